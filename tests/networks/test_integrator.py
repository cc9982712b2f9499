"""The readout that adds up hidden spikes: what it is, its early exit, and that it survives a checkpoint."""

from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact import backend as backends
from neurotact.errors import InputError
from neurotact.metrics import synops
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.patience import exits
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import run_folder

BACKENDS = ["reference", pytest.param("native", marks=pytest.mark.skipif(backends.native is None, reason="no kernels"))]
N_IN, CLASSES, STEPS = 5, 3, 40
each_backend = pytest.mark.parametrize("backend", BACKENDS)


def network(seed: int = 0, backend: Any = "reference", dtype: torch.dtype = torch.float32, **table: Any) -> RSNN:
    spec = RSNNSpec(**{"hidden": 7, "readout": "integrator", "forward_weight_scale": 3.0, **table})
    generator = torch.Generator().manual_seed(seed)
    net = RSNN(N_IN, CLASSES, spec, 400.0, backend=backend, generator=generator, dtype=dtype)
    assert net.bias is not None
    with torch.no_grad():
        net.bias += 0.3 * torch.randn(CLASSES, generator=generator)
    return net


def spikes(seed: int = 0, n_trials: int = 6, n_steps: int = STEPS) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, N_IN, generator=torch.Generator().manual_seed(seed)) < 0.2).to(torch.uint8)


@each_backend
@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_it_adds_a_bias_and_the_weights_of_every_hidden_spike(backend, model):
    net = network(backend=backend, model=model)
    counts, rasters = net(spikes()), net.simulate(spikes())
    assert rasters.hidden.any()
    assert torch.equal(counts.hidden, rasters.hidden.sum(dim=1))
    expected = net.bias.double() + torch.einsum("nth,hc->nc", rasters.hidden.double(), net.w_out.double())
    torch.testing.assert_close(counts.readout, expected.float())
    torch.testing.assert_close(rasters.readout.sum(dim=1) + net.integration.level, expected)


@pytest.mark.skipif(backends.native is None, reason="no kernels")
@pytest.mark.parametrize("membrane", ["eq4", "delayed", "immediate"])
@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_native_gradients_are_those_of_the_reference(membrane, model):
    found = []
    for backend in ("reference", "native"):
        net = network(3, backend, torch.float64, membrane=membrane, model=model, learn=("alpha", "beta", "threshold"))
        readout, hidden = net(spikes(3))
        (readout.square().sum() + hidden.sum()).backward()
        found.append({name: p.grad for name, p in net.named_parameters()})
    assert found[0].keys() == found[1].keys()
    assert found[0]["w_in"].any()
    for name, gradient in found[0].items():
        torch.testing.assert_close(found[1][name], gradient, rtol=1e-9, atol=1e-9, msg=name)


@each_backend
def test_the_batch_moves_no_sum(backend):
    net = network(backend=backend)
    whole = net(spikes(n_trials=64)).readout
    alone = torch.cat([net(part).readout for part in spikes(n_trials=64).split(1)])
    assert torch.equal(whole, alone)


@examples(20)
@given(seed=st.integers(0, 999), patience=st.integers(1, STEPS), from_first=st.booleans())
@each_backend
def test_early_exit_is_the_definition_step_by_step(backend, seed, patience, from_first):
    net, given_spikes = network(seed, backend), spikes(seed)
    found = net.infer(given_spikes, ExitRule(patience, from_first))
    rasters = net.simulate(given_spikes, ordered=backend == "native")
    for trial in range(len(given_spikes)):
        total, leader, standing, heard = net.integration.level.clone(), 0, 0, False
        for t in range(STEPS):
            total = total + rasters.readout[trial, t]
            heard = heard or bool(rasters.readout[trial, t].any())
            same = int(total.argmax()) == leader
            leader = int(total.argmax())
            standing = (standing + 1 if same else 1) if heard or not from_first else 0
            if standing > patience or t + 1 == STEPS:
                break
        assert (int(found.steps[trial]), int(found.labels[trial])) == (t + 1, leader)
        assert int(found.input_spikes[trial]) == int(given_spikes[trial, : t + 1].sum())
        assert int(found.hidden_spikes[trial]) == int(rasters.hidden[trial, : t + 1].sum())
        torch.testing.assert_close(found.readout[trial], total)


