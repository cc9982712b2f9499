"""Worker processes: what reaches them, and what does not."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

SCRIPT = """
import signal
from neurotact import workers

def heard(job):
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN, signal.pthread_sigmask(signal.SIG_BLOCK, [])

if __name__ == "__main__":
    with workers.spawned(1) as run:
        print(*run(heard, [1]))
    print(signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


def interrupt_children_of(process: subprocess.Popen, sent: list[int]) -> None:
    """Send SIGINT to every child, all the time, from its birth on."""
    while process.poll() is None:
        for task in Path(f"/proc/{process.pid}/task").glob("*/children"):
            try:
                children = [int(child) for child in task.read_text().split()]
            except OSError:
                continue
            for child in children:
                try:
                    os.kill(child, signal.SIGINT)
                    sent.append(child)
                except ProcessLookupError:
                    pass
        time.sleep(0.002)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="no /proc to find children in")
def test_a_worker_that_loads_its_modules_hears_no_ctrl_c(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, "script.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    sent: list[int] = []
    striking = threading.Thread(target=interrupt_children_of, args=(process, sent))
    striking.start()
    out, err = process.communicate(timeout=120)
    striking.join()
    assert len(sent) > 100
    assert (process.returncode, err) == (0, "")
    assert out.splitlines() == ["(True, set())", "set()"]


WARNING = """
import warnings
from neurotact import workers

def job(_):
    warnings.warn("the gain silences RA-I", stacklevel=1)

if __name__ == "__main__":
    with workers.spawned(1) as run:
        list(run(job, [1]))
"""


def test_a_warning_of_a_worker_is_one_line(tmp_path):
    script = tmp_path / "warning.py"
    script.write_text(WARNING)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0
    assert done.stderr.splitlines() == ["neurotact: the gain silences RA-I"]
