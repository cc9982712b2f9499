"""The layers against their equations written out, against torch's own LSTM, and their gradients against autograd."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.touch_modality.recurrent_layers import GRULayers, LSTMLayers, Shape

KINDS = (LSTMLayers, GRULayers)
shapes = st.builds(Shape, st.integers(1, 3), st.integers(1, 5), st.integers(1, 6), st.integers(1, 4), st.integers(1, 5))


def drawn(kind, shape, seed):
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(shape.steps, shape.networks, shape.channels, shape.trials, generator=generator, dtype=torch.float64)
    rows = kind.n_gates * shape.hidden
    return x, torch.randn(shape.networks, rows, shape.stacked, generator=generator, dtype=torch.float64)


def last_state(kind, x, weights, hidden):
    """The equations as the papers write them, for autograd."""
    h = c = x.new_zeros(x.shape[1], hidden, x.shape[3])
    one = x.new_ones(x.shape[1], 1, x.shape[3])
    for now in x:
        stacked = weights @ torch.cat([now, h, one], 1)
        if kind is LSTMLayers:
            i, f, g, o = stacked.chunk(4, 1)
            c = f.sigmoid() * c + i.sigmoid() * g.tanh()
            h = o.sigmoid() * c.tanh()
        else:
            z, r = stacked[:, : 2 * hidden].sigmoid().chunk(2, 1)
            n = (weights[:, 2 * hidden :] @ torch.cat([now, r * h, one], 1)).tanh()
            h = z * h + (1 - z) * n
    return h


@pytest.mark.parametrize("kind", KINDS)
@given(shapes, st.integers(0, 1000))
def test_forward_and_backward_follow_the_equations(kind, shape, seed):
    x, weights = drawn(kind, shape, seed)
    layers = kind(shape, torch.float64)
    layers.x.copy_(x)
    state = layers.forward(weights)
    expected = last_state(kind, x, weights.requires_grad_(), shape.hidden)
    torch.testing.assert_close(state[:, :-1], expected, rtol=0, atol=1e-12)
    assert (state[:, -1] == 1).all()
    d_state = torch.randn_like(expected)
    (expected * d_state).sum().backward()
    scale = 1 + float(weights.grad.abs().max())
    torch.testing.assert_close(layers.backward(d_state), weights.grad, rtol=0, atol=1e-12 * scale)


def test_lstm_is_torchs_with_its_second_bias_at_zero():
    shape = Shape(1, 4, 9, 3, 5)
    x, weights = drawn(LSTMLayers, shape, 0)
    theirs = torch.nn.LSTM(3, 5, dtype=torch.float64)
    with torch.no_grad():
        theirs.weight_ih_l0.copy_(weights[0, :, :3])
        theirs.weight_hh_l0.copy_(weights[0, :, 3:8])
        theirs.bias_ih_l0.copy_(weights[0, :, 8])
        theirs.bias_hh_l0.zero_()
        expected = theirs(x[:, 0].transpose(1, 2))[1][0][0].T
    layers = LSTMLayers(shape, torch.float64)
    layers.x.copy_(x)
    torch.testing.assert_close(layers.forward(weights)[0, :-1], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_layers_forget_what_they_ran_before(kind):
    shape = Shape(2, 3, 4, 2, 3)
    x, weights = drawn(kind, shape, 0)
    d_state = torch.ones(2, 3, 3, dtype=torch.float64)
    fresh, used = kind(shape, torch.float64), kind(shape, torch.float64)
    used.x.copy_(-3 * x)
    used.forward(2 * weights)
    used.backward(-d_state)
    for layers in (fresh, used):
        layers.x.copy_(x)
    assert torch.equal(fresh.forward(weights), used.forward(weights))
    assert torch.equal(fresh.backward(d_state), used.backward(d_state))


@pytest.mark.parametrize("kind", KINDS)
def test_float32_holds_six_digits(kind):
    shape = Shape(3, 48, 60, 16, 10)
    x, weights = drawn(kind, shape, 1)
    results = []
    for dtype in (torch.float32, torch.float64):
        layers = kind(shape, dtype)
        layers.x.copy_(x)
        state = layers.forward(0.2 * weights.to(dtype))
        results.append((state.double(), layers.backward(torch.ones(3, 10, 48, dtype=dtype)).double()))
    for single, double in zip(*results, strict=True):
        assert float((single - double).abs().max()) < 1e-5 * float(double.abs().max())


def test_extreme_drives_saturate_and_stay_finite():
    for kind in KINDS:
        shape = Shape(1, 2, 5, 1, 2)
        layers = kind(shape)
        layers.x.fill_(1e4)
        state = layers.forward(torch.ones(1, kind.n_gates * 2, 4))
        assert np.isfinite(state.numpy()).all()
        assert np.isfinite(layers.backward(torch.ones(1, 2, 2)).numpy()).all()
