"""A study of a large set: seconds of each of its parts, seconds on a clock, and the most memory of all its processes.

    python benchmarks/large_study.py /tmp/large --trials 1000 3000 [--quick] [--workers 2]

The set is made up (`made_sets`): 16 taxels at 200 Hz, 2 s of touch at one of five speeds, 21 classes. A memory page
that several processes share counts once (proportional set size).
"""

import argparse
import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from made_sets import Made, touches

import neurotact as nt

SPEEDS = (10, 20, 30, 40, 50)
"""In mm/s."""
LARGE = Made(classes=21, taxels=16, rate_Hz=200.0, seconds=2.0, apart=0.08, noise=0.5)


class Ran(NamedTuple):
    """What a command and its processes took: seconds on a clock and of processors, most bytes of memory."""

    seconds: float
    computed: float
    most_bytes: int


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    found = [pid]
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += [each for child in (task / "children").read_text().split() for each in family(int(child))]
    return found


def resident(pid: int) -> int:
    """Bytes of memory of a process."""
    with suppress(OSError, StopIteration):
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("Pss:")).split()[1])
    return 0


def computed(pid: int) -> float:
    """Processor seconds of a process."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def ran(words: list[str]) -> Ran:
    """Run a command of neurotact."""
    began, most, seconds = time.perf_counter(), 0, dict[int, float]()
    child = subprocess.Popen([sys.executable, "-m", "neurotact", *words])
    while child.poll() is None:
        every = family(child.pid)
        most = max(most, sum(map(resident, every)))
        seconds |= {each: max(seconds.get(each, 0.0), computed(each)) for each in every}
        time.sleep(0.5)
    if child.returncode:
        raise SystemExit(f"{' '.join(words)}: exit code {child.returncode}")
    return Ran(time.perf_counter() - began, sum(seconds.values()), most)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, nargs="+", default=[1000])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], help="as of the study, such as calibrate=false")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for n in asked.trials:
        data, run = asked.folder / f"{n}.h5", asked.folder / f"{n}{'-quick' if asked.quick else ''}"
        if not data.is_file():
            nt.save(touches(LARGE._replace(trials=n), speeds=SPEEDS), data)
        words = ["study", "run", "own-recordings", "--data", str(data), "-o", str(run), "--workers", str(asked.workers)]
        words += [word for change in asked.set for word in ("--set", change)]
        took = ran([*words, *(["--quick"] if asked.quick else [])])
        parts = pd.read_csv(run / "timings.csv").groupby("part", sort=False)["seconds"].sum().round(1).to_dict()
        clock = f"{took.seconds:.0f} s on a clock, {took.computed:.0f} s of processors"
        print(f"\n{n} trials: {clock}, {took.most_bytes / 1e9:.2f} GB, {json.dumps(parts)}", flush=True)


if __name__ == "__main__":
    main()
