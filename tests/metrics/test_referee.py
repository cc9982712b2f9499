"""The referee: choices by hand, laws of choices, Holm's correction, and claims where there is no difference."""

import math
from functools import cache
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import thinned
from scipy.stats import binomtest

from neurotact.errors import InputError
from neurotact.metrics import paired, referee
from neurotact.metrics.paired import Paired
from neurotact.metrics.referee import Way
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer

share = st.integers(0, 20).map(lambda n: n / 20)
ways = st.lists(
    st.builds(Way, share, st.floats(0, 0.2), st.sampled_from([1.0, 2.0, 5.0, math.inf]), st.none()),
    min_size=1,
    max_size=8,
)
comparisons = st.lists(
    st.builds(Paired, st.floats(-1, 1, allow_nan=False), st.floats(0, 1, allow_nan=False), st.just(40)),
    min_size=1,
    max_size=6,
)


@given(ways)
def test_no_way_beats_the_best_and_of_equal_ones_none_is_cheaper(some):
    best = some[referee.best_of(some)]
    assert all(way.validation <= best.validation for way in some)
    assert all(way.cost >= best.cost for way in some if way.validation == best.validation)


@given(ways)
def test_the_cheapest_is_within_the_error_and_none_there_is_cheaper(some):
    best, cheapest = some[referee.best_of(some)], some[referee.cheapest_of(some)]
    assert cheapest.validation >= best.validation - best.error - 1e-9
    assert all(way.cost >= cheapest.cost for way in some if way.validation >= best.validation - best.error)


@given(ways, st.permutations(range(8)))
def test_the_order_of_different_ways_does_not_matter(some, order):
    distinct = list({way[::2]: way for way in some}.values())  # by accuracy and cost
    mixed = [distinct[index] for index in order if index < len(distinct)]
    assert distinct[referee.best_of(distinct)] == mixed[referee.best_of(mixed)]
    assert {distinct[i] for i in referee.level_with_best(distinct)} == {
        mixed[i] for i in referee.level_with_best(mixed)
    }


@given(ways)
def test_whatever_is_within_the_error_is_level_with_the_best(some):
    assert referee.best_of(some) in referee.within_error(some)
    assert {*referee.within_error(some)} <= {*referee.level_with_best(some)}


def test_means_that_differ_in_their_last_bits_are_equal():
    assert referee.best_of([Way(0.1 + 0.2, cost=5.0), Way(0.3, cost=1.0)]) == 1


def test_a_way_without_a_validation_accuracy_is_never_best():
    assert referee.best_of([Way(math.nan, cost=0.0), Way(0.1, cost=9.0)]) == 1


def test_without_an_error_only_equals_are_within_it():
    assert referee.within_error([Way(0.9, math.nan), Way(0.9), Way(0.89)]) == [0, 1]


def right(*wrong: int, n: int = 40) -> dict[int, float]:
    return {trial: float(trial not in wrong) for trial in range(n)}


def test_single_trials_tell_apart_what_shares_cannot():
    """Eight trials that one has wrong and the other right: p = 2 / 2^8; as shares of 40, 0.8 is within two errors."""
    best, other = Way(1.0, 0.03, right=right()), Way(0.8, 0.1, right=right(*range(8)))
    assert referee.level_with_best([best, other]) == [0]
    assert referee.level_with_best([best._replace(right=None), other]) == [0, 1]  # two errors are 21 points
    close = Way(0.9, 0.05, right=right(*range(4)))
    assert referee.level_with_best([best, close]) == [0, 1]  # four trials: p = 0.125
    near = best._replace(error=0.2)
    assert referee.level_with_best([near, other]) == [0, 1]  # within the error, whatever single trials say
    elsewhere = Way(0.6, 0.03, right={f"other {trial}": 0.0 for trial in range(8)})
    assert referee.level_with_best([best, elsewhere]) == [0]  # no common trial: by the errors
    assert referee.level_with_best([best, elsewhere._replace(error=0.3)]) == [0, 1]
    few = Way(0.2, 0.01, right={**right(*range(5), n=5)})
    assert referee.level_with_best([best, few]) == [0, 1]  # five common trials tell nothing: p = 0.0625


