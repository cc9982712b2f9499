"""The layout of the columns of a text file, and the reader of one file: taxels and, if any, time stamps."""

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from neurotact.data.readers.clock import Unit, is_time_of_day, seconds_of, unit_in
from neurotact.data.readers.tables import SEPARATORS, cells, check_width, is_value, numbers, read_text
from neurotact.errors import InputError, nearest
from neurotact.spec import Spec

TIME_COLUMN = re.compile(r"(times?|timestamps?|ts?|elapsed|seconds|millis|micros)(?![a-z0-9])", re.IGNORECASE)
"""The beginning of a name that time stamps have."""
FALLING = 0.1
"""Share of the intervals that may be negative in a column that is named like time stamps."""
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
RANGE = re.compile(r"(\d+)(?:-(\d+))?", re.ASCII)


class LayoutSpec(Spec):
    """The columns of each text file, counted from 1, including the time column; or the array of each file of arrays."""

    columns: tuple[str, ...] = ()
    """The taxels, by names or by numbers (`1-5`); all but the time column when absent."""
    time_column: str | None = None
    """The name or the number of the column of time stamps; when absent, the first one whose name says so, or that holds
    times of day. In a file of arrays, the name of the array of stamps."""
    time_unit: Unit | None = None
    """Unit of the stamps; when absent, that at the end of the column's name (`t_ms`), else the one that fits touch."""
    max_gap_ms: float | None = Field(default=None, gt=0)
    """The longest interval between stamps; five median ones when absent."""
    decimal: Literal[".", ","] = "."
    header_lines: int | None = Field(default=None, ge=0, le=10_000)
    """Lines before the first sample; the last of them names the columns if it has as many cells. When absent, the lines
    that begin with `#`, and a first line without a single number."""
    array: str | None = None
    """The array of each NPZ or MATLAB file that is its trial; when absent, each array is a trial."""
    transpose: bool = False
    """Whether arrays are (taxel, time)."""

    @field_validator("columns", mode="before")
    @classmethod
    def _apart(cls, columns: Any) -> Any:
        return tuple(part.strip() for part in columns.split(",")) if isinstance(columns, str) else columns


class Table(NamedTuple):
    """One file: the taxels' names (none without a header), their samples, the time stamps, the first sample's line.

    time_unit: of the stamps, as asked for or as their column is named; None if neither says it.
    """

    names: tuple[str, ...]
    signal: np.ndarray
    time: np.ndarray | None
    first_line: int
    time_unit: Unit | None = None


class _Columns(NamedTuple):
    """The columns of a file: all names (none without a header), the indices of the taxels, and that of the time."""

    names: tuple[str, ...]
    taxels: list[int]
    time: int | None


def read_table(path: Path, layout: LayoutSpec, *, find_time: bool = True) -> Table:
    """The samples of a CSV file and their stamps, if the layout names a time column or the file has one by its name.

    find_time: whether a column that the layout does not name may be the time. Columns are separated by `;`, by tabs or
    by commas, whichever the first line has; a separator at the end of each line is ignored. Raises InputError, which
    names the file, the line and column, and the fix.
    """
    text = read_text(path)
    head, body, first_line = _parted(text, path, layout)
    if not body.strip("\n"):
        raise InputError(f"{path}: holds no row of numbers; record it again or drop the file")
    first_row = body.partition("\n")[0]
    separator = next((each for each in SEPARATORS if each in first_row), ",")
    if layout.decimal == "," and separator == ",":
        raise InputError(f"{path}: has commas between its columns, so there are no decimal commas; drop --decimal")
    first = cells(first_row, separator)
    names, n_columns = _names_of(head, first, separator, layout)
    check_width(path, n_columns)
    if len(first) == n_columns + 1 and not first[-1]:
        body = re.sub(rf"{separator}[ \t]*$" if separator != "\t" else r"\t *$", "", body, flags=re.MULTILINE)
    columns = _columns_of(names, [*first, *[""] * n_columns][:n_columns], layout, path, find_time)
    times, body = _times_of_day(body, columns.time, separator, path, first_line, layout.time_unit)
    if layout.decimal == ",":
        _check_points(body, path)
        body = body.replace(",", ".")
    elif separator != "," and any(map(DECIMAL_COMMA.fullmatch, first)):
        raise InputError(f"{path}: line {first_line} has decimal commas; pass --decimal , or write decimal points")
    chosen = [*columns.taxels, *([] if columns.time is None else [columns.time])]
    values = numbers(
        body, path, separator=separator, first_line=first_line, names=names, width=n_columns,
        columns=None if sorted(chosen) == list(range(n_columns)) else chosen,
    )  # fmt: skip
    taxels = tuple(names[i] for i in columns.taxels) if names else ()
    signal = values[:, columns.taxels].astype(np.float32)
    if columns.time is None or times is not None:
        return Table(taxels, signal, times, first_line, "s" if times is not None else None)
    time = values[:, columns.time]
    if layout.time_column is None:
        check_rises(time, names[columns.time], path)
    named = unit_in(names[columns.time]) if names else None
    return Table(taxels, signal, time, first_line, layout.time_unit or named)


