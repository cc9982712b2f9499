"""`neurotact save`: what it proposes, what it chooses, and the run folders that it writes."""

import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
import torch
from made_chains import make_encoder, make_signal
from neurotact_parts.networks.saving import choice, save, trial, ways
from neurotact_parts.networks.saving import folder as points
from neurotact_parts.networks.saving.choice import found, interval
from neurotact_parts.networks.saving.proposals import WHOLE, Asked, key_of, next_batch, next_finalist
from neurotact_parts.networks.saving.start import Start, start_of
from neurotact_parts.networks.saving.trial import Job, Trial, other_validation, tried
from neurotact_parts.networks.saving.ways import Way, setting_of, ways_of
from neurotact_parts.studies.comparison.saving import Setting

import neurotact as nt
from neurotact import files
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.rule import FULL_WINDOW
from neurotact.networks.training import run_folder, trainer
from neurotact.networks.training.tasks import Task

N = 60
LIST = "memory-45nm"


def make_run(folder: Path, network: RSNNSpec = RSNNSpec(recipe="default", hidden=6), **keys) -> Path:
    """A short training with the default recipe, with its spikes and recordings beside it."""
    signals = [make_signal(200, seed=k) * (1.0 if k % 2 else 1.6) for k in range(N)]
    labels = pd.DataFrame({"label": [("felt", "silk")[k % 2] for k in range(N)]})
    folder.mkdir(parents=True, exist_ok=True)
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", labels), folder / "skin.h5")
    trains = encode_recordings(hdf5.load_recordings(folder / "skin.h5"), make_encoder(baseline="start"))
    hdf5.save_spikes(trains, folder / "spikes.h5")
    task = Task.model_validate({"window": {"length_ms": 160}, "exit_choice": "steady", **keys})
    spec = network.model_copy(update={"training": network.training.model_copy(update={"epochs": 4})})
    done, _ = trainer.fit(trains, spec, task, (3, 4))
    run_folder.save(done, folder / "run", trains, folder / "spikes.h5", task)
    return folder / "run"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("made"))


@pytest.fixture(scope="module")
def saved(run, tmp_path_factory):
    """A search with its folder, as it ends, and what it told."""
    folder, told = tmp_path_factory.mktemp("saved") / "small", []
    answer = nt.save_energy(run, folder, trials=13, at_most_points=100, workers=1, tell=told.append)
    return folder, answer, told


def test_a_point_is_a_run_folder_that_decides_as_the_search_said(saved):
    folder, answer, _ = saved
    for point in answer["points"]:
        row = nt.summarise(
            nt.infer(folder / point["folder"], spikes_of(folder / point["folder"]), test_only=True)
        ).iloc[-1]
        early = point["decides"] == trial.EARLY
        assert early or row["accuracy"] == pytest.approx(point["accuracy_test"])
        nt.export(folder / point["folder"], folder / f"chain-{point['folder']}", "c", variant="float")


def spikes_of(run: Path) -> Path:
    path = run_folder.restore(run).spikes_path
    assert path is not None
    return path


def test_the_run_is_trial_0_and_what_is_left_is_beside_it(saved, run):
    folder, answer, told = saved
    table = pd.read_csv(folder / "front.csv")
    assert table["trial"].iloc[0] == 0
    network, _ = run_folder.load_network(run)
    start = start_of(run)
    right = network.infer(start.base.sides.validation.spikes).labels == start.base.sides.validation.labels
    assert table["validation_accuracy"].iloc[0] == pytest.approx(float(right.double().mean()))
    first = answer["points"][0]
    assert first["left"][LIST] == pytest.approx(first["costs"][LIST] / first["costs_run"][LIST])
    assert first["left"][LIST] < 1
    assert json.loads((folder / "answer.json").read_text())["answer"] == answer["answer"]
    assert told[0].startswith(f"{folder / '1'}: {answer['answer']}; validation accuracy ")
    assert sum(answer["answer"] in line for line in told) == 1
    assert (folder / "front.png").is_file()
    assert answer["next"] == "export"
    assert (folder / answer["points"][0]["spikes"]).is_file()


