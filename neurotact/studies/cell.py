"""One cell of a study: train a network on spike trains, then count what its decisions cost."""

from functools import lru_cache
from pathlib import Path
from time import perf_counter

from neurotact.data import hdf5
from neurotact.data.spikes import SpikeTrains
from neurotact.files import write_json
from neurotact.studies import trained
from neurotact.studies.preparation import spikes_path
from neurotact.studies.study import Cell
from neurotact.studies.trained import Task


def run_cell(cell: Cell, folder: Path) -> None:
    """Train and measure a cell; `folder/cells/<digest>/result.json`, written last, says that it is done."""
    began = perf_counter()
    source = spikes_path(folder, cell)
    trains = _load_spikes(source)
    task = Task(
        window=cell.window,
        split=cell.split,
        stratify=tuple(cell.source["stratify"]),
        subset=cell.subset,
        exit_tolerance=cell.early_exit.tolerance,
    )
    fitted, sides = trained.fit(trains, cell.network, task, cell.seeds)
    result = trained.measure(fitted, sides.test, trains.is_sa)
    result["row"] = {
        "dataset": cell.dataset,
        "t_ref_ra_ms": cell.encoder.ra1.t_ref_ms,
        "t_ref_sa_ms": cell.encoder.sa1.t_ref_ms,
        "hidden": cell.network.hidden,
        "seed": cell.seed,
        **result["row"],
    }
    place = cell_folder(folder, cell)
    trained.save(fitted, place, trains, source, task)
    write_json(place / "timing.json", {"seconds": perf_counter() - began, "epochs": len(fitted.training.epochs)})
    write_json(place / "result.json", result)


def cell_folder(folder: Path, cell: Cell) -> Path:
    return folder / "cells" / cell.digest()


@lru_cache(maxsize=2)
def _load_spikes(path: Path) -> SpikeTrains:
    return hdf5.load_spikes(path)
