"""When a touch begins and ends: in one trial, by the band of a resting sensor; in many, by how much trials differ."""

import numpy as np

from neurotact.data.recordings import Trials
from neurotact.data.spikes import SpikeTrains
from neurotact.data.windows import Windows, long_enough

BINS, MOST_TRIALS, MOST_VALUES = 50, 500, 20_000_000
"""Bins of the shortest trial in which the touch is looked for; the most trials, evenly spaced, and their most values in
memory."""
MOST_READ = 20_000
"""Values of a trial that are read together."""
GLITCHES = 0.01
"""Share of the largest and of the smallest values of a taxel that are clipped."""
RISEN = 0.4
"""Share of the largest difference between trials with which the touch begins."""
LATEST = 1 / 3
"""Share of the shortest trial after which no touch begins: trials that differ ever more from one another drift."""
ONSET_S, ONSET_DEVIATIONS = 0.01, 6.0
"""Of `onsets_s`: the average, and the deviations of the rest that contact exceeds."""


def common_onset_s(trials: Trials) -> float:
    """The time at which the touch of recorded trials begins, in s from their start; 0 if they begin with it.

    At rest, trials differ little from one another. v is the variance over trials of a taxel's mean and deviation in a
    bin, a fiftieth of the shortest trial, in units of its largest. Each taxel counts with (1 - min v)^2, the minimum
    over bins in which a touch may begin: a taxel that is noise, or that differs from the start of trials on, hardly
    counts, whatever its unit. The touch begins with the first bin in which the sum over taxels is at least 0.4 of
    its largest. Rare values are clipped, so that a glitch in one trial does not decide. Labels are not used.

    >>> import pandas as pd
    >>> rng = np.random.default_rng(0)
    >>> signals = [rng.normal(0, 0.1, (200, 2)) for _ in range(20)]
    >>> for signal in signals:
    ...     signal[60:] += rng.normal(0, 5, 2)
    >>> from neurotact.data.recordings import Recordings
    >>> common_onset_s(Recordings(signals, 100.0, "mV", pd.DataFrame({"label": ["a", "b"] * 10})))
    0.6
    """
    lengths = np.asarray(trials.lengths)
    kept = np.flatnonzero(long_enough(1e3 * lengths / trials.sampling_rate_Hz, trials.labels))
    edges = _edges(int(lengths[kept].min()))
    chosen = kept[_sample(len(kept), 2 * trials.n_channels)].tolist()
    features = np.empty((len(chosen), len(edges) - 1, 2, trials.n_channels), np.float32)
    reference = _features(trials, chosen[0], edges)[0]  # a large offset, squared, would hide small differences
    for row, trial in enumerate(chosen):
        features[row] = _features(trials, trial, edges) - reference
    return _begin(features, edges) / trials.sampling_rate_Hz


def onsets_s(trials: Trials, rest_s: float) -> np.ndarray:
    """The onset of contact of each recorded trial in s from its start, `(trial,)`; NaN without one.

    Signals are averaged over bins of 10 ms. A taxel's deviation from its mean over the rest, the first `rest_s`, is
    counted in standard deviations of the rest. Contact begins with the first bin after the rest in which their root
    mean square over taxels exceeds 6, far more than noise at rest.

    >>> import pandas as pd
    >>> from neurotact.data.recordings import Recordings
    >>> signals = np.random.default_rng(0).normal(0, 0.1, (2, 500, 3))
    >>> signals[0, 200:] += 5
    >>> onsets_s(Recordings(signals, 100.0, "mV", pd.DataFrame({"label": ["a", "b"]})), 1.0).tolist()
    [2.0, nan]
    """
    onsets = np.full(len(trials), np.nan)
    width = max(1, round(ONSET_S * trials.sampling_rate_Hz))
    n_rest = int(rest_s * trials.sampling_rate_Hz) // width
    if n_rest < 2:
        return onsets
    for trial, n_samples in enumerate(trials.lengths.tolist()):
        n_bins = n_samples // width
        signal = trials.piece(trial, 0, n_bins * width).astype(np.float64)
        signal = signal.reshape(n_bins, width, trials.n_channels).mean(axis=1)
        rest = signal[:n_rest]
        deviation = np.maximum(rest.std(axis=0), np.finfo(np.float32).eps * np.maximum(1.0, np.abs(rest).max(axis=0)))
        away = np.sqrt((((signal - rest.mean(axis=0)) / deviation) ** 2).mean(axis=1))
        above = np.flatnonzero(away[n_rest:] > ONSET_DEVIATIONS)
        if len(above):
            onsets[trial] = (n_rest + above[0]) * width / trials.sampling_rate_Hz
    return onsets


