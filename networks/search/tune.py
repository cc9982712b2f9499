"""A search on spike trains from a file, into a folder: `nt.tune`, and the command of that name."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neurotact_parts.networks.search import journal

from neurotact import files, spec
from neurotact.data.splits import Splits
from neurotact.data.windows import WindowSpec
from neurotact.lazily import lazily
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec, given_keys
from neurotact.progress import Tell, track, untold
from neurotact.spec import takes_specs

with lazily():
    import pandas as pd
    from neurotact_parts.networks.search import figure, search_tables
    from neurotact_parts.networks.search import search as search_loop

    from neurotact.networks.definition import recipe
    from neurotact.networks.training import resumable, tasks


@takes_specs
def tune(
    spikes: str | Path,
    folder: str | Path,
    network: str | Path | RSNNSpec = "default",
    settings: Mapping[str, Any] | None = None,
    *,
    search: SearchSpec = SearchSpec(),
    window: WindowSpec = WindowSpec(),
    where: Mapping[str, Any] | None = None,
    leave_out: Any = None,
    split: Splits = Splits(),
    exit_tolerance: float = 0.01,
    workers: int | None = None,
    resume: bool = False,
    tell: Tell = untold,
) -> "pd.DataFrame":
    """Search a network's hyperparameters on validation windows, as `neurotact tune` does: one row per trial.

    search: how many networks are trained, what is searched for and how; the first one is the network as given. The best
        has the highest value and, of equal ones, the fewest SOPs.
    window, split, where, leave_out, exit_tolerance: as for `train`; of folds one is tested.
    workers: processes that train them (2; 1 trains in this one, also in a script without
        `if __name__ == "__main__"`).
    The journal, tables, figure, `best.toml` and the best network, `best`, are saved in `folder`; given the same folder
    again, the search continues there. resume: with more `trials` than before, too, as if all had been asked for at
    once. tell: called with what the command prints.
    Raises InputError for an unknown space, for a folder with another search, and as `train` does.

    >>> space = {"hidden": {"_type": "choice", "_value": [2, 3, 4]}}
    >>> search, window = nt.Search(space=space, trials=2), nt.Window(length_ms=50)
    >>> settings = {"training.epochs": 1}
    >>> found = nt.tune("spikes.h5", "search", "rsnn", settings, search=search, window=window, workers=1)
    >>> len(found)
    2
    """
    split.check_single("tune")
    trains, task = tasks.of_file("tune", spikes, window, split, exit_tolerance, where, leave_out)
    path, spikes = Path(folder), Path(spikes)
    what, given = spec.resolve(RSNNSpec, network, settings), given_keys(network, settings)
    asked = search_loop.asked(search, what, trains, task, given)
    problem = search_loop.problem_of(trains, asked, what, task)
    for line in recipe.joined_cost(what):
        tell(f"of each trial: {line}")
    with files.locked(path):
        with search_loop.runner(problem, spikes, workers or 2) as run, track("tune", search.trials) as advance:
            tried, timing = search_loop.search(problem, path, run, advance, resume=resume)
        figure.save_found(problem, tried, path)
        outcome = search_loop.save_best(problem, spikes, path, tried)
    best = journal.best_of(tried)
    tell(f"trial {best.id} of {len(tried)} is the best; {timing.seconds:.1f} s, proposals {timing.proposals:.1f} s")
    if problem.search.first is not None:
        tell(journal.beside_given(tried))
    saved = f"its settings: {path / 'best.toml'}; every trial: {path / 'trials.csv'}; figure: {path / 'search.png'}"
    for line in (*outcome.lines(), saved, resumable.saved_in(path / "best")):
        tell(line)
    return search_tables.trials_table(tried)
