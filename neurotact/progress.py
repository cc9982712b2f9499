"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from neurotact.interrupt import stop_if_asked

Advance = Callable[[int, str], None]
Watcher = Callable[[str, int, int, str], None]
"""Called with what is done, how much of how much, and at which parts worker processes are."""
Tell = Callable[[Any], object]
"""Called with what the command of a function prints, a text or a table at a time; `print` is one."""
SECONDS_BETWEEN_LINES = 10.0
PARTS, SECONDS_BETWEEN_PARTS = "NEUROTACT_PARTS", 1.0
"""Names in the environment of worker processes the folder in which each says at which part of its job it is."""
_shown = ContextVar("shown", default=True)


def untold(_what: Any) -> None:
    """A `Tell` that prints nothing."""


def show(is_shown: bool) -> None:
    """Set whether `track` writes anything from here on."""
    _shown.set(is_shown)


@contextmanager
def track(what: str, total: int, *, done: int = 0, at_most: bool = False) -> Iterator[Advance]:
    """Yield `advance(n, note)`, to be called when `n` more of `total` are done; writes to stderr.

    done: how many were done by the run that this one continues; the estimate of the time left ignores them.
    at_most: the work may end before the total is reached; the time left is shown beside a note, as an upper bound.
    Each call also stops the work if the end of a time limit asks for it (`interrupt.stop_if_asked`).

    >>> with track("encode", 2) as advance:
    ...     advance(1, "trial 1")
    ...     advance(1, "trial 2")
    """
    told = _Told(what, done, total)
    shown = _bar if sys.stderr.isatty() else _lines
    with shown(told, at_most) if _shown.get() else _hidden(told) as advance:
        yield told.counting(advance)


class _Told:
    """What `track` shows, and tells its watchers."""

    def __init__(self, what: str, done: int, total: int) -> None:
        self.what, self.done, self.total = what, done, total

    def counting(self, advance: Advance) -> Advance:
        """An `Advance` that counts, too, and stops where the end of a time limit asks for it."""

        def counting(n: int, note: str) -> None:
            self.done += n
            advance(n, note)
            stop_if_asked()

        return counting

    def parts(self, parts: str) -> None:
        """Tell the watchers at which parts worker processes are."""
        for watcher in [*_watchers]:
            try:
                watcher(self.what, self.done, self.total, parts)
            except Exception as error:  # what is shown stops no work
                _watchers.remove(watcher)
                say(f"progress is told no more: {error}")


@contextmanager
def _hidden(told: _Told) -> Iterator[Advance]:
    with _watching(told.parts):
        yield silent


@contextmanager
def _bar(told: _Told, at_most: bool) -> Iterator[Advance]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bound = (TextColumn("at most"),) if at_most else ()
    left = (*bound, TimeRemainingColumn(), TextColumn("{task.fields[note]} {task.fields[parts]}"))
    with Progress(*columns, *left, console=Console(stderr=True)) as bar:
        task = bar.add_task(told.what, total=told.total, completed=told.done, note="", parts="")
        with _watching(told.parts, lambda parts: bar.update(task, parts=parts)):
            yield lambda n, note: bar.update(task, advance=n, note=note)


@contextmanager
def _lines(told: _Told, at_most: bool) -> Iterator[Advance]:
    began = last = time.monotonic()
    before, spoken = told.done, began - SECONDS_BETWEEN_LINES

    def line(shown: str) -> None:
        print(f"{told.what} {told.done}/{told.total}{f'  {shown}' if shown else ''}", file=sys.stderr, flush=True)

    def advance(_: int, note: str) -> None:
        nonlocal last
        now = time.monotonic()
        if told.done >= told.total or now - last >= SECONDS_BETWEEN_LINES:
            last = now
            known = before < told.done < told.total and (at_most or not note)
            left = time_left((now - began) / (told.done - before) * (told.total - told.done)) if known else ""
            line(", ".join(filter(None, (note, f"at most {left}" if left and at_most else left))))

    def parted(parts: str) -> None:
        nonlocal spoken
        if parts and time.monotonic() - spoken >= SECONDS_BETWEEN_LINES:
            spoken = time.monotonic()
            line(parts)

    with _watching(told.parts, parted):
        yield advance


@contextmanager
def parts_of_workers() -> Iterator[dict[str, str]]:
    """Within it `track` also shows what worker processes are at; yields what their environment needs for that."""
    with TemporaryDirectory(prefix="neurotact-", ignore_cleanup_errors=True) as folder:
        _folders.append(Path(folder))
        try:
            yield {PARTS: folder}
        finally:
            _folders.remove(Path(folder))


