"""The compliance chain: what it computes by hand, and who may see test data (`paper`) and who may not (`honest`)."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.compliance import protocol as compliance
from neurotact_parts.studies.compliance.curve_features import FEATURES
from neurotact_parts.studies.compliance.protocol import (
    Parameters,
    Sides,
    decision_cost,
    fit_kmeans,
    load,
    run,
    sides_of,
    task,
    vectors_of,
)
from neurotact_parts.studies.compliance.simulator import CHANNELS, ComplianceSpec

SMALL = ComplianceSpec(trials=6, sampling_rate_Hz=30.0)
MAX, H1 = FEATURES.index("MAX"), FEATURES.index("H1")


def finger_m00(**columns: np.ndarray) -> np.ndarray:
    """Features `(example, curve, 4)` that are 0 but for the named columns of the finger's M00."""
    features = np.zeros((len(next(iter(columns.values()))), len(CHANNELS), 4))
    for name, values in columns.items():
        features[:, CHANNELS.index("finger M00"), FEATURES.index(name)] = values
    return features


def accuracy_of(parameters, features, labels, components=0, moments=1, combination="d8"):
    """Test accuracy of one case, by default of the two features MAX and H1 of one moment."""
    sides = sides_of(labels, parameters.protocol, parameters.seed)
    vectors = vectors_of(parameters, features, sides, moments, combination, components)
    fitted = fit_kmeans(parameters, vectors, labels, sides)
    return float((fitted.predict(vectors.test) == labels[sides.test]).mean())


def planted(protocol, **options):
    return Parameters(protocol=protocol, sensors="finger", repetitions=20, **options)


@pytest.fixture(scope="module")
def arrays():
    return load(SMALL)


@pytest.fixture(scope="module")
def results(arrays):
    rows = []
    for protocol in ("honest", "paper"):
        for sensors in ("finger", "finger and palm"):
            for components in ((0,), (3,)):
                cell = Parameters(
                    data=SMALL,
                    protocol=protocol,
                    sensors=sensors,
                    component_counts=components,
                    moment_counts=(1, 4),
                    combinations=("d5",) if any(components) else ("d5", "d13"),
                    repetitions=3,
                )
                rows += run(cell, arrays)
    return pd.DataFrame(rows)


# --- what is computed -----------------------------------------------------------------------------------


def test_words_and_components_by_hand():
    # Full scale 255 at 8 bits: a code a unit. On the diagonal, the component is the distance along it.
    features = finger_m00(
        MAX=np.array([1.0, 101.2, 200.6, 254.7, 255.0]), H1=np.array([0.8, 100.9, 201.1, 255.0, 254.9])
    )
    everyone = np.arange(5)
    sides = Sides(everyone, everyone, everyone, everyone)
    parameters = planted("honest", bits=8)
    codes = vectors_of(parameters, features, sides, 1, "d8", 0).train
    assert codes.tolist() == [[1, 1], [101, 101], [201, 201], [255, 255], [255, 255]]
    scores = vectors_of(parameters, features, sides, 1, "d8", 1).train[:, 0]
    mean = (1 + 101 + 201 + 255 + 255) / 5
    expected = np.sqrt(2.0) * (codes[:, 0] - mean)
    np.testing.assert_allclose(np.abs(scores), np.abs(expected), atol=1e-9)
    assert np.sign(scores[0]) != np.sign(scores[-1])


def test_the_scale_spans_all_curves_and_not_only_those_that_are_used():
    features = finger_m00(MAX=np.array([1.0, 2.0]), H1=np.array([3.0, 4.0]))
    features[0, CHANNELS.index("palm M20"), FEATURES.index("AR")] = 2550.0
    both = np.arange(2)
    codes = vectors_of(planted("honest", bits=8), features, Sides(both, both, both, both), 1, "d8", 0).train
    assert codes.tolist() == [[0, 0], [0, 0]]


