"""The layout of the columns of a text file, and the reader of one file: taxels and, if any, time stamps."""

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.data.readers.clock.units import Unit, apart, is_time_of_day, joined, pair_in, seconds_of, unit_in
from neurotact.data.readers.table.cells import (
    NOT_FINITE,
    Table,
    as_signal,
    columns_at,
    finite,
    lost_digits,
    with_whole_rows,
)
from neurotact.data.readers.table.headings import check_first_row, is_sample, open_table
from neurotact.data.recordings import LABEL
from neurotact.errors import InputError, nearest, number_of, some
from neurotact.spec import Names, Spec, chosen

Missing = Literal["interpolate", "drop-trial"]
FALLING = 0.1
"""Share of the intervals that may be negative in a column that is named like time stamps."""
SINCE_1970_NS = 1e18
"""Nanoseconds since 1970 in 2001: no clock that starts with its computer counts as many."""
ROS_FIELDS = 3
"""Columns of the header in ROS 2 (`ros2 topic echo --csv`): seconds, nanoseconds, the name of the frame."""
SECOND_NS, LEAST_NS = 10**9, 1000
"""Nanoseconds of a second, and so many as a clock shows at least once; a number of a trial or a finger is smaller."""
LIKE_NUMBER = re.compile(rf"\W*\d|({NOT_FINITE.pattern})$", re.IGNORECASE)
"""The beginning of a cell that may be meant as a number."""
DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}", re.ASCII)
CHOICE = ", or choose other columns with `columns`"
RANGE = re.compile(r"(\d+)(?:-(\d+))?", re.ASCII)
SAME = 1e-9
"""Share by which intervals of channels may differ."""


class _Guess(NamedTuple):
    """What the name of a column, or of an array, says it is.

    names: in small letters, the likeliest first; or the pattern of a whole name. reading: what such a column becomes.
    doubt: what speaks against it, and what then happens.
    """

    names: tuple[str, ...] | re.Pattern[str]
    reading: str
    doubt: str

    @property
    def aliases(self) -> tuple[str, ...]:
        """The names, if they are listed."""
        return () if isinstance(self.names, re.Pattern) else self.names


GUESSES: dict[str, _Guess] = {
    "time": _Guess(
        re.compile(
            r"(times?|timestamps?|ts?|elapsed|seconds|millis|micros|x_value|zeit(punkt|stempel)?|temps|tempo|tiempo)"
            r"(?![a-z0-9]).*", re.I | re.S,
        ),
        "time stamps of samples", "its values fall, as of a temperature `T`, or another one is the time: refused",
    ),
    "row number": _Guess(
        re.compile(r"(Unnamed: 0(\.\d+)?)?"), "row numbers that pandas writes, or wrote and read again: left out",
        "it does not count: a taxel",
    ),
    "ROS header": _Guess(
        re.compile(r"(.*[./_])?header[./_](seq|stamp|frame_id)\b.*", re.ASCII),
        "the header of a message (`rostopic echo -p`, bagpy): left out", "it is named as the time: time stamps",
    ),
    "label": _Guess(
        (LABEL, "labels", "class", "classes", "y", "target", "targets"), "the class of a trial",
        "it changes within a trial: refused",
    ),
    "trial": _Guess(
        (
            "trial", "trials", "trial_id", "recording", "recordings", "recording_id", "touch", "touch_id",
            "sequence_id",
        ),
        "a trial begins where it changes", "a value comes back later: refused",
    ),
    "channels": _Guess(
        ("channels", "channel_names", "taxels", "electrodes"), "the names of the taxels",
        "it has another length: not used",
    ),
    "begin": _Guess(re.compile(r"(begin|start|onset|from)([ _]?time)?", re.I), "where an annotation begins", ""),
    "end": _Guess(
        re.compile(r"(end|stop|offset|to)([ _]?time)?", re.I), "where it ends", "it is before its begin: refused"
    ),
    "duration": _Guess(re.compile(r"duration|length", re.I), "how long it lasts, without an end", ""),
    "annotation": _Guess(
        (LABEL, "labels", "class", "classes", "y", "target", "targets", "trial_type", "annotation"),
        "its class; `onset`, `duration` and `trial_type` are those of BIDS", "",
    ),
    "event time": _Guess(("time", "times", "t", "timestamp", "timestamps", "ts"), "the times of events", ""),
    "event channel": _Guess(
        ("channel", "channels", "unit", "units", "taxel", "taxels", "neuron", "address", "addr", "id"),
        "the channels of events", "it is not whole: refused",
    ),
    "event population": _Guess(("population", "polarity", "p", "pol", "type", "kind"), "ON or OFF, or a word", ""),
    "event trial": _Guess(
        ("trial", "trials", "recording", "recordings", "sample", "samples", "touch"), "the trials of events", ""
    ),
    "event label": _Guess((LABEL, "labels", "class", "classes"), "their class", "it changes within a trial: refused"),
}  # fmt: skip
"""Each guess by the name of a column, of all formats. A user's option decides in its place."""
OF_EVENTS = [what.removeprefix("event ") for what in GUESSES if what.startswith("event ")]
"""What the columns of events may be."""
OF_ARRAYS = ["signals", LABEL, "channels"]
"""What the arrays of a file may be."""


