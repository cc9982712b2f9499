"""Time stamps as they are written: their unit, times of day, and whole seconds beside the rest of the second."""

import re
from array import array
from collections.abc import Collection, Iterable, Sequence
from typing import Literal, NamedTuple, cast

import numpy as np

from neurotact.errors import InputError

Unit = Literal["s", "ms", "us", "ns"]
UNIT_S: dict[Unit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
IN_NAME = re.compile(r"(?:_|\s*\[|\s*\()(s|ms|us|ns)[])]?$", re.IGNORECASE)
"""The unit at the end of a column's name: `t_ms`, `Time [us]`, `time (s)`."""
TIME_OF_DAY = re.compile(
    r"(?:(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{1,2}[- ][a-z]{3,9}[- ]\d{2,4})[ T]+)?"
    r"(?:(\d{1,2}):)?(\d{1,3}):(\d{2}(?:[.,]\d+)?)(?: ?([ap])\.?m\.?)?(?:Z| ?([+-]\d{2}):?(\d{2}))?",
    re.ASCII | re.IGNORECASE,
)
"""A time stamp with minutes and seconds, with or without hours and a date: `2024-01-31 12:00:00.25`,
`31-Jan-2024 01:00:00 PM`, `59:59.5`."""
DAY_S, HOUR_S = 86_400.0, 3600.0

SLOWEST_HZ, FASTEST_HZ = 10.0, 100_000.0
"""Sampling rates of touch."""
SHORTEST_S, LONGEST_S = 0.02, 600.0
"""Lengths of a trial of touch."""
NEAR_RATE = 10.0
"""Stamps in the right unit give a sampling rate within this factor of the user's."""

NAMED = re.compile(r"(.*?)(nano|micro|milli|[num])?sec(?:ond)?s?", re.IGNORECASE)
"""`sec`, `header.stamp.nanosec`, `tv_usec`, `stamp_nsecs`, `milliseconds`: a beginning, what is counted."""
_UNITS: dict[str, Unit] = {"nano": "ns", "n": "ns", "micro": "us", "u": "us", "milli": "ms", "m": "ms"}


def unit_in(name: str) -> Unit | None:
    """The unit that the name of a column of times ends with; None without one.

    >>> unit_in("event_t_ms"), unit_in("Time [us]"), unit_in("TIME (S)"), unit_in("times")
    ('ms', 'us', 's', None)
    """
    match = IN_NAME.search(name)
    return cast(Unit, match[1].lower()) if match else None


def without_unit(name: str) -> str:
    """The name of a column of times without its unit.

    >>> without_unit("time_us"), without_unit("Time [s]"), without_unit("times")
    ('time', 'Time', 'times')
    """
    return IN_NAME.sub("", name)


def is_time_of_day(cell: str) -> bool:
    """Whether a cell of text is a time stamp with hours, minutes and seconds, or with minutes and parts of seconds.

    `12:00` is not: it may be of hours and minutes.

    >>> [is_time_of_day(cell) for cell in ("2024-01-31T23:59:59.5Z", "31.1.2024 12:00:00,25", "12:00:00", "12:00")]
    [True, True, True, False]
    >>> [is_time_of_day(cell) for cell in ("31-Jan-2024 13:02:03.5", "01:02:03.5 PM", "02:03.5", "13:02:03 PM")]
    [True, True, True, False]
    """
    match = TIME_OF_DAY.fullmatch(cell)
    return match is not None and _of_day(match) is not None and (match[2] is not None or not match[4].isdigit())


def _of_day(match: re.Match[str]) -> float | None:
    """Seconds since midnight, or since the full hour, of a time stamp; None for an hour that a clock does not have."""
    _, hours, minutes, of_minute, half, *_ = match.groups()
    if (hours is not None and len(minutes) != 2) or (half and not 1 <= int(hours or 0) <= 12):
        return None
    hour = int(hours or 0) % 12 + 12 * (half in ("p", "P")) if half else int(hours or 0)
    return HOUR_S * hour + 60 * int(minutes) + float(of_minute.replace(",", "."))


def seconds_of(cells: Iterable[str], where: str, column: str, first_line: int, unit: Unit | None) -> np.ndarray:
    """Seconds since midnight of the first day for time stamps with hours, minutes and seconds, AM and PM or none.

    A stamp whose date is another than that of the stamp before is of the next day; without dates, one that is half a
    day earlier. Minutes and seconds alone begin again with each hour. A time zone at the end is taken off, so that a
    change to daylight-saving time is none. unit: the one that is asked for.
    Raises InputError, which begins with `where`, for a cell that is no such stamp, and for another unit than seconds.

    >>> seconds_of(["2024-01-31 23:59:59.5", "2024-02-01 00:00:00.5"], "felt.csv", "time", 2, None).tolist()
    [86399.5, 86400.5]
    >>> seconds_of(["02:59:59+02:00", "02:00:00+01:00"], "felt.csv", "time", 2, None).tolist()
    [3599.0, 3600.0]
    >>> seconds_of(["11:59:59.5 AM", "12:00:00.5 PM"], "felt.csv", "time", 2, None).tolist()
    [43199.5, 43200.5]
    >>> seconds_of(["59:59.5", "00:00.5"], "felt.csv", "time", 2, None).tolist()
    [3599.5, 3600.5]
    """
    if unit not in (None, "s"):
        raise InputError(f"{where}: column {column} holds times of day, which are in seconds; leave `time_unit` out")
    seconds = array("d")
    turns_s, last, before, has_hours = 0.0, None, None, None
    for line, cell in enumerate(cells, first_line):
        match = TIME_OF_DAY.fullmatch(cell)
        of_day = None if match is None else _of_day(match)
        is_alike = match is not None and has_hours in (None, match[2] is not None)
        if match is None or of_day is None or not is_alike:
            example = "59:59.25" if has_hours is False else "12:00:00.25"
            raise InputError(
                f"{where}: line {line}, column {column} is {cell[:30]!r}, not a time as in {example}; repair it or "
                "drop the file"
            )
        date, has_hours = match[1], match[2] is not None
        turn_s = DAY_S if has_hours else HOUR_S
        if before is not None and (date != last or (date is None and of_day < before - turn_s / 2)):
            turns_s += turn_s
        last, before = date, of_day
        zone = HOUR_S * int(match[6] or 0) + 60 * int(f"{(match[6] or '+')[0]}{match[7] or 0}")
        seconds.append(turns_s + of_day - zone)
    return np.array(seconds)


class _Timing(NamedTuple):
    """What time stamps in one unit give: samples per second, and the length of the median trial in seconds."""

    unit: Unit
    rate_Hz: float
    trial_s: float


def timings(times: Sequence[np.ndarray], given_Hz: float | None = None) -> list[_Timing]:
    """The units in which the stamps of these trials can be those of touch, the longest unit first.

    The rate is within a factor of ten of the given one; without one it is 10 Hz to 100 kHz, and the median trial lasts
    20 ms to 10 min. times: stamps of each trial, in the unknown unit.

    >>> [each.unit for each in timings([np.arange(0, 5000, 28)])], [each.unit for each in timings([np.arange(9) * 1e3])]
    (['ms'], [])
    >>> [each.unit for each in timings([np.arange(2000) * 100.0])]
    ['ms', 'us']
    """
    steps = [np.diff(time) for time in times]
    shared = [len(trial) / max(1, np.count_nonzero(trial)) for trial in steps]  # rows per stamp
    usual = float(np.median([
        np.median(trial[trial != 0]) / n for trial, n in zip(steps, shared, strict=True) if trial.any()
    ] or [0.0]))  # fmt: skip
    if usual <= 0:
        return []
    length = float(np.median([time[-1] - time[0] for time in times]))
    units = [_Timing(unit, 1 / (usual * unit_s), length * unit_s) for unit, unit_s in UNIT_S.items()]
    if given_Hz is not None:
        return [unit for unit in units if 1 / NEAR_RATE < unit.rate_Hz / given_Hz < NEAR_RATE]
    return [
        unit for unit in units if SLOWEST_HZ <= unit.rate_Hz <= FASTEST_HZ and SHORTEST_S <= unit.trial_s <= LONGEST_S
    ]


def pair_in(names: Sequence[str], others: Collection[int | None] = ()) -> tuple[int, int] | None:
    """The places of the first seconds and the rest of a second whose names begin alike, not among `others`.

    >>> pair_in(["stamp.sec", "stamp.nanosec", "left"]), pair_in(["left", "tv_sec", "tv_usec"], [0])
    ((0, 1), (1, 2))
    >>> pair_in(["seconds", "left"]), pair_in(["a_sec", "b_nsec"])
    (None, None)
    """
    seconds: dict[str, int] = {}
    rests: dict[str, int] = {}
    for column, name in enumerate(names):
        match = NAMED.fullmatch(name.strip())
        if match and column not in others:
            (rests if match[2] else seconds).setdefault(match[1].lower(), column)
    return next(((column, rests[begin]) for begin, column in seconds.items() if begin in rests), None)


def apart(name: str, names: Collection[str]) -> list[str]:
    """The one or two columns that a name or `seconds,rest` stands for; a column may have a comma in its name.

    >>> apart("sec,nanosec", ["sec", "nanosec"]), apart("time, s", ["time, s"]), apart("1,2", [])
    (['sec', 'nanosec'], ['time, s'], ['1', '2'])
    """
    parts = [part.strip() for part in name.split(",")]
    return [name] if name in names or len(parts) != 2 or not all(parts) else parts


def joined(
    seconds: np.ndarray, rest: np.ndarray, name: str, where: str, first_line: int, unit: Unit | None = None
) -> np.ndarray:
    """The stamps in seconds, `(row,)`. name: of the column of the rest, which says its unit, or else the values do.

    Raises InputError, which begins with `where`, for seconds that are not whole, for a rest of a second or more, and
    for a `unit` that is asked for. first_line: the line of the first row, 0 in an array.

    >>> joined(np.array([7.0, 8.0]), np.array([5e8, 0.0]), "nanosec", "felt.csv", 2).tolist()
    [7.5, 8.0]
    """
    row = "line" if first_line else "sample"
    if unit is not None:
        raise InputError(f"{where}: `time_unit`: seconds and {name} together are in seconds; leave it out")
    unit = _unit_of(name, rest)
    wrong = np.flatnonzero((rest < 0) | (rest * UNIT_S[unit] >= 1))
    if len(wrong):
        raise InputError(
            f"{where}: {row} {wrong[0] + first_line}: {name} is {rest[wrong[0]]:.12g} {unit}, not the rest of a "
            "second; name the time stamps with `time_column`"
        )
    broken = np.flatnonzero(seconds != np.floor(seconds))
    if len(broken):
        raise InputError(
            f"{where}: {row} {broken[0] + first_line}: the seconds are {seconds[broken[0]]:.12g}, not whole, so that "
            f"{name} is no rest of them; name the time stamps with `time_column`"
        )
    return seconds + rest * UNIT_S[unit]


def _unit_of(name: str, rest: np.ndarray) -> Unit:
    """The unit of the rest of a second: by its name, else the longest in which all values are less than a second.

    >>> _unit_of("tv_usec", np.array([5.0])), _unit_of("ms", np.array([5.0])), _unit_of("2", np.array([5.0, 250_000.0]))
    ('us', 'ms', 'us')
    """
    counted = NAMED.fullmatch(name.strip())
    named = _UNITS.get((counted[2] or "").lower()) if counted else unit_in(f"_{name.strip()}")
    if named not in (None, "s"):
        return named
    most = float(np.max(rest, initial=0.0))
    return "ms" if most < 1e3 else "us" if most < 1e6 else "ns"
