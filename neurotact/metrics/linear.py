"""The linear classifier that accuracies are compared with."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

FOLDS = 5


def linear(C: float = 1.0) -> Pipeline:
    """Logistic regression on standardised features, not yet fitted; C: inverse penalty."""
    return make_pipeline(StandardScaler(), LogisticRegression(C=C, max_iter=2000))


def cross_validated_accuracy(
    features: np.ndarray, labels: np.ndarray, groups: np.ndarray | None = None, order: np.ndarray | None = None
) -> float:
    """The cross-validated accuracy of logistic regression.

    features: `(trial, feature)`. Five stratified folds; NaN if a class has one trial. groups: `(trial,)`, if there are
    several, those of one group are tested by the trials of the others. order: numbers of the trials, `(trial,)`, by
    which they are dealt into folds, so that a trial that is left out moves few others; random if absent.

    >>> rates = np.array([[1.0], [2.0], [1.5], [8.0], [9.0], [7.0]])
    >>> cross_validated_accuracy(rates, np.array([0, 0, 0, 1, 1, 1]))
    1.0
    """
    if np.unique(labels, return_counts=True)[1].min() < 2:
        return float("nan")
    right = np.zeros(len(labels), bool)
    if groups is not None and len(names := np.unique(groups)) > 1:
        fold = np.searchsorted(names, groups) % FOLDS
    else:
        fold = folds_of(labels, np.random.default_rng(0).random(len(labels)) if order is None else order)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # for features that carry no information
        for test in (fold == one for one in np.unique(fold)):
            if len(np.unique(labels[~test])) > 1:
                right[test] = linear().fit(features[~test], labels[~test]).predict(features[test]) == labels[test]
    return float(right.mean())


def folds_of(labels: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The fold of each trial, `(trial,)`: equal shares of each class, in the order of the trials' numbers.

    >>> folds_of(np.array([0, 0, 0, 0, 0, 1, 1]), np.array([0.5, 0.1, 0.2, 0.9, 0.3, 0.7, 0.2])).tolist()
    [3, 0, 1, 4, 2, 2, 0]
    """
    fold = np.empty(len(labels), np.int64)
    for label in np.unique(labels):
        own = np.flatnonzero(labels == label)
        fold[own[np.argsort(order[own], kind="stable")]] = np.arange(len(own)) * FOLDS // len(own)
    return fold
