"""Varied copies of recorded trials, from which a network learns what does not depend on speed, force or start.

A copy is the signal of a training trial, played faster or slower (another speed), scaled from its rest (another
force), begun later (another start) or with some taxels at rest (another place on the skin, a dead taxel), and encoded
like any recording. Sources: window warping (Le Guennec, Malinowski and Tavenard 2016), magnitude scaling (Um et al.
2017, doi 10.1145/3136755.3136817), and drop-out of whole channels (Tompson et al. 2015, arXiv 1411.4280).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from pydantic import Field, field_validator

from neurotact import plugins
from neurotact.data.digests import recorded_digest
from neurotact.data.onset import common_onset_s
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, Variations
from neurotact.data.window_choice import RESTS
from neurotact.errors import InputError
from neurotact.spec import Spec

Part = Literal["time", "gain", "start", "taxels"]
NONE, AUTO, JOIN = "none", "auto", "+"
CANDIDATES = (NONE, "time", "gain", "time+gain")
"""What `auto` chooses among, on validation trials of a condition that is not trained on."""
EVERY = "time+gain+start"
"""What it may choose, too, where windows do not begin at contact."""
UNRANKED = (CANDIDATES[-1], EVERY)
"""What `auto` takes where validation cannot leave out a condition: the last of its candidates."""
BEGIN_S = 0.05
"""Of a trial without rest, the beginning whose mean stands for it."""


class AugmentationSpec(Spec):
    """Varied copies of the training trials."""

    kind: str = AUTO
    """What varies: `time`, `gain`, `start` and `taxels`, joined by `+`; `none`: no copies; `auto`: where the test is on
    other conditions, none, time, gain or time+gain, whichever is best on validation trials of another condition."""
    any_start: bool = False
    """With `auto`: time+gain+start is a candidate, too. Studies set it where windows do not begin at contact."""
    copies: int = Field(default=3, ge=1, le=20)
    """Copies of each training trial."""
    time_factor: float = Field(default=2.0, gt=1, le=10)
    """A copy is played up to this many times faster or slower; the logarithm is uniform."""
    gain_factor: float = Field(default=2.0, gt=1, le=10)
    """The deviation of its signals from rest is up to this many times larger or smaller; the logarithm is uniform."""
    shift_ms: float = Field(default=500.0, gt=0)
    """A copy begins up to this much later."""
    taxel_share: float = Field(default=0.25, gt=0, lt=1)
    """Share of the taxels that are at rest in a copy, drawn for each; at least one is, and one is not."""
    seed: int = Field(default=0, ge=0)
    """Random seed of the copies."""

    @field_validator("kind")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind in (NONE, AUTO):
            return kind
        parts, known = kind.split(JOIN), get_args(Part)
        if parts != [part for part in known if part in parts]:
            raise ValueError(f"must be none, auto, or some of {', '.join(known)} in this order, as in time+gain")
        return kind

    def reach_ms(self, end_ms: float) -> float:
        """How much of a trial the copies need that last `end_ms`.

        >>> AugmentationSpec(kind="time+start").reach_ms(500.0), AugmentationSpec(kind="gain").reach_ms(500.0)
        (1500.0, 500.0)
        """
        faster = self.time_factor if "time" in self.parts else 1.0
        return faster * end_ms + (self.shift_ms if "start" in self.parts else 0.0)

    @property
    def parts(self) -> set[str]:
        """What varies in some of the copies.

        >>> sorted(AugmentationSpec(kind="gain+taxels").parts)
        ['gain', 'taxels']
        """
        return {part for kind in self.kinds for part in kind.split(JOIN)}

    @property
    def candidates(self) -> tuple[str, ...]:
        """The kinds of copies that may be chosen, without copies first; of a named kind that alone.

        >>> AugmentationSpec(kind="gain").candidates, AugmentationSpec(any_start=True).candidates[-1]
        (('gain',), 'time+gain+start')
        """
        if self.kind != AUTO:
            return (self.kind,)
        return (*CANDIDATES, EVERY) if self.any_start else CANDIDATES

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of copies that are needed."""
        return tuple(kind for kind in self.candidates if kind != NONE)


