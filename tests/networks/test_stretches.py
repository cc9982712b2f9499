"""Readouts with weights of their own in each stretch of a window: what they are, and that they learn."""

from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import READOUTS, unequal_stretches
from neurotact_parts.exporters.c import fine_tuning
from neurotact_parts.exporters.c.formats import Steps

from neurotact import backend as backends
from neurotact.errors import InputError
from neurotact.metrics.flops import Integrator, cost
from neurotact.networks.definition import initial
from neurotact.networks.definition.readouts import Stretches
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.exit.rule import ExitRule
from neurotact.networks.training import epochs, run_folder
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.sparsity import prune
from neurotact.networks.use.measuring import synops_of
from neurotact.neurons import Membrane
from neurotact.spec import build

native_only = pytest.mark.skipif(backends.native is None, reason="no kernels")
each_backend = pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=native_only)])


def network(seed: int = 0, backend: backends.Backend = "reference", rate_Hz: float = 1000.0, **keys) -> RSNN:
    keys = {"hidden": 6, "forward_weight_scale": 4.0, **READOUTS["stretches"], **keys}
    generator, dtype = torch.Generator().manual_seed(seed), keys.pop("dtype", torch.float32)
    net = RSNN(4, 3, sampling_rate_Hz=rate_Hz, backend=backend, generator=generator, dtype=dtype, **keys)
    unequal_stretches(net)
    return net


def spikes(seed: int = 0, n_trials: int = 5, n_steps: int = 40) -> torch.Tensor:
    return (torch.rand(n_trials, n_steps, 4, generator=torch.Generator().manual_seed(seed)) < 0.3).to(torch.uint8)


@given(number=st.integers(2, 6), steps=st.integers(1, 9), n_steps=st.integers(0, 40), seed=st.integers(0, 99))
@examples(30)
def test_the_parts_of_a_window_are_all_of_it(number, steps, n_steps, seed):
    hidden = spikes(seed, 2, n_steps).double()
    parts, weights = Stretches(number, steps), torch.randn(number, 4, 3, dtype=torch.float64)
    counts, of_steps = parts.counts(hidden), parts.of_steps(n_steps).tolist()
    assert of_steps == [parts.of_step(t) for t in range(n_steps)]
    assert counts.sum(dim=1).equal(hidden.sum(dim=1))
    expected = sum((hidden[:, t] @ weights[k] for t, k in enumerate(of_steps)), torch.zeros(2, 3, dtype=torch.float64))
    torch.testing.assert_close(parts.sums(counts, weights), expected)
    torch.testing.assert_close(parts.gains(hidden, weights).sum(dim=1), expected)


@each_backend
@pytest.mark.parametrize("step_ms", [None, 3.0])
def test_each_spike_adds_the_weight_of_its_stretch(backend, step_ms):
    net = network(backend=backend, step_ms=step_ms)
    hidden, gained = net.simulate(spikes())
    n = net.steps_per_bin
    by_hand = torch.zeros(5, 3, dtype=torch.float64)
    for t in range(hidden.shape[1]):
        stretch = min(t * n // 12, 2)
        weights = (net.w_out + net.w_stretch[stretch]).double()
        by_hand += hidden[:, t].double() @ weights
        torch.testing.assert_close(gained[:, t], hidden[:, t].double() @ weights)
    assert hidden.any()
    by_hand += net.bias.double()
    torch.testing.assert_close(net(spikes()).readout.double(), by_hand, rtol=1e-6, atol=1e-5)
    torch.testing.assert_close(net.infer(spikes()).readout, by_hand.detach())


@native_only
@given(
    seed=st.integers(0, 99), patience=st.sampled_from([1, 5]), step_ms=st.sampled_from([None, 3.0, 4.0]),
    membrane=st.sampled_from(get_args(Membrane)), delay=st.integers(0, 1), model=st.sampled_from(["rsnn", "snn"]),
    hidden=st.sampled_from([6, 20, 80]), adaptation=st.sampled_from([0.0, 0.3]),
)  # fmt: skip
@examples(30)
def test_kernels_equal_the_reference_in_decisions_and_gradients(
    seed, patience, step_ms, membrane, delay, model, hidden, adaptation
):
    rule = ExitRule(patience)
    options = {
        "step_ms": step_ms, "model": model, "membrane": membrane, "hidden": hidden, "threshold_adaptation": adaptation,
    }  # fmt: skip
    if model == "rsnn":
        options["recurrent_delay_steps"] = delay
    decided = [network(seed, backend, **options).infer(spikes(seed), rule) for backend in ("reference", "native")]
    for ours, theirs in zip(*decided, strict=True):
        assert torch.equal(ours, theirs)
    nets = [network(seed, backend, dtype=torch.float64, **options) for backend in ("reference", "native")]
    for net in nets:
        counts = net(spikes(seed), torch.rand(5, hidden, generator=torch.Generator().manual_seed(seed)))
        (counts.readout.square().sum() + counts.hidden.sum()).backward()
    for (name, ours), theirs in zip(nets[0].named_parameters(), nets[1].parameters(), strict=True):
        if ours.grad is not None:
            torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-7, atol=1e-7, msg=name)


