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
    """Within it, Ctrl-C ends the process with one line: no work has started yet.

    Some modules would take an exception for a failed import. If Ctrl-C is already ignored, as under nohup, or handled
    elsewhere, that stays.
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
    """Within it, SIGTERM (the end of a time limit) acts as Ctrl-C; a second one is ignored.

    It also stops a background job, to which a shell that is not interactive sends no Ctrl-C. If SIGTERM is ignored
    already, that stays.

    Python drops an exception that a signal raises inside some callbacks, such as a weak reference's. So long work calls
    `stop_if_asked` between its steps.
    """
    is_main = threading.current_thread() is threading.main_thread()  # which alone handles signals
    if not is_main or signal.getsignal(signal.SIGTERM) in (signal.SIG_IGN, None):
        yield
        return

    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def deferred() -> Iterator[None]:
    """Within it, Ctrl-C and SIGTERM wait until the block is left.

    For steps that must not be left halfway, such as the start of a process that must be ended later. A blocked signal
    does not wait where another thread takes it: Python's handler then runs in this one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[tuple[int, FrameType | None]] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in handlers:
        signal.signal(number, lambda number, frame: arrived.append((number, frame)))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in arrived[:1]:
            handlers[signal.Signals(number)](number, frame)


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt if SIGTERM has arrived within `terminated_as_interrupted`."""
    if signal.getsignal(signal.SIGTERM) is _ignore:
        raise KeyboardInterrupt


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, _ignore)
    raise KeyboardInterrupt


def _ignore(number: int, frame: FrameType | None) -> None:
    """The SIGTERM handler from the second signal on."""


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, LINE.encode())
    os._exit(INTERRUPTED)
