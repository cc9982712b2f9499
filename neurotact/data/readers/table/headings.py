"""What stands above the samples of a text: names, units, comments, a start time, the separator; where samples begin."""

import logging
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice, zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from neurotact.data.readers.clock.units import FASTEST_HZ, is_time_of_day
from neurotact.data.readers.formats import tables_in
from neurotact.data.readers.formats.contents import BEGIN_OF_LVM
from neurotact.data.readers.table.cells import (
    BLANKS,
    COMMAS,
    COMMENT,
    DECIMAL_COMMA,
    NUMBER_OF_ANY_SIGN,
    SPACES,
    THOUSANDS,
    Decimal,
    Table,
    cells,
    has_columns,
    has_decimal_commas,
    is_value,
    splits_thousands,
)
from neurotact.data.readers.table.texts import read_any_text
from neurotact.errors import InputError, some

log = logging.getLogger("neurotact")

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
DIGIT, WORD = re.compile(r"\d"), re.compile(r"[^\W\d_]|[%°\[(]")
"""A digit in a cell without any of the others is of a number in a form that is not read, and of no unit."""
IN_BRACKETS = re.compile(r"[\[(].*[\])]")
WIDE = re.compile(r"\t|[ ]{2,}")
"""Between names that contain blanks."""


LETTER = re.compile(r"[^\W\d_]")
BRACKETS = re.compile(r"[ \t]*[\[(]+[ \t]*[+-]?\.?\d")
"""The beginning of a row in brackets, as Python prints arrays, lists and tuples."""
SEPARATOR_LINE = re.compile(r'"?sep=(.)"? *', re.IGNORECASE)
"""The first line of a file that tells Excel the separator."""
SINCE_1970_S = (0.9e9, 2.2e9)
"""Seconds since 1970, from 1998 to 2039; a start time may also be in ms, us or ns."""
ABOVE = 100.0
"""Factor by which a start time, or a sampling rate alone, is above all samples."""
FEW_WHOLE = 0.02
"""Share of whole numbers below which samples have decimals, so that a whole number beside them is none of them."""
LEAST_ROWS = 3
"""Samples that tell what is usual."""


class _UsualRow(NamedTuple):
    """The separator of a file, the cells of its usual row, and whether each is a number or a time of day."""

    separator: str
    cells: tuple[str, ...]
    are_values: tuple[bool, ...]

    @property
    def n_columns(self) -> int:
        """The number of columns, to which a separator at the end of the row adds none."""
        return len(_without_end(self.cells))

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
        ways = (*map(_without_end, apart), [cell.strip() for cell in WIDE.split(line.strip())])
        fitting = (names for names in ways if len(names) in (self.n_columns, len(self.cells)))
        names = tuple(next(fitting, ()))
        are_names = any(names) and (_numbers_columns(names) or not any(map(_is_number, names)))
        return names if are_names else ()

    def units_in(self, line: str) -> tuple[str, ...]:
        """The units of the columns in a line, separated as the cells of a row are; none if the line is of other words.

        Words between blanks are units only if they are known ones or in brackets, as prose has blanks too.
        """
        row = tuple(cells(line, self.separator))
        row = row if any(row[self.n_columns :]) else row[: self.n_columns]
        is_sure = self.separator != BLANKS and self.n_columns > 1
        are_units = is_sure or all(not cell or is_unit(cell) for cell in row)
        are_numbers = any(is_sample(cell) or (DIGIT.search(cell) and not WORD.search(cell)) for cell in row)
        return row if self._fits(row) and are_units and not are_numbers else ()

    def _fits(self, row: Sequence[str]) -> bool:
        return any(row) and len(row) in (self.n_columns, len(self.cells))


