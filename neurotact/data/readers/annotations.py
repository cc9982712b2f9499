"""A table of annotations: when each touch of a continuous recording begins and ends, its class and its conditions."""

import logging
import re
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.readers.arrays import ALIASES
from neurotact.data.readers.clock import UNIT_S, Unit, is_time_of_day, seconds_of, without_unit
from neurotact.data.readers.headings import named_table
from neurotact.data.readers.layout import unit_of
from neurotact.data.readers.tables import TextTable, called, columns_of, values_of
from neurotact.data.recordings import LABEL
from neurotact.errors import InputError, nearest, some

LABELS = (*ALIASES[LABEL], "trial_type", "annotation")
"""Names of the column of classes; `onset`, `duration` and `trial_type` are those of BIDS."""
BEGIN = re.compile(r"(begin|start|onset|from)([ _]?time)?", re.IGNORECASE)
END = re.compile(r"(end|stop|offset|to)([ _]?time)?", re.IGNORECASE)
DURATION = re.compile(r"duration|length", re.IGNORECASE)
ROUNDING = 1e-3
"""Share of a sample's interval by which a time may be off: 0.1 s and 0.2 s are a little more than 0.3 s."""

log = logging.getLogger("neurotact")


class Annotations(NamedTuple):
    """When each touch begins and ends, `(touch,)`, in this unit (None if the file does not say it), and what it is.

    first_line: the line of the first touch.
    """

    path: Path
    begin: np.ndarray
    end: np.ndarray
    unit: Unit | None
    conditions: pd.DataFrame
    first_line: int

    def on(self, time: np.ndarray, unit: Unit | None, where: str) -> tuple[np.ndarray, np.ndarray]:
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
            line = row + self.first_line
            raise InputError(
                f"{self.path}: line {line}: {begin[row]:.10g} to {end[row]:.10g} lies outside of {where}, "
                f"which goes from {time[0]:.10g} to {time[-1]:.10g}; give both times on one clock, with their "
                "units, as in begin_ms"
            )
        rounding = ROUNDING * (time[-1] - time[0]) / max(1, len(time) - 1)
        return np.searchsorted(time, begin - rounding), np.searchsorted(time, end - rounding)


def read(path: Path, label: str | None = None, decimal: Literal[".", ","] = ".") -> Annotations:
    """The annotations in a CSV or TSV file with a header: a row per touch.

    Columns: `begin` (or start, onset), `end` (or stop, offset) or `duration`, with or without a unit (`begin_ms`), and
    `label`, or the one that is named. All others are conditions.

    Raises InputError, which names the file, the line or the column, and the fix.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "events.tsv"
    >>> _ = path.write_text("onset\\tduration\\ttrial_type\\tforce\\n0.5\\t1.5\\ttap\\t3\\n4\\t1\\trub\\t6\\n")
    >>> found = read(path)
    >>> found.begin.tolist(), found.end.tolist(), found.conditions.values.tolist()
    ([0.5, 4.0], [2.0, 5.0], [['tap', 3], ['rub', 6]])
    >>> found.on(np.arange(0, 6, 0.5), "s", "touches.csv")
    (array([1, 8]), array([ 4, 10]))
    """
    table = named_table(path, decimal)
    names = [name for name in table.names if name]
    its_label = label or called(names, LABELS)
    if its_label not in names:
        hint = f"{nearest(label, names)}" if label else f"name it with `label`, of {some(names)}"
        raise InputError(f"{path}: there is no column of classes called {label or LABEL}; {hint}")
    begin, end = _named(BEGIN, names), _named(END, names) or _named(DURATION, names)
    if begin is None or end is None:
        absent = "begin" if begin is None else "end or duration"
        raise InputError(f"{path}: no column is called {absent} ({some(names)}); rename the columns to begin,end,label")
    columns = columns_of(table, {its_label})
    first, second = (_times(columns[name], name, table) for name in (begin, end))
    units: set[Unit | None] = {unit_of(table, table.names.index(name), np.zeros(0)) for name in (begin, end)}
    if len(units) > 1:
        raise InputError(f"{path}: columns {begin} and {end} are in different units; give both the same")
    last = first + second if _named(END, names) is None else second
    wrong = np.flatnonzero(last <= first)
    if len(wrong):
        raise InputError(f"{path}: line {wrong[0] + table.first_line} ends before it begins; correct its times")
    others = {name: values_of(columns[name]) for name in names if name not in (its_label, begin, end, LABEL)}
    is_of_day = columns[begin].dtype.kind == "U"
    unit: Unit | None = "s" if is_of_day else units.pop()
    conditions = pd.DataFrame({LABEL: columns[its_label], **others})
    return Annotations(path, first, last, unit, conditions, table.first_line)


def _named(pattern: re.Pattern[str], names: list[str]) -> str | None:
    return next((name for name in names if pattern.fullmatch(without_unit(name).strip())), None)


def _times(values: np.ndarray, name: str, table: TextTable) -> np.ndarray:
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
