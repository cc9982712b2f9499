"""One training for each fold, each value of a condition left out, or each of several random splits; and their mean."""

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact import files
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Splits, aside_of, combination, each_left_out
from neurotact.data.trial_choice import values_in_words
from neurotact.errors import InputError, some
from neurotact.metrics.resampled import LEAST_SPLITS, SHARES, Interval, resampled_interval
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import resumable
from neurotact.networks.training.comparison import percent
from neurotact.networks.training.numbers import scored
from neurotact.networks.training.tasks import Task, load_spikes, split_of
from neurotact.tables import write_table

TABLE = "splits.csv"
"""One row per training, in the parent of their folders."""
LEFT_OUT = "left_out"
"""Column of that table: the condition that is tested and was not trained."""
SCORES = (-math.inf, 1.0)
"""What the mean of scores can be."""


class Repeated(NamedTuple):
    """One row per training, and the mean test accuracy with a 95 % interval that considers trials shared by splits.

    Where each value of a condition is tested in turn, the interval is of the means at these values: further seeds test
    the same trials again. Its ends are NaN where there are fewer than `LEAST_SPLITS` of them, or of splits. Where all
    test the same trials, it is the mean of theirs.
    tested: the conditions whose values are tested. of_numbers: whether accuracies are scores.
    """

    table: pd.DataFrame
    accuracy: Interval
    tested: tuple[str, ...] = ()
    of_numbers: bool = False


def tasks_of(task: Task, splits: Splits, conditions: pd.DataFrame) -> dict[str, Task]:
    """The task with each split that has a turn, by the name of its folder: every fold, or each value that is left out.

    Each with `splits.repeats` random seeds. A value of the conditions `leave_out_each` is tested and never trained on;
    of several conditions each combination of values is, those of `test_where` alone, if it has some. Raises InputError
    as `each_left_out`.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 3, "speed": [150, 150, 300, 300, 450, 450]})
    >>> list(tasks_of(Task(), Splits(folds=2, repeats=2), table))
    ['seed-0-fold-0', 'seed-0-fold-1', 'seed-1-fold-0', 'seed-1-fold-1']
    >>> [each.split.test_where for each in tasks_of(Task(), Splits(leave_out_each="speed"), table).values()]
    [{'speed': 150}, {'speed': 300}, {'speed': 450}]
    """
    columns, one, tasks = splits.leave_out_each, splits.one, {}
    tests = each_left_out(conditions, columns, one.test_where) if columns else []
    for seed in range(one.seed, one.seed + splits.repeats):
        for index, test in enumerate(tests):
            values = "-".join(f"{column}-{value}" for column, value in test.items())
            name = f"{index}-{re.sub('[^A-Za-z0-9.+-]+', '_', values)[:60]}"
            changes = {"test_where": test, "leave_aside": len(columns) > 1}
            tasks[f"seed-{seed}-{name}" if splits.repeats > 1 else name] = {"seed": seed, **changes}
        for fold in [] if columns else range(splits.folds) if splits.folds and splits.every_fold else [one.fold]:
            name = f"seed-{seed}-fold-{fold}" if splits.every_fold else f"seed-{seed}"
            tasks[name] = {"seed": seed, "fold": fold}
    split = {name: one.model_copy(update=changes) for name, changes in tasks.items()}
    return {name: task.model_copy(update={"split": each}) for name, each in split.items()}


def run(
    spikes: Path,
    folder: Path,
    network: RSNNSpec,
    tasks: dict[str, Task],
    *,
    force: bool = False,
    resume: bool = False,
    tell: Callable[[str], None] = lambda line: None,
    **options: Any,
) -> Repeated:
    """Train one network for each task in its own folder below `folder`, and write the table of all.

    options: of `resumable.run`; with `resume=True`, finished trainings are not repeated.
    """
    with files.locked(folder):
        single = [name for name in resumable.LEFT if (folder / name).exists()]
        if single:
            raise InputError(f"{folder}: holds a single training; choose another folder")
        if not (force or resume) and (folder / TABLE).exists():
            raise InputError(
                f"{folder / TABLE}: already exists; choose another folder, or pass `force=True` or `resume=True`"
            )
        if not (force or resume) and trained_in(folder):
            raise InputError(
                f"{folder}: holds trainings that were interrupted; pass `resume=True` to continue, or `force=True` to "
                "start again"
            )
        if resume and (strangers := [name for name in trained_in(folder) if name not in tasks]):
            raise InputError(
                f"{folder}: holds trainings of other splits ({some(strangers)}); give the options that it was begun "
                "with, or choose another folder"
            )
        rows, compared = [], []
        for name, task in tasks.items():
            subfolder = folder / name
            resumable.run(spikes, subfolder, network, task, force=force, resume=resume, tell=tell, **options)
            tell = _silent  # the recipe's choices are printed only for the first split
            result = files.read_json(subfolder / resumable.RESULT)
            split: dict[str, Any] = {"split_seed": task.split.seed}
            if task.split.folds:
                split["fold"] = task.split.fold
            if task.split.test_where:
                split[LEFT_OUT] = values_in_words(task.split.test_where)
            compared.append(result["compared"])
            rows.append({"folder": name, **split, **result["row"], "baseline": compared[-1]["baseline_accuracy"]})
        table = pd.DataFrame(rows)
        write_table(table, folder / TABLE)
    first, known = next(iter(tasks.values())), pd.DataFrame(compared)
    if len(table) == 1 or (LEFT_OUT in table and not _are_values(table)):  # no spread over splits
        accuracy = Interval(*(float(mean) for mean in (table["accuracy_test"].mean(), *known[["low", "high"]].mean())))
    else:
        values = table["accuracy_test"] if not _are_values(table) else _by_value(table)
        within = SCORES if first.numbers else SHARES
        sizes = _sizes(load_spikes(spikes, first), tasks.values())
        accuracy = resampled_interval(values.to_numpy(), *sizes, within, known["trials"].mean())
    return Repeated(table, accuracy, (*first.split.test_where,), bool(first.numbers))


