"""Worker processes that do jobs one after another, with one thread each.

On Linux they are forked from a server process that has loaded modules and done nothing else, so only it takes the
seconds that this needs; elsewhere each is spawned.
Their number changes only the run time. A process keeps its state between jobs (the caches of a module) until the block
is left. If a process dies, only its own job is lost, and that job starts again in a new process; InputError is raised
when this happens to a job too often, and when a process has loaded another neurotact than this one.
"""

import logging
import os
import signal
import subprocess
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, ExitStack, contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.context import BaseContext
from pathlib import Path
from threading import Thread
from typing import Any

import neurotact
from neurotact.backend import THREADS, native
from neurotact.errors import InputError
from neurotact.interrupt import deferred
from neurotact.progress import at, parts_of_workers, say

Task = Callable[[Any], Any]
Run = Callable[[Task, Sequence[Any]], Iterator[Any]]
"""`run(task, jobs)` yields each job's result, in the order of the jobs."""
RunAsDone = Callable[[Task, Sequence[Any]], Iterator[tuple[int, Any]]]
"""`run(task, jobs)` yields each job's place in `jobs` and its result, in the order of completion."""
ATTEMPTS = 3
DYING_S = 0.2
"""Seconds to wait for the end of a server of processes that was killed: until then no process can be started."""
ROOMS = ("neurotact.", "neurotact_parts.")
UNUSED = ("neurotact.api.", "neurotact.cli.")
"""Modules that no job calls, and which put off the loading of those that jobs do."""
_preloaded: list[str] = []
SAFE_PATH, PATH = "PYTHONSAFEPATH", "PYTHONPATH"
HINTS = {"SIGKILL": "if its memory ran out, use fewer processes", "SIGBUS": "if a disk of it is full, free some"}
"""What may be behind a signal that ended a process."""


@contextmanager
def pool(n_workers: int) -> Iterator[Run]:
    """Yield a `Run` in `n_workers` processes, which end when the block is left, however it is left."""
    with pool_as_done(n_workers) as run:

        def in_order(task: Task, jobs: Sequence[Any]) -> Iterator[Any]:
            early: dict[int, Any] = {}
            due = 0
            for number, result in run(task, jobs):
                early[number] = result
                while due in early:
                    yield early.pop(due)
                    due += 1

        yield in_order


@contextmanager
def pool_as_done(n_workers: int) -> Iterator[RunAsDone]:
    """As `pool`, for results in the order of completion."""
    started: list[ProcessPoolExecutor] = []
    context, parts = _context(), ExitStack()

    def start() -> ProcessPoolExecutor:
        # Pools of one: a process that dies breaks its pool.
        given = {**os.environ, THREADS: "1", **told}
        with _safe_path():  # a process that tracks its locks may start, too
            started.append(ProcessPoolExecutor(1, mp_context=context, initializer=_begin, initargs=(given,)))
        return started[-1]

    told = parts.enter_context(parts_of_workers())
    try:
        with _environment({THREADS: "1"}):
            idle: list[ProcessPoolExecutor] = [start() for _ in range(n_workers)]
            yield lambda task, jobs: _run(task, jobs, idle, start)
    except BaseException:
        for process in [process for one in started for process in _processes(one)]:
            process.terminate()
        raise
    finally:
        for one in started:
            one.shutdown(wait=True, cancel_futures=True)
        parts.close()


@contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    """Within it, these variables of the environment have these values."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _safe_path() -> Iterator[None]:
    """Processes that start within it find modules where this one does, but in the current folder last.

    Python looks for them there first in a process that `-c` starts, as it does in a notebook: a `signal.py` or a clone
    of neurotact would be imported in place of Python's own or of the installed one.
    """
    before, path = sys.path, _path()
    with _environment({SAFE_PATH: "1", PATH: os.pathsep.join(path)}):
        sys.path = path  # what the new process takes over
        try:
            yield
        finally:
            sys.path = before


def _path() -> list[str]:
    own, here = str(Path(neurotact.__file__).parents[1]), os.getcwd()
    is_script = hasattr(sys.modules["__main__"], "__file__")  # Python then puts the script's folder first
    last = [] if is_script else [entry for entry in sys.path if entry in ("", here)]
    return [*([own] if own == here else []), *(entry for entry in sys.path if entry not in last), *last]


def _context() -> BaseContext:
    """How processes start. None is forked from this one: a fork after an OpenMP call hangs."""
    if sys.platform != "linux":
        return get_context("spawn")
    context = get_context("forkserver")
    loaded = [name for name in sys.modules if name.startswith(ROOMS) and not name.startswith(UNUSED)]
    context.set_forkserver_preload([*loaded, *_preloaded, f"{neurotact.__name__}.loaded"])
    return context


def preload(modules: Sequence[str]) -> None:
    """Let processes that start from now on have these modules, too: they are loaded once, in the server."""
    _preloaded.extend(module for module in modules if module not in _preloaded)


@contextmanager
def beginning(modules: Sequence[str]) -> Iterator[None]:
    """Start the server of processes, which loads for seconds, beside what is done within; an error there ends it.

    modules: what is loaded in it, too. Where processes are spawned, nothing is started.
    """
    preload(modules)
    with ExitStack() as on_error:
        if sys.platform == "linux":
            from multiprocessing import forkserver

            server: Any = forkserver._forkserver
            if server._forkserver_pid is None:
                _context()
                with _safe_path(), _environment({THREADS: "1"}), _ignoring_interrupts():
                    server.ensure_running()
                # It would load on, and hold the pipes of this process.
                on_error.callback(lambda: os.kill(server._forkserver_pid, signal.SIGKILL))
        yield
        on_error.pop_all()


def in_a_process(task: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a worker process; its result."""
    with pool(1) as run:
        return next(run(_call, [(task, arguments)]))


