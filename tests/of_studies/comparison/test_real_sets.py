"""All classifiers see the same windows and sides; a difference between two is taken seed by seed."""

import pandas as pd
import pytest
from neurotact_parts.studies.comparison import by_list, real_sets, sets
from neurotact_parts.studies.comparison.real_sets import (
    NETWORK_INPUT,
    Parameters,
    _points,
    draw_energy,
    draw_points,
    named,
    tables,
)

from neurotact.data.splits import SplitSpec, split_conditions
from neurotact.spec import build
from neurotact.studies import way_study
from neurotact.studies.loading import resolve
from neurotact.studies.way import ALL_SETS

SET = {
    "dataset": {"simulate": "gratings", "parameters": {"trials": 2, "duration_s": 0.4}},
    "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start", "resample_Hz": 200.0},
    "window": {"length_ms": 100.0, "start_ms": 250.0, "per_trial": 1}, "group": ["force_N"],
}  # fmt: skip


def asked(split="trials", **keys):
    network = {"recipe": "default", "hidden": 6, "training": {"epochs": 2, "patience": 2}}
    data = {"set": "made", "sets": {"made": SET}, "split": split}
    return build(Parameters, {"data": data, "network": network, **keys}, source="test")


def test_its_sets_are_those_of_ways_to_save_with_groups():
    ours, theirs = (resolve(name).parameters["data"]["sets"] for name in ("real-sets", "ways-to-save"))
    assert {name: {k: v for k, v in chosen.items() if k != "group"} for name, chosen in ours.items()} == {
        name: {k: v for k, v in theirs[name].items() if k != "group"} for name in ours
    }


def test_results_name_the_split_also_where_it_is_the_default():
    study = resolve("real-sets")
    found = [way_study.swept_values(study, cell) for cell in way_study.cells(study)]
    assert {(each["set"], each["split"]) for each in found} == {
        ("cubes", "trials"), ("cubes", "groups"), ("fabrics", "trials"), ("fabrics", "groups"), ("letters", "trials")
    }  # fmt: skip


@pytest.fixture(scope="module")
def rows():
    parameters = asked("groups")
    return real_sets.run(parameters, real_sets.load(parameters.data))


@pytest.mark.thorough
def test_networks_and_classifiers_on_signals_and_spikes_leave_a_row(rows):
    names = [(row["classifier"], row["input"]) for row in rows]
    # on three kinds of features of signals, and on two of spikes, four classifiers; two on the sequences of signals
    assert len(set(names)) == len(names) == 2 + 4 * 3 + 2 + 4 * 2
    assert names[:2] == [("RSNN", NETWORK_INPUT), ("SNN", NETWORK_INPUT)]
    assert ("GRU", "signals: 20 ms bins") in names
    assert {row["n_test"] for row in rows} == {rows[0]["n_test"]}
    assert {row["test_trials"] for row in rows} == {rows[0]["n_test"]}  # a window each
    assert {row["n_train"] for row in rows} == {rows[0]["n_train"]}
    assert {row["validation_trials"] for row in rows} == {row["n_validation"] for row in rows}
    assert len({row["n_validation"] for row in rows}) == 1
    assert len({row["signal_ms"] for row in rows}) == 1


@pytest.mark.thorough
def test_every_row_has_its_energy_by_every_price_list(rows):
    table = pd.DataFrame(rows)
    energies = by_list.energies(table)
    assert energies.notna().all(axis=None)
    assert energies["arithmetic-45nm"].to_numpy() == pytest.approx(table["energy_estimate_nJ"].to_numpy())
    apart = energies["memory-45nm"] != energies["memory-45nm-events"]
    assert apart.tolist() == [name in real_sets.MODELS for name in table["classifier"]]


@pytest.mark.thorough
def test_a_network_without_recurrence_has_no_recurrent_operations(rows):
    assert rows[1]["sops_recurrent"] == 0 < rows[0]["sops_recurrent"]
    assert rows[0]["parameters"] - rows[1]["parameters"] == 6 * 6


def test_by_group_no_group_stands_on_two_sides():
    parameters = asked("groups")
    arrays = real_sets.load(parameters.data)
    bench = sets.bench_of(parameters.data, parameters.network, 0, arrays)
    groups = [set(arrays["condition force_N"][side]) for side in bench.split]
    assert all(groups)
    assert not groups[0] & groups[2]
    assert not groups[1] & (groups[0] | groups[2])


def test_by_trial_the_split_is_as_without_groups():
    parameters = asked()
    arrays = real_sets.load(parameters.data)
    bench = sets.bench_of(parameters.data, parameters.network, 3, arrays)
    expected = split_conditions(pd.DataFrame({"label": arrays["condition label"]}), (), SplitSpec(seed=6))
    assert [side.tolist() for side in bench.split] == [side.tolist() for side in expected]


