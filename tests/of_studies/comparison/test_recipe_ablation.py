"""Each change alters what it names alone; differences are taken seed by seed, beside the recipe."""

import numpy as np
import pandas as pd
import pytest
from neurotact_parts.studies.comparison import recipe_ablation as ablation
from neurotact_parts.studies.comparison.recipe_ablation import (
    WHOLE,
    Parameters,
    _changes,
    draw_changes,
    named,
    tables,
    variants,
)

from neurotact.errors import InputError
from neurotact.metrics.resampled import DIFFERENCES, resampled_interval
from neurotact.networks.definition import recipe
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import build
from neurotact.studies.loading import resolve

SET = {
    "dataset": {"simulate": "gratings", "parameters": {"trials": 1, "duration_s": 0.4}},
    "conditioning": {"ema_cutoff_Hz": 30.0, "baseline": "start", "resample_Hz": 500.0},
    "window": {"length_ms": 100.0, "start_ms": 250.0, "per_trial": 1},
}  # fmt: skip


def asked(**keys):
    network = {"recipe": "default", "hidden": 8, "training": {"epochs": 3, "patience": 3}}
    return build(
        Parameters, {"data": {"set": "made", "sets": {"made": SET}}, "network": network, **keys}, source="test"
    )


WHOLE_SPEC = recipe.resolve(RSNNSpec(recipe="default", hidden=8), recipe.Seen(900, 150, 500.0, 2.0))


def test_every_shipped_choice_is_of_the_recipe_and_changes_what_it_names_alone():
    parameters = resolve("recipe-ablation").parameters
    every = flat(WHOLE_SPEC)
    found = variants(WHOLE_SPEC, asked(without=parameters["without"], instead=parameters["instead"]))
    assert found
    for name, spec in found.items():
        changed = {key for key, value in flat(spec).items() if value != every[key]}
        named = parameters["without"].get(name.removeprefix("without ")) or parameters["instead"][name]
        assert changed <= set(named)
        assert changed


def test_its_sets_are_those_of_ways_to_save():
    ours, theirs = (resolve(name).parameters["data"]["sets"] for name in ("recipe-ablation", "ways-to-save"))
    assert ours == theirs


def flat(spec):
    return {**dict(spec), **{f"training.{key}": value for key, value in spec.training}, "training": None}


def test_what_changes_nothing_has_no_network():
    same = {"instead": {"as it is": {"readout": WHOLE_SPEC.readout}, "other": {"readout": "count"}}}
    assert list(variants(WHOLE_SPEC, asked(**same))) == ["other"]


def test_a_key_that_is_taken_away_is_that_of_a_network_without_a_recipe():
    without = {"a": ["tau_mem_ms", "training.relative_learning_rate"], "b": ["input_deviation"]}
    found = variants(WHOLE_SPEC, asked(without=without))
    plain = RSNNSpec()
    assert found["without a"].tau_mem_ms == plain.tau_mem_ms != WHOLE_SPEC.tau_mem_ms
    assert found["without a"].training.relative_learning_rate is None
    assert found["without a"].tau_syn_ms == WHOLE_SPEC.tau_syn_ms
    assert found["without b"].input_deviation is None


@pytest.mark.parametrize("keys", [{"without": {"a": ["tau_men_ms"]}}, {"instead": {"a": {"tau_men_ms": 5.0}}}])
def test_a_misspelt_key_is_named(keys):
    with pytest.raises(InputError, match="tau_me"):
        variants(WHOLE_SPEC, asked(**keys))


def test_the_recipe_and_each_change_leave_a_row():
    parameters = asked(
        without={"readout": ["readout"]}, instead={"feed-forward": {"model": "snn"}, "recurrent": {"model": "rsnn"}}
    )
    rows = ablation.run(parameters, ablation.load(parameters.data))
    assert [row["change"] for row in rows] == [WHOLE, "without readout", "feed-forward", "recurrent"]
    assert rows[2]["sops_recurrent"] == 0 < rows[3]["sops_recurrent"]
    assert len({row["input_spikes"] for row in rows}) == 1
    again = ablation.run(parameters, ablation.load(parameters.data))
    assert again == rows


def test_the_recipe_beside_changes_does_not_depend_on_which_they_are():
    arrays = ablation.load(asked().data)
    alone = ablation.run(asked(), arrays)
    beside = ablation.run(asked(instead={"wide": {"hidden": 12}}), arrays)
    assert beside[0] == alone[0]


def test_a_set_that_is_not_at_hand_is_left_out(tmp_path):
    absent = {"dataset": {"read": "braille-letters", "path": str(tmp_path / "none.npz")}}
    parameters = build(Parameters, {"data": {"set": "absent", "sets": {"absent": absent}}}, source="test")
    (row,) = ablation.run(parameters, ablation.load(parameters.data))
    assert "absent is left out" in row["skipped"]
    table = pd.DataFrame([{"set": "absent", **row}])
    assert named(table) == tables(table) == {}
    assert list(ablation.draw(table, {})) == []


def table(values):
    """Rows of one set: accuracies by change and seed, SOPs 1000, or 250 without the recipe."""
    return pd.DataFrame([
        {"set": "made", "change": change, "seed": seed, "accuracy_test": accuracy, "n_train": 700, "n_test": 150,
         "sops_total": 1000.0 if change == WHOLE else 250.0}
        for change, accuracies in values.items() for seed, accuracy in enumerate(accuracies)
    ])  # fmt: skip


