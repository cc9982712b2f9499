"""Figures of many hyperparameter searches, one per cell: the gain over trials, and the best values.

Tables hold one row per trial: cell, setting, pair, trial, outcome, value, and a column per hyperparameter.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from neurotact_parts.networks.search.figure import best_so_far
from neurotact_parts.networks.search.search_tables import by_rank

from neurotact.figures.style import INK, PALE, add_legend, name_ticks, new_panels, printed, series_style

COLUMNS = 3
MOST_BARS = 12
"""Number of bins for a hyperparameter with more values."""


@printed
def draw_best_so_far(trials: pd.DataFrame) -> Figure:
    """A panel per setting: the best value of each cell's search so far, and the median over the cells of a pair."""
    settings = list(dict.fromkeys(trials["setting"]))
    pairs = list(dict.fromkeys(trials["pair"]))
    figure, grid = new_panels(len(settings), COLUMNS, 2.5, 0.4, sharex=True, sharey=True)
    for axes, setting in zip(grid, settings, strict=True):
        rows = trials[trials["setting"] == setting]
        for _, own in rows.groupby("cell", sort=False):
            axes.step(own["trial"], best_so_far(own), where="post", color=PALE, lw=0.7, gid="cell")
        for index, pair in enumerate(pairs):
            of_pair = rows[rows["pair"] == pair]
            if of_pair.empty:
                continue
            best = pd.DataFrame({c: best_so_far(own) for c, own in of_pair.groupby("cell", sort=False)})
            style: dict[str, Any] = series_style(index) | {"marker": ""}
            axes.step(np.arange(len(best)), best.median(axis=1), where="post", label=pair, lw=1.5, **style)
        axes.set(title=setting, xlabel="trial")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis="y")
    for axes in grid[::COLUMNS]:
        axes.set_ylabel("best value so far")
    add_legend(figure, grid, ncols=6, handlelength=1.4)
    return figure


@printed
def draw_winners(trials: pd.DataFrame, winners: pd.DataFrame, space: Mapping[str, Mapping[str, Any]]) -> Figure:
    """A panel per hyperparameter: the share of each value in the cells' best trials, and in all trials (line).

    winners: of `winners`. space: the dimension of each column, in NNI's terms.
    """
    keys = list(space)
    figure, grid = new_panels(len(keys), COLUMNS, 1.75, 0.4)
    for axes, key in zip(grid, keys, strict=True):
        names, won, tried = _shares(winners[key], trials[key], space[key])
        axes.bar(range(len(names)), won, 0.7, color="#56B4E9", label="best trials", gid="won")
        axes.plot(range(len(names)), tried, color=INK, marker=".", lw=0.9, label="all trials", gid="tried")
        name_ticks(axes, names)
        axes.set_title(key)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.set_ylim(bottom=0)
        axes.grid(axis="y")
    add_legend(figure, grid, ncols=2)
    return figure


def winners(trials: pd.DataFrame) -> pd.DataFrame:
    """The best finished trial of each cell, one row per cell.

    >>> rows = {"cell": [0, 0, 1], "trial": [0, 1, 0], "outcome": ["finished"] * 3, "value": [0.5, 0.7, 0.6]}
    >>> winners(pd.DataFrame(rows | {"sops_total": [1e3] * 3}))["trial"].tolist()
    [1, 0]
    """
    return by_rank(trials).groupby("cell").head(1).sort_index()


def gains(trials: pd.DataFrame) -> pd.Series:
    """The gain of each cell's best value over its first finished trial."""
    finished = trials[trials["outcome"] == "finished"].groupby("cell", sort=False)["value"]
    return finished.max() - finished.first()


def _shares(
    won: pd.Series, tried: pd.Series, dimension: Mapping[str, Any]
) -> tuple[list[str], list[float], list[float]]:
    """Names of the values or bins of a hyperparameter, and the share of both series in each."""
    if dimension["_type"] == "choice" or tried.nunique() <= MOST_BARS:
        values = dimension["_value"] if dimension["_type"] == "choice" else sorted(set(tried))
        names = [f"{value:g}" if isinstance(value, (int, float)) else str(value) for value in values]
        best, all_tried = ([float((side == value).mean()) for value in values] for side in (won, tried))
        return names, best, all_tried
    is_log = "log" in dimension["_type"]
    edges = (np.geomspace if is_log else np.linspace)(tried.min(), tried.max(), MOST_BARS + 1)
    middles = np.sqrt(edges[1:] * edges[:-1]) if is_log else (edges[1:] + edges[:-1]) / 2
    heights = [(np.histogram(side, edges)[0] / len(side)).tolist() for side in (won, tried)]
    return [f"{middle:.3g}" for middle in middles], heights[0], heights[1]
