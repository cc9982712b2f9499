"""The commands that download a public data set, and describe a file: fetch, info."""

from pathlib import Path
from typing import Annotated, Any

import typer

from neurotact.api import recordings as api
from neurotact.cli.options import calling, flag, option
from neurotact.cli.output import show


@calling(
    api.fetch,
    name=Annotated[str | None, typer.Argument(help="Name of the set; without it the sets are listed.")],
    out=option(Path | None, "The folder to download to.", "-o", "--out", show_default="its name in $NEUROTACT_DATA"),
)
def fetch(given: dict[str, Any]) -> None:
    """Download a public tactile data set.

    Its licence, size and citation are shown first. Files that exist are not downloaded again. If a set cannot be
    downloaded, the manual steps are printed.
    """
    api.fetch(**given, show=show)


@calling(
    api.describe,
    file=Annotated[Path, typer.Argument(help="An HDF5 file of recordings or spikes.")],
    all=flag("--all", f"Print a row for each taxel of more than {api.MOST_TAXELS} too."),
)
def info(given: dict[str, Any]) -> None:
    """Describe the content of a file of recordings or spikes.

    Prints its classes, conditions and marks in time, the length and the rate of its trials, when the touch begins, and
    the range of each taxel or the rate of each population. Use it after an import: it shows a wrong unit, a dead taxel,
    a clock column among the taxels, copies of a trial, or a class with two names.
    """
    api.describe(**given, show=show)
