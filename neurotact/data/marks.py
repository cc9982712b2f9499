"""Annotations in time, the marks of long recordings: which label is in force from when to when, in which trial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from neurotact.errors import InputError
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


KINDS = {"trial": np.int64, "start_s": np.float64, "stop_s": np.float64, "label": str}
COLUMNS = [*KINDS]
NONE = "none"
"""The label of time without a mark."""


def checked(marks: Any, durations_s: np.ndarray, where: str) -> pd.DataFrame | None:
    """Marks in the order of trials and times; None stays None.

    marks: a table, or a mapping of its `COLUMNS`. durations_s: of the trials, `(trial,)`. InputError for a mark outside
    of its trial, and for two that overlap.

    >>> checked({"trial": [0], "start_s": [1], "stop_s": [1.5], "label": ["slip"]}, np.array([2.0]), "").values.tolist()
    [[0, 1.0, 1.5, 'slip']]
    """
    if marks is None:
        return None
    try:
        table = pd.DataFrame(marks if isinstance(marks, pd.DataFrame) else dict(marks))[COLUMNS].astype(KINDS)
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{where}: marks need the columns {', '.join(COLUMNS)} ({error})") from error
    table = table.sort_values(COLUMNS[:2], ignore_index=True)
    trial, start, stop = (table[name].to_numpy() for name in COLUMNS[:3])
    lasts = durations_s[np.clip(trial, 0, len(durations_s) - 1)]
    overlaps = np.append((trial[1:] == trial[:-1]) & (start[1:] < stop[:-1] - 1e-9), False)
    for wrong, why in (
        ((trial < 0) | (trial >= len(durations_s)), f"is of a trial that is none of the {len(durations_s)}"),
        (~((start >= 0) & (start < stop) & (stop <= lasts * (1 + 1e-9))), "does not lie within its trial"),
        (overlaps[: len(table)], "overlaps the next one; cut them so that one label is in force at a time"),
        (table["label"].isin(["", NONE]).to_numpy(), f"has no label of its own; leave it out: unmarked is '{NONE}'"),
    ):
        if wrong.any():
            row = table.iloc[int(wrong.argmax())]
            span = f"from {row.start_s:g} to {row.stop_s:g} s of trial {row.trial} ('{row.label}')"
            raise InputError(f"{where}: the mark {span} {why}")
    return table


def selected(marks: pd.DataFrame | None, trials: Sequence[int] | np.ndarray) -> pd.DataFrame | None:
    """The marks of some trials, which are then counted as in `trials`."""
    if marks is None:
        return None
    parts = [marks[marks["trial"] == old].assign(trial=new) for new, old in enumerate(trials)]
    return pd.concat([marks[:0], *parts], ignore_index=True)


def labels_at(marks: pd.DataFrame, trial: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """The label in force at times of trials, `(time,)` text.

    >>> marks = pd.DataFrame({"trial": [0], "start_s": [1.0], "stop_s": [2.0], "label": ["slip"]})
    >>> labels_at(marks, np.array([0, 0, 0, 1]), np.array([0.5, 1.0, 2.0, 1.5])).tolist()
    ['none', 'slip', 'none', 'none']
    """
    labels = np.full(len(trial), NONE, object)
    for number, own in marks.groupby("trial"):
        here = np.flatnonzero(trial == number)
        place = np.searchsorted(own["start_s"].to_numpy(), time_s[here], "right") - 1
        within = (place >= 0) & (time_s[here] < own["stop_s"].to_numpy()[place])
        labels[here[within]] = own["label"].to_numpy()[place[within]]
    return labels
