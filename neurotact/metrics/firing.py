"""Rates and inter-spike intervals of the SA-I and RA-I populations, in windows or over a whole touch."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows
from neurotact.errors import InputError
from neurotact.metrics import spike_trains
from neurotact.metrics.spike_trains import Events


def firing_of(trains: SpikeTrains, events: Events, trial_of: np.ndarray, columns: Sequence[str]) -> pd.DataFrame:
    """Rates and mean intervals of both populations, a row per combination of `columns` in the order of the trials.

    events: spikes of parts of trials; trial_of: the trial of each part, `(part,)`.
    """
    rates = spike_trains.rates_Hz(events, trains.sampling_rate_Hz)
    isis = spike_trains.isis_ms(events, trains.sampling_rate_Hz)
    rows = []
    for _, group in trains.conditions.groupby(list(columns), sort=False):
        chosen = np.isin(trial_of, group.index.to_numpy())
        row: dict[str, Any] = group.iloc[0][list(columns)].to_dict()
        for kind, is_kind in (("sa", trains.is_sa), ("ra", ~trains.is_sa)):
            spikes = rates[chosen][:, is_kind].sum(axis=1)
            row[f"spikes_{kind}_per_s"] = spikes.mean() if len(spikes) else float("nan")
            these = isis.isi_ms[chosen[isis.trial] & is_kind[isis.afferent]]
            row[f"isi_{kind}_ms"] = these.mean() if len(these) else float("nan")
        total = row["spikes_total_per_s"] = row["spikes_sa_per_s"] + row["spikes_ra_per_s"]
        row["sa_share"] = row["spikes_sa_per_s"] / total if total else float("nan")
        rows.append(row)
    return pd.DataFrame(rows)


def windowed_spikes(trains: SpikeTrains, windows: Windows) -> Events:
    """The spikes of each window, counted from its start: each window is a trial of the result."""
    steps, units = [], []
    for trial, start in zip(windows.trial.tolist(), windows.start.tolist(), strict=True):
        inside = (trains.steps[trial] >= start) & (trains.steps[trial] < start + windows.n_steps)
        steps.append(trains.steps[trial][inside] - start)
        units.append(trains.units[trial][inside])
    return spike_trains.events(steps, units, np.full(len(windows), windows.n_steps), len(trains.afferents))


def touch_spikes(trains: SpikeTrains, start_ms: float) -> Events:
    """The spikes from `start_ms` to the end of each trial; InputError for a trial that is shorter."""
    rate_Hz = trains.sampling_rate_Hz
    start = round(start_ms * 1e-3 * rate_Hz)
    if start >= trains.trial_steps.min():
        raise InputError(
            f"window.start_ms: {start_ms:g} ms is past the end of trial {trains.trial_steps.argmin()}, "
            f"which lasts {trains.trial_steps.min() / rate_Hz:.3f} s; lower it"
        )
    return spike_trains.events(
        [steps[steps >= start] - start for steps in trains.steps],
        [units[steps >= start] for steps, units in zip(trains.steps, trains.units, strict=True)],
        trains.trial_steps - start,
        len(trains.afferents),
    )
