"""What a layer reads and writes, equal to loops that note every access, and what price lists make of it."""

import math

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from neurotact_parts.opponents.minirocket import FixedConvolutions
from neurotact_parts.opponents.pooled_gru import GRU, PooledStates
from neurotact_parts.opponents.scikit_learn import Trees, mean_depth
from sklearn.ensemble import ExtraTreesClassifier

from neurotact import spec as specs
from neurotact.encoders import specs as encoders
from neurotact.encoders.cost import encoding_cost
from neurotact.metrics.flops import (
    Cost,
    Dense,
    Integrator,
    Layer,
    Moments,
    MovingAverage,
    NearestPoints,
    NotCounted,
    SpikingLayer,
    Standardise,
    cost,
)
from neurotact.metrics.prices import ACCESSES, ARITHMETIC_45NM, PriceList, names, price_list
from neurotact.metrics.signal_flops import Averaging
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.use.ledger import network_cost

small = st.integers(1, 5)


class Memory:
    """Numbers by memory, and how often they are read or written."""

    def __init__(self) -> None:
        self.accesses = dict.fromkeys(ACCESSES, 0)

    def touch(self, memory: str, times: int = 1) -> None:
        self.accesses[f"{memory}_accesses"] += times

    def equals(self, found: Cost) -> bool:
        return {name: getattr(found, name) for name in ACCESSES} == self.accesses


def dense(memory: Memory, inputs: int, units: int) -> None:
    for _ in range(inputs):
        memory.touch("buffers")  # an input comes once, and every unit's sum is in a register
        for _ in range(units):
            memory.touch("weights")
    for _ in range(units):
        memory.touch("weights")  # its bias
        memory.touch("buffers")  # its value


@given(small, small)
def test_a_dense_layer_reads_its_weights_once(inputs, units):
    memory = Memory()
    dense(memory, inputs, units)
    found = cost(Dense(inputs, units, "sigmoid"))
    assert memory.equals(found)
    assert (found.weights_bytes, found.states_bytes, found.buffers_bytes) == (4 * units * (inputs + 1), 0, 4 * units)


@given(small, small, small)
def test_kernels_neighbours_scales_and_means(units, features, outputs):
    kernels = Memory()
    kernels.touch("buffers", features)
    kernels.touch("weights")  # gamma
    for _ in range(units):
        kernels.touch("weights", features)
        kernels.touch("buffers")  # the kernel's value, written
        kernels.touch("buffers")  # and read
        kernels.touch("weights", outputs)
    kernels.touch("buffers", outputs)
    assert kernels.equals(cost(RBFExpansion(units, features, outputs)))
    points = Memory()
    points.touch("buffers", features + 1)
    points.touch("weights", units * features)
    assert points.equals(cost(NearestPoints(units, features)))
    scaled = Memory()
    for _ in range(features):
        scaled.touch("buffers", 2)
        scaled.touch("weights", 2)
    assert scaled.equals(cost(Standardise(features)))
    means = Memory()
    for _ in range(units * features):  # samples of each channel: the sum is read and written
        means.touch("states", 2)
    means.touch("buffers", outputs * features)
    assert means.equals(cost(Averaging(units, outputs, features)))
    smoothed = Memory()
    smoothed.touch("states", 2 * units * features)
    assert smoothed.equals(cost(MovingAverage(units, features)))


@given(st.integers(1, 9), st.integers(1, 4))
def test_moments_keep_their_samples(samples, order):
    memory = Memory()
    memory.touch("states", samples)  # stored as they come
    for _ in range(min(order, 2)):  # the mean, then the powers of the differences
        memory.touch("states", samples)
    memory.touch("buffers", order)
    assert memory.equals(cost(Moments(samples, 1, order)))


@pytest.mark.parametrize("seed", range(3))
def test_a_forest_reads_the_nodes_on_its_paths(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(60, 4)), np.arange(60) % 3
    forest = ExtraTreesClassifier(n_estimators=5, random_state=seed).fit(x, y)
    memory = Memory()
    for example in x.astype(np.float32):
        for one in forest.estimators_:
            tree, node = one.tree_, 0
            while tree.children_left[node] >= 0:
                memory.touch("weights", 3)  # the feature, the threshold and the child
                memory.touch("buffers")
                is_left = example[tree.feature[node]] <= tree.threshold[node]
                node = tree.children_left[node] if is_left else tree.children_right[node]
            memory.touch("weights", 3)  # the shares of three classes
        memory.touch("buffers", 3)
    found = cost(Trees(5, mean_depth(forest, x), sum(one.tree_.node_count for one in forest.estimators_), 3))
    assert {name: len(x) * getattr(found, name) for name in ACCESSES} == pytest.approx(memory.accesses)


