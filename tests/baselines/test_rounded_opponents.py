"""Opponents with parameters as narrow as those of the C export."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from neurotact_parts.opponents import minirocket as rocket
from neurotact_parts.opponents import pooled_gru
from neurotact_parts.opponents.scikit_learn import EXTRA_TREES
from sklearn.neighbors import KNeighborsClassifier

from neurotact import plugins
from neurotact.baselines import opponents
from neurotact.baselines.opponent import Opponent, Sides, best_of, load, rounded
from neurotact.data.windows import Windows
from neurotact.metrics.flops import Cost

MACHINES = {"support_vectors_", "_dual_coef_", "_intercept_"}
BIASES = {"intercept_", "_intercept_", "hidden_biases_", "biases_"}
PARAMETERS = BIASES | {"coef_", "hidden_weights_", "input_weights_", "recurrent_weights_", "centroids_", "_fit_X",
                       "X_fit_", "dual_coef_"}  # fmt: skip
"""What a decision of an estimator reads: as the laws below ask, and not as the rounding has it."""
FAMILIES = [name for name in plugins.names("opponents") if plugins.load("opponents", name, Opponent).tells == "classes"]


def sides_of(takes, seed=0):
    """Three noisy classes."""
    rng, made, labels = np.random.default_rng(seed), [], []
    for n in (45, 24, 60):
        labels.append(np.arange(n) % 3)
        shape = (4,) if takes == "features" else (20, 2)
        made.append(rng.normal(size=(n, *shape)) + 0.7 * labels[-1].reshape(-1, *[1] * len(shape)))
    return Sides(*made, *labels)


@pytest.fixture(scope="module")
def fitted():
    """Each opponent with its sides and its estimator, small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rocket, "FEATURES", 84)
        patch.setattr(pooled_gru, "GRU_HIDDEN", (6,))
        found = {}
        for name in FAMILIES:
            one = load(name)
            sides = sides_of(one.takes)
            found[name] = one, sides, next(iter(one.candidates(sides, 0))).fitted
    return found


def numbers(part, bits):
    """The rounded arrays of an estimator and its parts, by name, and the bits of each."""
    if hasattr(part, "network_"):
        own = part.network_.named_parameters()
        return {name: (one.detach().numpy(), bits * (1 if one.ndim > 1 else 2)) for name, one in own}
    if hasattr(part, "estimators_"):
        trees = [tree.tree_ for tree in part.estimators_]
        inner = [tree.threshold[tree.children_left >= 0] for tree in trees]
        shares = np.concatenate([tree.value.ravel() for tree in trees])
        return {"thresholds": (np.concatenate(inner), bits), "shares": (shares, bits)}
    if hasattr(part, "transform_"):
        biases = np.concatenate([one.biases for one in part.transform_.convolutions_])
        return {"biases": (biases, 2 * bits), **numbers(part.ridge_, bits)}
    arrays = vars(part.steps[-1][1] if hasattr(part, "steps") else part)
    own = MACHINES if "_dual_coef_" in arrays else PARAMETERS
    return {name: (arrays[name], bits * (2 if name in BIASES else 1)) for name in own & arrays.keys()}


@given(
    arrays(st.sampled_from([np.float64, np.float32]), st.integers(1, 30), elements=st.floats(-6e4, 6e4, width=16)),
    st.floats(0.1, 1.0),
    st.integers(2, 20),
)
def test_what_is_rounded_is_on_few_values_near_its_own_and_stays(values, scale, bits):
    values = (values * scale).astype(values.dtype)
    once = rounded(values, bits)
    half = 0.5 * np.abs(values).max() / (2 ** (bits - 1) - 1)
    assert np.abs(once - values.astype(float)).max() <= half * (1 + 1e-5) + np.abs(values).max() * 2.0**-20
    assert once.dtype == values.dtype
    assert len(np.unique(once)) <= 2**bits
    np.testing.assert_array_equal(rounded(once, bits), once)
    np.testing.assert_array_equal(rounded(-values, bits), -once)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_rounded_opponent_has_few_numbers_and_rounding_it_again_changes_none(fitted, family):
    opponent, sides, one = fitted[family]
    before = one.predict(sides.test)
    for bits in (3, 8):
        narrow = opponent.rounded(one, sides.train, bits)
        found, again = numbers(narrow, bits), numbers(opponent.rounded(narrow, sides.train, bits), bits)
        assert found
        for name, (values, width) in found.items():
            assert len(np.unique(values)) <= 2**width, name
            np.testing.assert_array_equal(again[name][0], values, err_msg=name)
    np.testing.assert_array_equal(one.predict(sides.test), before)
    assert numbers(one, 8).keys() == found.keys()


@pytest.mark.parametrize("family", FAMILIES)
def test_many_bits_change_no_decision_and_two_do(fitted, family):
    opponent, sides, one = fitted[family]
    decided = one.predict(sides.test)
    wide = opponent.rounded(one, sides.train, 24)
    np.testing.assert_array_equal(wide.predict(rounded(sides.test, 48, of=sides.train)), decided)
    assert (opponent.rounded(one, sides.train, 2).predict(sides.test) != decided).any()


