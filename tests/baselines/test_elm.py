import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.opponents.elm import LEAST_POWER, ELMClassifier, powers_of_two
from scipy.special import expit
from sklearn.linear_model import Ridge
from sklearn.utils.estimator_checks import parametrize_with_checks

from neurotact.errors import InputError

ACTIVATIONS = ("sigmoid", "relu", "hard_limit")


def blobs(n_classes, n_examples=60, n_features=3, seed=0):
    rng = np.random.default_rng(seed)
    indices = np.arange(n_examples) % n_classes
    return rng.normal(size=(n_examples, n_features)) + 2 * np.eye(n_classes, n_features)[indices], indices


def hidden_layer(elm, X):
    drive = X @ elm.hidden_weights_ + elm.hidden_biases_
    return {"sigmoid": expit, "relu": lambda v: v * (v > 0), "hard_limit": lambda v: 1.0 * (v >= 0)}[elm.activation](
        drive
    )


@parametrize_with_checks([ELMClassifier(), ELMClassifier(activation="relu", output_bias=True)])
def test_scikit_learns_checks(estimator, check):
    check(estimator)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("output_bias", [False, True])
@pytest.mark.parametrize("n_classes", [2, 3])
def test_output_layer_is_scikit_learns_ridge(activation, output_bias, n_classes):
    X, y = blobs(n_classes)
    elm = ELMClassifier(15, activation, alpha=0.3, output_bias=output_bias, random_state=1).fit(X, y)
    H = hidden_layer(elm, X)
    targets = np.where(y[:, None] == np.arange(n_classes), 1.0, -1.0)[:, 1 if n_classes == 2 else slice(None)]
    ridge = Ridge(alpha=0.3, fit_intercept=output_bias, solver="cholesky").fit(H, targets)
    np.testing.assert_allclose(elm.decision_function(X), ridge.predict(H), rtol=0, atol=1e-8)


def test_output_layer_solves_the_normal_equations():
    X, y = blobs(3)
    elm = ELMClassifier(10, alpha=0.05, random_state=0).fit(X, y)
    H, targets = hidden_layer(elm, X), np.where(y[:, None] == np.arange(3), 1.0, -1.0)
    closed_form = np.linalg.solve(H.T @ H + 0.05 * np.eye(10), H.T @ targets)
    np.testing.assert_allclose(elm.coef_, closed_form, rtol=0, atol=1e-8)


@given(
    st.sampled_from(ACTIVATIONS), st.booleans(), st.integers(2, 4), st.integers(1, 40), st.floats(1e-8, 1e8),
    st.integers(0, 1000),
)  # fmt: skip
def test_a_path_of_alphas_equals_a_fit_at_each(activation, output_bias, n_classes, hidden, alpha, seed):
    X, y = blobs(n_classes, seed=seed)
    given_params = {"hidden": hidden, "activation": activation, "output_bias": output_bias, "random_state": seed}
    alone = ELMClassifier(alpha=alpha, **given_params).fit(X, y)
    path = ELMClassifier(alpha=1.0, **given_params).fit(X, y).decision_path([1.0, alpha], X)
    scores = alone.decision_function(X).reshape(len(X), -1)
    np.testing.assert_allclose(path[1], scores, rtol=0, atol=1e-8 * max(1.0, np.abs(scores).max()))


def test_accuracy_path_is_the_score_of_each_alpha():
    X, y = blobs(3)
    names = np.array(["rubber", "sponge", "wood"])[y]
    alphas = 10.0 ** np.arange(-8, 9)
    path = ELMClassifier(20, random_state=0).fit(X, names).accuracy_path(alphas, X, names)
    each = [ELMClassifier(20, alpha=a, random_state=0).fit(X, names).score(X, names) for a in alphas]
    assert path.tolist() == each
    assert len(set(path)) > 1


@pytest.mark.parametrize("alpha", [0.0, 1e-12])
@pytest.mark.parametrize("output_bias", [False, True])
def test_singular_and_constant_features_are_solved(alpha, output_bias):
    X, y = blobs(2, n_examples=20)
    X = np.column_stack([X, X[:, 0], np.full(20, 7.0)])
    elm = ELMClassifier(200, alpha=alpha, output_bias=output_bias, random_state=0).fit(X, y)
    assert np.isfinite(elm.coef_).all()
    assert elm.score(X, y) == 1.0  # 200 neurons hold 20 examples


def test_without_penalty_the_solution_of_least_norm_is_taken():
    X, y = blobs(2, n_examples=12)
    elm = ELMClassifier(50, "relu", alpha=0.0, random_state=0).fit(X, y)
    H = hidden_layer(elm, X)
    least = np.linalg.lstsq(H, np.where(y == 1, 1.0, -1.0), rcond=None)[0]
    np.testing.assert_allclose(elm.coef_[:, 0], least, rtol=0, atol=1e-8)


def test_constant_features_alone_leave_the_more_frequent_class():
    y = np.array([0, 0, 0, 1])
    elm = ELMClassifier(alpha=0.0, output_bias=True, random_state=0).fit(np.full((4, 2), 3.0), y)
    assert elm.predict(np.full((1, 2), 3.0)).tolist() == [0]
    np.testing.assert_allclose(elm.decision_function(np.full((1, 2), 3.0)), [-0.5], atol=1e-8)


def test_an_output_bias_is_not_penalised():
    X, y = blobs(2)
    elm = ELMClassifier(5, alpha=1e12, output_bias=True, random_state=0).fit(X, np.append(y[:-5], [1] * 5))
    np.testing.assert_allclose(elm.intercept_, np.where(np.append(y[:-5], [1] * 5) == 1, 1, -1).mean(), atol=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 6))
def test_hidden_layers_are_drawn_as_the_paper_says(seed, hidden, n_features):
    X, y = blobs(2, n_features=n_features, seed=1)
    elm = ELMClassifier(hidden, random_state=seed).fit(X, y)
    drawn = np.append(elm.hidden_weights_, elm.hidden_biases_)
    assert drawn.shape == ((n_features + 1) * hidden,)
    assert (np.abs(drawn) < 1).all()
    hard = ELMClassifier(hidden, "hard_limit", random_state=seed).fit(X, y)
    exponents = np.log2(np.abs(hard.hidden_weights_))
    assert (exponents == np.rint(exponents)).all()
    assert (np.sign(hard.hidden_weights_) == np.sign(elm.hidden_weights_)).all()


@given(st.floats(-1, 1).filter(bool))
def test_powers_of_two_are_nearest_in_ratio(weight):
    rounded = abs(powers_of_two(np.array([weight]))[0])
    known = 2.0 ** np.arange(LEAST_POWER, 1)
    ratios = np.abs(np.log2(known) - np.log2(abs(weight)))
    assert ratios[known.tolist().index(rounded)] <= ratios.min() + 1e-12


def test_refusals():
    X, y = blobs(2)
    with pytest.raises(InputError, match="y: holds one class"):
        ELMClassifier().fit(X, np.zeros(len(X), int))
    with pytest.raises(InputError, match="did you mean 'sigmoid'"):
        ELMClassifier(activation="sigmoide").fit(X, y)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="alpha: must be a finite number >= 0; got -1"):
        ELMClassifier(alpha=-1).fit(X, y)
    with pytest.raises(InputError, match="hidden: must be a whole number >= 1"):
        ELMClassifier(hidden=0).fit(X, y)
    with pytest.raises(InputError, match="class '7' was not among the training examples"):
        ELMClassifier().fit(X, y).accuracy_path([1.0], X, np.full(len(X), 7))
