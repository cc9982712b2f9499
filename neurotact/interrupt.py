"""Ctrl-C while modules load, and the end of a time limit while something runs."""

import os
import signal
import threading
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


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Within it SIGTERM, which comes at the end of a time limit, is what Ctrl-C is; a second one is ignored.

    Python drops an exception that a signal raises in a callback of its own, such as a weak reference's. Long work
    therefore calls `stop_if_asked` between its steps.
    """
    if threading.current_thread() is not threading.main_thread():  # signals are not its own
        yield
        return

    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt where SIGTERM has come within `terminated_as_interrupted`."""
    if signal.getsignal(signal.SIGTERM) is _ignore:
        raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, _ignore)
    raise KeyboardInterrupt


def _ignore(number: int, frame: FrameType | None) -> None:
    """What SIGTERM does from the second one on."""


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)
