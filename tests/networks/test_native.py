"""The compiled kernels against the definition: spikes to the last bit, gradients to rounding, any thread count."""

from collections.abc import Iterable
from typing import get_args

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.definition import native, reference
from neurotact.networks.definition.rsnn import RSNN, Inference, Rasters
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule, Leader
from neurotact.neurons import CubaLIF, Membrane, Reset

pytestmark = [
    pytest.mark.skipif(native.native is None, reason="the kernels are not compiled here"),
    pytest.mark.usefixtures("kernels_as_before"),
]

VARIANTS = [(membrane, reset) for membrane in get_args(Membrane) for reset in get_args(Reset)]
TOLERANCE = {torch.float32: 1e-4, torch.float64: 1e-9}
LEARNED = ("alpha", "beta", "threshold")
each_variant = thinned(("membrane", "reset"), VARIANTS, every=4)
"""The quick ones have each membrane and each reset."""
variants = st.sampled_from(VARIANTS)
dtypes = st.sampled_from([torch.float32, torch.float64])
delays = st.sampled_from([0, 1])
isas = st.sampled_from(native.isas() if native.native else ["plain"])


def network(n_in=5, hidden=20, classes=3, seed=0, dtype=torch.float32, backend="native", **spec) -> RSNN:
    """A network that spikes in earnest: about every fifth step, in both layers."""
    table = {"hidden": hidden, "forward_weight_scale": 6.0, "recurrent_weight_scale": 0.3, **spec}
    generator = torch.Generator().manual_seed(seed)
    net = RSNN(n_in, classes, RSNNSpec(**table), 400.0, backend=backend, generator=generator, dtype=dtype)
    with torch.no_grad():
        net.threshold.copy_(torch.tensor([1.0, 0.7]))
        net.alpha.copy_(torch.tensor([0.75, 0.8]))
    return net


def spikes(n_trials=4, n_steps=30, n_in=5, density=0.3, seed=1) -> Tensor:
    return (torch.rand(n_trials, n_steps, n_in, generator=torch.Generator().manual_seed(seed)) < density).to(
        torch.uint8
    )


def farthest(given: Tensor, wanted: Tensor) -> float:
    """The largest difference, relative to the largest value."""
    if wanted.numel() == 0:
        return 0.0
    # What sums to nothing is rounded as its terms are, which are of the order of 1.
    least = 1e-2 if wanted.ndim < 2 and wanted.dtype == torch.float32 else 1e-30
    return ((given - wanted).abs().max() / wanted.abs().max().clamp(min=least)).item()


