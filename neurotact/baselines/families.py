"""Families of classifiers chosen on validation examples: the candidates of each, and the cost of a decision.

Features are standardised on training examples. A family yields its candidates from the smallest on; ties in
validation accuracy: the first.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from sklearn.svm import SVC

from neurotact.baselines.elm import ELMClassifier
from neurotact.metrics import flops
from neurotact.metrics.flops import Layer
from neurotact.metrics.linear import fit_linear

ELM_HIDDEN, ELM_ALPHAS = (25, 50, 100, 200), tuple(10.0**k for k in range(2, -7, -1))
SVM_GAMMAS, SVM_CS = (0.25, 1.0, 4.0), (1.0, 10.0, 100.0)
"""Gamma, before division by the number of features."""


class Sides(NamedTuple):
    """Inputs `(example, ...)` and labels `(example,)` for training, validation and test."""

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray
    y_train: np.ndarray
    y_validation: np.ndarray
    y_test: np.ndarray


class Candidate(NamedTuple):
    """A description, the fitted classifier, and the layers of its decision."""

    settings: str
    fitted: Any
    layers: tuple[Layer, ...]


Family = Callable[[Sides, int], Iterator[Candidate]]


def logistic_regression(sides: Sides, seed: int = 0) -> Iterator[Candidate]:
    """One logistic regression; nothing is chosen."""
    fitted = fit_linear(sides.train, sides.y_train)
    yield Candidate("C 1", fitted, (flops.Dense(sides.train.shape[1], len(np.unique(sides.y_train))),))


def elm(sides: Sides, seed: int) -> Iterator[Candidate]:
    """Sigmoid ELMs, each with the penalty of the best validation accuracy (ties: the strongest)."""
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    for hidden in ELM_HIDDEN:
        network = ELMClassifier(hidden, alpha=ELM_ALPHAS[0], random_state=seed).fit(sides.train, sides.y_train)
        alpha = ELM_ALPHAS[int(network.accuracy_path(ELM_ALPHAS, sides.validation, sides.y_validation).argmax())]
        fitted = ELMClassifier(hidden, alpha=alpha, random_state=seed).fit(sides.train, sides.y_train)
        layers = (flops.Dense(n_features, hidden, "sigmoid"), flops.Dense(hidden, n_classes, bias=False))
        yield Candidate(f"N {hidden}, alpha {alpha:g}", fitted, layers)


def svm(sides: Sides, seed: int) -> Iterator[Candidate]:
    """RBF support vector machines, one against one, with shared support vectors."""
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    fits = [
        (gamma, c, SVC(C=c, gamma=gamma / n_features).fit(sides.train, sides.y_train))
        for gamma in SVM_GAMMAS
        for c in SVM_CS
    ]
    for gamma, c, fitted in sorted(fits, key=lambda fit: int(fit[2].n_support_.sum())):
        vectors = int(fitted.n_support_.sum())
        layer = flops.SupportVectorMachines(vectors, n_features, n_classes)
        yield Candidate(f"C {c:g}, gamma {gamma:g}/{n_features}, {vectors} vectors", fitted, (layer,))


def best_of(family: Family, sides: Sides, seed: int) -> Candidate:
    """The candidate with the highest validation accuracy (ties: the first); test examples are not used."""
    return max(family(sides, seed), key=lambda candidate: accuracy(candidate, sides.validation, sides.y_validation))


def accuracy(candidate: Candidate, x: np.ndarray, y: np.ndarray) -> float:
    """Share of correct decisions."""
    return float((candidate.fitted.predict(x) == y).mean())
