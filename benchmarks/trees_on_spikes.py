"""What extremely randomised trees tell from the spikes of the simulated gratings: a mark beside the spiking networks.

    python benchmarks/trees_on_spikes.py [--trials 100] [--json trees.json]

The encoder, the windows and the split of the studies of refractory periods and of sensing conditions. Each afferent's
spikes are counted in bins, or cumulatively; which, is chosen on validation trials. Its test accuracy is a mean over
three seeds of the trees; that of the others, of the first seed, is shown for comparison.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate
from sklearn.ensemble import ExtraTreesClassifier

from neurotact.data.recordings import select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split, SplitSpec, split_conditions
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders import specs as encoders
from neurotact.encoders.encoding import encode_recordings

SIDES = ("force_N", "speed_mm_per_s")
WINDOWS_ms = (150.0, 1000.0)
BINS_ms = (5.0, 10.0, 25.0, 50.0)
CUMULATIVE_ms = 5.0
TREES, SEEDS = 300, (0, 1, 2)


def features_of(trains: SpikeTrains, length_ms: float) -> dict[str, np.ndarray]:
    """Counts `(trial, feature)` of every afferent in one window a trial, from 250 ms on, by how they are counted."""
    windows = cut(
        trains.trial_steps, trains.sampling_rate_Hz, WindowSpec(length_ms=length_ms, start_ms=250, per_trial=1)
    )
    raster = trains.raster(windows)

    def binned(bin_ms: float) -> np.ndarray:
        width = round(bin_ms * 1e-3 * trains.sampling_rate_Hz)
        n, n_bins = len(raster), windows.n_steps // width
        return raster[:, : n_bins * width].reshape(n, n_bins, width, -1).sum(axis=2, dtype=np.uint16)

    counts = {f"counts in {bin_ms:g} ms": binned(bin_ms) for bin_ms in BINS_ms}
    counts[f"counts so far, every {CUMULATIVE_ms:g} ms"] = np.cumsum(binned(CUMULATIVE_ms), axis=1, dtype=np.uint16)
    return {name: found.reshape(len(raster), -1).astype(np.float32) for name, found in counts.items()}


def rows_of(counts: dict[str, np.ndarray], labels: np.ndarray, split: Split) -> Iterator[dict]:
    """A row per way of counting, the one that validates best marked; only its test accuracy has all seeds."""

    def fitted(name: str, seed: int) -> ExtraTreesClassifier:
        return ExtraTreesClassifier(TREES, random_state=seed).fit(counts[name][split.train], labels[split.train])

    def score(machine: ExtraTreesClassifier, name: str, side: np.ndarray) -> float:
        return float(machine.score(counts[name][side], labels[side]))

    first = {name: fitted(name, SEEDS[0]) for name in counts}
    validated = {name: score(machine, name, split.validation) for name, machine in first.items()}
    best = max(validated, key=lambda name: validated[name])
    for name, machine in first.items():
        machines = [machine, *(fitted(name, seed) for seed in SEEDS[1:])] if name == best else [machine]
        tested = float(np.mean([score(each, name, split.test) for each in machines]))
        yield {"counted": name, "chosen": name == best, "validation": validated[name], "test": tested}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=100, help="trials of each grating, force and speed")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    options = parser.parse_args()
    trains = encode_recordings(simulate(GratingsSpec(trials=options.trials)), encoders.load("sa1-ra1-lif"))
    conditions = trains.conditions
    split = split_conditions(conditions, SIDES, SplitSpec())
    each = [
        dict(zip(SIDES, values, strict=True)) for values in sorted(set(zip(*map(conditions.get, SIDES), strict=True)))
    ]
    rows = []
    for length_ms in WINDOWS_ms:
        counts = features_of(trains, length_ms)
        for where in ({}, *each):
            inside = np.flatnonzero(select_conditions(conditions, where))
            sides = Split(*(np.intersect1d(side, inside) for side in split))
            name = ", ".join(f"{value:g}" for value in where.values()) or "mixed"
            found = [{"window_ms": length_ms, "N, mm/s": name, **row} for row in rows_of(counts, trains.labels, sides)]
            print(pd.DataFrame(found).to_string(index=False, float_format="{:.3f}".format), flush=True)
            rows += found
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
