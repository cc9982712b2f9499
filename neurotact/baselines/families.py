"""Families of classifiers sized on validation examples: the candidates of each, and the cost of a decision.

MiniRocket has one candidate, of the published size: it costs seconds to fit, and a smaller one loses up to 2 points.
Features and sequences are standardised on training examples. A family yields its candidates from the cheapest on; ties
in validation accuracy: the first.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.svm import SVC

from neurotact.baselines import minirocket as rocket
from neurotact.baselines.elm import ELMClassifier
from neurotact.baselines.pooled_gru import GRU, PooledGRUClassifier, PooledStates
from neurotact.metrics import flops
from neurotact.metrics.flops import BYTES, Cost, Layer
from neurotact.metrics.linear import fit_linear

T = TypeVar("T")
LINEAR_CS = (1.0, 0.01, 0.1, 10.0, 100.0)
"""Inverse penalties, the usual one first: it stands if none is better."""
TREES, LEAVES = 200, (3, 1)
"""Trees of a forest, and the least number of examples in a leaf."""
GRU_HIDDEN = (64, 128)
ELM_HIDDEN, ELM_ALPHAS = (25, 50, 100, 200), tuple(10.0**k for k in range(2, -7, -1))
SVM_GAMMAS, SVM_CS = (0.0625, 0.25, 1.0, 4.0), (1.0, 10.0, 100.0)
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
    """A description, the fitted classifier, and the layers of its decision.

    again: fits the same settings to other sides; None of families that are not fitted again after the choice.
    """

    settings: str
    fitted: Any
    layers: tuple[Layer, ...]
    again: "Callable[[Sides], Candidate] | None" = None


Family = Callable[[Sides, int], Iterator[Candidate]]


def _refittable(fit: Callable[[Sides], Candidate], sides: Sides) -> Candidate:
    """The candidate that `fit` makes of these sides, and can make of others."""
    return fit(sides)._replace(again=fit)


def logistic_regression(sides: Sides, seed: int = 0) -> Iterator[Candidate]:
    """Logistic regressions with several penalties; all cost the same."""
    for c in LINEAR_CS:
        yield _refittable(partial(_logistic_regression, c=c), sides)


def _logistic_regression(sides: Sides, c: float) -> Candidate:
    layer = flops.Dense(sides.train.shape[1], len(np.unique(sides.y_train)))
    return Candidate(f"C {c:g}", fit_linear(sides.train, sides.y_train, c), (layer,))


def elm(sides: Sides, seed: int) -> Iterator[Candidate]:
    """Sigmoid ELMs, each with the penalty of the best validation accuracy (ties: the strongest)."""
    for hidden in ELM_HIDDEN:
        network = ELMClassifier(hidden, alpha=ELM_ALPHAS[0], random_state=seed).fit(sides.train, sides.y_train)
        alpha = ELM_ALPHAS[int(network.accuracy_path(ELM_ALPHAS, sides.validation, sides.y_validation).argmax())]
        yield _refittable(partial(_elm, hidden=hidden, alpha=alpha, seed=seed), sides)


def _elm(sides: Sides, hidden: int, alpha: float, seed: int) -> Candidate:
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    fitted = ELMClassifier(hidden, alpha=alpha, random_state=seed).fit(sides.train, sides.y_train)
    layers = (flops.Dense(n_features, hidden, "sigmoid"), flops.Dense(hidden, n_classes, bias=False))
    return Candidate(f"N {hidden}, alpha {alpha:g}", fitted, layers)


def svm(sides: Sides, seed: int) -> Iterator[Candidate]:
    """RBF support vector machines, one against one, with shared support vectors."""
    machines = [_refittable(partial(_svm, gamma=gamma, c=c), sides) for gamma in SVM_GAMMAS for c in SVM_CS]
    yield from sorted(machines, key=lambda machine: int(machine.fitted.n_support_.sum()))


def _svm(sides: Sides, gamma: float, c: float) -> Candidate:
    n_features, n_classes = sides.train.shape[1], len(np.unique(sides.y_train))
    fitted = SVC(C=c, gamma=gamma / n_features).fit(sides.train, sides.y_train)
    vectors = int(fitted.n_support_.sum())
    layer = flops.SupportVectorMachines(vectors, n_features, n_classes)
    return Candidate(f"C {c:g}, gamma {gamma:g}/{n_features}, {vectors} vectors", fitted, (layer,))


def extra_trees(sides: Sides, seed: int) -> Iterator[Candidate]:
    """Forests of extremely randomised trees (Geurts et al. 2006)."""
    for leaf in LEAVES:
        yield _refittable(partial(_extra_trees, leaf=leaf, seed=seed), sides)


def _extra_trees(sides: Sides, leaf: int, seed: int) -> Candidate:
    forest = ExtraTreesClassifier(TREES, min_samples_leaf=leaf, random_state=seed)
    fitted = forest.fit(sides.train, sides.y_train)
    n_nodes = sum(tree.tree_.node_count for tree in fitted.estimators_)
    layer = Trees(TREES, mean_depth(fitted, sides.train), n_nodes, len(np.unique(sides.y_train)))
    return Candidate(f"{TREES} trees, leaves of {leaf}", fitted, (layer,))


def mean_depth(forest: ExtraTreesClassifier, features: np.ndarray) -> float:
    """Comparisons from the root to a leaf, a mean over trees and examples `(example, feature)`."""
    checked = features.astype(np.float32)  # as trees hold them, once for all
    paths = (tree.decision_path(checked, check_input=False) for tree in forest.estimators_)
    return float(np.mean([path.getnnz() / len(features) - 1 for path in paths]))


def minirocket(sides: Sides, seed: int) -> Iterator[Candidate]:
    """MiniRocket of the published size, on sequences `(example, time, channel)` of at least nine steps."""
    yield _refittable(partial(_minirocket, features=rocket.FEATURES, seed=seed), sides)


def _minirocket(sides: Sides, features: int, seed: int) -> Candidate:
    _, n_steps, n_channels = sides.train.shape
    fitted = rocket.MiniRocketClassifier(features, seed).fit(sides.train, sides.y_train)
    convolutions = fitted.transform_.convolutions_
    made = rocket.FixedConvolutions(
        n_steps,
        n_channels,
        dilations=len({one.dilation for one in convolutions}),
        convolved=sum(len(one.channels) for one in convolutions),
        biases=sum(len(one.biases) for one in convolutions),
    )
    dense = flops.Dense(features, len(fitted.classes_))
    return Candidate(f"{features} features", fitted, (made, flops.Standardise(features), dense))


def pooled_gru(sides: Sides, seed: int) -> Iterator[Candidate]:
    """GRUs of two sizes by a modern recipe, on sequences `(example, time, channel)`."""
    for hidden in GRU_HIDDEN:
        yield _refittable(partial(_pooled_gru, hidden=hidden, seed=seed), sides)


def _pooled_gru(sides: Sides, hidden: int, seed: int) -> Candidate:
    _, n_steps, n_channels = sides.train.shape
    network = PooledGRUClassifier(hidden, random_state=seed)
    fitted = network.fit(sides.train, sides.y_train, validation=(sides.validation, sides.y_validation))
    layers = (
        GRU(n_channels, hidden, n_steps),
        PooledStates(hidden, n_steps),
        flops.Dense(2 * hidden, len(fitted.classes_), "softmax"),
    )
    return Candidate(f"N {hidden}, {fitted.epochs_} epochs", fitted, layers)


def standardised(sequences: np.ndarray, labels: np.ndarray, sides: Sequence[np.ndarray]) -> Sides:
    """Sequences `(example, time, channel)` of each side, each channel standardised on the training side.

    sides: indices or booleans that select the examples of training, validation and test.
    """
    training = sequences[sides[0]]
    offset, scale = training.mean(axis=(0, 1)), training.std(axis=(0, 1))
    standard = (sequences - offset) / np.where(scale > 0, scale, 1.0)
    return Sides(*(standard[side] for side in sides), *(labels[side] for side in sides))


MACHINES, MOST_MACHINES = "SVM", 10_000
"""Training examples up to which support vector machines are fitted: their time grows with the square of the number."""
ON_FEATURES: dict[str, Family] = {
    "logistic regression": logistic_regression,
    MACHINES: svm,
    "ELM": elm,
    "extra trees": extra_trees,
}
"""The families on features, by their name."""


def best_of(family: Family, sides: Sides, seed: int) -> Candidate:
    """The candidate with the highest validation accuracy (ties: the first); test examples are not used."""
    return first_best((accuracy(one, sides.validation, sides.y_validation), one) for one in family(sides, seed))[1]


def refitted(chosen: Candidate, sides: Sides) -> Candidate:
    """The chosen candidate fitted to other sides."""
    assert chosen.again is not None, f"{chosen.settings}: this family is not fitted again"
    return chosen.again(sides)


def first_best(scored: Iterable[tuple[float, T]]) -> tuple[float, T]:
    """The first of the highest accuracy; after one of 1 no other is asked for, as none can be better.

    scored: `(accuracy, what has it)`, at least one.

    >>> first_best(iter([(0.5, "a"), (0.9, "b"), (0.9, "c")]))
    (0.9, 'b')
    """
    remaining = iter(scored)
    best = next(remaining)
    while best[0] < 1 and (following := next(remaining, None)) is not None:
        best = following if following[0] > best[0] else best
    return best


def accuracy(candidate: Candidate, x: np.ndarray, y: np.ndarray) -> float:
    """Share of correct decisions."""
    return float((candidate.fitted.predict(x) == y).mean())


@dataclass(frozen=True)
class Trees(Layer):
    """A forest of `trees` decision trees: `depth` comparisons a tree on average, then the shares of classes are added.

    nodes: of all trees; an inner one holds a feature and a threshold, a leaf the shares of the classes.
    """

    trees: int
    depth: float
    nodes: int
    classes: int

    def cost(self) -> Cost:
        parameters = self.nodes * (2 + self.classes) // 2
        sums, compared = self.trees * self.classes, self.trees * self.depth
        return Cost(acs=sums, comparisons=compared, parameters=parameters, bytes=BYTES * parameters)
