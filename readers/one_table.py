"""One table with the samples of all trials: a row per sample, with the trial and the class that it belongs to.

Trials are told apart by columns, by the class of each sample, or by a table of annotations.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.readers.clock.stamps import row_times
from neurotact_parts.readers.clock.trials import Read, mended, recordings_of
from neurotact_parts.readers.doubts import kinds_of_names
from pydantic import model_validator

from neurotact.data import marks
from neurotact.data.readers.clock.units import UNIT_S, Unit, is_time_of_day, seconds_of, without_unit
from neurotact.data.readers.columns import (
    CHOICE,
    Clock,
    ColumnsSpec,
    Samples,
    called,
    check_rises,
    chosen_places,
    clock_of,
    evenly,
    is_index,
    unit_of,
)
from neurotact.data.readers.formats import holding, tables_in
from neurotact.data.readers.table.cells import (
    Table,
    check_digits,
    columns_of,
    finite_called,
    is_gap,
    is_meant_as_number,
    values_of,
)
from neurotact.data.readers.table.headings import named_table
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where, chosen_trials
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing
from neurotact.lazily import lazily
from neurotact.spec import Names, build

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

SEGMENT = "segment"
"""The condition that numbers the segments of a continuous recording."""
FEATURES = (
    "if each row is a touch of its own, give a row per sample, or put the samples into an .npz with signals "
    "(trial, time) and label for neurotact import arrays touches.npz --axes trial,time (features have no time)"
)
WHOLE = "recording"
"""The class of a continuous recording that is kept whole."""
SHORT = 5
"""Rows of a stretch below which it is hardly a touch."""
FAULTS = 0.5
"""Share of numbers above which a column of texts is a taxel with faults."""
ROUNDING = 1e-3
"""Share of a sample's interval by which a time may be off: 0.1 s and 0.2 s are a little more than 0.3 s."""


class _TableSpec(ColumnsSpec):
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
    keep_whole: bool = False
    """Whether a continuous recording is one trial, whose marks say when each of its touches is."""
    where: Where = {}
    """Conditions of the trials to read, such as `{ speed = 300 }`."""
    leave_out: LeaveOut = {}
    """Classes that are no touch, such as `rest`, or conditions of trials that are not read."""

    @model_validator(mode="after")
    def _has_one_source_of_trials(self) -> _TableSpec:
        if self.annotations is not None and (self.segments or self.trial):
            raise ValueError("`annotations` says where trials begin and end; leave out `segments` and `trial`")
        if self.keep_whole and not self.is_continuous:
            raise ValueError("`keep_whole` needs touches that are told apart; give `segments` or `annotations`")
        return self

    @property
    def is_continuous(self) -> bool:
        """Whether trials are cut from a continuous recording."""
        return self.segments or self.annotations is not None

    def chosen_by(self, conditions: pd.DataFrame) -> list[str]:
        """The conditions that choose trials before they are cut: not the number of a segment, a count of the chosen."""
        return [name for name in conditions if not (self.is_continuous and name == SEGMENT)]


class _Roles(NamedTuple):
    """The names of the columns.

    label: empty with annotations. time: None without stamps; rest: of its seconds, None if they have none of their own.
    taxels: the chosen ones; none: all other columns.
    """

    label: str
    trial: tuple[str, ...]
    time: str | None
    rest: str | None
    taxels: tuple[str, ...]

    @property
    def used(self) -> tuple[str | None, ...]:
        return self.label, *self.trial, self.time, self.rest, *self.taxels


class _Trials(NamedTuple):
    """The first row of each trial, `(trial,)`, the row after its last, its name, and its class and conditions."""

    begin: np.ndarray
    end: np.ndarray
    names: list[str]
    conditions: pd.DataFrame

    def are_constant(self, values: np.ndarray) -> bool:
        """Whether a column has one value within each trial."""
        changes = np.flatnonzero(values[1:] != values[:-1]) + 1
        return bool((np.searchsorted(changes, self.begin, "right") >= np.searchsorted(changes, self.end)).all())

    def chosen(self, keep: np.ndarray) -> _Trials:
        """The trials of which `keep`, `(trial,)`, is true."""
        names = [name for name, kept in zip(self.names, keep, strict=True) if kept]
        return _Trials(self.begin[keep], self.end[keep], names, self.conditions[keep].reset_index(drop=True))


