"""One file of arrays: signals of all trials, the class and the conditions of each; all formats are opened alike."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from neurotact_parts.readers.doubts import Fixes, say_doubts, say_unit, units_in
from neurotact_parts.readers.numpy_files import read_array, read_arrays

from neurotact.data.hdf5_input import Declared, attribute, own_members, reading
from neurotact.data.readers.columns import GUESSES, OF_ARRAYS, called
from neurotact.data.readers.formats import Arrays, Cells, arrays_in, holding, suffixes
from neurotact.data.readers.table.cells import check_digits, check_width, columns_of, values_of
from neurotact.data.readers.table.headings import check_first_row, named_table
from neurotact.data.recordings import LABEL, Recordings, check_import, check_sampling_rate
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

DEEPEST = 4
"""Depth of nested groups of an HDF5 file to search."""
RATES = (
    "fs", "fshz", "samplingrate", "samplingratehz", "samplerate", "sampleratehz", "samplingfrequency",
    "samplingfrequencyhz", "srate", "sfreq", "ratehz",
)  # fmt: skip
"""Names of a sampling rate in Hz, in small letters alone."""
UNIT_NAMES = ("unit", "units")
"""Names of arrays of one text, and of attributes, with the unit of the signals."""
SAME_RATE = 1e-6
"""Share by which a rate that is saved may differ from the given one: it was rounded."""
TRIAL, TIME, TAXEL, ROW, COLUMN = "trial", "time", "taxel", "row", "column"
AXES, GRID = (TRIAL, TIME, TAXEL), (TRIAL, TIME, ROW, COLUMN)
LAYOUTS = ((TRIAL, TIME), AXES, GRID)
"""The axes that an array of signals can have; without one of taxels there is one taxel."""
TIME_LAST = (TRIAL, ROW, COLUMN, TIME)
LONGER = 2
"""The time of a grid has this many times as many samples as the grid has rows or columns, or must be named."""
SIGNALS, _, CHANNELS = OF_ARRAYS
ALIASES = {what: GUESSES[what].aliases for what in (LABEL, CHANNELS)}
"""Names of the arrays; the signals are the only array with three or four axes, or the only cell array of matrices."""
CLASSES = ".npy"
"""The suffix of a file with the class of each trial alone."""


class ArrayFile(NamedTuple):
    """The arrays of a file: the shape of each by its name, and a function that reads one.

    A matrix of one row or one column is a vector. cells: the cell arrays of a MATLAB file, a matrix per trial; others:
    its variables that are neither numbers nor texts. units: of arrays of an HDF5 file, and
    of the file by no name, by the attributes that say them.
    """

    path: Path
    shapes: dict[str, tuple[int, ...]]
    read: Callable[[str], Any]
    cells: Mapping[str, Cells] = {}
    others: Sequence[str] = ()
    units: Mapping[str, Mapping[str, str]] = {}

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

    def shown(self, name: str) -> str:
        """The name and the shape of an array."""
        return f"{name} ({len(self.cells[name])} cells)" if name in self.cells else f"{name} {self.shapes[name]}"

    def existing(self, named: str) -> str:
        """The name unchanged; InputError if the file has no such array."""
        if named not in self.shapes and named not in self.cells:
            raise InputError(f"{self.path}: holds no array '{named}'; {nearest(named, [*self.shapes, *self.cells])}")
        return named


@contextmanager
def opened_arrays(path: str | Path) -> Iterator[ArrayFile]:
    """The arrays of a .npz, .npy, .mat, .pt, .h5 or .hdf5 file, while it is open; one without a name has the file's.

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
    if suffix in (".h5", ".hdf5"):
        with reading(path, "arrays", "the program that made it") as file:
            declared = Declared(file, path)
            shapes = {name: _flat(shape) for name, shape in _datasets(file, "")}
            yield ArrayFile(path, shapes, declared.value, units=dict(_units(file, shapes, path)))
        return
    if suffix == ".npz":
        held = Arrays(read_arrays(path))
    elif suffix == ".npy":
        held = Arrays({path.stem: read_array(path)})
    elif holding(path) == "arrays":
        held = arrays_in(path)
    else:
        known = f".npz, .npy, {', '.join(suffixes('arrays'))}, .h5 or .hdf5"
        raise InputError(f"{path}: is not a file of arrays by its suffix; give one that ends with {known}")
    shapes = {name: _flat(array.shape) for name, array in held.arrays.items()}
    yield ArrayFile(path, shapes, held.arrays.__getitem__, held.cells, held.others)