def called(names: Sequence[str], what: str) -> str | None:
    """The column that is `what` by its name, in upper or lower case; None if there is none.

    >>> called(["a", "Class", "label"], "label"), called(["t1", "Time [us]"], "time"), called(["a", "b"], "trial")
    ('label', 'Time [us]', None)
    """
    aliases = GUESSES[what].names
    if isinstance(aliases, re.Pattern):
        return next((name for name in names if aliases.fullmatch(name)), None)
    lower = {name.lower(): name for name in reversed(names)}
    return next((lower[alias] for alias in aliases if alias in lower), None)


class ColumnsSpec(Spec):
    """The columns of a text file of samples, counted from 1."""

    columns: Names = Field(default=(), json_schema_extra=chosen("all but the time column"))
    """The taxels, by numbers from 1 or by names, as in 1-5, left,right or p1-p8. Of a table of all trials, all columns
    of numbers that change within a trial when absent."""
    time_column: str | None = Field(
        default=None, json_schema_extra=chosen("one named time, timestamp or t (t_ms), else one of times of day")
    )
    """The column of time stamps, or in files of arrays their array; seconds and the rest as in sec,nanosec."""
    time_unit: Unit | None = Field(
        default=None, json_schema_extra=chosen("that of the column's name (t_ms), else the one that fits touch")
    )
    """Unit of the time stamps."""
    max_gap_ms: float | None = Field(default=None, gt=0, json_schema_extra=chosen("five times the usual one"))
    """Longest allowed interval between time stamps."""
    drop_repeats: bool = False
    """Drop every row with the time stamp of the row before it, in place of spreading such rows evenly."""
    missing: Missing | None = Field(default=None, json_schema_extra=chosen("refused"))
    """Empty cells, NaN and cut lines: fill them, at most 5 % of a trial, or drop their trials, at most 20 % of all."""
    decimal: Literal[".", ","] | None = Field(default=None, json_schema_extra=chosen("a comma where it must be one"))
    """Decimal separator."""
    header_lines: int | None = Field(default=None, ge=0, le=10_000, json_schema_extra=chosen("detected"))
    """Lines before the first sample. The last of them names the columns if it has as many cells; when absent, the lines
    that begin with `#`, and a first line without a single number."""

    def check_no_text(self, path: Path) -> None:
        """Refuse what only the reading of text needs."""
        for key in ("decimal", "header_lines"):
            if getattr(self, key) != ColumnsSpec.model_fields[key].default:
                raise InputError(f"{path}: `{key}` is for text files; leave it out")


class LayoutSpec(ColumnsSpec):
    """The columns of each text file, with the time column; or the array of each file of arrays.

    In a file of arrays `time_column` is the name of the array of stamps. In Python `nt.Layout`.
    """

    public = "Layout"
    array: str | None = Field(default=None, json_schema_extra=chosen("each is a trial"))
    """The array of each NPZ or MATLAB file that is its trial."""
    transpose: bool = False
    """Arrays are (taxel, time)."""


