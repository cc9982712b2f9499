"""Cross-validation and repeated splits: every trial is tested once, and the mean is that of the trainings."""

import sys
import warnings
from dataclasses import replace
from typing import Any

import in_process
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from neurotact import cli
from neurotact.cli import app, output
from neurotact.data import hdf5
from neurotact.data.spikes import from_rasters
from neurotact.data.splits import Splits, aside_of, split_touches
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.files import read_json, write_json
from neurotact.metrics.resampled import resampled_interval
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import cross_validation, resumable, run_folder
from neurotact.networks.training.tasks import Task

COMMAND = "--network rsnn --set hidden=4 --set training.epochs=1 --window-ms 60"
SMALL = RSNNSpec(hidden=4, training=TrainingSpec(epochs=1))


@pytest.fixture
def spikes(tmp_path):
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"label": ["felt", "silk"] * 9})
    rasters = [rng.random((60, 2)) < (0.1 if label == "felt" else 0.5) for label in table["label"]]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), tmp_path / "spikes.h5")
    return tmp_path / "spikes.h5"


def tasks_of(conditions: pd.DataFrame | None = None, **splits: Any) -> dict[str, Task]:
    task = Task(window=WindowSpec(length_ms=60))
    return cross_validation.tasks_of(task, Splits(**splits), pd.DataFrame() if conditions is None else conditions)


@pytest.mark.thorough
def test_every_trial_is_tested_once_in_each_repetition(spikes, tmp_path):
    tasks = tasks_of(folds=3, seed=4, repeats=2)
    found = cross_validation.run(spikes, tmp_path / "run", SMALL, tasks)
    trains = hdf5.load_spikes(spikes)
    tested = [run_folder.test_trials(run_folder.restore(tmp_path / "run" / name), trains) for name in tasks]
    assert sorted(np.concatenate(tested[:3])) == sorted(np.concatenate(tested[3:])) == list(range(18))
    assert [tuple(trials) for trials in tested[:3]] != [tuple(trials) for trials in tested[3:]]
    rows = [read_json(tmp_path / "run" / name / "result.json")["row"]["accuracy_test"] for name in tasks]
    assert found.table["accuracy_test"].tolist() == rows
    assert found.table["split_seed"].tolist() == [4, 4, 4, 5, 5, 5]
    assert found.accuracy.mean == pytest.approx(np.mean(rows))
    assert found.accuracy.low <= found.accuracy.mean <= found.accuracy.high


def test_what_is_done_is_not_done_again(spikes, tmp_path):
    tasks = tasks_of(repeats=2)
    first = cross_validation.run(spikes, tmp_path / "run", SMALL, tasks)
    before = (tmp_path / "run/seed-0/weights.safetensors").stat().st_mtime_ns
    with pytest.raises(InputError, match=r"splits\.csv: already exists"):
        cross_validation.run(spikes, tmp_path / "run", SMALL, tasks)
    again = cross_validation.run(spikes, tmp_path / "run", SMALL, tasks, resume=True)
    assert again.table.equals(first.table)
    assert (tmp_path / "run/seed-0/weights.safetensors").stat().st_mtime_ns == before


def test_one_interrupted_after_a_split_is_told_to_resume(spikes, tmp_path):
    """Not to start again, which would train the first split anew."""
    one, both = (tasks_of(repeats=n) for n in (1, 2))
    cross_validation.run(spikes, tmp_path / "run", SMALL, one)
    (tmp_path / "run/splits.csv").unlink()
    with pytest.raises(InputError, match="were interrupted; pass `resume=True` to continue"):
        cross_validation.run(spikes, tmp_path / "run", SMALL, both)
    assert len(cross_validation.run(spikes, tmp_path / "run", SMALL, both, resume=True).table) == 2


