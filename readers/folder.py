"""A plain folder of recordings: text, arrays or TDMS files, with conditions in sub-folders, file names or a table."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from neurotact_parts.readers.arrays import ArrayFile, opened_arrays, said_rates, sampling_rate_of
from neurotact_parts.readers.clock.trials import OF_COLUMNS, Read, mended, recordings_of
from neurotact_parts.readers.doubts import Fixes, kinds_of_names
from neurotact_parts.readers.events.signed_matrix import SIGNED_MATRIX, holds_events
from neurotact_parts.readers.file_names import labelled, unnamed

from neurotact.data.readers.clock.units import Unit, apart, joined, pair_in, unit_in
from neurotact.data.readers.columns import LayoutSpec, Samples, called, is_text, read_table, samples_of
from neurotact.data.readers.formats import holding, suffixes, tables_in
from neurotact.data.readers.formats.contents import content_of
from neurotact.data.readers.specs import FIELD, FILE, NamingSpec
from neurotact.data.readers.table.cells import NUMBER, as_signal, columns_of
from neurotact.data.readers.table.headings import named_table
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.errors import InputError, nearest, number_of, some
from neurotact.files import below, check_size, existing, is_hidden
from neurotact.lazily import lazily
from neurotact.spec import build

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

TEXTS = (".csv", ".tsv", ".txt", ".lvm")
OF_NUMPY = (".npz", ".npy")
MATLAB = ".mat"
"""In MATLAB a vector is a matrix of one row or column, and texts and single numbers often stand beside the samples."""


def conditions_of(files: Sequence[str], naming: NamingSpec, folder: Path) -> pd.DataFrame:
    """One row per file (paths within `folder`): label, the other conditions, file.

    Raises InputError for a file that does not fit a level, the pattern or the table, and if no label is given.

    >>> naming = NamingSpec(levels="label", pattern="F{force}_{repetition}.csv")
    >>> conditions_of(["felt/F3_0.csv", "felt/F6_0.csv"], naming, Path("my-data")).values.tolist()
    [['felt', 3, 0, 'felt/F3_0.csv'], ['felt', 6, 0, 'felt/F6_0.csv']]
    """
    table = _read_table(naming.table, files) if naming.table is not None else {file: {} for file in files}
    levels = (LABEL,) if naming.is_label_by_folder else naming.levels
    if naming.pattern is None and naming.table is None and (parts := unnamed(files, levels)):
        log.warning(
            "%s: parts of file names are not read as conditions, such as %s of %s; name them with `pattern`, as in "
            "`pattern=%r`", folder, " and ".join(parts.example), files[0], parts.pattern,
        )  # fmt: skip
    rows = []
    for file in files:
        parts = [*_of_path(file, levels, naming.pattern, folder), table[file]]
        names = [name for part in parts for name in part]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(f"{naming.table}: the condition '{twice[0]}' is also given by the file's path or name")
        rows.append({name: value for part in parts for name, value in part.items()})
    conditions = _with_label(pd.DataFrame(rows), naming.label, folder)
    for name in conditions.columns.drop(LABEL):
        texts = conditions[name].astype(str)
        if all(NUMBER.fullmatch(text) and not re.match(r"[+-]?0\d", text) for text in texts):  # 007 is a name
            conditions[name] = pd.to_numeric(texts)
    conditions = conditions[[LABEL, *conditions.columns.drop(LABEL)]]
    conditions[FILE] = list(files)
    return conditions


def _with_label(conditions: pd.DataFrame, label: str | None, folder: Path) -> pd.DataFrame:
    """The conditions of each file, that which is the class called `label`."""
    names = [*map(str, conditions.columns)]
    if label is not None and label not in names:
        if not names:
            raise InputError(
                f"{folder}: no condition is called {label}, as no condition is named; name the sub-folders with "
                f"`levels={label!r}`, or leave out `label`: the first sub-folder is the class"
            )
        raise InputError(f"{folder}: no condition is called {label}; {nearest(label, names)}")
    if label not in (None, LABEL):
        if LABEL in names:
            raise InputError(f"{folder}: a condition is called label already; rename it, or leave out `label`")
        conditions = conditions.rename(columns={label: LABEL})
    if LABEL not in conditions:
        named = f"name it with `label`, of {', '.join(names)}"
        fix = named if names else "add it with `levels`, `pattern` or `conditions`"
        raise InputError(f"{folder}: no condition is called label, the class of each file; {fix}")
    return conditions


def _compiled(pattern: str) -> re.Pattern[str]:
    """A pattern with names in braces as a regular expression of named groups."""
    parts = FIELD.split(pattern)  # text, name, text, ...
    return re.compile("".join(re.escape(part) if i % 2 == 0 else f"(?P<{part}>[^/]+?)" for i, part in enumerate(parts)))


def _of_path(file: str, levels: Sequence[str], pattern: str | None, folder: Path) -> tuple[dict, dict]:
    """The conditions in the names of the sub-folders, and those in the name of the file."""
    *above, _ = parts = PurePosixPath(file).parts
    if len(above) < len(levels):
        raise InputError(
            f"{folder / file}: is {len(above)} sub-folders deep, but `levels` names {len(levels)} "
            f"({', '.join(levels)}); move it, or name fewer levels"
        )
    found: dict[str, str] = {}
    for level, name in zip(levels, above, strict=False):
        match = _compiled(level if "{" in level else f"{{{level}}}").fullmatch(name)
        if match is None:
            raise InputError(f"{folder / file}: the folder '{name}' does not fit the level {level}; rename one of them")
        found |= match.groupdict()
    if pattern is None:
        return found, {}
    if not pattern.lower().endswith(every_suffix()):
        parts = PurePosixPath(file).with_suffix("").parts
    match = _compiled(pattern).fullmatch("/".join(parts[-1 - pattern.count("/") :]))
    if match is None:
        raise InputError(f"{folder / file}: its name does not fit the pattern {pattern}; rename it or move it away")
    return found, match.groupdict()


def _read_table(path: str, files: Sequence[str]) -> dict[str, dict[str, str]]:
    """The conditions of each file, by the table in `path`."""
    table = named_table(Path(path))
    if FILE not in table.names:
        raise InputError(f"{path}: has no column 'file', the path of each file; {nearest(FILE, [*table.names])}")
    if "" in table.names:
        raise InputError(f"{path}: column {table.names.index('') + 1} has no name; give it one, or remove it")
    columns = columns_of(table)
    by_name: dict[str, list[str]] = {}
    for file in files:
        by_name.setdefault(PurePosixPath(file).name, []).append(file)
    rows: dict[str, dict[str, str]] = {}
    for number, row in enumerate(zip(*(columns[name].tolist() for name in table.names), strict=True), table.first_line):
        given = dict(zip(table.names, row, strict=True))
        name = given.pop(FILE)
        fitting = [name] if name in files else by_name.get(name, [])
        if len(fitting) != 1:
            why = "is not a file of recordings in the folder" if not fitting else f"is the name of {len(fitting)} files"
            raise InputError(f"{path}: line {number}: '{name[:80]}' {why}; give its path within the folder")
        if fitting[0] in rows:
            raise InputError(f"{path}: line {number}: '{name[:80]}' already has a line above; drop one of them")
        rows[fitting[0]] = given
    absent = [file for file in files if file not in rows]
    if absent:
        raise InputError(f"{path}: has no line for {absent[0]} ({len(absent)} in all); add it or move the file away")
    return rows


LATER = ((".lvm",), TEXTS)
"""Files that are read only if a folder holds none of the others, as text files may be notes."""

MOST_FAULTS = 20
"""Files with faults after which no more are read."""
OF_ARRAYS = Fixes("save the arrays without it")


def read(
    folder: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    naming: Mapping[str, Any] | None = None,
    layout: Mapping[str, Any] | None = None,
    is_raster: bool = False,
) -> Recordings:
    """The recordings in a folder of files at any depth, in the order of their paths, as of `api.read_folder`.

    naming, layout: keys of `NamingSpec` and of `LayoutSpec`. is_raster: whether the samples are spikes, of which
    nothing is doubted.

    Text: one row per sample, one column per taxel. Arrays: each is one trial, (time, channel), but for the time stamps
    and for the single numbers and texts of a MATLAB file. Tables of other formats: each is one trial. With time stamps
    the sampling rate is theirs, unless it is given. Conditions: label, those of `naming`, file (its path in the folder;
    of an array `file.npz:key`).
    """
    if Path(folder).is_file():
        raise InputError(f"{folder}: is one file, not a folder; neurotact import table reads one with all trials")
    folder = existing(folder, "folder")
    names, table = build(NamingSpec, naming or {}, "import folder"), build(LayoutSpec, layout or {}, "import folder")
    check_import(sampling_rate_Hz, unit, str(folder))
    paths = _data_files(folder, names)
    files = [path.relative_to(folder).as_posix() for path in paths]
    of_files = conditions_of(files, names, folder)
    read: list[Read] = []
    said_hz: dict[str, float] = {}
    row_of = []
    n_bytes = 0
    faults: dict[str, InputError] = {}
    for row, path in enumerate(paths):
        try:
            trials, rates_hz = _read(path, files[row], table, find_time=sampling_rate_Hz is None or not table.columns)
        except InputError as error:
            faults[files[row]] = error
            if len(faults) == MOST_FAULTS:
                break
            continue
        said_hz |= {f"{files[row]}: {name}": rate_hz for name, rate_hz in rates_hz.items()}
        if sampling_rate_Hz is None and trials[0].table.time is None and not rates_hz:
            raise InputError(f"{folder}: the sampling rate is not known; give `sampling_rate_Hz`, or `time_column`")
        read += trials
        row_of += [row] * len(trials)
        n_bytes += sum(trial.table.signal.nbytes for trial in trials)
        check_size(folder, n_bytes)
    if faults:
        raise _every(faults, folder)
    read, kept = mended(read, table.missing, str(folder))
    row_of = [row_of[number] for number in kept]
    if said_hz and (sampling_rate_Hz is not None or read[0].table.time is None):
        sampling_rate_Hz = sampling_rate_of(said_hz, sampling_rate_Hz, str(folder))
    if table.time_unit is not None and all(trial.table.time is None for trial in read):
        raise InputError(f"{folder}: `time_unit`: the samples have no time stamps; leave it out")
    _say_layout(read, table, folder, is_raster=is_raster)
    conditions = of_files.iloc[row_of].reset_index(drop=True)
    conditions["file"] = [trial.file for trial in read]
    conditions = _with_constants(conditions, read, folder)
    return recordings_of(
        read, conditions, sampling_rate_Hz, unit,
        max_gap_ms=table.max_gap_ms, drop_repeats=table.drop_repeats, source=f"folder {folder.name}", where=str(folder),
        fixes=None if is_raster else OF_ARRAYS if all(trial.table.first_line == 0 for trial in read) else OF_COLUMNS,
    )  # fmt: skip


def _every(faults: Mapping[str, InputError], folder: Path) -> InputError:
    """The first fault with its fix, and those of the other files; one file may not hide the next."""
    first, *others = faults.items()
    if not others:
        return first[1]

    def short(file: str) -> str:
        return str(faults[file]).removeprefix(f"{folder / file}: ").partition(";")[0]

    n_others = f"{len(others)} other files have" if len(others) > 1 else "another file has"
    at_least = "at least " if len(faults) == MOST_FAULTS else ""
    if len({*map(short, faults)}) == 1:
        return InputError(f"{first[1]}; {at_least}{n_others} the same fault")
    said = ", ".join(f"{file} ({short(file)})" for file, _ in others)
    return InputError(f"{first[1]}; {at_least}{n_others} faults: {said}")


def _with_constants(conditions: pd.DataFrame, read: Sequence[Read], folder: Path) -> pd.DataFrame:
    """The conditions with those that stand in the files: columns of one text in each, which differ between files."""
    of: dict[str, dict[str, str]] = {}
    for trial in read:
        for name, value in trial.table.constants.items():
            of.setdefault(name, {})[trial.file] = value
    for name, values in of.items():
        n_values = len({*values.values()})
        if len(values) < len(read) or n_values == 1 or name in conditions:
            which = "" if len(values) == len(read) else f" ({some([*values])})"
            example = next(iter(values.values()))[:20]
            log.warning("%s: holds no number, so no taxel: %s (%r)%s", folder, name, example, which)
            continue
        conditions[name] = [*values.values()]
        apart = (
            f"; to test on others than in training, train with `split=nt.Split(group={name!r})`"
            if n_values < len(read)
            else ""
        )
        log.warning("%s: '%s' is one text in each file, so a condition (%d values)%s", folder, name, n_values, apart)
    return conditions


def _read(path: Path, file: str, layout: LayoutSpec, *, find_time: bool) -> tuple[list[Read], dict[str, float]]:
    """The trials of a file, and the sampling rates that it says."""
    if path.suffix.lower() in TEXTS:
        if layout.array is not None or layout.transpose:
            raise InputError(f"{path}: `array` and `transpose` are for NPZ and MATLAB files; leave them out")
        return [Read(str(path), file, read_table(path, layout, find_time=find_time))], {}
    layout.check_no_text(path)
    if holding(path) == "tables":
        if layout.transpose:
            raise InputError(f"{path}: `transpose` is for NPZ and MATLAB files; leave it out")
        tables = tables_in(path, layout.array).items()
        return [
            Read(f"{path}:{name}" if name else str(path), f"{file}:{name}" if name else file,
                 samples_of(table, layout, find_time=find_time)) for name, table in tables
        ], {}  # fmt: skip
    if layout.columns:
        raise InputError(f"{path}: `columns` is for CSV files and TDMS; save the chosen columns, or as CSV")
    return _of_arrays(path, file, layout, find_time=find_time)


def _of_arrays(path: Path, file: str, layout: LayoutSpec, *, find_time: bool) -> tuple[list[Read], dict[str, float]]:
    """The trials in a file of arrays, and the sampling rates that it says."""
    with opened_arrays(path) as opened:
        arrays, rates_hz = _matrices(opened, layout.array), said_rates(opened)
    stamps_at = [] if layout.time_column is None else apart(layout.time_column, arrays)
    for key_wanted in (layout.array if layout.array not in opened.cells else None, *stamps_at):
        if key_wanted is not None and key_wanted not in arrays:
            raise InputError(f"{path}: holds no array '{key_wanted[:40]}'; {nearest(key_wanted, list(arrays))}")
    stamps_at = stamps_at or (_stamps_at(arrays, layout) if find_time else [])
    time, unit = _time_of(arrays, stamps_at, layout, path)
    wanted = (layout.array, *_names_of_cells(opened, layout.array))
    chosen = {
        key: array for key, array in arrays.items()
        if key not in stamps_at and (layout.array is None or key in wanted)
    }  # fmt: skip
    if not chosen:
        raise InputError(f"{path}: holds no array but the time stamps; save the samples too, (time, taxel)")
    signals = {key: as_signal(array, f"{path}, key '{key}'") for key, array in chosen.items()}
    if key := next((key for key, signal in signals.items() if holds_events(signal) or holds_events(signal.T)), None):
        raise InputError(
            f"{path}: '{key}' is {SIGNED_MATRIX}: events, not samples; read it with neurotact import events"
        )
    if len({signal.shape[0 if layout.transpose else 1] for signal in signals.values()}) > 1:
        held = ", ".join(f"{key} {signal.shape}" for key, signal in signals.items())
        raise InputError(f"{path}: holds arrays of different numbers of taxels ({held[:100]}); name one with `array`")
    if layout.transpose:
        signals = {key: signal.T for key, signal in signals.items()}
    for key, array in signals.items():
        if time is not None and len(time) != len(array):
            raise InputError(
                f"{path}: '{key}' has {len(array)} samples and '{stamps_at[0]}' {len(time)} time stamps; give each "
                "sample one"
                f"{'' if layout.transpose else ', or use `transpose=True`'}"
            )
    return [
        Read(f"{path}:{key}", f"{file}:{key}", Samples((), array, time, 0, unit)) for key, array in signals.items()
    ], rates_hz


def _stamps_at(arrays: Mapping[str, np.ndarray], layout: LayoutSpec) -> list[str]:
    """The first array of a number per sample that is named like time stamps, or two like seconds and their rest."""
    axis = 1 if layout.transpose else 0
    samples = {key: part.shape[axis] for key, part in arrays.items() if part.ndim == 2 and layout.array in (None, key)}

    def is_per_sample(keys: Sequence[str]) -> bool:
        others = {n for name, n in samples.items() if name not in keys}
        return all(key != layout.array and others == {arrays[key].size} == {max(arrays[key].shape)} for key in keys)

    pair = [[[*arrays][column] for column in pair_in([*arrays]) or ()]]
    ways = [keys for keys in [*pair, *([key] for key in arrays if called([key.rpartition("/")[2]], "time"))] if keys]
    return next((keys for keys in ways if is_per_sample(keys)), [])


def _time_of(
    arrays: Mapping[str, np.ndarray], keys: Sequence[str], layout: LayoutSpec, path: Path
) -> tuple[np.ndarray | None, Unit | None]:
    """The time stamps in the arrays that `keys` name, and their unit; None without any, and if nothing says it."""
    if not keys:
        return None, layout.time_unit
    stamps = [_stamps(arrays[key], f"{path}, key '{key}'") for key in keys]
    if len(stamps) == 1:
        return stamps[0], layout.time_unit or unit_in(keys[0])
    if len(stamps[0]) != len(stamps[1]):
        raise InputError(
            f"{path}: '{keys[0]}' has {len(stamps[0])} time stamps and '{keys[1]}' {len(stamps[1])}; give each sample "
            "both"
        )
    return joined(stamps[0], stamps[1], keys[1], str(path), 0, layout.time_unit), "s"


def _stamps(array: np.ndarray, where: str) -> np.ndarray:
    if array.dtype.kind not in "iuf" or array.ndim == 0 or array.size != max(array.shape):
        raise InputError(f"{where}: must hold one number per sample as time stamps; got {array.dtype} {array.shape}")
    stamps = array.astype(np.float64).ravel()
    if not np.isfinite(stamps).all():
        raise InputError(f"{where}: time stamp {np.argmin(np.isfinite(stamps))} is not finite; repair it")
    return stamps


def _matrices(file: ArrayFile, chosen: str | None) -> dict[str, np.ndarray]:
    """The arrays of a file that can be trials, all but single numbers and texts; of a cell array each cell is one.

    chosen: the one that is; without it, other kinds are refused.
    """
    if file.others and chosen is None:
        raise InputError(
            f"{file.path}: '{file.others[0][:40]}' is neither numbers nor text; name the matrix of samples with `array`"
        )
    held = {name: np.asarray(file.read(name)) for name in file.shapes}
    is_matlab = file.path.suffix.lower() == MATLAB
    matrices = {
        name: values for name, values in held.items()
        if (values.size != 1 or values.ndim > 1) and (values.dtype.kind in "iufb" or not is_matlab)
    }  # fmt: skip
    for name, cells in file.cells.items():
        matrices |= dict(zip(_names_of_cells(file, name), cells, strict=True))
    if not matrices:
        raise InputError(f"{file.path}: holds no matrix of numbers; save one, (time, taxel)")
    return {name: values[:, None] if values.ndim == 1 and is_matlab else values for name, values in matrices.items()}


def _names_of_cells(file: ArrayFile, name: str | None) -> list[str]:
    """The names of the trials of a cell array, as MATLAB names its cells; none for another array."""
    return [f"{name}{{{number}}}" for number in range(1, 1 + len(file.cells.get(name or "", ())))]


def _say_layout(read: Sequence[Read], layout: LayoutSpec, folder: Path, *, is_raster: bool) -> None:
    """Say what the files note, and warn of arrays that all have more taxels than samples, and of kinds of names."""
    shapes = [trial.table.signal.shape for trial in read if trial.table.first_line == 0]  # arrays have no lines
    if shapes and all(taxels > samples for samples, taxels in shapes):
        samples, taxels = shapes[0]
        fix = "leave out `transpose`" if layout.transpose else "use `transpose=True`"
        log.warning(
            "%s: arrays of %d taxels, %d samples each; if it is the other way round, %s", folder, taxels, samples, fix
        )
    doubt = "" if is_raster or layout.columns else kinds_of_names(read[0].table.names)
    if doubt:
        log.warning("%s: %s", folder, doubt)
    for note in dict.fromkeys(note for trial in read for note in trial.table.notes):
        noted = [trial.file for trial in read if note in trial.table.notes]
        log.warning("%s: %s%s", folder, note, "" if len(noted) == len(read) else f" ({some(noted)})")


def _data_files(folder: Path, naming: NamingSpec) -> list[Path]:
    """The files to read; a warning names ignored files, and a folder or file that would be lost is refused."""
    table = None if naming.table is None else os.path.realpath(naming.table)
    paths = [path.relative_to(folder) for path in below(folder) if table is None or os.path.realpath(path) != table]
    shown = [path for path in paths if not is_hidden(path.name)]
    usual = (".csv", *(suffix for suffix in every_suffix() if suffix not in TEXTS))
    ways = ([path for path in shown if path.suffix.lower() in its] for its in (usual, *LATER))
    data_files = next(filter(None, ways), [])
    read = set(data_files)
    ignored = [path for path in paths if path not in read]
    if naming.is_label_by_folder:
        _check_label_folders(folder, data_files, ignored, naming.pattern)
    elif not data_files:
        raise _no_recordings(folder, [folder / inside for inside in ignored])
    for inside in data_files:
        if not is_text(str(inside)):
            raise InputError(
                f"{folder}: the name {str(inside)!a} is not printable UTF-8 text; rename that file or folder"
            )
    if ignored:
        names = some([str(path) for path in ignored])
        log.warning("%s: ignores %s (hidden, or not recordings): %s", folder, number_of(len(ignored), "file"), names)
    return [folder / inside for inside in data_files]


def every_suffix() -> tuple[str, ...]:
    """The suffixes of all files that are read."""
    return tuple(dict.fromkeys((*TEXTS, *OF_NUMPY, *suffixes())))


def _no_recordings(folder: Path, others: Sequence[Path]) -> InputError:
    """The refusal of a folder without a file that is read, which names what there is instead."""
    other = next((path for path in others if path.is_file() and not is_hidden(path.name)), None)
    *most, last = every_suffix()
    kinds = f"{', '.join(most)} or {last}"
    if other is None:
        return InputError(f"{folder}: holds no {kinds} file; add one or remove the sub-folder")
    kind = content_of(other)
    what = f", which is {kind.what}; {kind.fix}" if kind else "; if it is a table of samples as text, name it .csv"
    return InputError(f"{folder}: holds no {kinds} file, but {other.relative_to(folder)}{what}")


def _check_label_folders(folder: Path, files: Sequence[Path], ignored: Sequence[Path], pattern: str | None) -> None:
    labels = {entry.name for entry in folder.iterdir() if entry.is_dir() and not is_hidden(entry.name)}
    if not labels:
        lacks = "" if pattern is None else f", and `pattern={pattern!r}` no {{label}}"
        own = labelled([path.as_posix() for path in files]) or "{label}_{number}.csv"
        raise InputError(
            f"{folder}: holds no sub-folder{lacks}; put the files of each class in a sub-folder named by its label, or "
            f"give the label with `pattern={own!r}` or the like, or `conditions`"
        )
    for inside in files:
        if len(inside.parts) == 1:
            raise InputError(
                f"{folder / inside}: is beside the sub-folders and has no label; put it in the sub-folder of its "
                "class or move it away"
            )
    empty = sorted(labels - {inside.parts[0] for inside in files})
    if empty:
        others = [folder / inside for inside in ignored if inside.parts[0] == empty[0]]
        raise _no_recordings(folder / empty[0], others)
