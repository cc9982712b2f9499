"""Features of spike trains for plain classifiers: one row per trial, never NaN.

Classifiers before the texture paper used them (texture paper, Table I, its references 13 to 16 and 18). Each uses the
whole window. Distances between trains are in `neurotact_parts.studies.texture.spike_distances`.
"""

import numpy as np

from neurotact.errors import InputError
from neurotact.metrics.spike_trains import (
    Events,
    Spikes,
    check_rate,
    events_of_raster,
    isis_ms,
    spike_counts,
)


def mean_isis(spikes: Spikes, sampling_rate_Hz: float) -> np.ndarray:
    """Mean inter-spike interval of each afferent in ms, `(trial, afferent)` (Table I, reference 15).

    The window's length if there is no interval, as a lower bound.

    >>> mean_isis(np.array([[[1, 0], [0, 0], [1, 0]]]), sampling_rate_Hz=1000.0).tolist()
    [[2.0, 3.0]]
    """
    window_ms = _n_steps(spikes) * (1e3 / sampling_rate_Hz)
    mean = isi_mean_ms(spikes, sampling_rate_Hz)
    return np.where(np.isnan(mean), window_ms, mean)


def isi_variations(spikes: Spikes) -> np.ndarray:
    """Coefficient of variation of each afferent's intervals, `(trial, afferent)` (Table I, references 13 and 14).

    0 with fewer than two intervals.

    >>> isi_variations(np.array([[[1, 1], [0, 0], [1, 1], [1, 0]]])).round(3).tolist()
    [[0.333, 0.0]]
    """
    return np.nan_to_num(isi_cv(spikes), nan=0.0)


def bin_fano_factors(spikes: Spikes, bin_steps: int) -> np.ndarray:
    """Variance over mean of each afferent's counts in the bins of its window, `(trial, afferent)` (Table I, [14]).

    The Fano factor of one trial, over consecutive bins of `bin_steps` steps, without a shorter last one; the variance
    is that of the population. 0 for a silent afferent. Raises InputError if a window holds fewer than two bins.

    >>> bin_fano_factors(np.array([[[1], [1], [0], [0]]]), bin_steps=2).tolist()
    [[1.0]]
    """
    n_bins = _n_steps(spikes) // _at_least_one("bin_steps", bin_steps)
    if n_bins < 2:
        raise InputError(
            f"bin_steps: {bin_steps} steps leave {n_bins} bins in the window; shorten them to have at least two"
        )
    counts = _binned(spikes, bin_steps, n_bins)
    mean = counts.mean(axis=2)
    return counts.var(axis=2) / np.where(mean == 0, 1.0, mean)


def co_occurrence(spikes: Spikes, lag_steps: int) -> np.ndarray:
    """Pairs of spikes no further apart than `lag_steps`, `(trial, afferent, afferent)` int64 (Table I, [14]).

    Entry (a, b) counts pairs of a spike of a and a spike of b; entry (a, a) pairs of two spikes of a, each once.
    Symmetric.

    >>> co_occurrence(np.array([[[1, 0], [1, 1], [0, 0], [0, 1]]]), lag_steps=1)[0].tolist()
    [[1, 2], [2, 0]]
    """
    if lag_steps < 0:
        raise InputError(f"lag_steps: must be >= 0; got {lag_steps}")
    events = _events(spikes)
    n_trials, n = len(events.trial_steps), events.n_afferents
    room = int(events.trial_steps.max(initial=0)) + 2 * lag_steps + 2  # so that no lag reaches another group
    group = events.trial * n + events.afferent
    key = group * room + events.step + lag_steps  # ascending, since events are in this order
    pairs = np.zeros((n_trials * n, n), np.int64)
    for other in range(n):
        centre = (events.trial * n + other) * room + events.step + lag_steps
        near = np.searchsorted(key, centre + lag_steps, "right") - np.searchsorted(key, centre - lag_steps, "left")
        pairs[:, other] = np.bincount(group, near, minlength=len(pairs)).astype(np.int64)
    pairs = pairs.reshape(n_trials, n, n)
    itself = np.arange(n)
    pairs[:, itself, itself] = (pairs[:, itself, itself] - spike_counts(events)) // 2
    return pairs


def co_occurrences(spikes: Spikes, lag_steps: int) -> np.ndarray:
    """The upper triangle of `co_occurrence` with its diagonal, `(trial, afferent (afferent + 1) / 2)` float."""
    matrices = co_occurrence(spikes, lag_steps)
    return matrices[:, *np.triu_indices(matrices.shape[1])].astype(float)