def gradients(outputs: tuple[Tensor, ...], inputs: list[Tensor], seed: int = 3) -> tuple[Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    total = torch.zeros(()) + sum(
        (out * torch.randn(out.shape, generator=generator, dtype=out.dtype)).sum() for out in outputs
    )
    if not total.requires_grad:  # the reference, over a window too short for a gradient
        return tuple(map(torch.zeros_like, inputs))
    return torch.autograd.grad(total, inputs, allow_unused=True, materialize_grads=True)


def limit(gradient: Tensor) -> float:
    """How far a gradient may be off.

    That of a learned alpha, beta or threshold is a sum over all spikes of terms of both signs: where they cancel,
    float32 rounds it by more of what is left than it rounds a weight's.
    """
    cancels = gradient.ndim < 2 and gradient.dtype == torch.float32
    return 2e-3 if cancels else TOLERANCE[gradient.dtype]


def compare(net: RSNN, x: Tensor, with_inputs: bool = False, isas: Iterable[str] = ()) -> Rasters:
    """Counts equal to the last bit and gradients within tolerance, also with each of the instruction sets.

    Returns the reference's rasters.
    """
    ours, theirs = ([x.to(net.w_in.dtype).requires_grad_()] if with_inputs else [] for _ in range(2))
    parameters = [p for p in net.parameters() if p.requires_grad]
    rasters = net.simulate(*theirs or [x], ordered=True)
    wanted = rasters.readout.sum(dim=1), rasters.hidden.sum(dim=1)
    has_gradients = bool(x.shape[0] and x.shape[1])
    slopes = gradients(wanted, parameters + theirs) if has_gradients else ()
    for isa in isas or [None]:
        if isa is not None:
            native.set_isa(isa)
        counts = net(*ours or [x])
        assert all(map(torch.equal, counts, wanted)), isa
        if has_gradients:
            pairs = zip(gradients(counts, parameters + ours), slopes, strict=True)
            assert all(farthest(a, b) <= limit(b) for a, b in pairs), isa
    return Rasters(*(raster.detach() for raster in rasters))


def decide(x: Tensor, rasters: Rasters, rule: ExitRule) -> Inference:
    """What `_infer_by_steps` says, from the rasters of the whole window."""
    n_trials, n_steps, _ = x.shape
    leader = Leader.start(n_trials, rasters.readout.shape[2], x.device)
    labels, steps = torch.zeros(2, n_trials, dtype=torch.int64)
    running = torch.ones(n_trials, dtype=torch.bool)
    for t in range(n_steps):
        leader = leader.after(rasters.readout[:, t].to(torch.int64))
        done = running & (leader.exits(rule) | torch.tensor(t + 1 == n_steps))
        labels[done], steps[done] = leader.index[done], t + 1
        running &= ~done
    seen = (torch.arange(n_steps) < steps[:, None])[..., None]
    sums = [(part * seen).sum(dim=(1, 2)).to(torch.int64) for part in (x, rasters.hidden)]
    return Inference(labels, steps, *sums, (rasters.readout * seen).sum(dim=1).to(torch.int64))


# --- parity of the fused network ---------------------------------------------------------------------


@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 80), st.integers(1, 80), st.one_of(st.integers(1, 20), st.integers(17, 70))),
    model=st.sampled_from(["rsnn", "rsnn", "snn"]),
    readout_scale=st.sampled_from([None, 3.0]),
    window=st.tuples(st.integers(0, 5), st.integers(0, 25)),
    density=st.sampled_from([0.0, 0.05, 0.3, 1.0]),
    dtype=dtypes,
    isa=isas,
    n_threads=st.integers(1, 4),
    learns=st.booleans(),
    with_inputs=st.booleans(),
    delay=delays,
    seed=st.integers(0, 99),
)
@examples(160)
def test_counts_and_gradients_are_the_reference_s(
    variant,
    sizes,
    model,
    readout_scale,
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
    table["readout_surrogate_scale"] = readout_scale
    net = network(n_in, hidden, classes, seed, dtype, **table, learn=LEARNED if learns else ())
    native.set_isa(isa)
    torch.set_num_threads(n_threads)
    compare(net, spikes(*window, n_in, density, seed), with_inputs)


@thinned("model", ["rsnn", "snn"])
@thinned(("hidden", "classes"), [(n, c) for n in (16, 30, 48, 64) for c in (8, 9, 17, 33, 65)], every=4)
@thinned("learn", [LEARNED, ()])
def test_every_form_of_the_register_kernel_and_its_neighbours_agree(model, hidden, classes, learn):
    """Each pair of padded widths is compiled apart; the quick ones have each width once."""
    compare(network(20, hidden, classes, model=model, learn=learn), spikes(5, 20, 20, 0.1), isas=native.isas())


@each_variant
@thinned("learn", [LEARNED, ()])
@thinned("hidden", [20, 64, 70], every=2)
def test_what_an_integrator_hears_agrees(membrane, reset, learn, hidden):
    """Hidden counts without a spiking readout, one value of each constant for the layer."""
    net, x = network(6, hidden, membrane=membrane, reset=reset, learn=learn, readout="integrator"), spikes(5, 20, 6)
    wanted = net.simulate(x, ordered=True).hidden.sum(dim=1)
    counts = net(x).hidden
    assert torch.equal(counts, wanted)
    parameters = [net.w_in, net.w_rec, *(getattr(net, name) for name in learn)]
    pairs = zip(gradients((counts,), parameters), gradients((wanted,), parameters), strict=True)
    assert all(farthest(a, b) <= limit(b) for a, b in pairs)


@thinned("hidden", [65, 64, 128, 200])
@thinned("dtype", [torch.float32, torch.float64])
@thinned("delay", [0, 1])
def test_wide_layers_agree(hidden, dtype, delay):
    compare(network(70, hidden, 27, dtype=dtype, recurrent_delay_steps=delay), spikes(19, 40, 70, 0.1))


@each_variant
@thinned("delay", [1, 0])
@pytest.mark.parametrize("n_steps", [1, 2, 3])
@pytest.mark.parametrize("hidden", [20, 70])
def test_windows_no_longer_than_the_delays_agree(membrane, reset, delay, n_steps, hidden):
    net = network(5, hidden, membrane=membrane, reset=reset, recurrent_delay_steps=delay, dtype=torch.float64)
    compare(net, spikes(5, n_steps, density=0.8))


@pytest.mark.parametrize("hidden", [66, 72])
def test_a_step_in_which_every_neuron_spikes_agrees(hidden):
    """Its list of events is as long as a list can be, and nothing behind it may be written over."""
    net = network(16, hidden)
    with torch.no_grad():
        net.w_in.fill_(1.0)
    compare(net, torch.ones(5, 20, 16), isas=native.isas())


@pytest.mark.slow
@pytest.mark.parametrize("membrane", get_args(Membrane))
def test_the_widest_layer_agrees(membrane):
    compare(network(130, 1024, 1000, membrane=membrane), spikes(17, 20, 130, 0.1))


@each_variant
@thinned("delay", [0, 1])
def test_a_negative_threshold_is_no_special_case(membrane, reset, delay):
    variant = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay}
    net = network(**variant, learn=LEARNED, dtype=torch.float64)
    with torch.no_grad():
        net.threshold.copy_(torch.tensor([-0.1, -0.2]))
    compare(net, spikes(5, 12))


