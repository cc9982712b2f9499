"""Fronts and the sentences of what it costs to save, on points whose answer is known."""

import re

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.fronts import (
    COSTS,
    ENERGY,
    LONGEST,
    MINUS,
    NOTHING,
    REFRACTORY,
    answers,
    cautions,
    fronts,
    headline,
    labels,
    tables,
)

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.resampled import DIFFERENCES, compare_over_splits, resampled_interval
from neurotact.metrics.shares import wilson_interval


def table(points, seeds=3) -> pd.DataFrame:
    """points: way, setting, SOPs, validation and test accuracy; each seed is 1 point above the one before."""
    rows = [
        {
            "set": "made up", "way": way, "setting": setting, "seed": seed, "accuracy_validation": validation,
            "accuracy_test": test + 0.01 * seed, "sops_total": sops, "energy_estimate_nJ": 1.0, "signal_ms": 10.0,
            "n_train": 7000, "n_test": 1500,
        }
        for way, setting, sops, validation, test in points
        for seed in range(seeds)
    ]  # fmt: skip
    return pd.DataFrame(rows)


POINTS = [
    (NOTHING, "-", 1000.0, 0.90, 0.90),
    (REFRACTORY, "5 & 5 ms", 600.0, 0.89, 0.89),
    (REFRACTORY, "10 & 10 ms", 400.0, 0.80, 0.80),
    (REFRACTORY, "20 & 20 ms", 450.0, 0.70, 0.70),
    ("pruning", "50 %", 500.0, 0.88, 0.86),
    ("pruning", "75 %", 300.0, 0.85, 0.87),
    ("fewer taxels", "75 %", 800.0, 0.91, 0.91),
]


def test_fronts_are_of_points_that_none_beats():
    found = fronts(table(POINTS)).set_index(["way", "setting"])
    assert found.index[found["on_front"]].tolist() == [
        (REFRACTORY, "5 & 5 ms"), ("pruning", "75 %"), ("fewer taxels", "75 %")
    ]  # fmt: skip
    assert found.index[~found["on_own_front"]].tolist() == [(REFRACTORY, "20 & 20 ms"), ("pruning", "50 %")]
    row = found.loc[(REFRACTORY, "10 & 10 ms")]
    assert row["share"] == pytest.approx(0.4)
    assert row["accuracy_test"] == pytest.approx(0.81)
    assert (row["low"], row["high"]) == pytest.approx(resampled_interval([0.8, 0.81, 0.82], 7000, 1500)[1:])


def test_networks_that_are_all_right_have_the_interval_of_their_test_trials():
    rows = table([(NOTHING, "-", 1000.0, 1.0, 1.0), ("pruning", "50 %", 500.0, 1.0, 1.0)])
    rows = rows.assign(accuracy_test=1.0, n_train=70, n_test=15)
    of_windows, of_trials = (fronts(each).iloc[0] for each in (rows, rows.assign(test_trials=5)))
    # 15 windows, or the 5 trials that they are of, divided by 1/3 + 15/70.
    assert (of_windows["low"], of_windows["high"]) == pytest.approx(wilson_interval(1.0, 27))
    assert (of_trials["low"], of_trials["high"]) == pytest.approx(wilson_interval(1.0, 9))
    earlier = pd.concat([rows, rows.assign(set="own", test_trials=5)])  # a run of an earlier version beside another
    assert fronts(earlier)["low"].tolist() == pytest.approx([of_windows["low"]] * 2 + [of_trials["low"]] * 2)


def test_the_error_of_the_choice_is_that_of_the_validation_side():
    # A setting 1 point below validation's best is kept where few validation trials decide, and not where many do.
    points = [(NOTHING, "-", 1000.0, 0.90, 0.90), ("pruning", "50 %", 500.0, 0.89, 0.90)]
    rows = table(points).assign(n_train=7000, n_test=150)
    rows["energy_estimate_nJ"] = rows["sops_total"]
    few, many = rows.assign(n_validation=150), rows.assign(n_validation=6000)
    assert "pruning" in headline(few)
    assert "pruning" not in headline(many)
    assert headline(rows) == headline(few)  # an earlier run: as large as the test side
    by_trial = many.assign(validation_trials=100)  # 60 windows of each
    assert headline(by_trial) == headline(few)


