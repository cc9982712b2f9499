"""Progress elsewhere than on a terminal: plain lines, with the time that is left."""

import io
import re
import time

from in_process import typed

from neurotact import progress, workers


def test_plain_lines_say_how_much_is_left(capsys, monkeypatch):
    clock = iter([0.0, 5.0, 20.0, 40.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.track("cells", 4) as advance:
        advance(1, "")  # after 5 s: too soon for a line
        advance(1, "")
        advance(2, "")
    assert capsys.readouterr().err.splitlines() == ["cells 2/4  20 s left", "cells 4/4"]


def test_a_note_stands_in_place_of_it(capsys, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.0)
    with progress.track("tune", 2) as advance:
        advance(1, "best 0.9, 3 s left")
    assert re.fullmatch(r"tune 1/2  best 0.9, 3 s left\n", capsys.readouterr().err)


def test_nothing_done_tells_no_time(capsys, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.0)
    with progress.track("tune", 2) as advance:
        advance(0, "")
    assert capsys.readouterr().err == "tune 0/2\n"


def test_work_that_may_end_early_is_told_a_bound_beside_its_note(capsys, monkeypatch):
    clock = iter([0.0, 20.0, 40.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.track("train", 100, at_most=True) as advance:
        advance(2, "loss 0.5")
        advance(98, "loss 0.4")
    assert capsys.readouterr().err.splitlines() == [
        "train 2/100  loss 0.5, at most 16 min left",
        "train 100/100  loss 0.4",
    ]


def test_what_was_done_before_says_nothing_of_the_time_left(capsys, monkeypatch):
    clock = iter([0.0, 20.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with progress.track("train", 100, done=90) as advance:
        advance(2, "")  # ten seconds each
    assert capsys.readouterr().err == "train 92/100  80 s left\n"


def test_a_bar_on_a_terminal_begins_where_the_work_does(monkeypatch):
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(progress.sys, "stderr", terminal)
    with progress.track("train", 100, done=90, at_most=True) as advance:
        advance(2, "loss 0.5")
    assert "92/100" in terminal.getvalue()
    assert "at most" in terminal.getvalue()


def test_a_quiet_command_hides_its_own_progress_alone(capsys, monkeypatch):
    assert typed("--quiet", "info", "nothing.h5").code == 2
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.0)
    with progress.track("tune", 1) as advance:
        advance(1, "")
    assert capsys.readouterr().err == "tune 1/1\n"


def train_for_a_while(times: int) -> None:
    for done in range(times):
        progress.at("train", done, times)
        time.sleep(0.1)


def test_what_workers_are_at_is_shown_while_a_job_runs(capsys, monkeypatch):
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_PARTS", 0.05)
    monkeypatch.setattr(progress, "SECONDS_BETWEEN_LINES", 0.05)
    with progress.track("cells", 1) as advance, workers.pool(1) as run:
        list(run(train_for_a_while, [8]))
        advance(1, "")
    *parts, last = capsys.readouterr().err.splitlines()
    assert parts
    assert all(re.fullmatch(r"cells 0/1  train \d/8(, \d+ s left)?", line) for line in parts)
    assert last == "cells 1/1"
    assert not progress._folders


def test_a_process_that_is_no_worker_tells_nobody(monkeypatch, tmp_path):
    monkeypatch.delenv(progress.PARTS, raising=False)
    progress.at("train", 1, 2)
    monkeypatch.setenv(progress.PARTS, str(tmp_path))
    progress.at("train", 1, 2)
    (told,) = tmp_path.glob("*.txt")
    assert told.read_text() == "train 1/2"
    progress.at("train", 2, 2)
    assert told.read_text() == "train 1/2"  # within a second
    advance = progress.counting("encode", 3)
    assert told.read_text() == "encode 0/3"
    advance(1)
    progress.at("read")
    assert told.read_text() == "read"
    progress.at("fit", 1, 5, ", loss 0.5")
    assert told.read_text() == "fit 1/5, loss 0.5"
    progress.at("")
    assert not [*tmp_path.iterdir()]
    monkeypatch.setenv(progress.PARTS, str(tmp_path / "gone"))
    progress.at("train", 1, 2)
