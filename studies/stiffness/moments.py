"""Statistical moments as features: mean, standard deviation, skewness, kurtosis (stiffness paper, Sec. III-C).

The state is a set of central sums that pieces of a signal update, so a peak may arrive in pieces; a whole
signal is one piece. Sums of pieces are merged by the formulas of Chan et al. (1983) and Pébay (Sandia SAND2008-6212).
"""

from typing import NamedTuple

import numpy as np

from neurotact.data.conditioning import ema
from neurotact.errors import InputError

NAMES = ("mean", "std", "skewness", "kurtosis")


class MomentState(NamedTuple):
    """Sums over the samples so far: their number, mean, and the sums of the 2nd to 4th powers of x - mean.

    All but `n` have the shape of one sample, `(..., channel)`.
    """

    n: int
    mean: np.ndarray
    m2: np.ndarray
    m3: np.ndarray
    m4: np.ndarray


def moments_start(shape: int | tuple[int, ...]) -> MomentState:
    """The state before the first sample, for samples of a shape such as `(channel,)`."""
    zeros = np.zeros(shape)
    return MomentState(0, zeros, zeros, zeros, zeros)


def moments_update(state: MomentState, piece: np.ndarray) -> MomentState:
    """The state after a piece, `(..., time, channel)`, in double precision.

    >>> state = moments_start(1)
    >>> for piece in np.split(np.arange(6.0)[:, None], [1, 4]):
    ...     state = moments_update(state, piece)
    >>> state.n, state.mean.tolist(), state.m2.tolist()
    (6, [2.5], [17.5])
    """
    piece = np.asarray(piece, np.float64)
    if piece.shape[:-2] + piece.shape[-1:] != state.mean.shape:
        raise InputError(f"moments: a piece of shape {piece.shape} does not fit samples of {state.mean.shape}")
    if piece.shape[-2] == 0:
        return state
    return _joined(state, _sums(piece))


def moments_finish(state: MomentState) -> np.ndarray:
    """Mean, STD (population), skewness and kurtosis (3 for a normal distribution), `(..., 4, channel)`.

    A constant channel has skewness and kurtosis 0. Raises InputError without samples.
    """
    if state.n == 0:
        raise InputError("moments: there are no samples; give at least one")
    variance = state.m2 / state.n
    some = np.where(variance > 0, variance, 1.0)
    skewness = np.where(variance > 0, state.m3 / state.n / some**1.5, 0.0)
    kurtosis = np.where(variance > 0, state.m4 / state.n / some**2, 0.0)
    return np.stack([state.mean, np.sqrt(variance), skewness, kurtosis], axis=-2)


def moments(signal: np.ndarray) -> np.ndarray:
    """Mean, STD, skewness and kurtosis over time, `(..., time, channel)` to `(..., 4, channel)`.

    >>> moments(np.array([[1.0], [2.0], [3.0], [6.0]])).round(3).ravel().tolist()
    [3.0, 1.871, 0.687, 2.0]
    """
    signal = np.asarray(signal)
    if signal.ndim < 2:
        raise InputError(f"signal: must be (..., time, channel); got shape {signal.shape}")
    return moments_finish(moments_update(moments_start(signal.shape[:-2] + signal.shape[-1:]), signal))


def peak_features(peaks: np.ndarray, alpha: float, order: int = 4) -> np.ndarray:
    """Features of peaks, `(peak, time, channel)` to `(peak, order channel)`: the moments of the smoothed signal.

    alpha: weight of the newest sample in the two-sample moving average `y[i] = alpha x[i] + (1 - alpha) y[i-1]`,
        which starts at the peak's first sample (stiffness paper, Sec. III-B).
    order: number of moments of mean, STD, skewness and kurtosis; 1, 2 and 4 are the paper's sets 4F, 8F and 16F for its
        four channels. All channels' means come first, then all deviations, and so on.

    >>> peak_features(np.ones((2, 150, 4)), alpha=0.5, order=2)[0].tolist()
    [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    """
    peaks = np.asarray(peaks, np.float64)
    if not 0 < alpha <= 1:
        raise InputError(f"alpha: must be above 0 and at most 1; got {alpha}")
    if not 1 <= order <= len(NAMES):
        raise InputError(f"order: there are four moments, {', '.join(NAMES)}; got {order}")
    return moments(ema(peaks, alpha))[:, :order].reshape(len(peaks), order * peaks.shape[-1])


def _sums(piece: np.ndarray) -> MomentState:
    mean = piece.mean(axis=-2)
    away = piece - mean[..., None, :]
    squares = away**2
    return MomentState(
        piece.shape[-2],
        mean,
        squares.sum(axis=-2),
        (squares * away).sum(axis=-2),
        (squares**2).sum(axis=-2),
    )


def _joined(a: MomentState, b: MomentState) -> MomentState:
    """The sums of the union of two sets of samples, from theirs (Pébay 2008, Eqs. 2.1 and 3.1, for two sets)."""
    n = a.n + b.n
    d = b.mean - a.mean
    wa, wb = a.n / n, b.n / n
    product = a.n * b.n / n
    return MomentState(
        n,
        a.mean + d * wb,
        a.m2 + b.m2 + d**2 * product,
        a.m3 + b.m3 + d**3 * product * (wa - wb) + 3.0 * d * (wa * b.m2 - wb * a.m2),
        a.m4
        + b.m4
        + d**4 * product * (wa**2 - wa * wb + wb**2)
        + 6.0 * d**2 * (wa**2 * b.m2 + wb**2 * a.m2)
        + 4.0 * d * (wa * b.m3 - wb * a.m3),
    )