def test_shares_are_of_the_same_seeds():
    rows = table(POINTS[:3])
    rows.loc[(rows["way"] == NOTHING) & (rows["seed"] == 0), "sops_total"] = 4000.0
    only = rows[(rows["seed"] == 0) | (rows["setting"] != "10 & 10 ms")]
    found = fronts(only).set_index("setting")["share"]
    assert found["10 & 10 ms"] == pytest.approx(0.1)
    assert found["5 & 5 ms"] == pytest.approx(0.3)


def test_a_way_that_saves_nothing_is_beaten_by_saving_nothing():
    found = fronts(table([*POINTS, ("no recurrence", "feed-forward", 1100.0, 0.8, 0.8)])).set_index("way")
    assert not found.loc["no recurrence", "on_own_front"]
    assert found.loc[NOTHING, "on_own_front"]
    assert not found.loc[NOTHING, "on_front"]


SPENT = {  # nJ of each setting of LEVEL, where their SOPs tell another order
    "-": 200.0, "5 & 5 ms": 90.0, "75 %": 30.0,
    "10 & 10 ms, longest steps": 60.0, "80 %": 80.0,
}  # fmt: skip
LEVEL = [
    (NOTHING, "-", 1000.0, 0.90, 0.90),
    (REFRACTORY, "5 & 5 ms", 600.0, 0.899, 0.898),
    (LONGEST, "10 & 10 ms, longest steps", 700.0, 0.895, 0.895),
    ("shorter windows", "80 %", 400.0, 0.897, 0.894),
    ("pruning", "75 %", 300.0, 0.80, 0.80),
]


SMALL = {"n_train": 700, "n_test": 150}
"""Sides of so few windows that test windows tell no difference of some tenths of a point."""


def with_energies(points, **more) -> pd.DataFrame:
    rows = table(points)
    return rows.assign(energy_estimate_nJ=rows["setting"].map(SPENT), **SMALL, **more)


def within(lost: float) -> str:
    """The interval of a loss, in points, that is the same in three seeds."""
    _, low, high = resampled_interval([lost] * 3, 700, 150, DIFFERENCES)
    return f"{100 * low:.1f} to {100 * high:.1f}"


def test_the_cheapest_way_in_energy_is_another_than_in_operations():
    of_sops, of_energy = answers(with_energies(LEVEL, afferents="at each sample (35.6 Hz)"))
    assert of_energy == (
        "Energy: a refractory period is the cheapest way at an accuracy that cannot be told from the best; a network "
        "that saves nothing has 91 % at 200 nJ, with afferents computed at each sample (35.6 Hz); validation windows "
        "cannot tell 4 of 5 settings from the most accurate; the cheapest within its standard error: a refractory "
        f"period of 10 & 10 ms with the longest steps costs 0.5 points (95 % interval {within(0.005)}) at 30 % of the "
        f"energy, and shorter windows (80 %) costs 0.6 points (95 % interval {within(0.006)}) at 40 % of the energy."
    )
    assert of_sops == (
        "A refractory period is not the cheapest way at an accuracy that cannot be told from the best; a network that "
        "saves nothing has 91 % at 1,000 SOPs; validation windows cannot tell 4 of 5 settings from the most accurate; "
        "the cheapest within its standard error: shorter windows (80 %) costs 0.6 points (95 % interval "
        f"{within(0.006)}) at 40 % of the SOPs, and a refractory period of 5 & 5 ms costs 0.2 points (95 % interval "
        f"{within(0.002)}) at 60 % of the SOPs, 0.4 points (95 % interval {within(0.004)}) less than shorter windows."
    )


def test_events_have_no_afferents_to_compute():
    assert "afferents" not in answers(with_energies(LEVEL, afferents="events"))[1]