class Samples(NamedTuple):
    """One file: the taxels' names (none without a header), their samples, the time stamps, the first sample's line.

    time_unit: of the stamps, as asked for or as their column is named; None if neither says it. notes: what is said
    once of such files. constants: the texts of columns that are the same in each row, by the column's name.
    missing: which samples are missing and stand as NaN, `(time, taxel)`; None if none is. n_cut: how many lines are
    left out. units: of the taxels as the file says them; none if it does not.
    """

    names: tuple[str, ...]
    signal: np.ndarray
    time: np.ndarray | None
    first_line: int
    time_unit: Unit | None = None
    notes: tuple[str, ...] = ()
    constants: Mapping[str, str] = MappingProxyType({})
    missing: np.ndarray | None = None
    n_cut: int = 0
    units: tuple[str, ...] = ()


class _Columns(NamedTuple):
    """The places of the taxels, of the time and of the rest of its seconds, and what is said of others."""

    taxels: list[int]
    time: int | None
    notes: tuple[str, ...]
    rest: int | None = None


class Clock(NamedTuple):
    """The time stamps of all rows, `(row,)`, None without, and their unit, None if nothing says it."""

    time: np.ndarray | None
    unit: Unit | None


def read_table(path: Path, layout: LayoutSpec, *, find_time: bool = True) -> Samples:
    """The samples of a text file; `samples_of` says how. What may stand above them: `headings.open_table`."""
    table = open_table(path, layout.decimal, layout.header_lines, option="header_lines", choice=CHOICE)
    return samples_of(table, layout, find_time=find_time)


def samples_of(table: Table, layout: LayoutSpec, *, find_time: bool = True) -> Samples:
    """The samples of a table and their stamps, if the layout names a time column or the table has one by its name.

    find_time: whether a column that the layout does not name may be the time. Without one, the interval that the
    format says gives the times. Columns without a single number are no taxels, and are left out. Raises InputError,
    which names the file, the line and column, and the fix.
    """
    table.check_has_rows()
    first = table.first_row
    if not table.names and len(first) > 2 and first == [str(i) for i in range(len(first))]:
        raise InputError(
            f"{table.path}: line {table.first_line} counts 0 to {len(first) - 1}, which looks like column numbers, not "
            "a sample; name the taxels or remove the line (pandas: to_csv(header=False))"
        )
    ros_time = _ros_stamps(table) if find_time and not layout.columns and layout.time_column is None else None
    columns = _columns_of(table, layout, find_time)
    if ros_time is not None:
        note = f"columns 1 to {ROS_FIELDS} are the header of a ROS 2 message, whose stamp is the time"
        columns = _Columns([*range(ROS_FIELDS, table.n_columns)], None, (note,))
    is_of_day = columns.time is not None and is_time_of_day(first[columns.time])
    stamps_at = [column for column in (columns.time, columns.rest) if column is not None]
    n_cut = 0
    if layout.missing is not None:
        table, n_cut = with_whole_rows(table, are_kept=not stamps_at and ros_time is None)
    places = [*columns.taxels, *stamps_at]
    values = dict(zip(places, columns_at(table, places, stamps_at[:1] if is_of_day else ()), strict=True))
    clock = clock_of(table, columns.time, columns.rest, values, layout.time_unit)
    if clock.time is not None and columns.time is not None and layout.time_column is None and not is_of_day:
        check_rises(clock.time, table.names[columns.time], table.path)
    taxels, constants, notes = columns.taxels, {}, ()
    if not layout.columns:
        taxels, constants, notes = _without_texts(table, columns.taxels, values)
    if ros_time is not None:
        clock = Clock(ros_time, "s")
    elif clock.time is None and find_time and table.intervals_s:
        clock = evenly(table, taxels, len(values[taxels[0]]))
    signal = _signal(table, taxels, values, with_gaps=layout.missing is not None)
    names = tuple(table.names[column] for column in taxels) if table.names else ()
    if not all(names):
        names, notes = (), (*notes, "a column has no name, so the taxels have none")
    gaps, cut = np.isnan(signal), ("lines that are empty or cut are left out",) if n_cut else ()
    return Samples(
        names, signal, clock.time, table.first_line, clock.unit, (*table.notes, *columns.notes, *notes, *cut),
        constants, gaps if gaps.any() else None, n_cut, tuple(table.units[column] for column in taxels if table.units),
    )  # fmt: skip


