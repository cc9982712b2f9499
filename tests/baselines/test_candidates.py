"""How the candidates of a family of classifiers are chosen."""

from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.opponents import minirocket as rocket
from neurotact_parts.opponents import pooled_gru, rounding, scikit_learn
from neurotact_parts.opponents.minirocket import FixedConvolutions
from neurotact_parts.opponents.pooled_gru import GRU, PooledStates
from neurotact_parts.opponents.scikit_learn import Trees, mean_depth
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.linear_model import RidgeClassifier, RidgeClassifierCV
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from neurotact.baselines.features import BandPowers, averaged
from neurotact.baselines.opponent import (
    Opponent,
    Sides,
    accuracy,
    best_of,
    first_best,
    joined,
    load,
    part_of,
    say_once,
    standardised,
)
from neurotact.errors import InputError
from neurotact.metrics import flops
from neurotact.metrics.flops import Cost, cost


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
    [*((name, (3,)) for name in (*joined("features", "quick"), "RLS", "SLFN", "k-means", "kNN")),
     *((name, (20, 2)) for name in ("MiniRocket", "GRU"))],
)  # fmt: skip
def test_a_choice_is_fitted_again_with_its_settings(monkeypatch, family, shape):
    monkeypatch.setattr(rocket, "FEATURES", 84)
    monkeypatch.setattr(pooled_gru, "GRU_HIDDEN", (4, 6))
    sides, others = sides_of(0, shape=shape), sides_of(1, n_train=36, shape=shape)
    opponent = load(family)
    for candidate, own in islice(zip(*(opponent.candidates(of, 0) for of in (sides, others)), strict=True), 3):
        again, elsewhere = candidate.again(sides), candidate.again(others)
        assert (again.settings, again.layers) == (candidate.settings, candidate.layers)
        np.testing.assert_array_equal(again.fitted.predict(sides.test), candidate.fitted.predict(sides.test))
        if family in ("ELM", "RLS"):  # whose penalty is chosen, and kept
            assert elsewhere.settings == candidate.settings
        elif family != "SVM":  # whose order depends on the data
            np.testing.assert_array_equal(elsewhere.fitted.predict(others.test), own.fitted.predict(others.test))


@pytest.mark.parametrize("kind", ["f8", "f4", "i8"])
def test_machines_of_a_gamma_share_a_kernel_and_are_those_of_libsvm(monkeypatch, kind):
    computed, rbf_kernel = [], scikit_learn.rbf_kernel
    monkeypatch.setattr(
        scikit_learn, "rbf_kernel", lambda *x, gamma: computed.append(gamma) or rbf_kernel(*x, gamma=gamma)
    )
    made = sides_of(3)
    sides = made._replace(**{side: (4 * getattr(made, side)).astype(kind) for side in ("train", "validation", "test")})
    found = list(scikit_learn.SVM.candidates(sides, 0))
    assert len(found) == len(scikit_learn.SVM_GAMMAS) * len(scikit_learn.SVM_CS)
    assert sorted(computed) == [gamma / 3 for gamma in scikit_learn.SVM_GAMMAS for _ in range(2)]
    for one in found:
        machines, alone = one.fitted, SVC(C=one.fitted.C, gamma=one.fitted.gamma).fit(sides.train, sides.y_train)
        np.testing.assert_array_equal(machines.support_vectors_, alone.support_vectors_)
        np.testing.assert_allclose(machines.dual_coef_, alone.dual_coef_, rtol=1e-6)
        for x in (sides.validation, sides.test, sides.train):
            np.testing.assert_array_equal(machines.predict(x), alone.predict(x))
            np.testing.assert_allclose(machines.decision_function(x), alone.decision_function(x), rtol=1e-6, atol=1e-6)
        narrow = [rounding.machines(of, sides.train, 2).predict(sides.validation) for of in (machines, alone)]
        np.testing.assert_array_equal(*narrow)
        again = machines.fit(sides.test, sides.y_test).predict(sides.validation)
        np.testing.assert_array_equal(again, alone.fit(sides.test, sides.y_test).predict(sides.validation))


@pytest.mark.parametrize("most", [23, 24, 40])
def test_settings_of_many_examples_are_searched_on_a_part_and_fitted_to_all(monkeypatch, capsys, most):
    monkeypatch.setattr(scikit_learn, "MOST_SEARCHED", most)
    say_once.cache_clear()
    sides, n_grid = sides_of(3, n_train=40), len(scikit_learn.SVM_GAMMAS) * len(scikit_learn.SVM_CS)
    found = list(scikit_learn.SVM.candidates(sides, 0))
    list(scikit_learn.SVM.candidates(sides, 0))
    told = capsys.readouterr().err.count(
        f"are searched on {most} training windows, evenly over their labels; the best 3"
    )
    assert (len(found), told) == ((n_grid, 0) if most == 40 else (3, 1))
    assert all(one.fitted.shape_fit_[0] == 40 for one in found)
    if most == 40:
        return
    some = part_of(sides.y_train, most)
    part = sides._replace(train=sides.train[some], y_train=sides.y_train[some])
    monkeypatch.setattr(scikit_learn, "MOST_SEARCHED", 40)
    every = [(accuracy(one, sides.validation, sides.y_validation), one) for one in scikit_learn.SVM.candidates(part, 0)]
    ranked = sorted(every, key=lambda pair: (-pair[0], pair[1].fitted.n_support_.sum()))
    settings = [{(one.fitted.C, one.fitted.gamma) for one in of} for of in (found, [one for _, one in ranked[:3]])]
    assert settings[0] == settings[1]


