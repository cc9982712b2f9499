"""Ctrl-C while modules load."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from neurotact.errors import INTERRUPTED

LINE = "neurotact: interrupted\n"


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Ctrl-C within it ends the process in one line: nothing has begun.

    An exception would be taken for a failed import by some module. Where Ctrl-C is ignored, as under nohup, or handled
    by somebody else, it stays so.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)
