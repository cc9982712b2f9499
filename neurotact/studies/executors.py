"""Where a study's cells are computed: in processes of this machine or on the workers of a cluster.

Each yields a cell with its files as soon as it is finished, and the caller writes the files. So workers need no shared
disk, and no later failure loses a file that is written.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from neurotact import plugins
from neurotact.progress import at
from neurotact.studies.engine import AnyCell, Engine, Files, MapCells
from neurotact.studies.store import cell_folder
from neurotact.workers import pool_as_done, preload


def executor(n_workers: int, scheduler: str | None = None) -> AbstractContextManager[MapCells]:
    """`n_workers` processes of this machine, or the cluster of the Dask scheduler at this address."""
    return processes(n_workers) if scheduler is None else plugins.load_function("tools", "cluster")(scheduler)


@contextmanager
def processes(n_workers: int) -> Iterator[MapCells]:
    """Compute cells in processes of this machine, which read their inputs from the run folder.

    The first cell tells how long its training takes.
    """
    preload(plugins.modules("opponents"))  # a cell is compared with them
    with pool_as_done(n_workers) as run:

        def map_cells(engine: Engine, cells: list[AnyCell], folder: Path) -> Iterator[tuple[AnyCell, Files]]:
            places = [(folder / cell.given, cell_folder(folder, cell)) for cell in cells]
            jobs = [(engine.load, engine.run, cell, *places[n], n == 0) for n, cell in enumerate(cells)]
            return ((cells[index], files) for index, files in run(_run_from_disk, jobs))

        yield map_cells


def _run_from_disk(job: tuple[Callable[[Path], Any], Callable[..., Files], AnyCell, Path, Path, bool]) -> Files:
    load, run, cell, given, kept, tells = job
    at("read")
    loaded = _loaded(load, given)
    at("begin")
    return run(cell, loaded, kept, tells)


@lru_cache(maxsize=2)
def _loaded(load: Callable[[Path], Any], path: Path) -> Any:
    return load(path)
