"""Sampled trials as they were read from text or arrays: their stamps, one clock, the same taxels, what looks wrong."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from neurotact_parts.readers.clock.shared import own_interval
from neurotact_parts.readers.clock.stamps import MOST_DROPPED, Stamps, middle_of, on_clock, rate_of, stamps_of
from neurotact_parts.readers.doubts import Fixes, are_thousandths, say_doubts, say_unit, units_in

from neurotact.data.readers.clock.units import UNIT_S, Unit, timings
from neurotact.data.readers.columns import Missing, Samples
from neurotact.data.readers.table.headings import check_first_row, rate_in
from neurotact.data.recordings import LABEL, Recordings, check_named_classes
from neurotact.errors import InputError, in_digits, number_of, some
from neurotact.files import check_size
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

RATES_DIFFER, STANDARD_ERRORS = 0.01, 4.0
"""A trial has another sampling rate than the common one if it differs by this share, and by so many of its errors."""
COUNTS = {"count", "counts", "adc", "lsb", "digit", "digits", "step", "steps"}
"""Units of which samples are whole numbers."""

OTHER_UNIT = 100.0
"""If the given rate and that of the time stamps differ by this factor, the unit of the stamps is wrong."""

MATTERS, LOST = 0.01, 1.5
"""Jitter, and a longest interval, in intervals of samples: larger ones are said."""
OF_COLUMNS = Fixes("select the taxels with `columns`", "give `time_column`, or ")
"""What mends a wrong column."""


class Read(NamedTuple):
    """One trial as it was read. where: begins messages. file: its name among the others."""

    where: str
    file: str
    table: Samples


class _Trial(NamedTuple):
    """One trial: its name among the others, its samples and their stamps."""

    file: str
    signal: np.ndarray
    stamps: Stamps | None


def recordings_of(
    read: Sequence[Read],
    conditions: pd.DataFrame,
    sampling_rate_Hz: float | None,
    unit: str,
    *,
    max_gap_ms: float | None,
    drop_repeats: bool,
    source: str,
    where: str,
    fixes: Fixes | None = OF_COLUMNS,
) -> Recordings:
    """The trials at one sampling rate, given or from their stamps; irregular samples are interpolated, with a warning.

    Rows that share a time stamp are spread or dropped, as `stamps_of` does, and counted in a warning.
    drop_repeats: whether more than `MOST_DROPPED` of the rows may be dropped. where: of all trials, begins
    messages. fixes: of doubts about them; None says no doubt. Raises InputError for trials of other taxels, stamps that
    make no clock, or a wrong unit of time.
    """
    check_named_classes(conditions[LABEL].tolist(), where)
    _check_first_rows(read, sampling_rate_Hz, where)
    channels = _same_names(read)
    unit_of_time = _unit_of_time([trial.table for trial in read], sampling_rate_Hz, where)
    stamps_s = [its.time * UNIT_S[its.time_unit or unit_of_time] for _, _, its in read if its.time is not None]
    known = [interval_s for interval_s in map(own_interval, stamps_s) if interval_s is not None]
    common_s = middle_of(known) if known else None
    trials: list[_Trial] = []
    for where_read, file, its in read:
        if its.time is None:
            trials.append(_Trial(file, its.signal, None))
            continue
        stamps = stamps_of(
            its.time, its.time_unit or unit_of_time, where_read, its.first_line, max_gap_ms,
            signal=its.signal, drop_repeats=drop_repeats, given_Hz=sampling_rate_Hz, common_s=common_s,
        )  # fmt: skip
        trials.append(_Trial(file, its.signal[stamps.keep], stamps))
    if max_gap_ms is not None and all(trial.stamps is None for trial in trials):
        raise InputError(f"{where}: `max_gap_ms`: the samples have no time stamps; leave it out")
    _say_dropped(_stamps_of(trials), drop_repeats, where)
    rate_Hz, signals = _on_one_clock(trials, sampling_rate_Hz, where)
    if unit.strip().lower() in COUNTS and are_thousandths(signals):
        raise InputError(
            f"{where}: the samples are in {unit}, but have three decimals, and none lies between 0 and 1, as if "
            "separators of thousands were decimal points; write whole numbers without them, or give another unit if "
            "these are no counts"
        )
    recordings_read = Recordings(signals, rate_Hz, unit, conditions, channels, source)
    if fixes is not None:
        say_unit({**units_in(channels), **units_of(read, channels)}, unit, where)
        say_doubts(recordings_read, where, fixes, rate_is_given=sampling_rate_Hz is not None)
    return recordings_read


def units_of(read: Sequence[Read], channels: Sequence[str]) -> dict[str, str]:
    """The units of taxels that files say beside their names, by taxel."""
    names = channels or [f"taxel {taxel}" for taxel in range(1, read[0].table.signal.shape[1] + 1)]
    return {name: unit for trial in read for name, unit in zip(names, trial.table.units, strict=False)}


def _unit_of_time(tables: Sequence[Samples], given_Hz: float | None, where: str) -> Unit:
    """The unit of the stamps whose files do not say it: seconds if these can be touch, else the one that can.

    A warning names it if it is not seconds. InputError if several can.
    """
    times = [table.time for table in tables if table.time is not None and table.time_unit is None]
    fitting = timings(times, given_Hz) if times else []
    if not fitting or fitting[0].unit == "s":
        return "s"
    said = [
        f"{timing.unit} (trials of {in_digits(timing.trial_s)} s at {in_digits(timing.rate_Hz, 4)} Hz)"
        for timing in fitting
    ]
    if len(fitting) > 1:
        raise InputError(f"{where}: the time stamps may be in {' or '.join(said)}; give their unit with `time_unit`")
    log.warning("%s: the time stamps are taken as %s; if that is wrong, give their unit with `time_unit`", where, *said)
    return fitting[0].unit


def _stamps_of(trials: Sequence[_Trial]) -> dict[str, Stamps]:
    """The stamps of the trials that have any, by the names of the trials."""
    return {trial.file: trial.stamps for trial in trials if trial.stamps is not None}


def _on_one_clock(trials: Sequence[_Trial], given_Hz: float | None, where: str) -> tuple[float, list[np.ndarray]]:
    """The sampling rate of all trials, given or from their stamps, and the samples at that rate."""
    stamps = [*_stamps_of(trials).values()]
    if not stamps:
        assert given_Hz is not None
        return float(given_Hz), [trial.signal for trial in trials]
    found_Hz = rate_of(stamps)
    rate_Hz = found_Hz if given_Hz is None else float(given_Hz)
    intervals_s = {file: its.interval_s for file, its in _stamps_of(trials).items()}
    fast, slow = min(intervals_s, key=intervals_s.__getitem__), max(intervals_s, key=intervals_s.__getitem__)
    if intervals_s[slow] >= OTHER_UNIT * intervals_s[fast]:
        raise InputError(
            f"{where}: the time stamps give {1 / intervals_s[fast]:.4g} Hz in {fast} and {1 / intervals_s[slow]:.4g} "
            f"Hz in {slow}; if their units differ, write the unit at the end of the column's name (t_s, t_ms), or "
            "import them apart"
        )
    if not 1 / OTHER_UNIT < found_Hz / rate_Hz < OTHER_UNIT:
        raise InputError(
            f"{where}: the time stamps give {in_digits(found_Hz)} Hz and `sampling_rate_Hz` says {rate_Hz:g} Hz; give "
            "the unit of the stamps with `time_unit` (s, ms, us, ns), or leave `sampling_rate_Hz` out"
        )
    n_ticks = sum(trial.time_s[-1] * rate_Hz for trial in stamps)
    check_size(f"{where} at {rate_Hz:g} Hz", int(4 * n_ticks * trials[0].signal.shape[1]))
    signals = [
        trial.signal if trial.stamps is None else on_clock(trial.signal, trial.stamps, rate_Hz) for trial in trials
    ]
    _say_shared(_stamps_of(trials), rate_Hz, where)
    _say_moved(trials, signals, rate_Hz, where)
    return rate_Hz, signals


def _say_moved(trials: Sequence[_Trial], signals: Sequence[np.ndarray], rate_Hz: float, where: str) -> None:
    """Say how many trials of another rate are resampled, and how many are interpolated because their stamps jitter."""
    moved = {trial.file for trial, signal in zip(trials, signals, strict=True) if signal is not trial.signal}
    stamps = {file: its for file, its in _stamps_of(trials).items() if file in moved}
    odd = set()
    for file, its in stamps.items():  # their rates are means of intervals that jitter
        by_jitter = STANDARD_ERRORS * its.jitter_s / np.sqrt(len(its.time_s)) / its.interval_s
        if abs(its.interval_s * rate_Hz - 1) > max(RATES_DIFFER, by_jitter):
            odd.add(file)
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


def _check_first_rows(read: Sequence[Read], given_Hz: float | None, where: str) -> None:
    """Refuse trials that begin with a start time; warn of those that seem to begin with their sampling rate."""
    for trial in read:
        check_first_row(trial.table.signal, trial.where, trial.table.first_line)
    rates = [(trial, rate_in(trial.table.signal, given_Hz)) for trial in read]
    found = [(trial, rate_Hz) for trial, rate_Hz in rates if rate_Hz is not None]
    if found:
        trial, rate_Hz = found[0]
        line = trial.table.first_line
        skip = f"skip it with `header_lines={line}`" if line else "remove it"
        log.warning(
            "%s: the first row of %d of %d trials looks like a sampling rate above the samples, as %g in %s; if it is "
            "one, %s", where, len(found), len(read), rate_Hz, trial.file, skip,
        )  # fmt: skip


def _same_names(read: Sequence[Read]) -> tuple[str, ...]:
    """The names of the channels, which every trial that has names has in the same order; all have as many channels."""
    first, expected = read[0].file, read[0].table.signal.shape[1]
    for trial in read:
        if (found := trial.table.signal.shape[1]) != expected:
            more, fewer = (trial, read[0]) if found > expected else (read[0], trial)
            others = [name for name in more.table.names if name not in fewer.table.names] if fewer.table.names else []
            of = f" ({some(others)} {'is' if len(others) == 1 else 'are'} not in {fewer.file})" if others else ""
            raise InputError(
                f"{trial.where}: has {number_of(found, 'channel')} where {first} has {expected}{of}; move the file "
                "away, or name taxels that all files have with `columns`"
            )
    named = [trial for trial in read if trial.table.names]
    for trial in named:
        for column, (name, wanted) in enumerate(zip(trial.table.names, named[0].table.names, strict=True), 1):
            if name != wanted:
                raise InputError(
                    f"{trial.where}: column {column} is '{name[:40]}' where {named[0].file} has '{wanted[:40]}'; "
                    "give all files the same taxels in the same order"
                )
    return named[0].table.names if named else ()


def _say_dropped(stamps: Mapping[str, Stamps], drop_repeats: bool, where: str) -> None:
    """Say how many rows are dropped; InputError if they are many, and `drop_repeats` does not ask for it.

    stamps: of each trial that has any, by its name. where: of all trials, begins messages.
    InputError, too, if `drop_repeats` drops nothing.
    """
    fewer = {name: its for name, its in stamps.items() if its.n_dropped}
    if not fewer:
        if drop_repeats:
            why = "no row has the time stamp of the row before it" if stamps else "the samples have no time stamps"
            raise InputError(f"{where}: `drop_repeats`: {why}; leave it out")
        return
    n_rows, n_dropped = _n_rows(stamps), sum(its.n_dropped for its in fewer.values())
    which = f"in {len(fewer)} of {len(stamps)} trials; the first is {next(iter(fewer))}"
    if n_dropped > MOST_DROPPED * n_rows and not drop_repeats:
        raise InputError(
            f"{where}: {n_dropped:,} of {n_rows:,} rows repeat the row before them with its time stamp ({which}); drop "
            "them with `drop_repeats=True`, or give `sampling_rate_Hz` if each row is a sample of its own"
        )
    log.warning(
        "%s: %s of %s rows repeat the time stamp of the row before them and are dropped (%s)",
        where, f"{n_dropped:,}", f"{n_rows:,}", which,
    )  # fmt: skip


def _say_shared(stamps: Mapping[str, Stamps], rate_Hz: float, where: str) -> None:
    """Say how many rows share the stamp of the row before them and are spread; rate_Hz: of the recordings."""
    shared = {name: its for name, its in stamps.items() if its.n_shared}
    if shared:
        n_shared = sum(its.n_shared for its in shared.values())
        log.warning(
            "%s: %s of %s rows have the time stamp of the row before them (in %d of %d trials); all are kept, spread "
            "evenly over the time to the next stamp, at %g Hz; if that is wrong, give `sampling_rate_Hz` or "
            "`drop_repeats=True`",
            where, f"{n_shared:,}", f"{_n_rows(shared):,}", len(shared), len(stamps), rate_Hz,
        )  # fmt: skip


def _n_rows(stamps: Mapping[str, Stamps]) -> int:
    return sum(len(its.keep) for its in stamps.values())


MOST_INTERPOLATED = 0.05
"""Share of a trial's samples of a taxel that may be interpolated: more would be a signal that nobody recorded."""


