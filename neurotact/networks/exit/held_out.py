"""What early exit loses on trials that did not choose its rule, and whether it is used.

A rule that is chosen and judged on the same trials looks better than it is: of many patiences, one does well by luck.
So validation trials are divided into folds, and the rule that the other folds choose is judged on each.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.stats import beta, norm

from neurotact.networks.exit.early_exit import FULL_WINDOW, ExitRule
from neurotact.networks.exit.exit_choice import least, steady

FOLDS = 10
CONFIDENCE = 0.95
"""Of the upper bound, one-sided."""


class ExitChoice(NamedTuple):
    """A rule of early exit, and what rules that were chosen in the same way lose on other trials.

    losses: by validation trial, the share of its windows that are right on the whole window minus that with early exit,
    by a rule that the trial did not choose; empty if unknown. tolerance: accuracy that may be lost.
    """

    rule: ExitRule
    losses: Mapping[int, float]
    tolerance: float

    @property
    def bound(self) -> float:
        """The upper bound of the loss."""
        return float(upper_bound([*self.losses.values()]))

    @property
    def used(self) -> ExitRule:
        """The rule as it is used: that of the whole window where the loss may exceed the tolerance."""
        return self.rule if is_within(self.bound, self.tolerance) else FULL_WINDOW

    @property
    def is_refused(self) -> bool:
        """Whether there is a rule of early exit that is not used."""
        return not self.rule.never and self.used.never

    @property
    def in_words(self) -> str:
        """What is known of the loss."""
        return in_words(self.bound, self.tolerance)


class Judged(NamedTuple):
    """Decisions of windows by each of ascending rules, the last of which is the full window.

    right: whether each is right, `(window, rule)` boolean. labels, trial: the class and the trial of each window,
    `(window,)` int64.
    """

    right: np.ndarray
    labels: np.ndarray
    trial: np.ndarray


def choose(validation: Judged, tolerance: float, training: tuple[torch.Tensor, int] | None = None) -> int:
    """The index of the rule that validation windows choose: by `least`, or by `steady` where training windows help.

    training: how many training windows each rule decides correctly, `(rule,)`, and their number. `steady` then also
    looks for the first rule from which on the upper bound of the loss is within the tolerance, where there are enough
    trials for one: a rule that loses as much as it may would be refused.
    """
    right = torch.from_numpy(validation.right.sum(axis=0))
    if training is None:
        return least(right, len(validation.right), tolerance)
    index = steady(right, len(validation.right), *training, tolerance)
    above = np.flatnonzero(~is_within(upper_bound(_lost(validation)), tolerance))
    safe = int(above[-1]) + 1 if len(above) else 0
    return max(index, safe) if safe < len(right) - 1 else index


def losses(validation: Judged, tolerance: float, training: tuple[torch.Tensor, int] | None = None) -> dict[int, float]:
    """The loss of early exit on each validation trial, by the rule that trials of the other folds `choose`.

    Empty for a single trial, which leaves no other to choose.

    >>> right = np.array([[0, 1], [1, 1], [1, 1]], bool)
    >>> losses(Judged(right, np.zeros(3, int), np.arange(3)), tolerance=0.1)
    {0: 1.0, 1: 0.0, 2: 0.0}
    """
    fold, found = _folds(validation), {}
    for held in range(fold.max() + 1) if fold.any() else ():
        inside, outside = (Judged(*(part[side] for part in validation)) for side in (fold == held, fold != held))
        rule = choose(outside, tolerance, training)
        found |= dict(zip(np.unique(inside.trial).tolist(), _lost(inside)[:, rule].tolist(), strict=True))
    return dict(sorted(found.items()))


def _folds(validation: Judged) -> np.ndarray:
    """The fold of each window: trials in turn, class by class, so that a class is in as many folds as it can be."""
    trials, first, of = np.unique(validation.trial, return_index=True, return_inverse=True)
    turn = np.empty(len(trials), np.int64)
    turn[np.argsort(validation.labels[first], kind="stable")] = np.arange(len(trials))
    return turn[of] % min(FOLDS, len(trials))


def _lost(validation: Judged) -> np.ndarray:
    """The share of the windows of each trial that each rule loses, `(trial, rule)`, in the order of the trials."""
    order = np.argsort(validation.trial, kind="stable")
    _, first, n = np.unique(validation.trial[order], return_index=True, return_counts=True)
    right = np.add.reduceat(validation.right[order].astype(np.int32), first) / n[:, None]
    return right[:, -1:] - right


def upper_bound(losses: ArrayLike) -> np.ndarray:
    """The 95 % upper bound of a mean loss of independent trials; 1 without any.

    losses: paired differences of shares, from -1 to 1, `(trial,)` or `(trial, rule)`. The bound for paired proportions
    of Bonett and Price (2012, Journal of Educational and Behavioral Statistics 37:479), which adds one trial each way,
    and at least that of Clopper and Pearson (1934, Biometrika 26:404) for the trials that are lost on balance: without
    any loss the former alone would be too low.

    >>> [round(float(upper_bound([0.0] * n)), 3) for n in (0, 30, 299)]
    [1.0, 0.095, 0.01]
    """
    values = np.asarray(losses, float)
    n, total = len(values), values.sum(axis=0)
    if not n:
        return np.ones(values.shape[1:])
    mean = total / (n + 2)
    variance = ((values**2).sum(axis=0) + 2) / (n + 2) - mean**2
    paired = mean + norm.ppf(CONFIDENCE) * np.sqrt(variance / (n + 2))
    lost = np.clip(total, 0, n)
    exact = np.where(lost < n, beta.ppf(CONFIDENCE, lost + 1, np.maximum(n - lost, math.ulp(1.0))), 1.0)
    return np.minimum(1.0, np.maximum(paired, exact))


def is_within(bound: ArrayLike, tolerance: float) -> np.ndarray:
    """Whether an upper bound of the loss is within the tolerance, so that early exit is used."""
    return np.asarray(bound) <= tolerance


def in_words(bound: float, tolerance: float) -> str:
    """What is known of the loss.

    >>> in_words(0.095, 0.01)
    'validation trials that did not choose it show a loss of at most 9.5 points (95 % bound), and 1 may be lost'
    """
    return (
        f"validation trials that did not choose it show a loss of at most {100 * bound:.2g} points "
        f"({100 * CONFIDENCE:.0f} % bound), and {100 * tolerance:.3g} may be lost"
    )
