"""The output of commands: tables for people or, as JSON, for programs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from neurotact.api import recordings as api
from neurotact.api.recordings import Recordings, SpikeTrains
from neurotact.cli.words import as_typed
from neurotact.lazily import lazily
from neurotact.tables import to_json

with lazily():
    import pandas as pd


PLAIN: Any = {"soft_wrap": True, "highlight": False, "markup": False, "emoji": False}
"""Text is printed as it is: a class may be called `[red]` or `:tada:`."""
console = Console(**PLAIN)
WIDEST = 10_000
"""Characters of a line in which no table is folded."""


def show(what: "str | pd.DataFrame") -> None:
    """Print what a function of `neurotact.api` tells: a line, in the words of the command line, or a table."""
    if isinstance(what, str):
        print(as_typed(what))
    else:
        print_table(what)


def save(data: Recordings | SpikeTrains, out: Path) -> None:
    """Save recordings or spike trains, in place of a file, and print a summary."""
    api.save(data, out, force=True)
    print(f"{out}: {data.summary()}")


def unless(as_json: bool) -> "Callable[[str | pd.DataFrame], None]":
    """`show`; with JSON, which is printed alone, nothing."""
    return (lambda what: None) if as_json else show


def print_json(table: "pd.DataFrame") -> None:
    """Print a table as a list of records."""
    print(to_json(table))


def print_table(frame: "pd.DataFrame", title: str | None = None, least_width: int = 0) -> None:
    """Print a table without rules, a row per row of `frame`; what is too wide is folded, first the names of columns.

    least_width: characters of a line that it may have where the terminal is narrower.
    """
    wide = Console(**PLAIN, width=max(console.width, least_width))
    table = _table(frame, title)
    if wide.measure(table, options=wide.options.update(max_width=WIDEST)).maximum > wide.width:
        table = _table(frame.rename(columns=lambda name: str(name).replace("_", "_\n")), title)
    wide.print(table)


def _table(frame: "pd.DataFrame", title: str | None) -> Table:
    table = Table(title=title, title_justify="left", box=None)
    for column in frame.columns:
        table.add_column(str(column), overflow="fold")
    for row in frame.itertuples(index=False):
        table.add_row(*map(_shown, row))
    return table


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
