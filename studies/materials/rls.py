"""Regularised least squares in the space of an RBF kernel."""

from collections.abc import Iterator

import numpy as np
from neurotact_parts.opponents import rounding
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from neurotact_parts.opponents.targets import MachinesMixin, encode, signed
from numpy.typing import ArrayLike
from scipy import linalg
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics.pairwise import rbf_kernel

from neurotact.baselines.opponent import Opponent, Settings, Sides
from neurotact.checks import at_least
from neurotact.estimators import further_examples, training_examples
from neurotact.metrics.flops import Layer


class RLSClassifier(MachinesMixin, ClassifierMixin, BaseEstimator):
    """Regularised least squares with the kernel `exp(-||x - x'||² / (2 sigma²))`, one machine per class.

    Materials paper, Eqs. 1 and 2: `(K + alpha I) beta = t` with targets ±1; the largest output decides. It is solved in
    the eigenvectors of K, so `alpha = 0` and repeated examples are allowed. Scale the inputs beforehand.

    Parameters
    ----------
    alpha : L2 penalty (lambda in the paper).
    sigma : width of the kernel, in units of the inputs.

    Attributes
    ----------
    classes_ `(class,)`; X_fit_ `(example, feature)`, needed in full by predictions; dual_coef_ `(example, machine)`.

    Raises InputError for a single class and for parameters out of range.

    >>> X = np.array([[0.0], [0.2], [0.8], [1.0]])
    >>> RLSClassifier(sigma=0.5).fit(X, ["wood", "wood", "brass", "brass"]).predict([[0.1], [0.9]]).tolist()
    ['wood', 'brass']
    """

    def __init__(self, alpha: float = 1e-3, sigma: float = 1.0):
        self.alpha = alpha
        self.sigma = sigma

    def fit(self, X: ArrayLike, y: ArrayLike) -> "RLSClassifier":
        """Solve for the dual coefficients. X `(example, feature)`, y `(example,)`."""
        at_least("alpha", self.alpha, 0)
        at_least("sigma", self.sigma, 0, above=True)
        X, y = training_examples(self, X, y)
        self.classes_, indices = encode(y)
        self.X_fit_ = X
        values, vectors = linalg.eigh(self._kernel(X), check_finite=False)
        kept = values > np.finfo(float).eps * len(X) * values[-1]  # below, an eigenvalue is rounding
        self._eigenvalues, self._eigenvectors = values[kept], vectors[:, kept]
        self._projected = self._eigenvectors.T @ signed(indices, len(self.classes_))
        self.dual_coef_ = self._eigenvectors @ self._filtered([self.alpha])[0]
        return self

    def _outputs(self, X: ArrayLike) -> np.ndarray:
        return self._kernel(further_examples(self, X)) @ self.dual_coef_

    def decision_path(self, alphas: ArrayLike, X: ArrayLike) -> np.ndarray:
        """Outputs of this machine with each alpha, `(alpha, example, machine)`."""
        return (self._kernel(further_examples(self, X)) @ self._eigenvectors) @ self._filtered(alphas)

    def _kernel(self, X: np.ndarray) -> np.ndarray:
        return rbf_kernel(X, self.X_fit_, gamma=1 / (2 * self.sigma**2))

    def _filtered(self, alphas: ArrayLike) -> np.ndarray:
        gains = 1 / (self._eigenvalues + np.asarray(alphas, float)[:, None])
        return gains[:, :, None] * self._projected


SIGMAS, ALPHAS = (2.0, 1.0, 0.5), tuple(10.0**k for k in range(1, -7, -1))
"""Of `OPPONENT`; sigmas are multiplied by the root of the number of features."""


def _grid(sides: Sides, seed: int) -> Iterator[Settings]:
    """Of each width the penalty with the best validation accuracy, the strongest of equal ones."""
    for factor in SIGMAS:
        sigma = factor * sides.train.shape[1] ** 0.5
        machine = RLSClassifier(ALPHAS[0], sigma).fit(sides.train, sides.y_train)
        path = machine.accuracy_path(ALPHAS, sides.validation, sides.y_validation)
        yield {"sigma": sigma, "alpha": ALPHAS[int(path.argmax())]}


def _layers(fitted: RLSClassifier, x: np.ndarray) -> tuple[Layer, ...]:
    n_classes = len(fitted.classes_)
    return (RBFExpansion(*x.shape, outputs=1 if n_classes == 2 else n_classes),)


OPPONENT = Opponent(
    "Regularised least squares in the space of an RBF kernel.",
    RLSClassifier,
    _grid,
    layers=_layers,
    words=lambda fitted: f"sigma {fitted.sigma:.3g}, alpha {fitted.alpha:g}",
    rounded=rounding.weights,
    joins="named",
)
