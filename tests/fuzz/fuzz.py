"""Fuzz the command line: spoilt inputs of every kind, each in a forked process of its own.

    python tests/fuzz/fuzz.py --cases 10000 --seed 0
    python tests/fuzz/fuzz.py --cases 10000 --seed 0 --control 50  one case in 50 also in a process that starts anew
    python tests/fuzz/fuzz.py --seed 0 --case 17 --keep DIR      one case alone; its folder and streams stay in DIR

Of every case is asked: no traceback, exit code 0 or 2, with 2 one line on stderr beside progress and warnings, at most
1 GB and 20 s, inputs as they were, no draft and no lock left. A run folder that was damaged and resumed must come to
the very results of an undamaged one. Ends with 1 where a case failed.
"""

# ruff: noqa: E402
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy and torch are imported: a process with threads is not to be forked

import argparse
import gc
import json
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]  # started by another path, as a test does

import cases
import chain_cases
import content_cases
import judge
from judge import Case, Outcome

SLOW_BASE = 300.0
"""Seconds that making a valid input may take."""


cases.COMMANDS |= chain_cases.COMMANDS
cases.KINDS |= chain_cases.KINDS | content_cases.KINDS


class Done(NamedTuple):
    """A case that ended."""

    number: int
    words: list[str]
    outcome: Outcome


