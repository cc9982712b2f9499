"""A search's journal is the same bytes whoever trains its trials and whatever interrupts it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from in_process import typed
from neurotact_parts.networks.search import search, search_tables
from neurotact_parts.networks.search.figure import draw_search
from neurotact_parts.networks.search.journal import FAILED, FINISHED, JOURNAL, STOPPED, Trial, best_of, read_journal
from neurotact_parts.networks.search.tuning import Proposal

from neurotact import cli, spec
from neurotact.data import hdf5
from neurotact.data.dataset import load_recordings
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.files import read_json, write_json
from neurotact.networks.definition import recipe
from neurotact.networks.definition import space as spaces
from neurotact.networks.definition.space import SearchSpec, load_space
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import epochs, run_folder, tasks
from neurotact.networks.training.epochs import Epoch, Training
from neurotact.networks.training.tasks import Task
from neurotact.networks.use import measuring
from neurotact.studies import cell as cells
from neurotact.studies import study

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
SPACE = {
    "hidden": {"_type": "choice", "_value": [4, 6, 8]},
    "forward_weight_scale": {"_type": "loguniform", "_value": [0.3, 3.0]},
}
NETWORK = RSNNSpec.model_validate({"hidden": 4, "training": {"epochs": 4, "batch": 4}})
TRIALS = 10


@pytest.fixture(scope="module")
def spikes(tmp_path_factory):
    """The spike trains of the tiny study, in a file."""
    path = tmp_path_factory.mktemp("spikes") / "spikes.h5"
    what = study.resolve(TINY)
    hdf5.save_spikes(encode_recordings(load_recordings(what.dataset), what.encoder), path)
    return path


@pytest.fixture(scope="module")
def trains(spikes):
    return hdf5.load_spikes(spikes)


def problem(trains, **settings):
    what = study.resolve(TINY)
    task = Task(window=what.window, split=what.split, stratify=what.dataset.stratify)
    defaults = {"space": SPACE, "trials": TRIALS, "batch": 4, "start_epoch": 2, "objective": "accuracy-sops"}
    return search.problem_of(trains, SearchSpec.model_validate(defaults | settings), NETWORK, task)


def run(trains, folder, **settings):
    what = problem(trains, **settings)
    return search.search(what, folder, search.here(trains, what.task))[0]


@pytest.fixture(scope="module")
def whole(trains, tmp_path_factory):
    """The folder of a search that nothing interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    run(trains, folder)
    return folder


@pytest.fixture
def journal(whole):
    return (whole / JOURNAL).read_bytes()


# --- the journal -----------------------------------------------------------------------------------


def test_the_journal_tells_each_trial_and_no_times(journal):
    lines = [json.loads(line) for line in journal.splitlines()]
    assert [line["id"] for line in lines] == list(range(TRIALS))
    for line in lines:
        assert list(line) == ["id", "parameters", "epochs", "outcome", "accuracy", "sops", "value"]
        assert set(line["parameters"]) == set(SPACE)
        assert line["value"] == line["accuracy"] - 0.1 * np.log10(line["sops"])


@given(
    objective=st.sampled_from(["accuracy", "accuracy-sops"]), budget=st.floats(1.0, 1e6), weight=st.floats(0, 1),
    within=st.tuples(st.floats(0, 1), st.floats(0, 1)), beyond=st.tuples(st.floats(0, 1), st.floats(1.001, 1e3)),
)  # fmt: skip
def test_any_network_within_the_budget_counts_for_more_than_any_beyond_it(objective, budget, weight, within, beyond):
    spec = SearchSpec(space=SPACE, objective=objective, sops_weight=weight, max_sops=budget)
    assert spec.value(within[0], within[1] * budget) > spec.value(beyond[0], beyond[1] * budget)
    free = spec.model_copy(update={"max_sops": None})
    assert spec.value(within[0], within[1] * budget) == free.value(within[0], within[1] * budget)


def test_beyond_the_budget_fewer_operations_are_better():
    spec = SearchSpec(space=SPACE, max_sops=100.0)
    assert spec.value(0.5, 200.0) > spec.value(0.5, 400.0)


