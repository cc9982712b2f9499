"""Copies: trials that hold the same touch, so that no split may part them.

Recordings are copies if their samples are equal. They are near copies if one lies within the other and they are equal
but for rounding, an offset of each taxel, the order of the taxels, or samples that another rate leaves out. Spike
trains are copies if their recordings are, or if so many spikes are equal that it is no chance. A trial that does not
change, or has hardly a spike, is a copy of nothing: rest looks alike each time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from neurotact.data import conditioning
from neurotact.data.conditioning import pieces
from neurotact.data.digests import again, spike_digests
from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains, TrialSpikes
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


FILE = "file"
"""The condition that names the file of a trial."""
LEAST_CHANGES = 4
"""Values that differ from the sample before, or spikes: a trial with fewer may equal another by chance."""
LEAST_IRREGULAR = 32
"""Intervals between spikes that differ from the one before, from which on equal spikes are no chance although the
recordings differ: a saturated afferent has none."""
SEARCHED = 0.1
"""The start of a trial that is searched for near copies, as a share of the values that are in memory at once."""
PRINT_STEPS = 7
"""Changes of the signal in a print, each over one lag."""
PRINTS = 16
"""Prints of a trial: those with the smallest hashes, so that a copy chooses the same."""
MOST_ALIKE = 4
"""Trials with one print that are compared with a later one."""
LEVELS = 32
"""Levels of a print per typical change of the signal."""
NEAR = 0.02
"""Largest difference of near copies, as a share of the typical change of the signal."""


class Copies(NamedTuple):
    """Which trials hold the same touch.

    first: the first trial with the same touch, `(trial,)` int64; the trial itself if it is no copy.
    equal: the first trial that is equal sample by sample (of spikes: whose recording is the same).
    """

    first: np.ndarray
    equal: np.ndarray

    @property
    def is_near(self) -> np.ndarray:
        """Whether each trial is a near copy of its `first`, `(trial,)` boolean."""
        return self.first != self.equal

    @property
    def trials(self) -> np.ndarray:
        """The trials that copy another one, ascending."""
        return np.flatnonzero(self.first != np.arange(len(self.first)))

    def distinct(self, trials: np.ndarray) -> np.ndarray:
        """One of the given trials for each touch among them, ascending.

        >>> Copies(np.array([0, 0, 2, 0]), np.array([0, 0, 2, 0])).distinct(np.array([1, 2, 3])).tolist()
        [1, 2]
        """
        return np.sort(trials[np.unique(self.first[trials], return_index=True)[1]])


_known: WeakKeyDictionary[SpikeTrains, Copies] = WeakKeyDictionary()


def copies_of(touches: Trials | SpikeTrains) -> Copies:
    """The copies among recordings or spike trains; names and classes play no part.

    Of recordings the start of every trial is read, and all of those that look alike.

    >>> import pandas as pd
    >>> from neurotact.data.recordings import Recordings
    >>> walks = np.random.default_rng(0).standard_normal((3, 200, 4)).cumsum(axis=1)
    >>> signals = [walks[0], walks[1], walks[0], walks[1][5:].round(4), walks[2]]
    >>> found = copies_of(Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": list("abaab")})))
    >>> found.first.tolist(), found.is_near.tolist()
    ([0, 1, 0, 1, 4], [False, False, False, True, False])
    """
    if not isinstance(touches, SpikeTrains):
        return _of_recordings(touches)
    if (known := _known.get(touches)) is None:  # a study's cell asks five times
        known = _known[touches] = _of_spikes(touches)
    return known


def with_touches(trials: Iterable[TrialSpikes], first: np.ndarray) -> Iterator[TrialSpikes]:
    """The encoded trials of recordings, one after the other, with the name of the touch of each.

    first: of the copies among the recordings. Copies have the name of their first, its digest. Recordings that do not
    change are no copies, though their digests may be equal: the number of the trial is part of their names.
    """
    names: list[str] = []
    digests: set[str] = set()
    for trial, copied in zip(trials, first.tolist(), strict=True):
        own = again(trial.digest, len(names)) if trial.digest in digests else trial.digest
        digests.add(trial.digest)
        names.append(own if copied == len(names) else names[copied])
        yield trial._replace(touch=names[-1])


def equal_examples(examples: np.ndarray, labels: np.ndarray | None = None) -> np.ndarray:
    """The first example with equal values, and with the same label if they are given, `(example,)` int64.

    examples: `(example, ...)`. One with fewer than `LEAST_CHANGES` values that are not zero equals none.

    >>> equal_examples(np.array([[1, 2, 3, 4], [0, 0, 0, 1], [1, 2, 3, 4], [0, 0, 0, 1]])).tolist()
    [0, 1, 0, 3]
    """
    flat = np.ascontiguousarray(examples).reshape(len(examples), -1)
    counted = np.count_nonzero(flat, axis=1)
    classes = [None] * len(flat) if labels is None else labels.tolist()
    first, seen = np.arange(len(flat)), {}
    for example in np.flatnonzero(counted >= LEAST_CHANGES).tolist():
        digest = hashlib.blake2b(flat[example].data, digest_size=16).digest()
        first[example] = seen.setdefault((digest, classes[example]), example)
    return first


def name_of(conditions: pd.DataFrame, trial: int) -> str:
    """The file of a trial, or its number.

    >>> name_of(pd.DataFrame({"file": ["felt/1.csv"]}), 0), name_of(pd.DataFrame({"label": ["felt"]}), 0)
    ('felt/1.csv', 'trial 0')
    """
    return str(conditions[FILE].iloc[trial]) if FILE in conditions else f"trial {trial}"


def joined(*groupings: np.ndarray) -> np.ndarray:
    """The first trial that each trial is linked to by trials of one group, `(trial,)` int64.

    groupings: arrays of names or numbers, `(trial,)` each.

    >>> joined(np.array([0, 1, 1, 3]), np.array(["ann", "ann", "bob", "cem"])).tolist()
    [0, 0, 0, 3]
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_trials = n_nodes = len(groupings[0])
    links = []
    for grouping in groupings:
        names, group = np.unique(grouping, return_inverse=True)
        links.append(n_nodes + group.ravel())
        n_nodes += len(names)
    trials = np.tile(np.arange(n_trials), len(groupings))
    graph = coo_array((np.ones(len(trials)), (trials, np.concatenate(links))), (n_nodes, n_nodes))
    part = connected_components(graph, directed=False)[1][:n_trials]
    _, first, of_part = np.unique(part, return_index=True, return_inverse=True)
    return first[of_part]


# --- spikes -------------------------------------------------------------------------------------------


def _of_spikes(trains: SpikeTrains) -> Copies:
    n_trials, is_recorded = len(trains), bool(trains.trial_digests)
    touches = np.array(trains.trial_touches or trains.trial_digests)
    recorded = joined(touches) if is_recorded else np.arange(n_trials)
    counts = np.array([len(steps) for steps in trains.steps])
    sizes = np.stack([trains.trial_steps, counts], axis=1)
    _, size, n_alike = np.unique(sizes, axis=0, return_inverse=True, return_counts=True)
    alike = np.flatnonzero((n_alike[size.ravel()] > 1) & (counts >= LEAST_CHANGES))
    equal = np.arange(n_trials).astype(object)
    if len(alike):
        equal[alike] = spike_digests(trains.select(alike))
    names, n_equal = np.unique(equal[alike].astype(str), return_counts=True)
    repeated = alike[np.isin(equal[alike].astype(str), names[n_equal > 1])]
    chance = repeated[~are_telling(trains, repeated)]
    equal[chance] = chance
    first = joined(recorded, equal.astype(str))
    if not is_recorded:
        return Copies(first, first)
    _, of_digest = np.unique(trains.trial_digests, return_inverse=True)
    return Copies(first, joined(np.array([f"{touch} {n}" for touch, n in zip(touches, of_digest, strict=True)])))


def are_telling(trains: SpikeTrains, trials: np.ndarray) -> np.ndarray:
    """Whether the spikes of some trials are so many and so irregular that equal ones are no chance, `(trial,)` boolean.

    Different recordings may give the same spikes, above all from saturated afferents: these need more.
    """
    is_recorded = bool(trains.trial_digests)
    least = LEAST_IRREGULAR if is_recorded else LEAST_CHANGES
    events = ((np.asarray(trains.steps[trial], np.int64), np.asarray(trains.units[trial])) for trial in trials.tolist())
    return np.array([_n_irregular(*e) + (0 if is_recorded else _n_begins(*e)) >= least for e in events], bool)


def _n_irregular(steps: np.ndarray, units: np.ndarray) -> int:
    """The number of intervals between spikes of an afferent that differ from its interval before.

    >>> _n_irregular(np.array([1, 2, 4, 7, 9]), np.array([0, 1, 0, 0, 1]))
    0
    >>> _n_irregular(np.array([1, 4, 6]), np.array([0, 0, 0]))
    1
    """
    order = np.argsort(units, kind="stable")
    unit, intervals = units[order], np.diff(steps[order])
    return int(((unit[2:] == unit[:-2]) & (intervals[1:] != intervals[:-1])).sum())


def _n_begins(steps: np.ndarray, units: np.ndarray) -> int:
    """The number of different times and of different intervals with which the afferents begin.

    >>> _n_begins(np.array([1, 1, 4, 4, 7, 7]), np.array([0, 1, 0, 1, 0, 1])), _n_begins(np.arange(4), np.arange(4))
    (2, 4)
    """
    order = np.argsort(units, kind="stable")
    unit, step = units[order], steps[order]
    first = np.flatnonzero(np.diff(unit, prepend=-1))
    second = first[np.append(unit[1:], -1)[first] == unit[first]] + 1
    return len(np.unique(step[first])) + len(np.unique(step[second] - step[second - 1]))


# --- recordings ---------------------------------------------------------------------------------------


class _Search(NamedTuple):
    """How near copies are found.

    lengths: samples of each trial. n_rows: samples of its start that are searched. lag: samples between compared ones.
    change, sum_change: the typical change over a lag, of a taxel and of the sum of all.
    """

    lengths: np.ndarray
    n_rows: int
    lag: int
    change: float
    sum_change: float


def _of_recordings(recordings: Trials) -> Copies:
    lengths = recordings.lengths
    equal = _equal(recordings, lengths)
    trials = np.unique(equal)
    search = _search_of(recordings, lengths, trials)
    if search is None:
        return Copies(equal, equal)
    first = equal.copy()
    known: dict[int, list[tuple[int, int]]] = {}
    for trial in trials.tolist():
        for print_, row in _prints(recordings.piece(trial, 0, search.n_rows), search):
            others = known.setdefault(print_, [])
            for other, other_row in others:
                if first[other] != first[trial] and _is_near(recordings, (trial, row), (other, other_row), search):
                    low, high = sorted((first[other], first[trial]))
                    first[first == high] = low
            if len(others) < MOST_ALIKE:
                others.append((trial, row))
    return Copies(first, equal)


def _equal(recordings: Trials, lengths: np.ndarray) -> np.ndarray:
    """The first trial with equal samples, `(trial,)`."""
    n_rows = _n_searched(recordings)
    first = np.arange(len(recordings))
    known: dict[tuple[int, bytes], list[int]] = {}
    for trial, length in enumerate(lengths.tolist()):
        start = np.ascontiguousarray(recordings.piece(trial, 0, n_rows))
        others = known.setdefault((length, hashlib.blake2b(start.data, digest_size=16).digest()), [])
        copied = next((other for other in others if length <= n_rows or _same(recordings, trial, other)), None)
        if copied is None:
            others.append(trial)
        elif not _is_bare(recordings, trial):
            first[trial] = copied
    return first


def _n_searched(recordings: Trials) -> int:
    return max(1, int(SEARCHED * conditioning.PIECE_VALUES) // recordings.n_channels)


def _same(recordings: Trials, trial: int, other: int) -> bool:
    both = zip(pieces(recordings, trial), pieces(recordings, other), strict=True)
    return all(np.array_equal(one, two) for one, two in both)


def _is_bare(recordings: Trials, trial: int) -> bool:
    """Whether fewer than `LEAST_CHANGES` values of a trial differ from the sample before."""
    n_changes, before = 0, None
    for piece in pieces(recordings, trial):
        rows = piece if before is None else np.concatenate([before, piece])
        n_changes += np.count_nonzero(rows[1:] != rows[:-1])
        if n_changes >= LEAST_CHANGES:
            return False
        before = piece[-1:]
    return True


def _search_of(recordings: Trials, lengths: np.ndarray, trials: np.ndarray) -> _Search | None:
    """The search for near copies among some trials; None if the signals do not change.

    The lag has many divisors, so that a copy at half or a third of the rate has the compared samples, too.
    """
    n_rows = _n_searched(recordings)
    lag = max(1, min(int(np.median(lengths)), n_rows) // 20)
    lag = lag - lag % 12 if lag >= 12 else max(fine for fine in (1, 2, 4, 6) if fine <= lag)
    spreads = []
    for trial in trials.tolist():
        changes = np.diff(recordings.piece(trial, 0, n_rows)[::lag].astype(np.float64), axis=0)
        if len(changes):
            spreads.append((np.sqrt(np.mean(changes**2)), np.sqrt(np.mean(changes.sum(axis=1) ** 2))))
    change, sum_change = np.median(spreads, axis=0).tolist() if spreads else (0.0, 0.0)
    return _Search(lengths, n_rows, lag, change, sum_change) if sum_change > 0 else None


def _prints(rows: np.ndarray, search: _Search) -> Iterator[tuple[int, int]]:
    """Some prints of the start of a trial, `(time, taxel)`, each with its row.

    A print is a hash of successive changes of the sum of all taxels, in levels: offsets and the order of the taxels
    play no part. Stretches at rest have none.
    """
    lag, n = search.lag, len(rows) - PRINT_STEPS * search.lag
    if n < 1:
        return
    total = rows.sum(axis=1, dtype=np.float64)
    levels = np.clip(np.rint((total[lag:] - total[:-lag]) * (LEVELS / search.sum_change)), -(2.0**40), 2.0**40)
    hashes = levels.astype(np.int64).view(np.uint64)
    prints, n_moved = np.zeros(n, np.uint64), np.zeros(n, np.int64)
    for start in range(0, PRINT_STEPS * lag, lag):
        prints = prints * np.uint64(0x9E3779B97F4A7C15) + hashes[start : start + n]
        n_moved += levels[start : start + n] != 0
    places = np.flatnonzero(n_moved >= LEAST_CHANGES)
    prints = mixed(prints[places])
    smallest = np.argpartition(prints, PRINTS)[:PRINTS] if len(prints) > PRINTS else np.arange(len(prints))
    yield from zip(prints[smallest].tolist(), places[smallest].tolist(), strict=True)


def mixed(values: np.ndarray) -> np.ndarray:
    """A hash of each uint64 (the finaliser of MurmurHash3)."""
    values = (values ^ (values >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    values = (values ^ (values >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return values ^ (values >> np.uint64(33))


def _is_near(recordings: Trials, one: tuple[int, int], two: tuple[int, int], search: _Search) -> bool:
    """Whether one of two trials lies within the other; the given rows of both are the same moment.

    Every `search.lag`-th sample is compared, and at least half of the longer trial.
    """
    (trial, row), (other, other_row) = one, two
    length, other_length = (int(search.lengths[t]) for t in (trial, other))
    begin, end = max(0, row - other_row), min(length, other_length + row - other_row)
    if end - begin < min(length, other_length) or 2 * (end - begin) < max(length, other_length):
        return False
    begin += (row - begin) % search.lag
    n_rows = search.lag * -(-search.n_rows // search.lag)
    orders = origins = None
    for start in range(begin, end, n_rows):
        stop = min(start + n_rows, end)
        here = recordings.piece(trial, start, stop)[:: search.lag].astype(np.float64)
        shift = other_row - row
        there = recordings.piece(other, start + shift, stop + shift)[:: search.lag].astype(np.float64)
        if orders is None or origins is None:
            origins = here[0], there[0]
            orders = _orders(here - origins[0], there - origins[1], search)
        apart = (here - origins[0])[:, orders[0]] - (there - origins[1])[:, orders[1]]
        if np.abs(apart).max() > NEAR * search.change:
            return False
    return True


def _orders(here: np.ndarray, there: np.ndarray, search: _Search) -> tuple[np.ndarray, np.ndarray]:
    """The order of the taxels of both stretches in which they can be compared: as they are, or by a fixed sum."""
    as_they_are = np.arange(here.shape[1])
    if np.abs(here - there).max() <= NEAR * search.change:
        return as_they_are, as_they_are
    weights = np.random.default_rng(0).standard_normal(len(here))
    return np.argsort(weights @ here), np.argsort(weights @ there)