def test_what_each_way_saves_is_listed_at_the_accuracy_of_the_best():
    shown, _ = tables(with_energies(LEVEL))["made up"]
    assert [shown.rows["way"][row] for row in shown.first][:2] == [LONGEST, "shorter windows"]
    assert shown.rows.to_dict("records") == [
        {"way": REFRACTORY, "fewest SOPs": f"5 & 5 ms: 0.2 points ({within(0.002)}), 60 % left",
         "fewest nJ": f"5 & 5 ms: 0.2 points ({within(0.002)}), 45 % left", "fewest ms": "-"},
        {"way": LONGEST, "fewest SOPs": f"10 & 10 ms: 0.5 points ({within(0.005)}), 70 % left",
         "fewest nJ": f"10 & 10 ms: 0.5 points ({within(0.005)}), 30 % left", "fewest ms": "-"},
        {"way": "shorter windows", "fewest SOPs": f"80 %: 0.6 points ({within(0.006)}), 40 % left",
         "fewest nJ": f"80 %: 0.6 points ({within(0.006)}), 40 % left", "fewest ms": "-"},
        {"way": "pruning", "fewest SOPs": "-", "fewest nJ": "-", "fewest ms": "-"},
    ]  # fmt: skip


def test_the_headline_and_the_names_of_points_say_what_the_table_says():
    rows = with_energies(LEVEL)
    assert headline(rows) == (
        "A refractory period is the cheapest way at an accuracy that cannot be told from the best: 70 % of the energy "
        "is saved by a refractory period (0.5 points lost), 60 % by shorter windows (0.6 points lost)."
    )
    assert headline(rows[rows["way"].isin([NOTHING, "shorter windows"])]).startswith(
        "A refractory period is not the cheapest way at an accuracy that cannot be told from the best: 60 % of"
    )
    assert headline(rows[rows["seed"] < 2]).startswith("2 seeds cannot tell which way is the cheapest: 70 % of the en")
    assert headline(rows[rows["way"].isin([NOTHING, "pruning"])]) == (
        "No way that was tried saves energy at an accuracy that cannot be told from the best."
    )
    less = f"{MINUS}0.2 points", f"{MINUS}0.5 points", f"{MINUS}0.6 points"
    names = {way: said.replace("\u00a0", " ") for (way, _), said in labels(rows, ENERGY).items() if said}
    assert names == {
        NOTHING: NOTHING,
        REFRACTORY: f"{REFRACTORY} {MINUS}55 %, {less[0]}",
        LONGEST: f"{LONGEST} {MINUS}70 %, {less[1]}",
        "shorter windows": f"shorter windows {MINUS}60 %, {less[2]}",
    }
    assert {*labels(rows, ENERGY)} == {*rows[["way", "setting"]].itertuples(index=False, name=None)}


def test_a_way_that_costs_accuracy_is_not_the_cheapest_however_much_it_saves():
    lone = [LEVEL[0], ("pruning", "75 %", 10.0, 0.8, 0.8), (REFRACTORY, "5 & 5 ms", 5.0, 0.7, 0.7)]
    assert answers(table(lone).assign(**SMALL))[0] == (
        "No way that was tried saves SOPs at an accuracy that cannot be told from the best; a network that saves "
        "nothing has 91 % at 1,000 SOPs; validation windows cannot tell 1 of 3 settings from the most accurate, and "
        "none within its standard error saves SOPs; no refractory period does: validation is highest where a "
        f"refractory period of 5 & 5 ms costs 20.0 points (95 % interval {within(0.2)}) at 0.5 % of the SOPs."
    )
    assert answers(table(lone[:2]))[0].endswith("; no refractory period was tried.")


