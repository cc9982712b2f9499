"""Networks that differ in the start of their weights alone: how far accuracies lie apart, and what one start tells."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t

from neurotact.metrics.shares import wilson_interval

ONE = "one start of the weights: others may differ"
"""What is said of an interval that knows a single start."""
FITTED = "without a hidden layer, every start of the weights leads to this network"
"""What is said in place of it where one fit of the weights is the best."""


class Spread(NamedTuple):
    """How far accuracies of networks from several starts lie apart: a standard deviation, its degrees of freedom."""

    deviation: float
    freedom: int


def spread(groups: Iterable[Sequence[float]]) -> Spread | None:
    """The standard deviation of accuracies between starts, pooled over groups; None where no group has two.

    groups: of each network (its spikes, size and split) the accuracies from its starts, on the same test trials.

    >>> spread([[0.9, 0.8], [0.7, 0.7], [0.5]])
    Spread(deviation=0.05, freedom=2)
    >>> spread([[0.9], [0.8]]) is None
    True
    """
    several = [np.asarray(group, float) for group in groups if len(group) > 1]
    freedom = sum(len(group) - 1 for group in several)
    if not freedom:
        return None
    squares = sum(float(((group - group.mean()) ** 2).sum()) for group in several)
    return Spread(round(math.sqrt(squares / freedom), 12), freedom)  # rounded: sums differ in their last bits


def interval(accuracy: float, n_trials: int, n_starts: int = 1, apart: Spread | None = None) -> tuple[float, float]:
    """The 95 % interval of the accuracy of a network from another start, on other trials.

    accuracy: the mean over `n_starts` starts on the same `n_trials` independent test trials. apart: as of `spread`;
    None if unknown: the interval is then that of this network alone, which `ONE` says.
    Test trials give the interval of Wilson, starts that of Student for a new value beside a mean; as they are
    independent, their distances from the accuracy are added as squares (MOVER; Zou and Donner 2008, Statistics in
    Medicine 27:1693).

    >>> [round(end, 3) for end in interval(0.9, 100)], [round(end, 3) for end in interval(0.9, 100, 3, Spread(0.03, 6))]
    ([0.826, 0.945], [0.787, 0.996])
    """
    low, high = wilson_interval(accuracy, n_trials)
    if apart is None:
        return low, high
    half = float(t.ppf(0.975, apart.freedom)) * apart.deviation * math.sqrt(1 + 1 / n_starts)
    return max(0.0, accuracy - math.hypot(accuracy - low, half)), min(1.0, accuracy + math.hypot(high - accuracy, half))
