"""Trials in which every unit was observed: a unit that was not recorded would read as silent."""

import logging
from collections.abc import Sequence
from typing import Literal

import numpy as np

from neurotact.errors import InputError, some

log = logging.getLogger("neurotact")

Unobserved = Literal["leave-out", "silent"]
"""What becomes of trials that are not observed whole: left out, however many they are, or read as silent."""
MOST_UNOBSERVED = 0.1
"""Share of the trials that may be left out without being asked."""
FEW = 0.5
"""Share of the trials below which a unit observes few."""


def within(start_s: np.ndarray, stop_s: np.ndarray, intervals_s: np.ndarray, slack_s: float) -> np.ndarray:
    """Which trials lie whole within intervals, `(trial,)`; those that follow one another without a gap are one.

    intervals_s: `(interval, 2)`, in any order. slack_s: what may be missing, as of rounded times.

    >>> trials = np.array([0.0, 1.5, 3.0]), np.array([1.0, 2.5, 4.0])
    >>> within(*trials, np.array([[2.0, 3.5], [0.0, 2.0]]), 1e-3).tolist()
    [True, True, False]
    """
    spans = _joined(intervals_s, slack_s)
    span = np.searchsorted(spans[:, 0], start_s + slack_s, "right") - 1
    return (span >= 0) & (spans[span.clip(0), 1] >= stop_s - slack_s) if len(spans) else np.zeros(len(start_s), bool)


def touching(start_s: np.ndarray, stop_s: np.ndarray, intervals_s: np.ndarray, slack_s: float) -> np.ndarray:
    """Which trials share more than `slack_s` with one of the intervals, `(trial,)`.

    >>> touching(np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.array([[1.5, 1.6], [1.7, 9.0]]), 1e-3).tolist()
    [False, True]
    """
    spans = _joined(intervals_s, slack_s)
    if not len(spans):
        return np.zeros(len(start_s), bool)
    after = np.searchsorted(spans[:, 1], start_s + slack_s, "right")  # the first span that ends within a trial or later
    return (after < len(spans)) & (spans[after.clip(max=len(spans) - 1), 0] < stop_s - slack_s)


def _joined(intervals_s: np.ndarray, slack_s: float) -> np.ndarray:
    """The intervals in order, `(span, 2)`: those that overlap or follow one another are one, empty ones none."""
    spans: list[list[float]] = []
    for start_s, stop_s in sorted(intervals_s[intervals_s[:, 0] < intervals_s[:, 1]].tolist()):
        if spans and start_s <= spans[-1][1] + slack_s:
            spans[-1][1] = max(spans[-1][1], stop_s)
        else:
            spans.append([start_s, stop_s])
    return np.array(spans).reshape(-1, 2)


def observed_trials(
    observed: np.ndarray, names: Sequence[str], policy: Unobserved | None, where: str, *, fix: str,
    invalid: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Which trials are kept, `(trial,)`: those that every unit observes whole, without invalid times, with a line.

    observed: `(unit, trial)`. names: of the units. invalid: trials that touch invalid times, `(trial,)`.
    policy: leave out any number of trials, or read them as silent; when None, at most `MOST_UNOBSERVED` of them are
    left out. where: begins messages. fix: how units are left out, in words, with the place of a name.

    Raises InputError if more trials would be left out, and if none is left.
    """
    n_trials = observed.shape[1]
    invalid = np.zeros(n_trials, bool) if invalid is None else invalid
    partial = ~observed.all(axis=0)
    lost = partial | invalid
    if not lost.any():
        return ~lost
    causes = [f"{partial.sum()} are not observed whole by {_fewest(observed, names)}"] if partial.any() else []
    causes += [f"{invalid.sum()} touch invalid times"] if invalid.any() else []
    which, why = f"{where}: {lost.sum()} of {n_trials} trials", ", and ".join(causes)
    if policy == "silent":
        log.warning("%s are kept, and read as silent what was not observed: %s", which, why)
        return np.ones(n_trials, bool)
    if lost.all() or (lost.mean() > MOST_UNOBSERVED and policy is None):
        fixes = [fix.format(names[int(observed.sum(axis=1).argmin())])] if partial.any() else []
        fixes += [] if lost.all() else ["leave these trials out with `unobserved='leave-out'`"]
        fixes += ["read what was not observed as silent with `unobserved='silent'`"]
        raise InputError(
            f"{which} would be left out, more than {100 * MOST_UNOBSERVED:g} %: {why}; {', or '.join(fixes)}"
        )
    log.warning("%s are left out: %s", which, why)
    return ~lost


def _fewest(observed: np.ndarray, names: Sequence[str]) -> str:
    """The units that do not observe every trial, those that observe the fewest first, with their numbers of trials."""
    counts, n_trials = observed.sum(axis=1), observed.shape[1]
    order = [unit for unit in np.argsort(counts, kind="stable").tolist() if counts[unit] < n_trials]
    named = some([f"{names[unit]} (observes {counts[unit]} of {n_trials})" for unit in order])
    n_few = int((counts < FEW * n_trials).sum())
    return f"{named}, of which {n_few} observe fewer than half" if n_few else named