def common_spike_onset_s(spikes: SpikeTrains) -> float:
    """The time at which the touch begins in spike trains, in s from the start of a trial; 0 if they begin with it.

    The rule of `common_onset_s`, with the rate of each afferent in a bin.

    >>> import pandas as pd
    >>> from neurotact.data.spikes import from_rasters
    >>> rasters = np.random.default_rng(0).random((20, 500, 4)) < np.linspace(0, 1, 20)[:, None, None]
    >>> rasters[:, :100] = 0
    >>> common_spike_onset_s(from_rasters(rasters, 1000.0, "abcd", pd.DataFrame({"label": ["a", "b"] * 10})))
    0.1
    """
    n_afferents = len(spikes.afferents)
    durations_ms = 1e3 * np.asarray(spikes.trial_steps) / spikes.sampling_rate_Hz
    kept = np.flatnonzero(long_enough(durations_ms, spikes.labels)) if len(spikes) else np.zeros(0, np.int64)
    shortest = int(spikes.trial_steps[kept].min()) if len(spikes) else 0
    if not (shortest and n_afferents):
        return 0.0
    edges = _edges(shortest)
    chosen = kept[_sample(len(kept), n_afferents)]
    windows = Windows(chosen, np.zeros(len(chosen), np.int64), shortest)
    counts = spikes.binned(windows, np.array(edges))
    rates = (counts / np.diff(edges)[:, None]).astype(np.float32)[:, :, None]
    return _begin(rates, edges) / spikes.sampling_rate_Hz


def evenly(n_trials: int, most: int = MOST_TRIALS) -> np.ndarray:
    """At most `most` trials, evenly spaced; all if there are fewer.

    >>> evenly(10, 4).tolist(), evenly(3, 4).tolist()
    ([0, 3, 6, 9], [0, 1, 2])
    """
    return np.linspace(0, n_trials - 1, min(n_trials, most)).astype(int)


def _features(trials: Trials, trial: int, edges: list[int]) -> np.ndarray:
    """Mean and standard deviation of each channel of a trial in each bin, `(bin, 2, channel)`."""
    n_bins = len(edges) - 1
    features = np.empty((n_bins, 2, trials.n_channels))
    together = max(1, MOST_READ * n_bins // (edges[-1] * trials.n_channels))
    for first in range(0, n_bins, together):
        inside = np.array(edges[first : first + together + 1])
        piece = trials.piece(trial, inside[0], inside[-1]).astype(np.float64)
        starts, widths = inside[:-1] - inside[0], np.diff(inside)
        mean = np.add.reduceat(piece, starts) / widths[:, None]
        piece -= np.repeat(mean, widths, axis=0)
        deviation = np.sqrt(np.add.reduceat(piece**2, starts) / widths[:, None])
        features[first : first + together] = np.stack([mean, deviation], axis=1)
    return features


def _edges(shortest: int) -> list[int]:
    """The edges of the bins, in samples."""
    return np.unique(np.linspace(0, shortest, BINS + 1).astype(int)).tolist()


def _sample(n_trials: int, n_features: int) -> list[int]:
    """The trials that are compared, evenly spaced; `n_features` of each in a bin are in memory."""
    return evenly(n_trials, max(2, min(MOST_TRIALS, MOST_VALUES // (BINS * max(1, n_features))))).tolist()


def _begin(features: np.ndarray, edges: list[int]) -> int:
    """The first sample of the bin in which the touch begins.

    features: `(trial, bin, feature, channel)`; they are overwritten.
    """
    low, high = np.quantile(features, [GLITCHES, 1 - GLITCHES], axis=(0, 1))
    variance = np.clip(features, low, high, out=features).var(axis=0, dtype=np.float64).sum(axis=1)
    variance /= np.maximum(variance.max(axis=0), np.finfo(float).tiny)
    early = np.array(edges[:-1]) <= LATEST * edges[-1]
    differ = variance @ (1 - variance[early].min(axis=0)) ** 2
    first = int(np.argmax(differ >= RISEN * differ.max()))
    return edges[first] if early[first] else 0