@pytest.mark.skipif(backends.native is None, reason="no kernels")
@examples(40)
@given(
    seed=st.integers(0, 999),
    patience=st.one_of(st.none(), st.integers(1, STEPS)),
    from_first=st.booleans(),
    membrane=st.sampled_from(["eq4", "delayed", "immediate"]),
    delay=st.integers(0, 1),
    hidden=st.sampled_from([7, 64, 65, 130]),
    model=st.sampled_from(["rsnn", "snn"]),
    n_steps=st.sampled_from([0, 1, STEPS]),
)
def test_the_kernel_that_stops_decides_as_the_simulation_of_whole_windows(
    seed, patience, from_first, membrane, delay, hidden, model, n_steps
):
    table = {"membrane": membrane, "recurrent_delay_steps": delay, "hidden": hidden, "model": model}
    ours, theirs = (network(seed, backend, torch.float64, **table) for backend in ("native", "reference"))
    rule = ExitRule(patience, from_first)
    found, wanted = (net.infer(spikes(seed, n_steps=n_steps), rule) for net in (ours, theirs))
    assert all(map(torch.equal, found[:4], wanted[:4]))
    torch.testing.assert_close(found.readout, wanted.readout, rtol=1e-12, atol=1e-12)


@pytest.mark.skipif(backends.native is None, reason="no kernels")
def test_an_early_exit_reads_no_step_behind_it():
    """Graded input is refused where the kernel reads it: behind the exit it does not."""
    net, rule = network(backend="native"), ExitRule(4)
    x = spikes(n_trials=1).float()
    exit_step = int(net.infer(x, rule).steps)
    assert exit_step < STEPS
    x[:, exit_step:] = 0.5
    assert int(net.infer(x, rule).steps) == exit_step
    with pytest.raises(InputError, match="other than 0 and 1"):
        net.infer(x)


@examples(20)
@given(seed=st.integers(0, 999))
@each_backend
def test_a_patience_that_never_ends_is_the_full_window(backend, seed):
    net = network(seed, backend)
    full, patient = net.infer(spikes(seed), FULL_WINDOW), net.infer(spikes(seed), ExitRule(STEPS))
    for one, other in zip(full[:4], patient[:4], strict=True):
        assert torch.equal(one, other)
    assert torch.equal(full.labels, net(spikes(seed)).readout.argmax(dim=1))


@examples(20)
@given(seed=st.integers(0, 999), patience=st.integers(1, STEPS))
@each_backend
def test_all_patiences_at_once_are_each_by_itself(backend, seed, patience):
    net = network(seed, backend)
    curve = exits(net.simulate(spikes(seed)).readout, integration=net.integration)
    alone = net.infer(spikes(seed), ExitRule(patience, from_first_spike=True))
    assert torch.equal(curve.steps[:, patience - 1], alone.steps)
    assert torch.equal(curve.labels[:, patience - 1], alone.labels)


def test_a_bias_alone_decides_a_silent_window_and_no_exit_comes_before_a_spike():
    net = network()
    with torch.no_grad():
        net.bias.copy_(torch.tensor([0.0, 2.0, 1.0]))
    found = net.infer(torch.zeros(2, STEPS, N_IN), ExitRule(3, from_first_spike=True))
    assert found.labels.tolist() == [1, 1]
    assert found.steps.tolist() == [STEPS, STEPS]


def test_large_batches_are_inferred_in_parts_with_the_same_result(monkeypatch):
    net, rule = network(), ExitRule(4, from_first_spike=True)
    whole = net.infer(spikes(n_trials=9), rule)
    monkeypatch.setattr("neurotact.networks.definition.rsnn.RASTER_VALUES", 1)
    for one, other in zip(whole, net.infer(spikes(n_trials=9), rule), strict=True):
        assert torch.equal(one, other)


def test_a_hidden_spike_is_an_operation_at_every_class():
    net = network(model="snn")
    found = net.infer(spikes())
    cost = synops.of_network(net, found.input_spikes.numpy(), found.hidden_spikes.numpy())
    hidden = net.simulate(spikes()).hidden.sum(dim=(1, 2))
    assert cost.readout.tolist() == (CLASSES * hidden).long().tolist()
    assert not cost.recurrent.any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_checkpoint_gives_it_back(tmp_path, dtype):
    net = network(dtype=dtype)
    run_folder.save_network(net, tmp_path)
    again, _ = run_folder.load_network(tmp_path, backend="reference")
    assert torch.equal(again.bias, net.bias)
    assert torch.equal(again(spikes()).readout, net(spikes()).readout)