def in_words(kind: str, spec: AugmentationSpec) -> str:
    """What varies in the copies, with the factors.

    >>> in_words("time+gain", AugmentationSpec())
    'played up to 2 times faster or slower, and scaled up to 2 times'
    """
    words = {
        "time": f"played up to {spec.time_factor:g} times faster or slower",
        "gain": f"scaled up to {spec.gain_factor:g} times",
        "start": f"begun up to {spec.shift_ms:g} ms later",
        "taxels": f"with {100 * spec.taxel_share:g} % of the taxels at rest",
    }
    *first, last = (words[part] for part in kind.split(JOIN))
    return ", and ".join([", ".join(first), last]) if first else last


def check_taxels(spec: AugmentationSpec | None, n_channels: int) -> None:
    """InputError for copies with taxels at rest of a sensor with a single one: nothing of the touch would be left.

    >>> check_taxels(AugmentationSpec(kind="gain+taxels"), 2)
    """
    if spec is not None and "taxels" in spec.parts and n_channels < 2:
        raise InputError(
            "augmentation: 'taxels' leaves some of the taxels at rest, and these recordings have only one; leave it out"
        )


MOST_MADE = 6
"""Reads whose spikes are kept: of the kinds that are compared, and of the last training."""
BLOCK_VALUES = 2_000_000
"""Values of the copies that are in memory at once."""


class _VariedCopies(NamedTuple):
    """Some varied copies of one kind; of: the trial that each is a copy of, `(copy,)` int64."""

    kind: str
    recordings: Recordings
    of: np.ndarray