def _signal(table: Table, taxels: Sequence[int], values: dict[int, np.ndarray], *, with_gaps: bool) -> np.ndarray:
    """The samples of these columns, `(time, taxel)` float32; with_gaps: missing ones are NaN, else they are refused."""
    if table.values and not with_gaps:
        return as_signal(np.stack([values[column] for column in taxels], axis=1), str(table.path))
    signal = np.empty((len(values[taxels[0]]), len(taxels)), np.float32)
    lost = ""
    for number, column in enumerate(taxels):
        samples = finite(table, column, values.pop(column), with_gaps=with_gaps)
        lost = lost or lost_digits(samples[np.isfinite(samples)] if with_gaps else samples)
        signal[:, number] = samples
    if not np.isnan(signal).any():
        check_first_row(signal, str(table.path), table.first_line)
    if lost:
        raise InputError(f"{table.path}: {lost}{CHOICE}")
    return signal


def evenly(table: Table, taxels: Sequence[int], n_rows: int) -> Clock:
    """The times of samples at the interval that a format says of each of these columns, if it does."""
    intervals_s = [interval for column in taxels if (interval := table.intervals_s[column]) is not None]
    if len(intervals_s) < len(taxels):
        return Clock(None, None)
    if max(intervals_s) - min(intervals_s) > SAME * max(intervals_s):
        raise InputError(f"{table.path}: has channels of different intervals; choose taxels of one with `columns`")
    return Clock(np.arange(n_rows) * intervals_s[0], "s")


def clock_of(
    table: Table, time: int | None, rest: int | None, values: Mapping[int, np.ndarray], asked: Unit | None
) -> Clock:
    """The time stamps in the column `time`, numbers or times of day, with the rest of their seconds in another one.

    values: the columns by their places. asked: the unit that the user gives.
    """
    if time is None:
        return Clock(None, asked)
    where, first = str(table.path), table.first_line
    is_of_day = values[time].dtype.kind == "U" and is_time_of_day(str(values[time][0]))
    if is_of_day:
        stamps = seconds_of(values[time].tolist(), where, str(time + 1), first, asked)
    else:
        stamps = finite(table, time, values[time])
    if rest is not None:
        name = table.names[rest] if table.names else str(rest + 1)
        return Clock(joined(stamps, finite(table, rest, values[rest]), name, where, first, asked), "s")
    return Clock(stamps, "s" if is_of_day else asked or unit_of(table, time, stamps))


def unit_of(table: Table, column: int, time: np.ndarray) -> Unit | None:
    """The unit of a column of times: in its name, below it, or that of nanoseconds since 1970; None if nothing says it.

    >>> table = Table(Path("felt.csv"), ("t", "left"), ",", "0,1", 2, units=("[ms]", "mV"))
    >>> unit_of(table, 0, np.zeros(1)), unit_of(table._replace(units=()), 0, np.array([1.7e18]))
    ('ms', 'ns')
    """
    named = unit_in(table.names[column]) if table.names else None
    below = unit_in(f"_{table.units[column].strip('[]()')}") if table.units else None
    is_since_1970 = time.dtype.kind in "iuf" and len(time) > 0 and time[0] > SINCE_1970_NS
    return named or below or ("ns" if is_since_1970 else None)


def _ros_stamps(table: Table) -> np.ndarray | None:
    """The stamps of ROS 2 messages in seconds from the first one on, `(row,)`; None if the columns are something else.

    `ros2 topic echo --csv` names no column, and begins each row with the header of the message, if it has one.
    """
    seconds, nanoseconds, frame = (*table.first_row[:ROS_FIELDS], "", "", "")[:ROS_FIELDS]
    if table.names or table.n_columns <= ROS_FIELDS or is_sample(frame) or not (seconds + nanoseconds).isdigit():
        return None
    second, rest_ns = columns_at(table, [0, 1])
    if second.dtype.kind not in "iu" or rest_ns.dtype.kind not in "iu":
        return None
    if not (LEAST_NS <= rest_ns.max() < SECOND_NS and min(second.min(), rest_ns.min()) >= 0):
        return None
    since_first = (second - second[0]).astype(np.float64) * SECOND_NS + (rest_ns - rest_ns[0])
    return since_first / SECOND_NS if (np.diff(since_first) >= 0).all() and since_first[-1] > 0 else None


