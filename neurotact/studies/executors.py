"""Where a study's cells are computed: in processes of this machine, on the workers of a cluster, or on a torch device.

Each yields a cell with its files as soon as it is finished, and the caller writes the files. So workers need no shared
disk, and no later failure loses a file that is written.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from neurotact.studies.cluster import cluster
from neurotact.studies.device import on_device
from neurotact.studies.engine import Engine, Load, MapCells, RunCell
from neurotact.studies.store import AnyCell, Files, cell_folder
from neurotact.workers import pool_as_done


def executor(n_workers: int, scheduler: str | None = None, device: str = "cpu") -> AbstractContextManager[MapCells]:
    """`n_workers` processes of this machine, the cluster of the Dask scheduler at this address, or a torch device."""
    if device != "cpu":
        return on_device(device)
    return processes(n_workers) if scheduler is None else cluster(scheduler)


@contextmanager
def processes(n_workers: int) -> Iterator[MapCells]:
    """Compute cells in processes of this machine, which read their inputs from the run folder."""
    with pool_as_done(n_workers) as run:

        def map_cells(engine: Engine, cells: list[AnyCell], folder: Path) -> Iterator[tuple[AnyCell, Files]]:
            functions = engine.load_given, engine.run_cell
            jobs = [(*functions, cell, folder / cell.given, cell_folder(folder, cell)) for cell in cells]
            return ((cells[index], files) for index, files in run(_run_from_disk, jobs))

        yield map_cells


def _run_from_disk(job: tuple[Load, RunCell, AnyCell, Path, Path]) -> Files:
    load, run, cell, given, kept = job
    return run(cell, _loaded(load, given), kept)


@lru_cache(maxsize=2)
def _loaded(load: Load, path: Path) -> Any:
    return load(path)
