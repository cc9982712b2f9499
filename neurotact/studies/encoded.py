"""The firing of the afferents: encoding.csv of every study, and the cells of a study without networks.

In such cells, the texture paper (Sec. III-A) compares scaling coefficients of the afferents' currents: by rates,
intervals, overlap of the intervals of different gratings, silent share, and latency of the first spike.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.sensitivity import pair_of
from neurotact.encoders.specs import populations, t_ref_pair_ms
from neurotact.files import scratch, write_json
from neurotact.metrics import firing, isi_distributions
from neurotact.studies.study import Cell
from neurotact.tables import read_table, write_table

TOUCH = "touch_"
"""Prefix of the columns of `encoding.csv` that describe the whole touch; the others describe windows."""
ISI = "isi.csv"
POPULATIONS = (("SA-I", "sa", "sa1"), ("RA-I", "ra", "ra1"))
"""Each population: its name, its name in columns, and its name in the encoder's spec."""


def periods(cell: Cell) -> dict[str, float]:
    """The columns of the refractory periods of a cell's encoder."""
    first_ms, second_ms = t_ref_pair_ms(cell.encoder)
    return {"t_ref_ra_ms": second_ms, "t_ref_sa_ms": first_ms}


def run(cell: Cell, trains: SpikeTrains) -> dict[str, bytes]:
    """The files of a cell without a network: `result.json` with its row, `isi.csv`, `timing.json`."""
    began = perf_counter()
    chosen = trains.select(select_conditions(trains.conditions, cell.subset))
    touches = firing.touch_spikes(chosen, cell.window.start_ms)
    row: dict[str, Any] = {
        "dataset": cell.dataset,
        **periods(cell),
        "seed": cell.seed,
    }
    parts = []
    names = [population.name for population in populations(cell.encoder)]
    pairs = zip((names[0], " and ".join(names[1:])), pair_of(cell.encoder), t_ref_pair_ms(cell.encoder), strict=True)
    for (_, kind, _), (name, gain, t_ref_ms) in zip(POPULATIONS, pairs, strict=True):
        is_kind = chosen.is_sa if kind == "sa" else ~chosen.is_sa
        row |= {
            f"{what}_{kind}{unit}": value for (what, unit), value in firing.measures(touches, is_kind, chosen).items()
        }
        counts, edges_ms = firing.isi_histograms(touches, is_kind, chosen)
        common = isi_distributions.overlap(counts)
        row[f"isi_overlap_{kind}"] = None if np.isnan(common) else common
        table = firing.as_table(counts, edges_ms, chosen.classes)
        table.insert(0, "population", name)
        table.insert(1, "gain", gain)
        table.insert(2, "t_ref_ms", t_ref_ms)
        parts.append(table)
    with scratch() as target:
        write_table(pd.concat(parts, ignore_index=True), target / ISI)
        write_json(target / "result.json", {"row": row})
        write_json(target / "timing.json", {"seconds": perf_counter() - began})
        return {path.name: path.read_bytes() for path in target.iterdir()}


def isi_table(folders: Sequence[Path], rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """The distributions of all cells; before their columns, the data set and the swept keys of `results.csv`.

    folders: those of the cells, one for each row. Their tables already contain gains and refractory periods.
    """
    own = [key for key in keys if not key.endswith((".gain", ".t_ref_ms"))]
    parts = []
    for cell_path, (_, row) in zip(folders, rows.iterrows(), strict=True):
        table = read_isi(cell_path / ISI)
        for key in reversed(["dataset", *own]):
            table.insert(0, key, row[key])
        parts.append(table)
    return pd.concat(parts, ignore_index=True).drop_duplicates(ignore_index=True)


def read_isi(path: Path) -> pd.DataFrame:
    """An `isi.csv`; a class may be called "None"."""
    return read_table(path, dtype={"label": str}, keep_default_na=False)


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
    touch = firing.touch_spikes(trains, cell.window.start_ms)
    whole = np.arange(len(trains))
    if cell.network is None:
        stretch = f"from {cell.window.start_ms:g} ms to the trial's end"
        table = firing.firing_of(trains, touch, whole, columns)
    else:
        windows = trains.cut(cell.window)
        stretch = f"windows of {cell.window.length_ms:g} ms from {cell.window.start_ms:g} ms on"
        table = firing.firing_of(trains, firing.windowed_spikes(trains, windows), windows.trial, columns)
        if cell.encoded_ms is None:
            of_touch = firing.firing_of(trains, touch, whole, columns).drop(columns=columns).add_prefix(TOUCH)
            table = table.join(of_touch)
    table.insert(len(columns), "stretch", stretch)
    for column_index, (column, t_ref_ms) in enumerate(periods(cell).items()):
        table.insert(column_index, column, t_ref_ms)
    return table


def read_encoding(path: Path) -> pd.DataFrame:
    """The encoding table; a class may be called "None", and an interval or a share may be missing."""
    measures = ("isi_sa_ms", "isi_ra_ms", "sa_share")
    missing = {f"{stretch}{name}": [""] for stretch in ("", TOUCH) for name in measures}
    return read_table(path, dtype={"label": str}, keep_default_na=False, na_values=missing)
