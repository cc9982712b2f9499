import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.materials.rls import RLSClassifier
from sklearn.kernel_ridge import KernelRidge
from sklearn.utils.estimator_checks import parametrize_with_checks

from neurotact.errors import InputError


def blobs(n_classes, n_examples=60, n_features=3, seed=0):
    rng = np.random.default_rng(seed)
    indices = np.arange(n_examples) % n_classes
    return rng.normal(size=(n_examples, n_features)) + 2 * np.eye(n_classes, n_features)[indices], indices


def signs(y, n_classes):
    return np.where(y[:, None] == np.arange(n_classes), 1.0, -1.0)[:, 1 if n_classes == 2 else slice(None)]


@parametrize_with_checks([RLSClassifier()])
def test_scikit_learns_checks(estimator, check):
    check(estimator)


@given(st.integers(2, 4), st.floats(1e-2, 10), st.floats(0.1, 10), st.integers(0, 1000))
def test_equals_scikit_learns_kernel_ridge(n_classes, alpha, sigma, seed):
    X, y = blobs(n_classes, seed=seed)
    new = np.random.default_rng(seed + 1).normal(size=(20, 3))
    ridge = KernelRidge(alpha=alpha, kernel="rbf", gamma=1 / (2 * sigma**2)).fit(X, signs(y, n_classes))
    ours = RLSClassifier(alpha, sigma).fit(X, y)
    np.testing.assert_allclose(ours.decision_function(new), ridge.predict(new), rtol=1e-8, atol=1e-8)


def test_dual_coefficients_solve_equation_2_of_the_materials_paper():
    X, y = blobs(3)
    K = np.exp(-((X[:, None] - X) ** 2).sum(axis=2) / (2 * 0.7**2))
    closed_form = np.linalg.solve(K + 0.01 * np.eye(len(X)), signs(y, 3))
    np.testing.assert_allclose(RLSClassifier(0.01, 0.7).fit(X, y).dual_coef_, closed_form, rtol=0, atol=1e-8)


def test_accuracy_path_is_the_score_of_each_alpha():
    X, y = blobs(3, seed=4)
    new, truth = blobs(3, seed=5)
    alphas = 2.0 ** np.arange(-12, 8)
    path = RLSClassifier(sigma=1.5).fit(X, y).accuracy_path(alphas, new, truth)
    assert path.tolist() == [RLSClassifier(a, 1.5).fit(X, y).score(new, truth) for a in alphas]
    assert len(set(path)) > 1


@pytest.mark.parametrize("sigma", [2.0**-12, 1.0, 2.0**12])
@pytest.mark.parametrize("alpha", [0.0, 2.0**-12])
def test_repeated_examples_and_constant_features_are_solved(sigma, alpha):
    X, y = blobs(2, n_examples=20)
    X, y = np.repeat(np.column_stack([X, np.full(20, 5.0)]), 2, axis=0), np.repeat(y, 2)
    scores = RLSClassifier(alpha, sigma).fit(X, y).decision_function(X)
    assert np.isfinite(scores).all()
    if sigma <= 1:
        assert ((scores > 0) == (y == 1)).all()


def test_a_narrow_kernel_without_penalty_interpolates():
    X, y = blobs(2)
    np.testing.assert_allclose(RLSClassifier(0.0, 0.2).fit(X, y).decision_function(X), signs(y, 2), atol=1e-8)


def test_refusals():
    X, y = blobs(2)
    with pytest.raises(InputError, match="y: holds one class"):
        RLSClassifier().fit(X, np.zeros(len(X), int))
    with pytest.raises(InputError, match="sigma: must be a finite number > 0; got 0"):
        RLSClassifier(sigma=0).fit(X, y)
    with pytest.raises(InputError, match="alpha: must be a finite number >= 0"):
        RLSClassifier(alpha=float("nan")).fit(X, y)
