"""Files of events: CSV tables, NumPy arrays, structured x, y, t, p arrays, and HDF5 in the Heidelberg layout."""

import logging
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data import heidelberg
from neurotact.data.readers.archives import read_arrays
from neurotact.data.readers.clock import UNIT_S, unit_in, without_unit
from neurotact.data.readers.events import ROW, Events, EventSpec, joined, to_trains
from neurotact.data.readers.headings import named_table
from neurotact.data.readers.naming import NamingSpec, conditions_of
from neurotact.data.readers.tables import columns_of, is_number, values_of
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError, nearest
from neurotact.files import below, check_size, existing, is_hidden
from neurotact.spec import build

ALIASES = {
    "time": ("time", "times", "t", "timestamp", "timestamps", "ts"),
    "channel": ("channel", "channels", "unit", "units", "taxel", "taxels", "neuron", "address", "addr", "id"),
    "population": ("population", "polarity", "p", "pol", "type", "kind"),
    "trial": ("trial", "trials", "recording", "recordings", "sample", "samples", "touch"),
    LABEL: (LABEL, "labels", "class", "classes"),
}
"""Names of columns and arrays of events, without the prefix `event_` and a unit of time as suffix."""
POLARITY = "polarity"
"""Another name for the population, of which a sensor with polarities has two."""
ARCHIVES, TABLES, HDF5 = (".npz", ".npy"), (".csv", ".txt", ".tsv"), (".h5", ".hdf5")

log = logging.getLogger("neurotact")


def read(
    path: str | Path,
    spec: Mapping[str, Any] | None = None,
    *,
    names: Mapping[str, str] | None = None,
    naming: Mapping[str, Any] | None = None,
) -> SpikeTrains:
    """Events as spike trains, from one file, or from a folder of one file per trial.

    spec: keys of `events.EventSpec`. names: the names of time, channel, population (or polarity), trial and label in
    the file, if not among `ALIASES`. naming: keys of `naming.NamingSpec`, for the files of a folder.

    CSV: a row per event, with a header; columns that are constant within each trial are its conditions. NPZ: an array
    per column (`time_s`, `channel`, `polarity`, `trial`), and per trial (`label`, conditions); or one structured array
    (x, y, t, p) per trial. HDF5: `spikes/times`, `spikes/units` and `labels`, as the Heidelberg Digits have them.
    Pickles are not loaded. Raises InputError, which names the file and the place.
    """
    asked = build(EventSpec, spec or {}, "import events")
    names = {"population" if what == POLARITY else what: name for what, name in (names or {}).items()}
    path = existing(path, "file or folder")
    if path.is_dir():
        named = build(NamingSpec, naming or {}, "import events")
        return _to_trains(_of_folder(path, asked, names, named), asked, path)
    if naming and any(naming.values()):
        raise InputError(f"{path}: is one file; --levels, --pattern and --conditions are for a folder")
    if existing(path).suffix.lower() in HDF5:
        return heidelberg.load(path, asked)
    found = _of_file(path, asked, names)
    if LABEL not in found.conditions:
        raise InputError(f"{path}: no column is called label, the class of each trial; name it with --names label=...")
    return _to_trains(found, asked, path)


def _to_trains(events: Events, spec: EventSpec, path: Path) -> SpikeTrains:
    if events.ignored:
        log.warning(
            "%s: not used, because the value changes within a trial: %s; if one of them is the polarity, name it with "
            "--names polarity=...",
            path, ", ".join(events.ignored),
        )  # fmt: skip
    return to_trains(events, spec, str(path))


def _of_file(path: Path, spec: EventSpec, names: Mapping[str, str]) -> Events:
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return _of_columns(columns_of(named_table(path)), spec, names, path)
    if suffix in ARCHIVES:
        arrays = _arrays(path)
        if all(array.dtype.names for array in arrays.values()):
            return _structured(arrays, spec, path)
        return _of_columns(arrays, spec, names, path)
    known = ", ".join((*TABLES, *ARCHIVES, *HDF5))
    raise InputError(f"{path}: is not a file of events by its suffix; give one that ends with {known}")


