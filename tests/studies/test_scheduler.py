"""Who computes a study's cells, and who dies over it, changes no byte of the results."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from threading import Thread
from unittest.mock import Mock

import pytest
from levels import thinned
from neurotact_parts.studies import cluster

from neurotact import workers
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.studies import runner, study

ROOT = Path(__file__).parents[2]
TINY = Path(__file__).parent / "tiny.toml"
WITHOUT_DASK = "distributed is not installed; pip install 'neurotact[dask]'"
DEADLINE_S = 120.0
# A straight-through surrogate over strong recurrence: the gradient grows with every step until it is not finite.
UNTRAINABLE = {"network.surrogate_scale": 1e-9, "network.recurrent_weight_scale": 1e8, "network.hidden": 4}
OPTIONS = [word for key, value in UNTRAINABLE.items() for word in ("--set", f"{key}={value}")]
NOT_TRAINED = "training: weights are not finite after epoch 1"


def typed(*words: object) -> subprocess.Popen:
    """A command in a process of its own: `neurotact ...` or `dask ...`."""
    main = {"neurotact": "neurotact.cli", "dask": "dask.__main__"}[str(words[0])]
    return subprocess.Popen(
        [sys.executable, "-c", f"from {main} import main; main()", *map(str, words[1:])],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for(found: Callable[[], object]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not found():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


def left_by(folder: Path) -> dict[str, bytes]:
    """The tables, what every cell left, and every manifest, but for how long it took."""
    assert not list(folder.rglob(".*")), "a draft or a lock is left"
    found = [folder / "results.csv", folder / "encoding.csv", *folder.glob("cells/*/*"), *folder.rglob("files.json")]
    return {str(p.relative_to(folder)): p.read_bytes() for p in found if p.name != "timing.json"}


@pytest.fixture(scope="module")
def expected(tmp_path_factory) -> dict[str, bytes]:
    """What the tiny study leaves when one process computes it."""
    folder = tmp_path_factory.mktemp("one-process")
    runner.run(study.resolve(TINY), folder, workers=1)
    return left_by(folder)


@pytest.fixture(scope="module")
def dask(tmp_path_factory) -> Iterator[tuple[str, dict[str, subprocess.Popen]]]:
    """A scheduler and two workers on loopback, started as docs/scale.md says: its address, the workers by name."""
    pytest.importorskip("distributed", reason=WITHOUT_DASK)
    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    listen = ("--host", "127.0.0.1", "--port", 0, "--dashboard-address", "127.0.0.1:0", "--no-dashboard")
    scheduler = typed("dask", "scheduler", *listen, "--scheduler-file", file)
    started = {
        name: typed("dask", "worker", "--scheduler-file", file, "--nthreads", 1, "--no-nanny", "--name", name,
                    "--local-directory", file.parent, "--no-dashboard")
        for name in ("first", "second")
    }  # fmt: skip
    try:
        wait_for(lambda: file.is_file() and file.read_text().rstrip().endswith("}"))  # it is written in place
        yield read_json(file)["address"], started
    finally:
        for process in (*started.values(), scheduler):
            process.kill()
            process.communicate()


# --- a cluster --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_leaves_a_run_that_resume_completes_elsewhere(dask, expected, tmp_path):
    folder = tmp_path / "run"
    process = typed("neurotact", "study", "run", TINY, "-o", folder, "--scheduler", dask[0])
    wait_for(lambda: process.poll() is not None or list(folder.glob("cells/*/result.json")))
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 130, said
    assert said.splitlines()[-1] == f"neurotact: interrupted; go on with: neurotact study resume {folder}"
    assert not (folder / "results.csv").exists()
    runner.run(runner.load(folder), folder, workers=1)
    assert left_by(folder) == expected


@pytest.mark.thorough
def test_a_worker_with_other_versions_is_refused(dask, tmp_path, monkeypatch):
    here = {**cluster.versions(), "torch": "0.1"}
    monkeypatch.setattr(cluster, "versions", lambda: here)
    with pytest.raises(InputError, match=r"worker tcp://.*: torch is .* there and 0\.1 here; install the same"):
        runner.run(study.resolve(TINY), tmp_path / "run", scheduler=dask[0])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("here", "there", "expected"),
    [
        ("0.9", "0.1", "neurotact is 0.1 there and 0.9 here; install the same"),
        ("0.9", None, "lacks neurotact; install"),
    ],
)
def test_a_worker_with_another_neurotact_is_refused_before_it_is_given_any_of_its_functions(here, there, expected):
    class Client:
        def get_versions(self, packages: list[str]):
            found = {
                one: {"packages": dict.fromkeys(packages, version)} for one, version in (("a", here), ("b", there))
            }
            return {"client": found["a"], "workers": found}

    with pytest.raises(InputError, match=f"^worker b: {expected}"):
        cluster._check_packages(Client())


def map_one(monkeypatch, error: Exception) -> None:
    """Compute one cell, whose future raises this error, on a made cluster."""
    future = Mock(**{"result.side_effect": error})
    monkeypatch.setattr("distributed.as_completed", lambda futures, loop: futures)
    monkeypatch.setattr(cluster, "_submit", lambda *_: {future: Mock()})
    list(cluster._map_cells(Mock(), "tcp://here", None, [], Path("run"), None))


@pytest.mark.parametrize("late", [True, False])
def test_an_odd_error_of_a_cell_is_of_a_worker_with_another_neurotact_that_joined_late_or_is_ours(monkeypatch, late):
    pytest.importorskip("distributed", reason=WITHOUT_DASK)

    def check(client):
        if late:
            raise InputError("worker tcp://late: neurotact is another")

    monkeypatch.setattr(cluster, "_check_packages", check)
    with pytest.raises(InputError if late else TypeError, match="tcp://late" if late else "takes 2"):
        map_one(monkeypatch, TypeError("run_cell() takes 2 positional arguments"))


def test_a_cluster_that_is_lost_names_no_folder_that_may_be_gone(monkeypatch):
    """A study that is refused before its first cell is done leaves its folder free."""
    pytest.importorskip("distributed", reason=WITHOUT_DASK)
    lost = {CancelledError(): "the scheduler was lost; start it again, ", killed(): "several workers were lost"}
    for error, words in lost.items():
        with pytest.raises(InputError, match=f"{words}.*then give the same command again: what is done is kept$"):
            map_one(monkeypatch, error)


def killed() -> Exception:
    from distributed import KilledWorker

    return KilledWorker("cell", None, 4)


@pytest.mark.thorough
def test_a_worker_that_computes_with_other_instructions_is_refused(dask, tmp_path, monkeypatch):
    here = {**cluster.versions(), "instructions": "SSE9"}
    monkeypatch.setattr(cluster, "versions", lambda: here)
    with pytest.raises(InputError, match=r"instructions is .* there and SSE9 here; start it with ATEN_.*=sse9"):
        runner.run(study.resolve(TINY), tmp_path / "run", scheduler=dask[0])


@pytest.mark.thorough
def test_a_worker_killed_in_the_middle_of_a_cell_changes_nothing(dask, expected, tmp_path):
    address, started = dask
    killed: list[str] = []
    killer = Thread(target=kill_one_in_a_cell, args=(address, started, killed))
    killer.start()
    runner.run(study.resolve(TINY), tmp_path / "run", scheduler=address)
    killer.join()
    assert len(killed) == 1
    assert started[killed[0]].wait() == -signal.SIGKILL
    assert left_by(tmp_path / "run") == expected


@pytest.mark.thorough
def test_a_cell_that_cannot_be_trained_is_one_sentence_from_there_too(dask, tmp_path):
    with pytest.raises(InputError, match=NOT_TRAINED):
        runner.run(study.resolve(TINY, UNTRAINABLE), tmp_path / "run", scheduler=dask[0])
    assert not list((tmp_path / "run").rglob(".*"))


def kill_one_in_a_cell(address: str, started: dict[str, subprocess.Popen], killed: list[str]) -> None:
    """Stop a worker that computes a cell, see that it has not finished it, and kill it."""
    from distributed import Client

    def its_cells(worker: str) -> set:
        return {key for key in client.processing().get(worker, ()) if key[0].startswith("cells-")}

    def strike() -> bool:
        for worker, about in client.scheduler_info()["workers"].items():
            if its_cells(worker):
                process = started[about["name"]]
                process.send_signal(signal.SIGSTOP)
                time.sleep(0.3)
                if its_cells(worker):
                    process.kill()
                    killed.append(about["name"])
                    return True
                process.send_signal(signal.SIGCONT)
        return False

    with Client(address, set_as_default=False) as client:
        wait_for(strike)


# --- clusters that cannot be used -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("tcp://127.0.0.1:1", "no scheduler answered there within 0.5 s; start one with dask scheduler"),
        ("cluster", "missing port number in address 'cluster'; give an address such as tcp://host:8786"),
        ("http://127.0.0.1:80", "unknown address scheme 'http'"),
    ],
)
def test_an_address_without_a_scheduler_is_named(tmp_path, monkeypatch, address, expected):
    pytest.importorskip("distributed", reason=WITHOUT_DASK)
    monkeypatch.setattr(cluster, "REACH_S", 0.5)
    with pytest.raises(InputError, match=f"`scheduler='{address}'`: ") as refusal:
        runner.run(study.resolve(TINY), tmp_path / "run", scheduler=address)
    assert expected in str(refusal.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("n_workers", "expected"),
    [(0, r"no worker joined it within 0\.5 s; start some with dask worker"), (1, "has 2 threads, but a cell needs")],
)
def test_workers_that_cannot_be_used_are_named(tmp_path, monkeypatch, n_workers, expected):
    distributed = pytest.importorskip("distributed", reason=WITHOUT_DASK)
    threads = {"processes": False, "n_workers": n_workers, "threads_per_worker": 2}
    with distributed.LocalCluster(**threads, protocol="tcp", dashboard_address=None) as local:
        monkeypatch.setattr(cluster, "REACH_S", 10.0 if n_workers else 0.5)
        with pytest.raises(InputError, match=expected):
            runner.run(study.resolve(TINY), tmp_path / "run", scheduler=local.scheduler_address)


def test_without_dask_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"install it with pip install 'neurotact\[dask\]'"):
        runner.run(study.resolve(TINY), tmp_path / "run", scheduler="tcp://127.0.0.1:8786")


# --- processes of this machine ---------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cell_that_cannot_be_trained_is_one_sentence(tmp_path):
    process = typed("neurotact", "study", "run", TINY, *OPTIONS, "-o", tmp_path / "run")
    _, said = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 2
    assert re.match(f"neurotact: {NOT_TRAINED}", said.splitlines()[-1])
    assert "Traceback" not in said


def test_a_process_that_dies_costs_its_own_job_and_nothing_else(tmp_path, capsys):
    died, other = tmp_path / "died", tmp_path / "other"
    dies_once = f"test -e {died} || {{ touch {died}; kill -9 $PPID; }}"  # the shell's parent is the worker process
    jobs = [dies_once, f"echo begun >> {other}; sleep 1"]
    with workers.pool(2) as run:
        assert list(run(os.system, jobs)) == [0, 0]
    assert other.read_text() == "begun\n"
    assert capsys.readouterr().err.count("a worker process died") == 1


@thinned(
    ("task", "job", "seen"),
    [
        (os.system, "kill -KILL $PPID", r"were killed .* \(signal 9, SIGKILL\) .*; if its memory ran out, use fewer"),
        (os.system, "kill -SEGV $PPID", r"were killed .* \(signal 11, SIGSEGV\) .*; look for the cause in the log"),
        (os._exit, 3, "ended with code 3 at the same job"),
    ],
)
def test_a_job_that_ends_every_process_ends_the_run_with_what_was_seen(task, job, seen):
    with pytest.raises(InputError, match=f"^3 worker processes {seen}") as refusal:
        workers.in_a_process(task, job)
    assert ("memory" in str(refusal.value)) == ("SIGKILL" in seen)
