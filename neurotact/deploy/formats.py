"""Whole-number formats of a chain, chosen from what was recorded.

Samples are `zero + lsb x` with x in 16 bits. Filters and afferents keep `FRACTION` bits more than a sample in 32 bits.
Afferents need no gains: their thresholds are divided by them. A layer's currents and membranes share one unit, so that
the largest value seen on training windows, times `HEADROOM`, fills its bits; weights are `step 2^shift` of that unit.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neurotact.data.causal import Conditioner
from neurotact.deploy.chain import Chain
from neurotact.errors import InputError
from neurotact.networks import reference
from neurotact.networks.rsnn import RSNN
from neurotact.neurons import LIF, cuba_lif_start

FRACTION = 12
"""Bits behind the binary point of a conditioned sample: 16 + 12 bits, and two more for differences, fit 32."""
MANTISSA = 15
"""Bits of a filter's or an afferent's weight of the newest value, from its first one on."""
DECAY, FINE_DECAY = 15, 24
"""Bits of the network's decays: a state of 16 bits times the one fits 32; wider states take the other."""
HEADROOM = 1.25
"""Of the ranges: by how much later windows may exceed what was recorded before they saturate."""
MOST_LEAK = 0.05
"""Below this share of the threshold, rounding may leak as fast as the time constants do."""
LARGEST = 2**31 - 1
MOST_OFFSET = 2**28
WINDOWS = 256
"""Training windows whose states are recorded, at most."""


class Raw(NamedTuple):
    """A sample is `zero + lsb x`, x a whole number of 16 bits, in the encoder's unit."""

    lsb: float
    zero: float

    def samples(self, signal: np.ndarray) -> np.ndarray:
        """`x` of a signal, rounded and limited to 16 bits, int16.

        >>> Raw(0.5, 1.0).samples(np.array([1.0, 2.2, 1e9])).tolist()
        [0, 2, 32767]
        """
        return np.clip(np.rint((np.asarray(signal, np.float64) - self.zero) / self.lsb), -32768, 32767).astype(np.int16)


class Weight(NamedTuple):
    """A weight below 1 of `MANTISSA` bits: `mantissa / 2^bits`."""

    mantissa: int
    bits: int

    @staticmethod
    def of(value: float) -> "Weight":
        """The nearest; 1 becomes the largest below it.

        >>> Weight.of(0.0899), Weight.of(0.00157)
        (Weight(mantissa=23567, bits=18), Weight(mantissa=26340, bits=24))
        """
        bits = MANTISSA - math.frexp(value)[1]
        return Weight(min(round(value * 2.0**bits), 2**MANTISSA - 1), bits)


class FrontEnd(NamedTuple):
    """Conditioning and afferents in whole numbers.

    smoothing: weight of the newest sample; None without a moving average.
    stride: samples from one step to the next, whole ones and 2^-32ths; None where there is a step a sample.
    baseline: as in the encoder; baseline_steps: of `start`; baseline_weight: of `high-pass`.
    offset, and the thresholds and resets of SA-I and RA-I, `(taxel,)`, in units of 2^-FRACTION of a raw step.
    leak: of both populations; silent: their refractory steps.
    """

    smoothing: Weight | None
    stride: tuple[int, int] | None
    baseline: str
    baseline_steps: int
    baseline_weight: Weight | None
    offset: np.ndarray
    rectify: bool
    leak: Weight
    threshold_sa1: np.ndarray
    threshold_ra1: np.ndarray
    reset_sa1: np.ndarray
    reset_ra1: np.ndarray
    silent_sa1: int
    silent_ra1: int


class Layer(NamedTuple):
    """CUBA-LIF neurons in whole numbers: `I <- I alpha / 2^decay_bits + (x w) 2^shift + (s v) 2^shift_rec`, and so on.

    unit: what 1 of a state means. state_bits: to which states saturate.
    """

    unit: float
    state_bits: int
    w: np.ndarray
    shift: int
    v: np.ndarray | None
    shift_rec: int
    alpha: int
    beta: int
    threshold: int

    @property
    def decay_bits(self) -> int:
        return decay_bits(self.state_bits)

    @property
    def rounding_leak(self) -> float:
        """The largest state, in thresholds, that rounding towards zero takes off each step as much as its decay."""
        slowest = max(self.alpha, self.beta) / 2**self.decay_bits
        return math.inf if slowest >= 1 else 1 / (1 - slowest) / self.threshold


def decay_bits(state_bits: int) -> int:
    """Bits of a decay, beside states of so many."""
    return DECAY if state_bits <= 16 else FINE_DECAY


class Integrator(NamedTuple):
    """A readout that adds up: weights `(hidden, class)` and where it begins, in one unit."""

    unit: float
    w: np.ndarray
    bias: np.ndarray


