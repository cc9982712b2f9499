"""From a trained network to the integers of XyloAudio 2: first to the chip's neurons, then to its bits."""

import math
from typing import NamedTuple

import numpy as np
import torch
from neurotact_parts.exporters import chips
from neurotact_parts.exporters.xylo.chip import (
    BITS,
    MOST_HIDDEN,
    MOST_READOUT,
    Chip,
    ChipLayer,
    Ran,
    a_step_later,
    with_last_step,
)
from torch import Tensor

from neurotact.networks.definition.rsnn import RSNN

LARGEST_WEIGHT, HIGHEST = 127, 2 ** (BITS - 1) - 1
MOST_SHIFT, MOST_DASH = 7, 15
FINER = 20
"""Extra bits of weights and thresholds in a chip without limits, which shows what the bits of the real one cost."""
IN_HALF = 1
"""Dash of currents that an integrator of ours does not have: the current halves, and in sum adds its weight."""


class Converted(NamedTuple):
    """A network on the chip, and how its decision is read.

    network: the same with the chip's neurons, in float. fine: the chip with `FINER` bits more, whose weights are not
    shifted. unit: the value of 1 of a weight of a readout that does not spike.
    """

    network: RSNN
    chip: Chip
    fine: Chip
    unit: float

    def labels(self, readout: Ran, of: Chip) -> np.ndarray:
        """The decision of each window of one of the chips: by spikes, or by membranes and the bias; first of equals."""
        integration = self.network.integration
        if integration is None:
            return readout.spikes.sum(axis=1).argmax(axis=1)
        peak, last = np.maximum(readout.membranes.max(axis=1), 0), readout.membranes[:, -1]
        reached = peak if integration.peak else last
        bits = FINER if of is self.fine else of.readout.shift
        return (self.unit * reached / 2**bits + integration.level.detach().numpy()).argmax(axis=1)


def with_neurons_of_the_chip(network: RSNN) -> RSNN:
    """A copy on its own clock: membrane `immediate`, reset `subtract`, no recurrent delay, decays by bit shifts.

    A time constant becomes the nearest one that a shift has. Thresholds, or the weights of an integrator that leaks,
    change so that a constant rate of spikes raises a membrane as far in relation to its threshold.

    >>> network = RSNN(2, 2, hidden=3, sampling_rate_Hz=1000.0, readout="count")
    >>> made = with_neurons_of_the_chip(network)
    >>> made.spec.membrane, made.spec.reset, round(float(1 / (1 - made.beta[0])))
    ('immediate', 'subtract', 16)
    """
    own = network.on_own_clock()
    leak = own.spec.readout_leak_ms
    changes = {"membrane": "immediate", "reset": "subtract", "recurrent_delay_steps": 0}
    if leak is not None:
        changes["readout_tau_ms"] = 1e3 * chips.steps_of(chips.shift_of(leak * 1e-3 * own.clock_Hz)) / own.clock_Hz
    spec = own.spec.model_copy(update=changes)
    made = RSNN(own.n_inputs, own.n_classes, spec, own.clock_Hz, generator=torch.Generator(), dtype=own.w_in.dtype)
    made.load_state_dict(own.state_dict())
    made = made.to(own.w_in.device).requires_grad_(False)
    for decays in (made.alpha, made.beta):
        decays.copy_(torch.tensor([1 - 2.0 ** -_dash(float(decay)) for decay in decays]))
    through = own.beta if own.spec.membrane == "eq4" else torch.ones(2)
    gains = _gain(made.alpha) * _gain(made.beta), _gain(own.alpha) * _gain(own.beta) * through.detach()
    made.threshold.mul_(gains[0] / gains[1])
    if leak is not None:
        made.w_out.mul_((1 - made.readout_decay) / (1 - own.readout_decay))
    return made