class Narrow:
    """What stands for a rounded copy: wrong in some windows; keeps what it was made of and what it was given."""

    def __init__(self, *made):
        self.made = made

    def predict(self, x):
        self.given = x
        return np.arange(len(x)) % 2


def rows_of(opponent, is_last=False):
    """The row of an opponent on one feature that tells two classes."""
    labels = np.repeat([0, 1], 15)
    features = labels[:, None] + np.linspace(0, 0.4, 30)[:, None]
    windows = Windows(np.arange(30), np.zeros(30, int), 10)
    sides = tuple(np.arange(30) % 3 == side for side in range(3))
    cuts = opponents.Cuts(windows, 1000.0, sides)
    cuts = cuts._replace(last=cuts if is_last else None)
    one = opponents.Input("signals", "level", None, features, Cost(), {"one": opponent})
    return next(opponents.rows([one], labels, cuts)), labels, sides


def test_the_rounded_copy_is_judged_on_rounded_inputs_and_where_there_is_none_nothing_is_known():
    made = []

    def narrow(*given):
        made.append(Narrow(*given))
        return made[-1]

    opponent = Opponent("Nearest.", lambda: KNeighborsClassifier(1), rounded=narrow)
    row, labels, sides = rows_of(opponent)
    assert (row["accuracy_validation"], row["accuracy_test"]) == (1.0, 1.0)
    for side, one, name in zip(sides[1:], made, ("validation", "test"), strict=True):
        right = np.arange(10) % 2 == labels[side]
        assert row[f"accuracy_{name}_8bit"] == right.mean() == 0.6
        by_trial = dict(zip(np.flatnonzero(side).tolist(), right.tolist(), strict=True))
        assert row[opponents.RIGHT][f"{name}_8bit"] == by_trial
        estimator, x, bits = one.made
        assert (type(estimator), bits) == (KNeighborsClassifier, 8)
        np.testing.assert_array_equal(one.given, rounded(one.given, 16, of=x))
        assert len(one.given) == 10
    row, *_ = rows_of(Opponent("Nearest.", lambda: KNeighborsClassifier(1)))
    assert np.isnan([row["accuracy_validation_8bit"], row["accuracy_test_8bit"]]).all()
    assert [*row[opponents.RIGHT]] == ["validation", "test"]


class Wrong:
    """A classifier that is wrong in the first windows of two classes, in a given number of them; it notes each fit."""

    def __init__(self, index, n_wrong, fits):
        self.index, self.n_wrong, self.fits = index, n_wrong, fits

    def fit(self, x, y):
        self.fits.append(self.index)

    def predict(self, x):
        right = (x[:, 0] > 0).astype(int)
        return np.concatenate([1 - right[: self.n_wrong], right[self.n_wrong :]])


def wrong_in(wrong, fits):
    """An opponent whose candidates are wrong in so many windows, with 32 bits and with 8."""
    return Opponent(
        "Wrong.",
        lambda index: Wrong(index, wrong[index][0], fits),
        [{"index": index} for index in range(len(wrong))],
        rounded=lambda one, x, bits: Wrong(one.index, wrong[one.index][1], fits),
    )


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=6))
@example([(0, 3), (2, 1), (1, 0), (0, 0)])
@example([(1, 2), (1, 2)])
def test_validation_chooses_among_the_same_candidates_with_8_bits(wrong):
    """The first of the most accurate at each width; none is fitted after both make no error."""
    fits = []
    row, *_ = rows_of(wrong_in(wrong, fits))
    perfect = [n for n in range(1, len(wrong) + 1) if all(0 in best for best in zip(*wrong[:n], strict=True))]
    tried = wrong[: perfect[0]] if perfect else wrong
    assert fits == [*range(len(tried))]
    for width, ours in zip(("", "_8bit"), zip(*tried, strict=True), strict=True):
        assert row[f"settings{width}"] == f"index {ours.index(min(ours))}"
        assert row[f"accuracy_validation{width}"] == row[f"accuracy_test{width}"] == pytest.approx(1 - min(ours) / 10)


def test_each_choice_is_fitted_again_once_for_the_last_training():
    fits = []
    row, *_ = rows_of(wrong_in([(0, 5), (3, 1)], fits), is_last=True)
    assert fits == [0, 1, 0, 1]
    assert (row["accuracy_test"], row["accuracy_test_8bit"]) == (1.0, 0.9)
    rows_of(wrong_in([(0, 0), (3, 1)], fits), is_last=True)
    assert fits[4:] == [0, 0]


def test_all_trees_have_one_step():
    sides = sides_of("features")
    one = best_of(EXTRA_TREES, sides, 0).fitted
    values = numbers(EXTRA_TREES.rounded(one, sides.train, 4), 4)["thresholds"][0]
    steps = values / np.abs(values[values != 0]).min()
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