def test_a_search_under_a_budget_keeps_to_it(trains, tmp_path):
    free = run(trains, tmp_path / "free", objective="accuracy")
    taken = sorted(trial.sops for trial in free if trial.outcome == FINISHED)
    assert best_of(free).sops > taken[0]
    budget = float(np.mean(taken[:2]))
    trials = run(trains, tmp_path / "bound", objective="accuracy", max_sops=budget)
    assert best_of(trials).sops <= budget
    search_tables.write_tables(problem(trains, objective="accuracy", max_sops=budget), tmp_path / "bound", trials)
    assert (tmp_path / "bound" / "pareto.csv").is_file()
    assert f"within {budget:,g} SOPs" in (tmp_path / "bound" / "best.toml").read_text()


def test_a_budget_that_nothing_keeps_to_is_said(trains, tmp_path):
    with pytest.warns(UserWarning, match=r"no trial stays within 0.5 SOPs, the cheapest takes \d"):
        run(trains, tmp_path, objective="accuracy", max_sops=0.5)


def test_a_stopped_trial_is_told_its_last_epoch(trains, tmp_path):
    trials = run(trains, tmp_path, objective="accuracy", start_epoch=1, trials=24)
    stopped = [trial for trial in trials if trial.outcome == STOPPED]
    assert stopped
    assert all(trial.value == trial.epochs[-1] for trial in stopped)


def test_a_stopped_trial_has_the_accuracy_and_the_network_of_its_last_epoch_though_another_was_better(
    trains, monkeypatch
):
    log = (Epoch(1, 0.7, 0.5, 0.6, 0.75), Epoch(2, 0.6, 0.6, 0.7, 0.25))

    def train(network, *_, progress, **__):
        for epoch in log:
            progress(epoch)

    class AfterTwo:
        def stops(self, trial, epochs):
            return len(epochs) == 2

    what = problem(trains, objective="accuracy")
    monkeypatch.setattr(epochs, "train", train)
    job = search.Job(what, Proposal(0, {}), AfterTwo())  # pyright: ignore
    trial = search.try_network(job, trains, tasks.sides_of(trains, what.task))
    assert trial.epochs == [0.75, 0.25]
    assert (trial.outcome, trial.accuracy, trial.value) == (STOPPED, 0.25, 0.25)


@given(st.lists(st.tuples(st.sampled_from([0.5, 0.75, 1.0]), st.integers(1, 4)), min_size=1, max_size=8))
def test_the_best_has_the_highest_value_and_of_equal_ones_the_fewest_operations(results):
    trials = [Trial(i, {}, [value], FINISHED, value, float(sops), value) for i, (value, sops) in enumerate(results)]
    best = best_of([*trials, Trial(len(trials), {}, [1.0], STOPPED, 1.0, 0.5, 1.0)])
    assert best.value == max(value for value, _ in results)
    assert best.sops == min(sops for value, sops in results if value == best.value)
    assert best.id == results.index((best.value, best.sops))
    assert search_tables.by_rank(search_tables.trials_table(trials))["id"].iloc[0] == best.id


@pytest.mark.parametrize("kept", [0.0, 0.02, 0.31, 0.5, 0.77, 0.999, 1.0])
def test_resumed_from_any_byte_the_journal_is_that_of_the_uninterrupted_run(trains, whole, journal, kept, tmp_path):
    (tmp_path / "search.json").write_bytes((whole / "search.json").read_bytes())
    (tmp_path / JOURNAL).write_bytes(journal[: round(kept * len(journal))])
    trials = run(trains, tmp_path)
    assert (tmp_path / JOURNAL).read_bytes() == journal
    assert len(trials) == TRIALS


def test_a_finished_search_trains_nothing_again(trains, whole):
    def forbidden(jobs):
        assert not jobs
        return iter(())

    trials, _ = search.search(problem(trains), whole, forbidden)
    assert len(trials) == TRIALS


def test_seeds_decide_the_journal(trains, journal, tmp_path):
    run(trains, tmp_path, seed=1)
    assert (tmp_path / JOURNAL).read_bytes() != journal


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda lines: [lines[0], "{\n", *lines[2:]], "line 2 is damaged"),
        (lambda lines: [lines[0], *lines[2:]], "line 2 is damaged .it is of trial 2"),
        (lambda lines: [re.sub('"value": .*}', '"value": "x"}', lines[0]), *lines[1:]], "1 is damaged .value: Input"),
        (lambda lines: [re.sub(', "value": .*}', "}", lines[0]), *lines[1:]], "its value is missing"),
        (lambda lines: [re.sub('"sops": [^,]*', '"sops": NaN', lines[0]), *lines[1:]], "1 is damaged .sops"),
        (lambda lines: [lines[0].replace('"hidden": ', '"hidden": 1'), *lines[1:]], "trial 0 is not the one"),
    ],
    ids=["garbage", "gap", "text for a value", "no value", "not a number", "other parameters"],
)
def test_a_damaged_journal_is_refused(trains, whole, journal, damage, message, tmp_path):
    (tmp_path / "search.json").write_bytes((whole / "search.json").read_bytes())
    (tmp_path / JOURNAL).write_text("".join(damage(journal.decode().splitlines(keepends=True))))
    with pytest.raises(InputError, match=message):
        run(trains, tmp_path)


