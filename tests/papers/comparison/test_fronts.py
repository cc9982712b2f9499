"""Fronts and the sentences of what it costs to save, on points whose answer is known."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.resampled import resampled_interval
from neurotact.metrics.shares import wilson_interval
from neurotact.papers.comparison.fronts import (
    COSTS,
    LONGEST,
    NOTHING,
    REFRACTORY,
    answers,
    cautions,
    fronts,
    halved,
    tables,
)


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


SPENT = {  # nJ of each setting of POINTS and LONGER, where their SOPs tell another order
    "-": 200.0, "5 & 5 ms": 90.0, "10 & 10 ms": 95.0, "20 & 20 ms": 94.0, "50 %": 190.0, "75 %": 180.0,
    "10 & 10 ms, longest steps": 60.0, "80 %": 80.0,
}  # fmt: skip
LONGER = [(LONGEST, "10 & 10 ms, longest steps", 700.0, 0.895, 0.895), ("shorter windows", "80 %", 600.0, 0.85, 0.86)]


def with_energies(points, **more) -> pd.DataFrame:
    rows = table(points)
    return rows.assign(energy_estimate_nJ=rows["setting"].map(SPENT), **more)


def test_energy_is_halved_by_other_ways_than_operations():
    rows = with_energies([*POINTS[:6], *LONGER])
    halves = halved(rows, cost="energy_estimate_nJ")
    assert [(each.way, each.setting, each.share) for each in halves] == [
        (LONGEST, "10 & 10 ms, longest steps", 0.3), (REFRACTORY, "5 & 5 ms", 0.45), ("shorter windows", "80 %", 0.4)
    ]  # fmt: skip
    _, of_energy = answers(rows.assign(afferents="at each sample (35.6 Hz)"))
    assert of_energy == (
        "Energy: a refractory period is the cheapest way; a network that saves nothing has 91 % at 200 nJ, with "
        "afferents computed at each sample (35.6 Hz); to save at least 50 % of it, a refractory period of 10 & 10 ms "
        "with the longest steps costs 0.5 points (95 % interval 0.2 to 0.8) at 30 % of the energy, and shorter windows "
        "(80 %) costs 4.0 points (95 % interval 3.2 to 4.8) at 40 % of the energy."
    )


def test_events_have_no_afferents_to_compute():
    assert "afferents" not in answers(with_energies(POINTS[:6], afferents="events"))[1]


def test_what_half_costs_is_listed_way_by_way():
    _, shown = tables(with_energies([*POINTS[:6], *LONGER]))["made up"]
    assert shown.rows.to_dict("records") == [
        {"way": REFRACTORY, "half of the SOPs": "10 & 10 ms: 10.0 points (8.8 to 11.2), 40 % left",
         "half of the nJ": "5 & 5 ms: 1.0 points (0.6 to 1.4), 45 % left", "half of the ms": "-"},
        {"way": "pruning", "half of the SOPs": "50 %: 4.0 points (3.2 to 4.8), 50 % left", "half of the nJ": "-",
         "half of the ms": "-"},
        {"way": LONGEST, "half of the SOPs": "-",
         "half of the nJ": "10 & 10 ms: 0.5 points (0.2 to 0.8), 30 % left", "half of the ms": "-"},
        {"way": "shorter windows", "half of the SOPs": "-",
         "half of the nJ": "80 %: 4.0 points (3.2 to 4.8), 40 % left", "half of the ms": "-"},
    ]  # fmt: skip


def test_settings_are_chosen_on_validation_and_judged_on_test():
    found = halved(table(POINTS))
    # On test windows 75 % would be the better one; a taxel of four left out saves too little.
    assert [(each.way, each.setting) for each in found] == [("pruning", "50 %"), (REFRACTORY, "10 & 10 ms")]
    assert found[0].lost == pytest.approx(np.full(3, 0.04))


def test_of_equal_validation_the_fewest_operations_decide():
    equal = [(way, setting, sops, 0.9, test) for way, setting, sops, _, test in POINTS]
    assert [(each.way, each.setting) for each in halved(table(equal))] == [
        ("pruning", "75 %"), (REFRACTORY, "10 & 10 ms")
    ]  # fmt: skip


def test_the_sentence_compares_seed_by_seed():
    sentence, of_energy = answers(table(POINTS))
    assert of_energy == "Energy: a network that saves nothing has 91 % at 1 nJ; no way that was tried saves 50 % of it."
    assert sentence == (
        "A refractory period is not the cheapest way; a network that saves nothing has 91 % at 1,000 SOPs; "
        "to save at least 50 % of them, pruning (50 %) "
        "costs 4.0 points (95 % interval 3.2 to 4.8) at 50 % of the SOPs, and a refractory period of 10 & 10 ms costs "
        "10.0 points (95 % interval 8.8 to 11.2) at 40 % of the SOPs, 6.0 points (95 % interval 5.1 to 6.9) more than "
        "pruning."
    )


def test_refractory_periods_that_save_too_little_are_said():
    sentence, _ = answers(table([point for point in POINTS if "10 &" not in point[1] and "20 &" not in point[1]]))
    assert sentence.endswith(
        "and no refractory period that was tried saves as much: 5 & 5 ms costs 1.0 points (95 % interval 0.6 to 1.4) "
        "at 60 % of the SOPs."
    )


def test_a_refractory_period_may_be_the_cheapest_and_may_gain():
    points = [(NOTHING, "-", 1000.0, 0.9, 0.9), (REFRACTORY, "5 & 5 ms", 400.0, 0.95, 0.92)]
    sentence, _ = answers(table(points, seeds=1))
    assert "a refractory period of 5 & 5 ms gains 2.0 points (one seed) at 40 % of the SOPs." in sentence


def test_nothing_saved_enough_and_nothing_to_compare_with():
    assert answers(table(POINTS[:2]))[0].endswith("no way that was tried saves 50 % of them.")
    assert "Nothing to compare with" in answers(table(POINTS[1:]))[0]


def spread(points, way, by):
    """The table with the test accuracy of a way moved by so much in the last seed."""
    rows = table(points)
    rows.loc[(rows["way"] == way) & (rows["seed"] == 2), "accuracy_test"] += by
    return rows


@pytest.mark.parametrize(
    ("rows", "verdict"),
    [
        (table(POINTS), "A refractory period is not the cheapest way; "),
        (spread(POINTS, "pruning", -0.2), "No clear difference between a refractory period and the best other way; "),
        (table([*POINTS, (REFRACTORY, "40 & 40 ms", 100.0, 0.95, 0.95)]), "A refractory period is the cheapest way; "),
        (table([POINTS[0], POINTS[2], POINTS[6]]), "A refractory period alone saves enough; "),
        (table([POINTS[0], POINTS[1], POINTS[4]]), "A refractory period saves too little; "),
        (table(POINTS, seeds=1), "One seed cannot tell whether a refractory period is cheapest; "),
    ],
)
def test_the_sentence_begins_with_a_verdict(rows, verdict):
    assert answers(rows)[0].startswith(verdict)


def test_differences_that_are_equal_in_every_seed_are_no_certainty_on_few_trials():
    """Six points are one and a half of the 27 trials that three seeds of 15 test trials are worth."""
    few = table(POINTS).assign(n_train=70, n_test=15)
    assert answers(few)[0].startswith("No clear difference between a refractory period and the best other way; ")
    assert "6.0 points (95 % interval -7.8 to 19.8) more than pruning" in answers(few)[0]
    fewer_trials = table(POINTS).assign(test_trials=15)
    assert answers(fewer_trials)[0].startswith("No clear difference")
    assert answers(table(POINTS))[0].startswith("A refractory period is not the cheapest way")


def test_two_seeds_have_no_interval():
    two = table(POINTS, seeds=2)
    assert fronts(two)[["low", "high"]].isna().all(axis=None)
    said = " ".join(answers(two))
    assert said.startswith("2 seeds cannot tell whether a refractory period is cheapest; ")
    assert "costs 4.0 points (2 seeds) at 50 % of the SOPs" in said
    assert "interval" not in said
    assert "interval" not in tables(two)["made up"][1].caption
    assert "interval" in tables(table(POINTS, seeds=3))["made up"][1].caption
    assert tables(two)["made up"][1].rows["half of the SOPs"].tolist() == [
        "10 & 10 ms: 10.0 points, 40 % left", "50 %: 4.0 points, 50 % left"
    ]  # fmt: skip


def test_an_accuracy_is_within_0_and_100_percent():
    rows = spread([(NOTHING, "-", 1000.0, 0.9, 0.9), ("pruning", "50 %", 500.0, 0.5, 0.3)], "pruning", 0.6)
    low, high = fronts(rows).set_index("way").loc["pruning", ["low", "high"]]
    assert (low, high) == (0.0, 1.0)


def test_no_interval_is_wider_than_all_points():
    sentence, _ = answers(spread(POINTS, "pruning", -0.7))
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
    assert answers(rows.assign(accuracy_test=0.95))[0].startswith("No clear difference")


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
        assert "`repeats=3`" in caution


@st.composite
def some_points(draw):
    tenths = st.integers(0, 10)
    rows = draw(st.lists(st.tuples(tenths, tenths, tenths, tenths), min_size=1, max_size=8))
    return [
        {"set": "made up", "way": "pruning" if number else NOTHING, "setting": f"{number} %", "seed": 0,
         "accuracy_validation": validation / 10, "accuracy_test": 0.5, "sops_total": 100.0 + sops,
         "energy_estimate_nJ": 100.0 + energy, "signal_ms": 100.0 + ms, "n_train": 7000, "n_test": 1500}
        for number, (validation, sops, energy, ms) in enumerate(rows)
    ]  # fmt: skip


@given(some_points())
def test_the_list_is_the_front_of_each_cost_from_the_best_down(points):
    rows = pd.DataFrame(points)
    shown = tables(rows)["made up"][0].rows
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
