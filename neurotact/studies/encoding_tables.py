"""The firing of the afferents under each condition: encoding.csv of a study."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.specs import t_ref_pair_ms
from neurotact.metrics import firing
from neurotact.studies.study import Cell
from neurotact.tables import read_table

TOUCH = "touch_"
"""Prefix of the columns of `encoding.csv` that describe the whole touch; the others describe windows."""


def periods(cell: Cell) -> dict[str, float]:
    """The columns of the refractory periods of a cell's encoder."""
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    return {"t_ref_ra_ms": second_ms, "t_ref_sa_ms": first_ms}


def encoding_table(trains: SpikeTrains, cell: Cell, by: Iterable[str]) -> pd.DataFrame:
    """Firing of both populations for each class and condition, in the windows that the cell's network classifies.

    Columns: the t_ref pair, label, the conditions in `by`, stretch (the counted time, in words), spikes_sa_per_s and
    spikes_ra_per_s (the whole population), spikes_total_per_s, sa_share (of all spikes), isi_sa_ms and isi_ra_ms (means
    of the intervals within a window). The same columns with the prefix `touch_` count from the window's start to the
    trial's end, as the texture paper's Figs. 6 and 10 do; there, intervals may be longer than a window.

    A cell without a network classifies no windows: its plain columns describe the touch, and it has no other columns.
    A cell that encodes no more than its windows has no columns of the touch.
    In a study that sweeps its windows, the table describes the cell's own windows, as `stretch` says.
    """
    columns = [LABEL, *by]
    window, onsets = cell.window, trains.begins(cell.window, np.arange(len(trains)))
    of_touch = trains if onsets is None else _from(trains, onsets)
    # A trial that ends before its window would begin is left out, as `cut` leaves it out.
    begun = np.flatnonzero(of_touch.trial_steps > round(window.start_ms * 1e-3 * trains.sampling_rate_Hz))
    felt = of_touch.select(begun) if len(begun) else of_touch
    touch, whole = firing.touch_spikes(felt, window.start_ms), np.arange(len(felt))
    start = f"{window.start_ms:g} ms{'' if onsets is None else ' after the onset of contact'}"
    if cell.network is None:
        stretch = f"from {start} to the trial's end"
        table = firing.firing_of(felt, touch, whole, columns)
    else:
        windows = trains.cut(window)
        stretch = f"windows of {window.length_ms:g} ms from {start} on"
        table = firing.firing_of(trains, firing.windowed_spikes(trains, windows), windows.trial, columns)
        if cell.encoded_ms is None:
            beside = firing.firing_of(felt, touch, whole, columns).set_index(columns).add_prefix(TOUCH)
            table = table.join(beside, on=columns)
    table.insert(len(columns), "stretch", stretch)
    for column_index, (column, t_ref_ms) in enumerate(periods(cell).items()):
        table.insert(column_index, column, t_ref_ms)
    return table


def _from(trains: SpikeTrains, first: np.ndarray) -> SpikeTrains:
    """The trials from a step of each on, `(trial,)`."""
    kept = [np.searchsorted(steps, own) for steps, own in zip(trains.steps, first.tolist(), strict=True)]
    return replace(
        trains,
        steps=[steps[n:] - own for steps, n, own in zip(trains.steps, kept, first.tolist(), strict=True)],
        units=[units[n:] for units, n in zip(trains.units, kept, strict=True)],
        trial_steps=trains.trial_steps - first,
    )


def read_encoding(path: Path) -> pd.DataFrame:
    """The encoding table; a class may be called "None", and an interval or a share may be missing."""
    measures = ("isi_sa_ms", "isi_ra_ms", "sa_share")
    missing = {f"{stretch}{name}": [""] for stretch in ("", TOUCH) for name in measures}
    return read_table(path, dtype={"label": str}, keep_default_na=False, na_values=missing)
