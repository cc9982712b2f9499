"""Readouts that leak: what they are, on both backends, with early exit, and in training."""

import math
from typing import Any, get_args

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from neurotact_parts.studies.texture import shortened
from torch import Tensor

from neurotact import backend as backends
from neurotact.errors import InputError
from neurotact.networks.definition import native
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.exit import truncated
from neurotact.networks.exit.patience import exits
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import run_folder
from neurotact.networks.training.epochs import Examples, train
from neurotact.networks.training.trainer import exit_of
from neurotact.neurons import Membrane
from neurotact.spec import build

native_only = pytest.mark.skipif(backends.native is None, reason="no kernels")
BACKENDS = ["reference", pytest.param("native", marks=native_only)]
each_backend = pytest.mark.parametrize("backend", BACKENDS)
KINDS = {
    "sum": {"readout": "integrator"},
    "leaky": {"readout": "integrator", "readout_tau_ms": 20.0},
    "max": {"readout": "max", "readout_tau_ms": 20.0},
    "count": {"readout": "count"},
}
LEAKING = ["leaky", "max"]
RATE_Hz, N_IN, CLASSES, STEPS = 400.0, 5, 3, 40
TOLERANCE = {torch.float32: 1e-4, torch.float64: 1e-9}
LEARNED = ("alpha", "beta", "threshold")


def network(
    kind: str, seed: int = 0, backend: Any = "reference", dtype=torch.float64, classes: int = CLASSES, **table: Any
) -> RSNN:
    spec = RSNNSpec(**{"hidden": 7, "forward_weight_scale": 4.0, **KINDS[kind], **table})
    generator = torch.Generator().manual_seed(seed)
    net = RSNN(N_IN, classes, spec, RATE_Hz, backend=backend, generator=generator, dtype=dtype)
    if net.bias is not None:
        with torch.no_grad():
            net.bias += 0.3 * torch.randn(classes, generator=generator)
    return net


def spikes(seed: int = 0, n_trials: int = 5, n_steps: int = STEPS) -> Tensor:
    return (torch.rand(n_trials, n_steps, N_IN, generator=torch.Generator().manual_seed(seed)) < 0.2).to(torch.uint8)


def values_by_hand(kind: str, net: RSNN, hidden: Tensor) -> Tensor:
    """After each step, `(trial, time, class)`, from hidden rasters: the equations of docs/equations.md."""
    decay = math.exp(-1e3 / (20.0 * RATE_Hz))
    found = torch.zeros(*hidden.shape[:2], net.n_classes, dtype=torch.float64)
    for trial, raster in enumerate(hidden.double()):
        y = most = torch.zeros(net.n_classes, dtype=torch.float64)
        for t, sent in enumerate(raster):
            y = decay * y + sent @ net.w_out.double()
            most = torch.maximum(most, y)
            found[trial, t] = net.bias.double() + (y if kind == "leaky" else most)
    return found.detach()


# --- what they are -------------------------------------------------------------------------------------


@each_backend
@pytest.mark.parametrize("kind", LEAKING)
@pytest.mark.parametrize("membrane", get_args(Membrane))
def test_they_are_their_equations(kind, backend, membrane):
    net = network(kind, 1, backend, membrane=membrane)
    hidden = net.simulate(spikes(1), ordered=True).hidden
    assert hidden.any()
    wanted = values_by_hand(kind, net, hidden)
    torch.testing.assert_close(net(spikes(1)).readout.detach(), wanted[:, -1], rtol=1e-12, atol=1e-12)
    found = net.infer(spikes(1))
    torch.testing.assert_close(found.readout, wanted[:, -1], rtol=1e-12, atol=1e-12)
    assert torch.equal(found.labels, wanted[:, -1].argmax(dim=1))


@each_backend
def test_without_a_leak_it_is_the_sum(backend):
    plain = network("sum", backend=backend, dtype=torch.float32)
    slow = network("leaky", backend=backend, dtype=torch.float32, readout_tau_ms=1e9)
    assert slow.leaks
    assert not plain.leaks
    torch.testing.assert_close(slow(spikes()).readout, plain(spikes()).readout)


