"""One refractory period is named: what the sentence says is what the rows say, and no single trial decides it."""

import itertools
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.splits import Split
from neurotact.metrics.referee import Way, cheapest_of, may_be_cheapest
from neurotact.metrics.resampled import Interval
from neurotact.metrics.shares import standard_error
from neurotact.metrics.starts import Spread
from neurotact.report import first_screen, front, period_choice
from neurotact.report.answer import Decision, Network, Trials, answer
from neurotact.report.period_choice import Comparison, Evidence, Places, Sure

PAIRS = ("1&1", "5&5", "10&10")
SURE = Sure(test=100, splits=1, trainings=3, each=40)


class Run:
    """A made-up run: for each pair, size and seed which validation and test trials are right, and the costs."""

    def __init__(self, seed: int, n: int = 60, apart: float = 0.06, seeds: int = 3, splits: int = 1) -> None:
        draw = np.random.default_rng(seed)
        hard = draw.random((2, splits, n))
        kinds = itertools.product(PAIRS, draw.choice([20, 50], draw.integers(1, 3), replace=False).tolist())
        level, self.right, rows = draw.uniform(0.6, 1.0), {}, []
        for pair, hidden in kinds:
            skill, cost = level + draw.normal(0, apart), hidden * (1 - 0.04 * float(pair.partition("&")[0]))
            for split, start in itertools.product(range(splits), range(seeds)):
                right = (hard[:, split] + draw.normal(0, 0.02, (2, n)) < skill).astype(float)
                self.right[len(rows)] = right
                sops = cost * draw.uniform(98, 102)
                rows.append({"pair": pair, "hidden": hidden, "seed": start, "split.fold": split,
                             "whole_sops": sops, "whole_nJ": sops / 80 + 10})  # fmt: skip
        self.rows, self.n, self.splits = pd.DataFrame(rows), n, ("split.fold",) if splits > 1 else ()

    def networks(self, without: int | None = None) -> list[Network]:
        """Without one validation trial."""
        kept = [index for index in range(self.n) if index != without]
        found = []
        for (pair, hidden), own in self.rows.groupby(["pair", "hidden"], sort=False):
            validation, test = (np.mean([self.right[row][side] for row in own.index], axis=0) for side in (0, 1))
            spent = Decision(float(test.mean()), *own[["whole_sops"]].mean(), 500.0, 80.0, own["whole_nJ"].mean())
            found.append(Network(pair, hidden, len(own), float(validation[kept].mean()), spent, None, starts=len(own)))
        return found

    def choice(self, without: int | None = None):
        n_validation = self.n - (without is not None)
        networks, trials = self.networks(without), Trials(n_validation, self.n)
        for side, name in enumerate(("accuracy_validation", "accuracy_test")):
            self.rows[name] = [self.right[row][side].mean() for row in self.rows.index]
        found = answer(networks, [], 0.25, trials, chosen=period_choice.chosen(networks, trials))
        compared = Comparison(self.rows, self._right, self.splits, (3 * self.n, self.n, float(self.n)))
        choice = period_choice.choose(found, compared)
        assert choice is not None
        return found, choice

    def _right(self, row: int) -> dict[str, float]:
        return {str(trial): right for trial, right in enumerate(self.right[row][1])}


RUNS = st.builds(Run, st.integers(0, 2**32), st.sampled_from([30, 60, 200]), st.sampled_from([0.0, 0.02, 0.1]),
                 st.sampled_from([1, 3]), st.sampled_from([1, 2, 4]))  # fmt: skip


@given(RUNS)
def test_the_sentence_says_what_the_rows_say(run):
    found, choice = run.choice()
    said = period_choice.in_words(choice, SURE, ("RA-I", "SA-I"))
    at = {(one.pair, one.hidden): one for one in found.rows}
    shortest = at["1&1", choice.network.hidden]
    (marked,) = [row[0] for row in first_screen.table(found).rows if ": chosen" in row[0]]
    assert marked == f"{choice.network.pair} ms, {choice.network.hidden}: chosen"
    assert found.best == found.cheapest == choice.network
    longer = choice.longer
    saved, lost = 1 - longer.whole.sops / shortest.whole.sops, shortest.whole.accuracy - longer.whole.accuracy
    assert f"saves {100 * saved:.0f} % of the SOPs" in said or saved < 0.095
    points = re.search(r"(for|and gains) ([\d.]+) points", said)
    assert float(points[2]) == pytest.approx(100 * abs(lost), abs=0.051)
    assert (points[1] == "for") == (lost > -0.0005)
    assert said.startswith(
        {
            "use": f"Use t_ref of {longer.pair.partition('&')[0]} ms: it saves",
            "none": "No refractory period pays",
            "unclear": "These recordings cannot tell",
        }[choice.kind]
    )
    evidence = choice.evidence
    assert evidence.lost.low <= lost <= evidence.lost.high
    if choice.kind == "use":
        assert choice.network == longer != shortest
        assert longer.whole.nJ < shortest.whole.nJ
        assert evidence.lost.high <= 0.1
        assert not (evidence.lost.low > 0 and lost > 0.01)
    if choice.kind == "none":
        assert choice.network == shortest
        better = [one for one in found.rows if one.hidden == shortest.hidden and one.pair != "1&1"]
        assert all(one.whole.accuracy < shortest.whole.accuracy for one in better if one.whole.nJ < shortest.whole.nJ)
    assert choice.why in said
    assert (choice.kind == "unclear") == bool(choice.why) == bool(choice.fix)


