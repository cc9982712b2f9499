"""Conditioning: from a signal as recorded to the signal that the afferents feel.

The order is fixed: smoothing (EMA), resampling to the encoder's clock, baseline, standardisation, rectification.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.files import check_size

Baseline = Literal["none", "mean", "median", "first"]


def condition(
    recordings: Recordings,
    *,
    ema_cutoff_Hz: float | None = None,
    resample_Hz: float | None = None,
    baseline: Baseline = "none",
    offset: Sequence[float] | None = None,
    scale: Sequence[float] | None = None,
    rectify: bool = False,
) -> Recordings:
    """Condition every trial; the result has the encoder's sampling rate.

    ema_cutoff_Hz: cut-off of the exponential moving average; none when absent.
    resample_Hz: the encoder's clock; the recordings' own rate when absent.
    baseline: what is subtracted from each taxel of each trial: `none`, `mean`, `median` or `first`.
    offset, scale: standardisation, a value a taxel (see `fit_standardisation`).
    rectify: take the absolute value at the end.

    Raises InputError for a cut-off above the Nyquist frequency and for offsets or scales that do not match the
    taxels.

    >>> import pandas as pd
    >>> skin = Recordings([np.ones((3, 2))], 35.6, "count", pd.DataFrame({"label": ["felt"]}))
    >>> condition(skin, resample_Hz=1000.0, baseline="first").signals[0].shape
    (57, 2)
    """
    rate_Hz = recordings.sampling_rate_Hz
    if ema_cutoff_Hz is not None:
        smoothing = ema_coefficient(ema_cutoff_Hz, rate_Hz)
        recordings = _each(recordings, lambda x: ema(x, smoothing))
    if resample_Hz is not None and resample_Hz != rate_Hz:
        clock_Hz = resample_Hz
        recordings = replace(_each(recordings, lambda x: resample(x, rate_Hz, clock_Hz)), sampling_rate_Hz=clock_Hz)
    if baseline != "none":
        level = BASELINES[baseline]
        recordings = _each(recordings, lambda x: x - level(x))
    if offset is not None or scale is not None:
        shift = _per_taxel(offset, 0.0, recordings)
        spread = _per_taxel(scale, 1.0, recordings)
        recordings = replace(_each(recordings, lambda x: (x - shift) / spread), unit="sd")
    if rectify:
        recordings = _each(recordings, np.abs)
    return recordings


BYTES_WHILE_RESAMPLED = 32
"""For each value of the result: its place, its neighbours and itself."""

BASELINES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mean": lambda x: x.mean(axis=-2, keepdims=True),
    "median": lambda x: np.median(x, axis=-2, keepdims=True).astype(x.dtype),
    "first": lambda x: x[..., :1, :],
}


def ema_coefficient(cutoff_Hz: float, rate_Hz: float) -> float:
    """Weight of the newest sample, `1 - exp(-2 pi cutoff / rate)`; InputError above the Nyquist frequency.

    >>> round(ema_coefficient(30.0, 2000.0), 4)
    0.0899
    """
    if cutoff_Hz >= rate_Hz / 2:
        raise InputError(
            f"ema_cutoff_Hz: {cutoff_Hz:g} Hz is not below the Nyquist frequency of {rate_Hz / 2:g} Hz; "
            "lower it or leave it out"
        )
    return float(1.0 - np.exp(-2.0 * np.pi * cutoff_Hz / rate_Hz))


def ema(signal: np.ndarray, coefficient: float, before: np.ndarray | None = None) -> np.ndarray:
    """`y[t] = y[t-1] + coefficient (x[t] - y[t-1])` along time, `(..., time, taxel)`.

    before: y just before the signal begins, `(..., taxel)`: the last output of the piece before it. A signal
        without one starts at y[0] = x[0].

    >>> ema(np.array([[0.0], [1.0], [1.0]]), 0.5).ravel().tolist()
    [0.0, 0.5, 0.75]
    """
    carried = signal[..., :1, :] if before is None else before[..., None, :]
    kind = signal.dtype.type
    b, a = np.array([coefficient], kind), np.array([1.0, coefficient - 1.0], kind)
    smooth, _ = lfilter(b, a, signal, axis=-2, zi=kind(1.0 - coefficient) * carried)
    return smooth


def resample(signal: np.ndarray, rate_Hz: float, to_Hz: float) -> np.ndarray:
    """Linear interpolation of `(..., time, taxel)` at another rate, from the first sample to the last.

    Samples are not invented beyond the recording; going to a lower rate wants an EMA before it.

    >>> resample(np.array([[0.0], [2.0]]), 1.0, 2.0).ravel().tolist()
    [0.0, 1.0, 2.0]
    """
    n_samples = signal.shape[-2]
    n_resampled = int(np.floor((n_samples - 1) / rate_Hz * to_Hz + 1e-9)) + 1
    check_size(f"a trial resampled to {to_Hz:g} Hz", n_resampled * signal[..., :1, :].size * BYTES_WHILE_RESAMPLED)
    position = np.arange(n_resampled) * (rate_Hz / to_Hz)
    before = np.minimum(position.astype(np.int64), n_samples - 1)
    after = np.minimum(before + 1, n_samples - 1)
    weight = (position - before).astype(signal.dtype)[:, None]
    left = np.take(signal, before, axis=-2)
    return left + weight * (np.take(signal, after, axis=-2) - left)


def fit_standardisation(signals: Sequence[np.ndarray]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """`(offset, scale)`: mean and standard deviation of each taxel over training trials.

    A taxel that never moves gets scale 1, so that it stays silent and not infinite.

    >>> fit_standardisation([np.array([[1.0, 5.0], [3.0, 5.0]])])
    ((2.0, 5.0), (1.0, 1.0))
    """
    n_samples = sum(len(s) for s in signals)
    mean = sum(s.sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    variance = sum(((s - mean) ** 2).sum(axis=0, dtype=np.float64) for s in signals) / n_samples
    deviation = np.sqrt(variance)
    still = deviation <= 1e-12 * np.maximum(1.0, np.abs(mean))
    return tuple(np.asarray(mean).tolist()), tuple(np.where(still, 1.0, deviation).tolist())


def _each(recordings: Recordings, change: Callable[[np.ndarray], np.ndarray]) -> Recordings:
    signals = recordings.signals
    changed = change(signals) if isinstance(signals, np.ndarray) else [change(s) for s in signals]
    return replace(recordings, signals=changed)


def _per_taxel(values: Sequence[float] | None, default: float, recordings: Recordings) -> np.ndarray:
    if values is None:
        return np.full(recordings.n_channels, default, np.float32)
    if len(values) != recordings.n_channels:
        raise InputError(
            f"{recordings.source or 'recordings'}: has {recordings.n_channels} channels but the encoder's conditioning "
            f"has {len(values)} offsets or scales; calibrate an encoder for this sensor"
        )
    return np.array(values, np.float32)
