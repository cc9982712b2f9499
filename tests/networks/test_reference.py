from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned
from snntorch import surrogate
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.definition.reference import cuba_lif_layer
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.definition.surrogate import FastSigmoid, arctan, fast_sigmoid, spike_function
from neurotact.neurons import CubaLIF, Membrane, Reset

MEMBRANES, RESETS = get_args(Membrane), get_args(Reset)
VARIANTS = [(membrane, reset) for membrane in MEMBRANES for reset in RESETS]
SCALE = 3.0
DELAYS = (0, 1)
each_delay = pytest.mark.parametrize("delay", DELAYS)


def network(membrane: str, reset: str, seed: int = 0, dtype=torch.float64, hidden: int = 5, **spec) -> RSNN:
    table = {"hidden": hidden, "membrane": membrane, "reset": reset, "learn": ("alpha", "beta", "threshold"), **spec}
    generator = torch.Generator().manual_seed(seed)
    net = RSNN(3, 2, RSNNSpec(**table), 200.0, backend="reference", generator=generator, dtype=dtype)
    with torch.no_grad():
        for weights, scale in ((net.w_in, 1.5), (net.w_rec, 0.5), (net.w_out, 1.5)):
            weights.copy_(scale * torch.randn(weights.shape, generator=generator, dtype=dtype))
        net.alpha.copy_(torch.tensor([0.6, 0.7]))
        net.beta.copy_(torch.tensor([0.8, 0.9]))
        net.threshold.copy_(torch.tensor([1.0, 0.8]))
    return net


def spikes(n_trials: int = 3, n_steps: int = 12, seed: int = 1) -> Tensor:
    return (torch.rand(n_trials, n_steps, 3, generator=torch.Generator().manual_seed(seed)) < 0.5).double()


# --- gradients ---------------------------------------------------------------------------------------


def smooth(x: Tensor) -> Tensor:
    """Transmits a number, whose slope is the fast sigmoid's everywhere: 1 / (1 + scale |x|)^2."""
    return x / (1 + SCALE * x.abs())


def watched(over: list[Tensor]) -> Callable[[Tensor], Tensor]:
    def spike(x: Tensor) -> Tensor:
        over.append(x.detach() > 0)
        return smooth(x)

    return spike


def loss_of(net: RSNN, x: Tensor) -> tuple[Tensor, Tensor]:
    """A number that depends on every spike of both layers, and where membranes stood above threshold."""
    over: list[Tensor] = []
    net.spike = watched(over)
    rasters = net.simulate(x)
    generator = torch.Generator().manual_seed(7)
    total = x.new_zeros(())
    for raster in rasters:
        total = total + (raster * torch.randn(raster.shape, generator=generator, dtype=raster.dtype)).sum()
    return total, torch.cat([o.flatten() for o in over])


def finite_difference(net: RSNN, x: Tensor, parameter: Tensor, h: float = 1e-6) -> Tensor:
    """Central differences; fails where the reset flips, since the loss has a jump there."""
    slope = torch.empty_like(parameter)
    with torch.no_grad():
        _, resets = loss_of(net, x)
        for i in range(parameter.numel()):
            kept, moved = parameter.view(-1)[i].clone(), []
            for step in (h, -h):
                parameter.view(-1)[i] = kept + step
                loss, now = loss_of(net, x)
                assert torch.equal(now, resets), "a reset flipped: choose another seed"
                moved.append(loss)
            parameter.view(-1)[i] = kept
            slope.view(-1)[i] = (moved[0] - moved[1]) / (2 * h)
    return slope


@each_delay
@thinned(("membrane", "reset"), VARIANTS, every=2)
def test_gradients_equal_finite_differences(membrane, reset, delay):
    net, x = network(membrane, reset, recurrent_delay_steps=delay), spikes()
    loss, resets = loss_of(net, x)
    loss.backward()
    assert 0.05 < resets.double().mean() < 0.95  # resets do act
    for name, parameter in net.named_parameters():
        if name == "threshold" and reset == "subtract":
            continue  # takes the threshold off without a gradient: see the next test
        expected = finite_difference(net, x, parameter.data)
        assert parameter.grad.abs().max() > 1e-3, name
        torch.testing.assert_close(parameter.grad, expected, rtol=1e-6, atol=1e-7, msg=lambda m, n=name: f"{n}: {m}")