def _times_of_day(
    body: str, place: int | None, separator: str, path: Path, first_line: int, unit: Unit | None
) -> tuple[np.ndarray | None, str]:
    """The seconds of a column of times of day, and the lines with 0 in its place; None and the lines if it is none."""
    first = cells(body.partition("\n")[0], separator)
    if place is None or len(first) <= place or not is_time_of_day(first[place]):
        return None, body
    stamps, lines = [], body.rstrip("\n").split("\n")
    for at, line in enumerate(lines):
        row = cells(line, separator)
        stamps.append(row[place] if place < len(row) else "")
        lines[at] = separator.join([*row[:place], "0", *row[place + 1 :]])
    return seconds_of(stamps, str(path), str(place + 1), first_line, unit), "\n".join(lines)


def _names_of(head: str, first: list[str], separator: str, layout: LayoutSpec) -> tuple[tuple[str, ...], int]:
    """The names of the columns (none if one has no name), and the number of columns.

    first: the cells of the first row of numbers.
    """
    header = cells(head.rstrip("\n"), separator) if head else []
    if layout.header_lines is not None and len(_named(header)) != len(_named(first)):
        header = []
    n_columns = len(_named(header or first))
    return (tuple(header[:n_columns]) if all(header[:n_columns]) else ()), n_columns


def is_text(name: str) -> bool:
    """Whether a name is UTF-8 without control characters, which tables and figures cannot show."""
    return not any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name)


def _parted(text: str, path: Path, layout: LayoutSpec) -> tuple[str, str, int]:
    """The line that names the columns (empty if none does), the lines of samples, and the number of the first one."""
    if layout.header_lines is not None:
        before, body = _skip(text, layout.header_lines)
        head = before.rstrip("\n").rpartition("\n")[2]
        return head, body, layout.header_lines + 1
    n_comments = 0
    while text.startswith("#"):
        text = text.partition("\n")[2]
        n_comments += 1
    head, _, body = text.partition("\n")
    separator = next((each for each in SEPARATORS if each in head), ",")
    row = cells(head, separator)
    filled = _named(row)
    is_header = all(cell and not is_value(cell) and not DECIMAL_COMMA.fullmatch(cell) for cell in filled)
    if is_header:
        return head, body, n_comments + 2
    _check_not_numbered(filled, path)
    return "", text, n_comments + 1


def _skip(text: str, n_lines: int) -> tuple[str, str]:
    at = 0
    for _ in range(n_lines):
        end = text.find("\n", at)
        if end < 0:
            return text, ""
        at = end + 1
    return text[:at], text[at:]


def _named(row: list[str]) -> list[str]:
    """The cells of a row; a separator at its end adds no cell."""
    return row[:-1] if len(row) > 1 and not row[-1] else row


def _columns_of(
    names: tuple[str, ...], first: Sequence[str], layout: LayoutSpec, path: Path, find_time: bool
) -> _Columns:
    seen: set[str] = set()
    for column, name in enumerate(names, 1):
        if name in seen:
            raise InputError(f"{path}: two columns are named '{name[:40]}'; give each taxel its own name")
        if not is_text(name):
            raise InputError(f"{path}: column {column}, {name[:40]!a}, has control characters; rename it")
        seen.add(name)
    chosen, time = chosen_places(layout.columns, layout.time_column, names, first, path, find_time=find_time)
    taxels = chosen or [place for place in range(len(first)) if place != time]
    if not taxels:
        raise InputError(f"{path}: has no column besides the time; record at least one taxel")
    second = None if chosen else _time_place(names, first, [time])
    if second is not None:
        named = f" ('{names[second][:40]}')" if names else ""
        raise InputError(
            f"{path}: column {second + 1}{named} looks like time stamps but is not the time column; choose the taxels "
            "with --columns, or remove the column"
        )
    return _Columns(names, taxels, time)


