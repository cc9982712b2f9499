"""Worker processes: what reaches them, and what does not."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from levels import thinned
from processes import descendants

import neurotact
from neurotact import workers
from neurotact.errors import InputError

SCRIPT = """
import signal
from neurotact import workers

def heard(job):
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN, signal.pthread_sigmask(signal.SIG_BLOCK, [])

if __name__ == "__main__":
    with workers.pool(1) as run:
        print(*run(heard, [1]))
    print(signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


def interrupt_descendants_of(process: subprocess.Popen, sent: list[int]) -> None:
    """Send SIGINT to every process that it starts, all the time, from its birth on."""
    while process.poll() is None:
        for one in descendants(process.pid):
            try:
                os.kill(one, signal.SIGINT)
                sent.append(one)
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
    striking = threading.Thread(target=interrupt_descendants_of, args=(process, sent))
    striking.start()
    out, err = process.communicate(timeout=120)
    striking.join()
    assert len(sent) > 100
    assert len({*sent}) > 1
    assert (process.returncode, err) == (0, "")
    assert out.splitlines() == ["(True, set())", "set()"]


WARNING = """
import logging
import warnings
from neurotact import workers

def job(_):
    warnings.warn("the gain silences RA-I", stacklevel=1)
    logging.getLogger("neurotact").warning("%d of 3 trials are kept", 2)

if __name__ == "__main__":
    with workers.pool(1) as run:
        list(run(job, [1]))
"""


def lay_traps(folder: Path) -> None:
    """Modules of the user's own, with the names of Python's and of the package."""
    for name in ("signal", "queue", "selectors", "neurotact"):
        (folder / f"{name}.py").write_text(f"raise RuntimeError('{name}.py of the current folder')")


@pytest.mark.thorough
def test_a_warning_of_a_worker_is_one_line_and_no_module_is_that_of_the_current_folder(tmp_path):
    script, here = tmp_path / "warning.py", tmp_path / "here"
    here.mkdir()
    lay_traps(here)
    script.write_text(WARNING)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, cwd=here)
    assert done.returncode == 0
    assert done.stderr.splitlines() == ["neurotact: the gain silences RA-I", "neurotact: 2 of 3 trials are kept"]


NOTEBOOK = """
import os, sys
from importlib.util import find_spec
from neurotact import workers

sys.path.insert(0, "")  # as IPython does, when its own modules are loaded
before, environment = [*sys.path], {**os.environ}
with workers.pool(1) as run:
    print(*(found.origin for found in run(find_spec, ["queue", "mine", "signal"])))
assert sys.path == before
assert os.environ == environment
"""


@pytest.mark.thorough
def test_a_notebook_beside_modules_of_its_own_has_them_but_never_in_place_of_pythons(tmp_path):
    lay_traps(tmp_path)
    (tmp_path / "mine.py").write_text("")
    words = [sys.executable, "-P", "-c", NOTEBOOK]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    queue, mine, signals = map(Path, done.stdout.split())
    assert mine == tmp_path / "mine.py"
    assert tmp_path not in (*queue.parents, *signals.parents)


