"""What is doubtful about the trials of a file: copies of one touch, and classes that may be one. One line each."""

import logging
from collections.abc import Iterator
from itertools import chain

import numpy as np
import pandas as pd

from neurotact.data.copies import Copies, copies_of, name_of
from neurotact.data.recordings import LABEL, Recordings, Trials, class_names
from neurotact.data.spikes import SpikeTrains
from neurotact.data.stretches import shared_stretches
from neurotact.errors import InputError, some

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
