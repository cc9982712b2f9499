import pytest
import snntorch
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.exporters.snntorch import from_snntorch, to_snntorch
from snntorch import surrogate
from torch import nn

from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid


@pytest.fixture(autouse=True, scope="module")
def _forget_neurons():
    yield
    snntorch.SpikingNeuron.instances.clear()


def network(seed: int = 0, hidden: int = 8, reset: str = "zero", **spec) -> RSNN:
    table = {"hidden": hidden, "membrane": "immediate", "reset": reset, "forward_weight_scale": 2.0, **spec}
    generator = torch.Generator().manual_seed(seed)
    made = RSNN(5, 3, RSNNSpec(**table), 2000.0, backend="reference", generator=generator)
    with torch.no_grad():
        made.w_rec.copy_(0.5 * torch.randn(hidden, hidden, generator=generator))
    return made


def spikes(seed: int, n_trials: int = 6, n_steps: int = 40) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(n_trials, n_steps, 5, generator=generator) < 0.25).float()


def clear_trials(net: RSNN, x: torch.Tensor) -> torch.Tensor:
    """Trials in which no membrane comes so near the threshold that the order of a sum could decide."""
    near = []
    spike = net.spike

    def watching(difference: torch.Tensor) -> torch.Tensor:
        near.append((difference.detach().abs() < 1e-3).any(dim=1))
        return spike(difference)

    net.spike = watching
    net.simulate(x)
    net.spike = spike
    return ~torch.stack(near).any(dim=0)


@given(
    st.integers(0, 2**32),
    st.integers(1, 12),
    st.sampled_from(["zero", "subtract"]),
    st.tuples(*[st.floats(0, 1, width=32)] * 4),
    st.tuples(*[st.floats(0.5, 2, width=32)] * 2),
)
@examples(40)
def test_both_networks_spike_alike(seed, hidden, reset, decays, threshold):
    net, x = network(seed, hidden, reset), spikes(seed)
    with torch.no_grad():
        net.alpha.copy_(torch.tensor(decays[:2]))
        net.beta.copy_(torch.tensor(decays[2:]))
        net.threshold.copy_(torch.tensor(threshold))
    clear = clear_trials(net, x)
    mine, theirs = net.simulate(x[clear]), to_snntorch(net)(x[clear])
    assert torch.equal(mine.hidden, theirs[0])
    assert torch.equal(mine.readout, theirs[1])


@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_the_trials_compared_are_many_and_spike(reset):
    # That the test above tests something: hardly a trial is set aside, both layers spike and rest.
    kept = spoken = heard = 0
    for seed in range(10):
        net, x = network(seed, 8, reset), spikes(seed)
        kept += int(clear_trials(net, x).sum())
        hidden, readout = net.simulate(x)
        heard, spoken = heard + hidden.mean().item() / 10, spoken + readout.mean().item() / 10
    assert kept > 45
    assert 0.05 < heard < 0.95
    assert 0.05 < spoken < 0.95


@pytest.mark.parametrize("reset", ["zero", "subtract"])
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("membrane", ["immediate", "eq4", "delayed"])
def test_spikes_are_equal_to_the_bit_where_all_sums_are_exact(reset, membrane, delay):
    # Weights in eighths and decays of 1/2 for 8 steps: float32 rounds nothing, ties with the threshold included.
    net = network(0, 8, reset, membrane=membrane, recurrent_delay_steps=delay)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for weights in (net.w_in, net.w_rec, net.w_out):
            weights.copy_(torch.randint(-8, 12, weights.shape, generator=generator) / 8)
        net.alpha.fill_(0.5)
        net.beta.fill_(0.5)
    x = spikes(2, 200, 8)
    mine, theirs = net.simulate(x), to_snntorch(net)(x)
    assert torch.equal(mine.hidden, theirs[0])
    assert torch.equal(mine.readout, theirs[1])
    assert mine.readout.any()
    if (membrane, delay) == ("immediate", 0):
        assert not clear_trials(net, x).all()  # some membranes did meet the threshold exactly


@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_gradients_are_alike_too(reset):
    net, x = network(3, 8, reset, learn=("alpha", "beta"), surrogate_scale=7.0), spikes(3)
    x = x[clear_trials(net, x)]
    theirs = to_snntorch(net)
    weight = torch.randn(len(x), 40, 3, generator=torch.Generator().manual_seed(5))
    (net.simulate(x).readout * weight).sum().backward()
    (theirs(x)[1] * weight).sum().backward()
    for mine, its in (
        (net.w_in, theirs.fc_in.weight),
        (net.w_rec, theirs.hidden.recurrent.weight),
        (net.w_out, theirs.fc_out.weight),
    ):
        torch.testing.assert_close(mine.grad, its.grad.t(), rtol=1e-4, atol=1e-4)
    for name in ("alpha", "beta"):
        its = torch.stack([getattr(theirs.hidden, name).grad, getattr(theirs.readout, name).grad])
        torch.testing.assert_close(getattr(net, name).grad, its, rtol=1e-3, atol=1e-3)


