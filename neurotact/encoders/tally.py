"""What a search for gains asks of spikes: how many each afferent has, and how its intervals spread over bins.

LIF afferents are tallied while they are computed, in compiled code; the spikes of other models are, from their raster.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from neurotact.backend import Backend, use_native
from neurotact.data import conditioning
from neurotact.data.spool import Spool
from neurotact.encoders import closed_form, native
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import side_by_side
from neurotact.encoders.model import EncoderSpec
from neurotact.encoders.native import Tally
from neurotact.encoders.specs import encode, is_exact
from neurotact.metrics.spike_trains import events_of_raster, isis_ms

HELD_PIECES = 32
"""Signals and copies of at most so many pieces stay in memory for all gains; more are read anew for each."""


class Asked(NamedTuple):
    """Afferents to tally: those from `first` to before `last` of an encoder's output, of one type.

    part: the type's key in the spec. edges, floor: as those of `Tally.empty`.
    """

    part: str
    first: int
    last: int
    edges: np.ndarray
    floor: int


class Group:
    """Conditioned signals that are encoded together, and what afferents feel of them, which no gain changes.

    signal: `(trial, time, taxel)` float32, zeros after the end of the shorter ones. n_samples: of each, `(trial,)`.
    """

    def __init__(self, signals: Sequence[np.ndarray]) -> None:
        self.signal, self.n_samples = side_by_side(signals)
        self._in_lanes: dict[str, np.ndarray] = {}

    @cached_property
    def change(self) -> np.ndarray:
        """The rectified change since the sample before."""
        change = np.zeros_like(self.signal)
        np.subtract(self.signal[:, 1:], self.signal[:, :-1], out=change[:, 1:])
        return np.abs(change, out=change)

    def in_lanes(self, part: str) -> np.ndarray:
        """What a type feels, with as many taxels as the kernel takes."""
        if part not in self._in_lanes:
            felt, more = self.change if part == "ra1" else self.signal, -self.signal.shape[2] % native.LANES
            self._in_lanes[part] = np.pad(felt, ((0, 0), (0, 0), (0, more))) if more else felt
        return self._in_lanes[part]

    def tallies(
        self, spec: EncoderSpec, rate_Hz: float, asked: Iterable[Asked], backend: Backend = "auto"
    ) -> list[Tally]:
        """The spikes of `encode`, tallied. rate_Hz: of the signals."""
        n_samples = self.signal.shape[1]
        clock_Hz = spec.conditioning.clock_Hz(rate_Hz)
        n_steps = closed_form.n_complete(n_samples, rate_Hz, clock_Hz) if is_exact(spec) else n_samples
        ends = np.minimum(np.ceil(self.n_samples * (clock_Hz / rate_Hz)).astype(np.int64), n_steps)
        found = [(one, Tally.empty(ends, one.last - one.first, one.edges, one.floor)) for one in asked]
        compiled = use_native(backend, True, "")
        if compiled and isinstance(spec, AfferentSpec) and spec.is_plain and spec.has_all_taxels:
            for one, tally in found:
                self._tally_lif(spec, rate_Hz, one.part, tally)
        else:
            raster, _ = encode(self.signal, rate_Hz, spec)
            for one, tally in found:
                (native.tally_raster if compiled else _tally_raster)(raster[..., one.first : one.last], tally)
        return [tally for _, tally in found]

    def _tally_lif(self, spec: AfferentSpec, rate_Hz: float, part: str, tally: Tally) -> None:
        if is_exact(spec):
            return closed_form.tally(self.change if part == "ra1" else self.signal, rate_Hz, spec, part, tally)
        neuron = spec.neuron(getattr(spec, part), rate_Hz)
        for nth, gain in enumerate(spec.gains_at(rate_Hz)[part == "ra1"]):
            native.tally_population(self.in_lanes(part), gain, neuron, tally, nth * self.signal.shape[2])
        return None


def _tally_raster(raster: np.ndarray, tally: Tally) -> None:
    """The definition of `native.tally_raster`."""
    counted = np.arange(raster.shape[1]) < tally.ends[:, None]
    spikes = events_of_raster(raster * counted[..., None])
    intervals = isis_ms(spikes, 1e3)  # at 1 kHz an ISI in ms is its number of steps
    n_steps = intervals.isi_ms.astype(np.int64)
    np.maximum.at(tally.last, (spikes.trial, spikes.afferent), spikes.step.astype(np.int32))
    np.add.at(tally.intervals, (intervals.trial, intervals.afferent, tally.bin_of[n_steps]), 1)
    np.add.at(tally.at_floor, intervals.trial, n_steps <= tally.floor)


class Groups:
    """Signals in groups that fit in memory several times; where all do, they are put side by side once.

    per_sample: steps of the spikes' clock in a sample.
    """

    def __init__(self, signals: Spool, per_sample: float) -> None:
        self._signals, self._per_sample = signals, per_sample
        n_taxels = signals[0].shape[1]
        more = -n_taxels % native.LANES
        n_values = 2 * sum(signals.lengths) * (n_taxels if not more else 2 * n_taxels + more)  # `Group` and its copies
        self._held = [*self._anew()] if n_values <= HELD_PIECES * conditioning.PIECE_VALUES else None

    @property
    def signals(self) -> Sequence[np.ndarray]:
        """Each signal, `(time, taxel)`."""
        if self._held is None:
            return self._signals
        return [signal[:n] for group in self._held for signal, n in zip(group.signal, group.n_samples, strict=True)]

    def __iter__(self) -> Iterator[Group]:
        return iter(self._held) if self._held is not None else self._anew()

    def _anew(self) -> Iterator[Group]:
        waiting: list[np.ndarray] = []
        for signal in self._signals:
            longest = max(map(len, [*waiting, signal]))
            n_steps = round((len(waiting) + 1) * longest * self._per_sample)
            if waiting and conditioning.is_long(n_steps, signal.shape[1]):
                yield Group(waiting)
                waiting = []
            waiting.append(signal)
        yield Group(waiting)
