"""HDF5 files in the layout of the Spiking Heidelberg Digits, as they are published (Cramer et al. 2022).

`spikes/times` and `spikes/units`: one row of variable length per trial, in s. `labels`: the class of each, an index
into `extra/keys` if the file has it. Other datasets of one value per trial in `extra` are conditions, such as `speaker`
(doi 10.1109/TNNLS.2020.3044364).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from neurotact_parts.readers.events.spikes import EventSpec, TrialEvents, channel_names, trains_of
from neurotact_parts.readers.events.times import event_times, in_order

from neurotact.data.hdf5_input import Declared
from neurotact.data.readers.clock.units import UNIT_S
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


def spikes_in(declared: Declared, spec: EventSpec | Mapping[str, Any]) -> SpikeTrains:
    """The spikes of an open file on a clock of `step_ms`; spec may be keys of `EventSpec`.

    Rows are read as they are stored and binned trial by trial, since such files hold many millions of spikes.
    Raises InputError for a file that is damaged, too large or not in the layout.
    """
    spec = spec if isinstance(spec, EventSpec) else EventSpec(**spec)
    path = declared.path
    given = {"polarity": spec.polarity != "separate", "polarities": spec.polarities, "sensor": spec.sensor}
    wrong = next((name for name, value in given.items() if value), None)
    if wrong is not None:
        raise InputError(f"{path}: the Heidelberg layout has units, neither polarities nor a grid; drop `{wrong}`")
    rows, units = declared.rows("spikes/times", "iuf"), declared.rows("spikes/units", "iu")
    labels = declared.numbers("labels", "iu")
    if len(rows) != len(units) or any(len(a) != len(b) for a, b in zip(rows, units, strict=False)):
        raise InputError(f"{path}: spikes/times and spikes/units differ in length; copy the file again")
    if len(labels) != len(rows) or not len(rows):
        raise InputError(f"{path}: has {len(labels)} labels for {len(rows)} trials; copy the file again")
    conditions = _conditions(declared, declared.file, labels, path)
    filled = [trial for trial, row in enumerate(rows) if len(row)]
    for trial in filled:
        if not np.isfinite(rows[trial]).all() or units[trial].min() < 0:
            raise InputError(f"{path}: trial {trial} has a time that is no number, or a negative unit; drop the trial")
    afferents = channel_names(max((int(units[trial].max()) + 1 for trial in filled), default=1), spec, str(path))
    may_wrap, unit_s = spec.time_unit != "ns", UNIT_S[spec.time_unit or "s"]
    orders = [
        in_order(row, np.zeros(len(row), np.int64), [its], may_wrap=may_wrap)
        for row, its in zip(rows, units, strict=True)
    ]
    trials = [
        TrialEvents(partial(event_times, order.stamps, unit_s, spec.origin), its)
        for order, its in zip(orders, units, strict=True)
    ]
    return trains_of(trials, orders, spec, afferents, conditions, str(path))


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
        dataset = f"extra/{name}"
        if name != "keys" and isinstance(file[dataset], h5py.Dataset) and file[dataset].shape == labels.shape:
            table[str(name)] = declared.column(dataset, len(labels))
    return table
