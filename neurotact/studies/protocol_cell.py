"""The cells of a protocol study: the arrays that they share on the disk, and what each leaves."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from neurotact.errors import InputError
from neurotact.files import existing, read_json, whole, write_json
from neurotact.studies.cell import RESULT, Files
from neurotact.studies.protocol import Arrays, module_of
from neurotact.studies.protocol_study import ProtocolCell


def arrays_path(folder: Path, cell: ProtocolCell) -> Path:
    return folder / "data" / f"{cell.data_name}.npz"


def prepare(folder: Path, cells: Iterable[ProtocolCell]) -> None:
    """Write what is missing of the arrays that cells share, and their hashes into data.json."""
    missing = {cell.data_name: cell for cell in cells if not arrays_path(folder, cell).is_file()}
    if not missing:
        return
    path = folder / "data.json"
    known = read_json(path) if path.is_file() else {}
    for name, cell in missing.items():
        arrays = module_of(cell.protocol).load(cell.built().data)
        found = {"sha256": _hash(arrays), "arrays": {key: list(value.shape) for key, value in arrays.items()}}
        if known.get(name, found) != found:
            raise InputError(f"{folder}: the recordings changed since this study began; run it into another folder")
        known[name] = found
        write_json(path, known)
        with whole(arrays_path(folder, cell)) as draft:
            np.savez(draft, allow_pickle=False, **arrays)


def load_arrays(path: Path) -> Arrays:
    """The arrays that `prepare` wrote."""
    with np.load(existing(path), allow_pickle=False) as kept:
        return {name: kept[name] for name in kept.files}


def run_cell(cell: ProtocolCell, arrays: Arrays) -> Files:
    """Run a cell; the files that it leaves. It reads and keeps nothing but what is passed."""
    began = perf_counter()
    rows = [_plain(row) for row in module_of(cell.protocol).run(cell.built(), arrays)]
    result = json.dumps({"rows": rows}, indent=1)
    timing = json.dumps({"seconds": perf_counter() - began})
    return {RESULT: result.encode(), "timing.json": timing.encode()}


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """A row as JSON holds it; a number that is missing is null."""
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()}
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in plain.items()}


def _hash(arrays: Arrays) -> str:
    content = hashlib.sha256()
    for name in sorted(arrays):
        content.update(name.encode())
        content.update(np.ascontiguousarray(arrays[name]).tobytes())
    return content.hexdigest()