@pytest.mark.parametrize("changed", [{"seed": 1}, {"seed": 1, "trials": TRIALS + 1}, {"batch": 5}])
def test_a_folder_of_another_search_is_refused(trains, whole, changed):
    what = problem(trains, **changed)
    with pytest.raises(InputError, match="holds another search"):
        search.search(what, whole, search.here(trains, what.task), resume=True)


def test_a_search_of_an_earlier_form_is_refused(trains, whole, tmp_path):
    table = json.loads((whole / "search.json").read_text())
    assert table.pop("schema") == spec.SCHEMA
    (tmp_path / "search.json").write_text(json.dumps(table))
    (tmp_path / JOURNAL).write_bytes((whole / JOURNAL).read_bytes())
    with pytest.raises(
        InputError, match=r"holds a search of another neurotact \(schema none, here 2\); choose another"
    ):
        run(trains, tmp_path)


def made_up(jobs):
    """Trials as if they had been trained: best at 12 neurons, and some stopped by the rule."""
    for job in jobs:
        number, parameters = job.proposal
        accuracy = 1 / (1 + abs(parameters["hidden"] - 12)) / (1 + abs(np.log(parameters["forward_weight_scale"])))
        epochs = [accuracy / 2, accuracy]
        stopped = next((n for n in (1, 2) if job.median_stop.stops(number, epochs[:n])), None)
        end = epochs[: stopped or 2]
        value = job.problem.search.value(end[-1], 100.0 * parameters["hidden"])
        outcome = STOPPED if stopped else FINISHED
        yield Trial(number, parameters, end, outcome, end[-1], 100.0 * parameters["hidden"], value)


@pytest.mark.parametrize("tuner", ["tpe", "random", "grid"])
def test_a_search_goes_on_with_more_trials_as_if_all_had_been_asked_for_at_once(trains, tmp_path, tuner):
    """Also from within a batch of 4, and where TPE learns: after 20 trials."""
    wide = {**SPACE, "hidden": {"_type": "quniform", "_value": [4, 40, 1]}}
    steps = ((1, False), (6, True), (22, True), (45, True), (46, True))
    for name, asked in (("extended", steps), ("at once", steps[-1:])):
        for n, resume in asked:
            what = problem(trains, space=wide, trials=n, tuner=tuner, start_epoch=1)
            found, _ = search.search(what, tmp_path / name, made_up, resume=resume)
            assert len(found) == n
    assert {trial.outcome for trial in found} == {FINISHED, STOPPED}
    for left in (JOURNAL, "search.json"):
        assert (tmp_path / "extended" / left).read_bytes() == (tmp_path / "at once" / left).read_bytes()


def test_more_trials_are_refused_unless_they_are_asked_for_and_fewer_always(trains, whole, journal):
    with pytest.raises(InputError, match=f"holds this search with {TRIALS} trials; pass `resume=True` to go on to 11$"):
        run(trains, whole, trials=TRIALS + 1)
    what = problem(trains, trials=TRIALS - 1)
    with pytest.raises(InputError, match=f"holds this search with {TRIALS} trials; ask for {TRIALS} trials or more$"):
        search.search(what, whole, search.here(trains, what.task), resume=True)
    assert (whole / JOURNAL).read_bytes() == journal


