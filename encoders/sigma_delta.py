"""Sigma-delta: the signal minus what the pulses already say is integrated; at a threshold a pulse is sent, ON or OFF.

Inose and Yasuda 1963, doi 10.1109/PROC.1963.2622; that integrate-and-fire neurons do the same is in Yoon 2017,
doi 10.1109/TNNLS.2016.2526029.
"""

from typing import Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.decoding import filtered, hann
from neurotact_parts.encoders.send_on_delta import cost
from pydantic import Field

from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, RefractoryMs, both, checked, over_time
from neurotact.neurons import refractory_steps, silenced

SMOOTHED_ms = 40.0
"""Length of the Hann window that smooths sigma-delta pulses: half of the amplitude is left at 25 Hz."""
OVERLOAD = 4.0
"""The integral is limited to this many thresholds: what a too strong signal leaves does not fire on for long."""


class _SigmaDeltaSpec(EncoderSpec):
    """ON and OFF pulses of every taxel (`encoders/sigma-delta.toml`)."""

    model: Literal["sigma-delta"] = "sigma-delta"
    """A pulse when the integral of the error reaches a threshold."""
    threshold_unit_ms: float = Field(gt=0)
    """Integral of the conditioned signal over time that one pulse stands for, in its unit times ms."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time of a taxel after a pulse; the integral goes on."""


class _SigmaDeltaState(NamedTuple):
    """The integral of the error of each taxel, in its unit times ms, and the silent steps to come, `(trial, taxel)`."""

    integral: np.ndarray
    silent_steps: np.ndarray


def _encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: _SigmaDeltaSpec, state: _SigmaDeltaState | None = None
) -> tuple[np.ndarray, _SigmaDeltaState]:
    """Pulses of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, ON first.

    `v <- v + x dt`; ON where `v >= threshold`, and v falls by the threshold; OFF where `v <= -threshold`, and it rises
    by as much. So v is the integral of the signal minus that of the pulses: their error is pushed to high frequencies,
    and a low-pass filter of the pulses gives the signal. A constant x fires at `x / threshold` per ms.

    >>> spikes, _ = _encode(np.full((1, 1000, 1), -2.0), 1000.0, _SigmaDeltaSpec(threshold_unit_ms=20.0))
    >>> spikes[0].sum(axis=0).tolist()  # 2 / 20 per ms, in 1000 ms
    [0, 100]
    """
    signal = checked(signal)
    kind = signal.dtype.type
    threshold, limit = kind(spec.threshold_unit_ms), kind(OVERLOAD * spec.threshold_unit_ms)
    step_ms, n_silent = kind(1e3 / sampling_rate_Hz), refractory_steps(spec.t_ref_ms, sampling_rate_Hz)

    def step(x: np.ndarray, state: _SigmaDeltaState) -> tuple[np.ndarray, _SigmaDeltaState]:
        integral = np.clip(state.integral + step_ms * x, -limit, limit)
        awake = state.silent_steps == 0
        up, down = awake & (integral >= threshold), awake & (integral <= -threshold)
        integral = np.where(up, integral - threshold, np.where(down, integral + threshold, integral))
        return both(up, down), _SigmaDeltaState(integral, silenced(state.silent_steps, up | down, n_silent))

    n_trials, _, n_taxels = signal.shape
    shape = n_trials, n_taxels
    begin = _SigmaDeltaState(np.zeros(shape, signal.dtype), np.zeros(shape, np.int32))
    return over_time(signal, begin if state is None else state, step, 2 * n_taxels)


def _decode(signed: np.ndarray, step_ms: float, spec: _SigmaDeltaSpec) -> np.ndarray:
    taps = hann(SMOOTHED_ms, step_ms)
    return spec.threshold_unit_ms / step_ms * filtered(signed, taps, (len(taps) - 1) // 2)


MODEL = Model("sigma-delta pulses", _SigmaDeltaSpec, _encode, _SigmaDeltaState, ON_OFF, cost, decode=_decode)
