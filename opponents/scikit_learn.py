"""The opponents whose estimators are scikit-learn's, sized on validation examples, and the cost of each decision."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.kernel_machines import SupportVectorMachines
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import SVC

from neurotact.baselines.opponent import Opponent, Settings, Sides, part_of, right, say_once
from neurotact.metrics.flops import Cost, Dense, Layer, NearestPoints, passed, with_weights
from neurotact.metrics.linear import linear

LINEAR_CS = (1.0, 0.01, 0.1, 10.0, 100.0)
"""Inverse penalties, the usual one first: it stands if none is better."""
TREES, LEAVES = 200, (3, 1)
"""Trees of a forest, and the least number of examples in a leaf."""
SVM_GAMMAS, SVM_CS = (0.0625, 0.25, 1.0, 4.0), (1.0, 10.0, 100.0)
"""Gamma, before division by the number of features."""
MOST_MACHINES = 10_000
"""Training examples up to which support vector machines are fitted: their time grows with the square of the number."""
MOST_SEARCHED, FITTED = 2000, 3
"""Training examples on which C and gamma are searched, and how many of the settings are then fitted to all of them."""


def n_outputs(fitted: Any, x: np.ndarray) -> int:
    """Outputs of a linear classifier: one for each class, or for two classes one in all, whose sign decides."""
    return np.size(fitted.decision_function(x[:1]))


LOGISTIC_REGRESSION = Opponent(
    "Logistic regression with one of several penalties; all cost the same.",
    linear,
    [{"C": c} for c in LINEAR_CS],
    layers=lambda fitted, x: (Dense(x.shape[1], n_outputs(fitted, x)),),
    rounded=rounding.last_step,
    joins="linear",
)


class Kernel:
    """The RBF kernel of training examples `(example, feature)` with themselves and validation's, a gamma at a time."""

    def __init__(self, train: np.ndarray, validation: np.ndarray) -> None:
        self.train, self.validation = train, validation
        self.forget()

    def of(self, gamma: float) -> list[np.ndarray]:
        """`(training, training)` and `(validation, training)`, computed where gamma is another than before."""
        if gamma != self._gamma:
            self.forget()  # before another is computed
            self._gamma = gamma
            train, held = (x.astype(np.float64, copy=False) for x in (self.train, self.validation))
            self._values = [rbf_kernel(x, train, gamma=gamma) for x in (train, held)]
        return self._values

    def forget(self) -> None:
        """Free its memory."""
        self._gamma, self._values = 0.0, []


class RBFMachines(SVC):
    """`SVC` that may take its kernel from others of its gamma, as in a grid of C."""

    shared: Kernel | None = None
    _seen: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None  # validation, coefficients, what they say of it

    def fit(self, X: np.ndarray, y: np.ndarray) -> "RBFMachines":
        """As `SVC.fit`: with the shared kernel to the examples that it is of, and without it to others."""
        kernel, self.shared, self._seen = self.shared, None, None
        if kernel is None or kernel.train is not X:
            return super().fit(X, y)
        among, held = kernel.of(self.gamma)
        fitted = SVC(C=self.C, kernel="precomputed").fit(among, y)
        learned = {name: value for name, value in vars(fitted).items() if name not in fitted.get_params()}
        vectors = np.ascontiguousarray(X[fitted.support_], np.float64)
        self.__dict__.update(learned, support_vectors_=vectors, _gamma=self.gamma, n_features_in_=X.shape[1])
        self._seen = kernel.validation, self._dual_coef_, fitted.predict(held)
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        """As `SVC.predict`."""
        if self._seen is not None and self._seen[0] is X and self._seen[1] is self._dual_coef_:
            return self._seen[2]
        return super().predict(X)


def build(kind: type, shared: Kernel | None = None, **settings: Any) -> Any:
    """Machines that may share a kernel."""
    machines = kind(**settings)
    machines.shared = shared
    return machines


