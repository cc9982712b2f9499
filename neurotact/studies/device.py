"""Cells of a study on one GPU: cells with a network and without a search are trained together, as one population.

Then each cell with a search is run; each batch of its trials is a population.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

from neurotact.errors import InputError
from neurotact.networks import tasks
from neurotact.networks.population.devices import device_of
from neurotact.networks.population.training import Asked, fit
from neurotact.studies import cell as cells
from neurotact.studies.engine import Engine, MapCells
from neurotact.studies.store import AnyCell, Files, cell_folder
from neurotact.studies.study import Cell


@contextmanager
def on_device(name: str) -> Iterator[MapCells]:
    """Compute cells on the CUDA device of this name; InputError if it does not exist."""
    device_of(name)

    def map_cells(engine: Engine, todo: list[AnyCell], folder: Path) -> Iterator[tuple[AnyCell, Files]]:
        known = [cell for cell in todo if isinstance(cell, Cell)]
        if len(known) < len(todo):
            raise InputError(f"--device {name}: this study's protocol trains no spiking networks; leave --device out")
        together = [cell for cell in known if cell.network is not None and cell.search is None]
        yield from _trained_together(engine, together, folder, name)
        for cell in known:
            if cell.network is None or cell.search is not None:
                given = engine.load_given(folder / cell.given)
                yield cell, cells.run_cell(cell, given, cell_folder(folder, cell), name)

    yield map_cells


def asked_of(engine: Engine, todo: Sequence[Cell], folder: Path) -> list[Asked]:
    """The training of each cell; cells with the same windows share them."""
    trains = {given: engine.load_given(folder / given) for given in {cell.given for cell in todo}}
    sides, asked = {}, []
    for cell in todo:
        assert cell.network is not None
        task = cells.task_of(cell)
        windows = (cell.given, task.model_dump_json())
        if windows not in sides:
            sides[windows] = tasks.sides_of(trains[cell.given], task)
        asked.append(Asked(trains[cell.given], cell.network, task, cell.seeds, sides[windows]))
    return asked


def _trained_together(engine: Engine, todo: Sequence[Cell], folder: Path, name: str) -> Iterator[tuple[AnyCell, Files]]:
    began = perf_counter()
    asked = asked_of(engine, todo, folder)
    fitted = fit(asked, device_of(name))
    seconds = (perf_counter() - began) / max(1, len(todo))
    for cell, each, network in zip(todo, asked, fitted, strict=True):
        yield cell, cells.left_by(cell, each.trains, network, each.sides, seconds)