def test_settings_are_chosen_on_validation_and_test_windows_may_speak_against_them():
    points = [LEVEL[0], (REFRACTORY, "5 & 5 ms", 600.0, 0.9, 0.89), ("pruning", "75 %", 500.0, 0.7, 0.89)]
    said = answers(table(points).assign(**SMALL))[0]
    assert said.startswith("Validation and test windows cannot tell which way is the cheapest; ")
    assert "where a refractory period of 5 & 5 ms costs 1.0 points" in said
    assert "no dearer and no less accurate: pruning (75 %) costs 1.0 points" in said
    assert answers(table([*points[:2], ("pruning", "75 %", 500.0, 0.7, 0.88)]).assign(**SMALL))[0].startswith(
        "A refractory period is"
    )


def test_a_setting_that_test_windows_show_to_be_worse_keeps_no_accuracy():
    points = [LEVEL[0], ("pruning", "75 %", 500.0, 0.9, 0.8), (REFRACTORY, "5 & 5 ms", 600.0, 0.9, 0.895)]
    assert "standard error: a refractory period of 5 & 5 ms costs 0.5" in answers(table(points).assign(**SMALL))[0]
    worse = [(NOTHING, "-", 1000.0, 0.9, 0.7), ("pruning", "75 %", 500.0, 0.7, 0.9)]
    assert answers(table(worse))[0].endswith("show each one within its standard error to be clearly less accurate.")


def test_differences_that_are_equal_in_every_seed_are_no_certainty_on_few_trials():
    """Six points are one and a half of the 27 trials that three seeds of 15 test trials are worth."""
    points = [LEVEL[0], ("pruning", "75 %", 500.0, 0.9, 0.84), (REFRACTORY, "5 & 5 ms", 600.0, 0.9, 0.9)]
    few, fewer_trials = table(points).assign(n_train=70, n_test=15), table(points).assign(test_trials=15)
    for rows in (few, fewer_trials):
        assert "standard error: pruning (75 %) costs 6.0 points" in answers(rows)[0]
    assert "pruning" not in answers(table(points))[0]


def test_a_refractory_period_that_saves_nothing_is_said_to_save_nothing():
    points = [LEVEL[0], ("pruning", "75 %", 500.0, 0.9, 0.9), (REFRACTORY, "5 & 5 ms", 1001.0, 0.9, 0.9)]
    said = answers(table(points))[0]
    assert "; no refractory period does: validation is highest where a refractory period of 5 & 5 ms" in said
    assert "100.1 % of the SOPs." in said


def test_of_equal_costs_none_is_the_cheapest():
    points = [LEVEL[0], ("pruning", "75 %", 500.0, 0.9, 0.9), (REFRACTORY, "5 & 5 ms", 500.0, 0.9, 0.9)]
    assert answers(table(points))[0].startswith("A refractory period is among the cheapest ways at an accuracy")
    alone = [points[0], points[2]]
    assert answers(table(alone))[0].endswith("at 50 % of the SOPs, and no other way saves SOPs.")


def test_a_refractory_period_may_gain():
    points = [(NOTHING, "-", 1000.0, 0.9, 0.9), (REFRACTORY, "5 & 5 ms", 400.0, 0.95, 0.92)]
    sentence, _ = answers(table(points, seeds=1))
    assert "a refractory period of 5 & 5 ms gains 2.0 points (one seed) at 40 % of the SOPs" in sentence


def test_nothing_to_compare_with():
    assert "Nothing to compare with" in answers(table(POINTS[1:]))[0]
    assert len(tables(table(POINTS[1:]))["made up"]) == 1


WAYS = (REFRACTORY, LONGEST, "pruning", "fewer taxels", "early exit")


