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
from neurotact.data.readers.clock.stamps import UNIT_S
from neurotact.data.readers.events.spikes import (
    EventSpec,
    channel_names,
    check_range,
    n_steps_of,
    on_clock,
    say_lost,
    say_order,
    say_times,
)
from neurotact.data.readers.events.times import (
    MOST_COMPARED,
    EventTimes,
    InOrder,
    event_times,
    in_order,
    joined_times,
    rounding_of,
    steps_of,
)
from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains, from_trials
from neurotact.errors import InputError

NO_EVENTS = EventTimes(np.zeros(0), np.zeros(0))


def load(path: str | Path, spec: EventSpec) -> SpikeTrains:
    """Spikes of a file on a clock of `spec.step_ms`; InputError if it is damaged, too large or not in the layout."""
    with opened(path, EVENTS) as (file, _):
        return read(Declared(file, path), spec)


def read(declared: Declared, spec: EventSpec) -> SpikeTrains:
    """The spikes of an open file on a clock of `spec.step_ms`.

    Rows are read as they are stored and binned trial by trial, since such files hold many millions of spikes.
    """
    path = declared.path
    _check_options(spec, path)
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
    ordered = [_in_order(row, unit, spec) for row, unit in zip(rows, units, strict=True)]
    n_events = sum(map(len, rows))
    say_order(sum(trial.n_back for trial in ordered), sum(trial.n_wraps for trial in ordered), n_events, str(path))
    some, ends = [NO_EVENTS], [NO_EVENTS]
    every = max(1, n_events // MOST_COMPARED)
    for trial in filled:
        times = _times_of(ordered[trial], spec)
        some.append(times.at(np.arange(trial % every, len(times.time_s), every)))
        ends.append(times.at(np.array([times.time_s.argmin(), times.time_s.argmax()])))
    of_ends = joined_times(ends)
    check_range(float(of_ends.time_s.min(initial=0.0)), float(of_ends.time_s.max(initial=0.0)), spec, str(path))
    step_s = 1e-3 * spec.step_ms
    rounding = rounding_of(joined_times(some), step_s)
    steps = [steps_of(_times_of(trial, spec), step_s, rounding) for trial in ordered]
    n_steps = n_steps_of(max(int(row.max(initial=0)) for row in steps), spec)
    binned = on_clock(((row, unit, n_steps) for row, unit in zip(steps, units, strict=True)), len(afferents))
    say_lost(binned, spec, str(path))
    say_times(joined_times(some), n_steps, spec, str(path))
    return from_trials(binned.trials, 1e3 / spec.step_ms, afferents, conditions, source=str(path))


def _check_options(spec: EventSpec, path: str | Path) -> None:
    """Refuse what such a file has no use for."""
    given = {"polarity": spec.polarity != "separate", "polarities": spec.polarities, "sensor": spec.sensor}
    wrong = next((name for name, value in given.items() if value), None)
    if wrong is not None:
        raise InputError(f"{path}: the Heidelberg layout has units, neither polarities nor a grid; drop `{wrong}`")


def _in_order(row: np.ndarray, units: np.ndarray, spec: EventSpec) -> InOrder:
    return in_order(row, np.zeros(len(row), np.int64), [units], may_wrap=spec.time_unit != "ns")


def _times_of(row: InOrder, spec: EventSpec) -> EventTimes:
    return event_times(row.stamps, UNIT_S[spec.time_unit or "s"], spec.origin)


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
