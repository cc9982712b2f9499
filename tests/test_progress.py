"""Progress elsewhere than on a terminal: plain lines, with the time that is left."""

import re

from neurotact import progress


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
