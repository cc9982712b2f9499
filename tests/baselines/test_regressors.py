"""The opponents that tell numbers: what they learn, what of it is chosen on validation, and what it costs."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.opponents import minirocket, pooled_gru, regressors, rounding
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVR
from test_opponents import CONDITIONS, cuts

from neurotact.baselines import opponents
from neurotact.baselines.opponent import Sides, accuracy, best_of, joined, part_of, right, standardised
from neurotact.baselines.opponents import Input
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.data.windows import WindowSpec
from neurotact.metrics.flops import Cost, Dense

FAMILIES = {one: takes for takes in ("features", "sequences", "signals") for one in joined(takes, "all", "numbers")}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(minirocket, "FEATURES", 168)
    monkeypatch.setattr(pooled_gru, "GRU_HIDDEN", (8, 4))
    monkeypatch.setattr(pooled_gru, "LEAST_STEPS", 200)


def inputs(takes, n=40):
    """Levels of two channels, as features or as sequences that rise to them."""
    levels = np.random.default_rng(0).uniform(-1, 1, (n, 2))
    if takes == "features":
        return levels, levels
    return levels, (levels[:, None] * np.linspace(0, 1, 12)[:, None] + 2.0).astype(np.float32)


def rows_of(name, labels, of):
    takes, made = FAMILIES[name], cuts(np.full(40, 20))._replace(tells="numbers")
    chosen = {name: joined(takes, "all", "numbers")[name]}
    return next(opponents.rows([Input("signals", "made up", None, of, Cost(), chosen)], labels, made))


def test_every_family_has_one_that_tells_numbers():
    assert [*FAMILIES] == [
        "ridge regression",
        "SVR",
        "extra trees regression",
        "GRU regression",
        "MiniRocket regression",
    ]
    assert [*joined("features", "linear", "numbers")] == ["ridge regression"]
    assert [*joined("sequences", "quick", "numbers")] == []


@pytest.mark.parametrize("n_told", [1, 2])
@pytest.mark.parametrize("name", FAMILIES)
def test_all_tell_what_is_there_in_any_unit_and_their_cost_is_known(name, n_told):
    levels, of = inputs(FAMILIES[name])
    row = rows_of(name, levels[:, :n_told], of)
    assert 0.6 < row["accuracy_test"] < 1
    assert row["accuracy_test_8bit"] == pytest.approx(row["accuracy_test"], abs=0.1)
    assert row["energy_estimate_nJ"] > 0 < row["bytes"]
    other = rows_of(name, 1024 * levels[:, :n_told] - 4096, of)
    assert other["accuracy_test"] == pytest.approx(row["accuracy_test"], abs=0.03)  # trees split otherwise for a bit
    assert np.mean([*row[opponents.RIGHT]["test"].values()]) == pytest.approx(row["accuracy_test"])


@pytest.mark.parametrize("name", FAMILIES)
def test_the_best_of_the_whole_grid_on_validation_is_chosen(name):
    """A score that is nowhere 0 is not an accuracy of 1, after which nothing else would be fitted."""
    levels, of = inputs(FAMILIES[name])
    labels = levels[:, :1] + np.random.default_rng(1).normal(0, 0.3, (40, 1))
    y = (labels - labels[:24].mean(axis=0)) / labels[:24].std(axis=0)
    parts = [np.arange(24), np.arange(24, 32), np.arange(32, 40)]
    sides = standardised(of, y, parts) if of.ndim == 3 else None
    if sides is None:
        scaler = StandardScaler().fit(of[:24])
        sides = Sides(*(scaler.transform(of[part]) for part in parts), *(y[part] for part in parts))
    opponent = joined(FAMILIES[name], "all", "numbers")[name]
    every = [accuracy(one, sides.validation, sides.y_validation) for one in opponent.candidates(sides, 0)]
    assert rows_of(name, labels, of)["accuracy_validation"] == max(every)


@given(st.sampled_from([1.0, 30.0]), st.sampled_from([0.1, 2.0]), st.sampled_from([0.1, 0.01]), st.integers(0, 9))
@examples(8)
def test_machines_of_all_numbers_are_those_of_libsvm(c, gamma, epsilon, seed):
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(30, 3)), rng.normal(size=(30, 2))
    found = regressors.RBFRegression(c, gamma, epsilon).fit(X, y)
    alone = [SVR(C=c, gamma=gamma, epsilon=epsilon).fit(X, each) for each in y.T]
    expected = np.stack([each.predict(X) for each in alone], axis=1)
    np.testing.assert_allclose(found.predict(X), expected, atol=2e-3)
    used = np.unique(np.concatenate([each.support_ for each in alone]))
    assert found.n_support_ == len(found.X_fit_) == len(used)
    assert regressors.SUPPORT_VECTORS.layers(found, X) == (RBFExpansion(len(used), 3, outputs=2, bias=True),)


def test_machines_share_a_kernel_and_their_margin_is_chosen(monkeypatch):
    levels, _ = inputs("features")
    y = np.sin(3 * levels)
    sides, made = Sides(levels[:24], levels[24:32], levels[32:], y[:24], y[24:32], y[32:]), []
    own = regressors.Kernel.of
    monkeypatch.setattr(regressors.Kernel, "of", lambda self, gamma: made.append(self) or own(self, gamma))
    found = list(regressors.SUPPORT_VECTORS.candidates(sides, 0))
    assert len({id(kernel) for kernel in made}) == 1
    assert {one.fitted.epsilon for one in found} == {*regressors.MARGINS}
    assert accuracy(best_of(regressors.SUPPORT_VECTORS, sides, 0), sides.test, sides.y_test) > 0.9
    again = found[0].again(sides)
    np.testing.assert_array_equal(again.fitted.predict(sides.test), found[0].fitted.predict(sides.test))


def test_a_number_more_costs_an_output_more():
    for name, takes in FAMILIES.items():
        levels, of = inputs(takes)
        opponent, (x, held) = joined(takes, "all", "numbers")[name], (of[:24], of[24:])
        one, two = (
            next(iter(opponent.candidates(Sides(x, held, held, y[:24], y[24:], y[24:]), 0)))
            for y in (levels[:, :1], levels)
        )
        dense = [layer for layer in two.layers if isinstance(layer, Dense)]
        assert all(layer.activation == "linear" for layer in dense)
        sizes = [layer.units for told in (one, two) for layer in told.layers if isinstance(layer, Dense)]
        sizes += [layer.outputs for told in (one, two) for layer in told.layers if isinstance(layer, RBFExpansion)]
        sizes += [layer.classes for told in (one, two) for layer in told.layers if hasattr(layer, "trees")]
        assert sizes == [1, 2], name


def test_a_gru_of_numbers_keeps_the_epoch_with_the_least_error_on_validation(monkeypatch):
    levels, of = inputs("sequences")
    held, errors = (of[24:], np.random.default_rng(1).normal(size=(16, 2))), []  # of noise: soon no better
    own = pooled_gru._judged

    def judged(outputs, labels):
        found = own(outputs, labels)
        errors.append(float(found[0])) if len(labels) == 16 and not outputs.requires_grad else None
        return found

    monkeypatch.setattr(pooled_gru, "_judged", judged)
    monkeypatch.setattr(pooled_gru, "LEARNED", 1e9)  # which ends the training of classes alone
    fitted = pooled_gru.PooledGRURegressor(hidden=4, epochs=12, random_state=0).fit(of[:24], levels[:24], held)
    told = torch.from_numpy(fitted.predict(held[0]))
    assert float(np.square(told.numpy() - held[1]).mean()) == pytest.approx(min(errors))
    assert (len(errors), fitted.epochs_) == (12, 12)


def test_a_penalty_of_minirocket_is_searched_on_a_part_and_fitted_to_all_numbers(monkeypatch):
    levels, of = inputs("signals")
    whole = minirocket.MiniRocketRegressor(84, random_state=0).fit(of, levels)
    monkeypatch.setattr(minirocket, "MOST_SEARCHED", 30)
    fitted = minirocket.MiniRocketRegressor(84, random_state=0).fit(of, levels)
    made = whole.transform_.transform(of).astype(float)
    expected = make_pipeline(StandardScaler(), Ridge(fitted.ridge_[-1].alpha)).fit(made, levels).predict(made)
    np.testing.assert_allclose(fitted.predict(of), expected, atol=1e-3)


def test_rounded_forests_tell_numbers_in_steps_of_their_largest():
    levels, _ = inputs("features")
    forest = regressors.ExtraTreesRegressor(20, random_state=0).fit(levels, 50 * levels)
    narrow = rounding.forest(forest, levels, 8)
    np.testing.assert_allclose(narrow.predict(levels), 50 * levels, atol=5)


@pytest.mark.parametrize("n", [1, 7, 30, 40])
def test_a_part_of_numbers_is_even_over_the_first_ones(n):
    both = np.random.default_rng(0).normal(size=(40, 2))
    ranks = both[:, 0].argsort().argsort()
    some = part_of(both, n)
    assert (np.diff(some) > 0).all()
    np.testing.assert_array_equal(np.sort(ranks[some]), np.linspace(0, 39, n).round() if n < 40 else np.arange(40))


def test_ridge_is_that_of_scikit_learn_and_its_score_one_less_the_squares():
    levels, of = inputs("features")
    row = rows_of("ridge regression", levels, of)
    assert row["settings"] == "alpha 0.01"
    found = Ridge(alpha=0.01).fit(of[:24], levels[:24]).predict(of[32:])
    scores = right(found / levels[:24].std(axis=0), levels[32:] / levels[:24].std(axis=0))
    assert row["accuracy_test"] == pytest.approx(float(scores.mean()), abs=1e-3)


@pytest.mark.parametrize("tells", ["classes", "numbers"])
def test_signals_spikes_and_events_are_given_to_those_that_tell_what_is_asked_for(tells):
    rng, steps = np.random.default_rng(0), 200
    made = cuts(np.full(40, steps), WindowSpec(length_ms=steps))._replace(tells=tells)
    rasters = (rng.random((40, steps, 2)) < 0.2).astype(np.uint8)
    events = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS)
    spikes = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), CONDITIONS, {"model": "lif"})
    signals = Recordings([*rng.normal(size=(40, steps, 1))], 1000.0, "mV", CONDITIONS)
    of = [opponents.signal_inputs(signals, made, "all")]
    of += [opponents.spike_inputs(trains, (1.0, 1.0), made, "all") for trains in (events, spikes)]
    for every in of:
        told = [one.tells for given in every for one in given.opponents.values()]
        assert {*told} == {tells}