def is_index(table: Table, column: int, values: np.ndarray) -> bool:
    """Whether a column is one in which pandas numbers the rows: without a name, and counting."""
    if not table.names or called([table.names[column]], "row number") is None or values.dtype.kind == "U":
        return False
    return bool((values == values[0] + np.arange(len(values))).all())


def _without_texts(
    table: Table, taxels: list[int], values: Mapping[int, np.ndarray]
) -> tuple[list[int], dict[str, str], tuple[str, ...]]:
    """The taxels without columns that hold no number, nor pandas' numbers of rows; of these, the columns that have a
    name and one text in all rows, with it; and what is said of the others.
    """
    texts = [column for column in taxels if values[column].dtype.kind == "U" and _holds_no_number(values[column])]
    index = [column for column in taxels if is_index(table, column, values[column])]
    rest = [column for column in taxels if column not in (*texts, *index)]
    if not rest:
        line = repr(" ".join(table.first_row))[:60]
        raise InputError(
            f"{table.path}: has no column of numbers for a taxel; line {table.first_line} is {line}: give a row per "
            "sample and a column per taxel"
        )
    notes = ["a column without a name numbers the rows and is no taxel"] if index else []
    alike = [column for column in texts if table.names and table.names[column] and values[column][0]]
    constants = {
        table.names[column]: str(values[column][0]) for column in alike if (values[column] == values[column][0]).all()
    }
    texts = [column for column in texts if column not in alike or table.names[column] not in constants]
    named = [table.names[column] if table.names else f"column {column + 1}" for column in texts]
    shown = [f"{name} ({values[column][0][:20]!r})" for name, column in zip(named, texts, strict=True)]
    return rest, constants, (*notes, *([f"holds no number, so no taxel: {some(shown)}"] if texts else []))


def _holds_no_number(texts: np.ndarray) -> bool:
    """Whether no cell of a column can be meant as a number; dates are none, and a single cell may be a fault."""
    like_numbers = (LIKE_NUMBER.match(cell) and not DATE.fullmatch(cell) for cell in texts.tolist())
    return len(texts) > 1 and not any(like_numbers)


def is_text(name: str) -> bool:
    """Whether a name is UTF-8 without control characters, which tables and figures cannot show."""
    return not any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name)


def _columns_of(table: Table, layout: LayoutSpec, find_time: bool) -> _Columns:
    names, first, path = table.names, table.first_row, table.path
    headers = [column for column, name in enumerate(names) if called([name], "ROS header")]
    chosen, time, rest = chosen_places(layout.columns, layout.time_column, names, first, path, find_time=find_time)
    taxels = chosen or [column for column in range(table.n_columns) if column not in (time, rest, *headers)]
    if not taxels:
        what = "channel" if table.values else "column"
        raise InputError(f"{path}: has no {what} besides the time; record at least one taxel")
    seen: set[str] = set()
    for column in [*taxels, *([] if time is None else [time])] if names else []:
        if names[column] in seen - {""}:
            raise InputError(f"{path}: two columns are named '{names[column][:40]}'; give each taxel its own name")
        if not is_text(names[column]):
            raise InputError(f"{path}: column {column + 1}, {names[column][:40]!a}, has control characters; rename it")
        seen.add(names[column])
    second = None if chosen else _stamps_at(names, first, [time, rest, *headers])[0]
    if second is not None:
        named = f" ('{names[second][:40]}')" if names else ""
        raise InputError(
            f"{path}: column {second + 1}{named} looks like time stamps but is not the time column; choose the taxels "
            "with `columns`, or remove the column"
        )
    left_out = [] if chosen else [names[column] for column in headers if column not in (time, rest)]
    notes = (f"the header of the ROS message is no taxel: {some(left_out)}",) if left_out else ()
    return _Columns(taxels, time, notes, rest)


