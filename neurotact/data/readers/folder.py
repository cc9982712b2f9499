"""A plain folder of recordings: one sub-folder per class, CSV or NPZ files in it."""

import logging
import re
import unicodedata
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact.data.readers.archives import as_signal, read_arrays
from neurotact.data.readers.tables import cells, check_width, is_value, numbers, read_text
from neurotact.data.recordings import Recordings, check_sampling_rate
from neurotact.errors import InputError
from neurotact.files import below, check_size, existing, is_hidden

SUFFIXES = (".csv", ".npz")
TIME_COLUMN = re.compile(r"(time|timestamp|t)(?![a-z0-9])", re.IGNORECASE)
MOST_NAMED = 5
"""Ignored files that a warning names; the others are counted."""

log = logging.getLogger("neurotact")


def read(folder: str | Path, sampling_rate_Hz: float, unit: str) -> Recordings:
    """The recordings in `folder/<label>/*.csv` and `*.npz`, at any depth, in the order of their paths.

    The label is the first sub-folder; deeper ones are read as well. CSV: commas between columns, decimal points, one
    row per sample, one column per taxel and no time column; a first row without a single number names the taxels. NPZ:
    each array is one trial, (time, channel). All trials have the same number of channels, all header rows the same
    names. Conditions: label, file (its path in the folder; of an array `file.npz:key`).

    Hidden files and other kinds of file are ignored, and named in a warning. A CSV or NPZ file beside the sub-folders
    has no label and is refused.

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
    check_sampling_rate(sampling_rate_Hz, str(folder))
    if not unit.strip():
        raise InputError(f"{folder}: the unit of the signals is empty; give one, such as mV")
    signals: dict[str, np.ndarray] = {}
    headers: dict[str, tuple[str, ...]] = {}
    n_bytes = 0
    for path in _data_files(folder):
        file = path.relative_to(folder).as_posix()
        if path.suffix.lower() == ".csv":
            headers[file], signals[file] = _read_csv(path)
            n_bytes += signals[file].nbytes
        else:
            for key, array in read_arrays(path).items():
                signals[f"{file}:{key}"] = as_signal(array, f"{path}, key '{key}'")
                n_bytes += signals[f"{file}:{key}"].nbytes
        check_size(folder, n_bytes)
    _check_same_channels(signals, folder)
    names = _same_names({file: names for file, names in headers.items() if names}, folder)
    conditions = pd.DataFrame({"label": [file.split("/")[0] for file in signals], "file": list(signals)})
    return Recordings(list(signals.values()), float(sampling_rate_Hz), unit, conditions, names, f"folder {folder.name}")


def _data_files(folder: Path) -> list[Path]:
    """The files to read; those that are ignored are said, and a folder or file that would be lost is refused."""
    found, ignored = [], []
    for path in below(folder):
        is_data = path.suffix.lower() in SUFFIXES and not is_hidden(path.name)
        (found if is_data else ignored).append(path.relative_to(folder))
    labels = {place.name for place in folder.iterdir() if place.is_dir() and not is_hidden(place.name)}
    if not labels:
        raise InputError(
            f"{folder}: holds no sub-folder; put the files of each class in a sub-folder named by its label"
        )
    for inside in found:
        if len(inside.parts) == 1:
            raise InputError(
                f"{folder / inside}: lies beside the sub-folders and has no label; put it in the sub-folder of its "
                "class or move it away"
            )
        if not _is_text(str(inside)):
            raise InputError(f"{folder}: the name {str(inside)!a} is no text; rename that file or folder")
    empty = sorted(labels - {inside.parts[0] for inside in found})
    if empty:
        raise InputError(f"{folder / empty[0]}: holds no .csv or .npz file; add one or remove the sub-folder")
    if ignored:
        names = ", ".join(map(str, ignored[:MOST_NAMED])) + (", ..." if len(ignored) > MOST_NAMED else "")
        log.warning("%s: %d ignored, being hidden or no .csv or .npz file: %s", folder, len(ignored), names)
    return [folder / inside for inside in found]


def _is_text(name: str) -> bool:
    """Whether a name is UTF-8 and holds no control character, which no table or figure can show."""
    return not any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name)


def _read_csv(path: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """The taxels' names (none without a header row) and the `(time, channel)` signal."""
    text = read_text(path)
    head, _, body = text.partition("\n")
    first = cells(head)
    if not first or any(not cell or is_value(cell) for cell in first):
        _check_not_numbered(first, path)
        return (), numbers(text, path).astype(np.float32)
    check_width(path, len(first))
    seen: set[str] = set()
    for column, name in enumerate(first, 1):
        if TIME_COLUMN.match(name):
            raise InputError(
                f"{path}: column {column} is '{name[:40]}', but every column is a taxel; remove the column"
            )
        if name in seen:
            raise InputError(f"{path}: two columns are named '{name[:40]}'; give each taxel its own name")
        if not _is_text(name):
            raise InputError(f"{path}: column {column}, {name[:40]!a}, has control characters; rename it")
        seen.add(name)
    return tuple(first), numbers(body, path, first_line=2, names=first).astype(np.float32)


def _check_not_numbered(first: list[str], path: Path) -> None:
    if len(first) > 2 and first == [str(i) for i in range(len(first))]:
        raise InputError(
            f"{path}: line 1 counts 0 to {len(first) - 1}, which looks like column numbers, not a sample; "
            "name the taxels or remove the line (pandas: to_csv(header=False))"
        )


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
