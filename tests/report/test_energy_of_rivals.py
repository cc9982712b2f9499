"""No sentence gives a ratio of energy to a baseline that guesses, or that tests show to be clearly worse."""

import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.cost import encoding_cost
from neurotact.metrics.paired import compare_shares
from neurotact.metrics.prices import ARITHMETIC_45NM
from neurotact.networks.use.ledger import Afferents
from neurotact.report import first_screen, front, sentences, wording
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer
from neurotact.report.sentences import details, headline
from neurotact.spec import load

GUESS = 1 / 3
SHARES = st.integers(0, 40).map(lambda right: right / 40)
NETWORKS = st.lists(
    st.builds(lambda v, a, nJ: Network("1&1", 20, 1, v, Decision(a, 900.0, 500.0, 80.0, nJ), None),
              SHARES, SHARES, st.floats(1, 500)),
    min_size=1, max_size=3,
)  # fmt: skip
BASELINES = st.lists(
    st.builds(Baseline, st.sampled_from([f"{name} on {source} (counts)" for name in ("SVM", "ELM", "trees")
                                         for source in ("signals", "1&1 ms spikes")]),
              SHARES, SHARES, st.floats(1, 500), st.just(()), st.none()),
    min_size=1, max_size=6, unique_by=lambda one: one.name,
)  # fmt: skip


@given(NETWORKS, BASELINES, st.integers(20, 200))
def test_energy_is_compared_with_what_test_trials_do_not_show_to_be_worse(networks, baselines, n):
    found = answer(networks, baselines, GUESS, Trials(n, n))
    (figure,) = (one for one in first_screen.figures(found) if one.what == "energy per decision")
    pairs = [(one.network.used.accuracy, one.comparable) for one in found.priced if one.comparable is not None]
    for used, rival in pairs:
        worse = compare_shares(used, rival.accuracy, n)
        assert not (worse.difference > 0 and worse.is_clear)
        assert rival.accuracy > GUESS
    # The headline and the figure are of the best network, details of the cheapest one, too.
    of_best = [rival for _, rival in pairs if rival == found.comparable]
    for told, rivals in (((headline(found), figure.against), of_best), (details(found), [rival for _, rival in pairs])):
        for sentence in told:
            if re.search(r"times (as much|less)", sentence):
                assert any(one.short in sentence and wording.percent(one.accuracy) in sentence for one in rivals)


def run(validation: float, test: float, baselines: list[Baseline], n_validation=44, n=75):
    """The answer for one network of 155 nJ whose accuracies are given."""
    network = Network("1&1", 20, 1, validation, Decision(test, 11000.0, 861.0, 80.0, 155.0), None)
    return answer([network], baselines, GUESS, Trials(n_validation, n))


def test_a_cheap_baseline_that_guesses_is_named_with_its_accuracy_and_without_a_ratio():
    guesser = Baseline("ELM on signals (mean and deviation)", 0.66, 0.365, 23.2)
    forest = Baseline("extra trees on 1&1 ms spikes (counts)", 0.68, 0.84, 105.0)
    found = run(0.7, 0.743, [guesser, forest])
    assert headline(found).startswith("No clear difference in accuracy: the best network is right in 74.3 %")
    said = " ".join(details(found))
    assert "No ratio to a baseline on signals: each is no better than guessing, or clearly less" in said
    assert "the cheapest is ELM on signals (mean and deviation) at 23.2 nJ and 36.5 % on test windows" in said
    good = Baseline("SVM on signals (10 time bins)", 0.67, 0.72, 77.5)
    found = run(0.7, 0.743, [guesser, forest, good])
    assert (found.priced[0].cheapest, found.comparable) == (guesser, good)
    assert headline(found).startswith(
        "No clear difference in accuracy, and spiking takes 2 times as much energy as SVM on signals with 72.0 %"
    )
    (energy,) = (words for words in details(found) if words.startswith("Energy"))
    assert "2 times as much as SVM on signals (10 time bins) at 77.5 nJ and 72.0 % on test windows" in energy
    assert "ELM" not in energy


def test_what_fails_on_test_trials_alone_is_told_so():
    weak, strong = Baseline("SVM on signals", 0.73, 0.5, 9.0), Baseline("trees on signals", 0.7, 0.9, 9.0)
    found = run(15 / 22, 7 / 22, [weak], 22, 22)
    assert headline(found).startswith("Nothing was learned that holds on test trials: ")
    (warning,) = sentences.gaps(found, "few trials")
    assert "the best network 68.2 % and 31.8 %" in warning
    found = run(15 / 22, 7 / 22, [weak, strong], 22, 22)
    assert headline(found).startswith("The network learned nothing that holds on test trials, other classifiers did: ")
    assert headline(run(0.3, 0.3, [weak._replace(accuracy=0.3)])).startswith("Nothing was learned: ")
    many = [Baseline(f"LR {index} on signals", 0.7, 0.4 + 0.01 * index, 9.0) for index in range(18)]
    assert "none is clearly better than guessing, after correction for 18" in headline(run(0.7, 0.3, many, 22, 22))


def test_what_is_the_cheapest_says_in_which_cost():
    first = Network("10&10", 20, 1, 0.9, Decision(0.8, 4620.0, 887.0, 80.0, 116.0), None)
    found = answer([first, Network("1&1", 20, 1, 0.89, Decision(0.86, 6140.0, 824.0, 80.0, 112.3), None)],
                   [], GUESS, Trials(22, 22))  # fmt: skip
    assert (
        "1&1 ms with 20 neurons is the cheapest in energy (an estimate): 3.2 % less energy, although 33 % more SOPs "
        "(6,140 against 4,620), and test accuracy" in next(iter(details(found)))
    )


@pytest.mark.parametrize("spikes", [100.0, 1500.0])
def test_the_energy_of_encoding_is_that_of_the_decision_it_is_part_of(spikes):
    """In closed form it grows with the spikes: those of this network, not of the study's first one."""
    encoder = load(AfferentSpec, "sa1-ra1-lif", {"integration": "exact"}).model_dump(mode="json", exclude_none=True)
    made_by = Afferents(2, {**encoder, "recorded_Hz": 50.0}, 1000.0)
    decision = Decision(0.9, 1000.0, 1000.0, spikes, 500.0)
    judged = SimpleNamespace(cheapest=SimpleNamespace(used=decision), is_above_chance=True)
    (said,) = front._of_encoding(judged, [made_by], SimpleNamespace(encoding_in="processor", prices=ARITHMETIC_45NM))
    spent = encoding_cost(1, 1000.0, 1000.0, made_by.encoder, spikes=spikes)
    assert f"take {wording.energy(spent.energy_estimate_nJ)} of 500 nJ" in said
