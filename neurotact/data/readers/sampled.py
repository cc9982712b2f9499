"""Sampled trials as they were read from text or arrays: their stamps, one clock, the same taxels, what looks wrong."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.readers import clock, doubts, first_rows, repeats, shared_stamps
from neurotact.data.readers.layout import Table
from neurotact.data.recordings import LABEL, Recordings, check_named_classes
from neurotact.errors import InputError
from neurotact.files import check_size

RATES_DIFFER, STANDARD_ERRORS = 0.01, 4.0
"""A trial has another sampling rate than the common one if it differs by this share, and by so many of its errors."""
COUNTS = {"count", "counts", "adc", "lsb", "digit", "digits", "step", "steps"}
"""Units of which samples are whole numbers."""

OTHER_UNIT = 100.0
"""If the given rate and that of the time stamps differ by this factor, the unit of the stamps is wrong."""

MATTERS, LOST = 0.01, 1.5
"""Jitter, and a longest interval, in intervals of samples: larger ones are said."""
OF_COLUMNS = doubts.Fixes("select the taxels with `columns`", "give `time_column`, or ")
"""What mends a wrong column."""

log = logging.getLogger("neurotact")


class Read(NamedTuple):
    """One trial as it was read. where: begins messages. file: its name among the others."""

    where: str
    file: str
    table: Table


class _Trial(NamedTuple):
    """One trial: its name among the others, its samples and their stamps."""

    file: str
    signal: np.ndarray
    stamps: clock.Stamps | None


def recordings(
    read: Sequence[Read],
    conditions: pd.DataFrame,
    sampling_rate_Hz: float | None,
    unit: str,
    *,
    max_gap_ms: float | None,
    drop_repeats: bool,
    source: str,
    where: str,
    fixes: doubts.Fixes | None = OF_COLUMNS,
) -> Recordings:
    """The trials at one sampling rate, given or from their stamps; irregular samples are interpolated, with a warning.

    Rows that share a time stamp are spread or dropped, as `clock.stamps_of` does, and counted in a warning.
    drop_repeats: whether more than `clock.MOST_DROPPED` of the rows may be dropped. where: of all trials, begins
    messages. fixes: of doubts about them; None says no doubt. Raises InputError for trials of other taxels, stamps that
    make no clock, or a wrong unit of time.
    """
    check_named_classes(conditions[LABEL].tolist(), where)
    _check_first_rows(read, sampling_rate_Hz, where)
    _check_same_channels(read)
    channels = _same_names(read)
    unit_of_time = _unit_of_time([trial.table for trial in read], sampling_rate_Hz, where)
    common_s = _common_interval(read, unit_of_time)
    trials = [
        _stamped(trial, unit_of_time, max_gap_ms, drop_repeats, given_Hz=sampling_rate_Hz, common_s=common_s)
        for trial in read
    ]
    if max_gap_ms is not None and all(trial.stamps is None for trial in trials):
        raise InputError(f"{where}: `max_gap_ms`: the samples have no time stamps; leave it out")
    repeats.say_dropped(_stamps_of(trials), drop_repeats, where)
    rate_Hz, signals = _on_one_clock(trials, sampling_rate_Hz, where)
    if unit.strip().lower() in COUNTS and doubts.are_thousandths(signals):
        raise InputError(
            f"{where}: the samples are in {unit}, but have three decimals, and none lies between 0 and 1, as if "
            "separators of thousands were decimal points; write whole numbers without them, or give another unit if "
            "these are no counts"
        )
    recordings_read = Recordings(signals, rate_Hz, unit, conditions, channels, source)
    if fixes is not None:
        doubts.say(recordings_read, where, fixes, rate_is_given=sampling_rate_Hz is not None)
    return recordings_read


def _unit_of_time(tables: Sequence[Table], given_Hz: float | None, where: str) -> clock.Unit:
    """The unit of the stamps whose files do not say it: seconds if these can be touch, else the one that can.

    A warning names it if it is not seconds. InputError if several can.
    """
    times = [table.time for table in tables if table.time is not None and table.time_unit is None]
    timings = clock.timings(times, given_Hz) if times else []
    if not timings or timings[0].unit == "s":
        return "s"
    said = [f"{timing.unit} (trials of {timing.trial_s:.3g} s at {timing.rate_Hz:.4g} Hz)" for timing in timings]
    if len(timings) > 1:
        raise InputError(f"{where}: the time stamps may be in {' or '.join(said)}; give their unit with `time_unit`")
    log.warning("%s: the time stamps are taken as %s; if that is wrong, give their unit with `time_unit`", where, *said)
    return timings[0].unit


def _stamps_of(trials: Sequence[_Trial]) -> dict[str, clock.Stamps]:
    """The stamps of the trials that have any, by the names of the trials."""
    return {trial.file: trial.stamps for trial in trials if trial.stamps is not None}


def _common_interval(read: Sequence[Read], unit: clock.Unit) -> float | None:
    """The median interval of samples that share stamps, in s; None if no trial tells it."""
    tables = [trial.table for trial in read]
    intervals_s = [
        shared_stamps.own_interval(table.time * clock.UNIT_S[table.time_unit or unit])
        for table in tables if table.time is not None
    ]  # fmt: skip
    known = [interval_s for interval_s in intervals_s if interval_s is not None]
    return clock.middle_of(known) if known else None


def _stamped(
    read: Read, unit: clock.Unit, max_gap_ms: float | None, drop_repeats: bool, *, given_Hz: float | None,
    common_s: float | None,
) -> _Trial:  # fmt: skip
    """The trial with the stamps of its samples; unit: of stamps whose file does not say it."""
    table = read.table
    if table.time is None:
        return _Trial(read.file, table.signal, None)
    stamps = clock.stamps_of(
        table.time, table.time_unit or unit, read.where, table.first_line, max_gap_ms,
        signal=table.signal, drop_repeats=drop_repeats, given_Hz=given_Hz, common_s=common_s,
    )  # fmt: skip
    return _Trial(read.file, table.signal[stamps.keep], stamps)


def _on_one_clock(trials: Sequence[_Trial], given_Hz: float | None, where: str) -> tuple[float, list[np.ndarray]]:
    """The sampling rate of all trials, given or from their stamps, and the samples at that rate."""
    stamps = [*_stamps_of(trials).values()]
    if not stamps:
        assert given_Hz is not None
        return float(given_Hz), [trial.signal for trial in trials]
    found_Hz = clock.rate_of(stamps)
    rate_Hz = found_Hz if given_Hz is None else float(given_Hz)
    _check_same_unit(trials, where)
    _check_unit(found_Hz, given_Hz, where)
    n_ticks = sum(trial.time_s[-1] * rate_Hz for trial in stamps)
    check_size(f"{where} at {rate_Hz:g} Hz", int(4 * n_ticks * trials[0].signal.shape[1]))
    signals = [
        trial.signal if trial.stamps is None else clock.on_clock(trial.signal, trial.stamps, rate_Hz)
        for trial in trials
    ]
    repeats.say_shared(_stamps_of(trials), rate_Hz, where)
    _say_moved(trials, signals, rate_Hz, where)
    return rate_Hz, signals


def _say_moved(trials: Sequence[_Trial], signals: Sequence[np.ndarray], rate_Hz: float, where: str) -> None:
    """Say how many trials of another rate are resampled, and how many are interpolated because their stamps jitter."""
    moved = {trial.file for trial, signal in zip(trials, signals, strict=True) if signal is not trial.signal}
    stamps = {file: its for file, its in _stamps_of(trials).items() if file in moved}
    odd = {file for file, its in stamps.items() if abs(its.interval_s * rate_Hz - 1) > _by_jitter(its)}
    if odd:
        first = next(file for file in stamps if file in odd)
        log.warning(
            "%s: %d of %d trials have another sampling rate than %g Hz and are resampled to it; the first is %s at "
            "%.4g Hz",
            where, len(odd), len(trials), rate_Hz, first, 1 / stamps[first].interval_s,
        )  # fmt: skip
    near = [its for file, its in stamps.items() if file not in odd]
    if not near:
        return
    jitter_ms = 1e3 * float(np.median([its.jitter_s for its in near]))
    worst_ms = 1e3 * max(float(np.diff(its.time_s).max()) for its in near if len(its.time_s) > 1)
    what = "the time stamps are a little off"
    if jitter_ms > MATTERS * 1e3 / rate_Hz or worst_ms > LOST * 1e3 / rate_Hz:
        what = (
            f"the time stamps jitter by {jitter_ms:.3g} ms (standard deviation of the intervals; the longest is "
            f"{worst_ms:.4g} ms)"
        )
    log.warning(
        "%s: %s: %d of %d trials are interpolated onto a regular clock of %g Hz",
        where, what, len(near), len(trials), rate_Hz,
    )  # fmt: skip


def _by_jitter(stamps: clock.Stamps) -> float:
    """Share by which a trial's rate may differ from the common one: it is a mean of intervals that jitter."""
    error_s = stamps.jitter_s / np.sqrt(len(stamps.time_s))
    return max(RATES_DIFFER, STANDARD_ERRORS * error_s / stamps.interval_s)


