"""How the candidates of a family of classifiers are chosen."""

from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.baselines import families
from neurotact.baselines import minirocket as rocket
from neurotact.baselines.families import ON_FEATURES, Sides, first_best, minirocket, pooled_gru, refitted


@given(st.lists(st.sampled_from([0.0, 0.5, 0.9, 1.0]), min_size=1))
def test_the_first_of_the_best_is_chosen_and_none_is_fitted_after_one_without_an_error(accuracies):
    fitted = []

    def fit(order):
        fitted.append(order)
        return accuracies[order], order

    assert first_best(map(fit, range(len(accuracies)))) == (max(accuracies), accuracies.index(max(accuracies)))
    assert len(fitted) == (accuracies.index(1.0) + 1 if 1.0 in accuracies else len(accuracies))


def sides_of(seed, n_train=24, shape=(3,)):
    """Two noisy classes, of examples of a shape."""
    rng, made, labels = np.random.default_rng(seed), [], []
    for n in (n_train, 12, 12):
        labels.append(np.arange(n) % 2)
        made.append(rng.normal(size=(n, *shape)) + 0.7 * labels[-1].reshape(-1, *[1] * len(shape)))
    return Sides(*made, *labels)


@pytest.mark.parametrize(
    ("family", "shape"),
    [*((family, (3,)) for family in ON_FEATURES.values()), (minirocket, (40, 2)), (pooled_gru, (20, 2))],
)
def test_a_choice_is_fitted_again_with_its_settings(monkeypatch, family, shape):
    monkeypatch.setattr(rocket, "FEATURES", 84)
    monkeypatch.setattr(families, "GRU_HIDDEN", (4, 6))
    sides, others = sides_of(0, shape=shape), sides_of(1, n_train=36, shape=shape)
    for candidate, own in islice(zip(family(sides, 0), family(others, 0), strict=True), 3):
        again, elsewhere = refitted(candidate, sides), refitted(candidate, others)
        assert (again.settings, again.layers) == (candidate.settings, candidate.layers)
        np.testing.assert_array_equal(again.fitted.predict(sides.test), candidate.fitted.predict(sides.test))
        if family is families.elm:  # whose penalty is chosen, and kept
            assert elsewhere.settings == candidate.settings
        elif family is not families.svm:  # whose order depends on the data
            np.testing.assert_array_equal(elsewhere.fitted.predict(others.test), own.fitted.predict(others.test))


def test_minirocket_has_one_candidate_of_the_default_size(monkeypatch):
    monkeypatch.setattr(rocket, "FEATURES", 168)
    (candidate,) = minirocket(sides_of(0, shape=(40, 2)), 0)
    assert candidate.settings == "168 features"
    assert len(candidate.fitted.transform_.convolutions_) == 84 * 2
    assert sum(len(one.biases) for one in candidate.fitted.transform_.convolutions_) == 168