def test_other_splits_are_not_mixed_into_the_folder_of_an_earlier_run(spikes, tmp_path):
    few, more = (tasks_of(repeats=n) for n in (2, 3))
    cross_validation.run(spikes, tmp_path / "run", SMALL, few)
    table = (tmp_path / "run/splits.csv").read_bytes()
    folds = tasks_of(folds=2)
    with pytest.raises(InputError, match=r"holds trainings of other splits \(seed-0, seed-1\)"):
        cross_validation.run(spikes, tmp_path / "run", SMALL, folds, resume=True)
    assert (tmp_path / "run/splits.csv").read_bytes() == table
    assert len(cross_validation.run(spikes, tmp_path / "run", SMALL, more, resume=True).table) == 3


def test_an_interruption_of_a_later_training_tells_how_to_go_on(spikes, tmp_path, monkeypatch, capsys):
    begun, folder = tasks_of(), tmp_path / "run"
    words = ["train", str(spikes), "-o", str(folder), *COMMAND.split(), "--repeats", "2"]
    cross_validation.run(spikes, folder, SMALL, begun)

    def interrupted(*_, **__):
        raise resumable.Interrupted(0)

    monkeypatch.setattr(resumable, "run", interrupted)
    monkeypatch.setattr(sys, "argv", ["neurotact", *words, "--resume"])
    with pytest.raises(SystemExit):
        cli.main()
    assert "earlier trainings are saved; go on with: neurotact train" in capsys.readouterr().err


def test_one_fold_is_one_training(spikes, tmp_path):
    done = CliRunner().invoke(
        app, ["train", str(spikes), "-o", str(tmp_path / "run"), *COMMAND.split(), "--folds", "3", "--fold", "1"]
    )
    assert done.exit_code == 0
    assert not (tmp_path / "run" / "splits.csv").exists()
    assert run_folder.restore(tmp_path / "run").task.split.fold == 1


def test_seeds_that_would_test_the_same_trials_are_refused():
    with pytest.raises(InputError, match=r"`repeats`: the test trials of `order` are the same"):
        tasks_of(order="trial", repeats=2)
    assert [*tasks_of(order="trial")] == ["seed-0"]
    # Each seed validates on another condition that training leaves out.
    seeds = tasks_of(test_where={"speed": 450}, repeats=2)
    assert [task.split.seed for task in seeds.values()] == [0, 1]


def test_the_command_prints_a_row_of_each_training_and_the_mean(spikes):
    words = ["train", str(spikes), "-o", str(spikes.parent / "run"), "--repeats", "2", *COMMAND.split()]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "baseline" in done.output
    assert "% over 2 splits (too few for an interval: " in done.output
    assert "95 %" not in done.output


@pytest.fixture
def at_speeds(tmp_path):
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"label": ["felt", "silk"] * 12, "speed": np.repeat([450, 150, 300], 8)})
    rasters = [rng.random((60, 2)) < (0.1 if label == "felt" else 0.5) for label in table["label"]]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), tmp_path / "speeds.h5")
    return tmp_path / "speeds.h5"


def test_each_speed_is_tested_by_a_network_that_has_not_seen_it(at_speeds, tmp_path):
    words = ["train", str(at_speeds), "-o", str(tmp_path / "run"), *COMMAND.split(), "--leave-out-each", "speed"]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0
    trains = hdf5.load_spikes(at_speeds)
    for speed, name in ((150, "0-speed-150"), (300, "1-speed-300"), (450, "2-speed-450")):
        restored = run_folder.restore(tmp_path / "run" / name)
        tested = run_folder.test_trials(restored, trains)
        assert set(trains.conditions["speed"][tested]) == {speed}
        assert len(tested) == 8
        assert f"speed = {speed}: " in done.stdout
    assert "%) over 3 values of speed, " in done.stdout
    table = pd.read_csv(tmp_path / "run" / "splits.csv", comment="#")
    assert table["left_out"].tolist() == ["speed = 150", "speed = 300", "speed = 450"]


