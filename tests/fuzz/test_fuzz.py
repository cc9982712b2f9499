"""A short run of the fuzzer, and whether what judges its cases sees what it should."""

import random
import subprocess
import sys
from pathlib import Path

import judge
import mutations
import numpy as np
import pytest
from judge import Case

from neurotact.data.hdf5 import save_recordings
from neurotact.data.recordings import Recordings

SCRIPT = Path(__file__).with_name("fuzz.py")
CASES = 40


@pytest.mark.thorough
def test_no_spoilt_input_breaks_the_command_line():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--cases", str(CASES), "--seconds", "60"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert f"\nall {CASES:27}" in done.stdout


TRACEBACK = """Traceback (most recent call last):
  File "/somewhere/neurotact/spec.py", line 79, in read
    return tomllib.loads(text)
  File "/usr/lib/python3.11/tomllib/_parser.py", line 420, in parse_array
    pos, val = parse_value(src, pos, parse_float)
RecursionError: maximum recursion depth exceeded
"""
CRASH = """Fatal Python error: Segmentation fault

Current thread 0x1 (most recent call first):
  File "/usr/lib/h5py/_hl/files.py", line 1 in close
  File "/somewhere/neurotact/data/hdf5.py", line 72 in save_spikes
  File "/somewhere/neurotact/cli.py", line 218 in encode
"""


@pytest.mark.parametrize(
    ("code", "said", "fault"),
    [
        (0, "", ""),
        (0, "encode 8/8\nneurotact: t_ref of 1.2 ms is 2.4 steps; 3 are taken\n", ""),
        (2, "cells 1/4  3 s left\nneurotact: a.h5: there is no such file; check the path\n", ""),
        (1, TRACEBACK, "RecursionError: maximum recursion depth exceeded: neurotact/spec.py read"),
        (-11, CRASH, "Fatal Python error: Segmentation fault: neurotact/data/hdf5.py save_spikes"),
        (2, "", "exit code 2 without a word"),
        (2, "warning: careful\n", "not a line of neurotact's: warning: careful"),
        (130, "neurotact: interrupted\n", "exit code 130: no frame of neurotact"),
        (2, f"neurotact: {'x' * 2000}\n", "a line of more than 1000 characters: exit code 2"),
        (2, "neurotact: \x1b[31m: there is no such file\n", "control characters in a line: exit code 2"),
    ],
)
def test_how_a_command_ends_is_judged(code, said, fault):
    assert judge._fault_of_end(code, said) == fault


def _fault(tmp_path, case, change, code=0):
    """What the judge says of a command that did `change` to its folder."""
    (tmp_path / "touch.h5").write_bytes(b"mine")
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "results.csv").write_bytes(b"a\n1\n")
    before = judge._contents(tmp_path)
    change()
    return judge._fault_of_files(case, tmp_path, before, code)


def test_an_input_that_was_changed_is_seen(tmp_path):
    case = Case("x", ["encode", "touch.h5", "-o", "touch.h5", "--force"])
    fault = _fault(tmp_path, case, lambda: (tmp_path / "touch.h5").write_bytes(b"theirs"))
    assert fault == "changed what was there: touch.h5"


def test_an_output_that_was_forced_may_be_replaced(tmp_path):
    (tmp_path / "out.h5").write_bytes(b"old")
    case = Case("x", ["encode", "touch.h5", "-o", "out.h5", "--force"])
    assert not _fault(tmp_path, case, lambda: (tmp_path / "out.h5").write_bytes(b"new"))


@pytest.mark.parametrize(("name", "fault"), [(".draft-1.h5", "left behind: a draft"), (".lock", "left behind: a lock")])
def test_what_is_left_behind_is_seen(tmp_path, name, fault):
    assert _fault(tmp_path, Case("x", []), lambda: (tmp_path / "study" / name).touch()) == fault


def test_damage_that_was_believed_is_seen(tmp_path):
    case = Case("run folders", [], changes=("study",), results=("study/results.csv", b"a\n1\n"))
    fault = _fault(tmp_path, case, lambda: (tmp_path / "study" / "results.csv").write_bytes(b"a\n7.5\n"))
    assert fault == "believed damage: run folders"


def test_an_output_that_never_came_is_seen(tmp_path):
    assert _fault(tmp_path, Case("x", [], out="out.h5"), lambda: None) == "exit code 0 without an output"
    (tmp_path / "again").mkdir()
    assert not _fault(tmp_path / "again", Case("x", [], out="out.h5"), lambda: None, code=2)


@pytest.mark.parametrize(
    ("said", "holds", "fault"),
    [
        ("", {"samples": 60, "trials": 2, "total": 60.0}, ""),
        ("", {"samples": 63}, ""),
        ("", {"samples": 64}, "lost samples without a word: x"),
        ("", {"trials": 1}, "doubled trials without a word: x"),
        ("", {"total": 6.0}, "doubled total without a word: x"),
        ("neurotact: 4 of 64 samples are left out", {"samples": 64}, ""),
    ],
)
def test_a_share_that_is_lost_or_doubled_without_a_word_is_seen(tmp_path, said, holds, fault):
    signals = [np.ones((20, 1), np.float32), np.ones((40, 1), np.float32)]
    save_recordings(Recordings(signals, 100.0, "mV", {"label": ["a", "b"]}), tmp_path / "out.h5")
    assert judge._fault_of_share(Case("x", [], out="out.h5", holds=holds), tmp_path, said) == fault


def test_a_seed_gives_the_same_damage_again():
    content = b'title = "x"\n[a]\nb = [1, 2.5]\n'
    drawn = [[mutations.spoil_toml(content, random.Random(seed)) for seed in range(60)] for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert len(set(drawn[0])) > 40
