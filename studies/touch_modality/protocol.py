"""The touch-modality paper: LSTM and GRU classify sliding, brushing and rolling from a few averages of a touch.

Table I, Figs. 4 and 7. Two protocols: `paper` has five stratified, unshuffled folds, trains on four of them and chooses
batch size and epochs by the accuracy on the *test* folds, as published; `honest` keeps every person on one side, and
chooses for each fold on validation people taken from its training people. Both normalise by the training patterns.
"""

from collections.abc import Iterator
from itertools import product
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.opponents.pooled_gru import GRU
from neurotact_parts.studies.published_flops import TOUCH_MODALITY_FLOPS
from neurotact_parts.studies.task_data import TaskData
from neurotact_parts.studies.touch_modality import figures
from neurotact_parts.studies.touch_modality.datasets import STEP_COUNTS, TOUCH_SAMPLES, dataset_c, window_bounds
from neurotact_parts.studies.touch_modality.folds import Fold
from neurotact_parts.studies.touch_modality.recurrent import LSTM, GRUClassifier, LSTMClassifier, fit_snapshots
from neurotact_parts.studies.touch_modality.touches import (
    TouchData,
    fit_standardisation,
    folds_of,
    seed_of,
    touches_of,
    typical,
)
from pydantic import Field

from neurotact.data.conditioning import Conditioner, ConditioningSpec, ema, ema_coefficient
from neurotact.figures.style import Drawn
from neurotact.metrics.flops import Cost, Dense, Moments, cost
from neurotact.spec import Spec
from neurotact.studies.way import Arrays, View, heads

AtLeastOne = Annotated[int, Field(ge=1)]

CELLS = {"LSTM": (LSTMClassifier, LSTM), "GRU": (GRUClassifier, GRU)}
NETWORKS: dict[str, tuple[Literal["LSTM", "GRU"], int]] = {
    "LSTM(10)": ("LSTM", 10),
    "GRU(10)": ("GRU", 10),
    "GRU(12)": ("GRU", 12),
}
"""Cell and neurons (Sec. IV-B)."""
TABLE_I = {
    ("LSTM(10)", 8): (83.52, 73.52, 65.44, 76.08, 73.97),
    ("LSTM(10)", 10): (81.98, 71.98, 67.94, 74.93, 73.14),
    ("LSTM(10)", 16): (83.78, 71.85, 65.96, 75.64, 71.79),
    ("LSTM(10)", 20): (84.23, 73.39, 67.11, 75.57, 69.80),
    ("LSTM(10)", 50): (79.48, 69.48, 63.52, 74.16, 66.98),
    ("LSTM(10)", 100): (73.26, 62.75, 62.5, 69.23, 62.17),
    ("LSTM(10)", 200): (74.67, 58.52, 56.85, 61.08, 58.46),
    ("LSTM(10)", 256): (68.07, 58.07, 55.32, 59.29, 56.6),
    ("GRU(10)", 8): (82.11, 70.5, 65.44, 75.76, 71.66),
    ("GRU(10)", 10): (81.98, 70.12, 65.0, 73.39, 71.08),
    ("GRU(10)", 16): (81.47, 69.23, 65.57, 74.42, 69.67),
    ("GRU(10)", 20): (81.92, 70.25, 64.55, 74.74, 68.84),
    ("GRU(10)", 50): (81.41, 70.32, 64.23, 71.73, 64.93),
    ("GRU(10)", 100): (79.23, 65.57, 61.79, 68.65, 63.33),
    ("GRU(10)", 200): (72.75, 64.48, 56.15, 60.06, 52.17),
    ("GRU(10)", 256): (68.07, 61.02, 61.41, 61.41, 52.17),
    ("GRU(12)", 8): (82.30, 71.02, 65.12, 75.89, 72.82),
    ("GRU(12)", 10): (80.83, 71.15, 67.05, 76.08, 71.92),
    ("GRU(12)", 16): (83.52, 70.64, 66.66, 74.35, 69.87),
    ("GRU(12)", 20): (83.78, 70.70, 67.75, 74.55, 68.58),
    ("GRU(12)", 50): (81.47, 69.35, 63.65, 73.91, 65.44),
    ("GRU(12)", 100): (78.46, 66.15, 60.70, 71.28, 62.94),
    ("GRU(12)", 200): (75.76, 61.66, 55.51, 65.06, 55.12),
    ("GRU(12)", 256): (70.57, 59.61, 55.38, 61.21, 54.67),
}
"""Published mean over ten runs of each fold (%), by network and steps."""

