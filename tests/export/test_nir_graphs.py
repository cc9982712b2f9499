"""Graphs of other programs: they spike as snnTorch's own import of the same file does, whatever they hold."""

from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.exporters.nir import compare
from neurotact_parts.exporters.nir.execute import Interpreter
from neurotact_parts.networks.graph import order

import neurotact as nt
from neurotact.errors import InputError
from neurotact.networks.definition.module import ModuleNetwork

nir = pytest.importorskip("nir")
DT_S = compare.STEP_OF_SNNTORCH_S
BRAILLE = ("braille_noDelay_bias_zero_subgraph", "braille_noDelay_noBias_subtract_subgraph")


def raster(density: float, n_trials: int, n_steps: int, n: int, seed: int = 0) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, n, generator=torch.Generator().manual_seed(seed)) < density).float()


@torch.no_grad()
def by_snntorch(graph, spikes: torch.Tensor, *, subtracts: bool = False) -> torch.Tensor:
    """The output of snnTorch's import; subtracts: with its other reset, which its import never sets."""
    loader, snntorch = pytest.importorskip("snntorch.import_nir"), pytest.importorskip("snntorch")
    with redirect_stdout(StringIO()):
        model = loader.import_from_nir(compare.arranged(graph))
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