def read(
    path: str | Path, sampling_rate_Hz: float | None = None, unit: str = "", spec: Mapping[str, Any] | None = None
) -> Recordings:
    """The recordings in one table with a header, as of `api.read_table`. spec: keys of `_TableSpec`.

    Trials of a continuous recording are found by `segments` or `annotations`; the condition `segment` numbers them.
    """
    path = existing(path)
    layout = build(_TableSpec, spec or {}, "import table")
    check_import(sampling_rate_Hz, unit, str(path))
    table = _opened(path, layout)
    roles = _roles(table, layout, find_time=sampling_rate_Hz is None or not layout.columns)
    if sampling_rate_Hz is None and roles.time is None and not table.intervals_s:
        raise InputError(f"{path}: the sampling rate is not known; give `sampling_rate_Hz`, or `time_column`")
    if layout.time_unit is not None and roles.time is None and layout.annotations is None:
        raise InputError(f"{path}: `time_unit`: the samples have no time stamps; leave it out")
    columns = columns_of(table, {roles.label, *roles.trial} & {*table.names})
    time, rest = (None if name is None else table.names.index(name) for name in (roles.time, roles.rest))
    clock = clock_of(table, time, rest, dict(enumerate(columns.values())), layout.time_unit)
    if clock.time is None and table.intervals_s:
        clock = evenly(table, range(table.n_columns), len(table.values[0]))
    columns = _without_others(columns, table, roles)
    if layout.missing is not None:
        columns = {name: _with_gaps(table, name, values, roles) for name, values in columns.items()}
    trials = _find_trials(columns, roles, clock, layout, sampling_rate_Hz, table)
    _check_time(trials, layout, clock, path)
    touches, trials = trials, _whole(columns, roles) if layout.keep_whole else trials
    taxels, conditions = _parted(columns, roles, trials, table)
    cut = [*_cut(columns, roles._replace(taxels=taxels), trials, clock, layout, table)]
    trial_of, kept = mended(cut, layout.missing, str(path))
    read = recordings_of(
        trial_of, conditions.iloc[kept].reset_index(drop=True), sampling_rate_Hz, unit,
        max_gap_ms=layout.max_gap_ms, drop_repeats=layout.drop_repeats, source=f"table {path.name}", where=str(path),
    )  # fmt: skip
    if layout.keep_whole:
        kept_trials = trials.chosen(np.isin(np.arange(len(trials.begin)), kept))
        return replace(read, marks=_marks(touches, kept_trials, clock, read))
    choice = TrialChoice(layout.where, layout.leave_out).with_label(roles.label)
    return chosen_trials(read, choice.beyond(layout.chosen_by(trials.conditions)), str(path))


def _opened(path: Path, layout: _TableSpec) -> Table:
    """The table in a text file, or the only one of another format."""
    if path.suffix.lower() == ".lvm" or holding(path) != "tables":  # a text, which may be any other
        return named_table(path, layout.decimal, layout.header_lines, option="header_lines", choice=CHOICE)
    layout.check_no_text(path)
    name, *others = tables = tables_in(path)
    if others:
        raise InputError(f"{path}: holds {len(tables)} tables ({some([*tables])}); neurotact import folder reads each")
    return tables[name]


# --- columns ----------------------------------------------------------------------------------------


def _roles(table: Table, spec: _TableSpec, *, find_time: bool) -> _Roles:
    path, names = table.path, [*table.names]
    label, trial = "", ()
    if spec.annotations is None:
        label = spec.label or called(names, "label")
        trial_column = called(names, "trial")
        trial = spec.trial or ((trial_column,) if trial_column else ())
        for role, role_names in (("`label`", (label,) if label else ()), ("`trial`", trial)):
            for name in role_names:
                if name not in names:
                    raise InputError(f"{path}: {role}: there is no column '{name[:40]}'; {nearest(name, names)}")
        shown = some(names, 12)
        if label is None:
            raise InputError(f"{path}: no column is called label ({shown}); name the class of a trial with `label`")
        if not trial and not spec.segments:
            raise InputError(
                f"{path}: no column is called trial ({shown}); name the columns that tell trials apart with `trial`, "
                f"as in `trial='subject,repetition'`, or take each stretch of one '{label}' as a trial with "
                f"`segments=True`{'' if called(names, 'time') else f'; {FEATURES}'}"
            )
    others = {"`label`": [names.index(label)] if label else [], "`trial`": [names.index(name) for name in trial]}
    chosen, time, rest = chosen_places(
        spec.columns, spec.time_column, table.names, table.first_row, path, find_time=find_time, others=others
    )
    its_time, its_rest = (None if column is None else names[column] for column in (time, rest))
    return _Roles(label, trial, its_time, its_rest, tuple(names[column] for column in chosen))


