"""Several hidden layers: one is an rsnn, SOPs are counted by hand, kernels equal the reference."""

import numpy as np
import pytest
import torch

import neurotact as nt
from neurotact.errors import InputError
from neurotact.metrics.flops import SpikingLayer
from neurotact.networks.definition import module
from neurotact.networks.definition.initial import start
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.run_folder import load_network as load
from neurotact.networks.training.run_folder import save_network as save
from neurotact.networks.use.measuring import synops_of
from neurotact.spec import load as load_spec

RATE_Hz, RULE = 500.0, ExitRule(4, from_first_spike=True)


def spikes_of(seed: int = 0, n: int = 6, steps: int = 40, afferents: int = 5) -> torch.Tensor:
    return (torch.rand(n, steps, afferents, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


def layered(seed: int = 0, backend="auto", dtype=torch.float32, **keys) -> module.ModuleNetwork:
    spec = RSNNSpec.model_validate({"hidden": [6, 4], "forward_weight_scale": 6.0, **keys})
    generator = torch.Generator().manual_seed(seed)
    network = module.new(5, 3, spec, RATE_Hz, backend=backend, generator=generator, dtype=dtype)
    assert isinstance(network, module.ModuleNetwork)
    return network


def one_layer(seed: int, **keys) -> nt.RSNN:
    generator = torch.Generator().manual_seed(seed)
    return nt.RSNN(5, 3, sampling_rate_Hz=RATE_Hz, generator=generator, hidden=8, forward_weight_scale=6.0, **keys)


@pytest.mark.parametrize("readout", ["integrator", "count"])
@pytest.mark.parametrize("model", ["rsnn", "snn"])
@pytest.mark.parametrize("keys", [{}, {"membrane": "immediate", "reset": "subtract"}, {"step_ms": 4.0}])
def test_one_hidden_layer_is_an_rsnn_spike_for_spike(model, readout, keys):
    ours = layered(3, hidden=[8], model=model, readout=readout, recurrent_weight_scale=0.5, **keys)
    recurrence = {"recurrent_weight_scale": 0.5} if model == "rsnn" else {}
    theirs = one_layer(3, model=model, readout=readout, **recurrence, **keys)
    for w_out in (theirs.w_out, ours.module.readout.w):
        w_out.data += 1.0
    if theirs.bias is not None:
        level = torch.tensor([0.3, -0.2, 0.1])
        theirs.bias.data, ours.module.level.data = level, level.clone()
    assert theirs.spec.training == ours.spec.training
    for found, expected in zip(ours.simulate(spikes_of()), theirs.simulate(spikes_of()), strict=True):
        assert torch.equal(found, expected.to(found))
        assert expected.any()
    for rule in (RULE, ExitRule()):
        found, expected = ours.infer(spikes_of(), rule), theirs.infer(spikes_of(), rule)
        for ours_, theirs_ in zip(found, expected, strict=True):
            assert torch.equal(ours_, theirs_.to(ours_))
        for counted, known in zip(synops_of(found, ours), synops_of(expected, theirs), strict=True):
            np.testing.assert_array_equal(counted, known)
            assert counted.dtype == np.int64


@pytest.mark.parametrize("recurrent", [True, False])
def test_operations_counted_by_hand(recurrent):
    network = layered(recurrent=recurrent)
    spikes = spikes_of()
    hidden = network.simulate(spikes).hidden.sum(dim=1)
    first, second = hidden[:, :6].sum(dim=1).long(), hidden[:, 6:].sum(dim=1).long()
    assert first.all()
    assert second.any()
    sent = spikes.sum(dim=(1, 2)).long()
    into, readout = 6 * sent, 3 * second
    among = 6 * first + 4 * second if recurrent else 0 * first
    found = synops_of(network.infer(spikes), network)
    assert found.input.tolist() == into.tolist()
    assert found.recurrent.tolist() == among.tolist()
    assert found.readout.tolist() == readout.tolist()
    assert found.total_feedforward.tolist() == (into + 4 * first + readout).tolist()
    assert found.total.tolist() == (into + among + 4 * first + readout).tolist()
    early = network.infer(spikes, RULE)
    cut = [network.infer(spikes[k : k + 1, : int(n)]) for k, n in enumerate(early.steps)]
    assert synops_of(early, network).total.tolist() == [int(synops_of(one, network).total[0]) for one in cut]


@pytest.mark.parametrize(("recurrent", "n_layers"), [(False, 1), (False, 2), (True, 2), (False, 3), (True, 3)])
def test_each_layer_has_the_operations_and_spikes_that_it_receives_in_the_bill(recurrent, n_layers):
    """A spike is written and read once by each layer that hears it, and read again where it comes back."""
    sizes = [6, 4, 7][:n_layers]
    network = layered(hidden=sizes, recurrent=recurrent, recurrent_weight_scale=0.5)
    spikes = spikes_of()
    hidden, found = network.simulate(spikes).hidden.detach().sum(dim=1).double().mean(dim=0), network.infer(spikes)
    sent = [float(one.sum()) for one in hidden.split(sizes)]
    assert all(sent)
    measured = {f"sops_{name}": float(v.mean()) for name, v in synops_of(found, network)._asdict().items()}
    measured |= {name: float(getattr(found, name).double().mean()) for name in ("input_spikes", "hidden_spikes")}
    layers, cost_of = [], SpikingLayer.cost
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SpikingLayer, "cost", lambda layer: layers.append(layer) or cost_of(layer))
        spent = network.module.cost(measured, 40.0, 80.0)
    came = [measured["input_spikes"], *sent]
    again = sum(sent) if recurrent else 0.0
    assert spent.sops == pytest.approx(measured["sops_total"])
    assert spent.buffers_accesses == pytest.approx(2 * sum(came) + again)
    assert spent.sops_sent == pytest.approx(measured["sops_total"] - measured["sops_input"])
    if n_layers < 3:
        own = [n * (before + recurrent * after) for n, before, after in zip(sizes, came, sent, strict=False)]
        assert [layer.sops for layer in layers] == pytest.approx(own)
        assert [layer.spikes for layer in layers] == pytest.approx(came[:-1])


def test_a_bill_has_no_operations_below_zero_where_means_are_rounded():
    """Biases alone make the last layer spike: nothing passes between the layers, but 0.3 - 0.1 - 0.2 is below 0."""
    measured = {"sops_input": 0.1, "sops_readout": 0.2, "sops_total": 0.3, "sops_total_feedforward": 0.3}
    spent = layered(bias=True).module.cost(measured | {"input_spikes": 0.1, "hidden_spikes": 0.2}, 40.0, 80.0)
    assert spent.sops == pytest.approx(0.3)


@pytest.mark.parametrize("keys", [{}, {"bias": True, "recurrent": True, "tau_spread": 0.5}, {"readout": "count"}])
def test_kernels_give_the_spikes_and_gradients_of_the_reference(keys):
    learn = ["alpha", "beta", "threshold"]
    found = []
    for backend in ("native", "reference"):
        network = layered(backend=backend, dtype=torch.float64, learn=learn, **keys)
        for name, parameter in network.named_parameters():
            if name.endswith("bias"):
                parameter.data += 0.05
        spikes = spikes_of()
        counts = network.counts(spikes)
        (counts.readout.square().sum() + counts.hidden.square().sum()).backward()
        gradients = {name: p.grad for name, p in network.named_parameters() if p.requires_grad}
        found.append((counts, gradients))
    (native, ours), (reference, theirs) = found
    assert torch.equal(native.hidden, reference.hidden)
    assert native.hidden.any()
    assert ours.keys() == theirs.keys()
    for name, gradient in ours.items():
        torch.testing.assert_close(gradient, theirs[name], rtol=1e-9, atol=1e-9)


def test_a_bias_is_a_constant_current():
    network = layered(hidden=[4], bias=True, tau_mem_ms=20.0, tau_syn_ms=5.0)
    (layer,) = network.module.layers
    layer.w.data.zero_()
    layer.bias.data = torch.tensor([0.0, 0.01, 0.05, 0.1])
    per_neuron = network.simulate(spikes_of()).hidden.sum(dim=(0, 1)).tolist()
    assert per_neuron == sorted(per_neuron)
    assert per_neuron[0] == 0 < per_neuron[2] < per_neuron[3]


def test_time_constants_are_drawn_for_each_neuron_and_learned_within_their_range():
    spread = layered(tau_spread=0.5, learn=["alpha", "beta", "threshold"])
    for layer in spread.module.layers:
        assert len(set(layer.alpha.tolist())) == len(layer.alpha)
        assert ((layer.beta > 0) & (layer.beta < 1)).all()
    alike = layered()
    assert len(set(alike.module.layers[0].beta.tolist())) == 1
    spec = spread.spec.training.model_copy(update={"learning_rate": 5.0, "epochs": 1, "batch": 2})
    spread.spec = spread.spec.model_copy(update={"training": spec})
    before = spread.module.layers[0].beta.clone()
    sides = Examples(spikes_of(), torch.tensor([0, 1, 2, 0, 1, 2]))
    train(spread, sides, sides, generator=torch.Generator().manual_seed(0))
    for layer in spread.module.layers:
        for decay in (layer.alpha, layer.beta):
            assert ((decay >= 0) & (decay <= 1)).all()
        assert (layer.threshold > 0).all()
    assert not torch.equal(before, spread.module.layers[0].beta)


def test_initial_weights_are_scaled_layer_by_layer():
    network = layered(input_deviation=1.0, forward_weight_scale=0.01)
    start(network, spikes_of(n=64), torch.Generator().manual_seed(0))
    counts = network.counts(spikes_of(n=64))
    counts = counts._replace(readout=counts.readout.detach())
    assert (counts.hidden.sum(dim=0) > 0).float().mean() > 0.5
    assert counts.readout.std(dim=0, correction=0).mean() == pytest.approx(1.0, rel=1e-4)
    unscaled = layered(forward_weight_scale=0.01)
    assert not unscaled.counts(spikes_of(n=64)).hidden.any()


def test_a_list_of_neurons_makes_layers_of_any_network():
    for name in ("default", "rsnn", "snn", "layered"):
        spec = load_spec(RSNNSpec, name, {"hidden": [6, 4]})
        assert (spec.model, spec.own.hidden, spec.own.recurrent, spec.n_hidden) == (
            "layered",
            (6, 4),
            name == "rsnn",
            10,
        )
        assert RSNNSpec.model_validate(spec.model_dump(mode="json")) == spec
    assert load_spec(RSNNSpec, "rsnn", {"hidden": [6, 4]}).own.surrogate_scale == 20.0


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"hidden": [6, 0]}, r"^hidden\.1: must be >= 1; got 0 \(model = 'layered'\)"),
        ({"hidden": [6, 4], "readout_stretches": 3}, "^readout_stretches: unknown key; did you mean 'readout'"),
        ({"hidden": [6, 4], "model": "auto"}, "^model: 'auto' tries recurrence with one hidden layer"),
        ({"hidden": [6, 4], "training": {"members": 2}}, "2 networks .* join only if they are an rsnn or an snn"),
        ({"hidden": []}, r"^hidden: .*at least 1 .*, not 0; got \[\]"),
        ({"hidden": ["6"]}, r"^hidden\.0: must be a (whole )?number"),
        ({"model": "layerd"}, "there is none called 'layerd'; did you mean 'layered'"),
    ],
)
def test_wrong_keys_are_refused_in_a_sentence(keys, said):
    with pytest.raises(InputError, match=said):
        RSNNSpec(**keys)


def test_an_rsnn_has_one_layer_and_says_so():
    with pytest.raises(InputError, match="model: RSNN is no 'layered'"):
        nt.RSNN(5, 3, sampling_rate_Hz=RATE_Hz, hidden=[6, 4])


def test_a_network_is_saved_and_read_back(tmp_path):
    network = layered(bias=True, recurrent=True, tau_spread=0.3)
    save(network, tmp_path)
    again, _ = load(tmp_path)
    assert again.spec == network.spec
    assert sorted(path.name for path in tmp_path.iterdir()) == ["network.json", "weights.safetensors"]
    for found, expected in zip(again.infer(spikes_of(), RULE), network.infer(spikes_of(), RULE), strict=True):
        assert torch.equal(found, expected)
