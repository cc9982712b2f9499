"""Thresholds that rise with each spike: their laws, the kernels against the definition, and who refuses them."""

import json
from typing import get_args

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from neurotact_parts.exporters.snntorch import to_snntorch
from neurotact_parts.studies.texture import shortened
from test_native import (
    LEARNED,
    compare,
    decide,
    dtypes,
    each_variant,
    farthest,
    gradients,
    isas,
    limit,
    network,
    spikes,
    variants,
)
from test_reference import finite_difference, loss_of
from test_reference import network as smooth_network
from test_reference import spikes as smooth_spikes

from neurotact.errors import InputError
from neurotact.metrics.flops import SpikingLayer, cost
from neurotact.networks.definition import native, reference
from neurotact.networks.definition.recipe import Seen, resolve
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.exit import truncated
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training import run_folder
from neurotact.networks.training.epochs import Examples
from neurotact.networks.use import ledger
from neurotact.neurons import Adaptation, CubaLIF, Membrane, Reset
from neurotact.spec import build

pytestmark = pytest.mark.usefixtures("kernels_as_before")

needs_kernels = pytest.mark.skipif(native.native is None, reason="the kernels are not compiled here")
ADAPTING = {"threshold_adaptation": 2.0, "tau_adaptation_ms": 25.0}
strengths = st.sampled_from([0.1, 2.0, 20.0])
times_ms = st.sampled_from([3.0, 25.0, 4000.0])
VARIANTS = [(membrane, reset) for membrane in get_args(Membrane) for reset in get_args(Reset)]


# --- laws ----------------------------------------------------------------------------------------------


def run(x, w, neuron: CubaLIF, how: Adaptation | None, *, alpha=0.8, beta=0.9, threshold=1.0):
    """What a feed-forward layer sends, and its last state."""
    return reference.cuba_lif_layer(
        x, w, None, alpha=alpha, beta=beta, threshold=threshold, neuron=neuron, spike=FastSigmoid(), adaptation=how
    )


def steady(n_steps: int, drive: float):
    """One afferent that spikes at each step, and its weight into one neuron."""
    return torch.ones(1, n_steps, 1, dtype=torch.float64), torch.full((1, 1), drive, dtype=torch.float64)


def test_three_steps_by_hand():
    """Membrane `immediate` with alpha = beta = 0: U[t+1] = w x[t], so that every number is in one's head."""
    x = torch.tensor([[[1.0], [1.0], [1.0], [0.0], [1.0]]], dtype=torch.float64)
    w = torch.full((1, 1), 1.25, dtype=torch.float64)
    how = Adaptation(strength=0.5, decay=0.5)
    sent, state = run(x, w, CubaLIF("immediate", "hard"), how, alpha=0.0, beta=0.0)
    # A[1] = 0: 1.25 > 1 spikes. A[2] = 1: 1.25 < 1.5. A[3] = 0.5: 1.25 is not above 1.25. A[4] = 0.25: no input.
    # A[5] = 0.125: 1.25 > 1.0625 spikes.
    assert sent[0, :, 0].tolist() == [1, 0, 0, 0, 1]
    assert state.adaptation.item() == 0.125


@pytest.mark.parametrize(("reset", "left"), [("zero", 0.0), ("hard", 0.0), ("subtract", 0.5 * 5.0 - 1.5)])
def test_subtract_takes_off_the_threshold_that_was_crossed(reset, left):
    x = torch.tensor([[[1.0], [1.0], [0.0]]], dtype=torch.float64)
    neuron, w = CubaLIF("immediate", reset), torch.full((1, 1), 4.0, dtype=torch.float64)
    sent, state = run(x, w, neuron, Adaptation(0.5, 0.5), alpha=0.0, beta=0.5)
    # subtract: U[1] = 4, A[1] = 0. U[2] = 0.5 * 4 + 4 - 1 = 5, A[2] = 1: above 1.5. U[3] = 0.5 * 5 - 1.5.
    # The others silence no step here but reset it: hard has U[2] = 4, which is above 1.5 as well; zero has 0.
    assert sent[0, :, 0].tolist() == {"zero": [1, 0, 0], "hard": [1, 1, 0], "subtract": [1, 1, 0]}[reset]
    assert state.membrane.item() == left