TASK_STEPS = 8
TASK_RATE_HZ = 250.0
TASK_CUTOFF_HZ = 100.0


class Parameters(Spec):
    """One cell: a network on sequences of one length, all folds, runs and pairs of batch and epochs."""

    data: TouchData = TouchData()
    network: Literal["LSTM(10)", "GRU(10)", "GRU(12)"] = "LSTM(10)"
    steps: Literal[8, 10, 16, 20, 50, 100, 200, 256] = 20
    protocol: Literal["paper", "honest"] = "honest"
    runs: int = Field(default=10, ge=1)
    """Random initialisations and orders per fold (Sec. IV-C)."""
    batches: tuple[AtLeastOne, ...] = Field(default=(48, 69), min_length=1)
    epochs: tuple[AtLeastOne, ...] = Field(default=(48, 96), min_length=1)
    """Epochs (Sec. IV-C); the smaller number is a checkpoint of the larger, so that runs share initialisations."""
    learning_rate: float = Field(default=0.001, gt=0)
    """Keras' default for Adam, since the public code sets none."""
    seed: int = Field(default=0, ge=0)


VIEW = View(
    by=("network", "steps", "protocol"),
    measures=heads(
        "accuracy_test accuracy_validation parameters flops_published flops flops_windows energy_estimate_nJ signal_ms",
        flops_published="FLOPs as published",
        flops_windows="FLOPs of averaging",
    ),
    cost="flops",
    score="accuracy_test",
    note=(
        "Rows are folds, each the mean of its runs; standard deviations are over folds. Protocol paper chooses batch "
        "size and epochs on the test folds, as published, so its accuracies are optimistic; honest tests on people "
        "who are not in training or in that choice."
    ),
    apart=("protocol",),
    optimistic=("paper",),
)


def load(data: TouchData) -> Arrays:
    """Dataset C for every number of steps (`steps_<N>`, `(pattern, N, 16)` in V), labels `(pattern,)` and persons
    `(pattern,)` where known; classes with the numbers of recorded and of silent touches; one touch per class to show.
    """
    touches = touches_of(data)
    classes = np.array(sorted(touches.recorded))
    recorded = np.array([touches.recorded[label] for label in classes.tolist()])
    n_active = np.array([(touches.labels == label).sum() for label in classes.tolist()])
    arrays = {f"steps_{n}": dataset_c(touches.patterns, n, data.windows) for n in STEP_COUNTS}
    shown = [typical(touches.patterns, np.flatnonzero(touches.labels == label)) for label in classes.tolist()]
    return {
        **arrays,
        "labels": touches.labels,
        **({"persons": touches.persons} if len(touches.persons) else {}),
        "classes": classes,
        "recorded": recorded,
        "silent": recorded - n_active,
        "activity_s": touches.activity_s,
        "shown": touches.patterns[shown],
        "band_V": np.array([data.band.low_V, data.band.high_V]),
        "sampling_rate_Hz": np.array(touches.sampling_rate_Hz),
        "windows": np.array(data.windows),
    }


class Normalisation(NamedTuple):
    """Mean and deviation of each channel over the training patterns, `(channel,)`."""

    offset: tuple[float, ...]
    scale: tuple[float, ...]

    def apply(self, sequences: np.ndarray) -> np.ndarray:
        """`(pattern, step, channel)` in deviations from the mean."""
        return (sequences - np.array(self.offset)) / np.array(self.scale)


class Trained(NamedTuple):
    """The networks of one fold by pair of batch and epochs, its normalisation, and their accuracies `(pair, run)`."""

    networks: dict[tuple[int, int], list]
    normalisation: Normalisation
    validation: np.ndarray
    test: np.ndarray