ERRORS = st.floats(0, 0.2) | st.just(math.nan)
UNSURE = st.lists(st.builds(Way, share | st.just(math.nan), ERRORS, st.just(1.0), st.none()), min_size=1, max_size=8)


@given(UNSURE)
def test_of_an_unknown_error_nothing_is_said_to_be_level(some):
    at = referee.best_of(some)
    best = some[at]
    for index in referee.level_with_best(some):
        way = some[index]
        known = not math.isnan(best.error) and best.validation - way.validation <= best.error + 1e-9
        both = best.validation - way.validation <= 2 * math.hypot(best.error, way.error)  # false if one is NaN
        assert index == at or way.validation == best.validation or known or both
    assert at in referee.within_error(some)
    assert referee.cheapest_of(some) in referee.within_error(some)


@given(st.lists(share, min_size=2, max_size=8, unique=True), st.integers(0, 7))
def test_with_one_seed_the_best_stands_alone(shares, at):
    """A single row has no error: neither near nor far is told, whichever of them has none."""
    unknown = [Way(validation, math.nan) for validation in shares]
    best = referee.best_of(unknown)
    assert referee.level_with_best(unknown) == referee.within_error(unknown) == [best] == [shares.index(max(shares))]
    one = [way if index == at % len(shares) else way._replace(error=0.0) for index, way in enumerate(unknown)]
    assert referee.level_with_best(one) == [best]


def test_holm_by_hand():
    assert referee.holm([]) == []
    assert referee.holm([0.04]) == [0.04]
    assert referee.holm([0.03, 0.02]) == [0.04, 0.04]
    assert referee.holm([0.5, 0.9]) == [1.0, 1.0]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_corrects_upwards_at_most_as_bonferroni_and_keeps_the_order(p):
    corrected = referee.holm(p)
    assert all(raw <= new <= min(1.0, len(p) * raw) or raw == new for raw, new in zip(p, corrected, strict=True))
    order = np.argsort(p, kind="stable")
    assert np.all(np.diff(np.array(corrected)[order]) >= 0)


@given(comparisons)
def test_a_verdict_is_that_of_every_comparison(some):
    verdict = referee.judge(some)
    corrected = referee.holm([one.p for one in some])
    clear = [one.difference for one, p in zip(some, corrected, strict=True) if p < 0.05]
    if verdict.kind == "better":
        assert len(clear) == len(some)
        assert min(clear) > 0
    assert (verdict.kind == "worse") == any(difference < 0 for difference in clear)
    assert verdict.p == corrected[verdict.decisive]


def test_one_strong_opponent_late_in_the_list_decides():
    many = [Paired(0.2, 0.0001, 60)] * 15
    assert referee.judge([*many, Paired(-0.2, 0.0001, 60)])[:2] == ("worse", 15)
    assert referee.judge([*many, Paired(0.01, 0.6, 60)])[:2] == ("tie", 15)
    assert referee.judge(many).kind == "better"


def test_a_comparison_at_the_level_is_not_clear():
    assert referee.judge([Paired(0.1, 0.05, 40)]).kind == "tie"
    assert referee.judge([Paired(0.1, 0.025, 40)] * 2).kind == "tie"  # twice 0.025


def shown(n: int, better: int, worse: int, opponents: int) -> referee.Kind:
    """The verdict on one that is right on `better` trials where each opponent is wrong, and wrong on `worse` others."""
    mine, other = np.zeros(n), np.zeros(n)
    mine[:better], other[better : better + worse] = 1.0, 1.0
    return referee.judge([paired.compare(mine, other)] * opponents).kind


