"""A sentence of the answer never says what a row of its table contradicts."""

import re
from collections.abc import Callable, Iterator
from io import StringIO
from random import Random
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.metrics import power, referee
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.starts import Spread
from neurotact.report import answer as answers
from neurotact.report import first_screen, front, sentences, wording
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer
from neurotact.report.sentences import details, headline

NAMES = [
    f"{name} on {source} (counts)" for name in ("SVM", "ELM", "trees", "LR") for source in ("signals", "1&1 ms spikes")
]
SHARES = [0.05, 0.1, 0.5, 0.7, 0.8, 0.85, 0.875, 0.9, 0.925, 0.95, 1.0]
ENERGIES = [0.0, 10.0, 11.0, 20.0, 50.0, 90.0]


def drawn_decision(draw: Random) -> Decision:
    energy_nJ = draw.choice([None, *ENERGIES[1:], *ENERGIES[1:]])
    return Decision(draw.choice(SHARES), draw.choice([100.0, 300.0]), draw.choice([400.0, 500.0]), 80.0, energy_nJ)


def drawn_network(draw: Random, hidden: int) -> Network:
    early, bound = (
        (drawn_decision(draw) if draw.random() < 0.8 else None),
        draw.choice([None, 0.0, 0.01, 0.0101, 0.03, 0.2]),
    )
    pair, tolerance = draw.choice(["1&1", "5&5"]), draw.choice([0.01, 0.05])
    starts = draw.randint(1, 3), *(draw.choice([None, Spread(0.0, 3), Spread(0.04, 3)]) for _ in range(2))
    return Network(pair, hidden, 1, draw.choice(SHARES[4:]), drawn_decision(draw), early, bound, tolerance, *starts)


def tables(seed: int) -> Iterator[tuple[list[Network], list[Baseline], Trials, float]]:
    """Random tables of few values, so that rows are often equal, or just above or below one another."""
    draw = Random(seed)
    for _ in range(40):
        networks = [drawn_network(draw, hidden) for hidden in range(1, draw.randint(2, 5))]
        baselines = [
            Baseline(name, draw.choice(SHARES[3:]), draw.choice(SHARES), draw.choice([None, *ENERGIES]))
            for name in draw.sample(NAMES, draw.randint(0, len(NAMES)))
        ]
        trials = Trials(draw.randint(1, 300), draw.choice([1, 3, 12, 40, 79, 80, 500]))
        yield networks, baselines, trials, draw.choice([0.1, 0.5])


def of_tables(law: Callable[[list[Network], list[Baseline], Trials, float], None]) -> Callable[..., None]:
    """A test that a law holds for random tables."""

    @given(st.integers(0, 2**32))
    def test(seed: int) -> None:
        for table in tables(seed):
            law(*table)

    test.__name__, test.__doc__ = law.__name__, law.__doc__
    return test


def shares(sentence: str) -> list[str]:
    return re.findall(r"[\d.]+ %", sentence)


def rows_of(found, networks, baselines) -> dict[str, list[str]]:
    """The table by the names of its rows, without their marks."""
    return {row[0].partition(": ")[0]: row[1:] for row in first_screen.table(found).rows}