@given(small, small, small)
def test_a_gru_reads_its_gates_on_each_step(inputs, units, steps):
    memory = Memory()
    for _ in range(steps):
        memory.touch("buffers", inputs)
        for _ in range(3 * units):  # a gate of a unit: its weights and its bias
            memory.touch("weights", inputs + units + 1)
        memory.touch("states", 2 * units)
    assert memory.equals(cost(GRU(inputs, units, steps)))
    pooled = Memory()
    for _ in range(steps * units):
        pooled.touch("states", 2 * 2)  # the sum and the maximum
    pooled.touch("buffers", 2 * units)
    assert pooled.equals(cost(PooledStates(units, steps)))


@given(st.integers(9, 20), small, small, small, small)
def test_convolutions_read_their_taps(samples, channels, dilations, convolved, biases):
    memory = Memory()
    for _ in range(samples):
        memory.touch("states", channels)  # stored as it comes
        for _ in range(dilations * channels):
            memory.touch("states", 9)  # taps of the sum that its convolutions share
            memory.touch("states")
        for _ in range(convolved):
            memory.touch("states", 3 + 1)  # three taps more, and that sum
    memory.touch("weights", biases)
    memory.touch("buffers", biases)
    assert memory.equals(cost(FixedConvolutions(samples, channels, dilations, convolved, biases)))


@given(small, st.integers(1, 30), st.booleans(), st.booleans())
def test_afferents_update_their_states_on_each_step(taxels, steps, opposite, exact):
    """Clocked, on every step; in closed form, on every sample of a slower recording, and a spike moves nothing more."""
    spec = {"sa1": {"gain": 1.0, "opposite": opposite}, "ra1": {"gain": 1.0}}
    memory = Memory()
    for _ in range(taxels * steps):
        for _ in range(2 + opposite):
            memory.touch("weights")  # its gain
            memory.touch("states", 2 * 2)  # its membrane and its refractory counter
        memory.touch("states", 2)  # the sample before
    given = {**spec, "integration": "exact", "recorded_Hz": 100.0} if exact else spec
    clock_steps = 10 * steps if exact else steps
    assert memory.equals(encoding_cost(taxels, clock_steps, 10.0 * steps, given, spikes=3.0))