def test_sequences_are_standardised_on_the_training_side():
    x = np.random.default_rng(0).normal(5.0, 3.0, (9, 20, 2))
    x[:, :, 1] = 7.0
    sides = standardised(x, np.arange(9), [np.arange(9) % 3 == side for side in range(3)])
    assert [each.dtype for each in sides[:3]] == [np.float32] * 3
    expected = (x[1::3] - x[::3].mean(axis=(0, 1))) / [x[::3, :, 0].std(), 1.0]
    np.testing.assert_array_equal(sides.validation, expected.astype(np.float32))
    assert sides.y_test.tolist() == [2, 5, 8]


def test_samples_of_float32_are_as_exact_as_in_float64():
    """A bin of one sample is the sample, so that sequences of a set of gigabytes take half of the memory."""
    rng, sides = np.random.default_rng(0), [np.arange(30) % 3 == side for side in range(3)]
    pieces = [(1e3 + rng.normal(size=(50, 3))).astype(np.float32) for _ in range(30)]
    exact, narrow = (averaged(pieces, 50, kind) for kind in (np.float64, np.float32))
    assert narrow.dtype == np.float32
    np.testing.assert_array_equal(narrow, exact)
    for one, other in zip(*(standardised(of, np.arange(30), sides) for of in (exact, narrow)), strict=True):
        np.testing.assert_array_equal(one, other)


@given(st.lists(st.integers(0, 4), min_size=1, max_size=60), st.integers(1, 70))
def test_a_part_is_even_within_each_class(labels, n):
    labels = np.array(labels)
    some = part_of(labels, n)
    assert len(some) == min(n, len(labels))
    assert (np.diff(some) > 0).all()
    sizes, kept = np.bincount(labels, minlength=5), np.bincount(labels[some], minlength=5)
    assert (abs(kept - len(some) / len(labels) * sizes) <= 2).all()


