"""Which encoder: validation chooses, and of those that it cannot tell apart the cheapest is named."""

import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.comparison.encoder_choice import Choice, _of_each_pair, as_table, details, sentence, table

from neurotact.metrics import starts
from neurotact.metrics.paired import compare_shares
from neurotact.metrics.referee import LEVEL
from neurotact.metrics.starts import Spread
from neurotact.report.answer import Baseline, Decision, Network, Trials


def choice(name, validation, nJ, pair="1&1", spikes=20.0, n_validation=200, snr_dB=3.0, test=None):
    whole = Decision(validation if test is None else test, 100.0, 300.0, spikes, nJ)
    readout = Baseline("logistic regression on 1&1 ms spikes (counts)", 0.8, 0.7, nJ)
    return Choice(name, None, Network(pair, 20, 1, validation, whole, None), Trials(n_validation, 50), readout, snr_dB)


def test_the_cheapest_of_those_that_validation_cannot_tell_apart_is_named():
    lif, burst = choice("lif", 0.9, 50.0, spikes=60.0), choice("burst", 0.89, 30.0, pair="-")
    among = [lif, burst, choice("latency", 0.5, 1.0)]
    assert sentence(among) == (
        "burst saves 40 % of the energy of lif with t_ref 1&1 ms, at an accuracy that validation trials cannot tell "
        "from its own: right in 89.0 % of the test windows, for 30 nJ a decision."
    )
    assert details(among) == [
        "Validation trials cannot tell 2 of 3 encoders and refractory periods apart.",
        "lif with t_ref 1&1 ms: right in 90.0 % of the test windows (79 to 96 %), for 60 spikes and 50 nJ.",
        "burst: right in 89.0 % of the test windows (77 to 95 %), for 20 spikes and 30 nJ.",
    ]


def test_the_best_may_be_the_cheapest_of_its_equals():
    words = sentence([choice("lif", 0.9, 20.0), choice("burst", 0.89, 30.0)])
    assert words.startswith("lif with t_ref 1&1 ms saves 33 % of the energy of burst with t_ref 1&1 ms, at an accuracy")
    assert words.endswith(": right in 90.0 % of the test windows, for 20 nJ a decision.")
    assert "takes as much energy as burst" in sentence([choice("lif", 0.9, 30.0), choice("burst", 0.89, 30.01)])


def test_where_the_energy_of_one_is_not_counted_all_are_compared_by_synaptic_operations():
    mine = choice("mine", 0.89, None)
    mine = mine._replace(network=mine.network._replace(whole=mine.network.whole._replace(sops=60.0)))
    assert sentence([choice("lif", 0.9, 50.0), mine]).startswith("mine with t_ref 1&1 ms saves 40 % of the SOPs of lif")


def test_an_encoder_that_validation_tells_from_all_others_is_the_answer():
    words = sentence([choice("lif", 0.95, 50.0), choice("burst", 0.6, 1.0)])
    assert words == (
        "lif with t_ref 1&1 ms is more accurate than all others on validation trials: right in 95.0 % of the test "
        "windows, for 50 nJ a decision."
    )
    above = sentence([choice("lif", 0.95, 50.0), choice("burst", 0.6, 60.0, test=0.97)])
    assert above.endswith("; on test trials burst with t_ref 1&1 ms has 97.0 %, which is not clearly more.")


def test_an_encoder_that_test_trials_show_to_be_worse_is_not_the_answer():
    """The cheapest of its equals on validation is right in 62.5 % of the test windows, beside 93.8 % of another."""
    among = [choice("lif", 0.9, 50.0, test=0.938), choice("send-on-delta", 0.9, 1.0, test=0.625)]
    assert sentence(among) == (
        "lif with t_ref 1&1 ms is the only one within the error of the best that test trials do not speak against: "
        "right in 93.8 % of the test windows, for 50 nJ a decision."
    )
    found = table(among)
    assert found is not None
    assert [row[0] for row in found.rows] == [
        "lif, 1&1 ms: cheapest within its error", "send-on-delta, 1&1 ms: best on validation"
    ]  # fmt: skip


def test_where_validation_and_test_trials_differ_none_is_the_cheapest():
    cheaper = [choice("lif", 0.9, 50.0, test=0.85), choice("burst", 0.6, 5.0, test=0.86)]
    assert sentence(cheaper) == (
        "No encoder is clearly the cheapest: validation trials prefer lif with t_ref 1&1 ms (85.0 % of the test "
        "windows, 50 nJ a decision), and burst with t_ref 1&1 ms is no dearer and no less accurate on test trials "
        "(86.0 %, 5 nJ a decision)."
    )
    worse = [choice("lif", 0.9, 5.0, test=0.5), choice("burst", 0.6, 50.0, test=0.9)]
    assert sentence(worse).endswith("within its standard error to be clearly less accurate than another.")
    for among in (cheaper, worse):
        found = table(among)
        assert found is not None
        assert [row[0] for row in found.rows] == ["lif, 1&1 ms: best on validation", "burst, 1&1 ms"]


