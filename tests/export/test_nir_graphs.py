"""Graphs of other programs: they spike as snnTorch's own import of the same file does, whatever they hold."""

from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.exporters.nir import compare
from neurotact_parts.exporters.nir.execute import Interpreter, arranged
from neurotact_parts.networks.graph import order

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.definition import module
from neurotact.networks.definition.module import ModuleNetwork
from neurotact.networks.definition.specs import RSNNSpec

nir = pytest.importorskip("nir")
DT_S = compare.STEP_OF_SNNTORCH_S
BRAILLE = ("braille_noDelay_bias_zero_subgraph", "braille_noDelay_noBias_subtract_subgraph")


def raster(density: float, n_trials: int, n_steps: int, n: int, seed: int = 0) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, n, generator=torch.Generator().manual_seed(seed)) < density).float()


@torch.no_grad()
def by_snntorch(graph, spikes: torch.Tensor, *, subtracts: bool = False, as_it_is: bool = False) -> torch.Tensor:
    """The output of snnTorch's import; subtracts: with its other reset, which its import never sets."""
    loader, snntorch = pytest.importorskip("snntorch.import_nir"), pytest.importorskip("snntorch")
    with redirect_stdout(StringIO()):
        model = loader.import_from_nir(graph if as_it_is else arranged(graph))
    for neurons in model.modules() if subtracts else ():
        if isinstance(neurons, snntorch.Synaptic):
            neurons.reset_mechanism, neurons.state_function = "subtract", neurons._base_sub
    state, sent = None, []
    for step in spikes.unbind(dim=1):
        output, state = model(step, state)
        sent.append(output.clone())
    return torch.stack(sent, dim=1)


def by_us(graph, spikes: torch.Tensor, **keys) -> torch.Tensor:
    with torch.no_grad():
        return nt.from_nir(graph, dt_s=DT_S, **keys).network.simulate(spikes).readout.float()


@pytest.fixture(params=BRAILLE)
def braille(request, data_folder):
    """A published network, as a file with a graph within its graph, and as a flat one."""
    paths = [data_folder / "nir-braille" / f"{name}.nir" for name in (request.param, flat_of(request.param))]
    if not paths[0].exists():
        pytest.skip(f"{paths[0]} is not there")
    return paths


def flat_of(name: str) -> str:
    return f"flat_{name.removesuffix('_subgraph')}"


@pytest.mark.parametrize(("density", "n_trials", "n_steps"), [(0.02, 4, 200), (0.1, 64, 256), (0.6, 9, 50), (0, 1, 30)])
def test_published_networks_spike_as_in_snntorch(braille, density, n_trials, n_steps):
    spikes = raster(density, n_trials, n_steps, 12)
    for keys, subtracts in (({}, False), ({"reset": "subtract"}, True)):
        expected = by_snntorch(nir.read(braille[0]), spikes, subtracts=subtracts)
        assert expected.any() or not density
        for path in braille:
            assert torch.equal(by_us(path, spikes, **keys), expected), (path, keys)


def test_the_resets_of_a_published_network_differ(braille):
    spikes = raster(0.1, 8, 100, 12)
    assert not torch.equal(by_us(braille[0], spikes), by_us(braille[0], spikes, reset="subtract"))


def test_a_published_network_with_biases_decides_and_counts(braille):
    network = nt.from_nir(braille[1], dt_s=DT_S).network
    spikes = raster(0.2, 3, 60, 12)
    has_biases = "bias_zero" in braille[1].name
    assert isinstance(network, ModuleNetwork if has_biases else nt.RSNN)
    found = network.infer(spikes)
    simulated = network.simulate(spikes)
    assert torch.equal(found.readout, simulated.readout.sum(dim=1).to(found.readout))
    assert torch.equal(found.labels, found.readout.argmax(dim=1))
    assert found.hidden_spikes.tolist() == simulated.hidden.sum(dim=(1, 2)).tolist()
    counted = found.sops.numpy() if has_biases else None
    sops = network.operations(found.input_spikes.numpy(), found.hidden_spikes.numpy(), counted)
    n_hidden = simulated.hidden.shape[2]
    assert sops.input.tolist() == (found.input_spikes * n_hidden).tolist()
    assert sops.recurrent.tolist() == (found.hidden_spikes * n_hidden).tolist()
    assert sops.readout.tolist() == (found.hidden_spikes * 7).tolist()


