"""A plain folder of recordings: one sub-folder a class, CSV or NPZ files in it."""

import re
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact.data.readers.archives import as_signal, read_arrays
from neurotact.data.readers.tables import cells, is_value, numbers, read_text
from neurotact.data.recordings import Recordings, check_sampling_rate
from neurotact.errors import InputError
from neurotact.files import existing

SUFFIXES = (".csv", ".npz")
TIME_COLUMN = re.compile(r"(time|timestamp|t)(?![a-z0-9])", re.IGNORECASE)


def read(folder: str | Path, sampling_rate_Hz: float, unit: str) -> Recordings:
    """The recordings in `folder/<label>/*.csv` and `*.npz`, label by label, files in the order of their names.

    CSV: commas between columns, decimal points, one row a sample, one column a taxel and no time column; a
    first row without a single number names the taxels. NPZ: each array is one trial, (time, channel). All
    trials have the same number of channels, all header rows the same names. Hidden files, other kinds of
    file and whatever lies beside the sub-folders are ignored. Conditions: label, file (of an array `file.npz:key`).

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
    for path in _data_files(folder):
        file = path.relative_to(folder).as_posix()
        if path.suffix.lower() == ".csv":
            headers[file], signals[file] = _read_csv(path)
        else:
            for key, array in read_arrays(path).items():
                signals[f"{file}:{key}"] = as_signal(array, f"{path}, key '{key}'")
    _check_same_channels(signals, folder)
    names = _same_names({file: names for file, names in headers.items() if names}, folder)
    conditions = pd.DataFrame({"label": [file.split("/")[0] for file in signals], "file": list(signals)})
    return Recordings(list(signals.values()), float(sampling_rate_Hz), unit, conditions, names, f"folder {folder.name}")


def _data_files(folder: Path) -> list[Path]:
    labels = sorted(place for place in folder.iterdir() if place.is_dir() and not place.name.startswith((".", "__")))
    if not labels:
        raise InputError(
            f"{folder}: holds no sub-folder; put the files of each class in a sub-folder named by its label"
        )
    files = []
    for place in labels:
        inside = sorted(p for p in place.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
        if not inside:
            raise InputError(f"{place}: holds no .csv or .npz file; add one or remove the sub-folder")
        files += inside
    return files


def _read_csv(path: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """The taxels' names (none without a header row) and the `(time, channel)` signal."""
    text = read_text(path)
    head, _, body = text.partition("\n")
    first = cells(head)
    if not first or any(not cell or is_value(cell) for cell in first):
        _check_not_numbered(first, path)
        return (), numbers(text, path).astype(np.float32)
    for column, name in enumerate(first, 1):
        if TIME_COLUMN.match(name):
            raise InputError(f"{path}: column {column} is '{name}', but every column is a taxel; remove the column")
        if name in first[: column - 1]:
            raise InputError(f"{path}: two columns are named '{name[:40]}'; give each taxel its own name")
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
