"""Kill studies, searches and trainings at random moments, go on, and compare with what an undisturbed run leaves.

    python tests/fuzz/kills.py --kills 50 --seed 0

The main process, one of its workers or the whole group gets SIGKILL, SIGINT or SIGTERM; some are killed twice. In the
end every file must hold the very bytes of the undisturbed run, timings excepted, and no draft, no lock and no process
may be left. Ends with 1 where one differs.
"""

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))  # started by its path

from processes import workers_of

ROOT = Path(__file__).parents[2]
TINY = ROOT / "tests" / "studies" / "tiny.toml"
NEUROTACT = [sys.executable, "-c", "from neurotact.cli import main; main()"]
SIMULATE = ["simulate", "gratings", "--set", "trials=12", "--set", "duration_s=0.4", "--set", "pitches_mm=[4.0, 0.5]"]
SMALL = ["--network", "rsnn", "--set", "hidden=6", "--set", "training.batch=4"]
WINDOW = ["--window-ms", "50", "--start-ms", "100", *SMALL]
TIMINGS = {"timing.json", "timings.csv"}
TOLD_TIMES = re.compile(rb'\d+ cells? took [^<]*|<a href="[^"]*" download="timings.csv">')
"""What of a report tells times: one sentence, and the embedded table."""
SECONDS_TO_END = 20.0
SLOWEST = 600.0


class Work(NamedTuple):
    """A command that writes into a folder, and the one that goes on in it."""

    name: str
    begin: list[str]
    go_on: list[str]


class Kill(NamedTuple):
    """When, which processes and how; `which` of the workers, in turn."""

    after_s: float
    whom: str
    how: signal.Signals
    which: int


def works() -> list[Work]:
    """The commands; `DIR` stands for the folder."""
    train = ["train", "spikes.h5", *WINDOW, "--set", "training.epochs=40", "--set", "training.patience=40", "-o", "DIR"]
    tune = ["tune", "spikes.h5", *WINDOW, "--set", "training.epochs=3", "--trials", "8", "--batch", "4", "-o", "DIR"]
    study = ["study", "run", str(TINY), "--set", "network.training.epochs=6", "-o", "DIR"]
    return [
        Work("train", train, [*train, "--resume"]),
        Work("tune", tune, tune),
        Work("study", study, ["study", "resume", "DIR"]),
    ]


def main() -> int:
    asked = _arguments()
    work = Path(tempfile.mkdtemp(prefix="neurotact-kills-"))
    rng = random.Random(asked.seed)
    faults: Counter[str] = Counter()
    done: Counter[str] = Counter()
    try:
        must(["simulate", *SIMULATE[1:], "-o", "touch.h5"], work)
        must(["encode", "touch.h5", "-o", "spikes.h5"], work)
        undisturbed: dict[str, float] = {}
        chosen = {one.name: one for one in works() if asked.only in (None, one.name)}
        for one in chosen.values():
            began = time.monotonic()
            must(_in(one.begin, f"whole-{one.name}"), work)
            undisturbed[one.name] = time.monotonic() - began
            print(f"{one.name}: {undisturbed[one.name]:.0f} s undisturbed", flush=True)
        while sum(done.values()) < asked.kills:
            one = min(chosen.values(), key=lambda one: done[one.name])
            kills = [_drawn(rng, undisturbed[one.name]) for _ in range(rng.choice([1, 1, 2]))]
            n_kills, fault = disturbed(one, kills, work)
            done[one.name] += n_kills
            faults[fault] += bool(fault)
            told = ", ".join(f"{kill.how.name} to {kill.whom} after {kill.after_s:.1f} s" for kill in kills)
            print(f"{sum(done.values()):3} {one.name}: {told}: {fault or 'the same bytes'}", flush=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"kills: {dict(done)}; {sum(faults.values())} runs failed")
    return 1 if +faults else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=["train", "tune", "study"])
    return parser.parse_args()


def _drawn(rng: random.Random, whole_s: float) -> Kill:
    # The first seconds are imports: most kills fall later, some there.
    after_s = rng.uniform(0.2, 1.0) * whole_s if rng.random() < 0.85 else rng.uniform(0.0, 0.2) * whole_s
    how = rng.choice([signal.SIGKILL] * 3 + [signal.SIGINT, signal.SIGTERM])
    return Kill(after_s, rng.choice(["main", "worker", "group"]), how, rng.randrange(100))


def disturbed(one: Work, kills: list[Kill], work: Path) -> tuple[int, str]:
    """How many kills struck, and what is wrong in the end, if anything."""
    folder = work / "disturbed"
    shutil.rmtree(folder, ignore_errors=True)
    words, n_kills = one.begin, 0
    for kill in kills:
        process = subprocess.Popen(
            [*NEUROTACT, *_in(words, folder.name)], cwd=work, env=environment(), start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        n_kills += _strike(process, kill)
        _, said = process.communicate(timeout=SLOWEST)
        if "Traceback" in said:
            return n_kills, f"a traceback: {said.splitlines()[-1]}"
        if not _ended(process.pid):
            os.killpg(process.pid, signal.SIGKILL)
            return n_kills, "processes are left"
        words = one.go_on if one.name != "study" or (folder / "study.toml").is_file() else one.begin
    last = _run(_in(words, folder.name), work)
    if last.returncode != 0:
        return n_kills, f"cannot go on: {last.stderr.strip().splitlines()[-1:]}"
    left = [path.name for path in folder.rglob("*") if path.name.startswith(".")]
    if left:
        return n_kills, f"left behind: {left[0]}"
    return n_kills, "; ".join(differences(work / f"whole-{one.name}", folder))


def differences(expected: Path, found: Path) -> Iterator[str]:
    """What two folders do not have in common, timings and what is drawn from them left out."""
    names = [{path.relative_to(root) for path in root.rglob("*") if path.is_file()} for root in (expected, found)]
    for name in sorted(names[0] ^ names[1]):
        yield f"{name} is {'missing' if name in names[0] else 'too many'}"
    for name in sorted(names[0] & names[1]):
        one, other = (TOLD_TIMES.sub(b"", (root / name).read_bytes()) for root in (expected, found))
        if name.name not in TIMINGS and one != other:
            yield f"{name} differs"


def _strike(process: subprocess.Popen, kill: Kill) -> int:
    """Send the signal once its time has come; 0 where the command has ended by then."""
    try:
        process.wait(kill.after_s)
        return 0
    except subprocess.TimeoutExpired:
        pass
    try:
        workers = workers_of(process.pid)
        if kill.whom == "group":
            os.killpg(process.pid, kill.how)
        else:
            os.kill(workers[kill.which % len(workers)] if kill.whom == "worker" and workers else process.pid, kill.how)
    except ProcessLookupError:
        return 0
    return 1


def _ended(group: int) -> bool:
    """Whether every process of the group ends by itself within some seconds."""
    deadline = time.monotonic() + SECONDS_TO_END
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def _in(words: list[str], folder: str) -> list[str]:
    return [folder if word == "DIR" else word for word in words]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def _run(words: list[str], work: Path) -> subprocess.CompletedProcess:
    return subprocess.run(
        [*NEUROTACT, *words], cwd=work, env=environment(), capture_output=True, text=True, check=False
    )


def must(words: list[str], work: Path) -> None:
    done = _run(words, work)
    if done.returncode:
        raise SystemExit(f"neurotact {' '.join(words)}: ended with {done.returncode}: {done.stderr}")


if __name__ == "__main__":
    sys.exit(main())
