"""What a report says of 8-bit weights: of baselines, of the network, and of the verdict."""

import pandas as pd
import pytest

from neurotact.metrics.referee import Verdict
from neurotact.report import front, sentences
from neurotact.report.answer import Baseline, Decision, Network, Priced, Trials, answer
from neurotact.report.networks import _baselines_table
from neurotact.studies import study

SHARES = {"accuracy_validation": [1.0, 0.75], "accuracy_test": [0.9, 0.8],
          "accuracy_validation_8bit": [0.5, None], "accuracy_test_8bit": [0.6, None]}  # fmt: skip
SIDES = [(0, "validation", 7, 1.0), (0, "validation_8bit", 7, 0.5), (0, "test", 3, 0.9), (0, "test_8bit", 3, 0.6),
         (1, "validation", 7, 0.75), (1, "test", 3, 0.8)]  # fmt: skip
TRIALS = pd.DataFrame(SIDES, columns=["baseline", "side", "trial", "right"])


def test_rounded_tables_hold_what_is_rounded_and_else_what_is_not():
    tables = {"baselines": pd.DataFrame(SHARES, dtype=float), "baselines_trials": TRIALS}
    found = front.rounded(tables)
    assert found["baselines"]["accuracy_validation"].tolist() == [0.5, 0.75]
    assert found["baselines"]["accuracy_test"].tolist() == [0.6, 0.8]
    rows = [(0, "validation", 7, 0.5), (0, "test", 3, 0.6), (1, "validation", 7, 0.75), (1, "test", 3, 0.8)]
    assert [*found["baselines_trials"].itertuples(index=False, name=None)] == rows
    earlier = {"baselines": tables["baselines"][["accuracy_test"]], "baselines_trials": TRIALS}
    assert front.rounded(earlier) == earlier
    assert front.rounded({}) == {}


def outcome(svm, network=0.9):
    decided = Decision(network, 1000.0, 500.0, 80.0, None)
    baselines = [Baseline("SVM on signals", 0.95, svm, None), Baseline("ELM on signals", 0.6, 0.5, None)]
    return answer([Network("1&1", 20, 1, 0.9, decided, None)], baselines, 0.25, Trials(400, 400))


@pytest.mark.parametrize(
    ("svm", "narrow", "own", "said"),
    [
        (0.90, 0.895, 0.895, []),
        (0.90, 0.890, 0.890, []),  # a point, and no more
        (0.90, 0.88, None, ["accuracy on test windows falls (SVM on signals 90.0 % to 88.0 %)."]),
        (0.90, 0.91, 0.85, ["accuracy on test windows falls (1&1 ms with 20 neurons 90.0 % to 85.0 %)."]),
        (0.80, 0.88, 0.9, ["the verdict would be 'No clear difference in accuracy'."]),
    ],
)
def test_a_sentence_tells_a_loss_of_more_than_a_point_and_another_verdict(svm, narrow, own, said):
    found = [*sentences.of_width(outcome(svm), outcome(narrow), own)]
    assert found == [f"With 8-bit weights, for which baselines are chosen anew, {words}" for words in said]


def test_a_verdict_that_is_not_clear_any_more_is_said_as_such():
    """With 12 trials only a large difference shows; that none does then is no other verdict than a tie is."""
    verdicts = [Verdict("worse", 0, 0.01, 40, 1), Verdict("tie", 0, 0.5, 12, 6), Verdict("tie", 0, 0.5, 400, 1)]
    worse, few, tie = (outcome(0.9)._replace(verdict=one) for one in verdicts)
    assert [worse.kind, few.kind, tie.kind] == ["worse", "too few trials", "tie"]
    begun = "With 8-bit weights, for which baselines are chosen anew, "
    for before in (worse, worse._replace(verdict=Verdict("better", 0, 0.01, 40, 1))):
        assert [*sentences.of_width(before, few, None)] == [f"{begun}the difference in accuracy is no longer clear."]
        (said,) = sentences.of_width(before, tie, None)
        assert said.startswith(f"{begun}the verdict would be 'No clear difference")
    assert [*sentences.of_width(few, tie, None), *sentences.of_width(tie, few, None)] == []
    assert "Spiking costs accuracy" in "".join(sentences.of_width(few, worse, None))


def test_the_table_shows_what_is_not_rounded_and_the_network_beside_it():
    rows = pd.DataFrame({
        "classifier": "SVM", "input": "signals: counts", "dataset": "all", "t_ref_ra_ms": float("nan"),
        "t_ref_sa_ms": float("nan"),
        "flops": 1.0, "energy_estimate_nJ": 1.0, "settings": "", **SHARES,
    })  # fmt: skip
    what = study.resolve("refractory-period")
    table = _baselines_table(rows, what, 0.625)
    column = table.columns.index("with 8-bit weights (%)")
    assert [row[column] for row in table.rows] == ["60.0", "not rounded"]
    assert "8-bit weights has 62.5 %" in table.caption
    assert "has" not in _baselines_table(rows, what, None).caption


def test_the_accuracy_in_integers_is_that_of_the_network_and_its_setting():
    rows = [("all", "1&1", 20, 0.5), ("all", "1&1", 20, 0.7), ("all", "5&5", 20, 0.1), ("all", "1&1", 50, 0.1),
            ("few", "1&1", 20, 0.1)]  # fmt: skip
    table = pd.DataFrame(rows, columns=["setting", "pair", "hidden", "accuracy_test_8bit"])
    network = outcome(0.9).best
    assert front.in_integers({"integers": table}, "all", network) == pytest.approx(0.6)
    assert front.in_integers({"integers": table[["setting", "pair", "hidden"]]}, "all", network) is None
    assert front.in_integers({}, "all", network) is None


def test_a_long_list_is_cut_short_after_the_network():
    many = tuple(Baseline(f"SVM {n}", 0.95, 0.9, 1.0) for n in range(5))
    known = outcome(0.9)
    before = known._replace(others=many, rivals=many, baseline=many[0], priced=(Priced(known.best, None, many),))
    narrow = before._replace(others=tuple(one._replace(accuracy=0.5) for one in many))
    (said,) = sentences.of_width(before, narrow, 0.5)
    assert "accuracy on test windows falls (1&1 ms with 20 neurons 90.0" in said
    assert said.count("to 50.0") == 3
    assert said.endswith("; and that of 3 others).")
