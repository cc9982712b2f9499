"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from neurotact.interrupt import stop_if_asked

Advance = Callable[[int, str], None]
Tell = Callable[[Any], object]
"""Called with what the command of a function prints, a text or a table at a time; `print` is one."""
SECONDS_BETWEEN_LINES = 10.0
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
    if not _shown.get():
        yield _stoppable(silent)
        return
    if sys.stderr.isatty():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        bound = (TextColumn("at most"),) if at_most else ()
        left = (*bound, TimeRemainingColumn(), TextColumn("{task.fields[note]}"))
        with Progress(*columns, *left, console=Console(stderr=True)) as bar:
            task = bar.add_task(what, total=total, completed=done, note="")
            yield _stoppable(lambda n, note: bar.update(task, advance=n, note=note))
        return
    began = last = time.monotonic()
    before = done

    def advance(n: int, note: str) -> None:
        nonlocal done, last
        done += n
        now = time.monotonic()
        if done >= total or now - last >= SECONDS_BETWEEN_LINES:
            last = now
            known = before < done < total and (at_most or not note)
            left = time_left((now - began) / (done - before) * (total - done)) if known else ""
            shown = ", ".join(filter(None, (note, f"at most {left}" if left and at_most else left)))
            print(f"{what} {done}/{total}{f'  {shown}' if shown else ''}", file=sys.stderr, flush=True)

    yield _stoppable(advance)


def _stoppable(advance: Advance) -> Advance:
    def stopping(n: int, note: str) -> None:
        advance(n, note)
        stop_if_asked()

    return stopping


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
