"""Let the disk run full at random sizes, then give it room: one line, nothing half-written, and the same bytes.

    python tests/fuzz/disk_full.py --sizes 20 --seed 0

As root the disk is a small tmpfs, which fills up for all that a command writes; otherwise each file is limited
(RLIMIT_FSIZE). A command that finds no room must end with exit code 2 and one line, leave no draft, and no file but
such as an undisturbed run leaves, whole. With room again the same command must come to the very bytes of that run;
of a file of NWB, which has its date and random identifiers, to the same content.
"""

import argparse
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # started by another path, as a test does

import h5py
import kills
import numpy as np
from kills import NEUROTACT, TINY, WINDOW, Work, differences

PAGE = 4096
PLENTY = 2**30
GROWING = {".jsonl", ".csv"}
"""Files that may grow line by line: a part of one is whole up to its last line."""


def works() -> list[Work]:
    """Each command, and how it goes on; it writes below `DIR` alone."""
    simulate = [*kills.SIMULATE, "-o", "DIR/out.h5"]
    encode = ["encode", "touch.h5", "-o", "DIR/out.h5"]
    drawn = ["raster", "spikes.h5", "-o", "DIR/out.png"]
    events = ["raster", "spikes.h5", "-o", "DIR/out.csv"]
    train = ["train", "spikes.h5", *WINDOW, "--set", "training.epochs=4", "-o", "DIR/run"]
    tune = ["tune", "spikes.h5", *WINDOW, "--set", "training.epochs=2", "--trials", "4", "-o", "DIR/search"]
    study = ["study", "run", str(TINY), "--set", "sweep.seed=[0]", "-o", "DIR/study"]
    nwb = ["raster", "spikes.h5", "-o", "DIR/out.nwb"]
    nir = ["export", "chain", "--to", "nir", "-o", "DIR/out.nir"]
    c = ["export", "chain", "--to", "c", "-o", "DIR/c", "--force"]
    once = [Work(words[0], words, words) for words in (simulate, encode, drawn, events, tune, nwb, nir, c)]
    return [*once, Work("train", train, [*train, "--resume"]), Work("study", study, ["study", "resume", "DIR/study"])]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, default=20, help="random sizes, dealt to the commands in turn")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="neurotact-full-"))
    rng = random.Random(asked.seed)
    n_failed = n_full = 0
    try:
        kills.must(["simulate", *kills.SIMULATE[1:], "-o", "touch.h5"], work)
        kills.must(["encode", "touch.h5", "-o", "spikes.h5"], work)
        kills.must(["encode", "touch.h5", "--set", "conditioning.baseline=start", "-o", "causal.h5"], work)
        kills.must(["train", "causal.h5", *WINDOW, "--set", "training.epochs=1", "-o", "chain"], work)
        for number in range(asked.sizes):
            place = number % len(works())
            one, whole = works()[place], work / f"whole-{place}"
            if not whole.is_dir():
                whole.mkdir()
                kills.must(_below(one.begin, whole.name), work)
            size = rng.randrange(PAGE, _needed(whole) + 1)
            was_full, fault = filled(one, size, whole, work)
            n_full += was_full
            n_failed += bool(fault)
            how = fault or ("the same bytes" if was_full else "fitted")
            print(f"{number + 1:3} {' '.join(one.begin[:2])}, {size / 1e3:.0f} kB: {how}", flush=True)
    finally:
        _unmount(work / "disk")
        shutil.rmtree(work, ignore_errors=True)
    print(f"{asked.sizes} sizes, {n_full} of them too small; {n_failed} failed")
    return 1 if n_failed else 0


