"""Gains of an encoder for another sensor, from training trials (`docs/calibration.md`).

The texture paper (Sec. III-A) weighs gains by the inter-spike intervals (ISIs) of its gratings: too high, and all
ISIs crowd at the refractory period, where the gratings overlap; too low, and afferents fall silent. Here that is a
rule: among the gains with few silent trials and few ISIs at the floor, the one whose ISI distributions separate the
classes best. No classifier is trained, and no trial but those given is seen.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field
from scipy.special import entr

from neurotact.data.conditioning import (
    ACAUSAL,
    Baseline,
    ConditioningSpec,
    condition_pieces,
    conditioned_length,
    is_long,
    standardised,
)
from neurotact.data.recordings import Trials
from neurotact.data.spool import Spool
from neurotact.encoders import grading
from neurotact.encoders.afferents import POPULATIONS, AfferentSpec, AfferentType, encode
from neurotact.encoders.scaling import REST_SD
from neurotact.encoders.scaling import fit as fit_scaling
from neurotact.errors import InputError
from neurotact.metrics.isi_distributions import bin_edges
from neurotact.metrics.spike_trains import Intervals, events_of_raster, isis_ms
from neurotact.neurons import LIF
from neurotact.spec import Spec, refuse

CLOCK_HZ = 1000.0
"""A clock that can express a refractory period of 1 ms."""
FLOOR_OF_TAU = 0.1
"""To charge within this share of tau_mem takes 10.5 times the drive that just fires: such an ISI is mostly t_ref."""
STRONGEST, STEPS_BELOW = 99.9, 3
"""The search begins so many steps below the gain at which this percentile of the drive just reaches threshold."""
PAST: tuple[Baseline, ...] = ("none", "start")
"""Baselines that `calibrate_causally` chooses from, the first of equal ones."""

FITTED = ("unit", "sa1.gain", "ra1.gain", "conditioning.offset", "conditioning.scale")
"""Keys of an encoder that calibration finds, whatever they were before."""
BY_CALIBRATION = "calibration finds it on the training trials, so that a given value would be ignored; leave it out"

log = logging.getLogger("neurotact")
Progress = Callable[[int, str], None]


class CalibrationRule(Spec):
    """What makes gains acceptable, and which are tried.

    >>> CalibrationRule(candidates=12).max_silent_share
    0.05
    """

    max_silent_share: float = Field(default=0.05, ge=0, lt=1)
    """Of the trials, at most this share may leave a population without a spike."""
    max_floor_share: float = Field(default=0.1, ge=0, le=1)
    """Of a population's ISIs, at most this share may lie at the refractory floor."""
    tie: float = Field(default=0.02, ge=0, lt=1)
    """Gains that separate the classes within this share of the best are as good; the smallest of them is taken."""
    candidates: int = Field(default=24, ge=2)
    """Gains tried for each population."""
    step: float = Field(default=1.25, gt=1)
    """From one candidate to the next."""
    trials_per_class: int = Field(default=64, ge=2)
    """At most so many trials of each class are used, drawn at random."""
    excerpt_s: float = Field(default=2.0, gt=0)
    """Of each of them, at most so long a stretch, at a random place."""
    shuffles: int = Field(default=8, ge=1)
    """Random labellings of the trials; how far they separate is the separation that means nothing."""
    seed: int = Field(default=0, ge=0)
    """Of trials, stretches and shuffles."""


@dataclass(frozen=True)
class Calibration:
    """An encoder for a sensor, and why it has these gains.

    encoder: the fitted spec, for recordings of the unit, taxels and rate that it was fitted on.
    table: one row per population and candidate gain: `afferent` ("SA-I", "RA-I"), `gain` (mV per standard deviation, or
        mV per standard deviation per ms), `silent_share`, `floor_share`, `separation` (bit), `spikes_per_s` (of one
        afferent), `admissible`, `chosen`.
    isi: one row per population, gain, label and bin: `afferent`, `gain`, `label`, `isi_ms` (the bin's geometric middle,
        infinite for trials without an interval), `share`, over trials and afferents.
    notes: what was changed of the spec, and what else one should know.
    """

    encoder: AfferentSpec
    table: pd.DataFrame
    isi: pd.DataFrame
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Felt:
    """Conditioned excerpts of the trials that gains are fitted on.

    signals: `(time, taxel)` each, on the encoder's clock.
    labels: class index of each.
    """

    signals: Spool
    labels: np.ndarray
    classes: tuple[str, ...]
    sampling_rate_Hz: float
    source: str

    @property
    def n_channels(self) -> int:
        return self.signals[0].shape[1]


