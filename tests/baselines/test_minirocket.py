"""MiniRocket: a feature counted by hand, its size and range, and what it recognises."""

import inspect
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.opponents import minirocket as rocket
from neurotact_parts.opponents.minirocket import (
    ALPHAS,
    TRIPLES,
    Convolution,
    MiniRocket,
    MiniRocketClassifier,
    MiniRocketRegressor,
    dilations,
)
from sklearn.linear_model import RidgeClassifierCV, RidgeCV
from sklearn.preprocessing import StandardScaler

from neurotact.errors import InputError


def convolved(signal: np.ndarray, convolution: Convolution) -> np.ndarray:
    """The definition, weight by weight: nine weights of -1, three of which are 2, zeros beyond the ends."""
    n_steps = len(signal)
    weights = np.full(9, -1.0)
    weights[list(TRIPLES[convolution.kernel])] = 2.0
    summed = signal[:, convolution.channels].sum(axis=1)
    made = np.zeros(n_steps)
    for step in range(n_steps):
        for place, weight in enumerate(weights):
            at = step + (place - 4) * convolution.dilation
            made[step] += weight * summed[at] if 0 <= at < n_steps else 0.0
    edge = 4 * convolution.dilation
    return made if convolution.padded else made[edge : n_steps - edge]


def by_hand(signal: np.ndarray, convolution: Convolution) -> np.ndarray:
    return np.array([(convolved(signal, convolution) > bias).mean() for bias in convolution.biases])


@examples(10)
@given(st.integers(9, 40), st.integers(1, 4), st.integers(84, 400))
def test_each_feature_is_the_share_of_time_above_its_bias(n_steps, n_channels, features):
    X = np.random.default_rng(0).integers(-9, 9, (3, n_steps, n_channels)).astype(float)  # exact sums in any order
    rocket = MiniRocket(features, random_state=1).fit(X)
    found = rocket.transform(X)
    assert found.shape[1] == features // 84 * 84
    first = 0
    for convolution in rocket.convolutions_[::7]:
        first = sum(len(one.biases) for one in rocket.convolutions_[: rocket.convolutions_.index(convolution)])
        mine = found[2, first : first + len(convolution.biases)]
        np.testing.assert_allclose(mine, by_hand(X[2], convolution), atol=1e-6)


def test_biases_are_quantiles_of_the_convolution_of_one_training_sequence():
    """Shares of the golden ratio, one after the other over all features; zeros are beyond the ends of the sequence."""
    X = np.random.default_rng(0).normal(size=(3, 30, 2))
    taken, first = [], 0
    for convolution in MiniRocket(400, random_state=0).fit(X).convolutions_:
        shares = np.arange(first + 1, first + 1 + len(convolution.biases)) * (5**0.5 + 1) / 2 % 1
        whole = convolution._replace(padded=True)
        wanted = [np.quantile(convolved(signal, whole), shares) for signal in X]
        (number,) = [at for at, each in enumerate(wanted) if np.allclose(each, convolution.biases, atol=1e-4)]
        taken, first = [*taken, number], first + len(convolution.biases)
    assert {*taken} == {0, 1, 2}
    assert first == 336


def test_every_second_kernel_and_dilation_is_padded():
    padded = [one.padded for one in MiniRocket(400, random_state=0).fit(np.zeros((1, 40, 1))).convolutions_]
    rows = np.reshape(padded, (-1, 84))
    assert len(rows) > 1
    assert (rows[:, 1:] != rows[:, :-1]).all()
    assert (rows[1:] != rows[:-1]).all()
    assert rows[0, 0]


def test_its_ridge_sees_standardised_features():
    X, y = waves()
    fitted = MiniRocketClassifier(168, random_state=0).fit(X, y)
    features = fitted.transform_.transform(X)
    standard = (features - features.mean(axis=0)) / np.where(features.std(axis=0) > 0, features.std(axis=0), 1.0)
    wanted = RidgeClassifierCV(alphas=np.logspace(-3, 3, 10)).fit(standard, y).decision_function(standard)
    np.testing.assert_allclose(fitted.ridge_.decision_function(features), wanted, rtol=1e-3)


def made_to_give(monkeypatch, features: np.ndarray) -> None:
    monkeypatch.setattr(MiniRocket, "fit_transform", lambda self, X, y=None: features)
    monkeypatch.setattr(MiniRocket, "transform", lambda self, X: features)


