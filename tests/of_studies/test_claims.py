"""The rule of a claim: what holds, how it is told, and when a run does not hold its cells."""

import pandas as pd
import pytest
from neurotact_parts.studies.verdicts import State, judge

from neurotact.errors import InputError
from neurotact.studies.claims import Claim

RESULTS = pd.DataFrame(
    {
        "pair": ["1&1", "1&1", "5&5", "5&5"],
        "hidden": [20, 30, 20, 30],
        "seed": [0, 0, 0, 0],
        "accuracy_test": [0.80, 0.90, 0.70, 0.84],
        "sops_total": [100.0, 200.0, 80.0, 140.0],
    }
)
PAIRS = ({"pair": "5&5"}, {"pair": "1&1"})


def claim(kind, measure="accuracy_test", **rest):
    return Claim(name="c", source="Fig. 0", published="p", kind=kind, measure=measure, **rest)


def verdict(one):
    return judge(one, {"results": RESULTS})


def test_a_level_is_the_mean_of_the_selected_rows():
    assert verdict(claim("value", where=PAIRS[1], value=0.85, tolerance=0.001)).holds
    assert not verdict(claim("value", where=PAIRS[1], value=0.88, tolerance=0.001)).holds


def test_figures_from_a_thousand_on_are_whole_numbers_without_an_exponent():
    costs = pd.DataFrame({"unit": ["A", "B", "C"], "flops": [10_142.4, 3_592.0, 999.6]})
    one = claim("value", "flops", where={"unit": "B"}, value=3444.0, tolerance=344.0)
    assert judge(one, {"results": costs}).ours == "3,592"
    assert "is 3,444 ± 344 for" in one.rule
    falls = claim("order", "flops", order=[[{"unit": "A"}], [{"unit": "B"}], [{"unit": "C"}]])
    assert judge(falls, {"results": costs}).ours == "10,142 > 3,592 > 1,000"


def test_best_over_takes_the_largest_mean_and_names_it():
    best = verdict(claim("at_least", where=PAIRS[1], best_over=("hidden",), value=0.9))
    assert best.holds
    assert best.ours.endswith("hidden = 30")


def test_the_best_of_one_size_says_that_it_is_the_only_one():
    one_size = RESULTS[RESULTS["hidden"] == 30]
    best = judge(claim("at_least", where=PAIRS[1], best_over=("hidden",), value=0.9), {"results": one_size})
    assert best.ours == "90 % at hidden = 30, the only size run"


def test_a_rule_reads_as_a_sentence_and_names_its_column():
    falls = claim(
        "order",
        "spikes_sa_per_s",
        where={"pair": "1&1", "label": ["P4.0", "P2.0"]},
        order=[[{"force_N": 12.0}], [{"force_N": 3.0}]],
    )
    assert falls.rule == (
        "The mean of SA-I spikes per second (spikes_sa_per_s) falls along 12 N > 3 N "
        "for t_ref 1&1 ms, class P4.0 or P2.0"
    )
    changes = claim(
        "change",
        where={**PAIRS[0], "dataset": "mixed"},
        against={**PAIRS[1], "dataset": "mixed"},
        value=-0.1,
        tolerance=0.02,
    )
    assert changes.rule == (
        "The mean of test accuracy (accuracy_test) falls by 0.1 ± 0.02 from t_ref 1&1 ms to t_ref 5&5 ms "
        "for data set mixed"
    )


def test_an_order_of_pairs_names_what_they_are_once():
    assert claim("order", order=[[PAIRS[1]], [PAIRS[0], {"pair": "1&10"}]]).rule.endswith("t_ref 1&1 > 5&5 and 1&10 ms")


def test_a_relative_change_is_formed_for_each_size_and_then_averaged():
    change = claim("change", "sops_total", where=PAIRS[0], against=PAIRS[1], relative=True, value=-0.25, tolerance=1e-9)
    assert verdict(change).holds  # (-20 % and -30 %) / 2
    assert verdict(change).ours == "-25 ± 5 %"