def chosen_places(
    columns: Sequence[str],
    time_column: str | None,
    names: tuple[str, ...],
    first: Sequence[str],
    path: Path,
    *,
    find_time: bool,
    others: Mapping[str, Sequence[int]] = {},
) -> tuple[list[int], int | None, int | None]:
    """The places of the taxels that are asked for (none: all others), of the time stamps (None: there are none), and of
    the rest of their seconds (None: they have none of their own).

    first: the cells of the first row. find_time: whether a column that only looks like time stamps may be the time.
    others: the places of columns that are neither, by the option that names them.
    Raises InputError for a column that is named twice.
    """
    used = [column for those in others.values() for column in those]
    chosen = [column for choice in columns for column in _places(choice, names, len(first), "`columns`", path)]
    time = rest = None
    if time_column is not None:
        parts = apart(time_column, names)
        time, rest = [*(_places(part, names, len(first), "`time_column`", path)[0] for part in parts), None][:2]
    elif find_time:
        time, rest = _stamps_at(names, first, [*used, *chosen])
    named = [*chosen, *(column for column in (time, rest) if column is not None)]
    if len({*named}) < len(named) or {*named} & {*used}:
        *options, last = ("`columns`", "`time_column`", *others)
        raise InputError(f"{path}: {', '.join(options)} and {last} name a column twice; name each once")
    return chosen, time, rest


def _stamps_at(
    names: Sequence[str], first: Sequence[str], others: Collection[int | None]
) -> tuple[int | None, int | None]:
    """The place of the time stamps, and of the rest of their seconds, by their names; None if there is none.

    >>> _stamps_at(["seconds", "nanoseconds", "left"], [], []), _stamps_at(["time", "left_sec", "left_nsec"], [], [])
    ((0, 1), (0, None))
    """
    single, pair = _time_place(names, first, others), pair_in(names, others)
    return pair if pair is not None and single in (None, *pair) else (single, None)


def _time_place(names: Sequence[str], first: Sequence[str], others: Collection[int | None]) -> int | None:
    """The place of the first column that is named like time stamps, else of the first one that holds times of day.

    first: the cells of the first row. None if there is no such column beside `others`.

    >>> _time_place(["n", "Time [us]", "t1"], [], []), _time_place(["t", "taxel"], [], [0])
    (1, None)
    >>> _time_place([], ["0.5", "12:00:00.25"], [])
    1
    """
    named = (column for column, name in enumerate(names) if called([name], "time"))
    timed = (column for column, cell in enumerate(first) if is_time_of_day(cell))
    return next((column for column in (*named, *timed) if column not in others), None)


def check_rises(time: np.ndarray, name: str, path: Path) -> None:
    """Refuse stamps that only the name of their column shows, if they often fall: `T` may be a temperature."""
    if len(time) > 1 and (np.diff(time) < 0).mean() > FALLING:
        raise InputError(
            f"{path}: column '{name[:40]}' is named like time stamps, but its values fall; choose the taxels with "
            "`columns`, or the time with `time_column`"
        )


def _places(choice: str, names: tuple[str, ...], n_columns: int, option: str, path: Path) -> list[int]:
    """The columns that a name, a number, or a range of numbers or of names stands for."""
    if choice in names:
        return [names.index(choice)]
    ends = next(((choice[:index], choice[index + 1 :]) for index, mark in enumerate(choice) if mark == "-"
                 and choice[:index] in names and choice[index + 1 :] in names), None)  # fmt: skip
    match = RANGE.fullmatch(choice)
    if ends is not None and option == "`columns`":
        first, last = (names.index(end) for end in ends)
        return list(range(min(first, last), max(first, last) + 1))
    if match is None:
        hint = nearest(choice, list(names)) if names else "the file names no columns, so give a number"
        raise InputError(f"{path}: {option}: there is no column '{choice[:40]}'; {hint}")
    first = int(match[1])
    last = int(match[2] or first)
    if not 1 <= first <= last <= n_columns or (option == "`time_column`" and last > first):
        raise InputError(
            f"{path}: {option}: {choice} is not there, since this file has {number_of(n_columns, 'column')}, "
            "numbered from 1; name columns that it has, or move it away if it is from another sensor"
        )
    return list(range(first - 1, last))