def test_a_penalty_of_many_trials_is_searched_on_a_part_and_fitted_to_all(monkeypatch, capsys):
    monkeypatch.setattr(rocket, "FEATURES", 84)
    sides = sides_of(0, n_train=40, shape=(40, 2))
    whole = rocket.MiniRocketClassifier(84, random_state=0).fit(sides.train, sides.y_train)
    monkeypatch.setattr(rocket, "MOST_SEARCHED", 30)
    say_once.cache_clear()
    fitted = rocket.MiniRocketClassifier(84, random_state=0).fit(sides.train, sides.y_train)
    assert "the penalty of MiniRocket is searched on 30 training windows" in capsys.readouterr().err
    some, features = part_of(sides.y_train, 30), whole.transform_.transform(sides.train)
    searched = make_pipeline(StandardScaler(), RidgeClassifierCV(alphas=rocket.ALPHAS)).fit(
        features[some], sides.y_train[some]
    )
    alone = make_pipeline(StandardScaler(), RidgeClassifier(searched[-1].alpha_)).fit(
        features.astype(float), sides.y_train
    )
    np.testing.assert_allclose(fitted.ridge_[-1].coef_, alone[-1].coef_, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(fitted.predict(sides.test), alone.predict(fitted.transform_.transform(sides.test)))


def test_minirocket_has_one_candidate_of_the_default_size(monkeypatch):
    monkeypatch.setattr(rocket, "FEATURES", 168)
    (candidate,) = rocket.MINIROCKET.candidates(sides_of(0, shape=(40, 2)), 0)
    assert candidate.settings == "168 features"
    assert len(candidate.fitted.transform_.convolutions_) == 84 * 2
    assert sum(len(one.biases) for one in candidate.fitted.transform_.convolutions_) == 168


def test_gru_by_hand():
    # 1 input, 2 units, one step. Gates: 6 sums of 3 products = 18 MACs. r h a product, h - g a difference,
    # g + z (h - g) a MAC, a unit; 2 sigmoids and 1 tanh a unit.
    others = {"multiplications": 2, "comparisons": 2 * (2 * 2 + 3), "divisions": 2 * 3, "exponentials": 2 * 3}
    counted = cost(GRU(1, 2))
    moved = {"weights_accesses": 24, "states_accesses": 2 * 2, "buffers_accesses": 1, "states_bytes": 8}
    assert counted == Cost(macs=18 + 2, acs=2, parameters=24, bytes=4 * (24 + 2), **others, **moved)
    assert counted.other_flops == 2 * (1 + 2 * 14 + 15)


def test_opponents_on_sequences_by_hand():
    # 100 steps, 2 channels, 3 dilations: 8 additions each; 10 channels in all convolutions: 4 additions, a product.
    rocket = FixedConvolutions(samples=100, channels=2, dilations=3, convolved=10, biases=20).cost()
    assert (rocket.macs, rocket.acs) == (0, 100 * (8 * 3 * 2 + 4 * 10 + 20))
    assert (rocket.other_flops, rocket.parameters) == (100 * (10 + 20) + 20, 20)
    assert rocket.multiplications == 100 * 10 + 20
    # 8 samples: a window, an FFT of 8 * 3 products and 36 additions, 8 squares and sums, the logarithm of 2 bands.
    bands = BandPowers(samples=8, bands=2, channels=3).cost()
    assert (bands.macs, bands.acs, bands.other_flops) == (3 * 8, 3 * (36 + 8), 3 * (24 + 8 + 16))
    pooled = PooledStates(units=4, steps=10).cost()
    assert (pooled.acs, pooled.multiplications, pooled.comparisons) == (40, 4, 40)


def test_trees_by_hand():
    """A comparison at each inner node on the way; of two classes, two sums a tree; three numbers a node pair."""
    forest = ExtraTreesClassifier(2, random_state=0).fit(np.arange(4.0)[:, None], [0, 0, 1, 1])
    depth = mean_depth(forest, np.arange(4.0)[:, None])
    assert depth == np.mean([tree.tree_.max_depth for tree in forest.estimators_]) == 1.0
    spent = Trees(trees=2, depth=depth, nodes=6, classes=2).cost()
    assert (spent.acs, spent.other_flops, spent.parameters) == (4, 2, 12)


def drawn_costs(is_ordered: bool) -> Opponent:
    """Settings that classify alike and cost 3, 1 and 2."""

    def layers(fitted, x):
        return (flops.Dense(1, fitted.n_neighbors),)

    return Opponent(
        "Alike.", KNeighborsClassifier, [{"n_neighbors": k} for k in (3, 1, 2)], layers=layers, is_ordered=is_ordered
    )


@pytest.mark.parametrize(("is_ordered", "chosen"), [(True, 3), (False, 1)])
def test_the_cheapest_of_equals_is_chosen_where_a_grid_is_in_no_order(is_ordered, chosen):
    x, y = np.repeat([[0.0], [9.0]], 8, axis=0), np.repeat([0, 1], 8)
    assert best_of(drawn_costs(is_ordered), Sides(x, x, x, y, y, y), 0).fitted.n_neighbors == chosen


def test_a_decision_that_is_not_counted_has_no_cost_but_its_signal():
    sides, before = sides_of(0), Cost(macs=5, signal_ms=20.0)
    counted = best_of(load("kNN"), sides, 0)
    assert counted.spent(before)["macs"] == 5 + 24 * 3
    columns = counted._replace(layers=None).spent(before)
    assert columns.pop("signal_ms") == 20.0
    assert columns.keys() == counted.spent(before).keys() - {"signal_ms"}
    assert np.isnan([*columns.values()]).all()


def test_what_an_estimator_leaves_open_is_the_seed_and_what_it_sets_stays():
    sides = sides_of(0)
    tree = ("tree", ExtraTreesClassifier(3))
    for build, seeds in ((lambda: Pipeline([tree]), (5, 5)), (lambda: ExtraTreesClassifier(3, random_state=2), (2, 2))):
        fitted = best_of(Opponent("Trees.", build), sides, 5).fitted
        found = {value for key, value in fitted.get_params().items() if key.endswith("random_state")}
        assert found == {seeds[0]}


def test_validation_examples_reach_an_estimator_that_takes_them():
    seen = []

    class Stopping:
        def fit(self, x, y, validation=None):
            seen.append(validation)

        def predict(self, x):
            return np.zeros(len(x), int)

    sides = sides_of(0)
    best_of(Opponent("Stops.", Stopping), sides, 0)
    assert seen[0][0] is sides.validation
    assert seen[0][1] is sides.y_validation


@pytest.mark.parametrize(
    ("given", "why"),
    [({"takes": "feature"}, "takes: 'feature' is unknown; did you mean"), ({"joins": "ever"}, "joins: 'ever'"),
     ({"build": None}, r"Opponent\.build: must be a function"), ({"layers": (1,)}, r"Opponent\.layers")],
)  # fmt: skip
def test_an_opponent_that_cannot_be_is_refused(given, why):
    with pytest.raises(InputError, match=why):
        Opponent(**{"about": "", "build": KNeighborsClassifier, **given})
