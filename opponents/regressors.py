"""The opponents that tell numbers and are fitted to features, which networks with a target are compared with."""

from dataclasses import replace
from functools import partial

import numpy as np
from neurotact_parts.opponents import rounding, scikit_learn
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from neurotact_parts.opponents.scikit_learn import SVM, Kernel, build, grid
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import Ridge
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.svm import SVR

from neurotact.baselines.opponent import Opponent
from neurotact.metrics.flops import Dense

PENALTIES = (1.0, 100.0, 0.01, 0.1, 10.0, 1000.0, 10_000.0)
"""The usual one first: it stands if none is better."""
MARGINS = (0.1, 0.01)
"""Errors that machines of standardised numbers leave unpunished."""


class RBFRegression(RegressorMixin, BaseEstimator):
    """RBF support vector regression, a machine for each number, with shared support vectors.

    C, gamma, epsilon : as of `SVR`. Attributes: X_fit_ `(vector, feature)`, dual_coef_ `(vector, target)`, intercept_.

    >>> X = np.linspace(-1, 1, 20)[:, None]
    >>> float(RBFRegression(C=100, gamma=1, epsilon=0.01).fit(X, X[:, 0] ** 2).predict([[0.5]])[0, 0].round(1))
    0.2
    """

    shared: Kernel | None = None

    def __init__(self, C: float = 1.0, gamma: float = 1.0, epsilon: float = 0.1):
        self.C = C
        self.gamma = gamma
        self.epsilon = epsilon

    def fit(self, X: np.ndarray, y: np.ndarray) -> "RBFRegression":
        """Fit on X `(example, feature)`, y `(example,)` or `(example, target)`."""
        kernel, self.shared = self.shared, None
        kernel = kernel if kernel is not None and kernel.train is X else Kernel(X, X[:1])
        among, _ = kernel.of(self.gamma)
        numbers = np.asarray(y, float).reshape(len(X), -1)
        machines = [SVR(kernel="precomputed", C=self.C, epsilon=self.epsilon).fit(among, each) for each in numbers.T]
        every = np.zeros(numbers.shape)
        for place, machine in enumerate(machines):
            every[machine.support_, place] = machine.dual_coef_[0]
        used = every.any(axis=1)
        self.X_fit_, self.dual_coef_ = X[used], every[used]
        self.intercept_ = np.concatenate([machine.intercept_ for machine in machines])
        self.n_support_, self.n_features_in_ = used.sum(), X.shape[1]
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Numbers `(example, target)`."""
        return rbf_kernel(X, self.X_fit_, gamma=self.gamma) @ self.dual_coef_ + self.intercept_


RIDGE = Opponent(
    "Ridge regression with one of several penalties; all cost the same.",
    Ridge,
    [{"alpha": alpha} for alpha in PENALTIES],
    layers=lambda fitted, x: (Dense(x.shape[1], len(np.atleast_2d(fitted.coef_))),),
    rounded=rounding.weights,
    joins="linear",
    tells="numbers",
)
SUPPORT_VECTORS = replace(
    SVM,
    about="RBF support vector regression, a machine for each number, with shared support vectors.",
    build=partial(build, RBFRegression),
    grid=partial(grid, RBFRegression, [{"epsilon": epsilon} for epsilon in MARGINS]),
    layers=lambda fitted, x: (RBFExpansion(*fitted.X_fit_.shape, outputs=len(fitted.intercept_), bias=True),),
    rounded=rounding.weights,
    tells="numbers",
)
EXTRA_TREES = replace(scikit_learn.EXTRA_TREES, build=ExtraTreesRegressor, tells="numbers")