def run(parameters: Parameters, arrays: Arrays) -> list[dict]:
    """A row per fold: the mean over runs at the chosen pair of batch and epochs, every pair's mean, and its costs."""
    folds = folds_of(parameters.protocol, parameters.data, arrays, parameters.seed)
    sequences, labels = arrays[f"steps_{parameters.steps}"], arrays["labels"]
    trained = train_folds(parameters, sequences, labels, folds)
    pairs = list(product(parameters.batches, parameters.epochs))
    chosen = choose(parameters.protocol, trained)
    spent, published, averaging = costs_of(parameters, arrays)
    rows = []
    for number, (fold, one, pair) in enumerate(zip(folds, trained, chosen, strict=True)):
        each_pair = {f"accuracy_b{b}_e{e}": one.test[i].mean() for i, (b, e) in enumerate(pairs)}
        rows.append(
            {
                "fold": number,
                "batch": pairs[pair][0],
                "epochs_trained": pairs[pair][1],
                "accuracy_test": one.test[pair].mean(),
                "accuracy_runs_sd": one.test[pair].std(ddof=1) if parameters.runs > 1 else float("nan"),
                "accuracy_validation": one.validation[pair].mean() if len(fold.validation) else float("nan"),
                **each_pair,
                **_on_other_steps(one, pairs[pair], arrays, fold.test),
                "patterns_train": len(fold.train),
                "patterns_test": len(fold.test),
                "parameters": spent.parameters,
                "flops_published": published,
                **spent.columns("flops", "macs"),
                "flops_windows": averaging.flops,
                **spent.columns("energy_estimate_nJ", "signal_ms"),
            }
        )
    return rows


def train_folds(parameters: Parameters, sequences: np.ndarray, labels: np.ndarray, folds: list[Fold]) -> list[Trained]:
    """Train every run of every fold at every pair; no fold's validation or test patterns are used before.

    sequences `(pattern, step, channel)`; labels `(pattern,)`.
    """
    cell, hidden = NETWORKS[parameters.network]
    normalisations = [Normalisation(*fit_standardisation(list(sequences[fold.train]))) for fold in folds]
    given = [
        (n.apply(sequences[fold.train]), labels[fold.train]) for n, fold in zip(normalisations, folds, strict=True)
    ]
    # A separate order for each fold and run, independent of other folds and of the number of runs.
    seeds = [seed_of(parameters.seed, fold, run) for fold in range(len(folds)) for run in range(parameters.runs)]
    examples = [pair for pair in given for _ in range(parameters.runs)]
    networks: dict[tuple[int, int], list] = {}
    for batch in parameters.batches:
        prototype = CELLS[cell][0](hidden, batch=batch, learning_rate=parameters.learning_rate)
        snapshots = fit_snapshots(prototype, examples, seeds, parameters.epochs)
        networks |= {(batch, epochs): fitted for epochs, fitted in zip(parameters.epochs, snapshots, strict=True)}
    return [
        _judged(networks, normalisation, parameters.runs, number, sequences, labels, fold)
        for number, (fold, normalisation) in enumerate(zip(folds, normalisations, strict=True))
    ]


def _judged(
    networks: dict[tuple[int, int], list],
    normalisation: Normalisation,
    runs: int,
    number: int,
    sequences: np.ndarray,
    labels: np.ndarray,
    fold: Fold,
) -> Trained:
    mine = {pair: fitted[number * runs : (number + 1) * runs] for pair, fitted in networks.items()}

    def accuracies(side: np.ndarray) -> np.ndarray:
        if not len(side):
            return np.full((len(mine), runs), np.nan)
        seen = normalisation.apply(sequences[side])
        return np.array([[(one.predict(seen) == labels[side]).mean() for one in fitted] for fitted in mine.values()])

    return Trained(mine, normalisation, accuracies(fold.validation), accuracies(fold.test))


def choose(protocol: str, trained: list[Trained]) -> list[int]:
    """The index of the pair of batch and epochs that each fold reports.

    `paper`: one pair for all folds, with the highest mean *test* accuracy (Sec. IV-C). `honest`: separately for each
    fold, the one with the highest mean validation accuracy.
    """
    if protocol == "paper":
        best = int(np.mean([one.test.mean(axis=1) for one in trained], axis=0).argmax())
        return [best] * len(trained)
    return [int(one.validation.mean(axis=1).argmax()) for one in trained]


def _on_other_steps(one: Trained, pair: tuple[int, int], arrays: Arrays, test: np.ndarray) -> dict[str, float]:
    """Accuracy of the same weights, with their own normalisation, on sequences of other lengths (Sec. V, 4)."""
    accuracies = {}
    for steps in STEP_COUNTS:
        seen = one.normalisation.apply(arrays[f"steps_{steps}"][test])
        accuracies[f"used_on_{steps}"] = np.mean(
            [(network.predict(seen) == arrays["labels"][test]).mean() for network in one.networks[pair]]
        )
    return accuracies


