"""The command that downloads public tactile data sets."""

from pathlib import Path
from typing import Annotated, Any

import typer

from neurotact.api import recordings as api
from neurotact.cli.options import calling, option
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
