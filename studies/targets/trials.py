"""The classes by which gains are calibrated where none are learned."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from neurotact.data import marks
from neurotact.data.recordings import LABEL, Recordings
from neurotact.errors import InputError
from neurotact.networks.training import numbers
from neurotact.networks.training.tasks import Task

HEAD_s = 0.2
"""Of the beginning of a recording, which comes before each of its stretches: a baseline that is taken from the start of
a trial is then that of the recording."""
SHORTEST_s = 0.05
"""Of a stretch."""


def classes_of_target(training: Recordings, task: Task) -> Recordings:
    """Training trials with classes: ranges of the first number, or the marks of stretches."""
    return stretches(training) if task.detects else with_ranges(training, task.numbers[0])


def with_ranges(training: Recordings, name: str) -> Recordings:
    """The trials, whose classes are ranges of a number with about as many trials each.

    >>> table = pd.DataFrame({"label": ["a"] * 20, "force_N": np.arange(20.0)})
    >>> ranged = with_ranges(Recordings(np.ones((20, 9, 1)), 100.0, "mV", table), "force_N")
    >>> ranged.conditions["label"].unique().tolist()
    ['force_N 0 to 9', 'force_N 10 to 19']
    """
    values = training.conditions[name].to_numpy(float)
    groups = numbers.groups_of(training.conditions, [name])
    groups = groups if len({*groups.tolist()}) > 1 else (values > values.min()).astype(int)
    ends = {group: (values[groups == group].min(), values[groups == group].max()) for group in {*groups.tolist()}}
    labels = [f"{name} {ends[group][0]:g} to {ends[group][1]:g}" for group in groups.tolist()]
    return replace(training, conditions=training.conditions.assign(**{LABEL: labels}))


def stretches(training: Recordings) -> Recordings:
    """A trial for each mark, with its label, and for each stretch without one, behind the beginning of its recording.

    Without unmarked time, a baseline that forgets the level of a touch would separate the labels best.
    """
    kept = [*_marked(training)]
    if len({label for *_, label in kept}) < 2:
        raise InputError(
            f"{training.source or 'recordings'}: training recordings have no two labels that last {SHORTEST_s:g} s"
        )
    head = round(HEAD_s * training.sampling_rate_Hz)
    signals = [
        np.concatenate([training.signals[trial][: min(head, first)], training.signals[trial][first:last]])
        for trial, first, last, _ in kept
    ]
    table = training.conditions.iloc[[trial for trial, *_ in kept]].reset_index(drop=True)
    conditions = table.assign(**{LABEL: [label for *_, label in kept]})
    return replace(training, signals=signals, conditions=conditions, marks=None)


def _marked(training: Recordings) -> Iterator[tuple[int, int, int, str]]:
    """Trial, first sample, end and label of each mark, and of each stretch without one."""
    rate_Hz = training.sampling_rate_Hz
    table = pd.DataFrame(columns=marks.COLUMNS) if training.marks is None else training.marks
    for trial, length in enumerate(training.lengths.tolist()):
        before = 0
        for row in table[table["trial"] == trial].itertuples():
            first, last = round(row.start_s * rate_Hz), round(row.stop_s * rate_Hz)
            yield from _long_enough((trial, before, first, marks.NONE), rate_Hz)
            yield from _long_enough((trial, first, last, str(row.label)), rate_Hz)
            before = last
        yield from _long_enough((trial, before, length, marks.NONE), rate_Hz)


def _long_enough(one: tuple[int, int, int, str], rate_Hz: float) -> Iterator[tuple[int, int, int, str]]:
    if one[2] - one[1] >= SHORTEST_s * rate_Hz:
        yield one
