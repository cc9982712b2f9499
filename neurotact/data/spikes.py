"""Spike trains of trials, as events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from neurotact.data import marks as annotations
from neurotact.data.contact import OnsetSpec, onset_of
from neurotact.data.recordings import (
    check_conditions,
    check_sampling_rate,
    chosen,
    class_indices,
    class_names,
    conditions_table,
)
from neurotact.data.windows import LONGEST_STEPS, Windows, WindowSpec, cut
from neurotact.errors import InputError, in_digits, number_of
from neurotact.files import check_size, room_bytes
from neurotact.lazily import lazily
from neurotact.notebook import html_of

with lazily():
    import pandas as pd


class TrialSpikes(NamedTuple):
    """The spikes of one trial: the step and the afferent of each, in order of time, and the trial's length in steps.

    digest: of the recording (`data.digests`); empty if unknown.
    touch: as of `SpikeTrains.trial_touches`; empty if it is the digest.
    """

    steps: np.ndarray
    units: np.ndarray
    n_steps: int
    digest: str = ""
    touch: str = ""


def populations_of(afferents: Sequence[str]) -> dict[str, np.ndarray]:
    """The afferents of each population, `(afferent,)` int64 indices, in the order of their first afferents.

    The first word of an afferent's name is its population, as in "SA-I taxel1" and "ON left"; afferents with a name of
    one word form a single population, "afferents".

    >>> {name: its.tolist() for name, its in populations_of(("ON left", "ON right", "OFF left")).items()}
    {'ON': [0, 1], 'OFF': [2]}
    """
    kinds = np.array([name.partition(" ")[0] if " " in name else "afferents" for name in afferents])
    return {str(kind): np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds.tolist())}


class CopySource(Protocol):
    """What gives the spikes of varied copies, some at a time, by their places in it."""

    def blocks(self, places: np.ndarray) -> Iterator[SpikeTrains]: ...


class StoredCopies(NamedTuple):
    """Copies whose spikes are in memory."""

    trains: SpikeTrains

    def blocks(self, places: np.ndarray) -> Iterator[SpikeTrains]:
        """All at once."""
        yield self.trains.select(places)


class Variations(NamedTuple):
    """Varied copies of trials (`data.augmentation`), which training alone may use; their spikes are made when read.

    of: the trial that each is a copy of, `(copy,)` int64. kind: what varies, `(copy,)`.
    source, places: what gives their spikes, and the place of each in it, `(copy,)` int64.
    """

    source: CopySource
    of: np.ndarray
    kind: np.ndarray
    places: np.ndarray

    @property
    def trains(self) -> SpikeTrains:
        """The spikes of all."""
        return end_to_end([*self.source.blocks(self.places)])

    def only(self, rows: np.ndarray) -> Variations:
        """Some of the copies."""
        return self._replace(of=self.of[rows], kind=self.kind[rows], places=self.places[rows])

    def rows(self, trials: np.ndarray, kind: str) -> np.ndarray:
        """The copies of one kind of some trials."""
        return np.flatnonzero(np.isin(self.of, trials) & (self.kind == kind))

    def select(self, trials: np.ndarray) -> Variations:
        """The copies of some trials, which are then counted as in `trials`."""
        rows = np.flatnonzero(np.isin(self.of, trials))
        ordered = np.argsort(trials, kind="stable")
        return self.only(rows)._replace(of=ordered[np.searchsorted(trials, self.of[rows], sorter=ordered)])


@dataclass(frozen=True, eq=False)
class SpikeTrains:
    """The spikes of every trial.

    steps, units: for each trial, the step and the afferent of each spike, in order of time.
    trial_steps: length of each trial in steps, `(trial,)`.
    sampling_rate_Hz: steps per second.
    afferents: the afferents' names, such as "SA-I taxel1".
    conditions: one row per trial, with the column `label`.
    encoder: the encoder spec.
    source: the recordings that were encoded, usually a path.
    trial_digests: one digest per trial of the recording (`data.digests`); empty if unknown.
    trial_touches: one name per trial, equal for copies of one touch (`data.copies`); empty if the digests tell.
    touch_s: when the touch begins in the recordings, in s from the start of a trial (`data.onset`); None if unknown.
    variations: varied copies of the trials, for training alone; None if there are none.
    recorded_Hz: samples of the recordings per second; None if unknown.
    marks: as of `Recordings`.
    until_s: where spikes end that were cut behind the windows of a study (`until`); None: with their trials.

    Raises InputError if the lengths do not match, and for spikes out of order or outside their trial.

    >>> raster = np.zeros((1, 4, 2), np.uint8)
    >>> raster[0, 1, 0] = raster[0, 3, 1] = 1
    >>> trains = from_rasters(raster, 2000.0, ("SA-I taxel1", "RA-I taxel1"), pd.DataFrame({"label": ["felt"]}))
    >>> trains.steps[0].tolist(), trains.units[0].tolist()
    ([1, 3], [0, 1])
    """

    steps: Sequence[np.ndarray]
    units: Sequence[np.ndarray]
    trial_steps: np.ndarray
    sampling_rate_Hz: float
    afferents: tuple[str, ...]
    conditions: pd.DataFrame
    encoder: Mapping[str, Any]
    source: str = ""
    trial_digests: tuple[str, ...] = ()
    touch_s: float | None = None
    trial_touches: tuple[str, ...] = ()
    variations: Variations | None = None
    recorded_Hz: float | None = None
    marks: pd.DataFrame | None = None
    until_s: float | None = None

    def __post_init__(self) -> None:
        check_sampling_rate(self.sampling_rate_Hz, "spikes")
        if self.recorded_Hz is not None:
            check_sampling_rate(self.recorded_Hz, "spikes, recorded_Hz")
        object.__setattr__(self, "afferents", tuple(self.afferents))
        object.__setattr__(self, "conditions", conditions_table(self.conditions, "spikes"))
        object.__setattr__(self, "trial_steps", _lengths(self.trial_steps))
        if not len(self.steps) == len(self.units) == len(self.trial_steps) == len(self.conditions):
            raise InputError("spikes, trial_steps and conditions differ in number of trials; give one each per trial")
        if self.trial_digests and len(self.trial_digests) != len(self.steps):
            raise InputError("spikes and trial_digests differ in number of trials; give one digest per trial, or none")
        if self.trial_touches and len(self.trial_touches) != len(self.trial_digests):
            raise InputError("trial_touches and trial_digests differ in number of trials; give both per trial, or none")
        if self.touch_s is not None and not 0 <= self.touch_s < math.inf:
            raise InputError(f"touch_s: must be a time in s, at least 0, or None; got {self.touch_s}")
        check_conditions(self.conditions, "spikes")
        object.__setattr__(self, "marks", annotations.checked(self.marks, np.full(len(self.steps), np.inf), "spikes"))
        for trial, (steps, units) in enumerate(zip(self.steps, self.units, strict=True)):
            if not _fits(np.asarray(steps), np.asarray(units), self.trial_steps[trial], len(self.afferents)):
                raise InputError(
                    f"trial {trial} has spikes out of order, or outside its time or its afferents; "
                    "sort them by time and drop those outside"
                )

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        seconds = self.held_steps.sum() / self.sampling_rate_Hz
        n_spikes = sum(map(len, self.steps))
        rate_Hz = n_spikes / seconds / max(1, len(self.afferents)) if seconds else 0.0
        return (
            f"SpikeTrains({number_of(len(self), 'trial')} x {number_of(len(self.afferents), 'afferent')}, {n_spikes:,} "
            f"spikes in {in_digits(seconds)} s ({in_digits(rate_Hz)} Hz per afferent), clock "
            f"{self.sampling_rate_Hz:g} Hz, {number_of(len(self.classes), 'class')})"
        )

    def summary(self) -> str:
        """Sizes and rate in words, with the afferents of each population."""
        counts = {name: len(rows) for name, rows in self.populations.items()}
        shares = f" ({', '.join(f'{n} {name}' for name, n in counts.items())})" if len(counts) > 1 else ""
        return (
            f"{number_of(len(self), 'trial')} of {number_of(len(self.classes), 'class')}, "
            f"{number_of(sum(map(len, self.steps)), 'spike')} of {number_of(len(self.afferents), 'afferent')}{shares}, "
            f"{self.trial_steps[0]} steps at {self.sampling_rate_Hz:g} Hz"
        )

    def _repr_html_(self) -> str:
        parts = {"": self.encoder, **{f" of {name}": part for name, part in self.encoder.items()}}
        periods = {
            f"t_ref{name}": f"{part['t_ref_ms']:g} ms"
            for name, part in parts.items()
            if isinstance(part, Mapping) and "t_ref_ms" in part
        }
        return html_of(self, periods)

    @property
    def classes(self) -> tuple[str, ...]:
        return class_names(self.conditions)

    @property
    def labels(self) -> np.ndarray:
        """Class index of each trial, `(trial,)` int64, into `classes`."""
        return class_indices(self.conditions)

    @property
    def is_sa(self) -> np.ndarray:
        """Which afferents are slowly adapting, `(afferent,)` boolean; of other populations, those of the first one."""
        slow = np.array([name.startswith("SA") for name in self.afferents], bool)
        if not slow.any() and len(self.afferents) and not any(name.startswith("RA") for name in self.afferents):
            slow[next(iter(self.populations.values()))] = True
        return slow

    @property
    def held_steps(self) -> np.ndarray:
        """The steps of each trial whose spikes are held, `(trial,)`: all, or those up to `until_s`."""
        end = math.inf if self.until_s is None else self.until_s * self.sampling_rate_Hz
        return np.minimum(self.trial_steps, end).round().astype(np.int64)

    @property
    def populations(self) -> dict[str, np.ndarray]:
        """`populations_of` the afferents."""
        return populations_of(self.afferents)

    def trials(self) -> Iterator[TrialSpikes]:
        """One trial after the other."""
        digests, touches = (names or [""] * len(self) for names in (self.trial_digests, self.trial_touches))
        yield from map(TrialSpikes, self.steps, self.units, self.trial_steps.tolist(), digests, touches)

    def select(self, keep: ArrayLike) -> SpikeTrains:
        """The trials where the boolean `keep` is true, or the trials that an index array names."""
        index = chosen(keep, len(self))
        return replace(
            self,
            steps=[self.steps[i] for i in index.tolist()],
            units=[self.units[i] for i in index.tolist()],
            trial_steps=self.trial_steps[index],
            conditions=self.conditions.iloc[index].reset_index(drop=True),
            trial_digests=tuple(self.trial_digests[i] for i in index.tolist()) if self.trial_digests else (),
            trial_touches=tuple(self.trial_touches[i] for i in index.tolist()) if self.trial_touches else (),
            variations=None if self.variations is None else self.variations.select(index),
            marks=annotations.selected(self.marks, index),
        )

    def with_afferents(self, kept: Sequence[int]) -> SpikeTrains:
        """The spikes of some afferents alone, in ascending order.

        >>> trains = from_rasters(np.ones((1, 2, 3), np.uint8), 2000.0, ("a", "b", "c"), pd.DataFrame({"label": ["x"]}))
        >>> trains.with_afferents([0, 2]).afferents, trains.with_afferents([2]).steps[0].tolist()
        (('a', 'c'), [0, 1])
        """
        place = np.full(len(self.afferents), -1)
        place[[*kept]] = np.arange(len(kept))
        rows = [place[units] for units in self.units]
        return replace(
            self,
            steps=[steps[own >= 0] for steps, own in zip(self.steps, rows, strict=True)],
            units=[own[own >= 0] for own in rows],
            afferents=tuple(self.afferents[index] for index in kept),
        )

    def with_variations(self, *windows: WindowSpec) -> SpikeTrains:
        """All trials, then all copies, as trials; of these only the spikes that windows need, if there are any."""
        if self.variations is None:
            return self
        blocks = self.variations.source.blocks(self.variations.places)
        return end_to_end([self, *(block.within(*map(block.cut, windows)) if windows else block for block in blocks)])

    def cut(self, spec: WindowSpec, trials: np.ndarray | None = None) -> Windows:
        """The windows of some trials (of all when absent), with the trial numbers of these spike trains.

        Raises InputError when a trial holds no window, or too many, and for windows behind `until_s`.
        """
        trials = np.arange(len(self)) if trials is None else np.asarray(trials)
        windows = cut(self.trial_steps[trials], self.sampling_rate_Hz, spec, trials, self.begins(spec, trials))
        end_s = max(windows.start + windows.n_steps, default=0) / self.sampling_rate_Hz
        if self.until_s is not None and end_s > self.until_s:
            raise InputError(
                f"window: ends at {end_s:g} s, but the spikes are those of the first {self.until_s:g} s of a trial, "
                "which a study kept; shorten `length_ms`, give `per_trial=1`, or encode the recordings"
            )
        return windows

    def begins(self, spec: WindowSpec, trials: np.ndarray) -> np.ndarray | None:
        """The step of each given trial from which `start_ms` counts; None if it is the trial's beginning."""
        if spec.align != "onset":
            return None
        return np.array([onset or 0 for onset in self.onsets(spec.onset, trials)], np.int64)

    def onsets(self, rule: OnsetSpec, trials: np.ndarray) -> list[int | None]:
        """The step of the onset of contact of each given trial; None without one."""
        return [onset_of(self.steps[trial], self.sampling_rate_Hz, rule) for trial in trials.tolist()]

    def onset_complaint(self, spec: WindowSpec) -> str | None:
        """A note on trials whose windows do not start at the onset of contact as requested; None if all do."""
        if spec.align != "onset" or not len(self):
            return None
        onsets = self.onsets(spec.onset, np.arange(len(self)))
        never = [trial for trial, onset in enumerate(onsets) if onset is None]
        wanted = np.array([onset or 0 for onset in onsets]) + round(spec.start_ms * 1e-3 * self.sampling_rate_Hz)
        late = np.flatnonzero(wanted + round(spec.length_ms * 1e-3 * self.sampling_rate_Hz) > self.trial_steps)
        parts = []
        if never:
            parts.append(
                f"{len(never)} of {len(self)} trials have no onset of contact (the first is trial {never[0]}): their "
                "windows start at the trial's beginning"
            )
        if len(late):
            parts.append(
                f"{len(late)} end too soon after it for a window (the first is trial {late[0]}): they use the last "
                "window that fits"
            )
        return f"window.align: {'; '.join(parts)}" if parts else None

    def until(self, *windows: WindowSpec) -> SpikeTrains:
        """These trials without the spikes after the last of these windows; all lengths stay, and copies.

        >>> trains = from_rasters(np.ones((1, 9, 1)), 1000.0, ("SA-I a",), pd.DataFrame({"label": ["felt"]}))
        >>> trains.until(WindowSpec(length_ms=3, per_trial=2)).steps[0].tolist()
        [0, 1, 2, 3, 4, 5]
        """
        return self.within(*map(self.cut, windows))

    def within(self, *windows: Windows) -> SpikeTrains:
        """`until` windows that are cut already."""
        end = np.zeros(len(self), np.int64)
        for cut_into in windows:
            np.maximum.at(end, cut_into.trial, cut_into.start + cut_into.n_steps)
        kept = [np.searchsorted(steps, last) for steps, last in zip(self.steps, end.tolist(), strict=True)]
        steps, units = ([row[:n] for row, n in zip(rows, kept, strict=True)] for rows in (self.steps, self.units))
        is_cut = (end < self.held_steps).any()
        until_s = float(end.max() / self.sampling_rate_Hz) if is_cut else self.until_s
        return replace(self, steps=steps, units=units, until_s=until_s)

    def counts(self, windows: Windows) -> np.ndarray:
        """Spikes of all afferents in each window, `(window,)` int64: the sums of `raster`."""
        totals = [
            np.subtract(*np.searchsorted(self.steps[trial], (start + windows.n_steps, start)))
            for trial, start in zip(windows.trial, windows.start, strict=True)
        ]
        return np.array(totals, np.int64)

    def binned(self, windows: Windows, edges: np.ndarray) -> np.ndarray:
        """Spikes of each afferent in bins of each window, `(window, bin, afferent)` int64.

        edges: the first step of each bin and the end of the last one, `(bin + 1,)`, from the start of a window.

        >>> spikes, table = [np.array([[1], [1], [0], [1]])], pd.DataFrame({"label": ["felt"]})
        >>> trains = from_rasters(spikes, 1000.0, ("SA-I taxel1",), table)
        >>> trains.binned(Windows(np.array([0]), np.array([1]), 3), np.array([0, 2, 3])).ravel().tolist()
        [1, 1]
        """
        counts = np.zeros((len(windows), len(edges) - 1, len(self.afferents)), np.int64)
        for window, (trial, start) in enumerate(zip(windows.trial, windows.start, strict=True)):
            first, last = np.searchsorted(self.steps[trial], (start + edges[0], start + edges[-1]))
            bins = np.searchsorted(edges, self.steps[trial][first:last] - start, side="right") - 1
            np.add.at(counts[window], (bins, self.units[trial][first:last]), 1)
        return counts

    def raster(self, windows: Windows, into: np.ndarray | None = None) -> np.ndarray:
        """Spikes in the given windows, `(window, time, afferent)` uint8; InputError if it is too large.

        into: of `empty_raster`, filled in place.
        """
        raster = empty_raster(len(windows), windows.n_steps, len(self.afferents)) if into is None else into
        for window, (trial, start) in enumerate(zip(windows.trial, windows.start, strict=True)):
            first, last = np.searchsorted(self.steps[trial], (start, start + windows.n_steps))
            raster[window, self.steps[trial][first:last] - start, self.units[trial][first:last]] = 1
        return raster


