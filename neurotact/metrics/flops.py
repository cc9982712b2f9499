"""The cost ledger: what one decision costs, whether an ELM, an LSTM or a spiking network makes it.

A chain is a list of layer descriptors; `cost` counts it analytically. A layer that is not known raises: it never
counts zero. FLOPs as the papers count them are in `neurotact_parts.studies.published_flops`.

What is counted, by kind (`FLOPS` has the FLOPs of each, a `prices.PriceList` the energy):
- a MAC is a multiplication whose product is added; a sum starts at its bias, so that a bias costs nothing;
- an AC is an addition or subtraction without a multiplication: what a spike or a zero-or-one input costs;
- a multiplication is one whose product is not added: a gain, a window, a decay;
- a comparison, and what costs as little: a magnitude, a sign, a shift, a rounding, the addition within an activation;
- a division or square root; an exponential or logarithm.

What moves is counted by the memory that holds it, in numbers (a price list says how wide they are):
- a weight is read once by each operation that uses it;
- what a layer receives, a feature or a spike, is read once from a buffer, and what it makes is written there once; a
  sample from the sensor is at hand;
- a state is read and written once where it changes: clocked, on every step; event-driven, when a spike comes;
- sums that run while a layer works are in registers, and cost nothing.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Literal

from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.metrics.prices import ACCESSES, ARITHMETIC_45NM, OF_WIDTH, PRICED, WIDE, PriceList

with lazily():
    import pandas as pd


FLOPS = {"macs": 2, "acs": 1, "multiplications": 1, "comparisons": 1, "divisions": 4, "exponentials": 8}
"""FLOPs of an operation of each kind: the weights behind the stiffness paper's Tables I and II."""
OTHERS = ("multiplications", "comparisons", "divisions", "exponentials")
"""The kinds that are neither MACs nor ACs."""

Activation = Literal["linear", "hard_limit", "relu", "sigmoid", "tanh", "softmax"]
BYTES = 4
"""Of a weight or a state variable, in single precision."""
SYNAPSES = ("synapses_input", "synapses_recurrent", "synapses_readout")
"""Numbers of synapses by projection, of a network that was pruned."""


LEDGER_COLUMNS = (
    *FLOPS, "flops", "parameters", "bytes", *PRICED[len(FLOPS) :], "signal_ms", "energy_estimate_nJ",
)  # fmt: skip
"""What the ledger says of a cost."""


