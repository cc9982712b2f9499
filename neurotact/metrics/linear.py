"""The linear classifier that accuracies are set beside."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler


def fit_linear(features: np.ndarray, labels: np.ndarray) -> Pipeline:
    """Logistic regression on features `(window, feature)`, standardised on the same windows.

    >>> fit_linear(np.array([[0.0], [1.0], [5.0], [6.0]]), np.array([0, 0, 1, 1])).predict([[0.5], [7.0]]).tolist()
    [0, 1]
    """
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of features that tell nothing apart
        return model.fit(features, labels)
