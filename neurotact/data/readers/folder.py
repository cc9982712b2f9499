"""A plain folder of recordings: text or NPZ files, with conditions in sub-folders, file names or a table."""

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurotact.data.readers import clock
from neurotact.data.readers.archives import as_signal, read_arrays
from neurotact.data.readers.layout import LayoutSpec, Table, is_text, read_table
from neurotact.data.readers.naming import SUFFIXES, TEXTS, NamingSpec, conditions_of
from neurotact.data.recordings import Recordings, check_sampling_rate
from neurotact.errors import InputError
from neurotact.files import below, check_size, existing, is_hidden
from neurotact.spec import build

USUAL = (".csv", ".npz")
"""Files that are read; other text files are notes, unless a folder holds none of these."""
MOST_NAMED = 5
"""Ignored files named in a warning; the others are counted."""
KINDS = ".csv, .tsv, .txt or .npz"
RATES_DIFFER = 0.1
"""Share by which a file's sampling rate may differ from the common one without a warning."""

OTHER_UNIT = 100.0
"""If the given rate and that of the time stamps differ by this factor, the unit of the stamps is wrong."""
LEAST_RISING = 20
"""Samples of a trial from which on a channel that never falls causes a warning."""

log = logging.getLogger("neurotact")


class _Read(NamedTuple):
    """One trial as it was read: its file, how it is named in the conditions, and its samples."""

    path: Path
    file: str
    table: Table


class _Trial(NamedTuple):
    """One trial: its file, its channels' names (none without a header), samples and their stamps."""

    file: str
    names: tuple[str, ...]
    signal: np.ndarray
    stamps: clock.Stamps | None


def read(
    folder: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    naming: Mapping[str, Any] | None = None,
    layout: Mapping[str, Any] | None = None,
) -> Recordings:
    """The recordings in a folder of CSV and NPZ files, at any depth, in the order of their paths.

    naming: keys of `naming.NamingSpec`: the source of the class and the conditions of each file; the first
    sub-folder is the label when absent.
    layout: keys of `layout.LayoutSpec`: which columns are taxels, which is the time, the number format; all
    columns but the time are taxels when absent.

    CSV: one row per sample, one column per taxel; commas, `;` or tabs between them; a first row without a single number
    names the columns. With a time column the sampling rate is that of the stamps, unless it is given, and irregular
    samples are interpolated onto a regular clock, with a warning. NPZ: each array is one trial,
    (time, channel). All trials have the same taxels. Conditions: label, those of `naming`, file (its path in the
    folder; of an array `file.npz:key`).

    If there is neither CSV nor NPZ, .txt and .tsv files are read as CSV. Hidden files and other kinds of file are
    ignored, with a warning that names them.

    Raises InputError, which names the file, the line and column, and the fix.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> (folder / "felt").mkdir()
    >>> _ = (folder / "felt" / "slow.csv").write_text("left,right\\n0.1,0.2\\n0.3,0.4\\n")
    >>> touch = read(folder, sampling_rate_Hz=100, unit="mV")
    >>> touch.signals[0].shape, touch.channels, touch.classes
    ((2, 2), ('left', 'right'), ('felt',))
    """
    folder = existing(folder, "folder")
    names, table = build(NamingSpec, naming or {}, "import folder"), build(LayoutSpec, layout or {}, "import folder")
    if sampling_rate_Hz is not None:
        check_sampling_rate(sampling_rate_Hz, str(folder))
    if not unit.strip():
        raise InputError(f"{folder}: the unit of the signals is empty; give one, such as mV")
    paths = _data_files(folder, names)
    files = [path.relative_to(folder).as_posix() for path in paths]
    of_files = conditions_of(files, names, folder)
    read: list[_Read] = []
    row_of = []
    n_bytes = 0
    for row, path in enumerate(paths):
        found = _read(path, files[row], table, find_time=sampling_rate_Hz is None or not table.columns)
        if sampling_rate_Hz is None and found[0].table.time is None:
            raise InputError(f"{folder}: the sampling rate is not known; give --sampling-rate-Hz, or --time-column")
        read += found
        row_of += [row] * len(found)
        n_bytes += sum(each.table.signal.nbytes for each in found)
        check_size(folder, n_bytes)
    unit_of_time = _unit_of_time([each.table for each in read], sampling_rate_Hz, folder)
    trials = [_stamped(each, unit_of_time, table.max_gap_ms) for each in read]
    _check_same_channels({trial.file: trial.signal for trial in trials}, folder)
    channels = _same_names({trial.file: trial.names for trial in trials if trial.names}, folder)
    _warn_of_other_columns(trials, channels, folder)
    rate_Hz, signals = _on_one_clock(trials, sampling_rate_Hz, folder)
    conditions = of_files.iloc[row_of].reset_index(drop=True)
    conditions["file"] = [trial.file for trial in trials]
    return Recordings(signals, rate_Hz, unit, conditions, channels, f"folder {folder.name}")