@dataclass(frozen=True)
class Cost:
    """What one decision costs.

    macs, acs, multiplications, comparisons, divisions, exponentials: operations by kind (see the module); means over
        decisions need not be whole.
    parameters: numbers that training fixes. bytes: memory for them and for the state between samples, 4 a number.
    sops: synaptic operations of the spiking part; each is also one of the `acs`.
    neuron_updates: updates of its neurons, whose operations, `neuron_macs` and `neuron_comparisons`, are also among the
        `macs` and `comparisons`. They count where a price list has a price of an update.
    readout_updates: steps of readout neurons that only add up, at which nothing is done without a spike. sops_sent: of
        the `sops`, those of spikes that its own neurons sent. Both count where a price list has a price of them.
    weights_accesses, states_accesses, buffers_accesses: numbers that are read or written, by memory (see the module).
        Absent, where there are operations: NaN, not counted.
    states_bytes: of `bytes`, those of the state. buffers_bytes: memory for features and spikes on their way.
    wide_macs and so on: of these, those on numbers of 32 bits where all else has 8 (`in_32_bits`).
    signal_ms: signal that must have come in before the decision.

    Costs add up along a chain; the signal is the same for all its parts, so of `signal_ms` the longest stands.

    >>> total = Cost(macs=100, signal_ms=75) + Cost(acs=10, signal_ms=50)
    >>> total.macs, total.flops, total.signal_ms
    (100, 210, 75)
    """

    macs: float = 0
    acs: float = 0
    multiplications: float = 0
    comparisons: float = 0
    divisions: float = 0
    exponentials: float = 0
    parameters: float = 0
    bytes: float = 0
    sops: float = 0
    signal_ms: float = 0
    neuron_updates: float = 0
    neuron_macs: float = 0
    neuron_comparisons: float = 0
    readout_updates: float = 0
    sops_sent: float = 0
    weights_accesses: float | None = None
    states_accesses: float | None = None
    buffers_accesses: float | None = None
    states_bytes: float = 0
    buffers_bytes: float = 0
    wide_macs: float = 0
    wide_acs: float = 0
    wide_multiplications: float = 0
    wide_comparisons: float = 0
    wide_divisions: float = 0
    wide_exponentials: float = 0
    wide_weights_accesses: float = 0
    wide_states_accesses: float = 0
    wide_weights_bytes: float = 0
    wide_states_bytes: float = 0

    def __post_init__(self) -> None:
        absent = [name for name in ACCESSES if getattr(self, name) is None]
        for name in absent:  # nothing moves where nothing is done; operations without a word of it are not counted
            object.__setattr__(self, name, math.nan if self.flops and len(absent) == len(ACCESSES) else 0)
        for field in fields(self):
            value = getattr(self, field.name)
            if not (0 <= value < float("inf") or (field.name in ACCESSES and math.isnan(value))):
                raise InputError(f"cost.{field.name}: must be a finite number >= 0; got {value}")

    @property
    def weights_bytes(self) -> float:
        """Of `bytes`, those of the parameters."""
        return self.bytes - self.states_bytes

    def __add__(self, other: Cost) -> Cost:
        summed = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        kind = NotCounted if isinstance(self, NotCounted) or isinstance(other, NotCounted) else Cost
        return kind(**{**summed, "signal_ms": max(self.signal_ms, other.signal_ms)})

    def times(self, n: float) -> Cost:
        """Its operations and accesses `n` times, with what it stores and the signal that it waits for once.

        >>> thrice = Cost(macs=2, acs=1, sops=1, parameters=5).times(3)
        >>> thrice.macs, thrice.acs, thrice.sops, thrice.parameters
        (6, 3, 3, 5)
        """
        return replace(self, **{name: n * getattr(self, name) for name in PRICED if not name.endswith("_bytes")})

    def in_32_bits(self) -> Cost:
        """The same on numbers of 32 bits, also by a list of narrower integers (`PriceList.wide`).

        >>> wide = Cost(macs=10, states_accesses=2).in_32_bits()
        >>> wide.macs, wide.wide_macs, wide.wide_states_accesses
        (10, 10, 2)
        """
        counted = {name: getattr(self, name) for name in OF_WIDTH}
        return replace(self, **{f"{WIDE}{name}": 0 if math.isnan(n) else n for name, n in counted.items()})

    @property
    def flops(self) -> float:
        """All operations as FLOPs: two for a MAC, one for an AC, and the others."""
        return 2 * self.macs + self.acs + self.other_flops

    @property
    def other_flops(self) -> float:
        """The FLOPs of what is neither a MAC nor an AC."""
        return sum(FLOPS[kind] * getattr(self, kind) for kind in OTHERS)

    @property
    def energy_estimate_nJ(self) -> float:  # noqa: N802
        """`energy_nJ` by the default price list."""
        return self.energy_nJ()

    def energy_nJ(self, prices: PriceList = ARITHMETIC_45NM) -> float:  # noqa: N802
        """An estimate by a price list, never a measurement; NaN where the list has a price of what is not counted.

        >>> Cost(macs=10, acs=100).energy_nJ(), Cost(multiplications=10).energy_nJ()
        (0.136, 0.037)
        """
        return float(prices.energy_nJ({name: getattr(self, name) for name in PRICED}))

    def columns(self, *names: str, prices: PriceList = ARITHMETIC_45NM) -> dict[str, float]:
        """The cost as columns of a table: those named, in that order, else all of the ledger's; energy by `prices`.

        >>> Cost(macs=10, acs=100).columns("macs", "flops")
        {'macs': 10, 'flops': 120}
        """
        priced = {"energy_estimate_nJ": self.energy_nJ(prices)}
        return {name: priced[name] if name in priced else getattr(self, name) for name in names or LEDGER_COLUMNS}