@each_backend
def test_a_maximum_over_time_is_never_below_the_bias_or_any_step(backend):
    largest, leaky = network("max", 4, backend), network("leaky", 4, backend)
    found = largest.infer(spikes(4)).readout
    assert (found >= largest.bias.detach()).all()
    assert all((found >= leaky.infer(spikes(4)[:, :n]).readout).all() for n in (1, 10, 25, STEPS))


def test_a_maximum_leaks_as_its_membranes_where_nothing_else_is_said():
    net = RSNN(2, 2, RSNNSpec(readout="max", tau_mem_ms=7.0), RATE_Hz)
    assert net.integration is not None
    assert net.integration.decay == pytest.approx(math.exp(-1e3 / (7.0 * RATE_Hz)))


def test_a_leak_without_a_readout_that_adds_is_refused():
    with pytest.raises(InputError, match="readout_tau_ms needs readout"):
        build(RSNNSpec, {"readout_tau_ms": 5.0}, source="here")
    assert build(RSNNSpec, {"readout_tau_ms": 5.0, "recipe": "default"}, source="here").readout_tau_ms == 5.0
    assert RSNNSpec(readout="max").digest() != RSNNSpec(readout="max", readout_tau_ms=5.0).digest()


@pytest.mark.parametrize("kind", LEAKING)
def test_a_checkpoint_gives_it_back(kind, tmp_path):
    net = network(kind)
    run_folder.save_network(net, tmp_path)
    again, _ = run_folder.load_network(tmp_path, backend="reference")
    assert torch.equal(again(spikes()).readout, net(spikes()).readout)


# --- the kernels ---------------------------------------------------------------------------------------