def calibrate(
    recordings: Trials,
    spec: AfferentSpec,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
    *,
    inverted: bool = False,
    tell: bool = True,
) -> Calibration:
    """Fit standardisation and gains of `spec` on training trials as recorded, of any unit and rate.

    The spec's smoothing, clock and baseline stay, but for what the recordings cannot take: an EMA whose cut-off is
    not below their Nyquist frequency is dropped, and a recording below 1 kHz without `resample_Hz` gets a 1 kHz clock.
    Then each taxel is scaled by its standard deviation, and the gain of each population is searched by itself. The
    same trials, spec and rule give the same encoder.

    progress: called with 1 and a note at each of the `rule.candidates` steps.
    inverted: SA-I feels the signal's fall and not its rise: the scales are negative.
    tell: log the notes, too.
    Raises InputError for less than two classes, for signals that never move, and where no gain keeps both limits.

    >>> from neurotact.data.recordings import Recordings
    >>> from neurotact.spec import build
    >>> time_s, rng = np.arange(0, 1, 1e-3)[:, None], np.random.default_rng(0)
    >>> slide = lambda f: np.sin(2 * np.pi * f * time_s + rng.uniform(0, 6)) + rng.normal(0, 0.1, time_s.shape)
    >>> trials = Recordings([slide(f) for f in (2, 2, 2, 8, 8, 8)], 1000.0, "count",
    ...                     pd.DataFrame({"label": [*"aaabbb"]}))
    >>> start = build(AfferentSpec, {"sa1": {"gain": 1}, "ra1": {"gain": 1}}, "an example")
    >>> fitted = calibrate(trials, start, rule=CalibrationRule(candidates=16))
    >>> fitted.encoder.unit, fitted.table[fitted.table.chosen].afferent.tolist()
    ('count', ['SA-I', 'RA-I'])
    """
    if len(recordings.classes) < 2:
        raise InputError(
            f"{_source(recordings)}: holds one class, '{''.join(recordings.classes)}', and gains are chosen by how "
            "well they separate classes; give training trials of at least two"
        )
    rng = np.random.default_rng(rule.seed)
    conditioning, notes = _suited(spec.conditioning, recordings)
    drawn = recordings.select(_draw(recordings.labels, rule.trials_per_class, rng))
    clock_Hz = conditioning.resample_Hz or recordings.sampling_rate_Hz
    excerpts = _excerpts(drawn, conditioning, rule.excerpt_s, rng)
    # Of both polarities the mean is the zero: what lies below it is felt too.
    rest_sd = 0.0 if spec.sa1.opposite else REST_SD
    scaling = fit_scaling(drawn, excerpts, conditioning.baseline, inverted=inverted, rest_sd=rest_sd)
    conditioning = conditioning.model_copy(update={"offset": scaling.offset, "scale": scaling.scale})
    fitted = spec.model_copy(update={"unit": recordings.unit, "conditioning": conditioning})
    standardised = Spool(_standardised(excerpts, conditioning))
    felt = Felt(standardised, drawn.labels, drawn.classes, clock_Hz, recordings.source)

    table, isi = _search(felt, fitted, rule, rng, progress)
    chosen = {}
    for part, afferent in POPULATIONS.items():
        mine = table.afferent == afferent
        best = _choose(table[mine], rule, f"{_source(recordings)}: {afferent}")
        table.loc[best, "chosen"] = True
        gain = float(table.gain[best])
        chosen[part] = _graded(felt, fitted, part, gain)
        n_lost = len(getattr(spec, part).grades) - len(chosen[part].grades)
        if n_lost:
            notes.append(f"{afferent}: {n_lost} of the grades would equal others, and are left out")
        if gain == table.gain[mine].max():
            notes.append(f"{afferent}: the chosen gain is the largest tried; more candidates may find a better one")
    less = "vary less than a tenth as much as the liveliest taxel"
    if scaling.noise:
        notes.append(f"{', '.join(scaling.noise)}: {less} and are the same in all classes; treated as noise")
    if scaling.small:
        notes.append(f"{', '.join(scaling.small)}: {less} but differ between classes; scaled by their own deviation")
    for note in notes if tell else ():
        log.warning("%s: %s", _source(recordings), note)
    return Calibration(fitted.model_copy(update=chosen), table, isi, tuple(notes))