@pytest.mark.parametrize("membrane", MEMBRANES)
def test_the_subtracted_threshold_carries_no_gradient(membrane):
    # dU/d(threshold) = 0 whatever is reset, so that the slope is minus that of an input to each spike's argument.
    net, x = network(membrane, "subtract"), spikes()
    shift = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    calls = []

    def shifted(u: Tensor) -> Tensor:
        calls.append(u.shape[1])
        return smooth(u - shift[0 if u.shape[1] == 5 else 1])

    net.spike = shifted
    rasters = net.simulate(x)
    sum(raster.sum() for raster in rasters).backward()
    assert set(calls) == {5, 2}
    torch.testing.assert_close(net.threshold.grad, shift.grad, rtol=1e-12, atol=1e-12)


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=20), st.floats(0.1, 100))
@examples(60)
def test_the_surrogate_is_its_formula(values, scale):
    x = torch.tensor(values, dtype=torch.float64, requires_grad=True)
    sent = FastSigmoid(scale)(x)
    assert torch.equal(sent, (x > 0).double())
    upstream = torch.arange(1.0, len(values) + 1, dtype=torch.float64)
    (sent * upstream).sum().backward()
    expected = upstream / (1 + scale * x.detach().abs()) ** 2
    torch.testing.assert_close(x.grad, expected, rtol=1e-14, atol=0)


def test_the_surrogate_keeps_the_float_type():
    for dtype in (torch.float32, torch.float64):
        x = torch.ones(3, dtype=dtype, requires_grad=True)
        sent = FastSigmoid()(x)
        sent.sum().backward()
        assert sent.dtype == x.grad.dtype == dtype


# --- surrogates of snntorch --------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("membrane", "reset"), VARIANTS)
def test_snntorchs_fast_sigmoid_gives_the_same_network(membrane, reset, dtype):
    mine, theirs = (network(membrane, reset, dtype=dtype, surrogate_scale=25.0) for _ in range(2))
    theirs.spike = surrogate.fast_sigmoid(25)
    x = spikes(20, 30)
    a, b = mine.simulate(x), theirs.simulate(x)
    assert a.readout.dtype == b.readout.dtype == dtype
    assert a.readout.sum() > 20
    assert torch.equal(a.hidden, b.hidden)
    assert torch.equal(a.readout, b.readout)
    a.readout.mean().backward()
    b.readout.mean().backward()
    for p, q in zip(mine.parameters(), theirs.parameters(), strict=True):
        torch.testing.assert_close(p.grad, q.grad, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "spike",
    [
        surrogate.atan(2.0),
        surrogate.sigmoid(2),  # overflows to NaN where slope x |U - 1| is large
        surrogate.fast_sigmoid(25),
        surrogate.straight_through_estimator(),
    ],
)
def test_other_surrogates_of_snntorch_train_the_reference(spike):
    net, x = network("eq4", "zero"), spikes()
    plain = net(x)
    net.spike = spike
    counts = net(x)
    assert torch.equal(counts.readout, plain.readout)  # a surrogate changes gradients alone
    counts.readout.sum().backward()
    for name, parameter in net.named_parameters():
        assert torch.isfinite(parameter.grad).all(), name
    assert net.w_in.grad.abs().sum() > 0


# --- timing ------------------------------------------------------------------------------------------

# One neuron, w = 8, alpha = beta = 1/2, a single input at step 0: I[1..6] = 8, 4, 2, 1, 1/2, 1/4.
# U[1], U[2], ... by hand; * marks a spike (U > 1; U = 1 is none). Step t sends s[t] under eq4 and delayed, and
# s[t+1] under immediate.
SENT_AT = {
    ("eq4", "zero"): [2],  # 0  4*  0   1   1    3/4
    ("eq4", "subtract"): [2, 3, 4],  # 0  4*  3*  3/2*  1/4
    ("eq4", "hard"): [2, 3],  # 0  4*  2*  1   1    3/4
    ("delayed", "zero"): [2, 4],  # 0  8*  0   2*  0
    ("delayed", "subtract"): [2, 3, 4, 5],  # 0  8*  7*  9/2*  9/4*
    ("delayed", "hard"): [2, 3, 4],  # 0  8*  4*  2*  1
    ("immediate", "zero"): [0, 2],  # 8*  0   2*  0   1/2  1/2
    ("immediate", "subtract"): [0, 1, 2, 3],  # 8*  7*  9/2*  9/4*  5/8
    ("immediate", "hard"): [0, 1, 2],  # 8*  4*  2*  1   1    3/4
}


@pytest.mark.parametrize(("membrane", "reset"), VARIANTS)
def test_which_step_sends_what_worked_by_hand(membrane, reset):
    x = torch.zeros(1, 6, 1)
    x[0, 0] = 1
    sent, _ = cuba_lif_layer(
        x, torch.tensor([[8.0]]), None, alpha=0.5, beta=0.5, threshold=1.0,
        neuron=CubaLIF(membrane, reset), spike=FastSigmoid(),
    )  # fmt: skip
    assert sent[0, :, 0].nonzero().flatten().tolist() == SENT_AT[membrane, reset]


