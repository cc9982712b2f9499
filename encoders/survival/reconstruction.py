"""How well a linear filter of spikes gives the signal back, on trials that it was not fitted to.

The filter is the optimal linear one (Bialek et al. 1991, doi 10.1126/science.2063199): in the frequency domain
`H = S_xs / S_ss`, of several afferents a matrix. Its error on other trials gives a signal-to-noise ratio and a lower
bound of the information rate (Borst and Theunissen 1999, doi 10.1038/14731).
"""

from typing import NamedTuple

import numpy as np

from neurotact.errors import InputError

EDGE = 0.2
"""Below this share of the taper's height nothing is decoded."""
SEGMENT_s = 0.5
"""Length of a segment: the slowest frequency is its inverse."""


class Reconstruction(NamedTuple):
    """The spectra of a signal and of what a decoder leaves of it.

    frequency_Hz: `(line,)`. power, error: of the signal and of signal minus decoded, mean over segments and taxels,
    `(line,)`, in one unit. snr_dB: of their sums. bits_per_s: the lower bound of the information of one taxel.
    """

    frequency_Hz: np.ndarray
    power: np.ndarray
    error: np.ndarray

    @property
    def snr_dB(self) -> float:  # noqa: N802
        """`10 log10(sum of power / sum of error)`."""
        return float(10 * np.log10(self.power.sum() / max(self.error.sum(), np.finfo(float).tiny)))

    @property
    def bits_per_s(self) -> float:
        """`sum of log2(power / error) df` over the lines at which the decoder helps.

        The lower bound for a Gaussian signal, since the error is that of other trials than those of the fit.
        """
        lines = np.log2(self.power / np.maximum(self.error, np.finfo(float).tiny))
        return float(np.maximum(lines, 0).sum() * self.frequency_Hz[1])


