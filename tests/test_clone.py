"""A package that is installed from a clone, and is not editable, is the one that runs inside the clone."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import workers_of
from venvs import clean, copy_of_checkout, pip_install, venv

STUDY = "study run refractory-period --quick --set network.training.epochs=2 --workers 2 -o mine"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="what a process has loaded is read in /proc")
@pytest.mark.skipif(not any(map(shutil.which, ("c++", "g++", "clang++"))), reason="there is no C++ compiler")
def test_a_study_inside_a_clone_runs_with_the_installed_kernels_in_every_process(tmp_path):
    clone = copy_of_checkout(tmp_path / "clone")
    python = venv(tmp_path / "venv", sees_packages=True)
    pip_install(python, "--no-deps", clone)
    (kernels,) = (tmp_path / "venv").rglob("_native*.so")
    (clone / "signal.py").write_text("raise RuntimeError('a module of the current folder')")
    with subprocess.Popen(
        [str(python.parent / "neurotact"), *STUDY.split()],
        cwd=clone,
        env=clean(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        loaded: dict[int, set[Path]] = {}
        while process.poll() is None:
            for pid in (process.pid, *workers_of(process.pid)):
                loaded[pid] = loaded.get(pid, set()) | _kernels_in(pid)
            time.sleep(0.05)
        assert process.returncode == 0, process.communicate()[1]
    assert len(loaded) >= 4  # the command, the server that forks workers, and two of them
    assert set(map(frozenset, loaded.values())) == {frozenset([kernels])}
    assert (clone / "mine" / "results.csv").is_file()


def _kernels_in(pid: int) -> set[Path]:
    """The compiled kernels that a process has mapped."""
    try:
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    except OSError:
        return set()
    return {Path(line.split(maxsplit=5)[5]) for line in lines if line.endswith(".so") and "/_native." in line}