@given(
    kind=st.sampled_from(["strided", "time first", "bool", "int64", "float32", "float64", "sliced"]),
    seed=st.integers(0, 9),
)
@examples(15)
def test_any_layout_and_type_of_spikes(kind, seed):
    x = spikes(6, 20, 10, seed=seed)
    taken = {
        "strided": lambda: x.repeat_interleave(2, dim=2)[..., ::2],
        "time first": lambda: x.transpose(0, 1).contiguous().transpose(0, 1),
        "sliced": lambda: torch.cat([x, x], dim=1)[:, 20:],
        "bool": x.bool, "int64": x.long, "float32": x.float, "float64": x.double,
    }[kind]()  # fmt: skip
    net = network(10)
    assert all(map(torch.equal, net(taken), net(x)))
    assert all(map(torch.equal, net.infer(taken), net.infer(x)))


@pytest.mark.parametrize("value", [2, 0.5, -1.0, float("nan")])
def test_spikes_other_than_0_and_1_are_refused(value):
    net, x = network(), spikes().to(torch.uint8 if value == 2 else torch.float32)
    x[2, 3, 4] = value
    with pytest.raises(InputError, match="other than 0 and 1"):
        net(x)
    with pytest.raises(InputError, match="other than 0 and 1"):
        net.infer(x)


# --- what training needs -----------------------------------------------------------------------------


def trained(n_threads: int, hidden: int, delay: int, isa: str, steps: int = 100) -> list[Tensor]:
    torch.set_num_threads(n_threads)
    native.set_isa(isa)
    net, x = network(6, hidden, 4, recurrent_delay_steps=delay), spikes(37, 40, 6)
    labels = torch.arange(37) % 4
    optimiser = torch.optim.Adam(net.parameters(), lr=1e-2)
    for _ in range(steps):
        optimiser.zero_grad()
        counts = net(x)
        loss = torch.nn.functional.cross_entropy(counts.readout, labels) + 1e-3 * counts.hidden.mean()
        loss.backward()
        optimiser.step()
    return [p.detach().clone() for p in net.parameters()]


@pytest.mark.parametrize("hidden", [20, 70])
@thinned("delay", [0, 1])
def test_a_hundred_adam_steps_give_the_same_weights_on_any_thread_count_and_instruction_set(hidden, delay):
    wanted = trained(1, hidden, delay, native.isas()[-1])
    assert all(map(torch.equal, trained(2, hidden, delay, native.isas()[-1]), wanted))
    assert all(map(torch.equal, trained(1, hidden, delay, native.isas()[0]), wanted))


