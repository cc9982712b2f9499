"""The arithmetic of XyloAudio 2, in NumPy: two layers of LIF neurons whose decays are bit shifts.

It is that of XyloSim 0.1.3 (the package xylosim, `src/v2`), Rockpool's simulator of the chip, to the bit. In a step,
each spike that arrives adds its weight to the current of a neuron, I, which is clipped to 16 bits after each. Then I
falls by `I >> dash`, and the membrane U rises by I and falls by `U >> dash`. A shift rounds down, and takes at least 1
from a positive value. A neuron spikes once for each threshold in U, which is taken off at once; hidden neurons up to 31
times in a step, readout neurons once. What a hidden neuron sends arrives in the next step, at the readout as well.
"""

from typing import Any, NamedTuple

import numpy as np

BITS = 16
"""Of a current and of a membrane."""
MOST_HIDDEN, MOST_READOUT = 31, 1
"""Spikes of a neuron in one step."""


class Ran(NamedTuple):
    """What a layer did: spikes uint8, currents and membranes int16 after each step, `(window, step, neuron)`.

    clipped: how often a current or a membrane met the limits of 16 bits.
    """

    spikes: np.ndarray
    currents: np.ndarray
    membranes: np.ndarray
    clipped: int = 0


class ChipLayer(NamedTuple):
    """A layer of the chip.

    weights: int64 in 8 bits, `(presynaptic, neuron)`; among: those from the layer itself, or None. Each is shifted left
        by `shift`, `shift_among` bits.
    dash_syn, dash_mem: shifts of the decays of currents and membranes, from 1. threshold: `(neuron,)`, from 1.
    most: spikes of a neuron in a step. bits: of currents and membranes; more than the chip's only to tell what these
        cost.
    """

    weights: np.ndarray
    among: np.ndarray | None
    shift: int
    shift_among: int
    dash_syn: int
    dash_mem: int
    threshold: np.ndarray
    most: int
    bits: int = BITS

    def run(self, arriving: np.ndarray) -> Ran:
        """The layer's answer to spike counts, `(window, step, presynaptic)`, from a silent start.

        >>> layer = ChipLayer(np.array([[40]]), None, 0, 0, 1, 4, np.array([30]), most=31)
        >>> ran = layer.run(np.array([[[1], [0], [0]]]))
        >>> [each.ravel().tolist() for each in ran[:3]]
        [[0, 0, 1], [20, 10, 5], [20, 29, 3]]
        """
        weights, among = self.weights << self.shift, None if self.among is None else self.among << self.shift_among
        lowest, highest = -(2 ** (self.bits - 1)), 2 ** (self.bits - 1) - 1
        current = membrane = sent = np.zeros((len(arriving), weights.shape[1]), np.int64)
        state = np.int16 if self.bits == BITS else np.int64
        steps, clipped = [], 0
        for spikes in arriving.transpose(1, 0, 2):
            current = _delivered(current, spikes, weights, highest)
            current = current if among is None else _delivered(current, sent, among, highest)
            full = (current == lowest) | (current == highest)
            current = current - _decay(current, self.dash_syn)
            wanted = current - _decay(membrane, self.dash_mem)
            change = np.clip(wanted, lowest, highest)
            risen = membrane + change
            membrane = np.clip(risen, lowest, highest)
            clipped += int((full | (wanted != change) | (risen != membrane)).sum())
            sent = np.clip(membrane // self.threshold, 0, self.most)
            membrane = membrane - sent * self.threshold
            steps.append((sent.astype(np.uint8), current.astype(state), membrane.astype(state)))
        sent, current, membrane = (np.stack(each, axis=1) for each in zip(*steps, strict=True))
        return Ran(sent, current, membrane, clipped)


class Chip(NamedTuple):
    """A network on the chip."""

    hidden: ChipLayer
    readout: ChipLayer

    def run(self, spikes: np.ndarray) -> tuple[Ran, Ran]:
        """Hidden layer and readout for input spikes `(window, step, input)` and one silent step after them.

        In that step the readout receives the last spikes of hidden neurons.
        """
        hidden = self.hidden.run(with_last_step(spikes))
        return hidden, self.readout.run(a_step_later(hidden.spikes))

    @property
    def specification(self) -> dict[str, Any]:
        """The arguments of `XyloSim.from_specification` in Rockpool's `devices.xylo.syns61201`, arrays as lists."""
        (hidden, readout), n = self, len(self.hidden.threshold)
        made = {
            "weights_in": hidden.weights,
            **({} if hidden.among is None else {"weights_rec": hidden.among}),
            "weights_out": readout.weights,
            "dash_mem": np.full(n, hidden.dash_mem),
            "dash_mem_out": np.full(len(readout.threshold), readout.dash_mem),
            "dash_syn": np.full(n, hidden.dash_syn),
            "dash_syn_out": np.full(len(readout.threshold), readout.dash_syn),
            "threshold": hidden.threshold,
            "threshold_out": readout.threshold,
        }
        shifts = {"in": hidden.shift, "rec": hidden.shift_among, "out": readout.shift}
        return {name: value.tolist() for name, value in made.items()} | {
            f"weight_shift_{name}": shift for name, shift in shifts.items()
        }


def with_last_step(spikes: np.ndarray) -> np.ndarray:
    """Spikes `(window, step, input)` and a silent step."""
    return np.pad(spikes, ((0, 0), (0, 1), (0, 0)))


def a_step_later(spikes: np.ndarray) -> np.ndarray:
    """Spikes `(window, step, neuron)` as they arrive at the readout."""
    return np.pad(spikes, ((0, 0), (1, 0), (0, 0)))[:, :-1]


def _decay(values: np.ndarray, dash: int) -> np.ndarray:
    """What a step takes off."""
    change = values >> dash
    return np.where(change == 0, np.sign(values), change)


def _delivered(current: np.ndarray, spikes: np.ndarray, weights: np.ndarray, highest: int) -> np.ndarray:
    """Currents after spikes `(window, presynaptic)`, in ascending order, each clipped."""
    arriving = spikes.astype(np.float64)  # whole numbers far below 2^53 stay whole, and products are fast
    if (np.abs(current) + arriving @ np.abs(weights)).max(initial=0) <= highest:
        return current + (arriving @ weights).astype(np.int64)
    for row, weight in zip(spikes.T, weights, strict=True):
        current = np.clip(current + row[:, None] * weight, -highest - 1, highest)
    return current
