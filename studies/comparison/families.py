"""Every family of classifiers on one task: its candidates, the choice by validation, the cost of a decision.

Features and sequences are standardised on training examples; sequences are first averaged to the steps of the family. A
family yields its candidates from the smallest on; of candidates with equal validation accuracy, the first is chosen.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from sklearn.neighbors import KNeighborsClassifier
from sklearn.preprocessing import StandardScaler

from neurotact.baselines.centroid_kmeans import ClassCentroidKMeans, Init
from neurotact.baselines.families import (
    Candidate,
    Family,
    Sides,
    elm,
    extra_trees,
    minirocket,
    pooled_gru,
    standardised,
    svm,
)
from neurotact.baselines.features import averaged
from neurotact.baselines.opponents import MOST_SAMPLES, gru_steps
from neurotact.baselines.recurrent import GRUClassifier, LSTMClassifier
from neurotact.baselines.rls import RLSClassifier
from neurotact.baselines.slfn import SLFNClassifier
from neurotact.data.splits import Split
from neurotact.metrics import flops
from neurotact.metrics.flops import Layer
from neurotact.metrics.signal_flops import Averaging, StandardisedSteps
from neurotact.studies.way import TaskData

STEPS = 50
"""Steps of the input sequences of LSTM and GRU."""

SLFN_HIDDEN = (10, 30, 100)
RLS_SIGMAS, RLS_ALPHAS = (2.0, 1.0, 0.5), tuple(10.0**k for k in range(1, -7, -1))
"""Sigmas are multiplied by the root of the number of features."""
NEIGHBOURS = (1, 3, 5, 9)
RECURRENT_HIDDEN = (10, 30)
RECURRENT_TRAINING = {"epochs": 60, "batch": 48, "learning_rate": 0.01}


def feature_sides(task: TaskData, split: Split) -> Sides:
    """The features of each side, standardised on the training side."""
    scaler = StandardScaler().fit(task.features[split.train])
    return Sides(*(scaler.transform(task.features[side]) for side in split), *(task.labels[side] for side in split))


def sequence_sides(task: TaskData, split: Split, family: str = "GRU") -> Sides:
    """The sequences of each side, averaged to the family's steps, each channel standardised on the training side."""
    sequences = np.asarray(task.sequences, float)
    n_samples = sequences.shape[1]
    own = {
        "MiniRocket": min(MOST_SAMPLES, n_samples),
        "pooled GRU": gru_steps(1e3 * n_samples / task.sampling_rate_Hz, n_samples),
    }
    return standardised(averaged(sequences, own.get(family, min(STEPS, n_samples))), task.labels, split)


def slfn(sides: Sides, seed: int) -> Iterator[Candidate]:
    """ReLU networks trained by back-propagation, stopped on validation accuracy."""
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    for hidden in SLFN_HIDDEN:
        network = SLFNClassifier(hidden, random_state=seed)
        fitted = network.fit(sides.train, sides.y_train, validation=(sides.validation, sides.y_validation))
        layers = (flops.Dense(n_features, hidden, "relu"), flops.Dense(hidden, n_classes, "softmax"))
        yield Candidate(f"N {hidden}", fitted, layers)


def rls(sides: Sides, seed: int) -> Iterator[Candidate]:
    """RBF least squares; each width has the penalty with the best validation accuracy, the strongest of equal ones."""
    (n_train, n_features), n_classes = sides.train.shape, len(np.unique(sides.y_train))
    for factor in RLS_SIGMAS:
        sigma = factor * n_features**0.5
        machine = RLSClassifier(RLS_ALPHAS[0], sigma).fit(sides.train, sides.y_train)
        alpha = RLS_ALPHAS[int(machine.accuracy_path(RLS_ALPHAS, sides.validation, sides.y_validation).argmax())]
        fitted = RLSClassifier(alpha, sigma).fit(sides.train, sides.y_train)
        layer = flops.RBFExpansion(n_train, n_features, outputs=1 if n_classes == 2 else n_classes)
        yield Candidate(f"sigma {sigma:.3g}, alpha {alpha:g}", fitted, (layer,))


def kmeans(sides: Sides, seed: int) -> Iterator[Candidate]:
    """One centroid per class, from the class means or from k-means++."""
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    starts: tuple[tuple[Init, int], ...] = (("class-mean", 1), ("k-means++", 20))
    for init, repetitions in starts:
        start = ClassCentroidKMeans(init, repetitions, random_state=seed)
        fitted = start.fit(sides.train, sides.y_train, validation=(sides.validation, sides.y_validation))
        yield Candidate(init, fitted, (flops.NearestPoints(n_classes, n_features),))


def knn(sides: Sides, seed: int) -> Iterator[Candidate]:
    """The nearest training examples."""
    n_train, n_features = sides.train.shape
    for k in NEIGHBOURS:
        fitted = KNeighborsClassifier(k).fit(sides.train, sides.y_train)
        yield Candidate(f"k {k}", fitted, (flops.NearestPoints(n_train, n_features, k),))


def lstm(sides: Sides, seed: int) -> Iterator[Candidate]:
    """One LSTM layer and a softmax on its last state."""
    yield from _recurrent(sides, seed, LSTMClassifier, flops.LSTM)


def gru(sides: Sides, seed: int) -> Iterator[Candidate]:
    """One GRU layer and a softmax on its last state."""
    yield from _recurrent(sides, seed, GRUClassifier, flops.GRU)


def _recurrent(sides: Sides, seed: int, classifier: Any, layer: Any) -> Iterator[Candidate]:
    _, n_steps, n_channels = sides.train.shape
    n_classes = len(np.unique(sides.y_train))
    for hidden in RECURRENT_HIDDEN:
        fitted = classifier(hidden, random_state=seed, **RECURRENT_TRAINING).fit(sides.train, sides.y_train)
        layers = (layer(n_channels, hidden, n_steps), flops.Dense(hidden, n_classes, "softmax"))
        yield Candidate(f"N {hidden}", fitted, layers)


ON_FEATURES: dict[str, Family] = {
    "ELM": elm,
    "SLFN": slfn,
    "SVM": svm,
    "RLS": rls,
    "k-means": kmeans,
    "kNN": knn,
    "extra trees": extra_trees,
}
ON_SEQUENCES: dict[str, Family] = {"LSTM": lstm, "GRU": gru, "MiniRocket": minirocket, "pooled GRU": pooled_gru}


def standardising(sides: Sides) -> tuple[Layer, ...]:
    """The cost of standardising features."""
    return (flops.Standardise(sides.train.shape[1]),)


def averaging(n_samples: int, n_steps: int, n_channels: int) -> tuple[Layer, ...]:
    """The cost of averaging `n_samples` samples to `n_steps` steps; empty if the numbers are equal."""
    return () if n_steps >= n_samples else (Averaging(n_samples, n_steps, n_channels),)


def slowing(n_samples: int, sides: Sides) -> tuple[Layer, ...]:
    """The cost of averaging and standardising a sequence of `n_samples` samples."""
    _, n_steps, n_channels = sides.train.shape
    return (*averaging(n_samples, n_steps, n_channels), StandardisedSteps(n_steps, n_channels))
