"""Paired test of two classifiers on the same trials."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binom

from neurotact.errors import InputError
from neurotact.metrics.shares import standard_error

RESAMPLES = 9999
"""Number of random sign vectors if differences give too many sums to know all."""
MOST_SUMS = 200_000
"""Sums of signed differences that one step of the exact test may form, some 20 ms."""
DECIMALS, ROUNDING = 12, 1e-9
"""Shares are equal up to the former, sums up to the latter: means of several differ in their last bits."""
LEVEL = 0.05
"""The probability below which a difference is clear, of several after Holm's correction."""
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
        """Whether p is below `LEVEL`."""
        return self.p < LEVEL


def p_in_words(p: float) -> str:
    """A probability with as many digits as tell on which side of `LEVEL` it is.

    >>> p_in_words(0.0002), p_in_words(0.312), p_in_words(0.0513), p_in_words(0.0496), p_in_words(0.05)
    ('p < 0.001', 'p = 0.3', 'p = 0.051', 'p = 0.0496', 'p = 0.05')
    """
    if p < 0.001:
        return "p < 0.001"
    told = (f"{p:.{digits}g}" for digits in range(1, 18))
    return f"p = {next(one for one in told if np.sign(float(one) - LEVEL) == np.sign(p - LEVEL))}"


def compare(right: np.ndarray, other: np.ndarray) -> Paired:
    """Compare two classifiers on the same trials with a sign-flip permutation test.

    right, other: the share of correct decisions of each trial, `(trial,)`, over its windows and over trainings. If
    each is 0 or 1, p is that of McNemar's exact test (1947, Psychometrika 12:153). p is exact, over all signs, unless
    so many differences are unlike that their signs give more than `MOST_SUMS` sums: then it is of 9,999 random sign
    vectors (Monte Carlo), and at least 1 / 10,000. Raises InputError for other shapes, and for no trial.

    >>> found = compare(np.array([1, 1, 1, 1, 1, 1, 0.0]), np.array([0, 0, 0, 0, 0, 0, 0.0]))
    >>> round(found.difference, 3), round(found.p, 5), found.n
    (0.857, 0.03125, 7)
    """
    if right.shape != other.shape or right.ndim != 1 or not len(right):
        raise InputError(f"right, other: give the same trials, (trial,); got {right.shape} and {other.shape}")
    differences = np.asarray(right, float) - other
    return Paired(float(differences.mean()), _p_of_signs(differences), len(right))


def _p_of_signs(differences: np.ndarray) -> float:
    """The two-sided p-value of a sum whose signs are random.

    The n equal differences d with their signs give `d (2B - n)`, where B is binomial, so that p is exact as long as
    unlike differences give few sums.
    """
    apart = np.abs(differences).round(DECIMALS)
    sizes, counts = np.unique(apart[apart > 0], return_counts=True)
    sums, chances = np.zeros(1), np.ones(1)
    for size, n in zip(sizes, counts, strict=True):
        if len(sums) * (n + 1) > MOST_SUMS:
            return _p_of_random_signs(differences)
        ways = np.arange(n + 1)
        every = np.add.outer(sums, size * (2 * ways - n)).round(DECIMALS).ravel()
        of_every = np.multiply.outer(chances, binom.pmf(ways, n, 0.5)).ravel()
        sums, at = np.unique(every, return_inverse=True)
        chances = np.bincount(at, weights=of_every)
    as_large = np.abs(sums) > abs(differences.sum()) - ROUNDING
    return min(1.0, float(chances[as_large].sum()))


def _p_of_random_signs(differences: np.ndarray) -> float:
    # By size, so that neither the order of trials nor that of the classifiers matters.
    apart, rng = np.sort(np.abs(differences[differences != 0])), np.random.default_rng(0)
    sums = np.zeros(RESAMPLES)
    for part in np.array_split(apart, math.ceil(len(apart) * RESAMPLES / AT_ONCE)):
        sums += (2.0 * rng.integers(0, 2, (RESAMPLES, len(part))) - 1) @ part
    as_large = np.abs(sums) > abs(differences.sum()) - ROUNDING
    return float((1 + as_large.sum()) / (1 + RESAMPLES))


def sign_test(n_better: int, n_worse: int) -> float:
    """The exact two-sided p-value of the sign test: of `n_better + n_worse` trials that differ, so many each way.

    >>> sign_test(6, 0), sign_test(0, 0)
    (0.03125, 1.0)
    """
    n = n_better + n_worse
    return min(1.0, 2 * float(binom.sf(max(n_better, n_worse) - 1, n, 0.5)))


def least_p(n_apart: float) -> float:
    """The least p of any exact test of two classifiers of which at least so many trials differ: all in favor of one.

    >>> least_p(6), least_p(0.5)
    (0.03125, 1.0)
    """
    return min(1.0, 2.0 ** (1 - n_apart))


def compare_shares(share: float, other: float, n: int) -> Paired:
    """Compare two shares of `n` trials each whose single trials are unknown, as if they were different trials.

    The normal approximation, with two correct and two wrong trials added to each (as Agresti and Caffo 2000 add one)
    and a correction of half a trial, which holds 5 % with any number of trials; p is at least `least_p`. It finds fewer
    differences than a paired test.

    >>> found = compare_shares(0.9, 0.5, 100)
    >>> round(found.difference, 3), found.is_clear, compare_shares(0.9, 0.85, 100).is_clear
    (0.4, True, False)
    """
    error = math.hypot(standard_error(share, n), standard_error(other, n))
    apart = max(0.0, abs(share - other) * n - 0.5) / (n + 4)
    return Paired(share - other, max(math.erfc(apart / error / math.sqrt(2)), least_p(abs(share - other) * n)), n)


def compare_by_trial(right: Mapping[Any, float], other: Mapping[Any, float]) -> Paired:
    """As `compare`, of the trials that both hold: by trial, the share of its windows that are classified correctly.

    >>> compare_by_trial({3: 1.0, 7: 0.5}, {7: 0.0, 9: 1.0}).n
    1
    """
    common = sorted(right.keys() & other.keys(), key=str)
    return compare(*(np.array([shares[trial] for trial in common]) for shares in (right, other)))


def by_trial(trial: np.ndarray, right: Sequence[float] | np.ndarray) -> dict[int, float]:
    """The share of correct windows of each trial; `trial`, `right`: of each window, `(window,)`.

    >>> by_trial(np.array([3, 3, 7]), [True, False, True])
    {3: 0.5, 7: 1.0}
    """
    shares = pd.Series(np.asarray(right, float)).groupby(np.asarray(trial)).mean()
    return {int(one): float(share) for one, share in shares.items()}  # pyright: ignore[reportArgumentType]