def _check_same_unit(trials: Sequence[_Trial], where: str) -> None:
    """Refuse trials of which one is a hundred times faster than another: their stamps are in different units."""
    intervals_s = {file: stamps.interval_s for file, stamps in _stamps_of(trials).items()}
    fast, slow = min(intervals_s, key=intervals_s.__getitem__), max(intervals_s, key=intervals_s.__getitem__)
    if intervals_s[slow] >= OTHER_UNIT * intervals_s[fast]:
        raise InputError(
            f"{where}: the time stamps give {1 / intervals_s[fast]:.4g} Hz in {fast} and {1 / intervals_s[slow]:.4g} "
            f"Hz in {slow}; if their units differ, write the unit at the end of the column's name (t_s, t_ms), or "
            "import them apart"
        )


def _check_unit(found_Hz: float, given_Hz: float | None, where: str) -> None:
    """Refuse time stamps that are a hundred times faster or slower than the given rate: their unit is wrong."""
    if given_Hz is not None and not 1 / OTHER_UNIT < found_Hz / given_Hz < OTHER_UNIT:
        raise InputError(
            f"{where}: the time stamps give {found_Hz:.3g} Hz and `sampling_rate_Hz` says {given_Hz:g} Hz; give the "
            "unit of the stamps with `time_unit` (s, ms, us, ns), or leave `sampling_rate_Hz` out"
        )