@st.composite
def some_tables(draw):
    """Tables of few accuracies and costs, so that ties are frequent, with as many trials as real sets have."""
    ways = draw(st.lists(st.sampled_from(WAYS), min_size=1, max_size=6))
    rows = []
    for number, way in enumerate([NOTHING, *ways]):
        cost = 1000.0 if way == NOTHING else draw(st.sampled_from([200.0, 350.0, 600.0, 900.0, 1000.0, 1100.0]))
        level = draw(st.sampled_from([0.6, 0.8, 0.85, 0.9]))
        apart = draw(st.sampled_from([0.0, 0.02]))
        for seed in range(3):
            validation, test = (level + apart * draw(st.integers(-2, 2)) for _ in range(2))
            rows.append({
                "set": "made up", "way": way, "setting": f"s{number}", "seed": seed, "accuracy_validation": validation,
                "accuracy_test": test, "sops_total": cost, "energy_estimate_nJ": 1e3 * cost, "signal_ms": 10.0,
                "n_train": 350, "n_test": 75,
            })  # fmt: skip
    return pd.DataFrame(rows)


@given(some_tables())
def test_no_sentence_calls_a_way_the_cheapest_that_its_table_contradicts(rows):
    said, points = answers(rows)[0], fronts(rows).set_index("setting")
    found = re.search(r"the cheapest within its standard error: .*?\b(s\d)\b", said)
    if found is None:
        assert said.startswith(("No way that was tried", "Validation and test windows cannot tell"))
        return
    named = points.loc[found[1]]
    is_called = said.startswith("A refractory period is the cheapest")
    assert (named["way"] in (REFRACTORY, LONGEST)) == is_called or "among the cheapest" in said
    assert "cannot be told from the best; " in said
    for setting, other in points.drop(index=found[1]).iterrows():
        is_cheaper = other["sops_total"] < named["sops_total"]
        assert not (is_cheaper and other["accuracy_test"] >= named["accuracy_test"])
        mine, theirs = (rows[rows["setting"] == one]["accuracy_test"].to_numpy() for one in (found[1], setting))
        gained = compare_over_splits(theirs - mine, 350, 75)
        assert not (gained.difference > 0 and gained.is_clear)


@given(some_tables(), st.integers(1, 6), st.sampled_from([(499.0, 501.0), (510.0, 590.0), (901.0, 999.0)]))
def test_a_cost_moves_numbers_alone_until_the_order_of_costs_changes(rows, number, costs):
    moved = rows["setting"] == f"s{min(number, rows['setting'].nunique() - 1)}"
    before, after = (answers(rows.assign(sops_total=rows["sops_total"].mask(moved, cost)))[0] for cost in costs)
    assert re.sub(r"[\d.]+ % of the SOPs", "", before) == re.sub(r"[\d.]+ % of the SOPs", "", after)


def spread(points, way, by):
    """The table with the test accuracy of a way moved by so much in the last seed."""
    rows = table(points)
    rows.loc[(rows["way"] == way) & (rows["seed"] == 2), "accuracy_test"] += by
    return rows


def test_one_or_two_seeds_cannot_tell_and_have_no_interval():
    assert answers(table(LEVEL, seeds=1))[0].startswith("One seed cannot tell which way is the cheapest; ")
    two = table(LEVEL, seeds=2)
    assert fronts(two)[["low", "high"]].isna().all(axis=None)
    said = " ".join(answers(two))
    assert said.startswith("2 seeds cannot tell which way is the cheapest; ")
    assert "costs 0.6 points (2 seeds) at 40 % of the SOPs" in said
    assert "interval" not in said
    assert "interval" not in tables(two)["made up"][0].caption
    assert "interval" in tables(table(LEVEL, seeds=3))["made up"][0].caption
    assert tables(two)["made up"][0].rows["fewest SOPs"].tolist() == [
        "5 & 5 ms: 0.2 points, 60 % left", "10 & 10 ms: 0.5 points, 70 % left", "80 %: 0.6 points, 40 % left", "-"
    ]  # fmt: skip


def test_an_accuracy_is_within_0_and_100_percent():
    rows = spread([(NOTHING, "-", 1000.0, 0.9, 0.9), ("pruning", "50 %", 500.0, 0.5, 0.3)], "pruning", 0.6)
    low, high = fronts(rows).set_index("way").loc["pruning", ["low", "high"]]
    assert (low, high) == (0.0, 1.0)