def test_inputs_are_sensors_times_moments_times_features(arrays):
    sides = sides_of(arrays["labels"], "honest", 0)
    for sensors, factor in (("finger", 1), ("palm", 1), ("finger and palm", 2)):
        for moments, combination, each in ((1, "d5", 2), (4, "d11", 3), (6, "d15", 4)):
            seen = vectors_of(Parameters(sensors=sensors), arrays["features"], sides, moments, combination, 0)
            assert seen.train.shape[1] == factor * moments * each
            assert compliance.n_features(sensors, moments, combination) == factor * moments * each


def test_cost_of_a_decision_by_hand():
    parameters = Parameters(sensors="finger")
    found = decision_cost(parameters, 1, "d5", 0)
    assert found.macs == 42 * 2
    assert found.acs == 44 * 1165 + 1165 + 42 * 2  # M00, AR, distances
    assert found.other_flops == 1165 + 42  # the instant of MAX, the least distance
    assert found.signal_ms == pytest.approx(1e3 * 1165 / 485)
    early = decision_cost(Parameters(sensors="finger and palm"), 2, "d8", 3)
    assert early.signal_ms == pytest.approx(1e3 * 583 / 485)  # known when the movement turns
    assert early.macs == (44 + 256) * 583 + 8 * 3 + 42 * 3


def test_published_split_sizes():
    labels = np.repeat([f"OBJ-{i}" for i in range(1, 43)], 47)
    honest, paper = (sides_of(labels, protocol, 0) for protocol in ("honest", "paper"))
    assert len(honest.test) == len(paper.test) == 673
    np.testing.assert_array_equal(honest.test, paper.test)
    assert len(paper.train) == 1301
    counts = np.unique(labels[honest.test], return_counts=True)[1]
    assert set(counts) == {16, 17}
    everyone = np.concatenate([honest.train, honest.choose, honest.test])
    assert sorted(everyone) == list(range(1974))


def test_rows_say_which_case_they_are(results):
    assert set(results["moments"]) == {1, 4}
    with_pca = results["components"] == 3
    assert (results.loc[with_pca, "inputs"] == 3).all()
    # Two features of the finger's M00 have no third component.
    assert results[with_pca & (results["sensors"] == "finger") & (results["moments"] == 1)].empty
    assert results["accuracy_test"].between(0, 1).all()
    assert results.loc[results["protocol"] == "paper", "accuracy_validation"].isna().all()
    named = results[results["accuracy_published"].notna()]
    case = named[(named["sensors"] == "finger and palm") & (named["moments"] == 1)]
    assert set(case["combination"]) == {"d5"}
    assert set(zip(case["components"], case["accuracy_published"], strict=True)) == {(0, 0.945), (3, 0.946)}


def test_honest_chooses_a_combination_on_validation(results):
    for (protocol, _, _), rows in results[results["components"] == 0].groupby(["protocol", "sensors", "moments"]):
        assert rows["chosen"].sum() == 1
        by = "accuracy_test" if protocol == "paper" else "accuracy_validation"
        assert rows.loc[rows["chosen"], by].iloc[0] == rows[by].max()


def test_a_cell_repeats_bit_for_bit(arrays):
    cell = Parameters(data=SMALL, moment_counts=(2,), combinations=("d5",), repetitions=2)
    assert run(cell, arrays) == run(cell, arrays)


def test_figures_are_drawn(results, arrays):
    drawn = list(compliance.draw(results, arrays))
    names = [figure.name for figure in drawn]
    assert len(set(names)) == len(names) == 10
    assert {"compliance-table-3", "compliance-merit-4", "compliance-confusion-3"} <= set(names)
    assert all(figure.figure.axes and figure.caption and figure.alt for figure in drawn)
    marked = next(figure for figure in drawn if figure.name == "compliance-table-3")
    assert "chosen on test data" in marked.caption
    without = results[(results["components"] == 0) & (results["protocol"] == "paper")]
    assert [figure.name for figure in compliance.draw(without, arrays)].count("compliance-confusion-0") == 0