def _read(path: Path, file: str, layout: LayoutSpec, *, find_time: bool) -> list[_Read]:
    if path.suffix.lower() in TEXTS:
        return [_Read(path, file, read_table(path, layout, find_time=find_time))]
    if layout.time_column is not None or layout.columns:
        raise InputError(f"{path}: --columns and --time-column are for CSV files; save the chosen columns, or as CSV")
    arrays = read_arrays(path).items()
    signals = {key: as_signal(array, f"{path}, key '{key}'") for key, array in arrays}
    return [_Read(path, f"{file}:{key}", Table((), signal, None, 0)) for key, signal in signals.items()]


def _unit_of_time(tables: Sequence[Table], given_Hz: float | None, folder: Path) -> clock.Unit:
    """The unit of the stamps whose files do not say it: seconds if these can be touch, else the one that can.

    A warning names it if it is not seconds. InputError if several can.
    """
    times = [table.time for table in tables if table.time is not None and table.time_unit is None]
    found = clock.timings(times, given_Hz) if times else []
    if not found or found[0].unit == "s":
        return "s"
    said = [f"{each.unit} (trials of {each.trial_s:.3g} s at {each.rate_Hz:.4g} Hz)" for each in found]
    if len(found) > 1:
        raise InputError(f"{folder}: the time stamps may be in {' or '.join(said)}; give their unit with --time-unit")
    log.warning(
        "%s: the time stamps are taken as %s; if that is wrong, give their unit with --time-unit", folder, *said
    )
    return found[0].unit


def _stamped(read: _Read, unit: clock.Unit, max_gap_ms: float | None) -> _Trial:
    """The trial with the stamps of its samples; unit: of stamps whose file does not say it."""
    path, table = read.path, read.table
    if table.time is None:
        return _Trial(read.file, table.names, table.signal, None)
    stamps = clock.stamps_of(table.time, table.time_unit or unit, str(path), table.first_line, max_gap_ms)
    dropped = len(table.time) - len(stamps.time_s)
    if dropped:
        log.warning("%s: %d rows repeat the time stamp of the row before them and are dropped", path, dropped)
    return _Trial(read.file, table.names, table.signal[stamps.keep], stamps)


def _warn_of_other_columns(trials: Sequence[_Trial], channels: Sequence[str], folder: Path) -> None:
    """Warn of columns that are rarely taxels: a constant one (a temperature of the board), and one that rises
    throughout every trial while others fall (time stamps without a name, a counter of samples).
    """
    first = trials[0].signal[0]
    constant = np.logical_and.reduce([(trial.signal == first).all(axis=0) for trial in trials])
    if constant.any() and not constant.all():
        log.warning(
            "%s: every sample has the same value in %s; select the taxels with --columns",
            folder, _named_taxels(constant, channels),
        )  # fmt: skip
    rising = np.logical_and.reduce([_rises(trial.signal) for trial in trials])
    if rising.any() and not rising.all():
        log.warning(
            "%s: %s rises throughout every trial, as time stamps or a counter do; give --time-column, or select the "
            "taxels with --columns",
            folder, _named_taxels(rising, channels),
        )  # fmt: skip


def _rises(signal: np.ndarray) -> np.ndarray:
    """Of each channel of `(time, channel)`, whether it rises and never falls over enough samples to be no chance."""
    if len(signal) < LEAST_RISING:
        return np.zeros(signal.shape[1], bool)
    return (signal[1:] >= signal[:-1]).all(axis=0) & (signal[-1] > signal[0])


def _named_taxels(chosen: np.ndarray, channels: Sequence[str]) -> str:
    names = [channels[at] if channels else f"column {at + 1} of the taxels" for at in np.flatnonzero(chosen).tolist()]
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _on_one_clock(trials: Sequence[_Trial], given_Hz: float | None, folder: Path) -> tuple[float, list[np.ndarray]]:
    """The sampling rate of all trials, given or from their stamps, and the samples at that rate."""
    stamps = [trial.stamps for trial in trials if trial.stamps is not None]
    if not stamps:
        assert given_Hz is not None
        return float(given_Hz), [trial.signal for trial in trials]
    found_Hz = clock.rate_of(stamps)
    rate_Hz = found_Hz if given_Hz is None else float(given_Hz)
    _check_unit(found_Hz, given_Hz, float(np.median([each.time_s[-1] for each in stamps])), folder)
    n_ticks = sum(each.time_s[-1] * rate_Hz for each in stamps)
    check_size(f"{folder} at {rate_Hz:g} Hz", int(4 * n_ticks * trials[0].signal.shape[1]))
    signals = [
        trial.signal if trial.stamps is None else clock.on_clock(trial.signal, trial.stamps, rate_Hz)
        for trial in trials
    ]
    n_moved = sum(signal is not trial.signal for signal, trial in zip(signals, trials, strict=True))
    if n_moved:
        jitter_ms = [1e3 * each.jitter_s for each in stamps]
        worst_ms = 1e3 * max(float(np.diff(each.time_s).max()) for each in stamps)
        log.warning(
            "%s: the time stamps jitter by %.3g ms (standard deviation of the intervals; the longest is %.4g ms): %d "
            "of %d trials are interpolated onto a regular clock of %g Hz",
            folder, float(np.median(jitter_ms)), worst_ms, n_moved, len(trials), rate_Hz,
        )  # fmt: skip
    _warn_of_other_rates(trials, rate_Hz, folder)
    return rate_Hz, signals


