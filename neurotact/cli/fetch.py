"""The command that downloads public tactile data sets."""

from pathlib import Path
from typing import Annotated

import typer

from neurotact import effects
from neurotact.data import fetch as public
from neurotact.data.sources import expand
from neurotact.progress import track


def fetch(
    name: Annotated[str | None, typer.Argument(help="Name of the set; without it the sets are listed.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The folder to download to.", show_default="its name in $NEUROTACT_DATA"),
    ] = None,
) -> None:
    """Download a public tactile data set.

    Its licence, size and citation are shown first. Files that exist are not downloaded again. If a set cannot be
    downloaded, the manual steps are printed.
    """
    effects.check(out=out, name=name)
    if name is None:
        for each, about in public.SETS.items():
            print(f"{each}: {about.about}")
        return
    about = public.public_set(name)
    folder = out or expand(f"$NEUROTACT_DATA/{name}")
    facts = {"licence": about.licence, "size": about.size, "cite": about.citation, "page": about.page}
    print("\n".join([f"{name}: {about.about}", *(f"{what}: {fact}" for what, fact in facts.items())]))
    wanted = public.missing(name, folder)
    with track("fetch", max(1, len(wanted))) as advance:
        n_files = public.fetch(name, folder, advance)
    n_there = len(public.registry_of(name)) - n_files
    print(f"{folder}: {n_files} files downloaded, {n_there} existed; neurotact import {about.reader} reads them")