def test_equal_weights_in_every_stretch_are_those_of_one():
    plain = RSNN(4, 3, sampling_rate_Hz=1000.0, hidden=6, readout="integrator")
    parts = network()
    parts.load_state_dict(plain.state_dict(), strict=False)
    with torch.no_grad():
        parts.w_stretch.zero_()
    for ours, theirs in zip(plain.infer(spikes()), parts.infer(spikes()), strict=True):
        torch.testing.assert_close(ours, theirs)


def ordered(seed: int, n: int = 120) -> Examples:
    """Two classes with the same spikes in another order: the one half of the afferents, a pause, then the other."""
    generator = np.random.default_rng(seed)
    labels = torch.arange(n) % 2
    found = torch.zeros(n, 40, 4, dtype=torch.uint8)
    for i, label in enumerate(labels.tolist()):
        for half in (0, 1):
            afferents = slice(0, 2) if half == label else slice(2, 4)
            drawn = (generator.random((12, 2)) < 0.4).astype(np.uint8)
            found[i, 28 * half : 28 * half + 12, afferents] = torch.from_numpy(drawn)
    return Examples(found, labels)


def trained_on_order(backend: backends.Backend, **keys) -> float:
    table = {
        "model": "snn", "hidden": 8, "tau_mem_ms": 1.5, "tau_syn_ms": 1.5, "input_deviation": 1.0, **keys,
        "training": {"epochs": 15, "batch": 20, "relative_learning_rate": 0.05, "readout_dropout": 0.1},
    }  # fmt: skip
    net = RSNN(4, 2, build(RSNNSpec, table, source="test"), 1000.0, backend=backend,
               generator=torch.Generator().manual_seed(0))  # fmt: skip
    seen, unseen = ordered(0), ordered(1)
    initial.start(net, seen.spikes, torch.Generator().manual_seed(1))
    return train(net, seen, unseen, generator=torch.Generator().manual_seed(2)).best.validation_accuracy


@each_backend
def test_they_tell_an_order_that_one_sum_cannot(backend):
    halves = {"readout": "integrator", "readout_stretches": 2, "readout_stretch_ms": 20.0}
    assert trained_on_order(backend, readout="integrator") < 0.75 < 0.95 < trained_on_order(backend, **halves)


def test_deviations_learn_at_their_share_of_the_rate():
    for settings in ({"relative_learning_rate": 0.05}, {"learning_rate": 0.01}):
        net = network(training=TrainingSpec(stretch_rate=0.1, **settings).model_dump())
        rates = epochs.rates_of(net)
        assert rates["w_stretch"] == pytest.approx(0.1 * rates["w_out"])
        groups = epochs._optimiser(net).param_groups
        assert {group["lr"] for group in groups if group["params"][0] is net.w_stretch} == {rates["w_stretch"]}


def test_a_checkpoint_keeps_them(tmp_path):
    net = network(step_ms=3.0)
    run_folder.save_network(net, tmp_path)
    again, _ = run_folder.load_network(tmp_path)
    assert again.stretches == Stretches(3, 4)
    assert torch.equal(again.infer(spikes()).readout, net.infer(spikes()).readout)


def test_their_weights_count_and_their_operations_do_not():
    plain, parts = (cost(Integrator(6, 3, sops=50, stretches=k)) for k in (1, 4))
    assert (plain.parameters, parts.parameters, parts.acs) == (21, 75, plain.acs)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"readout_stretches": 3, "readout": "integrator"}, "needs readout_stretch_ms"),
        ({"readout_stretches": 3, "readout_stretch_ms": 5.0}, "needs readout = 'integrator'"),
        ({**READOUTS["stretches"], "readout_tau_ms": 5.0}, "without readout_tau_ms"),
        ({**READOUTS["stretches"], "step_ms": 5.0}, "readout_stretch_ms: 12 ms is not a whole number of steps"),
    ],
)
def test_stretches_that_cannot_be_are_refused(keys, message):
    with pytest.raises(InputError, match=message):
        RSNN(2, 2, sampling_rate_Hz=1000.0, **keys)


def test_a_pruned_synapse_has_no_weight_in_any_stretch():
    net = network()
    before = net.readout_weights.detach().square().mean(dim=0)
    prune(net, 0.5)
    kept = net.readout_weights.detach().ne(0)
    assert kept.all(dim=0).equal(kept.any(dim=0))
    assert int(kept[0].sum()) == 9
    assert before[kept[0]].min() >= before[~kept[0]].max()
    spent = synops_of(net.infer(spikes()), net)
    assert (spent.readout == (net(spikes()).hidden @ kept[0].sum(dim=1).float()).detach().numpy()).all()


def test_fine_tuning_refuses_them():
    with pytest.raises(InputError, match="readout_stretches: fine-tuning"):
        fine_tuning.grids_of(network(), Steps(0.1, None, 0.1), 8)
