"""The cells of a way that is a module: the arrays that they share on the disk, the files of each, the rows of all."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from neurotact.data.dataset import expand
from neurotact.errors import InputError
from neurotact.files import existing, whole, write_json
from neurotact.studies import store, way_study
from neurotact.studies.engine import Engine, Files, Results
from neurotact.studies.store import DATA, RESULT, TIMING
from neurotact.studies.way import Arrays, module_of
from neurotact.studies.way_study import WayCell, WayStudy, swept_values


def prepare(folder: Path, study: WayStudy, cells: Iterable[WayCell]) -> bool:
    """Write missing and damaged arrays that cells share, and their hashes into data.json.

    Raises InputError if their recordings changed since the study started.
    """
    target = folder / "data"
    distinct = {cell.data_name: cell for cell in cells}
    data_flaws = store.flaws(folder, [DATA])
    flaws = store.flaws(target, [f"{name}.npz" for name in distinct])
    known = store.sound_json(folder, DATA) or {}
    store.say_flaws("", data_flaws, "written again")
    store.say_flaws(f"{target.name}/", flaws, "written again")
    for name, cell in distinct.items():
        before, sources = known.get(name), _sources(cell)
        if before is not None and f"{name}.npz" not in flaws and _are_same(before.get("sources", {}), sources):
            continue
        arrays = module_of(study.way).load(cell.built().data)
        entry = {"sha256": _hash(arrays), "arrays": {key: list(value.shape) for key, value in arrays.items()}}
        if before is not None and {key: before[key] for key in entry} != entry:
            raise InputError(f"{folder}: the recordings changed since this study began; run it in another folder")
        known[name] = entry | ({"sources": sources} if sources else {})
        write_json(folder / DATA, known)
        store.seal(folder, [DATA])
        with whole(folder / cell.given) as draft:
            np.savez(draft, allow_pickle=False, **arrays)
        store.seal(target, [f"{name}.npz"])
    return True


def _check(folder: Path, _: WayStudy, cells: Iterable[WayCell]) -> None:
    """Raise InputError if the arrays of the cells of a run folder were changed."""
    store.check(folder, [DATA, *dict.fromkeys(cell.given for cell in cells)])


def _sources(cell: WayCell) -> dict[str, str]:
    """The fingerprint of each file or folder from which the cell's arrays may be read."""
    prints = {path: store.fingerprint(expand(path)) for path in _paths(cell.parameters["data"])}
    return {path: sha256 for path, sha256 in sorted(prints.items()) if sha256 is not None}


def _are_same(before: Mapping[str, str], now: Mapping[str, str]) -> bool:
    """Whether the sources are unchanged; a source that no longer exists is ignored, since it was already read."""
    return all(before.get(path) == sha256 for path, sha256 in now.items())


def _paths(table: Mapping[str, Any]) -> Iterator[str]:
    """The value of every key `path` and `file`, in this table and in nested ones."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _paths(value)
        elif key in ("path", "file") and isinstance(value, str):
            yield value


def load_arrays(path: Path) -> Arrays:
    """The arrays that `prepare` wrote."""
    with np.load(existing(path), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def run_cell(cell: WayCell, arrays: Arrays, *_: Any) -> Files:
    """The files of a cell; what else an `Engine` passes is for networks."""
    began = perf_counter()
    rows = [_plain(row) for row in module_of(cell.way).run(cell.built(), arrays)]
    result = json.dumps({"rows": rows}, indent=1)
    timing = json.dumps({"seconds": perf_counter() - began})
    return {RESULT: result.encode(), TIMING: timing.encode()}


def _tables(_: Path, study: WayStudy, results: Results) -> dict[str, pd.DataFrame]:
    """The rows of all cells, in the order of the sweep; the swept values are the first columns."""
    rows = [{**swept_values(study, cell), **row} for cell, result in results for row in result["rows"]]
    return {"results.csv": pd.DataFrame(rows)}


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


ENGINE = Engine(way_study.cells, prepare, _check, load_arrays, run_cell, _tables)
