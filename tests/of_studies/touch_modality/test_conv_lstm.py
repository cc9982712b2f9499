import numpy as np
import pytest
import torch
from costs import operations
from neurotact_parts.studies.touch_modality import conv_lstm
from neurotact_parts.studies.touch_modality.cnn_features import Conv2d
from neurotact_parts.studies.touch_modality.conv_lstm import ConvLSTM, ConvLSTMClassifier
from neurotact_parts.studies.touch_modality.recurrent import LSTM
from neurotact_parts.studies.touch_modality.recurrent_layers import LSTMLayers, Shape
from sklearn.base import clone

from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, cost


def bars(n_trials=24, n_steps=5, side=7, seed=0):
    """A bar that moves down or up: the same images in another order."""
    rng = np.random.default_rng(seed)
    X = 0.1 * rng.normal(size=(n_trials, n_steps, side, side))
    for trial in range(n_trials):
        rows = np.arange(n_steps) + 1
        X[trial, np.arange(n_steps), rows if trial % 2 else rows[::-1]] += 1
    return X, np.where(np.arange(n_trials) % 2, "down", "up")


def test_count_of_parameters_of_the_touch_modality_paper():
    X, y = np.zeros((3, 1, 64, 64)), ["brushing", "rolling", "sliding"]
    fitted = ConvLSTMClassifier(epochs=1, batch=3, random_state=0).fit(X, y)
    gates = 4 * (3 * 3 * 1 * 32 + 3 * 3 * 32 * 32 + 32)
    dense = 62 * 62 * 32 * 100 + 100
    assert fitted.n_parameters_ == gates + dense + 100 * 3 + 3 == 12_339_347


def test_on_images_of_one_pixel_it_is_an_lstm():
    X = np.random.default_rng(0).normal(size=(6, 5, 1, 1))
    fitted = ConvLSTMClassifier(filters=4, kernel=1, units=3, epochs=1, random_state=0).fit(X, [0, 1] * 3)
    net = fitted.network_
    layers = LSTMLayers(Shape(1, 6, 5, 1, 4))
    layers.x.copy_(torch.tensor(X[:, :, 0, 0]).T[:, None, None])
    weights = torch.cat([net.into.weight.flatten(1), net.recurrent.weight.flatten(1), net.into.bias[:, None]], dim=1)
    with torch.no_grad():
        state = layers.forward(weights[None])[0, :-1].T
        expected = net.output(net.dense(state).relu()).softmax(dim=1)
    np.testing.assert_allclose(fitted.predict_proba(X), expected.numpy(), atol=1e-6)


def test_learns_an_order_in_time():
    X, y = bars()
    fitted = ConvLSTMClassifier(4, units=8, epochs=25, batch=8, learning_rate=0.02, random_state=0).fit(X, y)
    new, truth = bars(seed=1)
    assert fitted.score(new, truth) > 0.95
    assert fitted.score(new[:, ::-1], truth) < 0.05


def test_a_batch_in_parts_is_the_batch(monkeypatch):
    X, y = bars(12)
    prototype = ConvLSTMClassifier(2, units=3, epochs=2, batch=12, random_state=1)
    in_parts = clone(prototype).fit(X, y)
    monkeypatch.setattr(conv_lstm, "TRIALS_AT_ONCE", 12)
    whole = clone(prototype).fit(X, y)
    for ours, theirs in zip(in_parts.network_.parameters(), whole.network_.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-5)


def test_repeats_from_its_seed_and_leaves_the_global_one_alone():
    X, y = bars(6)
    before = torch.get_rng_state()
    nets = [ConvLSTMClassifier(2, units=3, epochs=1, random_state=s).fit(X, y) for s in (0, 0, 1)]
    assert torch.equal(torch.get_rng_state(), before)
    predicted = [net.predict_proba(X) for net in nets]
    assert np.array_equal(predicted[0], predicted[1])
    assert not np.allclose(predicted[0], predicted[2])


def test_trained_on_n_steps_used_on_m():
    X, y = bars(6)
    fitted = ConvLSTMClassifier(2, units=3, epochs=1, random_state=0).fit(X, y)
    np.testing.assert_allclose(fitted.predict_proba(X[:, :2]).sum(axis=1), 1, atol=1e-6)


def test_refusals():
    X, y = bars(4)
    with pytest.raises(InputError, match=r"X: must be \(trial, time, height, width\).*\(4, 5, 49\)"):
        ConvLSTMClassifier().fit(X.reshape(4, 5, -1), y)
    with pytest.raises(InputError, match="kernel: 9 is wider than the images"):
        ConvLSTMClassifier(kernel=9).fit(X, y)
    with pytest.raises(InputError, match="y: holds one class"):
        ConvLSTMClassifier().fit(X, ["up"] * 4)
    with pytest.raises(InputError, match="y: has the shape"):
        ConvLSTMClassifier().fit(X, y[:3])
    fitted = ConvLSTMClassifier(2, units=3, epochs=1, random_state=0).fit(X, y)
    with pytest.raises(InputError, match=r"X: images are \(6, 7\) but were \(7, 7\)"):
        fitted.predict(X[:, :, :6])
    with pytest.raises(InputError, match="not finite"):
        fitted.predict(X * np.inf)


def test_convolutions_by_hand():
    # 2x3 output pixels, 1 channel, 2 filters of 3x3: 6 x 2 x 9 MACs; 2 filters of 9 weights and a bias.
    assert operations(cost(Conv2d(2, 3, 1, 2, 3))) == operations(Cost(macs=108, parameters=20, bytes=80))
    # An LSTM of 1 channel and 2 filters on 6 pixels: 4 gates x 2 filters x 3 maps x 9 = 216 weights, 8 biases.
    convolutional = cost(ConvLSTM(2, 3, 1, 2, 3))
    assert (convolutional.macs, convolutional.parameters) == (6 * 216 + 12, 224)
    assert convolutional.other_flops == 12 * (2 + 3 * 14 + 2 * 15)


def test_a_conv_lstm_of_one_pixel_and_one_tap_is_an_lstm():
    assert cost(ConvLSTM(1, 1, 16, 10, 1, steps=20)) == cost(LSTM(16, 10, steps=20))
