"""The opponents that ship, sized on validation examples, and the cost of a decision of each.

MiniRocket has one candidate, of the published size: it costs seconds to fit, and a smaller one loses up to 2 points.
Features and sequences are standardised on training examples.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import SVC

from neurotact.baselines import minirocket as rocket
from neurotact.baselines.elm import ELMClassifier
from neurotact.baselines.opponent import Opponent, Settings, Sides
from neurotact.baselines.pooled_gru import GRU, PooledGRUClassifier, PooledStates
from neurotact.metrics.flops import (
    Cost,
    Dense,
    Layer,
    NearestPoints,
    Standardise,
    SupportVectorMachines,
    passed,
    with_weights,
)
from neurotact.metrics.linear import linear

LINEAR_CS = (1.0, 0.01, 0.1, 10.0, 100.0)
"""Inverse penalties, the usual one first: it stands if none is better."""
TREES, LEAVES = 200, (3, 1)
"""Trees of a forest, and the least number of examples in a leaf."""
GRU_HIDDEN = (64, 128)
ELM_HIDDEN, ELM_ALPHAS = (25, 50, 100, 200), tuple(10.0**k for k in range(2, -7, -1))
SVM_GAMMAS, SVM_CS = (0.0625, 0.25, 1.0, 4.0), (1.0, 10.0, 100.0)
"""Gamma, before division by the number of features."""
MOST_MACHINES = 10_000
"""Training examples up to which support vector machines are fitted: their time grows with the square of the number."""


def standardised(sequences: np.ndarray, labels: np.ndarray, sides: Sequence[np.ndarray]) -> Sides:
    """Sequences `(example, time, channel)` of each side, each channel standardised on the training side.

    sides: indices or booleans that select the examples of training, validation and test.
    """
    training = sequences[sides[0]]
    offset, scale = training.mean(axis=(0, 1)), training.std(axis=(0, 1))
    standard = (sequences - offset) / np.where(scale > 0, scale, 1.0)
    return Sides(*(standard[side] for side in sides), *(labels[side] for side in sides))


LOGISTIC_REGRESSION = Opponent(
    "Logistic regression with one of several penalties; all cost the same.",
    linear,
    [{"C": c} for c in LINEAR_CS],
    layers=lambda fitted, x: (Dense(x.shape[1], len(fitted.classes_)),),
    joins="linear",
)


def _svm_grid(sides: Sides, seed: int) -> Iterator[Settings]:
    n_features = sides.train.shape[1]
    yield from ({"C": c, "gamma": gamma / n_features} for gamma in SVM_GAMMAS for c in SVM_CS)


def _svm_words(fitted: SVC) -> str:
    n, vectors = fitted.n_features_in_, int(fitted.n_support_.sum())
    return f"C {fitted.C:g}, gamma {n * fitted.gamma:g}/{n}, {vectors} vectors"


def _svm_layers(fitted: SVC, x: np.ndarray) -> tuple[Layer, ...]:
    return (SupportVectorMachines(int(fitted.n_support_.sum()), x.shape[1], len(fitted.classes_)),)


SVM = Opponent(
    "RBF support vector machines, one against one, with shared support vectors.",
    SVC,
    _svm_grid,
    layers=_svm_layers,
    words=_svm_words,
    is_ordered=False,
    most_examples=MOST_MACHINES,
)


def _elm_grid(sides: Sides, seed: int) -> Iterator[Settings]:
    """Of each size the penalty of the best validation accuracy (ties: the strongest), by one decomposition for all."""
    for hidden in ELM_HIDDEN:
        network = ELMClassifier(hidden, alpha=ELM_ALPHAS[0], random_state=seed).fit(sides.train, sides.y_train)
        path = network.accuracy_path(ELM_ALPHAS, sides.validation, sides.y_validation)
        yield {"hidden": hidden, "alpha": ELM_ALPHAS[int(path.argmax())]}


def _elm_layers(fitted: ELMClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    return Dense(x.shape[1], fitted.hidden, "sigmoid"), Dense(fitted.hidden, len(fitted.classes_), bias=False)


ELM = Opponent(
    "Extreme learning machines with sigmoids.",
    ELMClassifier,
    _elm_grid,
    layers=_elm_layers,
    words=lambda fitted: f"N {fitted.hidden}, alpha {fitted.alpha:g}",
)


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
        moved = {"weights_accesses": 3 * compared + sums, **passed(compared, self.classes)}  # feature, threshold, child
        return with_weights(parameters, acs=sums, comparisons=compared, **moved)


def mean_depth(forest: ExtraTreesClassifier, features: np.ndarray) -> float:
    """Comparisons from the root to a leaf, a mean over trees and examples `(example, feature)`."""
    checked = features.astype(np.float32)  # as trees hold them, once for all
    paths = (tree.decision_path(checked, check_input=False) for tree in forest.estimators_)
    return float(np.mean([path.getnnz() / len(features) - 1 for path in paths]))


def _trees_layers(fitted: ExtraTreesClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    n_nodes = sum(tree.tree_.node_count for tree in fitted.estimators_)
    return (Trees(len(fitted.estimators_), mean_depth(fitted, x), n_nodes, len(fitted.classes_)),)


EXTRA_TREES = Opponent(
    "Forests of extremely randomised trees (Geurts et al. 2006).",
    ExtraTreesClassifier,
    lambda sides, seed: [{"n_estimators": TREES, "min_samples_leaf": leaf} for leaf in LEAVES],
    layers=_trees_layers,
    words=lambda fitted: f"{fitted.n_estimators} trees, leaves of {fitted.min_samples_leaf}",
)


def _minirocket_layers(fitted: rocket.MiniRocketClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    _, n_steps, n_channels = x.shape
    convolutions = fitted.transform_.convolutions_
    made = rocket.FixedConvolutions(
        n_steps,
        n_channels,
        dilations=len({one.dilation for one in convolutions}),
        convolved=sum(len(one.channels) for one in convolutions),
        biases=sum(len(one.biases) for one in convolutions),
    )
    return made, Standardise(fitted.features), Dense(fitted.features, len(fitted.classes_))


MINIROCKET = Opponent(
    "MiniRocket of the published size.",
    rocket.MiniRocketClassifier,
    lambda sides, seed: [{"features": rocket.FEATURES}],
    "signals",
    _minirocket_layers,
    lambda fitted: f"{fitted.features} features",
    least_steps=rocket.KERNEL,
)


def _gru_layers(fitted: PooledGRUClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    (_, n_steps, n_channels), hidden = x.shape, fitted.hidden
    states = GRU(n_channels, hidden, n_steps), PooledStates(hidden, n_steps)
    return *states, Dense(2 * hidden, len(fitted.classes_), "softmax")


POOLED_GRU = Opponent(
    "GRUs of two sizes by a modern recipe.",
    PooledGRUClassifier,
    lambda sides, seed: [{"hidden": hidden} for hidden in GRU_HIDDEN],
    "sequences",
    _gru_layers,
    lambda fitted: f"N {fitted.hidden}, {fitted.epochs_} epochs",
    joins="all",
)


KNN = Opponent(
    "The nearest training examples.",
    KNeighborsClassifier,
    [{"n_neighbors": k} for k in (1, 3, 5, 9)],
    layers=lambda fitted, x: (NearestPoints(len(x), x.shape[1], fitted.n_neighbors),),
    words=lambda fitted: f"k {fitted.n_neighbors}",
    joins="named",
)