def filled(one: Work, size: int, whole: Path, work: Path) -> tuple[bool, str]:
    """Whether the command ran out of room, and what is wrong with how it ended, if anything."""
    disk = work / "disk"
    shutil.rmtree(disk, ignore_errors=True)
    disk.mkdir()
    mounted = os.geteuid() == 0 and _mount(disk, size)
    try:
        done = _run(_below(one.begin, disk.name), work, None if mounted else lambda: _limit(size))
        if done.returncode == 0:
            return False, ""
        fault = fault_of(done) or half_written(disk, whole)
        if fault:
            return True, fault
        if mounted:
            subprocess.run(["mount", "-o", f"remount,size={PLENTY}", str(disk)], check=True)
        has_begun = one.name != "study" or (disk / "study" / "study.toml").is_file()
        again = _run(_below(one.go_on if has_begun else one.begin, disk.name), work, None)
        if again.returncode:
            return True, f"cannot go on: {' '.join(again.stderr.splitlines()[-1:])}"
        return True, "; ".join(each for each in differences(whole, disk) if not _is_told_alike(each, whole, disk))
    finally:
        if mounted:
            _unmount(disk)


def fault_of(done: subprocess.CompletedProcess) -> str:
    """What is wrong with how a command without room ended."""
    said = [line for line in done.stderr.splitlines() if line.startswith("neurotact: ")]
    if done.returncode != 2:
        return f"exit code {done.returncode}: {' '.join(done.stderr.splitlines()[-1:])}"
    if "Traceback" in done.stderr or "Exception ignored" in done.stderr:
        return f"a traceback: {done.stderr.splitlines()[-1]}"
    return "" if said else "not a line of neurotact's"


def half_written(disk: Path, whole: Path) -> str:
    """The first file that is not as an undisturbed run leaves it, nor the first lines of it where it grows by lines."""
    for path in sorted(path for path in disk.rglob("*") if path.is_file()):
        name = path.relative_to(disk)
        if path.name.startswith("."):
            return f"left behind: {name}"
        if path.name in kills.TIMINGS or not (whole / name).is_file():
            continue
        found, expected = path.read_bytes(), (whole / name).read_bytes()
        grows = path.suffix in GROWING and expected.startswith(found) and found[-1:] in (b"", b"\n")
        if found != expected and not grows and not _is_told_alike(f"{name} differs", whole, disk):
            return f"{name} is half-written"
    return ""


def _is_told_alike(difference: str, whole: Path, disk: Path) -> bool:
    """Whether two files of NWB differ in nothing but their date and identifiers."""
    name, _, how = difference.rpartition(" ")
    return how == "differs" and name.endswith(".nwb") and _told(whole / name) == _told(disk / name)


def _told(path: Path) -> dict[str, list]:
    """The content of a file of NWB."""
    content: dict[str, list] = {}

    def visit(name: str, each: h5py.Dataset | h5py.Group) -> None:
        if isinstance(each, h5py.Dataset) and name != "file_create_date":
            content[name] = np.ravel(each[()]).tolist()

    with h5py.File(path) as file:
        file.visititems(visit)
    return content


def _needed(folder: Path) -> int:
    """Nearly what the disk must hold for a command's files; of a limit on each file, what the largest needs."""
    pages = [-(-path.stat().st_size // PAGE) for path in folder.rglob("*") if path.is_file()]
    return max(1, (sum(pages) if os.geteuid() == 0 else max(pages)) - 1) * PAGE


def _run(words: list[str], work: Path, before: Callable[[], None] | None) -> subprocess.CompletedProcess:
    return subprocess.run(
        [*NEUROTACT, *words], cwd=work, env=kills.environment(), capture_output=True, text=True, check=False,
        preexec_fn=before,
    )  # fmt: skip


def _limit(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def _below(words: list[str], folder: str) -> list[str]:
    return [word.replace("DIR", folder, 1) if word.startswith("DIR") else word for word in words]


def _mount(disk: Path, size: int) -> bool:
    words = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def _unmount(disk: Path) -> None:
    if os.path.ismount(disk):
        subprocess.run(["umount", str(disk)], check=False)


if __name__ == "__main__":
    sys.exit(main())