MOST_TRIALS_DROPPED = 0.2
"""Share of the trials that may be dropped: more would be another set."""


def mended(read: Sequence[Read], how: Missing | None, where: str) -> tuple[list[Read], list[int]]:
    """The trials without missing samples, and their numbers in `read`.

    Logs how many samples are interpolated, or which trials are dropped. Raises InputError beyond the limits, and where
    nothing is missing.
    """
    everything = [*range(len(read))]
    if how is None:
        return [*read], everything
    marked = {number: trial for number, trial in enumerate(read) if trial.table.missing is not None}
    cut = [number for number, trial in enumerate(read) if trial.table.n_cut]
    if not marked and not cut:
        raise InputError(f"{where}: `missing='{how}'`: no sample is missing; leave it out")
    if how == "drop-trial":
        dropped = {*marked, *cut}
        names = some([read[number].file for number in sorted(dropped)])
        if len(dropped) > MOST_TRIALS_DROPPED * len(read):
            raise InputError(
                f"{where}: {len(dropped)} of {len(read)} trials have missing samples ({names}), more than "
                f"{100 * MOST_TRIALS_DROPPED:.0f} % to drop; record them again, or use `missing='interpolate'`"
            )
        said = (where, len(dropped), len(read), names)
        log.warning("%s: %d of %d trials have missing samples and are dropped (%s)", *said)
        kept = [number for number in everything if number not in dropped]
        return [read[number] for number in kept], kept
    if not marked:
        return [*read], everything  # lines without a sample, which leave a gap between stamps
    mended = [_interpolated(trial) if number in marked else trial for number, trial in enumerate(read)]
    n_missing = sum(int(trial.table.missing.sum()) for trial in marked.values() if trial.table.missing is not None)
    n_all = sum(trial.table.signal.size for trial in read)
    log.warning(
        "%s: %s of %s samples are missing and interpolated, in %d of %d trials (%s)",
        where, f"{n_missing:,}", f"{n_all:,}", len(marked), len(read), some([trial.file for trial in marked.values()]),
    )  # fmt: skip
    return mended, everything


def _interpolated(trial: Read) -> Read:
    """The trial with missing samples on the line between their neighbours, and equal to the nearest one at the ends."""
    its, missing = trial.table, trial.table.missing
    assert missing is not None
    shares = missing.mean(axis=0)
    worst = int(np.argmax(shares))
    if shares[worst] > MOST_INTERPOLATED:
        name = its.names[worst] if its.names else f"taxel {worst + 1}"
        raise InputError(
            f"{trial.where}: {100 * shares[worst]:.1f} % of the samples of {name} are missing, more than "
            f"{100 * MOST_INTERPOLATED:.0f} % to interpolate; record it again, or use `missing='drop-trial'`"
        )
    signal, at = its.signal.copy(), np.arange(len(its.signal)) if its.time is None else its.time
    for taxel in np.flatnonzero(missing.any(axis=0)):
        gap = missing[:, taxel]
        signal[gap, taxel] = np.interp(at[gap], at[~gap], signal[~gap, taxel])
    return trial._replace(table=its._replace(signal=signal, missing=None))
