"""A search proposes the same networks from one seed, refuses what it cannot search, and keeps NNI to itself."""

import copy
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.networks.search import tuning
from neurotact_parts.networks.search.tuning import MedianStop, Tuner

import neurotact
from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec

PACKAGE = Path(neurotact.__file__).parent
SPACE = {
    "hidden": {"_type": "quniform", "_value": [10, 50, 1]},
    "tau_mem_ms": {"_type": "loguniform", "_value": [5, 200]},
    "training.batch": {"_type": "choice", "_value": [64, 128]},
}
TUNERS = ("tpe", "random", "grid")


def searching(space=SPACE, **settings):
    return Tuner(SearchSpec(space=space, **settings))


def score(parameters):
    """Best at 30 neurons."""
    return 1.0 - abs(parameters["hidden"] - 30) / 40


def play(tuner, steps):
    """Ask and tell `steps` batches; every proposal made."""
    proposals = []
    for _ in range(steps):
        for trial in tuner.ask():
            proposals.append(trial)
            tuner.tell(trial.id, score(trial.parameters))
    return proposals


# --- proposals ---------------------------------------------------------------------------------


@pytest.mark.parametrize("tuner", TUNERS)
def test_one_seed_gives_one_sequence(tuner):
    first, again = (play(searching(tuner=tuner, seed=3, batch=4), 12) for _ in range(2))
    assert first == again
    assert [trial.id for trial in first] == list(range(48))


@pytest.mark.parametrize("tuner", ["tpe", "random"])
def test_seeds_differ(tuner):
    assert play(searching(tuner=tuner, seed=3), 4) != play(searching(tuner=tuner, seed=4), 4)


@pytest.mark.parametrize("tuner", TUNERS)
def test_every_proposal_is_a_network(tuner):
    for trial in play(searching(tuner=tuner, batch=5), 12):
        assert spaces.apply(RSNNSpec(), trial.parameters, "test").hidden == trial.parameters["hidden"]
        assert isinstance(trial.parameters["hidden"], int)


def test_the_first_trial_can_be_given_and_the_tuner_proposes_the_others():
    """What NNI proposes does not depend on the given trial, whose values need not lie in the space."""
    space = {"hidden": {"_type": "choice", "_value": list(range(20, 60))}}
    with_first, without = (Tuner(SearchSpec(space=space, trials=9, batch=3, first=f)) for f in ({"hidden": 7}, None))
    found = []
    while batch := with_first.ask():
        found += batch
        for trial in batch:
            with_first.tell(trial.id, 100.0 if trial.id == 0 else trial.parameters["hidden"])
    assert [trial.id for trial in found] == list(range(9))
    assert found[0].parameters == {"hidden": 7}
    assert all(trial.parameters["hidden"] in range(20, 60) for trial in found[1:])
    assert len(without.ask()) == 3


def test_a_given_first_trial_of_another_key_is_refused():
    with pytest.raises(InputError, match="first: 'membrane' is not in the space"):
        specs.build(SearchSpec, {"space": SPACE, "first": {"membrane": "delayed"}}, source="here")


def test_tpe_finds_what_random_search_misses():
    late = {tuner: [score(t.parameters) for t in play(searching(tuner=tuner), 12)[60:]] for tuner in ("tpe", "random")}
    assert sum(late["tpe"]) > sum(late["random"])


def test_the_last_batch_ends_with_the_trials():
    assert [len(batch) for batch in iter_batches(searching(trials=10, batch=4))] == [4, 4, 2]


@pytest.mark.parametrize("tuner", TUNERS)
def test_a_space_that_is_used_up_ends_the_search(tuner):
    space = {
        "hidden": {"_type": "choice", "_value": [20, 30]},
        "training.batch": {"_type": "randint", "_value": [1, 4]},
    }
    proposed = [t for batch in iter_batches(searching(space, tuner=tuner, batch=4)) for t in batch]
    points = {(t.parameters["hidden"], t.parameters["training.batch"]) for t in proposed}
    assert len(proposed) == len(points) == 6
    assert points == {(n, b) for n in (20, 30) for b in (1, 2, 3)}


