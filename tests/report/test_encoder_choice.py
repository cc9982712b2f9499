"""Which encoder: validation chooses, and of those that it cannot tell apart the cheapest is named."""

import pytest

from neurotact.report.answer import Baseline, Decision, Network, Trials
from neurotact.report.encoder_choice import Choice, as_table, sentence, table


def choice(name, validation, nJ, pair="1&1", spikes=20.0, n_validation=200, snr_dB=3.0):
    whole = Decision(validation, 100.0, 300.0, spikes, nJ)
    readout = Baseline("logistic regression on 1&1 ms spikes (counts)", 0.8, 0.7, nJ)
    return Choice(name, None, Network(pair, 20, 1, validation, whole, None), Trials(n_validation, 50), readout, snr_dB)


def test_the_cheapest_of_those_that_validation_cannot_tell_apart_is_named():
    lif, burst = choice("lif", 0.9, 50.0, spikes=60.0), choice("burst", 0.89, 30.0, pair="-")
    words = sentence([lif, burst, choice("latency", 0.5, 1.0)])
    assert words.startswith(
        "burst keeps 99 % of the accuracy of lif with t_ref 1&1 ms, the most accurate on validation trials, at 33 % of "
        "the spikes and 60 % of the energy: right in 89.0 % of the test windows (77 to 95 %), for 20 spikes and 30 nJ; "
        "validation trials cannot tell 2 of 3 encoders and refractory periods apart"
    )


def test_the_best_may_be_the_cheapest_of_its_equals():
    words = sentence([choice("lif", 0.9, 20.0), choice("burst", 0.89, 30.0)])
    assert "which cannot tell 2 of 2 encoders and refractory periods apart, and the cheapest of these" in words


def test_an_encoder_that_validation_tells_from_all_others_is_the_answer():
    words = sentence([choice("lif", 0.95, 50.0), choice("burst", 0.6, 1.0)])
    assert words.startswith("lif with t_ref 1&1 ms is the most accurate of 2 encoders and refractory periods, and")
    assert "right in 95.0 %" in words


def test_an_answer_that_guessing_may_reach_says_so():
    among = [choice("lif", 0.6, 20.0)._replace(guess=0.5), choice("burst", 0.55, 30.0)._replace(guess=0.5)]
    assert "not clearly more often than by guessing (50.0 %)" in sentence(among)


def test_the_table_marks_the_best_its_equals_and_the_cheapest():
    among = [choice("a", 0.9, 50.0), choice("b", 0.89, 40.0), choice("c", 0.88, 30.0, pair="5"), choice("d", 0.4, 1.0)]
    found = table(among)
    assert found is not None
    assert [row[0] for row in found.rows] == ["a: best on validation", "b ~", "c: cheapest of its equals", "d"]
    assert found.rows[2][1:] == ["5", "20", "88.0 % (76 to 94)", "70.0 % (56 to 81)", "3.0", "30 nJ"]
    frame = as_table(among)
    assert frame["t_ref_ms"].tolist() == ["1&1", "1&1", "5", "1&1"]
    assert (frame["accuracy_low"] < frame["accuracy_test"]).all()
    assert (frame["readout_test"] == 0.7).all()


@pytest.mark.parametrize("among", [[], [choice("lif", 0.9, 1.0)]])
def test_one_encoder_is_no_choice(among):
    assert sentence(among) == ""
    assert table(among) is None
