"""Files of events: CSV tables, NumPy arrays, structured x, y, t, p arrays, and HDF5 in the Heidelberg layout."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from neurotact_parts.readers.events import heidelberg, signed_matrix
from neurotact_parts.readers.events.spikes import ROW, Events, EventSpec, joined, to_trains
from neurotact_parts.readers.events.times import event_times, in_order
from neurotact_parts.readers.folder import conditions_of
from neurotact_parts.readers.numpy_files import read_array, read_arrays

from neurotact.data.hdf5_input import EVENTS, Declared, opened
from neurotact.data.readers.clock.units import UNIT_S, Unit, unit_in, without_unit
from neurotact.data.readers.columns import OF_EVENTS, LayoutSpec, called, read_table
from neurotact.data.readers.formats import arrays_in, tables_in
from neurotact.data.readers.formats.contents import HDF5, LVM, MATLAB, NPY, NPZ, TDMS, ZIP, check_content
from neurotact.data.readers.specs import NamingSpec
from neurotact.data.readers.table.cells import (
    COMMAS,
    DECIMAL_COMMA,
    NUMBER,
    THOUSANDS,
    columns_of,
    grouping_of,
    has_decimal_commas,
    values_of,
)
from neurotact.data.readers.table.headings import named_table
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError, nearest, number_of, some
from neurotact.files import below, check_size, existing, is_hidden
from neurotact.lazily import lazily
from neurotact.spec import build

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

POPULATION, POLARITY = "population", "polarity"
"""The population, and its other name, of which a sensor with polarities has two."""
WRITTEN = ("trial", "afferent", "type", "time_s")
"""Columns of a table of spikes that was written for other programs: it lacks classes, silent trials and lengths."""
ARCHIVES, TABLES, HDF5_FILES = (".npz", ".npy"), (".csv", ".txt", ".tsv", ".parquet"), (".h5", ".hdf5")
MATLAB_FILES, TENSORS = (".mat",), (".pt", ".pth")
"""Files of vectors, of MATLAB also of `signed_matrix`."""
OF_TRIALS = (*TABLES, *ARCHIVES, *MATLAB_FILES, *TENSORS)


def read(
    path: str | Path,
    spec: Mapping[str, Any] | None = None,
    *,
    names: Mapping[str, str] | None = None,
    naming: Mapping[str, Any] | None = None,
) -> SpikeTrains:
    """Events as spike trains, from one file, or from a folder of one file per trial, as of `api.read_events`.

    spec: keys of `EventSpec`. names: of columns that `columns.GUESSES` does not have. naming: keys of `NamingSpec`.

    CSV: a row per event, with a header; columns that are constant within each trial are its conditions. NPZ: an array
    per column (`time_s`, `channel`, `polarity`, `trial`), and per trial (`label`, conditions); or one structured array
    (x, y, t, p) per trial. HDF5: `spikes/times`, `spikes/units` and `labels`, as the Heidelberg Digits have them.
    """
    options = build(EventSpec, spec or {}, "import events")
    names = dict(names or {})
    if {POLARITY, POPULATION} <= names.keys():
        raise InputError(f"`names`: {POLARITY} and {POPULATION} are the same; give one of them")
    path = existing(path, "file or folder")
    if path.is_dir():
        wrong = next((what for what in (LABEL, "trial") if what in names), None)
        if wrong is not None:
            raise InputError(
                f"{path}: each file is a trial, and its place or name gives the class (`levels`, `pattern` or "
                f"`conditions`); drop `names={{{wrong!r}: ...}}`"
            )
        named = build(NamingSpec, naming or {}, "import events")
        return _to_trains(_of_folder(path, options, names, named), options, path)
    if naming and any(naming.values()):
        raise InputError(f"{path}: is one file; `levels`, `pattern`, `conditions` and `label` are for a folder")
    if path.suffix.lower() in HDF5_FILES:
        if names:
            raise InputError(
                f"{path}: the Heidelberg layout has names of its own; drop `names={{{next(iter(names))!r}: ...}}`"
            )
        check_content(path, HDF5)
        with opened(path, EVENTS) as (file, _):
            return heidelberg.spikes_in(Declared(file, path), options)
    events = _of_file(path, options, names)
    if path.suffix.lower() in MATLAB_FILES and LABEL not in events.conditions:
        raise InputError(
            f"{path}: is one trial without a class; give a folder that holds a folder of such files per class"
        )
    if LABEL not in events.conditions:
        raise InputError(
            f"{path}: no column is called label, the class of each trial; name it with `names={{'label': ...}}`"
        )
    return _to_trains(events, options, path)


def _to_trains(events: Events, spec: EventSpec, path: Path) -> SpikeTrains:
    if events.ignored:
        log.warning(
            "%s: not used, because the value changes within a trial: %s; if one of them is the polarity, name it with "
            "`names={'polarity': ...}`",
            path, ", ".join(events.ignored),
        )  # fmt: skip
    if events.other:
        log.warning("%s: not used, because it has no value per event or trial: %s", path, some(events.other))
    return to_trains(events, spec, str(path))


def _of_file(path: Path, spec: EventSpec, names: Mapping[str, str]) -> Events:
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return _of_columns(_columns(path, names), spec, names, path)
    if suffix in ARCHIVES:
        check_content(path, *((NPZ, ZIP) if suffix == ".npz" else (NPY,)))
        arrays = read_arrays(path) if suffix == ".npz" else {"events": read_array(path)}
        if all(array.dtype.names for array in arrays.values()):
            return _structured(arrays, spec, names, path)
        return _of_columns(arrays, spec, names, path)
    if suffix in (*MATLAB_FILES, *TENSORS):
        held = arrays_in(path)
        columns = {
            name.rpartition("/")[2]: values for name, values in held.arrays.items()
        }  # of a structure, its fields
        if suffix in TENSORS or (len(columns) > 1 and _place("time", columns, names, path) is not None):
            return _of_columns(columns, spec, names, path)
        matrix = signed_matrix.matrix_of(held, path)
        events = _of_columns(signed_matrix.events_of(matrix), spec, {**names, LABEL: ""}, path)
        return events._replace(n_channels=len(matrix) - 1)
    check_content(path, NPY, NPZ, MATLAB, TDMS, LVM)  # their fix is another suffix
    known = ", ".join((*OF_TRIALS, *HDF5_FILES))
    raise InputError(f"{path}: is not a file of events by its suffix; give one that ends with {known}")


def _columns(path: Path, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """The columns of a table; InputError, which says so, for the table of another command and for rows of a raster."""
    if path.suffix.lower() == ".parquet":
        return columns_of(tables_in(path)[""])
    try:
        columns = columns_of(named_table(path))
    except InputError:
        rows = {}
        with suppress(InputError):
            rows[""] = read_table(path, LayoutSpec()).signal
        _check_no_raster(rows, (), path)
        raise
    if tuple(columns) == WRITTEN and not any(names.values()):
        raise InputError(
            f"{path}: neurotact raster wrote this table, without classes, silent trials and lengths; use its file of "
            "spikes, or write that as .nwb and read it with neurotact import nwb"
        )
    return columns


def _check_no_raster(columns: Mapping[str, np.ndarray], known: Collection[str | None], path: Path) -> None:
    """InputError that names the right command if an array, or columns that are not `known`, hold a number a step.

    These are 0 and 1 alone, or counts of which most are 0.
    """
    arrays = {name: values for name, values in columns.items() if values.ndim > 1 and _is_raster(values)}
    flat = {name: values for name, values in columns.items() if values.ndim == 1 and name not in known}
    flat = [name for name, values in flat.items() if _is_raster(values_of(values))]
    if not (arrays or flat):
        return
    is_table = path.suffix.lower() in TABLES
    name, values = next(iter(arrays.items()), (some(flat), None))
    shown = f"'{name}' of the shape {values.shape}" if values is not None and not is_table else name or "its rows"
    fix = "reads a folder of such files, one per trial, in a sub-folder per class" if is_table else "reads it"
    raise InputError(
        f"{path}: holds no events but a raster, a number per step ({shown}); neurotact import raster {fix}"
    )


def _is_raster(values: np.ndarray) -> bool:
    """Whether numbers are 0 and 1 alone, or counts of which most are 0."""
    if values.dtype.kind not in "iufb" or not values.size:
        return False
    is_binary = np.isin(values, (0, 1)).all()
    is_count = (values >= 0).all() and (values == np.floor(values)).all() and (values == 0).mean() > 0.5
    return bool(is_binary or is_count)


def _of_folder(folder: Path, spec: EventSpec, names: Mapping[str, str], naming: NamingSpec) -> Events:
    """One trial per file; class and conditions come from paths and names, as for a folder of recordings."""
    table = None if naming.table is None else os.path.realpath(naming.table)
    inside = [path for path in below(folder) if table is None or os.path.realpath(path) != table]
    paths = [path for path in inside if path.suffix.lower() in OF_TRIALS and not is_hidden(path.name)]
    ignored = [path for path in inside if path not in paths]
    if not paths:
        for path in ignored:
            check_content(path)
        raise InputError(f"{folder}: holds no {', '.join(OF_TRIALS)} file; add one")
    if ignored:
        shown = some([path.relative_to(folder).as_posix() for path in ignored])
        log.warning("%s: ignores %s (hidden, or not events): %s", folder, number_of(len(ignored), "file"), shown)
    conditions = conditions_of([path.relative_to(folder).as_posix() for path in paths], naming, folder)
    parts, n_bytes = [], 0
    for path in paths:
        part = _of_file(path, spec, {**names, LABEL: ""})
        if len(part.conditions) != 1:
            raise InputError(f"{path}: holds {len(part.conditions)} trials where a folder has one per file")
        parts.append(part)
        n_bytes += sum(np.asarray(column).nbytes for column in part[:4] if column is not None)
        check_size(folder, n_bytes)
    return _joined(parts, paths)._replace(conditions=conditions)


def _joined(parts: Sequence[Events], places: Sequence[Path]) -> Events:
    """The events of all files or arrays, which must say the same about their events."""
    told = [(part.is_grid, part.population is not None, part.channel.dtype.kind in "iu") for part in parts]
    for what, ours in zip(("places x and y", "a polarity", "numbered channels"), zip(*told, strict=True), strict=True):
        if len(set(ours)) > 1:
            raise InputError(
                f"{places[ours.index(True)]} has {what}, but {places[ours.index(False)]} has none; give each the same"
            )
    return joined(parts)


def _of_columns(
    columns: Mapping[str, np.ndarray], spec: EventSpec, names: Mapping[str, str], path: Path, usual: Unit = "s"
) -> Events:
    """Columns by their names: those as long as the times are of events, the others of trials.

    usual: the unit of times that neither the spec nor a name gives; of places x and y they are microseconds.
    """
    roles = {what: _place(what, columns, names, path) for what in OF_EVENTS}
    is_grid = roles["channel"] is None and "x" in map(str.lower, columns)
    if is_grid:
        roles |= {axis: next((n for n in columns if n.lower() == axis), None) for axis in ("x", "y")}
    time_name = roles["time"]
    if time_name is None or (roles["channel"] is None and not is_grid):
        _check_no_raster(columns, roles.values(), path)
        absent = "time" if time_name is None else "channel"
        raise InputError(
            f"{path}: no column is called {absent} ({some(list(columns), 12)}); name it with "
            f"`names={{{absent!r}: ...}}`"
        )
    said_unit = spec.time_unit or unit_in(time_name) or ("us" if is_grid or usual == "us" else None)
    unit = said_unit or usual
    if columns[time_name].ndim != 1:
        raise InputError(f"{path}: '{time_name}' has the shape {columns[time_name].shape}; give one time per event")
    stamps = _stamps(columns[time_name], time_name, path)
    of_events = {what: columns[name] for what, name in roles.items() if name is not None and what != LABEL}
    for what, values in of_events.items():
        if values.shape != stamps.shape:
            _check_no_raster(columns, (*columns,), path)
            raise InputError(f"{path}: '{roles[what]}' has the shape {values.shape} where {stamps.shape} is expected")
    trial, others = _trials(columns, roles, len(stamps), path)
    unused = [name for name in columns if name not in {*roles.values(), *others.columns}]
    channel = _places_of(of_events, path) if is_grid else _channel(of_events["channel"], str(roles["channel"]), path)
    population = values_of(of_events[POPULATION]) if POPULATION in of_events else None
    if population is not None and population.dtype.kind == "f" and not np.isfinite(population).all():
        event = int(np.argmin(np.isfinite(population)))
        raise InputError(f"{path}: event {event} of '{roles[POPULATION]}' is {population[event]}; drop the event")
    ordered = in_order(stamps, trial, [channel, *([] if population is None else [population])], may_wrap=unit != "ns")
    cells = columns[time_name]
    times = event_times(
        ordered.stamps, UNIT_S[unit], spec.origin, trial, cells.astype(str) if cells.dtype.kind in "OSU" else None
    )
    return Events(
        times.time_s, channel, population, trial, others, is_grid,
        ignored=tuple(name for name in unused if columns[name].shape == stamps.shape),
        other=tuple(f"{name} {columns[name].shape}" for name in unused if columns[name].shape != stamps.shape),
        error_s=times.error_s, resolutions=times.resolutions, n_back=ordered.n_back, n_wraps=ordered.n_wraps,
        has_unit=said_unit is not None or bool((stamps != np.floor(stamps)).any()),
    )  # fmt: skip


def _place(what: str, columns: Mapping[str, np.ndarray], names: Mapping[str, str], path: Path) -> str | None:
    """The column of a quantity; None if there is none."""
    word = POLARITY if what == POPULATION and POLARITY in names else what
    if word in names:
        name = names[word]
        if name and name not in columns:
            raise InputError(
                f"{path}: `names={{{word!r}: ...}}`: there is no '{name[:40]}'; {nearest(name, list(columns))}"
            )
        return name or None
    free = [name for name in columns if name not in names.values()]
    plain = {without_unit(re.sub("^events?_", "", name.lower())): name for name in reversed(free)}
    return plain.get(called([*plain], f"event {what}") or "")


def _trials(
    columns: Mapping[str, np.ndarray], roles: Mapping[str, str | None], n_events: int, path: Path
) -> tuple[np.ndarray, pd.DataFrame]:
    """The trial of each event, and the conditions of all trials."""
    used = {name for what, name in roles.items() if what != LABEL}
    rest = {name: values for name, values in columns.items() if name not in used and values.ndim == 1}
    number = np.zeros(n_events, np.int64) if roles["trial"] is None else columns[str(roles["trial"])]
    lengths = {len(values) for values in rest.values()} - {n_events}
    if number.dtype.kind == "f" and (number == np.rint(number)).all() and (np.abs(number) < 2**53).all():
        number = number.astype(np.int64)  # an array of several columns holds all of them as floats
    if number.dtype.kind in "iu" and len(lengths) == 1 and roles["trial"] is not None:
        (n_trials,) = lengths  # arrays of one value per trial; events refer to trials by index
        if n_events and not (number.min() >= 0 and number.max() < n_trials):
            raise InputError(
                f"{path}: '{roles['trial']}' must hold 0 to {n_trials - 1}, as there are {n_trials} trials; "
                "number them from 0"
            )
        per_trial = {name: values for name, values in rest.items() if len(values) == n_trials}
        return number.astype(np.int64), _conditions(per_trial, roles[LABEL], path)
    trial, values = pd.factorize(number, use_na_sentinel=False)  # in order of first appearance
    begin = np.unique(trial, return_index=True)[1]
    constant = {
        name: part[begin] for name, part in rest.items() if len(part) == n_events and (part == part[begin][trial]).all()
    }
    if roles[LABEL] is not None and roles[LABEL] not in constant:
        raise InputError(
            f"{path}: '{roles[LABEL]}' changes within a trial; give each trial one class, or `names={{'trial': ...}}`"
        )
    if roles[LABEL] is None:
        return trial, pd.DataFrame(index=range(len(values)))
    return trial, _conditions(constant, roles[LABEL], path)


def _conditions(columns: Mapping[str, np.ndarray], label: str | None, path: Path) -> pd.DataFrame:
    if label is None or label not in columns:
        raise InputError(
            f"{path}: no value per trial is called label ({', '.join(columns) or 'there is none'}); name the class "
            "with `names={'label': ...}`"
        )
    others = {name: values_of(values) for name, values in columns.items() if name not in (label, LABEL)}
    return pd.DataFrame({LABEL: [str(value) for value in columns[label].tolist()], **others})


def _channel(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    numbers = values_of(values)
    if numbers.dtype.kind != "f":
        return numbers
    if not (np.isfinite(numbers) & (numbers == np.floor(numbers)) & (np.abs(numbers) < 2**31)).all():
        raise InputError(
            f"{path}: '{name}' holds {numbers[numbers != np.floor(numbers)][:1]}, not a whole number; number channels"
        )
    return numbers.astype(np.int64)


def _stamps(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    """The times of events as the numbers that the file holds."""
    if values.dtype.kind in "OSU" and has_decimal_commas([values.astype(str).tolist()]):
        log.warning("%s: %s", path, COMMAS)
        values = np.char.replace(values.astype(str), ",", ".")
    stamps = values_of(values)
    if stamps.dtype.kind == "U":
        texts = stamps.tolist()
        wrong = [i for i, text in enumerate(texts) if not NUMBER.fullmatch(text.strip())]
        if sign := next(filter(None, (_sign_fault(texts[i], texts) for i in wrong or range(len(texts)))), ""):
            raise InputError(f"{path}: '{name}' {sign}")
    elif stamps.dtype.kind in "iuf":
        wrong = np.flatnonzero(~np.isfinite(stamps)).tolist()
    else:
        raise InputError(f"{path}: '{name}' holds {stamps.dtype}, not numbers; save the times as numbers")
    if wrong:
        what = f"event {wrong[0]} of '{name}' is {str(stamps[wrong[0]])[:20]!r}, not a number"
        more = f", and so are {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise InputError(f"{path}: {what}{more}; drop {'these events' if more else 'the event'}")
    return stamps


def _sign_fault(cell: str, texts: Sequence[str]) -> str:
    """What is wrong with the signs in a number, and the fix; empty if nothing is."""
    if DECIMAL_COMMA.fullmatch(cell) and grouping_of(texts, ",") == "no":
        return f"has decimal commas, as in {cell[:20]}; write decimal points"
    is_one = THOUSANDS.fullmatch(cell)
    return f"has separators of thousands, as in {cell[:20]!r}; write numbers without them" if is_one else ""


def _structured(arrays: Mapping[str, np.ndarray], spec: EventSpec, names: Mapping[str, str], path: Path) -> Events:
    """Structured arrays with the fields t, p, x and y (or one address), one per trial, by the key in the file."""
    wrong = next((what for what in (LABEL, "trial") if names.get(what)), None)
    if wrong is not None:
        raise InputError(
            f"{path}: each structured array is a trial, and its key the class; drop `names={{{wrong!r}: ...}}`"
        )
    parts, places = [], []
    for key, array in arrays.items():
        fields = {name: array[name] for name in array.dtype.names or ()}
        places.append(path if len(arrays) == 1 else Path(f"{path}:{key}"))
        if any(field.dtype.kind not in "iufb" or field.ndim != 1 for field in fields.values()):
            raise InputError(f"{places[-1]}: its fields must hold one number each; save t, x, y and p")
        part = _of_columns(fields, spec, {**names, LABEL: "", "trial": ""}, places[-1], "us")
        label = re.sub(r"_\d+$", "", key)  # a key such as felt_3
        parts.append(part._replace(conditions=pd.DataFrame({LABEL: [label]})))
    return _joined(parts, places)


def _places_of(columns: Mapping[str, np.ndarray], where: Path) -> np.ndarray:
    """Positions on a grid whose width is not known yet, from x and, if there is one, y."""
    places = np.zeros(len(columns["x"]), np.int64)
    for name, scale in (("x", 1), ("y", ROW)):
        values = values_of(columns[name]) if name in columns else places
        is_number = values.dtype.kind in "iufb"
        if len(values) and not (
            is_number and values.min() >= 0 and values.max() < ROW and (values == np.floor(values)).all()
        ):
            raise InputError(f"{where}: '{name}' must hold whole numbers from 0 on; number columns and rows")
        places = places + scale * values.astype(np.int64)
    return places
