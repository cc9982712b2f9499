"""An encoder: ON where the signal rises above a threshold, OFF where it falls below."""

from typing import Literal, NamedTuple

import numpy as np

from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, both, over_time
from neurotact.metrics.flops import changed, with_weights


class CrossingSpec(EncoderSpec):
    """`model` is the name of the entry point; calibration sets the threshold."""

    model: Literal["crossings"] = "crossings"
    threshold: float = 1.0


class CrossingState(NamedTuple):
    """What a piece of a signal leaves for the next one: (trial, taxel)."""

    above: np.ndarray


def encode(signal, sampling_rate_Hz, spec, state=None):
    """Spikes (trial, time, 2 taxel) of a conditioned signal (trial, time, taxel), and the state after it."""

    def step(x, state):
        above, before = x > spec.threshold, state.above
        return both(above & ~before, before & ~above), CrossingState(above)

    start = state or CrossingState(np.zeros_like(signal[:, 0], bool))
    return over_time(signal, start, step, 2 * signal.shape[2])


def cost(spec, taxels, steps, step_ms):
    """A comparison of each sample; a threshold, in a register, and a state of each taxel, read and written."""
    return with_weights(1, taxels, comparisons=taxels * steps, **changed(taxels, steps))


MODEL = Model("threshold crossings", CrossingSpec, encode, CrossingState, ON_OFF, cost)