def main() -> int:
    asked = _arguments()
    if asked.kind:
        cases.KINDS = {kind: share for kind, share in cases.KINDS.items() if kind.__name__ in asked.kind}
    work = asked.keep or Path(tempfile.mkdtemp(prefix="neurotact-fuzz-"))
    work.mkdir(parents=True, exist_ok=True)
    base = work / "base"
    began = time.monotonic()
    try:
        make_base(base)
        print(f"valid inputs made in {time.monotonic() - began:.0f} s", flush=True)
        numbers = range(asked.start, asked.start + asked.cases) if asked.case is None else [asked.case]
        done = _told(run_all(asked, numbers, base, work), asked, began)
    finally:
        if asked.keep is None:
            shutil.rmtree(work, ignore_errors=True)
    return report(done, asked.seed)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--start", type=int, default=0, help="number of the first case")
    parser.add_argument("--case", type=int, help="run this case alone")
    parser.add_argument("--kind", action="append", help="draw cases of this kind alone; may be repeated")
    parser.add_argument(
        "--keep", type=Path, help="keep every case's folder and streams, and valid inputs, in this folder"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--control", type=int, metavar="N", help="run one case in N also in a process that starts anew")
    parser.add_argument("--seconds", type=float, default=20.0, help="that a case may take; more on a busy machine")
    parser.add_argument("--log", type=Path, help="write a JSON line a case to this file")
    return parser.parse_args()


def make_base(base: Path) -> None:
    """Valid inputs, made by neurotact itself; what that imports is imported here too, for the cases to inherit."""
    is_made = judge.modules_of(base) if base.is_dir() else []  # by an earlier run with --keep
    if not is_made:
        base.mkdir(parents=True)
        cases.make_folders(base)
        chain_cases.make_samples(base)
    for words in [] if is_made else [*cases.base_commands(), *chain_cases.base_commands()]:
        outcome = in_child(
            lambda words=words: judge.run(Case("base", words, changes=()), base, SLOW_BASE, wants_modules=True)
        )
        if outcome.code != 0:
            raise SystemExit(f"neurotact {' '.join(words)}: ended with {outcome.code}: {outcome.said[-2000:]}")
    inherit(judge.modules_of(base))


def inherit(modules: Iterable[str]) -> None:
    """Import what commands need: the processes that are forked from this one have it then."""
    for name in modules:
        try:
            import_module(name)
        except Exception:  # a part of another module, which cannot be imported by itself
            continue
    gc.collect()
    gc.freeze()


def run_all(asked: argparse.Namespace, numbers: Iterable[int], base: Path, work: Path) -> Iterator[Done]:
    """Each case, in a process that writes its inputs and judges it; some of them side by side."""
    todo, running = iter(numbers), {}
    while True:
        for number in todo if len(running) < asked.jobs else ():
            report = work / f"{number}.json"
            child = os.fork()
            if child == 0:
                _one(asked, number, base, work, report)
            running[child] = number, report
            if len(running) == asked.jobs:
                break
        if not running:
            return
        child, _ = os.wait()
        number, report = running.pop(child)
        try:
            words, *rest = json.loads(report.read_text())
            report.unlink()
        except (OSError, ValueError):
            words, rest = [], ["harness", -1, 0.0, 0, "the case could not be made or judged", ""]
        yield Done(number, words, Outcome(*rest))


def _one(asked: argparse.Namespace, number: int, base: Path, work: Path, report: Path) -> None:
    """Never returns."""
    code = 1
    try:
        place = work / f"case-{number}"
        case = _drawn(asked.seed, number, place, base)
        outcome = judge.run(case, place, asked.seconds)
        if asked.control and number % asked.control == 0 and not outcome.fault:
            case = _drawn(asked.seed, number, place, base)
            control = judge.run(case, place, asked.seconds, starts_anew=True)
            outcome = outcome._replace(fault=judge.fault_of_control(outcome, control))
        report.write_text(json.dumps([case.words, *outcome]))
        if asked.keep is None:
            judge.clear(place)
        code = 0
    finally:
        if code:
            import traceback

            traceback.print_exc()
        sys.stderr.flush()
        os._exit(code)


def _drawn(seed: int, number: int, place: Path, base: Path) -> Case:
    """A case, with its inputs in a new folder."""
    judge.clear(place)
    place.mkdir()
    return cases.draw(seed, number, place, base)


def in_child(call) -> Outcome:
    """The outcome of a call in a forked process, so that this one stays as it is."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(write, json.dumps(call()).encode())
        finally:
            os._exit(0)
    os.close(write)
    with open(read, "rb") as stream:
        told = stream.read()
    os.waitpid(child, 0)
    return Outcome(*json.loads(told))


def _told(done: Iterator[Done], asked: argparse.Namespace, began: float) -> list[Done]:
    """All of them, each failure printed as it comes, the first of its kind with what was said."""
    every: list[Done] = []
    seen: Counter[str] = Counter()
    log = asked.log.open("w") if asked.log else None
    for one in done:
        every.append(one)
        if log:
            log.write(json.dumps([one.number, one.words, *one.outcome]) + "\n")
            log.flush()
        fault = one.outcome.fault
        if fault:
            seen[fault] += 1
            if seen[fault] == 1:
                print(f"case {one.number}: {fault}\n    neurotact {_short(one.words)}", flush=True)
        if len(every) % 500 == 0:
            print(f"{len(every)} cases, {sum(seen.values())} failed, {time.monotonic() - began:.0f} s", flush=True)
    if log:
        log.close()
    if asked.case is not None and every:
        print(every[0].outcome.said[-4000:], end="")
    return every


def report(done: list[Done], seed: int) -> int:
    """Print a table by kind and the failures, like ones together; the exit code."""
    print(f"\n{'kind':24}{'cases':>7}{'exit 0':>8}{'exit 2':>8}{'failed':>8}{'longest s':>11}{'most MB':>9}")
    kinds: dict[str, list[Outcome]] = defaultdict(list)
    for one in done:
        kinds[one.outcome.kind].append(one.outcome)
        kinds["all"].append(one.outcome)
    for kind in sorted(kinds, key=lambda kind: (kind == "all", kind)):
        some = kinds[kind]
        good = Counter(one.code for one in some if not one.fault)
        failed = sum(bool(one.fault) for one in some)
        longest, most = max(one.seconds for one in some), max(one.memory for one in some) / 1e6
        print(f"{kind:24}{len(some):7}{good[0]:8}{good[2]:8}{failed:8}{longest:11.1f}{most:9.0f}")
    faults: dict[str, list[Done]] = defaultdict(list)
    for one in done:
        if one.outcome.fault:
            faults[one.outcome.fault].append(one)
    for fault, some in sorted(faults.items(), key=lambda item: -len(item[1])):
        numbers = ", ".join(str(one.number) for one in some[:6]) + (" ..." if len(some) > 6 else "")
        print(f"\n{len(some)} x {fault}\n    cases {numbers}; alone: --seed {seed} --case {some[0].number} --keep DIR")
    return 1 if faults else 0


def _short(words: list[str]) -> str:
    return (
        " ".join(word if len(word) < 60 else f"{word[:50]}..." for word in words)
        .encode("ascii", "backslashreplace")
        .decode()
    )


if __name__ == "__main__":
    sys.exit(main())
