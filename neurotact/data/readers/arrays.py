"""One NPZ, MATLAB or HDF5 file: signals `(trial, time, taxel)`, and the class and conditions of each trial."""

import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pandas as pd

from neurotact.data.hdf5_input import Declared, reading
from neurotact.data.readers.archives import read_arrays
from neurotact.data.readers.matlab import MATLAB, read_variables
from neurotact.data.readers.tables import check_width
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing

AXES = ("trial", "time", "taxel")
SIGNALS, CHANNELS = "signals", "channels"
ALIASES = {
    LABEL: (LABEL, "labels", "class", "classes", "y", "target", "targets"),
    CHANNELS: (CHANNELS, "channel_names", "taxels", "electrodes"),
}
"""Names of the arrays; the signals are the only array with three axes."""
HDF5 = (".h5", ".hdf5")
DEEPEST = 4
"""Depth of nested groups of an HDF5 file to search."""

log = logging.getLogger("neurotact")


class _Arrays(NamedTuple):
    """The arrays of a file: the shape of each by its name, and a function that reads one."""

    path: Path
    shapes: dict[str, tuple[int, ...]]
    read: Callable[[str], Any]


def read(
    path: str | Path,
    sampling_rate_Hz: float,
    unit: str,
    *,
    names: Mapping[str, str] | None = None,
    axes: str = "trial,time,taxel",
) -> Recordings:
    """The recordings in one .npz, .mat, .h5 or .hdf5 file.

    names: the names of signals, label and channels in the file, such as `{"signals": "data", "label": "gesture"}`; by
    default the signals are the only array with three axes, and the label is one of `ALIASES`.
    axes: the axes of the signals, in order.

    Every other array of one value per trial is a condition. All trials are equally long. Pickles are not loaded. Raises
    InputError, which names the file, the array and the fix.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touches.npz"
    >>> np.savez(path, data=np.ones((2, 50, 3)), gesture=["tap", "rub"], session=[1, 1])
    >>> touches = read(path, 100, "count", names={"label": "gesture"})
    >>> touches, touches.conditions["session"].tolist()
    (Recordings(2 trials x 3 taxels, 50 samples at 100 Hz (0.5 s), count, 2 classes), [1, 1])
    """
    path = existing(path)
    check_import(sampling_rate_Hz, unit, str(path))
    unknown = [name for name in names or {} if name not in (SIGNALS, *ALIASES)]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is not a known name; {nearest(unknown[0], (SIGNALS, *ALIASES))}")
    if path.suffix.lower() in HDF5:
        with reading(path, "arrays", "the program that made it") as file:
            declared = Declared(file, path)
            return _recordings(
                _Arrays(path, dict(_datasets(file, "")), declared.value), sampling_rate_Hz, unit, names, axes
            )
    if path.suffix.lower() == MATLAB:
        arrays, others = read_variables(path)
        if others:
            log.warning("%s: neither numbers nor texts, so not read: %s", path, some(others))
    elif path.suffix.lower() == ".npz":
        arrays = read_arrays(path)
    else:
        raise InputError(
            f"{path}: is not a file of arrays by its suffix; give one that ends with .npz, .mat, .h5 or .hdf5"
        )
    shapes = {name: array.shape for name, array in arrays.items()}
    return _recordings(_Arrays(path, shapes, arrays.__getitem__), sampling_rate_Hz, unit, names, axes)


