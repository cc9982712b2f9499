"""AR, MAX, H1 and H2: four numbers of a curve that rises and falls, sample by sample or at once.

The instants of MAX, H1 and H2 belong to the commanded movement, not to the curve: there is no search, so a comparison,
a register and one adder are enough (compliance paper, Secs. 2 and 4, Fig. 8).
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from neurotact.errors import InputError

FEATURES = ("AR", "MAX", "H1", "H2")

COMBINATIONS = {
    f"d{number}": names
    for number, names in enumerate((some for n in range(1, 5) for some in combinations(FEATURES, n)), start=1)
}
"""The features of each label of the compliance paper's Table 2, where d13 is misprinted as "AR, H1 and H1"."""


class Instants(NamedTuple):
    """Samples, counted from 0, of MAX, H1 and H2."""

    maximum: int
    h1: int
    h2: int


def instants(peak: int) -> Instants:
    """The instants of a movement that turns at sample `peak`: H1 at 2/3 of the time to it, H2 1/3 of it later.

    Raises InputError when the turn comes too early for H1 to lie before it.

    >>> instants(582)
    Instants(maximum=582, h1=388, h2=776)
    """
    if peak < 2:
        raise InputError(f"peak: sample {peak} is too early for H1 before it; it must be at least 2")
    return Instants(peak, round(2 * peak / 3), round(4 * peak / 3))


class CurveState(NamedTuple):
    """The state of the streaming form: the next sample's number, the sum so far, and MAX, H1 and H2 so far."""

    sample: int
    total: np.ndarray
    held: np.ndarray


def start(n_channels: int) -> CurveState:
    """Before the first sample: `total` is `(channel,)`, `held` is `(channel, 3)` for MAX, H1, H2."""
    return CurveState(0, np.zeros(n_channels), np.full((n_channels, 3), np.nan))


def step(state: CurveState, values: np.ndarray, when: Instants) -> CurveState:
    """One sample of every channel, `(channel,)`: one addition, and a copy at the three instants."""
    held = state.held
    if state.sample in when:
        held = np.where(np.array(when) == state.sample, np.asarray(values, np.float64)[:, None], held)
    return CurveState(state.sample + 1, state.total + values, held)


def finish(state: CurveState, sampling_rate_Hz: float) -> np.ndarray:
    """The features after the last sample, `(channel, 4)` in the order of FEATURES, AR in unit times seconds.

    Raises InputError when the curve ended before H2 was read.
    """
    if np.isnan(state.held).any():
        raise InputError(f"curve: {state.sample} samples end before H2; give the release as well as the squeeze")
    return np.column_stack([state.total / sampling_rate_Hz, state.held])


def curve_features(curves: np.ndarray, peak: int, sampling_rate_Hz: float) -> np.ndarray:
    """The features of whole curves, `(..., channel, 4)` float64 in the order of FEATURES: AR, MAX, H1, H2.

    curves: `(..., time, channel)`. peak: the sample at which the commanded movement turns.
    AR is the sum over all samples divided by the sampling rate, that is the area in unit times seconds. Equal to the
    streaming form bit for bit: sums are formed sample after sample. Source: compliance paper, Sec. 2 and Fig. 1.

    >>> triangle = np.array([0, 1, 2, 3, 2, 1, 0.0])[:, None]
    >>> dict(zip(FEATURES, curve_features(triangle, peak=3, sampling_rate_Hz=10.0)[0].tolist()))
    {'AR': 0.9, 'MAX': 3.0, 'H1': 2.0, 'H2': 2.0}
    """
    curves = np.asarray(curves)
    when = instants(peak)
    if curves.ndim < 2 or curves.shape[-2] <= when.h2:
        raise InputError(
            f"curves: shape {curves.shape} ends before H2 at sample {when.h2}; give (..., time, channel) with the "
            "release as well as the squeeze"
        )
    total = np.cumsum(curves, axis=-2, dtype=np.float64)[..., -1, :]
    read = [curves[..., sample, :] for sample in when]
    return np.stack([total / sampling_rate_Hz, *read], axis=-1).astype(np.float64)


def select_features(features: np.ndarray, combination: str) -> np.ndarray:
    """The columns of one combination of Table 2 side by side, `(..., channel * feature)`, channel by channel.

    features: `(..., channel, 4)`. Raises InputError for a label that Table 2 does not have.

    >>> select_features(np.array([[[1, 2, 3, 4], [5, 6, 7, 8]]]), "d13").tolist()
    [[1, 3, 4, 5, 7, 8]]
    """
    if combination not in COMBINATIONS:
        raise InputError(f"combination '{combination}': is not in Table 2; give one of d1 to d15")
    columns = [FEATURES.index(name) for name in COMBINATIONS[combination]]
    chosen = np.asarray(features)[..., columns]
    return chosen.reshape(*chosen.shape[:-2], -1)
