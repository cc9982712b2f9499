"""`neurotact train` goes on where it was interrupted and leaves the bytes of a training that was not."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from uuid import uuid4

import numpy as np
import pandas as pd
import pytest
import safetensors.torch
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples, thinned

from neurotact import cli, files, spec
from neurotact.data.hdf5 import save_spikes
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError
from neurotact.networks.definition.seeds import of_start
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import resumable, run_folder, tasks, trainer
from neurotact.networks.training.resumable import (
    ASKED,
    CHECKPOINT,
    CHOICE,
    LAST,
    LEFT,
    OF_DETECTOR,
    RESULT,
    Interrupted,
    run,
)
from neurotact.spec import override, read, to_toml

ROOT = Path(__file__).parents[2]
N_EPOCHS = 5
NETWORK = RSNNSpec(hidden=6, learn=("beta",), training=TrainingSpec(epochs=N_EPOCHS, batch=8, learning_rate=0.05))
TASK = tasks.Task(window={"length_ms": 40.0})


def spikes_of(seed: int, n_trials: int = 24, n_steps: int = 40) -> SpikeTrains:
    """Two classes that fire on different afferents."""
    labels = np.arange(n_trials) % 2
    rates = np.where(labels[:, None] == np.array([[0, 0, 1, 1]]), 0.3, 0.1)
    rasters = np.random.default_rng(seed).random((n_trials, n_steps, 4)) < rates[:, None]
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": [("felt", "silk")[i] for i in labels]}))


@pytest.fixture(scope="module")
def spikes(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("spikes") / "spikes.h5"
    save_spikes(spikes_of(0), path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every file, hidden ones too; the folder is as deep below the spikes as any other here."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(spikes) -> dict[str, bytes]:
    """What an uninterrupted training leaves."""
    assert run(spikes, spikes.parent / "whole", NETWORK, TASK) is not None
    left = contents(spikes.parent / "whole")
    assert set(left) == set(LEFT) - {CHECKPOINT, LAST, CHOICE, *OF_DETECTOR}
    return left


@thinned("network", [NETWORK, spec.load(RSNNSpec, "default", {"training.epochs": 3})], ids=["own", "default"])
def test_the_number_of_threads_changes_no_byte(spikes, network):
    """Nor, so, does the number of trainings that run side by side in processes of one thread each."""
    left, before = [], torch.get_num_threads()
    try:
        for n_threads in (1, 2, 5):
            torch.set_num_threads(n_threads)
            left.append(new_folder(spikes))
            run(spikes, left[-1], network, TASK)
    finally:
        torch.set_num_threads(before)
    assert contents(left[0]) == contents(left[1]) == contents(left[2])


@pytest.fixture
def folder(spikes) -> Path:
    return new_folder(spikes)


def new_folder(spikes: Path) -> Path:
    """A folder beside the spikes that is not there yet."""
    return spikes.parent / f"run-{uuid4()}"


class Stop:
    """Raises in place of the n-th call of `resumable.line_of`, which each epoch makes once."""

    def __init__(self, after: int, error: type[BaseException] = KeyboardInterrupt) -> None:
        self.left, self.error = after, error

    def __call__(self, *_) -> str:
        if self.left == 0:
            raise self.error
        self.left -= 1
        return ""


def interrupt(monkeypatch, after: int, spikes: Path, folder: Path, **options) -> int:
    """Interrupt a training when so many epochs are saved; how many it says are."""
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(after))
        with pytest.raises(Interrupted) as end:
            run(spikes, folder, NETWORK, TASK, **options)
    return end.value.epochs


def test_what_a_recipe_chooses_is_told_saved_and_gone_on_with(monkeypatch, spikes, folder):
    asked = RSNNSpec(recipe="default", hidden=6, training=TrainingSpec(epochs=N_EPOCHS))
    told, told_again = [], []
    assert run(spikes, folder, asked, TASK, tell=told.append) is not None
    assert "tau_mem_ms = 2.0 (a twentieth of the window, at least one step)" in told
    assert "epochs" not in " ".join(told).replace("all epochs", "")  # it is given
    left = contents(folder)
    saved = json.loads(left["network.json"])["spec"]
    assert saved["readout"] == "integrator"
    assert saved["tau_mem_ms"] == 2.0
    assert saved["recipe"] is None
    assert read(folder / ASKED)["network"] == {key: value for key, value in saved.items() if value is not None}

    again = new_folder(spikes)
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(3))
        with pytest.raises(Interrupted):
            run(spikes, again, asked, TASK)
    assert run(spikes, again, asked, TASK, resume=True, tell=told_again.append) is not None
    assert told_again == told
    assert contents(again) == left
    assert run(spikes, again, asked, TASK, resume=True, tell=told_again.append) is None
    assert told_again == told  # nothing is trained, so nothing is chosen


@examples(6)
@given(stops=st.lists(st.integers(0, N_EPOCHS - 1), min_size=1, max_size=3), between=st.sampled_from([0.0, 1e9]))
def test_a_training_interrupted_after_any_epochs_leaves_the_same_bytes(monkeypatch, spikes, whole, stops, between):
    monkeypatch.setattr(resumable, "SECONDS_BETWEEN", between)  # each epoch, or the first and the last alone
    folder = new_folder(spikes)
    done = 0
    for more in stops:
        more = min(more, N_EPOCHS - 1 - done)
        done += more
        assert interrupt(monkeypatch, more, spikes, folder, resume=True) == done
        assert not folder.exists() if done == 0 else set(contents(folder)) == {ASKED, CHECKPOINT}
    assert run(spikes, folder, NETWORK, TASK, resume=True) is not None
    assert contents(folder) == whole


@pytest.mark.parametrize(
    "place", ["training.run_folder.save", "use.measuring.measure", "training.resumable.files.write_json"]
)
def test_an_interrupt_after_the_last_epoch_loses_nothing(monkeypatch, spikes, whole, folder, place):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"neurotact.networks.{place}", interrupted)
        with pytest.raises(Interrupted) as end:
            run(spikes, folder, NETWORK, TASK)
    assert end.value.epochs == N_EPOCHS
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(0))  # no epoch is trained again
        assert run(spikes, folder, NETWORK, TASK, resume=True) is not None
    assert contents(folder) == whole


ELSEWHERE = tasks.Task(window={"length_ms": 40.0}, split={"test_where": {"speed": 3}})


@pytest.fixture(scope="module")
def at_speeds(tmp_path_factory) -> Path:
    """Spikes of three speeds."""
    path, trains = tmp_path_factory.mktemp("speeds") / "spikes.h5", spikes_of(0)
    trains.conditions["speed"] = np.repeat([1, 2, 3], 8)
    save_spikes(trains, path)
    return path


@pytest.fixture(scope="module")
def elsewhere(at_speeds) -> dict[str, bytes]:
    """What a training leaves that is tested at an untrained speed."""
    assert run(at_speeds, at_speeds.parent / "whole", NETWORK, ELSEWHERE) is not None
    left = contents(at_speeds.parent / "whole")
    assert set(left) == set(LEFT) - {CHECKPOINT, LAST, *OF_DETECTOR}
    return left


def test_after_the_choice_every_other_condition_is_trained_on(at_speeds, elsewhere):
    trains = tasks.load_spikes(at_speeds, ELSEWHERE)
    first, seeds = tasks.trials_of(trains, ELSEWHERE), of_start(0, ELSEWHERE.split)
    assert np.unique(trains.conditions["speed"].iloc[first.train]).size == 1
    chosen, sides = trainer.fit(trains, NETWORK, ELSEWHERE, seeds)
    choice, row = json.loads(elsewhere[CHOICE]), json.loads(elsewhere[RESULT])["row"]
    assert choice["accuracy_validation"] == row["accuracy_validation"] == chosen.training.best.validation_accuracy
    assert choice["exit_patience"] == row["exit_patience"] == chosen.rule.patience
    assert choice["exit_accuracy_validation"] == row["exit_accuracy_validation"]
    restored = run_folder.restore(at_speeds.parent / "whole")
    assert restored.held == chosen.held  # of the speed that validation left out
    assert set(restored.held.losses) == set(first.validation.tolist())
    assert row["exit_loss_bound"] == restored.held.bound
    told = [one for one in json.loads(elsewhere[RESULT])["cautions"] if one.startswith("early exit is not used")]
    assert bool(told) == restored.held.is_refused
    last = tasks.trials_of(trains, restored.task)
    assert np.unique(trains.conditions["speed"].iloc[last.train]).tolist() == [1, 2]
    assert last.test.tolist() == first.test.tolist() == list(range(16, 24))
    again, _ = trainer.fit(trains, NETWORK, restored.task, seeds)
    torch.testing.assert_close(restored.network.state_dict(), again.network.state_dict(), rtol=0, atol=0)
    assert not torch.equal(restored.network.w_in, chosen.network.w_in)
    assert restored.rule == chosen.rule
    assert not restored.has_own_rule
    assert len(sides.validation.labels) == 8


@pytest.mark.parametrize("is_possible", [True, False])
def test_a_last_training_is_said_where_there_is_one(monkeypatch, at_speeds, is_possible):
    said: list[str] = []
    with monkeypatch.context() as patch:
        if not is_possible:  # as where a class has a single trial at other speeds
            patch.setattr(tasks, "trials_of", refuses_other_splits(tasks.trials_of))
            with pytest.warns(
                UserWarning, match="speed = 3 is tested, training is not repeated with the condition that "
            ):
                run(at_speeds, new_folder(at_speeds), NETWORK, ELSEWHERE, tell=said.append)
        else:
            run(at_speeds, new_folder(at_speeds), NETWORK, ELSEWHERE, tell=said.append)
    assert [line.endswith("; after the choice all are trained on") for line in said].count(True) == is_possible
    assert said[0].startswith("Validation leaves out one speed")


def refuses_other_splits(trials_of):
    """`tasks.trials_of` that refuses a split without a condition left out for validation."""

    def refusing(trains, task, split=None):
        if not task.split.nested:
            raise InputError("split: too few trials")
        return trials_of(trains, task, split)

    return refusing


@pytest.mark.parametrize("after", range(2 * N_EPOCHS))
def test_both_trainings_go_on_after_any_epoch(monkeypatch, at_speeds, elsewhere, after):
    folder = new_folder(at_speeds)
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(after))
        with pytest.raises(Interrupted):
            run(at_speeds, folder, NETWORK, ELSEWHERE)
    if after:
        with pytest.raises(InputError, match="pass `resume=True` to continue"):
            run(at_speeds, folder, NETWORK, ELSEWHERE)
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(2 * N_EPOCHS - after))  # no epoch is trained again
        assert run(at_speeds, folder, NETWORK, ELSEWHERE, resume=True) is not None
    assert contents(folder) == elsewhere
    assert run(at_speeds, folder, NETWORK, ELSEWHERE, resume=True) is None


def test_a_kill_between_the_trainings_loses_nothing(monkeypatch, at_speeds, elsewhere):
    folder = new_folder(at_speeds)

    def killed(self, *_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(resumable._Run, "last", killed)
        with pytest.raises(MemoryError):
            run(at_speeds, folder, NETWORK, ELSEWHERE)
    assert set(contents(folder)) == {ASKED, CHOICE}
    assert run(at_speeds, folder, NETWORK, ELSEWHERE, resume=True) is not None
    assert contents(folder) == elsewhere


def test_a_training_that_is_done_is_left_alone(monkeypatch, spikes, whole, folder):
    assert run(spikes, folder, NETWORK, TASK) is not None
    monkeypatch.setattr(trainer, "fit", None)
    assert run(spikes, folder, NETWORK, TASK, resume=True) is None
    with pytest.raises(InputError, match=r"already exists and is not empty; .*`force=True`"):
        run(spikes, folder, NETWORK, TASK)
    assert contents(folder) == whole


def test_the_folder_says_what_was_asked(spikes, whole):
    asked = read(spikes.parent / "whole" / ASKED)
    assert asked["spikes"] == os.path.join("..", "spikes.h5")
    assert asked["network"]["training"]["epochs"] == N_EPOCHS
    assert asked["task"]["window"]["length_ms"] == 40.0
    assert asked["versions"]["neurotact"]


# --- other settings, other spikes, other versions ---------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"seed": 1}, "seed = 0, not 1"),
        ({"network": NETWORK.model_copy(update={"hidden": 7})}, "network.hidden = 6, not 7"),
        ({"network": NETWORK.model_copy(update={"learn": ()})}, r"network.learn = \['beta'\], not \[\]"),
        ({"task": TASK.model_copy(update={"exit_tolerance": 0.5})}, "task.exit_tolerance = 0.01, not 0.5"),
        ({"task": tasks.Task(window={"length_ms": 40, "hop_ms": 20})}, "task.window.hop_ms = None, not 20.0"),
    ],
)
@pytest.mark.parametrize("is_done", [True, False])
def test_other_settings_are_refused_by_name(monkeypatch, spikes, whole, folder, changes, expected, is_done):
    if is_done:
        folder = spikes.parent / "whole"
    else:
        interrupt(monkeypatch, 2, spikes, folder)
    before = contents(folder)
    asked = {"network": NETWORK, "task": TASK, **changes}
    with pytest.raises(InputError, match=f"was started with {expected}; give that, or start again with `force=True`"):
        run(spikes, folder, **asked, resume=True)
    assert contents(folder) == before


def test_a_training_of_an_earlier_form_is_refused(monkeypatch, spikes, folder):
    interrupt(monkeypatch, 2, spikes, folder)
    path = folder / ASKED
    path.write_text(path.read_text().replace("schema = 2\n", ""))
    with pytest.raises(InputError, match=r"holds a training of another neurotact \(schema none, here 2\); start again"):
        run(spikes, folder, NETWORK, TASK, resume=True)


def test_spikes_that_changed_are_refused_and_moved_ones_are_not(monkeypatch, tmp_path, spikes, whole):
    mine = tmp_path / "spikes.h5"
    mine.write_bytes(spikes.read_bytes())
    interrupt(monkeypatch, 2, mine, tmp_path / "run")
    save_spikes(spikes_of(1), mine)
    with pytest.raises(InputError, match="started with other spikes, or the file has changed"):
        run(mine, tmp_path / "run", NETWORK, TASK, resume=True)
    mine.unlink()
    run(spikes, tmp_path / "run", NETWORK, TASK, resume=True)
    assert contents(tmp_path / "run")["weights.safetensors"] == whole["weights.safetensors"]


def test_other_versions_are_told(monkeypatch, spikes, whole, folder):
    versions = dict.fromkeys(resumable.NUMBERS, "x")
    with monkeypatch.context() as patch:
        patch.setattr(resumable, "versions", lambda: {**versions, "torch": "1.0"})
        interrupt(patch, 2, spikes, folder)
        patch.setattr(resumable, "versions", lambda: {**versions, "torch": "2.0"})
        with pytest.warns(UserWarning, match=r"was started with torch 1\.0; its numbers may differ"):
            run(spikes, folder, NETWORK, TASK, resume=True)
    assert contents(folder)["weights.safetensors"] == whole["weights.safetensors"]


# --- folders that are not free, and --force ---------------------------------------------------------


def test_an_interrupted_training_is_not_begun_again_unasked(monkeypatch, spikes, folder):
    interrupt(monkeypatch, 2, spikes, folder)
    before = contents(folder)
    with pytest.raises(InputError, match="pass `resume=True` to continue, or `force=True` to start again"):
        run(spikes, folder, NETWORK, TASK)
    assert contents(folder) == before


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, spikes):
    (tmp_path / "thesis.txt").write_text("precious")
    for options, expected in (({}, "is not empty"), ({"resume": True}, "holds no training to resume")):
        with pytest.raises(InputError, match=expected):
            run(spikes, tmp_path, NETWORK, TASK, **options)
    with pytest.raises(InputError, match=r"thesis\.txt: is a file; name a folder"):
        run(spikes, tmp_path / "thesis.txt", NETWORK, TASK)
    assert contents(tmp_path) == {"thesis.txt": b"precious"}


@pytest.mark.parametrize("interrupted", [True, False])
def test_force_replaces_a_training_and_nothing_else(monkeypatch, spikes, whole, folder, interrupted):
    other = NETWORK.model_copy(update={"hidden": 9})
    run(spikes, folder, other, TASK)
    if interrupted:
        (folder / RESULT).unlink()
        (folder / CHECKPOINT).write_bytes(b"old")
    (folder / "thesis.txt").write_text("precious")
    assert run(spikes, folder, NETWORK, TASK, force=True) is not None
    assert contents(folder) == {**whole, "thesis.txt": b"precious"}


def test_force_replaces_nothing_until_an_epoch_is_over(monkeypatch, spikes, whole, folder):
    run(spikes, folder, NETWORK, TASK)
    assert interrupt(monkeypatch, 0, spikes, folder, seed=1, force=True) == 0
    with pytest.raises(InputError, match="shorten the window"):
        run(spikes, folder, NETWORK, tasks.Task(window={"length_ms": 1e6}), force=True)
    assert contents(folder) == whole
    assert interrupt(monkeypatch, 1, spikes, folder, seed=1, force=True) == 1
    assert set(contents(folder)) == {ASKED, CHECKPOINT}


def test_a_refused_training_makes_no_folder(tmp_path, spikes):
    with pytest.raises(InputError, match="shorten the window"):
        run(spikes, tmp_path / "a" / "b", NETWORK, tasks.Task(window={"length_ms": 1e6}))
    with pytest.raises(InputError, match="`force`, `resume`: give one of them"):
        run(spikes, tmp_path / "a" / "b", NETWORK, TASK, force=True, resume=True)
    assert not list(tmp_path.iterdir())


def test_one_training_at_a_time(spikes, folder):
    with files.locked(folder), pytest.raises(InputError, match="is working here"):
        run(spikes, folder, NETWORK, TASK)


def test_drafts_of_a_killed_process_are_swept_and_do_not_fill_a_folder(spikes, whole, folder):
    folder.mkdir()
    (folder / f"{files.DRAFT}1.toml").write_text("")
    (folder / files.LOCK).write_text("")
    run(spikes, folder, NETWORK, TASK)
    assert contents(folder) == whole


# --- damaged folders --------------------------------------------------------------------------------


def damage(folder: Path, what: str) -> None:
    path = folder / (ASKED if what.startswith("asked") else CHECKPOINT)
    content = path.read_bytes()
    if what.endswith("truncated"):
        path.write_bytes(content[: len(content) // 2])
    elif what.endswith("junk"):
        path.write_bytes(b'\xff{"junk": [')
    elif what.endswith("absent"):
        path.unlink()
    elif what == "asked of another kind":
        path.write_text("schema = 2\nhidden = 3\n")
    elif what == "asked for something else":  # by one who edits both the file and the command
        path.write_text(to_toml(override(read(path), {"network.training.learning_rate": 0.9})))
    else:
        tensors = safetensors.torch.load(content)
        tensors["weights.w_in"][0, 0] = {"NaN": float("nan"), "another weight": 0.5}[what]
        path.write_bytes(safetensors.torch.save(tensors))


@thinned(
    "what",
    [
        "truncated", "junk", "NaN", "another weight", "asked truncated", "asked junk", "asked absent",
        "asked of another kind",
    ],
    every=4,
)  # fmt: skip
def test_a_damaged_folder_is_refused_and_begun_again_with_force(monkeypatch, spikes, whole, folder, what):
    interrupt(monkeypatch, 2, spikes, folder)
    damage(folder, what)
    name = ASKED if what.startswith("asked") else CHECKPOINT
    with pytest.raises(InputError, match=f"{name}: .*; start again with `force=True`$") as refusal:
        run(spikes, folder, NETWORK, TASK, resume=True)
    assert "\n" not in str(refusal.value)
    assert run(spikes, folder, NETWORK, TASK, force=True) is not None
    assert contents(folder) == whole


def test_a_checkpoint_goes_with_its_own_settings_alone(monkeypatch, spikes, folder):
    interrupt(monkeypatch, 2, spikes, folder)
    damage(folder, "asked for something else")
    training = NETWORK.training.model_copy(update={"learning_rate": 0.9})
    with pytest.raises(InputError, match="of another training"):
        run(spikes, folder, NETWORK.model_copy(update={"training": training}), TASK, resume=True)


def test_a_folder_without_its_checkpoint_is_begun_again(monkeypatch, spikes, whole, folder):
    interrupt(monkeypatch, 2, spikes, folder)
    (folder / CHECKPOINT).unlink()
    assert run(spikes, folder, NETWORK, TASK, resume=True) is not None
    assert contents(folder) == whole


def test_a_full_disk_is_one_sentence_and_the_training_goes_on_later(monkeypatch, spikes, whole, folder):
    interrupt(monkeypatch, 2, spikes, folder)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        patch.setattr(resumable, "SECONDS_BETWEEN", 0.0)
        with pytest.raises(InputError, match=r"cannot be written .*free space"):
            run(spikes, folder, NETWORK, TASK, resume=True)
    assert set(contents(folder)) == {ASKED, CHECKPOINT}
    assert run(spikes, folder, NETWORK, TASK, resume=True) is not None
    assert contents(folder) == whole


def full(*_) -> None:
    raise OSError(28, os.strerror(28))


# --- as a user meets it -----------------------------------------------------------------------------

OPTIONS = ("--network", "rsnn", "--set", f"training.epochs={N_EPOCHS}", "--set", "hidden=6", "--window-ms", "40")


def test_ctrl_c_says_how_to_go_on(monkeypatch, capsys, spikes, folder):
    words = ["train", str(spikes), "-o", str(folder), *OPTIONS]

    def typed(*more: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["neurotact", *words, *more])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        return (int(end.value.code or 0), *capsys.readouterr())

    with monkeypatch.context() as patch:
        patch.setattr(resumable, "line_of", Stop(0))
        said = "neurotact: interrupted before the first epoch was over; nothing is saved\n"
        assert typed() == (130, "", said)
        patch.setattr(resumable, "line_of", Stop(3))
        said = f"neurotact: interrupted after epoch 3; go on with: neurotact {' '.join(words)} --resume\n"
        assert typed("--force") == (130, "", said)
    code, out, err = typed("--resume")
    assert code == 0
    for told in (
        "accuracy ", "test trials); one start of the weights: others may differ\nbaselines: chance", "a decision costs",
        "saved in",
        f"next: neurotact infer {folder}", "neurotact sops",
    ):  # fmt: skip
        assert told in out
    done = rf"train {N_EPOCHS}/{N_EPOCHS}  loss .*, validation accuracy .*\n"
    assert re.fullmatch(rf"{done}(neurotact: .*\n)*", err)
    again, more, _ = typed("--resume")
    told, then, _ = more.split("\n", 2)
    assert (again, told) == (0, f"{folder}: this training is done already; its result is in {folder / RESULT}")
    assert then == f"next: neurotact infer {folder} {spikes}"


TRAIN = """
import sys
from pathlib import Path
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import resumable
from neurotact.networks.training.tasks import Task
resumable.SECONDS_BETWEEN = float(sys.argv[3])
network = RSNNSpec(hidden=6, training=TrainingSpec(epochs=int(sys.argv[4]), patience=10**6, batch=4))
try:
    resumable.run(Path(sys.argv[1]), Path(sys.argv[2]), network, Task(window={"length_ms": 40}), resume=True)
