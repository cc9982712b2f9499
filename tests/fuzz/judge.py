"""Run one command of neurotact in a process of its own and say what is wrong with how it went.

The process is forked from one that has imported neurotact and computed nothing with torch, so that a case costs
milliseconds, not seconds of imports; as a control it can be started anew, as a shell does. Each command has a process
group of its own, its streams in files, and a watch on time and memory.
"""

import ctypes
import faulthandler
import hashlib
import multiprocessing.context
import os
import re
import resource
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import mutations
import numpy as np
from processes import descendants

from neurotact import workers
from neurotact.data import hdf5

ROOT = Path(__file__).parents[2]
RESOLVE_ONLY = "import sys; from neurotact.studies import runner; runner.run = lambda *_, **__: sys.exit(0)\n"
MAIN = "from neurotact.cli import main; main()"
START = 40.0
"""Seconds that the imports of a new process may take on a busy machine."""
MEMORY = 1_000_000_000
"""How many bytes a command may take with the processes that it starts."""
LARGEST_FILE = 2_000_000_000
INPUTS = (
    "touch.h5",
    "spikes.h5",
    "net",
    "chain",
    "causal.h5",
    "samples.csv",
    "spikes.nwb",
    "csv",
    "npz",
    "fabric",
    "presses",
    "cubes",
    "modality",
    "search",
    "study",
)
"""Valid inputs, which no command may change unless it works in them."""
INTERRUPTED = 130
AFTER_FIRST_LINE = 1.0
"""Seconds until Ctrl-C."""
LONGEST_LINE = 1000
"""Characters of an error line that a person still reads."""
PROGRESS = re.compile(r"[\w ,.&()/-]+ \d+/\d+(  .*)?")
SHARE = 0.95
"""Of the samples, events and trials of an input, at least so many are in the output, or the command says so."""
TELLS = re.compile(
    r"left out|drop|ignor|merg|repeat|resampl|interpolat|copies|outside|beyond|skip|not used|one spike|kept|share", re.I
)
"""Words of what was lost or doubled."""
FRAME = re.compile(r'File "[^"]*/(neurotact/[^"]+\.py)", line \d+,? in (\w+|<\w+>)')
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")


class Case(NamedTuple):
    """One command line in a folder of its own.

    kind: what is spoilt; words: after `neurotact`.
    changes: what lies there before and may be changed, as paths in the folder; anything else must stay as it is.
    resolve_only: a study is read and checked, and not run.
    results: where the command ends well, the table that must come out, by its path in the folder.
    out: what the command must have written where it ends well.
    endless: it may go on until Ctrl-C, which comes a second after its first line, or after half of its time.
    holds: how many samples, events and trials the input holds, and the total of its absolute values, as far as known:
    the output holds as much, or the command says why not.
    """

    kind: str
    words: list[str]
    changes: tuple[str, ...] = ()
    resolve_only: bool = False
    results: tuple[str, bytes] | None = None
    out: str | None = None
    endless: bool = False
    holds: Mapping[str, float] = {}


class Outcome(NamedTuple):
    """How a case went. fault: what is wrong in a few words, the same for the same cause; empty without a fault."""

    kind: str
    code: int
    seconds: float
    memory: int
    fault: str
    said: str


def run(case: Case, place: Path, seconds: float, *, wants_modules: bool = False, starts_anew: bool = False) -> Outcome:
    """Run a case in `place`, which holds its inputs; the streams are left beside it.

    wants_modules: also note what the command imported, for `modules_of`.
    starts_anew: the process starts Python again instead of using what this one has imported.
    """
    before = _contents(place)
    streams = [place.parent / f"{place.name}.{name}" for name in ("out", "err")]
    began = time.monotonic()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _become_the_command(case, place, streams, seconds, wants_modules, starts_anew)
    seconds += START if starts_anew else 0
    ended_by = _CtrlC(child, streams[0], began + seconds / 2) if case.endless else None
    code, memory, killed = _watch(child, began + seconds, ended_by)
    took = time.monotonic() - began
    said = _text(streams[1])
    fault = (
        killed
        or _fault_of_end(0 if code == INTERRUPTED and ended_by and ended_by.came else code, said)
        or _fault_of_memory(memory)
        or _fault_of_files(case, place, before, code)
        or (_fault_of_share(case, place, "".join(map(_text, streams))) if code == 0 else "")
    )
    if fault in ("too long", "too much memory"):
        fault = f"{fault}: {_frame(said)}"
    return Outcome(case.kind, code, took, memory, fault, said)


# --- in the forked process --------------------------------------------------------------------------


def modules_of(place: Path) -> list[str]:
    """What the commands that ran in `place` imported, in that order."""
    path = place.parent / f"{place.name}.modules"
    return list(dict.fromkeys(path.read_text().split()))


