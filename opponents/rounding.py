"""Fitted opponents with whole numbers for weights, so that they are as narrow as a network in C.

Weights, support vectors, examples, thresholds and shares of classes have the given bits, with a step for each matrix;
biases have twice as many. Standardisation, sums, states and activations are not rounded.
"""

import copy
from typing import Any

import numpy as np
import torch
from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline
from sklearn.svm import SVC

from neurotact.baselines.opponent import rounded

BIASES = {"intercept_", "hidden_biases_", "biases_"}
WEIGHTS = {"coef_", "hidden_weights_", "input_weights_", "recurrent_weights_", "centroids_", "X_fit_", "dual_coef_"}


def weights(fitted: Any, x: np.ndarray, bits: int) -> Any:
    """A copy of an estimator with its learned `WEIGHTS` and `BIASES` rounded.

    >>> from neurotact_parts.opponents.elm import ELMClassifier
    >>> X, y = np.random.default_rng(0).normal(size=(40, 2)), np.arange(40) % 2
    >>> elm = ELMClassifier(hidden=50, random_state=0).fit(X, y)
    >>> len(np.unique(weights(elm, X, bits=3).hidden_weights_)), len(np.unique(elm.hidden_weights_))
    (7, 100)
    """
    narrow = copy.copy(fitted)
    for name, value in vars(fitted).items():
        if name in WEIGHTS | BIASES:
            setattr(narrow, name, rounded(value, bits if name in WEIGHTS else 2 * bits))
    return narrow


def last_step(fitted: Pipeline, x: np.ndarray, bits: int) -> Pipeline:
    """The same of a pipeline's classifier; what standardises its features is kept."""
    return Pipeline([*fitted.steps[:-1], (fitted.steps[-1][0], weights(fitted[-1], x, bits))])


def machines(fitted: SVC, x: np.ndarray, bits: int) -> SVC:
    """Support vector machines with rounded vectors, coefficients and biases, which libsvm reads from private names."""
    narrow = copy.copy(fitted)
    narrow.support_vectors_ = rounded(fitted.support_vectors_, bits)
    narrow._dual_coef_ = rounded(fitted._dual_coef_, bits)
    narrow._intercept_ = rounded(fitted._intercept_, 2 * bits)
    return narrow


def forest(fitted: Any, x: np.ndarray, bits: int) -> ExtraTreesClassifier | ExtraTreesRegressor:
    """A forest whose trees have rounded thresholds, in one step for all, and shares of classes or numbers."""
    narrow = copy.deepcopy(fitted)
    trees = [tree.tree_ for tree in narrow.estimators_]
    inner = [tree.children_left >= 0 for tree in trees]
    every = np.concatenate([tree.threshold[own] for tree, own in zip(trees, inner, strict=True)])
    shares = isinstance(fitted, ExtraTreesClassifier)
    told = 1.0 if shares else np.concatenate([tree.value for tree in trees])
    for tree, own in zip(trees, inner, strict=True):
        tree.threshold[own] = rounded(tree.threshold[own], bits, of=every)
        tree.value[:] = rounded(tree.value, bits, of=told)
    return narrow


def examples(fitted: KNeighborsClassifier, x: np.ndarray, bits: int) -> KNeighborsClassifier:
    """Neighbours among rounded training examples."""
    return KNeighborsClassifier(**fitted.get_params()).fit(rounded(x, bits), fitted.classes_[fitted._y])


def module(fitted: Any, x: np.ndarray, bits: int) -> Any:
    """A copy of an estimator whose torch module, `network_`, has rounded matrices and biases."""
    narrow = copy.deepcopy(fitted)
    with torch.no_grad():
        for own in narrow.network_.parameters():
            own.copy_(torch.from_numpy(rounded(own.numpy(), bits if own.ndim > 1 else 2 * bits)))
    return narrow
