"""Integer formats of a chain, chosen from recorded ranges.

Samples are `zero + lsb x` with x in 16 bits; whole numbers that fit are x themselves. Filters and afferents have
`FRACTION` bits more than a sample, in 32 bits.
Afferents need no gains: their thresholds are divided by them. A layer's currents and membranes have one unit: the
largest value on training windows, times `HEADROOM`, fills its bits. Weights are `step 2^shift` of that unit.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from neurotact_parts.streams.chain import Chain
from torch import Tensor

from neurotact.data.conditioning import Conditioner
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.specs import conditioning_of, is_exact
from neurotact.errors import InputError
from neurotact.networks.definition.executors import Subject, require
from neurotact.networks.definition.readouts import Stretches
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.training.ranges import Ranges
from neurotact.neurons import decay_per_step

FRACTION = 12
"""Bits after the binary point of a conditioned sample: 16 + 12 bits, and two more for differences, fit in 32."""
MANTISSA = 15
"""Significant bits of a filter's or an afferent's weight of the newest value."""
DECAY, FINE_DECAY = 15, 24
"""Bits of the network's decays: a state of 16 bits times `DECAY` bits fits in 32; wider states use `FINE_DECAY`."""
HEADROOM = 1.25
"""Factor by which later windows may exceed the recorded ranges before they saturate."""
MOST_LEAK = 0.05
"""Share of the threshold below which rounding may leak as fast as the time constants."""
LARGEST = 2**31 - 1
MOST_OFFSET = 2**28
FINEST = 128
"""Units of the afferents' arithmetic in the least threshold, from which on rounding it moves it by less than 0.4 %."""

TICK = 16
"""Bits of a step in the times of afferents in closed form."""
OCTAVE = 24
"""Bits after the binary point of a logarithm to the base 2, and of a power of 2."""
PIECE = 6
"""Bits of the number of straight pieces of an octave of both: of 64, a logarithm is at most 4.5e-5 of an octave off."""


class Raw(NamedTuple):
    """A sample is `zero + lsb x` in the encoder's unit, with an integer x of 16 bits."""

    lsb: float
    zero: float

    def samples(self, signal: np.ndarray) -> np.ndarray:
        """`x` of a signal, rounded and clipped to int16.

        >>> Raw(0.5, 1.0).samples(np.array([1.0, 2.2, 1e9])).tolist()
        [0, 2, 32767]
        """
        return np.clip(np.rint((np.asarray(signal, np.float64) - self.zero) / self.lsb), -32768, 32767).astype(np.int16)

    @property
    def is_plain(self) -> bool:
        """Whether a sample is the signal itself."""
        return (self.lsb, self.zero) == (1.0, 0.0)


class Weight(NamedTuple):
    """A weight below 1 of `MANTISSA` bits: `mantissa / 2^bits`."""

    mantissa: int
    bits: int

    @staticmethod
    def of(value: float) -> "Weight":
        """The nearest one; 1 becomes the largest weight below 1.

        >>> Weight.of(0.0899), Weight.of(0.00157)
        (Weight(mantissa=23567, bits=18), Weight(mantissa=26340, bits=24))
        """
        bits = MANTISSA - math.frexp(value)[1]
        return Weight(min(round(value * 2.0**bits), 2**MANTISSA - 1), bits)


class ClosedForm(NamedTuple):
    """Times of afferents in closed form, in ticks: 2^-TICK of a step.

    stride: steps from one sample to the next, as an integer and 2^-32ths, rounded up; sample: the same in ticks.
    octave: in which the distance of a membrane from its target halves. per_tick: the octaves of a tick, times
    2^(TICK + OCTAVE). kept: of a membrane's distance from its target after a sample, times 2^OCTAVE.
    """

    stride: tuple[int, int]
    sample: int
    octave: int
    per_tick: int
    kept: int


class Afferents(NamedTuple):
    """One afferent under each taxel, in integers.

    name: of its levels: `sa1` or `ra1`, with a number from the second grade on. drive: what the afferent receives.
    threshold, reset: `(taxel,)`, in units of 2^-FRACTION of a raw step. silent: refractory steps; in closed form ticks.
    taxels: those that have one, of the taxels that are used.
    """

    name: str
    drive: Literal["signal", "falling", "change"]
    threshold: np.ndarray
    reset: np.ndarray
    silent: int
    taxels: list[int]


