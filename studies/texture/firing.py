"""The firing of a population over whole touches: its measures, and its inter-spike intervals class by class."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.metrics import spike_trains
from neurotact.metrics.isi_distributions import bin_edges
from neurotact.metrics.spike_trains import Events


def measures(touches: Events, is_kind: np.ndarray, trains: SpikeTrains) -> dict[tuple[str, str], float | None]:
    """Measures of one population, means over trials, by name and unit; None if there is nothing to average.

    spikes (per second, of the whole population), isi (mean of all intervals), isi_sd, isi_least, silent_share (of
    trials without any spike), latency (of the population's first spike; of a silent trial, its whole length).
    """
    rate_Hz = trains.sampling_rate_Hz
    intervals = spike_trains.isis_ms(touches, rate_Hz)
    isi_ms = intervals.isi_ms[is_kind[intervals.afferent]]
    first_ms = latencies_ms(touches, rate_Hz)[:, is_kind]
    is_silent = np.isnan(first_ms).all(axis=1)
    until_ms = 1e3 * touches.trial_steps / rate_Hz
    latency_ms = np.where(is_silent, until_ms, np.where(np.isnan(first_ms), np.inf, first_ms).min(axis=1))
    return {
        ("spikes", "_per_s"): float(spike_trains.rates_Hz(touches, rate_Hz)[:, is_kind].sum(axis=1).mean()),
        ("isi", "_ms"): float(isi_ms.mean()) if len(isi_ms) else None,
        ("isi_sd", "_ms"): float(isi_ms.std()) if len(isi_ms) else None,
        ("isi_least", "_ms"): float(isi_ms.min()) if len(isi_ms) else None,
        ("silent_share", ""): float(is_silent.mean()),
        ("latency", "_ms"): float(latency_ms.mean()),
    }


def as_table(counts: np.ndarray, edges_ms: np.ndarray, classes: Sequence[str]) -> pd.DataFrame:
    """One row per class and non-empty bin: the number of intervals, and their share of all intervals of the class."""
    label, i = np.nonzero(counts)
    n = counts[label, i]
    columns = {"label": np.array(classes)[label], "isi_from_ms": edges_ms[i], "isi_to_ms": edges_ms[i + 1], "n": n}
    return pd.DataFrame({**columns, "share": n / counts.sum(axis=1)[label]})


def isi_histograms(touches: Events, is_kind: np.ndarray, trains: SpikeTrains) -> tuple[np.ndarray, np.ndarray]:
    """The intervals of one population, `(class, bin)`, and the bins' edges in ms.

    The bins are the same for every encoder of these trials: from one step to the longest trial.
    """
    rate_Hz = trains.sampling_rate_Hz
    edges_ms = (1e3 / rate_Hz) * bin_edges(1, int(touches.trial_steps.max()))
    intervals = spike_trains.isis_ms(touches, rate_Hz)
    mine = is_kind[intervals.afferent]
    labels = trains.labels[intervals.trial[mine]]
    return histograms(intervals.isi_ms[mine], labels, len(trains.classes), edges_ms), edges_ms


def histograms(isi: np.ndarray, group: np.ndarray, n_groups: int, edges: np.ndarray) -> np.ndarray:
    """Number of intervals of each group in each bin, `(group, bin)` int64; the last bin holds longer ones too.

    isi, group: `(interval,)`, the interval in the unit of `edges` and the group that it belongs to.
    Raises InputError for an interval below the first edge.

    >>> histograms(np.array([2, 3, 9]), np.array([0, 0, 1]), 2, np.array([1.5, 4.5, 10.5])).tolist()
    [[2, 0], [0, 1]]
    """
    if len(isi) and isi.min() < edges[0]:
        raise InputError(f"intervals: one of {isi.min():g} is below the first edge, {edges[0]:g}; begin the bins lower")
    n_bins = len(edges) - 1
    bins = np.clip(np.searchsorted(edges, isi, side="right") - 1, 0, n_bins - 1)
    return np.bincount(group * n_bins + bins, minlength=n_groups * n_bins).reshape(n_groups, n_bins)


def overlap(counts: np.ndarray) -> float:
    """The overlap of two groups' distributions, averaged over all pairs of groups.

    1 if all are the same, 0 if no two share a bin. Groups without an interval have no distribution and are skipped;
    NaN if fewer than two remain.

    >>> overlap(np.array([[2, 2, 0], [0, 1, 1]]))
    0.5
    """
    counts = np.asarray(counts, float)
    with_intervals = counts[counts.sum(axis=1) > 0]
    if len(with_intervals) < 2:
        return float("nan")
    shares = with_intervals / with_intervals.sum(axis=1, keepdims=True)
    one, other = np.triu_indices(len(shares), k=1)
    return float(np.minimum(shares[one], shares[other]).sum(axis=1).mean())


def latencies_ms(touches: Events, sampling_rate_Hz: float) -> np.ndarray:
    """Time of the first spike from the trial's beginning, `(trial, afferent)`; NaN for a silent afferent."""
    first = np.full((len(touches.trial_steps), touches.n_afferents), np.inf)
    np.minimum.at(first, (touches.trial, touches.afferent), touches.step * (1e3 / sampling_rate_Hz))
    return np.where(np.isinf(first), np.nan, first)
