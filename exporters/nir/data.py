"""Spikes as NIR's data (`nir.data_ir`): what the node `input` of a graph receives."""

from typing import Any

import numpy as np
import pandas as pd
from neurotact_parts.exporters.nir.nodes import nir

from neurotact.data.recordings import check_sampling_rate
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError

NODE, OBSERVABLE = "input", "spikes"
SLACK = 1e-6
"""Share of a step by which rounding may put an event before its step."""


def to_nir_data(spikes: SpikeTrains) -> Any:
    """The spikes of all trials as `nir.NIRGraphData`: boolean `TimeGriddedData` of the node `input`.

    `nir.write_data(path, data)` writes it. Labels, names and the encoder have no place there.
    Raises InputError for trials of different lengths, which it cannot hold.

    >>> raster = np.zeros((1, 4, 2), np.uint8)
    >>> raster[0, 3, 1] = 1
    >>> trains = from_rasters(raster, 2000.0, ("a", "b"), pd.DataFrame({"label": ["felt"]}))
    >>> to_nir_data(trains).nodes["input"].observables["spikes"].data.sum()
    np.int64(1)
    """
    package, lengths = nir(), np.unique(spikes.trial_steps)
    if len(lengths) != 1:
        raise InputError(f"spikes: trials of {lengths.min()} to {lengths.max()} steps; NIR's data have one length")
    data = np.zeros((len(spikes), int(lengths[0]), len(spikes.afferents)), bool)
    for trial, (steps, units) in enumerate(zip(spikes.steps, spikes.units, strict=True)):
        data[trial, steps, units] = True
    gridded = package.TimeGriddedData(data, 1.0 / spikes.sampling_rate_Hz)
    return package.NIRGraphData({NODE: package.NIRNodeData({OBSERVABLE: gridded})})


def from_nir_data(
    data: Any, labels: Any = None, *, sampling_rate_Hz: float | None = None, node: str = NODE
) -> SpikeTrains:
    """The spikes in NIR's data, one trial a sample.

    data: `nir.NIRGraphData` of one of whose nodes, `node`, the observable `spikes` is taken, or `nir.TimeGriddedData`
    or `nir.EventData` itself. labels: one of each sample; None: all are `unknown`. sampling_rate_Hz: the clock, which
    events do not have; of gridded data 1 / dt.
    Raises InputError for graded events, for two of a neuron in one step, and for those outside their sample.

    >>> events = nir().EventData(np.array([[1, 0, -1]]), np.array([[0.001, 0.003, np.inf]]), 2, 0.004)
    >>> trains = from_nir_data(events, sampling_rate_Hz=1000.0)
    >>> trains.steps[0].tolist(), trains.units[0].tolist()
    ([1, 3], [1, 0])
    """
    package = nir()
    if isinstance(data, package.NIRGraphData):
        if node not in data.nodes or OBSERVABLE not in getattr(data.nodes[node], "observables", {}):
            raise InputError(f"node: '{node}' has no spikes in these data; there are {', '.join(data.nodes) or 'none'}")
        data = data.nodes[node].observables[OBSERVABLE]
    if isinstance(data, package.TimeGriddedData):
        if sampling_rate_Hz is not None:
            raise InputError("sampling_rate_Hz: gridded data state their own step; leave it out")
        rasters, rate_Hz = np.asarray(data.data), 1.0 / data.dt
        if not np.isin(rasters, (0, 1)).all():
            raise InputError("data: hold values other than 0 and 1, which are no spikes")
    elif isinstance(data, package.EventData) and not isinstance(data, package.ValuedEventData):
        if sampling_rate_Hz is None:
            raise InputError("sampling_rate_Hz: events have no clock; give it")
        check_sampling_rate(sampling_rate_Hz, "from_nir_data")
        rasters, rate_Hz = _rasters(data, sampling_rate_Hz), sampling_rate_Hz
    else:
        raise InputError(f"data: are {type(data).__name__}, not spikes; give nir.TimeGriddedData or nir.EventData")
    given = ["unknown"] * len(rasters) if labels is None else list(labels)
    if len(given) != len(rasters):
        raise InputError(f"labels: {len(given)} for {len(rasters)} samples; give one of each")
    names = tuple(f"neuron {index}" for index in range(rasters.shape[2]))
    return from_rasters(rasters, rate_Hz, names, pd.DataFrame({"label": given}), source="NIR data")


def _rasters(events: Any, rate_Hz: float) -> np.ndarray:
    """Events on a clock, `(sample, time, neuron)`."""
    n_steps = round(events.t_max * rate_Hz)
    rasters = np.zeros((events.n_samples, n_steps, events.n_neurons), bool)
    for sample, (units, times) in enumerate(zip(events.idx, events.time, strict=True)):
        there = units != -1
        steps, units = np.floor(times[there] * rate_Hz + SLACK), units[there]
        if not ((steps >= 0) & (steps < n_steps) & (units >= 0) & (units < events.n_neurons)).all():
            raise InputError(f"data: sample {sample} has an event outside its {events.t_max:g} s or its neurons")
        rasters[sample, steps.astype(np.int64), units] = True
        if rasters[sample].sum() != len(units):
            raise InputError(f"data: sample {sample} has two events of a neuron in one step; give a faster clock")
    return rasters
