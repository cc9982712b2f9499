"""One text table with the samples of all trials: a row per sample, with the trial and the class that it belongs to."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, field_validator

from neurotact.data.readers import sampled
from neurotact.data.readers.arrays import ALIASES
from neurotact.data.readers.clock import Unit, is_time_of_day, seconds_of, unit_in
from neurotact.data.readers.layout import DECIMAL_COMMA, Table, check_rises, chosen_places
from neurotact.data.readers.sampled import Read
from neurotact.data.readers.tables import FLOAT32_MAX, columns_of, is_number, named_table, values_of
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing
from neurotact.spec import Spec, build

TRIALS = ("trial", "trials", "trial_id", "recording", "recordings", "recording_id", "touch", "touch_id", "sequence_id")
"""Names of the column that tells trials apart."""
FIRST_LINE = 2
"""Line of the first sample, below the names of the columns."""

log = logging.getLogger("neurotact")


class TableSpec(Spec):
    """What the columns are."""

    label: str | None = None
    """The class of each sample's trial; when absent, a column called label, class, y or target."""
    trial: tuple[str, ...] = ()
    """The columns that tell trials apart; when absent, one called trial, recording or touch."""
    columns: tuple[str, ...] = ()
    """The taxels, by names or by numbers; all columns of numbers that change within a trial when absent."""
    time_column: str | None = None
    """The time stamps; when absent, the first column whose name says so."""
    time_unit: Unit | None = None
    """Their unit; when absent, that at the end of the column's name, else the one that fits touch."""
    max_gap_ms: float | None = Field(default=None, gt=0)
    """The longest interval between stamps; five median ones when absent."""
    decimal: Literal[".", ","] = "."

    @field_validator("columns", "trial", mode="before")
    @classmethod
    def _apart(cls, names: Any) -> Any:
        return tuple(part.strip() for part in names.split(",")) if isinstance(names, str) else names


class _Roles(NamedTuple):
    """The names of the columns: class, trial, time stamps (None without), and the chosen taxels (none: all others)."""

    label: str
    trial: tuple[str, ...]
    time: str | None
    taxels: tuple[str, ...]


class _Trials(NamedTuple):
    """Where each trial begins, `(trial,)`, and where it ends."""

    begin: np.ndarray
    end: np.ndarray

    def are_constant(self, values: np.ndarray) -> bool:
        """Whether a column has one value within each trial."""
        changes = np.flatnonzero(values[1:] != values[:-1]) + 1
        return bool(np.isin(changes, self.begin).all())


def read(
    path: str | Path, sampling_rate_Hz: float | None = None, unit: str = "", spec: Mapping[str, Any] | None = None
) -> Recordings:
    """The recordings in one CSV, TSV or TXT file with a header: a row per sample, the rows of a trial together.

    spec: keys of `TableSpec`. Columns of numbers that change within trials are taxels; columns that are constant within
    each trial are its conditions. With time stamps the sampling rate is theirs, unless it is given.

    Raises InputError, which names the file, the line or the column, and the fix.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touches.csv"
    >>> _ = path.write_text("trial,gesture,speed,left,right\\n1,tap,5,0.1,0.2\\n1,tap,5,0.3,0.4\\n2,rub,5,0.5,0.4\\n")
    >>> touches = read(path, 100, "mV", {"label": "gesture"})
    >>> touches.channels, touches.lengths.tolist(), touches.conditions.values.tolist()
    (('left', 'right'), [2, 1], [['tap', 1, 5], ['rub', 2, 5]])
    """
    path = existing(path)
    asked = build(TableSpec, spec or {}, "import table")
    check_import(sampling_rate_Hz, unit, str(path))
    table = named_table(path)
    names = [name for name in table.names if name]
    first = [cell for cell, name in zip_longest(table.first_row, table.names, fillvalue="") if name]
    roles = _roles(names, first, asked, find_time=sampling_rate_Hz is None or not asked.columns, path=path)
    if sampling_rate_Hz is None and roles.time is None:
        raise InputError(f"{path}: the sampling rate is not known; give --sampling-rate-Hz, or --time-column")
    columns = columns_of(table, {roles.label, *roles.trial}, asked.decimal)
    trials = _trials(columns, roles, path)
    taxels, conditions = _parted(columns, roles, trials, path)
    return sampled.recordings(
        [*_cut(columns, roles._replace(taxels=taxels), trials, asked, path)], conditions, sampling_rate_Hz, unit,
        max_gap_ms=asked.max_gap_ms, source=f"table {path.name}", where=str(path),
    )  # fmt: skip


def _cut(
    columns: Mapping[str, np.ndarray], roles: _Roles, trials: _Trials, asked: TableSpec, path: Path
) -> Iterator[Read]:
    """The samples and the stamps of each trial."""
    signal = np.stack([_numbers(columns[name], name, path) for name in roles.taxels], axis=1).astype(np.float32)
    time = None if roles.time is None else _stamps(columns[roles.time], roles.time, path)
    unit = asked.time_unit or unit_in(roles.time or "")
    for begin, end in zip(*trials, strict=True):
        its_time = None if time is None else time[begin:end]
        if its_time is not None and its_time.dtype.kind == "U":
            its_time = seconds_of(its_time.tolist(), str(path), roles.time or "", begin + FIRST_LINE, asked.time_unit)
            unit = "s"
        if its_time is not None and asked.time_column is None:
            check_rises(its_time, roles.time or "", path)
        name = " ".join(str(columns[key][begin]) for key in roles.trial)
        its = Table(roles.taxels, signal[begin:end], its_time, int(begin) + FIRST_LINE, unit)
        yield Read(f"{path}, trial {name}", name, its)


