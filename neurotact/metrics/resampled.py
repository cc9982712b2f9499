"""Means over several splits of one set, whose accuracies are not independent: one test, one interval, one error.

The corrected resampled t test (Nadeau and Bengio 2003, Machine Learning 52:239): a mean over J splits has the variance
`s² (1/J + n_test/n_train)`, where independent tests would have `s²/J`. What counts as a split is what is tested:

- Random splits draw the test trials of each anew from the same set, and share trials on both sides: the case for which
  the test was derived.
- Folds, and values of a condition (or groups) that are left out in turn, test each trial once, but share most of their
  training trials. No estimate of their variance is without bias (Bengio and Grandvalet 2004, Journal of Machine
  Learning Research 5:1089). The same correction, with `n_test/n_train` of one fold, is used and found about right, and
  so it is for repeated folds, each a split (Bouckaert and Frank 2004, doi 10.1007/978-3-540-24775-3_3).
- Further seeds of weights on the same test trials are no further splits: average them first. One split, or two, say
  nothing of other splits; of one split, single test trials can be compared (`metrics.paired`).

Splits that agree by chance are no certainty. A mean over J splits tells as much as
`trials / (1/J + n_test/n_train)` independent trials: equal shares have the interval of a share on so many, and p of a
difference is never below that of the sign test on those of them that must differ.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from neurotact.errors import InputError
from neurotact.metrics.paired import LEVEL, Paired, least_p
from neurotact.metrics.shares import Z_95, standard_error, wilson_interval

LEAST_SPLITS = 3
"""Splits that give an interval: of two, Student's t has one degree of freedom and reaches 12.7 standard errors, so that
it mostly spans all that is possible; and two that are equal by chance would have no width."""
SHARES, DIFFERENCES = (0.0, 1.0), (-1.0, 1.0)
"""What the mean of shares, and of differences of shares, can be."""
ROUNDING = 1e-12
"""Shares that differ by less are equal: means of several differ in their last bits."""
LEAST_APART = 1 - math.log2(LEVEL)
"""Trials that must differ, all in favor of the same side, for a sign test's p of `LEVEL`."""
ADDED = (LEAST_APART / Z_95) ** 2 - LEAST_APART
"""Differing trials, half of them each way, that are added to the variance of a difference (2.05, about as Agresti and
Min 2005 do, doi 10.1002/sim.1781): its interval then leaves out 0 exactly where the sign test's p is below `LEVEL`."""


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
    """The 95 % confidence interval of a mean over splits, by the corrected resampled t test.

    values: one per split, `(split,)`; n_train, n_test: examples on both sides of each. within: what the mean can be,
    beyond which no interval reaches. trials: independent ones that a split tests, if not its `n_test` examples. The
    ends are NaN for fewer than `LEAST_SPLITS` splits. Raises InputError for none.
    Equal shares have the interval of Wilson for `effective_trials`. That of `DIFFERENCES`, equal or not, has at least
    the width for so many trials of which only those differ that must.

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
    half = float(stats.t.ppf(1 - LEVEL / 2, len(values) - 1) * _error(values, n_train, n_test))
    n = effective_trials(len(values), n_train, n_test, trials)
    if within == SHARES and np.ptp(values) < ROUNDING:
        low, high = wilson_interval(mean, max(1, round(n)))
        return Interval(mean, min(low, mean), max(high, mean))  # rounding may leave 1 just outside
    if within == DIFFERENCES:
        half = max(half, Z_95 * math.sqrt(abs(mean) * n + ADDED) / n)
    return Interval(mean, max(least, mean - half), min(most, mean + half))


def resampled_p(
    differences: Sequence[float] | np.ndarray, n_train: int, n_test: int, trials: float | None = None
) -> float:
    """The two-sided p-value of the mean difference of two shares over splits: below 0.05 where its interval omits 0.

    differences: one per split, of the same test trials, `(split,)`. trials: as of `resampled_interval`. Raises
    InputError for fewer than `LEAST_SPLITS` splits.

    >>> round(resampled_p([0.1, 0.2, 0.1, 0.2], n_train=70, n_test=15), 3)
    0.07
    >>> round(resampled_p([1 / 30] * 3, n_train=139, n_test=30), 2)
    0.57
    """
    values = _checked(differences, n_train, n_test, least=LEAST_SPLITS)
    mean, error = float(values.mean()), _error(values, n_train, n_test)
    n_apart = abs(mean) * effective_trials(len(values), n_train, n_test, trials)
    return max(least_p(n_apart), float(2 * stats.t.sf(abs(mean) / error, len(values) - 1)) if error else 0.0)


def resampled_error(
    values: Sequence[float] | np.ndarray, n_train: int, n_test: int, trials: float | None = None
) -> float:
    """One standard error of a mean of shares over splits; NaN for fewer than `LEAST_SPLITS`.

    Arguments and errors are those of `resampled_interval`. It is at least that of a share of as many independent
    trials.

    >>> round(resampled_error([0.8, 0.9, 0.7, 0.8], n_train=70, n_test=15), 3)
    0.07
    """
    values = _checked(values, n_train, n_test, least=1)
    if len(values) < LEAST_SPLITS:
        return math.nan
    n = effective_trials(len(values), n_train, n_test, trials)
    return max(_error(values, n_train, n_test), standard_error(float(values.mean()), max(1, round(n))))


def compare_over_splits(
    differences: Sequence[float] | np.ndarray, n_train: int, n_test: int, trials: float | None = None
) -> Paired:
    """The comparison of two classifiers over splits, for `referee.judge`; arguments and errors as of `resampled_p`.

    Its n is the number of independent trials that the splits are worth.

    >>> found = compare_over_splits([0.3, 0.4, 0.3, 0.4], n_train=70, n_test=15)
    >>> round(found.difference, 2), found.is_clear, found.n
    (0.35, True, 32)
    """
    values = np.asarray(differences, float)
    p = resampled_p(values, n_train, n_test, trials)
    return Paired(float(values.mean()), p, round(effective_trials(len(values), n_train, n_test, trials)))


def effective_trials(n_splits: int, n_train: float, n_test: float, trials: float | None = None) -> float:
    """The number of independent trials whose share has the variance of a mean over splits; arguments as above.

    It is below all test trials of the splits together, and below the training trials.

    >>> round(effective_trials(10, n_train=140, n_test=30)), round(effective_trials(10**6, n_train=140, n_test=30))
    (95, 140)
    """
    return (trials or n_test) / (1 / n_splits + n_test / n_train)


def least_difference_over_splits(
    n_splits: int, n_train: int, n_test: int, opponents: int = 1, trials: float | None = None
) -> float:
    """The least mean difference, as a share, that can be clear over so many splits; infinite if none can.

    opponents: comparisons of Holm's correction; others as of `resampled_p`. Where the differences of the splits spread,
    a larger one is needed. As `referee.least_difference` says it of one split.

    >>> round(least_difference_over_splits(10, n_train=139, n_test=30), 3), least_difference_over_splits(2, 139, 30)
    (0.056, inf)
    """
    if n_splits < LEAST_SPLITS:
        return math.inf
    least = (LEAST_APART + math.log2(opponents)) / effective_trials(n_splits, n_train, n_test, trials)
    return least if least < 1 else math.inf


def sizes_of(rows: pd.DataFrame, side: Literal["test", "validation"] = "test") -> tuple[int, int, float]:
    """The sides of a split, means over the rows: examples of training and of `side`, and the trials of `side`.

    rows: with n_train, n_test, and `test_trials` where several examples are of one trial; the same of validation, whose
    side is taken to be as large as the test side in rows that do not say it.

    >>> rows = pd.DataFrame({"n_train": [70, 72], "n_test": [30, 28], "test_trials": [10, 10], "n_validation": 15})
    >>> sizes_of(rows), sizes_of(rows, "validation")
    ((71, 29, 10.0), (71, 15, 15.0))
    """
    n = rows["n_test"]
    trials = rows.get("test_trials", n).fillna(n)
    if side == "validation" and "n_validation" in rows:
        own = rows["n_validation"]
        n, trials = own.fillna(n), rows.get("validation_trials", own).fillna(own).fillna(trials)
    return round(rows["n_train"].mean()), round(n.mean()), float(trials.mean())


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