def iter_batches(tuner):
    while batch := tuner.ask():
        yield batch
        for trial in batch:
            tuner.tell(trial.id, 0.5)


@given(lower=st.integers(-50, 50), size=st.integers(1, 30), seed=st.integers(0, 1000))
def test_a_randint_stays_within_its_bounds(lower, size, seed):
    tuner = searching({"n": {"_type": "randint", "_value": [lower, lower + size]}}, seed=seed, trials=25, batch=25)
    for trial in tuner.ask():
        assert lower <= trial.parameters["n"] < lower + size
        assert isinstance(trial.parameters["n"], int)


# --- ask, tell, fail -------------------------------------------------------------------------------


def test_asking_before_telling_is_refused():
    tuner = searching()
    tuner.ask()
    with pytest.raises(InputError, match="trial 0: has no result yet"):
        tuner.ask()


def test_telling_out_of_turn_is_refused():
    tuner = searching()
    with pytest.raises(InputError, match="ask for trials first"):
        tuner.tell(0, 0.5)
    tuner.ask()
    with pytest.raises(InputError, match="it is the turn of trial 0"):
        tuner.tell(1, 0.5)


@pytest.mark.parametrize("end", ["tell", "fail"])
def test_a_trial_that_has_ended_is_never_told_again(end):
    tuner = searching(batch=1)
    tuner.ask()
    tuner.tell(0, 0.5) if end == "tell" else tuner.fail(0)
    with pytest.raises(InputError, match="trial 0: cannot be reported now"):
        tuner.tell(0, 0.5)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_value_that_is_not_finite_is_refused_and_the_trial_can_still_fail(value):
    tuner = searching(batch=1)
    tuner.ask()
    with pytest.raises(InputError, match="trial 0: its value must be finite"):
        tuner.tell(0, value)
    tuner.fail(0)
    assert tuner.ask()[0].id == 1


@pytest.mark.parametrize("tuner", TUNERS)
def test_a_search_goes_on_when_all_trials_fail(tuner):
    searched = searching(tuner=tuner, trials=60, batch=6)
    while batch := searched.ask():
        for trial in batch:
            searched.fail(trial.id)
    assert searched.asked == 60


# --- the median-stop rule ----------------------------------------------------------------------------


def test_a_trial_is_stopped_below_the_median_of_mean_accuracies():
    rule = MedianStop(start_epoch=2)
    for trial, values in enumerate([[0.2, 0.4], [0.4, 0.6], [0.6, 0.8]]):  # means after two epochs: 0.3, 0.5, 0.7
        rule.end(trial, values, finished=True)
    assert not rule.stops(3, [0.0])
    assert rule.stops(3, [0.0, 0.49])
    assert not rule.stops(4, [0.5, 0.1])


def test_trials_that_were_stopped_are_not_compared_with():
    rule = MedianStop(start_epoch=1)
    rule.end(0, [0.9], finished=False)
    assert not rule.stops(1, [0.1])


def test_the_rule_goes_to_another_process():
    rule = MedianStop(start_epoch=1)
    rule.end(0, [0.5], finished=True)
    sent = copy.deepcopy(rule)
    assert sent.stops(1, [0.4])
    sent.end(1, [0.1], finished=True)
    assert rule.stops(2, [0.4])


# --- spaces --------------------------------------------------------------------------------------------


def test_the_texture_space_is_the_published_one_in_real_time():
    space = spaces.load_space("texture")
    spaces.check(space, specs.load(RSNNSpec, "rsnn"), "texture")
    assert space["hidden"]["_value"] == [20, 30, 40, 50]
    assert [2 * tau for tau in space["tau_mem_ms"]["_value"]] == [10, 20, 30, 40, 100, 200, 300, 400]
    assert [2 * tau for tau in space["tau_syn_ms"]["_value"]] == [10, 20, 30, 40, 100, 200, 300]
    points = 1
    for dimension in space.values():
        points *= len(dimension["_value"])
    assert points == 4 * 4 * 2 * 10 * 10 * 8 * 7


