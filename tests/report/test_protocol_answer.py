"""What a protocol's run answers: chosen on validation rows, told by test rows."""

import math

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.report import protocol, protocol_answer
from neurotact.studies.protocol import View

MEASURES = {"accuracy_test": "test accuracy (%)", "accuracy_validation": "validation accuracy (%)", "flops": "FLOPs"}
VIEW = View(("kind", "size"), MEASURES, "flops", "accuracy_test")


def means(*rows, **columns):
    """Rows of kind, size, validation, test, FLOPs; four rows each, deviations of 0.04."""
    names = ["kind", "size", "accuracy_validation", "accuracy_test", "flops"]
    table = pd.DataFrame(list(rows), columns=names).assign(rows=4, flops_sd=0.0)
    return table.assign(accuracy_validation_sd=0.04, accuracy_test_sd=0.04, **columns)


def test_validation_rows_choose_and_test_rows_tell():
    (found,) = protocol_answer.answers(means(("a", 1, 0.95, 0.90, 900.0), ("b", 2, 0.80, 0.99, 100.0)), VIEW)
    assert (found.best.name, found.best.score) == ("a, size 1", 0.90)
    assert protocol_answer.headline(found, VIEW) == "a, size 1 has a test accuracy of 90.0 % at 900 FLOPs."


def test_the_cheapest_lies_within_one_standard_error_on_validation_rows():
    # The error is 0.04 / sqrt(4) = 0.02.
    rows = (("a", 1, 0.95, 0.90, 900.0), ("b", 1, 0.93, 0.89, 300.0), ("c", 1, 0.929, 0.95, 100.0))
    (found,) = protocol_answer.answers(means(*rows), VIEW)
    assert found.cheapest.name == "b, size 1"
    (told,) = protocol_answer.details(found, VIEW)
    assert told == (
        "Within the error of a, size 1 (2.0 points on validation rows), b, size 1 is the cheapest: 67 % less, 300 "
        "FLOPs against 900, and its score is 1.0 points lower, 89.0 %."
    )


def test_without_validation_the_reader_is_warned():
    table = means(("a", 1, 0.95, 0.90, 900.0)).drop(columns=["accuracy_validation", "accuracy_validation_sd"])
    (found,) = protocol_answer.answers(table, VIEW)
    assert any("no validation accuracy" in line for line in protocol_answer.details(found, VIEW))


def test_one_row_has_no_error():
    table = means(("a", 1, 0.95, 0.9, 900.0), ("b", 1, 0.95, 0.8, 300.0), ("c", 1, 0.94, 0.9, 1.0)).assign(
        rows=1, accuracy_validation_sd=math.nan, accuracy_test_sd=math.nan
    )
    (found,) = protocol_answer.answers(table, VIEW)
    assert found.best.name == found.cheapest.name == "b, size 1"
    assert any("one row" in line for line in protocol_answer.details(found, VIEW))
    assert "±" not in str(protocol_answer.table(found, VIEW).rows)


@pytest.mark.parametrize(
    ("spiking", "words"),
    [
        (0.80, "Spiking costs accuracy: rsnn, size 1 has a test accuracy of 80.0 %; the best without spikes, svm,"),
        (0.99, "Spiking is more accurate: rsnn"),
        (0.91, "No clear difference between spiking and the others: rsnn"),
    ],
)
def test_spiking_is_set_beside_the_best_of_the_others(spiking, words):
    view = VIEW._replace(spiking=("kind", ("rsnn",)))
    table = means(("rsnn", 1, 0.9, spiking, 9.0), ("svm", 1, 0.9, 0.90, 9.0), ("elm", 1, 0.6, 0.95, 9.0), chance=0.125)
    (found,) = protocol_answer.answers(table, view)
    said = protocol_answer.headline(found, view)
    assert said.startswith(words)
    assert said.endswith("guessing reaches 12.5 %.")


def test_what_a_row_of_the_table_contradicts_is_not_claimed():
    view = VIEW._replace(spiking=("kind", ("rsnn",)))
    table = means(("rsnn", 1, 0.9, 0.95, 9.0), ("svm", 1, 0.9, 0.8, 9.0), ("elm", 1, 0.6, 0.99, 9.0))
    (found,) = protocol_answer.answers(table, view)
    said = protocol_answer.headline(found, view)
    assert said.startswith("No clear difference between spiking and the others: rsnn")
    assert "elm, size 1, which validation ranks lower, has 99.0 %" in said


