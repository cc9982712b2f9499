"""The command line: it parses, calls and prints.

Other rooms take:

    __init__: main
"""

import logging
import os
import shlex
import sys
import warnings
from contextvars import copy_context
from io import TextIOWrapper

import typer

from neurotact import files
from neurotact.cli.commands import COMMANDS as COMMANDS
from neurotact.cli.commands import app
from neurotact.cli.meant import as_key
from neurotact.cli.pipe import until_its_reader_leaves
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED, InputError
from neurotact.interrupt import terminated_as_interrupted


@until_its_reader_leaves()
def main() -> None:
    """Run the command line; exit code 0, 2 for what the user got wrong, 1 for a fault of neurotact."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Said()])
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal may be unable to print µ
    warnings.showwarning = lambda message, *_: say(message)
    warnings.filterwarnings("ignore", ".*joblib will operate in serial mode")  # where no file may grow; it runs nothing
    try:
        for word in sys.argv[1:]:
            files.check_text(word)
        with terminated_as_interrupted():
            words = sys.argv[1:] or ["--help"]
            # What --quiet hides is hidden of this command alone, also where the process lives on.
            code = copy_context().run(app, words, prog_name="neurotact", standalone_mode=False)
    except InputError as error:
        say(error)
        sys.exit(2)
    except typer.TyperException as error:
        command = _command_of(error)
        meant = as_key(error, sys.argv[1:])
        said = f"{error.format_message().rstrip('.')}{meant}; see {command} --help"
        say(_import_of(sys.argv[1:], command) or said)
        sys.exit(2)
    if code == INTERRUPTED:  # Typer makes this of Ctrl-C
        say("interrupted")
    sys.exit(code or 0)


class _Said(logging.Handler):
    """Prints the log records of neurotact like its errors."""

    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


READS = {
    ".csv": "table", ".tsv": "table", ".txt": "table", ".npz": "arrays", ".npy": "arrays", ".mat": "arrays",
    ".h5": "arrays", ".hdf5": "arrays", ".nwb": "nwb",
}  # fmt: skip
"""The command of `import` for a file, by its suffix."""


def _import_of(words: list[str], command: str) -> str | None:
    """What to type in place of `neurotact import PATH`, which lacks the form of the recordings; None if it is not that.

    >>> _import_of(["import", "touches.csv"], "neurotact import")
    'touches.csv: say what it is: neurotact import table touches.csv --help'
    """
    given = next((word for word in words[1:] if not word.startswith("-")), "")
    is_path = os.path.exists(given) or "/" in given or os.path.splitext(given)[1] in READS
    if command != "neurotact import" or not given or not is_path:
        return None
    form = "folder" if os.path.isdir(given) or given.endswith("/") else READS.get(os.path.splitext(given)[1], "table")
    return f"{given}: say what it is: neurotact import {form} {shlex.quote(given)} --help"


def _command_of(error: typer.TyperException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "neurotact"
