"""The answer of a run: hand-computed choices, ties, a single network, and what beats what."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact import spec_names
from neurotact.encoders.model import DrivenSpec
from neurotact.encoders.specs import load
from neurotact.metrics.paired import Paired
from neurotact.metrics.shares import standard_error
from neurotact.report import first_screen, front, sentences
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer
from neurotact.report.sentences import details, headline

TRIALS = Trials(validation=96, test=100)


def network(pair="1&1", hidden=50, validation=0.9, accuracy=0.9, sops=1000.0, early=None, nJ=None) -> Network:
    return Network(pair, hidden, 3, validation, Decision(accuracy, sops, 1000.0, 80.0, nJ), early)


def test_where_nothing_is_clear_every_rival_is_named_by_its_ends():
    rivals = [Baseline("LR", 1.0, 0.3, 1.0), Baseline("trees", 1.0, 0.74, 9.0), Baseline("weak", 0.2, 0.9, 1.0)]
    said = headline(answer([network(accuracy=0.3)], rivals, 0.25, TRIALS))
    assert "2 baselines that validation cannot tell apart are right in 30.0 % (LR) to 74.0 % (trees): some of" in said


def test_a_baseline_that_is_not_counted_is_compared_by_accuracy_alone():
    """Were its cost zero, it would be the cheapest and, of equals, the best."""
    rivals = [Baseline(f"{name} on signals", 0.9, 0.9, nJ) for name, nJ in (("mine", None), ("SVM", 25.0))]
    found = answer([network(nJ=250.0)], rivals, 0.25, TRIALS)
    assert (found.baseline, found.comparable) == (rivals[1], rivals[1])
    assert found.rivals == tuple(rivals)
    *_, told = details(found)
    assert told == "The cost of mine is not counted, so that no sentence on energy compares with it."
    assert not any("not counted" in line for line in details(answer([network(nJ=250.0)], rivals[1:], 0.25, TRIALS)))
    shown = first_screen.table(found).rows
    assert {row[0].partition(" on ")[0]: row[-1] for row in shown}["mine"] == "not counted"


def test_the_cheapest_within_the_error_is_chosen_on_validation_trials():
    best = network("1&1", validation=0.95, accuracy=0.93, sops=1000)
    near = network("5&5", validation=0.93, accuracy=0.91, sops=400)  # 0.02 below, error 0.0253
    far = network("10&10", validation=0.92, accuracy=0.99, sops=100)  # 0.03 below; its test accuracy is ignored
    found = answer([best, near, far], [], 0.25, TRIALS)
    assert found.error == pytest.approx(math.sqrt((0.95 * 96 + 2) / 100 * (1 - (0.95 * 96 + 2) / 100) / 100))
    assert (found.best, found.cheapest) == (best, near)
    (words,) = details(found)
    assert "5&5 ms with 50 neurons is the cheapest in SOPs: 60 % fewer SOPs (400 against 1,000)" in words
    assert "test accuracy falls by 2.0 points (2 of 100 test trials) to 91.0 %" in words


def test_trials_are_counted_where_a_change_is_of_fewer_than_three():
    for lost, words in ((0.02, "2.0 points (2 of 100 test trials) to"), (0.03, "3.0 points to")):
        near = network("5&5", validation=0.89, accuracy=0.9 - lost, sops=400)
        assert f"test accuracy falls by {words}" in next(details(answer([network(), near], [], 0.25, TRIALS)))


def test_exactly_at_the_error_is_within_it():
    error = standard_error(0.95, 96)
    near = network("5&5", validation=0.95 - error, sops=400)
    assert answer([network(validation=0.95), near], [], 0.25, TRIALS).cheapest == near


def test_of_equal_networks_the_cheapest_is_best():
    dear, cheap = network("1&1", sops=1000), network("5&5", sops=999)
    found = answer([dear, cheap], [], 0.25, TRIALS)
    assert found.best == found.cheapest == cheap


def test_of_equally_cheap_networks_the_more_accurate_on_validation_trials_is_chosen():
    one, other = network("1&1", validation=0.9), network("5&5", validation=0.89)
    assert answer([other, one], [], 0.25, TRIALS).cheapest == one


def test_a_single_network_is_best_and_cheapest():
    found = answer([network()], [], 0.25, TRIALS)
    assert found.best == found.cheapest
    assert "is also the cheapest" in next(details(found))
    assert found.kind == "no baseline"
    assert headline(found).startswith("The best network is right in 90.0 %")


@pytest.mark.parametrize(
    ("accuracy", "rival", "kind", "words"),
    [
        # as shares of different trials: standard errors of 3.1 and 1.7 points, 3.1 and 4.3 points
        (0.90, 0.98, "worse", "Spiking costs accuracy"),
        (0.90, 0.96, "tie", "No clear difference"),
        (0.90, 0.80, "tie", "No clear difference"),
        (0.90, 0.79, "better", "Spiking is more accurate"),
        (0.25, 0.25, "nothing learned", "the best baseline is not clearly better than guessing either (SVM, 25.0 %)"),
        (0.20, 0.95, "nothing learned", "the best baseline is clearly better than guessing (SVM, 95.0 %)"),
        # 21.9 to 39.6 %: more than guessing, and guessing may reach it
        (0.30, 0.30, "unclear", "Not clearly better than guessing: the best network is right in 30.0 % of the test"),
        (0.30, 0.95, "unclear", "of 100 test trials, guessing in 25.0 %; the best baseline is clearly better"),
    ],
)
def test_the_network_is_judged_beside_the_baseline_and_guessing(accuracy, rival, kind, words):
    found = answer([network(accuracy=accuracy)], [Baseline("SVM", 0.9, rival, 12.0)], 0.25, TRIALS)
    assert found.kind == kind
    assert words in headline(found)
    assert bool(list(details(found))) == (kind not in ("nothing learned", "unclear"))


@pytest.mark.parametrize(
    ("accuracy", "short", "loses"),
    [
        (0.97, "Saving costs accuracy, spiking shows no clear loss", ["the encoding", "the saving"]),
        (0.88, "Spiking costs accuracy", ["the encoding", "the network", "the saving"]),
    ],
)
def test_of_a_chosen_network_it_is_told_whether_spiking_or_saving_costs_accuracy(accuracy, short, loses):
    best = network("1&1", validation=0.99, accuracy=accuracy, sops=1000.0)
    cheap = network("5&5", validation=0.98, accuracy=0.8, sops=400.0)
    rivals = [Baseline("SVM on signals", 0.99, 0.99, 12.0), Baseline("SVM on spikes (counts)", 0.99, 0.96, 12.0)]
    found = answer([best, cheap], rivals, 0.25, TRIALS, chosen=cheap)
    assert (found.best, found.leader, found.called) == (cheap, best, "chosen")
    assert sentences.verdict(found) == short
    assert [" ".join(line.split()[:2]) for line in sentences.where_lost(found)] == loses
    first = next(details(found))
    assert first.startswith(f"1&1 ms with 50 neurons is the best network on validation trials, with {100 * accuracy}")
    assert "5&5 ms with 50 neurons, the cheapest within its error (" in first
    assert "has 60 % fewer SOPs (400 against 1,000), and test accuracy falls by" in first
    same = answer([best, cheap], rivals, 0.25, TRIALS, chosen=best)
    assert same.ahead is None
    assert same.called == "chosen"
    assert "is the best network on validation trials" not in " ".join(details(same))


@pytest.mark.parametrize(
    ("paired", "kind", "words"),
    [
        (Paired(-0.02, 0.03, 100), "worse", "SVM, 92.0 % (100 test trials, p = 0.03)."),
        (Paired(-0.02, 0.07, 100), "tie", "SVM, 92.0 % (100 test trials, p = 0.07)."),
        (Paired(0.02, 0.0004, 100), "better", "p < 0.001"),
    ],
)
def test_where_trials_are_paired_they_decide_and_not_the_interval(paired, kind, words):
    found = answer([network()], [Baseline("SVM", 0.9, 0.92, 12.0)], 0.25, TRIALS, lambda network, baseline: paired)
    assert found.kind == kind
    assert words in headline(found)


def test_the_baseline_is_chosen_on_validation_trials_and_of_equal_ones_the_cheapest():
    rivals = [Baseline("a", 0.7, 0.99, 1.0), Baseline("b", 0.9, 0.7, 50.0), Baseline("c", 0.9, 0.6, 5.0)]
    found = answer([network()], rivals, 0.25, TRIALS)
    assert found.baseline == rivals[2]
    assert found.rivals == (rivals[1], rivals[2])


@pytest.mark.parametrize(
    ("ms", "sops", "saves"), [(1000.0, 1000.0, False), (990.0, 1000.0, True), (1000.0, 990.0, True)]
)
def test_an_early_exit_that_never_exits_is_told_so(ms, sops, saves):
    early = Decision(0.9, sops, ms, 80.0, None)
    said = " ".join(details(answer([network(early=early)], [], 0.25, TRIALS)))
    assert ("Early exit saves nothing here: it decides at the end of the window, after 1,000 ms." in said) != saves
    assert ("Early exit is not used: what it may lose is not known." in said) == saves


def test_early_exit_and_energy_are_told_of_the_cheapest():
    early = Decision(0.89, 500.0, 420.0, 40.0, 200.0)
    spiking = network(early=early, nJ=390.0)._replace(exit_bound=0.009)
    found = answer([spiking], [Baseline("SVM", 0.9, 0.9, 24.0)], 0.25, TRIALS)
    words = " ".join(details(found))
    assert "decides after 420 ms of 1,000 ms on average: 50 % fewer SOPs (500 against 1,000)" in words
    assert "falls by 1.0 points (1 of 100 test trials) to 89.0 %" in words
    assert "50 % fewer SOPs (500 against 1,000) and 49 % less energy, and test" in words
    assert (
        "390 nJ for a whole window, 200 nJ with early exit; that is 8.3 times as much as SVM at 24 nJ and 90.0 %"
        in words
    )
    assert headline(found).startswith(
        "No clear difference in accuracy, and spiking takes 8.3 times as much energy as SVM with 90.0 % (estimate): "
        "the best network, with early exit, is right in 89.0 % of the test windows (95 % interval 81 to 94 %; on whole "
        "windows 90.0 %), the best"
    )


@pytest.mark.parametrize("accuracy", [0.8, 0.9])
def test_whole_windows_are_used_where_validation_does_not_bound_the_loss_of_early_exit(accuracy):
    """Whatever it loses on test trials, nothing included."""
    early = Decision(accuracy, 500.0, 420.0, 40.0, 200.0)
    known = {bound: f"it may lose up to {100 * bound:.0f} points, of which 1 is" for bound in (0.2, 1.0)}
    for bound, words in {None: "what it may lose is not known.", **known}.items():
        spiking = network(early=early, nJ=390.0)._replace(exit_bound=bound)
        found = answer([spiking], [], 0.25, TRIALS)
        assert found.best.used == found.best.whole
        (about,) = (one for one in details(found) if one.startswith("Early exit is not used: "))
        assert words in about
        assert "early exit" not in headline(found)


def test_energy_is_not_told_where_it_is_about_equal_or_unknown():
    for ours, theirs in ((25.0, 24.0), (None, 24.0), (25.0, None)):
        found = answer([network(nJ=ours)], [Baseline("SVM", 0.9, 0.9, theirs)], 0.25, TRIALS)
        assert headline(found).startswith("No clear difference in accuracy: ")


def test_fewer_operations_that_save_no_energy_are_not_sold_as_savings():
    best, near = network("1&1", sops=1000, nJ=590.0), network("5&5", validation=0.89, sops=800, nJ=588.0)
    assert "20 % fewer SOPs (800 against 1,000) and 0.34 % less energy" in next(
        details(answer([best, near], [], 0.25, TRIALS))
    )


def test_nearly_all_energy_that_is_saved_is_told_without_an_exponent():
    best, near = network("1&1", sops=1000, nJ=590.0), network("5&5", validation=0.89, sops=2, nJ=1.0)
    assert "and 100 % less energy" in next(details(answer([best, near], [], 0.25, TRIALS)))


def test_what_is_lost_is_divided_between_encoding_and_network():
    rivals = [
        Baseline("ELM on signals (10 time bins)", 0.6, 0.8, 198.0),
        Baseline("SVM on signals (mean and deviation)", 0.5, 0.95, 55.0),  # better on test trials, which do not choose
        Baseline("logistic regression on 10&10 ms spikes (10 time bins)", 0.57, 0.57, 754.0),
        Baseline("SVM on 1&1 ms spikes (counts)", 0.37, 0.7, 763.0),
    ]

    def lost(accuracy: float, known=rivals, trials=TRIALS):
        return list(sentences.where_lost(answer([network(accuracy=accuracy)], known, 0.05, trials), ["at more"]))

    encoding, trained = lost(0.33)
    assert "the encoding loses 23.0 points (80.0 % by ELM on signals (10 time bins), 57.0 % by logistic" in encoding
    assert encoding.endswith("; look at other windows (`settings={'window.length_ms': ..., 'window.align': 'onset'}`) "
                             "and at more")  # fmt: skip
    assert "the network loses 24.0 points (57.0 % by logistic regression on 10&10 ms spikes" in trained
    assert "record more trials" in trained
    assert lost(0.56) == [encoding]  # one test trial of a hundred is no loss
    assert lost(0.93) == []  # no clear difference
    assert lost(0.33, rivals[:2]) == []  # no classifier of spikes


@pytest.mark.parametrize("name", spec_names("encoders"))
def test_the_remedies_of_an_encoding_are_those_that_its_encoder_has(name, monkeypatch, tmp_path):
    encoder = load(name)
    said = " ".join(front._of_afferents(encoder))
    for key in re.findall(r"'encoder\.([\w.]+)'", said):
        assert key in type(encoder).model_fields
    for other in re.findall(r"'encoder': '([\w-]+)'", said):
        assert load(other).model == encoder.model
        assert load(other) != encoder
    if encoder.model != "lif":
        assert "which-encoder compares" in said
    if "compare=True" in said:
        assert isinstance(encoder, DrivenSpec)
        assert not encoder.is_signed


def test_more_operations_are_not_called_fewer():
    early = Decision(0.9, 1100.0, 990.0, 40.0, None)
    spiking = network(early=early)._replace(exit_bound=0.0)
    assert "10 % more SOPs" in " ".join(details(answer([spiking], [], 0.25, TRIALS)))
    silent = network(sops=0.0, early=Decision(0.9, 0.0, 1.0, 0.0, None))._replace(exit_bound=0.0)
    assert "0 % fewer SOPs" in " ".join(details(answer([silent], [], 0.25, TRIALS)))


SHARE = st.floats(0, 1)
NETWORKS = st.lists(
    st.builds(lambda v, a, s, h: network("1&1", h, v, a, s), SHARE, SHARE, st.floats(0, 1e6), st.integers(1, 99)),
    min_size=1, max_size=8,
)  # fmt: skip


@given(NETWORKS, st.integers(1, 500))
def test_the_cheapest_never_costs_more_and_lies_within_the_error(networks, n):
    found = answer(networks, [], 0.5, Trials(n, n))
    assert found.cheapest.whole.sops <= found.best.whole.sops
    assert found.best.validation - found.cheapest.validation <= found.error + 1e-9
    assert all(one.validation <= found.best.validation + 1e-9 for one in networks)  # sums differ in their last bits
    assert sentences.headline(found)