except resumable.Interrupted as interrupted:
    sys.exit(130)
"""


def begin(spikes: Path, folder: Path, n_epochs: int, between: float = 0.0) -> subprocess.Popen:
    words = [sys.executable, "-c", TRAIN, str(spikes), str(folder), str(between), str(n_epochs)]
    return subprocess.Popen(words, env={**os.environ, "PYTHONPATH": str(ROOT)}, stderr=subprocess.DEVNULL)


def wait_for(path: Path, process: subprocess.Popen) -> None:
    while not path.exists() and process.poll() is None:
        time.sleep(0.01)


@pytest.mark.slow
def test_the_end_of_a_time_limit_saves_as_ctrl_c_does(spikes, folder):
    with begin(spikes, folder, 10**6, between=1e9) as process:
        wait_for(folder / CHECKPOINT, process)
        first = (folder / CHECKPOINT).read_bytes()
        time.sleep(0.5)
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 130
    assert set(contents(folder)) == {ASKED, CHECKPOINT}
    assert (folder / CHECKPOINT).read_bytes() != first


@pytest.mark.slow
def test_a_training_killed_at_random_moments_leaves_the_same_bytes(spikes):
    n_epochs, draw = 300, random.Random(0)
    undisturbed, killed = new_folder(spikes), new_folder(spikes)
    with begin(spikes, undisturbed, n_epochs) as process:
        assert process.wait() == 0
    n_kills = 0
    while not (killed / RESULT).exists() and n_kills < 10:
        with begin(spikes, killed, n_epochs) as process:
            wait_for(killed / files.LOCK, process)
            time.sleep(draw.random() * 0.3)
            process.kill()
            n_kills += process.wait() != 0
    with begin(spikes, killed, n_epochs) as process:
        assert process.wait() == 0
    assert n_kills > 2
    assert contents(killed) == contents(undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("before", ["nothing", "done", "interrupted"])
def test_a_training_killed_before_any_step_of_its_writing_leaves_the_same_bytes(spikes, tmp_path, before):
    script = Path(__file__).with_name("killed_trainings.py")
    words = [sys.executable, str(script), str(spikes), str(tmp_path), before]
    done = subprocess.run(
        words, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    n_steps, n_untouched = map(int, done.stdout.split())
    assert n_steps > 20
    assert n_untouched < 5