def calibrate_causally(
    recordings: Trials,
    spec: AfferentSpec,
    progress: Progress | None = None,
    rule: CalibrationRule = CalibrationRule(),
) -> Calibration:
    """`calibrate`, with the baseline of `PAST` that lets SA-I separate the classes best in place of the spec's.

    Without a baseline the static level is felt, which tells many surfaces apart; the mean of each trial's start takes
    off what drifts from touch to touch. RA-I feels changes, which neither touches. progress: called with 1 and a note
    at each of `rule.candidates` steps a baseline. Raises InputError where none of them can be calibrated.
    """
    found: dict[Baseline, Calibration] = {}
    for baseline in PAST:
        conditioning = spec.conditioning.model_copy(update={"baseline": baseline})
        changed = spec.model_copy(update={"conditioning": conditioning})
        try:
            found[baseline] = calibrate(recordings, changed, progress, rule)
        except InputError:
            if baseline == PAST[-1] and not found:
                raise
    best = max(found, key=lambda baseline: _chosen_separation(found[baseline]))
    told = ", ".join(f"{baseline} {_chosen_separation(each):.3f} bit" for baseline, each in found.items())
    note = f"the baseline is '{best}', which knows the past alone and separates the classes best (SA-I: {told})"
    log.warning("%s: %s", _source(recordings), note)
    return replace(found[best], notes=(*found[best].notes, note))


def way_of(spec: AfferentSpec, given: Mapping[str, Any]) -> tuple[Callable[..., Calibration], int]:
    """How an encoder is calibrated, and how often that goes through all candidates of its rule.

    A baseline that knows the whole trial gives way to one that knows the past alone, unless its key is among `given`,
    the dotted keys that were set. Raises InputError where one of them is of `FITTED`.

    >>> from neurotact.spec import load
    >>> paper = load(AfferentSpec, "sa1-ra1-lif")
    >>> [way_of(paper, given)[1] for given in ({}, {"conditioning.baseline": "mean"})]
    [2, 1]
    """
    refuse(given, dict.fromkeys(FITTED, BY_CALIBRATION))
    chooses = spec.conditioning.baseline in ACAUSAL and "conditioning.baseline" not in given
    return (calibrate_causally, len(PAST)) if chooses else (calibrate, 1)


def _graded(felt: Felt, spec: AfferentSpec, part: str, gain: float) -> AfferentType:
    """The afferents of a type with their gain, and with as many grades as they have, set anew (`grading`)."""
    kind: AfferentType = getattr(spec, part)
    n_grades = len(kind.grades)
    if n_grades == 1:
        return kind.model_copy(update={"gain": gain})
    values = grading.sample(*_drives(felt, spec)[part])
    return kind.model_copy(update={"gain": gain, "grades": grading.fit(values, spec, gain, n_grades)})


def _chosen_separation(found: Calibration) -> float:
    """Of SA-I, at the gain that was chosen."""
    table = found.table
    return float(table.separation[table.chosen & (table.afferent == POPULATIONS["sa1"])].iloc[0])


def _suited(conditioning: ConditioningSpec, recordings: Trials) -> tuple[ConditioningSpec, list[str]]:
    """Conditioning that recordings of this rate can take, without standardisation, and what was changed."""
    rate_Hz, notes = recordings.sampling_rate_Hz, []
    change: dict[str, float | None] = {"offset": None, "scale": None}
    cutoff_Hz = conditioning.ema_cutoff_Hz
    if cutoff_Hz is not None and cutoff_Hz >= rate_Hz / 2:
        change["ema_cutoff_Hz"] = None
        notes.append(f"the EMA at {cutoff_Hz:g} Hz is left out: {rate_Hz:g} Hz recordings end at {rate_Hz / 2:g} Hz")
    if conditioning.resample_Hz is None and rate_Hz < CLOCK_HZ:
        change["resample_Hz"] = CLOCK_HZ
        notes.append(f"the clock is {CLOCK_HZ:g} Hz: at {rate_Hz:g} Hz a refractory period of 1 ms cannot be resolved")
    return conditioning.model_copy(update=change), notes


def _draw(labels: np.ndarray, per_class: int, rng: np.random.Generator) -> np.ndarray:
    """At most `per_class` trials of each class, at random; sorted indices."""
    trials = (rng.permutation(np.flatnonzero(labels == label))[:per_class] for label in np.unique(labels))
    return np.sort(np.concatenate(list(trials)))


