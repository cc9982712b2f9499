"""A study survives what interrupts it, and its bytes depend on nothing but its spec."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest
from in_process import studies_here, without_pictures

from neurotact import cli, files
from neurotact.errors import InputError
from neurotact.report import report
from neurotact.studies import executors, networks, preparation, runner, study
from neurotact.studies.engine import Beside

TINY = Path(__file__).parent / "tiny.toml"


COMMAND = [sys.executable, "-c", "from neurotact.cli import main; main()"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The tiny study, run without interruption in one process."""
    folder = tmp_path_factory.mktemp("whole")
    runner.run(study.resolve(TINY), folder, workers=1)
    report.write(folder)
    return folder


def test_a_study_leaves_tables_figures_and_a_report(finished):
    results = pd.read_csv(finished / "results.csv")
    assert list(results.columns[:18]) == [
        "dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed", "accuracy_validation",
        "exit_accuracy_validation", "exit_loss_bound", "accuracy_test",
        "sops_input", "sops_recurrent", "sops_readout", "sops_total", "sops_total_feedforward",
        "spikes_sa", "spikes_ra", "exit_steps", "exit_accuracy",
    ]  # fmt: skip
    assert len(results) == 8
    assert (finished / "report.html").is_file()
    assert any((finished / "figures").iterdir())


def test_the_rows_stand_in_the_order_of_the_sweep(finished):
    rows = pd.read_csv(finished / "results.csv")[["t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed"]]
    pairs = [[1, 1], [5, 10]]
    assert rows.values.tolist() == [[*pair, hidden, seed] for pair in pairs for hidden in (4, 6) for seed in (0, 1)]


