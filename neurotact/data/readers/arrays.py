"""One NPZ, NPY, MATLAB or HDF5 file: signals of all trials, and the class and conditions of each trial."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.readers import doubts, first_rows
from neurotact.data.readers.archives import read_array
from neurotact.data.readers.array_files import ArrayFile, is_rate, opened_arrays, said_rates, sampling_rate_of
from neurotact.data.readers.axes import AXES, TAXEL, TIME, TRIAL, Grid, order_of, stacked, stacked_cells
from neurotact.data.readers.headings import named_table
from neurotact.data.readers.tables import called, check_digits, check_width, columns_of, values_of
from neurotact.data.recordings import LABEL, Recordings, check_import
from neurotact.errors import InputError, nearest, some
from neurotact.files import existing

SIGNALS, CHANNELS = "signals", "channels"
ALIASES = {
    LABEL: (LABEL, "labels", "class", "classes", "y", "target", "targets"),
    CHANNELS: (CHANNELS, "channel_names", "taxels", "electrodes"),
}
"""Names of the arrays; the signals are the only array with three or four axes, or the only cell array of matrices."""
CLASSES = ".npy"
"""The suffix of a file with the class of each trial alone."""
FIXES = doubts.Fixes("save the array without it", axes="use `axes`")

log = logging.getLogger("neurotact")


class Loaded(NamedTuple):
    """What a file of arrays holds: one `(time, taxel)` array per trial, or one `(trial, time, taxel)` array.

    channels: the taxels' names; none if the file has none.
    """

    signals: Sequence[np.ndarray] | np.ndarray
    conditions: pd.DataFrame
    channels: tuple[str, ...]
    sampling_rate_Hz: float


def read(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    unit: str = "",
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
) -> Recordings:
    """The recordings in one .npz, .npy, .mat, .h5 or .hdf5 file.

    sampling_rate_Hz: that which the file says (`fs`, `sampling_rate`) when None.
    names: the names of signals, label and channels in the file, such as `{"signals": "data", "label": "gesture"}`; by
    default the signals are the only array with three or four axes, and the label is one of `ALIASES`.
    axes: the axes of the signals, in order; "trial,time,taxel" when None, or for a grid "trial,time,row,column" or
    "trial,row,column,time", whichever has the time as its longest axis. Signals of one taxel: "trial,time".
    conditions: a CSV file with a row per trial and a column per condition, or an .npy file with the class of each; the
    name of label may be that of a column.

    Every other array of one value per trial is a condition. A cell array of matrices has trials of any lengths. A grid
    is read row by row, with names such as `r0c1`. Pickles are not loaded. Raises InputError, which names the file, the
    array and the fix.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "touches.npz"
    >>> rest = np.random.default_rng(0).normal(size=(2, 50, 3))
    >>> np.savez(path, data=rest, gesture=["tap", "rub"], session=[1, 1])
    >>> touches = read(path, 100, "count", names={"label": "gesture"})
    >>> touches, touches.conditions["session"].tolist()
    (Recordings(2 trials x 3 taxels, 50 samples at 100 Hz (0.5 s), count, 2 classes), [1, 1])
    """
    check_import(sampling_rate_Hz, unit, str(path))
    parts = load(path, sampling_rate_Hz, names, axes, conditions)
    for trial, signal in enumerate(parts.signals):
        check_digits(np.asarray(signal), f"{path}: trial {trial}")
        first_rows.check(np.asarray(signal), f"{path}: trial {trial}", 0)
    recordings = Recordings(
        parts.signals, parts.sampling_rate_Hz, unit, parts.conditions, parts.channels, f"arrays of {Path(path).name}"
    )
    doubts.say(recordings, str(path), FIXES)
    return recordings


def load(
    path: str | Path,
    sampling_rate_Hz: float | None,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
) -> Loaded:
    """What a file of arrays holds, with numbers as they are stored; the arguments are those of `read`."""
    unknown = [name for name in names or {} if name not in (SIGNALS, *ALIASES)]
    if unknown:
        raise InputError(f"{path}: '{unknown[0]}' is not a known name; {nearest(unknown[0], (SIGNALS, *ALIASES))}")
    with opened_arrays(path) as file:
        if file.others:
            log.warning("%s: neither numbers nor texts, so not read: %s", path, some(file.others))
        return _loaded(file, sampling_rate_Hz, names or {}, axes, conditions)


def _loaded(
    file: ArrayFile, rate_Hz: float | None, names: Mapping[str, str], axes: str | None, table: str | Path | None
) -> Loaded:
    name = _signals_at(file, names.get(SIGNALS), axes)
    signals, grid, order = _signals(file, name, axes)
    check_width(f"{file.path}: '{name}'", signals[0].shape[1])
    of_table = None if table is None else _column(Path(table), names.get(LABEL), file)
    given = {} if table is None else _table_of_trials(Path(table), len(signals), str(file.path), of_table)
    label_at = None if of_table is not None else _at(file, LABEL, names, len(signals), name, order)
    channels_at = _at(file, CHANNELS, names, signals[0].shape[1], name, order)
    channels = () if channels_at is None else tuple(map(str, file.values(channels_at).tolist()))
    if grid is not None and not channels:
        channels = grid.channels
        log.warning(
            "%s: '%s' has the axes %s: %d taxels, named %s to %s row by row",
            file.path, name, ", ".join(order), len(channels), channels[0], channels[-1],
        )  # fmt: skip
    others = [other for other in file.shapes if other not in (name, channels_at, label_at) and not is_rate(other)]
    of_trials = [other for other in others if file.shapes[other] == (len(signals),)]
    conditions = _conditions(file, label_at, of_trials, given)
    unused = [other for other in others if other not in of_trials] + [cell for cell in file.cells if cell != name]
    if unused:
        log.warning("%s: not used: %s", file.path, some([f"{name} {_shape(file, name)}" for name in unused]))
    return Loaded(signals, conditions, channels, sampling_rate_of(said_rates(file), rate_Hz, str(file.path)))


def _shape(file: ArrayFile, name: str) -> str:
    return f"({len(file.cells[name])} cells)" if name in file.cells else str(file.shapes[name])


def _signals_at(file: ArrayFile, named: str | None, axes: str | None) -> str:
    """The name of the array of signals, or of the cell array of them."""
    if named is not None:
        return _existing(file, named)
    stacks = [name for name, shape in file.shapes.items() if len(shape) in (3, 4)]
    named_axes = [name for name, shape in file.shapes.items() if axes and len(shape) == axes.count(",") + 1]
    names = named_axes or stacks or [*file.cells]
    if len(names) == 1:
        return names[0]
    shown = ", ".join(f"{name} {_shape(file, name)}" for name in [*file.shapes, *file.cells][:12]) or "none at all"
    matrix = next((name for name, shape in file.shapes.items() if len(shape) == 2), None)
    fix = "save the signals as one array with three axes"
    if names:
        fix = "name one with `names={'signals': ...}`"
    elif len(trials := _like_trials(file)) > 1:
        fix = (
            f"{len(trials)} arrays such as '{trials[0]}' look like one trial each, (time, taxel): save each in a "
            "file of its own, in one folder per class, and read them with neurotact import folder"
        )
    elif matrix is not None:
        fix = (
            f"{fix}; '{matrix}' is read as the signals of one taxel with `axes='trial,time'`, but features of "
            "each trial have no time to encode"
        )
    raise InputError(f"{file.path}: holds {len(names)} arrays with the axes trial, time and taxel ({shown}); {fix}")


def _like_trials(file: ArrayFile) -> list[str]:
    """The names of arrays that may be `(time, taxel)` of one trial: of as many taxels, which are fewer than samples."""
    matrices = {name: shape for name, shape in file.shapes.items() if len(shape) == 2}
    widths = {shape[1] for shape in matrices.values()}
    return [*matrices] if len(widths) == 1 and all(shape[0] > shape[1] > 0 for shape in matrices.values()) else []


def _signals(
    file: ArrayFile, name: str, axes: str | None
) -> tuple[Sequence[np.ndarray] | np.ndarray, Grid | None, tuple[str, ...]]:
    """The signals as `(trial, time, taxel)`, or a `(time, taxel)` array per cell; their grid and the order of axes."""
    where = f"{file.path}: '{name}'"
    if name in file.cells:
        return stacked_cells(file.cells[name], axes, where)
    shape = file.shapes[name]
    order = order_of(axes, shape, where)
    if 0 in shape:
        raise InputError(f"{where} has the shape {shape}; give an array of trials, samples and taxels")
    values = np.asarray(file.read(name))
    if values.dtype.kind not in "iufb":
        raise InputError(f"{where} holds {values.dtype}, not numbers; save the signals as numbers")
    return *stacked(values, order), order


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
    if file.shapes[_existing(file, named)] != (n,):
        if what == LABEL:
            _check_trial_axis(file, [named], signals, order)
        raise InputError(
            f"{file.path}: '{named}' has the shape {file.shapes[named]} where ({n},) is expected; give one value per "
            f"{TRIAL if what == LABEL else TAXEL}"
        )
    return named


def _check_trial_axis(file: ArrayFile, labels: Sequence[str], signals: str, order: tuple[str, ...]) -> None:
    """Refuse classes of as many trials as another axis of the signals is long: it is the axis of trials."""
    if signals in file.cells:
        return
    shape = file.shapes[signals]
    for label in labels:
        places = [axis for axis, n in enumerate(shape) if file.shapes[label] == (n,)]
        if len(places) == 1 and len(shape) == len(AXES) and order[places[0]] != TRIAL:
            rest = [axis for axis in range(len(shape)) if axis != places[0]]
            time = max(rest, key=lambda axis: shape[axis])
            meant = [TRIAL if axis == places[0] else TIME if axis == time else TAXEL for axis in range(len(shape))]
            raise InputError(
                f"{file.path}: '{label}' has {shape[places[0]]} values, as many as axis {places[0] + 1} of '{signals}' "
                f"{shape} is long; if these are the trials, use `axes='{','.join(meant)}'`"
            )


def _conditions(
    file: ArrayFile, label_at: str | None, of_trials: Sequence[str], given: Mapping[str, Any]
) -> pd.DataFrame:
    """The class and the conditions of each trial: arrays of one value per trial, and the columns of a table."""
    columns = {name.rpartition("/")[2]: name for name in reversed(of_trials)}
    twice = [name for name in of_trials if columns[name.rpartition("/")[2]] != name]
    if label_at is None and LABEL not in given:
        known = ", ".join(of_trials) or "none has one value per trial"
        raise InputError(
            f"{file.path}: no array is called label ({known}); name the class with `names={{'label': ...}}`, or give a "
            "table that has it with `conditions`"
        )
    table: dict[str, Any] = {} if label_at is None else {LABEL: labels_of(file.values(label_at))}
    table |= {column: file.values(name) for column, name in columns.items() if column not in table}
    shared = [name for name in given if name in table]
    if shared:
        raise InputError(f"{file.path}: '{shared[0]}' is an array here and a column of `conditions`; drop one of them")
    if twice:
        log.warning("%s: not used, as another array of its name is: %s", file.path, some(twice))
    table |= given
    return pd.DataFrame({LABEL: table.pop(LABEL), **table})


def _column(path: Path, named: str | None, file: ArrayFile) -> str | None:
    """The name of the class if it is that of a column of the table in `path`, and of no array; else None."""
    if named is None or named in file.shapes or path.suffix.lower() == CLASSES:
        return None
    return named if named in named_table(existing(path)).names else None


def _table_of_trials(path: Path, n_trials: int, file: str, named: str | None) -> dict[str, Any]:
    """The columns of a table with a row per trial, or the class of each trial from an .npy file.

    named: the column that is the class; None: one with a usual name.
    """
    if path.suffix.lower() == CLASSES:
        columns_of_trials: dict[str, Any] = {LABEL: labels_of(read_array(path).ravel())}
    else:
        table = named_table(existing(path))
        label = named or called(table.names, ALIASES[LABEL])
        columns = columns_of(table, {label} if label else set())
        columns_of_trials = {LABEL if name == label else name: values_of(values) for name, values in columns.items()}
    n_rows = len(next(iter(columns_of_trials.values())))
    if n_rows != n_trials:
        raise InputError(
            f"{path}: has {n_rows} rows, but {file} {n_trials} trials; give a row per trial, in their order"
        )
    return columns_of_trials


def _existing(file: ArrayFile, named: str) -> str:
    """The name unchanged; InputError if the file has no such array."""
    if named not in file.shapes and named not in file.cells:
        raise InputError(f"{file.path}: holds no array '{named}'; {nearest(named, [*file.shapes, *file.cells])}")
    return named


def labels_of(values: np.ndarray) -> list[Any]:
    """Names of classes; whole numbers are written without a decimal point, others, which name no class, stay numbers.

    >>> labels_of(np.array([1.0, 0.0]))
    ['1', '0']
    """
    is_whole = values.dtype.kind == "f" and bool(np.isfinite(values).all() and (values == np.floor(values)).all())
    if values.dtype.kind == "f" and not is_whole:
        return values.tolist()
    return [str(value) for value in (values.astype(np.int64) if is_whole else values).tolist()]
