"""Send-on-delta: an event when the signal has changed by a threshold since the last one (ON: up, OFF: down).

Miskowicz 2006, doi 10.3390/s6010049; an event-based sensor does it in the pixel (Lichtsteiner et al. 2008,
doi 10.1109/JSSC.2007.914337), and so do the published Braille letters (Müller-Cleve et al. 2022,
doi 10.3389/fnins.2022.951164).
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, RefractoryMs, both, checked, over_time
from neurotact.metrics.flops import Cost, changed, with_weights
from neurotact.neurons import refractory_steps, silenced


class SendOnDeltaSpec(EncoderSpec):
    """ON and OFF events of every taxel (`encoders/send-on-delta.toml`)."""

    model: Literal["send-on-delta"] = "send-on-delta"
    """An event when the signal has changed by a threshold since the last one."""
    threshold: float = Field(gt=0)
    """Change of the conditioned signal that gives an event, in its unit."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time of a taxel after an event, ON or OFF."""


class _SendOnDeltaState(NamedTuple):
    """The reference of each taxel and its silent steps still to come, `(trial, taxel)`.

    `reference` is None before the first sample, which is the first reference.
    """

    reference: np.ndarray | None
    silent_steps: np.ndarray


def _encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: SendOnDeltaSpec, state: _SendOnDeltaState | None = None
) -> tuple[np.ndarray, _SendOnDeltaState]:
    """Events of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, ON first.

    ON where `x - reference >= threshold`, OFF where `x - reference <= -threshold`; then the reference is x. So an event
    stands for a change of the threshold or more: a change of several thresholds between two samples is one event, and a
    finer clock (`conditioning.resample_Hz`) tells them apart. In the refractory period nothing is sent and the
    reference stays, so that the change is sent after it, as one event.

    >>> ramp = np.arange(12.0).reshape(1, 12, 1)
    >>> spikes, _ = _encode(ramp, 1000.0, SendOnDeltaSpec(threshold=3.0))
    >>> spikes[0, :, 0].tolist(), int(spikes[0, :, 1].sum())
    ([0, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0], 0)
    """
    signal = checked(signal)
    threshold = signal.dtype.type(spec.threshold)
    n_silent = refractory_steps(spec.t_ref_ms, sampling_rate_Hz)

    def step(x: np.ndarray, state: _SendOnDeltaState) -> tuple[np.ndarray, _SendOnDeltaState]:
        reference = x if state.reference is None else state.reference
        change, awake = x - reference, state.silent_steps == 0
        up, down = awake & (change >= threshold), awake & (change <= -threshold)
        fired = up | down
        after = _SendOnDeltaState(np.where(fired, x, reference), silenced(state.silent_steps, fired, n_silent))
        return both(up, down), after

    n_trials, _, n_taxels = signal.shape
    begin = _SendOnDeltaState(None, np.zeros((n_trials, n_taxels), np.int32))
    return over_time(signal, begin if state is None else state, step, 2 * n_taxels)


def cost(_spec: Mapping[str, Any], taxels: int, steps: int, _step_ms: float) -> Cost:
    """The cost of ON and OFF events of a change against a reference, or of an integral, over that many steps.

    Per taxel and step: a difference from the reference (or a sample added to the integral) and the comparisons with the
    threshold above and below. What an event does to the reference is rare and not counted.
    """
    updates = taxels * steps
    moved = {"weights_accesses": updates, **changed(2, updates)}  # a reference and a refractory counter
    return with_weights(1, 2 * taxels, acs=updates, comparisons=2 * updates, **moved)


def sum_of_steps(signed: np.ndarray, _step_ms: float, encoder: Any) -> np.ndarray:
    """The sum so far of ON minus OFF, `(trial, time, taxel)`, each a `threshold`."""
    return encoder.threshold * np.cumsum(signed, axis=1)


MODEL = Model("send-on-delta events", SendOnDeltaSpec, _encode, _SendOnDeltaState, ON_OFF, cost, decode=sum_of_steps)