def gradients_of(net: RSNN, x: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    counts = net(x)
    generator = torch.Generator().manual_seed(3)
    parts = [torch.randn(each.shape, generator=generator, dtype=each.dtype) for each in counts]
    total = sum((each * part).sum() for each, part in zip(counts, parts, strict=True))
    trained = [p for p in net.parameters() if p.requires_grad]
    found = torch.autograd.grad(total, trained, allow_unused=True, materialize_grads=True)
    return [each.detach() for each in counts], [*found]


def agree(x: Tensor, kind: str, seed: int, dtype: torch.dtype, classes: int = CLASSES, **table: Any) -> None:
    """Hidden spikes equal to the last bit, values and gradients within tolerance."""
    ours, theirs = (network(kind, seed, backend, dtype, classes, **table) for backend in ("native", "reference"))
    assert torch.equal(ours(x).hidden, theirs.simulate(x, ordered=True).hidden.sum(dim=1))
    pairs = zip(gradients_of(ours, x), gradients_of(theirs, x), strict=True)
    for one, other in (pair for parts in pairs for pair in zip(*parts, strict=True)):
        assert (one - other).abs().max() <= TOLERANCE[dtype] * max(float(other.abs().max()), 1e-2)


@native_only
@pytest.mark.parametrize("kind", LEAKING)
@pytest.mark.parametrize("membrane", get_args(Membrane))
@given(
    hidden=st.integers(1, 80),
    classes=st.integers(1, 70),
    model=st.sampled_from(["rsnn", "snn"]),
    reset=st.sampled_from(["zero", "subtract", "hard"]),
    window=st.tuples(st.integers(1, 20), st.integers(1, 30)),
    isa=st.sampled_from(native.isas() if native.native else ["plain"]),
    threads=st.integers(1, 3),
    delay=st.integers(0, 1),
    learns=st.booleans(),
    seed=st.integers(0, 99),
)
@examples(25)
def test_values_and_gradients_are_the_reference_s(
    kind, membrane, hidden, classes, model, reset, window, isa, threads, delay, learns, seed
):
    before = torch.get_num_threads()
    try:
        native.set_isa(isa)
        torch.set_num_threads(threads)
        table = {"membrane": membrane, "recurrent_delay_steps": delay, "hidden": hidden, "model": model}
        table |= {"reset": reset, "learn": LEARNED if learns else ()}
        agree(spikes(seed, *window), kind, seed, torch.float64, classes, **table)
    finally:
        torch.set_num_threads(before)
        native.set_isa(native.isas()[-1])


@native_only
@pytest.mark.parametrize("kind", LEAKING)
@thinned(("hidden", "classes"), [(16, 8), (30, 12), (48, 30), (64, 32), (32, 60), (70, 27)], every=3)
@pytest.mark.parametrize("membrane", ["eq4", "immediate"])
def test_every_form_of_the_kernels_agrees_in_float32(kind, hidden, classes, membrane):
    for isa in native.isas():
        native.set_isa(isa)
        agree(spikes(2), kind, 2, torch.float32, classes, hidden=hidden, membrane=membrane)
    native.set_isa(native.isas()[-1])


@native_only
@pytest.mark.parametrize("kind", LEAKING)
@pytest.mark.parametrize("hidden", [20, 70])
def test_gradients_of_the_readout_follow_finite_differences(kind, hidden):
    """Hidden spikes do not depend on the readout's weights, in which a value is linear but where its step changes."""
    net, x = network(kind, 5, "native", hidden=hidden), spikes(5)
    weights = torch.randn(len(x), CLASSES, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    (grad,) = torch.autograd.grad((net(x).readout * weights).sum(), [net.w_out])
    with torch.no_grad():
        for i, c in ((0, 0), (3, 1), (hidden - 1, 2)):
            sums = []
            for step in (1e-6, -1e-6):
                net.w_out[i, c] += step
                sums.append(float((net(x).readout * weights).sum()))
                net.w_out[i, c] -= step
            assert (sums[0] - sums[1]) / 2e-6 == pytest.approx(float(grad[i, c]), rel=1e-6, abs=1e-6)


@native_only
@pytest.mark.parametrize("kind", LEAKING)
@pytest.mark.parametrize("hidden", [20, 70])
def test_threads_move_no_bit(kind, hidden):
    found = []
    for threads in (1, 4):
        torch.set_num_threads(threads)
        found.append(gradients_of(network(kind, 6, "native", torch.float32, hidden=hidden), spikes(6, 40)))
    torch.set_num_threads(1)
    for one, other in zip(*found, strict=True):
        assert all(map(torch.equal, one, other))


# --- early exit ----------------------------------------------------------------------------------------

rules = st.one_of(
    st.just(FULL_WINDOW),
    st.builds(ExitRule, st.integers(1, STEPS), st.booleans()),
)


@each_backend
@pytest.mark.parametrize("kind", KINDS)
@examples(25)
@given(seed=st.integers(0, 999), rule=rules)
def test_early_exit_is_the_definition_step_by_step(kind, backend, seed, rule):
    net, x = network(kind, seed, backend), spikes(seed, 3)
    found, rasters = net.infer(x, rule), net.simulate(x, ordered=True)
    values = rasters.readout.cumsum(dim=1) if kind == "count" else values_by_hand(kind, net, rasters.hidden)
    if kind == "sum":
        values = net.bias.detach() + rasters.readout.detach().cumsum(dim=1)
    for trial in range(len(x)):
        leader, standing, heard = 0, 0, False
        for t in range(STEPS):
            now = values[trial, t].detach().double()
            heard = heard or bool(rasters.readout[trial, t].any())
            standing = (standing + 1 if int(now.argmax()) == leader else 1) if heard or not rule.from_first_spike else 0
            leader = int(now.argmax())
            stops = rule.patience is not None and standing > rule.patience
            if stops or t + 1 == STEPS:
                break
        assert (int(found.steps[trial]), int(found.labels[trial])) == (t + 1, leader)
        assert int(found.input_spikes[trial]) == int(x[trial, : t + 1].sum())
        assert int(found.hidden_spikes[trial]) == int(rasters.hidden[trial, : t + 1].sum())


@native_only
@pytest.mark.parametrize("kind", KINDS)
@examples(40)
@given(
    seed=st.integers(0, 999), rule=rules, membrane=st.sampled_from(get_args(Membrane)), delay=st.integers(0, 1),
    hidden=st.sampled_from([7, 64, 65]), classes=st.sampled_from([1, 2, 9]), n_steps=st.sampled_from([0, 1, STEPS]),
)  # fmt: skip
def test_both_backends_decide_alike(kind, seed, rule, membrane, delay, hidden, classes, n_steps):
    table = {"membrane": membrane, "recurrent_delay_steps": delay, "hidden": hidden}
    found, wanted = (
        network(kind, seed, backend, torch.float64, classes, **table).infer(spikes(seed, n_steps=n_steps), rule)
        for backend in ("native", "reference")
    )
    assert all(map(torch.equal, found[:4], wanted[:4]))
    torch.testing.assert_close(found.readout, wanted.readout, rtol=1e-12, atol=1e-12)


@each_backend
@pytest.mark.parametrize("kind", KINDS)
@examples(15)
@given(seed=st.integers(0, 999), patience=st.integers(1, STEPS))
def test_all_patiences_at_once_are_each_by_itself(kind, backend, seed, patience):
    net, x = network(kind, seed, backend, torch.float32), spikes(seed)
    curve = exits(net.simulate(x).readout.detach(), integration=net.integration)
    alone = net.infer(x, ExitRule(patience, from_first_spike=True))
    assert torch.equal(curve.steps[:, patience - 1], alone.steps)
    assert torch.equal(curve.labels[:, patience - 1], alone.labels)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_training", [False, True])
def test_a_patience_is_chosen_that_keeps_the_accuracy(kind, with_training):
    net, x = network(kind, 9), spikes(9, 30)
    held = Examples(x, net.infer(x).labels)  # right whenever the whole window is heard
    rule = exit_of(net, held, 0.0, held if with_training else None).rule
    found = net.infer(x, rule)
    assert torch.equal(found.labels, held.labels)
    assert rule.patience is not None
    assert rule.from_first_spike
    assert found.steps.sum() < STEPS * len(x)
    loose = net.infer(x, exit_of(net, held, 0.5).rule)
    assert loose.steps.sum() <= found.steps.sum()


@pytest.mark.parametrize("kind", LEAKING)
def test_a_window_cut_short_is_one_of_that_length(kind):
    net, x = network(kind, 2), spikes(2, 20)
    examples = Examples(x, net.infer(x).labels)
    heard = truncated.simulate_windows(net, examples)
    (row,) = shortened.cut_short(net, heard, [1e3 * 15 / RATE_Hz])
    assert row["accuracy_test"] == (net.infer(x[:, :15]).labels == examples.labels).double().mean()


# --- training ------------------------------------------------------------------------------------------


@thinned("backend", BACKENDS[::-1])
@pytest.mark.parametrize("kind", LEAKING)
@thinned("dropout", [0.3, 0.0])
def test_a_network_learns_which_half_of_a_window_is_busy(kind, backend, dropout):
    """Both classes send as many spikes: only a readout that knows when can tell them apart from one hidden neuron."""
    draw = torch.Generator().manual_seed(0)
    labels = torch.arange(60) % 2
    busy = torch.where(labels[:, None] == (torch.arange(STEPS) >= STEPS // 2), 0.4, 0.02)
    x = (torch.rand(60, STEPS, N_IN, generator=draw) < busy[..., None]).to(torch.uint8)
    training = TrainingSpec(
        epochs=40, patience=40, batch=20, learning_rate=0.03, rate_penalty=0.0, readout_dropout=dropout
    )
    spec = RSNNSpec(hidden=12, forward_weight_scale=4.0, training=training, **KINDS[kind])
    net = RSNN(N_IN, 2, spec, RATE_Hz, backend=backend, generator=torch.Generator().manual_seed(1))
    found = train(net, Examples(x, labels), Examples(x, labels), generator=torch.Generator().manual_seed(2))
    assert found.best.validation_accuracy > 0.8
    assert found.best.validation_loss < found.epochs[0].train_loss


def test_hidden_neurons_that_are_not_heard_have_no_say():
    net, x = network("leaky"), spikes()
    heard = torch.ones(7, dtype=torch.float64)
    heard[2:] = 0
    with torch.no_grad():
        wanted = net(x, heard).readout
        net.w_out[2:] = 0
    torch.testing.assert_close(net(x).readout, wanted)


def test_integration_says_whether_it_leaks():
    level = torch.zeros(2, dtype=torch.float64)
    assert [Integration(level, *how).leaks for how in ((1.0, False), (1.0, True), (0.9, False))] == [False, True, True]