class FrontEnd(NamedTuple):
    """Conditioning and afferents in integers.

    smoothing: weight of the newest sample; None without a moving average.
    stride: samples from one step of the conditioned signal to the next, as an integer and 2^-32ths; None for one step
        per sample.
    baseline: as in the encoder; baseline_steps: of `start`; baseline_weight: of `high-pass`.
    offset: `(taxel,)`, in units of 2^-FRACTION of a raw step.
    sign: of each taxel's scale, `(taxel,)`; -1 for a signal that falls on contact. Thresholds contain its magnitude.
    leak: of all afferents at a step of their clock. kinds: the afferents under each taxel, SA-I first.
    columns: the taxels that are used, of those of a sample; all else is of these alone.
    closed: of afferents in closed form; None on a clock.
    """

    smoothing: Weight | None
    stride: tuple[int, int] | None
    baseline: str
    baseline_steps: int
    baseline_weight: Weight | None
    offset: np.ndarray
    sign: np.ndarray
    rectify: bool
    leak: Weight
    kinds: tuple[Afferents, ...]
    columns: list[int]
    closed: ClosedForm | None = None


class Layer(NamedTuple):
    """CUBA-LIF neurons in integers: `I <- I alpha / 2^decay_bits + (x w) 2^shift + (s v) 2^shift_rec`, and so on.

    unit: the value of 1 of a state. state_bits: bits at which states saturate.
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
        """The largest state, in thresholds, at which rounding towards zero subtracts as much per step as the decay."""
        slowest = max(self.alpha, self.beta) / 2**self.decay_bits
        return math.inf if slowest >= 1 else 1 / (1 - slowest) / self.threshold


def decay_bits(state_bits: int) -> int:
    """Bits of a decay, for states of `state_bits`."""
    return DECAY if state_bits <= 16 else FINE_DECAY


class Integrator(NamedTuple):
    """A readout that integrates: weights `(heard, class)` and initial values, in one unit; of numbers, each in its own.

    stretches: of a window, if each has weights of its own; w is then `(K, heard, class)`.
    """

    unit: float | np.ndarray
    w: np.ndarray
    bias: np.ndarray
    stretches: Stretches | None = None

    def at(self, step: int) -> np.ndarray:
        """The weights in a step of the network, `(heard, class)`."""
        return self.w if self.stretches is None else self.w[self.stretches.of_step(step)]


class Steps(NamedTuple):
    """The value of 1 of an integer weight, in each matrix; `w_out` also of an integrator's bias.

    w_rec: None without recurrence.
    """

    w_in: float
    w_rec: float | None
    w_out: float


class Layers(NamedTuple):
    """A network in integers."""

    hidden: Layer
    readout: Layer | Integrator

    @property
    def steps(self) -> Steps:
        """The steps of its weights.

        >>> network = RSNN(2, 2, hidden=3, model="snn", sampling_rate_Hz=1000.0)
        >>> layers = layers_of(network, (4.0, 2.0), weight_bits=4, state_bits=16, n_steps=50)
        >>> most = float(network.w_in.detach().abs().max()) / (2 ** (4 - 1) - 1)
        >>> math.isclose(layers.steps.w_in, most), layers.steps.w_rec
        (True, None)
        """
        hidden, readout = self
        shift = 0 if isinstance(readout, Integrator) else readout.shift
        return Steps(
            hidden.unit * 2.0**hidden.shift,
            None if hidden.v is None else hidden.unit * 2.0**hidden.shift_rec,
            float(np.max(readout.unit)) * 2.0**shift,
        )


class Formats(NamedTuple):
    """All integers of a chain; `weight_bits` as given."""

    raw: Raw
    front: FrontEnd
    hidden: Layer
    readout: Layer | Integrator
    weight_bits: int
    state_bits: int


def choose(
    chain: Chain,
    ranges: Ranges,
    *,
    weight_bits: int = 8,
    state_bits: int | None = None,
    lsb: float | None = None,
    steps: Steps | None = None,
) -> Formats:
    """Formats of a chain; InputError if a value does not fit.

    weight_bits, state_bits, steps: as for `layers_of`. lsb: of the samples. None: 1 for whole numbers that fit in 16
    bits, so that the sensor's counts are samples; else the recorded range fills 16 bits. Samples are counted from 0
    where that fits.
    """
    require("c-integer", chain.subject)
    largest, n_steps = (ranges.hidden, ranges.readout), chain.windows.length
    hidden, readout = layers_of(
        chain.network, largest, weight_bits=weight_bits, state_bits=state_bits, n_steps=n_steps, steps=steps,
        tells_numbers=chain.tells_numbers,
    )  # fmt: skip
    raw = _raw(ranges, lsb)
    if lsb is None and ranges.is_whole and _reach(ranges, 0.0) <= 32767 and _is_fine(chain, Raw(1.0, 0.0)):
        raw = Raw(1.0, 0.0)
    return Formats(raw, _front_end(chain, raw), hidden, readout, weight_bits, hidden.state_bits)


def layers_of(
    network: RSNN,
    seen: tuple[float, float],
    *,
    weight_bits: int,
    state_bits: int | None,
    n_steps: int,
    steps: Steps | None = None,
    tells_numbers: bool = False,
) -> Layers:
    """The layers of a network in integers; InputError if a value does not fit.

    seen: the largest |I| or |U| of the hidden layer and of the readout (`record_states`).
    weight_bits: 2 to 8. state_bits: 8 to 16, or 24; None: 16 if rounding leaks little compared with the time constants
    (`MOST_LEAK`), else 24. n_steps: of a window.
    steps: of the weights, from fine-tuning; None: the largest weight of a layer fills its bits.
    tells_numbers: each readout neuron has a unit of its own, since no two are compared.
    """
    options = {"weight_bits": weight_bits, "n_steps": n_steps, "steps": steps, "tells_numbers": tells_numbers}
    if state_bits is None:
        layers = layers_of(network, seen, state_bits=16, **options)
        leaks = [layer.rounding_leak for layer in layers if isinstance(layer, Layer)]
        return layers if max(leaks) <= MOST_LEAK else layers_of(network, seen, state_bits=24, **options)
    require("c-integer", Subject(None, network))
    if not 2 <= weight_bits <= 8:
        raise InputError(f"weight_bits: must be from 2 to 8; got {weight_bits}")
    if not (8 <= state_bits <= 16 or state_bits == 24):
        raise InputError(f"state_bits: must be from 8 to 16, or 24; got {state_bits}")
    bits = (weight_bits, state_bits)
    w_in, w_rec, w_out = steps or (None, None, None)
    hidden = _layer(network, 0, (network.w_in, network.w_rec), seen[0], bits, (w_in, w_rec))
    if network.bias is not None:
        return Layers(hidden, _integrator(network, weight_bits, n_steps, w_out, tells_numbers=tells_numbers))
    return Layers(hidden, _layer(network, 1, (network.w_out, None), seen[1], bits, (w_out, None)))


def _raw(ranges: Ranges, lsb: float | None) -> Raw:
    zero = 0.0 if ranges.low <= 0 <= ranges.high else (ranges.low + ranges.high) / 2
    if lsb is None:
        return Raw(_reach(ranges, zero) / 32767 or 1.0, zero)
    if not 0 < lsb < math.inf:
        raise InputError(f"lsb: must be a positive number; got {lsb:g}")
    return Raw(lsb, 0.0 if _reach(ranges, 0.0) <= 32767 * lsb else zero)


def _reach(ranges: Ranges, zero: float) -> float:
    """The largest distance of a signal from `zero`, with headroom."""
    return HEADROOM * max(abs(ranges.low - zero), abs(ranges.high - zero))


def _is_fine(chain: Chain, raw: Raw) -> bool:
    """Whether rounding the thresholds of afferents to the steps of these samples moves them little."""
    try:
        front = _front_end(chain, raw)
    except InputError:  # an offset or a threshold that does not fit
        return False
    return min(int(kind.threshold.min()) for kind in front.kinds) >= FINEST


def _front_end(chain: Chain, raw: Raw) -> FrontEnd:
    columns, chain = chain.of_used()
    encoder, conditioning, conditioner = chain.lif, chain.encoder.conditioning, conditioner_of(chain)
    fine = 2.0**FRACTION / raw.lsb
    zero = raw.zero if conditioning.baseline == "none" else 0.0
    offset = np.zeros(chain.n_taxels) if conditioning.offset is None else np.array(conditioning.offset)
    scale = np.ones(chain.n_taxels) if conditioning.scale is None else np.array(conditioning.scale)
    shifted = np.rint((offset - zero) * fine)
    if (np.abs(shifted) > MOST_OFFSET).any():
        raise InputError("lsb: the encoder's offsets do not fit in 28 bits; give a coarser one")
    stride = None
    if conditioner.clock_Hz != conditioner.rate_Hz:
        whole, part = divmod(round(conditioner.rate_Hz / conditioner.clock_Hz * 2**32), 2**32)
        stride = (whole, part)
    return FrontEnd(
        smoothing=None if conditioner.smoothing is None else Weight.of(conditioner.smoothing),
        stride=stride,
        baseline=conditioning.baseline,
        baseline_steps=conditioner.n_start,
        baseline_weight=None if conditioner.following is None else Weight.of(conditioner.following),
        offset=shifted.astype(np.int64),
        sign=np.sign(scale).astype(np.int64),
        rectify=conditioning.rectify,
        leak=Weight.of(1.0 - decay_per_step(encoder.tau_mem_ms, chain.clock_Hz)),
        kinds=tuple(_kinds(encoder, chain, np.abs(scale) * fine)),
        columns=columns,
        closed=_closed_form(encoder, chain) if is_exact(encoder) else None,
    )


def conditioner_of(chain: Chain) -> Conditioner:
    """What conditions the samples of a chain."""
    return Conditioner(chain.sampling_rate_Hz, conditioning_of(chain.encoder, chain.sampling_rate_Hz))


def _closed_form(encoder: AfferentSpec, chain: Chain) -> ClosedForm:
    steps, octave_ms = chain.clock_Hz / chain.signal_Hz, encoder.tau_mem_ms * math.log(2)
    octave = _ticks(octave_ms, chain, "tau_mem_ms")
    whole, part = divmod(math.ceil(steps * 2**32), 2**32)
    kept = math.exp(-1e3 / chain.signal_Hz / encoder.tau_mem_ms)
    return ClosedForm(
        (whole, part), round(steps * 2**TICK), octave, min(round(2 ** (TICK + OCTAVE) / octave), LARGEST),
        round(kept * 2**OCTAVE),
    )  # fmt: skip


def _ticks(time_ms: float, chain: Chain, key: str) -> int:
    ticks = max(1, round(time_ms * 1e-3 * chain.clock_Hz * 2**TICK))
    if ticks > LARGEST:
        raise InputError(f"encoder: {key} is longer than 2^15 steps, which 32 bits do not hold; export it in float32")
    return ticks


def _kinds(encoder: AfferentSpec, chain: Chain, fine: np.ndarray) -> Iterator[Afferents]:
    """The afferents under each taxel; fine: units of the integers in one of the standardised signal, `(taxel,)`."""
    columns, exact = encoder.columns(len(fine)), is_exact(encoder)
    for part, gains, taxels in zip(("sa1", "ra1"), encoder.gains_at(chain.signal_Hz), columns, strict=True):
        kind = getattr(encoder, part)
        silent = (
            _ticks(kind.t_ref_ms, chain, f"{part}.t_ref_ms")
            if exact
            else encoder.neuron(kind, chain.clock_Hz).refractory_steps
        )
        for index, gain in enumerate(gains if taxels else ()):
            grade = index % len(kind.grades)
            drive = "change" if part == "ra1" else "signal" if gain > 0 else "falling"
            levels = _levels(encoder, abs(gain), fine)
            yield Afferents(part if grade == 0 else f"{part}_{grade + 1}", drive, *levels, silent, taxels)


def _levels(neuron: AfferentSpec, gain: float, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Threshold and reset above rest, divided by the gain: in the signal's unit."""
    threshold = np.rint((neuron.v_threshold_mV - neuron.v_rest_mV) / gain * fine)
    reset = np.rint((neuron.v_reset_mV - neuron.v_rest_mV) / gain * fine)
    if (threshold < 1).any():
        raise InputError("lsb: a threshold is less than one lsb; give a finer one")
    # A signal stays below 2^29 and its change below 2^30: a larger reset is of a threshold that is never reached. The
    # difference of a membrane and a signal then fits in 32 bits.
    threshold = np.clip(threshold, 1, LARGEST).astype(np.int64)
    return threshold, np.clip(reset, -MOST_OFFSET, MOST_OFFSET * 4 - 1).astype(np.int64)


