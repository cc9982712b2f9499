"""What a protocol's run answers: chosen on validation rows, told by test rows."""

import math

import equal_learners
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from levels import QUICK, thinned

from neurotact.metrics.paired import compare_shares
from neurotact.metrics.referee import least_difference
from neurotact.metrics.resampled import least_difference_over_splits, resampled_error, resampled_p
from neurotact.metrics.shares import standard_error
from neurotact.report import first_screen, sentences, way_answer, ways
from neurotact.studies.way import View

MEASURES = {"accuracy_test": "test accuracy (%)", "accuracy_validation": "validation accuracy (%)", "flops": "FLOPs"}
VIEW = View(("kind", "size"), MEASURES, "flops", "accuracy_test")


def means(*rows, **columns):
    """Rows of kind, size, validation, test, FLOPs; four rows each, deviations of 0.04."""
    names = ["kind", "size", "accuracy_validation", "accuracy_test", "flops"]
    table = pd.DataFrame(list(rows), columns=names).assign(rows=4, flops_sd=0.0)
    return table.assign(accuracy_validation_sd=0.04, accuracy_test_sd=0.04, **columns)


SPIKING = VIEW._replace(spiking=("kind", ("rsnn",)), splits=("split",))
SPREAD = [0.02, -0.02, 0.01, -0.01, 0.02, -0.01, -0.01]


def runs(*rows, splits=4, n_train=700, n_test=150, **columns):
    """Results of these rows, as of `means`, on every split: what is added to one split adds up to about nothing."""
    names = ["kind", "size", "accuracy_validation", "accuracy_test", "flops"]
    table = pd.DataFrame(list(rows), columns=names)
    shifted = [
        table.assign(split=split, accuracy_test=table["accuracy_test"] + SPREAD[split % 7] * (splits > 1))
        for split in range(splits)
    ]
    return pd.concat(shifted).assign(n_train=n_train, n_test=n_test, **columns).reset_index(drop=True)


def answer_of(results, view=SPIKING):
    shown = ways.over_rows(results, view)
    (found,) = way_answer.answers(ways._with_choice(results, shown, view), view, results)
    return found


def test_validation_rows_choose_and_test_rows_tell():
    (found,) = way_answer.answers(means(("a", 1, 0.95, 0.90, 900.0), ("b", 2, 0.80, 0.99, 100.0)), VIEW)
    assert (found.best.name, found.best.accuracy) == ("a, size 1", 0.90)
    assert sentences.headline(found) == "a, size 1 has a test accuracy of 90.0 % at 900 FLOPs."


def test_the_cheapest_lies_within_one_standard_error_on_validation_rows():
    # The error is 0.04 / sqrt(4) = 0.02.
    rows = (("a", 1, 0.95, 0.90, 900.0), ("b", 1, 0.93, 0.89, 300.0), ("c", 1, 0.929, 0.95, 100.0))
    (found,) = way_answer.answers(means(*rows), VIEW)
    assert found.cheapest.name == "b, size 1"
    (told,) = sentences.details(found)
    assert told == (
        "Within the error of a, size 1 (2.0 points on validation trials), b, size 1 is the cheapest: 67 % less, 300 "
        "FLOPs against 900, and test accuracy falls by 1.0 points to 89.0 %."
    )


def test_what_is_not_counted_is_never_the_cheapest_and_it_is_said():
    rows = (("a", 1, 0.95, 0.90, math.nan), ("b", 1, 0.94, 0.89, 300.0), ("c", 1, 0.94, 0.89, 400.0))
    (found,) = way_answer.answers(means(*rows), VIEW)
    assert (found.best.name, found.cheapest.name) == ("a, size 1", "b, size 1")
    saved, uncounted = sentences.details(found)
    assert "is the cheapest: 300 FLOPs against a cost that is not counted, and test accuracy" in saved
    assert uncounted == "Not counted, and so never among the cheapest: a, size 1."
    (alone,) = way_answer.answers(means(rows[0]), VIEW)
    assert [*sentences.details(alone)] == [uncounted]


def test_without_validation_the_reader_is_warned():
    table = means(("a", 1, 0.95, 0.90, 900.0)).drop(columns=["accuracy_validation", "accuracy_validation_sd"])
    (found,) = way_answer.answers(table, VIEW)
    assert any("no validation accuracy" in line for line in sentences.details(found))