def test_losses_are_taken_seed_by_seed():
    found = _changes(table({WHOLE: [0.9, 0.7, 0.8], "worse": [0.8, 0.6, 0.7], "none": [0.9, 0.7, 0.8]}))
    assert found["lost"].to_numpy() == pytest.approx([0.1, 0.0])
    ends = [resampled_interval([lost] * 3, 700, 150, DIFFERENCES) for lost in (0.1, 0.0)]  # every seed loses as much
    assert found["low"].to_numpy() == pytest.approx([end.low for end in ends])
    assert found["high"].to_numpy() == pytest.approx([end.high for end in ends])
    assert found["share"].to_numpy() == pytest.approx(0.25)
    assert found["accuracy_test"].to_numpy() == pytest.approx([0.7, 0.8])


def test_a_seed_that_only_one_of_them_has_is_left_out():
    found = _changes(table({WHOLE: [0.9, 0.7], "worse": [0.8, 0.6, 0.0]}))
    assert found["lost"].item() == pytest.approx(0.1)
    assert found["seeds"].item() == 2


def test_a_recipe_without_changes_is_told_and_draws_nothing():
    alone = table({WHOLE: [0.9, 0.8]})
    assert named(alone)["made"].headline == "No change was tried on the recipe (85.0 %)."
    assert named(alone)["made"].labels["sops_total"] == {(WHOLE,): WHOLE}
    assert list(ablation.draw(alone, {})) == []


VALUES = {
    WHOLE: [0.8, 0.8, 0.8], "much": [0.5, 0.5, 0.5], "little": [0.7, 0.8, 0.9], "better": [0.9, 0.9, 0.9],
    "more": [0.7, 0.7, 0.7], "most": [0.4, 0.4, 0.4],
}  # fmt: skip


def within(lost):
    """The points of a change that each of three seeds loses or gains alike, with their interval."""
    low, high = sorted(100 * end for end in resampled_interval([abs(lost)] * 3, 700, 150, DIFFERENCES)[1:])
    return f"{100 * abs(lost):.1f} points (95 % interval {low:.1f} to {high:.1f})"


@pytest.mark.parametrize(
    ("changes_of", "said"),
    [
        (
            VALUES,
            f"Change the recipe (80.0 %): 1 of 5 changes is clearly better: 'better', {within(-0.1)} gained.",
        ),
        (
            {name: VALUES[name] for name in (WHOLE, "little", "much", "most")},
            f"Keep the recipe (80.0 %): 2 of 3 changes are clearly worse, most of all 'most', {within(0.4)} lost, and "
            "none is clearly better.",
        ),
        (
            {name: VALUES[name][:2] for name in (WHOLE, "much", "better")},
            "2 seeds cannot tell whether a change is better than the recipe (80.0 %): they reach from 'much', "
            "30.0 points lost, to 'better', 10.0 points gained.",
        ),
    ],
)
def test_one_sentence_says_whether_to_keep_the_recipe(changes_of, said):
    assert named(table(changes_of))["made"].headline == said


def test_without_a_clear_change_both_ends_are_told():
    found = named(table({WHOLE: [0.8, 0.8, 0.8], "a": [0.7, 0.8, 0.9], "b": [0.7, 0.8, 0.8]}))["made"]
    assert found.headline.startswith(
        "None of 2 changes is clearly better or worse than the recipe (80.0 %): they reach from 'b', 3.3 points (95 % "
        "interval -"
    )
    assert ") lost, to 'a', 0.0 points (95 % interval -" in found.headline
    assert found.details == [f"Clearly {how}, after correction for 2 changes: none." for how in ("worse", "better")]


def test_what_the_picture_names_stands_in_the_first_rows_of_the_table():
    rows = table(VALUES)
    ((listed,),) = tables(rows).values()
    first = listed.rows.iloc[listed.first]
    assert first["change"].tolist() == [WHOLE, "most", "much", "more", "better"]
    assert first["points gained"].str.partition(" ")[0].tolist() == ["-", "-40.0", "-30.0", "-10.0", "+10.0"]
    assert first["share of SOPs"].tolist() == ["100 %", *["25 %"] * 4]
    found = named(rows)["made"]
    names = {name: said for (name,), said in found.labels["sops_total"].items() if said}
    assert [*names] == [WHOLE, "most", "much", "more", "better"]
    assert names["most"].replace("\u00a0", " ") == "most \u221275 %, \u221240 points"
    assert found.details == [
        "Clearly worse, after correction for 5 changes: most, much, more.",
        "Clearly better, after correction for 5 changes: better.",
    ]


def test_a_mark_stands_where_the_loss_is():
    found = _changes(table({WHOLE: [0.9, 0.7], "worse": [0.8, 0.6], "one seed": [0.9]}))
    assert np.isnan(found["low"].iloc[1])
    figure = draw_changes(found)
    (axes,) = figure.axes
    x = axes.containers[0].lines[0].get_xdata()
    assert list(x) == pytest.approx([10.0, 0.0])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["worse", "one seed"]
