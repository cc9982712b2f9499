"""The stiffness protocol: its data, its splits, its rows and figures."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.stiffness import protocol as stiffness

from neurotact.errors import InputError
from neurotact.studies import loading

SMALL = {"simulation": {"placements": 5, "grasps": 4}}
NETWORK = {"neurons": (5, 10), "n_max": (5, 10), "exponents": (-2, 0), "draws": 2, "epochs": 5}


@pytest.fixture(scope="module")
def data():
    return stiffness.StiffnessData.model_validate(SMALL)


@pytest.fixture(scope="module")
def arrays(data):
    return stiffness.load(data)


def parameters(data, **changes):
    given = {"data": data, "classifier": "R-ELM", "features": "8F", "splits": 2, "network": NETWORK}
    return stiffness.Parameters.model_validate({**given, **changes})


def test_every_grasp_gives_a_peak(arrays):
    assert arrays["peaks"].shape == (60, 150, 4)
    assert arrays["features"].shape == (60, 16)
    assert int(arrays["unfelt"]) == 0
    assert {label: int((arrays["labels"] == label).sum()) for label in ("SR", "HR", "RW")} == {
        "SR": 20, "HR": 20, "RW": 20,
    }  # fmt: skip
    assert len(np.unique(arrays["placement"])) == 15


def test_whole_placements_stand_on_one_side(arrays):
    labels, placement = arrays["labels"], arrays["placement"]
    for split in stiffness.splits_of(labels, placement, "by placement", 3, 0):
        sides = [set(placement[side]) for side in split]
        assert sum(map(len, sides)) == len(set.union(*sides)) == 15
        assert sorted(np.concatenate(split)) == list(range(60))
    mixed = stiffness.splits_of(labels, placement, "honest", 3, 0)
    assert any(set(placement[split.train]) & set(placement[split.test]) for split in mixed)


def test_rows_carry_accuracy_and_the_costs_of_the_unit(data, arrays):
    rows = pd.DataFrame(stiffness.run(parameters(data), arrays))
    assert rows[["split", "n_max"]].values.tolist() == [[0, 5], [0, 10], [1, 5], [1, 10]]
    assert set(stiffness.VIEW.by) | set(stiffness.VIEW.measures) <= set(rows.columns)
    assert (rows["test_trials"] == rows["n_test"]).all()
    assert (rows["n_train"] > 3 * rows["n_test"]).all()
    assert (rows["n_train"] + rows["n_validation"] + rows["n_test"] == 60).all()
    # Table I: 4224 before the classifier at 8F; Table II: 24 a neuron for an R-ELM.
    assert (rows["flops"] == 4224 + 24 * rows["neurons"]).all()
    assert (rows["signal_ms"] == 75.0).all()
    assert stiffness.run(parameters(data), arrays) == rows.to_dict("records")


def test_the_papers_rule_and_ours_differ(data, arrays):
    found = {
        rule: [row["accuracy_test"] for row in stiffness.run(parameters(data, protocol=rule), arrays)]
        for rule in ("honest", "paper", "by placement")
    }
    assert found["honest"] != found["by placement"]
    assert {len(rows) for rows in found.values()} == {4}


def test_placements_that_are_split_as_a_whole_are_trials(data, arrays):
    for row in stiffness.run(parameters(data, protocol="by placement"), arrays):
        assert row["test_trials"] == row["n_test"] / 4  # 60 grasps of 15 placements
        assert row["validation_trials"] == row["n_validation"] / 4


def test_figures_are_drawn_from_part_of_a_sweep(data, arrays):
    rows = pd.DataFrame(stiffness.run(parameters(data), arrays))
    drawn = list(stiffness.draw(rows, arrays))
    assert [figure.name for figure in drawn] == ["trade-off", "by-n-max", "signals"]
    assert all(figure.caption and figure.alt for figure in drawn)


def test_the_task_keeps_placements_together(data):
    task = stiffness.task(data)
    assert task.features.shape == (60, 16)
    assert (task.sequences.shape, task.sequences.dtype) == ((60, 150, 4), np.float32)
    assert (task.sampling_rate_Hz, task.unit) == (2000.0, "mV")
    assert all(len(set(task.labels[task.groups == group])) == 1 for group in np.unique(task.groups))


def test_a_threshold_that_nothing_reaches_is_refused():
    data = stiffness.StiffnessData.model_validate(
        {"simulation": {"placements": 1, "grasps": 1}, "peaks": {"threshold": 100.0}}
    )
    with pytest.raises(InputError, match="no grasp reaches 100 mV"):
        stiffness.load(data)


def test_the_shipped_study_is_table_iii():
    study = loading.resolve("stiffness-slfn")
    assert len([*loading.engine_of(study).cells(study)]) == 5 * 3 * 3
    assert study.parameters["network"]["neurons"] == [25, 50, 100, 200, 300]
    assert study.parameters["network"]["n_max"] == [50, 100, 200, 300]
    assert study.parameters["network"]["exponents"] == list(range(-8, 9))
    assert (study.parameters["splits"], study.parameters["network"]["draws"]) == (10, 10)


@pytest.mark.parametrize("classifier", ["R-ELM", "H-ELM", "S-FC"])
def test_what_only_test_grasps_betray_is_at_chance(data, classifier):
    """Features without a class, but that the test grasps of each split carry their label: nobody may have seen it."""
    rng = np.random.default_rng(2)
    labels = np.repeat(["HR", "RW", "SR"], 40)
    code = np.repeat([0, 1, 2], 40)
    plain = {
        "labels": labels,
        "placement": np.arange(120),
        "peaks": np.zeros((120, 150, 4), np.float32),
        "sampling_rate_Hz": np.array(2000.0),
    }
    found = []
    for seed in range(6):
        split = stiffness.splits_of(labels, plain["placement"], "honest", 1, seed)[0]
        features = rng.standard_normal((120, 16))
        features[split.test, 3] += 3.0 * code[split.test]
        arrays = {**plain, "features": features}
        rows = stiffness.run(parameters(data, classifier=classifier, splits=1, seed=seed), arrays)
        found += [row["accuracy_test"] for row in rows]
    betrayed = {**plain, "features": rng.standard_normal((120, 16)) + 3.0 * code[:, None]}
    seen = stiffness.run(parameters(data, classifier="R-ELM", splits=1), betrayed)
    assert np.mean([row["accuracy_test"] for row in seen]) > 0.8
    assert abs(np.mean(found) - 1 / 3) < 0.12
