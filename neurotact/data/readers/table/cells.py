"""Delimited text as columns: numbers where all cells are numbers, else texts; a fault is named by line and column."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from neurotact import files
from neurotact.errors import InputError, number_of, some
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


SIGNS = ".,'\u2019`\u00b4\u00b7\u02d9_ \u00a0\u2007\u2008\u2009\u200a\u202f\u066c"
"""Signs that separate thousands: points, commas, apostrophes, underscores and blanks of any width."""
THOUSANDS = re.compile(
    rf"[+-]?(\d{{1,3}}([{SIGNS}])\d{{3}}(\2\d{{3}})*|\d{{1,2}}([{SIGNS}])\d{{2}}(\4\d{{2}})*\4\d{{3}})([.,]\d*)?",
    re.ASCII,
)
"""A number with signs between its thousands, those of India included; `1.234` is one, too."""
CUT, END = re.compile(r"[+-]?\d{1,3}", re.ASCII), re.compile(r"\d{2,3}([.,]\d*)?", re.ASCII)
"""A number that ends at a separator of thousands, and what stands after it."""
NUMBER_OF_ANY_SIGN = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
LOOKED_AT = 1000
"""Values of a column that tell at once that most columns have no separators of thousands."""
NEAR_IN_FLOAT32 = 0.05
"""Error of a thousandth of a number below 1000 in float32."""

Grouping = Literal["no", "perhaps", "yes"]


def grouping_of(cells: Iterable[str], mark: str) -> Grouping:
    """Whether `mark` separates the thousands in the cells of a column.

    It does not if a number has another number of digits after it, begins with a zero, or has four digits without it.
    It does if another number has no mark, but for zero: a program that writes decimals writes them in all numbers, or
    leaves out zeros at their end.

    >>> grouping_of(["1.234", "850"], "."), grouping_of(["1.234", "850.5"], "."), grouping_of(["1.234", "2.000"], ".")
    ('yes', 'no', 'perhaps')
    """
    marked, repeated = _marked(mark)
    n_marked = n_plain = n_zeros = n_sure = n_ends = 0
    for cell in cells:
        if marked.fullmatch(cell):
            n_marked += 1
            n_ends += cell.endswith("0")
        elif CUT.fullmatch(cell):
            is_zero = not cell.strip("+-0")
            n_zeros += is_zero
            n_plain += not is_zero
        elif repeated.fullmatch(cell):
            n_sure += 1
        elif NUMBER_OF_ANY_SIGN.fullmatch(cell):
            return "no"
    if n_sure or (n_marked and (n_plain or (n_zeros and n_ends))):
        return "yes"
    return "perhaps" if n_marked else "no"


def has_decimal_commas(columns: Iterable[Sequence[str]], separator: str = "") -> bool:
    """Whether commas in numbers are surely decimal, in columns that something else separates; no number has a point.

    Between blanks, a comma at the beginning of a number may be a separator, too.

    >>> has_decimal_commas([["1", "2"], ["0,5", "1,5"]]), has_decimal_commas([["1,234"]]), has_decimal_commas([["1.5"]])
    (True, False, False)
    >>> has_decimal_commas([["5"], [",15"]], ";"), has_decimal_commas([["5"], [",15"]], BLANKS)
    (True, False)
    """
    found = set[Grouping]()
    for column in columns:
        if any("." in cell and NUMBER.fullmatch(cell) for cell in column):
            return False
        marked = filter(DECIMAL_COMMA.fullmatch, column)
        if any(separator != BLANKS or not cell.startswith(",") for cell in marked):
            found.add(grouping_of(column, ","))
    return "no" in found and "yes" not in found


@lru_cache
def _marked(mark: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Numbers with one mark, and those with several marks or with decimals."""
    sign = re.escape(mark)
    one = re.compile(rf"[+-]?[1-9]\d{{0,2}}{sign}\d{{3}}", re.ASCII)
    more = rf"({sign}\d{{3}}){{2,}}([.,]\d*)?|({sign}\d{{3}})+[{'.' if mark == ',' else ','}]\d*"
    return one, re.compile(rf"[+-]?[1-9]\d{{0,2}}({more})", re.ASCII)


