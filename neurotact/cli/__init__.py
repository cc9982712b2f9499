"""The command line: it parses, calls and prints."""

import logging
import sys
import warnings
from contextvars import copy_context
from io import TextIOWrapper

import typer

from neurotact import files
from neurotact.cli.commands import COMMANDS as COMMANDS
from neurotact.cli.commands import app
from neurotact.cli.words import say
from neurotact.errors import INTERRUPTED, InputError
from neurotact.interrupt import terminated_as_interrupted


def main() -> None:
    """Run the command line; exit code 0, 2 for what the user got wrong, 1 for a fault of neurotact."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Said()])
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a terminal may be unable to print µ
    warnings.showwarning = lambda message, *_: say(message)
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
        say(f"{error.format_message().rstrip('.')}; see {_command_of(error)} --help")
        sys.exit(2)
    if code == INTERRUPTED:  # Typer makes this of Ctrl-C
        say("interrupted")
    sys.exit(code or 0)


class _Said(logging.Handler):
    """Prints the log records of neurotact like its errors."""

    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


def _command_of(error: typer.TyperException) -> str:
    context = getattr(error, "ctx", None)
    return context.command_path if context else "neurotact"
