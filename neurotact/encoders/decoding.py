"""From spikes back to the signal, for the encoders whose spikes say by themselves what they stand for.

Sums of steps (send-on-delta, step-forward, moving window: Petro et al. 2020, doi 10.1109/TNNLS.2019.2906158), the
filter of Ben's spiker (Schrauwen and Van Campenhout 2003, doi 10.1109/IJCNN.2003.1224019), and a low pass of
sigma-delta pulses. Any encoder's spikes can be decoded by the optimal linear filter (`metrics.reconstruction`).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from neurotact.encoders import bens_spiker
from neurotact.encoders.bens_spiker import BensSpikerSpec
from neurotact.encoders.sigma_delta import SigmaDeltaSpec
from neurotact.encoders.specs import EncoderSpec
from neurotact.errors import InputError, some

SMOOTHED_ms = 40.0
"""Length of the Hann window that smooths sigma-delta pulses: half of the amplitude is left at 25 Hz."""


def decode(spikes: np.ndarray, sampling_rate_Hz: float, encoder: EncoderSpec) -> np.ndarray:
    """The signal that an encoder's spikes stand for, `(trial, time, 2 taxel)` to `(trial, time, taxel)`, in its unit.

    It is that of the conditioned signal. Sums of steps begin at 0: they tell changes, not where the signal began.
    Ben's spiker is decoded without its delay. Raises InputError for a model whose spikes have no such meaning.

    >>> from neurotact.encoders.specs import encode, load
    >>> encoder = load("step-forward", {"threshold": 0.5})
    >>> ramp = np.linspace(0, 5, 101).reshape(1, 101, 1)
    >>> spikes, _ = encode(ramp, 1000.0, encoder)
    >>> bool(abs(decode(spikes, 1000.0, encoder) - ramp).max() <= 0.55)  # a threshold, and a sample's change
    True
    """
    if encoder.model not in DECODERS:
        known = some([*DECODERS], len(DECODERS))
        raise InputError(
            f"encoder: spikes of '{encoder.model}' have no meaning of their own, as those of {known} have; a linear "
            "filter decodes any (nt.what_survives)"
        )
    n_taxels = spikes.shape[2] // 2
    signed = spikes[..., :n_taxels].astype(float) - spikes[..., n_taxels:]
    return DECODERS[encoder.model](signed, 1e3 / sampling_rate_Hz, encoder)


def _steps(signed: np.ndarray, step_ms: float, encoder: Any) -> np.ndarray:
    del step_ms
    return encoder.threshold * np.cumsum(signed, axis=1)


def _low_pass(signed: np.ndarray, step_ms: float, encoder: SigmaDeltaSpec) -> np.ndarray:
    taps = bens_spiker.response(SMOOTHED_ms, step_ms)
    return encoder.threshold_unit_ms / step_ms * _filtered(signed, taps, (len(taps) - 1) // 2)


def _response(signed: np.ndarray, step_ms: float, encoder: BensSpikerSpec) -> np.ndarray:
    taps = bens_spiker.response(encoder.filter_ms, step_ms)
    return _filtered(signed, taps, len(taps) - 1) / encoder.gain


def _filtered(signed: np.ndarray, taps: np.ndarray, ahead: int) -> np.ndarray:
    """The convolution with the taps, `ahead` steps earlier, as long as the spikes."""
    n_steps, n_taps = signed.shape[1], len(taps)
    padded = np.pad(signed, ((0, 0), (n_taps - 1, ahead), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, n_taps, axis=1)
    return (windows @ taps[::-1])[:, ahead : ahead + n_steps]


DECODERS: dict[str, Callable[[np.ndarray, float, Any], np.ndarray]] = {
    "send-on-delta": _steps,
    "step-forward": _steps,
    "moving-window": _steps,
    "sigma-delta": _low_pass,
    "bens-spiker": _response,
}
"""The decoders of models whose spikes say by themselves what they stand for."""
