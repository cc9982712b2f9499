"""Recordings and spike trains as HDF5 files.

Recordings: `signals/values` (all trials end to end, `(time, channel)`), `signals/lengths`, `conditions/<column>`.
Spike trains: the layout of the Spiking Heidelberg Digits (`spikes/times` in s, `spikes/units`, `labels`), and
`conditions/<column>`, `trial_steps`. What else belongs to a file stands in its attributes.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
import pandas as pd

from neurotact.data.hdf5_output import create
from neurotact.data.recordings import LABEL, Recordings, check_sampling_rate
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.files import existing, whole

Loaded = TypeVar("Loaded")


def save_recordings(recordings: Recordings, path: str | Path) -> None:
    """Write recordings to `path`, whole or not at all."""
    with whole(path) as draft, create(draft) as (file, output):
        file.attrs["kind"] = "recordings"
        file.attrs["sampling_rate_Hz"] = recordings.sampling_rate_Hz
        file.attrs["unit"] = recordings.unit
        file.attrs["channels"] = json.dumps(recordings.channels)
        file.attrs["source"] = recordings.source
        lengths = np.array([len(s) for s in recordings.signals], np.int64)
        values = file.create_dataset("signals/values", (lengths.sum(), recordings.n_channels), np.float32)
        start = 0
        for signal in recordings.signals:
            values[start : start + len(signal)] = signal
            start += len(signal)
            output.check()
        file["signals/lengths"] = lengths
        _write_table(file.create_group("conditions"), recordings.conditions)


def load_recordings(path: str | Path) -> Recordings:
    """Read recordings; InputError for a file that is truncated, not HDF5 or of another kind."""

    def read(file: h5py.File) -> Recordings:
        lengths = _array(file, "signals/lengths")
        values = _array(file, "signals/values")
        n_expected = int(lengths.sum())
        if n_expected != len(values):
            raise InputError(f"{path}: holds {len(values)} samples of {n_expected}; it is damaged, write it again")
        equal = len(lengths) > 0 and (lengths == lengths[0]).all()
        stacked = values.reshape(len(lengths), -1, values.shape[1]) if equal else None
        return Recordings(
            signals=stacked if stacked is not None else np.split(values, np.cumsum(lengths)[:-1]),
            sampling_rate_Hz=float(file.attrs["sampling_rate_Hz"]),
            unit=str(file.attrs["unit"]),
            conditions=_read_table(file["conditions"]),
            channels=tuple(json.loads(file.attrs["channels"])),
            source=str(path),
        )

    return _load(path, "recordings", "simulate or import", read)


def save_spikes(trains: SpikeTrains, path: str | Path) -> None:
    """Write spike trains to `path`, whole or not at all."""
    with whole(path) as draft, create(draft) as (file, output):
        file.attrs["kind"] = "spikes"
        file.attrs["sampling_rate_Hz"] = trains.sampling_rate_Hz
        file.attrs["dt_s"] = 1.0 / trains.sampling_rate_Hz
        file.attrs["afferents"] = json.dumps(trains.afferents)
        file.attrs["encoder"] = json.dumps(trains.encoder)
        file.attrs["source"] = trains.source
        _write_events(file, "spikes/times", [s / trains.sampling_rate_Hz for s in trains.steps], np.float64)
        output.check()
        _write_events(file, "spikes/units", trains.units, np.uint16)
        file["labels"] = trains.labels
        file["trial_steps"] = trains.trial_steps
        _write_table(file.create_group("conditions"), trains.conditions)


def load_spikes(path: str | Path) -> SpikeTrains:
    """Read spike trains; InputError for a file that is truncated, not HDF5 or of another kind."""

    def read(file: h5py.File) -> SpikeTrains:
        rate_Hz = float(file.attrs["sampling_rate_Hz"])
        check_sampling_rate(rate_Hz, str(path))
        trains = SpikeTrains(
            steps=[np.rint(times * rate_Hz).astype(np.int64) for times in _array(file, "spikes/times")],
            units=list(_array(file, "spikes/units")),
            trial_steps=_array(file, "trial_steps"),
            sampling_rate_Hz=rate_Hz,
            afferents=tuple(json.loads(file.attrs["afferents"])),
            conditions=_read_table(file["conditions"]),
            encoder=json.loads(file.attrs["encoder"]),
            source=str(file.attrs["source"]),
        )
        _check_events(trains, path)
        return trains

    return _load(path, "spikes", "encode", read)


def _load(path: str | Path, kind: str, command: str, read: Callable[[h5py.File], Loaded]) -> Loaded:
    try:
        with h5py.File(existing(path), "r") as file:
            found = file.attrs.get("kind", "")
            if found != kind:
                raise InputError(
                    f"{path}: holds {found or 'something else'}, not {kind}; make one with neurotact {command}"
                )
            return read(file)
    except InputError:
        raise
    except (OSError, LookupError, ValueError, TypeError, RuntimeError, AttributeError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0].strip("'\"")
        raise InputError(
            f"{path}: cannot be read as {kind} ({reason}); write it again with neurotact {command}"
        ) from error


def _array(file: h5py.File, name: str) -> np.ndarray:
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise KeyError(f"{name} is not a dataset")
    return dataset[()]


def _write_events(file: h5py.File, name: str, events: list[np.ndarray] | Any, kind: type) -> None:
    boxed = np.empty(len(events), dtype=object)
    for i, values in enumerate(events):
        boxed[i] = np.asarray(values, kind)
    file.create_dataset(name, data=boxed, dtype=h5py.vlen_dtype(kind))


def _write_table(group: h5py.Group, table: pd.DataFrame) -> None:
    group.attrs["columns"] = json.dumps([str(c) for c in table.columns])
    for column in table.columns:
        if str(column) in ("", ".") or "/" in str(column) or "\0" in str(column):
            raise InputError(f"condition {str(column)!r}: HDF5 cannot name a condition so; rename the column")
        values = table[column].to_numpy()
        is_number = np.issubdtype(values.dtype, np.number) or values.dtype == bool
        if is_number:
            group.create_dataset(str(column), data=values)
        else:
            group.create_dataset(str(column), data=values.astype(str).astype(object), dtype=h5py.string_dtype())


def _read_table(group: Any) -> pd.DataFrame:
    columns = {}
    for column in json.loads(group.attrs["columns"]):
        dataset = group[column]
        columns[column] = dataset.asstr()[()] if h5py.check_string_dtype(dataset.dtype) else dataset[()]
    return pd.DataFrame(columns)


def _check_events(trains: SpikeTrains, path: str | Path) -> None:
    if not len(trains.steps) == len(trains.units) == len(trains.trial_steps) == len(trains.conditions):
        raise InputError(f"{path}: spikes, trial_steps and conditions differ in number of trials; write it again")
    if LABEL not in trains.conditions:
        raise InputError(f"{path}: the table of conditions has no column 'label'; add one class name a trial")
    for trial, (steps, units) in enumerate(zip(trains.steps, trains.units, strict=True)):
        in_order = (np.diff(steps) >= 0).all()
        in_time = len(steps) == 0 or (steps[0] >= 0 and steps[-1] < trains.trial_steps[trial])
        known = len(units) == len(steps) and ((units >= 0) & (units < len(trains.afferents))).all()
        if not (in_order and in_time and known):
            raise InputError(
                f"{path}: trial {trial} has spikes out of order, or outside its time or its afferents; write it again"
            )
