"""A refractory period of events: events of an afferent within a dead time after its last kept event are dropped."""

from dataclasses import replace

import numpy as np

from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError


def with_dead_time(trains: SpikeTrains, steps: int) -> SpikeTrains:
    """The spikes that remain when each afferent is silent for `steps` steps after each of them.

    So the shortest interval between two spikes of an afferent is `steps` + 1, as for a LIF afferent with a
    refractory period of as many steps; but a LIF afferent also ignores the drive during that time, while here events
    are only dropped. Raises InputError for a negative number.

    >>> import pandas as pd
    >>> from neurotact.data.spikes import from_rasters
    >>> raster = np.ones((1, 6, 1), np.uint8)
    >>> trains = from_rasters(raster, 1000.0, ("ON taxel1",), pd.DataFrame({"label": ["felt"]}))
    >>> with_dead_time(trains, 2).steps[0].tolist()
    [0, 3]
    """
    if steps < 0:
        raise InputError(f"dead time: must be 0 steps or more; got {steps}")
    kept = [_kept(np.asarray(s), np.asarray(units), steps) for s, units in zip(trains.steps, trains.units, strict=True)]
    return replace(
        trains,
        steps=[spikes[keep] for spikes, keep in zip(trains.steps, kept, strict=True)],
        units=[units[keep] for units, keep in zip(trains.units, kept, strict=True)],
    )


def _kept(spike_steps: np.ndarray, units: np.ndarray, steps: int) -> np.ndarray:
    """Which spikes of a trial are kept, `(spike,)` boolean; the spikes are in order of time."""
    keep = np.zeros(len(spike_steps), bool)
    free_from: dict[int, int] = {}
    for index, (step, unit) in enumerate(zip(spike_steps.tolist(), units.tolist(), strict=True)):
        if step >= free_from.get(unit, 0):
            keep[index], free_from[unit] = True, step + steps + 1
    return keep
