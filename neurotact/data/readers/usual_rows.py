"""The usual row of a text file: what separates its cells, how many there are, and which of them hold numbers."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from neurotact.data.readers.clock import is_time_of_day
from neurotact.data.readers.tables import BLANKS, COMMENT, DECIMAL_COMMA, SPACES, cells, is_value
from neurotact.data.readers.thousands import THOUSANDS

SEPARATORS = (";", "\t", ",", "|")
PROBES = 9
"""Lines, spread evenly over a file and at its end, among which the usual row is found."""
LAST_PROBES = 3
LONGEST_PROBE = 1 << 20
UNITS = {
    "-", "s", "sec", "ms", "us", "µs", "ns", "Hz", "kHz", "V", "mV", "uV", "µV", "A", "mA", "N", "mN", "kN", "Nm", "g",
    "kg", "Pa", "hPa", "kPa", "MPa", "bar", "mbar", "psi", "m", "cm", "mm", "um", "µm", "m/s", "mm/s", "m/s^2", "m/s²",
    "°", "deg", "rad", "°C", "C", "K", "%", "ohm", "Ohm", "kOhm", "Ω", "kΩ", "F", "pF", "nF", "count", "counts", "LSB",
    "a.u.", "au",
}  # fmt: skip
"""Units of what sensors of touch record."""
BRACKETS = re.compile(r"[\[(].*[\])]")
WIDE = re.compile(r"\t|[ ]{2,}")
"""Between names that contain blanks."""


class UsualRow(NamedTuple):
    """The separator of a file, the cells of its usual row, and whether each is a number or a time of day."""

    separator: str
    cells: tuple[str, ...]
    are_values: tuple[bool, ...]

    @property
    def n_columns(self) -> int:
        """The number of columns, to which a separator at the end of the row adds none."""
        return len(without_end(self.cells))

    def is_like(self, line: str) -> bool:
        """Whether a line has as many cells, and values or nothing where the usual row has values."""
        row = cells(line, self.separator)
        pairs = zip(self.are_values, row, strict=False)
        is_row = self._fits(row) and not _numbers_columns(row)
        return is_row and all(not cell or is_sample(cell) for is_one, cell in pairs if is_one)

    def is_near(self, line: str) -> bool:
        """Whether a line has as many cells, and a value among them: a row with a fault."""
        row = cells(line, self.separator)
        return self._fits(row) and any(map(is_sample, row)) and not _numbers_columns(row)

    def names_in(self, line: str, *, by_blanks: bool) -> tuple[str, ...]:
        """The names of the columns in a line, whatever separates them; none if the line does not name each.

        by_blanks: whether single blanks may separate names where they separate no cells.
        """
        apart = (cells(line, mark) for mark in (self.separator, *SEPARATORS, *([BLANKS] if by_blanks else [])))
        ways = (*map(without_end, apart), [cell.strip() for cell in WIDE.split(line.strip())])
        fitting = (names for names in ways if len(names) in (self.n_columns, len(self.cells)))
        names = tuple(next(fitting, ()))
        are_names = any(names) and (_numbers_columns(names) or not any(is_sample(n) or _is_grouped(n) for n in names))
        return names if are_names else ()

    def units_in(self, line: str) -> tuple[str, ...]:
        """The units of the columns in a line, separated as the cells of a row are; none if the line is of other words.

        Words between blanks are units only if they are known ones or in brackets, as prose has blanks too.
        """
        row = tuple(self._cut(cells(line, self.separator)))
        is_sure = self.separator != BLANKS and self.n_columns > 1
        are_units = is_sure or all(not cell or is_unit(cell) for cell in row)
        are_numbers = any(is_sample(cell) or _is_digits(cell) for cell in row)
        return row if self._fits(row) and are_units and not are_numbers else ()

    def _cut(self, row: Sequence[str]) -> Sequence[str]:
        """As many cells as there are columns, if no other one is filled."""
        return row if any(row[self.n_columns :]) else row[: self.n_columns]

    def _fits(self, row: Sequence[str]) -> bool:
        return any(row) and len(row) in (self.n_columns, len(self.cells))


def _is_digits(cell: str) -> bool:
    """Whether a cell is a number in a form that is not read, as with separators of thousands, and surely no unit.

    >>> [cell for cell in ("1'005", "1,005.5", "mV", "m/s2", "[1]", "-", "") if _is_digits(cell)]
    ["1'005", '1,005.5']
    """
    return bool(re.search(r"\d", cell)) and not re.search(r"[^\W\d_]|[%°\[(]", cell)


def _is_grouped(cell: str) -> bool:
    """Whether a cell is a number with separators of thousands, and surely no name, as the place 001_002 may be."""
    return bool(THOUSANDS.fullmatch(cell)) and "_" not in cell


def usual_row(text: str, separator: str | None = None) -> UsualRow | None:
    """The row of numbers like which most lines are; None if no line that is looked at holds a number.

    separator: of the file, if it says it.

    >>> usual_row("Force of 2 fingers\\nleft right\\n1 2\\n3 4\\n").cells
    ('1', '2')
    """
    rows: defaultdict[tuple[str, int], list[list[str]]] = defaultdict(list)
    for line in _probes(text):
        its = separator or separator_of(line)
        row = cells(line, its)
        if any(map(is_sample, row)):
            rows[its, len(row)].append(row)
    if not rows:
        return None
    most = max(rows, key=lambda kind: sum(is_sample(cell) for row in rows[kind] for cell in row))
    fullest = max(rows[most], key=lambda row: sum(map(is_sample, row)))
    return UsualRow(most[0], tuple(fullest), tuple(map(is_sample, fullest)))


def separator_of(line: str) -> str:
    """What separates the cells of a row: `;`, else tabs, else commas that are not decimal ones, else blanks.

    >>> [separator_of(row) for row in ("0,5;1", "1, 2", " 0.5   1", "0,5 1,0")]
    [';', ',', ' ', ' ']
    """
    separator = next((candidate for candidate in SEPARATORS if candidate in line), None)
    parts = SPACES.split(line.strip(" \t"))
    if separator in (None, ",") and len(parts) > 1:
        are_numbers = all(is_value(part) or DECIMAL_COMMA.fullmatch(part) for part in parts)
        if separator is None or are_numbers:
            return BLANKS
    return separator or ","


def is_sample(cell: str) -> bool:
    """Whether a cell is a number, with a point or a comma, or a time of day."""
    return is_value(cell) or bool(DECIMAL_COMMA.fullmatch(cell)) or is_time_of_day(cell)


def is_unit(cell: str) -> bool:
    """Whether a cell is a known unit, or anything in brackets.

    >>> is_unit("mV"), is_unit("[a.u.]"), is_unit("left")
    (True, True, False)
    """
    return cell in UNITS or bool(BRACKETS.fullmatch(cell))


def without_end(row: Sequence[str]) -> Sequence[str]:
    """The cells of a row; a separator at its end adds no cell."""
    return row[:-1] if len(row) > 1 and not row[-1] else row


def _numbers_columns(row: Sequence[str]) -> bool:
    """Whether cells are a name, or none, and then the numbers of the other columns, from 0 or 1 on."""
    first, *others = row
    if is_sample(first) or others[:1] not in (["0"], ["1"]) or (first and len(others) == 1):
        return False
    return others == [str(int(others[0]) + index) for index in range(len(others))]


def _probes(text: str) -> Iterator[str]:
    """Some lines that are not empty and no comments, in their order; all lines of a short text."""
    end = len(text.rstrip("\n"))
    starts = {text.find("\n", max(0, position - 1)) + 1 if position else 0 for position in _spread(end)}
    last = end
    for _ in range(LAST_PROBES):
        last = text.rfind("\n", 0, max(0, last))
        starts.add(last + 1)
    for start in sorted(starts):
        stop = text.find("\n", start, start + LONGEST_PROBE)
        line = text[start : stop if stop >= 0 else start + LONGEST_PROBE]
        if line.strip() and not COMMENT.match(line):
            yield line


def _spread(end: int) -> list[int]:
    return [end * index // PROBES for index in range(PROBES)]