def converted(network: RSNN, windows: Tensor) -> Converted:
    """A network in the chip's integers; windows: of training, `(window, time, afferent)`, at most some hundred.

    Each neuron has its own step of 8-bit weights, except for a readout that does not spike. How far the weights of a
    projection are shifted left, which uses more of the 16 bits of currents and membranes, these windows decide.
    """
    made = with_neurons_of_the_chip(network)
    w_in, w_out = (w.detach().double().numpy() for w in (made.w_in, made.w_out))
    w_rec = None if made.w_rec is None else made.w_rec.detach().double().numpy()
    dashes = [(_dash(float(alpha)), _dash(float(beta))) for alpha, beta in zip(made.alpha, made.beta, strict=True)]
    thresholds = made.threshold.tolist()
    inputs = with_last_step(network.binned(windows).numpy())
    first = _Asked(w_in, w_rec, *dashes[0], thresholds[0], MOST_HIDDEN)
    second = _Asked(w_out, None, *dashes[1], thresholds[1], MOST_READOUT)
    if made.integration is not None:
        decay = made.readout_decay
        second = _Asked(w_out, None, IN_HALF, _dash(decay) if decay < 1 else MOST_DASH, math.inf, MOST_READOUT)
    fine = Chip(first.rounded(0, FINER), second.rounded(0, FINER))
    hidden, ran = _in_bits(first, fine.hidden.run(inputs), inputs)
    heard = a_step_later(ran.spikes)
    readout, _ = _in_bits(second, fine.readout.run(heard), heard)
    return Converted(made, Chip(hidden, readout), fine, float(second.unit(0, 0).max()))


class _Asked(NamedTuple):
    """A layer before it is rounded; an infinite threshold: its membranes are read, in one unit."""

    w: np.ndarray
    v: np.ndarray | None
    dash_syn: int
    dash_mem: int
    threshold: float
    most: int

    @property
    def reached(self) -> float:
        """The threshold in units of a weight: a current falls once before it reaches the membrane."""
        return self.threshold * (1 - 2.0**-self.dash_syn)

    def shifts(self, most: int) -> tuple[int, int]:
        """Of the two projections, the larger one `most`: the other's largest weight fills its bits as well."""
        if self.v is None or not (self.v.any() and self.w.any()):
            return most, most
        apart = math.floor(math.log2(np.abs(self.w).max() / np.abs(self.v).max()))
        return max(0, most + min(0, apart)), max(0, most - max(0, apart))

    def unit(self, shift: int, shift_among: int) -> np.ndarray:
        """The value of 1 of a state, `(neuron,)`."""
        units = np.abs(self.w).max(axis=0, initial=0) / (LARGEST_WEIGHT << shift)
        if self.v is not None:
            units = np.maximum(units, np.abs(self.v).max(axis=0, initial=0) / (LARGEST_WEIGHT << shift_among))
        if math.isinf(self.threshold):
            units = np.full_like(units, units.max())
        else:
            units = np.maximum(units, self.reached / (HIGHEST - 1))
        return np.where(units > 0, units, 1.0)

    def rounded(self, most: int, finer: int = 0) -> ChipLayer:
        """The layer, with the larger of its two shifts, and so many bits more."""
        shifts = self.shifts(most)
        unit = self.unit(*shifts)
        w, v = (
            None if w is None else np.rint(w / unit * 2.0 ** (finer - k)).astype(np.int64)
            for w, k in zip((self.w, self.v), shifts, strict=True)
        )
        assert w is not None
        bits = BITS + 2 * finer
        # A membrane of ours spikes above the threshold, one of the chip at it.
        threshold = np.minimum(np.floor(self.reached / unit * 2**finer) + 1, 2 ** (bits - 1) - 1).astype(np.int64)
        return ChipLayer(w, v, *shifts, self.dash_syn, self.dash_mem, threshold, self.most, bits)


def _in_bits(asked: _Asked, fine: Ran, arriving: np.ndarray) -> tuple[ChipLayer, Ran]:
    """The shift of a layer whose spikes are most as without rounding, or that clips least where membranes are read.

    fine: the answer with `FINER` bits more to the spikes `(window, step, presynaptic)`. Of equals the largest shift.
    """
    tried = [(layer := asked.rounded(most), layer.run(arriving)) for most in range(MOST_SHIFT, -1, -1)]
    if math.isinf(asked.threshold):
        return min(tried, key=lambda each: each[1].clipped)
    return min(tried, key=lambda each: int((each[1].spikes != fine.spikes).sum()))


def _dash(decay: float) -> int:
    """The shift whose decay has the nearest time constant."""
    return chips.shift_of(-1 / math.log(min(max(decay, 1e-9), 1 - 1e-9)))


def _gain(decays: Tensor) -> Tensor:
    """What a constant input of 1 adds up to."""
    return 1 / (1 - decays.detach().clamp(max=1 - 2.0**-MOST_DASH))
