"""Numbers from delimited text: every cell is a finite number, else the error names file, line and column."""

import csv
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact import files
from neurotact.errors import InputError

MAX_CHANNELS = 10_000
"""Maximum number of columns; a table with more is transposed, or is not a table."""
FLOAT32_MAX = float(np.finfo(np.float32).max)
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NOT_FINITE = re.compile(r"[+-]?(nan|na|inf|infinity)", re.IGNORECASE)


def read_text(path: str | Path) -> str:
    """The file's text, its line ends as `\\n`, without a byte-order mark; InputError if it is not UTF-8 text."""
    return files.read_text(path).replace("\r\n", "\n").replace("\r", "\n")


def split_header(text: str, path: str | Path) -> tuple[str, str]:
    """The first line and the rest of a published file, in which every line ends with a line break.

    InputError when the last line does not end: the file was cut off, and its last number may be too.
    """
    if not text.endswith("\n"):
        raise InputError(f"{path}: the last line does not end, so the file was cut off; copy or download it again")
    head, _, body = text.partition("\n")
    return head, body


def cells(line: str, separator: str = ",") -> list[str]:
    """The cells of one line, without quotes and surrounding spaces; after MAX_CHANNELS cells the rest is one cell.

    >>> cells('time, "felt, left",3')
    ['time', 'felt, left', '3']
    """
    if line.count(separator) > MAX_CHANNELS:
        return [cell.strip() for cell in line.split(separator, MAX_CHANNELS)]
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
    except csv.Error:
        row = line.split(separator)
    return [cell.strip() for cell in row]


def is_value(cell: str) -> bool:
    """Whether a cell holds a number (NaN and infinity included) and so is not a column name."""
    return bool(NUMBER.fullmatch(cell) or NOT_FINITE.fullmatch(cell))


def numbers(
    text: str,
    path: str | Path,
    *,
    separator: str = ",",
    first_line: int = 1,
    names: Sequence[str] = (),
    width: int = 0,
    columns: Sequence[int] | None = None,
) -> np.ndarray:
    """The `(row, column)` float64 table in `text`, each value finite and within the range of float32.

    first_line: the file's line on which `text` begins. names: of the columns. width: number of columns; that of
    the names when 0, and that of the first row if there are none. columns: indices of the columns to read; the content
    of the others is ignored, and they are 0. Empty lines are allowed only at the end. InputError names `path`,
    line and column, and refuses a table that is too wide or takes too much memory.

    >>> numbers("1,2\\n3,4\\n", "a.csv")
    array([[1., 2.],
           [3., 4.]])
    >>> numbers("1,2\\n3,x\\n", "a.csv", names=["left", "right"])
    Traceback (most recent call last):
    neurotact.errors.InputError: a.csv: line 2, column 2 (right) is 'x', not a number; write a number or drop the file
    """
    body = text.rstrip("\n")
    if not body:
        raise InputError(f"{path}: holds no row of numbers; record it again or drop the file")
    first_end = body.find("\n") if "\n" in body else len(body)
    check_width(path, body.count(separator, 0, first_end) + 1)
    files.check_size(path, 8 * (body.count(separator) + body.count("\n") + 1))
    values = _parse_at_once(body, separator)
    width = width or len(names)
    right_width = values is not None and width in (0, values.shape[1])
    if values is None or not right_width or not (np.abs(values) <= FLOAT32_MAX).all():
        return _parse_by_cell(body, path, separator, first_line, names, width, columns)
    return values


def check_width(where: str | Path, n_channels: int) -> None:
    """Refuse a table with more than `MAX_CHANNELS` columns; `where` begins the message."""
    if n_channels > MAX_CHANNELS:
        raise InputError(
            f"{where}: has {n_channels} columns, more than {MAX_CHANNELS} taxels; "
            "give one row per sample and one column per taxel"
        )


def _parse_at_once(body: str, separator: str) -> np.ndarray | None:
    """The table by pandas' C parser; None if `_parse_by_cell` must check it."""
    encoded = body.encode()
    if encoded.translate(None, b"0123456789+-.eE \n" + separator.encode()):
        return None  # other characters: the C parser would take 'true' for 1 and end a cell at a NUL
    try:
        table = pd.read_csv(
            io.BytesIO(encoded),
            sep=separator,
            header=None,
            dtype="float64",
            skip_blank_lines=False,
            quoting=csv.QUOTE_NONE,
            engine="c",
        )
    except (ValueError, OverflowError):
        return None
    return table.to_numpy()


def _parse_by_cell(
    body: str,
    path: str | Path,
    separator: str,
    first_line: int,
    names: Sequence[str],
    width: int = 0,
    columns: Sequence[int] | None = None,
) -> np.ndarray:
    """The definition of a valid table; `_parse_at_once` is the same, faster, for tables without a fault."""
    values = array("d")
    width = width or len(names)
    is_read = None if columns is None else set(columns)
    for line_number, line in enumerate(_lines(body), first_line):
        row = cells(line, separator)
        width = width or len(row)
        if not any(row):
            raise InputError(f"{path}: line {line_number} is empty; remove the line or drop the file")
        if len(row) != width:
            raise InputError(
                f"{path}: line {line_number} has {len(row)} columns where {width} are expected; "
                "give every line the same columns or drop the file"
            )
        for column, cell in enumerate(row):
            if is_read is not None and column not in is_read:
                row[column] = "0"
            elif not (NUMBER.fullmatch(cell) and abs(float(cell)) <= FLOAT32_MAX):
                name = f" ({names[column]})" if names else ""
                raise InputError(f"{path}: line {line_number}, column {column + 1}{name} {_fault(cell)}")
        values.extend(map(float, row))
    return np.array(values).reshape(-1, width)


def _lines(text: str) -> Iterator[str]:
    """Each line, without a list of all of them."""
    start = 0
    while (end := text.find("\n", start)) >= 0:
        yield text[start:end]
        start = end + 1
    yield text[start:]


def _fault(cell: str) -> str:
    if not cell:
        return "is empty; write a number or drop the file"
    if NOT_FINITE.fullmatch(cell):
        return f"is {cell}; repair the gap or drop the file"
    if NUMBER.fullmatch(cell):
        return f"is {cell[:20]}, more than float32 holds; use another unit"
    return f"is {cell[:20]!r}, not a number; write a number or drop the file"