def test_a_set_without_groups_is_left_out_by_group(caplog):
    data = {"set": "made", "sets": {"made": {**SET, "group": []}}, "split": "groups"}
    parameters = build(Parameters, {"data": data}, source="test")
    (row,) = real_sets.run(parameters, real_sets.load(parameters.data))
    assert "names no group" in row["skipped"]
    assert row["skipped"] in caplog.text
    table = pd.DataFrame([{"set": "made", "split": "groups", **row}])
    assert named(table) == tables(table) == {}
    assert list(real_sets.draw(table, {})) == []


def table(values):
    """Rows of one set: accuracies by classifier and seed; validation accuracy the same, energy by the order."""
    return pd.DataFrame([
        {"set": "made", "split": "trials", "classifier": name, "input": words, "seed": seed, "n_train": 700,
         "n_test": 150, "accuracy_test": accuracy, "accuracy_validation": accuracy,
         "energy_estimate_nJ": 100.0 * (place + 1)}
        for place, ((name, words), accuracies) in enumerate(values.items()) for seed, accuracy in enumerate(accuracies)
    ])  # fmt: skip


def test_one_sentence_sets_the_best_network_beside_the_best_of_the_others():
    values = {
        ("RSNN", NETWORK_INPUT): [0.8, 0.85, 0.9], ("SNN", NETWORK_INPUT): [0.6, 0.6, 0.6],
        ("SVM", "spikes: counts"): [0.7, 0.75, 0.8], ("ELM", "spikes: counts"): [0.2, 0.25, 0.3],
    }  # fmt: skip
    (found,) = named(table(values)).values()
    assert found.headline == (
        "Spiking is more accurate: RSNN has 85.0 %, 10.0 points (95 % interval 6.1 to 13.9) more than SVM, spikes: "
        "counts, for 33 % of its energy, and nothing within the error of the best takes less."
    )
    assert found.details == ["RSNN, spikes: every step has 85.0 % at 100 nJ; SVM, spikes: counts has 75.0 % at 300 nJ."]
    names = {name: said for name, said in found.labels["energy_estimate_nJ"].items() if said}
    assert names == {
        ("RSNN", NETWORK_INPUT): f"RSNN, {NETWORK_INPUT} 85.0 %",
        ("SVM", "spikes: counts"): "SVM, spikes: counts 75.0 %",
    }  # fmt: skip
    assert found.labels["energy_estimate_nJ"].keys() == values.keys()


def test_a_rival_that_validation_cannot_tell_apart_decides_wherever_it_stands():
    values = {
        ("RSNN", "a"): [0.8] * 3, ("SVM", "signals: a"): [0.6, 0.7, 0.8], ("ELM", "signals: b"): [0.65] * 3,
    }  # fmt: skip
    rows = table(values)
    rows.loc[rows["classifier"] == "ELM", "accuracy_test"] = 0.9
    (found,) = named(rows).values()
    assert found.headline.startswith(
        "Spiking costs accuracy: RSNN has 80.0 %, 10.0 points (95 % interval 6.1 to 13.9) "
    )
    assert "less than ELM, signals: b, for 33 % of its energy" in found.headline
    assert found.details[1] == "Validation cannot tell 2 rivals apart."
    assert found.labels["energy_estimate_nJ"]["ELM", "signals: b"] == "ELM, signals: b 90.0 %"
    assert found.labels["energy_estimate_nJ"]["SVM", "signals: a"] == ""


def test_the_cheapest_within_the_error_of_the_best_ends_the_sentence_and_stands_in_the_table():
    values = {("RSNN", "a"): [0.8, 0.9, 0.8], ("SVM", "b"): [0.9, 0.8, 0.8], ("ELM", "c"): [0.8, 0.8, 0.8]}
    rows = table(values).replace({"energy_estimate_nJ": {100.0: 1000.0, 300.0: 30.0}})
    (found,) = named(rows).values()
    assert found.headline.endswith("its energy; ELM, c has 80.0 % for 3 % of that of RSNN.")
    ((best, *_),) = tables(rows).values()
    assert {"RSNN, a", "SVM, b", "ELM, c"} <= {*best.rows["configuration"].iloc[best.first].str.partition(": ")[0]}


@pytest.mark.parametrize(("n", "seeds"), [(1, "One seed"), (2, "2 seeds")])
def test_one_or_two_seeds_claim_nothing(n, seeds):
    values = {("RSNN", "a"): [0.8], ("SNN", "a"): [0.8], ("SVM", "a"): [0.9], ("ELM", "a"): [0.9]}
    (found,) = named(table({of: n * accuracy for of, accuracy in values.items()})).values()
    assert found.headline == (
        f"{seeds} cannot tell whether spiking is worth it: RSNN has 80.0 %, 10.0 points less than SVM, a, for 33 % of "
        "its energy."
    )
    assert not any("rivals" in said for said in found.details)


