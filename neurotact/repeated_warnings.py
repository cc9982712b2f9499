"""Warnings that are the same for many files, said once: how many there were, and the first of them."""

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

log = logging.getLogger("neurotact")
NUMBER = re.compile(r"\d+")


@contextmanager
def _said_once() -> Iterator[None]:
    """Hold the warnings of a block back, and say those of one kind, with other names and numbers, in one line.

    >>> import sys
    >>> log.addHandler(shown := logging.StreamHandler(sys.stdout))
    >>> with _said_once():
    ...     for name in ("a.csv", "b.csv", "c.csv"):
    ...         log.warning("%s: two rows are dropped", name)
    a.csv: two rows are dropped (and 2 more such lines)
    >>> log.removeHandler(shown)
    """
    held: dict[tuple[object, ...], list[logging.LogRecord]] = {}

    def hold(record: logging.LogRecord) -> bool:
        form, said = str(record.msg), record.args if isinstance(record.args, tuple) else ()
        kind = () if form.replace("%s", "").strip(": ") else said[1:] or said  # of "%s: %s" all words are arguments
        held.setdefault((form, *(NUMBER.sub("0", str(part)) for part in kind)), []).append(record)
        return False

    log.addFilter(hold)
    try:
        yield
    finally:
        log.removeFilter(hold)
        for first, *others in held.values():
            if others:
                first.msg, first.args = f"{first.getMessage()} (and {len(others)} more such lines)", None
            log.handle(first)


def in_few_lines(function: Callable[P, T]) -> Callable[P, T]:
    """A function whose warnings are `_said_once`."""

    @wraps(function)
    def quiet(*args: P.args, **kwargs: P.kwargs) -> T:
        with _said_once():
            return function(*args, **kwargs)

    return quiet
