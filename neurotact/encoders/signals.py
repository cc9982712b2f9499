"""Signals before encoding: amplitude and principal frequency of each class and condition."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.conditioning import condition
from neurotact.data.recordings import LABEL, Recordings
from neurotact.encoders.model import EncoderSpec

LEAST_Hz = 1.0
"""Below this frequency, a spectrum of about a second shows drift, not texture."""
LINE_Hz = 1 / 16
"""Distance between the lines of a spectrum, so that its highest line separates frequencies."""
RIDGE_mm = 1.0
"""Width of the ridges of every grating in the texture paper (Sec. II-B); its pitch is the gap between ridges."""


def signal_table(recordings: Recordings, encoder: EncoderSpec, by: Iterable[str], start_ms: float) -> pd.DataFrame:
    """Means over the trials of each class and combination of the conditions in `by`, from `start_ms` on.

    Signals are conditioned as for the encoder; each trial must last longer than `start_ms`.
    Columns: label, for gratings also grating and pitch_mm, `by`, peak_<unit> (highest magnitude
    on the strongest taxel), principal_Hz (highest line of that taxel's mean amplitude spectrum), and for
    gratings expected_Hz, the set speed / (pitch + 1 mm).
    """
    conditioned = condition(recordings.to_unit(encoder.unit), encoder.conditioning)
    start = round(start_ms * 1e-3 * conditioned.sampling_rate_Hz)
    signals = [signal[start:] for signal in conditioned.signals]
    peaks = np.array([np.abs(signal).max(axis=0) for signal in signals])
    names = [LABEL, *(name for name in ("grating", "pitch_mm") if name in recordings.conditions), *by]
    rows = []
    for _, group in recordings.conditions.groupby([LABEL, *by], sort=False):
        trials = group.index.to_numpy()
        taxel = int(peaks[trials].mean(axis=0).argmax())
        row: dict[str, Any] = group.iloc[0][names].to_dict()
        row[f"peak_{conditioned.unit}"] = float(peaks[trials, taxel].mean())
        row["principal_Hz"] = principal_frequency(
            [signals[trial][:, taxel] for trial in trials], conditioned.sampling_rate_Hz
        )
        if {"pitch_mm", "speed_mm_per_s"} <= set(row):
            row["expected_Hz"] = row["speed_mm_per_s"] / (row["pitch_mm"] + RIDGE_mm)
        rows.append(row)
    return pd.DataFrame(rows)


def principal_frequency(signals: Iterable[np.ndarray], rate_Hz: float) -> float:
    """The highest line above 1 Hz of the mean amplitude spectrum of signals `(time,)`.

    >>> time_s = np.arange(2000) / 2000
    >>> principal_frequency([np.sin(2 * np.pi * 4.3 * time_s), np.cos(2 * np.pi * 4.3 * time_s)], 2000.0)
    4.3125
    """
    n_padded = round(rate_Hz / LINE_Hz)
    frequencies = np.fft.rfftfreq(n_padded, 1.0 / rate_Hz)
    spectrum = np.mean([np.abs(np.fft.rfft(x - x.mean(), n_padded)) / len(x) for x in signals], axis=0)
    return float(frequencies[np.where(frequencies >= LEAST_Hz, spectrum, 0.0).argmax()])
