"""The firing of the populations in windows and over a whole touch, for each class and condition: encoding.csv."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows
from neurotact.errors import InputError
from neurotact.metrics import spike_trains
from neurotact.studies.study import Cell
from neurotact.tables import read_table

TOUCH = "touch_"
"""Prefix of the columns of `encoding.csv` that describe the whole touch; the others describe windows."""


def encoding_table(trains: SpikeTrains, cell: Cell, by: Iterable[str]) -> pd.DataFrame:
    """Firing of both populations for each class and condition, in the windows that the cell's network classifies.

    Columns: the t_ref pair, label, the conditions in `by`, stretch (the counted time, in words), spikes_sa_per_s and
    spikes_ra_per_s (the whole population), spikes_total_per_s, sa_share (of all spikes), isi_sa_ms and isi_ra_ms (means
    of the intervals within a window). The same columns with the prefix `touch_` count from the window's start to the
    trial's end, as the texture paper's Figs. 6 and 10 do; there, intervals may be longer than a window.

    A cell without a network classifies no windows: its plain columns describe the touch, and it has no other columns.
    In a study that sweeps its windows, the table describes the cell's own windows, as `stretch` says.
    """
    columns = [LABEL, *by]
    touch = touch_spikes(trains, cell.window.start_ms)
    whole = np.arange(len(trains))
    if cell.network is None:
        stretch = f"from {cell.window.start_ms:g} ms to the trial's end"
        table = firing_of(trains, touch, whole, columns)
    else:
        windows = trains.cut(cell.window)
        stretch = f"windows of {cell.window.length_ms:g} ms from {cell.window.start_ms:g} ms on"
        of_touch = firing_of(trains, touch, whole, columns).drop(columns=columns).add_prefix(TOUCH)
        table = firing_of(trains, windowed_spikes(trains, windows), windows.trial, columns).join(of_touch)
    table.insert(len(columns), "stretch", stretch)
    table.insert(0, "t_ref_ra_ms", cell.encoder.ra1.t_ref_ms)
    table.insert(1, "t_ref_sa_ms", cell.encoder.sa1.t_ref_ms)
    return table


def read_encoding(path: Path) -> pd.DataFrame:
    """The encoding table; a class may be called "None", and an interval or a share may be missing."""
    measures = ("isi_sa_ms", "isi_ra_ms", "sa_share")
    missing = {f"{stretch}{name}": [""] for stretch in ("", TOUCH) for name in measures}
    return read_table(path, dtype={"label": str}, keep_default_na=False, na_values=missing)


def firing_of(
    trains: SpikeTrains, events: spike_trains.Events, trial_of: np.ndarray, columns: Sequence[str]
) -> pd.DataFrame:
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
            row[f"spikes_{kind}_per_s"] = rates[chosen][:, is_kind].sum(axis=1).mean()
            these = isis.isi_ms[chosen[isis.trial] & is_kind[isis.afferent]]
            row[f"isi_{kind}_ms"] = these.mean() if len(these) else float("nan")
        total = row["spikes_total_per_s"] = row["spikes_sa_per_s"] + row["spikes_ra_per_s"]
        row["sa_share"] = row["spikes_sa_per_s"] / total if total else float("nan")
        rows.append(row)
    return pd.DataFrame(rows)


def windowed_spikes(trains: SpikeTrains, windows: Windows) -> spike_trains.Events:
    """The spikes of each window, counted from its start: each window is a trial of the result."""
    steps, units = [], []
    for trial, start in zip(windows.trial.tolist(), windows.start.tolist(), strict=True):
        inside = (trains.steps[trial] >= start) & (trains.steps[trial] < start + windows.n_steps)
        steps.append(trains.steps[trial][inside] - start)
        units.append(trains.units[trial][inside])
    return spike_trains.events(steps, units, np.full(len(windows), windows.n_steps), len(trains.afferents))


def touch_spikes(trains: SpikeTrains, start_ms: float) -> spike_trains.Events:
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
