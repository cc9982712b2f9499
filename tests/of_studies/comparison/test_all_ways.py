"""One task, all ways: rows of families, tasks that are left out, and the figures."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.comparison import by_list
from neurotact_parts.studies.comparison import protocol as all_ways
from neurotact_parts.studies.comparison import spiking as spiking_family
from neurotact_parts.studies.comparison.protocol import Parameters, TaskSpec
from neurotact_parts.studies.comparison.tasks import split_groups
from neurotact_parts.studies.touch_modality import recurrent

from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule
from neurotact.networks.training.tasks import Task, sides_of
from neurotact.networks.training.trainer import new_network

TINY = TaskSpec(
    task="gratings",
    examples=60,
    settings={
        "gratings": {
            "simulation": {"trials": 10, "pitches_mm": [4.0, 1.0], "forces_N": [12.0], "duration_s": 0.5},
            "length_ms": 200.0,
        }
    },
)


@pytest.fixture(scope="module")
def arrays():
    return all_ways.load(TINY)


@pytest.fixture(autouse=True)
def short_training(monkeypatch):
    short = RSNNSpec.model_validate({"recipe": "default", "hidden": 8, "training": {"epochs": 2}})
    monkeypatch.setattr(spiking_family, "TRIED", (short,))
    monkeypatch.setattr(recurrent, "TRAINING", {"epochs": 2, "batch": 16, "learning_rate": 0.01})


def test_the_task_is_on_the_clock_of_the_afferents(arrays):
    assert arrays["sequences"].shape == (40, 200, 8)
    assert float(arrays["sampling_rate_Hz"]) == 1000.0
    # A moving average over 400 samples of 8 taxels, then level, spread and rate: two MACs a sample and taxel.
    assert arrays["before_features"][0] == 2 * 400 * 8 + 8
    assert arrays["before_sequences"][1] == 400 * 8
    assert not any(array.dtype == object for array in arrays.values())


@pytest.mark.parametrize("family", ["ELM", "k-means", "GRU", "SNN"])
def test_rows_of_a_family(arrays, family):
    rows = all_ways.run(Parameters(data=TINY, family=family), arrays)
    assert [row["family"] for row in rows] == (["SNN", "SNN, early exit"] if family == "SNN" else [family])
    for row in rows:
        assert row["skipped"] == ""
        assert 0 < row["energy_before_nJ"] < row["energy_estimate_nJ"]
        assert 0 < row["signal_ms"] <= 200.0
        assert (row["sops"] > 0) == (family == "SNN")
        assert row["n_test"] == 6
        assert row["test_trials"] == 6  # touches, each of its own group
        assert row["n_train"] > 12
        assert row["validation_trials"] == row["n_validation"] == row["examples"] - row["n_train"] - row["n_test"]
        assert row["chance"] == 0.5
        energies = by_list.energies(pd.DataFrame([row])).iloc[0]
        assert energies["arithmetic-45nm"] == pytest.approx(row["energy_estimate_nJ"])
        assert (energies["memory-45nm"] != energies["memory-45nm-events"]) == (family == "SNN")
    assert all_ways.run(Parameters(data=TINY, family=family), arrays) == rows


def test_an_early_decision_updates_neurons_until_then_run_in_both_ways(arrays):
    task = all_ways.task_of(arrays)
    split = split_groups(task.labels, task.groups, 0)
    trains = spiking_family.encode(task, split.train)
    sides = sides_of(trains, Task(window=WindowSpec(length_ms=200.0, per_trial=1)), split)
    network, _ = new_network(trains, spiking_family.TRIED[0].of_model("snn"), (0, 1), sides.train.spikes)
    whole, early = (spiking_family._measure(network, trains, sides, rule) for rule in (FULL_WINDOW, ExitRule(20, True)))
    share = early[2].signal_ms / whole[2].signal_ms
    assert share < 0.9
    assert early[2].neuron_updates == pytest.approx(share * whole[2].neuron_updates)
    assert 0 < early[3].neuron_updates < min(early[2].neuron_updates, 0.95 * whole[3].neuron_updates)


def test_sequences_are_made_until_the_decision(arrays, monkeypatch):
    own, network = Cost(acs=10, signal_ms=50.0), Cost(acs=1, sops=1)
    decided = spiking_family.Decided("SNN", "", 1.0, 1.0, own, network, Cost(acs=5, sops=1))
    monkeypatch.setattr(spiking_family, "decide", lambda *_: [decided])
    (row,) = all_ways.run(Parameters(data=TINY, family="SNN"), arrays)
    # A quarter of 400 samples of 8 taxels, smoothed, and of their 200 means.
    assert row["macs"] == 100 * 8
    assert row["multiplications"] == 100 * 8 + 50 * 8
    assert row["acs"] == 100 * 8 + 10 + 1
    assert row["events_acs"] == 100 * 8 + 10 + 5
    whole = all_ways._as_cost(arrays["before_features"])
    assert whole.comparisons == 400 * 8
    assert whole.divisions == 8
    assert whole.bytes > 0


def test_a_task_whose_recordings_are_absent_is_left_out_with_a_sentence(tmp_path):
    data = TaskSpec(task="fabrics", settings={"fabrics": {"path": str(tmp_path / "nowhere")}})
    left_out = all_ways.load(data)
    assert list(left_out) == ["skipped"]
    (row,) = all_ways.run(Parameters(data=data, family="SVM"), left_out)
    assert row["skipped"].startswith("fabrics is left out: ")
    assert "nowhere" in row["skipped"]
    assert np.isnan(row["accuracy_test"])
    assert list(all_ways.draw(pd.DataFrame([{"task": "fabrics", **row}]), left_out)) == []


def test_a_wrong_setting_is_not_taken_for_absent_recordings():
    with pytest.raises(InputError, match="lenght_ms: unknown key"):
        all_ways.load(TaskSpec(task="fabrics", settings={"fabrics": {"lenght_ms": 5}}))


@pytest.mark.thorough
def test_figures_hold_a_panel_a_task(arrays):
    rows = [
        {"task": task, "seed": seed, **row}
        for task in ("gratings", "fabrics", "compliance", "stiffness")
        for seed in (0, 1)
        for family in ("ELM", "SNN")
        for row in all_ways.run(Parameters(data=TINY, family=family, seed=seed), arrays)
    ]
    drawn = list(all_ways.draw(pd.DataFrame(rows), arrays))
    assert [d.name for d in drawn] == ["accuracy-and-energy", "accuracy-and-parameters", "where-the-energy-goes"]
    for d in drawn:
        assert [axes.get_title() for axes in d.figure.axes] == ["gratings", "fabrics", "compliance", "stiffness"]