def test_snntorch_connects_a_flat_recurrence_through_its_recurrent_weights(braille):
    """All of the difference between its import of the flat file and of the nested one."""
    spikes = raster(0.1, 8, 100, 12)
    loader = pytest.importorskip("snntorch.import_nir")
    rewired, ordered = nir.read(braille[1]), nir.read(braille[1])
    ordered.nodes = {name: ordered.nodes[name] for name in order([*ordered.nodes], ordered.edges, [])}
    rewired.edges = [("fc1", "lif1.w_rec") if edge == ("fc1", "lif1.lif") else edge for edge in rewired.edges]
    with redirect_stdout(StringIO()):
        theirs = compare._stepped(loader.import_from_nir(ordered), spikes.numpy(), ["readout"])["readout"]
    assert (by_us(rewired, spikes).numpy() == theirs).all()
    assert (by_us(braille[1], spikes).numpy() != theirs).any()


# --- made-up graphs ---------------------------------------------------------------------------------


def cuba(rng, n: int, *, each: bool):
    """Neurons of NIR, one time constant for all or `each` its own, whose inputs snnTorch does not scale."""
    taus = rng.uniform(1.2, 9.0, (2, n if each else 1)) * np.ones((2, n)) * DT_S
    return nir.CubaLIF(
        tau_syn=taus[0], tau_mem=taus[1], r=taus[1] / DT_S, w_in=taus[0] / DT_S, v_leak=np.zeros(n),
        v_threshold=np.full(n, 0.8), v_reset=np.zeros(n),
    )  # fmt: skip


def weights(rng, n_in: int, n_out: int, *, bias: bool):
    weight = (rng.normal(size=(n_out, n_in)) * 0.7).astype(np.float32)
    return nir.Affine(weight, rng.normal(size=n_out).astype(np.float32) * 0.2) if bias else nir.Linear(weight)


def made(seed: int, widths=(5, 8, 3), *, bias=False, each=False, recurrent=True, nested=True):
    """A network of layers; recurrence in all but the last."""
    rng = np.random.default_rng(seed)
    nodes, edges, path = {"input": nir.Input({"input": np.array([widths[0]])})}, [], ["input"]
    for k, (n_in, n) in enumerate(pairwise(widths)):
        layer, back = cuba(rng, n, each=each), weights(rng, n, n, bias=bias)
        nodes[f"fc{k}"], name = weights(rng, n_in, n, bias=bias), f"layer{k}"
        path += [f"fc{k}", name]
        if not recurrent or k == len(widths) - 2:
            nodes[name] = layer
        elif nested:
            inner = {"input": nir.Input({"input": np.array([n])}), "lif": layer, "rec": back,
                     "output": nir.Output({"output": np.array([n])})}  # fmt: skip
            nodes[name] = nir.NIRGraph(inner, [("input", "lif"), ("lif", "rec"), ("rec", "lif"), ("lif", "output")])
        else:
            nodes |= {name: layer, f"back{k}": back}
            edges += [(name, f"back{k}"), (f"back{k}", name)]
    nodes["output"] = nir.Output({"output": np.array([widths[-1]])})
    return nir.NIRGraph(nodes, edges + list(pairwise([*path, "output"])))


@given(
    seed=st.integers(0, 999), bias=st.booleans(), each=st.booleans(), recurrent=st.booleans(), nested=st.booleans(),
    widths=st.sampled_from([(5, 8, 3), (4, 6), (3, 7, 5, 2), (2, 5, 5, 5, 3)]),
    density=st.sampled_from([0.05, 0.3, 1.0]), reset=st.sampled_from(["to-value", "subtract"]),
)  # fmt: skip
@examples(60)
def test_any_layers_spike_as_in_snntorch_after_a_file(
    tmp_path, seed, bias, each, recurrent, nested, widths, density, reset
):
    how = {"bias": bias, "each": each, "recurrent": recurrent}
    spikes = raster(density, 3, 60, widths[0], seed)
    path = tmp_path / "made.nir"
    nir.write(path, made(seed, widths, **how, nested=nested))
    expected = by_snntorch(made(seed, widths, **how), spikes, subtracts=reset == "subtract")
    assert torch.equal(by_us(path, spikes, reset=reset), expected)