def splits_thousands(row: Sequence[str], n_columns: int) -> bool:
    """Whether the cells of a row may be those of `n_columns` numbers, cut at their separators of thousands."""
    n_ends = sum(bool(CUT.fullmatch(before) and END.fullmatch(after)) for before, after in pairwise(row))
    return n_ends >= len(row) - n_columns > 0


def _may_be_grouped(values: np.ndarray) -> bool:
    """Whether numbers may be whole ones of which a separator of thousands made decimals: below 1000, none between 0
    and 1, with three decimals at most.
    """
    for part in (values[:LOOKED_AT], values):
        size = np.abs(part)
        if not ((size < 1000) & ((size >= 1) | (size == 0))).all() or not has_decimals(size, 3).all():
            return False
    return len(values) > 0


def has_decimals(size: np.ndarray, decimals: int, near: float = 1e-6) -> np.ndarray:
    """Of each number below 1000, whether it has so many decimals at most, to `near` of the last one."""
    scaled = size * 10.0**decimals
    return np.abs(scaled - np.rint(scaled)) < near


def _telling(values: np.ndarray, n_each: int = 500) -> np.ndarray:
    """The places of some values whose cells tell whether they are grouped: without decimals, with few, and others."""
    size = np.abs(values)
    is_whole, is_short = has_decimals(size, 0), has_decimals(size, 2)
    kinds = (is_whole, is_short & ~is_whole, ~is_short)
    return np.unique(np.concatenate([np.flatnonzero(kind)[:n_each] for kind in kinds]))


