"""A cell without a network: the firing of its afferents, and the distributions of their inter-spike intervals.

The texture paper (Sec. III-A) compares scaling coefficients of the afferents' currents by these measures: rates,
intervals, overlap of the intervals of different gratings, silent share, and latency of the first spike.
"""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.files import scratch, write_json
from neurotact.metrics import isi_distributions, spike_trains
from neurotact.metrics.spike_trains import Events
from neurotact.studies.firing import touch_spikes
from neurotact.studies.study import Cell
from neurotact.tables import read_table, write_table

ISI = "isi.csv"
POPULATIONS = (("SA-I", "sa", "sa1"), ("RA-I", "ra", "ra1"))
"""Each population: its name, its name in columns, and its name in the encoder's spec."""


def run(cell: Cell, trains: SpikeTrains) -> dict[str, bytes]:
    """The files of a cell without a network: `result.json` with its row, `isi.csv`, `timing.json`."""
    began = perf_counter()
    chosen = trains.select(select_conditions(trains.conditions, cell.subset))
    touches = touch_spikes(chosen, cell.window.start_ms)
    row: dict[str, Any] = {
        "dataset": cell.dataset,
        "t_ref_ra_ms": cell.encoder.ra1.t_ref_ms,
        "t_ref_sa_ms": cell.encoder.sa1.t_ref_ms,
        "seed": cell.seed,
    }
    parts = []
    for name, kind, part in POPULATIONS:
        is_kind = chosen.is_sa if kind == "sa" else ~chosen.is_sa
        row |= {f"{what}_{kind}{unit}": value for (what, unit), value in measures(touches, is_kind, chosen).items()}
        counts, edges_ms = _histograms(touches, is_kind, chosen)
        common = isi_distributions.overlap(counts)
        row[f"isi_overlap_{kind}"] = None if np.isnan(common) else common
        own = getattr(cell.encoder, part)
        table = _as_table(counts, edges_ms, chosen.classes)
        table.insert(0, "population", name)
        table.insert(1, "gain", own.gain)
        table.insert(2, "t_ref_ms", own.t_ref_ms)
        parts.append(table)
    with scratch() as place:
        write_table(pd.concat(parts, ignore_index=True), place / ISI)
        write_json(place / "result.json", {"row": row})
        write_json(place / "timing.json", {"seconds": perf_counter() - began})
        return {path.name: path.read_bytes() for path in place.iterdir()}


def measures(felt: Events, is_kind: np.ndarray, trains: SpikeTrains) -> dict[tuple[str, str], float | None]:
    """Measures of one population, means over trials, by name and unit; None if there is nothing to average.

    spikes (per second, of the whole population), isi (mean of all intervals), isi_sd, isi_least, silent_share (of
    trials without any spike), latency (of the population's first spike; of a silent trial, its whole length).
    """
    rate_Hz = trains.sampling_rate_Hz
    found = spike_trains.isis_ms(felt, rate_Hz)
    isi_ms = found.isi_ms[is_kind[found.afferent]]
    first_ms = spike_trains.latencies_ms(felt, rate_Hz)[:, is_kind]
    is_silent = np.isnan(first_ms).all(axis=1)
    until_ms = 1e3 * felt.trial_steps / rate_Hz
    latency_ms = np.where(is_silent, until_ms, np.where(np.isnan(first_ms), np.inf, first_ms).min(axis=1))
    return {
        ("spikes", "_per_s"): float(spike_trains.rates_Hz(felt, rate_Hz)[:, is_kind].sum(axis=1).mean()),
        ("isi", "_ms"): float(isi_ms.mean()) if len(isi_ms) else None,
        ("isi_sd", "_ms"): float(isi_ms.std()) if len(isi_ms) else None,
        ("isi_least", "_ms"): float(isi_ms.min()) if len(isi_ms) else None,
        ("silent_share", ""): float(is_silent.mean()),
        ("latency", "_ms"): float(latency_ms.mean()),
    }


def _histograms(touches: Events, is_kind: np.ndarray, trains: SpikeTrains) -> tuple[np.ndarray, np.ndarray]:
    """The intervals of one population, `(class, bin)`, and the bins' edges in ms.

    The bins are the same for every encoder of these trials: from one step to the longest trial.
    """
    rate_Hz = trains.sampling_rate_Hz
    edges_ms = (1e3 / rate_Hz) * isi_distributions.bin_edges(1, int(touches.trial_steps.max()))
    found = spike_trains.isis_ms(touches, rate_Hz)
    mine = is_kind[found.afferent]
    labels = trains.labels[found.trial[mine]]
    return isi_distributions.histograms(found.isi_ms[mine], labels, len(trains.classes), edges_ms), edges_ms


def _as_table(counts: np.ndarray, edges_ms: np.ndarray, classes: Sequence[str]) -> pd.DataFrame:
    """One row per class and non-empty bin: the number of intervals, and their share of all intervals of the class."""
    label, at = np.nonzero(counts)
    n = counts[label, at]
    columns = {"label": np.array(classes)[label], "isi_from_ms": edges_ms[at], "isi_to_ms": edges_ms[at + 1], "n": n}
    return pd.DataFrame({**columns, "share": n / counts.sum(axis=1)[label]})


def isi_table(folders: Sequence[Path], rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """The distributions of all cells; before their columns, the data set and the swept keys of `results.csv`.

    folders: those of the cells, one for each row. Their tables already contain gains and refractory periods.
    """
    own = [key for key in keys if not key.endswith((".gain", ".t_ref_ms"))]
    parts = []
    for place, (_, row) in zip(folders, rows.iterrows(), strict=True):
        table = read_isi(place / ISI)
        for key in reversed(["dataset", *own]):
            table.insert(0, key, row[key])
        parts.append(table)
    return pd.concat(parts, ignore_index=True).drop_duplicates(ignore_index=True)


def read_isi(path: Path) -> pd.DataFrame:
    """An `isi.csv`; a class may be called "None"."""
    return read_table(path, dtype={"label": str}, keep_default_na=False)