def test_a_folder_that_holds_anything_else_is_refused(trains, tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(InputError, match="is not empty"):
        run(trains, tmp_path)


def test_a_trial_that_cannot_be_trained_fails_and_the_search_goes_on(trains, tmp_path, monkeypatch):
    train = epochs.train

    def fragile(network, *args, **kwargs):
        if network.spec.hidden == 6:
            raise InputError("training: weights are not finite after epoch 1; lower training.learning_rate")
        return train(network, *args, **kwargs)

    monkeypatch.setattr(epochs, "train", fragile)
    trials = run(trains, tmp_path)
    failed = [trial for trial in trials if trial.outcome == FAILED]
    assert {trial.parameters["hidden"] for trial in failed} == {6}
    assert len(trials) == TRIALS
    assert best_of(trials).parameters["hidden"] != 6
    assert read_journal(tmp_path / JOURNAL) == trials
    with pytest.raises(InputError, match=r"none of .* trials finished; trial .*: training: weights are not finite"):
        best_of(failed)


# --- what it leaves ---------------------------------------------------------------------------------


def test_the_best_network_comes_out_of_its_seeds_again(trains, whole):
    what, trials = problem(trains), read_journal(whole / JOURNAL)
    best = best_of(trials)
    fitted, sides = search.train_best(what, trains, best)
    assert [epoch.validation_accuracy for epoch in fitted.training.epochs] == best.epochs
    assert measuring.mean_sops(fitted.network, sides.validation) == best.sops
    assert best.value == max(trial.value or -1 for trial in trials if trial.outcome == FINISHED)


def test_no_finished_trial_beats_one_on_the_front(whole):
    table = search_tables.trials_table(read_journal(whole / JOURNAL))
    front, finished = search_tables.front_table(table), table[table["outcome"] == FINISHED]
    assert len(front)
    for row in front.itertuples():
        better = (finished["accuracy_validation"] >= row.accuracy_validation) & (
            finished["sops_total"] < row.sops_total
        )
        assert not better.any()


def made_table(n=60):
    """Values that `a` decides, `b` and the text `c` do not."""
    rng = np.random.default_rng(0)
    a, b = rng.choice([1, 2, 3, 4], n), rng.choice([10.0, 20.0], n)
    value = 0.2 * a + 0.001 * rng.normal(size=n)
    rest = {"accuracy_validation": value, "sops_total": 1e3 * a, "a": a, "b": b, "c": rng.choice(["x", "y"], n)}
    return pd.DataFrame({"id": range(n), "outcome": FINISHED, "epochs": 3, "value": value, **rest, "error": ""})


def test_importance_finds_what_decides_the_value():
    found = search_tables.importance(made_table(), ["a", "b", "c"])
    assert found is not None
    assert found.drop["a"] > 1.0
    assert found.r2 > 0.95
    assert abs(found.drop["b"]) < 0.05
    assert abs(found.drop["c"]) < 0.05


def test_too_few_trials_tell_nothing_of_importance():
    assert search_tables.importance(made_table(10), ["a", "b"]) is None


def test_the_figure_shows_values_importance_and_front():
    table = made_table()
    table.loc[3, ["outcome", "value"]] = ["failed", float("nan")]
    table.loc[5, "outcome"] = "stopped"
    figure = draw_search(table, search_tables.importance(table, ["a", "b", "c"]), search_tables.front_table(table))
    drawn = {artist.get_gid() for axes in figure.axes for artist in axes.get_children()}
    assert {"finished", "stopped", "failed", "best", "front"} <= drawn
    assert len(draw_search(table, None).axes) == 1


def test_every_trial_draws_seeds_of_its_own(trains):
    """Also where it tries the same network again: weights and order differ from each other and from trial to trial."""
    what, parameters = problem(trains), {"hidden": 4, "forward_weight_scale": 1.0}
    pairs = [what.seeds_of(Proposal(number, parameters)) for number in range(20)]
    assert len({seed for pair in pairs for seed in pair}) == 40
    assert what.seeds_of(Proposal(3, parameters)) == pairs[3]
    assert problem(trains, seed=1).seeds_of(Proposal(3, parameters)) != pairs[3]
    assert what.seeds_of(Proposal(3, {**parameters, "hidden": 6})) != pairs[3]


def test_the_rule_of_early_exit_is_no_part_of_a_trials_seeds(trains):
    plain = problem(trains)
    steady = plain.model_copy(update={"task": plain.task.model_copy(update={"exit_choice": "steady"})})
    proposal = Proposal(0, {"hidden": 4})
    assert plain.seeds_of(proposal) == steady.seeds_of(proposal)


def test_the_same_network_tried_twice_is_trained_twice(trains):
    what = problem(trains)
    sides = tasks.sides_of(trains, what.task)
    first, second, again = (
        search.try_network(search.Job(what, Proposal(number, {"hidden": 6}), None), trains, sides)
        for number in (0, 1, 0)
    )
    assert first == again
    assert (first.epochs, first.sops) != (second.epochs, second.sops)


def test_a_trials_accuracy_is_that_of_the_epoch_whose_weights_it_kept(trains, monkeypatch):
    what = problem(trains, objective="accuracy")
    log = (Epoch(1, 0.7, 0.5, 0.6, 0.75), Epoch(2, 0.6, 0.6, 0.7, 1.0), Epoch(3, 0.5, 0.7, 0.8, 0.25))

    def train(*_, **__):
        return Training(log, log[0])

    monkeypatch.setattr(epochs, "train", train)
    trial = search.try_network(search.Job(what, Proposal(0, {}), None), trains, tasks.sides_of(trains, what.task))
    assert (trial.accuracy, trial.value) == (0.75, 0.75)


def test_the_best_network_is_trained_with_the_one_thread_of_the_search(trains, spikes, whole, tmp_path, monkeypatch):
    train_best, seen, before = search.train_best, [], torch.get_num_threads()

    def watched(*given):
        seen.append(torch.get_num_threads())
        return train_best(*given)

    monkeypatch.setattr(search, "train_best", watched)
    torch.set_num_threads(2)
    try:
        search.save_best(problem(trains), spikes, tmp_path, read_journal(whole / JOURNAL))
        assert (seen, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(before)


# --- the command ------------------------------------------------------------------------------------


def words(spikes, out, *more):
    shape = ("--window-ms", "50", "--start-ms", "100", "--per-trial", "1", "--batch", "4", "--seed", "7")
    small = ("--set", "training.epochs=3", "--set", "training.batch=4", "--space", str(out.parent / "space.toml"))
    return ["neurotact", "tune", str(spikes), "-o", str(out), *shape, *small, *more]


def write_space(folder):
    (folder / "space.toml").write_text(spec.to_toml(SPACE))


TUNED = ("--trials", "6", "--objective", "accuracy-sops")


@pytest.fixture(scope="module")
def tuned(spikes, tmp_path_factory):
    """What `neurotact tune` left, and what it said on stderr."""
    out = tmp_path_factory.mktemp("tune") / "tuned"
    write_space(out.parent)
    done = typed(*words(spikes, out, *TUNED, "--workers", "1")[1:])
    assert done.code == 0, done.err
    return out, done.err


def test_tune_leaves_a_network_that_can_be_used(tuned):
    out, err = tuned
    assert "tune 6/6  best " in err
    assert spec.load(RSNNSpec, out / "best.toml").training.epochs == 3
    assert (out / "search.png").is_file()
    assert len(pd.read_csv(out / "trials.csv")) == 6
    assert len(pd.read_csv(out / "pareto.csv")) >= 1
    row = json.loads((out / "best" / "result.json").read_text())["row"]
    assert run_folder.restore(out / "best").rule.patience == row["exit_patience"]
    assert row["accuracy_validation"] == best_of(read_journal(out / JOURNAL)).accuracy
    assert "neurotact tune" not in err


def test_the_first_trial_is_the_network_as_given_and_the_best_is_never_below_it(trains, tuned):
    found = read_journal(tuned[0] / JOURNAL)
    what = spec.build(search.Problem, spec.unsaved(read_json(tuned[0] / "search.json"), "", ""), source="search.json")
    asked = what.network_of(found[0].parameters)
    seen = tasks.seen(trains, what.task)
    given = recipe.resolve(what.network, seen).model_copy(update={"direct": False})  # a search of sizes has a layer
    assert recipe.resolve(asked, seen) == given
    assert best_of(found).value >= found[0].value


def test_without_a_space_the_choices_of_the_recipe_are_searched(trains):
    task = problem(trains).task
    network = spec.load(RSNNSpec, "default", {"hidden": 10, "tau_syn_ms": 3.0})
    asked = search.asked(SearchSpec(trials=2), network, trains, task)
    assert asked.space == recipe.space(network, tasks.seen(trains, task))
    assert asked.first == spaces.values_of(recipe.first_of(network, tasks.seen(trains, task)), asked.space)
    assert search.asked(SearchSpec(), NETWORK, trains, task).space == load_space("texture")
    assert search.asked(SearchSpec(space=SPACE, tuner="grid"), NETWORK, trains, task).first is None
    first = {next(iter(SPACE)): 7}
    assert search.asked(SearchSpec(space=SPACE, first=first), NETWORK, trains, task).first == first
    with pytest.raises(InputError, match="space: is missing"):
        search.problem_of(trains, SearchSpec(), NETWORK, task)


@pytest.mark.thorough
def test_two_processes_write_the_bytes_of_one(spikes, tuned, tmp_path):
    write_space(tmp_path)
    assert typed(*words(spikes, tmp_path / "tuned", *TUNED, "--workers", "2")[1:]).code == 0
    assert (tmp_path / "tuned" / JOURNAL).read_bytes() == (tuned[0] / JOURNAL).read_bytes()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--objective", "speed"), "'--objective': Value error, 'speed' is not one of 'accuracy', 'accuracy-sops'"),
        (("--tuner", "gp"), "'--tuner': Value error, 'gp' is not one of 'tpe', 'random', 'grid'"),
        (("--network", "rsnm"), "did you mean 'rsnn'?"),
        (("--space", "texure"), "did you mean 'texture'?"),
    ],
)
def test_tune_refuses_in_one_line(spikes, tmp_path, monkeypatch, capsys, more, message):
    write_space(tmp_path)
    monkeypatch.setattr(sys, "argv", words(spikes, tmp_path / "tuned", *more))
    with pytest.raises(SystemExit) as end:
        cli.main()
    err = capsys.readouterr().err
    assert end.value.code == 2
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "tuned").exists()