def test_without_an_answer_that_is_said_before_the_points(saved, run, tmp_path, monkeypatch):
    folder, told = shutil.copytree(saved[0], tmp_path / "small"), []
    monkeypatch.setattr(choice, "found", lambda *given: found(*given)._replace(answer=None))
    nt.save_energy(run, folder, trials=13, at_most_points=100, workers=1, tell=told.append)
    assert told[0] == "No setting that was tried saves energy and loses at most 100 points of accuracy"
    assert told[1].startswith(f"{folder / '1'}: ")


@pytest.mark.parametrize(
    ("encoder", "network", "command"),
    [
        (make_encoder(baseline="start"), {}, "export"),
        (make_encoder({"integration": "exact"}), {}, "export"),
        (None, {}, "export"),  # of events
        (load("send-on-delta"), {}, "infer"),
        (make_encoder({"ra1.change": "both"}), {}, "infer"),
        (make_encoder(baseline="mean"), {}, "infer"),
        (make_encoder(), {"threshold_adaptation": 0.3}, "infer"),
    ],
)
def test_c_is_the_next_command_where_it_runs_the_chain(encoder, network, command):
    table = {} if encoder is None else encoder.model_dump(mode="json", exclude_none=True)
    trained = nt.RSNN(4, 2, hidden=3, sampling_rate_Hz=1000.0, **network)
    base = SimpleNamespace(trains=SimpleNamespace(encoder=table), network=trained)
    assert save._next(cast(Start, SimpleNamespace(base=base))) == command


@pytest.mark.thorough
def test_a_search_goes_on_and_is_the_same_with_worker_processes(saved, run, tmp_path):
    folder, answer, _ = saved
    (tmp_path / "again").mkdir()
    lines = (folder / "journal.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "again" / "journal.jsonl").write_text("".join(lines[:5]) + lines[5][:20])
    (tmp_path / "again" / "search.json").write_text((folder / "search.json").read_text())
    again = nt.save_energy(run, tmp_path / "again", trials=13, at_most_points=100, workers=2)
    assert (tmp_path / "again" / "journal.jsonl").read_text() == (folder / "journal.jsonl").read_text()
    assert again["points"] == answer["points"]


def test_another_search_is_refused_in_its_folder(saved, run, tmp_path):
    folder, *_ = saved
    with pytest.raises(InputError, match="holds another search"):
        nt.save_energy(run, folder, trials=14, workers=1)
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="not empty"):
        nt.save_energy(run, tmp_path, trials=1, workers=1)


@pytest.mark.parametrize(
    ("keys", "match"),
    [({"trials": 0}, "trials"), ({"at_most_points": 101.0}, "at_most_points"), ({"prices": "gold"}, "gold")],
)
def test_what_cannot_be_is_refused(run, tmp_path, keys, match):
    with pytest.raises(InputError, match=match):
        nt.save_energy(run, tmp_path / "out", **keys)


def test_a_run_of_varied_copies_is_refused(run, tmp_path):
    """No trial could be trained, as the windows of a search are cut without copies."""
    copied = tmp_path / "run"
    shutil.copytree(run, copied)
    path = copied / run_folder.NETWORK
    table = files.read_json(path)
    assert table["extra"]["task"]["augmentation"] == "none"
    table["extra"]["task"]["augmentation"] = "shift"
    files.write_json(path, table)
    with pytest.raises(InputError, match="was trained on varied copies"):
        nt.save_energy(copied, tmp_path / "small", trials=2, workers=1, spikes=run.parent / "spikes.h5")