def test_one_row_has_no_error():
    table = means(("a", 1, 0.95, 0.9, 900.0), ("b", 1, 0.95, 0.8, 300.0), ("c", 1, 0.94, 0.9, 1.0)).assign(
        rows=1, accuracy_validation_sd=math.nan, accuracy_test_sd=math.nan
    )
    (found,) = way_answer.answers(table, VIEW)
    assert found.best.name == found.cheapest.name == "b, size 1"
    assert any("one row" in line for line in sentences.details(found))
    assert "±" not in str(first_screen.table_of_configurations(found).rows)


@pytest.mark.parametrize(
    ("spiking", "words"),
    [
        (0.80, "Spiking costs accuracy: rsnn, size 1 has a test accuracy of 80.0 %; the best baseline is svm,"),
        (0.97, "Spiking is more accurate: rsnn"),
        (0.91, "No clear difference in accuracy: rsnn"),
    ],
)
def test_spiking_is_set_beside_the_best_of_the_others(spiking, words):
    found = answer_of(
        runs(("rsnn", 1, 0.9, spiking, 9.0), ("svm", 1, 0.9, 0.90, 9.0), ("elm", 1, 0.6, 0.95, 9.0)).assign(
            chance=0.125
        ),
        SPIKING._replace(measures=MEASURES | {"chance": "guessing (%)"}),
    )
    said = sentences.headline(found)
    assert said.startswith(words)
    assert said.endswith("guessing reaches 12.5 %.")


def test_what_a_row_of_the_table_contradicts_is_not_claimed():
    found = answer_of(runs(("rsnn", 1, 0.9, 0.95, 9.0), ("svm", 1, 0.9, 0.8, 9.0), ("elm", 1, 0.6, 0.97, 9.0)))
    said = sentences.headline(found)
    assert said.startswith("No clear difference in accuracy: rsnn")
    assert "elm, size 1 has 97.0 %, although it is less accurate on validation windows than" in said


def test_of_rivals_that_validation_cannot_tell_apart_each_counts():
    found = answer_of(runs(("rsnn", 1, 0.9, 0.8, 9.0), ("svm", 1, 0.9, 0.6, 1.0), ("elm", 1, 0.88, 0.97, 9.0)))
    said = sentences.headline(found)
    assert said.startswith("Spiking costs accuracy: rsnn")
    assert "elm, size 1 has 97.0 % (p < 0.001 after correction for 2 comparisons), one of 2 baselines that " in said
    assert "validation cannot tell apart: 60.0 % to 97.0 %" in said
    shown = " ".join(str(row[0]) for row in first_screen.table_of_configurations(found).rows)
    assert all(kind in shown for kind in ("rsnn", "svm", "elm"))


APART = ("rsnn", 1, 0.9, 0.95, 9.0), ("svm", 1, 0.9, 0.8, 9.0)


def test_a_verdict_is_over_the_differences_of_splits():
    rows = runs(*APART, splits=7)
    rows.loc[(rows["kind"] == "svm") & (rows["split"] == 2), "accuracy_test"] += 0.1
    gained = rows[rows["kind"] == "rsnn"]["accuracy_test"].to_numpy() - rows[rows["kind"] == "svm"]["accuracy_test"]
    found = answer_of(rows)
    assert found.verdict.p == pytest.approx(resampled_p(gained, 700, 150))
    mixed = rows.sample(frac=1, random_state=3).sort_values("kind", kind="stable")  # pairs are by split, not by place
    assert answer_of(mixed).verdict.p == pytest.approx(found.verdict.p)
    few = answer_of(rows.assign(test_trials=15))  # windows of one trial tell less
    assert few.verdict.p == pytest.approx(resampled_p(gained, 700, 150, 15)) != found.verdict.p