def _roles(names: list[str], first: Sequence[str], asked: TableSpec, *, find_time: bool, path: Path) -> _Roles:
    lower = {name.lower(): name for name in reversed(names)}
    label = asked.label or next((lower[alias] for alias in ALIASES[LABEL] if alias in lower), None)
    trial = asked.trial or tuple(lower[alias] for alias in TRIALS if alias in lower)[:1]
    for role, each in (("--label", (label,) if label else ()), ("--trial", trial)):
        for name in each:
            if name not in names:
                raise InputError(f"{path}: {role}: there is no column '{name[:40]}'; {nearest(name, names)}")
    shown = ", ".join(names[:12])
    if label is None:
        raise InputError(f"{path}: no column is called label ({shown}); name the class of a trial with --label")
    if not trial:
        raise InputError(
            f"{path}: no column is called trial ({shown}); name the columns that tell trials apart with --trial, as in "
            "--trial subject,repetition"
        )
    chosen, time = chosen_places(
        asked.columns, asked.time_column, tuple(names), first, path, find_time=find_time,
        others={"--label": [names.index(label)], "--trial": [names.index(name) for name in trial]},
    )  # fmt: skip
    return _Roles(label, trial, None if time is None else names[time], tuple(names[at] for at in chosen))


def _trials(columns: Mapping[str, np.ndarray], roles: _Roles, path: Path) -> _Trials:
    """The trials: rows one after another with the same values in the columns that tell trials apart."""
    keys = pd.DataFrame({name: columns[name] for name in roles.trial})
    begin = np.flatnonzero((keys != keys.shift()).any(axis=1).to_numpy())
    trials = _Trials(begin, np.append(begin[1:], len(keys)))
    firsts = keys.iloc[begin]
    again = np.flatnonzero(firsts.duplicated().to_numpy())
    if len(again):
        name = " ".join(firsts.iloc[again[0]])
        raise InputError(
            f"{path}: trial {name[:40]} begins again at line {begin[again[0]] + FIRST_LINE}; if trials are numbered "
            f"anew for each class or subject, name all columns that tell them apart, as in --trial "
            f"{roles.label},{','.join(roles.trial)}; else sort the rows by trial"
        )
    if not trials.are_constant(columns[roles.label]):
        raise InputError(
            f"{path}: '{roles.label}' changes within a trial; give each trial one class, or name all columns that tell "
            f"trials apart, as in --trial {roles.label},{','.join(roles.trial)}"
        )
    return trials


def _parted(
    columns: Mapping[str, np.ndarray], roles: _Roles, trials: _Trials, path: Path
) -> tuple[tuple[str, ...], pd.DataFrame]:
    """The names of the taxels, and the conditions of the trials; columns that are neither are named in a warning."""
    others = [name for name in columns if name not in (roles.label, *roles.trial, roles.time, *roles.taxels)]
    constant = [name for name in others if trials.are_constant(columns[name])]
    changing = [name for name in others if name not in constant]
    taxels = roles.taxels or tuple(name for name in changing if columns[name].dtype.kind in "iuf")
    ignored = [name for name in changing if name not in taxels]
    commas = [name for name in (*ignored, *taxels) if DECIMAL_COMMA.fullmatch(str(columns[name][0]))]
    if commas:
        raise InputError(f"{path}: column {commas[0]} has decimal commas; pass --decimal , or write decimal points")
    if not taxels:
        raise InputError(f"{path}: no column of numbers changes within a trial; name the taxels with --columns")
    if constant and not roles.taxels:
        log.warning(
            "%s: constant within each trial, so conditions and not taxels: %s; to change that, name the taxels with "
            "--columns",
            path, some(constant),
        )  # fmt: skip
    if ignored:
        log.warning("%s: not used: %s", path, some(ignored))
    table = pd.DataFrame({LABEL: columns[roles.label][trials.begin]})
    for name in (*roles.trial, *constant):
        if name not in (roles.label, LABEL):
            table[name] = values_of(columns[name][trials.begin])
    return taxels, table


def _stamps(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    """A column of time stamps: finite numbers, or the texts of times of day."""
    is_of_day = values.dtype.kind == "U" and is_time_of_day(str(values[0]))
    return values if is_of_day else _numbers(values, name, path)


def _numbers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    """A column of finite numbers; InputError with the line of the first cell that is none."""
    if values.dtype.kind not in "iuf":
        at = next((row for row, cell in enumerate(values) if not is_number(cell)), None)
        if at is not None:
            raise InputError(
                f"{path}: line {at + FIRST_LINE}, column {name} is {values[at][:20]!r}, not a number; write a number, "
                "or name the taxels with --columns"
            )
    found = values.astype(np.float64)
    wrong = np.flatnonzero(~(np.abs(found) <= FLOAT32_MAX))
    if len(wrong):
        line = wrong[0] + FIRST_LINE
        raise InputError(f"{path}: line {line}, column {name} is {found[wrong[0]]}; repair the gap or drop the trial")
    return found