def test_an_unused_output_has_no_gradient():
    net, x = network(), spikes()
    (alone,) = torch.autograd.grad(net(x).readout.sum(), [net.w_in])
    counts = net(x)
    (both,) = torch.autograd.grad(counts.readout.sum() + 0 * counts.hidden.sum(), [net.w_in])
    assert torch.equal(alone, both)


def test_a_retained_graph_gives_its_gradient_again():
    net, x = network(), spikes()
    total = net(x).readout.sum()
    first = torch.autograd.grad(total, [net.w_in], retain_graph=True)
    net(spikes(seed=7)).readout.sum().backward()
    assert torch.equal(*first, *torch.autograd.grad(total, [net.w_in]))


def test_the_tape_is_what_the_docs_say():
    net = network(70, 20, 4)
    shape = native._shape_of(net, keep_currents=False, with_inputs=False)
    # A membrane for each of 32 + 8 padded neurons, two words of input and one of hidden spikes, a trial and step.
    assert native.native.tape_bytes(shape, trials=128, steps=300) == 128 * 300 * (4 * (32 + 8) + 8 * (2 + 1))


# --- what is handed over -----------------------------------------------------------------------------


def handed_over(monkeypatch, name: str) -> tuple[tuple, dict]:
    """What the extension's `name` is called with in a training step or an inference."""
    called = {}
    original = getattr(native.native, name)

    def kept(*args, **named):
        called[name] = args, named
        return original(*args, **named)

    monkeypatch.setattr(native.native, name, kept)
    net, x = network(learn=LEARNED), spikes()
    net(x).readout.sum().backward()
    net.infer(x)
    monkeypatch.undo()
    return called[name]


@pytest.mark.parametrize("name", ["forward", "backward", "infer"])
def test_addresses_are_handed_over_by_name_and_no_other_way(monkeypatch, name):
    (shape,), named = handed_over(monkeypatch, name)
    function = getattr(native.native, name)
    with pytest.raises(TypeError):
        function(shape, *named.values())
    for key in named:
        others = {k: v for k, v in named.items() if k != key}
        with pytest.raises(TypeError):
            function(shape, **others)
        with pytest.raises(TypeError):
            function(shape, **others, **{key + "_": named[key]})
        with pytest.raises(TypeError):
            function(shape, **named, **{key + "_": named[key]})


@pytest.mark.parametrize("name", ["make_shape", "encode"])
def test_nothing_is_handed_over_by_position(name):
    with pytest.raises(TypeError):
        getattr(native.native, name)(*[1] * 23)


@pytest.mark.parametrize("name", ["w_in", "w_rec", "w_out", "alpha", "beta", "threshold"])
@pytest.mark.parametrize("use", ["count", "train", "infer"])
def test_a_parameter_of_another_shape_is_refused(name, use):
    net, x = network(), spikes()
    given = getattr(net, name)
    shape = [given.shape[0] + 1, *given.shape[1:]]
    setattr(net, name, torch.nn.Parameter(torch.zeros(shape)))
    with pytest.raises(InputError, match=r"shape|neurons"), torch.set_grad_enabled(use == "train"):
        net.infer(x) if use == "infer" else net(x)


@pytest.mark.parametrize("membrane", get_args(Membrane))
def test_gradients_follow_finite_differences_between_spikes(membrane):
    """Where no spike changes, dL/dU comes from the readout's surrogate alone: a small step moves U as dU/dw says."""
    torch.manual_seed(0)
    x = spikes(3, 15, 4).double()
    w = (0.2 * torch.randn(4, 6, dtype=torch.float64)).requires_grad_()  # too weak to spike
    kept = {"alpha": 0.8, "beta": 0.9, "neuron": CubaLIF(membrane)}

    def membranes(weights: Tensor) -> Tensor:
        """The sum of a smooth function of U whose slope is the surrogate's: x / (1 + scale |x|)."""
        smooth = lambda u: u / (1 + 10.0 * u.abs())  # noqa: E731
        return reference.cuba_lif_layer(x, weights, None, threshold=1.0, spike=smooth, **kept)[0].sum()

    (grad,) = torch.autograd.grad(native.layer(x, w, None, threshold=1.0, scale=10.0, **kept).sum(), [w])
    for i, j in ((0, 0), (3, 5), (2, 1)):
        step = torch.zeros_like(w)
        step[i, j] = 1e-6
        difference = (membranes(w.detach() + step) - membranes(w.detach() - step)) / 2e-6
        assert difference.item() == pytest.approx(grad[i, j].item(), rel=1e-5)


