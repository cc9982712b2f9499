"""The cells of a protocol study: the arrays that they share on the disk, and the files of each."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from neurotact.data.sources import expand
from neurotact.errors import InputError
from neurotact.files import existing, whole, write_json
from neurotact.studies import manifest
from neurotact.studies.preparation import DATA, check_files
from neurotact.studies.protocol import Arrays, module_of
from neurotact.studies.protocol_study import ProtocolCell
from neurotact.studies.store import RESULT, TIMING, Files


def arrays_path(folder: Path, cell: ProtocolCell) -> Path:
    """The file of the arrays that a cell shares with others."""
    return folder / cell.given


def prepare(folder: Path, cells: Iterable[ProtocolCell]) -> None:
    """Write missing and damaged arrays that cells share, and their hashes into data.json.

    Raises InputError if their recordings changed since the study started.
    """
    place = folder / "data"
    distinct = {cell.data_name: cell for cell in cells}
    data_flaws = manifest.flaws(folder, [DATA])
    flaws = manifest.flaws(place, [f"{name}.npz" for name in distinct])
    known = manifest.sound_json(folder, DATA) or {}
    manifest.say_flaws("", data_flaws, "written again")
    manifest.say_flaws(f"{place.name}/", flaws, "written again")
    for name, cell in distinct.items():
        before, sources = known.get(name), _sources(cell)
        if before is not None and f"{name}.npz" not in flaws and _are_same(before.get("sources", {}), sources):
            continue
        arrays = module_of(cell.protocol).load(cell.built().data)
        found = {"sha256": _hash(arrays), "arrays": {key: list(value.shape) for key, value in arrays.items()}}
        if before is not None and {key: before[key] for key in found} != found:
            raise InputError(f"{folder}: the recordings changed since this study began; run it in another folder")
        known[name] = found | ({"sources": sources} if sources else {})
        write_json(folder / DATA, known)
        manifest.seal(folder, [DATA])
        with whole(arrays_path(folder, cell)) as draft:
            np.savez(draft, allow_pickle=False, **arrays)
        manifest.seal(place, [f"{name}.npz"])


def check(folder: Path, cells: Iterable[ProtocolCell]) -> None:
    """Raise InputError if the arrays of the cells of a run folder were changed."""
    check_files(folder, [DATA, *dict.fromkeys(cell.given for cell in cells)])


def _sources(cell: ProtocolCell) -> dict[str, str]:
    """The fingerprint of each file or folder from which the cell's arrays may be read."""
    found = {path: manifest.fingerprint(expand(path)) for path in _paths(cell.parameters["data"])}
    return {path: sha256 for path, sha256 in sorted(found.items()) if sha256 is not None}


def _are_same(before: Mapping[str, str], now: Mapping[str, str]) -> bool:
    """Whether the sources are unchanged; a source that no longer exists is ignored, since it was already read."""
    return all(before.get(path) == sha256 for path, sha256 in now.items())


def _paths(table: Mapping[str, Any]) -> Iterator[str]:
    """The value of every key `path`, in this table and in nested ones."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _paths(value)
        elif key == "path" and isinstance(value, str):
            yield value


def load_arrays(path: Path) -> Arrays:
    """The arrays that `prepare` wrote."""
    with np.load(existing(path), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def run_cell(cell: ProtocolCell, arrays: Arrays, kept: Path | None = None) -> Files:
    """Run a cell; returns its files. It reads only its arguments and writes nothing; `kept` is not used."""
    began = perf_counter()
    rows = [_plain(row) for row in module_of(cell.protocol).run(cell.built(), arrays)]
    result = json.dumps({"rows": rows}, indent=1)
    timing = json.dumps({"seconds": perf_counter() - began})
    return {RESULT: result.encode(), TIMING: timing.encode()}


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """A row with plain values for JSON; a missing number is null."""
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()}
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in plain.items()}


def _hash(arrays: Arrays) -> str:
    content = hashlib.sha256()
    for name in sorted(arrays):
        content.update(name.encode())
        content.update(np.ascontiguousarray(arrays[name]).tobytes())
    return content.hexdigest()