def test_what_all_trials_fail_for_is_said(run, tmp_path, monkeypatch):
    trained = trial.trained

    def fails(bench, setting, known):
        if setting != Setting():
            raise InputError("spikes: are gone")
        return trained(bench, setting, known)

    monkeypatch.setattr(trial, "trained", fails)
    with pytest.raises(InputError, match="no setting could be trained; the first one says: spikes: are gone"):
        nt.save_energy(run, tmp_path / "small", trials=3, workers=1)


def test_recordings_that_are_not_there_are_named(run, tmp_path):
    (run.parent / "skin.h5").rename(tmp_path / "moved.h5")
    try:
        with pytest.raises(InputError, match="skin"):
            start_of(run)
        assert start_of(run, recordings=tmp_path / "moved.h5").bench.encoder is not None
    finally:
        (tmp_path / "moved.h5").rename(run.parent / "skin.h5")


def test_the_same_training_again_is_the_run(run):
    """The recipe's choices are found again, so what a way changes is that way alone."""
    start = start_of(run)
    start = start._replace(bench=start.bench._replace(seeds=(3, 4)))
    plain, other = (trial.fitted_of(Job(1, point), start).network for point in ({}, {"rate penalty": 1}))
    assert start.bench.network.recipe == "default"
    assert other.spec.tau_mem_ms == plain.spec.tau_mem_ms
    assert other.spec.step_ms == plain.spec.step_ms
    again = start._replace(base=start.base._replace(network=start.base.network))
    setting = ways.Setting(rate_penalty=0.0)
    network = trial.trained(again.bench, setting, again.known).network
    assert all(torch.equal(network.state_dict()[name], value) for name, value in plain.state_dict().items())


def test_times_are_whole_steps_of_the_encoders_clock(run):
    start = start_of(run)
    every = ways_of(start)
    for name, way in every.items():
        for amount in range(len(way.amounts)):
            setting = setting_of({name: amount, "encoder's clock": 1}, every, start)
            assert setting.encoder_ms is not None
            for time in (*(setting.t_ref_ms or ()), *([setting.step_ms] if setting.step_ms else ())):
                assert time >= setting.encoder_ms
                assert math.isclose(time % setting.encoder_ms % setting.encoder_ms, 0, abs_tol=1e-9)
    assert setting_of({}, every, start) == setting_of({"window": 0}, every, start) == ways.Setting()


def test_each_way_saves_something_that_it_names(run):
    start = start_of(run)
    every = ways_of(start)
    base = tried(Job(0, {}), start)
    sparse = tried(Job(1, {"pruning": 2}), start)
    assert sparse.about["weights"] < 0.5 * base.about["weights"]
    assert sparse.decided[WHOLE]["sops_total"] < base.decided[WHOLE]["sops_total"]
    fewer = tried(Job(2, {"afferents": 2}), start)
    assert fewer.about["afferents"] == base.about["afferents"] // 2
    assert choice.in_words(fewer.about, base.about, WHOLE) == f"{fewer.about['afferents']} afferents"
    none = tried(Job(3, {"hidden neurons": len(every["hidden neurons"].amounts) - 1}), start)
    assert none.about["hidden"] == 0
    assert not none.error


def test_others_validate_a_point_that_was_chosen(run):
    start = start_of(run)
    split = start.bench.split
    second, third = (other_validation(start, member) for member in (2, 3))
    for other in (second, third):
        assert np.array_equal(other.test, split.test)
        assert {*other.validation} <= {*split.train}
        assert {*other.train} | {*other.validation} == {*split.train} | {*split.validation}
        assert not {*other.train} & {*other.validation}
    assert not {*second.validation} & {*third.validation}


