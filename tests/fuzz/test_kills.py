"""Kills that land in a write, and a clock that jumps: a short run of `kills_in_writes.py`."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("kills_in_writes.py")
KILLS = 6

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux" or not shutil.which("cc"), reason="wants Linux and a C compiler"),
]


def test_what_is_killed_in_a_write_comes_to_the_same_bytes():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--kills", str(KILLS)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert done.stdout.count(": the same bytes") >= KILLS