def test_seeds_of_a_split_are_no_further_splits():
    one = runs(*APART, splits=4)
    seeds = pd.concat([one.assign(seed=seed, accuracy_test=one["accuracy_test"] + more)
                       for seed, more in enumerate((0.01, -0.02, 0.01))])  # fmt: skip
    assert answer_of(seeds).verdict == pytest.approx(answer_of(one).verdict)
    assert answer_of(seeds).best.error == pytest.approx(answer_of(one).best.error)
    several = answer_of(seeds[seeds["split"] == 0])
    (mine, its) = (several.spiking.accuracy, several.baseline.accuracy)
    assert several.verdict.p == compare_shares(mine, its, 150).p
    assert "of 150 test trials of one split" in [*sentences.details(several)][-1]
    trials = answer_of(seeds[seeds["split"] == 0].assign(test_trials=9))
    assert (trials.kind, trials.verdict.n) == ("too few trials", 9)


@pytest.mark.parametrize(
    ("results", "view", "why"),
    [
        (runs(*APART), SPIKING._replace(splits=None), "the run does not say which rows test the same trials"),
        (runs(*APART).drop(columns="n_train"), SPIKING, "the run does not say which rows test the same trials"),
        (runs(*APART, n_test=None), SPIKING, "the run does not say which rows test the same trials"),
        (runs(*APART, splits=2), SPIKING, "2 splits are too few"),
        (pd.concat([runs(APART[0]), runs(APART[1]).assign(split=[5, 6, 7, 8])]), SPIKING,
         "rsnn, size 1 and svm, size 1 share no split"),
    ],
)  # fmt: skip
def test_what_cannot_be_tested_is_not_told_apart(results, view, why):
    found = answer_of(results, view)
    assert (found.kind, found.verdict) == ("untested", None)
    said = sentences.headline(found)
    assert said.startswith(f"Not tested, since {why}")
    assert "rsnn, size 1 has a test accuracy of 95." in said


def test_a_score_that_is_no_share_is_not_tested():
    view = SPIKING._replace(measures=MEASURES | {"accuracy_test": "information (bits)"})
    assert answer_of(runs(*APART), view).kind == "untested"
    beyond = runs(*APART).assign(accuracy_test=lambda rows: 2 * rows["accuracy_test"])
    assert answer_of(beyond).kind == "untested"


def test_means_without_their_rows_are_not_tested():
    table = means(*APART)
    (found,) = way_answer.answers(table, SPIKING)
    assert found.kind == "untested"


def test_errors_are_those_of_splits_or_of_the_trials_of_one():
    rows = runs(*APART, splits=4)
    rows["accuracy_validation"] += [0.02, 0.0] * 4
    best = answer_of(rows).best
    mine = rows[rows["kind"] == best.kind]
    assert best.error == pytest.approx(resampled_error(mine["accuracy_test"].to_numpy(), 700, 150))
    assert best.choice_error == pytest.approx(resampled_error(mine["accuracy_validation"].to_numpy(), 700, 150))
    own = answer_of(rows.assign(n_validation=90, validation_trials=30)).best
    validated = mine["accuracy_validation"].to_numpy()
    assert own.choice_error == pytest.approx(resampled_error(validated, 700, 90, 30))
    assert own.error == best.error
    one = answer_of(runs(*APART, splits=1))
    assert one.best.error == pytest.approx(standard_error(one.best.accuracy, 150))
    assert math.isnan(one.best.choice_error)
    known = answer_of(runs(*APART, splits=1, n_validation=40)).best
    assert known.choice_error == pytest.approx(standard_error(known.chosen_by, 40))
    of_trials = answer_of(runs(*APART, splits=1, n_validation=40, validation_trials=20)).best
    assert of_trials.choice_error == pytest.approx(standard_error(known.chosen_by, 20))
    (told,) = (line for line in sentences.details(one) if "not known" in line)
    assert "one row" in told
    two = answer_of(runs(*APART, splits=2))
    assert math.isnan(two.best.error)
    assert "too few splits" in " ".join(sentences.details(two))
    shown = first_screen.table_of_configurations(two)
    assert "standard error" not in shown.caption
    assert "within its error" not in str(shown.rows)
    some = answer_of(pd.concat([runs(APART[0]), runs(APART[1], splits=2)]))
    assert "± their standard error" in first_screen.table_of_configurations(some).caption


