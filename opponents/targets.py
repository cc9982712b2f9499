"""Class labels as indices and as the ±1 targets of one-vs-rest machines, and back."""

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.multiclass import check_classification_targets

from neurotact.errors import InputError


def encode(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(classes, indices)`: the sorted labels `(class,)` and the class index of each example `(example,)`.

    Raises InputError for a single class, and scikit-learn's ValueError for targets of a regression.

    >>> classes, indices = encode(np.array(["soft", "hard", "soft"]))
    >>> classes.tolist(), indices.tolist()
    (['hard', 'soft'], [1, 0, 1])
    """
    check_classification_targets(y)
    classes, indices = np.unique(y, return_inverse=True)
    if len(classes) < 2:
        raise InputError(f"y: holds one class, '{classes[0]}', where a classifier needs two; add trials of another")
    return classes, indices


def indices_of(y: ArrayLike, classes: np.ndarray) -> np.ndarray:
    """The index of each label in the sorted `classes`; InputError names an unknown label.

    >>> indices_of(np.array(["soft"]), np.array(["hard", "soft"])).tolist()
    [1]
    """
    labels = np.asarray(y)
    unknown = labels[~np.isin(labels, classes)]
    if len(unknown):
        raise InputError(
            f"y: class '{unknown[0]}' was not among the training examples; validate on the classes of training"
        )
    return np.searchsorted(classes, labels)


def signed(indices: np.ndarray, n_classes: int) -> np.ndarray:
    """Targets `(example, machine)` of one-vs-rest: +1 for the machine's own class, -1 for the rest.

    Two classes need one machine, whose own class is the second: the other's scores are its negative.

    >>> signed(np.array([0, 2]), 3).tolist()
    [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]]
    >>> signed(np.array([0, 1]), 2).tolist()
    [[-1.0], [1.0]]
    """
    if n_classes == 2:
        return np.where(indices == 1, 1.0, -1.0)[:, None]
    return np.where(indices[:, None] == np.arange(n_classes), 1.0, -1.0)


def decide(scores: np.ndarray) -> np.ndarray:
    """Class indices `(..., example)` from the scores of the machines `(..., example, machine)`.

    >>> decide(np.array([[0.2, 0.5, -1.0]])).tolist(), decide(np.array([[-0.1], [0.1]])).tolist()
    ([1], [0, 1])
    """
    return (scores[..., 0] > 0).astype(np.intp) if scores.shape[-1] == 1 else scores.argmax(axis=-1)


class MachinesMixin:
    """What estimators of one machine per class share; a subclass has `classes_`, `_outputs` and `decision_path`."""

    classes_: np.ndarray

    def decision_function(self, X: ArrayLike) -> np.ndarray:
        """Outputs `(example, class)`; for two classes `(example,)`, positive for the second."""
        scores = self._outputs(X)
        return scores[:, 0] if scores.shape[1] == 1 else scores

    def predict(self, X: ArrayLike) -> np.ndarray:
        """Labels `(example,)`."""
        chosen = decide(self._outputs(X))
        return self.classes_[chosen]

    def accuracy_path(self, alphas: ArrayLike, X: ArrayLike, y: ArrayLike) -> np.ndarray:
        """Accuracy on (X, y) of this estimator if it were fitted with each penalty, `(alpha,)`.

        All use the decomposition of the fit, so a whole grid costs about as much as one alpha.

        >>> from neurotact_parts.opponents.elm import ELMClassifier
        >>> X, y = np.random.default_rng(0).normal(size=(40, 2)), np.arange(40) % 2
        >>> elm = ELMClassifier(random_state=0).fit(X, y)
        >>> bool(elm.accuracy_path([1e-3, 1.0], X, y)[0] == elm.score(X, y))
        True
        """
        return (decide(self.decision_path(alphas, X)) == indices_of(y, self.classes_)).mean(axis=1)

    def decision_path(self, alphas: ArrayLike, X: ArrayLike) -> np.ndarray:
        """Outputs with each penalty, `(alpha, example, machine)`."""
        raise NotImplementedError

    def _outputs(self, X: ArrayLike) -> np.ndarray:
        """Outputs `(example, machine)`."""
        raise NotImplementedError