def segments(values: list[np.ndarray], sampling_rate_Hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Trials `(time, channel)` cut into segments of `SEGMENT_s`, `(segment, time, channel)`, and each one's trial.

    Shorter trials give shorter segments, all of the shortest trial's length. Raises InputError below 8 steps.
    """
    n_steps = min(round(SEGMENT_s * sampling_rate_Hz), min(map(len, values)))
    if n_steps < 8:
        raise InputError(f"recordings: the shortest trial has {n_steps} steps, too few to decode; give longer trials")
    places = [(trial, start) for trial, x in enumerate(values) for start in range(0, len(x) - n_steps + 1, n_steps)]
    return np.stack([values[trial][start : start + n_steps] for trial, start in places]), np.array(
        [trial for trial, _ in places]
    )


def linear(
    signal: np.ndarray, spikes: np.ndarray, trial: np.ndarray, sampling_rate_Hz: float
) -> tuple[Reconstruction, np.ndarray]:
    """The reconstruction of segments by the optimal linear filter of the other trials, and the decoded segments.

    Segments are tapered (Hann), so that their ends are not decoded: NaN.

    signal: `(segment, time, taxel)`, each taxel with a mean of 0. spikes: `(segment, time, taxel, kind)`, those of the
    afferents under each taxel; all taxels share one filter. trial: of each segment; trials of even and of odd places
    are decoded by the filter of the others.

    >>> rng = np.random.default_rng(0)
    >>> x = rng.normal(size=(40, 64, 1))
    >>> echo = np.roll(x, 1, axis=1)[..., None] + rng.normal(0, 0.1, (40, 64, 1, 1))  # late, with a hundredth of noise
    >>> found, decoded = linear(x, echo, np.arange(40), 128.0)
    >>> 15 < found.snr_dB < 20, decoded.shape
    (True, (40, 64, 1))
    """
    taper = np.hanning(signal.shape[1] + 2)[1:-1, None]
    x = np.fft.rfft(signal * taper, axis=1)
    s = np.fft.rfft((spikes - spikes.mean(axis=(0, 1))) * taper[..., None], axis=1)
    fold = np.unique(trial, return_inverse=True)[1] % 2
    decoded = np.zeros_like(x)
    for side in (0, 1):
        fitted, tested = fold != side, fold == side
        if fitted.any() and tested.any():
            decoded[tested] = np.einsum("sfjk,fk->sfj", s[tested], _filter(x[fitted], s[fitted]))
    frequency_Hz = np.fft.rfftfreq(signal.shape[1], 1 / sampling_rate_Hz)
    power, error = ((np.abs(part) ** 2).mean(axis=(0, 2)) for part in (x, x - decoded))
    inside = np.where(taper > EDGE, taper, np.nan)
    return Reconstruction(frequency_Hz, power, error), np.fft.irfft(decoded, signal.shape[1], axis=1) / inside


def transferred(
    fitted: tuple[np.ndarray, np.ndarray], tested: tuple[np.ndarray, np.ndarray], sampling_rate_Hz: float
) -> Reconstruction:
    """The reconstruction of some segments by the optimal linear filter of others: signals and spikes, as of `linear`.

    >>> rng = np.random.default_rng(0)
    >>> x = rng.normal(size=(80, 64, 1))
    >>> echo = np.roll(x, 1, axis=1)[..., None] + rng.normal(0, 0.1, (80, 64, 1, 1))
    >>> 15 < transferred((x[:40], echo[:40]), (x[40:], echo[40:]), 128.0).snr_dB < 20
    True
    """
    n_steps, silent = fitted[0].shape[1], fitted[1].mean(axis=(0, 1))
    taper = np.hanning(n_steps + 2)[1:-1, None]
    (x, s), (of, told) = (
        (np.fft.rfft(signal * taper, axis=1), np.fft.rfft((spikes - silent) * taper[..., None], axis=1))
        for signal, spikes in (fitted, tested)
    )
    left = of - np.einsum("sfjk,fk->sfj", told, _filter(x, s))
    frequency_Hz = np.fft.rfftfreq(n_steps, 1 / sampling_rate_Hz)
    return Reconstruction(frequency_Hz, *((np.abs(part) ** 2).mean(axis=(0, 2)) for part in (of, left)))


def _filter(x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """H, `(line, kind)`, for signals x `(segment, line, taxel)` and spikes s `(segment, line, taxel, kind)`.

    The ridge is the mean power of one value. Each line is shrunk by the ratio of its adjusted to its plain coefficient
    of determination: of few segments, a filter explains some of any signal by chance.
    """
    n_kinds, n_values = s.shape[-1], x.shape[0] * x.shape[2]
    cross = np.einsum("stjk,stj->tk", s.conj(), x)
    own = np.einsum("stjk,stjl->tkl", s.conj(), s)
    tiny = np.finfo(float).tiny
    ridge = np.trace(own, axis1=1, axis2=2).real.mean() / n_values + tiny  # at lines where afferents say little
    weights = np.linalg.solve(own + ridge * np.eye(n_kinds), cross[..., None])[..., 0]
    explained = np.einsum("tk,tk->t", cross.conj(), weights).real / np.maximum((np.abs(x) ** 2).sum(axis=(0, 2)), tiny)
    explained = np.clip(explained, 1e-12, 1)
    adjusted = 1 - (1 - explained) * n_values / max(n_values - n_kinds, 1) if n_values > n_kinds else 0 * explained
    return weights * np.maximum(adjusted / explained, 0)[:, None]


def direct(signal: np.ndarray, decoded: np.ndarray, sampling_rate_Hz: float) -> Reconstruction:
    """The reconstruction of segments by a decoder that needs no fit, `(segment, time, taxel)` both.

    The mean of each segment is taken off both: such a decoder does not know where the signal began.
    """
    taper = np.hanning(signal.shape[1] + 2)[1:-1, None]
    centred = [values - values.mean(axis=1, keepdims=True) for values in (signal, decoded)]
    x, y = (np.fft.rfft(values * taper, axis=1) for values in centred)
    frequency_Hz = np.fft.rfftfreq(signal.shape[1], 1 / sampling_rate_Hz)
    return Reconstruction(frequency_Hz, *((np.abs(part) ** 2).mean(axis=(0, 2)) for part in (x, x - y)))
