"""Figures of the ways to save: accuracy over what a decision costs, a line per way."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from neurotact_parts.studies.comparison.figures import write_out_log_ticks
from neurotact_parts.studies.comparison.fronts import COSTS, NOTHING, SOPS

from neurotact.figures.style import INK, MUTED, add_legend, new_figure, new_panels, printed

COLOURS = (
    "#E06C00", "#0072B2", "#56B4E9", "#009E73", "#7fb800", "#999999", "#CC79A7", "#882255", "#332288", "#c4a000",
    "#8c510a", "#e7298a", "#17becf",
)  # fmt: skip
MARKS = ("o", "s", "^", "v", "P", "X", "D", "d", "<", ">", "p", "h", "8")
"""Colours and markers of the ways, in turn."""


@printed
def draw_fronts(points: pd.DataFrame, cost: str = SOPS) -> Figure:
    """A panel per set, a line per way.

    points: of `fronts.fronts`, whose fronts are of this cost.
    """
    names = list(points["set"].unique())
    figure, panels = new_panels(len(names), 2, 2.9, 0.9)
    ways = [way for way in points["way"].unique() if way != NOTHING]
    for axes, name in zip(panels, names, strict=True):
        _draw_set(axes, points[points["set"] == name], ways, cost)
        axes.set_title(name)
    add_legend(figure, panels, ncols=4)
    return figure


@printed
def draw_costs(points: Mapping[str, pd.DataFrame]) -> Figure:
    """A panel per cost, a line per way, of one set.

    points: of `fronts.fronts`, by the cost column of its fronts.
    """
    figure = new_figure(3.8)
    panels = figure.subplots(1, len(points), sharey=True, squeeze=False)[0].tolist()
    for axes, (cost, rows) in zip(panels, points.items(), strict=True):
        _draw_set(axes, rows, [way for way in rows["way"].unique() if way != NOTHING], cost)
    for axes in panels[1:]:
        axes.set_ylabel("")
    add_legend(figure, panels, ncols=4)
    return figure


def _draw_set(axes: Axes, points: pd.DataFrame, ways: list[str], cost: str) -> None:
    for index, way in enumerate(ways):
        rows = points[points["way"] == way].sort_values(cost)
        style = {"color": COLOURS[index % len(COLOURS)], "marker": MARKS[index % len(MARKS)], "ls": "none", "ms": 4.5}
        axes.errorbar(rows[cost], rows["accuracy_test"], _whiskers(rows), elinewidth=0.5, capsize=0, mfc="none",
                      alpha=0.6, label=way, **style)  # fmt: skip
        best = rows[rows["on_own_front"]]
        axes.plot(best[cost], best["accuracy_test"], **{**style, "ls": "-", "lw": 0.9})
    base = points[points["way"] == NOTHING]
    axes.plot(base[cost], base["accuracy_test"], marker="*", ms=11, color=INK, ls="none", label=NOTHING)
    front = points[points["on_front"]].sort_values(cost)
    style: Any = {"where": "post", "color": MUTED, "ls": "--", "lw": 0.8, "zorder": 0}
    axes.step(front[cost], front["accuracy_test"], label="front of all ways", **style)
    axes.plot([], [], "o", mfc="none", color=MUTED, ms=4.5, label="beaten by its own way")
    axes.set(xlabel=COSTS[cost].axis, ylabel="test accuracy")
    if cost == SOPS:
        axes.set_xscale("log")
        write_out_log_ticks(axes.xaxis)
    else:
        axes.set_xlim(left=0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(axis="y")


def _whiskers(rows: pd.DataFrame) -> np.ndarray:
    """Distances of the interval's ends below and above each mean; 0 without an interval."""
    mean = rows["accuracy_test"]
    low, high = (rows[bound].fillna(mean) for bound in ("low", "high"))
    return np.array([mean - low, high - mean])