def _usual_row(text: str, separator: str | None = None) -> _UsualRow | None:
    """The row of numbers that most lines resemble; None if no line that is looked at holds a number.

    separator: of the file, if it says it.

    >>> _usual_row("Force of 2 fingers\\nleft right\\n1 2\\n3 4\\n").cells
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
    return _UsualRow(most[0], tuple(fullest), tuple(map(is_sample, fullest)))


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


def _is_number(cell: str) -> bool:
    """Whether a cell is surely no name: a number, with separators of thousands too; a place may be named 001_002."""
    return is_sample(cell) or (bool(THOUSANDS.fullmatch(cell)) and "_" not in cell)


def is_unit(cell: str) -> bool:
    """Whether a cell is a known unit, or anything in brackets.

    >>> is_unit("mV"), is_unit("[a.u.]"), is_unit("left")
    (True, True, False)
    """
    return cell in UNITS or bool(IN_BRACKETS.fullmatch(cell))


def _without_end(row: Sequence[str]) -> Sequence[str]:
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
    spread = [end * index // PROBES for index in range(PROBES)]
    starts = {text.find("\n", max(0, position - 1)) + 1 if position else 0 for position in spread}
    last = end
    for _ in range(LAST_PROBES):
        last = text.rfind("\n", 0, max(0, last))
        starts.add(last + 1)
    for start in sorted(starts):
        stop = text.find("\n", start, start + LONGEST_PROBE)
        line = text[start : stop if stop >= 0 else start + LONGEST_PROBE]
        if line.strip() and not COMMENT.match(line):
            yield line


class _Line(NamedTuple):
    """A line: where it begins, its number from 1, its text."""

    begin: int
    number: int
    text: str


class _Head(NamedTuple):
    """The names of the columns, and units; the lines above the samples that are neither, nor comments.

    comment: the number of the line with the names, if it is a comment whose words are taken for names; else 0.
    """

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    others: tuple[_Line, ...] = ()
    comment: int = 0


def named_table(
    path: Path, decimal: Decimal | None = ".", header_lines: int | None = None, *, option: str = "", choice: str = ""
) -> Table:
    """As `open_table`, of a file that names its columns, and in which an empty line is no row; its notes are said."""
    table = open_table(path, decimal, header_lines, option=option, choice=choice)
    if not table.body.strip():
        raise InputError(f"{path}: holds no row below its header; give at least one")
    if not table.names:
        line = table.first_line
        raise InputError(f"{path}: line {line} holds a row, but must name the columns, as in trial,time_s,label")
    twice = [name for name, n in Counter(table.names).items() if n > 1]
    if twice:
        raise InputError(f"{path}: names a column twice, '{twice[0][:40]}'; give each its own name")
    for note in table.notes:
        log.warning("%s: %s", path, note)
    return table._replace(skips_empty=True)


def open_table(
    path: Path, decimal: Decimal | None = ".", header_lines: int | None = None, *, option: str = "", choice: str = ""
) -> Table:
    """The table in a text file: UTF-8, UTF-16 or Windows-1252; commas, `;`, tabs or blanks between its columns.

    Above the samples may stand a line `sep=;`, comments (`#`, `%`, `//`; the last one may name the columns), the names,
    and units below them; or the head of a LabVIEW measurement. header_lines: the number of lines above the samples,
    which then may be any. option: the one that gives that number; empty without one. choice: see `Table`. decimal: None
    is a comma, with a note, where those in numbers can be nothing else, or a point.

    InputError names other lines above the samples.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "felt.txt"
    >>> _ = path.write_text("# made by hand\\n t_s  left\\n s  mV\\n 0.0  1\\n 0.1  2\\n")
    >>> table = open_table(path)
    >>> table.names, table.units, table.separator, table.first_line
    (('t_s', 'left'), ('s', 'mV'), ' ', 4)
    """
    text, note = read_any_text(path)
    if text.lstrip().startswith(BEGIN_OF_LVM):
        (table,) = tables_in(path, name="lvm").values()
        if decimal == "," != table.decimal:
            raise InputError(f"{path}: names {table.decimal!r} as its decimal separator; leave `decimal` out")
        return table._replace(choice=choice)
    match = SEPARATOR_LINE.fullmatch(text.partition("\n")[0])
    given = match[1] if match else None
    begin = 0 if header_lines is None else _after(text, header_lines)
    usual = _usual_row(text[begin:] if begin else text, given)
    above = _above(text, usual, begin if header_lines is not None else None, path, has_separator_line=given is not None)
    samples = above.pop()
    if usual is None:
        usual = _texts(text, samples, above, given)
    if decimal == "," and usual.separator == ",":
        usual = _in_one_column(usual, above, path)
    head = _head(above, usual)
    if header_lines is None:
        _check_others(head, usual, samples, option, path)
    notes = [note] if note else []
    if head.comment:
        notes.append(f"the comment in line {head.comment} names the columns: {some(head.names)}")
    if head.units:
        listed = some([unit for unit in head.units if unit])
        notes.append(f"the line of units is no sample ({listed})")
    body = text[samples.begin :]
    its_decimal = decimal or _decimal_in(body, usual.separator)
    notes += [COMMAS] if its_decimal != (decimal or ".") else []
    n_columns = usual.n_columns
    if head.names and len(head.names) == len(usual.cells) and head.names[-1]:
        n_columns = len(head.names)
    elif n_columns < len(usual.cells):
        body = re.sub(rf"{usual.separator}[ \t]*$" if usual.separator != "\t" else r"\t *$", "", body, flags=re.M)
    return Table(
        path, head.names[:n_columns], usual.separator, body, n_columns, samples.number, its_decimal,
        head.units[:n_columns], choice=choice, notes=tuple(notes),
    )  # fmt: skip


def _decimal_in(body: str, separator: str) -> Decimal:
    """The decimal sign of numbers: a comma where those of some lines can be nothing else, or a point."""
    rows = (cells(line, separator) for line in _probes(body) if separator != ",")
    return "," if has_decimal_commas(zip_longest(*rows, fillvalue=""), separator) else "."


def _after(text: str, n_lines: int) -> int:
    """The place after the first lines; the end of a text that has no more."""
    position = 0
    for _ in range(n_lines):
        position = text.find("\n", position) + 1
        if not position:
            return len(text)
    return position


def _lines(text: str) -> Iterator[_Line]:
    begin = number = 0
    while begin < len(text):
        end = text.find("\n", begin)
        end = len(text) if end < 0 else end
        number += 1
        yield _Line(begin, number, text[begin:end])
        begin = end + 1
    yield _Line(len(text), number + 1, "")


def _above(
    text: str, usual: _UsualRow | None, begin: int | None, path: Path, *, has_separator_line: bool
) -> list[_Line]:
    """The lines above the samples, but empty ones; the last one is the first of the samples.

    begin: where they begin, if that is known. Without a usual row they begin below the first line that is no comment.
    """
    headings: list[_Line] = []
    for line in islice(_lines(text), int(has_separator_line), None):
        is_first = line.begin >= begin if begin is not None else _is_first(line, headings, usual)
        if line.text.strip() or is_first or line.begin == len(text):
            headings.append(line)
        if is_first:
            break
    while begin is None and usual is not None and len(headings) > 1 and usual.is_near(headings[-2].text):
        headings.pop()
    for line in headings:
        if BRACKETS.match(line.text):
            raise InputError(
                f"{path}: line {line.number} begins with a bracket, {line.text.strip()[:20]!r}; write rows without "
                "brackets, in Python with numpy.savetxt"
            )
    return headings


def _is_first(line: _Line, above: Sequence[_Line], usual: _UsualRow | None) -> bool:
    if not line.text.strip() or COMMENT.match(line.text):
        return False
    if usual is None:
        return not LETTER.search(line.text) or any(not COMMENT.match(heading.text) for heading in above)
    return usual.is_like(line.text)


def _texts(text: str, samples: _Line, above: Sequence[_Line], separator: str | None) -> _UsualRow:
    """The row of a table without numbers, as its names are, with the end of the first row below them."""
    named = [heading.text for heading in above if not COMMENT.match(heading.text)]
    line = named[-1] if named else samples.text
    row = text[samples.begin :].partition("\n")[0]
    its = separator or separator_of(line)
    if its == BLANKS and len(cells(line, its)) != len(cells(row, its)):
        its = ","
    names = _without_end(cells(line, its))
    first = cells(row, its)
    ends_open = len(first) == len(names) + 1 and not first[-1]
    return _UsualRow(its, (*names, *[""] * ends_open), (False,) * (len(names) + ends_open))


def _in_one_column(usual: _UsualRow, above: Sequence[_Line], path: Path) -> _UsualRow:
    """The usual row if its comma is a decimal one, in a file of one column that has a name."""
    cell = ",".join(usual.cells)
    has_names = bool(above) and "," in above[-1].text
    if not above or has_names or not DECIMAL_COMMA.fullmatch(cell):
        if has_names and usual.n_columns > len(_without_end(cells(above[-1].text, ","))) and "." not in cell:
            raise InputError(
                f"{path}: has commas both in its numbers and between its columns; put ; between columns and pass "
                "`decimal=','`"
            )
        raise InputError(f"{path}: has commas between its columns, so there are no decimal commas; drop `decimal`")
    return _UsualRow("\t", (cell,), (True,))


def _head(above: Sequence[_Line], usual: _UsualRow) -> _Head:
    """The names and units in the last lines above the samples, else in the last comments."""
    comments = [line._replace(text=COMMENT.sub("", line.text)) for line in above if COMMENT.match(line.text)]
    others = [line for line in above if not COMMENT.match(line.text)]
    head = _named_by(others, usual, by_blanks=usual.separator == "\t")
    if others or usual.n_columns == 1:
        return head
    comments = [line for line in comments if line.text.strip()]
    head = _named_by(comments, usual, by_blanks=True)
    last = comments[-1 - bool(head.units)] if head.names else None
    are_words = last is not None and not any(separator in last.text for separator in SEPARATORS)
    return head._replace(others=(), comment=last.number if last and are_words else 0)


def _named_by(lines: Sequence[_Line], usual: _UsualRow, *, by_blanks: bool) -> _Head:
    units = usual.units_in(lines[-1].text) if len(lines) > 1 else ()
    above = usual.names_in(lines[-2].text, by_blanks=by_blanks) if units else ()
    if not above:
        last = usual.names_in(lines[-1].text, by_blanks=by_blanks) if lines else ()
        return _Head(last, others=tuple(lines[:-1] if last else lines))
    if len(set(above)) == len(above):
        return _Head(above, units, tuple(lines[:-2]))
    names = (f"{group} {name}".strip() for group, name in zip(above, units, strict=False))  # pandas' two levels
    return _Head(tuple(names), others=tuple(lines[:-2]))


def _check_others(head: _Head, usual: _UsualRow, samples: _Line, option: str, path: Path) -> None:
    """Refuse lines above the samples that are neither names nor units nor comments."""
    if not head.others:
        return
    apart = [(line, _without_end(cells(line.text, usual.separator))) for line in head.others]
    broken = [(line, row) for line, row in apart if not re.search("[A-Za-z]", line.text)]
    if broken:
        line, row = broken[0]
        raise InputError(f"{path}: line {line.number} {_fault_of(row, usual.n_columns)}")
    n_lines = samples.number - 1
    skip = (
        f"skip the lines above the samples with `{option}={n_lines}`" if option else "remove the lines above the names"
    )
    line, row = apart[-1]
    if len(apart) == 1 and not head.names and (len(row) > 1 or usual.n_columns == 2):
        fix = f"name each column{_hint(usual, len(row))}, or {skip}"
        if usual.separator in (",", BLANKS) and splits_thousands(usual.cells, len(row)):
            fix = "write numbers without separators of thousands and with decimal points, or name each column"
        raise InputError(
            f"{path}: line {samples.number} {has_columns(usual.n_columns, len(row))}, the names in line {line.number}; "
            f"{fix}"
        )
    first = head.others[0]
    which = f"line {first.number} is" if len(apart) == 1 else f"lines {first.number} to {line.number} are"
    raise InputError(f"{path}: {which} no sample and no name of a column, {first.text.strip()[:40]!r}; {skip}")


def _fault_of(row: Sequence[str], n_columns: int) -> str:
    """What is wrong with a line of numbers above the samples, and its fix: only what is no sample is to be removed."""
    grouped = [cell for cell in row if THOUSANDS.fullmatch(cell) and not NUMBER_OF_ANY_SIGN.fullmatch(cell)]
    if grouped:
        return f"has separators of thousands, as in {grouped[0]!r}; write numbers without them"
    if not any(row):
        return "holds no value; remove the line"
    fix = ", as a first line that was cut off; remove the line"
    if len(row) == n_columns:
        cell = next((cell for cell in row if not NUMBER_OF_ANY_SIGN.fullmatch(cell)), row[0])
        return f"holds {cell[:40]!r}, which the lines below do not; write numbers in one form"
    if splits_thousands(row, n_columns):
        fix = "; write numbers without separators of thousands and with decimal points"
    elif len(row) > n_columns:
        fix = "; give all lines the same columns"
    return f"{has_columns(len(row), n_columns)}{fix}"


def _hint(usual: _UsualRow, n_names: int) -> str:
    """Why there may be more or fewer names than columns."""
    if usual.separator == BLANKS:
        return " (names that contain blanks need quotes, or commas between columns)"
    if usual.separator == "," and usual.n_columns == 2 * n_names:
        commas = "pass `decimal=','`" if n_names == 1 else "put ; between columns and pass `decimal=','`"
        return f" (if these are decimal commas, {commas})"
    return ""


def check_first_row(signal: np.ndarray, where: str, first_line: int) -> None:
    """Refuse a signal, `(time, channel)`, whose first row holds a start time.

    where: begins the message. first_line: the line of the first row, 0 in an array.

    >>> check_first_row(np.array([[1.6e9], [64.0], [0.1], [0.2], [0.3]]), "acc.csv", 1)
    Traceback (most recent call last):
    neurotact.errors.InputError: acc.csv: line 1 holds a start time, 1.6e+09 s since 1970, and the sampling rate is 64 \
