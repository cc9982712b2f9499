"""Where a study's cells are computed: in processes of this machine, on the workers of a cluster, or on a GPU.

Each yields each cell with what it leaves, as it is done, and who asked writes that down: workers need no disk that is
shared, and what is written is not lost by anything that happens later.
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
from neurotact.workers import spawned_as_done


def executor(n_workers: int, scheduler: str | None = None, device: str = "cpu") -> AbstractContextManager[MapCells]:
    """So many processes of this machine, the cluster whose Dask scheduler has that address, or that CUDA device."""
    if device != "cpu":
        return on_device(device)
    return processes(n_workers) if scheduler is None else cluster(scheduler)


@contextmanager
def processes(n_workers: int) -> Iterator[MapCells]:
    """Compute cells in processes of this machine, which read what they work on in the run folder."""
    with spawned_as_done(n_workers) as run:

        def map_cells(engine: Engine, cells: list[AnyCell], folder: Path) -> Iterator[tuple[AnyCell, Files]]:
            how = engine.load_given, engine.run_cell
            jobs = [(*how, cell, folder / cell.given, cell_folder(folder, cell)) for cell in cells]
            return ((cells[place], left) for place, left in run(_run_from_disk, jobs))

        yield map_cells


def _run_from_disk(job: tuple[Load, RunCell, AnyCell, Path, Path]) -> Files:
    load, run, cell, given, kept = job
    return run(cell, _loaded(load, given), kept)


@lru_cache(maxsize=2)
def _loaded(load: Load, path: Path) -> Any:
    return load(path)
