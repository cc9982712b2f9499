"""One text table with the samples of all trials: a row per sample, with the trial and the class that it belongs to."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.readers import ros, sampled
from neurotact.data.readers.arrays import ALIASES
from neurotact.data.readers.headings import named_table
from neurotact.data.readers.layout import CHOICE, TIME_COLUMN, Table, check_rises, chosen_places, is_index, unit_of
from neurotact.data.readers.missing import mended
from neurotact.data.readers.sampled import Read
from neurotact.data.readers.table_trials import (
    Clock,
    Roles,
    TableSpec,
    Trials,
    chosen_by,
    clock_of,
    find_trials,
)
from neurotact.data.readers.tables import (
    TextTable,
    called,
    check_digits,
    columns_of,
    finite_called,
    is_gap,
    is_meant_as_number,
    values_of,
)
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.data.trial_choice import chosen_trials
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing
from neurotact.spec import build

TRIALS = ("trial", "trials", "trial_id", "recording", "recordings", "recording_id", "touch", "touch_id", "sequence_id")
"""Names of the column that tells trials apart."""
FEATURES = "if each row is a touch of its own (features, without time), there is no signal: give a row per sample"
SHORT = 5
"""Rows of a stretch below which it is hardly a touch."""
FAULTS = 0.5
"""Share of numbers above which a column of texts is a taxel with faults."""
log = logging.getLogger("neurotact")


def read(
    path: str | Path, sampling_rate_Hz: float | None = None, unit: str = "", spec: Mapping[str, Any] | None = None
) -> Recordings:
    """The recordings in one CSV, TSV or TXT file with a header: a row per sample, the rows of a trial together.

    spec: keys of `TableSpec`. Columns of numbers that change within trials are taxels; columns that are constant within
    each trial are its conditions. With time stamps the sampling rate is theirs, unless it is given. Trials
    of a continuous recording are found by `segments` or `annotations`, and the condition `segment` numbers them.

    Raises InputError, which names the file, the line or the column, and the fix.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touches.csv"
    >>> _ = path.write_text("trial,gesture,speed,left,right\\n1,tap,5,0.1,0.2\\n1,tap,5,0.3,0.4\\n2,rub,5,0.5,0.4\\n")
    >>> touches = read(path, 100, "mV", {"label": "gesture"})
    >>> touches.channels, touches.lengths.tolist(), touches.conditions.values.tolist()
    (('left', 'right'), [2, 1], [['tap', 1, 5], ['rub', 2, 5]])
    """
    path = existing(path)
    layout = build(TableSpec, spec or {}, "import table")
    check_import(sampling_rate_Hz, unit, str(path))
    table = named_table(path, layout.decimal, layout.header_lines, option="header_lines", choice=CHOICE)
    names = [*table.names]
    roles = _roles(names, table.first_row, layout, find_time=sampling_rate_Hz is None or not layout.columns, path=path)
    roles = roles._replace(first_line=table.first_line)
    if sampling_rate_Hz is None and roles.time is None:
        raise InputError(f"{path}: the sampling rate is not known; give `sampling_rate_Hz`, or `time_column`")
    if layout.time_unit is not None and roles.time is None and layout.annotations is None:
        raise InputError(f"{path}: `time_unit`: the samples have no time stamps; leave it out")
    columns = columns_of(table, {roles.label, *roles.trial} & {*names})
    if roles.time is not None and roles.rest is None:
        its_unit = layout.time_unit or unit_of(table, names.index(roles.time), columns[roles.time])
        layout = layout.model_copy(update={"time_unit": its_unit})
    columns = _without_others(columns, table, roles)
    if layout.missing is not None:
        columns = {name: _with_gaps(table, name, values, roles) for name, values in columns.items()}
    clock = clock_of(columns, roles, layout, table)
    trials = find_trials(columns, roles, clock, layout, sampling_rate_Hz, path)
    _check_time(trials, layout, clock, path)
    taxels, conditions = _parted(columns, roles, trials, table)
    cut = [*_cut(columns, roles._replace(taxels=taxels), trials, clock, layout, table)]
    trial_of, kept = mended(cut, layout.missing, str(path))
    conditions = conditions.iloc[kept].reset_index(drop=True)
    read = sampled.recordings(
        trial_of, conditions, sampling_rate_Hz, unit,
        max_gap_ms=layout.max_gap_ms, drop_repeats=layout.drop_repeats, source=f"table {path.name}", where=str(path),
    )  # fmt: skip
    choice = layout.choice.with_label(roles.label).beyond(chosen_by(trials.conditions, layout))
    return chosen_trials(read, choice, str(path))


def _with_gaps(table: TextTable, name: str, values: np.ndarray, roles: Roles) -> np.ndarray:
    """A column of numbers and gaps as numbers, NaN for each gap; another column as it is."""
    if values.dtype.kind != "U" or name in (roles.label, *roles.trial, roles.time, roles.rest):
        return values
    whole = [cell for cell in values.tolist() if not is_gap(cell)]
    is_taxel = whole and all(map(is_meant_as_number, whole))
    return finite_called(table, name, {name: values}, with_gaps=True) if is_taxel else values


def _check_time(trials: Trials, spec: TableSpec, clock: Clock, path: Path) -> None:
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


def _without_others(columns: dict[str, np.ndarray], table: TextTable, roles: Roles) -> dict[str, np.ndarray]:
    """The columns without pandas' numbers of rows, the header of a ROS message, and what has no name."""
    used = (roles.label, *roles.trial, roles.time, roles.rest, *roles.taxels)
    others = [
        column for column, name in enumerate(table.names) if name not in used
        and (not name or ros.is_header(name) or is_index(table, column, columns[name]))
    ]  # fmt: skip
    read = [column for column in others if not is_index(table, column, columns[table.names[column]])]
    if read:
        named = [table.names[column] or f"column {column + 1}, which has no name" for column in read]
        log.warning("%s: no taxel and no condition: %s", table.path, some(named))
    return {name: values for column, (name, values) in enumerate(columns.items()) if column not in others}


