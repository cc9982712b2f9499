"""Distributions of inter-spike intervals (ISIs) over bins that grow with the interval, and how far those of classes
lie apart.

The texture paper (Sec. III-A) uses them to choose the gains of its afferents: if the distributions of two gratings
overlap, their spikes hardly distinguish them.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import entr

from neurotact.metrics.spike_trains import Intervals

BIN_RATIO = 1.3
"""Ratio between successive bins of ISIs."""


def bin_edges(shortest: int, longest: int, ratio: float = BIN_RATIO) -> np.ndarray:
    """Edges between whole steps, spaced evenly in log(ISI) but never closer than a step.

    shortest, longest: the range of the bins, as intervals in steps.

    >>> bin_edges(2, 20, ratio=2.0).tolist()
    [1.5, 3.5, 8.5, 19.5]
    """
    longest = max(longest, shortest + 1)
    n_bins = max(1, round(np.log(longest / shortest) / np.log(ratio)))
    return np.unique(np.round(np.geomspace(shortest, longest, n_bins + 1))) - 0.5


def shares_of(isi_steps: Intervals, shape: tuple[int, int], edges: np.ndarray) -> np.ndarray:
    """ISI distribution of each trial and afferent, `(trial, afferent, bin)`, each summing to 1.

    isi_steps: intervals as whole numbers of steps. shape: the numbers of trials and afferents.
    Every trial has the same weight, for any number of spikes; the last bin holds those without any interval.
    """
    n_trials, n_afferents = shape
    n_bins = len(edges)
    steps = isi_steps.isi_ms.astype(np.int64)
    bin_of = np.searchsorted(edges, np.arange(steps.max(initial=0) + 1), side="right") - 1
    bins = np.clip(bin_of, 0, n_bins - 2)[steps]
    cell = (isi_steps.trial * n_afferents + isi_steps.afferent) * n_bins + bins
    counts = np.bincount(cell, minlength=n_trials * n_afferents * n_bins).reshape(n_trials, n_afferents, n_bins)
    counts[..., -1] = counts.sum(axis=-1) == 0
    return counts / counts.sum(axis=-1, keepdims=True)


def separation(shares: np.ndarray, labellings: Sequence[np.ndarray]) -> float:
    """The separation of the classes' ISI distributions, in bit: 0 for equal ones, at most 1.

    The Jensen-Shannon divergence of two classes' mean distributions, averaged over pairs and afferents; less the
    average over shuffled labels, because distributions of few trials always differ.
    labellings: the labels `(trial,)`, then the same labels shuffled, as often as one likes.
    """
    classes = np.unique(labellings[0])
    one, other = np.triu_indices(len(classes), k=1)

    def divergence(labels: np.ndarray) -> float:
        means = np.stack([shares[labels == label].mean(axis=0) for label in classes])
        entropies = _entropy(means)
        mixed = _entropy((means[one] + means[other]) / 2)
        return float((mixed - (entropies[one] + entropies[other]) / 2).mean())

    true, *shuffled = map(divergence, labellings)
    return float(true - np.mean(shuffled))


def _entropy(shares: np.ndarray) -> np.ndarray:
    return entr(shares).sum(axis=-1) / np.log(2)
