"""One process works in a folder at a time, and whatever stops it, the next one goes on to the same bytes."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from processes import workers_of

import neurotact as nt
from neurotact import files
from neurotact.api import networks as api
from neurotact.data import hdf5
from neurotact.data.dataset import load_recordings
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.files import DRAFT, LOCK
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import cross_validation
from neurotact.studies import runner, store, study

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TINY = HERE / "tiny.toml"
SMALL = ("--set", "network.hidden=4", "--set", "sweep.seed=[0]", "--set", "baselines=linear")
SPACE = '[forward_weight_scale]\n_type = "loguniform"\n_value = [0.3, 3.0]\n'
DEADLINE_S = 300.0


def typed(*words: object, before: str = "") -> subprocess.Popen:
    """`neurotact ...` in a process of its own, after the statements `before`."""
    return subprocess.Popen(
        [sys.executable, "-c", f"{before}\nfrom neurotact.cli import main; main()", *map(str, words)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def end_of(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and what was said on stderr."""
    try:
        _, said = process.communicate(timeout=DEADLINE_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    return process.returncode, said


def wait_until(found) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not found():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def refusal_in(said: str) -> str:
    """The one line of a refusal; progress and warnings apart, nothing else was said."""
    lines = [line for line in said.splitlines() if line.startswith("neurotact: ")]
    assert len(lines) == 1, said
    assert "Traceback" not in said
    return lines[0]


def left_by(folder: Path) -> dict[str, bytes]:
    """All that a study or a search leaves, but for times and drawings."""
    times = {"timing.json", "timings.csv", "report.html", "search.png"}
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in times and "figures" not in path.parts
    }


