"""Regularised least squares, decomposed once and solved for a whole path of penalties."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg


class RidgePath(NamedTuple):
    """`min ||A w + b - t||² + alpha ||w||²` by the singular value decomposition of A.

    The normal equations would square the condition number of A, which for the hidden layer of an ELM exceeds the
    precision of float64. Directions whose singular value is lost in rounding are dropped, so `alpha = 0` gives the
    least-squares solution of least norm, and constant or repeated columns are allowed.
    """

    right: np.ndarray
    """Right singular vectors `(column, direction)`."""
    singular: np.ndarray
    """Singular values `(direction,)`, all above rounding."""
    projected: np.ndarray
    """Targets in the left singular vectors `(direction, output)`."""
    column_means: np.ndarray
    """`(column,)`; zero without an intercept."""
    target_means: np.ndarray
    """`(output,)`; zero without an intercept."""

    def filtered(self, alphas: ArrayLike) -> np.ndarray:
        """The solutions in the directions of `right`, `(alpha, direction, output)`."""
        alphas = np.asarray(alphas, float)[:, None]
        gains = self.singular / (self.singular**2 + alphas)
        return gains[:, :, None] * self.projected

    def outputs(self, A: np.ndarray, alphas: ArrayLike) -> np.ndarray:
        """`A w + b` for each alpha, `(alpha, row, output)`."""
        return ((A - self.column_means) @ self.right) @ self.filtered(alphas) + self.target_means

    def solution(self, alpha: float) -> tuple[np.ndarray, np.ndarray]:
        """Weights `(column, output)` and intercept `(output,)` for one alpha."""
        weights = self.right @ self.filtered([alpha])[0]
        return weights, self.target_means - self.column_means @ weights


def decompose(A: np.ndarray, targets: np.ndarray, *, intercept: bool) -> RidgePath:
    """Prepare the problem of A `(row, column)` and targets `(row, output)`; an intercept is not penalised.

    >>> A, t = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]), np.array([[3.0], [5.0], [7.0]])
    >>> weights, offset = decompose(A, t, intercept=True).solution(0.0)
    >>> weights.ravel().round(12).tolist(), offset.round(12).tolist()
    ([1.0, 1.0], [1.0])
    """
    column_means = A.mean(axis=0) if intercept else np.zeros(A.shape[1])
    target_means = targets.mean(axis=0) if intercept else np.zeros(targets.shape[1])
    left, singular, right = linalg.svd(A - column_means, full_matrices=False, check_finite=False)
    # Centring a constant column leaves the rounding of its mean, so the scale is that of A before centring.
    lost = np.finfo(float).eps * max(A.shape) * max(singular[0], np.abs(A).max())
    kept = singular > lost
    projected = left[:, kept].T @ (targets - target_means)
    return RidgePath(right[kept].T, singular[kept], projected, column_means, target_means)