class Network:
    """A network of CUBA-LIF neurons and an integrator, in plain loops over rasters, with its memory."""

    def __init__(self, spikes: np.ndarray, hidden: np.ndarray, into: np.ndarray, among: np.ndarray, out: np.ndarray):
        """`out` has rows for the afferents behind those of the hidden neurons where the readout hears them."""
        self.spikes, self.hidden, self.into, self.among, self.out = spikes, hidden, into, among, out
        self.heard = np.concatenate([hidden, spikes], axis=1)[:, : len(out)]

    def sources(self, step: int, neuron: int) -> int:
        """Spikes that reach a neuron in a step."""
        arriving = int(sum(self.spikes[step, i] for i in range(len(self.into)) if self.into[i, neuron]))
        if step:
            sent = self.hidden[step - 1]
            arriving += int(sum(sent[j] for j in range(len(sent)) if self.among.size and self.among[j, neuron]))
        return arriving

    def run(self, event_driven: bool) -> tuple[Memory, dict[str, int]]:
        memory, counts = Memory(), {"sops": 0, "updates": 0, "touched": 0, "heard": 0}
        n_steps, n_hidden = self.hidden.shape
        last = n_steps - 1
        for step in range(n_steps):
            for sent in self.spikes[step]:
                readers = (n_hidden > 0) + (self.heard.shape[1] > n_hidden)
                memory.touch("buffers", (1 + readers) * int(sent))  # by the encoder, then by who hears it
            for sent in self.hidden[step]:
                memory.touch("buffers", (2 + bool(self.among.size)) * int(sent))  # and once more by its own layer
            for neuron in range(n_hidden):
                arriving = self.sources(step, neuron)
                memory.touch("weights", arriving)
                counts["sops"] += arriving
                counts["touched"] += arriving > 0
                if not event_driven or arriving:
                    counts["updates"] += 1
                    memory.touch("states", 2 * (3 if event_driven else 2))
                    memory.touch("weights", 3 if event_driven else 0)
            for weights in self.out.T:
                heard = int(self.heard[step] @ weights)
                memory.touch("weights", heard)
                counts["sops"] += heard
                counts["heard"] += heard > 0
        # A spike of the last step reaches the layer after the window; it is counted whole, as SOPs are.
        if self.among.size:
            late = sum(int(self.among[j].sum()) for j in range(n_hidden) if self.hidden[last, j])
            memory.touch("weights", late)
            counts["sops"] += late
        memory.touch("weights", self.out.shape[1])  # biases of the readout
        if event_driven:  # where a spike will be is found by bisection over the steps
            memory.touch("weights", 2 * int(self.hidden.sum()) * math.ceil(math.log2(max(2, n_steps))))
        return memory, counts


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 4), st.integers(0, 4), st.booleans(), st.booleans(),
    st.booleans(), st.booleans(),
)  # fmt: skip
def test_a_network_by_loops_over_its_rasters(seed, n_steps, n_in, n_hidden, recurrent, event_driven, pruned, direct):
    """Recurrent and not, clocked and event-driven, pruned; the readout's sums change where its spikes come.

    Without a hidden layer, or past it, the readout hears the afferents.

    A pruned weight is not read, but a spike is sent whether or not a weight is there for it.
    """
    rng = np.random.default_rng(seed)
    spikes, hidden = (rng.integers(0, 2, (n_steps, n)) for n in (n_in, n_hidden))
    recurrent, hears = recurrent and n_hidden > 0, direct or not n_hidden
    shapes = ((n_in, n_hidden), (n_hidden, n_hidden), (n_hidden + hears * n_in, 3))
    into, among, out = (rng.integers(0, 2, shape) if pruned else np.ones(shape, int) for shape in shapes)
    among = among if recurrent else np.zeros((0, 0), int)
    loops = Network(spikes, hidden, into, among, out)
    memory, counts = loops.run(event_driven)
    past = {"direct": True} if direct else {}
    spec = RSNNSpec(hidden=n_hidden, model="rsnn" if recurrent else "snn", readout="integrator", **past)
    sops = {"input": (spikes @ into).sum(), "readout": (loops.heard @ out).sum()}
    sops["recurrent"] = (hidden @ among).sum() if recurrent else 0
    measured = {
        **{f"sops_{name}": int(n) for name, n in sops.items()},
        **({"input_spikes": int(spikes.sum()), "hidden_spikes": int(hidden.sum())} if pruned else {}),
        "touched_hidden": counts["touched"], "touched_readout": counts["heard"],
    }  # fmt: skip
    found = network_cost(spec, n_in, 3, measured, steps=n_steps, signal_ms=float(n_steps), event_driven=event_driven)
    assert found.sops == counts["sops"]
    # a clocked readout adds each spike by itself
    changes = counts["heard"] if event_driven else sops["readout"]
    memory.touch("states", 2 * int(changes))
    assert memory.equals(found)
    assert found.neuron_updates == counts["updates"]
    assert found.buffers_bytes == 4 * (n_in + n_hidden)  # a queue for the spikes of each layer


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 6), small, st.integers(1, 3), st.integers(1, 4), st.integers(1, 3),
    st.booleans(),
)  # fmt: skip
def test_joined_networks_stretches_and_a_slow_clock_by_loops(seed, n_steps, n_in, half, slow, stretches, event_driven):
    """Two joined networks have no synapses between them; stretches have weights of their own, read as often; a slow
    clock has fewer steps than the encoder's.
    """
    rng, n_hidden = np.random.default_rng(seed), 2 * half
    spikes, hidden = (rng.integers(0, 2, (n_steps, n)) for n in (n_in, n_hidden))
    block = np.arange(n_hidden) // half
    among = (block[:, None] == block).astype(int)
    every = Network(spikes, hidden, np.ones((n_in, n_hidden), int), among, np.ones((n_hidden, 3), int))
    memory, counts = every.run(event_driven)
    keys = {"readout_stretches": stretches, "readout_stretch_ms": 1.0} if stretches > 1 else {}
    spec = RSNNSpec(
        hidden=n_hidden, model="rsnn", readout="integrator", recurrent_blocks=2, step_ms=float(slow), **keys
    )
    sent = int(hidden.sum())
    measured = {
        "sops_input": int(spikes.sum()) * n_hidden, "sops_recurrent": sent * half, "sops_readout": sent * 3,
        "touched_hidden": counts["touched"], "touched_readout": counts["heard"],
    }  # fmt: skip
    signal_ms = float(n_steps * slow)
    found = network_cost(spec, n_in, 3, measured, steps=signal_ms, signal_ms=signal_ms, event_driven=event_driven)
    memory.touch("states", 2 * (counts["heard"] if event_driven else sent * 3))
    assert memory.equals(found)
    assert (found.sops, found.neuron_updates) == (counts["sops"], counts["updates"])
    tables = 4 * 3 * n_steps if event_driven else 0
    weights = n_hidden * (n_in + half) + 3 * (stretches * n_hidden + 1)
    assert found.weights_bytes == 4 * weights + tables


