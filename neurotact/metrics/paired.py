"""Whether one classifier is right more often than another on the same trials."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import permutation_test

from neurotact.errors import InputError

RESAMPLES = 9999
"""Random signs that are drawn where there are too many trials to try all."""
AT_ONCE = 2_000_000
"""Signs in memory at a time."""


class Paired(NamedTuple):
    """A paired comparison: the mean difference of two accuracies, and how often chance alone makes it as large.

    n: trials that were compared. p: two-sided.
    """

    difference: float
    p: float
    n: int

    @property
    def is_clear(self) -> bool:
        """Whether chance alone would make such a difference in less than one of twenty cases."""
        return self.p < 0.05


def compare(right: np.ndarray, other: np.ndarray) -> Paired:
    """Compare two classifiers on the same trials, by flipping the signs of their differences.

    right, other: for each trial the share of right decisions, `(trial,)`, over its windows and over trainings. Where
    each is 0 or 1, p is that of McNemar's exact test (1947, Psychometrika 12:153). Where up to 13 trials differ, all
    signs are tried, else 9,999 random ones. Raises InputError for other shapes, and for no trial.

    >>> compare(np.array([1, 1, 1, 1, 1, 1, 0.0]), np.array([0, 0, 0, 0, 0, 0, 0.0]))
    Paired(difference=0.8571428571428571, p=0.03125, n=7)
    """
    if right.shape != other.shape or right.ndim != 1 or not len(right):
        raise InputError(f"right, other: give as many trials each, (trial,); got {right.shape} and {other.shape}")
    differences = np.asarray(right, float) - other
    apart = differences[differences != 0]  # others have no sign to flip
    difference = float(differences.mean())
    if len(apart) < 2:  # either sign of one difference is as large
        return Paired(difference, 1.0, len(right))
    tried = permutation_test(
        (apart,), _sums, permutation_type="samples", n_resamples=RESAMPLES, batch=max(1, AT_ONCE // len(apart)), rng=0
    )
    return Paired(difference, float(tried.pvalue), len(right))


def by_trial(trial: np.ndarray, right: Sequence[bool] | np.ndarray) -> dict[int, float]:
    """The share of each trial's windows that are right; `trial`, `right`: of each window, `(window,)`.

    >>> by_trial(np.array([3, 3, 7]), [True, False, True])
    {3: 0.5, 7: 1.0}
    """
    shares = pd.Series(np.asarray(right, float)).groupby(np.asarray(trial)).mean()
    return {int(one): float(share) for one, share in shares.items()}  # pyright: ignore[reportArgumentType]


def _sums(values: np.ndarray, axis: int) -> np.ndarray:
    return values.sum(axis=axis)
