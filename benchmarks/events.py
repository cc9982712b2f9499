"""A detector of contact and slip beside two rivals, on simulated recordings whose onsets are known.

    python benchmarks/events.py -o events/ [--recordings 20] [--duration-s 30] [--seeds 3] [--epochs 20]

Recordings are those of `neurotact simulate gratings-slips`. All three hear the same spikes, have their thresholds from
the same recordings for the same number of false alarms an hour, and are tested on the same recordings, by the same
rule:

- the detector: `neurotact train --target events`, on its windows, run on through whole recordings;
- logistic regression on the counts of each afferent in a sliding window, in 1 and in 5 bins, sized on validation;
- a threshold on the summed rate: all spikes of a sliding window, which tells contact from rest, and slip by a second,
  higher level of the training windows.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from neurotact_parts.streams import detector
from neurotact_parts.streams.detector import Heard
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import StandardScaler

import neurotact as nt
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.networks.training import run_folder, tasks
from neurotact.networks.training.tasks import Task

ENCODER = {"conditioning.resample_Hz": 1000.0, "conditioning.baseline": "start", "sa1.gain": 8.0, "ra1.gain": 60.0}
COLUMNS = [
    "seed", "who", "events_test", "hits", "hit_share", "false_alarms", "false_alarms_per_h", "delay_ms", "delay_ms_low",
    "delay_ms_high", "tested_s", "detector_threshold", "detector_steps", "chosen_on_s", "chosen_with_false_alarms",
]  # fmt: skip


def sliding(trains: SpikeTrains, trial: int, length: int, bins: int, hop: int) -> np.ndarray:
    """Counts of each afferent in the window that ends at each `hop`-th step, `(step, bin x afferent)`."""
    n_steps, n_afferents = int(trains.trial_steps[trial]), len(trains.afferents)
    raster = np.zeros((n_steps + 1, n_afferents), np.int64)
    np.add.at(raster, (trains.steps[trial] + 1, trains.units[trial]), 1)
    total, ends = raster.cumsum(axis=0), np.arange(hop, n_steps + 1, hop)
    edges = [np.clip(ends - length + round(length * k / bins), 0, None) for k in range(bins + 1)]
    return np.concatenate([total[b] - total[a] for a, b in pairwise(edges)], axis=1)


def logistic(trains: SpikeTrains, task: Task, length: int, split: Split) -> Callable[[int, int], np.ndarray]:
    """The scores of logistic regression, the best on validation windows."""
    best: tuple[float, Any] = (-1.0, None)
    sides = tasks.sides_of(trains, task, split)
    for bins in (1, 5):
        edges = np.linspace(0, length, bins + 1).round().astype(int)
        features = [
            np.concatenate([side.spikes[:, a:b].sum(dim=1).numpy() for a, b in pairwise(edges)], 1) for side in sides
        ]
        scaler = StandardScaler().fit(features[0])
        for strength in (0.01, 0.1, 1.0, 10.0):
            model = LogisticRegression(C=strength, max_iter=2000)
            model.fit(scaler.transform(features[0]), sides.train.labels.numpy())
            score = model.score(scaler.transform(features[1]), sides.validation.labels.numpy())
            best = max(best, (score, (bins, scaler, model)), key=lambda found: found[0])
    bins, scaler, model = best[1]
    n_labels = len(tasks.names_of(trains, task))

    def values(trial: int, hop: int) -> np.ndarray:
        scores = model.decision_function(scaler.transform(sliding(trains, trial, length, bins, hop)))
        found = np.full((len(scores), n_labels), scores.min() - 1e3)
        found[:, model.classes_] = scores
        return found

    return values


def summed(trains: SpikeTrains, task: Task, length: int, split: Split) -> Callable[[int, int], np.ndarray]:
    """Nearness of the summed count to its mean under each label in training."""
    train = tasks.sides_of(trains, task, split).train
    counts, labels = train.spikes.sum(dim=(1, 2)).double().numpy(), train.labels.numpy()
    means = np.array([counts[labels == label].mean() for label in range(labels.max() + 1)])

    def values(trial: int, hop: int) -> np.ndarray:
        total = sliding(trains, trial, length, 1, hop).sum(axis=1)
        return -np.abs(total[:, None] - means)

    return values


def rows(folder: Path, args: argparse.Namespace, seed: int) -> Iterator[dict[str, Any]]:
    """The results of all three, for one seed of the recordings, the split and the weights."""
    recordings = nt.simulate("gratings-slips", recordings=args.recordings, duration_s=args.duration_s, seed=seed)
    spikes, run = folder / f"spikes{seed}.h5", folder / f"run{seed}"
    nt.save(nt.encode(recordings, "sa1-ra1-lif", ENCODER), spikes, force=True)
    learn = nt.Learn(target="events", false_alarms_per_h=args.false_alarms_per_h)
    settings = {"training.epochs": args.epochs}
    split = nt.Split(seed=seed, validation=0.25, test=0.25)
    how = {"learn": learn, "settings": settings, "split": split, "seed": seed, "force": True}
    yield {"who": "detector", **nt.train(spikes, run, **how)}
    restored = run_folder.restore(run)
    trains, task = run_folder.load_spikes_of(restored), restored.task
    sides, length = tasks.trials_of(trains, task), round(task.window.length_ms * 1e-3 * trains.sampling_rate_Hz)
    ours, hop = detector.heard, restored.network.steps_per_bin
    for who, make in (("logistic regression", logistic), ("summed rate", summed)):
        fitted: Any = partial(make, trains, task, length)  # in place of a training, and `told` of a network

        def heard(told: Any, trains: SpikeTrains, trials: Iterable[int], names: Sequence[str]) -> list[Heard]:
            found = ours(restored.network, trains, trials, names)
            return [one._replace(values=told(one.trial, hop)) for one in found]

        with patch.object(detector, "heard", heard):
            told = fitted(sides)
            rule = detector.choose(told, trains, sides, task, fitted)
            row, _, _ = detector.judge(told, trains, sides.test.tolist(), rule)
        yield {"who": who, **row}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--duration-s", type=float, default=30.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--false-alarms-per-h", type=float, default=60.0)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found = [{"seed": seed, **row} for seed in range(args.seeds) for row in rows(args.out, args, seed)]
    table = pd.DataFrame(found)[COLUMNS]
    table.to_csv(args.out / "events.csv", index=False)
    print(table.round(3).to_string(index=False))


if __name__ == "__main__":
    main()