@of_tables
def test_the_verdict_is_that_of_the_tests_of_its_rows(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    said, used = headline(found), found.best.used.accuracy
    tests = [compare_shares(used, one.accuracy, trials.test) for one in found.rivals]
    p = referee.holm([one.p for one in tests])
    worse = any(one.difference < 0 and p < 0.05 for one, p in zip(tests, p, strict=True))
    better = bool(tests) and all(one.difference > 0 and p < 0.05 for one, p in zip(tests, p, strict=True))
    is_above = answers.interval_of(found.best, found.best.used, trials)[0] > guess
    assert said.startswith("Spiking costs accuracy") == (is_above and worse)
    beaten = all(one.accuracy < used for one in baselines)
    assert said.startswith("Spiking is more accurate") == (is_above and better and beaten)
    if is_above and tests:
        weak = not (worse or better) and referee.least_difference(trials.test, len(tests)) > 0.1
        assert said.startswith("Too few test trials") == weak
    if said.startswith("No clear difference"):
        assert not worse
        assert trials.test >= 60 or better
    assert said.startswith(sentences.verdict(found)) or found.kind == "no baseline"


@of_tables
def test_every_share_of_a_sentence_is_of_a_row_of_the_table(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    rows = rows_of(found, networks, baselines)
    known = {wording.percent(guess)} | {share for row in rows.values() for share in shares(row[0])[:1]}
    said = headline(found).replace("95 % interval", "interval").replace("95 % bound", "bound")
    low, high = (100 * end for end in found.interval)
    said = said.replace(f"interval {low:.0f} to {high:.0f} %", "")
    assert {*shares(said)} <= known
    for name in (one for one in NAMES if one in said or any(one in sentence for sentence in details(found))):
        assert name in rows
    for one in found.rivals:  # a name with a share has its own
        for share in re.findall(re.escape(one.name) + r" in ([\d.]+ %)", said):
            assert share == wording.percent(one.accuracy)


def energies(found) -> list[tuple[Network, str]]:
    """Every sentence on the energy of a network beside baselines, with the network that it is of."""
    by_name = {one.name: one for one in (found.cheapest, found.best)}
    for sentence in details(found):
        if sentence.startswith("Energy of "):
            yield by_name[sentence.removeprefix("Energy of ").partition(", an estimate")[0]], sentence


@of_tables
def test_no_row_of_signals_that_is_cheaper_and_as_accurate_stays_unnamed(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    on_signals = [one for one in baselines if " signals " in one.name and one.nJ is not None]
    told = dict(energies(found))
    if found.is_above_chance and on_signals:
        assert {
            one for one in (found.best, found.cheapest) if one.used.nJ is not None and one.whole.nJ is not None
        } == {*told}
    for network, sentence in told.items():
        used, spent = network.used.accuracy, network.used.nJ
        ahead = [one for one in on_signals if one.nJ < spent and one.accuracy >= used]
        for one in on_signals:
            at = f"{one.name} at {wording.energy(one.nJ)} and {wording.percent(one.accuracy)}"
            assert (one not in ahead) or at in sentence
            named_so = one.name in sentence.partition("cheaper and at least as accurate: ")[2]
            assert not named_so or one in ahead
        fair = [one for one in on_signals if one.accuracy > guess and
                (one.accuracy >= used or not compare_shares(used, one.accuracy, trials.test).is_clear)]  # fmt: skip
        least = min((one.nJ for one in fair), default=None)
        assert ("No ratio to a baseline" in sentence) == (not fair)
        if fair:
            named = re.search(r"(?:beside|times as much as|times less than) (.*?) at ", sentence)[1]
            (one,) = (one for one in on_signals if one.name == named)
            assert one in fair
            assert one.nJ == least
            if "times less" in sentence:
                assert spent < least
            if "times as much" in sentence:
                assert spent > least
    priced = found.priced[0]
    if priced.network.used.nJ is not None:
        assert [*priced.cheaper] == sorted(priced.cheaper, key=lambda one: (one.nJ, -one.accuracy))


@of_tables
def test_a_ratio_of_energy_is_that_of_the_rows_it_names(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    figure = next((one.against for one in first_screen.figures(found) if one.what == "energy per decision"), "")
    beside = found.comparable or found.priced[0].cheapest
    assert figure.partition(" (")[0].partition(": ")[0].endswith(beside.short if beside and figure else "")
    assert bool(figure) == (beside is not None and found.best.used.nJ is not None)
    ratios = [(found.best, headline(found)), (found.best, figure), *energies(found)]
    for network, sentence in ratios:
        for ratio, kind in re.findall(r"([\d.,]+) times (as much|less)", sentence):
            rival = next(each for each in found.priced if each.network == network).comparable
            shown = (
                rival.name if sentence != headline(found) else f"{rival.short} with {wording.percent(rival.accuracy)}"
            )
            assert shown in sentence
            spent = network.used.nJ, rival.nJ
            assert float(ratio.replace(",", "")) == pytest.approx(max(spent) / min(spent), rel=0.06)
            assert (kind == "as much") == (spent[0] > spent[1])


@of_tables
def test_early_exit_never_ranks_networks(networks, baselines, trials, guess):
    found, draw = answer(networks, baselines, guess, trials), Random(trials.validation)
    other = [one._replace(early=drawn_decision(draw), exit_bound=draw.choice([None, 0.0, 0.2])) for one in networks]
    again = answer(other, baselines, guess, trials)
    for which in ("best", "cheapest"):
        one, two = getattr(found, which), getattr(again, which)
        assert (one.pair, one.hidden) == (two.pair, two.hidden)
    assert found.error == again.error


@of_tables
def test_early_exit_is_used_where_its_loss_is_bounded(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    best, said = found.best, headline(found)
    saves = best.early is not None and (
        best.early.ms < 0.995 * best.whole.ms or best.early.sops < 0.995 * best.whole.sops
    )
    is_used = saves and best.exit_bound is not None and best.exit_bound <= best.tolerance
    assert best.used == (best.early if is_used else best.whole)
    assert (f"on whole windows {wording.percent(best.whole.accuracy)}" in said) == is_used
    assert ("early exit" in said) == is_used
    for each in found.priced if found.is_above_chance else ():
        one, name = each.network, "it" if len(found.priced) == 1 else each.network.name
        of = "" if name == "it" else f" of {name}"
        told = [
            said for said in details(found) if said.startswith((f"With early exit {name} d", f"Early exit{of} is not"))
        ]
        assert len(told) == (one.early is not None and one.saves)
        known = one.exit_bound is not None
        bound = f"it may lose up to {100 * (one.exit_bound or 0):.2g} points" if known else "is not known"
        assert all(bound in about and about.startswith("With") == one.exits for about in told)


@of_tables
def test_what_is_the_cheapest_within_the_error_costs_less_in_its_row(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    rows, n_test = first_screen.table(found).rows, trials.test
    (cheapest,) = [row for row in rows if "cheapest within its error" in row[0]]
    (best,) = [row for row in rows if "best on validation" in row[0]]
    assert best[1] == first_screen.within(found.best.used.accuracy, found.interval)
    if found.cheapest != found.best:
        interval = answers.interval_of(found.cheapest, found.cheapest.whole, trials)
        assert cheapest[1] == first_screen.within(found.cheapest.whole.accuracy, interval)
        ours, theirs = (one.way(trials).cost for one in (found.cheapest, found.best))
        assert ours <= theirs
        told = next((s for s in details(found) if s.startswith("Within the error")), "")
        assert ("on whole windows" in told) == (bool(told) and (found.best.exits or found.cheapest.exits))
        if told:
            after = float(re.search(r"SOPs \(([\d,]+) against", told)[1])
            assert after == found.cheapest.whole.sops
            assert told.endswith(f"{wording.percent(found.cheapest.whole.accuracy)}.")
    for (marked,) in [[row for row in rows if "not clearly less accurate" in row[0]]] if found.comparable else []:
        assert marked[0].startswith(found.comparable.name)
        assert marked[1] == first_screen.with_interval(found.comparable.accuracy, n_test)


@of_tables
def test_a_gap_between_validation_and_test_is_of_whole_windows(networks, baselines, trials, guess):
    found = answer(networks, [], guess, trials)
    for told in sentences.gaps(found, "few trials"):
        validation, test = (wording.percent(share) for share in (found.best.validation, found.best.whole.accuracy))
        assert f"the best network {validation} and {test}" in told


@of_tables
def test_the_answer_for_programs_is_that_of_the_rows(networks, baselines, trials, guess):
    found = answer(networks, baselines, guess, trials)
    told = front.as_json(SimpleNamespace(networks=networks, cells=range(len(networks)), answer=found))
    for network, entry in zip(networks, told["networks"], strict=True):
        assert entry["used"] == ("early" if network.exits else "whole")
        assert (entry["low"], entry["high"]) == answers.interval_of(network, network.used, trials)
    assert told["used"] == ("early" if found.best.exits else "whole")
    used = found.best.used
    expected = {one.name for one in baselines if not one.is_of_spikes and one.nJ is not None
                and used.nJ is not None and one.nJ < used.nJ and one.accuracy >= used.accuracy}  # fmt: skip
    assert {one["name"] for one in told["cheaper"]} == expected
    cautions = [*front._of_front(SimpleNamespace(answer=found, lost=[]), None)]
    assert cautions == [] if found.is_above_chance else f"accuracy of {wording.percent(used.accuracy)}" in cautions[0]


@pytest.mark.parametrize("exits", [False, True])
def test_trials_are_those_of_the_decision_that_is_used(monkeypatch, exits):
    results = {"right": {"3": 1.0, "4": 1.0, "5": 0.0}, "exit_right": {"3": 0.0, "4": 1.0, "5": 0.0}}
    monkeypatch.setattr(front, "result_of", lambda folder, cell: results)
    whole = Decision(0.9, 900.0, 500.0, 80.0, None)
    network = Network("1&1", 20, 1, 0.9, whole, whole._replace(sops=100.0), 0.0 if exits else None)
    rows = pd.DataFrame({"pair": ["1&1"], "hidden": [20]})
    trials = pd.DataFrame({"baseline": [0, 0, 0], "trial": [3, 4, 5], "right": [0.0, 0.0, 0.0]})
    baselines = {"baselines": pd.DataFrame(index=[0]), "baselines_trials": trials}
    compare = front._comparing(SimpleNamespace(sweep={}), None, [None], rows, baselines)
    found = compare(network, Baseline("SVM on signals", 0.9, 0.0, 1.0, (0,)))
    assert found.difference == pytest.approx((1 if exits else 2) / 3)


def test_trials_are_paired_in_splits_whose_names_are_texts_of_digits(monkeypatch):
    """What a file says of the person 01 is read as 1."""
    key, names = "split.test_where.person", ["01", "02"]
    cells = [SimpleNamespace(split=SimpleNamespace(test_where=SimpleNamespace(person=name))) for name in names]
    results = {"01": {"3": 1.0, "4": 1.0}, "02": {"5": 1.0, "6": 0.0}}
    monkeypatch.setattr(front, "result_of", lambda _, cell: {"right": results[cell.split.test_where.person]})
    read = pd.read_csv(StringIO("\n".join([key, *names])))
    rows = pd.DataFrame({"pair": "1&1", "hidden": 20, key: read[key]})
    trials = pd.DataFrame({"baseline": [0, 0, 1, 1], "trial": [3, 4, 5, 6], "right": [0.0, 0.0, 0.0, 0.0]})
    tables = {"baselines": read, "baselines_trials": trials}
    compare = front._comparing(SimpleNamespace(sweep={key: names}), None, cells, rows, tables)
    network = Network("1&1", 20, 2, 0.9, Decision(0.75, 900.0, 500.0, 80.0, None), None)
    found = compare(network, Baseline("SVM on signals", 0.9, 0.0, 1.0, (0, 1)))
    assert (found.n, found.difference) == (4, 0.75)


@given(st.integers(0, 200), st.integers(1, 8))
def test_too_few_trials_are_those_whose_test_shows_no_difference_of_ten_points(n, opponents):
    verdict = referee.Verdict("tie", 0, 1.0, n, opponents)
    ten = next((m for m in range(n + 1) if opponents * 2 * 0.5**m < 0.05 and m > 0), None)  # all favour one
    assert power.is_too_weak(verdict) == (ten is None or ten / n > 0.1)
    assert not power.is_too_weak(verdict._replace(kind="better"))
    assert ("no difference would show" in power.in_words(verdict)) == (ten is None)


def test_twelve_test_trials_are_the_headline():
    network = Network("1&1", 20, 1, 1.0, Decision(1.0, 900.0, 500.0, 80.0, 100.0), None)
    rivals = [Baseline(f"{index} on signals (counts)", 0.9, 5 / 12, 10.0) for index in range(6)]
    trials = np.repeat([1.0, 0.0], [7, 5])
    found = answer([network], rivals, 0.25, Trials(12, 12), lambda *_: Paired(float(trials.mean()), 0.016, 12))
    assert headline(found).startswith(
        "Too few test trials to tell whether spiking costs accuracy: only differences of 67 points or more would show; "
        "the best network is right in 100.0 % of"
    )
    assert found.kind == "too few trials"
    three = answer([network], rivals, 0.5, Trials(3, 3))
    assert headline(three).startswith(
        "Too few test trials: a network that is right in all of them would not be clearly"
    )


@given(st.sampled_from(SHARES), st.sampled_from(SHARES), st.integers(4, 300), st.booleans())
def test_a_loss_by_the_encoding_is_of_one_kind_of_baseline_and_clear(signals, spikes, n, is_validated):
    """The better baseline has no twin on spikes, and a worse one on signals does not count."""
    rivals = [
        Baseline("MiniRocket on signals", 1.0, 1.0, None),
        Baseline("SVM on signals (bins)", signals, signals, None),
        Baseline("ELM on signals (bins)", 0.0, 1.0, None),
        Baseline("SVM on 1&1 ms spikes (counts)", spikes if is_validated else signals, spikes, None),
        Baseline("SVM on 9&9 ms spikes (counts)", 0.0, 1.0, None),
        Baseline("ELM on 1&1 ms spikes (counts)", 0.0, 0.0, None),
    ]
    network = Network("1&1", 20, 1, 1.0, Decision(1.0, 1.0, 1.0, 1.0, None), None)
    said = sentences.lost_in_encoding(answer([network], rivals, 0.0, Trials(n, n)))
    held = (spikes + (spikes if is_validated else signals)) / 2
    is_clear = signals - spikes > power.WEAK and referee.is_gap(signals, 2 * n, held, 2 * n, referee.LEVEL)
    expected = (
        f"The encoding loses {100 * (signals - spikes):.0f} points (SVM: {100 * signals:.1f} % on signals, "
        f"{100 * spikes:.1f} % on spikes)"
    )
    assert said == (expected if is_clear else "")
    assert sentences.lost_in_encoding(answer([network], rivals[:3], 0.0, Trials(n, n))) == ""
