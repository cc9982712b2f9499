"""Trials that share a stretch of samples or spikes, as overlapping windows of one recording do, at any shift.

Such trials are no copies, so each counts, but a split that parts them tests on what it trained on. A stretch is found
by content: of all windows of a few changes, those with certain hashes are compared, which are the same ones wherever
the stretch lies. Each sample is hashed once.
"""

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from neurotact.data.conditioning import pieces
from neurotact.data.copies import mixed
from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains

WINDOW = 6
"""Changes in a row that are hashed together."""
ANCHORS = 64
"""Windows of a trial that are compared, about."""
LEAST_SHARE = 0.05
"""Share of the changes of the shorter trial below which a stretch is none."""
LEAST_BITS = 48
"""Irregular changes of one taxel that are no chance; of several taxels a quarter suffices at best."""
MOST_ALIKE = 4
"""Trials that are remembered for a hash, and stretches of a trial that are looked at."""
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


class Stretch(NamedTuple):
    """A stretch that `trial` shares with the earlier trial `other`.

    n: its samples, or spikes. later: how much later it lies in `trial`, in samples or steps.
    """

    trial: int
    other: int
    n: int
    later: int


class _Changes(NamedTuple):
    """What changes in a trial: a hash of each change and when it is, `(change,)`, and whether it differs from the one
    before. n_places: taxels or afferents.
    """

    hashes: np.ndarray
    at: np.ndarray
    is_irregular: np.ndarray
    n_places: int