@given(st.integers(0, 2**32), st.sampled_from([25, 60]), st.sampled_from([0.0, 0.03]), st.sampled_from([1, 3]))
def test_one_trial_less_never_names_another_period(seed, n, apart, seeds):
    run = Run(seed, n, apart, seeds)
    _, choice = run.choice()
    for trial in range(0, n, 12):
        _, other = run.choice(without=trial)
        named = {(one.kind, one.network.pair) for one in (choice, other) if one.kind != "unclear"}
        assert len(named) <= 1


@given(st.integers(0, 2**32), st.integers(5, 60), st.integers(2, 5), st.sampled_from([0.03, 0.1, 0.2]))
def test_what_one_trial_less_would_choose_is_among_what_may_be_cheapest(seed, n, n_ways, apart):
    draw = np.random.default_rng(seed)

    def ways(kept: np.ndarray, costs: list[int]) -> list[Way]:
        return [Way(share, standard_error(share, len(kept)), cost)
                for share, cost in zip(kept.mean(axis=0).tolist(), costs, strict=True)]  # fmt: skip

    for _ in range(20):
        right = (draw.random((n, n_ways)) < draw.uniform(0.6, 1.0) + draw.normal(0, apart, n_ways)).astype(float)
        costs = draw.permutation(n_ways).tolist()
        may_be = may_be_cheapest(ways(right, costs), n, [0.0] * n_ways)
        left = [cheapest_of(ways(np.delete(right, trial, axis=0), costs)) for trial in range(n)]
        assert {cheapest_of(ways(right, costs)), *left} <= {*may_be}


def decided(pair: str, hidden: int, validation: float, nJ: float, accuracy: float = 0.95) -> Network:
    return Network(pair, hidden, 1, validation, Decision(accuracy, 10 * nJ, 500.0, 80.0, nJ), None)


EQUAL = Evidence(Interval(0.4, 0.35, 0.47), Interval(0.12, 0.09, 0.15), Interval(0.004, -0.006, 0.014))


def choose(networks, evidence=EQUAL, untold="", trials=Trials(400, 400)):
    found = answer(networks, [], 0.25, trials, chosen=period_choice.chosen(networks, trials))
    choice = period_choice.choose(found, lambda one, other: evidence, untold)
    assert choice is not None
    return choice


def test_two_populations_with_two_periods_are_both_named():
    networks = [decided("1&1", 20, 0.95, 100), decided("10&5", 20, 0.95, 60)]
    said = period_choice.in_words(choose(networks), SURE, ("RA-I", "SA-I"), 6.7)
    assert said == (
        "Use t_ref of 10 ms for RA-I and 5 ms for SA-I (shorter than a sample of 6.7 ms): it saves 40 % of the SOPs "
        "(35 to 47) and 12 % of the energy (9 to 15) for 0.4 points (\u22120.6 to 1.4), against 1 ms, both with 20 "
        "neurons; 100 test trials of one split, 3 trainings each."
    )
    assert period_choice.in_words(choose([decided("1", 20, 0.95, 100), decided("5", 20, 0.95, 60)]), SURE).startswith(
        "Use a dead time (t_ref) of 5 ms: it saves"
    )


def test_another_size_of_the_best_with_the_shortest_period_is_told_too():
    three = [("1&1", 20, 0.94, 100), ("1&1", 50, 0.951, 300), ("10&10", 20, 0.95, 60)]
    networks = [decided(*one)._replace(starts=3, seeds=3, apart=Spread(0.005, 6)) for one in three]
    said = period_choice.in_words(choose(networks), SURE, ("RA-I", "SA-I"))
    assert "against 1 ms, both with 20 neurons; against the best with 1 ms, of 50 neurons, it saves 40 %" in said