def varied_copies(
    recordings: Recordings, spec: AugmentationSpec, places: np.ndarray | None = None
) -> Iterator[_VariedCopies]:
    """The copies of each kind that a spec needs, a block at a time, in their order.

    places: of those that are made, in the order of `order_of`; all if None.

    The same trials and spec give the same copies. What is drawn for a copy depends on its trial's samples, its number
    and the seed, not on the trial's index.

    A copy is at least as long as its trial: one that is played faster goes on backwards from its end, where a touch is
    over and a slide goes on. Raises InputError as `check_taxels`.

    >>> touches = Recordings([np.arange(8.0)[:, None]], 100.0, "mV", {"label": ["felt"]})
    >>> [(each.kind, len(each.recordings)) for each in varied_copies(touches, AugmentationSpec(copies=2))]
    [('time', 2), ('gain', 2), ('time+gain', 2)]
    """
    check_taxels(spec, recordings.n_channels)
    rate_Hz, per_kind = recordings.sampling_rate_Hz, len(recordings) * spec.copies
    n_rest = int(RESTS * common_onset_s(recordings) * rate_Hz) or max(1, int(BEGIN_S * rate_Hz))
    places = np.arange(per_kind * len(spec.kinds)) if places is None else places
    at_once = max(1, BLOCK_VALUES // max(1, int(recordings.lengths.max()) * recordings.n_channels))
    for of_kind in np.split(places, np.flatnonzero(np.diff(places // per_kind)) + 1):
        for first in range(0, len(of_kind), at_once):
            number, rows = divmod(of_kind[first : first + at_once], per_kind)
            yield _block(recordings, rows, spec.kinds[number[0]], spec, n_rest)


def order_of(n_trials: int, spec: AugmentationSpec) -> tuple[np.ndarray, np.ndarray]:
    """The trial and the kind of each copy, `(copy,)`, in the order of `varied_copies`.

    >>> order_of(2, AugmentationSpec(kind="gain", copies=2))[0].tolist()
    [0, 0, 1, 1]
    """
    of = np.repeat(np.arange(n_trials), spec.copies)
    return np.tile(of, len(spec.kinds)), np.repeat(np.array(spec.kinds, dtype=str), len(of))


@dataclass(frozen=True, eq=False)
class CopiesWhenRead:
    """Copies that are made and encoded when they are read, so that no file stores their signals or spikes.

    recordings: of the trials, as far as their copies need them. encoder: the table of their encoder. spec: what varies.
    made: the spikes that were read last, by their places: kinds are compared, then trained on, in each of many cells.
    """

    recordings: Recordings
    encoder: Mapping[str, Any]
    spec: AugmentationSpec
    made: dict[bytes, list[SpikeTrains]] = field(default_factory=dict, repr=False)

    def blocks(self, places: np.ndarray) -> Iterator[SpikeTrains]:
        """The spikes of the copies at some places in the order of `order_of`."""
        encode, key = plugins.load_function("tools", "encode_copies"), places.tobytes()
        if key not in self.made:
            every = varied_copies(self.recordings, self.spec, places)
            spikes = [encode(copies.recordings, self.encoder) for copies in every]
            while len(self.made) >= MOST_MADE:
                del self.made[next(iter(self.made))]
            self.made[key] = spikes
        yield from self.made[key]

    def variations(self, of: np.ndarray | None = None, places: np.ndarray | None = None) -> Variations:
        """The copies at some places, each with the trial that it is one of; all if None."""
        trials, kind = order_of(len(self.recordings), self.spec)
        places = np.arange(len(kind)) if places is None else places
        return Variations(self, trials[places] if of is None else of, kind[places], places)


def _block(recordings: Recordings, rows: np.ndarray, kind: str, spec: AugmentationSpec, n_rest: int) -> _VariedCopies:
    """Some copies of a kind. rows: of each, its trial times the number of copies, and its own number.

    n_rest: samples of each trial whose mean is its rest: test trials may not tell that of a training trial.
    """
    rate_Hz, signals = recordings.sampling_rate_Hz, []
    of, numbers = divmod(rows, spec.copies)
    samples = {trial: int(recorded_digest(recordings, trial), 16) for trial in {*of.tolist()}}
    for trial, copy in zip(of.tolist(), numbers.tolist(), strict=True):
        rng = np.random.default_rng([spec.seed, samples[trial], copy])
        signals.append(_copy(recordings.signals[trial], rate_Hz, kind, spec, n_rest, rng))
    conditions = recordings.conditions.iloc[of].reset_index(drop=True)
    about = recordings.unit, conditions, recordings.channels, recordings.source
    return _VariedCopies(kind, Recordings(signals, rate_Hz, *about), of)


def _copy(
    signal: np.ndarray, rate_Hz: float, kind: str, spec: AugmentationSpec, n_rest: int, rng: np.random.Generator
) -> np.ndarray:
    parts = kind.split(JOIN)
    speed = _factor(spec.time_factor, rng)  # always drawn, so that kinds differ only in what varies
    gain = _factor(spec.gain_factor, rng)
    shift = rng.uniform(0, 1e-3 * spec.shift_ms * rate_Hz)
    varied, level = signal, signal[:n_rest].mean(axis=0, dtype=np.float64)
    if "gain" in parts:
        varied = level + gain * (signal - level)
    if "time" in parts or "start" in parts:
        varied = played(varied, speed if "time" in parts else 1.0, shift if "start" in parts else 0.0)
    if "taxels" in parts:
        n = signal.shape[1]
        still = rng.choice(n, min(n - 1, max(1, round(spec.taxel_share * n))), replace=False)
        varied = varied.copy()
        varied[:, still] = level[still]
    return varied.astype(np.float32)


def _factor(most: float, rng: np.random.Generator) -> float:
    return float(most ** rng.uniform(-1, 1))


def played(signal: np.ndarray, speed: float, first: float = 0.0) -> np.ndarray:
    """A signal `(time, channel)` played `speed` times as fast from sample `first` on, with linear interpolation.

    It is at least as long as before; after its last sample it goes back.

    >>> played(np.array([[0.0], [1.0], [2.0], [3.0]]), 2.0).ravel().tolist()
    [0.0, 2.0, 2.0, 0.0]
    >>> played(np.array([[0.0], [1.0]]), 0.5).ravel().tolist()
    [0.0, 0.5, 1.0, 0.5]
    """
    n = len(signal)
    if n == 1:
        return np.asarray(signal, np.float64)
    position = first + speed * np.arange(max(n, round(n / speed)))
    position = (n - 1) - np.abs((n - 1) - position % (2 * (n - 1)))
    before = np.minimum(position.astype(np.int64), n - 2)
    share = (position - before)[:, None]
    return signal[before] * (1 - share) + signal[before + 1] * share