def from_trials(
    trials: Iterable[TrialSpikes],
    sampling_rate_Hz: float,
    afferents: tuple[str, ...],
    conditions: pd.DataFrame,
    encoder: Mapping[str, Any] | None = None,
    source: str = "",
    touch_s: float | None = None,
    recorded_Hz: float | None = None,
    marks: pd.DataFrame | None = None,
) -> SpikeTrains:
    """Spike trains from an iterator of trials, in the order of the rows of `conditions`."""
    listed = list(trials)
    return SpikeTrains(
        steps=[trial.steps for trial in listed],
        units=[trial.units for trial in listed],
        trial_steps=np.array([trial.n_steps for trial in listed], np.int64),
        sampling_rate_Hz=sampling_rate_Hz,
        afferents=afferents,
        conditions=conditions.reset_index(drop=True),
        encoder=dict(encoder or {}),
        source=source,
        trial_digests=tuple(trial.digest for trial in listed) if all(trial.digest for trial in listed) else (),
        touch_s=touch_s,
        trial_touches=_touch_names(listed),
        recorded_Hz=recorded_Hz,
        marks=marks,
    )


def empty_raster(n_windows: int, n_steps: int, n_afferents: int) -> np.ndarray:
    """No spike in any window, `(window, time, afferent)` uint8; InputError if it is too large."""
    what = f"the raster of {n_windows} windows, {n_steps} steps and {n_afferents} afferents"
    check_size(what, n_windows * n_steps * n_afferents, room_bytes())
    return np.zeros((n_windows, n_steps, n_afferents), np.uint8)


