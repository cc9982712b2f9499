"""The search of a study's cell."""

from pathlib import Path

from neurotact_parts.networks.search import journal, search, search_tables
from neurotact_parts.networks.search.search_tables import as_cell

from neurotact.data.spikes import SpikeTrains
from neurotact.files import DRAFT
from neurotact.networks.training.tasks import Task
from neurotact.studies.cell import SEARCH, Searched
from neurotact.studies.study import Cell


def search_cell(cell: Cell, trains: SpikeTrains, task: Task, kept: Path) -> Searched:
    """Search the hyperparameters of the cell's network on its validation trials, then train the best network again.

    The random seed of the search depends on the cell's content: cells that differ only in their seed search separately.
    kept: the folder in which the journal of the search is.
    """
    assert cell.search is not None
    assert cell.network is not None
    spec = cell.search.model_copy(update={"seed": cell.seeds[0]})
    problem = search.problem_of(trains, spec, cell.network, task)
    target = kept / SEARCH
    trials, _ = search.search(problem, target, search.here(trains, task))
    search_tables.write_tables(problem, target, trials)
    best = journal.best_of(trials)
    fitted, sides = search.train_best(problem, trains, best)
    row = {"trial": best.id, **{f"network.{key}": as_cell(value) for key, value in best.parameters.items()}}
    written = (path for path in sorted(target.iterdir()) if not path.name.startswith(DRAFT))
    left = {f"{SEARCH}/{path.name}": path.read_bytes() for path in written}
    return Searched(fitted, sides, row, left)