def test_ctrl_c_while_the_best_is_trained_again_says_how_to_go_on(spikes, tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    write_space(tmp_path)
    monkeypatch.setattr(search, "save_best", interrupt)
    monkeypatch.setattr(sys, "argv", words(spikes, tmp_path / "tuned", "--trials", "1", "--workers", "1"))
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 130
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == f"neurotact: interrupted; the same command continues in {tmp_path / 'tuned'}"


@pytest.mark.slow
def test_killed_and_resumed_gives_the_journal_of_the_uninterrupted_run(spikes, tmp_path):
    write_space(tmp_path)
    command = [sys.executable, "-c", "from neurotact.cli import main; main()"]
    outs = [tmp_path / "whole", tmp_path / "killed"]
    lines = [
        [*command, *words(spikes, out, "--trials", "60", "--workers", n)[1:]] for out, n in zip(outs, "12", strict=True)
    ]
    subprocess.run(lines[0], check=True, capture_output=True)
    process = subprocess.Popen(lines[1], start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (outs[1] / JOURNAL).is_file() or (outs[1] / JOURNAL).read_bytes().count(b"\n") < 20:
        assert process.poll() is None, "the search ended before it could be killed"
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    subprocess.run(lines[1], check=True, capture_output=True)
    for name in (JOURNAL, "trials.csv", "best.toml"):
        assert (outs[1] / name).read_bytes() == (outs[0] / name).read_bytes()


# --- in a study -------------------------------------------------------------------------------------


def searching_cells(**overrides):
    table = {"search.space": SPACE, "search.trials": 5, "search.batch": 4, "search.start_epoch": 2}
    return list(study.cells(study.resolve(TINY, table | overrides)))


def test_a_search_names_another_cell():
    cell = next(study.cells(study.resolve(TINY)))
    assert cell.search is None
    assert searching_cells()[0].digest() != cell.digest()


def test_what_the_sweep_decides_is_not_searched():
    assert all(set(cell.search.space) == {"forward_weight_scale"} for cell in searching_cells() if cell.search)
    with pytest.raises(InputError, match="decides every key of its space"):
        searching_cells(**{"search.space": {"hidden": SPACE["hidden"]}})


def test_a_study_names_a_space_and_reads_back_equal(tmp_path):
    what = study.resolve(TINY, {"search.space": "texture", "search.trials": 20})
    assert what.search is not None
    assert what.search.space == load_space("texture")
    (tmp_path / "study.toml").write_text(study.to_toml(what))
    assert study.resolve(tmp_path / "study.toml") == what


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"search.space": "texure"}, "did you mean 'texture'?"),
        ({"search.trails": 3}, "search.trails: unknown key; did you mean 'trials'?"),
        ({"search.space": {"hiden": SPACE["hidden"]}}, "hiden: unknown key; did you mean 'hidden'?"),
    ],
)
def test_a_wrong_search_is_refused_before_anything_runs(overrides, message):
    with pytest.raises(InputError) as refusal:
        searching_cells(**overrides)
    assert message in str(refusal.value)