@pytest.mark.parametrize("shape", [(400, 84), (60, 168), (30, 168)])
def test_its_penalty_and_weights_are_those_of_scikit_learn(shape, monkeypatch):
    """Also with constant features, and with trials that are equal."""
    rng, chosen = np.random.default_rng(0), set()
    features = rng.normal(3.0, 2.0, shape).astype(np.float32)
    features[:, 5], features[7] = 1.5, features[8]
    made_to_give(monkeypatch, features)
    standard = StandardScaler().fit(features.astype(float)).transform(features.astype(float))
    for noise in (0.0, 1.0, 10.0, 100.0):
        levels = features[:, :2] @ np.array([[1.0, 2.0], [0.5, -1.0]]) + rng.normal(0, noise + 1e-6, (len(features), 2))
        searched = RidgeCV(alphas=ALPHAS).fit(standard, levels)
        fitted = MiniRocketRegressor(84).fit(None, levels)
        assert fitted.ridge_[-1].alpha == searched.alpha_
        np.testing.assert_allclose(fitted.ridge_[-1].coef_, searched.coef_, atol=1e-6 * np.abs(searched.coef_).max())
        np.testing.assert_allclose(fitted.predict(None), searched.predict(standard), atol=1e-4 * np.abs(levels).max())
        chosen.add(searched.alpha_)
    assert len(chosen) > 1
    for y in (levels[:, 0] > 0, np.digitize(levels[:, 0], np.quantile(levels[:, 0], [0.3, 0.6]))):
        told = RidgeClassifierCV(alphas=ALPHAS).fit(standard, y)
        fitted = MiniRocketClassifier(84).fit(None, y)
        np.testing.assert_allclose(fitted.ridge_[-1].coef_, told.coef_, atol=1e-6 * np.abs(told.coef_).max())
        np.testing.assert_array_equal(fitted.predict(None), told.predict(standard))


def test_a_fit_holds_its_features_once_and_one_gram_matrix(monkeypatch):
    """A copy in float64 would be twice the features; the matrix and what is standardised at once are less than them."""
    features = np.random.default_rng(0).random((400, 8000), np.float32)
    features[1], features[2] = features[0], 1.4  # a matrix of one trial a class would be ill-conditioned: a warning
    made_to_give(monkeypatch, features)
    monkeypatch.setattr(rocket, "MOST_SEARCHED", 50)
    monkeypatch.setattr(rocket, "ALPHAS", (4e-3,))
    tracemalloc.start()
    try:
        MiniRocketClassifier(84).fit(None, np.arange(400) % 3)
        assert tracemalloc.get_traced_memory()[1] < 0.8 * features.nbytes
    finally:
        tracemalloc.stop()


def test_it_is_as_large_as_published_unless_another_size_is_asked_for():
    for made in (MiniRocket, MiniRocketClassifier):
        assert inspect.signature(made).parameters["features"].default == 9996
        assert made().features == 9996


@given(st.integers(9, 5000), st.integers(84, 10_000))
def test_the_longest_kernel_fits_and_all_features_are_given_out(n_steps, features):
    found = dilations(n_steps, features)
    assert sum(n for _, n in found) == features // 84
    assert all(8 * dilation <= n_steps - 1 for dilation, _ in found)
    assert [dilation for dilation, _ in found] == sorted({dilation for dilation, _ in found})


def waves(n=60, seed=0):
    """Two classes that differ in the frequency of one channel alone, at any phase."""
    rng = np.random.default_rng(seed)
    period = np.where(np.arange(n) % 2, 5.0, 9.0)[:, None]
    tone = np.sin(2 * np.pi * np.arange(80) / period + rng.uniform(0, 2 * np.pi, (n, 1)))
    return np.stack([tone, rng.normal(size=tone.shape)], axis=2), np.array(["high", "low"])[np.arange(n) % 2]


def test_it_recognises_frequencies_at_any_phase_and_repeats_from_a_seed():
    X, y = waves()
    fitted = MiniRocketClassifier(1008, random_state=0).fit(X, y)
    assert fitted.score(*waves(seed=1)) > 0.95
    again = MiniRocketClassifier(1008, random_state=0).fit(X, y)
    np.testing.assert_array_equal(fitted.transform_.transform(X), again.transform_.transform(X))


@pytest.mark.parametrize(
    ("X", "words"),
    [(np.zeros((4, 8, 1)), "has 8 steps; MiniRocket needs at least 9"), (np.zeros((4, 8)), "trial, time, channel")],
)
def test_what_it_cannot_read_is_refused(X, words):
    with pytest.raises(InputError, match=words):
        MiniRocket(84).fit(X)


def test_other_sequences_than_those_of_training_are_refused():
    fitted = MiniRocket(84, random_state=0).fit(np.zeros((4, 20, 2)))
    with pytest.raises(InputError, match=r"sequences are \(20, 3\), those of training \(20, 2\)"):
        fitted.transform(np.zeros((4, 20, 3)))
