"""The cells of a run on the disk: what each left in `cells/<digest>`, whether it is whole, what it was made from."""

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
"""How long a cell took: the one file that differs from run to run, so that no manifest lists it."""
Files = dict[str, bytes]
"""What a cell leaves: the content of each file, by its path in the cell's folder."""


class AnyCell(Protocol):
    """A cell of any study, as far as its files are concerned."""

    def digest(self) -> str:
        """Of all that decides the cell's numbers: the name of its folder."""
        ...

    @property
    def given(self) -> str:
        """The file in a run folder that the cell works on."""
        ...


def write_cell(left: Files, cell: AnyCell, folder: Path) -> None:
    """Write what `run_cell` left into `folder/cells/<digest>`; its manifest, the last, says that the cell is done."""
    for name, content in sorted(left.items()):
        with whole(cell_folder(folder, cell) / name) as draft:
            draft.write_bytes(content)
    seal(folder, cell, left.keys() - {TIMING})


def seal(folder: Path, cell: AnyCell, names: Iterable[str]) -> None:
    """Mark a cell as done, which left these files."""
    manifest.seal(cell_folder(folder, cell), names, _made_from(folder, cell))


def is_done(folder: Path, cell: AnyCell) -> bool:
    """Whether the files of a cell are unchanged, and were made from the present spikes.

    Its result must be there; a report does without the network and the other files, as of a run that was made smaller.
    """
    return all(flaw == manifest.MISSING and name != RESULT for name, flaw in _flaws(folder, cell).items())


def damage(folder: Path, cell: AnyCell) -> str | None:
    """Why a cell that was done is no longer whole, in words; None where it is whole or was never done."""
    return next((f"{name} {flaw}" for name, flaw in _flaws(folder, cell).items() if flaw is not None), None)


def discard(folder: Path, cell: AnyCell) -> None:
    """Remove all that a cell left."""
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
    """A cell's own digest, and the SHA-256 of the file that it worked on."""
    given = folder / cell.given
    known = manifest.read(given.parent)
    return {"settings": cell.digest(), given.parent.name: known.files.get(given.name, "") if known else ""}


def result_of(folder: Path, cell: AnyCell) -> dict[str, Any]:
    """What a cell that is done left as its result."""
    return read_json(cell_folder(folder, cell) / RESULT)


def timing_of(folder: Path, cell: AnyCell) -> dict[str, float]:
    """Seconds that a cell took and, of a network, epochs; nothing where that was damaged, since no result needs it."""
    try:
        found = read_json(cell_folder(folder, cell) / TIMING)
    except InputError:
        return {}
    parts = ("seconds", "epochs")
    known: dict[str, Any] = {name: found.get(name) for name in parts} if isinstance(found, dict) else {}
    return {name: value for name, value in known.items() if type(value) in (int, float) and 0 <= value < math.inf}


def cell_folder(folder: Path, cell: AnyCell) -> Path:
    """The folder of what a cell leaves."""
    return folder / "cells" / cell.digest()