def _excerpts(recordings: Trials, conditioning: ConditioningSpec, longest_s: float, rng: np.random.Generator) -> Spool:
    """A stretch of each trial, at a random place; conditioned before it is cut, as an encoder sees it."""
    rate_Hz, clock_Hz = recordings.sampling_rate_Hz, conditioning.resample_Hz or recordings.sampling_rate_Hz
    how = conditioning.model_copy(update={"offset": None, "scale": None, "rectify": False})

    def cut() -> Iterator[np.ndarray]:
        for trial, n_samples in enumerate(recordings.lengths.tolist()):
            n_steps = conditioned_length(n_samples, rate_Hz, conditioning.resample_Hz)
            length = min(n_steps, max(1, round(longest_s * clock_Hz)))
            start = int(rng.integers(n_steps - length + 1))
            yield _stretch(condition_pieces(recordings, trial, how), start, start + length)

    return Spool(cut())


def _stretch(pieces: Iterable[np.ndarray], start: int, stop: int) -> np.ndarray:
    """The steps from `start` to before `stop` of a signal that comes in pieces."""
    found, first = [], 0
    for piece in pieces:
        found.append(piece[max(0, start - first) : max(0, stop - first)].copy())  # a view would keep the whole piece
        first += len(piece)
        if first >= stop:
            break
    return np.concatenate(found)


def _standardised(excerpts: Iterable[np.ndarray], conditioning: ConditioningSpec) -> Iterator[np.ndarray]:
    """Excerpts as the populations feel them."""
    for signal in excerpts:
        yield standardised(signal, conditioning.offset, conditioning.scale, conditioning.rectify)