def trained_in(folder: Path) -> list[str]:
    """The names of the folders below `folder` that hold a finished training."""
    return sorted(result.parent.name for result in folder.glob(f"*/{resumable.RESULT}"))


def _sizes(trains: SpikeTrains, splits: Iterable[Task]) -> tuple[int, int]:
    """Trials outside and inside the test side, sums over splits; those that are left aside are on neither."""
    copies, n_rest, n_test = copies_of(trains), 0, 0
    for task in splits:
        tested = len(copies.distinct(split_of(trains, task).test))
        used = len(copies.distinct(np.flatnonzero(~aside_of(trains.conditions, task.split))))
        n_rest, n_test = n_rest + used - tested, n_test + tested
    return n_rest, n_test


def line(repeats: Repeated) -> str:
    """The mean accuracy of all trainings in one sentence.

    >>> table = pd.DataFrame({"sops_total": [100.0, 200.0], "baseline": [0.5, 0.5]})
    >>> line(Repeated(table, Interval(0.9, math.nan, math.nan)))
    'accuracy 90.0 % over 2 splits (too few for an interval: `split=nt.Split(repeats=3)` or more), 150 synaptic operations per window; the best baseline on the same spikes 50.0 %'
    """  # noqa: E501
    table, told = repeats.table, scored if repeats.of_numbers else percent
    by_value = ""
    if LEFT_OUT in table:
        by_value = f"; without {'; '.join(f'{value}: {told(mean)}' for value, mean in _by_value(table).items())}"
    return (
        f"{'score (1 is perfect)' if repeats.of_numbers else 'accuracy'} {told(repeats.accuracy.mean)} "
        f"{_over(repeats)}, {table['sops_total'].mean():.0f} synaptic operations per window; "
        f"the best baseline on the same spikes {told(table['baseline'].mean())}{by_value}"
    )


def _over(repeats: Repeated) -> str:
    """The interval of the mean and what it is over, or why there is none.

    >>> table = pd.DataFrame({LEFT_OUT: ["speed = 150", "speed = 300", "speed = 450"] * 2})
    >>> _over(Repeated(table, Interval(0.9, 0.8, 1.0), ("speed",)))
    '(95 % interval 80.0 to 100.0 %) over 3 values of speed, 2 splits each'
    """
    (_, low, high), n = repeats.accuracy, len(repeats.table)
    over, more = "over 1 split" if n == 1 else f"over {n} splits", f"`split=nt.Split(repeats={LEAST_SPLITS})` or more"
    if LEFT_OUT in repeats.table and n > 1:
        over += " with the same test trials"
    if _are_values(repeats.table):
        n_values, tested = repeats.table[LEFT_OUT].nunique(), repeats.tested
        noun = "value" if len(tested) == 1 else combination(tested)
        each = f", {n // n_values} splits each" if n > n_values else ""
        over, more = f"over {n_values} {noun}s of {' and '.join(tested)}{each}", f"test {LEAST_SPLITS} {noun}s or more"
    if math.isnan(low):
        return f"{over} (too few for an interval: {more})"
    ends = f"{low:.3f} to {high:.3f}" if repeats.of_numbers else f"{100 * low:.1f} to {100 * high:.1f} %"
    return f"(95 % interval {ends}) {over}"


def _are_values(table: pd.DataFrame) -> bool:
    """Whether each value of a condition is tested in turn."""
    return LEFT_OUT in table and table[LEFT_OUT].nunique() > 1


def _by_value(table: pd.DataFrame) -> pd.Series:
    """The mean accuracy at each tested value of a condition, in the order of the table."""
    return table.groupby(LEFT_OUT, sort=False)["accuracy_test"].mean()


def _silent(line: str) -> None:
    """Print nothing."""