SHARES = st.sampled_from([0.5, 0.6, 0.8, 0.85, 0.9])


@given(st.lists(st.tuples(SHARES, SHARES, st.integers(1, 4)), min_size=2, max_size=6), st.sampled_from([16, 40, 200]))
def test_no_sentence_crowns_a_row_that_its_table_contradicts(rows, n_trials):
    among = [
        choice(f"e{at}", validation, 10.0 * cost, "-", n_validation=n_trials, test=test)._replace(
            trials=Trials(n_trials, n_trials)
        )
        for at, (validation, test, cost) in enumerate(rows)
    ]
    words, found = sentence(among), table(among)
    assert found is not None
    named = re.match(r"(e\d) ", words)
    marked = [row[0] for row in found.rows if "cheapest" in row[0]]
    if named is None:
        assert words.startswith("No encoder is clearly the cheapest")
        assert marked == []
        return
    (crowned,) = [one for one in among if one.encoder in named.groups()]
    assert [mark[:2] for mark in marked] == [crowned.encoder]
    mine = crowned.network.used
    for other in (one.network.used for one in among if one is not crowned):
        assert other.nJ is not None
        assert mine.nJ is not None
        assert not (other.nJ < mine.nJ and other.accuracy >= mine.accuracy)
        clear = compare_shares(other.accuracy, mine.accuracy, n_trials)
        assert not (clear.difference > 0 and clear.p * len(among) * (len(among) - 1) / 2 < LEVEL)


def test_what_is_picked_is_the_decision_whose_cost_is_told():
    """Early exit makes the dearer of two on whole windows the cheaper one, where it is used."""
    plain, exits = choice("lif", 0.9, 30.0), choice("burst", 0.9, 50.0)
    early = exits.network.whole._replace(nJ=5.0, ms=100.0)
    for bound, named in ((0.0, "burst"), (0.2, "lif"), (None, "lif")):
        among = [plain, exits._replace(network=exits.network._replace(early=early, exit_bound=bound))]
        assert sentence(among).startswith(f"{named} with")
        assert ("for 5 nJ a decision" in sentence(among)) == (named == "burst")
        (marked,) = [row for row in table(among).rows if "cheapest" in row[0]]
        assert marked[0].startswith(named)


def test_an_interval_of_an_encoder_holds_other_starts_and_equals_of_one_period_are_chosen_as_used():
    first = choice("lif", 0.9, 50.0)
    apart = first._replace(network=first.network._replace(starts=3, apart=Spread(0.05, 4)))
    low, high = starts.interval(0.9, 50, 3, Spread(0.05, 4))
    for said in (" ".join(details([apart, choice("burst", 0.5, 60.0)])), table([apart, apart]).rows[0][1]):
        assert f"({100 * low:.0f} to {100 * high:.0f}" in said
    assert as_table([apart])["accuracy_low"].item() == low
    plain, exits = first.network, first.network._replace(hidden=30, exit_bound=0.0)
    exits = exits._replace(early=plain.whole._replace(nJ=5.0, ms=100.0), whole=plain.whole._replace(nJ=60.0))
    front = SimpleNamespace(answer=SimpleNamespace(rows=[plain, exits], trials=first.trials))
    assert [*_of_each_pair(front)] == [exits]


def test_an_answer_that_guessing_may_reach_says_so():
    among = [choice("lif", 0.6, 20.0)._replace(guess=0.5), choice("burst", 0.55, 30.0)._replace(guess=0.5)]
    assert "not clearly more often than by guessing (50.0 %)" in sentence(among)


def test_the_table_marks_the_best_its_equals_and_the_cheapest():
    among = [choice("a", 0.9, 50.0), choice("b", 0.89, 40.0), choice("c", 0.88, 30.0, pair="5"), choice("d", 0.4, 1.0)]
    found = table(among)
    assert found is not None
    assert [row[0] for row in found.rows] == [
        "a, 1&1 ms: best on validation", "b, 1&1 ms ~", "c, 5 ms: cheapest within its error", "d, 1&1 ms"
    ]  # fmt: skip
    assert found.rows[2][1:] == ["88.0 % (76 to 94)", "30 nJ", "20", "70.0 % (56 to 81)", "3.0"]
    frame = as_table(among)
    assert frame["t_ref_ms"].tolist() == ["1&1", "1&1", "5", "1&1"]
    assert (frame["accuracy_low"] < frame["accuracy_test"]).all()
    assert (frame["readout_test"] == 0.7).all()


@pytest.mark.parametrize("among", [[], [choice("lif", 0.9, 1.0)]])
def test_one_encoder_is_no_choice(among):
    assert sentence(among) == ""
    assert table(among) is None
