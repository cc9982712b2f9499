"""The reference of the command line, as Typer writes it from the program."""

import re
import subprocess
import sys

TYPER = [sys.executable, "-W", "ignore", "-m", "typer", "neurotact.cli", "utils", "docs", "--name", "neurotact"]


def page() -> str:
    """The reference in Markdown: all commands, each with its arguments and options."""
    done = subprocess.run(TYPER, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(TYPER)} failed:\n{done.stderr}")
    body = done.stdout.split("\n", 1)[1]  # its heading is the page's
    # Lists of commands, with lines cut short, of what follows as sections of their own.
    return re.sub(r"\*\*Commands\*\*:\n\n(?:\* .*\n)+\n?", "", body)