def _layer(
    network: RSNN,
    index: int,
    matrices: tuple[Tensor, Tensor | None],
    largest: float,
    bits: tuple[int, int],
    given: tuple[float | None, float | None],
) -> Layer:
    """bits: of weights and of states. given: the steps of the matrices; None: chosen here."""
    alpha, beta, threshold = _dynamics(network, index)
    weights = [np.asarray(matrix.detach().double()) for matrix in matrices if matrix is not None]
    top, most = (2 ** (n - 1) - 1 for n in bits)
    least_unit = HEADROOM * max(largest, threshold) / most
    # Sums of all weights stay below 2^30, and a state is at most 2^23.
    most_shift = 29 - math.ceil(math.log2(top * sum(len(matrix) for matrix in weights)))
    steps = [step for step in given if step is not None]
    if steps:
        unit = _unit_of(steps, least_unit, most_shift)
    else:
        unit, steps = _unit_and_steps(weights, top, least_unit, most_shift)
    shifts = [round(math.log2(step / unit)) for step in steps]
    integers = [_integers(matrix, step, top) for matrix, step in zip(weights, steps, strict=True)]
    if threshold > most * unit:
        raise InputError(f"state_bits: {bits[1]} bits do not hold the threshold with these weights; give more")
    v, shift_rec = (integers[1], shifts[1]) if len(integers) > 1 else (None, 0)
    alpha, beta = (round(decay * 2 ** decay_bits(bits[1])) for decay in (alpha, beta))
    return Layer(unit, bits[1], integers[0], shifts[0], v, shift_rec, alpha, beta, max(1, round(threshold / unit)))