@pytest.mark.parametrize("keys", [{"hidden": 5}, {"hidden": 5, "direct": True}, {"hidden": 0}])
def test_what_a_spike_reaches_is_counted_on_the_weights_that_are_there(keys):
    torch.manual_seed(0)
    network = RSNN(4, 3, RSNNSpec(readout="integrator", **keys), 1000.0)
    with torch.no_grad():
        network.w_in[:, ::2] = 0
        if network.w_rec is not None:
            network.w_rec[1:, 0] = 0
        network.w_out[:3, 1] = 0
    spikes = (torch.rand(6, 20, 4) < 0.2).float()
    hidden = (torch.rand(6, 20, keys["hidden"]) < 0.2).float()
    found = network.touched(spikes, hidden)
    for window in range(6):
        into = (network.w_in.detach() != 0).numpy()
        among = np.zeros((0, 0)) if network.w_rec is None else (network.w_rec.detach() != 0).numpy()
        out = (network.w_out.detach() != 0).numpy()
        loops = Network(spikes[window].numpy().astype(int), hidden[window].numpy().astype(int), into, among, out)
        counts = loops.run(True)[1]
        assert found[window].sum(dim=0).tolist() == [counts["touched"], counts["heard"]]


def test_fewer_neurons_are_updated_when_spikes_are_rare():
    measured = {
        "sops_input": 500,
        "sops_recurrent": 0,
        "sops_readout": 30,
        "touched_hidden": 400,
        "touched_readout": 30,
    }
    costs = [
        network_cost(RSNNSpec(hidden=50), 16, 3, measured, steps=1000, signal_ms=1000.0, event_driven=driven)
        for driven in (False, True)
    ]
    clocked, driven = (one.energy_nJ(price_list("memory-45nm")) for one in costs)
    assert driven < clocked / 10


class Silent(Layer):
    def cost(self) -> Cost:
        return Cost(macs=3)


def test_what_does_not_say_what_it_moves_is_not_counted_where_memory_costs():
    found = cost(Silent(), Dense(2, 2))
    assert found.energy_nJ() == pytest.approx(1e-3 * 4.6 * 7)
    assert math.isnan(found.energy_nJ(price_list("memory-45nm")))
    assert math.isnan((found + NotCounted()).energy_nJ())
    assert cost(signal_ms=5).energy_nJ(price_list("memory-45nm")) == 0


@pytest.mark.parametrize("encoder", specs.shipped("encoders"), ids=lambda path: path.stem)
def test_every_encoder_says_what_it_moves(encoder):
    table = encoders.load(encoder).model_dump(mode="json")
    found = encoding_cost(4, 200, 200.0, table, recorded_Hz=1000.0)
    assert all(not math.isnan(getattr(found, name)) for name in ACCESSES)
    assert found.states_accesses > 0


@given(st.floats(0, 4e6), st.sampled_from([name for name in names() if price_list(name).memory_pJ]))
def test_a_larger_memory_costs_as_much_or_more(size, name):
    one = price_list(name)
    assert 0 <= one.access_pJ(size) <= one.access_pJ(size + 1024)


def test_points_of_a_price_list_are_met_and_rows_are_priced_alike():
    one = price_list("memory-45nm")
    assert [one.access_pJ(size) for size in (8192, 32768, 1048576)] == [5.0, 10.0, 50.0]
    assert price_list("int8-45nm").access_pJ(4 * 8192) == 1.25  # 32 kB of 32-bit numbers are 8 kB of 8-bit ones
    spent = [cost(Dense(9, 7)), cost(SpikingLayer(4, 5, 30, 200, True, sent=7), Integrator(5, 3, 21))]
    table = pd.DataFrame([each.columns() for each in spent])
    for name in names():
        assert price_list(name).energy_nJ(table).tolist() == [each.energy_nJ(price_list(name)) for each in spent]


def test_a_chip_prices_synaptic_operations_and_updates_whole():
    own = PriceList(
        source="x", multiplication_pJ=3.7, addition_pJ=0.9, synaptic_operation_pJ=20.0, neuron_update_pJ=80.0
    )
    spent = cost(SpikingLayer(4, 5, 30, 200, True))
    assert spent.energy_nJ(own) == pytest.approx(1e-3 * (20 * 200 + 80 * 5 * 30))
    both = spent + cost(Dense(9, 7))
    assert both.energy_nJ(own) - spent.energy_nJ(own) == pytest.approx(cost(Dense(9, 7)).energy_nJ(ARITHMETIC_45NM))