def test_task_gives_features_and_sequences_of_every_exploration():
    found = task(SMALL)
    n_steps = SMALL.n_samples // compliance.TASK_STEP
    assert found.features.shape == (252, 36)
    assert found.sequences.shape == (252, n_steps, 12)
    assert found.sequences.dtype == np.float32
    assert found.sampling_rate_Hz == 6.0
    assert len(set(found.labels)) == 42
    assert len(set(found.groups)) == 252
    # Divided by their mean weights, all moments are read as M00 is.
    peaks = found.sequences.max(axis=1).mean(axis=0)
    assert peaks.max() / peaks.min() < 2


# --- who sees test data -----------------------------------------------------------------------------------


def two_classes():
    return np.repeat(["egg", "can"], 100)


def test_scale_fitted_on_test_vectors_leaks():
    """Test vectors are three times as large: on the training scale both features saturate, and nothing is left."""
    labels = two_classes()
    test = sides_of(labels, "honest", 0).test
    size = np.linspace(0.8, 1.0, len(labels))
    size[test] *= 3.0
    first, second = np.where(labels == "egg", 1.0, 0.5), np.where(labels == "egg", 0.5, 1.0)
    size[test] = np.maximum(size[test], 2.0)
    features = finger_m00(MAX=first * size, H1=second * size)
    chance = 0.5
    assert accuracy_of(planted("honest", bits=8), features, labels) == pytest.approx(chance, abs=0.02)
    assert accuracy_of(planted("paper", bits=8), features, labels) == 1.0


def test_components_fitted_on_test_vectors_leak():
    """In training the largest spread is a nuisance that both classes share; among test vectors it is the class."""
    labels = two_classes()
    sides = sides_of(labels, "honest", 0)
    is_egg = labels == "egg"
    of_class, nuisance = np.zeros(len(labels)), np.zeros(len(labels))
    for side, (egg, can) in ((sides.train, (40, 60)), (sides.choose, (40, 60)), (sides.test, (0, 100))):
        for members, value in ((side[is_egg[side]], egg), (side[~is_egg[side]], can)):
            of_class[members] = value
            nuisance[members] = np.linspace(20, 80, len(members))
    features = finger_m00(MAX=of_class, H1=nuisance)
    assert accuracy_of(planted("honest", bits=16), features, labels, components=1) == pytest.approx(0.5, abs=0.03)
    assert accuracy_of(planted("paper", bits=16), features, labels, components=1) == 1.0


def test_repetition_chosen_on_test_vectors_leaks():
    """Vectors are noise and labels are drawn: what is above chance was chosen."""
    found = {"honest": [], "paper": []}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        labels = rng.permutation(np.repeat(["egg", "can", "cup", "jar"], 30))
        features = rng.uniform(0, 1, (120, len(CHANNELS), 4))
        for protocol, accuracies in found.items():
            parameters = Parameters(protocol=protocol, sensors="finger", repetitions=60, seed=seed)
            accuracies.append(accuracy_of(parameters, features, labels, moments=6, combination="d15"))
    n_test = 6 * 41
    deviation = np.sqrt(0.25 * 0.75 / n_test)
    assert abs(np.mean(found["honest"]) - 0.25) < 3 * deviation
    assert np.mean(found["paper"]) > 0.25 + 3 * deviation


@pytest.mark.parametrize("components", [0, 3])
def test_nothing_fitted_by_honest_knows_the_test_vectors(arrays, components):
    changed = {}
    for protocol in ("honest", "paper"):
        parameters = Parameters(protocol=protocol, repetitions=3, bits=8)
        sides = sides_of(arrays["labels"], protocol, 0)
        other = arrays["features"].copy()
        other[sides.test] *= 1.7
        before, after = (vectors_of(parameters, f, sides, 4, "d5", components) for f in (arrays["features"], other))
        fitted = [fit_kmeans(parameters, v, arrays["labels"], sides) for v in (before, after)]
        same_vectors = np.array_equal(before.train, after.train)
        changed[protocol] = not (same_vectors and np.array_equal(fitted[0].centroids_, fitted[1].centroids_))
    assert changed == {"honest": False, "paper": True}