def test_a_cell_searches_and_reports_its_best_network(trains, tmp_path):
    cell = searching_cells()[0]
    left = cells.run_cell(cell, trains, tmp_path)
    row = json.loads(left[cells.RESULT])["row"]
    trials = read_journal(tmp_path / cells.SEARCH / JOURNAL)
    best = best_of(trials)
    assert len(trials) == 5
    assert row["trial"] == best.id
    assert row["network.forward_weight_scale"] == best.parameters["forward_weight_scale"]
    assert row["accuracy_validation"] == best.accuracy
    assert left[f"{cells.SEARCH}/{JOURNAL}"] == (tmp_path / cells.SEARCH / JOURNAL).read_bytes()


def test_a_cells_search_goes_on_where_it_was_killed(trains, tmp_path):
    cell = searching_cells()[0]
    whole = cells.run_cell(cell, trains)
    cells.run_cell(cell, trains, tmp_path)
    path = tmp_path / cells.SEARCH / JOURNAL
    path.write_bytes(path.read_bytes()[:400])
    left = cells.run_cell(cell, trains, tmp_path)
    timed = {"timing.json"}
    assert {name: left[name] for name in left if name not in timed} == {n: whole[n] for n in whole if n not in timed}


def test_seeds_search_anew(trains):
    first, second = (json.loads(cells.run_cell(cell, trains)[cells.RESULT])["row"] for cell in searching_cells()[:2])
    assert first["seed"] != second["seed"]
    assert first["network.forward_weight_scale"] != second["network.forward_weight_scale"]


