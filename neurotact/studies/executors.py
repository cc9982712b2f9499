"""Where a study's cells are computed: in processes of this machine, or on the workers of a cluster.

Either yields each cell with what it leaves, as it is done, and who asked writes that down: workers need no disk that is
shared, and what is written is not lost by anything that happens later.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from pathlib import Path

from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.studies.cell import Files, MapCells, cell_folder, run_cell
from neurotact.studies.cluster import cluster
from neurotact.studies.preparation import spikes_path
from neurotact.studies.study import Cell
from neurotact.studies.workers import spawned_as_done


def executor(n_workers: int, scheduler: str | None = None) -> AbstractContextManager[MapCells]:
    """So many processes of this machine, or the cluster whose Dask scheduler has that address."""
    return processes(n_workers) if scheduler is None else cluster(scheduler)


@contextmanager
def processes(n_workers: int) -> Iterator[MapCells]:
    """Compute cells in processes of this machine, which read the spike trains in the run folder."""
    with spawned_as_done(n_workers) as run:

        def map_cells(cells: list[Cell], folder: Path) -> Iterator[tuple[Cell, Files]]:
            jobs = [(cell, spikes_path(folder, cell), cell_folder(folder, cell)) for cell in cells]
            return ((cells[place], left) for place, left in run(_run_from_disk, jobs))

        yield map_cells


def _run_from_disk(job: tuple[Cell, Path, Path]) -> Files:
    cell, spikes, kept = job
    return run_cell(cell, _load_spikes(spikes), kept)


@lru_cache(maxsize=2)
def _load_spikes(path: Path) -> SpikeTrains:
    return load_spikes(path)