def _dynamics(network: RSNN, index: int) -> list[float]:
    """Decays and threshold of a layer; InputError if they have no integer form."""
    alpha, beta, threshold = (float(part[index].detach()) for part in (network.alpha, network.beta, network.threshold))
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not 0 <= value <= 1:
            raise InputError(f"network: {name} is {value:g}, which is no decay; train it within 0 to 1")
    if threshold <= 0:
        raise InputError(f"network: a threshold of {threshold:g} has no integer form; train it above 0")
    return [alpha, beta, threshold]


def _integers(weights: np.ndarray, step: float | np.ndarray, top: int) -> np.ndarray:
    return np.rint(weights / step).clip(-top, top).astype(np.int64)


def _unit_and_steps(
    weights: Sequence[np.ndarray], top: int, least_unit: float, most_shift: int
) -> tuple[float, list[float]]:
    """The unit of a layer's states, and the step of each matrix: the unit times a power of two, from its largest."""
    sizes = [float(np.abs(matrix).max(initial=0)) for matrix in weights]
    largest = max((max(sizes) or 1.0) / top, least_unit)
    unit = largest / 2 ** _shift(largest, least_unit, most_shift)
    shifts = [max(0, math.ceil(math.log2(max(size, 1e-300) / (top * unit)) - 1e-9)) for size in sizes]
    return unit, [unit * 2.0**shift for shift in shifts]


