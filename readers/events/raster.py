"""Rasters to spikes: dense arrays of 0 and 1, or of counts, of the trials of one file, or of a file per trial."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from neurotact_parts.readers import arrays, folder
from neurotact_parts.readers.clock.stamps import OF_GIVEN_RATE, of_rate
from neurotact_parts.readers.events.spikes import MOST_AFFERENTS, OnClock, say_merged

from neurotact.data.recordings import check_channels, check_conditions, check_import
from neurotact.data.spikes import SpikeTrains, from_trials, spikes_of
from neurotact.errors import InputError
from neurotact.files import existing

log = logging.getLogger("neurotact")

UNIT = "spikes"


def read(
    path: str | Path,
    sampling_rate_Hz: float | None = None,
    *,
    names: Mapping[str, str] | None = None,
    axes: str | None = None,
    conditions: str | Path | None = None,
    naming: Mapping[str, Any] | None = None,
    layout: Mapping[str, Any] | None = None,
    merge_events: bool = False,
) -> SpikeTrains:
    """The spikes of rasters in one file or in a folder, as of `api.read_raster`.

    Afferents are named `channel0`, `channel1`, ... if the file has no names. Raises InputError for what is no raster,
    and as `arrays.read` and `folder.read`.
    """
    check_import(sampling_rate_Hz, UNIT, str(path))
    naming, layout = ({key: value for key, value in (given or {}).items() if value} for given in (naming, layout))
    if existing(path, "file or folder").is_dir():
        if names or axes:
            raise InputError(f"{path}: `names` and `axes` are for one file with all trials; leave them out")
        table = {} if conditions is None else {"table": str(conditions)}
        frames = folder.read(path, sampling_rate_Hz, UNIT, naming=naming | table, layout=layout, is_raster=True)
        named = () if frames.channels[0] == "taxel1" else frames.channels
        held = arrays.Loaded(frames.signals, frames.conditions, named, frames.sampling_rate_Hz, {})
    elif naming or layout:
        raise InputError(f"{path}: `{next(iter(naming | layout))}` is for a folder with a file per trial; leave it out")
    else:
        held = arrays.load(path, sampling_rate_Hz, names, axes, conditions)
    return _trains_of(held, str(path), merge_events=merge_events)


def _trains_of(held: arrays.Loaded, where: str, *, merge_events: bool) -> SpikeTrains:
    """The spikes of one `(time, afferent)` raster per trial; a count of several in a step is one spike, and is said.

    Raises InputError for values that are no counts, and if more than 1 % would be lost, unless `merge_events`.
    """
    rasters, conditions, afferents, rate_Hz, _ = held
    n_afferents = rasters[0].shape[1]
    if n_afferents > MOST_AFFERENTS:
        raise InputError(f"{where}: has {n_afferents} afferents, more than {MOST_AFFERENTS}; use fewer")
    afferents = tuple(afferents) or tuple(f"channel{number}" for number in range(n_afferents))
    check_channels(afferents, where)
    check_conditions(conditions, where)
    n_events = sum(_n_spikes(raster, trial, where) for trial, raster in enumerate(rasters))
    binned = OnClock([spikes_of(raster) for raster in rasters], n_events, 0)
    if n_events == 0:
        raise InputError(f"{where}: holds no spike; give at least one")
    say_merged(binned, 1 / rate_Hz, where, accept=merge_events, step="step")
    for doubt in of_rate(np.array([len(raster) for raster in rasters]), rate_Hz, OF_GIVEN_RATE):
        log.warning("%s: %s", where, doubt)
    return from_trials(binned.trials, rate_Hz, afferents, conditions, source=where)


def _n_spikes(raster: np.ndarray, trial: int, where: str) -> int:
    """The number of spikes in a raster; InputError for values that are no counts."""
    if raster.dtype.kind == "f":
        wrong = np.argwhere(~(np.isfinite(raster) & (raster == np.floor(raster)) & (raster >= 0)))
    else:
        wrong = np.argwhere(raster < 0)
    if len(wrong):
        step, afferent = wrong[0].tolist()
        raise InputError(
            f"{where}: trial {trial}, step {step}, afferent {afferent} is {raster[step, afferent]:g}, which is no "
            "count of spikes; give 0 and 1, or read signals with neurotact import arrays"
        )
    return int(raster.sum(dtype=np.float64 if raster.dtype.kind == "f" else np.int64))