@each_delay
@pytest.mark.parametrize(("membrane", "steps"), [("eq4", (2, 4)), ("delayed", (2, 4)), ("immediate", (0, 1))])
def test_a_recurrent_spike_arrives_as_an_input_would(membrane, steps, delay):
    # Neuron 0 fires once and drives neuron 1 through v: s[t-d] stands in I[t+1], as x[t] does.
    x = torch.zeros(1, 6, 1)
    x[0, 0] = 1
    w, v = torch.tensor([[8.0, 0.0]]), torch.tensor([[0.0, 8.0], [0.0, 0.0]])
    sent, _ = cuba_lif_layer(
        x, w, v, alpha=0.0, beta=0.5, threshold=1.0, neuron=CubaLIF(membrane, "zero", delay), spike=FastSigmoid()
    )
    assert sent[0, :, 0].nonzero().flatten().tolist() == [steps[0]]
    assert sent[0, :, 1].nonzero().flatten().tolist() == [steps[1] + delay]


# One neuron that inhibits itself: w = 16, v = -4, alpha = beta = 1/2, reset zero, a single input at step 0. By hand,
# from t = 1; * marks a spike.
INHIBITED = {
    ("eq4", 0): [2],  # I 16 8 0 0      U 0  8* 0  0
    ("eq4", 1): [2, 4],  # I 16 8 4 -2 -1  U 0  8* 0  2* 0  -1/2
    ("delayed", 0): [2],  # I 16 8 0 0      U 0 16* 0  0
    ("delayed", 1): [2, 4],  # I 16 8 4 -2 -1  U 0 16* 0  4* 0  -1
    ("immediate", 0): [0, 2],  # I 16 4 2 -3 -3/2  U 16* 0  2* 0  -3/2
    ("immediate", 1): [0],  # I 16 8 0 0       U 16* 0  0  0
}


@pytest.mark.parametrize(("membrane", "delay"), INHIBITED)
@pytest.mark.parametrize("ordered", [False, True])
def test_when_a_spike_comes_back_worked_by_hand(membrane, delay, ordered):
    x = torch.zeros(1, 6, 1)
    x[0, 0] = 1
    sent, _ = cuba_lif_layer(
        x, torch.tensor([[16.0]]), torch.tensor([[-4.0]]), alpha=0.5, beta=0.5, threshold=1.0,
        neuron=CubaLIF(membrane, "zero", delay), spike=FastSigmoid(), ordered=ordered,
    )  # fmt: skip
    assert sent[0, :, 0].nonzero().flatten().tolist() == INHIBITED[membrane, delay]


@each_delay
@pytest.mark.parametrize(("membrane", "reset"), VARIANTS)
def test_the_layer_is_the_equations_written_with_indices(membrane, reset, delay):
    net, x = network(membrane, reset, recurrent_delay_steps=delay), spikes(4, 25)
    W, V, alpha, beta, theta = (
        p.detach().numpy() for p in (net.w_in, net.w_rec, net.alpha[0], net.beta[0], net.threshold[0])
    )
    T = x.shape[1]
    current, u, s = (np.zeros((T + 1, 4, 5)) for _ in range(3))
    for t in range(T):
        returning = s[t - delay] if t >= delay else s[0]
        current[t + 1] = alpha * current[t] + x[:, t].numpy() @ W + returning @ V
        before = u[t] * (1 - s[t]) if reset == "hard" else u[t]
        u[t + 1] = {
            "eq4": beta * (before + current[t]),
            "delayed": beta * before + current[t],
            "immediate": beta * before + current[t + 1],
        }[membrane]
        if reset == "zero":
            u[t + 1] *= 1 - s[t]
        if reset == "subtract":
            u[t + 1] -= theta * s[t]
        s[t + 1] = u[t + 1] > theta
    expected = s[1:] if membrane == "immediate" else s[:-1]
    assert np.abs(u - theta).min() > 1e-9
    assert 0.05 < expected.mean() < 0.95
    assert np.array_equal(net.simulate(x).hidden.detach().numpy().swapaxes(0, 1), expected)


# --- state and order ---------------------------------------------------------------------------------