class Formats(NamedTuple):
    """Everything whole about a chain; `weight_bits` and `state_bits` as asked for."""

    raw: Raw
    front: FrontEnd
    hidden: Layer
    readout: Layer | Integrator
    weight_bits: int
    state_bits: int


class Ranges(NamedTuple):
    """What was recorded: the samples' extremes, and the largest |I| or |U| of the hidden layer and of the readout."""

    low: float
    high: float
    hidden: float
    readout: float


def choose(
    chain: Chain, ranges: Ranges, *, weight_bits: int = 8, state_bits: int | None = None, lsb: float | None = None
) -> Formats:
    """Formats of a chain; InputError where a value does not fit.

    weight_bits: 2 to 8. state_bits: 8 to 16, or 24; absent, 16 where rounding leaks little beside the time constants
    (`MOST_LEAK`), else 24. lsb: of the samples; absent, the recorded range fills 16 bits.
    """
    if state_bits is None:
        chosen = choose(chain, ranges, weight_bits=weight_bits, state_bits=16, lsb=lsb)
        layers = [each for each in (chosen.hidden, chosen.readout) if isinstance(each, Layer)]
        if all(each.rounding_leak <= MOST_LEAK for each in layers):
            return chosen
        return choose(chain, ranges, weight_bits=weight_bits, state_bits=24, lsb=lsb)
    if not 2 <= weight_bits <= 8:
        raise InputError(f"weight_bits: must be from 2 to 8; got {weight_bits}")
    if not (8 <= state_bits <= 16 or state_bits == 24):
        raise InputError(f"state_bits: must be from 8 to 16, or 24; got {state_bits}")
    raw = _raw(ranges, lsb)
    network = chain.network
    hidden = _layer(network, 0, network.w_in, network.w_rec, ranges.hidden, weight_bits, state_bits)
    readout: Layer | Integrator
    if network.bias is not None:
        readout = _integrator(network, weight_bits, chain.windows.length)
    else:
        readout = _layer(network, 1, network.w_out, None, ranges.readout, weight_bits, state_bits)
    return Formats(raw, _front_end(chain, raw), hidden, readout, weight_bits, state_bits)


@torch.no_grad()
def record(network: RSNN, rasters: Tensor, signals: Sequence[np.ndarray]) -> Ranges:
    """Ranges over training windows `(window, time, afferent)` and over the samples of their trials."""
    seen = torch.linspace(0, len(rasters) - 1, min(len(rasters), WINDOWS)).long()
    spikes = rasters[seen].to(network.w_in.dtype)
    states = [cuba_lif_start(len(spikes), n, network.w_in) for n in (network.spec.hidden, network.n_classes)]
    largest = [0.0, 0.0]
    layers = ((network.w_in, network.w_rec), (network.w_out, None))
    for t in range(spikes.shape[1]):
        sent = spikes[:, t : t + 1]
        for index, (w, v) in enumerate(layers if network.bias is None else layers[:1]):
            sent, states[index] = reference.cuba_lif_layer(
                sent, w, v, alpha=network.alpha[index], beta=network.beta[index], threshold=network.threshold[index],
                neuron=network.neuron, spike=network.spike, state=states[index],
            )  # fmt: skip
            state = states[index]
            largest[index] = max(largest[index], float(state.current.abs().max()), float(state.membrane.abs().max()))
    low, high = min(float(s.min()) for s in signals), max(float(s.max()) for s in signals)
    return Ranges(low, high, *largest)


def _raw(ranges: Ranges, lsb: float | None) -> Raw:
    zero = 0.0 if ranges.low <= 0 <= ranges.high else (ranges.low + ranges.high) / 2
    reach = HEADROOM * max(abs(ranges.low - zero), abs(ranges.high - zero))
    if lsb is None:
        lsb = reach / 32767 or 1.0
    elif not 0 < lsb < math.inf:
        raise InputError(f"lsb: must be a positive number; got {lsb:g}")
    return Raw(lsb, zero)