def tried(number, value, outcome=FINISHED, sops=100.0):
    return Trial(number, {"hidden": 4}, [value], outcome, value, sops, value)


def test_the_best_trial_is_the_first_of_equal_ones_and_has_finished():
    trials = [tried(0, 0.9, STOPPED), tried(1, 0.5), tried(2, 0.8), tried(3, 0.8)]
    assert best_of(trials).id == 2
    with pytest.raises(InputError, match="search: its only trial did not finish; change the space"):
        best_of(trials[:1])


def test_a_stopped_trial_is_on_no_front():
    trials = [tried(0, 0.9, STOPPED, sops=10.0), tried(1, 0.8, sops=50.0), tried(2, 0.7, sops=90.0)]
    assert search_tables.front_table(search_tables.trials_table(trials))["id"].tolist() == [1]


def test_what_no_key_decides_is_not_foreseen():
    """Importance is that of trials which the forest has not seen: what it has seen it knows by heart."""
    rng = np.random.default_rng(0)
    keys = {"scale": rng.random(60), "rate": rng.random(60)}
    at_random, decided = (pd.DataFrame({**keys, "value": value}) for value in (rng.random(60), keys["scale"]))
    nothing, found = (search_tables.importance(table, list(keys)) for table in (at_random, decided))
    assert nothing is not None
    assert found is not None
    assert nothing.r2 < 0.1
    assert found.r2 > 0.8
    assert found.drop["scale"] > 10 * abs(found.drop["rate"])


def test_a_search_of_an_earlier_version_goes_on(trains, tmp_path):
    """Which wrote the device and the kind of early exit, that are always these today."""
    what = problem(trains)
    search.search(what, tmp_path, search.here(trains, what.task))
    saved = read_json(tmp_path / "search.json")
    for device, by, goes_on in (("cpu", "stability", True), ("cuda", "stability", False), ("cpu", "margin", False)):
        write_json(tmp_path / "search.json", {**saved, "device": device, "task": {**saved["task"], "exit_by": by}})
        if goes_on:
            search.search(what, tmp_path, lambda jobs: iter(()))
        else:
            with pytest.raises(InputError, match="holds another search"):
                search.search(what, tmp_path, lambda jobs: iter(()))


def test_a_trial_of_a_network_that_finds_a_smaller_one_has_its_accuracy_in_the_journal(trains, tmp_path):
    space = {"step_ms": {"_type": "choice", "_value": [1.0]}}
    asked_for = search.problem_of(
        trains, SearchSpec(space=space, trials=1), RSNNSpec(recipe="default"), problem(trains).task
    )
    (trial,), _ = search.search(asked_for, tmp_path, search.here(trains, asked_for.task))
    assert search.train_best(asked_for, trains, trial)[0].network.spec.hidden == 0
    assert read_journal(tmp_path / JOURNAL) == [trial]