def _search(
    felt: Felt, spec: AfferentSpec, rule: CalibrationRule, rng: np.random.Generator, progress: Progress | None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """`Calibration.table`, nothing chosen yet, and `Calibration.isi`: both populations at each candidate gain."""
    n_steps = felt.signals.lengths
    rate_Hz, labels = felt.sampling_rate_Hz, felt.labels
    labellings = [labels, *(rng.permutation(labels) for _ in range(rule.shuffles))]
    grids = _candidates(felt, spec, rule)
    rows, isi = [], []
    for gains in zip(*grids.values(), strict=True):
        tried = {
            part: getattr(spec, part).model_copy(update={"gain": gain, "grades": (1.0,)})
            for part, gain in zip(grids, gains, strict=True)
        }
        for (part, afferent), gain, fired in zip(
            POPULATIONS.items(), gains, _fire(felt, spec.model_copy(update=tried)), strict=True
        ):
            row = {
                "afferent": afferent,
                "gain": gain,
                "silent_share": float(1 - fired.n_heard / len(labels)),
                "floor_share": fired.n_at_floor / fired.n_intervals if fired.n_intervals else 0.0,
                "separation": _separation(fired.shares, labellings),
                "spikes_per_s": float(fired.n_spikes / (sum(n_steps) / rate_Hz * fired.shares.shape[1])),
            }
            rows.append(row)
            edges_ms = _edges(felt, spec, part) / rate_Hz * 1e3
            isi.append(_isi_table(fired.shares, labels, felt.classes, edges_ms, afferent, gain))
        if progress:
            progress(1, ", ".join(f"{a} {g:g}" for a, g in zip(POPULATIONS.values(), gains, strict=True)))
    table = pd.DataFrame(rows).sort_values(["afferent", "gain"], ascending=[False, True], ignore_index=True)
    within = (table.silent_share <= rule.max_silent_share) & (table.floor_share <= rule.max_floor_share)
    return table.assign(admissible=within, chosen=False), pd.concat(isi, ignore_index=True)


class Fired(NamedTuple):
    """What one population sends at one gain.

    shares: ISI distribution of each trial and afferent (`_isi_shares`).
    n_heard: trials with a spike. n_at_floor, n_intervals: ISIs at the refractory floor, and all.
    """

    shares: np.ndarray
    n_heard: int
    n_at_floor: int
    n_intervals: int
    n_spikes: int


def _fire(felt: Felt, spec: AfferentSpec) -> Iterator[Fired]:
    """Both populations, in the order of `POPULATIONS`; so many trials at a time as are encoded side by side."""
    parts: dict[str, list[Fired]] = {part: [] for part in POPULATIONS}
    edges = {part: _edges(felt, spec, part) for part in POPULATIONS}
    for signal, n_steps in _side_by_side(felt.signals):
        spikes, _ = encode(signal, felt.sampling_rate_Hz, spec)
        spikes[np.arange(signal.shape[1]) >= n_steps[:, None]] = 0
        n_sa1 = felt.n_channels * len(spec.sa1.gains)
        for part, raster in zip(POPULATIONS, (spikes[..., :n_sa1], spikes[..., n_sa1:]), strict=True):
            isi_steps = _isi_steps(raster)
            neuron = spec.neuron(getattr(spec, part), felt.sampling_rate_Hz)
            parts[part].append(
                Fired(
                    shares=_isi_shares(isi_steps, raster.shape, edges[part]),
                    n_heard=int(raster.any(axis=(1, 2)).sum()),
                    n_at_floor=_n_at_floor(isi_steps.isi_ms, neuron),
                    n_intervals=len(isi_steps.isi_ms),
                    n_spikes=int(raster.sum()),
                )
            )
    for found in parts.values():
        shares, *counts = zip(*found, strict=True)
        yield Fired(np.concatenate(shares), *map(sum, counts))


def _side_by_side(signals: Spool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Consecutive signals as `(trial, time, taxel)`, zeros after the end of the shorter ones, and their lengths."""
    waiting: list[np.ndarray] = []
    for signal in signals:
        longest = max(map(len, [*waiting, signal]))
        if waiting and is_long((len(waiting) + 1) * longest, signal.shape[1]):
            yield _padded(waiting)
            waiting = []
        waiting.append(signal)
    yield _padded(waiting)


def _padded(signals: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    n_steps = np.array([len(x) for x in signals])
    padded = np.zeros((len(signals), n_steps.max(), signals[0].shape[1]), np.float32)
    for row, x in zip(padded, signals, strict=True):
        row[: len(x)] = x
    return padded, n_steps


def _edges(felt: Felt, spec: AfferentSpec, part: str) -> np.ndarray:
    """The bins of a population's ISIs, in steps."""
    neuron = spec.neuron(getattr(spec, part), felt.sampling_rate_Hz)
    return bin_edges(neuron.refractory_steps + 1, max(felt.signals.lengths))


def _candidates(felt: Felt, spec: AfferentSpec, rule: CalibrationRule) -> dict[str, list[float]]:
    """Gains of each population, from a little below the one at which its strongest drive just reaches threshold."""
    grids = {}
    for part, (drive, n_values) in _drives(felt, spec).items():
        strongest = _strongest((x.ravel() for x in drive), n_values)
        if strongest <= 0:
            raise InputError(
                f"{_source(felt)}: the conditioned training trials never drive {POPULATIONS[part]} afferents; check "
                "the encoder's baseline and the columns that were read"
            )
        first = (spec.v_threshold_mV - spec.v_rest_mV) / strongest / rule.step**STEPS_BELOW
        grids[part] = [float(f"{first * rule.step**k:.3g}") for k in range(rule.candidates)]
    return grids


def _drives(felt: Felt, spec: AfferentSpec) -> dict[str, tuple[Iterator[np.ndarray], int]]:
    """What each type feels by a gain of 1, trial by trial `(time, taxel)`, and how many values that is.

    Of SA-I of both polarities the size alone: one of the two feels it.
    """
    per_ms = felt.sampling_rate_Hz * 1e-3
    n_values = felt.n_channels * sum(felt.signals.lengths)
    return {
        "sa1": ((np.abs(x) if spec.sa1.opposite else x for x in felt.signals), n_values),
        "ra1": (
            (np.abs(np.diff(x, axis=0)) * per_ms for x in felt.signals),
            n_values - felt.n_channels * len(felt.signals),
        ),
    }


def _strongest(drive: Iterable[np.ndarray], n_values: int) -> float:
    """The `STRONGEST` percentile of `n_values` numbers that come in parts, or their maximum where it is not positive.

    As `np.percentile` has it, linear between two of the numbers; only those from there upwards are kept.
    """
    if n_values == 0:
        return 0.0
    place = (n_values - 1) * float(np.true_divide(STRONGEST, 100))
    below = int(place)
    n_kept = n_values - below
    top = np.empty(0, np.float32)
    for part in drive:
        top = np.concatenate([top, part])
        if len(top) > n_kept:
            top = np.partition(top, len(top) - n_kept)[len(top) - n_kept :]
    top.sort()
    low, high, share = top[0], top[min(1, len(top) - 1)], place - below
    strongest = high - (high - low) * (1 - share) if share >= 0.5 else low + (high - low) * share
    return float(strongest if strongest > 0 else top[-1])


def _choose(table: pd.DataFrame, rule: CalibrationRule, where: str) -> int:
    """Index of the chosen row of one population; InputError where none is admissible."""
    heard = table[table.silent_share <= rule.max_silent_share]
    if heard.empty:
        raise InputError(
            f"{where}: every gain tried leaves {table.silent_share.min():.1%} of the training trials silent or more, "
            f"above max_silent_share = {rule.max_silent_share:.1%}; drop the trials without contact or raise the limit"
        )
    if not heard.admissible.any():
        raise InputError(
            f"{where}: every gain that leaves few trials silent puts {heard.floor_share.min():.1%} of the ISIs at the "
            f"refractory floor or more, above max_floor_share = {rule.max_floor_share:.1%}; drop the trials with the "
            "weakest contact or raise the limit"
        )
    admissible = table[table.admissible]
    best = admissible.separation.max()
    return int(admissible.index[admissible.separation >= best - rule.tie * abs(best)][0])


def _isi_steps(raster: np.ndarray) -> Intervals:
    """Every interval, counted in steps."""
    return isis_ms(events_of_raster(raster), 1e3)


def _n_at_floor(isi_steps: np.ndarray, neuron: LIF) -> int:
    """Intervals in which charging took one step, or no longer than FLOOR_OF_TAU of tau_mem."""
    with np.errstate(divide="ignore"):  # a membrane that never leaks takes an infinite share
        charging = np.maximum(1.0, np.round(-FLOOR_OF_TAU / np.log(neuron.decay)))
    return int((isi_steps <= neuron.refractory_steps + charging).sum())


def _isi_shares(isi_steps: Intervals, shape: tuple[int, ...], edges: np.ndarray) -> np.ndarray:
    """ISI distribution of each trial and afferent, `(trial, afferent, bin)`, each summing to 1.

    Every trial counts the same, however many spikes it has; the last bin holds those without any interval.
    """
    n_trials, _, n_afferents = shape
    n_bins = len(edges)
    bins = np.clip(np.searchsorted(edges, isi_steps.isi_ms, side="right") - 1, 0, n_bins - 2)
    cell = (isi_steps.trial * n_afferents + isi_steps.afferent) * n_bins + bins
    counts = np.bincount(cell, minlength=n_trials * n_afferents * n_bins).reshape(n_trials, n_afferents, n_bins)
    counts[..., -1] = counts.sum(axis=-1) == 0
    return counts / counts.sum(axis=-1, keepdims=True)


def _separation(shares: np.ndarray, labellings: Sequence[np.ndarray]) -> float:
    """How far the classes' ISI distributions lie apart, in bit: 0 for equal ones, at most 1.

    The Jensen-Shannon divergence of two classes' mean distributions, averaged over pairs and afferents; less the
    average of the same over shuffled labels, because few trials never agree exactly.
    """
    true, *shuffled = (_divergence(shares, labels) for labels in labellings)
    return float(true - np.mean(shuffled))


def _divergence(shares: np.ndarray, labels: np.ndarray) -> float:
    means = np.stack([shares[labels == label].mean(axis=0) for label in np.unique(labels)])
    one, other = np.triu_indices(len(means), k=1)
    entropies = _entropy(means)
    mixed = _entropy((means[one] + means[other]) / 2)
    return float((mixed - (entropies[one] + entropies[other]) / 2).mean())


def _entropy(shares: np.ndarray) -> np.ndarray:
    return entr(shares).sum(axis=-1) / np.log(2)


def _isi_table(
    shares: np.ndarray, labels: np.ndarray, classes: tuple[str, ...], edges_ms: np.ndarray, afferent: str, gain: float
) -> pd.DataFrame:
    middles_ms = [*np.sqrt(edges_ms[1:] * edges_ms[:-1]), np.inf]
    parts = [
        pd.DataFrame({"label": name, "isi_ms": middles_ms, "share": shares[labels == label].mean(axis=(0, 1))})
        for label, name in enumerate(classes)
    ]
    return pd.concat(parts, ignore_index=True).assign(afferent=afferent, gain=gain)


def _source(recordings: Trials | Felt) -> str:
    return recordings.source or "recordings"