def _without_others(columns: dict[str, np.ndarray], table: Table, roles: _Roles) -> dict[str, np.ndarray]:
    """The columns without pandas' numbers of rows, the header of a ROS message, and what has no name."""
    free = [(column, name) for column, name in enumerate(table.names) if name not in roles.used]
    index = [column for column, name in free if is_index(table, column, columns[name])]
    others = [column for column, name in free if column not in index and (not name or called([name], "ROS header"))]
    if others:
        named = [table.names[column] or f"column {column + 1}, which has no name" for column in others]
        log.warning("%s: no taxel and no condition: %s", table.path, some(named))
    return {name: values for column, (name, values) in enumerate(columns.items()) if column not in (*index, *others)}


def _with_gaps(table: Table, name: str, values: np.ndarray, roles: _Roles) -> np.ndarray:
    """A column of numbers and gaps as numbers, NaN for each gap; another column as it is."""
    if values.dtype.kind != "U" or name in (roles.label, *roles.trial, roles.time, roles.rest):
        return values
    whole = [cell for cell in values.tolist() if not is_gap(cell)]
    is_taxel = whole and all(map(is_meant_as_number, whole))
    return finite_called(table, name, {name: values}, with_gaps=True) if is_taxel else values


def _parted(
    columns: Mapping[str, np.ndarray], roles: _Roles, trials: _Trials, table: Table
) -> tuple[tuple[str, ...], pd.DataFrame]:
    """The names of the taxels, and the conditions of the trials; columns that are neither are named in a warning."""
    others = [name for name in columns if name not in roles.used]
    constant = [name for name in others if trials.are_constant(columns[name])]
    changing = [name for name in others if name not in constant]
    taxels = roles.taxels or tuple(name for name in changing if columns[name].dtype.kind in "iuf")
    ignored = [name for name in changing if name not in taxels]
    for name in [name for name in ignored if columns[name].dtype.kind == "U"]:
        if np.mean([is_meant_as_number(cell) for cell in columns[name].tolist()]) > FAULTS:
            finite_called(table, name, columns)  # says which cell is no number
    if not taxels:
        raise InputError(f"{table.path}: no column of numbers changes within a trial; name the taxels with `columns`")
    constant = [name for name in constant if name not in trials.conditions]
    if constant and not roles.taxels:
        log.warning(
            "%s: constant within each trial, so conditions and not taxels: %s; to change that, name the taxels with "
            "`columns`",
            table.path, some(constant),
        )  # fmt: skip
    if ignored:
        log.warning("%s: not used: %s", table.path, some(ignored))
    if not roles.taxels and (doubt := kinds_of_names(taxels)):
        log.warning("%s: %s", table.path, doubt)
    return taxels, trials.conditions.assign(**{name: values_of(columns[name][trials.begin]) for name in constant})


def _cut(
    columns: Mapping[str, np.ndarray], roles: _Roles, trials: _Trials, clock: Clock, spec: _TableSpec, table: Table
) -> Iterator[Read]:
    """The samples and the stamps of each trial."""
    taxels = [finite_called(table, name, columns, with_gaps=spec.missing is not None) for name in roles.taxels]
    for samples in taxels:
        check_digits(samples[np.isfinite(samples)], table.path)
    signal = np.stack(taxels, axis=1).astype(np.float32)
    units = tuple(table.units[table.names.index(name)] for name in roles.taxels if table.units)
    for begin, end, name in zip(trials.begin, trials.end, trials.names, strict=True):
        its_time = None if clock.time is None else clock.time[begin:end]
        if its_time is not None and spec.time_column is None:
            check_rises(its_time, roles.time or "", table.path)
        missing = np.isnan(signal[begin:end])
        its = Samples(
            roles.taxels, signal[begin:end], its_time, int(begin) + table.first_line, clock.unit,
            missing=missing if missing.any() else None, units=units,
        )  # fmt: skip
        yield Read(f"{table.path}, {name}", name, its)