# --- inference ---------------------------------------------------------------------------------------


@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 70), st.integers(1, 70), st.integers(1, 70)),
    window=st.tuples(st.integers(0, 5), st.integers(1, 30)),
    rule=st.sampled_from([FULL_WINDOW, ExitRule(1), ExitRule(4), ExitRule(4, from_first_spike=True), ExitRule(99)]),
    dtype=dtypes,
    isa=isas,
    n_threads=st.integers(1, 4),
    delay=delays,
    seed=st.integers(0, 99),
)
@examples(135)
def test_inference_is_the_reference_s(variant, sizes, window, rule, dtype, isa, n_threads, delay, seed):
    n_in, hidden, classes = sizes
    membrane, reset = variant
    net = network(n_in, hidden, classes, seed, dtype, membrane=membrane, reset=reset, recurrent_delay_steps=delay)
    x = spikes(*window, n_in, seed=seed)
    native.set_isa(isa)
    torch.set_num_threads(n_threads)
    with torch.no_grad():
        wanted = decide(x, net.simulate(x, ordered=True), rule)
    assert all(map(torch.equal, net.infer(x, rule), wanted))


@pytest.mark.parametrize("readout", ["count", "integrator", "max"])
@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 70), st.integers(1, 64), st.integers(1, 40)),
    window=st.tuples(st.integers(0, 5), st.integers(0, 30)),
    more=st.sampled_from(
        [{}, {"model": "snn"}, {"threshold_adaptation": 0.3}, {"readout_stretches": 3, "readout_stretch_ms": 25.0}]
    ),
    dtype=dtypes,
    isa=isas,
    delay=delays,
    seed=st.integers(0, 99),
)
@examples(60)
def test_whole_windows_are_decided_as_by_the_kernel_that_stops(
    readout, variant, sizes, window, more, dtype, isa, delay, seed
):
    n_in, hidden, classes = sizes
    membrane, reset = variant
    spec = {"membrane": membrane, "reset": reset, "recurrent_delay_steps": delay, "readout": readout, **more}
    if readout != "integrator":
        spec = {key: value for key, value in spec.items() if "stretch" not in key}
    net = network(n_in, hidden, classes, seed, dtype, **spec)
    x = spikes(*window, n_in, seed=seed)
    native.set_isa(isa)
    with torch.no_grad():
        assert all(map(torch.equal, net.infer(x), net.infer(x, ExitRule(99))))


def test_inference_of_an_empty_window():
    inference = network().infer(spikes(3, 0))
    assert inference.steps.tolist() == inference.labels.tolist() == [0, 0, 0]
    assert inference.readout.tolist() == [[0, 0, 0]] * 3


# --- a layer -----------------------------------------------------------------------------------------