def _check_unit(found_Hz: float, given_Hz: float | None, median_s: float, folder: Path) -> None:
    """Refuse time stamps that are a hundred times faster or slower than the given rate: their unit is wrong.

    Without a given rate, warn if they are too slow or too fast for touch. median_s: length of the median trial.
    """
    if given_Hz is not None:
        if not 1 / OTHER_UNIT < found_Hz / given_Hz < OTHER_UNIT:
            raise InputError(
                f"{folder}: the time stamps give {found_Hz:.3g} Hz and --sampling-rate-Hz says {given_Hz:g} Hz; give "
                "the unit of the stamps with --time-unit (s, ms, us, ns), or leave --sampling-rate-Hz out"
            )
    elif found_Hz < clock.SLOWEST_HZ:
        log.warning(
            "%s: the time stamps give %.3g Hz, which is slow for touch; if their unit is another, give it with "
            "--time-unit",
            folder, found_Hz,
        )  # fmt: skip
    elif median_s < clock.SHORTEST_S:
        log.warning(
            "%s: the time stamps give %.4g Hz and a median trial of %.3g ms, which is short for touch; if their unit "
            "is another, give it with --time-unit",
            folder, found_Hz, 1e3 * median_s,
        )  # fmt: skip


def _warn_of_other_rates(trials: Sequence[_Trial], rate_Hz: float, folder: Path) -> None:
    rates_Hz = {trial.file: 1 / trial.stamps.interval_s for trial in trials if trial.stamps is not None}
    odd = [file for file, each_Hz in rates_Hz.items() if abs(each_Hz / rate_Hz - 1) > RATES_DIFFER]
    if odd:
        log.warning(
            "%s: %d files have another sampling rate than %g Hz and are resampled to it; the first is %s at %.4g Hz",
            folder, len(odd), rate_Hz, odd[0], rates_Hz[odd[0]],
        )  # fmt: skip


def _data_files(folder: Path, naming: NamingSpec) -> list[Path]:
    """The files to read; a warning names ignored files, and a folder or file that would be lost is refused."""
    table = None if naming.table is None else os.path.realpath(naming.table)
    paths = [path.relative_to(folder) for path in below(folder) if table is None or os.path.realpath(path) != table]
    found = _with_suffix(paths, USUAL) or _with_suffix(paths, SUFFIXES)
    read = set(found)
    ignored = [path for path in paths if path not in read]
    if naming.is_label_by_folder:
        _check_label_folders(folder, found, naming.pattern)
    elif not found:
        raise InputError(f"{folder}: holds no {KINDS} file; save the recordings in one of these formats")
    for inside in found:
        if not is_text(str(inside)):
            raise InputError(
                f"{folder}: the name {str(inside)!a} is not printable UTF-8 text; rename that file or folder"
            )
    if ignored:
        names = ", ".join(map(str, ignored[:MOST_NAMED])) + (", ..." if len(ignored) > MOST_NAMED else "")
        log.warning("%s: %d files are ignored (hidden, or not recordings): %s", folder, len(ignored), names)
    return [folder / inside for inside in found]


def _with_suffix(paths: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    return [path for path in paths if path.suffix.lower() in suffixes and not is_hidden(path.name)]


def _check_label_folders(folder: Path, found: Sequence[Path], pattern: str | None) -> None:
    labels = {place.name for place in folder.iterdir() if place.is_dir() and not is_hidden(place.name)}
    if not labels:
        lacks = "" if pattern is None else f", and --pattern {pattern} no {{label}}"
        raise InputError(
            f"{folder}: holds no sub-folder{lacks}; put the files of each class in a sub-folder named by its label, or "
            "give the label with --pattern, as in '{label}_{number}.csv', or --conditions"
        )
    for inside in found:
        if len(inside.parts) == 1:
            raise InputError(
                f"{folder / inside}: is beside the sub-folders and has no label; put it in the sub-folder of its "
                "class or move it away"
            )
    empty = sorted(labels - {inside.parts[0] for inside in found})
    if empty:
        raise InputError(f"{folder / empty[0]}: holds no {KINDS} file; add one or remove the sub-folder")


def _check_same_channels(signals: dict[str, np.ndarray], folder: Path) -> None:
    first, expected = next((file, signal.shape[1]) for file, signal in signals.items())
    for file, signal in signals.items():
        if signal.shape[1] != expected:
            raise InputError(
                f"{folder / file}: has {signal.shape[1]} channels where {first} has {expected}; "
                "every trial needs the same taxels"
            )


def _same_names(headers: dict[str, tuple[str, ...]], folder: Path) -> tuple[str, ...]:
    if not headers:
        return ()
    first, expected = next(iter(headers.items()))
    for file, names in headers.items():
        for column, (name, wanted) in enumerate(zip(names, expected, strict=True), 1):
            if name != wanted:
                raise InputError(
                    f"{folder / file}: column {column} is '{name[:40]}' where {first} has '{wanted[:40]}'; "
                    "give all files the same taxels in the same order"
                )
    return expected