def _flat(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape of an array, of a matrix of one row or one column that of a vector."""
    return (max(shape),) if len(shape) == 2 and 1 in shape and 0 not in shape else shape


def _datasets(group: h5py.Group, prefix: str, depth: int = 0) -> Iterator[tuple[str, tuple[int, ...]]]:
    """The shapes of the datasets of an HDF5 file by their paths; links are not followed."""
    for name, member in own_members(group):
        if isinstance(member, h5py.Dataset) and member.shape is not None:
            yield prefix + name, member.shape
        elif isinstance(member, h5py.Group) and depth < DEEPEST:
            yield from _datasets(member, f"{prefix}{name}/", depth + 1)


def _units(file: h5py.File, names: Iterable[str], path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """The units that attributes say, of the file (no name) and of its datasets."""
    for name in ("", *names):
        of, holder = f" of {name}" if name else "", file[name or "/"]
        keys = [key for key in UNIT_NAMES if key in holder.attrs and holder.attrs.get_id(key).shape == ()]
        yield name, {f"attribute {key}{of}": str(attribute(holder, key, path)) for key in keys}


# --- the sampling rate ------------------------------------------------------------------------------


def _ends(name: str, known: Sequence[str]) -> bool:
    return re.sub(r"[^a-z]", "", name.rpartition("/")[2].lower()) in known


def _is_rate(name: str) -> bool:
    return _ends(name, RATES)


def said_rates(file: ArrayFile) -> dict[str, float]:
    """The sampling rates that a file says, in Hz, by the names of their arrays."""
    named = [name for name, shape in file.shapes.items() if _is_rate(name) and shape in ((), (1,))]
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


# --- axes -------------------------------------------------------------------------------------------


def _order_of(axes: str | None, shape: Sequence[int], where: str) -> tuple[str, ...]:
    """The names of the axes of an array, in their order, as given or by their lengths.

    Raises InputError for axes that do not fit the array, and where several orders do.

    >>> _order_of(None, (20, 6, 10, 75), "touch.npz: 'X'"), _order_of("time,taxel,trial", (50, 3, 20), "touch.npz: 'X'")
    (('trial', 'row', 'column', 'time'), ('time', 'taxel', 'trial'))
    """
    has = f"{where} has the shape {tuple(shape)}"
    if axes is None and len(shape) == len(AXES):
        return AXES
    if axes is None and len(shape) != len(GRID):
        raise InputError(f"{has}; give an array of trials, samples and taxels")
    if axes is None:
        lengths = [dict(zip(order, shape, strict=True)) for order in (GRID, TIME_LAST)]
        fitting = [its for its in lengths if its[TIME] >= LONGER * max(its[ROW], its[COLUMN])]
        if len(fitting) != 1:
            ways = f"`axes='{','.join(GRID)}'` or `axes='{','.join(TIME_LAST)}'`"
            raise InputError(f"{has}, of which no axis is clearly the time; give {ways}")
        return tuple(fitting[0])
    order = tuple(part.strip() for part in axes.split(","))
    if not any(sorted(order) == sorted(layout) for layout in LAYOUTS):
        raise InputError(
            "axes must name trial, time and taxel, each once, as in trial,taxel,time, or trial, time, row and column "
            f"of a grid, or trial and time of one taxel; got {axes[:60]}"
        )
    if len(order) != len(shape):
        raise InputError(f"{has}, so {len(order)} axes do not fit ({axes}); name each axis")
    return order


def _stacked(values: np.ndarray, order: Sequence[str]) -> tuple[np.ndarray, tuple[int, int] | None]:
    """Signals as `(trial, time, taxel)`, and the rows and columns of the grid that their taxels are, if any."""
    layout = next(layout for layout in LAYOUTS if sorted(layout) == sorted(order))
    ordered = np.ascontiguousarray(values.transpose([order.index(axis) for axis in layout]))
    return ordered.reshape(*ordered.shape[:2], -1), ordered.shape[2:] if layout == GRID else None


def _stacked_cells(
    cells: Sequence[np.ndarray], axes: str | None, where: str
) -> tuple[list[np.ndarray], tuple[int, int] | None, tuple[str, ...]]:
    """The signals of a cell array of matrices, `(time, taxel)` of each trial, their grid, and the order of their axes.

    A cell array of vectors is of one taxel. Raises InputError for cells of other taxels than the first one.
    """
    is_one_taxel = axes is None and all(cell.ndim == 1 for cell in cells)
    order = LAYOUTS[0] if is_one_taxel else _order_of(axes, (1, *cells[0].shape), where)
    if order[0] != TRIAL:
        fix = "begin `axes` with trial, as in `axes='trial,time,taxel'`"
        raise InputError(f"{where} is a cell array with a trial in each cell; {fix}")
    trials: list[np.ndarray] = []
    first = None
    for number, cell in enumerate(cells, 1):
        if cell.ndim != len(order) - 1:
            raise InputError(
                f"{where}, cell {number}, has the shape {cell.shape}; give each trial the axes of the first one"
            )
        signal, grid = _stacked(cell[None], order)
        first = first or (signal.shape[2], grid)
        if (signal.shape[2], grid) != first:
            other = "" if axes else "; if its axes are taxel and time, use `axes='trial,taxel,time'`"
            raise InputError(
                f"{where}, cell {number}, has {signal.shape[2]} taxels where the first has {first[0]}{other}"
            )
        trials.append(signal[0])
    return trials, first[1] if first else None, order


# --- trials -----------------------------------------------------------------------------------------


class Loaded(NamedTuple):
    """What a file of arrays holds: one `(time, taxel)` array per trial, or one `(trial, time, taxel)` array.

    channels: the taxels' names; none if the file has none. units: those that the file says, by what says them.
    """

    signals: Sequence[np.ndarray] | np.ndarray
    conditions: pd.DataFrame
    channels: tuple[str, ...]
    sampling_rate_Hz: float
    units: Mapping[str, str]


def read(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
) -> Recordings:
    """The recordings in one file of arrays, as of `api.read_arrays`.

    Every other array of one value per trial is a condition. A cell array of matrices has trials of any lengths. A grid
    is read row by row, with names such as `r0c1`.
    """
    check_import(sampling_rate_Hz, unit, str(path))
    parts = load(path, sampling_rate_Hz, names, axes, conditions)
    for trial, signal in enumerate(parts.signals):
        check_digits(np.asarray(signal), f"{path}: trial {trial}")
        check_first_row(np.asarray(signal), f"{path}: trial {trial}", 0)
    say_unit(parts.units, unit, str(path))
    recordings = Recordings(
        parts.signals, parts.sampling_rate_Hz, unit, parts.conditions, parts.channels, f"arrays of {Path(path).name}"
    )
    say_doubts(recordings, str(path), Fixes("save the array without it", axes="use `axes`"))
    return recordings


def load(
    path: str | Path,
    sampling_rate_Hz: float | None,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
) -> Loaded:
    """What a file of arrays holds, with numbers as they are stored; the arguments are those of `read`."""
    names = names or {}
    unknown = [name for name in names if name not in (SIGNALS, *ALIASES)]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is not a known name; {nearest(unknown[0], (SIGNALS, *ALIASES))}")
    with opened_arrays(path) as file:
        if file.others:
            log.warning("%s: neither numbers nor texts, so not read: %s", path, some(file.others))
        name = _signals_at(file, names.get(SIGNALS), axes)
        signals, grid, order = _signals(file, name, axes)
        n_taxels = signals[0].shape[1]
        check_width(f"{file.path}: '{name}'", n_taxels)
        of_table, given = None, {}
        if conditions is not None:
            of_table, given = _table_of_trials(Path(conditions), len(signals), names.get(LABEL), file)
        label_at = None if of_table is not None else _at(file, LABEL, names, len(signals), name, order)
        channels_at = _at(file, CHANNELS, names, n_taxels, name, order)
        channels = () if channels_at is None else tuple(map(str, file.values(channels_at).tolist()))
        if grid is not None and not channels:
            channels = tuple(f"r{row}c{column}" for row in range(grid[0]) for column in range(grid[1]))
            log.warning(
                "%s: '%s' has the axes %s: %d taxels, named %s to %s row by row",
                file.path, name, ", ".join(order), n_taxels, channels[0], channels[-1],
            )  # fmt: skip
        units = {**file.units.get("", {}), **file.units.get(name, {})}
        said_by = [key for key, shape in file.shapes.items() if shape in ((), (1,)) and _ends(key, UNIT_NAMES)]
        units |= {key: str(file.values(key).item()) for key in said_by}
        known = (name, channels_at, label_at, *said_by)
        others = [other for other in file.shapes if other not in known and not _is_rate(other)]
        of_trials = [other for other in others if file.shapes[other] == (len(signals),)]
        table = _conditions(file, label_at, of_trials, given, len(signals))
        unused = [other for other in (*others, *file.cells) if other not in of_trials and other != name]
        if unused:
            log.warning("%s: not used: %s", file.path, some([file.shown(other) for other in unused]))
        rate_Hz = sampling_rate_of(said_rates(file), sampling_rate_Hz, str(file.path))
        return Loaded(signals, table, channels, rate_Hz, {**units_in(channels), **units})


def _signals_at(file: ArrayFile, named: str | None, axes: str | None) -> str:
    """The name of the array of signals, or of the cell array of them."""
    if named is not None:
        return file.existing(named)
    n_axes = {axes.count(",") + 1} if axes else set()
    ways = [[name for name, shape in file.shapes.items() if len(shape) in ns] for ns in (n_axes, {3, 4})]
    names = ways[0] or ways[1] or [*file.cells]
    if len(names) == 1:
        return names[0]
    shown = ", ".join(map(file.shown, [*file.shapes, *file.cells][:12])) or "none at all"
    matrices = {name: shape for name, shape in file.shapes.items() if len(shape) == 2}
    are_trials = len({shape[1] for shape in matrices.values()}) == 1 and all(n > m > 0 for n, m in matrices.values())
    fix = "save the signals as one array with three axes"
    if names:
        fix = "name one with `names={'signals': ...}`"
    elif are_trials and len(matrices) > 1:
        fix = (
            f"{len(matrices)} arrays such as '{next(iter(matrices))}' look like one trial each, (time, taxel): save "
            "each in a file of its own, in one folder per class, and read them with neurotact import folder"
        )
    elif matrices:
        fix = (
            f"{fix}; '{next(iter(matrices))}' is read as the signals of one taxel with `axes='trial,time'`, but "
            "features of each trial have no time to encode"
        )
    raise InputError(f"{file.path}: holds {len(names)} arrays with the axes trial, time and taxel ({shown}); {fix}")


def _signals(
    file: ArrayFile, name: str, axes: str | None
) -> tuple[Sequence[np.ndarray] | np.ndarray, tuple[int, int] | None, tuple[str, ...]]:
    """The signals as `(trial, time, taxel)`, or a `(time, taxel)` array per cell; their grid and the order of axes."""
    where = f"{file.path}: '{name}'"
    if name in file.cells:
        return _stacked_cells(file.cells[name], axes, where)
    shape = file.shapes[name]
    order = _order_of(axes, shape, where)
    if 0 in shape:
        raise InputError(f"{where} has the shape {shape}; give an array of trials, samples and taxels")
    values = np.asarray(file.read(name))
    if values.dtype.kind not in "iufb":
        raise InputError(f"{where} holds {values.dtype}, not numbers; save the signals as numbers")
    return *_stacked(values, order), order


def _at(
    file: ArrayFile, what: str, names: Mapping[str, str], n: int, signals: str, order: tuple[str, ...]
) -> str | None:
    """The name of the array of a label or of channels, of `n` values; None if there is none.

    signals, order: the name of the array of signals and its axes, for messages.
    """
    named = names.get(what)
    if named is None:
        plain = {name.rpartition("/")[2].lower(): name for name, shape in file.shapes.items() if shape == (n,)}
        match = next((plain[alias] for alias in ALIASES[what] if alias in plain), None)
        if match is None and what == LABEL:
            labels = [key for key in file.shapes if key.rpartition("/")[2].lower() in ALIASES[LABEL]]
            _check_trial_axis(file, labels, signals, order)
        return match
    if file.shapes[file.existing(named)] != (n,):
        if what == LABEL:
            _check_trial_axis(file, [named], signals, order)
        raise InputError(
            f"{file.path}: '{named}' has the shape {file.shapes[named]} where ({n},) is expected; give one value per "
            f"{TRIAL if what == LABEL else TAXEL}"
        )
    return named


def _check_trial_axis(file: ArrayFile, labels: Sequence[str], signals: str, order: tuple[str, ...]) -> None:
    """Refuse classes of as many trials as another axis of the signals is long: it is the axis of trials."""
    shape = () if signals in file.cells else file.shapes[signals]
    for label in labels if len(shape) == len(AXES) else ():
        places = [axis for axis, n in enumerate(shape) if file.shapes[label] == (n,)]
        if len(places) == 1 and order[places[0]] != TRIAL:
            rest = [axis for axis in range(len(shape)) if axis != places[0]]
            time = max(rest, key=lambda axis: shape[axis])
            meant = [TRIAL if axis == places[0] else TIME if axis == time else TAXEL for axis in range(len(shape))]
            raise InputError(
                f"{file.path}: '{label}' has {shape[places[0]]} values, as many as axis {places[0] + 1} of '{signals}' "
                f"{shape} is long; if these are the trials, use `axes='{','.join(meant)}'`"
            )


def _conditions(
    file: ArrayFile, label_at: str | None, of_trials: Sequence[str], given: Mapping[str, Any], n_trials: int
) -> pd.DataFrame:
    """The class and the conditions of each trial: arrays of one value per trial, and the columns of a table."""
    columns = {name.rpartition("/")[2]: name for name in reversed(of_trials)}
    twice = [name for name in of_trials if columns[name.rpartition("/")[2]] != name]
    if label_at is None and LABEL not in given:
        known = ", ".join(of_trials) or "none has one value per trial"
        called_so = next((key for key in file.shapes if key.rpartition("/")[2].lower() in ALIASES[LABEL]), None)
        if called_so is not None:
            raise InputError(
                f"{file.path}: '{called_so}' has the shape {file.shapes[called_so]}, but there are {n_trials} trials; "
                "give one value per trial, or name another array with `names={'label': ...}`"
            )
        raise InputError(
            f"{file.path}: no array is called label ({known}); name the class with `names={{'label': ...}}`, or give a "
            "table that has it with `conditions`"
        )
    table: dict[str, Any] = {} if label_at is None else {LABEL: _labels_of(file.values(label_at))}
    table |= {column: file.values(name) for column, name in columns.items() if column not in table}
    shared = [name for name in given if name in table]
    if shared:
        raise InputError(f"{file.path}: '{shared[0]}' is an array here and a column of `conditions`; drop one of them")
    if twice:
        log.warning("%s: not used, as another array of its name is: %s", file.path, some(twice))
    table |= given
    return pd.DataFrame({LABEL: table.pop(LABEL), **table})


def _table_of_trials(
    path: Path, n_trials: int, named: str | None, file: ArrayFile
) -> tuple[str | None, dict[str, Any]]:
    """The columns of a table with a row per trial, or the class of each trial from an .npy file.

    named: the array or the column that is the class. First its name, if it is that of a column and of no array.
    """
    label = None
    if path.suffix.lower() == CLASSES:
        columns: dict[str, Any] = {LABEL: _labels_of(read_array(path).ravel())}
    else:
        table = named_table(existing(path))
        label = named if named not in file.shapes and named in table.names else None
        its = label or called(table.names, LABEL)
        held = columns_of(table, {its} if its else set())
        columns = {LABEL if name == its else name: values_of(values) for name, values in held.items()}
    n_rows = len(next(iter(columns.values())))
    if n_rows != n_trials:
        raise InputError(
            f"{path}: has {n_rows} rows, but {file.path} {n_trials} trials; give a row per trial, in their order"
        )
    return label, columns


def _labels_of(values: np.ndarray) -> list[Any]:
    """Names of classes; whole numbers are written without a point, others, which name no class, stay numbers."""
    if values.dtype.kind == "f":
        if not (np.isfinite(values).all() and (values == np.floor(values)).all()):
            return values.tolist()
        values = values.astype(np.int64)
    return [str(value) for value in values.tolist()]