@contextmanager
def watched(watcher: Watcher) -> Iterator[None]:
    """Within it `track` also tells a watcher, shown or not: after two seconds, then every second.

    A watcher that fails is not called again, and the work goes on.
    """
    _watchers.append(watcher)
    try:
        yield
    finally:
        if watcher in _watchers:
            _watchers.remove(watcher)


_folders: list[Path] = []
_watchers: list[Watcher] = []


@contextmanager
def _watching(*shown: Callable[[str], None]) -> Iterator[None]:
    """Call each with what worker processes are at: after two seconds, then every second, as long as this lasts."""
    ended = Event()

    def watch() -> None:
        wait_s = 2 * SECONDS_BETWEEN_PARTS
        while not ended.wait(wait_s):
            wait_s = SECONDS_BETWEEN_PARTS
            paths = sorted(path for folder in _folders for path in folder.glob("*.txt"))
            parts = "; ".join(filter(None, map(_content, paths)))
            for each in shown:
                each(parts)

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def _content(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:  # its worker has just ended the part
        return ""


class _At:
    """What this process is at; `began` and `first` are of the present part."""

    what, done, first, began, last = "", 0, 0, 0.0, 0.0


def at(what: str, done: int = 0, total: int = 0, note: str = "") -> None:
    """In a worker process: tell the one that waits for it at which part of its job it is, at most once a second.

    An empty `what` ends the part, and one without a `total` is shown without a number. Elsewhere this does nothing.
    """
    folder, now = os.environ.get(PARTS), time.monotonic()
    if folder is None:
        return
    is_new = what != _At.what or done < _At.done
    if is_new:
        _At.what, _At.first, _At.began = what, done, now
    _At.done = done
    if not is_new and now - _At.last < SECONDS_BETWEEN_PARTS:
        return
    _At.last = now
    path = Path(folder, f"{os.getpid()}.txt")
    with suppress(OSError):  # progress that cannot be told stops no work
        if not what:
            path.unlink(missing_ok=True)
            return
        known = _At.first < done < total
        left = f", {time_left((now - _At.began) / (done - _At.first) * (total - done))}" if known else ""
        draft = path.with_suffix(".new")
        draft.write_text(f"{what} {done}/{total}{note}{left}" if total else what, encoding="utf-8")
        draft.replace(path)


def counting(what: str, total: int) -> Callable[..., None]:
    """An `Advance` of a part of a job in a worker process (`at`)."""
    done = 0

    def advance(n: int, note: str = "") -> None:
        nonlocal done
        done += n
        at(what, done, total)

    at(what, 0, total)
    return advance


def time_left(seconds: float) -> str:
    """The time left, in words.

    >>> time_left(12.4), time_left(720.0), time_left(9000.0)
    ('12 s left', '12 min left', '2.5 h left')
    """
    if seconds >= 5400:
        return f"{seconds / 3600:.1f} h left"
    return f"{seconds / 60:.0f} min left" if seconds >= 90 else f"{seconds:.0f} s left"


@contextmanager
def tracked(what: str) -> Iterator[Callable[[int, int], None]]:
    """As `track`, of work that says how much it is: yield `progress(done, total)`.

    >>> with tracked("simulate") as progress:
    ...     progress(1, 2)
    ...     progress(2, 2)
    """
    with ExitStack() as stack:
        advance, before = None, 0

        def progress(done: int, total: int) -> None:
            nonlocal advance, before
            advance = advance or stack.enter_context(track(what, total))
            advance(done - before, "")
            before = done

        yield progress


def silent(n: int, note: str) -> None:
    """An `Advance` that prints nothing."""


LONGEST_LINE = 500
"""Characters of a readable line; the middle is cut out, since the end says what to do."""


def say(what: object) -> None:
    """Print one line on stderr, shortened to a readable length; control characters are written as escapes."""
    line = " ".join(str(what).split())
    if len(line) > LONGEST_LINE:
        half = LONGEST_LINE // 2
        line = f"{line[:half]} ... {line[-half:]}"
    print(f"neurotact: {printable(line)}", file=sys.stderr)


def printable(text: str) -> str:
    """A text with escapes for characters that are not printable: of control, and halves of surrogate pairs.

    >>> printable("a\\nb")
    'a\\\\nb'
    """
    return "".join(character if character.isprintable() else f"{character!a}"[1:-1] for character in text)