def test_a_change_is_the_mean_of_the_sizes_and_not_their_median():
    rows = [(pair, hidden, 0, 0.0, sops) for pair, sizes in (("1&1", (100, 100, 100)), ("5&5", (90, 90, 30)))
            for hidden, sops in zip((20, 30, 40), sizes, strict=True)]  # fmt: skip
    table = pd.DataFrame(rows, columns=list(RESULTS))
    change = claim("change", "sops_total", where=PAIRS[0], against=PAIRS[1], relative=True, value=-0.3, tolerance=1e-9)
    assert judge(change, {"results": table}).holds  # -10, -10 and -70 %


def test_an_absolute_change_is_in_the_measures_unit():
    assert verdict(claim("change", where=PAIRS[0], against=PAIRS[1], value=-0.08, tolerance=1e-9)).holds


def test_an_order_falls_without_ties():
    assert verdict(claim("order", order=[[PAIRS[1]], [PAIRS[0]]])).holds
    assert not verdict(claim("order", order=[[PAIRS[0]], [PAIRS[1]]])).holds
    assert not verdict(claim("order", order=[[PAIRS[0]], [PAIRS[0]]])).holds


def test_places_of_an_order_must_not_overlap():
    """Every selection of a place lies at or above every one of the next: 0.8 and 0.9 before 0.7 and 0.84 do not."""
    small, large = ([{"pair": pair, "hidden": hidden} for pair in ("1&1", "5&5")] for hidden in (20, 30))
    assert verdict(claim("order", order=[large, small])).holds  # 0.9 and 0.84, then 0.8 and 0.7
    fine, coarse = ([{"pair": pair, "hidden": hidden} for hidden in (20, 30)] for pair in ("1&1", "5&5"))
    assert not verdict(claim("order", order=[fine, coarse])).holds


@pytest.mark.parametrize(
    ("kind", "value", "holds"),
    [("at_least", 0.7, True), ("at_least", 0.71, False), ("at_most", 0.9, True), ("at_most", 0.89, False)],
)
def test_a_level_of_each_is_that_of_the_worst_row(kind, value, holds):
    found = verdict(claim(kind, value=value, each=True))
    assert found.holds == holds
    assert found.ours == ("70 %" if kind == "at_least" else "90 %")


def test_a_run_without_the_cells_gives_no_verdict():
    assert verdict(claim("at_least", where={"pair": "10&10"}, value=0.1)).state is State.MISSING


def test_a_run_without_the_table_gives_no_verdict():
    """As after `--set cut_short_ms=[]`: the claims of that table are not in the run, and the report is still made."""
    one = claim("at_least", table="cut_short", value=0.1)
    assert verdict(one) == (one, "not in this run", State.MISSING, None)


def test_why_is_told_only_where_a_claim_is_not_reproduced():
    reason = "no spikes reach the readout"
    levels = [claim("at_least", where=PAIRS[1], value=value, why=reason) for value in (0.8, 0.9)]
    assert [verdict(level).why for level in levels] == ["", reason]
    assert verdict(claim("at_least", where={"pair": "10&10"}, value=0.1, why=reason)).why == ""


def test_an_unknown_column_is_refused_by_its_nearest():
    with pytest.raises(InputError, match="did you mean 'accuracy_test'"):
        verdict(claim("at_least", "accuracy_tset", value=0.1))


@pytest.mark.parametrize("kind", ["value", "change", "equal", "order", "at_least"])
def test_a_claim_without_what_its_kind_needs_is_refused(kind):
    with pytest.raises(InputError, match="needs"):
        claim(kind)


@pytest.mark.parametrize("order", [[[{"pair": "1&1"}]], [[{"pair": "1&1"}], []]])
def test_an_order_needs_two_places_that_select_something(order):
    with pytest.raises(ValueError, match="order: needs at least two places, each with at least one selection"):
        claim("order", order=order)


def test_a_rule_shows_a_pair_that_is_a_number():
    assert "t_ref 1 > 5 ms" in claim("order", order=[[{"pair": 1}], [{"pair": 5}]]).rule
