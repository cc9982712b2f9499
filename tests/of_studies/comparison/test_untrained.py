"""Remedies change what they name alone; what is tested is never trained on; gains are of the same value and seed."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_inputs import touches
from neurotact_parts.studies.comparison import touch_sets, untrained
from neurotact_parts.studies.comparison.remedy_answers import (
    CEILING,
    DEFAULT,
    NETWORK,
    NOTHING,
    draw_points,
    points,
)
from neurotact_parts.studies.comparison.set_arrays import as_arrays, from_arrays, joined
from neurotact_parts.studies.comparison.untrained import HALF, Parameters

from neurotact.data import hdf5
from neurotact.data.splits import split_conditions
from neurotact.errors import InputError
from neurotact.spec import build
from neurotact.studies import loading, study, way_study

SHIPPED = loading.resolve("untrained-conditions").parameters
REMEDIES = SHIPPED["remedies"]
MADE = {"parts": {"file": {"file": "touches.h5", "content": "made"}}, "keys": {"window.length_ms": 100.0}}
SMALL = {"network.training.epochs": 2, "network.training.patience": 2}


def asked(remedy, condition="day", value=0.0, **keys):
    table = {"data": {"set": "made", "sets": {"made": MADE}}, "condition": condition, "value": value}
    return build(Parameters, {**table, "remedy": remedy, "remedies": REMEDIES, "keys": SMALL, **keys}, source="test")


def made(condition="day"):
    """Thirty touches on five days, with halves for the ceiling."""
    return untrained._halved(touches(), asked(NOTHING, condition))


def cells_of(remedy, condition="day", value=0.0):
    return untrained._saved_cells(asked(remedy, condition, value), made(condition) if condition else touches())


def test_the_study_has_the_remedies_of_which_its_sentences_tell():
    assert {NOTHING, DEFAULT, CEILING} <= {*REMEDIES}
    assert [name for name, remedy in REMEDIES.items() if remedy["trained"]] == [CEILING]


def test_the_default_is_what_own_recordings_does_by_itself(tmp_path):
    hdf5.save_recordings(made(), tmp_path / "touches.h5")
    pair = f"sweep.{study.PAIR}"
    keys = {"split.test_where": {"day": 0.0}, "split.seed": 0, "seed": 0, pair: [[5, 5]], "network.hidden": 50}
    own = study.resolve("own-recordings", {**SMALL, "window.length_ms": 100.0, **keys}, data=tmp_path / "touches.h5")
    (theirs,) = study.cells(own)
    (ours,) = cells_of(DEFAULT)
    assert ours.augmentation is not None
    assert ours.choose_opposite
    assert ours.choose_grades
    assert REMEDIES[DEFAULT]["between"]
    assert ours.model_copy(update={"encoded_ms": None}) == theirs


@pytest.mark.parametrize("remedy", sorted({*REMEDIES} - {NOTHING, CEILING}))
def test_a_remedy_has_the_trials_of_nothing_and_changes_what_it_names(remedy):
    (plain,) = cells_of(NOTHING)
    for cell in cells_of(remedy):
        assert cell.split == plain.split
        changed = {name for name in type(cell).model_fields if getattr(cell, name) != getattr(plain, name)}
        named = {key for key, value in REMEDIES[remedy].items() if value != REMEDIES[NOTHING][key]}
        allowed = {"from_contact": {"window"}, "copies": {"augmentation"}, "between": set(),
                   "falling": {"encoder", "calibrate", "choose_opposite"},
                   "thresholds": {"encoder", "calibrate", "choose_grades"}}  # fmt: skip
        assert changed <= {"encoded_ms"}.union(*(allowed[key] for key in named))


def test_the_ceiling_tests_each_trial_once_and_trains_on_the_others():
    conditions = made().conditions
    (plain,) = cells_of(NOTHING)
    tested = split_conditions(conditions, (), plain.split).test
    halves = [split_conditions(conditions, (), cell.split) for cell in cells_of(CEILING)]
    assert sorted(np.concatenate([half.test for half in halves])) == tested.tolist()
    for half in halves:
        trained = np.concatenate([half.train, half.validation])
        assert not {*trained} & {*half.test}
        assert {*tested} - {*half.test} <= {*trained}


def test_copies_of_a_touch_are_in_one_half():
    once = touches(n_trials=12)
    signals = [*once.signals, *once.signals]
    twice = replace(once, signals=signals, conditions=pd.concat([once.conditions] * 2, ignore_index=True))
    halves = untrained._halved(twice, asked(NOTHING)).conditions[HALF].to_numpy()
    assert (halves[:12] == halves[12:]).all()


@pytest.mark.parametrize(
    "remedy", ["windows from contact", "calibration between conditions", CEILING], ids=lambda name: name.split()[0]
)
def test_what_changes_nothing_has_no_row(remedy):
    assert cells_of(NOTHING, "", "")
    assert cells_of(remedy, "", "") == []


@pytest.mark.parametrize("keys", [{"value": ""}, {"remedy": "the defalt"}])
def test_a_wrong_parameter_is_named(keys):
    with pytest.raises(InputError, match="|".join(keys)):
        asked(**{"remedy": NOTHING, **keys})


@pytest.mark.thorough
@pytest.mark.parametrize("remedy", [NOTHING, "copies in gain", CEILING])
def test_the_network_and_each_opponent_leave_a_row(remedy):
    arrays = as_arrays(touches())
    rows = untrained.run(asked(remedy), arrays)
    network = [row for row in rows if row["classifier"] == NETWORK]
    assert len(network) == (2 if remedy == CEILING else 1)
    assert sum(row["n_test"] for row in network) == 12  # six trials of two windows
    assert sum(row["test_trials"] for row in network) == 6
    assert {row["n_validation"] for row in rows} == {2 * row["validation_trials"] for row in rows}
    assert {row["split"] for row in rows} == {str(asked(remedy).value)}  # seeds test the same trials
    assert {"logistic regression", "SVM", "extra trees", "MiniRocket"} < {row["classifier"] for row in rows}
    assert {row["copies"] for row in rows} == {"gain" if remedy == "copies in gain" else "none"}
    assert all(0 <= row["accuracy_test"] <= 1 for row in rows)
    assert all(np.isnan(row["accuracy_validation"]) and row["validated"] > 0 for row in rows)
    pd.testing.assert_frame_equal(pd.DataFrame(untrained.run(asked(remedy), arrays)), pd.DataFrame(rows))


def test_a_set_that_is_not_at_hand_is_left_out(tmp_path):
    absent = {"parts": {"all": {"read": "fabricslide", "path": str(tmp_path / "none")}}}
    parameters = asked(NOTHING, data={"set": "absent", "sets": {"absent": absent}})
    (row,) = untrained.run(parameters, untrained.load(parameters.data))
    assert "absent is left out" in row["skipped"]
    table = pd.DataFrame([{"set": "absent", **row}])
    assert untrained.named(table) == untrained.tables(table) == {}
    assert list(untrained.draw(table, {})) == []


@given(st.lists(st.integers(1, 30), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 99))
@examples(5)
def test_recordings_are_the_same_after_they_were_arrays(lengths, n_taxels, seed):
    noise = np.random.default_rng(seed)
    signals = [noise.normal(size=(n, n_taxels)).astype(np.float32) for n in lengths]
    conditions = pd.DataFrame({"label": ["None"] * len(lengths), "speed": noise.random(len(lengths)), "who": "s1"})
    signals = [np.asfortranarray(signal) if seed % 2 else signal for signal in signals]
    given_ = replace(touches(n_trials=2), signals=signals, conditions=conditions, channels=())
    found = from_arrays(as_arrays(given_), given_.source)
    assert all(np.array_equal(*pair) for pair in zip(found.signals, given_.signals, strict=True))
    assert all(signal.flags.c_contiguous for signal in found.signals)
    pd.testing.assert_frame_equal(found.conditions.astype(object), given_.conditions.astype(object))
    assert (found.unit, found.sampling_rate_Hz, found.channels) == (
        given_.unit,
        given_.sampling_rate_Hz,
        given_.channels,
    )


def test_parts_of_a_set_follow_each_other():
    one, other = touches(n_trials=4), touches(n_trials=6, seed=1)
    both = joined([one, other])
    assert both.conditions["day"].tolist() == [*one.conditions["day"], *other.conditions["day"]]
    assert np.array_equal(both.signals[4], other.signals[0])


def test_the_accuracy_of_some_trials_counts_their_windows_alone():
    shares, trial_of = {0: 1.0, 1: 0.5, 2: 0.0}, np.array([0, 1, 1, 2])
    assert untrained._accuracy(shares, np.array([0, 1]), trial_of) == pytest.approx(2 / 3)
    assert np.isnan(untrained._accuracy(shares, np.array([], int), trial_of))


def saved(folder):
    hdf5.save_recordings(touches(), folder / "touches.h5")
    return folder / "touches.h5"


def test_a_file_is_tested_at_each_value_of_its_condition(tmp_path):
    path = saved(tmp_path)
    resolved = loading.resolve(
        "untrained-conditions", {"sweep.split.test_where.day": [0, 3], "window.length_ms": 80.0}, data=path
    )
    cells = [cell.built() for cell in way_study.cells(resolved)]
    assert {(cell.condition, cell.value) for cell in cells} == {("day", 0), ("day", 3)}
    assert {cell.seed for cell in cells} == {0, 1, 2}
    assert {cell.remedy for cell in cells} == {*REMEDIES}
    assert cells[0].data.chosen.keys == {"window": {"length_ms": 80.0}}
    assert len(touch_sets.load(cells[0].data)["lengths"]) == 30


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "`leave_out_each`.*speed, day"),
        ({"sweep.split.test_where.day": [0, 1], "split.order": "day"}, "split.order"),
        ({"sweep.split.test_where.day": [0, 1], "window.length_ms": 9000.0}, "shorten the window"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_before_anything_runs(keys, said, tmp_path):
    with pytest.raises(InputError, match=re.compile(said)):
        loading.resolve("untrained-conditions", keys, data=saved(tmp_path))


def table(accuracies, seen=0.9):
    """Rows of one task: accuracies by remedy, a list for each value with an entry for each seed; an opponent has 10
    points more.
    """
    return pd.DataFrame([
        {"set": "made", "condition": "speed", "tested": "made by speed", "value": float(value), "split": str(value),
         "n_train": 400, "n_test": 100, "remedy": remedy, "classifier": classifier, "input": "spikes", "seed": seed,
         "accuracy_test": accuracy + more, "accuracy_seen": seen, "validated": 0.5 + more, "sops_total": 1000.0,
         "accuracy_validation": 0.5, "energy_estimate_nJ": 100.0 / (1 + more), "signal_ms": 150.0, "ranked": False}
        for remedy, values in accuracies.items() for value, seeds in enumerate(values)
        for seed, accuracy in enumerate(seeds) for classifier, more in ((NETWORK, 0.0), ("SVM", 0.1))
    ])  # fmt: skip


FOUND = {NOTHING: [[0.5, 0.7], [0.3, 0.3]], DEFAULT: [[0.8, 0.8], [0.8, 0.8]], "gain": [[0.6, 0.8], [0.6, 0.6]],
         CEILING: [[0.9, 0.9], [0.9, 0.9]]}  # fmt: skip


def test_gains_are_of_the_same_value_and_seed():
    found = points(table(FOUND)).set_index(["classifier", "remedy"])
    gain = found.loc[(NETWORK, "gain")]
    assert gain["gained"] == pytest.approx(0.2)
    assert (gain["gained_low"], gain["gained_high"]) == pytest.approx((0.1, 0.3))
    assert (gain["low"], gain["high"]) == pytest.approx((0.6, 0.7))
    assert found.xs(NOTHING, level="remedy")["gained"].tolist() == pytest.approx([0.0, 0.0])


@given(st.randoms(use_true_random=False))
@examples(5)
def test_gains_do_not_depend_on_the_order_of_rows(random):
    rows = table(FOUND)
    order = list(range(len(rows)))
    random.shuffle(order)
    by = ["remedy", "classifier"]
    one, other = (points(each).sort_values(by, ignore_index=True) for each in (rows, rows.iloc[order]))
    pd.testing.assert_frame_equal(one, other)


def test_a_single_value_has_no_ends():
    found = points(table({name: values[:1] for name, values in FOUND.items()}))
    assert found[["low", "high", "gained_low", "gained_high"]].isna().all(axis=None)


def test_one_sentence_says_whether_the_default_gains_and_what_is_left():
    (found,) = untrained.named(table(FOUND)).values()
    assert found.headline == (
        "Remedies gain accuracy: the default has 80.0 % at untrained values of speed, 35.0 points more than nothing "
        "(100 test trials, p < 0.001); SVM on spikes has 90.0 % with the same remedies for 91 % of the network's "
        "energy; trained on such trials, too, the network has 90.0 %."
    )
    assert found.details == [
        "With nothing the network has 45.0 % at untrained values and 90.0 % at trained ones (45.0 points are lost).",
        "By default the network has 80.0 % at untrained values and 90.0 % at trained ones (10.0 points are lost).",
        "Of 1 others, 'gain' gains most, 20.0 points (10.0 to 30.0 over 2 values).",
        "Of opponents with the same remedies, the best on validation trials, SVM on spikes, has 90.0 %, 10.0 points "
        "more, at 90.9 % of the network's energy.",
    ]
    labels = found.labels["energy_estimate_nJ"]
    assert labels == {
        (NOTHING, NETWORK, "spikes"): "nothing 45.0 %", (DEFAULT, NETWORK, "spikes"): "the default 80.0 %",
        (DEFAULT, "SVM", "spikes"): "SVM on spikes 90.0 %", ("gain", NETWORK, "spikes"): "gain 65.0 %",
        (CEILING, NETWORK, "spikes"): "trained on it 90.0 %",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("of_default", "verdict"),
    [(0.9, "Remedies gain accuracy"), (0.3, "Remedies cost accuracy"), (0.62, "No clear gain")],
)
def test_a_gain_is_clear_over_the_values_or_is_not_said(of_default, verdict):
    rows = table({NOTHING: [[0.6], [0.62], [0.58], [0.6]], DEFAULT: [[of_default + 0.01 * at] for at in range(4)]})
    (found,) = untrained.named(rows).values()
    assert found.headline.startswith(verdict)
    difference = 100 * (of_default + 0.015 - 0.6)
    assert f", {abs(difference):.1f} points (95 % interval " in found.headline
    assert ("less than nothing" in found.headline) == (difference < 0)


def test_without_the_default_or_nothing_no_gain_is_said():
    for missing in (NOTHING, DEFAULT):
        rows = table({name: values for name, values in FOUND.items() if name != missing})
        (found,) = untrained.named(rows).values()
        assert found.headline.startswith(f"No gain is known, since '{missing}' has no results: under '")


def test_what_limits_the_answer_is_said():
    rows = table(FOUND)
    assert ["third value" in line for line in untrained.cautions(rows)] == [True]
    assert "one seed" in untrained.cautions(rows[rows["seed"] == 0])[-1]
    assert untrained.cautions(rows.assign(ranked=True)) == []
    assert untrained.cautions(rows.assign(condition="-")) == []


def test_a_table_has_a_row_for_each_remedy():
    ((listed,),) = untrained.tables(table(FOUND)).values()
    assert listed.rows["remedy"].tolist() == [*FOUND]
    assert listed.rows["best opponent"].tolist()[0] == "SVM: 55.0 %"
    assert [listed.rows["remedy"][row] for row in dict.fromkeys(listed.first)] == [NOTHING, DEFAULT, CEILING, "gain"]


def test_a_mark_stands_at_each_accuracy():
    figure = draw_points(points(table(FOUND)))
    (axes,) = figure.axes
    assert list(axes.containers[0].lines[0].get_xdata()) == pytest.approx([45.0, 80.0, 65.0, 90.0])
    assert [text.get_text() for text in axes.get_yticklabels()] == [*FOUND]