def test_a_scale_of_all_inputs_goes_into_the_threshold_as_in_snntorch():
    graph = made(3, bias=True)
    graph.nodes["layer1"].w_in = graph.nodes["layer1"].w_in * 0.3
    graph.nodes["layer1"].v_threshold = graph.nodes["layer1"].v_threshold * 0.2
    spikes = raster(0.3, 5, 80, 5)
    expected = by_snntorch(graph, spikes)
    assert expected.any()
    assert torch.equal(by_us(graph, spikes), expected)


def test_factors_that_only_float32_keeps_from_1_are_1_as_in_snntorch():
    graph = made(1, (4, 3), recurrent=False)
    for key in ("r", "w_in"):
        setattr(graph.nodes["layer0"], key, getattr(graph.nodes["layer0"], key) * (1 + 2e-7))
    values = dict(nt.from_nir(graph, dt_s=DT_S).network.named_parameters())
    (threshold,) = (value for name, value in values.items() if name.endswith(".threshold"))
    assert threshold.tolist() == [np.float32(0.8)] * 3


@pytest.mark.parametrize(
    ("key", "value"),
    [("v_leak", np.linspace(-0.5, 0.5, 3)), ("v_reset", np.array([-1.0, 0.2, 0.0])),
     ("v_threshold", np.array([0.5, 1.0, 0.1])),
     ("w_in", np.array([1.0, 3.0, -2.0])), ("r", np.array([2.0, 5.0, 1.0]))],
)  # fmt: skip
def test_constants_of_each_neuron_mean_what_nir_says(key, value):
    """Against Euler steps of NIR's own equations, in float64."""
    graph = made(1, (4, 3), recurrent=False)
    node = graph.nodes["layer0"]
    setattr(node, key, value)
    spikes = raster(0.4, 2, 90, 4)
    syn = mem = np.zeros((2, 3))
    sent = []
    for step in spikes.numpy().astype(float).swapaxes(0, 1):
        syn = syn + DT_S / node.tau_syn * (node.w_in * (step @ graph.nodes["fc0"].weight.T) - syn)
        mem = mem + DT_S / node.tau_mem * (node.v_leak - mem + node.r * syn)
        fired = mem > node.v_threshold
        mem = np.where(fired, node.v_reset, mem)
        sent.append(fired)
    expected = np.stack(sent, axis=1).astype(float)
    assert expected.any()
    assert (Interpreter(graph, DT_S).run(spikes.numpy())["output"] == expected).all()
    assert (by_us(graph, spikes).numpy() == expected).all()


def test_a_network_of_a_graph_is_trained_by_its_gradient():
    network = nt.from_nir(made(2, bias=True), dt_s=DT_S).network
    network.counts(raster(0.3, 3, 40, 5)).readout.sum().backward()
    trained = {name for name, value in network.named_parameters() if value.grad is not None and value.grad.any()}
    assert {name.rpartition(".")[2] for name in trained} == {"weight", "bias"}
    assert len(trained) == 6


def test_a_file_of_ours_states_its_reset():
    ours = nt.to_nir(nt.RSNN(4, 2, hidden=3, sampling_rate_Hz=1000.0))
    with pytest.raises(InputError, match="reset: graph states that of its network; leave reset out"):
        nt.from_nir(ours, reset="subtract")


# --- written by neurotact ---------------------------------------------------------------------------


def same(a, b) -> bool:
    there, back = a.state_dict(), b.state_dict()
    return [*there] == [*back] and all(torch.equal(there[name], back[name]) for name in there)


