"""Model selection of the five networks: what is chosen, on which examples, and that no test example is looked at."""

import numpy as np
import pytest
from costs import operations
from levels import thinned
from neurotact_parts.studies.published_flops import preprocessing_flops, slfn_flops
from neurotact_parts.studies.stiffness.slfn_chain import (
    CLASSIFIERS,
    BinaryInputDense,
    PowerOfTwoDense,
    SLFNSpec,
    choices,
    unit_cost,
)

from neurotact.data.splits import SplitSpec, split_trials
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, cost

SMALL = SLFNSpec(neurons=(5, 10), n_max=(5, 10), exponents=(-2, 0, 2), draws=2, epochs=60, batch=16)


def blobs(n=90, features=4, distance=4.0, seed=0):
    rng = np.random.default_rng(seed)
    labels = np.repeat(["HR", "RW", "SR"], n // 3)
    return rng.standard_normal((n, features)) + distance * np.eye(3, features)[np.repeat([0, 1, 2], n // 3)], labels


def split(labels, n=2):
    return [split_trials(labels, SplitSpec(seed=2 * i)) for i in range(n)]


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_a_row_a_split_and_n_max_and_classes_that_lie_apart_are_told_apart(classifier):
    X, y = blobs()
    rows = choices(classifier, X, y, split(y), SMALL, seed=0)
    assert [(row.split, row.n_max) for row in rows] == [(0, 5), (0, 10), (1, 5), (1, 10)]
    assert all(row.neurons <= row.n_max for row in rows)
    assert np.mean([row.accuracy_test for row in rows]) > 0.7
    assert choices(classifier, X, y, split(y), SMALL, seed=0) == rows


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_more_candidates_are_never_worse_on_validation(classifier):
    X, y = blobs(distance=1.0)
    for few, many in zip(*[iter(choices(classifier, X, y, split(y), SMALL, seed=0))] * 2, strict=True):
        assert many.accuracy_validation >= few.accuracy_validation


def test_ties_go_to_fewer_neurons():
    X, y = blobs(distance=40.0)
    spec = SMALL.model_copy(update={"neurons": (20, 40), "n_max": (40,)})
    for row in choices("R-ELM", X, y, split(y), spec, seed=0):
        assert row.accuracy_validation == 1.0
        assert row.neurons == 20


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_test_examples_decide_nothing(classifier):
    """Other test examples change neither what is chosen nor how it does on validation."""
    X, y = blobs(distance=1.0)
    sides = split(y, 1)
    rows = choices(classifier, X, y, sides, SMALL, seed=0)
    changed, relabelled = X.copy(), y.copy()
    changed[sides[0].test] = 100.0 * np.random.default_rng(9).standard_normal((len(sides[0].test), 4))
    relabelled[sides[0].test] = np.roll(y[sides[0].test], 1)
    others = choices(classifier, changed, relabelled, sides, SMALL, seed=0)
    for row, other in zip(rows, others, strict=True):
        assert (row.neurons, row.accuracy_validation) == (other.neurons, other.accuracy_validation)
    # The paper's order of things, normalising before splitting, is what this test can see.
    leaky = choices(classifier, changed, y, sides, SMALL, seed=0, standardise_on="all")
    assert [r.accuracy_validation for r in leaky] != [r.accuracy_validation for r in rows]


@thinned("classifier", CLASSIFIERS)
def test_labels_that_only_test_examples_betray_are_at_chance(classifier):
    """A label planted in the test examples alone: whoever chooses by them beats chance by far, this chain does not."""
    rng = np.random.default_rng(5)
    y = np.repeat(["HR", "RW", "SR"], 60)
    X = rng.standard_normal((len(y), 6))
    spec = SMALL.model_copy(update={"draws": 3, "epochs": 30})
    sides = split(y, 6)
    planted, leaked = [], []
    for side in sides:
        felt = X.copy()
        felt[side.test, 5] += 3.0 * np.unique(y, return_inverse=True)[1][side.test]
        rows = choices(classifier, felt, y, [side], spec, seed=1)
        planted += [row.accuracy_test for row in rows]
        # The same networks, had the test examples been the training examples.
        leaky = side._replace(train=side.test, validation=side.test)
        leaked += [row.accuracy_test for row in choices(classifier, felt, y, [leaky], spec, seed=1)]
    assert np.mean(leaked) > 0.55
    assert abs(np.mean(planted) - 1 / 3) < 0.08


@pytest.mark.parametrize(
    ("classifier", "extra"), [("S-ELM", 0), ("R-ELM", -1), ("H-ELM", 0), ("S-FC", 0), ("R-FC", -1)]
)
def test_the_unit_costs_what_the_paper_says_and_the_standardisation(classifier, extra):
    """The paper leaves out standardising (a MAC a feature) and takes two FLOPs for a ReLU; the ledger one."""
    unit = unit_cost(classifier, samples=150, channels=4, order=2, neurons=51, n_classes=3, signal_ms=75)
    published = preprocessing_flops("8F") + slfn_flops(classifier, 51, 8, 3)
    assert unit.flops == published + 2 * 8 + 51 * extra
    assert unit.signal_ms == 75


def test_no_candidate_is_refused():
    with pytest.raises(InputError, match="allows none"):
        SLFNSpec(neurons=(100,), n_max=(50,))


def test_h_elm_by_hand():
    # 3 features to 2 hard-limit units: 6 shifts, 6 additions, 2 comparisons; 6 weights of a byte, 2 biases of four.
    hidden = cost(PowerOfTwoDense(3, 2))
    assert operations(hidden) == operations(Cost(acs=6, comparisons=8, parameters=8, bytes=14))
    # 2 zeros or ones to 3 classes: 6 additions.
    of_bits = cost(BinaryInputDense(2, 3, bias=False))
    assert operations(of_bits) == operations(Cost(acs=6, parameters=6, bytes=24))
