"""How much of the accuracy at a repeated start is the start: what the time of the first event tells of a grating.

    python benchmarks/start_leak.py [--trials 100] [--start repeated|random] [--json leak.json]

The encoder, the windows and the split of the refractory-period study at 1&1 ms, mixed data. A rig that repeats its
start meets each plate's ridges at that plate's own instants, so that *when* something happens tells the plate before
*what* happens does. Three machines of 300 extremely randomised trees, means over three seeds:

- phase: sees the time of the window's first spike alone (of SA-I, of RA-I, of both, or of every afferent apart);
- permuted: sees all spikes, but the labels of training trials are permuted within bins of the first spike's time, so
  that nothing but those bins can be learned;
- spikes: sees all spikes and true labels.

The share of the accuracy above chance that the phase gives is printed last. Bins hold equally many training trials.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from neurotact_parts.studies.texture.simulator import GratingsSpec, simulate
from sklearn.ensemble import ExtraTreesClassifier

from neurotact.data.splits import Split, SplitSpec, split_conditions
from neurotact.data.windows import WindowSpec, cut
from neurotact.encoders import specs as encoders
from neurotact.encoders.encoding import encode_recordings

WINDOW = WindowSpec(length_ms=150.0, start_ms=250.0, per_trial=1)
SIDES = ("force_N", "speed_mm_per_s")
BIN_ms, TREES, SEEDS = 10.0, 300, (0, 1, 2)
PHASE_BINS = 30


def first_spikes(raster: np.ndarray) -> np.ndarray:
    """The step of each afferent's first spike, `(window, afferent)`; the window's length where there is none."""
    return np.where(raster.any(axis=1), raster.argmax(axis=1), raster.shape[1])


def permuted_within(labels: np.ndarray, bins: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Labels permuted among the trials of each bin.

    >>> permuted_within(np.array([1, 1, 2, 3]), np.array([0, 0, 1, 2]), np.random.default_rng(0)).tolist()
    [1, 1, 2, 3]
    """
    found = labels.copy()
    for one in np.unique(bins):
        inside = np.flatnonzero(bins == one)
        found[inside] = rng.permutation(labels[inside])
    return found


def accuracy(features: np.ndarray, labels: np.ndarray, split: Split, learned: Callable[[int], np.ndarray]) -> float:
    """Mean test accuracy over the seeds; `learned(seed)` are the labels of the training trials."""
    scores = []
    for seed in SEEDS:
        trees = ExtraTreesClassifier(TREES, random_state=seed, min_samples_leaf=1 if features.shape[1] > 16 else 5)
        trees.fit(features[split.train], learned(seed))
        scores.append(trees.score(features[split.test], labels[split.test]))
    return float(np.mean(scores))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=100, help="trials of each grating, force and speed")
    parser.add_argument("--start", choices=["repeated", "random"], default="repeated")
    parser.add_argument("--start-mm", type=float, default=GratingsSpec().start_mm)
    parser.add_argument("--json", type=Path, help="also write the rows there")
    options = parser.parse_args()
    spec = GratingsSpec(trials=options.trials, start=options.start, start_mm=options.start_mm)
    trains = encode_recordings(simulate(spec), encoders.load("sa1-ra1-lif"))
    split = split_conditions(trains.conditions, SIDES, SplitSpec())
    raster = trains.raster(cut(trains.trial_steps, trains.sampling_rate_Hz, WINDOW))
    labels, first = trains.labels, first_spikes(raster).astype(np.float32)
    width = round(BIN_ms * 1e-3 * trains.sampling_rate_Hz)
    counts = raster.reshape(len(raster), -1, width, raster.shape[2]).sum(axis=2, dtype=np.uint16)
    counts = counts.reshape(len(raster), -1).astype(np.float32)
    any_first = first.min(axis=1, keepdims=True)
    edges = np.unique(np.quantile(any_first[split.train], np.linspace(0, 1, PHASE_BINS + 1)))
    bins = np.digitize(any_first[:, 0], edges[1:-1])

    def true(_: int) -> np.ndarray:
        return labels[split.train]

    def shuffled(seed: int) -> np.ndarray:
        return permuted_within(labels[split.train], bins[split.train], np.random.default_rng(seed))

    by_kind = np.stack([first[:, trains.is_sa].min(axis=1), first[:, ~trains.is_sa].min(axis=1)], axis=1)
    rows = {
        "first spike of any afferent": accuracy(any_first, labels, split, true),
        "first spike of SA-I and of RA-I": accuracy(by_kind, labels, split, true),
        "first spike of every afferent": accuracy(first, labels, split, true),
        f"all spikes, labels permuted within {len(edges) - 1} bins of the first spike": accuracy(
            counts, labels, split, shuffled
        ),
        "all spikes": accuracy(counts, labels, split, true),
    }
    chance = 1.0 / len(trains.classes)
    for name, found in rows.items():
        share = (found - chance) / (rows["all spikes"] - chance)
        print(f"{name:68s} {100 * found:5.1f} %   {100 * share:4.0f} % of what lies above chance", flush=True)
    if options.json:
        options.json.write_text(json.dumps({"start": options.start, "start_mm": options.start_mm} | rows, indent=1))


if __name__ == "__main__":
    main()