def end_to_end(parts: Sequence[SpikeTrains]) -> SpikeTrains:
    """The trials of several spike trains of one encoder as those of one, without digests.

    >>> one = from_rasters(np.ones((2, 3, 1)), 1000.0, ("SA-I a",), pd.DataFrame({"label": ["felt", "silk"]}))
    >>> len(end_to_end([one, one.select([0])]))
    3
    """
    return replace(
        parts[0],
        steps=[steps for part in parts for steps in part.steps],
        units=[units for part in parts for units in part.units],
        trial_steps=np.concatenate([part.trial_steps for part in parts]),
        conditions=pd.concat([part.conditions for part in parts], ignore_index=True),
        trial_digests=(),
        trial_touches=(),
        variations=None,
    )


def _touch_names(trials: Sequence[TrialSpikes]) -> tuple[str, ...]:
    """`SpikeTrains.trial_touches` of some trials."""
    is_told = all(trial.digest for trial in trials) and any(trial.touch not in ("", trial.digest) for trial in trials)
    return tuple(trial.touch or trial.digest for trial in trials) if is_told else ()


def from_rasters(
    rasters: Sequence[np.ndarray] | np.ndarray,
    sampling_rate_Hz: float,
    afferents: tuple[str, ...],
    conditions: pd.DataFrame,
    encoder: Mapping[str, Any] | None = None,
    source: str = "",
    trial_digests: Sequence[str] = (),
) -> SpikeTrains:
    """Events from one `(time, afferent)` raster per trial."""
    digests = trial_digests or [""] * len(rasters)
    trials = (spikes_of(raster)._replace(digest=digest) for raster, digest in zip(rasters, digests, strict=True))
    return from_trials(trials, sampling_rate_Hz, afferents, conditions, encoder, source)


