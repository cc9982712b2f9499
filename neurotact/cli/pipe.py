"""Standard output whose reader may stop reading, as `head` does."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from io import BufferedWriter, FileIO, TextIOWrapper, UnsupportedOperation
from typing import Any


class _Output(FileIO):
    """The bytes of standard output; without a reader they end the command, with exit code 0.

    It raises no OSError, which whoever prints while a file is open would take for a fault of the file.
    """

    def write(self, content: Any, /) -> int:
        try:
            return super().write(content)
        except BrokenPipeError:
            with open(os.devnull, "wb") as nowhere:  # for what the buffers still hold
                os.dup2(nowhere.fileno(), self.fileno())
            sys.exit(0)


@contextmanager
def until_its_reader_leaves() -> Iterator[None]:
    """Within it, a command ends without a message when the reader of its output has closed the pipe.

    A command that has printed everything keeps its exit code.
    """
    out = sys.stdout
    try:
        raw: Any = _Output(out.fileno(), "wb", closefd=False)
    except UnsupportedOperation:  # a buffer, which has no reader
        yield
        return
    assert isinstance(out, TextIOWrapper)
    out.flush()
    buffer = raw if out.write_through else BufferedWriter(raw)
    how: Any = {"line_buffering": out.line_buffering, "write_through": out.write_through}
    with redirect_stdout(TextIOWrapper(buffer, out.encoding, out.errors, **how)):
        try:
            yield
        finally:
            with suppress(SystemExit):
                sys.stdout.flush()