@given(rho=st.floats(0.0, 0.999), n=st.integers(1, 60))
@examples(20)
def test_a_neuron_that_spikes_at_each_step_adapts_as_a_geometric_series(rho, n):
    x, w = steady(n + 1, 1e9)
    sent, state = run(x, w, CubaLIF("immediate", "subtract"), Adaptation(1e-3, rho))
    assert sent.all()
    assert state.adaptation.item() == pytest.approx((1 - rho**n) / (1 - rho))


@each_variant
def test_at_constant_drive_intervals_grow_until_they_are_steady(membrane, reset):
    x, w = steady(2000, 0.03)  # without a spike the membrane would reach three thresholds
    intervals = []
    for strength in (0.0, 0.1, 0.3, 1.0):
        sent, _ = run(
            x, w, CubaLIF(membrane, reset), Adaptation(strength, 0.99) if strength else None, alpha=0.0, beta=0.99
        )
        intervals.append(sent[0, :, 0].nonzero()[:, 0].diff())
    assert intervals[0].max() - intervals[0].min() <= 1  # an interval is a whole number of steps
    for each in intervals[1:]:
        assert (each.diff() >= -1).all()
        assert each[-1] > each[0]
        assert each[-1] > intervals[0].max()
    assert intervals[-1][-1] > 2 * intervals[0].max()
    assert [len(each) for each in intervals] == sorted((len(each) for each in intervals), reverse=True)


@pytest.mark.parametrize(("membrane", "reset"), [(m, r) for m, r in VARIANTS if r != "subtract"])
@given(
    seed=st.integers(0, 999),
    n_in=st.integers(1, 5),
    more=st.sampled_from(["strength", "tau"]),
    strength=strengths,
    rho=st.sampled_from([0.3, 0.9, 0.99]),
)
@examples(8)
def test_no_spike_comes_earlier_where_thresholds_rise_more_or_longer(membrane, reset, seed, n_in, more, strength, rho):
    """Of excitatory inputs without recurrence: the n-th spike of each neuron, so that no window has more of them.

    A membrane that has spiked later was reset to 0 later and lies no higher, and its threshold lies no lower. (Not so
    of `subtract`: a threshold that had longer to come down takes off less.)
    """
    generator = torch.Generator().manual_seed(seed)
    x = (torch.rand(3, 80, n_in, generator=generator) < 0.4).double()
    w = 2.0 * torch.rand(n_in, 6, generator=generator, dtype=torch.float64)
    less = Adaptation(strength, rho)
    larger = Adaptation(1.5 * strength, rho) if more == "strength" else Adaptation(strength, rho**0.5)
    neuron = CubaLIF(membrane, reset)
    counts = [run(x, w, neuron, how)[0].cumsum(dim=1) for how in (None, less, larger)]
    assert (counts[0] >= counts[1]).all()
    assert (counts[1] >= counts[2]).all()
    assert counts[0].sum() > 0


