"""What spike counts tell about the class: mutual information in bits, corrected for the bias of few trials."""

import numpy as np

MOST_BINS, PER_BIN = 8, 4
"""Counts of an afferent are put into at most so many bins, and so few that a bin has this many trials of a class."""


def class_information(counts: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The information of each afferent's count about the class, in bits, `(afferent,)`.

    counts: spikes, `(trial, afferent)`. labels: class index of each trial, `(trial,)`.

    The plug-in estimate minus its bias, `(sum_s (R_s - 1) - (R - 1)) / (2 N ln 2)`, with R the bins that occur and R_s
    those in class s, of N trials (Panzeri and Treves 1996, doi 10.1088/0954-898X/7/1/006, Eq. 9). It is not limited to
    values above zero, so that the mean over afferents that tell nothing is about zero.

    >>> labels = np.repeat([0, 1], 50)
    >>> told = np.stack([labels * 4, np.zeros(100, int), np.tile([0, 1], 50)], axis=1)
    >>> class_information(told, labels).round(2).tolist()
    [1.01, 0.0, -0.01]
    """
    return information_of_bins(binned(counts, labels), labels)


def binned(counts: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The bin of each count, `(trial, afferent)`: the same for any order of the labels.

    >>> binned(np.array([[0], [5], [5], [9]]), np.array([0, 0, 1, 1])).ravel().tolist()
    [0, 1, 1, 1]
    """
    counts = np.asarray(counts)
    n_classes = len(np.unique(labels))
    most = max(2, min(MOST_BINS, len(labels) // (PER_BIN * max(1, n_classes))))
    columns = [_binned(column, most) for column in counts.T]
    return np.stack(columns, axis=1) if columns else np.zeros(counts.shape, np.int64)


def information_of_bins(bins: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """`class_information` of counts that are `binned`, in any order of the labels."""
    _, labels = np.unique(labels, return_inverse=True)
    n_classes, n_trials = int(labels.max(initial=-1)) + 1, len(labels)
    bits = np.zeros(bins.shape[1])
    for afferent, column in enumerate(bins.T):
        n_bins = column.max(initial=-1) + 1
        joint = np.bincount(labels * n_bins + column, minlength=n_classes * n_bins).reshape(n_classes, n_bins)
        occupied = (joint > 0).sum(axis=1)
        bias = ((occupied - 1).sum() - (joint.shape[1] - 1)) / (2 * n_trials * np.log(2))
        shares = joint / n_trials
        expected = shares.sum(axis=1, keepdims=True) * shares.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bits[afferent] = np.nansum(shares * np.log2(shares / expected)) - bias
    return bits


def _binned(column: np.ndarray, most: int) -> np.ndarray:
    """Counts as bins 0, 1, ..., each of which occurs: the counts themselves if there are few, else at most `most`."""
    values, bins = np.unique(column, return_inverse=True)
    if len(values) <= most:
        return bins
    edges = np.unique(np.quantile(column, np.arange(1, most) / most))
    return np.unique(np.searchsorted(edges, column, side="right"), return_inverse=True)[1]