def costs_of(parameters: Parameters, arrays: Arrays) -> tuple[Cost, int, Cost]:
    """Our count of one decision of the network, the published FLOPs of it, and our count of averaging its windows."""
    cell, hidden = NETWORKS[parameters.network]
    n_channels, n_classes = arrays["shown"].shape[2], len(arrays["classes"])
    signal_ms = 1e3 * TOUCH_SAMPLES / float(arrays["sampling_rate_Hz"])
    network = cost(
        CELLS[cell][1](n_channels, hidden, parameters.steps), Dense(hidden, n_classes, "softmax"), signal_ms=signal_ms
    )
    bounds = window_bounds(TOUCH_SAMPLES, parameters.steps, parameters.data.windows)
    averaging = cost(*(Moments(int(stop - first), n_channels, order=1) for first, stop in bounds))
    return network, TOUCH_MODALITY_FLOPS[cell, hidden] * parameters.steps, averaging


def draw(results: pd.DataFrame, arrays: Arrays) -> Iterator[Drawn]:
    """Touches (Fig. 2), accuracy over steps (Fig. 4), other numbers of steps and scaling (Sec. V, Fig. 7)."""
    band_V = (float(arrays["band_V"][0]), float(arrays["band_V"][1]))
    touch_ms = 1e3 * TOUCH_SAMPLES / float(arrays["sampling_rate_Hz"])
    silent = ", ".join(f"{n} of {of} {c}" for c, n, of in zip(*(arrays[k] for k in _COUNTS), strict=True))
    yield Drawn(
        "touches",
        "One touch of each modality",
        figures.draw_touches(
            arrays["shown"],
            dataset_c(arrays["shown"], 20, "printed" if str(arrays["windows"]) == "printed" else "overlap"),
            arrays["classes"].tolist(),
            float(arrays["sampling_rate_Hz"]),
            band_V,
        ),
        "The touch of median strength of each class. Above: Dataset A, 6144 samples from the onset on; the three "
        f"strongest taxels in colour, the grey band is rest. Below: Dataset C, 20 windows. Silent: {silent}. Activity "
        f"lasts {arrays['activity_s'].mean():.2f} s on average.",
        "Voltages of sixteen taxels over two seconds for brushing, rolling and sliding, and the same averaged.",
    )
    yield Drawn(
        "accuracy",
        "Accuracy over the number of steps",
        figures.draw_accuracy(results, TABLE_I, touch_ms),
        "As Fig. 4: each line is a fold, the mean of its runs. Above, protocol paper, whose pair of batch and epochs "
        "is chosen on these test folds; below, honest, on people that are not in training or in the choice. "
        "Dashed: the mean of Table I's folds.",
        "Test accuracy against the number of steps for three networks and two protocols, a line per fold.",
    )
    shown = "honest" if (results["protocol"] == "honest").any() else "paper"
    yield Drawn(
        "other-steps",
        "Weights trained on N steps, used on M",
        figures.draw_other_steps(results[results["protocol"] == shown], STEP_COUNTS, touch_ms),
        f"Mean test accuracy over folds and runs, protocol {shown}.",
        "A table of accuracies for each network: trained steps down, used steps across.",
    )
    yield Drawn(
        "scaling",
        "Cost against sensors and classes",
        figures.draw_scaling(NETWORKS),
        "As Fig. 7: FLOPs of one block by the formula that yields the published numbers, by our count of a step, and "
        "trainable parameters.",
        "Three panels of lines that grow with the number of sensors, for three networks and three numbers of classes.",
    )


_COUNTS = ("classes", "silent", "recorded")


def task(data: TouchData) -> TaskData:
    """Touches for every family of classifiers.

    features: mean and deviation of each taxel in each of the 8 windows of Dataset C, 256 numbers. sequences: Dataset A
    after a moving average at 100 Hz, at 250 Hz, minus each taxel's first sample, in mV. groups: persons, or single
    touches if those are unknown.
    """
    touches = touches_of(data)
    bounds = window_bounds(TOUCH_SAMPLES, TASK_STEPS, data.windows)
    parts = [touches.patterns[:, first:stop] for first, stop in bounds]
    features = np.concatenate([f(part, axis=1) for f in (np.mean, np.std) for part in parts], axis=1)
    smoothing = ema_coefficient(TASK_CUTOFF_HZ, touches.sampling_rate_Hz)
    slow = Conditioner(touches.sampling_rate_Hz, ConditioningSpec(resample_Hz=TASK_RATE_HZ))
    sequences = np.stack([slow.whole(ema(pattern - pattern[:1], smoothing)) for pattern in touches.patterns])
    groups = touches.persons if len(touches.persons) else np.arange(len(touches.labels))
    return TaskData(
        features.astype(np.float64), np.float32(1e3) * sequences, TASK_RATE_HZ, "mV", touches.labels, groups
    )