@each_variant
@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_kernels)])
def test_without_a_strength_it_is_the_network_that_it_was(membrane, reset, backend):
    variant = {"membrane": membrane, "reset": reset, "backend": backend, "learn": LEARNED}
    plain, off = network(**variant), network(**variant, threshold_adaptation=0.0)
    assert off.adaptation is None
    x = spikes()
    assert all(map(torch.equal, plain(x), off(x)))
    parameters = list(plain.parameters()), list(off.parameters())
    pairs = zip(gradients(plain(x), parameters[0]), gradients(off(x), parameters[1]), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("cut", [0, 1, 7, 25])
def test_two_pieces_equal_the_whole(cut):
    net, x = network(**ADAPTING, backend="reference", dtype=torch.float64), spikes().double()
    kept = {
        "alpha": net.alpha[0], "beta": net.beta[0], "threshold": net.threshold[0], "neuron": net.neuron,
        "spike": net.spike, "adaptation": net.adaptation,
    }  # fmt: skip
    whole, end = reference.cuba_lif_layer(x, net.w_in, net.w_rec, **kept)
    first, state = reference.cuba_lif_layer(x[:, :cut], net.w_in, net.w_rec, **kept)
    second, last = reference.cuba_lif_layer(x[:, cut:], net.w_in, net.w_rec, **kept, state=state)
    assert torch.equal(torch.cat([first, second], dim=1), whole)
    assert all(map(torch.equal, last, end))


@pytest.mark.parametrize("kind", ["count", "integrator", "max"])
def test_a_window_cut_short_is_one_of_that_length(kind):
    net, x = network(**ADAPTING, readout=kind, classes=4), spikes(20, 40)
    windows = Examples(x, torch.arange(20) % 4)
    heard = truncated.simulate_windows(net, windows)
    for steps in (5, 17, 40):
        (row,) = shortened.cut_short(net, heard, [1e3 * steps / 400.0])
        short = net.infer(x[:, :steps])
        assert row["accuracy_test"] == float((short.labels == windows.labels).double().mean())
        assert row["sops_readout"] == 4 * float(short.hidden_spikes.double().mean())


# --- gradients of the definition -----------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1])
@thinned(("membrane", "reset"), [(m, r) for m, r in VARIANTS if r != "subtract"], every=3)
def test_gradients_equal_finite_differences(membrane, reset, delay):
    """Through A too: a spike that is a number, with the surrogate as its slope, raises thresholds by as much.

    What `subtract` takes off has no gradient (see the next test), so that it is left out.
    """
    adapting = {"threshold_adaptation": 0.3, "tau_adaptation_ms": 15.0}
    net = smooth_network(membrane, reset, recurrent_delay_steps=delay, **adapting)
    x = smooth_spikes()
    loss, resets = loss_of(net, x)
    loss.backward()
    assert 0.05 < resets.double().mean() < 0.95
    for name, parameter in net.named_parameters():
        expected = finite_difference(net, x, parameter.data)
        torch.testing.assert_close(parameter.grad, expected, rtol=1e-6, atol=1e-7, msg=lambda m, n=name: f"{n}: {m}")


@pytest.mark.parametrize(("reset", "left"), [("zero", 0.0), ("hard", 3.0), ("subtract", 3.0 - 1.0)])
@pytest.mark.parametrize("backend", ["reference", pytest.param("native", marks=needs_kernels)])
def test_a_gradient_comes_through_the_adaptation_alone(reset, left, backend):
    """One neuron without recurrence or memory: that of the third spike by the first input has no other way.

    Not through what `subtract` takes off either, though it holds A.
    """
    x = torch.ones(1, 3, 1, dtype=torch.float64, requires_grad=True)
    w, k, rho = torch.full((1, 1), 3.0, dtype=torch.float64), 0.5, 0.9
    call = {"alpha": 0.0, "beta": 0.0, "threshold": 1.0, "neuron": CubaLIF("immediate", reset)}
    if backend == "native":
        sent = native.layer(x, w, None, **call, scale=10.0, adaptation=Adaptation(k, rho))
    else:
        sent, _ = reference.cuba_lif_layer(x, w, None, **call, spike=FastSigmoid(), adaptation=Adaptation(k, rho))
    (grad,) = torch.autograd.grad(sent[0, 2, 0], x)

    def slope(over: float) -> float:
        return 1 / (1 + 10 * abs(over)) ** 2

    # A[1] = 0, A[2] = s[1] = 1, A[3] = rho A[2] + s[2].
    second = left > 1 + k
    first, middle = slope(3.0 - 1.0), slope(left - (1 + k))
    taken = (1 + k) if reset == "subtract" and second else 0.0
    third = slope((0.0 if reset == "zero" and second else 3.0 - taken) - (1 + k * (rho + second)))
    assert grad[0, 0, 0].item() == pytest.approx(w.item() * first * -k * third * (rho - k * middle))


# --- the kernels against the definition ----------------------------------------------------------------


@needs_kernels
@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 80), st.integers(1, 80), st.one_of(st.integers(1, 20), st.integers(17, 70))),
    model=st.sampled_from(["rsnn", "rsnn", "snn"]),
    strength=strengths,
    tau_ms=times_ms,
    window=st.tuples(st.integers(0, 5), st.integers(0, 25)),
    density=st.sampled_from([0.0, 0.05, 0.3, 1.0]),
    dtype=dtypes,
    isa=isas,
    n_threads=st.integers(1, 4),
    learns=st.booleans(),
    with_inputs=st.booleans(),
    delay=st.sampled_from([0, 1]),
    seed=st.integers(0, 99),
)
@examples(160)
def test_counts_and_gradients_are_the_reference_s(
    variant,
    sizes,
    model,
    strength,
    tau_ms,
    window,
    density,
    dtype,
    isa,
    n_threads,
    learns,
    with_inputs,
    delay,
    seed,
):
    n_in, hidden, classes = sizes
    membrane, reset = variant
    table = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay, "model": model}
    adapting = {"threshold_adaptation": strength, "tau_adaptation_ms": tau_ms}
    net = network(n_in, hidden, classes, seed, dtype, **table, **adapting, learn=LEARNED if learns else ())
    native.set_isa(isa)
    torch.set_num_threads(n_threads)
    compare(net, spikes(*window, n_in, density, seed), with_inputs)


