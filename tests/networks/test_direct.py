"""Networks without a hidden layer, and with a path past it: what they compute, cost and refuse."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS, make_chain, make_signal, offline, told, unequal_stretches
from neurotact_parts.exporters.snntorch import to_snntorch
from neurotact_parts.streams.stream import Stream

from neurotact import backend as backends
from neurotact.errors import InputError
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import ensemble, run_folder
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.sparsity import prune

native_only = pytest.mark.skipif(backends.native is None, reason="no kernels")
each_backend = pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=native_only)])
KINDS = ({"hidden": 0}, {"hidden": 6, "direct": True})
each_kind = pytest.mark.parametrize("kind", KINDS, ids=["no-layer", "past"])
each_readout = pytest.mark.parametrize("readout", ["integrator", "stretches"])


def network(kind: dict, readout: str = "stretches", seed: int = 0, backend: backends.Backend = "auto", **keys) -> RSNN:
    scale = {"forward_weight_scale": 3.0} if kind["hidden"] else {}
    dtype, generator = keys.pop("dtype", torch.float32), torch.Generator().manual_seed(seed)
    keys = {**scale, **READOUTS[readout], **kind, **keys}
    net = RSNN(4, 3, sampling_rate_Hz=1000.0, backend=backend, generator=generator, dtype=dtype, **keys)
    unequal_stretches(net)
    return net


def spikes(seed: int = 0, n_trials: int = 5, n_steps: int = 40) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, 4, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


@each_backend
@each_readout
@each_kind
def test_the_values_are_those_of_loops_over_spikes(kind, readout, backend):
    net, arriving = network(kind, readout, backend=backend), spikes()
    hidden, gained = net.simulate(arriving)
    assert hidden.shape[2] == kind["hidden"]
    by_hand = net.bias.double().repeat(5, 1)
    for trial in range(5):
        for t in range(40):
            weights = net.readout_weights if readout == "integrator" else net.readout_weights[min(t // 12, 2)]
            for neuron in torch.cat([hidden[trial, t], arriving[trial, t].float()]).nonzero().flatten():
                by_hand[trial] += weights[neuron].double()
    torch.testing.assert_close(net.infer(arriving).readout, by_hand.detach())
    torch.testing.assert_close(net(arriving).readout.double(), by_hand, rtol=1e-6, atol=1e-5)
    torch.testing.assert_close(net.bias.double() + gained.sum(dim=1), by_hand)


@native_only
@given(
    seed=st.integers(0, 99), kind=st.sampled_from(KINDS), readout=st.sampled_from(["integrator", "stretches"]),
    rule=st.sampled_from([FULL_WINDOW, ExitRule(1), ExitRule(5, from_first_spike=True)]),
    step_ms=st.sampled_from([None, 3.0, 4.0]),
)  # fmt: skip
@examples(20)
def test_kernels_equal_the_reference_in_decisions_and_gradients(seed, kind, readout, rule, step_ms):
    how = {"kind": kind, "readout": readout, "seed": seed, "step_ms": step_ms}
    decided = [network(backend=one, **how).infer(spikes(seed), rule) for one in ("reference", "native")]
    for ours, theirs in zip(*decided, strict=True):
        assert torch.equal(ours, theirs)
    nets = [network(backend=one, dtype=torch.float64, **how) for one in ("reference", "native")]
    factors = torch.rand(5, kind["hidden"] + 4, generator=torch.Generator().manual_seed(seed))
    for net in nets:
        counts = net(spikes(seed), factors)
        (counts.readout.square().sum() + counts.hidden.sum()).backward()
        assert net.w_out.grad is not None
        assert net.w_out.grad[-4:].any()
    for (name, ours), theirs in zip(nets[0].named_parameters(), nets[1].parameters(), strict=True):
        if ours.grad is not None:
            torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-7, atol=1e-7, msg=name)


@each_kind
def test_operations_are_those_of_each_spike_and_each_weight(kind):
    net = network(kind)
    found = net.infer(spikes())
    own = net.operations(found.input_spikes.numpy(), found.hidden_spikes.numpy(), None)
    arrived = spikes().sum(dim=(1, 2)).numpy()
    np.testing.assert_array_equal(own.readout, 3 * (arrived + found.hidden_spikes.numpy()))
    np.testing.assert_array_equal(own.input, kind["hidden"] * arrived)
    prune(net, 0.5)
    pruned, rasters = net.infer(spikes()), net.simulate(spikes())
    heard = torch.cat([rasters.hidden, spikes().to(rasters.hidden)], dim=2)
    out = net.readout_weights.reshape(-1, *net.w_out.shape).ne(0).any(dim=0)  # in any stretch
    left = [sum(int(out[unit].sum()) for unit in step.nonzero()[:, 0]) for step in heard.flatten(0, 1)]
    expected = np.reshape(left, heard.shape[:2]).sum(axis=1)
    np.testing.assert_array_equal(pruned.sops[:, 2], expected)
    assert (expected < own.readout).all()


@each_readout
@each_kind
@pytest.mark.parametrize("step_ms", [None, 3.0])
def test_a_stream_decides_as_whole_windows_and_goes_on_from_its_state(kind, readout, step_ms, tmp_path):
    keys = {**kind, **({} if step_ms is None else {"step_ms": step_ms})}
    chain = make_chain({"baseline": "start"}, patience=6, readout=readout, **keys)
    signal = make_signal(200)
    _, expected = offline(chain, signal)
    assert expected
    for backend in ("auto", "reference"):
        whole = Stream(chain, backend=backend)
        assert told(whole.decide([signal]))[: len(expected)] == expected
        first, other = Stream(chain, backend=backend), Stream(chain, backend=backend)
        decided = first.push(signal[:77])
        first.save(tmp_path / f"{backend}.state")
        other.load(tmp_path / f"{backend}.state")
        assert told([*decided, *other.push(signal[77:])])[: len(expected)] == expected


@each_kind
def test_a_checkpoint_keeps_them(kind, tmp_path):
    net = network(kind)
    run_folder.save_network(net, tmp_path)
    again, _ = run_folder.load_network(tmp_path)
    assert again.spec == net.spec
    assert torch.equal(again.infer(spikes()).readout, net.infer(spikes()).readout)


def test_a_network_without_the_key_is_written_as_before():
    assert "direct" not in RSNNSpec().model_dump()
    assert RSNNSpec(hidden=3, readout="integrator", direct=True).model_dump()["direct"]


def test_joined_networks_score_the_mean_of_their_members():
    members = [network(KINDS[1], seed=seed) for seed in range(3)]
    whole = ensemble.joined(members)
    assert (whole.spec.hidden, whole.spec.direct, len(whole.w_out)) == (18, True, 22)
    scores = torch.stack([net.infer(spikes()).readout for net in members]).mean(dim=0)
    torch.testing.assert_close(whole.infer(spikes()).readout, scores, rtol=1e-5, atol=1e-5)


def test_snntorch_hears_the_afferents_of_stretches():
    net = network(KINDS[1])
    with torch.no_grad():
        _, values = to_snntorch(net)(spikes())
    torch.testing.assert_close(values[:, -1].float(), net.infer(spikes()).readout.float())


def test_the_path_past_learns_what_silent_neurons_do_not_say():
    """Hidden neurons that never spike: a class shows in which afferents spike, and only the path hears these."""
    generator = torch.Generator().manual_seed(0)
    labels = torch.arange(80) % 2
    rates = torch.where((torch.arange(4)[None, :] < 2) == (labels[:, None] == 0), 0.3, 0.05)
    seen = Examples((torch.rand(80, 40, 4, generator=generator) < rates[:, None]).to(torch.uint8), labels)
    how = {"hidden": 3, "forward_weight_scale": 1e-3, "readout": "integrator", "model": "snn"}
    training = {"epochs": 20, "batch": 20, "learning_rate": 0.02, "readout_dropout": 0.2}
    for direct, least, most in ((False, 0.0, 0.6), (True, 0.95, 1.0)):
        spec = RSNNSpec.model_validate({**how, "direct": direct, "training": training})
        net = RSNN(4, 2, spec, 1000.0, generator=torch.Generator().manual_seed(0))
        done = train(net, seen, seen, generator=torch.Generator().manual_seed(0))
        assert least <= done.best.validation_accuracy <= most


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"hidden": 0}, "hidden = 0 needs readout = 'integrator'"),
        ({"hidden": 0, "readout": "max"}, "hidden = 0 needs readout = 'integrator'"),
        ({"direct": True}, "direct = true needs readout = 'integrator'"),
        ({"direct": True, "readout": "integrator", "readout_tau_ms": 5.0}, "without readout_tau_ms"),
        ({"hidden": 0, "readout": "integrator", "direct": False}, "direct = false leaves"),
        ({"hidden": 0, "readout": "integrator", "training": {"members": 2}}, "training.members"),
        ({"hidden": 0, "readout": "integrator", "tau_mem_ms": 9.0}, "tau_mem_ms: has no effect without a hidden layer"),
        ({"hidden": 0, "readout": "integrator", "model": "snn"}, "model: has no effect without a hidden layer"),
    ],
)
def test_what_cannot_be_is_refused(keys, message):
    with pytest.raises(InputError, match=message):
        RSNN(2, 2, sampling_rate_Hz=1000.0, **keys)
