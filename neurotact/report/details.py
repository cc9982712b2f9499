"""The details of each cell in a report: training, confusions, one test window, and the cost of decisions.

All are numbers, which the page draws when a cell is selected: pictures would be a hundred times as large.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch

from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows
from neurotact.figures.columns import in_unit
from neurotact.figures.encoding import Classes
from neurotact.networks.definition import clock
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.training.cautions import MEMBER
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.run_folder import LOG, Restored
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import front
from neurotact.report.periods import named
from neurotact.report.tables import (
    LAST_TRAINING,
    LOGGED,
    confusion,
    first_member,
    in_words_of_split,
    is_last_training,
    kept_epoch,
)
from neurotact.studies.store import cell_folder, result_of
from neurotact.studies.study import SPLIT, Cell
from neurotact.tables import LAYERS, in_words_of_size, records, size_of, write_table

MOST_EVENTS = 1_000_000
"""Spikes drawn in one page, distributed evenly over its cells: about four bytes each."""
SOPS_ABOUT = """# Synaptic operations (SOPs) of {title}

One row per trained network; means over its test windows. Each spike is one operation at every neuron that receives it
(texture paper, Eqs. 8 and 9): from afferents to hidden neurons (`sops_input`), among hidden neurons
(`sops_recurrent`), from hidden neurons to the readout (`sops_readout`); `sops_total` is all three,
`sops_total_feedforward` excludes the recurrent ones. `spikes_sa`, `spikes_ra` and the like are the input spikes of a
window by population, `window_steps` its steps. Columns that begin with `exit_` are with early exit, at the patience
chosen on validation trials: only simulated steps count.
"""
SOPS_COLUMNS = (
    "accuracy_test", "window_steps",
    "sops_input", "sops_recurrent", "sops_readout", "sops_total", "sops_total_feedforward",
    "exit_accuracy", "exit_steps",
    "exit_sops_input", "exit_sops_recurrent", "exit_sops_readout", "exit_sops_total", "exit_sops_total_feedforward",
)  # fmt: skip


class _Test(NamedTuple):
    """The common test windows of some cells."""

    examples: Examples
    windows: Windows


def cell_details(folder: Path, done: list[Cell], classes: Classes) -> list[dict[str, Any]]:
    """For each done cell, as JSON: `confusion`, `training` and, if its network is saved, `raster`.

    raster: the spikes of one test window, the same one for all cells that are tested on the same windows.
    """
    details: list[dict[str, Any]] = [{} for _ in done]
    shown: dict[str, tuple[int, int]] = {}
    by_spikes: dict[Path, list[int]] = {}
    for index, cell in enumerate(done):
        by_spikes.setdefault((folder / cell.given), []).append(index)
    for path, indices in by_spikes.items():  # each file is read once, one at a time
        trains = load_spikes(path) if path.is_file() else None
        tests: dict[str, _Test] = {}
        for index in indices:
            kept = cell_folder(folder, done[index])
            matrix = confusion(result_of(folder, done[index]), classes)
            details[index] = {
                "confusion": None if matrix is None else matrix.tolist(),
                "training": _training(folder, done[index]),
            }
            if trains is None or not (kept / run_folder.NETWORK).is_file():
                continue
            restored = run_folder.restore(kept)
            key = restored.task.model_dump_json()
            if key not in tests:
                trials = run_folder.test_trials(restored, trains)
                tests[key] = _Test(*tasks.examples_of(trains, trials, restored.task))
            if len(tests[key].windows):
                if key not in shown:
                    shown[key] = _middle(tests[key])
                details[index]["raster"] = _raster(restored, trains, shown[key], classes, MOST_EVENTS // len(done))
    return details


def cell_name(row: pd.Series) -> str:
    """The name of a cell.

    >>> row = {"setting": "mixed", "pair": "1&10", "hidden": 30, "seed": 2, "split.test_where.force_N": 6.0}
    >>> cell_name(pd.Series(row))
    'mixed, t_ref 1&10 ms, N = 30, seed 2, tested force 6 N'
    """
    keys = [str(key) for key in row.index if str(key).startswith(SPLIT)]
    split = "".join(f", {in_words_of_split(key)} {in_unit(key, row[key])}" for key in keys)
    size = in_words_of_size(row, row.get(OWN_KEYS))
    return f"{row['setting']}, {named(row['pair'])}, {size}, seed {row['seed']}{split}"


def page_data(
    results: pd.DataFrame, costs: pd.DataFrame, details: list[dict[str, Any]], classes: Classes
) -> dict[str, Any]:
    """The data of the page's script.

    results: a run's `results.csv` with the columns `pair` and `setting`, a row for each of `details`.
    costs: of each row's decisions (`front.costs_of`).
    """
    rows = records(results.drop(columns=["pair", "setting"]))
    named = zip(results.iterrows(), rows, records(costs), details, strict=True)
    cells = [
        {"name": cell_name(row), "setting": row["setting"], "pair": row["pair"], "hidden": int(row["hidden"]),
         "layers": row.get(LAYERS, ""), "row": record, **front.decisions_of_row(record, spent), **detail}
        for (_, row), record, spent, detail in named
    ]  # fmt: skip
    return {
        "cells": cells,
        "pairs": list(dict.fromkeys(results["pair"])),
        "sizes": sorted({int(n) for n in results["hidden"]}),
        "architectures": [*dict.fromkeys(results.sort_values("hidden", kind="stable").apply(size_of, axis=1))],
        "classes": classes.ticks,
        "classWord": classes.word,
    }


def sops_table(results: pd.DataFrame, swept: list[str]) -> pd.DataFrame:
    """The SOP report of a study: one row per cell, its keys, the columns of `SOPS_COLUMNS` and input spikes."""
    layers = [LAYERS] if LAYERS in results else []
    keys = ["dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", *layers, "seed", *swept]
    return results[[*keys, *SOPS_COLUMNS[:2], *input_spikes(results, swept), *SOPS_COLUMNS[2:]]]


def input_spikes(results: pd.DataFrame, swept: Sequence[str] = ()) -> list[str]:
    """The columns of the input spikes of each population.

    >>> input_spikes(pd.DataFrame(columns=["seed", "spikes_on", "spikes_off", "spikes_per_s"]), ["spikes_per_s"])
    ['spikes_on', 'spikes_off']
    """
    return [name for name in results if name.startswith("spikes_") and name not in swept]


def write_sops(table: pd.DataFrame, folder: Path, title: str) -> None:
    """Write `sops.csv`, `sops.json` and `sops.md` into a run folder."""
    for suffix in (".csv", ".json", ".md"):
        write_table(table, folder / f"sops{suffix}", SOPS_ABOUT.format(title=title))


def _middle(test: _Test) -> tuple[int, int]:
    """The trial and the first step of the window with the median number of input spikes."""
    counts = test.examples.spikes.sum(dim=(1, 2)).numpy()
    middle = np.argsort(counts, kind="stable")[len(counts) // 2]
    return int(test.windows.trial[middle]), int(test.windows.start[middle])


@torch.no_grad()
def _raster(
    restored: Restored, trains: SpikeTrains, begin: tuple[int, int], classes: Classes, most_events: int
) -> dict[str, Any]:
    """Spikes of one window as steps for each neuron, cut short if there are more than `most_events`."""
    trial, start = begin
    n_steps = round(restored.task.window.length_ms * 1e-3 * trains.sampling_rate_Hz)
    window = trains.raster(Windows(np.array([trial]), np.array([start]), n_steps))
    network = restored.network
    hidden, readout = (
        clock.spread(spikes, network.steps_per_bin, n_steps)[0].numpy()
        for spikes in network.simulate(torch.from_numpy(window))
    )
    whole = network.infer(torch.from_numpy(window))
    readout = readout if network.integration is None else np.zeros_like(readout)  # an integrator does not spike
    early = network.infer(torch.from_numpy(window), restored.rule)
    order = [restored.classes.index(label) for label in classes.order]
    layers = (window[0], hidden, readout[:, order])
    events = np.cumsum(sum(layer.sum(axis=1) for layer in layers))
    until = int(np.searchsorted(events, most_events, side="right"))
    return {
        "trial": trial,
        "start_ms": 1e3 * start / trains.sampling_rate_Hz,
        "step_ms": 1e3 / trains.sampling_rate_Hz,
        "steps": n_steps,
        "shown": max(1, until),
        "isSA": trains.is_sa.astype(int).tolist(),
        "input": _events(layers[0][:until]),
        "hidden": _events(layers[1][:until]),
        "readout": _events(layers[2][:until]),
        "true": classes.order.index(str(trains.conditions["label"].iloc[trial])),
        "taken": order.index(int(whole.labels[0])),
        "exitStep": int(early.steps[0]),
        "exitTaken": order.index(int(early.labels[0])),
    }


def _events(raster: np.ndarray) -> list[list[int]]:
    return [np.flatnonzero(neuron).tolist() for neuron in raster.T]


def _training(folder: Path, cell: Cell) -> dict[str, Any] | None:
    """The training log by column, to four digits, and under `kept` the epoch of the network's weights.

    Where several networks were joined, `members` of them, it is that of the first one. `note`: of a last training.
    """
    path = cell_folder(folder, cell) / LOG
    if not path.is_file():
        return None
    whole = pd.read_csv(path)
    log = first_member(whole)
    columns: dict[str, Any] = {
        column: [None if pd.isna(value) else float(f"{value:.4g}") for value in log[column]] for column in LOGGED
    }
    members = {"members": n} if (n := int(whole[MEMBER].max()) if MEMBER in whole else 1) > 1 else {}
    note = {"note": LAST_TRAINING} if is_last_training(folder, cell) else {}
    return columns | members | note | {"kept": kept_epoch(folder, cell)}