@pytest.mark.parametrize(("splits", "n_test"), [(1, 150), (5, 150), (5, 60), (3, 20), (1, 20)])
def test_a_tie_says_below_which_difference_none_is_seen(splits, n_test):
    near = ("rsnn", 1, 0.9, 0.8, 9.0), ("svm", 1, 0.9, 0.801, 9.0), ("elm", 1, 0.9, 0.802, 9.0)
    found = answer_of(runs(*near, splits=splits, n_test=n_test))
    over = least_difference_over_splits(splits, 700, n_test, 2)
    least = least_difference(n_test, 2) if splits == 1 else over
    *_, said = sentences.details(found)
    assert f"no difference below {100 * least:.1f} points could be clear." in said
    is_weak = least > 0.1  # what the headline says then is the same difference
    assert (f"differences of {100 * least:.0f} points or more would show" in sentences.headline(found)) == is_weak
    assert (found.kind == "too few trials") == is_weak
    *_, said = sentences.details(answer_of(runs(*near, splits=splits, n_test=1)))
    assert said.endswith("no difference could be clear.")
    *_, said = sentences.details(answer_of(runs(*APART, splits=splits)))
    assert "could be clear" not in said


def test_the_least_difference_of_the_comparison_decides_whether_its_trials_are_too_few():
    found = answer_of(runs(("rsnn", 1, 0.9, 0.8, 9.0), ("svm", 1, 0.9, 0.801, 9.0), splits=5))
    assert found._replace(least=0.11).kind == "too few trials"
    assert found._replace(least=0.09).kind == "tie"


def test_a_figure_has_the_error_of_its_score_and_only_what_spikes_is_set_beside_another():
    rows = runs(*APART, ("elm", 1, 0.5, 0.4, 9.0))
    score, cost = first_screen.figures(answer_of(rows))
    error = 100 * answer_of(rows).spiking.error
    assert (score.value, score.of) == ("95.0 %", f"± {error:.1f} points, rsnn, size 1")
    assert score.against.startswith("svm, size 1: 80.0 ± ")
    assert (cost.value, cost.against) == ("9", "svm, size 1: 9")
    alone = rows[rows["kind"] != "rsnn"].assign(chance=0.25)
    view = SPIKING._replace(measures=MEASURES | {"chance": "guessing (%)"})
    score, cost = first_screen.figures(answer_of(alone, view))
    assert (score.against, cost.against) == ("guessing: 25.0 %", "")


def test_of_an_unknown_error_nothing_is_said_to_be_level():
    rows = runs(("rsnn", 1, 0.9, 0.95, 9.0), ("svm", 1, 0.9, 0.8, 9.0), ("elm", 1, 0.2, 0.3, 9.0), splits=1)
    said = sentences.headline(answer_of(rows))
    assert not any(word in said for word in ("elm", "cannot tell apart"))
    rows = runs(("rsnn", 1, 0.9, 0.95, 9.0), ("svm", 1, 0.9, 0.8, 9.0), ("elm", 1, 0.9, 0.79, 9.0), splits=1)
    said = sentences.headline(answer_of(rows))
    assert "2 baselines that validation finds equal have 79.0 %" in said


def page_verdict(rng, **how):
    return answer_of(equal_learners.rows(equal_learners.study(rng, **how)), equal_learners.VIEW).kind


@thinned(
    "how",
    [
        {"n": 199, "learners": 2, "splits": 10},
        {"n": 199, "learners": 6, "splits": 10},
        {"n": 199, "learners": 6, "splits": 3},
        {"n": 60, "learners": 2, "splits": 10},
        {"n": 60, "learners": 2, "splits": 1},
        {"n": 400, "learners": 2, "splits": 30, "apart": 1.2},
        {"n": 199, "learners": 2, "splits": 5, "kind": "folds"},
        {"n": 100, "learners": 2, "splits": 10, "kind": "folds", "apart": 1.0},
        {"n": 199, "learners": 2, "splits": 6, "kind": "groups"},
    ],
)
def test_of_equal_learners_one_is_called_better_in_at_most_one_of_twenty_studies(how):
    studies = 100 if settings.default.max_examples == QUICK else 400
    assert equal_learners.claims(lambda rng: page_verdict(rng, **how), studies) <= equal_learners.most(studies)