def _unit_of(steps: Sequence[float], least_unit: float, most_shift: int) -> float:
    """The unit of a layer's states, for weights with given steps."""
    unit = min(max(steps) / 2 ** _shift(max(steps), least_unit, most_shift), *steps)
    shifts = [math.frexp(step / unit) for step in steps]
    if any(mantissa != 0.5 or not 1 <= exponent <= most_shift + 1 for mantissa, exponent in shifts):
        raise InputError(f"network: weights in steps of {steps} have no common unit; fine-tune it again")
    return unit


def _shift(step: float, least_unit: float, most_shift: int) -> int:
    return min(max(0, math.floor(math.log2(step / least_unit))), most_shift)


def _integrator(
    network: RSNN, weight_bits: int, n_steps: int, step: float | None, *, tells_numbers: bool
) -> Integrator:
    assert network.bias is not None
    w, bias = (np.asarray(matrix.detach().double()) for matrix in (network.readout_weights, network.bias))
    top = 2 ** (weight_bits - 1) - 1
    if tells_numbers:
        largest = np.abs(w).reshape(-1, w.shape[-1]).max(axis=0)
        unit = np.where(largest > 0, largest, 1.0) / top
    else:
        unit = step or (float(np.abs(w).max()) or 1.0) / top
    integers = _integers(w, unit, top)
    initial = np.rint(bias / unit)
    if np.abs(initial).max() + float(n_steps) * np.abs(integers).sum(axis=-2).max() > LARGEST:
        raise InputError("window: an integrator may overflow 32 bits in a window of this length; shorten it")
    return Integrator(unit, integers, initial.astype(np.int64), network.stretches)