def shared_stretches(touches: Trials | SpikeTrains, first: np.ndarray) -> list[Stretch]:
    """One stretch of each trial that shares any with an earlier one, in the order of trials.

    first: of `copies_of`, the trials that are not compared. Every sample is read, in pieces.

    >>> import pandas as pd
    >>> from neurotact.data.recordings import Recordings
    >>> walk = np.random.default_rng(0).standard_normal((400, 4)).cumsum(axis=0)
    >>> windows = [walk[:200], walk[150:350], walk[380:]]
    >>> shared_stretches(Recordings(windows, 1000.0, "mV", pd.DataFrame({"label": list("aba")})), np.arange(3))
    [Stretch(trial=1, other=0, n=49, later=-150)]
    """
    every = max(1, int(np.median(_lengths(touches))) // ANCHORS)
    known: dict[int, list[tuple[int, int]]] = {}
    found = []
    for trial in range(len(touches)):
        changes = _changes(touches, trial)
        places: dict[tuple[int, int], int] = {}
        votes: Counter[tuple[int, int]] = Counter()
        for print_, place in _anchors(changes, every):
            others = known.setdefault(print_, [])
            for other, other_place in others:
                if first[other] != first[trial]:
                    votes[other, place - other_place] += 1
                    places[other, place - other_place] = place
            if len(others) < MOST_ALIKE and all(other != trial for other, _ in others):
                others.append((trial, place))
        shared = []
        for key, _ in votes.most_common(MOST_ALIKE):
            other, place = key[0], places[key]
            stretch = _stretch(changes, place, _changes(touches, other), place - key[1])
            shared += [Stretch(trial, other, *stretch)] if stretch is not None else []
        found += [max(shared, key=lambda each: each.n)] if shared else []
    return found


def _lengths(touches: Trials | SpikeTrains) -> list[int]:
    return [len(steps) for steps in touches.steps] if isinstance(touches, SpikeTrains) else touches.lengths.tolist()


def _changes(touches: Trials | SpikeTrains, trial: int) -> _Changes:
    if isinstance(touches, SpikeTrains):
        return _of_spikes(np.asarray(touches.steps[trial], np.int64), np.asarray(touches.units[trial], np.int64))
    return _of_samples(touches, trial)


def _of_samples(recordings: Trials, trial: int) -> _Changes:
    """The changes of a trial: each is hashed with the sample that it leads to, and the time since the one before."""
    weights = mixed(np.arange(1, recordings.n_channels + 1, dtype=np.uint64)) | np.uint64(1)
    hashes, steps, before = [], [], None
    for piece in pieces(recordings, trial):
        rows = np.ascontiguousarray(piece, np.float32) + np.float32(0)  # one zero for both signs
        hashes.append(_hashed(rows.view(np.uint32), weights))
        differences = np.diff(rows if before is None else np.concatenate([before, rows]), axis=0)
        steps.append(_hashed((differences + np.float32(0)).view(np.uint32), weights))
        before = rows[-1:]
    samples, step = np.concatenate(hashes), np.concatenate(steps)
    at = np.flatnonzero(samples[1:] != samples[:-1]) + 1
    its = step[at - 1]
    is_irregular = np.concatenate([[True], its[1:] != its[:-1]])[: len(at)]
    since = np.diff(at, prepend=at[:1] - 1).astype(np.uint64)
    return _Changes(mixed(samples[at]) + since * MULTIPLIER, at, is_irregular, recordings.n_channels)


def _hashed(bits: np.ndarray, weights: np.ndarray) -> np.ndarray:
    total = np.zeros(len(bits), np.uint64)
    for taxel, weight in enumerate(weights):
        total += mixed(bits[:, taxel].astype(np.uint64) + weight) * weight
    return total


def _of_spikes(steps: np.ndarray, units: np.ndarray) -> _Changes:
    """The intervals of successive spikes, each hashed with the two afferents; irregular as intervals of an afferent."""
    order = np.lexsort((units, steps))
    steps, units = steps[order], units[order]
    both = np.stack([np.diff(steps), units[:-1], units[1:]], axis=1).astype(np.uint64)
    hashes = _hashed(both, mixed(np.arange(1, 4, dtype=np.uint64)) | np.uint64(1))
    own = np.argsort(units, kind="stable")
    intervals = np.diff(steps[own], prepend=-1)
    is_irregular = np.zeros(len(steps), bool)
    is_irregular[own[2:]] = (units[own[2:]] == units[own[:-2]]) & (intervals[2:] != intervals[1:-1])
    return _Changes(hashes, steps[1:], is_irregular[1:], len(np.unique(units)))


def _anchors(changes: _Changes, every: int) -> Iterator[tuple[int, int]]:
    """The hashes of some windows, about one of `every`, chosen by their hashes, and their places."""
    n = len(changes.hashes) - WINDOW + 1
    if n < 1:
        return
    prints = np.zeros(n, np.uint64)
    for start in range(WINDOW):
        its = changes.hashes[start : start + n]
        prints = prints * MULTIPLIER + (its if start else np.zeros(n, np.uint64))  # the first depends on what is before
    prints = mixed(prints)
    places = np.flatnonzero(prints % np.uint64(every) == 0)
    yield from zip(prints[places].tolist(), places.tolist(), strict=True)


def _stretch(here: _Changes, place: int, there: _Changes, other_place: int) -> tuple[int, int] | None:
    """The samples of the stretch about two windows, and how much later it is here; None if it is short or regular."""
    begin = min(place, other_place)
    end = min(len(here.hashes) - place, len(there.hashes) - other_place)
    own, other = (its.hashes[at - begin : at + end] for its, at in ((here, place), (there, other_place)))
    differs = np.flatnonzero(own != other)
    inside = differs[differs <= begin]
    first = int(inside[-1]) if len(inside) else 0
    after = differs[differs > begin]
    last = int(after[0]) if len(after) else len(own)
    n_irregular = int(here.is_irregular[place - begin + first + 1 : place - begin + last].sum())
    least = LEAST_BITS / min(max(here.n_places, 1), 4)
    if n_irregular < least or last - first < LEAST_SHARE * min(len(here.hashes), len(there.hashes)):
        return None
    start, stop = int(here.at[place - begin + first]), int(here.at[place - begin + last - 1])
    return stop - start + 1, start - int(there.at[other_place - begin + first])
