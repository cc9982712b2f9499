"""Measurement files of LabVIEW as text (.lvm): their head says the separators, the interval and the units."""

import re
from pathlib import Path
from typing import NamedTuple, cast

from neurotact.data.readers.formats import Format
from neurotact.data.readers.formats.contents import LVM
from neurotact.data.readers.table.cells import Decimal, Table, lines_of
from neurotact.data.readers.table.texts import read_any_text
from neurotact.errors import InputError

END = "***End_of_Header***"
X_VALUE, COMMENT = "X_Value", "Comment"
"""Names of the first column, the times, and of the last one."""
SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}


class _Head(NamedTuple):
    """What stands above the samples: values by their keys, the names of the columns, the number of lines."""

    separator: str
    values: dict[str, list[str]]
    names: list[str]
    n_lines: int

    def first(self, key: str, default: str) -> str:
        """The first value of a key."""
        return next((value for value in self.values.get(key, []) if value), default)

    def number(self, key: str, path: Path) -> float | None:
        """The first value of a key as a number; None without one."""
        value = self.first(key, "")
        try:
            return float(value.replace(",", ".")) if value else None
        except ValueError as error:
            raise InputError(f"{path}: {key} is {value[:20]!r}, not a number; save it again") from error


def _read(path: Path) -> dict[str, Table]:
    """The table in a LabVIEW measurement: the times in the column X_Value, if the file has them or their interval.

    InputError for a file of several segments, for X values that are no times, and for times of each channel.
    """
    text, note = read_any_text(path)
    head = _head(text, path)
    mark = head.first("Decimal_Separator", ".")
    if mark not in (".", ","):
        raise InputError(f"{path}: names {mark!r} as its decimal separator; leave `decimal` out")
    if head.first("X_Dimension", "Time") != "Time":
        raise InputError(f"{path}: its X values are of {head.first('X_Dimension', '')[:20]!r}, no times; save samples")
    names = head.names[:-1] if head.names[-1] == COMMENT else head.names
    if names.count(X_VALUE) > 1:
        raise InputError(f"{path}: has the times of each channel; save it with one column of X values")
    units = ["s", *head.values.get("Y_Unit_Label", [])][: len(names)] if names[0] == X_VALUE else []
    rows, n_comments = _rows(text, head, len(names), path)
    if names[0] == X_VALUE and not any(row[0] for row in rows):
        start, interval = head.number("X0", path) or 0.0, head.number("Delta_X", path)
        if interval is None:
            names, units, rows = names[1:], units[1:], [row[1:] for row in rows]
        else:
            times = (repr(start + interval * number).replace(".", mark) for number in range(len(rows)))
            rows = [[time, *row[1:]] for time, row in zip(times, rows, strict=True)]
    said = f"comments of LabVIEW are not read ({n_comments} lines)" if n_comments else ""
    return {"": Table(
        path, tuple(names), head.separator, "\n".join(map(head.separator.join, rows)), len(names), head.n_lines + 1,
        cast(Decimal, mark), tuple(units) if len(units) == len(names) else (), notes=tuple(filter(None, (note, said))),
    )}  # fmt: skip


def _head(text: str, path: Path) -> _Head:
    """The head of the file and that of its only segment."""
    named = re.search(r"^Separator[\t,;](\w+)", text[: text.find(END)], re.MULTILINE)
    separator = SEPARATORS.get(named[1] if named else "Tab", "\t")
    values: dict[str, list[str]] = {}
    has_ended = False
    for number, line in enumerate(lines_of(text), 1):
        row = [cell.strip() for cell in line.split(separator)]
        has_ended |= row[0] == END
        if has_ended and (row[0] == X_VALUE or COMMENT in row):
            while row and not row[-1]:
                row.pop()
            return _Head(separator, values, row, number)
        values[row[0]] = row[1:]
    raise InputError(f"{path}: no line below {END} names the columns, from {X_VALUE} on; save it with column headings")


def _rows(text: str, head: _Head, n_columns: int, path: Path) -> tuple[list[list[str]], int]:
    """The cells of each row without comments, and the number of rows that have one."""
    rows, n_comments = [], 0
    for number, line in enumerate(lines_of(text.rstrip()), 1):
        if number <= head.n_lines:
            continue
        row = [cell.strip() for cell in line.split(head.separator)]
        if row[0] in (END, X_VALUE, "Channels"):
            raise InputError(f"{path}: line {number} begins a second segment; save each segment in a file of its own")
        n_comments += any(row[n_columns:])
        rows.append(row[:n_columns])
    return rows, n_comments


FORMAT = Format("a LabVIEW measurement", "save it again", _read, contents=(LVM,))