# --- trials -----------------------------------------------------------------------------------------


def _find_trials(
    columns: Mapping[str, np.ndarray], roles: _Roles, clock: Clock, spec: _TableSpec, rate_Hz: float | None,
    table: Table,
) -> _Trials:  # fmt: skip
    """The chosen trials in these columns; those of a continuous recording are numbered by the condition `SEGMENT`.

    Of the choice, the part that classes and columns of trials decide is made here, before anything of the others is
    checked. rate_Hz: the given sampling rate, which tells the times of rows without stamps.
    """
    n_rows = len(next(iter(columns.values())))
    if spec.annotations is not None:
        trials = _touches(_annotated(clock, n_rows, spec, rate_Hz, table), table.path)
    elif spec.segments:
        begin, end, _ = _stretches(columns, tuple(dict.fromkeys((*roles.trial, roles.label))))
        names = [f"the segment from line {row + table.first_line}" for row in begin]
        trials = _touches(_Trials(begin, end, names, _conditions(columns, roles, begin)), table.path)
    else:
        trials = _told_apart(columns, roles, table)
    if spec.is_continuous:
        changes = np.zeros(n_rows + 1, np.int64)
        np.add.at(changes, trials.begin, 1)
        np.add.at(changes, trials.end, -1)
        n_outside = int((np.cumsum(changes[:-1]) == 0).sum())
        if n_outside:
            log.warning("%s: %s of %s rows are in no trial", table.path, f"{n_outside:,}", f"{n_rows:,}")
    choice = TrialChoice(spec.where, spec.leave_out).with_label(roles.label).among(spec.chosen_by(trials.conditions))
    if choice:
        keep = choice.keeps(trials.conditions, str(table.path))
        choice.say(keep, str(table.path))
        trials = trials.chosen(keep)
    if not spec.is_continuous:
        return trials
    return trials._replace(conditions=trials.conditions.assign(**{SEGMENT: np.arange(1, len(trials.names) + 1)}))


def _told_apart(columns: Mapping[str, np.ndarray], roles: _Roles, table: Table) -> _Trials:
    """The trials: rows one after another with the same values in the columns that tell trials apart."""
    begin, end, firsts = _stretches(columns, roles.trial)
    again = np.flatnonzero(firsts.duplicated().to_numpy())
    every = f", as in `trial='{roles.label},{','.join(roles.trial)}'`" if roles.label not in roles.trial else ""
    if len(again):
        name, line = " ".join(firsts.iloc[again[0]]), begin[again[0]] + table.first_line
        raise InputError(
            f"{table.path}: trial {name[:40]} begins again at line {line}; if trials are numbered anew for each class "
            f"or subject, name all columns that tell them apart{every}; else sort the rows by trial"
        )
    names = [f"trial {' '.join(row)}" for row in firsts.itertuples(index=False)]
    trials = _Trials(begin, end, names, _conditions(columns, roles, begin))
    if not trials.are_constant(columns[roles.label]):
        raise InputError(
            f"{table.path}: '{roles.label}' changes within a trial; give each trial one class, name all columns that "
            f"tell trials apart{every}, or take each stretch of one class as a trial with `segments=True`"
        )
    return trials


def _stretches(columns: Mapping[str, np.ndarray], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, pd.DataFrame]:
    """Where stretches of rows with the same values in these columns begin and end, and their values."""
    keys = pd.DataFrame({name: columns[name] for name in names})
    begin = np.flatnonzero((keys != keys.shift()).any(axis=1).to_numpy())
    return begin, np.append(begin[1:], len(keys)), keys.iloc[begin]


def _conditions(columns: Mapping[str, np.ndarray], roles: _Roles, begin: np.ndarray) -> pd.DataFrame:
    """The class of each trial, and the values that tell trials apart."""
    others = [name for name in roles.trial if name not in (roles.label, LABEL)]
    values = {name: values_of(columns[name][begin]) for name in others}
    return pd.DataFrame({LABEL: columns[roles.label][begin], **values})


