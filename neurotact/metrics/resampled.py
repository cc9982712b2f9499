"""Confidence of a mean over random splits, which share examples, so that their accuracies are not independent."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from neurotact.errors import InputError
from neurotact.metrics.shares import wilson_interval

LEAST_SPLITS = 3
"""Splits that give an interval: of two, Student's t has one degree of freedom and reaches 12.7 standard errors, so that
it mostly spans all that is possible; and two that are equal by chance would have no width."""
SHARES, DIFFERENCES = (0.0, 1.0), (-1.0, 1.0)
"""What the mean of shares, and of differences of shares, can be."""

ROUNDING = 1e-12
"""Shares that differ by less are equal: means of several differ in their last bits."""


class Interval(NamedTuple):
    """A mean and its confidence interval, whose ends are NaN where there is none."""

    mean: float
    low: float
    high: float


def resampled_interval(
    values: Sequence[float] | np.ndarray,
    n_train: int,
    n_test: int,
    within: tuple[float, float] = SHARES,
    trials: float | None = None,
) -> Interval:
    """The 95 % confidence interval of a mean over random splits, by the corrected resampled t test.

    values: one per split, `(split,)`; n_train, n_test: examples on both sides of each. within: what the mean can be,
    beyond which no interval reaches. trials: independent ones that a split tests, if not its `n_test` examples.
    The variance of the mean is `s² (1/J + n_test/n_train)`; independent tests would have `s²/J` (Nadeau and
    Bengio 2003, Machine Learning 52:239). The ends are NaN for fewer than `LEAST_SPLITS` splits. Raises InputError
    for none.
    Equal shares have no spread, which is no certainty: their interval is that of Wilson for
    `trials / (1/J + n_test/n_train)` trials, whose share has this variance. Equal differences keep no width.

    >>> found = resampled_interval([0.8, 0.9, 0.7, 0.8], n_train=70, n_test=15)
    >>> round(found.mean, 3), round(found.low, 3), round(found.high, 3)
    (0.8, 0.623, 0.977)
    >>> round(resampled_interval([1.0, 1.0, 1.0, 1.0], n_train=70, n_test=15).low, 3)
    0.893
    """
    values = _checked(values, n_train, n_test, least=1)
    mean, (least, most) = float(values.mean()), within
    if len(values) < LEAST_SPLITS:
        return Interval(mean, float("nan"), float("nan"))
    if within == SHARES and np.ptp(values) < ROUNDING:
        n_trials = (trials or n_test) / (1 / len(values) + n_test / n_train)
        low, high = wilson_interval(mean, max(1, round(n_trials)))
        return Interval(mean, min(low, mean), max(high, mean))  # rounding may leave 1 just outside
    half = float(stats.t.ppf(0.975, len(values) - 1) * _error(values, n_train, n_test))
    return Interval(mean, max(least, mean - half), min(most, mean + half))


def resampled_p(differences: Sequence[float] | np.ndarray, n_train: int, n_test: int) -> float:
    """The two-sided p-value of the mean difference of two classifiers over random splits, by the same test.

    differences: one per split, `(split,)`. If all are equal, 1 for zero and 0 for any other number. Raises InputError
    for fewer than `LEAST_SPLITS` splits.

    >>> round(resampled_p([0.1, 0.2, 0.1, 0.2], n_train=70, n_test=15), 3)
    0.032
    """
    values = _checked(differences, n_train, n_test, least=LEAST_SPLITS)
    mean, error = float(values.mean()), _error(values, n_train, n_test)
    if error == 0:
        return float(mean == 0)
    return float(2 * stats.t.sf(abs(mean) / error, len(values) - 1))


def _checked(values: Sequence[float] | np.ndarray, n_train: int, n_test: int, least: int) -> np.ndarray:
    values = np.asarray(values, float)
    if values.ndim != 1 or len(values) < least:
        raise InputError(f"values: give one for each of at least {least} splits; got shape {values.shape}")
    if n_train < 1 or n_test < 1:
        raise InputError(f"n_train, n_test: both sides of a split hold examples; got {n_train} and {n_test}")
    return values


def _error(values: np.ndarray, n_train: int, n_test: int) -> float:
    """The standard error of the mean."""
    return float(values.std(ddof=1) * np.sqrt(1 / len(values) + n_test / n_train))
