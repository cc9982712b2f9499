"""Numbers from delimited text: every cell is a finite number, else the error names file, line and column."""

import csv
import io
import re
import warnings
from array import array
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd

from neurotact import files
from neurotact.data.readers.contents import LVM, content_of
from neurotact.errors import InputError

MAX_CHANNELS = 10_000
"""Maximum number of columns; a table with more is transposed, or is not a table."""
FLOAT32_MAX = float(np.finfo(np.float32).max)
SEPARATORS = (";", "\t", ",")
BYTES_PER_TEXT, BYTES_PER_CELL = 120, 24
"""Bytes in memory per cell of a table of texts, and of one that is mostly numbers."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NOT_FINITE = re.compile(r"[+-]?(nan|na|inf|infinity)", re.IGNORECASE)


def read_text(path: str | Path) -> str:
    """The file's text, its line ends as `\\n`, without a byte-order mark.

    InputError if it is not UTF-8 text, or holds another kind of data (`contents`).
    """
    kind = content_of(path)
    if kind not in (None, LVM):
        raise kind.refusal(path)
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


FIRST_LINE = 2
"""Line of the first row of a `NamedTable`, below the names of its columns."""


class NamedTable(NamedTuple):
    """A text table with a header: the names of its columns (empty: a separator ends each line), and its other lines."""

    path: Path
    names: list[str]
    separator: str
    body: str

    @property
    def first_row(self) -> list[str]:
        """The cells of the first line below the header."""
        return cells(self.body.partition("\n")[0], self.separator)


def named_table(path: Path) -> NamedTable:
    """The table of a file; InputError if its first line does not name the columns, or no line follows it."""
    head, _, body = read_text(path).partition("\n")
    separator = next((each for each in SEPARATORS if each in head), ",")
    names = cells(head, separator)
    names = names[:-1] if len(names) > 1 and not names[-1] else names
    first = cells(body.partition("\n")[0], separator)
    names += [""] if len(first) == len(names) + 1 and not first[-1] else []
    if not body.strip():
        raise InputError(f"{path}: holds no row below its header; give at least one")
    if len(set(names)) < len(names):
        raise InputError(f"{path}: line 1 names a column twice; give each its own name")
    if all(is_number(name) for name in names):
        raise InputError(f"{path}: line 1 holds numbers, but must name the columns, as in trial,time_s,label")
    return NamedTable(path, names, separator, body)


def called(names: Sequence[str], aliases: Sequence[str]) -> str | None:
    """The column that has the first of these names, in upper or lower case; None if there is none.

    >>> called(["a", "Class", "label"], ["label", "class"]), called(["a", "Class"], ["label", "class"])
    ('label', 'Class')
    """
    lower = {name.lower(): name for name in reversed(names)}
    return next((lower[alias] for alias in aliases if alias in lower), None)


def columns_of(
    table: NamedTable, texts: Collection[str] | None = None, decimal: Literal[".", ","] = "."
) -> dict[str, np.ndarray]:
    """The columns by their names. texts: those that are read as texts, all when None; others are numbers if all of
    their cells are, with this decimal separator.
    """
    if decimal == table.separator:
        raise InputError(
            f"{table.path}: has commas between its columns, so there are no decimal commas; drop --decimal"
        )
    n_cells = len(table.names) * (table.body.count("\n") + 1)
    files.check_size(table.path, n_cells * (BYTES_PER_TEXT if texts is None else BYTES_PER_CELL))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            found = pd.read_csv(
                io.StringIO(table.body), sep=table.separator, header=None, names=table.names, index_col=False,
                dtype=str if texts is None else dict.fromkeys(texts, "str"), keep_default_na=False, na_filter=False,
                skip_blank_lines=True, engine="c", on_bad_lines="error", low_memory=False, decimal=decimal,
            )  # fmt: skip
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        raise InputError(
            f"{table.path}: cannot be read as a table ({str(error).splitlines()[0][:100]}); repair that line"
        ) from error
    values = {name: found[name].to_numpy() for name in table.names if name}
    return {name: each if each.dtype.kind in "iuf" else each.astype(str) for name, each in values.items()}


def values_of(values: np.ndarray) -> np.ndarray:
    """Texts as numbers if all of them are numbers; anything else unchanged."""
    if values.dtype.kind in "OSU":
        texts = values.astype(str)
        numbers = pd.to_numeric(pd.Series(texts), errors="coerce").to_numpy()
        return texts if np.isnan(numbers.astype(float)).any() else numbers
    return values


def is_number(text: str) -> bool:
    """Whether a text reads as a number, NaN and infinity included."""
    try:
        float(text)
    except ValueError:
        return False
    return True
