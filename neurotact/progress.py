"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Advance = Callable[[int, str], None]
SECONDS_BETWEEN_LINES = 10.0


@contextmanager
def track(what: str, total: int) -> Iterator[Advance]:
    """Yield `advance(n, note)`, to be called when `n` more of `total` are done; writes to stderr.

    >>> with track("encode", 2) as advance:
    ...     advance(1, "trial 1")
    ...     advance(1, "trial 2")
    """
    if sys.stderr.isatty():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        left = (TimeRemainingColumn(), TextColumn("{task.fields[note]}"))
        with Progress(*columns, *left, console=Console(stderr=True)) as bar:
            task = bar.add_task(what, total=total, note="")
            yield lambda n, note: bar.update(task, advance=n, note=note)
        return
    done, last = 0, time.monotonic()

    def advance(n: int, note: str) -> None:
        nonlocal done, last
        done += n
        now = time.monotonic()
        if done >= total or now - last >= SECONDS_BETWEEN_LINES:
            last = now
            print(f"{what} {done}/{total}{f'  {note}' if note else ''}", file=sys.stderr, flush=True)

    yield advance


def silent(n: int, note: str) -> None:
    """An `Advance` that says nothing."""
