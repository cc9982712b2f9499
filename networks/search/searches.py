"""The searches of a study's cells in a report: their trials, their gain, and the best hyperparameters."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from neurotact_parts.networks.search import searches_figures
from neurotact_parts.networks.search.journal import FINISHED, STOPPED
from neurotact_parts.networks.search.search_tables import by_rank

from neurotact.errors import number_of
from neurotact.figures.style import Drawn
from neurotact.networks.definition.space import SearchSpec
from neurotact.report import periods
from neurotact.report.page import Table
from neurotact.studies.cell import SEARCH
from neurotact.studies.store import cell_folder
from neurotact.studies.study import Cell, StudySpec
from neurotact.tables import read_table

NAMED = ("dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed")
"""Columns that name a cell in each row of its trials."""


class Searches(NamedTuple):
    """What a report shows of the searches of a study, whose trials are a table as of `trials_table`."""

    trials: pd.DataFrame
    table: Table | None
    drawings: Iterator[Drawn]

    def of_cell(self, index: int) -> dict[str, Any] | None:
        """As `of_cell`."""
        return of_cell(self.trials, index)


def searches_of(study: StudySpec, folder: Path, done: list[Cell], results: pd.DataFrame) -> Searches:
    """The searches of the done cells of a study, whose rows `results` has in the same order."""
    assert study.search is not None
    trials = trials_table(folder, done, results)
    return Searches(trials, table(trials, results, study), drawings(trials, study.search))


def trials_table(folder: Path, done: list[Cell], results: pd.DataFrame) -> pd.DataFrame:
    """Every trial of every done cell, in the format of `neurotact tune`, after the columns that name its cell.

    Columns: cell (its row in results.csv), those of NAMED and all other swept keys (also `setting`, `pair`), then
    trial, outcome, epochs, value, accuracy_validation, sops_total, the hyperparameters, error.
    """
    parts = []
    if len(done) != len(results):
        return pd.DataFrame()  # the rows belong to other cells
    for index, (cell, (_, row)) in enumerate(zip(done, results.iterrows(), strict=True)):
        path = cell_folder(folder, cell) / SEARCH / "trials.csv"
        if cell.search is None or not path.is_file():
            continue
        table = read_table(path).rename(columns={"id": "trial", "hidden": "searched hidden"})
        for key in reversed(["cell", *NAMED, "setting", "pair"]):
            table.insert(0, key, index if key == "cell" else row[key])
        parts.append(table)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def of_cell(trials: pd.DataFrame, index: int) -> dict[str, Any] | None:
    """A cell's search for the page: value and outcome of each trial, the best one, and its choice."""
    own = trials[trials["cell"] == index] if len(trials) else trials
    if own.empty:
        return None
    best = by_rank(own).iloc[0]
    return {
        "values": [None if pd.isna(value) else float(f"{value:.4g}") for value in own["value"]],
        "outcomes": own["outcome"].tolist(),
        "best": int(best["trial"]),
        "chosen": {key: _text(best[key]) for key in hyperparameters(trials)},
    }


def hyperparameters(trials: pd.DataFrame) -> list[str]:
    """The columns of hyperparameters in a table of trials."""
    after = list(trials.columns).index("sops_total") + 1
    return [column for column in trials.columns[after:] if column != "error"]


def table(trials: pd.DataFrame, results: pd.DataFrame, study: StudySpec) -> Table | None:
    """The choice of each search, one row per cell; empty if there was none."""
    if trials.empty:
        return None
    keys = hyperparameters(trials)
    rows = []
    for index, row in results.reset_index(drop=True).iterrows():
        of_one = of_cell(trials, int(str(index)))
        if of_one is None:
            continue
        own = trials[trials["cell"] == index]
        kinds = "/".join(str((own["outcome"] == kind).sum()) for kind in (FINISHED, STOPPED))
        name = [str(row["setting"]), str(row["pair"]), str(row["hidden"]), str(row["seed"])]
        value = f"{own['value'][own['outcome'] == FINISHED].max():.4f}"
        rows.append([*name, str(of_one["best"]), value, kinds, *of_one["chosen"].values()])
    named = ["data set", f"{periods.head(study)} (ms)", "N", "seed"]
    heads = [*named, "best trial", "its value", "finished/stopped", *keys]
    return Table("Choice of each cell's search", heads, rows, n_heads=4)


def drawings(trials: pd.DataFrame, search: SearchSpec) -> Iterator[Drawn]:
    """The best so far over trials, and the best hyperparameters; empty if no cell has searched."""
    if trials.empty:
        return
    figure = searches_figures.draw_best_so_far(trials)
    gained = searches_figures.gains(trials)
    stopped = (trials["outcome"] == STOPPED).mean()
    tuner = search.tuner.upper() if search.tuner == "tpe" else search.tuner
    settings = f"{tuner}, {search.trials} trials per cell in batches of {search.batch}, {search.assessor}"
    caption = (
        f"The best value of each cell's search so far (grey) and the median of the cells of a pair, over trials. "
        f"{settings}. From the first finished trial to the last the best gains {100 * gained.median():.1f} points in "
        f"the median cell ({100 * gained.min():.1f} to {100 * gained.max():.1f}); {100 * stopped:.0f} % of all trials "
        "were stopped early. The best of many trials is optimistic: judge by the test accuracy."
    )
    yield Drawn("searches", "Gain of the searches", figure, caption, caption)
    keys = hyperparameters(trials)
    winners = searches_figures.winners(trials)
    spaces = {key: search.space[key.removeprefix("searched ")] for key in keys}
    figure = searches_figures.draw_winners(trials, winners, spaces)
    words = [f"{key} {_text(winners[key].mode().iloc[0])}" for key in keys]
    caption = (
        f"Share of each value in the best trials ({number_of(len(winners), 'cell')}), and its share of all "
        f"trials (line). Most frequent: {', '.join(words)}."
    )
    yield Drawn("search-winners", "Best hyperparameters", figure, caption, caption)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
