"""Tables of an NWB file as they stand in HDF5: columns of numbers and texts, intervals, electrodes."""

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from neurotact.data.digests import DIGEST, TOUCH
from neurotact.data.hdf5_input import Declared
from neurotact.errors import InputError
from neurotact.files import check_size

KEPT = ("id", "start_time", "stop_time", "timeseries", "tags", DIGEST, TOUCH)
"""Columns of trials that are not conditions."""
ELECTRODES = "general/extracellular_ephys/electrodes"
ELECTRODE_NAMES = ("label", "channel_name")
"""Columns of electrodes with their names."""
MOST_NAMED = 8


def columns(declared: Declared, table_path: str, n_trials: int) -> Iterator[tuple[str, np.ndarray | list[str]]]:
    """The columns of a table with one value per trial, in its own order."""
    group = declared.group(table_path)
    for name in _order(group, declared.path):
        if name in KEPT or f"{name}_index" in group or not declared.holds(f"{table_path}/{name}"):
            continue
        member = group[name]
        if isinstance(member, h5py.Dataset) and (member.shape or ()) == (n_trials,) and _is_plain(member):
            values = declared.column(f"{table_path}/{name}", n_trials)
            elements = f"{table_path}/{name}_elements"
            if declared.holds(elements) and not isinstance(values, list):
                meant = np.array(declared.texts(elements), object)
                values = [str(text) for text in meant[values.astype(np.int64)]]
            yield name, values.astype(np.int64) if isinstance(values, np.ndarray) and values.dtype == bool else values


def _is_plain(dataset: h5py.Dataset) -> bool:
    """Whether a column holds numbers or texts, not references to other objects."""
    return dataset.dtype.kind in "iufb" or h5py.check_string_dtype(dataset.dtype) is not None


def _order(group: h5py.Group, path: str | Path) -> list[str]:
    """The names of a table's columns in the order of its attribute `colnames`, others after them."""
    listed: list[str] = []
    if "colnames" in group.attrs:
        colnames = h5py.h5a.open(group.id, b"colnames")
        check_size(path, colnames.get_storage_size())
        listed = [name.decode() if isinstance(name, bytes) else str(name) for name in np.ravel(group.attrs["colnames"])]
    return list(dict.fromkeys([*(name for name in listed if name in group), *group]))


def named(group: h5py.Group) -> str:
    """The first names in a group, in words."""
    names = [str(name) for name, _ in zip(group, range(MOST_NAMED), strict=False)]
    return f"there is {', '.join(names)}" if names else "there is none"


def intervals(declared: Declared, table: str) -> np.ndarray:
    """The beginnings and ends of a table of intervals in s, `(interval, 2)`; none without the table."""
    if not declared.holds(table):
        return np.empty((0, 2))
    times = [declared.numbers(f"{table}/{name}").astype(float) for name in ("start_time", "stop_time")]
    if len(times[0]) != len(times[1]):
        raise InputError(f"{declared.path}: {table} has {len(times[0])} starts and {len(times[1])} stops; correct it")
    return checked(np.stack(times, axis=1), f"{declared.path}: {table}")


def checked(intervals_s: np.ndarray, where: str) -> np.ndarray:
    """The intervals as they are; InputError for one that ends before it begins; `where` begins it."""
    wrong = np.flatnonzero(~(intervals_s[:, 0] <= intervals_s[:, 1]))
    if len(wrong):
        start_s, stop_s = intervals_s[wrong[0]].tolist()
        raise InputError(f"{where}: interval {wrong[0]} lasts from {start_s:g} s to {stop_s:g} s; correct it")
    return intervals_s


def electrodes_of(declared: Declared, series: str, n_channels: int) -> tuple[str, ...]:
    """The names of the electrodes of a series: their column `label` or `channel_name`, else their ids; none without."""
    if not (declared.holds(f"{series}/electrodes") and declared.holds(ELECTRODES)):
        return ()
    rows = declared.numbers(f"{series}/electrodes", "iu").astype(np.int64)
    if len(rows) != n_channels:
        raise InputError(f"{declared.path}: {series} has {n_channels} columns but {len(rows)} electrodes; correct it")
    table = electrodes(declared, rows, f"{series}/electrodes")
    known = [[str(text) for text in np.asarray(table[name], object)[rows]] for name in ELECTRODE_NAMES if name in table]
    unique = next((names for names in known if len({*names}) == len(names)), None)
    return tuple(unique or (f"electrode{number}" for number in declared.numbers(f"{ELECTRODES}/id")[rows].tolist()))


def electrodes(declared: Declared, rows: np.ndarray, where: str) -> dict[str, np.ndarray | list[str]]:
    """The columns of the table of electrodes, in which `rows` must lie; `where` says what names these rows."""
    n_electrodes = len(declared.numbers(f"{ELECTRODES}/id", "iu"))
    if not len(rows) or rows.min() < 0 or rows.max() >= n_electrodes:
        raise InputError(f"{declared.path}: {where} names rows that {n_electrodes} electrodes do not have; correct it")
    return dict(columns(declared, ELECTRODES, n_electrodes))


def ends_of(declared: Declared, name: str, n_rows: int, n_values: int) -> np.ndarray:
    """The end of the values of each row in a column of rows of any lengths, `(row,)`; InputError if they do not fit."""
    ends = declared.numbers(f"{name}_index", "iu").astype(np.int64)
    if len(ends) != n_rows or (np.diff(ends, prepend=0) < 0).any() or (n_rows and ends[-1] != n_values):
        raise InputError(f"{declared.path}: {name}_index does not fit {n_values} values of {n_rows} rows; correct it")
    return ends
