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
from neurotact.studies.engine import AnyCell, Beside, Engine, Files, MapCells
from neurotact.studies.store import cell_folder
from neurotact.workers import pool_as_done, preload


def modules() -> list[str]:
    """What the processes of a study load, once: also what a cell is compared with."""
    return ["neurotact.studies.networks", *plugins.modules("opponents")]


def executor(n_workers: int, scheduler: str | None = None) -> AbstractContextManager[MapCells]:
    """`n_workers` processes of this machine, or the cluster of the Dask scheduler at this address."""
    return processes(n_workers) if scheduler is None else plugins.load_function("tools", "cluster")(scheduler)


@contextmanager
def processes(n_workers: int) -> Iterator[MapCells]:
    """Compute cells in processes of this machine, which read their inputs from the run folder.

    The first cell tells how long its training takes.
    """
    preload(modules())
    with pool_as_done(n_workers) as run:

        def map_cells(
            engine: Engine, cells: list[AnyCell], folder: Path, beside: Beside | None
        ) -> Iterator[tuple[Any, Any]]:
            if beside is not None and not beside.at_once:
                yield from in_one_process(beside)
                beside = None
            places = [(folder / cell.given, cell_folder(folder, cell)) for cell in cells]
            of_cells = [(engine.load, engine.run, cell, *places[n], n == 0) for n, cell in enumerate(cells)]
            others = [] if beside is None else [(beside.run, job) for job in beside.jobs]
            jobs = [*others, *((_run_from_disk, job) for job in of_cells)]
            for index, left in run(_call, jobs):
                yield (index if index < len(others) else cells[index - len(others)]), left

        yield map_cells


def in_one_process(beside: Beside) -> Iterator[tuple[int, Any]]:
    """The place and result of each job beside the cells, one after another."""
    with pool_as_done(1) as run:
        yield from run(beside.run, beside.jobs)


def _call(job: tuple[Callable[[Any], Any], Any]) -> Any:
    return job[0](job[1])


def _run_from_disk(job: tuple[Callable[[Path], Any], Callable[..., Files], AnyCell, Path, Path, bool]) -> Files:
    load, run, cell, given, kept, tells = job
    at("read")
    loaded = _loaded(load, given)
    at("begin")
    return run(cell, loaded, kept, tells)


@lru_cache(maxsize=2)
def _loaded(load: Callable[[Path], Any], path: Path) -> Any:
    return load(path)
