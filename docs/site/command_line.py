"""The reference of the command line, as Typer writes it from the program."""

import re

from typer.cli import app
from typer.testing import CliRunner

WORDS = ["neurotact.cli", "utils", "docs", "--name", "neurotact"]


def page() -> str:
    """The reference in Markdown: all commands, each with its arguments and options."""
    done = CliRunner().invoke(app, WORDS, catch_exceptions=False)
    if done.exit_code:
        raise RuntimeError(f"typer {' '.join(WORDS)} failed:\n{done.output}")
    body = done.stdout.split("\n", 1)[1]  # its heading is the page's
    # Lists of commands, with lines cut short, of what follows as sections of their own.
    return re.sub(r"\*\*Commands\*\*:\n\n(?:\* .*\n)+\n?", "", body)