def chosen_places(
    columns: Sequence[str],
    time_column: str | None,
    names: tuple[str, ...],
    first: Sequence[str],
    path: Path,
    *,
    find_time: bool,
    others: Mapping[str, Sequence[int]] = {},
) -> tuple[list[int], int | None]:
    """The places of the taxels that are asked for (none: all others), and of the time stamps (None: there are none).

    first: the cells of the first row. find_time: whether a column that only looks like time stamps may be the time.
    others: the places of columns that are neither, by the option that names them.
    Raises InputError for a column that is named twice.
    """
    used = [place for those in others.values() for place in those]
    chosen = [place for asked in columns for place in _places(asked, names, len(first), "--columns", path)]
    time = None
    if time_column is not None:
        (time,) = _places(time_column, names, len(first), "--time-column", path) or [None]
    elif find_time:
        time = _time_place(names, first, [*used, *chosen])
    named = [*chosen, *([] if time is None else [time])]
    if len({*named}) < len(named) or {*named} & {*used}:
        *options, last = ("--columns", "--time-column", *others)
        raise InputError(f"{path}: {', '.join(options)} and {last} name a column twice; name each once")
    return chosen, time


def _time_place(names: Sequence[str], first: Sequence[str], others: Collection[int | None]) -> int | None:
    """The place of the first column that is named like time stamps, else of the first one that holds times of day.

    first: the cells of the first row. None if there is no such column beside `others`.

    >>> _time_place(["n", "Time [us]", "t1"], [], []), _time_place(["t", "taxel"], [], [0])
    (1, None)
    >>> _time_place([], ["0.5", "12:00:00.25"], [])
    1
    """
    named = (at for at, name in enumerate(names) if TIME_COLUMN.match(name))
    timed = (at for at, cell in enumerate(first) if is_time_of_day(cell))
    return next((at for at in (*named, *timed) if at not in others), None)


def check_rises(time: np.ndarray, name: str, path: Path) -> None:
    """Refuse stamps that only the name of their column shows, if they often fall: `T` may be a temperature."""
    if len(time) > 1 and (np.diff(time) < 0).mean() > FALLING:
        raise InputError(
            f"{path}: column '{name[:40]}' is named like time stamps, but its values fall; choose the taxels with "
            "--columns, or the time with --time-column"
        )


def _places(asked: str, names: tuple[str, ...], n_columns: int, option: str, path: Path) -> list[int]:
    """The columns that a name, a number, or a range of numbers or of names stands for."""
    if asked in names:
        return [names.index(asked)]
    ends = next(((asked[:at], asked[at + 1 :]) for at, mark in enumerate(asked) if mark == "-"
                 and asked[:at] in names and asked[at + 1 :] in names), None)  # fmt: skip
    match = RANGE.fullmatch(asked)
    if ends is not None and option == "--columns":
        first, last = (names.index(end) for end in ends)
        return list(range(min(first, last), max(first, last) + 1))
    if match is None:
        hint = nearest(asked, list(names)) if names else "the file names no columns, so give a number"
        raise InputError(f"{path}: {option}: there is no column '{asked[:40]}'; {hint}")
    first = int(match[1])
    last = int(match[2] or first)
    if not 1 <= first <= last <= n_columns or (option == "--time-column" and last > first):
        raise InputError(
            f"{path}: {option} {asked}: this file has {n_columns} columns, numbered from 1; name columns that it has, "
            "or move it away if it is from another sensor"
        )
    return list(range(first - 1, last))


def _check_points(body: str, path: Path) -> None:
    at = body.find(".")
    if at >= 0:
        line = body.count("\n", 0, at) + 1
        raise InputError(f"{path}: sample {line} holds a point, but commas are decimal; write all numbers one way")


def _check_not_numbered(first: list[str], path: Path) -> None:
    if len(first) > 2 and first == [str(i) for i in range(len(first))]:
        raise InputError(
            f"{path}: line 1 counts 0 to {len(first) - 1}, which looks like column numbers, not a sample; "
            "name the taxels or remove the line (pandas: to_csv(header=False))"
        )