def _become_the_command(
    case: Case, place: Path, streams: Sequence[Path], seconds: float, wants_modules: bool, starts_anew: bool
) -> None:
    """Never returns."""
    code = 70
    try:
        os.setsid()
        os.chdir(place)
        for number, path in ((1, streams[0]), (2, streams[1])):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _give_up_rights()
        if starts_anew:
            resolve = RESOLVE_ONLY if case.resolve_only else ""
            words = [sys.executable, "-P", "-X", "faulthandler", "-c", f"{resolve}{MAIN}", *case.words]
            os.execve(sys.executable, list(map(os.fsencode, words)), {**os.environ, "PYTHONPATH": str(ROOT)})
        faulthandler.enable(sys.stderr)
        faulthandler.dump_traceback_later(seconds * 0.9, file=sys.stderr)
        faulthandler.register(signal.SIGUSR2, sys.stderr, all_threads=False)
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
        sys.argv = ["neurotact", *case.words]
        _fork_workers()
        if case.resolve_only:
            exec(RESOLVE_ONLY)
        from neurotact import cli

        warnings.resetwarnings()
        cli.main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    finally:
        if wants_modules:
            with open(place.parent / f"{place.name}.modules", "a") as file:
                file.writelines(f"{name}\n" for name in sys.modules)
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)


def _fork_workers() -> None:
    """Workers are forked from the command itself: they inherit the imports that another start takes seconds for."""
    contexts = multiprocessing.context._concrete_contexts  # type: ignore[attr-defined]
    contexts["spawn"] = contexts["forkserver"] = contexts["fork"]
    workers.beginning = lambda modules: nullcontext()  # no server, which would load every module again
    os.register_at_fork(after_in_child=lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL))  # as in a new process


def _give_up_rights() -> None:
    """As root: read and write only what the mode of a file allows, as any other user; also after a start of Python."""
    if os.geteuid() != 0:
        return
    version, rights = 0x20080522, (1, 2, 3)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH, CAP_FOWNER
    header = (ctypes.c_uint32 * 2)(version, 0)
    sets = (ctypes.c_uint32 * 6)()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.capget(header, sets)
    for right in rights:
        libc.prctl(24, right, 0, 0, 0)  # PR_CAPBSET_DROP
        for effective_or_permitted in (0, 1):
            sets[effective_or_permitted] &= ~(1 << right)
    libc.capset(header, sets)


# --- beside it --------------------------------------------------------------------------------------


class _CtrlC:
    """Ctrl-C for a command that goes on until then; came: whether it was sent."""

    def __init__(self, child: int, out: Path, latest: float) -> None:
        self.child, self.out, self.at, self.came = child, out, latest, False

    def look(self) -> None:
        """Send it when it is due, once."""
        now = time.monotonic()
        if self.out.is_file() and self.out.stat().st_size:
            self.at = min(self.at, now + AFTER_FIRST_LINE)
        if now >= self.at and not self.came:
            self.came = True
            os.kill(self.child, signal.SIGINT)


def _watch(child: int, deadline: float, ended_by: _CtrlC | None) -> tuple[int, int, str]:
    """Exit code, peak memory and, where it had to be killed, why."""
    peak, killed, at_start = 0, "", _resident(child)
    while True:
        pid, status, used = os.wait4(child, os.WNOHANG)
        if pid:
            break
        peak = max(peak, _resident(child) + sum(max(0, _resident(one) - at_start) for one in descendants(child)))
        if peak > MEMORY or time.monotonic() > deadline:
            killed = "too much memory" if peak > MEMORY else "too long"
            _kill(child, tell=peak > MEMORY)
            _, status, used = os.wait4(child, 0)
            break
        if ended_by:
            ended_by.look()
        time.sleep(0.005)
    _kill(child, tell=False)  # what it started and left behind
    return os.waitstatus_to_exitcode(status), max(peak, used.ru_maxrss * 1024), killed


def _kill(child: int, *, tell: bool) -> None:
    try:
        if tell:
            os.kill(child, signal.SIGUSR2)
            time.sleep(0.3)
        os.killpg(child, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, IndexError):
        return 0


def _fault_of_end(code: int, said: str) -> str:
    if "Traceback (most recent call last)" in said or "Fatal Python error" in said:
        return f"{_last_error(said)}: {_frame(said)}"
    if code not in (0, 2):
        return f"exit code {code}: {_frame(said)}"
    lines = [line for line in said.splitlines() if line.strip() and not PROGRESS.fullmatch(line)]
    foreign = [line for line in lines if not line.startswith("neurotact: ")]
    if code == 2 and foreign:
        return f"not a line of neurotact's: {_general(foreign[0])}"
    if code == 2 and not lines:
        return "exit code 2 without a word"
    if any(len(line) > LONGEST_LINE for line in lines):
        return f"a line of more than {LONGEST_LINE} characters: exit code {code}"
    if any(CONTROL.search(line) for line in lines):
        return f"control characters in a line: exit code {code}"
    return ""


