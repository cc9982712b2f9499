"""Time stamps: their unit, the sampling rate of their samples, and resampling to a regular clock."""

import re
from array import array
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, cast

import numpy as np

from neurotact.errors import InputError

Unit = Literal["s", "ms", "us", "ns"]
UNIT_S: dict[Unit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
IN_NAME = re.compile(r"(?:_|\s*\[|\s*\()(s|ms|us|ns)[])]?$", re.IGNORECASE)
"""The unit at the end of a column's name: `t_ms`, `Time [us]`, `time (s)`."""
TIME_OF_DAY = re.compile(
    r"(?:(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4})[ T]+)?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)(?:Z| ?[+-]\d{2}:?\d{2})?",
    re.ASCII,
)
"""A time stamp with hours, minutes and seconds, with or without a date: `2024-01-31 12:00:00.25`."""
GAP = 5.0
"""An interval longer than this many median ones is a gap, unless the user gives a length."""
REGULAR = 0.01
"""Intervals that deviate by less than this share of the median one are regular."""
MOST_DECIMALS = 9
DAY_S = 86_400.0

SLOWEST_HZ, FASTEST_HZ = 10.0, 100_000.0
"""Sampling rates of touch."""
SHORTEST_S, LONGEST_S = 0.02, 600.0
"""Lengths of a trial of touch."""
NEAR_RATE = 10.0
"""Stamps in the right unit give a sampling rate within this factor of the user's."""


class Stamps(NamedTuple):
    """The sampling times of one file.

    time_s: from the first sample on, `(time,)`, ascending, without repeats. keep: their rows in the file.
    interval_s: the mean interval without gaps. jitter_s: standard deviation of the intervals, and the largest one.
    resolution_s: of the clock that wrote the stamps; deviations up to it are rounding.
    """

    time_s: np.ndarray
    keep: np.ndarray
    interval_s: float
    jitter_s: float
    resolution_s: float

    @property
    def is_regular(self) -> bool:
        """Whether intervals differ by no more than rounding or a negligible share."""
        intervals = np.diff(self.time_s)
        allowed = max(1.001 * self.resolution_s, REGULAR * self.interval_s)
        return bool(np.abs(intervals - self.interval_s).max() <= allowed)


def unit_in(name: str) -> Unit | None:
    """The unit that the name of a column of times ends with; None without one.

    >>> unit_in("event_t_ms"), unit_in("Time [us]"), unit_in("TIME (S)"), unit_in("times")
    ('ms', 'us', 's', None)
    """
    found = IN_NAME.search(name)
    return cast(Unit, found[1].lower()) if found else None


def without_unit(name: str) -> str:
    """The name of a column of times without its unit.

    >>> without_unit("time_us"), without_unit("Time [s]"), without_unit("times")
    ('time', 'Time', 'times')
    """
    return IN_NAME.sub("", name)


def is_time_of_day(cell: str) -> bool:
    """Whether a cell of text is a time stamp with hours, minutes and seconds.

    >>> [is_time_of_day(cell) for cell in ("2024-01-31T23:59:59.5Z", "31.1.2024 12:00:00,25", "12:00:00", "12:00")]
    [True, True, True, False]
    """
    return bool(TIME_OF_DAY.fullmatch(cell))


def seconds_of(cells: Iterable[str], where: str, column: str, first_line: int, unit: Unit | None) -> np.ndarray:
    """Seconds since midnight of the first day for time stamps with hours, minutes and seconds.

    A stamp whose date is another than that of the stamp before is of the next day. unit: the one that is asked for.
    Raises InputError, which begins with `where`, for a cell that is no such stamp, and for another unit than seconds.

    >>> seconds_of(["2024-01-31 23:59:59.5", "2024-02-01 00:00:00.5"], "felt.csv", "time", 2, None).tolist()
    [86399.5, 86400.5]
    """
    if unit not in (None, "s"):
        raise InputError(f"{where}: column {column} holds times of day, which are in seconds; leave --time-unit out")
    seconds = array("d")
    days, last = -1, None
    for line, cell in enumerate(cells, first_line):
        found = TIME_OF_DAY.fullmatch(cell)
        if found is None:
            raise InputError(
                f"{where}: line {line}, column {column} is {cell[:30]!r}, not a time as in 12:00:00.25; repair it or "
                "drop the file"
            )
        date, hours, minutes, of_minute = found.groups()
        days += date != last or days < 0
        last = date
        seconds.append(DAY_S * days + 3600 * int(hours) + 60 * int(minutes) + float(of_minute.replace(",", ".")))
    return np.array(seconds)


class Timing(NamedTuple):
    """What time stamps in one unit give: samples per second, and the length of the median trial in seconds."""

    unit: Unit
    rate_Hz: float
    trial_s: float


def timings(times: Sequence[np.ndarray], given_Hz: float | None = None) -> list[Timing]:
    """The units in which the stamps of these trials can be those of touch, the longest unit first.

    The rate is within a factor of ten of the given one; without one it is 10 Hz to 100 kHz, and the median trial lasts
    20 ms to 10 min. times: stamps of each trial, in the unknown unit.

    >>> [each.unit for each in timings([np.arange(0, 5000, 28)])], [each.unit for each in timings([np.arange(9) * 1e3])]
    (['ms'], [])
    >>> [each.unit for each in timings([np.arange(2000) * 100.0])]
    ['ms', 'us']
    """
    steps = [np.diff(time) for time in times]
    usual = float(np.median([np.median(each[each != 0]) for each in steps if each.any()] or [0.0]))
    if usual <= 0:
        return []
    length = float(np.median([time[-1] - time[0] for time in times]))
    found = [Timing(unit, 1 / (usual * unit_s), length * unit_s) for unit, unit_s in UNIT_S.items()]
    if given_Hz is not None:
        return [each for each in found if 1 / NEAR_RATE < each.rate_Hz / given_Hz < NEAR_RATE]
    return [
        each for each in found if SLOWEST_HZ <= each.rate_Hz <= FASTEST_HZ and SHORTEST_S <= each.trial_s <= LONGEST_S
    ]


def stamps_of(time: np.ndarray, unit: Unit, where: str, first_line: int, max_gap_ms: float | None) -> Stamps:
    """The stamps of a file; rows that repeat the previous stamp are dropped.

    first_line: the line of the first sample, 0 in an array. max_gap_ms: the longest interval; five median ones when
    None.
    Raises InputError, which begins with `where`, for stamps that go back, for a gap and for less than two times.
    """
    row = "line" if first_line else "sample"
    time_s = (time - time[0]) * UNIT_S[unit]
    keep = np.concatenate([[True], np.diff(time_s) != 0])
    lines = np.flatnonzero(keep) + first_line
    time_s = time_s[keep]
    if len(time_s) < 2:
        raise InputError(f"{where}: holds a single time, and a sampling rate needs two; drop the file")
    intervals = np.diff(time_s)
    if (intervals < 0).any():
        line = lines[int(np.argmax(intervals < 0)) + 1]
        raise InputError(f"{where}: {row} {line} is earlier than the {row} before it; sort the rows or drop the file")
    usual = float(np.median(intervals))
    most = GAP * usual if max_gap_ms is None else max_gap_ms * 1e-3
    if intervals.max() > most:
        at = int(np.argmax(intervals > most))
        raise InputError(
            f"{where}: {row} {lines[at + 1]} comes {1e3 * intervals[at]:.4g} ms after the {row} before it, where "
            f"{1e3 * usual:.4g} ms is usual; cut the file there, or allow such gaps with --max-gap-ms"
        )
    without_gaps = intervals[intervals <= GAP * usual]
    return Stamps(time_s, keep, float(without_gaps.mean()), float(without_gaps.std()), _resolution(time) * UNIT_S[unit])


def rate_of(stamps: Sequence[Stamps]) -> float:
    """Samples per second of all files, from their median interval, rounded to four digits or to 0.01 Hz.

    >>> rate_of([Stamps(np.arange(3) * 0.01075, np.ones(3, bool), 0.01075, 0.0, 0.0)])
    93.02
    """
    rate_Hz = 1 / float(np.median([each.interval_s for each in stamps]))
    return float(f"{rate_Hz:.4g}") if rate_Hz < 10 else round(rate_Hz, 2)


def on_clock(signal: np.ndarray, stamps: Stamps, sampling_rate_Hz: float) -> np.ndarray:
    """The samples at the ticks of a regular clock that starts with the first one, by linear interpolation.

    signal: `(time, channel)`, one row per stamp. Samples that are already on this clock are unchanged.

    >>> jittered = Stamps(np.array([0.0, 0.9, 2.1, 3.0]), np.ones(4, bool), 1.0, 0.1, 0.01)
    >>> on_clock(np.array([[0.0], [9.0], [21.0], [30.0]]), jittered, 1.0)[:, 0].round(6).tolist()
    [0.0, 10.0, 20.0, 30.0]
    """
    duration_s = stamps.time_s[-1]
    drift_s = abs(duration_s - (len(signal) - 1) / sampling_rate_Hz)
    if stamps.is_regular and drift_s <= 0.5 / sampling_rate_Hz:
        return signal
    n_ticks = int(np.floor(duration_s * sampling_rate_Hz + 1e-6)) + 1
    ticks = np.arange(n_ticks) / sampling_rate_Hz
    columns = [np.interp(ticks, stamps.time_s, column) for column in signal.T]
    return np.stack(columns, axis=1).astype(signal.dtype)


def _resolution(time: np.ndarray) -> float:
    """The unit of the last digit that the stamps use: 1 for whole numbers, 0.1 for one decimal."""
    for decimals in range(MOST_DECIMALS):
        if np.allclose(time, np.round(time, decimals), rtol=0, atol=1e-3 * 10.0**-decimals):
            return 10.0**-decimals
    return 10.0**-MOST_DECIMALS
