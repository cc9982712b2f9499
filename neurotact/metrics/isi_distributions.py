"""Distributions of inter-spike intervals (ISIs) over bins that grow with the interval, and how far those of classes
lie apart.

The texture paper (Sec. III-A) uses them to choose the gains of its afferents: if the distributions of two gratings
overlap, their spikes hardly distinguish them.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import entr

from neurotact.backend import native

BIN_RATIO = 1.3
"""Ratio between successive bins of ISIs."""
MOST_PAIRS = 351
"""Pairs of shuffled classes that are compared, at least; all pairs of up to 27 classes."""


def bin_edges(shortest: int, longest: int, ratio: float = BIN_RATIO) -> np.ndarray:
    """Edges between whole steps, spaced evenly in log(ISI) but never closer than a step.

    shortest, longest: the range of the bins, as intervals in steps.

    >>> bin_edges(2, 20, ratio=2.0).tolist()
    [1.5, 3.5, 8.5, 19.5]
    """
    longest = max(longest, shortest + 1)
    n_bins = max(1, round(np.log(longest / shortest) / np.log(ratio)))
    return np.unique(np.round(np.geomspace(shortest, longest, n_bins + 1))) - 0.5


def bins_of(edges: np.ndarray, longest: int) -> np.ndarray:
    """The bin of every interval of 0 to `longest` steps, `(interval,)`; what is beyond an end is in the bin there.

    >>> bins_of(np.array([1.5, 3.5, 8.5]), 9).tolist()
    [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    """
    return np.clip(np.searchsorted(edges, np.arange(longest + 1), side="right") - 1, 0, len(edges) - 2)


def shares_of(intervals: np.ndarray) -> np.ndarray:
    """ISI distribution of each trial and afferent, `(trial, afferent, bin)`, each summing to 1.

    intervals: their number in each bin, of the same shape; the last bin is empty, and receives what has no interval.
    Every trial has the same weight, for any number of spikes.

    >>> shares_of(np.array([[[1, 3, 0], [0, 0, 0]]])).tolist()
    [[[0.25, 0.75, 0.0], [0.0, 0.0, 1.0]]]
    """
    counts = intervals.copy()
    counts[..., -1] = counts.sum(axis=-1) == 0
    return counts / counts.sum(axis=-1, keepdims=True)


def separation(shares: np.ndarray, labellings: Sequence[np.ndarray]) -> float:
    """The separation of the classes' ISI distributions, in bit: 0 for equal ones, at most 1.

    The Jensen-Shannon divergence of two classes' mean distributions, averaged over pairs and afferents; less the
    average over shuffled labels, because distributions of few trials always differ.
    Of many classes, shuffled ones are compared with their neighbours alone, in `MOST_PAIRS` pairs or a few more:
    shuffled, all pairs have one expectation.
    labellings: the labels `(trial,)`, then the same labels shuffled, as often as one likes.
    """
    classes = np.unique(labellings[0])
    one, other = np.triu_indices(len(classes), k=1)
    n_near = max(1, -(-MOST_PAIRS // len(classes)))
    is_near = (other - one <= n_near) | (one - other + len(classes) <= n_near)  # neighbours on a ring of the classes
    near_one, near_other = one[is_near], other[is_near]

    def divergence(means: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
        entropies = _entropy(means)
        mixed = _entropy((means[one] + means[other]) / 2)
        return float((mixed - (entropies[one] + entropies[other]) / 2).mean())

    true, *shuffled = _class_means(shares, np.stack(labellings), classes)
    chance = [divergence(means, near_one, near_other) for means in shuffled]
    return float(divergence(true, one, other) - np.mean(chance))


def _class_means(shares: np.ndarray, labellings: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """The mean of `shares` over the trials of each class, `(labelling, class, ...)`, added up trial by trial."""
    places = np.searchsorted(classes, labellings).astype(np.int64)
    sums = np.zeros((len(labellings), len(classes), *shares.shape[1:]))
    if native is None:
        for own, labels in zip(sums, places, strict=True):
            np.add.at(own, labels, shares)
    else:
        rows = np.ascontiguousarray(shares, np.float64)
        native.class_sums(
            rows=rows.ctypes.data, labels=places.ctypes.data, labellings=len(places), trials=len(rows),
            classes=len(classes), n=math.prod(rows.shape[1:]), sums=sums.ctypes.data,
        )  # fmt: skip
    n_trials = np.bincount(places[0], minlength=len(classes))
    return sums / n_trials.reshape(-1, *[1] * (shares.ndim - 1))


def _entropy(shares: np.ndarray) -> np.ndarray:
    return entr(shares).sum(axis=-1) / np.log(2)
