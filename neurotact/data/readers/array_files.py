"""Files of named arrays, NPZ, NPY, MATLAB and HDF5, opened alike; and the sampling rate that such a file says."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from neurotact.data.hdf5_input import Declared, reading
from neurotact.data.readers.archives import read_array, read_arrays
from neurotact.data.readers.matlab import MATLAB, Cells, read_variables
from neurotact.data.recordings import check_sampling_rate
from neurotact.errors import InputError, some
from neurotact.files import existing

HDF5 = (".h5", ".hdf5")
DEEPEST = 4
"""Depth of nested groups of an HDF5 file to search."""
RATES = (
    "fs", "fshz", "samplingrate", "samplingratehz", "samplerate", "sampleratehz", "samplingfrequency",
    "samplingfrequencyhz", "srate", "sfreq", "ratehz",
)  # fmt: skip
"""Names of a sampling rate in Hz, in small letters alone."""
SAME_RATE = 1e-6
"""Share by which a rate that is saved may differ from the given one: it was rounded."""

log = logging.getLogger("neurotact")


class ArrayFile(NamedTuple):
    """The arrays of a file: the shape of each by its name, and a function that reads one.

    A matrix of one row or one column is a vector. cells: the cell arrays of a MATLAB file, a matrix per trial; others:
    its variables that are neither numbers nor texts.
    """

    path: Path
    shapes: dict[str, tuple[int, ...]]
    read: Callable[[str], Any]
    cells: Mapping[str, Cells] = {}
    others: Sequence[str] = ()

    def values(self, name: str) -> np.ndarray:
        """An array of numbers or texts; a matrix of one row or one column is a vector."""
        array = np.asarray(self.read(name))
        array = array.ravel() if len(self.shapes[name]) == 1 else array
        if array.dtype.kind == "S":
            try:
                return np.char.decode(array, "utf-8")
            except UnicodeDecodeError as error:
                raise InputError(f"{self.path}: '{name}' holds text that is not UTF-8; save it again") from error
        if array.dtype.kind not in "iufbUO":
            raise InputError(f"{self.path}: '{name}' holds {array.dtype}, neither numbers nor text; leave it out")
        return array


@contextmanager
def opened_arrays(path: str | Path) -> Iterator[ArrayFile]:
    """The arrays of a .npz, .npy, .mat, .h5 or .hdf5 file, while it is open; that of an .npy file has the file's name.

    Raises InputError for a file that is damaged, too large or of another kind. Pickles are not loaded.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touch.npz"
    >>> np.savez(path, press=np.ones((4, 50, 2)), label=np.array([["felt"], ["silk"], ["felt"], ["silk"]]))
    >>> with opened_arrays(path) as file:
    ...     file.shapes, file.values("label").tolist()
    ({'press': (4, 50, 2), 'label': (4,)}, ['felt', 'silk', 'felt', 'silk'])
    """
    path = existing(path)
    suffix = path.suffix.lower()
    if suffix in HDF5:
        with reading(path, "arrays", "the program that made it") as file:
            declared = Declared(file, path)
            yield ArrayFile(path, {name: _flat(shape) for name, shape in _datasets(file, "")}, declared.value)
        return
    cells: Mapping[str, Cells] = {}
    others: Sequence[str] = ()
    if suffix == MATLAB:
        arrays, cells, others = read_variables(path)
    elif suffix == ".npz":
        arrays = read_arrays(path)
    elif suffix == ".npy":
        arrays = {path.stem: read_array(path)}
    else:
        raise InputError(
            f"{path}: is not a file of arrays by its suffix; give one that ends with .npz, .npy, .mat, .h5 or .hdf5"
        )
    yield ArrayFile(
        path, {name: _flat(array.shape) for name, array in arrays.items()}, arrays.__getitem__, cells, others
    )


def _flat(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of an array, of a matrix of one row or one column that of a vector."""
    return (max(shape),) if len(shape) == 2 and 1 in shape and 0 not in shape else shape


def _datasets(group: h5py.Group, prefix: str, depth: int = 0) -> Iterator[tuple[str, tuple[int, ...]]]:
    """The shapes of the datasets of an HDF5 file by their paths; links are not followed."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        member = group[name]
        if isinstance(member, h5py.Dataset) and member.shape is not None:
            yield prefix + name, member.shape
        elif isinstance(member, h5py.Group) and depth < DEEPEST:
            yield from _datasets(member, f"{prefix}{name}/", depth + 1)


def is_rate(name: str) -> bool:
    """Whether an array of this name holds a sampling rate.

    >>> is_rate("Fs"), is_rate("session/sampling_rate_Hz"), is_rate("rate")
    (True, True, False)
    """
    return re.sub(r"[^a-z]", "", name.rpartition("/")[2].lower()) in RATES


def said_rates(file: ArrayFile) -> dict[str, float]:
    """The sampling rates that a file says, in Hz, by the names of their arrays."""
    named = [name for name, shape in file.shapes.items() if is_rate(name) and shape in ((), (1,))]
    rates = {name: file.values(name) for name in named}
    return {name: float(value.item()) for name, value in rates.items() if value.dtype.kind in "iuf"}


def sampling_rate_of(said: Mapping[str, float], given_hz: float | None, where: str) -> float:
    """The sampling rate that is given, else the one that all of `said` say; a line tells of either where it matters.

    said: sampling rates by what says them; `where` begins the line. Raises InputError if none is known, or several are.
    """
    if given_hz is not None:
        others = [f"{name} = {rate_hz:g}" for name, rate_hz in said.items() if abs(rate_hz / given_hz - 1) > SAME_RATE]
        if others:
            log.warning("%s: says %s, but %g Hz is given and used", where, some(others, 2), given_hz)
        return float(given_hz)
    if not said:
        raise InputError(f"{where}: the sampling rate is not known; give `sampling_rate_Hz`, or save it as fs")
    different = {rate_hz: f"{name} = {rate_hz:g}" for name, rate_hz in said.items()}
    if len(different) > 1:
        raise InputError(f"{where}: says {some([*different.values()], 2)}; give the rate with `sampling_rate_Hz`")
    name, rate_hz = next(iter(said.items()))
    check_sampling_rate(rate_hz, f"{where}: {name}")
    log.warning("%s: the sampling rate is %g Hz, as %s says", where, rate_hz, name)
    return rate_hz