@dataclass(frozen=True)
class NotCounted(Cost):
    """The cost of a part that declares none, or a sum with it: NaN, never zero; `signal_ms` stays.

    >>> (Cost(macs=10, signal_ms=75) + NotCounted()).columns("macs", "energy_estimate_nJ", "signal_ms")
    {'macs': nan, 'energy_estimate_nJ': nan, 'signal_ms': 75}
    """

    macs: float = math.nan
    acs: float = math.nan
    multiplications: float = math.nan
    comparisons: float = math.nan
    divisions: float = math.nan
    exponentials: float = math.nan
    parameters: float = math.nan
    bytes: float = math.nan
    weights_accesses: float | None = math.nan
    states_accesses: float | None = math.nan
    buffers_accesses: float | None = math.nan

    def __post_init__(self) -> None:
        """NaN is no mistake here."""


@dataclass(frozen=True)
class Layer(ABC):
    """A part of a chain that can say what it costs. Its whole-number fields are sizes and must be at least 1."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            is_count = field.type is int or field.type == "int"
            if is_count and (value != int(value) or value < 1):
                raise InputError(f"{type(self).__name__}.{field.name}: must be a whole number, at least 1; got {value}")

    @abstractmethod
    def cost(self) -> Cost:
        """What the layer costs for one decision."""


def cost(*layers: Layer, signal_ms: float = 0) -> Cost:
    """What a chain of layers costs for one decision.

    signal_ms: signal that the chain waits for.
    Raises InputError for a layer that is none of the descriptors of this module (or of your own `Layer`).

    >>> chain = cost(Dense(8, 51, "relu"), Dense(51, 3), signal_ms=75)
    >>> chain.macs, chain.comparisons, chain.parameters, chain.flops
    (561, 51, 615, 1173)
    """
    total = Cost(signal_ms=signal_ms)
    for layer in layers:
        if not isinstance(layer, Layer):
            raise InputError(f"cost: {layer!r} is no layer that the ledger can count; describe it as a flops.Layer")
        total += layer.cost()
    return total


def ledger_table(
    costs: Mapping[str, Cost | None] | Iterable[tuple[str, Cost | None]], prices: PriceList = ARITHMETIC_45NM
) -> pd.DataFrame:
    """Named costs as a table, a row each, in their order; NaN where a cost is None, which is not counted.

    Columns: name, and those of `LEDGER_COLUMNS`: operations by kind, flops, parameters, bytes, sops, signal_ms and
    energy_estimate_nJ; and prices, the name of the price list.

    >>> ledger_table({"R-FC": cost(Dense(8, 51, "relu"), Dense(51, 3))}).T[0].to_dict()["macs"]
    561
    """
    named = costs.items() if isinstance(costs, Mapping) else costs
    rows = [{"name": name, "prices": prices.name, **(one.columns(prices=prices) if one else {})} for name, one in named]
    return pd.DataFrame(rows, columns=["name", *LEDGER_COLUMNS, "prices"])


def with_weights(parameters: float, state: float = 0, *, bytes_a_parameter: float = BYTES, **counted: float) -> Cost:
    """The cost of operations and accesses, with the memory for parameters and for a state."""
    stored = bytes_a_parameter * parameters + BYTES * state
    return Cost(parameters=parameters, bytes=stored, states_bytes=BYTES * state, **counted)


def stored(rows: int, columns: int, synapses: float | None = None, values: int = 1) -> Cost:
    """The weights of a matrix, or of the synapses in it that exist (None: all), with several values each.

    Where it takes less memory, a synapse has its column beside its values, and a row the place where it begins: an
    index takes the bytes that count up to its largest value.

    >>> [stored(100, 50, n).bytes for n in (None, 5000, 4500, 1000)]
    [20000, 20000, 20000, 5202]
    """
    whole = rows * columns
    n = whole if synapses is None else synapses
    if n >= whole:
        return with_weights(values * whole)
    sparse = n * (BYTES * values + index_bytes(columns - 1)) + (rows + 1) * index_bytes(n)
    return Cost(parameters=values * n, bytes=min(BYTES * values * whole, sparse))


def index_bytes(largest: float) -> int:
    """Bytes of a whole number from 0 to the largest one: 1, 2 or 4.

    >>> [index_bytes(largest) for largest in (255, 256, 65536)]
    [1, 2, 4]
    """
    return 1 if largest < 2**8 else 2 if largest < 2**16 else 4


def in_registers(**operations: float) -> Cost:
    """Operations on numbers that are at hand and stay there.

    >>> in_registers(acs=2).states_accesses
    0
    """
    return Cost(**operations, **dict.fromkeys(ACCESSES, 0))


def passed(received: float, made: float) -> dict[str, float]:
    """The buffer of a layer that receives and makes so many numbers: it holds what is made until that is received."""
    return {"buffers_accesses": received + made, "buffers_bytes": BYTES * made}


def changed(states: float, times: float = 1) -> dict[str, float]:
    """Each of so many state variables is read and written, so many times."""
    return {"states_accesses": 2 * states * times}


SIGMOID = in_registers(comparisons=2, divisions=1, exponentials=1)
"""1 / (1 + exp(-x)): 14 FLOPs."""
TANH = in_registers(comparisons=3, divisions=1, exponentials=1)
"""1 - 2 / (exp(2x) + 1): 15 FLOPs; x + x in place of 2x."""
ACTIVATIONS = {
    "linear": Cost(),
    "hard_limit": in_registers(comparisons=1),
    "relu": in_registers(comparisons=1),
    "sigmoid": SIGMOID,
    "tanh": TANH,
    "softmax": in_registers(comparisons=1, divisions=1, exponentials=1),
}


def _activations(activation: str, units: int) -> Cost:
    if activation not in ACTIVATIONS:
        raise InputError(f"activation: '{activation}' is not known; known: {', '.join(ACTIVATIONS)}")
    return ACTIVATIONS[activation].times(units)


@dataclass(frozen=True)
class Dense(Layer):
    """A fully connected layer."""

    inputs: int
    units: int
    activation: Activation = "linear"
    bias: bool = True

    def cost(self) -> Cost:
        parameters = self.units * (self.inputs + self.bias)
        moved = {"weights_accesses": parameters, **passed(self.inputs, self.units)}
        summed = with_weights(parameters, macs=self.inputs * self.units, **moved)
        return summed + _activations(self.activation, self.units)


@dataclass(frozen=True)
class NearestPoints(Layer):
    """Squared distances to `points` stored points and the `neighbours` nearest of them.

    A class-centroid classifier has one point per class and one neighbour; kNN a point for every training example.
    """

    points: int
    features: int
    neighbours: int = 1

    def cost(self) -> Cost:
        numbers = self.points * self.features
        moved = {"weights_accesses": numbers, **passed(self.features, self.neighbours)}
        compared = self.points * self.neighbours
        return with_weights(numbers, macs=numbers, acs=numbers, comparisons=compared, **moved)


@dataclass(frozen=True)
class MovingAverage(Layer):
    """`y[i] = a x[i] + (1 - a) y[i - 1]` on every sample of every channel (stiffness paper, Sec. III-B: 3n FLOPs)."""

    samples: int
    channels: int = 1

    def cost(self) -> Cost:
        n = self.samples * self.channels
        return with_weights(0, self.channels, macs=n, multiplications=n, **changed(n))


@dataclass(frozen=True)
class Moments(Layer):
    """The first `order` of mean, standard deviation, skewness and kurtosis of every channel.

    Each uses what those before it left, over samples that are kept: n additions and a product for the mean; n
    differences, n squares, a product and a root for the deviation; n MACs each for the sums of third and fourth
    powers. In FLOPs this is the stiffness paper's Table I.
    """

    samples: int
    channels: int = 1
    order: int = 4

    def cost(self) -> Cost:
        if self.order > 4:
            raise InputError(f"Moments.order: there are four moments; got {self.order}")
        n = self.samples
        orders = (
            in_registers(acs=n, multiplications=1),
            in_registers(macs=n, acs=n, multiplications=1, divisions=1),
            in_registers(macs=n, multiplications=3, divisions=1),  # 1/n, two products for the cubed deviation
            in_registers(macs=n, multiplications=1, divisions=1),  # the sum of squares times the variance
        )
        kept = n * (1 + min(self.order, 2))  # stored, then read for the mean and for the powers of differences
        once = sum(orders[: self.order], Cost()) + Cost(states_accesses=kept, **passed(0, self.order))
        return once.times(self.channels) + with_weights(0, self.channels * (n + self.order))


@dataclass(frozen=True)
class Standardise(Layer):
    """Each feature times its scale plus its offset."""

    features: int

    def cost(self) -> Cost:
        n = self.features
        return with_weights(2 * n, macs=n, weights_accesses=2 * n, **passed(n, n))


@dataclass(frozen=True)
class Integrator(Layer):
    """A readout that adds up its weights of every spike that it hears, from its biases on.

    sops: operations into this layer in one decision, a mean or a number: an AC each. Without a leak nothing is done
    without a spike.
    leaky_steps: steps in which what was added up decays, a MAC per neuron and step; 0 without a leak.
    peak: whether the largest value over time counts: a comparison more per neuron and step, and a second state.
    stretches: of a decision, each with weights of its own: more parameters, and the same operations.
    spikes: that it receives; None: each reaches all its neurons.
    touched: of its neurons and steps, those in which a spike comes: event-driven, only then is it updated. None:
        clocked. steps: of a decision, which count where a chip visits a neuron without a leak on each of them.
    beside: those of its inputs that another layer hears, too, and their spikes, which `spikes` leaves out: they stand
        in the queue of that layer and are read once more.
    synapses: those that exist, each with a weight in every stretch; None: all.
    sops_sent: of its `sops`, those of spikes that neurons of the network sent, and not afferents; None: all.
    """

    inputs: int
    neurons: int
    sops: float
    leaky_steps: float = 0.0
    peak: bool = False
    stretches: int = 1
    spikes: float | None = None
    touched: float | None = None
    steps: float = 0.0
    beside: tuple[int, float] = (0, 0.0)
    synapses: float | None = None
    sops_sent: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.sops >= 0 and self.leaky_steps >= 0):
            raise InputError(f"Integrator: sops and steps must be >= 0; got {self.sops} and {self.leaky_steps}")

    def cost(self) -> Cost:
        spikes, states = _received(self), self.neurons * (1 + self.peak)
        leaking = self.neurons * self.leaky_steps
        if self.touched is not None:  # the leak since the last spike is made good; the peak is where one came
            leaking = min(leaking, self.touched)
        changes = self.touched or leaking or self.sops
        most = int(self.peak)
        weights = stored(self.inputs, self.neurons, self.synapses, self.stretches)
        return weights + with_weights(
            self.neurons, states, macs=leaking, acs=self.sops, comparisons=most * leaking, sops=self.sops,
            neuron_updates=leaking, neuron_macs=leaking, neuron_comparisons=most * leaking,
            sops_sent=self.sops if self.sops_sent is None else self.sops_sent,
            readout_updates=0 if leaking else self.neurons * self.steps,
            weights_accesses=self.sops + self.neurons, **changed(1 + most, changes),
            **_queued(self.inputs - self.beside[0], spikes, self.beside[1]),
        )  # fmt: skip


@dataclass(frozen=True)
class SpikingLayer(Layer):
    """A layer of CUBA-LIF neurons over `steps` steps, from the synaptic operations that were measured.

    sops: operations into this layer in one decision, a mean or a number: an AC each.
    recurrent: whether its neurons are connected to one another, or with how many of them each is.
    Per neuron and step the current and the membrane decay (two MACs), and the membrane is compared with its threshold.
    adapts: whether thresholds adapt. Then the adaptation decays and takes the neuron's spike, and its multiple comes
    off the membrane before the comparison: two MACs more per neuron and step, and a third state.
    spikes: that come from the layer before; None: each reaches all its neurons, and none comes back. sent: of its own.
    touched: of its neurons and steps, those in which a spike comes: the layer is event-driven. None: clocked.
    sops_sent: of its `sops`, those of spikes that neurons of the network sent, and not afferents.
    synapses: those that exist, from its inputs and among its neurons; None: all.

    Event-driven, a neuron is updated when a spike comes. Then a third state, the step of its last update, says how many
    steps it has missed; its current decays by a power from a table (a product), and its membrane, too (a product, and a
    MAC for what the current has left there). A bound of what the membrane can still reach (a MAC and a comparison)
    says whether the neuron will spike before it is updated again; that step is found by bisection over the steps of
    the decision, for each spike that it sends.
    """

    inputs: int
    neurons: int
    steps: float
    sops: float
    recurrent: bool | int
    adapts: bool = False
    spikes: float | None = None
    sent: float = 0.0
    touched: float | None = None
    sops_sent: float = 0.0
    synapses: tuple[float | None, float | None] = (None, None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.steps >= 0 and self.sops >= 0):
            raise InputError(f"SpikingLayer: steps and sops must be >= 0; got {self.steps} and {self.sops}")

    def cost(self) -> Cost:
        n_among = self.neurons * self.recurrent if isinstance(self.recurrent, bool) else self.recurrent
        into, among = self.synapses
        weights = stored(self.inputs, self.neurons, into) + stored(self.neurons, n_among, among)
        spikes = _received(self)
        queued = _queued(self.inputs, spikes, self.sent if n_among else 0.0)
        arriving = Cost(
            acs=self.sops, sops=self.sops, sops_sent=self.sops_sent, weights_accesses=self.sops, **queued
        )  # fmt: skip
        adapting = int(self.adapts)
        if self.touched is None:
            updates = self.neurons * self.steps
            own = _updates(updates, macs=2 + 2 * adapting, comparisons=1) + Cost(**changed(2 + adapting, updates))
            return arriving + own + weights + with_weights(0, (2 + adapting) * self.neurons)
        made_good = _updates(self.touched, macs=2 + 2 * adapting, multiplications=2 + adapting, comparisons=2)
        tables, searched = 3 + adapting, self.sent * math.ceil(math.log2(max(2.0, self.steps)))
        found = in_registers(macs=1, multiplications=1, comparisons=1).times(searched)
        moved = Cost(weights_accesses=tables * self.touched + 2 * searched, **changed(3 + adapting, self.touched))
        constants = Cost(bytes=BYTES * tables * math.ceil(self.steps))
        fixed = weights + with_weights(0, (3 + adapting) * self.neurons)
        return arriving + made_good + found + moved + constants + fixed


def _received(layer: Integrator | SpikingLayer) -> float:
    return layer.sops / layer.neurons if layer.spikes is None else layer.spikes


def _queued(inputs: int, spikes: float, again: float) -> dict[str, float]:
    """Each spike is written to the queue of its step by its sender and read by its receiver; some are read again."""
    return {"buffers_accesses": 2 * spikes + again, "buffers_bytes": BYTES * inputs}


def _updates(updates: float, **each: float) -> Cost:
    """Updates of neurons, with the operations of each."""
    every = in_registers(**each).times(updates)
    return replace(every, neuron_updates=updates, neuron_macs=every.macs, neuron_comparisons=every.comparisons)