@given(
    hidden=st.sampled_from([[5], [6, 4], [3, 5, 4]]), bias=st.booleans(), recurrent=st.booleans(),
    membrane=st.sampled_from(["eq4", "delayed", "immediate"]), reset=st.sampled_from(["zero", "subtract", "hard"]),
    spread=st.sampled_from([0.0, 0.4]), readout=st.sampled_from(["count", "integrator"]), delay=st.integers(0, 1),
    seed=st.integers(0, 99), step_ms=st.sampled_from([None, 3.0]),
)  # fmt: skip
@examples(40)
def test_several_layers_are_written_and_come_back_to_a_unit_in_the_last_place(
    tmp_path, hidden, bias, recurrent, membrane, reset, spread, readout, delay, seed, step_ms
):
    keys = {
        "model": "layered", "hidden": hidden, "bias": bias, "recurrent": recurrent, "membrane": membrane,
        "reset": reset, "tau_spread": spread, "readout": readout, "recurrent_delay_steps": delay, "step_ms": step_ms,
        "forward_weight_scale": 3.0, "recurrent_weight_scale": 0.4, "learn": ["threshold"],
    }  # fmt: skip
    network = module.new(
        4, 3, RSNNSpec.model_validate(keys), 1000.0, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    drawn = torch.Generator().manual_seed(seed)
    for name, value in network.named_parameters():
        if name.endswith((".bias", ".level")):
            value.data.normal_(generator=drawn)
        if name.endswith("threshold") and "layers" in name:
            value.data.uniform_(0.5, 1.5, generator=drawn)
    path = tmp_path / "layers.nir"
    nt.to_nir(network, path, force=True)
    spikes = raster(0.3, 3, 60, 4, seed)
    found = compare.report(network.on_own_clock(), nir.read(path), network.binned(spikes).numpy())
    assert found["differing"].tolist() == [0], found.to_string()
    back = nt.from_nir(path).network
    assert (back.spec, back.sampling_rate_Hz, back.steps_per_bin) == (network.spec, 1000.0, network.steps_per_bin)
    there, read = network.state_dict(), back.state_dict()
    assert [*there] == [*read]
    for name, values in there.items():  # a decay of float64 is written as a time constant
        torch.testing.assert_close(read[name], values, rtol=2**-52, atol=0.0, msg=name)
    assume(found["spikes"].sum() > 0)


@given(seed=st.integers(0, 999), bias=st.booleans(), each=st.booleans(), nested=st.booleans())
@examples(20)
def test_a_graph_of_others_is_written_again(tmp_path, seed, bias, each, nested):
    network = nt.from_nir(made(seed, bias=bias, each=each, nested=nested), dt_s=DT_S).network
    nt.to_nir(network, tmp_path / "again.nir", dt_s=DT_S, force=True)
    spikes = raster(0.3, 3, 60, 5, seed)
    expected = network.simulate(spikes).readout.detach().float()
    assert torch.equal(by_us(tmp_path / "again.nir", spikes), expected)
    assert torch.equal(by_snntorch(nir.read(tmp_path / "again.nir"), spikes, as_it_is=True), expected)


def test_every_node_is_written_again():
    """A graph of all nodes that networks have, through a network and back."""
    n, rng = 3, np.random.default_rng(0)
    some = {name: rng.uniform(1.5, 4.0, n) * DT_S for name in ("tau", "tau_mem", "tau_syn")}
    rest = {"r": rng.uniform(1, 3, n), "v_leak": rng.normal(size=n) * 0.1}
    spiking = {"v_threshold": np.full(n, 0.4), "v_reset": np.array([0.0, -0.5, 0.1])}
    cuba = {"tau_mem": some["tau_mem"], "tau_syn": some["tau_syn"], "w_in": rng.uniform(1, 2, n)}
    nodes = [
        weights(rng, n, n, bias=True), nir.CubaLIF(**cuba, **rest, **spiking), nir.Delay(np.array([1, 3, 2]) * DT_S),
        nir.Scale(np.array([1.0, 2.0, -1.0])), nir.LIF(tau=some["tau"], **rest, **spiking),
        weights(rng, n, n, bias=False),
        nir.IF(r=rest["r"] / DT_S, **spiking), nir.CubaLI(**cuba, **rest), nir.Threshold(np.array([0.01, 0.0, 0.02])),
        nir.LI(tau=some["tau"], **rest), nir.I(r=rest["r"] / DT_S),
    ]  # fmt: skip
    graph = nir.NIRGraph.from_list(*nodes)
    network = nt.from_nir(graph, dt_s=DT_S).network.double()
    again = nt.to_nir(network, dt_s=DT_S)
    spikes = raster(0.5, 4, 80, n)
    expected = Interpreter(graph, DT_S).run(spikes.numpy())["output"]
    assert expected.any(axis=(0, 1)).all()
    np.testing.assert_allclose(Interpreter(again, DT_S).run(spikes.numpy())["output"], expected, rtol=1e-6, atol=1e-6)
    assert sorted(type(node).__name__ for node in again.nodes.values()) == sorted(
        type(node).__name__ for node in graph.nodes.values()
    )


def test_what_a_graph_cannot_say_is_refused():
    network = nt.from_nir(made(1), dt_s=DT_S, reset="subtract").network
    with pytest.raises(InputError, match="reset: NIR's neurons are reset to a value"):
        nt.to_nir(network)
    with pytest.raises(InputError, match="several layers, or a graph: plain NIR does not run it"):
        nt.to_nir(network, plain=True)