@pytest.mark.parametrize("sizes", [(30, 20), (20, 30), (30, 0), (0, 30)])
@pytest.mark.parametrize("costs", [(100, 60), (60, 100)])
def test_periods_that_each_searched_a_size_are_compared_and_each_size_is_named(sizes, costs):
    known = {"starts": 3, "seeds": 3, "apart": Spread(0.005, 6)}
    two = [
        decided(pair, size, 0.95, nJ)._replace(**known)
        for pair, size, nJ in zip(("5&5", "20&20"), sizes, costs, strict=True)
    ]
    choice = choose(two)
    chosen, other = two if costs[0] < costs[1] else two[::-1]
    assert (choice.network, choice.other, choice.larger) == (chosen, other, None)
    said = period_choice.in_words(choice, SURE, ("RA-I", "SA-I"))
    assert all(f"{name} ms{one.with_size}" in said for name, one in zip(("5", "20"), two, strict=True))
    assert "both" not in said
    shared = [*two, decided("20&20", 77, 0.5, 900)]  # where sizes are swept, one of another size is no peer
    assert period_choice.chosen(shared, Trials(400, 400)) is None
    parts = [one._replace(hidden=0, is_part=True) for one in two]
    said = period_choice.in_words(choose(parts), SURE, ("RA-I", "SA-I"))
    assert " ms" in said
    assert "both" not in said


def test_a_network_without_a_hidden_layer_is_compared_with_such_a_one_and_named_so():
    rows = [("1&1", 0, 0.95, 100), ("10&10", 0, 0.95, 60), ("1&1", 20, 0.951, 300), ("10&10", 20, 0.95, 200)]
    known = {"starts": 3, "seeds": 3, "apart": Spread(0.005, 6)}
    smallest, other, *_ = networks = [decided(*one)._replace(**known if one[1] else {}) for one in rows]
    choice = choose(networks)
    assert (choice.network, choice.other) == (other, smallest)
    said = period_choice.in_words(choice, SURE, ("RA-I", "SA-I"))
    assert "against 1 ms, both without a hidden layer; against the best with 1 ms, of 20 neurons, it saves" in said
    larger = period_choice.in_words(choice._replace(larger=(smallest, EQUAL)), SURE, ("RA-I", "SA-I"))
    assert "against the best with 1 ms, without a hidden layer, it saves" in larger
    assert (other.name, other._replace(pair="-").name) == ("10&10 ms without a hidden layer", "no hidden layer")
    part = other._replace(is_part=True)  # whose neurons are not counted
    assert (part.name, part._replace(pair="-").name) == ("10&10 ms with the network", "the network")


def test_no_start_of_the_weights_is_blamed_or_asked_for_where_there_is_one_fit():
    few = Trials(40, 400)
    fits = [decided("1&1", 0, 0.95, 100), decided("10&10", 0, 0.95, 60), decided("5&5", 0, 0.97, 80)]
    choice = choose(fits, trials=few)
    assert (choice.kind, choice.fix) == ("unclear", "trials")
    assert choice.why.startswith("a few other validation trials would choose ")
    assert [period_choice.noise_of(one, few) for one in fits] == [0.0] * 3
    choice = choose([one._replace(hidden=20) for one in fits], trials=few)
    assert (choice.kind, choice.fix) == ("unclear", "seeds")
    assert "or other starts of the weights, would choose " in choice.why
    unsure = EQUAL._replace(nJ=None, sops=Interval(0.1, -0.1, 0.3))
    sure = [decided("1&1", 0, 0.95, 100), decided("10&10", 0, 0.95, 60)]
    assert choose(sure, unsure).fix == "trials"


def test_nothing_is_said_without_two_periods():
    assert period_choice.chosen([decided("5&5", 20, 0.9, 9), decided("5&5", 50, 0.9, 9)], Trials(40, 40)) is None
    assert period_choice.chosen([decided("-", 20, 0.9, 9)], Trials(40, 40)) is None


@pytest.mark.parametrize(
    ("evidence", "untold", "trials", "why"),
    [
        (EQUAL, "Validation has no other speed", Trials(400, 400), "validation has no other speed"),
        (EQUAL, "", Trials(400, 1), "no network is clearly better than guessing"),
        (EQUAL._replace(lost=Interval(0.05, 0.02, 0.08)), "", Trials(400, 400), "a clear loss"),
        (EQUAL._replace(lost=Interval(0.0, -0.11, 0.11)), "", Trials(400, 400), "more than ten points"),
        (EQUAL._replace(nJ=Interval(0.1, -0.1, 0.3)), "", Trials(400, 400), "trainings differ"),
        (EQUAL._replace(seen=(0.02, True)), "", Trials(400, 400), "on validation trials"),
        (EQUAL._replace(lost=Interval(0.0, np.nan, np.nan)), "", Trials(400, 400), "is not known"),
    ],
)
def test_what_speaks_against_a_period_is_told_in_its_place(evidence, untold, trials, why):
    networks = [decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.95, 60)]
    choice = choose(networks, evidence, untold, trials)
    assert choice.kind == "unclear"
    assert why in period_choice.in_words(choice, SURE)


