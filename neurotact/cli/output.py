"""The output of commands: tables for people or, as JSON, for programs."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from neurotact.data import hdf5
from neurotact.data.recordings import Recordings

console = Console(soft_wrap=True, highlight=False)


def save_recordings(recordings: Recordings, out: Path) -> None:
    """Save recordings and print a summary."""
    hdf5.save_recordings(recordings, out)
    print(f"{out}: {recordings.summary()}")


def print_line(line: str | None) -> None:
    """Print a line, if there is one."""
    if line:
        print(line)


def print_table(frame: pd.DataFrame, title: str | None = None, least_width: int = 0) -> None:
    """Print a table without rules, a row per row of `frame`.

    least_width: characters of a line that it may have where the terminal is narrower.
    """
    table = Table(*map(str, frame.columns), title=title, title_justify="left", box=None)
    for row in frame.itertuples(index=False):
        table.add_row(*map(_shown, row))
    wide = Console(soft_wrap=True, highlight=False, width=max(console.width, least_width))
    wide.print(table)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
