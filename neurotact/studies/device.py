"""Cells of a study on one device: cells that train one network are trained together, as one population.

Then each other cell is run: each batch of a search is a population; where varied copies are chosen, the trainings of
which the choice is are run on the CPU.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import torch

from neurotact.errors import InputError
from neurotact.networks.training import fitting, population, tasks
from neurotact.networks.training.fitting import Trained
from neurotact.networks.training.training import Course
from neurotact.studies import cell as cells
from neurotact.studies.kind import AnyCell, Files, Kind, MapCells
from neurotact.studies.store import cell_folder
from neurotact.studies.study import Cell


@contextmanager
def on_device(name: str) -> Iterator[MapCells]:
    """Compute cells on the torch device of this name; InputError if torch cannot use it."""
    device = population.device_of(name)

    def map_cells(kind: Kind, todo: list[AnyCell], folder: Path) -> Iterator[tuple[AnyCell, Files]]:
        known = [cell for cell in todo if isinstance(cell, Cell)]
        if len(known) < len(todo):
            raise InputError(f"`device={name!r}`: this study's protocol trains no spiking networks; leave `device` out")
        together = [cell for cell in known if cells.trains_once(cell)]
        yield from _trained_together(kind, together, folder, device)
        for cell in known:
            if not cells.trains_once(cell):
                given = kind.load(folder / cell.given)
                yield cell, cells.run_cell(cell, given, cell_folder(folder, cell), device=name)

    yield map_cells


def _trained_together(
    kind: Kind, todo: Sequence[Cell], folder: Path, device: torch.device
) -> Iterator[tuple[AnyCell, Files]]:
    began = perf_counter()
    trains = {given: kind.load(folder / given) for given in {cell.given for cell in todo}}
    windows: dict[tuple[str, str], tasks.Sides] = {}
    sides: list[tasks.Sides] = []
    courses: list[Course[Trained]] = []
    for cell in todo:
        assert cell.network is not None
        given, task = trains[cell.given], cells.task_of(cell)
        key = cell.given, task.model_dump_json()
        if key not in windows:
            windows[key] = tasks.sides_of(given, task)
            fitting.warn_of_silence(windows[key].train)
        sides.append(windows[key])
        courses.append(fitting.fit_course(given, cell.network, task, cell.seeds, windows[key], device=device))
    fitted = population.run(courses)
    seconds = (perf_counter() - began) / max(1, len(todo))
    for cell, side, network in zip(todo, sides, fitted, strict=True):
        yield cell, cells.files_of(cell, trains[cell.given], network, side, seconds)
