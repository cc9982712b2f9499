"""The interval of a report holds other starts of the weights where several are known, and says so where one is."""

import json

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import without_pictures
from made_run import grating_conditions, make_run
from test_report import make_study

from neurotact.metrics import starts
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.use.measuring import OWN_KEYS
from neurotact.report import answer as answers
from neurotact.report import front, networks, sentences
from neurotact.report.answer import Trials
from neurotact.tables import NETWORK

TRIALS = Trials(100, 80)
SHARES = st.lists(st.floats(0.2, 0.9), min_size=2, max_size=4)
COSTS = {f"{kind}_{cost}": 1.0 for kind in front.KINDS for cost in front.COSTS}


def rows(accuracies, splits=lambda network, at: 0):
    """A row for each training of each network, with the split that it is of."""
    return pd.DataFrame([
        {"setting": "all", "pair": "1&1", "hidden": hidden, "seed": at, "split.fold": splits(hidden, at),
         "accuracy_validation": 0.9, "accuracy_test": accuracy, "exit_accuracy": accuracy / 2, **COSTS}
        for hidden, own in enumerate(accuracies, start=1) for at, accuracy in enumerate(own)
    ])  # fmt: skip


@given(st.lists(SHARES, min_size=1, max_size=3))
def test_where_starts_differ_the_interval_holds_them(accuracies):
    apart = starts.spread(accuracies)
    for network, own in zip(front.networks_of(rows(accuracies), ["split.fold"]), accuracies, strict=True):
        low, high = answers.interval_of(network, network.whole, TRIALS)
        assert (low, high) == starts.interval(network.whole.accuracy, TRIALS.test, len(own), apart)
        alone = wilson_interval(network.whole.accuracy, TRIALS.test)
        wider = apart.deviation > 0.01
        assert (low < alone[0]) >= (wider and low > 0)
        assert (high > alone[1]) >= (wider and high < 1)
        early = starts.spread([[share / 2 for share in one] for one in accuracies])
        ends = starts.interval(network.early.accuracy, TRIALS.test, len(own), early)
        assert answers.interval_of(network, network.early, TRIALS) == pytest.approx(ends)
        found = answers.answer([network], [], 0.1, TRIALS)
        assert found.interval == (low, high)
        assert starts.ONE not in sentences.of_starts(found)
        assert f"{100 * apart.deviation:.1f} points apart" in sentences.of_starts(found)


@given(st.lists(SHARES, min_size=1, max_size=3), st.booleans())
def test_a_network_without_a_hidden_layer_has_one_start_and_lends_its_spread_to_none(accuracies, is_part):
    others = rows(accuracies)
    fits = others[others["hidden"] == 1].assign(hidden=0, accuracy_test=0.5)
    fits = fits.assign(**({OWN_KEYS: '{"model": "mine"}'} if is_part else {}))
    first, *rest = front.networks_of(pd.concat([fits, others], ignore_index=True), ["split.fold"])
    apart = starts.spread([*accuracies, *([[0.5] * len(fits)] if is_part else [])])
    assert all(one.apart == apart for one in rest)
    assert first.apart == (apart if is_part else None)
    assert (first.size, first.is_part) == ("" if is_part else "no hidden layer", is_part)
    said = sentences.of_starts(answers.answer([first], [], 0.1, TRIALS))
    assert (starts.FITTED[1:] in said) != is_part
    if not is_part:
        assert answers.interval_of(first, first.whole, TRIALS) == wilson_interval(0.5, TRIALS.test)


@given(st.lists(SHARES, min_size=1, max_size=3))
def test_folds_and_repeats_are_no_starts(accuracies):
    for network in front.networks_of(rows(accuracies, lambda network, at: at), ["split.fold"]):
        assert answers.interval_of(network, network.whole, TRIALS) == wilson_interval(network.whole.accuracy, 80)
        said = sentences.of_starts(answers.answer([network], [], 0.1, TRIALS))
        assert said == "The 95 % interval knows one start of the weights, of each split: others may differ."


