"""The filters by which pulses become a signal again: taps, and their convolution with pulses."""

import numpy as np

from neurotact.errors import InputError

MOST_TAPS = 2000


def filtered(signed: np.ndarray, taps: np.ndarray, ahead: int) -> np.ndarray:
    """The convolution of `(trial, time, taxel)` with the taps, `ahead` steps earlier, as long as the spikes."""
    n_steps, n_taps = signed.shape[1], len(taps)
    padded = np.pad(signed, ((0, 0), (n_taps - 1, ahead), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_taps, axis=1)
    return (windows @ taps[::-1])[:, ahead : ahead + n_steps]


def hann(filter_ms: float, step_ms: float) -> np.ndarray:
    """The taps of a filter, `(tap,)`, positive and of sum 1: a Hann window of that length.

    >>> hann(3.0, 1.0).round(9).tolist()
    [0.25, 0.5, 0.25]
    """
    n_taps = max(1, round(filter_ms / step_ms))
    if n_taps > MOST_TAPS:
        raise InputError(f"filter_ms: {filter_ms:g} ms is {n_taps} steps, more than {MOST_TAPS}; shorten it")
    window = np.sin(np.pi * np.arange(1, n_taps + 1) / (n_taps + 1)) ** 2
    return window / window.sum()
