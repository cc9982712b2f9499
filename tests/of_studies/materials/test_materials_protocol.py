"""The protocol of the materials paper: its splits and counts, by hand and against leaks."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.opponents.kernel_machines import RBFExpansion
from neurotact_parts.opponents.targets import signed
from neurotact_parts.studies.materials import figures as materials_figures
from neurotact_parts.studies.materials import protocol as materials
from neurotact_parts.studies.materials.protocol import GRIDS, SETUPS, SHARES, Grid, Machines, Parameters
from neurotact_parts.studies.materials.simulator import ContactMaterialsSpec
from sklearn.svm import SVC

from neurotact.data.splits import SplitSpec, split_trials

SMALL = ContactMaterialsSpec(trials=4, frequencies_Hz=(15.0, 45.0), duration_s=0.2)
FEW = {
    "RELM": Grid((1.0, 0.01), hidden=(5, 25)),
    "RLS": Grid((1.0, 0.01), sigmas=(2.0, 0.5)),
    "SVM": Grid((1.0, 0.01), sigmas=(2.0, 0.5)),
}


@pytest.fixture(scope="module")
def arrays():
    return materials.load(SMALL)


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(materials, "GRIDS", {(c, n): grid for c, grid in FEW.items() for n in ("two", "four")})


def two_classes(seed, n=300):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)), rng.permutation(np.repeat([0, 1], n // 2))


@pytest.mark.parametrize(("n", "sizes"), [(300, [150, 50, 100]), (600, [300, 100, 200])])
def test_splits_are_those_of_the_paper(n, sizes):
    split = split_trials(np.arange(n) % (n // 150), SplitSpec(**SHARES))
    assert [len(part) for part in split] == sizes


def test_grids_are_those_of_the_paper():
    assert GRIDS["RELM", "two"].hidden[0] == 5
    assert GRIDS["RELM", "two"].hidden[-1] == 195
    assert len(GRIDS["RELM", "two"].penalties) == 32
    assert GRIDS["RELM", "four"].hidden == tuple(range(5, 301, 5))
    assert GRIDS["SVM", "two"].sigmas[0] == 4096
    assert GRIDS["SVM", "four"].sigmas[0] == 64
    assert sorted(1 / p for p in GRIDS["SVM", "four"].penalties) == [2.0**k for k in range(13)]
    assert (GRIDS["RLS", "four"].penalties[0], GRIDS["RLS", "four"].penalties[-1]) == (2**-3, 2**-12)


def test_setups_drop_force_and_frequency():
    assert SETUPS["A"] == ("frequency_Hz", "force_N", "phase_deg", "amplitude_mV")
    assert SETUPS["B"] == ("frequency_Hz", "phase_deg", "amplitude_mV")
    assert SETUPS["C"] == ("phase_deg", "amplitude_mV")


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("classifier", ["RELM", "RLS", "SVM"])
def test_rows_of_pairs_and_of_all(arrays, classifier):
    pairs = materials.run(Parameters(data=SMALL, classifier=classifier, setup="B"), arrays)
    assert [row["problem"] for row in pairs] == list(materials_figures.PUBLISHED_PAIRS)
    every = materials.run(Parameters(data=SMALL, classifier=classifier, classes="four"), arrays)
    assert [row["problem"] for row in every] == ["all"]
    for row in pairs + every:
        assert 0 <= row["error_test"] == pytest.approx(1 - row["accuracy_test"])
        assert row["signal_ms"] == 200.0
    again = materials.run(Parameters(data=SMALL, classifier=classifier, classes="four"), arrays)
    assert str(again) == str(every)


@pytest.mark.usefixtures("few")
def test_units_sum_over_the_machines():
    features, _ = two_classes(0, 600)
    indices = np.arange(600) % 4
    rls = materials.evaluate(Parameters(classifier="RLS", classes="four"), features, indices)
    relm = materials.evaluate(Parameters(classifier="RELM", classes="four"), features, indices)
    assert rls["units"] == 4 * 300
    assert relm["units"] == 4 * relm["units_per_machine"]


def test_support_vectors_are_those_of_every_machine():
    features, _ = two_classes(1, 80)
    indices = np.arange(80) % 3
    targets = signed(indices, indices.max() + 1)
    machines = next(materials.svm(features, targets, features, Grid((0.5,), (2.0,)), 0))
    by_hand = [SVC(C=2.0, gamma=1 / 8).fit(features, indices == c).support_.size for c in range(3)]
    assert list(machines.units) == by_hand


def test_rls_is_one_against_all_of_its_equations():
    features, _ = two_classes(2, 60)
    indices = np.arange(60) % 3
    targets, seen = signed(indices, indices.max() + 1), features[:7] + 0.1
    found = next(materials.rls(features, targets, seen, Grid((0.25,), (1.5,)), 0)).scores

    def kernel(a, b):
        return np.exp(-((a[:, None] - b[None]) ** 2).sum(axis=-1) / (2 * 1.5**2))

    beta = np.linalg.solve(kernel(features, features) + 0.25 * np.eye(60), targets)
    np.testing.assert_allclose(found, kernel(seen, features) @ beta, atol=1e-10)


def test_of_equal_errors_the_fewest_units_win_then_the_first():
    scores = np.array([[1.0], [-1.0]])
    tried = [Machines(Grid((p,)), units, scores) for p, units in ((3.0, (9,)), (2.0, (5,)), (1.0, (5,)))]
    worse = Machines(Grid((4.0,)), (1,), -scores)
    best = materials.least_error([worse, *tried], np.array([1, 0]))
    assert best.settings.penalties == (2.0,)


def test_a_tested_machine_is_the_validated_one():
    """The chosen machine, fitted again to be tested, gives on validation patterns what it was chosen for."""
    features, indices = two_classes(3)
    targets = signed(indices, indices.max() + 1)
    for classifier, family in materials.FAMILIES.items():
        for machines in family(features, targets, features, FEW[classifier], 5):
            alone = next(family(features, targets, features, machines.settings, 5))
            np.testing.assert_allclose(alone.scores, machines.scores, atol=1e-9)
            assert alone.units == machines.units


def test_costs_by_hand():
    relm = materials.cost_of("RELM", (10,), 4)
    assert (relm.macs, relm.other_flops) == (10 * 4 + 10, 10 * 14)
    assert materials.cost_of("RLS", (300,) * 4, 2) == RBFExpansion(300, 2, outputs=4).cost()
    assert materials.cost_of("SVM", (30, 20), 2).macs == 50 * 2 + 50


# --- leaks --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("classifier", ["RELM", "RLS", "SVM"])
def test_labels_at_random_are_at_chance(classifier):
    errors = []
    for seed in range(12):
        features, indices = two_classes(seed)
        errors.append(materials.evaluate(Parameters(classifier=classifier, seed=seed), features, indices)["error_test"])
    assert np.mean(errors) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(12 * 100))


@pytest.mark.parametrize("classifier", ["RELM", "RLS", "SVM"])
def test_labels_that_only_test_statistics_tell_are_at_chance(classifier, few):
    """Of the test patterns alone, those above their own median are of class 1: a scaler fitted on them would tell."""
    errors, informed = [], []
    for seed in range(6):
        features, indices = two_classes(seed)
        test = split_trials(indices, SplitSpec(**SHARES, seed=seed)).test
        features[test] = 0.3 + 1e-3 * (2 * indices[test, None] - 1) + 1e-5 * features[test]
        errors.append(materials.evaluate(Parameters(classifier=classifier, seed=seed), features, indices)["error_test"])
        alone = (features[test, 0] > np.median(features[test, 0])).astype(int)
        informed.append((alone != indices[test]).mean())
    assert np.mean(informed) == 0
    assert np.mean(errors) == pytest.approx(0.5, abs=0.03)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("classifier", ["RELM", "RLS", "SVM"])
def test_test_patterns_change_nothing_but_the_test_error(classifier):
    features, indices = two_classes(4)
    parameters = Parameters(classifier=classifier)
    before = materials.evaluate(parameters, features, indices)
    features[split_trials(indices, SplitSpec(**SHARES)).test] *= 1e3
    after = materials.evaluate(parameters, features, indices)
    kept = [key for key in before if key not in ("error_test", "accuracy_test")]
    assert str({key: before[key] for key in kept}) == str({key: after[key] for key in kept})


# --- figures ------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("few")
def test_figures_are_drawn_for_what_a_run_holds(arrays):
    rows = [
        {"classes": classes, "classifier": "RLS", "setup": setup, "seed": 0, **row}
        for classes in ("two", "four")
        for setup in ("A", "C")
        for row in materials.run(Parameters(data=SMALL, classifier="RLS", setup=setup, classes=classes), arrays)
    ]
    table = pd.DataFrame(rows)
    assert [d.name for d in materials.draw(table, arrays)] == [
        "waveforms",
        "patterns",
        "two-class-errors",
        "multiclass",
    ]
    alone = list(materials.draw(table[table.classes == "four"], arrays))
    assert [d.name for d in alone] == ["waveforms", "patterns", "multiclass"]
    titles = [
        axes.get_title() for axes in next(d for d in materials.draw(table, arrays) if "two" in d.name).figure.axes
    ]
    assert titles == ["Set-up A", "Set-up C"]


def test_published_tables_have_their_printed_averages():
    """Tables I to III print averages of their columns, rounded to 0.1 point."""
    printed = {"A": (2.3, 3.0, 3.2), "B": (5.0, 3.2, 3.5), "C": (9.2, 4.7, 4.8)}
    for setup, averages in printed.items():
        columns = np.array([errors[setup] for errors in materials_figures.PUBLISHED_PAIRS.values()])
        np.testing.assert_allclose(100 * columns.mean(axis=0), averages, atol=0.051)