def test_copies_of_a_test_trial_are_one(run, monkeypatch):
    start = start_of(run)
    own = points._right(start.base, FULL_WINDOW, start)
    assert [*own] == start.bench.split.test.tolist()
    monkeypatch.setattr(points, "copies_of", lambda trains: SimpleNamespace(first=np.arange(N) // 4 * 4))
    once = points._right(start.base, FULL_WINDOW, start)
    assert [*once] == sorted({trial // 4 * 4 for trial in own})
    assert once == {one: np.mean([own[trial] for trial in own if trial // 4 * 4 == one]) for one in once}


def test_groups_are_not_torn_apart_for_other_validation(run):
    start = start_of(run)
    task = start.bench.task.model_copy(update={"split": start.bench.task.split.model_copy(update={"group": ("day",)})})
    grouped = start._replace(bench=start.bench._replace(task=task))
    assert other_validation(grouped, 2) == start.bench.split


def done(number, point, accuracy, energy, member=1):
    """A trial with ten validation trials."""
    n = round(10 * accuracy)
    costs = {"validation_accuracy": accuracy, LIST: energy, "sops_total": 10 * energy, "test_accuracy": 0.0}
    return Trial(number, point, member, {WHOLE: costs}, {WHOLE: [1.0] * n + [0.0] * (10 - n)}, {"hidden": 4})


WAYS = {name: Way(name, ({}, {name: 1}, {name: 2}), 1) for name in ("a", "b", "c")}
ASKED = Asked(trials=12, loss=0.0, prices=LIST, seed=0)


def test_a_search_tries_each_way_alone_then_together_then_what_tpe_proposes():
    trials: list[Trial] = []
    saved_share = {"a": 0.5, "b": 0.8, "c": 1.0}
    sizes = []
    while batch := next_batch(trials, WAYS, ASKED):
        sizes.append([job.point for job in batch])
        for job in batch:
            energy = 100 * math.prod(saved_share[name] ** amount for name, amount in job.point.items())
            trials.append(done(job.id, job.point, 0.9, energy, job.member))
    assert sizes[:3] == [[{}], [{"a": 1}, {"b": 1}, {"c": 1}], [{"a": 1, "b": 1}]]
    assert [trial.id for trial in trials] == [*range(len(trials))]
    assert len(trials) - 1 == ASKED.trials
    searched = [key_of(trial.point) for trial in trials if trial.member == 1]
    assert len(searched) == len({*searched}) == 1 + ASKED.trials - ASKED.n_again
    again = {key_of(trial.point) for trial in trials if trial.member > 1}
    assert key_of({}) in again
    assert len(again) == ASKED.n_again // 2


def test_a_finalist_that_fails_is_followed_by_a_dearer_one():
    trials = [done(0, {}, 0.9, 100.0), *(done(n, {"a": n}, 0.9, 10.0 * n) for n in range(1, 6))]
    asked = ASKED._replace(trials=60)
    assert next_finalist(trials, asked) == (("a", 1),)
    again = [done(6, {}, 0.9, 100.0, 2), done(7, {"a": 1}, 0.8, 10.0, 2)]
    assert next_finalist([*trials, *again], asked) == (("a", 4),)
    again.append(done(8, {"a": 4}, 0.9, 40.0, 2))
    assert next_finalist([*trials, *again], asked) == (("a", 3),)


def test_what_was_judged_by_others_decides_and_the_cheapest_that_keeps_is_the_answer():
    trials = [done(0, {}, 0.9, 100.0), *(done(n, {"a": n}, 0.9, 10.0 * n) for n in (1, 2, 3))]
    trials += [done(4, {}, 0.8, 100.0, 2), done(5, {"a": 1}, 0.7, 10.0, 2), done(6, {"a": 2}, 0.8, 20.0, 2)]
    result = found(trials, ASKED)
    assert result.answer is not None
    assert key_of(result.answer.trial.point) == (("a", 2),)
    assert [one.trial.id for one in result.points] == [2, 1]
    assert result.was_judged
    assert found(trials, ASKED._replace(loss=0.2)).answer.trial.id == 1  # pyright: ignore[reportOptionalMemberAccess]
    assert found(trials[:4], ASKED).answer.trial.id == 1  # pyright: ignore[reportOptionalMemberAccess]
    lossy = [*trials[:4], done(4, {}, 0.9, 100.0, 2), done(5, {"a": 1}, 0.7, 10.0, 2)]
    assert found(lossy, ASKED).answer is None
    assert found(lossy, ASKED._replace(loss=0.2)).answer is not None


def test_the_interval_of_a_loss_holds_the_loss_and_shrinks():
    rng = np.random.default_rng(0)
    for n in (10, 100, 1000):
        lost = rng.integers(-1, 2, n).astype(float)
        mean, low, high = interval(lost)
        assert low < mean < high
        assert high - low < 8 / n**0.5


def test_words_of_the_answer_have_the_sign_of_the_numbers():
    row = {
        "lost_test": -0.02,
        "lost_test_low": -0.05,
        "lost_test_high": 0.01,
        "left": {"sops_total": 0.25, LIST: 1.1},
        "setting": "x",
    }
    said = save._sentence(row, ASKED)
    assert said == f"2.0 points more (-1.0 to 5.0), 75 % fewer SOPs, 10 % more energy by {LIST}: x"


def test_recordings_are_enough(run, tmp_path):
    answer = nt.save_energy(run.parent / "skin.h5", tmp_path / "out", trials=1, workers=1)
    assert (tmp_path / "out" / "run" / "network.json").is_file()
    assert len(answer["points"]) <= 1
    again = nt.save_energy(run.parent / "skin.h5", tmp_path / "out", trials=1, workers=1)
    assert again["answer"] == answer["answer"]
    for key in ("recordings", "spikes"):
        with pytest.raises(InputError, match=f"`{key}`: has no effect with a file"):
            nt.save_energy(run.parent / "skin.h5", tmp_path / "other", **{key: run.parent / "skin.h5"})


def test_slow_recordings_are_encoded_once_per_sample(tmp_path, monkeypatch):
    monkeypatch.setattr(save.nt, "train", lambda *given, **how: None)
    signals = [make_signal(100, seed=k) * (1.0 if k % 2 else 1.6) for k in range(N)]
    touches = Recordings(signals, 100.0, "mV", pd.DataFrame({"label": [("felt", "silk")[k % 2] for k in range(N)]}))
    hdf5.save_recordings(touches, tmp_path / "slow.h5")
    save._trained_on(tmp_path / "slow.h5", tmp_path, 0, print)
    made = hdf5.load_spikes(tmp_path / save.SPIKES)
    assert (made.encoder["integration"], made.sampling_rate_Hz) == ("exact", 1000.0)


def test_a_search_says_what_limits_its_answer(saved, run):
    _folder, answer, _ = saved
    assert answer["cautions"] == []
    assert answer["points"][0]["integers"]["accuracy_test_8bit"] >= 0
    start = start_of(run)
    split = start.bench.task.split.model_copy(update={"test_where": {"day": 1}})
    elsewhere = start._replace(bench=start.bench._replace(task=start.bench.task.model_copy(update={"split": split})))
    result = found([done(0, {}, 0.9, 100.0), done(1, {"a": 1}, 0.9, 10.0)], ASKED)
    assert [line.split()[0] for line in save._cautions(result, elsewhere)] == ["validation", "no"]


def test_a_study_gives_the_network_that_its_report_names(tmp_path):
    told = []
    with pytest.raises(InputError, match=r"its report names no network; neurotact study resume .* goes on to its end"):
        save.best_of_study(tmp_path, told.append)
    (tmp_path / "answer.json").write_text(json.dumps({"answers": [{"leader": ""}, {"leader": "b"}]}))
    (tmp_path / "cells" / "b").mkdir(parents=True)
    with pytest.raises(InputError, match="b: holds no network"):
        save.best_of_study(tmp_path, told.append)
    (tmp_path / "cells" / "b" / "network.json").write_text("{}")
    assert save.best_of_study(tmp_path, told.append).name == "b"
    assert told == [
        f"{tmp_path / 'cells' / 'b'}: the best network of {tmp_path} on validation trials, from which the search starts"
    ]
