"""What the benchmarks share: interleaved timing of ourselves and of peers, and the table that comes of it."""

import argparse
import importlib.metadata
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch


class Runner(NamedTuple):
    """One way to do the work: `run()` does it once; `threads` is set for torch before."""

    name: str
    run: Callable[[], object]
    threads: int


class Row(NamedTuple):
    case: str
    peer: str
    ours_ms: float
    peer_ms: float
    ratio: float
    note: str


def best_of(runners: list[Runner], seconds: float, rounds: int = 7) -> dict[str, tuple[float, int]]:
    """Median milliseconds and thread count of each name, the best of its runners.

    All runners take turns, so that what slows the machine slows all. Each turn warms up first, then repeats for
    about `seconds` (at least once); the median is taken over all repeats of all rounds.
    """
    times: dict[int, list[float]] = {k: [] for k in range(len(runners))}
    for _ in range(rounds):
        for k, runner in enumerate(runners):
            torch.set_num_threads(runner.threads)
            runner.run()
            end = time.perf_counter() + seconds
            while True:
                start = time.perf_counter()
                runner.run()
                now = time.perf_counter()
                times[k].append(1e3 * (now - start))
                if now > end:
                    break
    best: dict[str, tuple[float, int]] = {}
    for k, runner in enumerate(runners):
        median = statistics.median(times[k])
        if runner.name not in best or median < best[runner.name][0]:
            best[runner.name] = (median, runner.threads)
    return best


def machine() -> dict[str, object]:
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        model = next((s.split(":")[1].strip() for s in cpuinfo.read_text().splitlines() if "model name" in s), model)
    load = [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None
    return {"processor": model, "cores": os.cpu_count(), "system": platform.platform(), "load": load}


def versions(packages: tuple[str, ...]) -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def parse(cases: tuple[str, ...], peers: tuple[str, ...], about: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--case", choices=cases, nargs="+", default=list(cases))
    parser.add_argument("--peers", choices=peers, nargs="*", default=list(peers))
    parser.add_argument("--json", type=Path, help="write rows, machine and versions there")
    parser.add_argument("--rounds", type=int, default=7, help="turns of each runner")
    return parser.parse_args()


def missing(peer: str, error: Exception) -> None:
    print(f"{peer} is left out: {error}", file=sys.stderr)


def publish(rows: list[Row], packages: tuple[str, ...], to: Path | None) -> None:
    """A Markdown table on stdout, and JSON where asked for."""
    print("| case | peer | ours (ms) | peer (ms) | ratio | |\n| --- | --- | ---: | ---: | ---: | --- |")
    for row in rows:
        print(f"| {row.case} | {row.peer} | {row.ours_ms:.2f} | {row.peer_ms:.1f} | {row.ratio:.1f} | {row.note} |")
    result = {"rows": [row._asdict() for row in rows], "machine": machine(), "versions": versions(packages)}
    print()
    print("machine:", json.dumps(result["machine"]))
    print("versions:", json.dumps(result["versions"]))
    if to is not None:
        to.write_text(json.dumps(result, indent=2) + "\n")