def _front_end(chain: Chain, raw: Raw) -> FrontEnd:
    encoder, clock_Hz = chain.encoder, chain.clock_Hz
    conditioning = encoder.conditioning
    conditioner = Conditioner(chain.sampling_rate_Hz, chain.encoder.conditioning)
    sa1, ra1 = encoder.neuron(encoder.sa1, clock_Hz), encoder.neuron(encoder.ra1, clock_Hz)
    fine = 2.0**FRACTION / raw.lsb
    zero = raw.zero if conditioning.baseline == "none" else 0.0
    offset = np.zeros(chain.n_taxels) if conditioning.offset is None else np.array(conditioning.offset)
    scale = np.ones(chain.n_taxels) if conditioning.scale is None else np.array(conditioning.scale)
    shifted = np.rint((offset - zero) * fine)
    if (np.abs(shifted) > MOST_OFFSET).any():
        raise InputError("lsb: the encoder's offsets do not fit 28 bits of it; give a coarser one")
    gains = encoder.sa1.gain, encoder.ra1.gain * clock_Hz * 1e-3
    stride = None
    if conditioner.clock_Hz != conditioner.rate_Hz:
        whole, rest = divmod(round(conditioner.rate_Hz / conditioner.clock_Hz * 2**32), 2**32)
        stride = (whole, rest)
    past = conditioner.past
    high_pass = conditioning.baseline == "high-pass"
    levels = [_levels(neuron, gain, scale * fine) for neuron, gain in zip((sa1, ra1), gains, strict=True)]
    return FrontEnd(
        smoothing=None if conditioner.smoothing is None else Weight.of(conditioner.smoothing),
        stride=stride,
        baseline=conditioning.baseline,
        baseline_steps=past.n_start,
        baseline_weight=Weight.of(past.smoothing) if high_pass else None,
        offset=shifted.astype(np.int64),
        rectify=conditioning.rectify,
        leak=Weight.of(1.0 - sa1.decay),
        threshold_sa1=levels[0][0], threshold_ra1=levels[1][0],
        reset_sa1=levels[0][1], reset_ra1=levels[1][1],
        silent_sa1=sa1.refractory_steps, silent_ra1=ra1.refractory_steps,
    )  # fmt: skip


def _levels(neuron: LIF, gain: float, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Threshold and reset above rest, in the signal's unit: divided by the gain."""
    threshold = np.rint((neuron.v_threshold_mV - neuron.v_rest_mV) / gain * fine)
    reset = np.rint((neuron.v_reset_mV - neuron.v_rest_mV) / gain * fine)
    if (threshold < 1).any():
        raise InputError("lsb: a threshold is less than a step of it; give a finer one")
    return tuple(np.clip(each, -MOST_OFFSET, MOST_OFFSET * 8 - 1).astype(np.int64) for each in (threshold, reset))  # pyright: ignore


def _layer(
    network: RSNN, index: int, w: Tensor, v: Tensor | None, seen: float, weight_bits: int, state_bits: int
) -> Layer:
    alpha, beta, threshold = (float(part[index].detach()) for part in (network.alpha, network.beta, network.threshold))
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not 0 <= value <= 1:
            raise InputError(f"network: {name} is {value:g}, which is no decay; train it within 0 to 1")
    if threshold <= 0:
        raise InputError(f"network: a threshold of {threshold:g} has no integer form; train it above 0")
    weights = [np.asarray(each.detach().double()) for each in (w, v) if each is not None]
    largest = max(float(np.abs(each).max()) for each in weights) or 1.0
    top, most = 2 ** (weight_bits - 1) - 1, 2 ** (state_bits - 1) - 1
    least_unit = HEADROOM * max(seen, threshold) / most
    shift = max(0, math.floor(math.log2(largest / (top * least_unit))))
    # Sums of all weights stay below 2^30, beside a state of at most 2^23.
    shift = min(shift, 29 - math.ceil(math.log2(top * sum(len(each) for each in weights))))
    unit = max(largest / (top * 2**shift), least_unit)
    whole, shifts, bits = [], [], decay_bits(state_bits)
    for each in weights:
        own = max(0, math.ceil(math.log2(max(float(np.abs(each).max()), 1e-300) / (top * unit)) - 1e-9))
        whole.append(np.rint(each / (unit * 2**own)).clip(-top, top).astype(np.int64))
        shifts.append(own)
    return Layer(
        unit, state_bits, whole[0], shifts[0], whole[1] if v is not None else None, shifts[-1] if v is not None else 0,
        round(alpha * 2**bits), round(beta * 2**bits), max(1, round(threshold / unit)),
    )  # fmt: skip


def _integrator(network: RSNN, weight_bits: int, length: int) -> Integrator:
    assert network.bias is not None
    w, bias = (np.asarray(each.detach().double()) for each in (network.w_out, network.bias))
    top = 2 ** (weight_bits - 1) - 1
    unit = (float(np.abs(w).max()) or 1.0) / top
    whole = np.rint(w / unit).astype(np.int64)
    begin = np.rint(bias / unit)
    if np.abs(begin).max() + float(length) * np.abs(whole).sum(axis=0).max() > LARGEST:
        raise InputError("window: an integrator may pass 32 bits in so many steps; shorten the window")
    return Integrator(unit, whole, begin.astype(np.int64))