def fault_of_control(forked: Outcome, control: Outcome) -> str:
    """What is wrong with a process that started anew, where the forked one did well, or how they differ."""
    if control.fault:
        return f"in a process that starts anew: {control.fault}"
    if forked.code != control.code:
        return f"exit code {forked.code} in a forked process, {control.code} in one that starts anew"
    told = [[line for line in one.said.splitlines() if line.startswith("neurotact: ")] for one in (forked, control)]
    return "" if forked.code == 0 or told[0][-1:] == told[1][-1:] else "a forked process says something else"


def _fault_of_memory(memory: int) -> str:
    return "too much memory" if memory > MEMORY else ""


def _fault_of_files(case: Case, place: Path, before: dict[str, str], code: int) -> str:
    after = _contents(place)
    left = [name for name in after if Path(name).name.startswith(".draft-") or Path(name).name == ".lock"]
    if set(left) - set(before):
        return f"left behind: {'a lock' if left[0].endswith('.lock') else 'a draft'}"
    free = [*case.changes, *(_replaced(case.words) if "--force" in case.words else ())]
    kept = [name for name in before if not any(name == one or name.startswith(f"{one}/") for one in free)]
    changed = [name for name in kept if after.get(name) != before[name]]
    if changed:
        return f"changed what was there: {re.sub(r'[0-9a-f]{8,}', 'N', Path(changed[0]).name)}"
    if code == 0 and case.out is not None and not os.path.lexists(place / case.out):
        return "exit code 0 without an output"
    if code == 0 and case.results is not None:
        name, expected = case.results
        if (place / name).read_bytes() != expected:
            return f"believed damage: {case.kind}"
    return ""


def _fault_of_share(case: Case, place: Path, said: str) -> str:
    """What the output has less or more of than the input, without a word about it."""
    if not case.holds or case.out is None or TELLS.search(said):
        return ""
    kept = _held(place / case.out)
    for what, n in case.holds.items():
        if what in kept and not SHARE * n <= kept[what] <= n / SHARE:
            return f"{'lost' if kept[what] < n else 'doubled'} {what} without a word: {case.kind}"
    return ""


def _held(path: Path) -> dict[str, float]:
    """The samples or events, the trials and the total of the absolute values in a file that an import wrote."""
    if hdf5.kind_of(path) == "spikes":
        trains = hdf5.load_spikes(path)
        return {"events": sum(map(len, trains.units)), "trials": len(trains)}
    recordings = hdf5.load_recordings(path)
    total = sum(float(np.abs(np.asarray(signal, float)).sum()) for signal in recordings.signals)
    return {"samples": int(recordings.lengths.sum()), "trials": len(recordings), "total": total}


def _text(stream: Path) -> str:
    return stream.read_bytes().decode("utf-8", "replace")


def _replaced(words: Sequence[str]) -> list[str]:
    """The outputs that --force may replace: those named as such, and by nothing else."""
    named = [word for option, word in pairwise(words) if option in ("-o", "--out")]
    return [word for word in named if words.count(word) == 1 and word not in INPUTS]


def _contents(place: Path) -> dict[str, str]:
    """What lies in a folder: of each path its kind and, of plain files, a hash of the content."""
    found = {}
    for folder, folders, names in os.walk(place):
        for name in (*folders, *names):
            path = Path(folder, name)
            key = os.fsencode(path.relative_to(place)).decode("utf-8", "backslashreplace")
            if path.is_symlink():
                found[key] = f"link {os.readlink(path)!r}"
            elif path.is_dir():
                found[key] = "folder"
            elif mutations.is_plain(path):
                found[key] = hashlib.sha256(path.read_bytes()).hexdigest()
            else:
                found[key] = "special"
    return found


def _frame(said: str) -> str:
    """The innermost function of neurotact that a traceback names."""
    newest_first = "most recent call first" in said
    tail = said[said.rfind("Traceback (most recent call last)") :] if "Traceback (most" in said else said
    ours = [f"{file} {function}" for file, function in FRAME.findall(tail)]
    if not ours:
        return "no frame of neurotact"
    return ours[0] if newest_first and "Traceback (most" not in said else ours[-1]


def _last_error(said: str) -> str:
    if "Fatal Python error" in said:
        return _general(said[said.index("Fatal Python error") :].splitlines()[0])
    lines = said[said.rfind("Traceback (most recent call last)") :].splitlines()
    errors = [line for line in lines[1:] if line and not line[0].isspace()]
    return _general(errors[0] if errors else "an error")


def _general(line: str) -> str:
    """A line without what differs from case to case."""
    line = re.sub(r"'[^']*'|\"[^\"]*\"|\([^)]*\)", "'...'", line)
    return re.sub(r"[\w./~-]*\d[\w./-]*", "N", line)[:100]


def clear(place: Path) -> None:
    """Remove a case's folder and its streams, whatever the modes in it."""
    for folder, _, _ in os.walk(place):
        os.chmod(folder, 0o700)
    shutil.rmtree(place, ignore_errors=True)
    for name in ("out", "err"):
        (place.parent / f"{place.name}.{name}").unlink(missing_ok=True)