def test_each_speed_without_a_last_training_is_said_once(tmp_path):
    """Of silk one trial is left where 150 or 300 is tested, too few to train and validate on."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame(
        [("felt", speed) for speed in (150, 300, 450) for _ in range(6)] + [("silk", 150), ("silk", 300)]
    )
    table.columns = ["label", "speed"]
    rasters = [rng.random((60, 2)) < (0.1 if label == "felt" else 0.5) for label in table["label"]]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), tmp_path / "spikes.h5")
    words = [tmp_path / "spikes.h5", "-o", tmp_path / "run", *COMMAND.split(), "--leave-out-each", "speed"]
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        done = in_process.typed("train", *words)
    assert done.code == 0, done.err
    said = [
        f"where speed = {speed} is tested, training is not repeated with the condition" for speed in (150, 300, 450)
    ]
    assert [done.err.count(line) for line in said] == [1, 1, 0]
    assert done.err.count("training is not repeated") == 2


@pytest.mark.parametrize("width", [80, 200])
def test_no_name_of_a_folder_is_cut(monkeypatch, capsys, width):
    monkeypatch.setattr(output.console, "width", width)
    folders = [f"{number}-speed_mm_per_s-{number}.6-force_N-12.0" for number in range(3)]
    row = {"accuracy_validation": 0.3333, "accuracy_test": 0.5, "baseline": 0.525, "sops_total": 167.6}
    output.show(pd.DataFrame([{"folder": folder, **row, "exit_steps": 600.0} for folder in folders]))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    first = "".join(line[1:].split("  ")[0] for line in lines)
    assert "…" not in "".join(lines)
    assert first.strip() == f"folder{''.join(folders)}"
    assert (len(lines) == 4) == (width == 200)  # folded only where it has to be


def test_a_name_with_brackets_or_colons_is_printed_as_it_is(capsys):
    names = ["[red]felt", "[/b]", ":tada:", "[felt]"]
    output.show(pd.DataFrame({"[dim]label": names}))
    assert [line.strip() for line in capsys.readouterr().out.splitlines()] == ["[dim]label", *names]


def trained_with(accuracies):
    """`resumable.run` with these test accuracies in its results, one after the other."""
    run, left = resumable.run, iter(accuracies)

    def trained_as(spikes, folder, *more, **options):
        run(spikes, folder, *more, **options)
        result = read_json(folder / resumable.RESULT)
        result["row"]["accuracy_test"] = next(left)
        write_json(folder / resumable.RESULT, result)

    return trained_as


def test_splits_that_are_all_right_have_the_interval_of_their_test_trials(spikes, tmp_path, monkeypatch):
    monkeypatch.setattr(resumable, "run", trained_with([1.0] * 3))
    found = cross_validation.run(spikes, tmp_path / "run", SMALL, tasks_of(folds=3))
    # Each fold tests 6 of 18 trials: 6 / (1/3 + 6/12) are 7.
    assert [*found.accuracy] == pytest.approx([1.0, *wilson_interval(1.0, 7)])
    assert "accuracy 100.0 % (95 % interval 64.6 to 100.0 %) over 3 splits" in cross_validation.line(found)


def test_further_seeds_of_two_tested_values_give_no_interval(at_speeds, tmp_path, monkeypatch):
    given = ["--where", "speed=150,300", "--leave-out-each", "speed", "--repeats", "2"]
    said = in_process.typed("train", at_speeds, "-o", tmp_path / "run", *COMMAND.split(), *given).out
    assert "over 2 values of speed, 2 splits each (too few for an interval: test 3 values or more)" in said
    # Of three, it is that of the means at each of them: their seeds test the same trials.
    tasks = tasks_of(hdf5.load_spikes(at_speeds).conditions, leave_out_each="speed", repeats=2)
    monkeypatch.setattr(resumable, "run", trained_with([0.3, 0.5, 0.7, 0.5, 0.5, 0.5]))
    found = cross_validation.run(at_speeds, tmp_path / "three", SMALL, tasks)
    assert [*found.accuracy] == pytest.approx([*resampled_interval([0.4, 0.5, 0.6], 16, 8)])
    assert "%) over 3 values of speed, 2 splits each, " in cross_validation.line(found)


@pytest.fixture
def of_people(tmp_path):
    """Three people with 12, 6 and 6 presses, at two speeds each."""
    rng = np.random.default_rng(0)
    people = [("ann", speed) for speed in (1, 2) for _ in range(3)] * 2
    people += [(name, speed) for name in ("bob", "cem") for speed in (1, 2) for _ in range(3)]
    table = pd.DataFrame(people, columns=["person", "speed"]).assign(label=["felt", "silk"] * 12)
    table["force_N"] = rng.uniform(1, 5, len(table))
    rasters = [rng.random((60, 2)) < (0.1 if label == "felt" else 0.5) for label in table["label"]]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), tmp_path / "people.h5")
    return tmp_path / "people.h5"


@pytest.mark.parametrize(
    ("splits", "n_test"),
    [
        ({"group": "person", "repeats": 3}, None),  # a third of the groups at least, however small a share is asked for
        ({"group": "person", "folds": 3}, [12, 6, 6]),
        ({"leave_out_each": ("person", "speed"), "test_where": {"speed": 1}}, [6, 3, 3]),
        ({"leave_out_each": "person"}, [12, 6, 6]),
    ],
)
def test_the_interval_knows_how_many_trials_each_split_tests_and_leaves(
    of_people, tmp_path, monkeypatch, splits, n_test
):
    trains = hdf5.load_spikes(of_people)
    tasks = tasks_of(trains.conditions, **splits)
    own = [split_touches(trains, (), task.split) for task in tasks.values()]
    tested = [len(split.test) for split in own]
    assert n_test is None or sorted(tested) == sorted(n_test)
    aside = [int(aside_of(trains.conditions, task.split).sum()) for task in tasks.values()]
    monkeypatch.setattr(resumable, "run", trained_with([0.3, 0.5, 0.7]))
    found = cross_validation.run(of_people, tmp_path / "run", SMALL, tasks)
    left = 3 * 24 - sum(tested) - sum(aside)
    assert [*found.accuracy] == pytest.approx([*resampled_interval([0.3, 0.5, 0.7], left, sum(tested))])


def test_seeds_that_test_the_same_trials_are_no_further_splits(at_speeds, tmp_path):
    """They say nothing of other test trials: their interval is that of these."""
    given = ["--test-where", "speed=450", "--repeats", "3"]
    said = in_process.typed("train", at_speeds, "-o", tmp_path / "run", *COMMAND.split(), *given).out
    table = pd.read_csv(tmp_path / "run" / "splits.csv", comment="#")
    assert table["left_out"].tolist() == ["speed = 450"] * 3
    shares = table["accuracy_test"]
    low, high = 100 * np.mean([wilson_interval(share, 8) for share in shares], axis=0)
    mean = f"accuracy {100 * shares.mean():.1f} % (95 % interval {low:.1f} to {high:.1f} %)"
    assert f"{mean} over 3 splits with the same test trials, " in said


def test_splits_of_numbers_have_a_score_that_may_be_below_zero(of_people, tmp_path, monkeypatch):
    monkeypatch.setattr(resumable, "run", trained_with([-0.4, -0.2, -0.3]))
    task = Task(window=WindowSpec(length_ms=60), target="force_N")
    spec = RSNNSpec(recipe="default", hidden=0)
    tasks = cross_validation.tasks_of(task, Splits(folds=3), pd.DataFrame())
    found = cross_validation.run(of_people, tmp_path / "run", spec, tasks)
    assert found.accuracy.mean == pytest.approx(-0.3)
    assert found.accuracy.low < -0.3 < found.accuracy.high
    said = cross_validation.line(found)
    assert said.startswith(f"score (1 is perfect) -0.300 (95 % interval {found.accuracy.low:.3f} to ")
    assert "%" not in said.replace("95 % interval", "")


def test_each_pair_is_tested_by_a_network_that_has_seen_neither_value(tmp_path):
    rng = np.random.default_rng(0)
    rows = [(label, speed, f"d{day}") for speed in (1, 2) for day in (1, 2, 3) for label in ("felt", "silk")] * 2
    table = pd.DataFrame(rows, columns=["label", "speed", "day"])
    rasters = [rng.random((60, 2)) < (0.1 if label == "felt" else 0.5) for label in table["label"]]
    hdf5.save_spikes(from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), table), tmp_path / "spikes.h5")
    words = ["train", str(tmp_path / "spikes.h5"), "-o", str(tmp_path / "run"), *COMMAND.split()]
    each = ["--leave-out-each", "speed", "--leave-out-each", "day", "--test-where", "day=d1,d3"]
    done = CliRunner().invoke(app, [*words, *each], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "4 pairs of speed and day are tested in turn; trials that share a tested value are left aside: 12 of 24" in (
        done.stdout
    )
    assert "%) over 4 pairs of speed and day, " in done.stdout
    found = pd.read_csv(tmp_path / "run" / "splits.csv", comment="#")
    assert found["left_out"].tolist() == [f"speed = {speed}, day = {day}" for speed in (1, 2) for day in ("d1", "d3")]
    trains = hdf5.load_spikes(tmp_path / "spikes.h5")
    for name, left in zip(found["folder"], found["left_out"], strict=True):
        sides = run_folder.restore(tmp_path / "run" / name).provenance.sides(trains)
        of_test = trains.conditions[sides == "test"]
        assert {f"speed = {row.speed}, day = {row.day}" for row in of_test.itertuples()} == {left}
        others = trains.conditions[(sides == "training") | (sides == "validation")]
        assert {*others["speed"]}.isdisjoint(of_test["speed"])
        assert {*others["day"]}.isdisjoint(of_test["day"])
        assert (sides == "unseen").sum() == 12


@pytest.mark.parametrize(
    ("is_calibrated", "each", "typed"),
    [
        (True, ["--leave-out-each", "speed"], "study run ... --leave-out-each speed of own-recordings"),
        (True, ["--folds", "2"], "study run ... --folds 2 of own-recordings"),
        (False, ["--folds", "2"], None),
    ],
)
def test_an_encoder_that_was_calibrated_once_for_all_tests_is_named(
    at_speeds, tmp_path, capsys, is_calibrated, each, typed
):
    trains = hdf5.load_spikes(at_speeds)
    scale = {"scale": [2.0], "offset": [0.0]} if is_calibrated else {}
    hdf5.save_spikes(replace(trains, encoder={"conditioning": scale}), tmp_path / "calibrated.h5")
    words = ["train", tmp_path / "calibrated.h5", "-o", tmp_path / "run", *COMMAND.split(), *each]
    said = in_process.typed(*words).err
    assert ("the encoder was calibrated once for all tests" in said) == is_calibrated
    assert typed is None or f"neurotact {typed} calibrates for each test" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--leave-out-each", "sped"], "no condition is called 'sped'; did you mean 'speed'"),
        (["--leave-out-each", "speed", "--folds", "2"], "both select the test trials; give one of them"),
        (["--leave-out-each", "speed", "--where", "speed=150"], "all trials have speed = 150; record another value"),
    ],
)
def test_a_condition_that_cannot_be_left_out_is_refused(at_speeds, tmp_path, words, message):
    done = CliRunner().invoke(app, ["train", str(at_speeds), "-o", str(tmp_path / "run"), *COMMAND.split(), *words])
    assert done.exit_code != 0
    assert message in done.output + str(done.exception)