def _of_folder(folder: Path, spec: EventSpec, names: Mapping[str, str], naming: NamingSpec) -> Events:
    """One trial per file; class and conditions come from paths and names, as for a folder of recordings."""
    suffixes = (*TABLES, *ARCHIVES)
    table = None if naming.table is None else os.path.realpath(naming.table)
    paths = [
        path for path in below(folder)
        if path.suffix.lower() in suffixes and not is_hidden(path.name)
        and (table is None or os.path.realpath(path) != table)
    ]  # fmt: skip
    if not paths:
        raise InputError(f"{folder}: holds no {', '.join(suffixes)} file; add one")
    conditions = conditions_of([path.relative_to(folder).as_posix() for path in paths], naming, folder)
    parts, n_bytes = [], 0
    for path in paths:
        part = _one_trial(path, spec, names)
        parts.append(part)
        n_bytes += sum(np.asarray(each).nbytes for each in part[:4] if each is not None)
        check_size(folder, n_bytes)
    return joined(parts)._replace(conditions=conditions)


def _one_trial(path: Path, spec: EventSpec, names: Mapping[str, str]) -> Events:
    found = _of_file(path, spec, {**names, LABEL: ""})
    if len(found.conditions) != 1:
        raise InputError(f"{path}: holds {len(found.conditions)} trials where a folder has one per file")
    return found


def _of_columns(columns: Mapping[str, np.ndarray], spec: EventSpec, names: Mapping[str, str], path: Path) -> Events:
    """Columns by their names: those as long as the times are of events, the others of trials."""
    found = {what: _place(what, columns, names, path) for what in ALIASES}
    time_name = found["time"]
    if time_name is None or found["channel"] is None:
        absent = "time" if time_name is None else "channel"
        raise InputError(
            f"{path}: no column is called {absent} ({', '.join(list(columns)[:12])}); name it with --names {absent}=..."
        )
    unit = spec.time_unit or unit_in(time_name) or "s"
    if columns[time_name].ndim != 1:
        raise InputError(f"{path}: '{time_name}' has the shape {columns[time_name].shape}; give one time per event")
    time_s = _numbers(columns[time_name], time_name, path) * UNIT_S[unit]
    of_events = {what: columns[name] for what, name in found.items() if name is not None and what != LABEL}
    for what, values in of_events.items():
        if values.shape != time_s.shape:
            raise InputError(f"{path}: '{found[what]}' has the shape {values.shape} where {time_s.shape} is expected")
    trial, others = _trials(columns, found, time_s, path)
    used = {*found.values(), *others.columns}
    ignored = tuple(name for name in columns if name not in used and columns[name].shape == time_s.shape)
    population = of_events.get("population")
    return Events(
        time_s, _channel(of_events["channel"], str(found["channel"]), path),
        None if population is None else values_of(population), trial, others, ignored=ignored,
    )  # fmt: skip


def _place(what: str, columns: Mapping[str, np.ndarray], names: Mapping[str, str], path: Path) -> str | None:
    """The column of a quantity; None if there is none."""
    if what in names:
        if names[what] and names[what] not in columns:
            raise InputError(
                f"{path}: --names {what}: there is no '{names[what]}'; {nearest(names[what], list(columns))}"
            )
        return names[what] or None
    plain = {name: without_unit(name.lower().removeprefix("events_").removeprefix("event_")) for name in columns}
    return next((name for alias in ALIASES[what] for name, shown in plain.items() if shown == alias), None)


def _trials(
    columns: Mapping[str, np.ndarray], found: Mapping[str, str | None], time_s: np.ndarray, path: Path
) -> tuple[np.ndarray, pd.DataFrame]:
    """The trial of each event, and the conditions of all trials."""
    n_events = len(time_s)
    used = {found[what] for what in ("time", "channel", "population", "trial")}
    rest = {name: values for name, values in columns.items() if name not in used and values.ndim == 1}
    number = np.zeros(n_events, np.int64) if found["trial"] is None else columns[str(found["trial"])]
    lengths = {len(values) for values in rest.values()} - {n_events}
    if number.dtype.kind in "iu" and len(lengths) == 1 and found["trial"] is not None:
        (n_trials,) = lengths  # arrays of one value per trial; events refer to trials by index
        if n_events and not (number.min() >= 0 and number.max() < n_trials):
            raise InputError(
                f"{path}: '{found['trial']}' must hold 0 to {n_trials - 1}, as there are {n_trials} trials"
            )
        per_trial = {name: values for name, values in rest.items() if len(values) == n_trials}
        return number.astype(np.int64), _conditions(per_trial, found[LABEL], path)
    values, first, index = np.unique(number, return_index=True, return_inverse=True)
    order = np.argsort(first)  # trials in order of first appearance
    rank = np.empty(len(values), np.int64)
    rank[order] = np.arange(len(values))
    trial = rank[index]
    begin = first[order]
    constant = {
        name: each[begin] for name, each in rest.items() if len(each) == n_events and (each == each[begin][trial]).all()
    }
    if found[LABEL] is not None and found[LABEL] not in constant:
        raise InputError(
            f"{path}: '{found[LABEL]}' changes within a trial; give each trial one class, or --names trial=..."
        )
    return trial, _conditions(constant, found[LABEL], path) if found[LABEL] is not None else pd.DataFrame(
        index=range(len(values))
    )