@needs_kernels
@thinned("model", ["rsnn", "snn"])
@thinned(("hidden", "classes"), [(n, c) for n in (16, 30, 48, 64, 70) for c in (8, 9, 17, 33)], every=6)
@thinned("learn", [LEARNED, ()])
def test_every_form_of_the_register_kernel_and_its_neighbours_agree(model, hidden, classes, learn):
    net = network(20, hidden, classes, model=model, learn=learn, **ADAPTING)
    compare(net, spikes(5, 20, 20, 0.1), isas=native.isas())


@needs_kernels
@pytest.mark.parametrize("kind", ["integrator", "leaky", "max"])
@thinned("hidden", [20, 64, 70], every=2)
@thinned("learn", [LEARNED, ()])
@thinned("dtype", [torch.float32, torch.float64])
def test_readouts_that_add_up_hear_the_same(kind, hidden, learn, dtype):
    readout = {"readout": "integrator", "readout_tau_ms": 30.0} if kind == "leaky" else {"readout": kind}
    net, other = (
        network(6, hidden, **ADAPTING, **readout, learn=learn, dtype=dtype, backend=backend)
        for backend in ("native", "reference")
    )
    x = spikes(5, 20, 6)
    assert torch.equal(net(x).hidden, net.simulate(x, ordered=True).hidden.sum(dim=1))
    parameters = [[p for p in each.parameters() if p.requires_grad] for each in (net, other)]
    pairs = zip(gradients(net(x), parameters[0]), gradients(other(x), parameters[1]), strict=True)
    assert all(farthest(a, b) <= limit(b) for a, b in pairs)


@needs_kernels
@each_variant
@thinned("delay", [0, 1])
@pytest.mark.parametrize("hidden", [20, 70])
def test_a_negative_threshold_is_no_special_case(membrane, reset, delay, hidden):
    """A neuron that stands above its threshold before the first step is reset, but has sent nothing that raises it."""
    variant = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay}
    net = network(hidden=hidden, **variant, **ADAPTING, learn=LEARNED, dtype=torch.float64)
    with torch.no_grad():
        net.threshold.copy_(torch.tensor([-0.1, -0.2]))
    x = spikes(5, 12)
    rasters = compare(net, x)
    assert all(map(torch.equal, net.infer(x), decide(x, rasters, FULL_WINDOW)))


@needs_kernels
@each_variant
@thinned("delay", [1, 0])
@pytest.mark.parametrize("n_steps", [1, 2, 3])
@thinned("hidden", [20, 70])
def test_windows_no_longer_than_the_delays_agree(membrane, reset, delay, n_steps, hidden):
    variant = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay, "dtype": torch.float64}
    compare(network(5, hidden, **variant, **ADAPTING), spikes(5, n_steps, density=0.8))


@needs_kernels
@each_variant
@pytest.mark.parametrize("hidden", [20, 70])
@pytest.mark.parametrize("model", ["rsnn", "snn"])
def test_adaptation_changes_the_spikes(membrane, reset, hidden, model):
    """Or else the tests of this file would compare two networks without it; of every path of the kernels."""
    nets = [network(5, hidden, membrane=membrane, reset=reset, model=model, **how) for how in ({}, ADAPTING)]
    x = spikes(8, 40)
    fewer = nets[1](x).hidden.sum() / nets[0](x).hidden.sum()
    assert 0.1 < fewer < 0.9
    for found in ([net.infer(x).hidden_spikes.sum() for net in nets], [net.simulate(x).hidden.sum() for net in nets]):
        assert found[1] / found[0] == fewer