def _check_first_rows(read: Sequence[Read], given_Hz: float | None, where: str) -> None:
    """Refuse trials that begin with a start time; warn of those that seem to begin with their sampling rate."""
    for trial in read:
        first_rows.check(trial.table.signal, trial.where, trial.table.first_line)
    rates = [(trial, first_rows.rate_in(trial.table.signal, given_Hz)) for trial in read]
    found = [(trial, rate_Hz) for trial, rate_Hz in rates if rate_Hz is not None]
    if found:
        trial, rate_Hz = found[0]
        line = trial.table.first_line
        skip = f"skip it with `header_lines={line}`" if line else "remove it"
        log.warning(
            "%s: the first row of %d of %d trials looks like a sampling rate above the samples, as %g in %s; if it is "
            "one, %s", where, len(found), len(read), rate_Hz, trial.file, skip,
        )  # fmt: skip


def _check_same_channels(read: Sequence[Read]) -> None:
    first, expected = read[0].file, read[0].table.signal.shape[1]
    for trial in read:
        if trial.table.signal.shape[1] != expected:
            raise InputError(
                f"{trial.where}: has {trial.table.signal.shape[1]} channels where {first} has {expected}; "
                "every trial needs the same taxels"
            )


def _same_names(read: Sequence[Read]) -> tuple[str, ...]:
    """The names of the channels, which every trial that has names has in the same order."""
    named = [trial for trial in read if trial.table.names]
    for trial in named:
        for column, (name, wanted) in enumerate(zip(trial.table.names, named[0].table.names, strict=True), 1):
            if name != wanted:
                raise InputError(
                    f"{trial.where}: column {column} is '{name[:40]}' where {named[0].file} has '{wanted[:40]}'; "
                    "give all files the same taxels in the same order"
                )
    return named[0].table.names if named else ()