def test_a_better_learner_is_found():
    how = {"n": 199, "learners": 2, "splits": 10, "best": 2.0}
    assert equal_learners.claims(lambda rng: page_verdict(rng, **how), 20) >= 15


def test_tasks_apart_have_an_answer_each_and_what_saw_test_data_comes_last():
    view = VIEW._replace(by=("kind", "protocol"), apart=("protocol",), optimistic=("paper",))
    table = means(("a", 1, 0.99, 0.99, 9.0), ("a", 1, 0.7, 0.7, 9.0), ("b", 1, 0.8, 0.8, 9.0))
    table = table.assign(protocol=["paper", "honest", "honest"])
    honest, paper = way_answer.answers(table, view)
    assert (honest.setting, honest.best.name, paper.setting) == ("honest", "b", "paper")
    assert any("saw test data" in line for line in sentences.details(paper))
    assert not any("saw test data" in line for line in sentences.details(honest))


def test_configurations_that_were_not_run_are_left_out():
    table = means(("a", 1, 0.9, 0.9, 9.0), ("b", 1, math.nan, math.nan, math.nan))
    (found,) = way_answer.answers(table, VIEW)
    assert [one.name for one in found.rows] == ["a, size 1"]
    assert way_answer.answers(table.iloc[1:], VIEW) == []


def test_a_row_without_validation_is_shown_and_not_chosen():
    rows = (("window", 1, 0.9, 0.8, 900.0), ("early exit", 1, math.nan, 0.99, 9.0), ("window", 2, 0.8, 0.7, 9.0))
    (found,) = way_answer.answers(means(*rows), VIEW)
    assert found.best.name == found.cheapest.name == "window, size 1"
    assert [row[0] for row in first_screen.table_of_configurations(found).rows] == [
        "window, size 1: best and cheapest within its error", "early exit, size 1",
    ]  # fmt: skip


def test_validation_that_the_view_does_not_show_chooses_all_the_same():
    view = View(("kind",), {"accuracy_test": "test accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy_test")
    results = pd.DataFrame(
        {"kind": ["a", "b"], "accuracy_validation": [0.9, 0.8], "accuracy_test": [0.1, 0.2], "flops": [1.0, 1.0]}
    )
    table = ways._with_choice(results, ways.over_rows(results, view), view)
    (found,) = way_answer.answers(table, view)
    assert (found.best.name, found.is_validated) == ("a", True)


def test_the_table_has_the_best_of_each_kind_and_guessing():
    rows = (("a", 1, 0.95, 0.90, 900.0), ("a", 2, 0.94, 0.99, 80.0), ("b", 1, 0.5, 0.4, 300.0))
    (found,) = way_answer.answers(means(*rows, chance=0.25, signal_ms=150.0), VIEW)
    shown = first_screen.table_of_configurations(found)
    assert shown.caption == (
        "The best of each kind, chosen on validation rows: means over 4 rows of results.csv ± their standard error."
    )
    assert shown.columns == ["configuration", "test accuracy (%)", "FLOPs", "ms of signal"]
    assert shown.rows == [
        ["a, size 1: best", "90.0 ± 2.0 %", "900", "150"],
        ["b, size 1", "40.0 ± 2.0 %", "300", "150"],
        ["a, size 2: cheapest within its error", "99.0 ± 2.0 %", "80", "150"],
        ["guessing", "25.0 %", "", ""],
    ]


SHARES = st.integers(0, 2520).map(lambda right: right / 2520)  # of trials


@given(st.lists(st.tuples(SHARES, SHARES, st.floats(1.0, 1e6)), min_size=1, max_size=8))
def test_the_cheapest_never_costs_more_and_lies_within_the_error(points):
    rows = [("k", index, validation, test, cost) for index, (validation, test, cost) in enumerate(points)]
    (found,) = way_answer.answers(means(*rows), VIEW)
    best, cheapest = found.best, found.cheapest
    assert best.chosen_by == max(validation for validation, _, _ in points)
    assert cheapest.cost <= best.cost
    assert cheapest.chosen_by >= best.chosen_by - best.choice_error - 1e-9
    assert all(one.cost >= cheapest.cost for one in found.rows if one.chosen_by >= best.chosen_by - best.choice_error)