def spikes_of(raster: np.ndarray) -> TrialSpikes:
    """The spikes of one trial's raster, `(time, afferent)`.

    >>> spikes_of(np.array([[0, 1], [0, 0], [1, 0]])).steps.tolist()
    [0, 2]
    """
    # NumPy finds truth values in one dimension some ten times faster than bytes in two.
    steps, units = np.divmod(np.flatnonzero(raster != 0), raster.shape[1])
    return TrialSpikes(steps.astype(np.int64), units.astype(np.uint16), len(raster))


def _lengths(trial_steps: np.ndarray) -> np.ndarray:
    """Lengths of trials as int64; InputError if they are invalid."""
    lengths = np.asarray(trial_steps)
    if lengths.ndim != 1 or lengths.dtype.kind not in "iu":
        raise InputError(f"trial_steps: must be a whole number per trial; got {lengths.dtype} of shape {lengths.shape}")
    if len(lengths) and not (lengths.min() >= 0 and lengths.max() <= LONGEST_STEPS):
        wrong = lengths[(lengths < 0) | (lengths > LONGEST_STEPS)][0]
        raise InputError(f"trial_steps: must lie between 0 and 2^40 steps; got {wrong}")
    return lengths.astype(np.int64)


def _fits(steps: np.ndarray, units: np.ndarray, n_steps: int, n_afferents: int) -> bool:
    """Whether spikes are in order of time, within their trial and of known afferents."""
    if steps.ndim != 1 or steps.shape != units.shape:
        return False
    if len(steps) == 0:
        return True
    if steps.dtype.kind not in "iu" or units.dtype.kind not in "iu":
        return False
    in_order = bool((steps[1:] >= steps[:-1]).all())
    return in_order and steps[0] >= 0 and steps[-1] < n_steps and units.min() >= 0 and units.max() < n_afferents