def test_sops_of_a_row_add_up(finished):
    results = pd.read_csv(finished / "results.csv")
    assert (results.sops_input == results.hidden * (results.spikes_sa + results.spikes_ra)).all()
    assert (results.sops_total == results.sops_total_feedforward + results.sops_recurrent).all()


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A study with classifiers beside it, and its folder: two processes fitted them."""
    what, folder = study.resolve(TINY, {"baselines": "linear"}), tmp_path_factory.mktemp("compared")
    runner.run(what, folder, workers=2)
    return what, folder


@pytest.mark.parametrize(("most", "at_once"), [(preparation.MOST_AT_ONCE, True), (0, False)])
def test_processes_fit_classifiers_at_once_where_windows_are_few(compared, tmp_path, monkeypatch, most, at_once):
    """Elsewhere one process does, since each holds its windows and features; the numbers are the same."""
    monkeypatch.setattr(preparation, "MOST_AT_ONCE", most)
    used, (what, folder) = [], compared
    with studies_here() as patch:
        here = runner.executor

        @contextmanager
        def recording(*given):
            with here(*given) as map_cells:
                yield lambda *to: used.append(to[-1].at_once) or map_cells(*to)

        patch.setattr(runner, "executor", recording)
        runner.run(what, tmp_path / "run", workers=3)
    assert used == [at_once]
    for name in ("baselines.csv", "baselines_trials.csv"):
        assert (tmp_path / "run" / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.parametrize(
    ("window", "each"),
    [
        ({}, 1),
        ({"hop_ms": 0.2, "per_trial": 9}, 9),
        ({"length_ms": 0.2}, 1),
        ({"hop_ms": 10.0, "per_trial": 99}, 41),
    ],
)
def test_windows_of_a_clock_that_is_finer_than_the_recordings_are_counted(tmp_path, monkeypatch, window, each):
    """Their length and hop may be shorter than a sample."""
    changes = {f"window.{key}": value for key, value in window.items()} | {"encoder.conditioning.resample_Hz": 8000.0}
    what = study.resolve(TINY, changes)
    cells = list(study.cells(what))
    recordings = preparation.recordings_of(what, cells[0])
    values = cells[0].window.length_ms * 2 * recordings.n_channels  # at 2 kHz
    most = 8 * each * len(recordings) * (values + preparation.MINIROCKET)
    for bytes_at_once, at_once in ((most, True), (most - 1, False)):
        monkeypatch.setattr(preparation, "MOST_AT_ONCE", bytes_at_once)
        assert preparation.prepare(tmp_path / str(bytes_at_once), what, cells) == at_once


def _process_after(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.parametrize("at_once", [True, False])
def test_jobs_beside_the_cells_share_processes_if_they_may(tmp_path, at_once):
    jobs = Beside("naps", _process_after, [0.4, 0.3, 0.2], lambda _: None, at_once)
    with executors.processes(2) as map_cells:
        found = dict(map_cells(networks.ENGINE, [], tmp_path, jobs))
    assert sorted(found) == [0, 1, 2]
    assert len(set(found.values())) == (2 if at_once else 1)


@pytest.mark.thorough
def test_killed_and_resumed_with_two_workers_gives_the_same_bytes(finished, tmp_path):
    folder = tmp_path / "killed"
    process = subprocess.Popen(
        [*COMMAND, "study", "run", str(TINY), "-o", str(folder), "--workers", "2"],
        start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not list(folder.glob("cells/*/result.json")):
        assert process.poll() is None, "the study ended before it could be killed"
        assert time.monotonic() < deadline, "no cell was done in two minutes"
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (folder / "results.csv").exists()
    resumed = subprocess.run([*COMMAND, "study", "resume", str(folder)], capture_output=True, text=True, check=False)
    assert resumed.returncode == 0, resumed.stderr
    assert str(folder / "report.html") in resumed.stdout.splitlines()
    for path in (finished / "results.csv", finished / "encoding.csv", *finished.rglob("files.json")):
        assert (folder / path.relative_to(finished)).read_bytes() == path.read_bytes()
    assert not list(folder.rglob(".*")), "a draft or the lock of the killed process is left"


@pytest.mark.thorough
def test_the_end_of_a_time_limit_says_how_to_go_on(tmp_path):
    """As Ctrl-C does, without a word of the processes that it ends."""
    words = [*COMMAND, "study", "run", str(TINY), "-o", str(tmp_path / "run"), "--workers", "1"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not (tmp_path / "run" / "study.toml").exists():
            assert time.monotonic() < deadline, "nothing began in two minutes"
            time.sleep(0.02)
        process.terminate()
        _, err = process.communicate()
    assert process.returncode == 130
    assert err.splitlines()[-1] == f"neurotact: interrupted; go on with: neurotact study resume {tmp_path / 'run'}"
    assert "leaked" not in err


def test_an_interruption_before_the_study_began_names_no_folder_to_resume(tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "executor", interrupt)
    monkeypatch.setattr(sys, "argv", ["neurotact", "study", "run", str(TINY), "-o", str(tmp_path / "run")])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert (end.value.code, (tmp_path / "run").exists()) == (130, False)
    assert capsys.readouterr().err == "neurotact: interrupted; the study had not begun; nothing is saved\n"


def test_a_folder_that_holds_another_study_is_refused(finished):
    with pytest.raises(InputError, match="already holds another study") as refused:
        runner.run(study.resolve(TINY, {"split.test": 0.25}), finished, workers=1)
    assert "(split.test = " in str(refused.value)
    assert ", here 0.25); choose another folder" in str(refused.value)


def test_what_is_refused_before_anything_is_computed_leaves_the_folder_free(tmp_path):
    """So that the mended command can have it; what was computed is never removed."""
    folder = tmp_path / "run"
    with studies_here(), pytest.raises(InputError, match="window"):
        runner.run(study.resolve(TINY, {"window.length_ms": 5000.0}), folder)
    assert not folder.exists()
    with studies_here(), pytest.raises(InputError, match="fewer than the 999 folds"):
        runner.run(study.resolve(TINY, {"split.folds": 999, "split.fold": 0}), folder)
    assert (folder / "spikes" / "files.json").is_file()


def test_a_study_that_fails_after_it_has_encoded_keeps_that_for_the_corrected_one(tmp_path, capsys):
    """Not a folder with a cell, and nothing that neurotact did not write."""
    folder, changed = tmp_path / "run", {"network.training.epochs": 1}

    def refuse(*_):
        raise InputError("no opponent can be fitted")

    with studies_here(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("neurotact.studies.cell.run_cell", refuse)
        with pytest.raises(InputError, match="no opponent"):
            runner.run(study.resolve(TINY), folder)
    again = f"neurotact: {folder}: keeps what is done; neurotact study resume {folder}, or the corrected command, goes"
    assert again in capsys.readouterr().err
    encoded = {path.name: path.stat().st_mtime_ns for path in (folder / "spikes").glob("*.h5")}
    assert len(encoded) == 2
    files.write_text(folder / "notes.md", "mine")
    with studies_here():
        runner.run(study.resolve(TINY, changed), folder)
    told = "held another study (network.training.epochs = 3, here 1), of which no cell had begun; this one takes its"
    assert f"neurotact: {folder}: {told} place\n" in capsys.readouterr().err
    assert {path.name: path.stat().st_mtime_ns for path in (folder / "spikes").glob("*.h5")} == encoded
    assert (folder / "notes.md").read_text() == "mine"
    assert len(list(folder.glob("cells/*"))) == 8
    with pytest.raises(InputError, match="already holds another study"):
        runner.run(study.resolve(TINY), folder)


def test_a_study_that_is_refused_later_keeps_what_is_done(finished, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    shutil.rmtree(next(folder.glob("cells/*")))

    def refuse(*_):
        raise InputError("no")

    monkeypatch.setattr(runner, "_compute", refuse)
    with pytest.raises(InputError, match="no"):
        runner.run(study.resolve(TINY), folder, workers=1)
    assert len(list(folder.glob("cells/*"))) == 7


def test_a_study_that_goes_on_says_how_much_is_done(finished, tmp_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    shutil.rmtree(next(folder.glob("cells/*")))
    with studies_here():
        runner.run(study.resolve(TINY), folder)
    assert f"neurotact: {folder}: resumes; 7 of 8 cells are already done\n" in capsys.readouterr().err


def test_a_folder_that_holds_anything_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(InputError, match="is not empty"):
        runner.run(study.resolve(TINY), tmp_path, workers=1)
    assert (tmp_path / "thesis.tex").read_text() == "dear"


def test_a_finished_study_runs_again_without_training(finished, monkeypatch):
    without_pictures(monkeypatch)
    before = {path: path.stat().st_mtime_ns for path in finished.glob("cells/*/result.json")}
    claimed = {"name": "c", "source": "s", "published": "p", "kind": "at_least", "measure": "hidden", "value": 1}
    with studies_here():
        runner.run(study.resolve(TINY, {"claims": [claimed]}), finished)
        report.write(finished)
        assert "0 of 1 claims reproduced" in (finished / "report.html").read_text()
        runner.run(study.resolve(TINY), finished)
    assert before == {path: path.stat().st_mtime_ns for path in finished.glob("cells/*/result.json")}