@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    window=st.tuples(st.integers(1, 5), st.integers(1, 25)),
    recurrent=st.booleans(),
    per_neuron=st.booleans(),
    dtype=dtypes,
    isa=isas,
    n_threads=st.integers(1, 4),
    delay=delays,
    seed=st.integers(0, 99),
)
@examples(135)
def test_a_layer_is_the_reference_s(variant, sizes, window, recurrent, per_neuron, dtype, isa, n_threads, delay, seed):
    n_in, n_out = sizes
    native.set_isa(isa)
    torch.set_num_threads(n_threads)
    generator = torch.Generator().manual_seed(seed)

    def between(low: float, high: float, *shape: int) -> Tensor:
        return (low + (high - low) * torch.rand(shape, generator=generator, dtype=dtype)).requires_grad_()

    x = spikes(*window, n_in, seed=seed).to(dtype).requires_grad_()
    w, v = between(-0.5, 1.0, n_in, n_out), between(-0.3, 0.2, n_out, n_out) if recurrent else None
    shape = (n_out,) if per_neuron else ()
    dynamics = {"alpha": between(0.5, 0.9, *shape), "beta": between(0.7, 0.95, *shape)}
    dynamics["threshold"] = between(0.7, 1.2, *shape)
    neuron = CubaLIF(*variant, delay)
    ours = native.layer(x, w, v, neuron=neuron, scale=10.0, **dynamics)
    wanted, _ = reference.cuba_lif_layer(x, w, v, neuron=neuron, spike=FastSigmoid(10.0), ordered=True, **dynamics)
    assert torch.equal(ours, wanted)
    inputs = [t for t in (x, w, v, *dynamics.values()) if t is not None]
    pairs = zip(gradients((ours,), inputs), gradients((wanted,), inputs), strict=True)
    assert all(farthest(a, b) <= limit(b) for a, b in pairs)


@pytest.mark.parametrize("delay", [0, 1])
def test_two_layers_are_the_fused_network(delay):
    net, x = network(dtype=torch.float64, recurrent_delay_steps=delay), spikes()
    layer = {"neuron": net.neuron, "scale": 10.0}
    hidden, out = (
        dict(zip(LEARNED, (net.alpha[k].detach(), net.beta[k].detach(), net.threshold[k].detach()), strict=True))
        for k in (0, 1)
    )
    sent = native.layer(x, net.w_in, net.w_rec, **hidden, **layer)
    decided = native.layer(sent, net.w_out, None, **out, **layer)
    composed, fused = (decided.sum(dim=1), sent.sum(dim=1)), net(x)
    assert all(map(torch.equal, composed, fused))
    weights = [net.w_in, net.w_rec, net.w_out]
    pairs = zip(gradients(composed, weights), gradients(tuple(fused), weights), strict=True)
    assert max(farthest(a, b) for a, b in pairs) < 1e-9


def test_a_set_that_the_processor_lacks_is_refused():
    with pytest.raises(ValueError, match="unknown"):
        native.set_isa("sse9")


# --- without recurrence --------------------------------------------------------------------------------


@given(
    variant=variants,
    sizes=st.tuples(st.integers(1, 40), st.integers(1, 80), st.integers(1, 20)),
    window=st.tuples(st.integers(1, 5), st.integers(1, 25)),
    dtype=dtypes,
    isa=isas,
    learn=st.booleans(),
)
@examples(135)
def test_a_feed_forward_network_is_the_reference_s(variant, sizes, window, dtype, isa, learn):
    native.set_isa(isa)
    membrane, reset = variant
    n_in, hidden, classes = sizes
    chosen = LEARNED if learn else ()
    net = network(n_in, hidden, classes, dtype=dtype, model="snn", membrane=membrane, reset=reset, learn=chosen)
    assert net.w_rec is None
    compare(net, spikes(*window, n_in), with_inputs=learn)


@each_variant
@pytest.mark.parametrize("hidden", [20, 70])
def test_a_delay_changes_the_spikes(membrane, reset, hidden):
    """Or else the tests of this file would compare two networks without one."""
    nets = [network(5, hidden, membrane=membrane, reset=reset, recurrent_delay_steps=delay) for delay in (0, 1)]
    x = spikes(8, 40)
    assert not torch.equal(*(net(x).hidden for net in nets))
    assert not torch.equal(*(net.infer(x).hidden_spikes for net in nets))


@pytest.mark.parametrize("rule", [FULL_WINDOW, ExitRule(4), ExitRule(4, from_first_spike=True)])
def test_a_feed_forward_network_infers_as_its_rasters_say(rule):
    net, x = network(model="snn"), spikes(20, 60)
    wanted = decide(x, net.simulate(x, ordered=True), rule)
    for mine, its in zip(net.infer(x, rule), wanted, strict=True):
        assert torch.equal(mine, its)
    assert wanted.hidden_spikes.sum() > 0
