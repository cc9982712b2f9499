"""Force and speed as numbers: the default network beside its rivals on the same windows, trials and split.

    python benchmarks/how_much.py -o docs/data [--set gratings] [--opponents all] [--settings '{"hidden": 0}']

Simulated gratings, and the cubes of $NEUROTACT_DATA if they are there. Rivals are fitted to signals and to spikes, and
chosen on validation windows alone. Writes numbers.csv: a row for the network and for each rival on each input, with
its score and root-mean-square error on test windows, and the operations, bytes and energy of a decision, encoder
included.
"""

import argparse
import json
import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

import neurotact as nt
from neurotact.baselines import opponents
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.use import ledger

START = {"conditioning.baseline": "start"}
SETS = {
    "gratings": (["speed_mm_per_s", "force_N"], nt.Window(length_ms=500.0)),
    "cubes": (["force_max_N"], nt.Window()),
}
COLUMNS = ["set", "target", "who", "input", "settings", "accuracy_validation", "accuracy_test", "rmse",
           "flops", "bytes", "energy_estimate_nJ", "signal_ms"]  # fmt: skip


def touches_of(name: str) -> tuple[nt.Recordings, nt.SpikeTrains]:
    """Recordings and their spikes."""
    if name == "gratings":
        touches = nt.simulate("gratings", {"trials": 10, "duration_s": 1.0})
        return touches, nt.encode(touches, settings=START)
    data = Path(os.environ.get("NEUROTACT_DATA", "../shared/data"))
    touches = nt.read("pvdf-hardness", data / "pvdf-hardness")
    assert isinstance(touches, nt.Recordings)
    return touches, nt.encode(touches, nt.calibrate(touches, settings=START))


def network_row(folder: Path, row: dict[str, Any], target: str) -> dict[str, Any]:
    """The network's score and error, and what a decision costs."""
    restored = run_folder.restore(folder)
    trains, network = run_folder.load_spikes_of(restored), restored.network
    means = nt.summarise(nt.infer(folder, trains, test_only=True))
    sizes = len(trains.afferents), network.n_classes
    made_by = {"encoder": trains.encoder or None, "recorded_Hz": trains.recorded_Hz, "synapses": network.synapses}
    costs = ledger.decision_ledger(network.spec, *sizes, trains.sampling_rate_Hz, means, **made_by)
    shown = {**row, **costs.iloc[-1], "rmse": row[f"rmse_{target}"], "settings": f"hidden {network.spec.hidden}"}
    return {**shown, "who": "network", "input": "spikes"}


def rivals(recordings: nt.Recordings, folder: Path, target: str, level: Any) -> Iterator[dict[str, Any]]:
    """A row for each rival on each input."""
    restored = run_folder.restore(folder)
    trains, task = run_folder.load_spikes_of(restored), restored.task
    windows, split = trains.cut(task.window), tasks.trials_of(trains, task)
    cuts = opponents.cuts_of(trains.conditions, windows, trains.sampling_rate_Hz, split, {})._replace(tells="numbers")
    inputs = chain(
        opponents.signal_inputs(recordings, cuts, level), opponents.spike_inputs(trains, (0.0, 0.0), cuts, level)
    )
    labels = tasks.labels_of(trains, windows, task).numpy()
    deviation = float(labels[cuts.sides[0]].std(dtype=np.float64))
    for row in opponents.rows(inputs, labels, cuts):
        rmse = deviation * (1 - row["accuracy_test"]) ** 0.5  # of a single target the score is one less the squares
        yield {**row, "who": row["classifier"], "rmse": rmse}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, default=Path("docs/data"))
    parser.add_argument("--set", choices=SETS, action="append")
    parser.add_argument("--opponents", default="all")
    parser.add_argument("--settings", type=json.loads, default={})
    given, found = parser.parse_args(), []
    for name in given.set or SETS:
        targets, window = SETS[name]
        recordings, trains = touches_of(name)
        for target in targets:
            with TemporaryDirectory() as temporary:
                spikes, run = Path(temporary) / "spikes.h5", Path(temporary) / "run"
                nt.save(trains, spikes)
                learn = nt.Learn(target=target)
                row = nt.train(spikes, run, "default", given.settings, window=window, learn=learn, tell=print)
                every = [network_row(run, row, target)]
                every += [] if given.opponents == "none" else rivals(recordings, run, target, given.opponents)
            table = pd.DataFrame(every).assign(set=name, target=target).reindex(columns=COLUMNS)
            print(table.drop(columns="set").round(3).to_string(), flush=True)
            found.append(table)
    pd.concat(found).to_csv(given.o / "numbers.csv", index=False, float_format="%.5g", lineterminator="\n")


if __name__ == "__main__":
    main()
