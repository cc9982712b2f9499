"""HDF5 files in the layout of the Spiking Heidelberg Digits, as they are published (Cramer et al. 2022).

`spikes/times` and `spikes/units`: one row of variable length per trial, in s. `labels`: the class of each, an index
into `extra/keys` if the file has it. Other datasets of one value per trial in `extra` are conditions, such as `speaker`
(doi 10.1109/TNNLS.2020.3044364).
"""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from neurotact.data.hdf5_input import EVENTS, Declared, opened
from neurotact.data.readers.events import EventSpec, channel_names, clock_of, one_trial
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains, from_trials
from neurotact.errors import InputError


def load(path: str | Path, spec: EventSpec) -> SpikeTrains:
    """Spikes of a file on a clock of `spec.step_ms`; InputError if it is damaged, too large or not in the layout."""
    with opened(path, EVENTS) as (file, _):
        return read(Declared(file, path), spec)


def read(declared: Declared, spec: EventSpec) -> SpikeTrains:
    """The spikes of an open file on a clock of `spec.step_ms`.

    Rows are read as they are stored and binned trial by trial, since such files hold many millions of spikes.
    """
    path = declared.path
    times, units = declared.rows("spikes/times", "f"), declared.rows("spikes/units", "iu")
    labels = declared.numbers("labels", "iu")
    if len(times) != len(units) or any(len(a) != len(b) for a, b in zip(times, units, strict=False)):
        raise InputError(f"{path}: spikes/times and spikes/units differ in length; copy the file again")
    if len(labels) != len(times) or not len(times):
        raise InputError(f"{path}: has {len(labels)} labels for {len(times)} trials; copy the file again")
    conditions = _conditions(declared, declared.file, labels, path)
    filled = [trial for trial, row in enumerate(times) if len(row)]
    for trial in filled:
        if not np.isfinite(times[trial]).all() or units[trial].min() < 0:
            raise InputError(f"{path}: trial {trial} has a time that is no number, or a negative unit; drop the trial")
    if spec.origin == "first":
        times = [row.astype(float) - (float(row.min()) if len(row) else 0.0) for row in times]
    afferents = channel_names(max((int(units[trial].max()) + 1 for trial in filled), default=1), spec, str(path))
    ends_s = [(float(times[trial].min()), float(times[trial].max())) for trial in filled] or [(0.0, 0.0)]
    n_steps = clock_of(min(first for first, _ in ends_s), max(last for _, last in ends_s), spec, str(path))
    trials = (
        one_trial(row.astype(float), unit, spec.step_ms, n_steps, len(afferents))
        for row, unit in zip(times, units, strict=True)
    )
    return from_trials(trials, 1e3 / spec.step_ms, afferents, conditions, source=str(path))


def _conditions(declared: Declared, file: h5py.File, labels: np.ndarray, path: str | Path) -> pd.DataFrame:
    extra = declared.group("extra") if "extra" in file else {}
    if "keys" in extra:
        keys = declared.texts("extra/keys")
        if len(labels) and not (labels.min() >= 0 and labels.max() < len(keys)):
            raise InputError(f"{path}: labels must be 0 to {len(keys) - 1}, as extra/keys names {len(keys)} classes")
        names = [keys[label] for label in labels.tolist()]
    else:
        names = [str(label) for label in labels.tolist()]
    table = pd.DataFrame({LABEL: names})
    for name in extra:
        place = f"extra/{name}"
        if name != "keys" and isinstance(file[place], h5py.Dataset) and file[place].shape == labels.shape:
            table[str(name)] = declared.column(place, len(labels))
    return table