def _touches(trials: _Trials, path: Path) -> _Trials:
    """The trials with a class and at least two samples; a warning names the others that have a class."""
    is_touch = (trials.conditions[LABEL] != "").to_numpy()
    short = is_touch & (trials.end - trials.begin < 2)
    if short.any():
        which = [name for name, is_short in zip(trials.names, short, strict=True) if is_short]
        log.warning("%s: fewer than two samples make no trial; left out: %s", path, some(which))
    if not (is_touch & ~short).any():
        raise InputError(f"{path}: no trial has two samples of one class; check the classes and the times of touches")
    return trials.chosen(is_touch & ~short)


def _check_time(trials: _Trials, spec: _TableSpec, clock: Clock, path: Path) -> None:
    """Refuse trials of one row each; doubt stretches without time stamps that are as rows of features lie."""
    lengths = trials.end - trials.begin
    if (lengths == 1).all():
        raise InputError(f"{path}: every trial has one row; {FEATURES}")
    if not spec.segments or clock.time is not None:
        return
    n_classes = trials.conditions[LABEL].nunique()
    if 1 < n_classes == len(lengths):
        log.warning("%s: each of the %d classes is one stretch of rows; %s", path, n_classes, FEATURES)
    elif np.median(lengths) < SHORT:
        log.warning("%s: most stretches of a class have fewer than %d rows; %s", path, SHORT, FEATURES)


def _whole(columns: Mapping[str, np.ndarray], roles: _Roles) -> _Trials:
    """The continuous recordings: all rows, or those with the same values in the columns that tell recordings apart."""
    columns = {**columns, WHOLE: np.full(len(next(iter(columns.values()))), WHOLE)}
    begin, end, _ = _stretches(columns, (*roles.trial, WHOLE))
    names = [f"the recording from row {row + 1}" for row in begin]
    return _Trials(begin, end, names, _conditions(columns, roles._replace(label=WHOLE), begin))


def _marks(touches: _Trials, trials: _Trials, clock: Clock, read: Recordings) -> pd.DataFrame:
    """The marks of whole recordings. A touch that ends where rows go on ends at the time of the next row."""
    rows: list[tuple[int, float, float, str]] = []
    for trial, (first, after) in enumerate(zip(trials.begin, trials.end, strict=True)):
        time, n = np.arange(after - first) if clock.time is None else clock.time[first:after], read.lengths[trial]
        time_s = np.append((time - time[0]) / (time[-1] - time[0]) * (n - 1), n) / read.sampling_rate_Hz
        for begin, end, label in zip(touches.begin, touches.end, touches.conditions[LABEL], strict=True):
            if first <= begin < after:
                rows.append((trial, *time_s[[begin - first, min(end, after) - first]].tolist(), label))
    return pd.DataFrame(rows, columns=marks.COLUMNS)


# --- annotations ------------------------------------------------------------------------------------


class _Annotations(NamedTuple):
    """When each touch begins and ends, `(touch,)`, in this unit (None if the file does not say it), and what it is.

    first_line: the line of the first touch.
    """

    path: Path
    begin: np.ndarray
    end: np.ndarray
    unit: Unit | None
    conditions: pd.DataFrame
    first_line: int

    def on(self, time: np.ndarray, unit: Unit | None, where: Path) -> tuple[np.ndarray, np.ndarray]:
        """The first row of each touch, and the row after its last, among samples at these times, in ascending order.

        unit: of the times. What has no unit is in seconds; if both have none, they only have to have the same. Where
        the samples begin later than every touch ends, touches count from the first sample, with a warning.
        Raises InputError for a touch that lies outside of the recording.
        """
        scale = UNIT_S[self.unit or "s"] / UNIT_S[unit or "s"]
        begin, end = scale * self.begin, scale * self.end
        if time[0] > end.max() and 0 <= begin.min() <= begin.max() <= time[-1] - time[0]:
            log.warning("%s: its times count from the first sample of %s, which is at %.10g", self.path, where, time[0])
            begin, end = begin + time[0], end + time[0]
        outside = np.flatnonzero((end <= time[0]) | (begin > time[-1]))
        if len(outside):
            row = outside[0]
            raise InputError(
                f"{self.path}: line {row + self.first_line}: {begin[row]:.10g} to {end[row]:.10g} lies outside of "
                f"{where}, which goes from {time[0]:.10g} to {time[-1]:.10g}; give both times on one clock, with their "
                "units, as in begin_ms"
            )
        rounding = ROUNDING * (time[-1] - time[0]) / max(1, len(time) - 1)
        return np.searchsorted(time, begin - rounding), np.searchsorted(time, end - rounding)


