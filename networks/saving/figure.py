"""The figure of a search for savings: accuracy on validation windows over what a decision costs."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from neurotact_parts.networks.saving.trial import COSTS

from neurotact.figures.style import INK, MUTED, add_legend, keep_within, new_figure, printed
from neurotact.metrics.fronts import pareto_front

TRIED, CHOSEN = "#0072B2", "#E06C00"


@printed
def draw_front(table: pd.DataFrame, points: list[dict], prices: str) -> Figure:
    """A panel for the energy and one for SOPs: trials as dots, the front as a line, the run, the points to use.

    table: of `choice.table`. points: of `folder.write`, the answer first.
    """
    figure = new_figure(2.9)
    panels = figure.subplots(1, 2, sharey=True).tolist()
    for axes, cost, label in zip(panels, (prices, COSTS[0]), (f"energy (nJ, {prices})", "SOPs"), strict=True):
        column = f"{cost}_nJ" if cost == prices else cost
        rows = table[table[column].notna()]
        x, y = rows[column].to_numpy(float), 100 * rows["validation_accuracy"].to_numpy(float)
        axes.plot(x, y, "o", ms=3, color=TRIED, alpha=0.6, ls="", label="a trial")
        on_front = np.flatnonzero(pareto_front(x, y))
        order = on_front[np.argsort(x[on_front])]
        axes.plot(x[order], y[order], drawstyle="steps-post", color=MUTED, lw=0.9, ls="--", label="front of the trials")
        axes.plot(x[0], y[0], marker="*", ms=11, color=INK, ls="", label="the run")
        for point in points:
            place = point["costs"][cost], 100 * point["accuracy_validation"]
            called = "to use: mean of trainings" if point is points[0] else None
            axes.plot(*place, marker="D", ms=7, mfc="none", mew=1.3, color=CHOSEN, ls="", label=called)
            axes.annotate(point["folder"], place, fontsize=7, xytext=(4, -8), textcoords="offset points")
        axes.set(xlabel=label)
        axes.set_xscale("log")
        axes.grid(color="#e6e6e6")
        axes.tick_params(axis="x", which="minor", labelsize=6.5, color=MUTED)
    panels[0].set_ylabel("validation accuracy (%)")
    keep_within(panels)
    add_legend(figure, panels, ncols=4)
    return figure