@pytest.fixture(scope="module")
def spikes(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("spikes") / "spikes.h5"
    what = study.resolve(TINY)
    hdf5.save_spikes(encode_recordings(load_recordings(what.dataset), what.encoder), path)
    (path.parent / "space.toml").write_text(SPACE)
    return path


def tune(spikes: Path, out: Path, trials: int = 4) -> list[object]:
    shape = (
        "--window-ms",
        50,
        "--start-ms",
        100,
        "--per-trial",
        1,
        "--batch",
        2,
        "--space",
        spikes.parent / "space.toml",
    )
    small = ("--set", "training.epochs=2", "--set", "training.batch=4", "--set", "hidden=4")
    return ["tune", spikes, "-o", out, "--trials", trials, *shape, *small]


# --- two at once --------------------------------------------------------------------------------------


@pytest.fixture
def held(tmp_path):
    """A folder that another process holds."""
    folder = tmp_path / "run"
    hold = """if True:
        import sys, time
        from neurotact.files import locked
        with locked(sys.argv[1]):
            print("held", flush=True)
            time.sleep(600)
    """
    process = subprocess.Popen([sys.executable, "-c", hold, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield folder, process
    process.kill()
    process.wait()
    process.stdout.close()


@pytest.mark.thorough
def test_a_folder_at_work_is_refused_to_every_writer_and_free_after_a_kill(held, spikes):
    folder, process = held
    what = study.resolve(TINY)
    made_from = runner._made_from(what)
    store.seal(folder, [], made_from)
    (folder / "study.toml").write_text(study.to_toml(what))
    said = rf"run: another neurotact \(process {process.pid} on .*, since .*\) is working here; wait for it to end"
    for work in (
        lambda: runner.run(what, folder),
        lambda: runner.run(runner.load(folder), folder),
        lambda: runner.write_tables(folder),
        lambda: api.train(spikes, folder, window=nt.Window(length_ms=50)),
        lambda: nt.tune(spikes, folder, window=nt.Window(length_ms=50, per_trial=1)),
        lambda: cross_validation.run(spikes, folder, RSNNSpec(), {}),
    ):
        with pytest.raises(InputError, match=said):
            work()
    code, words = end_of(typed(*tune(spikes, folder)))
    assert (code, f"(process {process.pid} on " in refusal_in(words)) == (2, True)
    process.kill()
    process.wait()
    with pytest.raises(InputError, match="no cell is done yet"):
        runner.write_tables(folder)
    assert not (folder / LOCK).exists()


@pytest.mark.slow
def test_the_second_of_two_runs_in_one_folder_is_refused_and_the_first_ends_well(tmp_path):
    folder = tmp_path / "run"
    first = typed("study", "run", TINY, *SMALL, "-o", folder)
    wait_until((folder / "study.toml").is_file)
    os.killpg(first.pid, signal.SIGSTOP)
    for words in (("run", TINY, *SMALL, "-o", folder), ("resume", folder), ("report", folder)):
        code, said = end_of(typed("study", *words))
        assert (code, f"(process {first.pid} on " in refusal_in(said)) == (2, True)
    os.killpg(first.pid, signal.SIGCONT)
    assert end_of(first)[0] == 0
    assert not (folder / LOCK).exists()


# --- drafts ---------------------------------------------------------------------------------------------

PLACES = ("", "cells/ab12", "cells/ab12/search", "spikes", "data", "figures")


def test_drafts_of_a_killed_process_are_swept(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "_compute", lambda *_: None)
    monkeypatch.setattr(runner, "_write_tables", lambda *_: None)
    for go_on in (lambda: runner.run(study.resolve(TINY), tmp_path), lambda: runner.write_tables(tmp_path)):
        for place in PLACES:
            (tmp_path / place).mkdir(parents=True, exist_ok=True)
            (tmp_path / place / f"{DRAFT}0123.csv").write_text("half")
        if not (tmp_path / "study.toml").exists():
            for place in PLACES[1:]:  # killed as it began, a run has nothing but drafts
                (tmp_path / place / f"{DRAFT}0123.csv").unlink()
            for place in sorted((path for path in tmp_path.rglob("*") if path.is_dir()), reverse=True):
                place.rmdir()
        go_on()
        assert not list(tmp_path.rglob(f"{DRAFT}*"))


def test_drafts_in_a_folder_of_anything_else_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("dear")
    (tmp_path / f"{DRAFT}thesis").write_text("dearest")
    with pytest.raises(InputError, match="is not empty"):
        runner.run(study.resolve(TINY), tmp_path)
    assert sorted(os.listdir(tmp_path)) == [f"{DRAFT}thesis", "thesis.tex"]


@pytest.mark.slow
@pytest.mark.parametrize("whom", ["command", "a worker", "all"])
def test_a_search_killed_at_random_leaves_the_same_bytes_and_no_draft(whom, spikes, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert end_of(typed(*tune(spikes, whole, 12)))[0] == 0
    draw = random.Random(whom)
    for n_lines in sorted(draw.sample(range(12), 3)):
        process = typed(*tune(spikes, killed, 12))
        wait_until(partial(has_lines, killed / "journal.jsonl", n_lines, process))
        strike(process, whom, draw)
        end_of(process)
    assert end_of(typed(*tune(spikes, killed, 12)))[0] == 0
    assert left_by(killed) == left_by(whole)
    assert not list(killed.rglob(".*"))


def has_lines(journal: Path, n: int, process: subprocess.Popen) -> bool:
    """Whether a journal has so many lines, or none will come any more."""
    return process.poll() is not None or (journal.is_file() and journal.read_bytes().count(b"\n") >= n)


def strike(process: subprocess.Popen, whom: str, draw: random.Random) -> None:
    """Kill the command, one of its worker processes, or its whole group."""
    if process.poll() is not None:
        return
    if whom == "all":
        os.killpg(process.pid, signal.SIGKILL)
    elif whom == "command":
        process.kill()
    else:
        workers = workers_of(process.pid)
        for worker in draw.sample(workers, min(1, len(workers))):
            os.kill(worker, signal.SIGKILL)


# --- disks that are full or cannot be written -----------------------------------------------------------

LIMIT = (
    "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({n}, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))"
)
"""No file may become larger than so many bytes: a write beyond fails as it does where the disk is full."""


@pytest.mark.slow
def test_a_disk_that_is_full_ends_a_study_in_one_line_and_it_goes_on_to_the_same_bytes(tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "run"
    words = ("study", "run", TINY, *SMALL, "--workers", 1)
    assert end_of(typed(*words, "-o", whole))[0] == 0
    sizes = sorted({path.stat().st_size for path in whole.rglob("*") if path.is_file()})
    for n in (0, *(size - 1 for size in sizes[:: len(sizes) // 4])):
        code, said = end_of(typed(*words, "-o", folder, before=LIMIT.format(n=n)))
        assert code == 2, (n, said)
        assert "cannot be written" in refusal_in(said)
        assert not list(folder.rglob(".*"))
    assert end_of(typed("study", "resume", folder))[0] == 0
    assert left_by(folder) == left_by(whole)
    for n in (0, 100, 2000):
        code, said = end_of(typed("study", "report", folder, before=LIMIT.format(n=n)))
        assert (code, "cannot be written" in refusal_in(said)) == (2, True)
    assert left_by(folder) == left_by(whole)


@pytest.mark.slow
def test_a_disk_that_is_full_ends_a_search_in_one_line_and_it_goes_on_to_the_same_bytes(spikes, tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "tuned"
    assert end_of(typed(*tune(spikes, whole)))[0] == 0
    lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    size = (whole / "search.json").stat().st_size
    for n in (0, 200, size - 1, size, size + len(lines[0])):
        code, said = end_of(typed(*tune(spikes, folder), before=LIMIT.format(n=n)))
        assert (code, "cannot be written" in refusal_in(said)) == (2, True)
        journal = folder / "journal.jsonl"
        assert not journal.exists() or journal.read_bytes() in (whole / "journal.jsonl").read_bytes()
    assert end_of(typed(*tune(spikes, folder)))[0] == 0
    assert left_by(folder) == left_by(whole)


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path, monkeypatch):
    what = study.resolve(TINY)
    store.seal(tmp_path, [], runner._made_from(what))
    (tmp_path / "study.toml").write_text(study.to_toml(what))

    def refused(*_args, **_kwargs):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(files.os, "open", refused)
    for work in (lambda: runner.run(what, tmp_path), lambda: runner.write_tables(tmp_path)):
        with pytest.raises(InputError, match=r"cannot be written \(Read-only file system\)"):
            work()


def test_a_line_is_added_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "journal.jsonl"
    files.append(path, json.dumps({"id": 0}) + "\n")
    monkeypatch.setattr(files.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(InputError, match=r"journal\.jsonl: cannot be written \(No space left on device\)"):
        files.append(path, json.dumps({"id": 1}) + "\n")
    assert path.read_text() == '{"id": 0}\n'


def test_no_room_for_temporary_files_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(
        files.TemporaryDirectory, "__init__", lambda *_, **__: (_ for _ in ()).throw(OSError(28, "full"))
    )
    with pytest.raises(InputError, match=r"temporary files cannot be written \(full\); set TMPDIR"), files.scratch():
        pytest.fail("the block ran")