def _call(job: tuple[Callable[..., Any], tuple]) -> Any:
    return job[0](*job[1])


def _run(
    task: Task, jobs: Sequence[Any], idle: list[ProcessPoolExecutor], start: Callable[[], ProcessPoolExecutor]
) -> Iterator[tuple[int, Any]]:
    """Give each idle process a job, and the next one when it has finished."""
    todo = deque((number, 1) for number in range(len(jobs)))
    running: dict[Future, tuple[ProcessPoolExecutor, int, int]] = {}

    def deal() -> None:
        while todo and idle:
            number, attempt = todo.popleft()
            with deferred(), _ignoring_interrupts():
                process, future = _submit(idle.pop(), start, (task, jobs[number], identity()))
            running[future] = process, number, attempt

    deal()
    while running:
        future = next(iter(wait(running, return_when=FIRST_COMPLETED).done))
        process, number, attempt = running.pop(future)
        died = isinstance(future.exception(), BrokenProcessPool)
        if died and attempt < ATTEMPTS:
            say("a worker process died; its job starts again in another")
            todo.appendleft((number, attempt + 1))
        if died and attempt == ATTEMPTS:
            raise _all_died(process)
        idle.append(start() if died else process)
        deal()
        if not died:
            yield number, future.result()


def _submit(
    process: ProcessPoolExecutor, start: Callable[[], ProcessPoolExecutor], job: tuple[Task, Any, dict[str, str]]
) -> tuple[ProcessPoolExecutor, Future]:
    """Give a process a job; a new one if it died while it was idle, or if the server of processes died."""
    for _ in range(ATTEMPTS):
        try:
            with _safe_path():
                return process, process.submit(_do, job)
        except (BrokenProcessPool, EOFError, ConnectionError):
            time.sleep(DYING_S)
            died, process = process, start()
    raise _all_died(died)


def _do(job: tuple[Task, Any, dict[str, str]]) -> Any:
    """In a worker process: do a job, unless its numbers might differ from those of the parent."""
    task, what, expected = job
    here = identity()
    differing = [name for name in expected if here.get(name) != expected[name]]
    if differing:
        name = differing[0]
        raise InputError(
            f"worker processes: {name} is {here.get(name)} there and {expected[name]} here; leave one neurotact on "
            "Python's path and start again"
        )
    try:
        return task(what)
    except SystemExit as error:  # of another package's code: it would end the parent without a word
        raise RuntimeError(f"a job asked its process to end (SystemExit: {error})") from error
    finally:
        at("")


def identity() -> dict[str, str]:
    """Which neurotact this process has loaded, and with which kernels."""
    return {
        "neurotact": str(neurotact.__file__),
        "its version": neurotact.__version__,
        "its compiled kernels": "none" if native is None else str(native.__file__),
    }


def _processes(pool: ProcessPoolExecutor) -> list[Any]:
    return list((pool._processes or {}).values())


def _all_died(pool: ProcessPoolExecutor) -> InputError:
    """The error for a job that ended every process, with what was seen of the end of the last one."""
    processes = _processes(pool)
    pool.shutdown(wait=True)
    code = processes[0].exitcode if processes else None
    about = f"{ATTEMPTS} worker processes"
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = HINTS.get(name, "look for the cause in the log of the system")
        return InputError(f"{about} were killed at the same job (signal {-code}, {name}) on this machine; {hint}")
    fault = _fault_of_a_start()
    if fault:
        return InputError(f"{about} could not start: {fault}; mend what Python imports there")
    ended = "lost their server" if code is None else f"ended with code {code}"
    return InputError(f"{about} {ended} at the same job; what they printed says why")


def _fault_of_a_start() -> str:
    """The error of a new process that loads what worker processes do; empty if there is none."""
    with _safe_path():
        words = [sys.executable, "-c", f"import {__name__}"]
        done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"code {done.returncode}"])[-1]


def one_thread() -> AbstractContextManager[None]:
    """Within it torch uses one thread, as worker processes do, so that results are the same to the last bit."""
    return threads(1)


@contextmanager
def threads(n: int) -> Iterator[None]:
    """Within it torch uses `n` threads."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _begin(environment: dict[str, str]) -> None:
    """In a new process: take over the environment of the parent, which may be newer than the server's, and settle."""
    os.environ.clear()
    os.environ.update(environment)
    _settle()


def _settle() -> None:
    """In a new process: use one thread, leave Ctrl-C to the parent process, and end when the parent ends.

    Warnings and log records are printed in one line, as in the parent.
    """
    import torch

    torch.set_num_threads(1)
    warnings.showwarning = lambda message, *_: say(message)
    logging.basicConfig(level=logging.WARNING, format="neurotact: %(message)s")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    Thread(target=_end_with_parent, daemon=True).start()


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Processes that start within it ignore Ctrl-C until they `_settle`: they load modules for seconds.

    Signals to this process wait until the block is left.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
