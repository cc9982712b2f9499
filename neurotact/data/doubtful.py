"""What is doubtful about the trials of a file, a line each: copies, shared stretches, and classes that may be one.

Trials that share a stretch of samples or spikes, as overlapping windows of one recording do at any shift, are no
copies, so each counts, but a split that parts them tests on what it trained on. A stretch is found by content: of all
windows of a few changes, those with certain hashes are compared, which are the same ones wherever the stretch lies.
Each sample is hashed once.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from neurotact.data.conditioning import pieces
from neurotact.data.copies import Copies, copies_of, mixed, name_of
from neurotact.data.recordings import LABEL, Recordings, Trials, class_names
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError, some
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


NAMED = 3
"""Copies that a line names; the others are counted."""

NEARLY = " (with another rounding, rate, length, offset or order of taxels)"
TOGETHER = "a split keeps copies together and counts them once"

log = logging.getLogger("neurotact")


def check(touches: Recordings | SpikeTrains, source: str) -> None:
    """Warn of everything doubtful about trials that are to be saved; InputError for copies with two classes.

    Classes that all hold the same trials are no mistake in some of them: that is said, and the import goes on.
    source: begins the lines.
    """
    repeats = copies_of(touches)
    alike = list(_of_equal_classes(touches.conditions, repeats))
    if not alike and (refused := next(_of_other_class(touches.conditions, repeats), None)):
        raise InputError(f"{source}: {refused}")
    others = (of_copies(touches.conditions, repeats), _of_stretches(touches, repeats))
    for line in (*alike, *chain(*others), *of_classes(class_names(touches.conditions))):
        log.warning("%s: %s", source, line)


def warn(touches: Recordings | SpikeTrains) -> None:
    """Warn of everything doubtful about the data of a protocol that has its own split."""
    for line in lines(touches, "the split of this protocol may part them"):
        log.warning("%s: %s", touches.source or "data", line)


def lines(touches: Trials | SpikeTrains, fate: str = TOGETHER) -> list[str]:
    """Everything doubtful about recordings or spike trains; fate: what becomes of copies."""
    conditions, repeats = touches.conditions, copies_of(touches)
    classes = of_classes(class_names(conditions))
    return [*_of_other_class(conditions, repeats), *of_copies(conditions, repeats, fate), *classes]


def of_copies(conditions: pd.DataFrame, repeats: Copies, fate: str = TOGETHER) -> Iterator[str]:
    """The number of copies, with some names.

    >>> table = pd.DataFrame({"label": list("aaab"), "file": ["1.csv", "2.csv", "1_copy.csv", "3.csv"]})
    >>> print(*of_copies(table, Copies(np.array([0, 1, 0, 3]), np.array([0, 1, 0, 3]))))
    1 of 4 trials is a copy of another one: 1_copy.csv of 1.csv; a split keeps copies together and counts them once
    """
    kinds = (
        ("is a copy of another one", "are copies of others"),
        (f"is a near copy of another one{NEARLY}", f"are near copies of others{NEARLY}"),
    )
    for is_near, (one, many) in enumerate(kinds):
        copies = [trial for trial in repeats.trials.tolist() if repeats.is_near[trial] == is_near]
        if copies:
            names = some([_named(conditions, trial, int(repeats.first[trial])) for trial in copies], NAMED)
            yield f"{len(copies)} of {len(conditions)} trials {one if len(copies) == 1 else many}: {names}; {fate}"


def _of_stretches(touches: Recordings | SpikeTrains, repeats: Copies) -> Iterator[str]:
    """The number of trials that share a stretch of samples or spikes with another one, with some names."""
    shared = shared_stretches(touches, repeats.first)
    if not shared:
        return
    of, clock = ("spikes", "steps") if isinstance(touches, SpikeTrains) else ("samples", "samples")
    named = [
        f"{name_of(touches.conditions, each.trial)} with {name_of(touches.conditions, each.other)} ({each.n} {of}, "
        f"{abs(each.later)} {clock} {'later' if each.later > 0 else 'earlier'})" for each in shared
    ]  # fmt: skip
    one = "1 of {} trials shares" if len(shared) == 1 else f"{len(shared)} of {{}} trials share"
    yield (
        f"{one.format(len(touches))} a stretch of {of} with another one: {some(named, NAMED)}; a split parts them and "
        "tests on what it trained on, unless a condition names the recording and `group` keeps its trials together"
    )


def _named(conditions: pd.DataFrame, copy: int, copied: int) -> str:
    label, other = (str(conditions[LABEL].iloc[trial]) for trial in (copy, copied))
    classes = "" if label == other else f" (class '{label}', not '{other}')"
    return f"{name_of(conditions, copy)} of {name_of(conditions, copied)}{classes}"


def of_classes(classes: tuple[str, ...]) -> Iterator[str]:
    """Classes whose names differ only in case or blanks.

    >>> list(of_classes(("Wood", "WOOD", "felt", "wood ")))
    ["the classes 'Wood', 'WOOD', 'wood ' differ only in case or blanks; if they are one class, give it one name"]
    """
    alike: dict[str, list[str]] = {}
    for name in classes:
        alike.setdefault("".join(name.split()).casefold(), []).append(name)
    for names in alike.values():
        if len(names) > 1:
            yield (
                f"the classes {some([f'{name!r}' for name in names])} differ only in case or blanks; if they are one "
                "class, give it one name"
            )


def _of_equal_classes(conditions: pd.DataFrame, repeats: Copies) -> Iterator[str]:
    """A line if every class holds the same touches, sample by sample."""
    labels = conditions[LABEL].astype(str).to_numpy(dtype=str)
    held = {label: frozenset(repeats.equal[labels == label].tolist()) for label in np.unique(labels).tolist()}
    if len(held) > 1 and len(set(held.values())) == 1:
        yield (
            f"every class ({some([f'{label!r}' for label in held])}) holds the same trials, so that nothing tells the "
            "classes apart; give each touch one class"
        )


def _of_other_class(conditions: pd.DataFrame, repeats: Copies) -> Iterator[str]:
    """The copies, near copies left out, with another class than the first, in one line."""
    labels = conditions[LABEL].astype(str).to_numpy(dtype=str)
    copies = np.flatnonzero(labels != labels[repeats.equal])
    if len(copies):
        both = int(copies[0]), int(repeats.equal[copies[0]])
        named = (f"{name_of(conditions, trial)} of class '{labels[trial]}'" for trial in both)
        more = f" ({len(copies)} such trials)" if len(copies) > 1 else ""
        yield f"{' is a copy of '.join(named)}{more}; keep the one with the right class and remove the other"


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