@each_delay
@pytest.mark.parametrize(("membrane", "reset"), VARIANTS)
@pytest.mark.parametrize("cut", [0, 1, 11, 24, 25])
def test_two_pieces_equal_the_whole(membrane, reset, cut, delay):
    net, x = network(membrane, reset, recurrent_delay_steps=delay), spikes(4, 25)

    def run(x, state=None):
        return cuba_lif_layer(
            x, net.w_in, net.w_rec, alpha=net.alpha[0], beta=net.beta[0], threshold=net.threshold[0],
            neuron=net.neuron, spike=net.spike, state=state, ordered=True,
        )  # fmt: skip

    whole, end = run(x)
    first, middle = run(x[:, :cut])
    second, last = run(x[:, cut:], middle)
    assert torch.equal(torch.cat([first, second], dim=1), whole)
    assert all(torch.equal(a, b) for a, b in zip(end, last, strict=True))


@each_delay
@pytest.mark.parametrize(("membrane", "reset"), VARIANTS)
def test_ordered_equals_plain_up_to_rounding(membrane, reset, delay):
    net, x = network(membrane, reset, recurrent_delay_steps=delay), spikes(10, 40)
    plain, ordered = net.simulate(x), net.simulate(x, ordered=True)
    assert torch.equal(plain.hidden, ordered.hidden)
    assert torch.equal(plain.readout, ordered.readout)
    net.spike = smooth
    for a, b in zip(net.simulate(x), net.simulate(x, ordered=True), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_ordered_does_not_change_with_the_batch(dtype):
    net, x = network("eq4", "zero", dtype=dtype, hidden=33), spikes(50, 40)
    net.spike = smooth
    together = net.simulate(x, ordered=True)
    for i in (0, 17, 49):
        alone = net.simulate(x[i : i + 1], ordered=True)
        assert torch.equal(alone.hidden[0], together.hidden[i])
        assert torch.equal(alone.readout[0], together.readout[i])


def test_counts_are_the_sums_of_rasters():
    net, x = network("eq4", "zero"), spikes(10, 40)
    counts, rasters = net(x.to(torch.uint8)), net.simulate(x)
    assert torch.equal(counts.readout, rasters.readout.sum(dim=1))
    assert torch.equal(counts.hidden, rasters.hidden.sum(dim=1))
    assert net(x.bool()).readout.equal(counts.readout)


def test_no_steps_and_no_trials_give_empty_rasters():
    net = network("eq4", "zero")
    assert net.simulate(torch.zeros(4, 0, 3)).readout.shape == (4, 0, 2)
    assert net.simulate(torch.zeros(0, 5, 3)).hidden.shape == (0, 5, 5)
    assert net(torch.zeros(4, 0, 3)).readout.tolist() == [[0, 0]] * 4


def test_spikes_of_other_afferents_are_refused():
    net = network("eq4", "zero")
    for shape in ((4, 10, 2), (10, 3)):
        with pytest.raises(InputError, match=r"\(trial, time, 3\) is expected"):
            net.simulate(torch.zeros(*shape))
    with pytest.raises(InputError, match="did you mean 'immediate'"):
        CubaLIF(membrane="imediate")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="did you mean 'subtract'"):
        CubaLIF(reset="substract")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="recurrent_delay_steps: must be 0 or 1; got 2"):
        CubaLIF(recurrent_delay_steps=2)


def test_a_feed_forward_network_is_a_recurrent_one_whose_recurrent_weights_are_zero():
    rnn = network("eq4", "zero")
    snn = RSNN(3, 2, RSNNSpec(model="snn", hidden=5), 200.0, backend="reference", dtype=torch.float64)
    with torch.no_grad():
        rnn.w_rec.zero_()
    snn.load_state_dict({name: value for name, value in rnn.state_dict().items() if name != "w_rec"})
    x = spikes(6, 80)
    for mine, its in zip(snn.simulate(x), rnn.simulate(x), strict=True):
        assert mine.sum() > 0
        assert torch.equal(mine, its)
    for mine, its in zip(snn.infer(x), rnn.infer(x), strict=True):
        assert torch.equal(mine, its)
    assert "w_rec" not in snn.state_dict()


def test_the_readout_has_the_surrogate_of_the_spec_at_its_own_scale():
    for name in ("fast-sigmoid", "arctan"):
        net = network("eq4", "zero", surrogate=name, surrogate_scale=3.0, readout_surrogate_scale=5.0)
        assert [net.spike_of(layer) for layer in (0, 1)] == [spike_function(name, scale) for scale in (3.0, 5.0)]


@given(st.lists(st.floats(-3, 3), min_size=1), st.floats(0.5, 50))
def test_a_spike_has_the_slope_of_its_surrogate(potentials, scale):
    for name, slope in (("fast-sigmoid", fast_sigmoid), ("arctan", arctan)):
        x = torch.tensor(potentials, requires_grad=True)
        spikes = spike_function(name, scale)(x)
        spikes.sum().backward()
        assert torch.equal(spikes, (x > 0).float())
        torch.testing.assert_close(x.grad, slope(x.detach(), scale))
