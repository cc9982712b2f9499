"""A lock-in: amplitude and phase of a sinusoid of known frequency in a recorded waveform."""

from typing import Literal

import numpy as np

from neurotact.errors import InputError

Window = Literal["rectangular", "hann"]


def lock_in(
    signal: np.ndarray, frequency_Hz: float, sampling_rate_Hz: float, window: Window = "rectangular"
) -> np.ndarray:
    """The phasor A exp(jφ) of A cos(2πft + φ), t = 0 at the first sample, `(...,)` complex for `(..., time)`.

    Multiplying by a reference and averaging is exact only over whole periods. Here cosine, sine and a constant are
    fitted by weighted least squares (the three-parameter sine fit of IEEE 1057), which is exact for a sinusoid with
    an offset over any length, and equivalent over whole periods. A `hann` window suppresses other frequencies more.

    Raises InputError for less than half a period, and for frequencies that are not between 0 and half of the
    sampling rate.

    >>> time_s = np.arange(130) / 1000
    >>> phasor = lock_in(0.7 + 2 * np.cos(2 * np.pi * 15 * time_s + 0.5), 15.0, 1000.0)
    >>> round(float(abs(phasor)), 9), round(float(np.angle(phasor)), 9)
    (2.0, 0.5)
    """
    signal = np.asarray(signal, np.float64)
    n_samples = signal.shape[-1]
    if not 0 < frequency_Hz < sampling_rate_Hz / 2:
        raise InputError(
            f"lock-in: {frequency_Hz:g} Hz is not between 0 and {sampling_rate_Hz / 2:g} Hz, half of the sampling rate"
        )
    if n_samples < 4 or n_samples * frequency_Hz < sampling_rate_Hz / 2:
        raise InputError(
            f"lock-in: {n_samples} samples are less than half a period of {frequency_Hz:g} Hz; give a longer signal"
        )
    angle = 2.0 * np.pi * frequency_Hz / sampling_rate_Hz * np.arange(n_samples)
    basis = np.stack([np.cos(angle), -np.sin(angle), np.ones(n_samples)], axis=1)
    # The root of the weights is on both sides; a Hann window that ends in zeros would waste the outer samples.
    phase = (np.arange(n_samples) + 0.5) / n_samples
    root = np.ones(n_samples) if window == "rectangular" else np.sin(np.pi * phase)
    fit = np.linalg.pinv(basis * root[:, None]) * root
    real, imaginary, _ = np.moveaxis(signal @ fit.T, -1, 0)
    return real + 1j * imaginary


def phase_between(output: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Phase in degrees by which phasors lead a reference's, above -180 and at most 180.

    >>> phase_between(np.array([1j, 1.0]), np.array([1.0, 1j])).tolist()
    [90.0, -90.0]
    """
    return np.degrees(np.angle(output * np.conj(reference)))
