"""Kill commands in the middle of what they write, go on, and compare with what an undisturbed run leaves.

    python tests/fuzz/kills_in_writes.py --kills 50 --seed 0

A library before the C library (`faults.c`, so it wants Linux and cc) counts the calls that write, rename or remove a
file of the command, and at one of them, drawn at random, writes half of the bytes and kills the command and all of its
processes (SIGKILL). So each kill lands in a write; the report names the call and the file. Afterwards the same command
(`--resume`, `study resume`) must come to the very bytes of the undisturbed run, timings excepted, and leave no draft,
no lock and nothing else. Ends with 1 where one differs, and where a kill did not land.
"""

# ruff: noqa: E402
import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]  # started by another path, as a test does

import cases
import fuzz
import judge
import kills as at_moments
from judge import Case
from kills import SIMULATE, TINY, WINDOW

LIBRARY = "LD_PRELOAD"
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
"""A process with threads is not to be forked."""
SECONDS = 600.0


def main() -> int:
    if "faults" not in os.environ.get(LIBRARY, ""):
        return _under_the_library()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="kill this command alone")
    asked = parser.parse_args()
    rng, done, faults = random.Random(asked.seed), Counter(), 0
    with tempfile.TemporaryDirectory(prefix="neurotact-kills-", ignore_cleanup_errors=True) as folder:
        place = Path(folder) / "place"
        works = {one.name: one for one in _works() if asked.only in (None, one.name)}
        make_inputs(place)
        wholes = {name: undisturbed(one, place) for name, one in works.items()}
        for name, whole in wholes.items():
            print(f"{name}: {whole.calls} calls that write, rename or remove", flush=True)
        while sum(done.values()) < asked.kills:
            name = min(works, key=lambda name: done[name])
            kills = [rng.randrange(1, wholes[name].calls + 1) for _ in range(rng.choice([1, 1, 2]))]
            landed, fault = disturbed(works[name], wholes[name], kills, place)
            done[name] += len(landed) or 1
            faults += bool(fault)
            told = f"killed in {'; in '.join(landed)}: {fault or 'the same bytes'}"
            print(f"{sum(done.values()):3} {name}: {told}", flush=True)
    print(f"kills: {dict(done)}; {faults} runs failed")
    return 1 if faults else 0


def _under_the_library() -> int:
    """Compile it and start this script again with it: it must be there when a process begins."""
    with tempfile.TemporaryDirectory(prefix="neurotact-faults-") as folder:
        library = compiled(Path(folder))
        words = [sys.executable, __file__, *sys.argv[1:]]
        return subprocess.run(words, env={**os.environ, LIBRARY: str(library), **ONE_THREAD}, check=False).returncode


def compiled(folder: Path) -> Path:
    """The library of `faults.c`, made in a folder."""
    library, source = folder / "faults.so", Path(__file__).with_name("faults.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True)
    return library


class Work(NamedTuple):
    """A command that writes below `out`, and the one that goes on there; once: whether it writes a single file."""

    name: str
    begin: list[str]
    go_on: list[str]
    once: bool = False


class Whole(NamedTuple):
    """What an undisturbed run leaves, and in how many calls."""

    folder: Path
    calls: int


def _works() -> list[Work]:
    sets = ["--set", "training.epochs=8", "--set", "training.patience=8"]
    train = ["train", "spikes.h5", *WINDOW, *sets, "-o", "out/run"]
    few = ["--set", "training.epochs=2", "--trials", "6", "--batch", "3"]
    tune = ["tune", "spikes.h5", *WINDOW, *few, "-o", "out/search"]
    study = ["study", "run", str(TINY), "--set", "network.training.epochs=2", "--workers", "2", "-o", "out/study"]
    made = {
        "import": ["import", "folder", "csv", "--sampling-rate-Hz", "1000", "--unit", "mV", "-o", "out/touch.h5"],
        "encode": ["encode", "touch.h5", "-o", "out/spikes.h5"],
        "calibrate": ["calibrate", "touch.h5", "-o", "out/mine.toml"],
    }
    return [
        *(Work(name, words, words, once=True) for name, words in made.items()),
        Work("train", train, [*train, "--resume"]),
        Work("tune", tune, tune),
        Work("study", study, ["study", "resume", "out/study", "--workers", "2"]),
    ]


def make_inputs(place: Path) -> None:
    """Recordings and spikes; what commands import is imported here too."""
    place.mkdir(parents=True)
    cases.make_folders(place)
    for words in ([*SIMULATE, "-o", "touch.h5"], ["encode", "touch.h5", "-o", "spikes.h5"]):
        _must(words, place)


def undisturbed(one: Work, place: Path) -> Whole:
    """The files of a run that nothing disturbs."""
    calls = _must(one.begin, place)
    fuzz.inherit(judge.modules_of(place))
    folder = place.parent / f"whole-{one.name}"
    (place / "out").rename(folder)
    return Whole(folder, max(Counter(line.split()[0] for line in calls).values()))


def disturbed(one: Work, whole: Whole, kills: list[int], place: Path) -> tuple[list[str], str]:
    """Where each kill landed, and what is wrong in the end, if anything."""
    shutil.rmtree(place / "out", ignore_errors=True)
    words, landed = one.begin, []
    for at in kills:
        code, said, calls = run(words, place, at)
        if code == 0 and landed:  # what was left to do took fewer calls
            break
        if code != -signal.SIGKILL:
            return landed, f"the kill at call {at} did not land: exit code {code}: {said[-300:]}"
        _, call, path, n_bytes = calls[-1].split()
        landed.append(f"{call} of {Path(path).relative_to(place / 'out')} ({n_bytes} bytes)")
        if one.once:
            break
        has_begun = one.name != "study" or (place / "out" / "study" / "study.toml").is_file()
        words = one.go_on if has_begun else one.begin
    if one.once and any(path.suffix and not path.name.startswith(".") for path in (place / "out").glob("*")):
        return landed, "; ".join(
            at_moments.differences(whole.folder, place / "out")
        )  # it had been renamed: it is whole
    code, said, _ = run(words, place)
    if code != 0:
        return landed, f"cannot go on: exit code {code}: {said[-300:]}"
    left = [path.name for path in (place / "out").rglob(".*")]
    return landed, f"left behind: {left[0]}" if left else "; ".join(at_moments.differences(whole.folder, place / "out"))


def run(words: list[str], place: Path, kill_at: int = 0) -> tuple[int, str, list[str]]:
    """Exit code, what was said on stderr, and the calls that wrote; killed at one of them."""
    log = place.parent / "calls.log"
    log.unlink(missing_ok=True)
    given = {"NEUROTACT_FAULT_IN": str(place / "out"), "NEUROTACT_FAULT_LOG": str(log)}
    os.environ.update(given | {"NEUROTACT_KILL_AT": str(kill_at), "NEUROTACT_KILL_GROUP": "1"})
    try:
        outcome = fuzz.in_child(lambda: judge.run(Case("kill", words), place, SECONDS, wants_modules=not kill_at))
    finally:
        for name in given:
            del os.environ[name]
    return outcome.code, outcome.said, log.read_text().splitlines() if log.exists() else []


def _must(words: list[str], place: Path) -> list[str]:
    code, said, calls = run(words, place)
    if code:
        raise SystemExit(f"neurotact {' '.join(words)}: ended with {code}: {said}")
    return calls


if __name__ == "__main__":
    sys.exit(main())