MAX_CHANNELS = 10_000
"""Maximum number of columns; a table with more is transposed, or is not a table."""
FLOAT32_MAX = float(np.finfo(np.float32).max)
WHOLE_IN_FLOAT32 = 2**24
"""Whole numbers up to this one are held by float32."""
BLANKS = " "
"""The separator of a table whose columns are any number of blanks and tabs apart."""
SPACES = re.compile(r"[ \t]+")
BYTES_PER_TEXT, BYTES_PER_CELL = 120, 24
"""Bytes in memory per cell of a table of texts, and of one that is mostly numbers."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NOT_FINITE = re.compile(r"[+-]?(nan|na|inf|infinity)", re.IGNORECASE)
GAP = re.compile(r"-+|\?+|\*+|#?n/?a!?|#n/?v|<na>|none|null|missing", re.IGNORECASE)
"""A word or a sign that stands for a value that is missing."""
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
WITH_UNIT = re.compile(r"[+-]?\d*[.,]?\d+ ?[a-zµ°%Ω]{1,4}", re.IGNORECASE)
FEW_EMPTY = 10
"""Empty columns at the end of all rows that pandas may read as any others."""
PADDED = 100
"""Small numbers of a column that tell whether all have zeros at their beginning."""
ZERO_PADDED = re.compile(r"0\d{1,2}([.,]\d*)?", re.ASCII)
COMMENT = re.compile(r"[ \t]*(#|%|//)")
"""The beginning of a line that is a comment."""
Decimal = Literal[".", ","]
COMMAS = "commas in numbers are decimal"


class Table(NamedTuple):
    """The lines of samples in a text file, and what stands above them.

    names: of the columns; none if no line names them. units: below the names; none without such a line.
    separator: between cells, `BLANKS` for any number of blanks. first_line: the line of the file with which `body`
    begins. skips_empty: whether an empty line is no row; otherwise it is refused, since a sample may be lost.
    choice: how the user chooses other columns, the end of a sentence. notes: what is said once of a table.
    values: the columns of a format that is no text (`table_of`), and intervals_s: those of their samples, None if it
    does not say them.
    """

    path: Path
    names: tuple[str, ...]
    separator: str
    body: str
    n_columns: int
    first_line: int = 1
    decimal: Decimal = "."
    units: tuple[str, ...] = ()
    skips_empty: bool = False
    choice: str = ""
    notes: tuple[str, ...] = ()
    values: tuple[np.ndarray, ...] = ()
    intervals_s: tuple[float | None, ...] = ()

    @property
    def first_row(self) -> list[str]:
        """The cells of the first line, as many as there are columns."""
        if self.values:
            return [str(column[0]) for column in self.values]
        row = cells(self.body.lstrip("\n").partition("\n")[0], self.separator)
        return [*row, *[""] * self.n_columns][: self.n_columns]

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """The line and the cells of each row, slowly: for messages, and for what pandas does not check."""
        line = self.first_line
        lines = (line + "\n" for line in lines_of(self.body.rstrip("\n")))
        if self.separator == BLANKS:
            lines = (SPACES.sub(BLANKS, line.strip(" \t\n")) for line in lines)
        reader = csv.reader(lines, delimiter=self.separator, skipinitialspace=True)
        try:
            for row in reader:
                if any(row) or not self.skips_empty:
                    yield line, [cell.strip() for cell in row]
                line = self.first_line + reader.line_num
        except csv.Error as error:
            raise InputError(f"{self.path}: line {line} cannot be read as cells ({error}); repair that line") from error

    def check_has_rows(self) -> None:
        """Refuse a table without rows."""
        if not (self.body.strip("\n") or all(len(column) for column in self.values or [()])):
            raise InputError(f"{self.path}: holds no row of numbers; record it again, or move the file away")

    @property
    def pandas_separator(self) -> str:
        return r"\s+" if self.separator == BLANKS else self.separator

    def name(self, column: int) -> str:
        """The name of a column for messages, in brackets; empty without names."""
        return f" ({self.names[column][:40]})" if self.names else ""


def table_of(
    path: str | Path, columns: Mapping[str, Any], intervals_s: Sequence[float | None] = (), notes: Sequence[str] = ()
) -> Table:
    """The table of a format that holds columns by their names: dates become texts, truth values numbers.

    >>> table_of("felt.parquet", {"t": np.array(["2024-01-31T12:00:00.5"], "M8[ms]"), "left": [True]}).first_row
    ['2024-01-31T12:00:00.500', '1']
    """
    values = []
    for column in map(np.asarray, columns.values()):
        kind = column.dtype.kind
        values.append(column if kind in "iufU" else column.astype(np.int8) if kind == "b" else column.astype(str))
    names = tuple(columns)
    return Table(
        Path(path), names, ",", "", len(names), 0, notes=tuple(notes), values=tuple(values),
        intervals_s=tuple(intervals_s),
    )  # fmt: skip


def lines_of(text: str) -> Iterator[str]:
    """Each line, without a list of all of them."""
    start = 0
    while (end := text.find("\n", start)) >= 0:
        yield text[start:end]
        start = end + 1
    yield text[start:]


def cells(line: str, separator: str = ",") -> list[str]:
    """The cells of one line, without quotes and surrounding spaces; after MAX_CHANNELS cells the rest is one cell.

    >>> cells('time, "felt, left",3'), cells("  0.5   3", BLANKS)
    (['time', 'felt, left', '3'], ['0.5', '3'])
    """
    if separator == BLANKS:
        line = SPACES.sub(BLANKS, line.strip(" \t"))
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
    text: str, path: str | Path, *, separator: str = ",", first_line: int = 1, names: Sequence[str] = ()
) -> np.ndarray:
    """The `(row, column)` float64 table in `text`, each value finite and within the range of float32.

    first_line: the file's line on which `text` begins. names: of the columns; without them the first row says how many
    there are. Empty lines are allowed only at the end. InputError names `path`, line and column, and refuses a table
    that is too wide or takes too much memory.

    >>> numbers("1,2\\n3,4\\n", "a.csv")
    array([[1., 2.],
           [3., 4.]])
    >>> numbers("1,2\\n3,x\\n", "a.csv", names=["left", "right"])
    Traceback (most recent call last):
    neurotact.errors.InputError: a.csv: line 2, column 2 (right) is 'x', not a number; write a number
    """
    body = text.rstrip("\n")
    n_columns = len(names) or len(cells(body.partition("\n")[0], separator))
    table = Table(Path(path), tuple(names), separator, body, n_columns, first_line)
    columns = columns_at(table, range(n_columns))
    return np.stack([finite(table, index, column) for index, column in enumerate(columns)], axis=1)


def check_width(where: str | Path, n_channels: int) -> None:
    """Refuse a table with more than `MAX_CHANNELS` columns; `where` begins the message."""
    if n_channels > MAX_CHANNELS:
        raise InputError(
            f"{where}: has {n_channels} columns, more than {MAX_CHANNELS} taxels; "
            "give one row per sample and one column per taxel"
        )


def has_columns(found: int, expected: int) -> str:
    """
    >>> has_columns(1, 3), has_columns(8, 1)
    ('has 1 column where 3 are expected', 'has 8 columns where 1 is expected')
    """
    return f"has {number_of(found, 'column')} where {expected} {'is' if expected == 1 else 'are'} expected"


def columns_at(table: Table, places: Sequence[int], texts: Collection[int] = ()) -> list[np.ndarray]:
    """The columns at these places: numbers if all of their cells are, and no place is among `texts`; else texts.

    InputError for rows of different lengths, and for a table that is too wide or takes too much memory.
    """
    table.check_has_rows()
    if table.values:
        return _values_at(table, places, texts)
    if "\0" in table.body:
        line = table.first_line + table.body.count("\n", 0, table.body.index("\0"))
        raise InputError(f"{table.path}: line {line} holds a NUL, so it was not written to its end; repair that line")
    check_width(table.path, table.n_columns)
    numbers_read = None if texts else _numbers_at_once(table, places)
    columns = numbers_read if numbers_read is not None else _columns(table, places, texts)
    n_cells = (table.body.rstrip("\n").count("\n") + 1) * table.n_columns
    lacks_marks = 0 < table.body.count(table.decimal) != n_cells
    for place, column in zip(places, columns, strict=True):
        if column.dtype.kind == "f" and lacks_marks:
            _check_ungrouped(table, place, column)
        if place and not table.names and table.separator in (",", BLANKS) and column.dtype.kind in "if":
            _check_not_an_end(table, place, column)
    return columns


def _values_at(table: Table, places: Sequence[int], texts: Collection[int]) -> list[np.ndarray]:
    """The columns of a format that holds columns, all of one length."""
    check_width(table.path, len(places))
    lengths = {table.names[place]: len(table.values[place]) for place in places}
    if len({*lengths.values()}) > 1:
        shown = some([f"{name} {length}" for name, length in lengths.items()])
        raise InputError(f"{table.path}: has channels of different lengths ({shown}); choose the taxels with `columns`")
    return [table.values[place].astype(str) if place in texts else table.values[place] for place in places]


def _check_ungrouped(table: Table, place: int, values: np.ndarray) -> None:
    """Refuse a column of numbers in which the decimal sign separates thousands."""
    if not _may_be_grouped(values) or ((values == np.floor(values)).all() and f"{table.decimal}000" not in table.body):
        return
    texts = _texts_at(table, place, _telling(values))
    if grouping_of([text for _, text in texts], table.decimal) == "yes":
        line, text = next(pair for pair in texts if table.decimal in pair[1])
        plain = next((text for _, text in texts if table.decimal not in text), texts[0][1])
        raise InputError(
            f"{table.path}: line {line}, column {place + 1}{table.name(place)} is {text!r}, where {plain!r} has no "
            f"decimals, as if {table.decimal!r} separated thousands; write numbers without such signs, or all with "
            "as many decimals"
        )


def _check_not_an_end(table: Table, place: int, values: np.ndarray) -> None:
    """Refuse a column of what stands after separators of thousands, which also separate cells."""
    if not (np.abs(values) < 1000).all():
        return
    texts = _texts_at(table, place, np.flatnonzero(np.abs(values) < 100)[:PADDED])
    padded = next((pair for pair in texts if ZERO_PADDED.fullmatch(pair[1])), None)
    if padded is not None and len({len(re.split("[.,]", text)[0]) for _, text in texts}) == 1:
        line, text = padded
        raise InputError(
            f"{table.path}: line {line}, column {place + 1} is {text!r}, as the end of a number with a separator "
            "of thousands; write numbers without such signs, or without zeros at their beginning"
        )


def _texts_at(table: Table, place: int, rows: np.ndarray) -> list[tuple[int, str]]:
    """The line and the text of a cell in each of these rows, which ascend."""
    wanted = set(rows.tolist())
    if not wanted:
        return []
    if '"' in table.body or table.skips_empty:
        every = ((line, lambda row=row: row) for line, row in table.rows())
    else:
        its = (line for line in lines_of(table.body))
        every = ((n, lambda line=line: cells(line, table.separator)) for n, line in enumerate(its, table.first_line))
    up_to = islice(enumerate(every), int(rows[-1]) + 1)
    return [(line, row()[place]) for index, (line, row) in up_to if index in wanted]


def _numbers_at_once(table: Table, places: Sequence[int]) -> list[np.ndarray] | None:
    """The columns, if the whole table is numbers; None if `_columns` must look closer."""
    body = table.body.rstrip("\n")
    n_rows = body.count("\n") + 1
    n_separators = 0 if table.separator == BLANKS else body.count(table.separator)
    files.check_size(table.path, 8 * max(n_rows * len(places), n_separators + n_rows))
    separators = b" \t" if table.separator == BLANKS else table.separator.encode()
    encoded = body.encode()
    if encoded.translate(None, b"0123456789+-eE \n" + separators + table.decimal.encode()):
        return None  # other characters: the C parser would take 'true' for 1 and end a cell at a NUL
    if table.separator != BLANKS and n_separators != n_rows * (table.n_columns - 1):
        return None
    try:
        read = pd.read_csv(
            io.BytesIO(encoded), sep=table.pandas_separator, header=None, names=range(table.n_columns),
            index_col=False, dtype="float64", na_filter=False, decimal=table.decimal,
            skip_blank_lines=table.skips_empty, quoting=csv.QUOTE_NONE, engine="c",
        )  # fmt: skip
    except (ValueError, OverflowError):
        return None
    values = read.to_numpy()
    return [values[:, column] for column in places]


def _columns(table: Table, places: Sequence[int], texts: Collection[int]) -> list[np.ndarray]:
    """The columns of a table that may hold anything."""
    body = table.body.rstrip("\n")
    n_rows, first = body.count("\n") + 1, body.partition("\n")[0]
    n_empty = min(len(first) - len(first.rstrip(table.separator)), table.n_columns - 1)
    tail = table.separator * n_empty
    if (
        n_empty >= FEW_EMPTY and table.separator != BLANKS and not table.skips_empty and _are_alike(table)
        and all(line.endswith(tail) for line in lines_of(body))
    ):  # fmt: skip
        cut, n_left = "\n".join(line[:-n_empty] for line in lines_of(body)), table.n_columns - n_empty
        inner = [place for place in places if place < n_left]
        narrow = table._replace(body=cut, n_columns=n_left, names=table.names[:n_left], units=())
        found = dict(zip(inner, _columns(narrow, inner, [place for place in texts if place < n_left]), strict=True))
        return [found.get(place, np.zeros(n_rows, "U1")) for place in places]
    n_cells = n_rows * max(1, len(places))
    files.check_size(table.path, n_cells * (BYTES_PER_TEXT if len(texts) == len(places) else BYTES_PER_CELL))
    _check_rows(table)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            read = pd.read_csv(
                io.StringIO(body), sep=table.pandas_separator, header=None, names=range(table.n_columns),
                index_col=False, usecols=sorted(places), dtype=dict.fromkeys(texts, "str"), keep_default_na=False,
                na_filter=False, skipinitialspace=True, skip_blank_lines=table.skips_empty, engine="c",
                low_memory=False, decimal=table.decimal,
            )  # fmt: skip
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        raise InputError(
            f"{table.path}: cannot be read as a table ({str(error).splitlines()[0][:100]}); repair that line"
        ) from error
    return [_column(table, read[column].to_numpy(), is_text=column in texts) for column in places]


def _column(table: Table, values: np.ndarray, *, is_text: bool) -> np.ndarray:
    if values.dtype.kind in "iuf":
        return values
    texts = [str(cell).strip() for cell in values.tolist()]
    plain = [] if is_text else [_with_point(cell, table.decimal) for cell in texts]
    if plain and all(map(NUMBER.fullmatch, plain)):
        return np.array(plain, np.float64)  # whole numbers that fit no integer
    files.check_size(table.path, 4 * len(texts) * max(map(len, texts)))
    return np.array(texts, str)


def _check_rows(table: Table) -> None:
    """Refuse a row with another number of cells than there are columns: pandas would fill it or cut it."""
    expected = table.n_columns
    if _are_alike(table):
        return
    for line, row in table.rows():
        if len(row) == expected and any(row):
            continue
        if not any(row):
            raise InputError(f"{table.path}: line {line} is empty; remove empty lines")
        if COMMENT.match(row[0]):
            raise InputError(f"{table.path}: line {line} is a comment, {row[0][:40]!r}; remove the line")
        raise InputError(
            f"{table.path}: line {line} {has_columns(len(row), expected)}; remove the line, or give every line the "
            "same columns"
        )


def _are_alike(table: Table) -> bool:
    """Whether all rows have as many separators as columns need, quickly; false if quotes or empty lines need a look."""
    if '"' in table.body or table.n_columns == 1:
        return False
    lines = lines_of(table.body.rstrip("\n"))
    if table.separator == BLANKS:
        return all(len(SPACES.split(line.strip(" \t"))) == table.n_columns for line in lines)
    empty = table.separator * (table.n_columns - 1)
    return all(line.count(table.separator) == len(empty) and line != empty for line in lines)


def finite(table: Table, column: int, values: np.ndarray, *, with_gaps: bool = False) -> np.ndarray:
    """A column as float64, each value finite and within the range of float32; InputError names the first other one.

    with_gaps: whether an empty cell, or a word for a missing value, is NaN and no fault.
    """
    if with_gaps and values.dtype.kind == "U":
        gaps = np.array([is_gap(cell) for cell in values.tolist()])
        floats = np.full(len(values), np.nan)
        if gaps.any():
            floats[~gaps] = finite(table, column, np.where(gaps, "0", values))[~gaps]
            return floats
    if values.dtype.kind in "iuf":
        floats = values.astype(np.float64, copy=False)
        wrong = np.flatnonzero(~(np.abs(floats) <= FLOAT32_MAX) & ~(with_gaps & np.isnan(floats)))
        row = int(wrong[0]) if len(wrong) else None
    else:
        plain = [_with_point(cell, table.decimal) for cell in values.tolist()]
        row = next(
            (i for i, cell in enumerate(plain) if not NUMBER.fullmatch(cell) or abs(float(cell)) > FLOAT32_MAX), None
        )
        floats = np.array(plain if row is None else [], float)
    if row is None:
        return floats
    if table.values:
        raise InputError(f"{table.path}: sample {row}{_fault(table, column, str(values[row]), values)}")
    line, its_cells = next(islice(table.rows(), row, None))
    raise InputError(f"{table.path}: line {line}{_fault(table, column, its_cells[column], values)}")


def is_gap(cell: str) -> bool:
    """Whether a cell says that its value is missing.

    >>> [is_gap(cell) for cell in ("", "NaN", "#N/A", "--", "inf", "0")]
    [True, True, True, True, False, False]
    """
    return not cell or bool(GAP.fullmatch(cell)) or cell.lower() in ("nan", "na")


def with_whole_rows(table: Table, *, are_kept: bool) -> tuple[Table, int]:
    """A table without rows that are empty or cut, and how many there are.

    are_kept: such a row becomes one without values, since it is a sample; otherwise it is left out, since time stamps
    show its place.
    """
    if table.values or _are_alike(table):
        return table, 0
    filled = table.separator.join(["nan"] * table.n_columns)
    lines, n_cut = [], 0
    for line in lines_of(table.body.rstrip("\n")):
        is_whole = len(row := cells(line, table.separator)) == table.n_columns and any(row)
        if is_whole or (len(row) > table.n_columns) or (row and COMMENT.match(row[0])):
            lines.append(line)  # whole, or another fault
            continue
        n_cut += 1
        lines += [filled] if are_kept else []
    return table._replace(body="\n".join(lines)), 0 if are_kept else n_cut


def lost_digits(values: np.ndarray) -> str:
    """What is wrong with whole numbers that float32, in which samples are kept, does not hold, and the fix; often "".

    values: finite numbers.

    >>> lost_digits(np.array([2**24, 2**24 + 2])), lost_digits(np.array([2**24 + 1]))[:44]
    ('', 'holds 16777217, of which float32 keeps 16777')
    """
    if values.dtype.kind not in "iuf" or not len(values) or float(np.abs(values).max()) <= WHOLE_IN_FLOAT32:
        return ""
    lost = values.astype(np.float32).astype(np.float64) != values
    if not lost.any() or (values.dtype.kind == "f" and not (values == np.rint(values)).all()):
        return ""
    value = int(values[lost].flat[0])
    return (
        f"holds {value}, of which float32 keeps {int(np.float32(value))}; subtract an offset that leaves numbers up to "
        f"{WHOLE_IN_FLOAT32}, or round them so that float32 holds them"
    )


def check_digits(values: np.ndarray, where: str | Path) -> None:
    """Refuse samples of which `lost_digits` says something; `where` begins the message."""
    if lost := lost_digits(values):
        raise InputError(f"{where}: {lost}")


def finite_called(table: Table, name: str, columns: Mapping[str, np.ndarray], *, with_gaps: bool = False) -> np.ndarray:
    """As `finite`, of the column with this name."""
    return finite(table, table.names.index(name), columns[name], with_gaps=with_gaps)


def is_meant_as_number(cell: str) -> bool:
    """Whether a cell is a number, with a decimal comma or with separators of thousands, too."""
    return any(form.fullmatch(cell) for form in (NUMBER, DECIMAL_COMMA, THOUSANDS))


def _with_point(cell: str, decimal: Decimal) -> str:
    """A cell with decimal commas as a number with a point; empty if it has a point already."""
    return cell if decimal == "." else "" if "." in cell else cell.replace(",", ".")


def _fault(table: Table, column: int, cell: str, values: np.ndarray) -> str:
    """What is wrong with a cell of a column, and the fix: the end of the sentence that names its line."""
    cell_name = f", column {column + 1}{table.name(column)} is"
    fill = ", fill it with `missing='interpolate'`"
    can_fill = bool(table.choice) and is_gap(cell)
    repair = f"repair the gap{fill if can_fill else ''}{table.choice}"
    if not cell:
        return f"{cell_name} empty; {repair}"
    if NOT_FINITE.fullmatch(cell):
        return f"{cell_name} {cell}; {repair}"
    if GAP.fullmatch(cell):
        return f"{cell_name} {cell!r}, no value; {repair}"
    if NUMBER.fullmatch(_with_point(cell, table.decimal)):
        return f"{cell_name} {cell[:20]}, more than float32 holds; use another unit"
    if values.dtype.kind == "U" and (sign := _sign_fault(cell, values.tolist(), table)):
        return sign
    if table.decimal == "," and NUMBER.fullmatch(cell):
        return " holds a point, but commas are decimal; write all numbers one way"
    if THOUSANDS.fullmatch(cell):
        return f"{cell_name} {cell[:20]!r}, with separators of thousands; write numbers without them"
    if WITH_UNIT.fullmatch(cell):
        return f"{cell_name} {cell[:20]!r}, not a number; write it without its unit{table.choice}"
    if re.search(r"\d:\d\d", cell):
        forms = "12:00:00.25, 01:00:00.25 PM or, of minutes and seconds, 59:59.25"
        return f"{cell_name} {cell[:20]!r}, not a time that is read; write it as {forms}{table.choice}"
    return f"{cell_name} {cell[:20]!r}, not a number; write a number{table.choice}"


def _sign_fault(cell: str, texts: Sequence[str], table: Table) -> str:
    """What is wrong with a comma in a cell of a column, and the fix; empty if it is no decimal one.

    No option is named where commas may separate thousands: it would make 1.234 of 1234.
    """
    if table.decimal == "," or not DECIMAL_COMMA.fullmatch(cell):
        return ""
    grouping = grouping_of(texts, ",")
    if grouping == "yes":
        return ""
    if grouping == "perhaps":
        return (
            f" has commas that are decimal or separate thousands, {cell[:20]!r}; write decimal points, or whole "
            "numbers without commas"
        )
    pass_it = "" if table.separator == "," else "pass `decimal=','` or "
    return f" has decimal commas; {pass_it}write decimal points"


def columns_of(table: Table, texts: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """The columns by their names. texts: those that are read as texts, all when None; others are numbers if all of
    their cells are.
    """
    places = range(table.n_columns)
    as_texts = [column for column in places if texts is None or table.names[column] in texts]
    return dict(zip(table.names, columns_at(table, places, as_texts), strict=True))


def values_of(values: np.ndarray) -> np.ndarray:
    """Texts as numbers if all of them are numbers without separators of thousands; anything else unchanged."""
    if values.dtype.kind in "OSU":
        texts = values.astype(str)
        numbers = pd.to_numeric(pd.Series(texts), errors="coerce").to_numpy()
        if np.isnan(numbers.astype(float)).any():
            return texts
        is_grouped = numbers.dtype.kind == "f" and _may_be_grouped(numbers)
        return texts if is_grouped and grouping_of(texts.tolist(), ".") == "yes" else numbers
    return values


def as_signal(array: np.ndarray, where: str) -> np.ndarray:
    """`array` as a `(time, channel)` float32 signal; InputError, beginning with `where`, if it cannot be one.

    >>> as_signal(np.array([[1, 2]]), "touch.npz, key 'press'")
    array([[1., 2.]], dtype=float32)
    """
    if array.dtype.kind not in "iufb":
        raise InputError(f"{where}: holds {array.dtype}, not numbers; save a (time, channel) array of real numbers")
    if array.ndim != 2 or 0 in array.shape:
        stacked = (
            "; neurotact import arrays reads (trial, time, taxel), and a grid over time is saved as "
            "grid.reshape(len(grid), -1)"
        )
        stacked = stacked if array.ndim == 3 else ""
        raise InputError(f"{where}: has shape {array.shape}; save a (time, channel) array that is not empty{stacked}")
    check_width(where, array.shape[1])
    fits = np.abs(array) <= FLOAT32_MAX if array.dtype.kind == "f" else np.ones(array.shape, dtype=bool)
    if not fits.all():
        sample, channel = np.argwhere(~fits)[0]
        raise InputError(
            f"{where}: sample {sample}, channel {channel} is {array[sample, channel]}; "
            "repair the gap, or use another unit where float32 cannot hold it"
        )
    check_digits(array, where)
    return array.astype(np.float32)