def test_a_rival_that_is_far_off_is_not_said_to_be_level_with_one_seed():
    values = {("RSNN", "a"): [0.8], ("SVM", "signals: a"): [0.9], ("ELM", "signals: a"): [0.2]}
    (found,) = named(table(values)).values()
    assert "less than SVM, signals: a" in found.headline
    assert not any("ELM" in said or "rivals" in said for said in (found.headline, *found.details))


def test_equal_differences_count_trials_and_not_their_windows():
    values = {("RSNN", "a"): [0.8, 0.85, 0.9], ("SVM", "a"): [0.7, 0.75, 0.8]}
    assert named(table(values))["made, trials"].headline.startswith("Spiking is more accurate: ")
    few = named(table(values).assign(test_trials=15))["made, trials"].headline
    assert few.startswith("Too few test trials to tell whether spiking costs accuracy")


def test_each_family_has_its_front_of_accuracy_over_energy():
    found = _points(table({("RSNN", "a"): [0.8, 0.9], ("SVM", "a"): [0.7, 0.7], ("SVM", "b"): [0.6, 0.6],
                          ("SVM", "c"): [0.9, 0.9]}))  # fmt: skip
    (axes,) = draw_energy(found).axes
    fronts = [line for line in axes.lines if line.get_linestyle() == "-"]
    assert fronts[1].get_xdata().tolist() == [200.0, 400.0]  # b costs more than a, and is less accurate
    assert axes.get_xscale() == "log"


def test_networks_are_filled_and_stand_where_their_accuracy_is():
    found = _points(table({("RSNN", "a"): [0.8, 0.9], ("SVM", "a"): [0.7, 0.7]}))
    assert found["accuracy_test"].to_numpy() == pytest.approx([0.85, 0.7])
    (axes,) = draw_points(found).axes
    marks = [line for line in axes.lines if line.get_marker() == "o"]
    assert [float(line.get_xdata()[0]) for line in marks] == pytest.approx([85.0, 70.0])
    assert [line.get_markerfacecolor() == "none" for line in marks] == [False, True]


def of_two_sets(n_seeds):
    values = {("RSNN", NETWORK_INPUT): [0.8] * n_seeds, ("SVM", "signals: a"): [0.6] * n_seeds}
    again = {("RSNN", NETWORK_INPUT): [0.7] * n_seeds, ("ELM", "signals: b"): [0.9] * n_seeds}
    return pd.concat([table(values), table(again).assign(set="other")], ignore_index=True)


def test_all_sets_are_told_first_each_with_its_network_and_rival():
    every, *others = named(of_two_sets(4)).items()
    assert every[0] == ALL_SETS
    assert [name for name, _ in others] == ["made, trials", "other, trials"]
    assert every[1].headline == (
        "Of 2 sets and splits the network is clearly more accurate than its rival on 1 (made, trials) and clearly less "
        "accurate on 1 (other, trials); it takes 0.5 times the rival's energy."
    )
    assert every[1].labels["signal_ms"] == {
        ("made", "trials", "RSNN", NETWORK_INPUT): "made, trials", ("made", "trials", "SVM", "signals: a"): "",
        ("other", "trials", "RSNN", NETWORK_INPUT): "other, trials", ("other", "trials", "ELM", "signals: b"): "",
    }  # fmt: skip
    (listed,), *_ = tables(of_two_sets(4)).values()
    assert listed.rows["set, split"].tolist() == ["made, trials", "other, trials"]
    assert listed.rows["rival"].tolist() == ["SVM, signals: a 60.0 %", "ELM, signals: b 90.0 %"]
    assert [cell.split()[0] for cell in listed.rows["points more"]] == ["+20.0", "-20.0"]


@pytest.mark.parametrize(
    ("others", "said"),
    [
        (["SVM"], "; it takes 0.5 times the rival's energy, where that is counted."),
        (["SVM", "ELM"], " (other, trials)."),
    ],
)
def test_an_energy_that_is_not_counted_is_left_out_of_the_sentence_on_all_sets(others, said):
    rows = of_two_sets(4)
    rows.loc[rows["classifier"].isin(others), "energy_estimate_nJ"] = float("nan")
    assert named(rows)[ALL_SETS].headline.endswith(said)


def test_the_next_step_is_more_splits_until_there_are_enough_for_an_interval():
    for n_seeds, step in ((2, "study run real-sets"), (4, "study run ways-to-save")):
        said = named(of_two_sets(n_seeds))
        assert [step in "".join(one.next[1]) for one in said.values()] == [True, False, False]  # told once
        (alone,) = named(table({("RSNN", "a"): [0.8] * n_seeds, ("SVM", "signals: a"): [0.6] * n_seeds})).values()
        assert step in alone.next[1][0]
        assert ("cannot tell" in said[ALL_SETS].headline) == (n_seeds == 2)
