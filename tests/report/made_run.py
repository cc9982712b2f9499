"""A run folder as a study leaves it, with made-up numbers, for tests of the report."""

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from neurotact.data import hdf5
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.splits import SplitSpec
from neurotact.files import write_json, write_text
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import run_folder, tasks, trainer
from neurotact.networks.training.epochs import Epoch, Training
from neurotact.studies import networks, runner, store, study
from neurotact.studies.encoding_tables import encoding_table
from neurotact.studies.store import TIMING, cell_folder
from neurotact.studies.study import Cell, StudySpec

GRATINGS = {"simulate": "gratings", "stratify": ["force_N", "speed_mm_per_s"]}
SUBSETS = {"v1 mix": {"speed_mm_per_s": 8.6}, "mixed": {}}


def grating_conditions(pitches_mm=(4.0, 2.0, 1.0, 0.5), trials=1) -> pd.DataFrame:
    rows = product(range(trials), enumerate(pitches_mm, start=1), (3.0, 6.0, 12.0), (8.6, 13.7))
    return pd.DataFrame(
        [
            {"label": f"P{pitch}", "grating": n, "pitch_mm": pitch, "force_N": force, "speed_mm_per_s": speed}
            for _, (n, pitch), force, speed in rows
        ]
    )


def make_trains(conditions: pd.DataFrame, cell: Cell, rate_Hz: float, seconds: float, silent_ra: bool) -> SpikeTrains:
    """Random spikes of two taxels, the more the harder the touch and the shorter t_ref."""
    generator = np.random.default_rng(0)
    force = conditions.get("force_N", pd.Series(6.0, conditions.index)).to_numpy()
    t_ref = np.array([cell.encoder.sa1.t_ref_ms] * 2 + [cell.encoder.ra1.t_ref_ms] * 2)
    chance = 0.004 * force[:, None] / (1 + 0.3 * t_ref)
    if silent_ra:
        chance[:, 2:] = 0
    rasters = generator.random((len(conditions), round(seconds * rate_Hz), 4)) < chance[:, None]
    names = ("SA-I taxel1", "SA-I taxel2", "RA-I taxel1", "RA-I taxel2")
    return from_rasters(rasters, rate_Hz, names, conditions, cell.encoder.model_dump(mode="json", exclude_none=True))


def row_of(cell: Cell, generator: np.random.Generator) -> dict:
    ra, sa, hidden = cell.encoder.ra1.t_ref_ms, cell.encoder.sa1.t_ref_ms, cell.network.hidden
    accuracy = 0.92 - 0.012 * (ra + sa) / 2 + 0.0008 * hidden + generator.normal(0, 0.012)
    inputs = hidden * 120.0 / (1 + 0.08 * (ra + sa))
    recurrent, readout = (n * 150.0 * generator.uniform(0.9, 1.1) for n in (hidden, 8))
    total = inputs + recurrent + readout
    return {
        "dataset": cell.dataset,
        "t_ref_ra_ms": ra,
        "t_ref_sa_ms": sa,
        "hidden": hidden,
        "seed": cell.seed,
        "accuracy_validation": accuracy + 0.01,
        "accuracy_test": accuracy,
        "sops_input": inputs,
        "sops_recurrent": recurrent,
        "sops_readout": readout,
        "sops_total": total,
        "sops_total_feedforward": inputs + readout,
        "spikes_sa": 80.0 / (1 + sa),
        "spikes_ra": 40.0 / (1 + ra),
        "exit_steps": 220.0,
        "exit_steps_sd": 26.0,
        "exit_accuracy": accuracy - 0.01,
        "exit_sops_total": 0.75 * total,
        "exit_sops_input": 0.75 * inputs,
        "exit_sops_recurrent": 0.75 * recurrent,
        "exit_sops_readout": 0.75 * readout,
        "exit_sops_total_feedforward": 0.75 * (inputs + readout),
        "exit_patience": 120,
        "window_steps": 300,
        "epochs": 20,
    }


def save_network(cell: Cell, place: Path, trains: SpikeTrains, path: Path) -> None:
    """An untrained network that spikes, with what a trained one is kept with."""
    network = RSNN(
        len(trains.afferents),
        len(trains.classes),
        cell.network,
        trains.sampling_rate_Hz,
        generator=torch.Generator().manual_seed(cell.seed),
    )
    with torch.no_grad():
        network.w_in.abs_().mul_(4.0)
        network.w_out.mul_(8.0)
    epochs = tuple(Epoch(n, 2.0 / (1 + n), 0.05 * n, 2.0 / (1 + abs(n - 15)), 0.9) for n in range(20))
    fitted = trainer.Trained(network, Training(epochs, epochs[15]), ExitRule(40, from_first_spike=True))
    task = tasks.Task(window=cell.window, split=SplitSpec(validation=0.25, test=0.25), subset=cell.subset)
    run_folder.save(fitted, place, trains, path, task)


def make_run(
    what: StudySpec,
    folder: Path,
    conditions: pd.DataFrame,
    *,
    n_done: int | None = None,
    rate_Hz: float = 400.0,
    seconds: float = 0.6,
    silent_ra: bool = False,
    bounded: int = 0,
) -> Path:
    """Leave in `folder` what a run of `what` leaves, its first `n_done` cells done.

    bounded: validation trials on which early exit loses nothing.
    """
    generator = np.random.default_rng(1)
    done = list(study.cells(what))[:n_done]
    n_classes = conditions["label"].nunique()
    encoding = {}
    for cell in done:
        place, path = cell_folder(folder, cell), folder / cell.given
        if cell.spikes_name not in encoding:
            trains = make_trains(conditions, cell, rate_Hz, seconds, silent_ra)
            hdf5.save_spikes(trains, path)
            encoding[cell.spikes_name] = encoding_table(trains, cell, what.dataset.stratify)
        confusion = (12 * np.eye(n_classes, dtype=int) + generator.integers(0, 3, (n_classes, n_classes))).tolist()
        place.mkdir(parents=True)
        losses = {"exit_losses": dict.fromkeys(map(str, range(bounded)), 0.0)} if bounded else {}
        write_json(place / "result.json", {"row": row_of(cell, generator), "confusion": confusion, **losses})
        write_json(place / "timing.json", {"seconds": 3.5, "epochs": 20})
        save_network(cell, place, hdf5.load_spikes(path), path)
        store.seal(path.parent, [path.name])
        names = [one.name for one in place.iterdir() if one.name != TIMING]
        store.seal(place, names, store._sources(folder, cell))
    results = [(cell, store.result_of(folder, cell)) for cell in done]
    networks.results_table(what, results).to_csv(folder / "results.csv", index=False)
    pd.concat(encoding.values()).to_csv(folder / "encoding.csv", index=False)
    timings = [{"cell": cell.digest(), "seconds": 3.5, "epochs": 20} for cell in done]
    pd.DataFrame(timings).to_csv(folder / "timings.csv", index=False)
    write_text(folder / "study.toml", study.to_toml(what))
    write_json(folder / "versions.json", runner.versions())
    data = {"sha256": "0" * 64, "trials": len(conditions), "classes": sorted(set(conditions["label"]))}
    write_json(folder / "data.json", data)
    return folder
