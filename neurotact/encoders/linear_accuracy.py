"""How well spike rates tell classes apart: what a linear classifier makes of them, in cross-validation."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

MOST_FOLDS = 5


def linear_accuracy(rates: np.ndarray, labels: np.ndarray) -> float:
    """The share of trials that logistic regression names right from the rates of all afferents.

    rates: spikes per second, `(trial, afferent)`. labels: class of each trial.
    Stratified folds, five or as many as the smallest class has trials; NaN where it has one.

    >>> rates = np.array([[1.0], [2.0], [1.5], [8.0], [9.0], [7.0]])
    >>> linear_accuracy(rates, np.array([0, 0, 0, 1, 1, 1]))
    1.0
    """
    n_folds = min(MOST_FOLDS, int(np.unique(labels, return_counts=True)[1].min()))
    if n_folds < 2:
        return float("nan")
    folds = StratifiedKFold(n_folds, shuffle=True, random_state=0)
    classifier = make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return float(np.mean(cross_val_predict(classifier, rates, labels, cv=folds) == labels))


def error_of(accuracy: float, n_trials: int) -> float:
    """The standard error of a share of so many trials.

    >>> error_of(0.5, 100)
    0.05
    """
    return float(np.sqrt(accuracy * (1 - accuracy) / n_trials))