def test_a_space_that_does_not_ship_is_named_with_the_nearest():
    with pytest.raises(InputError, match=r"texure: there is no such spec .* did you mean 'texture'"):
        spaces.load_space("texure")


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("choice", []),
        ("choice", [20, 20]),
        ("choice", [{"_name": "nested"}]),
        ("choice", 20),
        ("randint", [3, 3]),
        ("randint", [0.5, 3]),
        ("uniform", [2, 1]),
        ("uniform", [1, 2, 3]),
        ("uniform", [0, float("inf")]),
        ("uniform", ["a", "b"]),
        ("uniform", [False, True]),
        ("quniform", [0, 1]),
        ("quniform", [0, 1, 0]),
        ("loguniform", [0, 1]),
        ("normal", [0, 0]),
    ],
)
def test_arguments_that_nni_would_choke_on_are_refused(kind, value):
    with pytest.raises(InputError) as refusal:
        specs.build(SearchSpec, {"space": {"hidden": {"_type": kind, "_value": value}}}, source="mine.toml")
    assert f"a {kind} needs" in str(refusal.value)
    assert "mine.toml" in str(refusal.value)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        ({}, "space: holds no key"),
        ({"hidden": {"_type": "choise", "_value": [1]}}, "did you mean 'choice'?"),
        ({"hidden": {"_type": "choice"}}, "must have _type and _value"),
        ({"hidden": [20, 30]}, "must be a table"),
    ],
)
def test_a_space_of_another_form_is_refused(space, message):
    with pytest.raises(InputError) as refusal:
        specs.build(SearchSpec, {"space": space}, source="mine.toml")
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("space", "message"),
    [
        ({"hiden": {"_type": "choice", "_value": [20]}}, "hiden: unknown key; did you mean 'hidden'?"),
        ({"training.bach": {"_type": "choice", "_value": [20]}}, "training.bach: unknown key; did you mean 'batch'?"),
        ({"hidden": {"_type": "choice", "_value": [20, -1]}}, "hidden: must be >= 0; got -1"),
        ({"membrane": {"_type": "choice", "_value": ["eq4", "leaky"]}}, "membrane: must be 'eq4'"),
        ({"tau_mem_ms": {"_type": "uniform", "_value": [-5, 5]}}, "tau_mem_ms: must be > 0; got -5"),
        ({"hidden": {"_type": "uniform", "_value": [20, 50]}}, "search whole numbers with quniform and q = 1"),
        ({"hidden": {"_type": "quniform", "_value": [20, 50, 2.5]}}, "search whole numbers with quniform and q = 1"),
        ({"hidden.of": {"_type": "choice", "_value": [20]}}, "'hidden' is a value, not a table"),
    ],
)
def test_what_a_network_cannot_have_is_refused_before_anything_runs(space, message):
    with pytest.raises(InputError) as refusal:
        spaces.check(space, RSNNSpec(), "mine.toml")
    assert message in str(refusal.value)


def test_a_space_may_be_written_in_tables():
    nested = {"training": {"batch": {"_type": "choice", "_value": [64]}}}
    assert list(SearchSpec(space=nested).space) == ["training.batch"]


# --- NNI stays hidden ---------------------------------------------------------------------------------


def test_nothing_is_printed(capfd):
    play(searching({"hidden": {"_type": "choice", "_value": list(range(10, 30))}}, batch=3), 10)
    rule = MedianStop(5)
    rule.end(0, [0.5], finished=True)
    assert capfd.readouterr() == ("", "")


def test_nni_is_imported_by_a_search_alone():
    """It takes a second: no module of ours imports it when it is imported itself."""
    modules = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")]
    names = [name for text in modules for name in re.findall(r"^(?:import|from) (\S+)", text, re.MULTILINE)]
    assert len(names) > len(modules)
    assert not [name for name in names if "nni" in name.split(".")]


def test_without_nni_a_search_says_what_is_missing(monkeypatch):
    monkeypatch.setattr(tuning, "find_spec", lambda name: None)
    tuning._nni.cache_clear()
    with pytest.raises(InputError, match=r"search: NNI is not installed .*; search on Linux"):
        MedianStop(10)
    tuning._nni.cache_clear()