def _datasets(group: h5py.Group, place: str, depth: int = 0) -> Iterator[tuple[str, tuple[int, ...]]]:
    """The shapes of the datasets of an HDF5 file by their paths; links are not followed."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        found = group[name]
        if isinstance(found, h5py.Dataset) and found.shape is not None:
            yield place + name, found.shape
        elif isinstance(found, h5py.Group) and depth < DEEPEST:
            yield from _datasets(found, f"{place}{name}/", depth + 1)


def _recordings(arrays: _Arrays, rate_Hz: float, unit: str, names: Mapping[str, str] | None, axes: str) -> Recordings:
    names = names or {}
    signals_at = _signals_at(arrays, names.get(SIGNALS))
    signals = _signals(arrays, signals_at, axes)
    n_trials, n_samples, n_taxels = signals.shape
    if n_taxels > n_samples:
        log.warning(
            "%s: '%s' has %d taxels of %d samples each; if it is the other way round, use --axes",
            arrays.path, signals_at, n_taxels, n_samples,
        )  # fmt: skip
    label_at = _at(arrays, LABEL, names, (n_trials,))
    if label_at is None:
        others = [name for name, shape in arrays.shapes.items() if shape == (n_trials,)]
        known = ", ".join(others) or "none has one value per trial"
        raise InputError(f"{arrays.path}: no array is called label ({known}); name the class with --names label=...")
    channels_at = _at(arrays, CHANNELS, names, (n_taxels,))
    channels = () if channels_at is None else tuple(map(str, _values(arrays, channels_at).tolist()))
    conditions: dict[str, Any] = {LABEL: _labels(_values(arrays, label_at))}
    for name, shape in arrays.shapes.items():
        column = name.rpartition("/")[2]
        if shape == (n_trials,) and name not in (label_at, channels_at) and column not in conditions:
            conditions[column] = _values(arrays, name)
    return Recordings(
        signals, float(rate_Hz), unit, pd.DataFrame(conditions), channels, f"arrays of {arrays.path.name}"
    )


def _signals_at(arrays: _Arrays, named: str | None) -> str:
    """The name of the array of signals."""
    if named is not None:
        return _existing(arrays, named)
    found = [name for name, shape in arrays.shapes.items() if len(shape) == len(AXES)]
    if len(found) != 1:
        shown = ", ".join(f"{name} {shape}" for name, shape in list(arrays.shapes.items())[:12]) or "none at all"
        raise InputError(
            f"{arrays.path}: holds {len(found)} arrays with the axes trial, time and taxel ({shown}); "
            f"{'name one with --names signals=...' if found else 'save the signals as one array with three axes'}"
        )
    return found[0]


def _signals(arrays: _Arrays, name: str, axes: str) -> np.ndarray:
    """The signals as `(trial, time, taxel)`."""
    order = tuple(part.strip() for part in axes.split(","))
    if sorted(order) != sorted(AXES):
        raise InputError(f"axes must name trial, time and taxel, each once, as in trial,taxel,time; got {axes[:60]}")
    shape = arrays.shapes[name]
    if len(shape) != len(AXES) or 0 in shape:
        raise InputError(f"{arrays.path}: '{name}' has the shape {shape}; give an array of trials, samples and taxels")
    check_width(f"{arrays.path}: '{name}'", shape[order.index("taxel")])
    values = np.asarray(arrays.read(name))
    if values.dtype.kind not in "iuf":
        raise InputError(f"{arrays.path}: '{name}' holds {values.dtype}, not numbers; save the signals as numbers")
    return np.ascontiguousarray(values.transpose([order.index(axis) for axis in AXES]))


def _at(arrays: _Arrays, what: str, names: Mapping[str, str], shape: tuple[int, ...]) -> str | None:
    """The name of the array of a label or of channels; None if there is none."""
    named = names.get(what)
    if named is None:
        fitting = {name.rpartition("/")[2].lower(): name for name, each in arrays.shapes.items() if each == shape}
        return next((fitting[alias] for alias in ALIASES[what] if alias in fitting), None)
    if arrays.shapes[_existing(arrays, named)] != shape:
        per = "trial" if what == LABEL else "taxel"
        raise InputError(
            f"{arrays.path}: '{named}' has the shape {arrays.shapes[named]} where {shape} is expected; "
            f"give one value per {per}"
        )
    return named


def _existing(arrays: _Arrays, named: str) -> str:
    """The name unchanged; InputError if the file has no such array."""
    if named not in arrays.shapes:
        raise InputError(f"{arrays.path}: holds no array '{named}'; {nearest(named, list(arrays.shapes))}")
    return named


def _values(arrays: _Arrays, name: str) -> np.ndarray:
    """An array of one value per trial: numbers, or texts."""
    found = np.asarray(arrays.read(name))
    if found.dtype.kind == "S":
        try:
            return np.char.decode(found, "utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"{arrays.path}: '{name}' holds text that is not UTF-8; save it again") from error
    if found.dtype.kind not in "iufbUO":
        raise InputError(f"{arrays.path}: '{name}' holds {found.dtype}, neither numbers nor text; leave it out")
    return found


def _labels(values: np.ndarray) -> list[str]:
    """Names of classes; whole numbers are written without a decimal point."""
    is_whole = values.dtype.kind == "f" and bool(np.isfinite(values).all() and (values == np.floor(values)).all())
    return [str(value) for value in (values.astype(np.int64) if is_whole else values).tolist()]
