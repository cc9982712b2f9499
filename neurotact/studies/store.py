"""The cells of a run on the disk: their files in `cells/<digest>`, with checks of these files and their sources."""

import math
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

from neurotact.errors import InputError
from neurotact.files import read_json, whole
from neurotact.studies import manifest

RESULT = "result.json"
TIMING = "timing.json"
"""The time of a cell: the only file that differs from run to run; no manifest lists it."""
Files = dict[str, bytes]
"""The files of a cell: the content of each, by its path in the cell's folder."""


class AnyCell(Protocol):
    """A cell of any study, with what its files require."""

    def digest(self) -> str:
        """The digest of everything that decides the cell's numbers: the name of its folder."""
        ...

    @property
    def given(self) -> str:
        """The input file of the cell in a run folder."""
        ...


def write_cell(left: Files, cell: AnyCell, folder: Path) -> None:
    """Write the files of `run_cell` into `folder/cells/<digest>`, then the manifest, which marks the cell as done."""
    for name, content in sorted(left.items()):
        with whole(cell_folder(folder, cell) / name) as draft:
            draft.write_bytes(content)
    seal(folder, cell, left.keys() - {TIMING})


def seal(folder: Path, cell: AnyCell, names: Iterable[str]) -> None:
    """Mark a cell with these files as done."""
    manifest.seal(cell_folder(folder, cell), names, _made_from(folder, cell))


def is_done(folder: Path, cell: AnyCell) -> bool:
    """Whether the files of a cell are unchanged, and were made from the present spikes.

    Its result must exist; a report does not require the network and the other files, which a user may remove.
    """
    return all(flaw == manifest.MISSING and name != RESULT for name, flaw in _flaws(folder, cell).items())


def damage(folder: Path, cell: AnyCell) -> str | None:
    """Why a finished cell is damaged, in words; None if it is not damaged or was never finished."""
    return next((f"{name} {flaw}" for name, flaw in _flaws(folder, cell).items() if flaw is not None), None)


def discard(folder: Path, cell: AnyCell) -> None:
    """Remove all files of a cell."""
    place = cell_folder(folder, cell)
    try:
        shutil.rmtree(place)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{place}: is damaged and cannot be removed ({reason}); remove it") from error


def _flaws(folder: Path, cell: AnyCell) -> manifest.Flaws:
    place = cell_folder(folder, cell)
    known = manifest.read(place)
    names = dict.fromkeys([RESULT, *(known.files if known else ())])
    return manifest.flaws(place, names, _made_from(folder, cell))


def _made_from(folder: Path, cell: AnyCell) -> dict[str, str]:
    """A cell's own digest, and the SHA-256 of its input file."""
    given = folder / cell.given
    known = manifest.read(given.parent)
    return {"settings": cell.digest(), given.parent.name: known.files.get(given.name, "") if known else ""}


def result_of(folder: Path, cell: AnyCell) -> dict[str, Any]:
    """The result of a finished cell."""
    return read_json(cell_folder(folder, cell) / RESULT)


def timing_of(folder: Path, cell: AnyCell) -> dict[str, float]:
    """The seconds of a cell and, for a network, its epochs; empty if the file is damaged, since no result needs it."""
    try:
        found = read_json(cell_folder(folder, cell) / TIMING)
    except InputError:
        return {}
    parts = ("seconds", "epochs")
    known: dict[str, Any] = {name: found.get(name) for name in parts} if isinstance(found, dict) else {}
    return {name: value for name, value in known.items() if type(value) in (int, float) and 0 <= value < math.inf}


def cell_folder(folder: Path, cell: AnyCell) -> Path:
    """The folder of a cell's files."""
    return folder / "cells" / cell.digest()