def test_a_longer_period_that_loses_nothing_on_test_trials_is_not_said_not_to_pay():
    networks = [decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.7, 60)]
    assert choose(networks, EQUAL._replace(lost=Interval(-0.01, -0.03, 0.01))).kind == "unclear"
    assert choose(networks, EQUAL._replace(lost=Interval(0.2, 0.15, 0.25))).kind == "none"


@given(st.text("ab c'&$", min_size=1, max_size=5), st.booleans())
def test_commands_name_their_paths_whole_and_quoted(name, may_fold):
    networks = [decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.95, 60)]
    run = Path("/runs") / name / "mine"
    places = Places(run, run / "cells" / "x", run.with_name("a.h5"), may_fold)
    choices = [
        choose(networks),
        choose(networks, untold="none"),
        choose(networks, EQUAL._replace(nJ=Interval(0, 0, 0))),
    ]
    for choice in choices:
        words, commands = period_choice.next_step(choice, SURE, places)
        assert words.endswith(":")
        for command in commands:
            head, *rest = shlex.split(command)
            assert head == "neurotact"
            assert [one for one in rest if str(run.parent) in one]
            out = rest[rest.index("-o") + 1] if "-o" in rest else None
            assert out is None or Path(out) not in (run, places.cell)


@pytest.mark.parametrize("may_fold", [False, True])
def test_where_the_encoding_loses_much_the_next_step_is_the_encoder_alone(may_fold):
    places = Places(Path("/runs/mine"), Path("/runs/mine/cells/x"), Path("/a.h5"), may_fold)
    for choice in (
        choose([decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.95, 60)], untold=u) for u in ("", "x")
    ):
        words, commands = period_choice.next_step(choice, SURE, places, "The encoding loses 30 points")
        assert words == "The encoding loses 30 points; compare encoders:"
        assert commands == ["neurotact study run which-encoder --data /a.h5 -o /runs/mine-encoders"]
        simulated = places._replace(recordings=None)  # which a study of encoders cannot be given
        assert period_choice.next_step(choice, SURE, simulated, "x") == period_choice.next_step(choice, SURE, simulated)


@pytest.mark.parametrize("may_fold", [False, True])
def test_where_tests_are_too_few_for_a_verdict_every_trial_is_tested_before_anything_is_taken_along(may_fold):
    places = Places(Path("/runs/mine"), Path("/runs/mine/cells/x"), Path("/a.h5"), may_fold)
    clear = choose([decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.95, 60)])
    found = period_choice.next_step(clear, SURE, places, few=True)
    assert found == (period_choice.in_folds(places.run) if may_fold else period_choice.next_step(clear, SURE, places))
    assert "save" in period_choice.next_step(clear, SURE, places)[1][0]


def test_twice_the_trials_are_asked_for_at_least_and_more_for_a_wide_interval():
    wide = choose([decided("1&1", 20, 0.95, 100), decided("10&10", 20, 0.95, 60)],
                  EQUAL._replace(lost=Interval(0.02, -0.22, 0.26)))  # fmt: skip
    assert period_choice.trials_needed(wide, SURE) == 360
    assert period_choice.trials_needed(wide._replace(evidence=EQUAL), SURE) == 80


def test_splits_of_unequal_sizes_count_as_their_mean(monkeypatch):
    """Groups that are tested in turn: the first of them may be the largest."""
    sides = [Split(*map(np.arange, sizes)) for sizes in ((10, 3, 8), (14, 3, 4))]
    monkeypatch.setattr(front, "task_of", lambda cell: cell)
    monkeypatch.setattr(front.tasks, "trials_of", lambda trains, cell: sides[cell])
    run = front._OfRun(None, None, (), None, object())
    n_train, n_test, trials = run._sizes([0, 1])
    assert (n_test / n_train, trials) == (12 / 24, 6.0)
    assert run._replace(trains=None)._sizes([0, 1]) == (1, 1, 1.0)


@pytest.mark.parametrize("splits", [(), ("split.fold",)])
def test_no_more_than_all_is_saved(splits):
    both = pd.DataFrame({"whole_sops of other": [100.0] * 3, "whole_sops": [10.0, 90.0, 50.0], "split.fold": [0, 1, 2]})
    found = Comparison(both, lambda row: None, splits, (20, 10, 10.0))._saved(both, "whole_sops")
    assert found is not None
    assert found.low < 0 < found.mean < found.high == 1
