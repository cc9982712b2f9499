"""The trials of a table of samples: by columns that tell them apart, by the class of each sample, or by annotations."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import model_validator

from neurotact.data.readers import annotations, split_stamps
from neurotact.data.readers.clock import Unit, is_time_of_day, row_times, seconds_of, unit_in
from neurotact.data.readers.layout import ColumnsSpec
from neurotact.data.readers.tables import TextTable, finite_called, values_of
from neurotact.data.recordings import LABEL
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where
from neurotact.errors import InputError, some
from neurotact.files import existing
from neurotact.spec import Names

SEGMENT = "segment"
"""The condition that numbers the segments of a continuous recording."""

log = logging.getLogger("neurotact")


class TableSpec(ColumnsSpec):
    """What the columns are."""

    columns: Names = ()
    """The taxels, by names or by numbers; all columns of numbers that change within a trial when absent."""
    label: str | None = None
    """The class of each sample's trial; when absent, a column called label, class, y or target."""
    trial: Names = ()
    """The columns that tell trials apart; when absent, one called trial, recording or touch."""
    segments: bool = False
    """Whether each stretch of samples of one class is a trial: a continuous recording with a class for each sample."""
    annotations: str | None = None
    """A CSV file that says when each touch of a continuous recording begins and ends, and its class."""
    where: Where = {}
    """Conditions of the trials to read, such as `{ speed = 300 }`."""
    leave_out: LeaveOut = {}
    """Classes that are no touch, such as `rest`, or conditions of trials that are not read."""

    @model_validator(mode="after")
    def _has_one_source_of_trials(self) -> "TableSpec":
        if self.annotations is not None and (self.segments or self.trial):
            raise ValueError("`annotations` says where trials begin and end; leave out `segments` and `trial`")
        return self

    @property
    def choice(self) -> TrialChoice:
        """The trials to read."""
        return TrialChoice(self.where, self.leave_out)

    @property
    def is_continuous(self) -> bool:
        """Whether trials are cut from a continuous recording."""
        return self.segments or self.annotations is not None


class Roles(NamedTuple):
    """The names of the columns.

    label: empty with annotations. time: None without stamps. taxels: the chosen ones; none: all other columns.
    first_line: the line of the first row. rest: of the seconds in `time`; None if they have none of their own.
    """

    label: str
    trial: tuple[str, ...]
    time: str | None
    taxels: tuple[str, ...]
    first_line: int = 2
    rest: str | None = None


class Trials(NamedTuple):
    """The first row of each trial, `(trial,)`, the row after its last, its name, and its class and conditions."""

    begin: np.ndarray
    end: np.ndarray
    names: list[str]
    conditions: pd.DataFrame

    def are_constant(self, values: np.ndarray) -> bool:
        """Whether a column has one value within each trial."""
        changes = np.flatnonzero(values[1:] != values[:-1]) + 1
        return bool((np.searchsorted(changes, self.begin, "right") >= np.searchsorted(changes, self.end)).all())

    def chosen(self, keep: np.ndarray) -> "Trials":
        """The trials of which `keep`, `(trial,)`, is true."""
        names = [name for name, kept in zip(self.names, keep, strict=True) if kept]
        return Trials(self.begin[keep], self.end[keep], names, self.conditions[keep].reset_index(drop=True))


class Clock(NamedTuple):
    """The time stamps of all rows, `(row,)`, None without, and their unit, None if nothing says it."""

    time: np.ndarray | None
    unit: Unit | None


def find_trials(
    columns: Mapping[str, np.ndarray], roles: Roles, clock: Clock, spec: TableSpec, rate_Hz: float | None, path: Path
) -> Trials:
    """The chosen trials in these columns; those of a continuous recording are numbered by the condition `SEGMENT`.

    Of the choice, the part that classes and columns of trials decide is made here, that of other columns by the caller.
    rate_Hz: the given sampling rate, which tells the times of rows without stamps.
    Raises InputError for trials that begin again or have two classes, and for annotations of another recording.
    """
    if spec.annotations is not None:
        trials = _annotated(clock, len(next(iter(columns.values()))), spec, rate_Hz, path, roles.first_line)
    else:
        trials = _segments(columns, roles, path) if spec.segments else _trials(columns, roles, path)
    if spec.is_continuous:
        _say_outside(trials, len(next(iter(columns.values()))), path)
    choice = spec.choice.with_label(roles.label).among(chosen_by(trials.conditions, spec))
    trials = _chosen(trials, choice, path)
    if not spec.is_continuous:
        return trials
    return trials._replace(conditions=trials.conditions.assign(**{SEGMENT: np.arange(1, len(trials.names) + 1)}))


def _say_outside(trials: Trials, n_rows: int, path: Path) -> None:
    """Say how many rows of a continuous recording are in no trial."""
    changes = np.zeros(n_rows + 1, np.int64)
    np.add.at(changes, trials.begin, 1)
    np.add.at(changes, trials.end, -1)
    n_outside = int((np.cumsum(changes[:-1]) == 0).sum())
    if n_outside:
        log.warning("%s: %s of %s rows are in no trial", path, f"{n_outside:,}", f"{n_rows:,}")


