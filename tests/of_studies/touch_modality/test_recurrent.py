import numpy as np
import pytest
import torch
from costs import operations
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.opponents.pooled_gru import GRU
from neurotact_parts.studies import published_flops
from neurotact_parts.studies.touch_modality.recurrent import AT_ONCE, LSTM, GRUClassifier, LSTMClassifier, fit_snapshots
from sklearn.base import clone
from sklearn.model_selection import cross_val_score

from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Dense, cost

CLASSIFIERS = (LSTMClassifier, GRUClassifier)
MODALITIES = np.array(["brushing", "rolling", "sliding"])


def touches(n_trials=60, n_steps=12, n_channels=4, seed=0):
    """Which of three directions a bump takes over the channels: the same values, in another order."""
    rng = np.random.default_rng(seed)
    indices = np.arange(n_trials) % 3
    steps = np.arange(n_steps)
    X = 0.2 * rng.normal(size=(n_trials, n_steps, n_channels))
    for trial, modality in enumerate(indices):
        place = [steps, steps[::-1], np.full(n_steps, n_steps // 2)][modality] * n_channels // n_steps
        X[trial, steps, place] += 1
    return X, MODALITIES[indices]


def weights_of(net):
    parts = (net.input_weights_, net.recurrent_weights_, net.biases_, net.coef_, net.intercept_)
    return np.concatenate([part.ravel() for part in parts])


@pytest.mark.parametrize(
    ("network", "count"), [(LSTMClassifier(10), 1113), (GRUClassifier(10), 843), (GRUClassifier(12), 1083)]
)
def test_counts_of_table_1_of_the_touch_modality_paper(network, count):
    X, y = touches(6, 4, 16)
    fitted = clone(network).set_params(epochs=1, random_state=0).fit(X, y)
    assert fitted.n_parameters_ == count == weights_of(fitted).size


@examples(15)
@given(st.integers(1, 12), st.integers(1, 20), st.integers(2, 5))
def test_counts_of_parameters(hidden, n_channels, n_classes):
    X, y = np.zeros((n_classes, 2, n_channels)), np.arange(n_classes)
    for kind, gates in ((LSTMClassifier, 4), (GRUClassifier, 3)):
        fitted = kind(hidden, epochs=1, random_state=0).fit(X, y)
        by_hand = gates * hidden * (n_channels + hidden + 1) + n_classes * (hidden + 1)
        assert fitted.n_parameters_ == by_hand == weights_of(fitted).size


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_learns_an_order_in_time(kind):
    X, y = touches(90)
    fitted = kind(8, epochs=40, batch=16, learning_rate=0.02, random_state=0).fit(X, y)
    new, truth = touches(60, seed=1)
    assert fitted.score(new, truth) > 0.95
    assert fitted.score(new[:, ::-1], truth) < 0.5  # directions turned round


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_many_at_once_equal_each_alone(kind):
    problems = [touches(seed=0), touches(seed=0), touches(seed=1), touches(50, seed=2)]
    prototype = kind(6, epochs=8, batch=16, learning_rate=0.01)
    new, _ = touches(30, seed=3)
    for seed, (net, problem) in enumerate(
        zip(*fit_snapshots(prototype, problems, range(4), [8]), problems, strict=True)
    ):
        alone = clone(prototype).set_params(random_state=seed).fit(*problem)
        np.testing.assert_allclose(weights_of(net), weights_of(alone), rtol=0, atol=1e-5)
        np.testing.assert_allclose(net.predict_proba(new), alone.predict_proba(new), rtol=0, atol=1e-5)
        assert net.random_state == seed


def test_more_networks_than_fit_at_once_keep_their_places():
    X, y = touches(6, 3, 2)
    prototype = GRUClassifier(2, epochs=1)
    (many,) = fit_snapshots(prototype, [(X, y)] * (AT_ONCE + 2), range(AT_ONCE + 2), [1])
    for seed in (0, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1):
        alone = clone(prototype).set_params(random_state=seed).fit(X, y)
        np.testing.assert_allclose(weights_of(many[seed]), weights_of(alone), rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_a_snapshot_is_the_shorter_training(kind):
    X, y = touches(30)
    prototype = kind(4, epochs=7, batch=8)
    early, late = fit_snapshots(prototype, [(X, y)] * 2, [3, 4], [2, 7])
    for nets, epochs in ((early, 2), (late, 7)):
        alone = clone(prototype).set_params(epochs=epochs, random_state=4).fit(X, y)
        np.testing.assert_allclose(weights_of(nets[1]), weights_of(alone), rtol=0, atol=1e-6)
    assert not np.allclose(weights_of(early[0]), weights_of(late[0]))


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_starts_as_keras_does(kind):
    X, y = touches(6, 3, 16)
    start = kind(10, epochs=1, learning_rate=1e-12, random_state=0).fit(X, y)
    np.testing.assert_allclose(start.recurrent_weights_ @ start.recurrent_weights_.T, np.eye(10), atol=1e-5)
    assert np.abs(start.input_weights_).max() <= np.sqrt(6 / (16 + start.biases_.size)) + 1e-6
    assert np.abs(start.coef_).max() <= np.sqrt(6 / (10 + 3)) + 1e-6
    forget = np.arange(start.biases_.size) // 10 == 1
    np.testing.assert_allclose(start.biases_, forget if kind is LSTMClassifier else 0 * forget, atol=1e-9)


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_one_step_is_adams_on_the_cross_entropy(kind):
    X, y = touches(24)
    start = kind(5, epochs=1, batch=24, learning_rate=1e-12, random_state=2).fit(X, y)
    moved = kind(5, epochs=1, batch=24, learning_rate=0.01, random_state=2).fit(X, y)
    logits = {name: np.log(net.predict_proba(X)) for name, net in (("start", start), ("moved", moved))}
    truth = np.searchsorted(MODALITIES, y)
    losses = {name: -values[np.arange(24), truth].mean() for name, values in logits.items()}
    assert losses["moved"] < losses["start"]
    # Adam's first step is the learning rate along the sign of every gradient that is not tiny.
    steps = np.abs(weights_of(moved) - weights_of(start))
    assert np.quantile(steps, 0.2) > 0.0099
    assert steps.max() < 0.01 + 1e-6
    for j in np.random.default_rng(0).choice(start.intercept_.size, 3):
        share = np.exp(logits["start"]).mean(axis=0)[j] - (truth == j).mean()  # the gradient of an output's bias
        assert np.sign(moved.intercept_[j] - start.intercept_[j]) == -np.sign(share)


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_trained_on_n_steps_used_on_m(kind):
    X, y = touches(45, n_steps=8)
    fitted = kind(8, epochs=40, batch=16, learning_rate=0.02, random_state=0).fit(X, y)
    for n_steps in (4, 16):
        new, truth = touches(30, n_steps=n_steps, seed=1)
        assert fitted.predict_proba(new).shape == (30, 3)
        assert fitted.score(new, truth) > 0.6


@pytest.mark.parametrize("kind", CLASSIFIERS)
def test_order_of_the_test_trials_changes_no_prediction(kind):
    X, y = touches(30)
    fitted = kind(4, epochs=3, random_state=0).fit(X, y)
    new = np.random.default_rng(0).normal(size=(300, 12, 4))  # more than are predicted at once
    order = np.random.default_rng(1).permutation(300)
    np.testing.assert_allclose(fitted.predict_proba(new)[order], fitted.predict_proba(new[order]), atol=1e-12)
    assert fitted.predict(new)[order].tolist() == fitted.predict(new[order]).tolist()


def test_same_seed_same_network_and_other_seed_another():
    X, y = touches(30)
    nets = [GRUClassifier(4, epochs=2, batch=7, random_state=s).fit(X, y) for s in (5, 5, 6)]
    assert np.array_equal(weights_of(nets[0]), weights_of(nets[1]))
    assert not np.allclose(weights_of(nets[0]), weights_of(nets[2]))


def test_global_random_numbers_are_left_alone():
    X, y = touches(6)
    torch.manual_seed(0)
    before = torch.get_rng_state()
    LSTMClassifier(3, epochs=1, random_state=0).fit(X, y)
    assert torch.equal(torch.get_rng_state(), before)


def test_works_where_scikit_learn_takes_any_estimator():
    X, y = touches(30)
    scores = cross_val_score(LSTMClassifier(4, epochs=10, batch=8, learning_rate=0.02, random_state=0), X, y, cv=3)
    assert scores.shape == (3,)
    assert scores.mean() > 1 / 3


def test_refusals():
    X, y = touches(6)
    with pytest.raises(InputError, match=r"X: must be \(trial, time, channel\).*shape \(6, 48\)"):
        LSTMClassifier().fit(X.reshape(6, -1), y)
    fitted = GRUClassifier(2, epochs=1, random_state=0).fit(X, y)
    with pytest.raises(InputError, match=r"X: must be \(trial, time, channel\)"):
        fitted.predict(X[0])
    with pytest.raises(InputError, match="X: has 3 channels, but training had 4"):
        fitted.predict(X[:, :, :3])
    with pytest.raises(InputError, match="not finite"):
        fitted.predict(np.full_like(X, np.nan))
    with pytest.raises(InputError, match=r"y: has the shape \(5,\) where X has 6 trials"):
        LSTMClassifier().fit(X, y[:5])
    with pytest.raises(InputError, match="y: holds one class"):
        LSTMClassifier().fit(X, ["sliding"] * 6)
    with pytest.raises(InputError, match="batch: must be a whole number >= 1; got 0"):
        LSTMClassifier(batch=0).fit(X, y)


def test_lstm_by_hand():
    # 1 input, 2 units, one step. Gates: 8 sums of 1 + 2 products = 24 MACs. Cell: f c a product, + i g a MAC, a unit;
    # o tanh(c) a product a unit; 3 sigmoids of 14 and 2 tanhs of 15 a unit, each an exponential and a division.
    one = cost(LSTM(1, 2))
    others = {"multiplications": 2 * 2, "comparisons": 2 * (3 * 2 + 2 * 3), "divisions": 10, "exponentials": 10}
    assert operations(one) == operations(Cost(macs=24 + 2, parameters=32, bytes=4 * (32 + 4), **others))
    assert one.other_flops == 2 * (2 + 3 * 14 + 2 * 15)
    five = cost(LSTM(1, 2, steps=5))
    assert (five.macs, five.other_flops, five.parameters) == (5 * one.macs, 5 * one.other_flops, 32)


def test_published_parameters_of_the_touch_modality_paper():
    assert cost(LSTM(16, 10), Dense(10, 3)).parameters == 1113
    assert cost(GRU(16, 10), Dense(10, 3)).parameters == 843
    assert cost(GRU(16, 12), Dense(12, 3)).parameters == 1083


def test_a_published_block_is_no_count_of_an_inference():
    ours = cost(LSTM(16, 10), Dense(10, 3)).flops
    assert ours == 2 * (1040 + 10 + 30) + 10 * 74
    assert ours != published_flops.touch_modality_flops("LSTM", 10)