@given(
    st.integers(0, 2**32),
    st.integers(1, 6),
    st.sampled_from(["zero", "subtract"]),
    st.sampled_from([(), ("alpha",), ("beta", "threshold")]),
    st.sampled_from([0.1, 5.0, 10.0, 25.0, 100.0]),
    st.sampled_from([0.0, 0.3, 0.95, 1.0]),
)
@examples(30)
def test_a_round_trip_gives_the_same_network(seed, hidden, reset, learn, scale, decay):
    net = network(seed, hidden, reset, learn=learn, surrogate_scale=scale)
    with torch.no_grad():
        net.alpha[0] = decay
        net.beta[1] = decay
        net.threshold.copy_(torch.tensor([0.9, 1.1]))
    again = from_snntorch(to_snntorch(net), 2000.0, backend="reference")
    for (name, mine), its in zip(net.named_parameters(), again.parameters(), strict=True):
        assert torch.equal(mine, its), name
        assert mine.requires_grad == its.requires_grad
    assert again.spike == FastSigmoid(scale)
    assert (again.spec.hidden, again.spec.reset, again.spec.learn) == (hidden, reset, learn)
    # The spec alone gives the hidden layer's dynamics, where no training has moved the layers apart.
    fresh = RSNN(5, 3, again.spec, 2000.0)
    torch.testing.assert_close(fresh.alpha[0], net.alpha[0], rtol=1e-6, atol=0)
    torch.testing.assert_close(fresh.beta[0], net.beta[0], rtol=1e-6, atol=0)
    x = spikes(seed)
    assert torch.equal(net.simulate(x).readout, again.simulate(x).readout)


def parts(**changes) -> list[nn.Module]:
    """A user's own snnTorch network, as its tutorials build one."""
    values = {"hidden": {}, "readout": {}, "bias": False, **changes}
    dynamics = {"alpha": 0.8, "beta": 0.9, "spike_grad": surrogate.fast_sigmoid(25), "reset_mechanism": "zero"}
    hidden = snntorch.RSynaptic(**{**dynamics, "linear_features": 4, **values["hidden"]})
    if hasattr(hidden.recurrent, "bias"):
        nn.init.zeros_(hidden.recurrent.bias)
    readout = snntorch.Synaptic(**{**dynamics, **values["readout"]})
    return [nn.Linear(5, 4, bias=values["bias"]), hidden, nn.Linear(4, 3, bias=values["bias"]), readout]


def test_a_users_network_comes_over_as_parts_or_as_a_module():
    torch.manual_seed(0)
    given_parts = parts()
    with torch.no_grad():
        given_parts[0].weight.mul_(5)
        given_parts[2].weight.mul_(5)

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.fc1, self.lif1, self.fc2, self.lif2 = given_parts

    x = spikes(0)
    syn = mem = syn_out = mem_out = sent = None
    expected = []
    for arriving in x.unbind(dim=1):
        sent, syn, mem = given_parts[1](given_parts[0](arriving), sent, syn, mem)
        decided, syn_out, mem_out = given_parts[3](given_parts[2](sent), syn_out, mem_out)
        expected.append(decided)
    expected = torch.stack(expected, dim=1)
    for form in (given_parts, Net(), nn.Sequential(*given_parts), nn.ModuleList([nn.Sequential(*given_parts)])):
        net = from_snntorch(form, 2000.0, backend="reference")
        clear = clear_trials(net, x)
        assert clear.sum() >= 4
        assert torch.equal(net.simulate(x[clear]).readout, expected[clear])
    assert 0.02 < expected.mean() < 0.98
    assert net.spike == FastSigmoid(25.0)


def test_each_layer_has_its_own_fast_sigmoid():
    net = from_snntorch(parts(readout={"spike_grad": surrogate.fast_sigmoid(10)}), 2000.0)
    assert (net.spec.surrogate_scale, net.spec.readout_surrogate_scale) == (25.0, 10.0)
    again = from_snntorch(to_snntorch(net), 2000.0)
    assert (again.spec.surrogate_scale, again.spec.readout_surrogate_scale) == (25.0, 10.0)


def test_another_surrogate_is_kept_for_the_reference():
    arctan = surrogate.atan(3.0)
    given_parts = parts(hidden={"spike_grad": arctan}, readout={"spike_grad": arctan})
    net = from_snntorch(given_parts, 2000.0)
    assert net.spike is arctan
    net(spikes(0)).readout.sum().backward()
    assert torch.isfinite(net.w_in.grad).all()
    assert to_snntorch(net).hidden.spike_grad is arctan
    bypass = parts(hidden={"surrogate_disable": True}, readout={"surrogate_disable": True})
    assert from_snntorch(bypass, 2000.0).simulate(spikes(0)).readout.shape == (6, 40, 3)


def test_no_neuron_stays_on_snntorchs_list_and_no_random_number_is_drawn():
    net, listed, before = network(), list(snntorch.SpikingNeuron.instances), torch.get_rng_state()
    for _ in range(3):
        from_snntorch(to_snntorch(net), 2000.0)
    assert [id(n) for n in snntorch.SpikingNeuron.instances] == [id(n) for n in listed]
    assert torch.equal(torch.get_rng_state(), before)