def _conditions(columns: Mapping[str, np.ndarray], label: str | None, path: Path) -> pd.DataFrame:
    if label is None or label not in columns:
        raise InputError(
            f"{path}: no value per trial is called label ({', '.join(columns) or 'there is none'}); name the class "
            "with --names label=..."
        )
    table = pd.DataFrame({LABEL: [str(value) for value in columns[label].tolist()]})
    for name, values in columns.items():
        if name not in (label, LABEL):
            table[name] = values_of(values)
    return table


def _channel(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    found = values_of(values)
    if found.dtype.kind != "f":
        return found
    if not (np.isfinite(found) & (found == np.floor(found)) & (np.abs(found) < 2**31)).all():
        raise InputError(
            f"{path}: '{name}' holds {found[found != np.floor(found)][:1]}, not a whole number; number channels"
        )
    return found.astype(np.int64)


def _numbers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    found = values_of(values)
    if found.dtype.kind not in "iuf":
        at = next(i for i, text in enumerate(found.astype(str)) if not is_number(text) or not np.isfinite(float(text)))
        raise InputError(f"{path}: event {at} of '{name}' is {str(found[at])[:20]!r}, not a number; drop the event")
    return found.astype(float)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if path.suffix.lower() == ".npz":
        return read_arrays(path)
    check_size(path, existing(path).stat().st_size)
    try:
        return {"events": np.load(path, allow_pickle=False)}
    except Exception as error:  # damaged bytes make numpy raise nearly anything
        why = "it holds pickled objects" if "allow_pickle" in str(error) else str(error).splitlines()[0][:80]
        raise InputError(f"{path}: cannot be read as an array ({why}); save plain numbers with numpy.save") from error


def _structured(arrays: Mapping[str, np.ndarray], spec: EventSpec, path: Path) -> Events:
    """Structured arrays with the fields t, p, x and y (or one address), one per trial, by the key in the file."""
    parts = []
    for key, array in arrays.items():
        fields = {name: array[name] for name in array.dtype.names or ()}
        where = path if len(arrays) == 1 else Path(f"{path}:{key}")
        if any(each.dtype.kind not in "iufb" or each.ndim != 1 for each in fields.values()):
            raise InputError(f"{where}: its fields must hold one number each; save t, x, y and p")
        is_grid = "x" in fields
        if is_grid:
            fields["channel"] = _places_of(fields.pop("x"), fields.pop("y", np.zeros(len(array))), where)
        unit = spec.model_copy(update={"time_unit": spec.time_unit or "us"})
        part = _of_columns(fields, unit, {LABEL: "", "trial": ""}, where)
        parts.append(part._replace(conditions=pd.DataFrame({LABEL: [_label_of(key)]}), is_grid=is_grid))
    return joined(parts)


def _places_of(x: np.ndarray, y: np.ndarray, where: Path) -> np.ndarray:
    """Positions on a grid whose width is not known yet."""
    for name, values in (("x", x), ("y", y)):
        if len(values) and not (values.min() >= 0 and values.max() < ROW and (values == np.floor(values)).all()):
            raise InputError(f"{where}: '{name}' must hold whole numbers from 0 on; number columns and rows")
    return x.astype(np.int64) + ROW * y.astype(np.int64)


def _label_of(key: str) -> str:
    """The class in an array's key: the part before a last underscore and a number, as in felt_3."""
    return re.sub(r"_\d+$", "", key)
