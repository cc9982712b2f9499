"""A study survives what interrupts it, and its bytes depend on nothing but its spec."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from neurotact.errors import InputError
from neurotact.report import report
from neurotact.studies import runner, study

TINY = Path(__file__).parent / "tiny.toml"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The tiny study, run without interruption in one process."""
    folder = tmp_path_factory.mktemp("whole")
    runner.run(study.resolve(TINY), folder, workers=1)
    report.write(folder)
    return folder


def test_a_study_leaves_tables_figures_and_a_report(finished):
    results = pd.read_csv(finished / "results.csv")
    assert list(results.columns[:16]) == [
        "dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed", "accuracy_validation", "accuracy_test",
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


def test_killed_and_resumed_with_two_workers_gives_the_same_bytes(finished, tmp_path):
    folder = tmp_path / "killed"
    command = [sys.executable, "-c", "from neurotact.cli import main; main()"]
    process = subprocess.Popen(
        [*command, "study", "run", str(TINY), "-o", str(folder), "--workers", "2"],
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
    resumed = subprocess.run([*command, "study", "resume", str(folder)], capture_output=True, text=True, check=False)
    assert resumed.returncode == 0, resumed.stderr
    assert resumed.stdout.splitlines()[-1] == str(folder / "report.html")
    for path in (finished / "results.csv", finished / "encoding.csv", *finished.rglob("files.json")):
        assert (folder / path.relative_to(finished)).read_bytes() == path.read_bytes()
    assert not list(folder.rglob(".*")), "a draft or the lock of the killed process is left"


def test_a_folder_that_holds_another_study_is_refused(finished):
    with pytest.raises(InputError, match="already holds another study"):
        runner.run(study.resolve(TINY, quick=True), finished, workers=1)


def test_a_folder_that_holds_anything_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(InputError, match="is not empty"):
        runner.run(study.resolve(TINY), tmp_path, workers=1)
    assert (tmp_path / "thesis.tex").read_text() == "dear"


def test_a_finished_study_runs_again_without_training(finished):
    before = {path: path.stat().st_mtime_ns for path in finished.glob("cells/*/result.json")}
    claimed = {"name": "c", "source": "s", "published": "p", "kind": "at_least", "measure": "hidden", "value": 1}
    runner.run(study.resolve(TINY, {"claims": [claimed]}), finished, workers=1)
    report.write(finished)
    assert "1 of 1 claims reproduced" in (finished / "report.html").read_text()
    runner.run(study.resolve(TINY), finished, workers=1)
    report.write(finished)
    assert before == {path: path.stat().st_mtime_ns for path in finished.glob("cells/*/result.json")}