def delayed_traces(
    spikes: Spikes, sampling_rate_Hz: float, *, tau_ms: float, delay_ms: float, n_delays: int
) -> np.ndarray:
    """Time-delayed inputs, `(trial, delay * afferent)` (Table I, reference 16).

    Each train has a trace, which rises by 1 at a spike and decays with `tau_ms`. It is read at the window's end and
    `delay_ms`, 2 `delay_ms`, ... before; 0 before the window begins. The end comes first, then by afferent.

    >>> read = delayed_traces(np.array([[[1], [0], [1]]]), 1000.0, tau_ms=1.0, delay_ms=1.0, n_delays=3)
    >>> read.round(3).tolist()
    [[1.135, 0.368, 1.0]]
    """
    check_rate(sampling_rate_Hz)
    _at_least_one("n_delays", n_delays)
    n_steps, step_ms = _n_steps(spikes), 1e3 / sampling_rate_Hz
    decay = np.exp(-step_ms / tau_ms)
    ends = n_steps - 1 - np.rint(np.arange(n_delays) * delay_ms / step_ms).astype(np.int64)
    events = _events(spikes)
    traces = np.zeros((n_delays, len(events.trial_steps) * events.n_afferents))
    group = events.trial * events.n_afferents + events.afferent
    for trace, last in zip(traces, ends, strict=True):
        before = events.step <= last
        trace += np.bincount(group[before], decay ** (last - events.step[before]), minlength=len(trace))
    shaped = traces.reshape(n_delays, len(events.trial_steps), events.n_afferents)
    return np.moveaxis(shaped, 0, 1).reshape(len(events.trial_steps), -1)


def grey_images(spikes: Spikes, columns: int, white: int) -> np.ndarray:
    """A raster as an image, `(trial, afferent, column)` uint8: the more spikes, the brighter (Table I, reference 18).

    The window is cut into `columns` bins of equal length; the last one also gets the remaining steps. A pixel is 255 if
    its bin holds `white` spikes or more, 0 if it holds none, and proportional in between.

    >>> grey_images(np.array([[[1, 0], [1, 0], [0, 0], [0, 1]]]), columns=2, white=2).tolist()
    [[[255, 0], [0, 127]]]
    """
    _at_least_one("columns", columns)
    bin_steps = _n_steps(spikes) // columns
    if bin_steps < 1:
        raise InputError(f"columns: a window of {_n_steps(spikes)} steps has no {columns} columns; choose fewer")
    counts = _binned(spikes, bin_steps, columns, keep_rest=True)
    return (np.minimum(counts, white) * 255 // _at_least_one("white", white)).astype(np.uint8)


def _binned(spikes: Spikes, bin_steps: int, n_bins: int, *, keep_rest: bool = False) -> np.ndarray:
    """Counts in consecutive bins, `(trial, afferent, bin)` int64."""
    events = _events(spikes)
    bins = events.step // bin_steps
    bins = np.minimum(bins, n_bins - 1) if keep_rest else bins
    inside = bins < n_bins
    group = (events.trial * events.n_afferents + events.afferent) * n_bins + bins
    shape = len(events.trial_steps), events.n_afferents, n_bins
    return np.bincount(group[inside], minlength=int(np.prod(shape))).reshape(shape)


def _events(spikes: Spikes) -> Events:
    return spikes if isinstance(spikes, Events) else events_of_raster(spikes)


def _n_steps(spikes: Spikes) -> int:
    """The windows' length; InputError if they differ, since their features could not be compared."""
    if not isinstance(spikes, Events):
        return np.shape(spikes)[1]
    lengths = np.unique(spikes.trial_steps)
    if len(lengths) > 1:
        raise InputError("spikes: features compare windows of one length; cut windows first")
    return int(lengths[0]) if len(lengths) else 0


def _at_least_one(name: str, value: int) -> int:
    if value < 1:
        raise InputError(f"{name}: must be >= 1; got {value}")
    return value


def isi_mean_ms(spikes: Spikes, sampling_rate_Hz: float) -> np.ndarray:
    """Mean inter-spike interval, `(trial, afferent)`; NaN if there is none.

    >>> isi_mean_ms(np.array([[[1], [0], [1], [1]]]), sampling_rate_Hz=2000.0).tolist()
    [[0.75]]
    """
    return _isi_moments(spikes, sampling_rate_Hz)[0]


def isi_cv(spikes: Spikes) -> np.ndarray:
    """Coefficient of variation of the inter-spike intervals, `(trial, afferent)`.

    Standard deviation (of the population, ddof 0) over mean; 0 for a regular train, about 1 for a Poisson one.
    NaN with fewer than two intervals. A feature in the texture paper's Table I.

    >>> isi_cv(np.array([[[1], [0], [1], [1]]])).round(3).tolist()
    [[0.333]]
    """
    mean, deviation, n_intervals = _isi_moments(spikes, 1.0)
    return np.where(n_intervals < 2, np.nan, deviation / mean)


def _isi_moments(spikes: Spikes, sampling_rate_Hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, standard deviation and number of the intervals of each trial and afferent."""
    trains = spikes if isinstance(spikes, Events) else events_of_raster(spikes)
    shape = len(trains.trial_steps), trains.n_afferents
    trial, afferent, isi = isis_ms(trains, sampling_rate_Hz)
    group = trial * trains.n_afferents + afferent
    n_intervals = np.bincount(group, minlength=shape[0] * shape[1])
    some = np.where(n_intervals == 0, np.nan, n_intervals)
    mean = np.bincount(group, isi, minlength=len(some)) / some
    variance = np.bincount(group, (isi - mean[group]) ** 2, minlength=len(some)) / some
    return mean.reshape(shape), np.sqrt(variance).reshape(shape), n_intervals.reshape(shape)
