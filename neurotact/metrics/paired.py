"""Paired test of two classifiers on the same trials."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import permutation_test, t

from neurotact.errors import InputError
from neurotact.metrics.shares import standard_error

RESAMPLES = 9999
"""Number of random sign vectors if there are too many trials to try all."""
AT_ONCE = 2_000_000
"""Signs in memory at once."""


class Paired(NamedTuple):
    """A paired comparison: the mean difference of two accuracies, and the probability of one as large by chance.

    n: number of trials. p: two-sided.
    """

    difference: float
    p: float
    n: int

    @property
    def is_clear(self) -> bool:
        """Whether p is below 0.05."""
        return self.p < 0.05


def compare(right: np.ndarray, other: np.ndarray) -> Paired:
    """Compare two classifiers on the same trials with a sign-flip permutation test.

    right, other: the share of correct decisions of each trial, `(trial,)`, over its windows and over trainings. If
    each is 0 or 1, p is that of McNemar's exact test (1947, Psychometrika 12:153). If up to 13 trials differ, all
    signs are tried, else 9,999 random ones. Raises InputError for other shapes, and for no trial.

    >>> compare(np.array([1, 1, 1, 1, 1, 1, 0.0]), np.array([0, 0, 0, 0, 0, 0, 0.0]))
    Paired(difference=0.8571428571428571, p=0.03125, n=7)
    """
    if right.shape != other.shape or right.ndim != 1 or not len(right):
        raise InputError(f"right, other: give the same trials, (trial,); got {right.shape} and {other.shape}")
    differences = np.asarray(right, float) - other
    apart = differences[differences != 0]  # others have no sign to flip
    difference = float(differences.mean())
    if len(apart) < 2:  # with one difference, both signs give the same magnitude
        return Paired(difference, 1.0, len(right))
    tried = permutation_test(
        (apart,), _sums, permutation_type="samples", n_resamples=RESAMPLES, batch=max(1, AT_ONCE // len(apart)), rng=0
    )
    return Paired(difference, float(tried.pvalue), len(right))


def compare_shares(share: float, other: float, n: int) -> Paired:
    """Compare two shares of `n` trials each whose single trials are unknown, as if they were different trials.

    The normal approximation, with two correct and two wrong trials added (Agresti and Caffo 2000). It finds fewer
    differences than a paired test.

    >>> found = compare_shares(0.9, 0.5, 100)
    >>> round(found.difference, 3), found.is_clear, compare_shares(0.9, 0.85, 100).is_clear
    (0.4, True, False)
    """
    error = math.hypot(standard_error(share, n), standard_error(other, n))
    return Paired(share - other, math.erfc(abs(share - other) / error / math.sqrt(2)), n)


def compare_means(one: tuple[float, float, int], other: tuple[float, float, int]) -> Paired:
    """Compare two means of independent rows by Welch's t test; each: mean, standard error, rows (at least two).

    >>> compare_means((0.9, 0.02, 4), (0.8, 0.02, 4)).is_clear, compare_means((0.9, 0.02, 4), (0.86, 0.02, 4)).is_clear
    (True, False)
    """
    difference, error = one[0] - other[0], math.hypot(one[1], other[1])
    n = min(one[2], other[2])
    if not error:
        return Paired(difference, 0.0 if difference else 1.0, n)
    parts = (own**4 / (rows - 1) for _, own, rows in (one, other))
    return Paired(difference, float(2 * t.sf(abs(difference) / error, error**4 / sum(parts))), n)


def compare_by_trial(right: Mapping[int, float], other: Mapping[int, float]) -> Paired:
    """As `compare`, of the trials that both hold: by trial, the share of its windows that are classified correctly.

    >>> compare_by_trial({3: 1.0, 7: 0.5}, {7: 0.0, 9: 1.0}).n
    1
    """
    common = sorted(right.keys() & other.keys())
    return compare(*(np.array([shares[trial] for trial in common]) for shares in (right, other)))


def by_trial(trial: np.ndarray, right: Sequence[bool] | np.ndarray) -> dict[int, float]:
    """The share of correct windows of each trial; `trial`, `right`: of each window, `(window,)`.

    >>> by_trial(np.array([3, 3, 7]), [True, False, True])
    {3: 0.5, 7: 1.0}
    """
    shares = pd.Series(np.asarray(right, float)).groupby(np.asarray(trial)).mean()
    return {int(one): float(share) for one, share in shares.items()}  # pyright: ignore[reportArgumentType]


def _sums(values: np.ndarray, axis: int) -> np.ndarray:
    return values.sum(axis=axis)
