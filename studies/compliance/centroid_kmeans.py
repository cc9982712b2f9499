"""k-means with one centroid per class."""

import warnings
from typing import Literal

import numpy as np
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.targets import encode, indices_of
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import pairwise_distances_argmin
from sklearn.utils import check_random_state

from neurotact.baselines.opponent import Opponent
from neurotact.checks import at_least, one_of
from neurotact.estimators import further_examples, training_examples
from neurotact.metrics.flops import NearestPoints

Init = Literal["k-means++", "class-mean"]


class ClassCentroidKMeans(ClassifierMixin, BaseEstimator):
    """As many centroids as classes, found without labels; then each is assigned a class, one to one.

    Compliance paper, Sec. 3.5. The classes are assigned so that most training examples lie nearest the centroid of
    their own class. Of the repetitions, the one with the least inertia is kept or, if `fit` is given a validation set,
    the one with the highest accuracy there (ties: the least inertia). The paper chose it on the test set, which is
    optimistic: give that set to `fit` only to reproduce the paper.

    Parameters
    ----------
    init : "k-means++", or "class-mean": start at the means of the training classes, a single repetition.
    repetitions : number of starts; the paper draws 100.
    max_iter : iterations of Lloyd's algorithm per repetition.
    random_state : seed or RandomState of the starts.

    Attributes
    ----------
    classes_ `(class,)`; centroids_ `(class, feature)`; inertia_; n_iter_ of the repetition that was kept.

    Raises InputError for a single class and for parameters out of range.

    >>> X = np.array([[0.0], [0.2], [0.8], [1.0]])
    >>> fitted = ClassCentroidKMeans(repetitions=5, random_state=0).fit(X, ["egg", "egg", "can", "can"])
    >>> fitted.predict([[0.1], [0.9]]).tolist(), fitted.centroids_.round(3).tolist()
    (['egg', 'can'], [[0.9], [0.1]])
    """

    def __init__(
        self,
        init: Init = "k-means++",
        repetitions: int = 10,
        max_iter: int = 300,
        random_state: int | np.random.RandomState | None = None,
    ):
        self.init = init
        self.repetitions = repetitions
        self.max_iter = max_iter
        self.random_state = random_state

    def fit(
        self, X: ArrayLike, y: ArrayLike, validation: tuple[ArrayLike, ArrayLike] | None = None
    ) -> "ClassCentroidKMeans":
        """Cluster X `(example, feature)`, assign the classes of y `(example,)`, keep the best repetition.

        validation: `(X, y)` for the choice of the repetition; when absent, the least inertia is chosen.
        """
        one_of("init", self.init, ("k-means++", "class-mean"))
        at_least("repetitions", self.repetitions, 1, whole=True)
        at_least("max_iter", self.max_iter, 1, whole=True)
        X, y = training_examples(self, X, y)
        self.classes_, indices = encode(y)
        best, new, truth = None, X[:0], indices[:0]
        if validation is not None:
            new, truth = further_examples(self, validation[0]), indices_of(validation[1], self.classes_)
        for clustered in self._repetitions(X, indices):
            centroids = clustered.cluster_centers_[_class_order(clustered.labels_, indices)]
            right = int((pairwise_distances_argmin(new, centroids) == truth).sum()) if len(new) else 0
            if best is None or (right, -clustered.inertia_) > best:
                best = (right, -clustered.inertia_)
                self.centroids_, self.inertia_ = centroids, float(clustered.inertia_)
                self.n_iter_ = clustered.n_iter_
        return self

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Labels `(example,)`: the class of the nearest centroid."""
        X = further_examples(self, X)
        return self.classes_[pairwise_distances_argmin(X, self.centroids_)]

    def _repetitions(self, X: np.ndarray, indices: np.ndarray):
        rng = check_random_state(self.random_state)
        n_classes = len(self.classes_)
        means = np.stack([X[indices == c].mean(axis=0) for c in range(n_classes)])
        starts = [means] if self.init == "class-mean" else ["k-means++"] * self.repetitions
        for start in starts:
            kmeans = KMeans(n_classes, init=start, n_init=1, max_iter=self.max_iter, random_state=rng)
            with warnings.catch_warnings():
                # Coarsely quantised features may hold fewer distinct vectors than classes: centroids then coincide.
                warnings.simplefilter("ignore", ConvergenceWarning)
                kmeans.fit(X)
            yield kmeans


def _class_order(clusters: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """The cluster of each class, one to one, with as many examples as possible in their class's cluster, `(class,)`."""
    n_classes = indices.max() + 1
    counts = np.zeros((n_classes, n_classes), int)
    np.add.at(counts, (indices, clusters), 1)
    return linear_sum_assignment(counts, maximize=True)[1]


OPPONENT = Opponent(
    "One centroid per class, from the class means or from k-means++.",
    ClassCentroidKMeans,
    [{"init": "class-mean", "repetitions": 1}, {"init": "k-means++", "repetitions": 20}],
    layers=lambda fitted, x: (NearestPoints(len(fitted.classes_), x.shape[1]),),
    words=lambda fitted: fitted.init,
    rounded=rounding.weights,
    joins="named",
)