def _annotated(clock: Clock, n_rows: int, spec: _TableSpec, rate_Hz: float | None, table: Table) -> _Trials:
    """The trials that the table of annotations names; times without stamps are seconds from the first sample."""
    annotated = _read_annotations(existing(spec.annotations or ""), spec.label, table.decimal)
    time, unit = clock
    if time is None:
        assert rate_Hz is not None
        time, unit = np.arange(n_rows) / rate_Hz, "s"
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        raise InputError(
            f"{table.path}: line {back[0] + 1 + table.first_line} is earlier than the line before it; annotations need "
            "one continuous recording"
        )
    begin, end = annotated.on(row_times(time), unit, table.path)
    order = np.argsort(begin, kind="stable")
    shared = int((begin[order][1:] < end[order][:-1]).sum())
    if shared:
        log.warning(
            "%s: annotations that begin before another one ends: %d; training and test trials may share their samples",
            annotated.path, shared,
        )  # fmt: skip
    names = [f"the touch of {annotated.path.name}, line {row + annotated.first_line}" for row in range(len(begin))]
    return _Trials(begin, end, names, annotated.conditions)


def _read_annotations(path: Path, label: str | None = None, decimal: Literal[".", ","] = ".") -> _Annotations:
    """The annotations in a CSV or TSV file with a header: a row per touch.

    Columns: `begin` (or start, onset), `end` (or stop, offset) or `duration`, with or without a unit (`begin_ms`), and
    `label`, or the one that is named. All others are conditions.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "events.tsv"
    >>> _ = path.write_text("onset\\tduration\\ttrial_type\\tforce\\n0.5\\t1.5\\ttap\\t3\\n4\\t1\\trub\\t6\\n")
    >>> found = _read_annotations(path)
    >>> found.begin.tolist(), found.end.tolist(), found.conditions.values.tolist()
    ([0.5, 4.0], [2.0, 5.0], [['tap', 3], ['rub', 6]])
    """
    table = named_table(path, decimal)
    names = [name for name in table.names if name]
    its_label = label or called(names, "annotation")
    if its_label not in names:
        hint = f"{nearest(label, names)}" if label else f"name it with `label`, of {some(names)}"
        raise InputError(f"{path}: there is no column of classes called {label or LABEL}; {hint}")
    plain = {without_unit(name).strip(): name for name in reversed(names)}
    begin, end, duration = (
        next((name for short, name in reversed(plain.items()) if called([short], what)), None)
        for what in ("begin", "end", "duration")
    )
    second = end or duration
    if begin is None or second is None:
        absent = "begin" if begin is None else "end or duration"
        raise InputError(f"{path}: no column is called {absent} ({some(names)}); rename the columns to begin,end,label")
    columns = columns_of(table, {its_label})
    first, last = (_times(columns[name], name, table) for name in (begin, second))
    units: set[Unit | None] = {unit_of(table, table.names.index(name), np.zeros(0)) for name in (begin, second)}
    if len(units) > 1:
        raise InputError(f"{path}: columns {begin} and {second} are in different units; give both the same")
    last = first + last if end is None else last
    wrong = np.flatnonzero(last <= first)
    if len(wrong):
        raise InputError(f"{path}: line {wrong[0] + table.first_line} ends before it begins; correct its times")
    others = {name: values_of(columns[name]) for name in names if name not in (its_label, begin, second, LABEL)}
    unit: Unit | None = "s" if columns[begin].dtype.kind == "U" else units.pop()
    conditions = pd.DataFrame({LABEL: columns[its_label], **others})
    return _Annotations(path, first, last, unit, conditions, table.first_line)


def _times(values: np.ndarray, name: str, table: Table) -> np.ndarray:
    """The times of a column, finite numbers or times of day."""
    if values.dtype.kind == "U" and is_time_of_day(str(values[0])):
        return seconds_of(values.tolist(), str(table.path), name, table.first_line, None)
    times = pd.to_numeric(pd.Series(values), errors="coerce").to_numpy(np.float64)
    wrong = np.flatnonzero(~np.isfinite(times))
    if len(wrong):
        raise InputError(
            f"{table.path}: line {wrong[0] + table.first_line}, column {name} is {str(values[wrong[0]])[:20]!r}, not a "
            "time; write a number"
        )
    return times