def test_starts_are_counted_on_the_split_that_has_the_fewest_and_spread_within_splits():
    table = rows([[0.9, 0.8, 0.5, 0.3, 0.1]], lambda network, at: at // 3)  # three of one fold, two of the other
    (network,) = front.networks_of(table, ["split.fold"])
    assert (network.starts, network.apart) == (2, starts.spread([[0.9, 0.8, 0.5], [0.3, 0.1]]))
    table["split.fold"] = None  # as a table of no folds is read
    (network,) = front.networks_of(table, ["split.fold"])
    assert network.starts == 5


def test_the_energy_by_a_list_is_a_mean_over_starts_and_its_spread_is_no_list():
    table = rows([[0.9, 0.8]]).assign(**{"whole_nJ by mine": [2.0, 4.0], "early_nJ by mine": [1.0, 2.0]})
    (network,) = front.networks_of(table)
    assert (network.whole.by_list, network.early.by_list) == ((("mine", 3.0),), (("mine", 1.5),))


def test_an_interval_of_early_exit_is_of_its_own_spread():
    own = rows([[0.9, 0.9]]).assign(exit_accuracy=[0.7, 0.9])
    (network,) = front.networks_of(own)
    network = network._replace(early=network.early._replace(ms=0.1), exit_bound=0.0)
    assert network.exits
    found = answers.answer([network], [], 0.1, TRIALS)
    assert found.interval == starts.interval(0.8, 80, 2, starts.spread([[0.7, 0.9]]))
    assert "14.1 points apart" in sentences.of_starts(found)


@pytest.mark.parametrize("seeds", [[0], [0, 1, 2]])
def test_a_run_tells_it_in_its_answer_and_in_its_table(tmp_path, monkeypatch, seeds):
    without_pictures(monkeypatch)
    what = make_study(claims=(), sweep={"network.hidden": [20, 30], "seed": seeds})
    folder = make_run(what, tmp_path / "run", grating_conditions())
    networks.write(what, folder)
    (told,) = json.loads((folder / "answer.json").read_text())["answers"]
    best = told["networks"][told["best"]]
    alone = wilson_interval(best[told["used"]]["accuracy"], told["test_trials"])
    low, high = told["interval"]
    assert [best["low"], best["high"]] == [low, high]
    assert f"95 % interval {100 * low:.0f} to {100 * high:.0f} %" in told["headline"]
    assert any(starts.ONE in one for one in told["details"]) == (len(seeds) == 1)
    if len(seeds) == 1:
        assert (low, high) == alone
    else:
        table = pd.read_csv(folder / "results.csv").assign(setting="", pair="")
        name = {"whole": "accuracy_test", "early": "exit_accuracy"}[told["used"]]
        apart = starts.spread(group.tolist() for _, group in table.groupby(NETWORK)[name])
        mean = best[told["used"]]["accuracy"]
        assert [low, high] == pytest.approx(starts.interval(mean, told["test_trials"], 3, apart))
        assert low < alone[0]
    said = f"{100 * mean_of(told):.1f} % ({100 * low:.0f} to {100 * high:.0f})"
    assert said in (folder / "report.html").read_text()


def test_a_run_of_repeats_has_no_starts(tmp_path, monkeypatch):
    without_pictures(monkeypatch)
    sweep, split = {"network.hidden": [20], "split.seed": [0, 1, 2]}, {"seed": 0, "validation": 0.25, "test": 0.25}
    what = make_study(claims=(), sweep=sweep, split=split)
    folder = make_run(what, tmp_path / "run", grating_conditions())
    networks.write(what, folder)
    (told,) = json.loads((folder / "answer.json").read_text())["answers"]
    assert tuple(told["interval"]) == wilson_interval(mean_of(told), told["test_trials"])
    assert told["details"][0] == "The 95 % interval knows one start of the weights, of each split: others may differ."


def mean_of(told):
    return told["networks"][told["best"]][told["used"]]["accuracy"]