def test_the_weights_are_copies():
    net = network()
    theirs = to_snntorch(net)
    with torch.no_grad():
        for part in (*theirs.parameters(), theirs.hidden.alpha, theirs.readout.beta):
            part.zero_()
    assert all(p.detach().abs().sum() > 0 for p in net.parameters())


@pytest.mark.parametrize("change", [{"membrane": "eq4"}, {"membrane": "delayed"}, {"recurrent_delay_steps": 1}])
def test_neurons_that_hear_later_do_not_come_back(change):
    with pytest.raises(InputError, match="receive input later"):
        from_snntorch(to_snntorch(network(**change)), 2000.0)


def test_networks_that_snntorch_cannot_hold_are_refused():
    net = network()
    with torch.no_grad():
        net.beta[1] = 1.25
    with pytest.raises(InputError, match=r"beta: must lie in \[0, 1\]"):
        to_snntorch(net)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"bias": True}, "input: the projection has a bias"),
        ({"hidden": {"alpha": 1.5}}, "alpha: must lie in"),
        ({"readout": {"beta": -0.1}}, "beta: must lie in"),
        ({"hidden": {"beta": torch.tensor([0.1, 0.2, 0.3, 0.4])}}, "beta: must be one finite number per layer"),
        ({"hidden": {"threshold": float("nan")}}, "threshold: must be one finite number"),
        ({"hidden": {"all_to_all": False, "linear_features": None, "V": 0.5}}, "not all-to-all"),
        ({"hidden": {"linear_features": 3}}, "all must be equal"),
        ({"hidden": {"reset_mechanism": "none"}}, "hidden: reset 'none'"),
        ({"readout": {"reset_mechanism": "subtract"}}, "reset differently"),
        ({"readout": {"reset_delay": False}}, "readout: reset_delay=False"),
        ({"readout": {"state_quant": lambda x: x}}, "readout: state_quant"),
        ({"readout": {"spike_grad": surrogate.atan(2.0)}}, "different surrogates"),
    ],
)
def test_what_has_no_place_here_is_refused(changes, complaint):
    with pytest.raises(InputError, match=complaint):
        from_snntorch(parts(**changes), 2000.0)


def test_other_odd_parts_are_refused():
    given_parts = parts()
    nn.init.ones_(given_parts[1].recurrent.bias)
    with pytest.raises(InputError, match="recurrent: the projection has a bias"):
        from_snntorch(given_parts, 2000.0)
    given_parts = parts()
    given_parts[1].inhibition = True
    with pytest.raises(InputError, match="hidden: inhibition"):
        from_snntorch(given_parts, 2000.0)
    given_parts = parts()
    given_parts[3].graded_spikes_factor = torch.tensor(2.0)
    with pytest.raises(InputError, match="readout: graded_spikes_factor"):
        from_snntorch(given_parts, 2000.0)
    with pytest.raises(InputError, match="must be Linear, RSynaptic, Linear, Synaptic; found Linear, Synaptic"):
        from_snntorch([given_parts[0], given_parts[3]], 2000.0)
    with pytest.raises(InputError, match="found Sequential"):
        from_snntorch(nn.Sequential(), 2000.0)
    with pytest.raises(InputError, match="sampling_rate_Hz"):
        from_snntorch(parts(), 0.0)
    with pytest.raises(InputError, match="weights must be float32"):
        from_snntorch([part.double() for part in parts()], 2000.0)


@pytest.mark.parametrize("membrane", ["immediate", "eq4", "delayed"])
@pytest.mark.parametrize(
    "readout", [{"readout": "integrator"}, {"readout": "integrator", "readout_tau_ms": 30.0}, {"readout": "max"}]
)
def test_a_feed_forward_network_and_an_integrator_decide_alike(membrane, readout):
    net = RSNN(5, 3, model="snn", **readout, hidden=8, membrane=membrane, sampling_rate_Hz=2000.0)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        net.w_in.copy_(torch.randint(-8, 12, net.w_in.shape, generator=generator) / 8)
        net.w_out.copy_(torch.randint(-8, 12, net.w_out.shape, generator=generator) / 8)
        net.bias.copy_(torch.tensor([0.5, -0.25, 0.0]))
        net.alpha.fill_(0.5)
        net.beta.fill_(0.5)
    x = spikes(2, 200, 8)
    hidden, sums = to_snntorch(net)(x)
    assert hidden.any()
    assert torch.equal(hidden, net.simulate(x).hidden)
    values = torch.stack([*net.integration.over(net.simulate(x).readout)], dim=1)
    if net.leaks:  # the float32 of snnTorch's neurons rounds what decays
        torch.testing.assert_close(sums.double(), values, rtol=1e-5, atol=1e-5)
    else:
        assert torch.equal(sums.double(), values)
    torch.testing.assert_close(sums[:, -1], net(x).readout)


def test_a_network_without_recurrence_does_not_come_back():
    with pytest.raises(InputError, match="must be Linear, RSynaptic, Linear, Synaptic"):
        from_snntorch(to_snntorch(RSNN(5, 3, model="snn", membrane="immediate", sampling_rate_Hz=2000.0)), 2000.0)
