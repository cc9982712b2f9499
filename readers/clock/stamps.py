"""The stamps of samples: rows that share one, gaps, the sampling rate, and resampling to a regular clock."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from neurotact_parts.readers.clock.shared import Uneven, on_line, spread

from neurotact.data.readers.clock.units import FASTEST_HZ, HOUR_S, LONGEST_S, SHORTEST_S, SLOWEST_HZ, UNIT_S, Unit
from neurotact.errors import InputError, in_digits

GAP = 5.0
"""An interval longer than this many median ones is a gap, unless the user gives a length."""
REGULAR = 0.01
"""Intervals that deviate by less than this share of the median one are regular."""
MOST_DROPPED = 0.05
"""Share of the rows that may be dropped as repeats without being asked for."""
BY_CHANCE = 0.05
"""Probability below which rows that all repeat the values before them, too, do not do so by chance."""
SPAN = 1.1
"""Rows at a given rate may last longer or shorter than their stamps by this factor."""
SLOWER = 1.1
"""Factor from which on the interval of a file is longer than that of the clock, and not only by jitter."""
MOST_DECIMALS = 9
OF_GIVEN_RATE = "check `sampling_rate_Hz`, which is in samples per second"
OF_STAMPS = "if the unit of the time stamps is another, give it with `time_unit`"
"""What to do about a rate that is given, and about one that time stamps tell."""


class Stamps(NamedTuple):
    """The sampling times of one file.

    time_s: from the first sample on, `(time,)`, ascending, without repeats. keep: their rows in the file.
    interval_s: the mean interval without gaps. jitter_s: standard deviation of the intervals, and the largest one.
    resolution_s: of the clock that wrote the stamps; deviations up to it are rounding.
    n_shared: rows that had the stamp of the row before and were spread.
    """

    time_s: np.ndarray
    keep: np.ndarray
    interval_s: float
    jitter_s: float
    resolution_s: float
    n_shared: int = 0

    @property
    def is_regular(self) -> bool:
        """Whether intervals differ by no more than rounding or a negligible share."""
        intervals = np.diff(self.time_s)
        allowed = max(1.001 * self.resolution_s, REGULAR * self.interval_s)
        return bool(np.abs(intervals - self.interval_s).max() <= allowed)

    @property
    def n_dropped(self) -> int:
        """Rows of the file that were dropped as repeats."""
        return len(self.keep) - len(self.time_s)


def of_rate(lengths: np.ndarray, rate_Hz: float, fix: str) -> Iterator[str]:
    """The doubt of a rate of samples or steps that is none of touch, else of the length of the median trial.

    >>> list(of_rate(np.array([9000, 9000]), 10.0, "check the rate"))
    ['the median trial lasts 900 s at 10 Hz, which is long for touch; check the rate']
    """
    if not SLOWEST_HZ <= rate_Hz <= FASTEST_HZ:
        yield f"{rate_Hz:g} Hz is {'slow' if rate_Hz < SLOWEST_HZ else 'fast'} for touch; {fix}"
    elif lengths.max() > 1:
        yield from of_length(float(np.median(lengths)) / rate_Hz, fix, f" at {rate_Hz:g} Hz")


def of_length(trial_s: float, fix: str, at: str = "") -> Iterator[str]:
    """The doubt of the length of the median trial in s. at: the rate that it is of, in words."""
    if not SHORTEST_S <= trial_s <= LONGEST_S:
        long = "short" if trial_s < SHORTEST_S else "long"
        yield f"the median trial lasts {in_digits(trial_s)} s{at}, which is {long} for touch; {fix}"


def stamps_of(
    time: np.ndarray,
    unit: Unit,
    where: str,
    first_line: int,
    max_gap_ms: float | None,
    *,
    signal: np.ndarray | None = None,
    drop_repeats: bool = False,
    given_Hz: float | None = None,
    common_s: float | None = None,
) -> Stamps:
    """The stamps of a file. Rows with the stamp of the row before are spread evenly, or dropped if they repeat it.

    They are dropped if they repeat the values, too, more often than by chance, or if they are few and the other stamps
    are regular. Otherwise they are spread (`shared_stamps`). first_line: the line of the first sample, 0 in an array.
    max_gap_ms: the longest interval between stamps; five median ones when None. signal: the samples, `(time, channel)`.
    drop_repeats: drop all such rows. given_Hz: the given sampling rate. common_s: the interval of samples in other
    files of the same import, for a file with less than three stamps.
    Raises InputError, which begins with `where`, for stamps that go back, for a gap, for less than two times, and for
    rows that share stamps so unevenly that they cannot be spread.
    """
    time_s = (time - time[0]) * UNIT_S[unit]
    keep = np.concatenate([[True], np.diff(time_s) != 0])
    rows = _Rows("line" if first_line else "sample", np.flatnonzero(keep) + first_line)
    _check_ascends(time_s[keep], rows, where, max_gap_ms)
    resolution_s = _resolution(time) * UNIT_S[unit]
    if keep.all() or drop_repeats:
        if keep.sum() < 2:
            raise InputError(f"{where}: holds a single time, and a sampling rate needs two; drop the file")
        return _stamps(time_s[keep], keep, resolution_s)
    placed = _shared(time_s, keep, resolution_s, signal, given_Hz, common_s)
    if not isinstance(placed, Stamps):
        raise InputError(f"{where}: {_not_spread(placed, keep, rows, given_Hz)}")
    return placed


def row_times(time: np.ndarray) -> np.ndarray:
    """When each row of a continuous recording was sampled, in the unit of its stamps, which ascend and may repeat.

    Rows that share stamps are spread; the stamps are unchanged where none is shared, or where they are uneven.

    >>> row_times(np.repeat([7.0, 8.0, 9.0], [1, 2, 2])).tolist()
    [7.5, 8.0, 8.5, 9.0, 9.5]
    """
    later = np.flatnonzero(np.diff(time)) + 1
    if len(later) in (0, len(time) - 1):
        return time
    even = spread(time - time[0], _resolution(time))
    return even - even[later[0]] + time[later[0]] if isinstance(even, np.ndarray) else time


class _Rows(NamedTuple):
    """What a row is called in messages, and the number of the row of each distinct stamp."""

    name: str
    lines: np.ndarray


def _shared(
    time_s: np.ndarray, keep: np.ndarray, resolution_s: float, signal: np.ndarray | None, given_Hz: float | None,
    common_s: float | None,
) -> Stamps | Uneven | None:  # fmt: skip
    """The stamps of a file in which rows share stamps; keep: the first row of each. Else why there are none."""
    n_rows, n_repeats = len(keep), int((~keep).sum())
    every = np.ones(n_rows, bool)
    given_s = None if given_Hz is None else 1 / given_Hz
    if given_s is not None and on_line(time_s, resolution_s, given_s):
        return _stamps(np.arange(n_rows) * given_s, every, 0.0, n_repeats)
    dropped = _stamps(time_s[keep], keep, resolution_s) if keep.sum() > 1 else None
    is_few = n_repeats <= MOST_DROPPED * n_rows
    if dropped and ((is_few and dropped.is_regular) or _are_copies(signal, keep)):
        return dropped
    even = spread(time_s, resolution_s, common_s)
    if isinstance(even, np.ndarray):
        return _stamps(even, every, 0.0, n_repeats)
    distinct_s = time_s[keep]  # the rows of the last one last as long as usual
    lasts_s = float(distinct_s[-1] + np.median(np.diff(distinct_s))) if len(distinct_s) > 1 else np.inf
    if given_s is not None and 1 / SPAN < n_rows * given_s / lasts_s < SPAN:
        return _stamps(np.arange(n_rows) * given_s, every, 0.0, n_repeats)
    return dropped if dropped and is_few else even


def _stamps(time_s: np.ndarray, keep: np.ndarray, resolution_s: float, n_shared: int = 0) -> Stamps:
    intervals = np.diff(time_s)
    without_gaps = intervals[intervals <= GAP * float(np.median(intervals))]
    return Stamps(time_s, keep, float(without_gaps.mean()), float(without_gaps.std()), resolution_s, n_shared)


def _check_ascends(time_s: np.ndarray, rows: _Rows, where: str, max_gap_ms: float | None) -> None:
    """InputError if distinct stamps go back or have a gap."""
    intervals = np.diff(time_s)
    if not len(intervals):
        return
    if (intervals < 0).any():
        row = int(np.argmax(intervals < 0))
        raise InputError(
            f"{where}: {rows.name} {rows.lines[row + 1]} is earlier than the {rows.name} before it, by "
            f"{-intervals[row]:.4g} s{_set_by_an_hour(intervals[row])}; sort the rows, cut the file there, or drop it"
        )
    usual = float(np.median(intervals))
    most = GAP * usual if max_gap_ms is None else max_gap_ms * 1e-3
    if intervals.max() > most:
        row = int(np.argmax(intervals > most))
        raise InputError(
            f"{where}: {rows.name} {rows.lines[row + 1]} comes {1e3 * intervals[row]:.4g} ms after the {rows.name} "
            f"before it, where {1e3 * usual:.4g} ms is usual{_set_by_an_hour(intervals[row])}; cut the file there, or "
            "allow such gaps with `max_gap_ms`"
        )


def _set_by_an_hour(interval_s: float) -> str:
    """What a jump of an hour may be."""
    return " (a clock that was set, as for daylight-saving time?)" if abs(abs(interval_s) - HOUR_S) <= 60 else ""


def _are_copies(signal: np.ndarray | None, keep: np.ndarray) -> bool:
    """Whether all rows that repeat a stamp repeat the values, too, where other rows change too often for that."""
    if signal is None:
        return False
    is_same = np.concatenate([[False], (signal[1:] == signal[:-1]).all(axis=1)])
    if not is_same[~keep].all():
        return False
    unchanged = is_same[1:][keep[1:]].mean()
    return bool(unchanged ** int((~keep).sum()) <= BY_CHANCE)


def _not_spread(uneven: Uneven | None, keep: np.ndarray, rows: _Rows, given_Hz: float | None) -> str:
    """Why rows that share stamps are not spread, and what to do."""
    n_rows = len(keep)
    if len(rows.lines) == 1:
        return f"holds a single time in {n_rows:,} rows, and a sampling rate needs two; give `sampling_rate_Hz`"
    why = "and two time stamps do not tell the sampling rate"
    if uneven is not None:
        line = uneven.row + rows.lines[0]
        why = (
            f"too unevenly to be spread: {uneven.n_rows} within {uneven.lasts_s:.4g} s from {rows.name} {line} on, "
            f"where {uneven.usual:.3g} are usual"
        )
    fix = "give `sampling_rate_Hz` if the samples are regular"
    if given_Hz is not None:
        why = f"{why}; they do not last as long as at {given_Hz:g} Hz"
        fix = "correct or leave out `sampling_rate_Hz`"
    return (
        f"{int((~keep).sum()):,} of {n_rows:,} rows have the time stamp of the row before them, {why}; {fix}, or drop "
        "them with `drop_repeats=True`"
    )


def middle_of(values: Sequence[float]) -> float:
    """The lower median: one of the values.

    >>> middle_of([4.0, 1.0, 2.0, 8.0])
    2.0
    """
    return sorted(values)[(len(values) - 1) // 2]


def rate_of(stamps: Sequence[Stamps]) -> float:
    """Samples per second of all files, from the median of their intervals, rounded to four digits or to 0.01 Hz.

    Of two rates in the middle it is the faster one, which loses no sample of any file; never one that no file has.

    >>> rate_of([Stamps(np.arange(3) * 0.01075, np.ones(3, bool), 0.01075, 0.0, 0.0)])
    93.02
    """
    rate_Hz = 1 / middle_of([trial.interval_s for trial in stamps])
    return float(f"{rate_Hz:.4g}") if rate_Hz < 10 else round(rate_Hz, 2)


def on_clock(signal: np.ndarray, stamps: Stamps, sampling_rate_Hz: float) -> np.ndarray:
    """The samples at the ticks of a regular clock that starts with the first one, by linear interpolation.

    signal: `(time, channel)`, one row per stamp. Samples that are already on this clock are unchanged. The last sample
    of a slower file holds as long as its samples last.

    >>> jittered = Stamps(np.array([0.0, 0.9, 2.1, 3.0]), np.ones(4, bool), 1.0, 0.1, 0.01)
    >>> on_clock(np.array([[0.0], [9.0], [21.0], [30.0]]), jittered, 1.0)[:, 0].round(6).tolist()
    [0.0, 10.0, 20.0, 30.0]
    """
    duration_s = stamps.time_s[-1]
    drift_s = abs(duration_s - (len(signal) - 1) / sampling_rate_Hz)
    if stamps.is_regular and drift_s <= 0.5 / sampling_rate_Hz:
        return signal
    last_ticks = stamps.interval_s * sampling_rate_Hz
    n_ticks = int(np.floor(duration_s * sampling_rate_Hz + (last_ticks if last_ticks > SLOWER else 1.0) + 1e-6))
    ticks = np.arange(n_ticks) / sampling_rate_Hz
    columns = [np.interp(ticks, stamps.time_s, column) for column in signal.T]
    return np.stack(columns, axis=1).astype(signal.dtype)


def _resolution(time: np.ndarray) -> float:
    """The unit of the last digit that the stamps use: 1 for whole numbers, 0.1 for one decimal.

    Large numbers have no finer digits than their type holds, which is float32 if all stamps are such numbers.

    >>> _resolution(np.arange(3) * 0.25), _resolution((40_000 + np.arange(9) * 0.001).astype(np.float32).astype(float))
    (0.01, 0.00390625)
    """
    largest = np.abs(time).max()
    single = time.astype(np.float32)
    held = np.spacing(np.float32(largest)) if (single == time).all() else np.spacing(largest)
    for decimals in range(MOST_DECIMALS):
        if np.allclose(time, np.round(time, decimals), rtol=0, atol=1e-3 * 10.0**-decimals):
            return max(10.0**-decimals, float(held))
    return max(10.0**-MOST_DECIMALS, float(held))