@needs_kernels
@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 70), st.integers(1, 80), st.integers(1, 70)),
    strength=strengths,
    tau_ms=times_ms,
    window=st.tuples(st.integers(0, 5), st.integers(1, 30)),
    rule=st.sampled_from([FULL_WINDOW, ExitRule(1), ExitRule(4), ExitRule(4, from_first_spike=True), ExitRule(99)]),
    dtype=dtypes,
    isa=isas,
    n_threads=st.integers(1, 4),
    delay=st.sampled_from([0, 1]),
    seed=st.integers(0, 99),
)
@examples(110)
def test_inference_is_the_reference_s(
    variant, sizes, strength, tau_ms, window, rule, dtype, isa, n_threads, delay, seed
):
    n_in, hidden, classes = sizes
    membrane, reset = variant
    table = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay}
    adapting = {"threshold_adaptation": strength, "tau_adaptation_ms": tau_ms}
    net = network(n_in, hidden, classes, seed, dtype, **table, **adapting)
    x = spikes(*window, n_in, seed=seed)
    native.set_isa(isa)
    torch.set_num_threads(n_threads)
    with torch.no_grad():
        wanted = decide(x, net.simulate(x, ordered=True), rule)
    assert all(map(torch.equal, net.infer(x, rule), wanted))


@needs_kernels
@pytest.mark.parametrize("kind", ["count", "integrator", "max"])
@pytest.mark.parametrize("rule", [FULL_WINDOW, ExitRule(6), ExitRule(3, from_first_spike=True)])
def test_both_backends_stop_alike(kind, rule):
    nets = [
        network(6, 24, **ADAPTING, readout=kind, dtype=torch.float64, backend=backend)
        for backend in ("native", "reference")
    ]
    x = spikes(40, 50, 6)
    one, other = (net.infer(x, rule) for net in nets)
    assert all(map(torch.equal, one[:4], other[:4]))
    assert torch.allclose(one.readout.double(), other.readout.double())


@needs_kernels
@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    window=st.tuples(st.integers(1, 5), st.integers(1, 25)),
    recurrent=st.booleans(),
    per_neuron=st.booleans(),
    how=st.builds(Adaptation, strengths, st.sampled_from([0.0, 0.7, 0.99])),
    dtype=dtypes,
    isa=isas,
    seed=st.integers(0, 99),
)
@examples(110)
def test_a_layer_is_the_reference_s(variant, sizes, window, recurrent, per_neuron, how, dtype, isa, seed):
    n_in, n_out = sizes
    native.set_isa(isa)
    generator = torch.Generator().manual_seed(seed)

    def between(low: float, high: float, *shape: int):
        return (low + (high - low) * torch.rand(shape, generator=generator, dtype=dtype)).requires_grad_()

    x = spikes(*window, n_in, seed=seed).to(dtype).requires_grad_()
    w, v = between(-0.5, 1.0, n_in, n_out), between(-0.3, 0.2, n_out, n_out) if recurrent else None
    shape = (n_out,) if per_neuron else ()
    dynamics = {"alpha": between(0.5, 0.9, *shape), "beta": between(0.7, 0.95, *shape)}
    dynamics["threshold"] = between(0.7, 1.2, *shape)
    call = {"neuron": CubaLIF(*variant), "adaptation": how, **dynamics}
    ours = native.layer(x, w, v, scale=10.0, **call)
    wanted, _ = reference.cuba_lif_layer(x, w, v, spike=FastSigmoid(10.0), ordered=True, **call)
    assert torch.equal(ours, wanted)
    inputs = [t for t in (x, w, v, *dynamics.values()) if t is not None]
    pairs = zip(gradients((ours,), inputs), gradients((wanted,), inputs), strict=True)
    assert all(farthest(a, b) <= limit(b) for a, b in pairs)


@needs_kernels
@pytest.mark.parametrize("hidden", [20, 70])
def test_training_gives_the_same_weights_on_any_thread_count_and_instruction_set(hidden):
    def trained(n_threads: int, isa: str) -> list[torch.Tensor]:
        torch.set_num_threads(n_threads)
        native.set_isa(isa)
        net, x = network(6, hidden, 4, **ADAPTING), spikes(37, 40, 6)
        optimiser = torch.optim.Adam(net.parameters(), lr=1e-2)
        for _ in range(30):
            optimiser.zero_grad()
            torch.nn.functional.cross_entropy(net(x).readout, torch.arange(37) % 4).backward()
            optimiser.step()
        return [p.detach().clone() for p in net.parameters()]

    wanted = trained(1, native.isas()[-1])
    assert all(map(torch.equal, trained(2, native.isas()[-1]), wanted))
    assert all(map(torch.equal, trained(1, native.isas()[0]), wanted))