Hz; skip what is no sample with `header_lines=2`, and give `sampling_rate_Hz=64`
    """
    started = _start_time(signal) if len(signal) > LEAST_ROWS else ""
    if not started:
        return
    beside = [value for value in signal[0].tolist() if _may_be_rate(value) and value > np.abs(signal[1:]).max()]
    row, number = ("line", first_line) if first_line else ("sample", 0)
    held = f"{where}: {row} {number} holds a start time, {started}"
    is_below = not beside and _may_be_rate(float(signal[1, 0])) and bool((signal[1] == signal[1, 0]).all())
    if is_below and not _differs(float(signal[1, 0]), signal[2:]):
        raise InputError(f"{held}; remove it, and {row} {number + 1}, too, if that is the sampling rate")
    rate_Hz = beside[0] if beside else float(signal[1, 0]) if is_below else None
    n_rows = 1 + is_below
    also, given = "", ""
    if rate_Hz is not None:
        also, given = f", and the sampling rate is {rate_Hz:g} Hz", f", and give `sampling_rate_Hz={rate_Hz:g}`"
    skip = f"skip what is no sample with `header_lines={first_line - 1 + n_rows}`"
    raise InputError(f"{held}{also}; {skip if first_line else f'remove the first {n_rows} rows'}{given}")


def _differs(value: float, samples: np.ndarray) -> bool:
    """Whether a number is surely no sample: whole where hardly a sample is, in several columns or beyond the samples of
    one; or further off than samples differ.
    """
    low, high = float(samples.min()), float(samples.max())
    is_whole = value == round(value) and (samples == np.rint(samples)).mean() < FEW_WHOLE
    if is_whole and (samples.shape[1] > 1 or not low <= value <= high):
        return True
    return not low - (high - low) <= value <= high + (high - low)


def rate_in(signal: np.ndarray, given_Hz: float | None) -> float | None:
    """The sampling rate that the first row seems to hold: one whole number, far above all samples, or the given rate.

    >>> rate_in(np.array([[64.0], [0.1], [0.2], [0.3]]), None), rate_in(np.array([[4.0], [3.0], [2.0], [1.0]]), None)
    (64.0, None)
    """
    if len(signal) <= LEAST_ROWS:
        return None
    first, rest = float(signal[0, 0]), signal[1:]
    is_given = first == given_Hz and not rest.min() <= first <= rest.max()
    is_far = first == round(first) and first > ABOVE * float(np.abs(rest).max()) > 0
    return first if _may_be_rate(first) and (signal[0] == first).all() and (is_given or is_far) else None


def _start_time(signal: np.ndarray) -> str:
    """The start time in the first row, in words; empty if there is none."""
    first, rest = np.abs(signal[0].astype(float)), np.abs(signal[2:]).max(axis=0)
    for unit_s, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")):
        is_time = (SINCE_1970_S[0] < first * unit_s) & (first * unit_s < SINCE_1970_S[1]) & (first > ABOVE * rest)
        if is_time.any():
            return f"{first[is_time][0]:.6g} {unit} since 1970"
    return ""


def _may_be_rate(value: float) -> bool:
    return 1 <= value <= FASTEST_HZ
