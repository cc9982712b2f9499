"""The linear classifier that accuracies are compared with."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold, StratifiedKFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

MOST_FOLDS = 5


def linear(C: float = 1.0) -> Pipeline:
    """Logistic regression on standardised features, not yet fitted; C: inverse penalty."""
    return make_pipeline(StandardScaler(), LogisticRegression(C=C, max_iter=2000))


def cross_validated_accuracy(features: np.ndarray, labels: np.ndarray, groups: np.ndarray | None = None) -> float:
    """The cross-validated accuracy of logistic regression.

    features: `(trial, feature)`. Stratified folds: five, or as many as the smallest class has trials; NaN if it has
    one. groups: `(trial,)`, if there are several, those of one group are tested by the trials of the others.

    >>> rates = np.array([[1.0], [2.0], [1.5], [8.0], [9.0], [7.0]])
    >>> cross_validated_accuracy(rates, np.array([0, 0, 0, 1, 1, 1]))
    1.0
    """
    n_folds = min(MOST_FOLDS, int(np.unique(labels, return_counts=True)[1].min()))
    if n_folds < 2:
        return float("nan")
    right = np.zeros(len(labels), bool)
    n_groups = 1 if groups is None else len(np.unique(groups))
    folds = (
        GroupKFold(min(MOST_FOLDS, n_groups)).split(features, labels, groups)
        if n_groups > 1
        else StratifiedKFold(n_folds, shuffle=True, random_state=0).split(features, labels)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # for features that carry no information
        for train, test in folds:
            if len(np.unique(labels[train])) > 1:
                right[test] = linear().fit(features[train], labels[train]).predict(features[test]) == labels[test]
    return float(right.mean())