def test_of_rivals_that_validation_cannot_tell_apart_each_counts():
    view = VIEW._replace(spiking=("kind", ("rsnn",)))
    table = means(("rsnn", 1, 0.9, 0.8, 9.0), ("svm", 1, 0.9, 0.6, 1.0), ("elm", 1, 0.88, 0.98, 9.0))
    (found,) = protocol_answer.answers(table, view)
    said = protocol_answer.headline(found, view)
    assert said.startswith("Spiking costs accuracy: rsnn")
    assert "2 without spikes that validation cannot tell apart have 60.0 % (svm, size 1) to 98.0 % (elm" in said
    shown = " ".join(str(row[0]) for row in protocol_answer.table(found, view).rows)
    assert all(kind in shown for kind in ("rsnn", "svm", "elm"))


def test_tasks_apart_have_an_answer_each_and_what_saw_test_data_comes_last():
    view = VIEW._replace(by=("kind", "protocol"), apart=("protocol",), optimistic=("paper",))
    table = means(("a", 1, 0.99, 0.99, 9.0), ("a", 1, 0.7, 0.7, 9.0), ("b", 1, 0.8, 0.8, 9.0))
    table = table.assign(protocol=["paper", "honest", "honest"])
    honest, paper = protocol_answer.answers(table, view)
    assert (honest.setting, honest.best.name, paper.setting) == ("honest", "b", "paper")
    assert any("saw test data" in line for line in protocol_answer.details(paper, view))
    assert not any("saw test data" in line for line in protocol_answer.details(honest, view))


def test_configurations_that_were_not_run_are_left_out():
    table = means(("a", 1, 0.9, 0.9, 9.0), ("b", 1, math.nan, math.nan, math.nan))
    (found,) = protocol_answer.answers(table, VIEW)
    assert [one.name for one in found.configurations] == ["a, size 1"]
    assert protocol_answer.answers(table.iloc[1:], VIEW) == []


def test_a_row_without_validation_is_shown_and_not_chosen():
    rows = (("window", 1, 0.9, 0.8, 900.0), ("early exit", 1, math.nan, 0.99, 9.0), ("window", 2, 0.8, 0.7, 9.0))
    (found,) = protocol_answer.answers(means(*rows), VIEW)
    assert found.best.name == found.cheapest.name == "window, size 1"
    assert [row[0] for row in protocol_answer.table(found, VIEW).rows] == [
        "window, size 1: best and cheapest within its error", "early exit, size 1",
    ]  # fmt: skip


def test_validation_that_the_view_does_not_show_chooses_all_the_same():
    view = View(("kind",), {"accuracy_test": "test accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy_test")
    results = pd.DataFrame(
        {"kind": ["a", "b"], "accuracy_validation": [0.9, 0.8], "accuracy_test": [0.1, 0.2], "flops": [1.0, 1.0]}
    )
    table = protocol._with_choice(results, protocol.over_rows(results, view), view)
    (found,) = protocol_answer.answers(table, view)
    assert (found.best.name, found.is_validated) == ("a", True)


def test_the_table_has_the_best_of_each_kind_and_guessing():
    rows = (("a", 1, 0.95, 0.90, 900.0), ("a", 2, 0.94, 0.99, 80.0), ("b", 1, 0.5, 0.4, 300.0))
    (found,) = protocol_answer.answers(means(*rows, chance=0.25, signal_ms=150.0), VIEW)
    shown = protocol_answer.table(found, VIEW)
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
    (found,) = protocol_answer.answers(means(*rows), VIEW)
    best, cheapest = found.best, found.cheapest
    assert best.chosen_by == max(validation for validation, _, _ in points)
    assert cheapest.cost <= best.cost
    assert cheapest.chosen_by >= best.chosen_by - best.choice_error - 1e-9
    assert all(
        one.cost >= cheapest.cost for one in found.configurations if one.chosen_by >= best.chosen_by - best.choice_error
    )