def _trials(columns: Mapping[str, np.ndarray], roles: Roles, path: Path) -> Trials:
    """The trials: rows one after another with the same values in the columns that tell trials apart."""
    begin, end, firsts = _stretches(columns, roles.trial)
    again = np.flatnonzero(firsts.duplicated().to_numpy())
    if len(again):
        name, line = " ".join(firsts.iloc[again[0]]), begin[again[0]] + roles.first_line
        raise InputError(
            f"{path}: trial {name[:40]} begins again at line {line}; if trials are numbered "
            f"anew for each class or subject, name all columns that tell them apart, as in "
            f"`trial='{roles.label},{','.join(roles.trial)}'`; else sort the rows by trial"
        )
    names = [f"trial {' '.join(row)}" for row in firsts.itertuples(index=False)]
    trials = Trials(begin, end, names, _conditions(columns, roles, begin))
    if not trials.are_constant(columns[roles.label]):
        raise InputError(
            f"{path}: '{roles.label}' changes within a trial; give each trial one class, name all columns that tell "
            f"trials apart, as in `trial='{roles.label},{','.join(roles.trial)}'`, or take each stretch of one class "
            "as a trial with `segments=True`"
        )
    return trials


def _segments(columns: Mapping[str, np.ndarray], roles: Roles, path: Path) -> Trials:
    """The trials: rows one after another with the same class, and the same in the columns that tell trials apart."""
    begin, end, _ = _stretches(columns, tuple(dict.fromkeys((*roles.trial, roles.label))))
    conditions = _conditions(columns, roles, begin)
    names = [f"the segment from line {row + roles.first_line}" for row in begin]
    return _touches(Trials(begin, end, names, conditions), path)


def _annotated(
    clock: Clock, n_rows: int, spec: TableSpec, rate_Hz: float | None, path: Path, first_line: int
) -> Trials:
    """The trials that the table of annotations names; times without stamps are seconds from the first sample."""
    marks = annotations.read(existing(spec.annotations or ""), spec.label, spec.decimal)
    time, unit = clock
    if time is None:
        assert rate_Hz is not None
        time, unit = np.arange(n_rows) / rate_Hz, "s"
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        raise InputError(
            f"{path}: line {back[0] + 1 + first_line} is earlier than the line before it; annotations need one "
            "continuous recording"
        )
    begin, end = marks.on(row_times(time), unit, str(path))
    order = np.argsort(begin, kind="stable")
    shared = int((begin[order][1:] < end[order][:-1]).sum())
    if shared:
        log.warning(
            "%s: annotations that begin before another one ends: %d; training and test trials may share their samples",
            marks.path, shared,
        )  # fmt: skip
    names = [f"the touch of {marks.path.name}, line {row + marks.first_line}" for row in range(len(begin))]
    return _touches(Trials(begin, end, names, marks.conditions), path)


def _touches(trials: Trials, path: Path) -> Trials:
    """The trials with a class and at least two samples; a warning names the others that have a class."""
    is_touch = (trials.conditions[LABEL] != "").to_numpy()
    short = is_touch & (trials.end - trials.begin < 2)
    if short.any():
        which = [name for name, is_short in zip(trials.names, short, strict=True) if is_short]
        log.warning("%s: fewer than two samples make no trial; left out: %s", path, some(which))
    if not (is_touch & ~short).any():
        raise InputError(f"{path}: no trial has two samples of one class; check the classes and the times of touches")
    return trials.chosen(is_touch & ~short)


def _stretches(columns: Mapping[str, np.ndarray], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, pd.DataFrame]:
    """Where stretches of rows with the same values in these columns begin and end, and their values."""
    keys = pd.DataFrame({name: columns[name] for name in names})
    begin = np.flatnonzero((keys != keys.shift()).any(axis=1).to_numpy())
    return begin, np.append(begin[1:], len(keys)), keys.iloc[begin]


def _conditions(columns: Mapping[str, np.ndarray], roles: Roles, begin: np.ndarray) -> pd.DataFrame:
    """The class of each trial, and the values that tell trials apart."""
    table = pd.DataFrame({LABEL: columns[roles.label][begin]})
    for name in roles.trial:
        if name not in (roles.label, LABEL):
            table[name] = values_of(columns[name][begin])
    return table


def chosen_by(conditions: pd.DataFrame, spec: TableSpec) -> list[str]:
    """The conditions that choose trials before these are cut: not the number of a segment, which counts the chosen."""
    return [name for name in conditions if not (spec.is_continuous and name == SEGMENT)]


def _chosen(trials: Trials, choice: TrialChoice, path: Path) -> Trials:
    """The trials that a choice keeps, before anything of the others is checked; a line says how many."""
    if not choice:
        return trials
    keep = choice.keeps(trials.conditions, str(path))
    choice.say(keep, str(path))
    return trials.chosen(keep)


def clock_of(columns: Mapping[str, np.ndarray], roles: Roles, spec: TableSpec, table: TextTable) -> Clock:
    """The column of time stamps: finite numbers, or times of day in seconds."""
    if roles.time is None:
        return Clock(None, None)
    values = columns[roles.time]
    is_of_day = values.dtype.kind == "U" and is_time_of_day(str(values[0]))
    if is_of_day:
        time = seconds_of(values.tolist(), str(table.path), roles.time, table.first_line, spec.time_unit)
    else:
        time = finite_called(table, roles.time, columns)
    if roles.rest is not None:
        rest = finite_called(table, roles.rest, columns)
        time = split_stamps.joined(time, rest, roles.rest, str(table.path), table.first_line, spec.time_unit)
    in_seconds = is_of_day or roles.rest is not None
    return Clock(time, "s" if in_seconds else spec.time_unit or unit_in(roles.time))