def test_the_package_runs_as_a_module_beside_a_module_with_the_name_of_pythons(tmp_path):
    (tmp_path / "signal.py").write_text("raise RuntimeError('signal.py of the current folder')")
    words = [sys.executable, "-m", "neurotact", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert (done.stdout.strip(), done.stderr) == (neurotact.__version__, "")


@pytest.mark.parametrize("name", workers.identity())
def test_a_worker_that_has_loaded_another_neurotact_does_nothing(monkeypatch, name):
    here = workers.identity() | {name: "another"}
    monkeypatch.setattr(workers, "identity", lambda: here)
    with pytest.raises(InputError, match=f"worker processes: {name} is .* there and another here; leave one"):
        workers.in_a_process(abs, -1)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each worker is spawned")
def test_workers_are_forked_from_one_server_with_one_thread_and_know_the_environment_of_today(monkeypatch):
    """So that only the first takes the seconds of the imports."""
    servers = set()
    for value in ("first", "second"):
        monkeypatch.setenv("NEUROTACT_EXAMPLE", value)
        with workers.pool(2) as run:
            servers |= {*run(_server, range(2))}
            assert [*run(os.getenv, ["NEUROTACT_EXAMPLE", "OMP_NUM_THREADS"])] == [value, "1"]
    assert len(servers) == 1
    ((server, threads),) = servers
    assert (server == os.getpid(), threads) == (False, 1)  # a fork of a process with more threads may hang


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is no server")
def test_a_server_that_dies_is_replaced():
    with workers.pool(1) as run:
        ((server, _),) = run(_server, [0])
    os.kill(server, signal.SIGKILL)
    with workers.pool(1) as run:
        assert [*run(_server, [0])] != [(server, 1)]


@thinned("fault", [EOFError, ConnectionResetError, ConnectionRefusedError])
def test_a_server_that_dies_while_it_starts_a_process_costs_nothing(fault, monkeypatch):
    submit, faults = ProcessPoolExecutor.submit, [fault] * 2

    def submit_in_the_end(*given):
        if faults:
            raise faults.pop()
        return submit(*given)

    monkeypatch.setattr(ProcessPoolExecutor, "submit", submit_in_the_end)
    with workers.pool(1) as run:
        assert [*run(abs, [-1, -2])] == [1, 2]
    faults += [fault] * 3
    monkeypatch.setattr(workers, "_fault_of_a_start", lambda: "")
    with pytest.raises(InputError, match="3 worker processes lost their server"), workers.pool(1) as run:
        next(run(abs, [-1]))


def test_what_a_new_process_cannot_import_is_said(monkeypatch):
    def refuse(*_):
        raise EOFError

    monkeypatch.setattr(ProcessPoolExecutor, "submit", refuse)
    monkeypatch.setattr(workers, "__name__", "neurotact.absent")
    with pytest.raises(InputError, match=r"could not start: ModuleNotFoundError: No module named 'neurotact\.absent';"):
        workers.in_a_process(abs, -1)


def _server(_: int) -> tuple[int, int]:
    return os.getppid(), len([*Path(f"/proc/{os.getppid()}/task").iterdir()])


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each worker is spawned")
def test_processes_of_a_study_begin_with_the_opponents_loaded(tmp_path):
    """The server loads them once, in place of each process; and it stays a process of one thread, which can fork."""
    script = """
import sys
from test_workers import _knows
from neurotact import plugins, workers
from neurotact.studies.executors import processes

def main():
    names = plugins.modules("opponents")
    assert not {*names} & {*sys.modules}
    with processes(2), workers.pool(2) as run:
        for known, n_threads in run(_knows, [names] * 2):
            assert (known, n_threads) == (names, 1)

if __name__ == "__main__":
    main()
"""
    _run_as_script(script, tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each worker is spawned")
def test_the_server_loads_while_a_study_is_read_and_ends_if_it_is_refused(tmp_path):
    script = """
import os, signal
from multiprocessing import forkserver
from test_workers import _server
import neurotact as nt
from neurotact import workers
from neurotact.errors import InputError
from neurotact.studies import loading

def refuse(*given, **options):
    servers.append(forkserver._forkserver._forkserver_pid)
    raise InputError("refused")

def main():
    loading.resolve = refuse
    try:
        nt.run_study("own-recordings", "out", data="none.h5")
    except InputError as error:
        assert str(error) == "refused"
    assert os.waitpid(servers[0], 0)[1] == signal.SIGKILL
    forkserver._forkserver._forkserver_pid = None
    with workers.beginning([]):
        begun = forkserver._forkserver._forkserver_pid
    try:
        with workers.beginning([]):
            raise InputError("refused")
    except InputError:
        with workers.pool(1) as run:  # what others began goes on
            ((server, n_threads),) = run(_server, [0])
    assert (server, n_threads) == (begun, 1)

if __name__ == "__main__":
    servers = []
    main()
"""
    _run_as_script(script, tmp_path)


def _run_as_script(script: str, folder: Path) -> None:
    (folder / "script.py").write_text(script)
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    subprocess.run([sys.executable, "script.py"], cwd=folder, check=True, env={**os.environ, "PYTHONPATH": paths})


def _knows(names: list[str]) -> tuple[list[str], int]:
    """Which of these modules the process has, and the threads of its server."""
    return [name for name in names if name in sys.modules], _server(0)[1]