def _cut(
    columns: Mapping[str, np.ndarray], roles: Roles, trials: Trials, clock: Clock, spec: TableSpec, table: TextTable
) -> Iterator[Read]:
    """The samples and the stamps of each trial."""
    gaps = spec.missing is not None
    taxels = [finite_called(table, name, columns, with_gaps=gaps) for name in roles.taxels]
    for samples in taxels:
        check_digits(samples[np.isfinite(samples)], table.path)
    signal = np.stack(taxels, axis=1).astype(np.float32)
    for begin, end, name in zip(trials.begin, trials.end, trials.names, strict=True):
        its_time = None if clock.time is None else clock.time[begin:end]
        if its_time is not None and spec.time_column is None:
            check_rises(its_time, roles.time or "", table.path)
        missing = np.isnan(signal[begin:end])
        its = Table(
            roles.taxels, signal[begin:end], its_time, int(begin) + table.first_line, clock.unit,
            missing=missing if missing.any() else None,
        )  # fmt: skip
        yield Read(f"{table.path}, {name}", name, its)


def _roles(names: list[str], first: Sequence[str], spec: TableSpec, *, find_time: bool, path: Path) -> Roles:
    if spec.annotations is not None:
        return _with_taxels(names, first, spec, "", (), find_time=find_time, path=path)
    label = spec.label or called(names, ALIASES[LABEL])
    trial_column = called(names, TRIALS)
    trial = spec.trial or ((trial_column,) if trial_column else ())
    for role, role_names in (("`label`", (label,) if label else ()), ("`trial`", trial)):
        for name in role_names:
            if name not in names:
                raise InputError(f"{path}: {role}: there is no column '{name[:40]}'; {nearest(name, names)}")
    shown = ", ".join(names[:12])
    if label is None:
        raise InputError(f"{path}: no column is called label ({shown}); name the class of a trial with `label`")
    if not trial and not spec.segments:
        raise InputError(
            f"{path}: no column is called trial ({shown}); name the columns that tell trials apart with `trial`, as in "
            f"`trial='subject,repetition'`, or take each stretch of one '{label}' as a trial with `segments=True`"
            f"{'' if any(map(TIME_COLUMN.match, names)) else f'; {FEATURES}'}"
        )
    return _with_taxels(names, first, spec, label, trial, find_time=find_time, path=path)


def _with_taxels(
    names: list[str], first: Sequence[str], spec: TableSpec, label: str, trial: tuple[str, ...], *,
    find_time: bool, path: Path,
) -> Roles:  # fmt: skip
    """The columns of these classes and trials, the time stamps and the taxels among the others."""
    chosen, time, rest = chosen_places(
        spec.columns, spec.time_column, tuple(names), first, path, find_time=find_time,
        others={
            "`label`": [names.index(label)] if label else [], "`trial`": [names.index(name) for name in trial],
        },
    )  # fmt: skip
    stamps = [None if column is None else names[column] for column in (time, rest)]
    return Roles(label, trial, stamps[0], tuple(names[column] for column in chosen), rest=stamps[1])


def _parted(
    columns: Mapping[str, np.ndarray], roles: Roles, trials: Trials, table: TextTable
) -> tuple[tuple[str, ...], pd.DataFrame]:
    """The names of the taxels, and the conditions of the trials; columns that are neither are named in a warning."""
    path = table.path
    used = (roles.label, *roles.trial, roles.time, roles.rest, *roles.taxels)
    others = [name for name in columns if name not in used]
    constant = [name for name in others if trials.are_constant(columns[name])]
    changing = [name for name in others if name not in constant]
    taxels = roles.taxels or tuple(name for name in changing if columns[name].dtype.kind in "iuf")
    ignored = [name for name in changing if name not in taxels]
    for name in [name for name in ignored if columns[name].dtype.kind == "U"]:
        if np.mean([is_meant_as_number(cell) for cell in columns[name].tolist()]) > FAULTS:
            finite_called(table, name, columns)  # says which cell is no number
    if not taxels:
        raise InputError(f"{path}: no column of numbers changes within a trial; name the taxels with `columns`")
    constant = [name for name in constant if name not in trials.conditions]
    if constant and not roles.taxels:
        log.warning(
            "%s: constant within each trial, so conditions and not taxels: %s; to change that, name the taxels with "
            "`columns`",
            path, some(constant),
        )  # fmt: skip
    if ignored:
        log.warning("%s: not used: %s", path, some(ignored))
    return taxels, trials.conditions.assign(**{name: values_of(columns[name][trials.begin]) for name in constant})
