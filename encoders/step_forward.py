"""Step-forward: a staircase follows the signal, one threshold up (ON) or down (OFF) an event.

Kasabov et al. 2016, doi 10.1016/j.neunet.2015.09.011 (NeuCube); compared with other encoders in Petro, Kasabov and
Kiss 2020, doi 10.1109/TNNLS.2019.2906158.
"""

from typing import Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.send_on_delta import cost, sum_of_steps
from pydantic import Field

from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, RefractoryMs, both, checked, over_time
from neurotact.neurons import refractory_steps, silenced


class _StepForwardSpec(EncoderSpec):
    """ON and OFF events of every taxel (`encoders/step-forward.toml`)."""

    model: Literal["step-forward"] = "step-forward"
    """A staircase that follows the signal, one step an event."""
    threshold: float = Field(gt=0)
    """Height of a step, in the unit of the conditioned signal."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time of a taxel after an event, ON or OFF."""


class _StepForwardState(NamedTuple):
    """The staircase of each taxel and its silent steps still to come, `(trial, taxel)`.

    `base` is None before the first sample, at which the staircase begins.
    """

    base: np.ndarray | None
    silent_steps: np.ndarray


def _encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: _StepForwardSpec, state: _StepForwardState | None = None
) -> tuple[np.ndarray, _StepForwardState]:
    """Events of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, ON first.

    ON where `x > base + threshold`, and the base rises by the threshold; OFF where `x < base - threshold`, and it falls
    by as much. What one event leaves of a large change the next ones send: the sum of the steps follows the signal
    within a threshold, unless it changes faster than one threshold in a step of the clock (or in t_ref).

    >>> jump = np.array([0.0, 7.0, 7.0, 7.0, 7.0]).reshape(1, 5, 1)
    >>> spikes, state = _encode(jump, 1000.0, _StepForwardSpec(threshold=3.0))
    >>> spikes[0, :, 0].tolist(), state.base.tolist()
    ([0, 1, 1, 0, 0], [[6.0]])
    """
    signal = checked(signal)
    threshold = signal.dtype.type(spec.threshold)
    n_silent = refractory_steps(spec.t_ref_ms, sampling_rate_Hz)

    def step(x: np.ndarray, state: _StepForwardState) -> tuple[np.ndarray, _StepForwardState]:
        base, awake = x if state.base is None else state.base, state.silent_steps == 0
        up, down = awake & (x > base + threshold), awake & (x < base - threshold)
        base = np.where(up, base + threshold, np.where(down, base - threshold, base))
        return both(up, down), _StepForwardState(base, silenced(state.silent_steps, up | down, n_silent))

    n_trials, _, n_taxels = signal.shape
    begin = _StepForwardState(None, np.zeros((n_trials, n_taxels), np.int32))
    return over_time(signal, begin if state is None else state, step, 2 * n_taxels)


MODEL = Model("step-forward events", _StepForwardSpec, _encode, _StepForwardState, ON_OFF, cost, decode=sum_of_steps)