def grid(kind: type, beside: Sequence[Settings], sides: Sides, seed: int) -> Iterator[Settings]:
    """Settings of machines of a kind; beside: those beside C and gamma."""
    some, n_features = part_of(sides.y_train, MOST_SEARCHED), sides.train.shape[1]
    is_all = len(some) == len(sides.train)
    part = sides if is_all else sides._replace(train=sides.train[some], y_train=sides.y_train[some])
    kernel = Kernel(part.train, part.validation)
    pairs = [{"C": c, "gamma": gamma / n_features, "shared": kernel} for gamma in SVM_GAMMAS for c in SVM_CS]
    every = [{**pair, **more} for pair in pairs for more in beside]
    yield from every if is_all else _best_on(part, kind, every)
    kernel.forget()


def _best_on(part: Sides, kind: type, grid: Sequence[Settings]) -> Iterator[Settings]:
    """The settings that are most accurate on validation examples after a fit to a part of those of training.

    Of equal ones the first, of fewer support vectors.
    """
    say_once(
        f"baselines: C and gamma of support vector machines are searched on {len(part.train):,} training windows, "
        f"evenly over their labels; the best {FITTED} settings are fitted to all"
    )
    fitted = [build(kind, **settings).fit(part.train, part.y_train) for settings in grid]
    merits = [float(right(one.predict(part.validation), part.y_validation).mean()) for one in fitted]
    best = sorted(range(len(grid)), key=lambda n: (-merits[n], fitted[n].n_support_.sum()))
    yield from ({**grid[n], "shared": None} for n in best[:FITTED])


def _svm_words(fitted: Any) -> str:
    n, vectors = fitted.n_features_in_, int(fitted.n_support_.sum())
    return f"C {fitted.C:g}, gamma {n * fitted.gamma:g}/{n}, {vectors} vectors"


def _svm_layers(fitted: SVC, x: np.ndarray) -> tuple[Layer, ...]:
    return (SupportVectorMachines(int(fitted.n_support_.sum()), x.shape[1], len(fitted.classes_)),)


SVM = Opponent(
    "RBF support vector machines, one against one, with shared support vectors.",
    partial(build, RBFMachines),
    partial(grid, RBFMachines, [{}]),
    layers=_svm_layers,
    words=_svm_words,
    rounded=rounding.machines,
    is_ordered=False,
    most_examples=MOST_MACHINES,
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


def mean_depth(forest: ExtraTreesClassifier | ExtraTreesRegressor, features: np.ndarray) -> float:
    """Comparisons from the root to a leaf, a mean over trees and examples `(example, feature)`."""
    checked = features.astype(np.float32)  # as trees hold them, once for all
    paths = (tree.decision_path(checked, check_input=False) for tree in forest.estimators_)
    return float(np.mean([path.getnnz() / len(features) - 1 for path in paths]))


def _forest_layers(fitted: Any, x: np.ndarray) -> tuple[Layer, ...]:
    trees = [one.tree_ for one in fitted.estimators_]
    n_nodes, n_told = sum(tree.node_count for tree in trees), trees[0].value[0].size
    return (Trees(len(trees), mean_depth(fitted, x), n_nodes, n_told),)


EXTRA_TREES = Opponent(
    "Forests of extremely randomised trees (Geurts et al. 2006, doi 10.1007/s10994-006-6226-1).",
    ExtraTreesClassifier,
    lambda sides, seed: [{"n_estimators": TREES, "min_samples_leaf": leaf} for leaf in LEAVES],
    layers=_forest_layers,
    words=lambda fitted: f"{fitted.n_estimators} trees, leaves of {fitted.min_samples_leaf}",
    rounded=rounding.forest,
)


KNN = Opponent(
    "The nearest training examples.",
    KNeighborsClassifier,
    [{"n_neighbors": k} for k in (1, 3, 5, 9)],
    layers=lambda fitted, x: (NearestPoints(len(x), x.shape[1], fitted.n_neighbors),),
    words=lambda fitted: f"k {fitted.n_neighbors}",
    rounded=rounding.examples,
    joins="named",
)
