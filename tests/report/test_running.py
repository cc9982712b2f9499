"""The page of a study that is still running: it says so, costs little, and leaves nothing in the finished report."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import neurotact as nt
from neurotact import files, progress
from neurotact.report import running

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
ONE = {"sweep.seed": [0], "sweep.network.hidden": [4], "network.training.epochs": 1}


def finish(folder: Path, name: str, accuracy: float) -> None:
    """Leave what a finished cell does."""
    files.write_json(folder / "cells" / name / "result.json", {"row": {"hidden": 4, "accuracy_validation": accuracy}})
    log = "epoch,train_loss,validation_loss\n1,2.0,1.0\n2,1.0,0.5\n"
    files.write_text(folder / "cells" / name / "training.csv", log)


def test_it_says_how_far_the_study_is_and_what_cells_gave_on_validation_trials(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "LEAST_S", 0.0)
    monkeypatch.setattr(running, "MOST_SHARE", 1e9)
    write = running.writer("Which <fabric>", tmp_path)
    write("cells", 0, 4, "train 3/40; train 5/40, 2 min left")
    page = (tmp_path / "report.html").read_text()
    assert "This study is still running: cells 0 of 4." in page
    assert "<li>train 3/40</li><li>train 5/40, 2 min left</li>" in page
    assert "<h1>Which &lt;fabric&gt;</h1>" in page
    assert "<table>" not in page
    finish(tmp_path, "ab", 0.8125)
    finish(tmp_path, "cd", 0.5)
    (tmp_path / "cells" / "cd" / "result.json").write_text("{")  # it is checked later
    write("cells", 2, 4, "")
    page = (tmp_path / "report.html").read_text()
    assert "cells 2 of 4, 0 s left." in page
    assert "81.2\u00a0%" in page
    assert 'points="0,0.5' not in page
    assert 'points="0,1.0 30,10.5"' in page  # from the largest of all losses to a half
    assert 'points="0,10.5 30,15.2" fill="none" stroke="currentColor" stroke-dasharray' in page
    assert page.count("<tr>") == 3
    for number in range(50):
        finish(tmp_path, f"n{number}", number / 100)
    write("cells", 4, 4, "")
    page = (tmp_path / "report.html").read_text()
    assert "52 cells finished, the newest 50." in page
    assert (page.count("<tr>"), "49.0\u00a0%" in page, "81.2\u00a0%" in page) == (51, True, False)


def test_pages_take_a_small_part_of_the_time(tmp_path, monkeypatch):
    clock = iter([0.0, 1.0, 1.1, 20.0, 22.0, 22.1])
    monkeypatch.setattr(running, "monotonic", lambda: next(clock))
    write, page = running.writer("A", tmp_path), tmp_path / "report.html"
    write("cells", 1, 9, "")
    page.unlink()
    write("cells", 2, 9, "")  # the first took 0.1 s
    assert not page.exists()
    write("cells", 3, 9, "")
    assert "cells 3 of 9" in page.read_text()


def test_the_finished_report_is_the_same_as_without(tmp_path, monkeypatch):
    pages, write_text = [], running.write_text
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_PARTS", 0.01)
    monkeypatch.setattr(running, "LEAST_S", 0.0)
    monkeypatch.setattr(running, "MOST_SHARE", 0.2)
    monkeypatch.setattr(running, "write_text", lambda path, page: pages.append(page) or write_text(path, page))
    nt.run_study(TINY, tmp_path, settings=ONE)
    assert any("This study is still running: cells 0 of 2" in page for page in pages)
    finished = (tmp_path / "report.html").read_text()
    assert "still running" not in finished
    every = {path.name for path in tmp_path.iterdir()}
    nt.report_study(tmp_path)
    again = (tmp_path / "report.html").read_text()
    took = re.compile(r'cells took [^<]*|href="[^"]*" download="timings.csv"')
    assert took.sub("", again) == took.sub("", finished)
    assert took.search(finished)
    assert {path.name for path in tmp_path.iterdir()} == every


def test_a_page_that_cannot_be_written_stops_no_study(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_PARTS", 0.01)

    def full(*_):
        raise OSError("disk full")

    with progress.watched(full), progress.track("cells", 2) as advance:
        time.sleep(0.2)
        advance(2, "")
    assert capsys.readouterr().err.splitlines() == ["neurotact: progress is told no more: disk full", "cells 2/2"]
    assert not progress._watchers


@pytest.mark.thorough
def test_a_study_killed_half_way_leaves_a_page_that_says_how_to_go_on(tmp_path):
    words = ["-m", "neurotact", "study", "run", str(TINY), "-o", str(tmp_path)]
    long = {"network.training.epochs": 100000, "network.training.patience": 100000}
    more = [word for key, value in {**ONE, **long}.items() for word in ("--set", f"{key}={value}")]
    child = subprocess.Popen([sys.executable, *words, *more], stderr=subprocess.DEVNULL, start_new_session=True)
    page = tmp_path / "report.html"
    try:
        for _ in range(600):
            if page.is_file() and "cells 0 of 2" in page.read_text():
                break
            time.sleep(0.1)
    finally:
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    assert "This study is still running: cells 0 of 2" in page.read_text()
    assert f"<code>neurotact study resume {tmp_path}</code>" in page.read_text()
