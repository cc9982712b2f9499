"""The commands that show and copy the specs that ship."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from neurotact import files, spec
from neurotact.api import specs
from neurotact.cli.options import Force
from neurotact.errors import InputError, nearest

console = Console(soft_wrap=True, highlight=False)


def list_specs() -> None:
    """List the specs that ship, and other packages' parts: encoders, networks, search spaces, studies, price lists."""
    for kind in spec.KINDS:
        table = Table("name", "about", title=kind, title_justify="left", box=None)
        for path in spec.shipped(kind):
            table.add_row(path.stem, path.read_text(encoding="utf-8").splitlines()[0].lstrip("# "))
        for name, package in specs.of_other_packages(kind).items():
            table.add_row(name, f"Of the package {package}.")
        console.print(table)


def show(name: Annotated[str, typer.Argument(help="Name or path of a spec.")]) -> None:
    """Print a spec, with the comments that give its sources."""
    print(spec.text(_find_any(name)), end="")


def copy(
    name: Annotated[str, typer.Argument(help="Name of a spec.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The file; NAME.toml here when absent.")] = None,
    force: Force = False,
) -> None:
    """Copy a spec to this folder, to edit it and pass its path."""
    source = _find_any(name)
    target = out or Path(source.name)
    files.check_new(target, force=force, inputs=[source])
    files.write_text(target, spec.text(source))
    print(target)


def _find_any(name: str) -> Path:
    """A spec of any kind; a name that several kinds have is refused."""
    if name.endswith(".toml") or "/" in name:
        return files.existing(name)
    known = [path for kind in spec.KINDS for path in spec.shipped(kind)]
    paths = [path for path in known if path.stem == name]
    if not paths:
        for package in (specs.of_other_packages(kind).get(name) for kind in spec.KINDS):
            if package is not None:
                raise InputError(f"{name}: is Python of the package {package}, not a spec; its keys stand there")
        raise InputError(f"{name}: there is no such spec; {nearest(name, [path.stem for path in known])}")
    return paths[0]