def test_no_interval_is_wider_than_all_points():
    rows = spread([LEVEL[0], ("pruning", "50 %", 500.0, 0.9, 0.9)], "pruning", -0.7)
    sentence, _ = answers(rows)
    assert "(95 % interval -100.0 to 100.0)" in sentence


def test_several_sets_are_named():
    both = pd.concat([table(POINTS), table(POINTS).assign(set="other")])
    assert [sentence.split(": ")[0] for sentence in answers(both)] == [
        "made up", "made up, energy", "other", "other, energy"
    ]  # fmt: skip


def test_where_nothing_was_learned_no_saving_means_anything():
    rows = table([(way, setting, sops, 0.5, 0.5) for way, setting, sops, _, _ in POINTS])
    rows = rows.assign(chance=0.5, test_trials=15, least_test_trials=7)
    (sentence,) = answers(rows)
    assert sentence == (
        "Nothing was learned, so no saving means anything: the network that saves nothing is right in 51 % of the "
        "test windows (95 % interval 28 to 73 %), which guessing reaches too (50 %)."
    )
    assert len(cautions(rows)) == 1
    assert cautions(rows)[0].startswith("the network that saves nothing is right in 51 %")
    assert answers(rows.assign(accuracy_test=0.95))[0].startswith("A refractory period is not the cheapest")


def test_few_trials_and_few_seeds_are_told_with_the_remedy():
    rows = table(POINTS).assign(chance=0.25, test_trials=12, least_test_trials=3)
    assert cautions(rows) == [
        "a seed tests 12 trials, 3 of the rarest class: one trial is 8.3 points of accuracy, and smaller differences "
        "mean nothing; record more"
    ]
    enough = rows.assign(test_trials=60, least_test_trials=15)
    assert cautions(enough) == cautions(table(POINTS)) == []
    for seeds, words in ((1, "one seed, so there is no interval"), (2, "2 seeds, so there is no interval")):
        (caution,) = cautions(enough[enough["seed"] < seeds])
        assert caution.startswith(words)
        assert "`split=nt.Split(repeats=3)`" in caution


@st.composite
def some_points(draw):
    tenths = st.integers(0, 10)
    rows = draw(st.lists(st.tuples(tenths, tenths, tenths, tenths), min_size=1, max_size=8))
    return [
        {"set": "made up", "way": "pruning" if number else NOTHING, "setting": f"{number} %", "seed": 0,
         "accuracy_validation": validation / 10, "accuracy_test": 0.5, "sops_total": 100.0 + sops,
         "energy_estimate_nJ": 100.0 + energy, "signal_ms": 100.0 + ms, "n_train": 70, "n_test": 15}
        for number, (validation, sops, energy, ms) in enumerate(rows)
    ]  # fmt: skip


@given(some_points())
def test_the_list_is_the_front_of_each_cost_from_the_best_down(points):
    rows = pd.DataFrame(points)
    shown = tables(rows)["made up"][-1].rows
    assert shown["how it is reached"].iloc[0] == NOTHING
    keys = [*COSTS, "accuracy_validation"]
    for cost in COSTS:
        on_it = pareto_front(rows[cost].to_numpy(), rows["accuracy_validation"].to_numpy())
        wanted = {tuple(row) for row in rows.loc[on_it & (rows["accuracy_validation"] > 0), keys].to_numpy()}
        listed = shown[shown["on the front of"].str.split(", ").map(lambda names, cost=cost: COSTS[cost].unit in names)]
        costs = {tuple(row) for row in listed[[cost.unit for cost in COSTS.values()]].to_numpy()}
        assert {row[:-1] for row in wanted} <= costs | {tuple(rows.loc[0, list(COSTS)])}
    order = [
        rows.loc[(rows[list(COSTS)] == row).all(axis=1), "accuracy_validation"].max()
        for row in shown[[cost.unit for cost in COSTS.values()]].iloc[1:].to_numpy()
    ]
    assert order == sorted(order, reverse=True) or len(set(map(tuple, rows[list(COSTS)].to_numpy()))) < len(rows)
