"""Confidence of a mean over random splits, which share examples, so that their accuracies are not independent."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from neurotact.errors import InputError


class Interval(NamedTuple):
    """A mean and its confidence interval."""

    mean: float
    low: float
    high: float


def resampled_interval(
    values: Sequence[float] | np.ndarray, n_train: int, n_test: int, level: float = 0.95
) -> Interval:
    """Confidence interval of a mean over random splits, by the corrected resampled t test.

    values: one per split, `(split,)`; n_train, n_test: examples on both sides of each.
    The variance of the mean is `s² (1/J + n_test/n_train)`; independent tests would have `s²/J` (Nadeau and
    Bengio 2003, Machine Learning 52:239). Raises InputError for fewer than two splits.

    >>> found = resampled_interval([0.8, 0.9, 0.7, 0.8], n_train=70, n_test=15)
    >>> round(found.mean, 3), round(found.low, 3), round(found.high, 3)
    (0.8, 0.623, 0.977)
    """
    mean, error = _mean_and_error(values, n_train, n_test)
    half = float(stats.t.ppf(0.5 + level / 2, len(values) - 1) * error)
    return Interval(mean, mean - half, mean + half)


def resampled_p(differences: Sequence[float] | np.ndarray, n_train: int, n_test: int) -> float:
    """The two-sided p-value of the mean difference of two classifiers over random splits, by the same test.

    differences: one per split, `(split,)`. If all are equal, 1 for zero and 0 for any other number.

    >>> round(resampled_p([0.1, 0.2, 0.1, 0.2], n_train=70, n_test=15), 3)
    0.032
    """
    mean, error = _mean_and_error(differences, n_train, n_test)
    if error == 0:
        return float(mean == 0)
    return float(2 * stats.t.sf(abs(mean) / error, len(differences) - 1))


def _mean_and_error(values: Sequence[float] | np.ndarray, n_train: int, n_test: int) -> tuple[float, float]:
    values = np.asarray(values, float)
    if values.ndim != 1 or len(values) < 2:
        raise InputError(f"values: an interval needs the values of at least two splits; got shape {values.shape}")
    if n_train < 1 or n_test < 1:
        raise InputError(f"n_train, n_test: both sides of a split hold examples; got {n_train} and {n_test}")
    return float(values.mean()), float(values.std(ddof=1) * np.sqrt(1 / len(values) + n_test / n_train))