@given(st.integers(1, 120), st.integers(1, 25), st.none() | st.floats(0, 1))
def test_the_least_difference_is_clear_and_a_smaller_one_is_not(n, opponents, discordance):
    least = referee.least_difference(n, opponents, discordance)
    apart = n if discordance is None else round(discordance * n)
    ways = [(b, w) for b in range(apart + 1) for w in ([0] if discordance is None else [apart - b]) if b > w]
    found = [(b - w) / n for b, w in ways if shown(n, b, w, opponents) == "better"]
    assert least == min(found, default=math.inf)


@pytest.mark.parametrize("wrong", [(-1, 1, None), (9, 0, None), (9, 1, 1.2), (9, 1, -0.1)])
def test_a_least_difference_of_nothing_is_refused(wrong):
    with pytest.raises(InputError, match="n_trials, opponents, discordance"):
        referee.least_difference(*wrong)


@pytest.mark.parametrize(
    ("validation", "test", "gap"), [((1.0, 45), (0.43, 180), True), ((0.95, 20), (0.9, 40), False)]
)
def test_a_gap_is_a_loss_beyond_chance(validation, test, gap):
    assert referee.is_gap(*validation, *test) == gap
    assert not referee.is_gap(*test, *validation)  # a gain is none


@cache
def mcnemar(won: int, lost: int) -> float:
    return float(binomtest(won, won + lost).pvalue) if won + lost else 1.0


def exact(mine: np.ndarray, other: np.ndarray) -> Paired:
    """McNemar's exact test, which the permutation test is for single windows, and which takes microseconds."""
    won, lost = int((mine > other).sum()), int((other > mine).sum())
    return Paired((won - lost) / len(mine), mcnemar(won, lost), len(mine))


def study_without_difference(rng: np.random.Generator, n_validation: int, n_test: int, n_baselines: int):
    """A network and baselines that are right with the same probability, partly on the same trials."""
    n = n_validation + n_test
    ease = rng.random(n)[:, None] < 0.5
    decided = np.where(ease, rng.random((n, 1)), rng.random((n, n_baselines + 3))) < 0.8
    validation, test = decided[:n_validation], decided[n_validation:]
    names = [str(index) for index in range(n_baselines + 3)]
    networks = [
        Network(name, 10, 1, validation[:, i].mean(), Decision(test[:, i].mean(), 1.0, 1.0, 1.0, 1.0), None)
        for i, name in enumerate(names[:3])
    ]
    baselines = [
        Baseline(name, validation[:, i].mean(), test[:, i].mean(), 1.0, right=dict(enumerate(validation[:, i] * 1.0)))
        for i, name in enumerate(names)
        if i >= 3
    ]

    def compare(network: Network, baseline: Baseline) -> Paired:
        return exact(test[:, int(network.pair)], test[:, int(baseline.name)])

    return answer(networks, baselines, 0.1, Trials(n_validation, n_test), compare)


@thinned(("n_validation", "n_test", "n_baselines"), [(20, 40, 8), (60, 100, 20), (9, 18, 3)], every=2)
def test_in_studies_without_a_difference_a_difference_is_claimed_in_at_most_one_of_twenty(
    n_validation, n_test, n_baselines, monkeypatch
):
    monkeypatch.setattr(paired, "compare", exact)
    rng = np.random.default_rng(7)
    kinds = [study_without_difference(rng, n_validation, n_test, n_baselines).kind for _ in range(1000)]
    assert sum(kind in ("better", "worse") for kind in kinds) <= 50
    assert sum(kind in ("tie", "too few trials") for kind in kinds) >= 940


def test_what_is_not_counted_is_neither_cheaper_nor_the_best_of_equals():
    ways = [Way(0.9, 0.03, cost) for cost in (math.nan, 5.0, math.inf)]
    for order in permutations(ways):
        assert order[referee.best_of(order)].cost == order[referee.cheapest_of(order)].cost == 5.0