@needs_kernels
def test_a_tape_is_as_large_as_without_but_where_dynamics_are_learned():
    def of(keep_currents: bool, **spec) -> int:
        shape = native._shape_of(network(70, 20, 4, **spec), keep_currents=keep_currents, with_inputs=False)
        return native.native.tape_bytes(shape, trials=128, steps=300)

    assert of(False, **ADAPTING) == of(False)
    assert of(True, **ADAPTING) == of(True) + 128 * 300 * 4 * 32


# --- specs, files and costs ----------------------------------------------------------------------------


def test_specs_are_read_back_equal():
    assert RSNNSpec().digest() == RSNNSpec(threshold_adaptation=0.0).digest()
    assert build(RSNNSpec, RSNNSpec().model_dump(mode="json"), source="here") == RSNNSpec()
    asked = RSNNSpec(threshold_adaptation=0.3, tau_adaptation_ms=50.0)
    assert build(RSNNSpec, asked.model_dump(mode="json"), source="here") == asked
    assert len({asked.digest(), RSNNSpec(threshold_adaptation=0.3).digest(), RSNNSpec().digest()}) == 3
    by_recipe = RSNNSpec(recipe="default", threshold_adaptation=0.3, tau_adaptation_ms=50.0)
    chosen = resolve(by_recipe, Seen(900, 300, 2000.0, 20.0))
    assert (chosen.threshold_adaptation, chosen.tau_adaptation_ms, chosen.readout) == (0.3, 50.0, "integrator")


@pytest.mark.parametrize("recipe", [None, "default"])
@pytest.mark.parametrize("tau_ms", [50.0, 100.0])
def test_a_time_constant_of_nothing_is_refused(recipe, tau_ms):
    with pytest.raises(InputError, match="tau_adaptation_ms needs threshold_adaptation above 0"):
        build(RSNNSpec, {"tau_adaptation_ms": tau_ms, "recipe": recipe}, source="here")


@pytest.mark.parametrize(("key", "value"), [("threshold_adaptation", -0.1), ("tau_adaptation_ms", 0.0)])
def test_values_without_a_meaning_are_refused(key, value):
    with pytest.raises(InputError, match=f"^{key}:"):
        RSNNSpec(**{"threshold_adaptation": 0.1, key: value})


def test_a_network_says_how_it_adapts_and_a_checkpoint_gives_it_back(tmp_path):
    net, x = network(**ADAPTING), spikes()
    assert "threshold_adaptation 2 over 25 ms, " in repr(net)
    assert "adaptation" not in repr(network())
    assert net.adaptation is not None
    assert net.adaptation.decay == pytest.approx(torch.tensor(-2.5 / 25.0).exp().item())
    run_folder.save_network(net, tmp_path)
    again, metadata = run_folder.load_network(tmp_path)
    assert again.adaptation == net.adaptation
    assert all(map(torch.equal, again(x), net(x)))
    assert json.loads(json.dumps(metadata["spec"]))["threshold_adaptation"] == 2.0


def test_it_costs_two_macs_a_neuron_and_step_and_a_state_a_neuron():
    plain, adapting = (
        cost(SpikingLayer(2, 3, steps=3, sops=21, recurrent=True, adapts=adapts)) for adapts in (False, True)
    )
    assert adapting.macs - plain.macs == 2 * 3 * 3
    assert adapting.bytes - plain.bytes == 4 * 3
    assert (adapting.acs, adapting.sops, adapting.other_flops) == (plain.acs, plain.sops, plain.other_flops)
    assert adapting.parameters == plain.parameters
    measured = {"sops_input": 900, "sops_recurrent": 300, "sops_readout": 80}
    one, other = (
        ledger.network_cost(RSNNSpec(hidden=30, **how), 16, 8, measured, steps=300, signal_ms=150)
        for how in ({}, ADAPTING)
    )
    assert (other.macs - one.macs, other.bytes - one.bytes) == (2 * 30 * 300, 4 * 30)  # of the hidden layer alone
    assert other.sops == one.sops


# --- who refuses it -------------------------------------------------------------------------------------


def test_snntorch_has_no_such_neuron():
    with pytest.raises(InputError, match=r"adaptive thresholds: snnTorch.*train with threshold_adaptation = 0"):
        to_snntorch(RSNN(3, 2, hidden=4, membrane="immediate", sampling_rate_Hz=400.0, **ADAPTING))
