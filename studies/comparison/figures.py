"""Figures of every family of classifiers on every task."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, PercentFormatter, StrMethodFormatter
from neurotact_parts.studies.comparison.spiking import EARLY, FAMILY

from neurotact.figures.style import (
    INK,
    MUTED,
    PALE,
    TOTAL,
    add_legend,
    bars,
    keep_within,
    name_ticks,
    new_panels,
    printed,
)

FAMILIES = (
    "ELM", "SLFN", "SVM", "RLS", "k-means", "kNN", "extra trees", "LSTM", "GRU", "MiniRocket", "pooled GRU",
    FAMILY, EARLY,
)  # fmt: skip
MARKS = ("o", "s", "^", "v", "P", "X", "h", "D", "d", "<", ">", "*", "*")
COLOURS = (
    "#0072B2", "#56B4E9", "#009E73", "#7fb800", "#999999", "#666666", "#117733", "#CC79A7", "#882255", "#332288",
    "#AA4499", "#E06C00", "#E06C00",
)  # fmt: skip
COLUMNS = 3


@printed
def draw_trade_offs(results: pd.DataFrame, cost: str, words: str) -> Figure:
    """Test accuracy against a cost on a logarithmic axis, a panel per task, a mark per family.

    results: rows with task, family, accuracy_test, chance and the column `cost`; shown are means and deviations.
    """
    tasks = list(dict.fromkeys(results["task"]))
    figure, panels = new_panels(len(tasks), COLUMNS, 2.1, 0.6)
    for axes, task in zip(panels, tasks, strict=True):
        rows = results[results["task"] == task]
        for family, mine in rows.groupby("family", sort=False):
            accuracy = mine["accuracy_test"].mean()
            axes.errorbar(
                mine[cost].mean(),
                accuracy,
                bars(accuracy, mine["accuracy_test"].std(ddof=0), 1.0),
                ls="",
                lw=0.8,
                label=family,
                **_style(str(family)),
            )
        axes.axhline(rows["chance"].mean(), color=MUTED, ls=":", lw=0.8, label="chance")
        axes.set(xscale="log", title=task.replace("_", " "), ylim=(0, 1))
        write_out_log_ticks(axes.xaxis)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axes.grid(axis="y")
    keep_within(panels, 1.0)
    for axes in panels[-COLUMNS:]:
        axes.set_xlabel(words)
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("test accuracy")
    add_legend(figure, panels, ncols=6)
    return figure


@printed
def draw_energy_shares(results: pd.DataFrame) -> Figure:
    """The energy estimate of all operations before the classifier and of the whole decision, a panel per task.

    results: rows with task, family, energy_estimate_nJ and energy_before_nJ.
    """
    tasks = list(dict.fromkeys(results["task"]))
    figure, panels = new_panels(len(tasks), COLUMNS, 2.2, 0.6)
    for axes, task in zip(panels, tasks, strict=True):
        means = results[results["task"] == task].groupby("family")[["energy_before_nJ", "energy_estimate_nJ"]].mean()
        names = [name for name in FAMILIES if name in means.index]
        before, whole = (means.loc[names, column].to_numpy() for column in means)
        rows = np.arange(len(names))
        axes.vlines(rows, before, whole, color=PALE, lw=3)
        axes.plot(rows, before, "_", color=TOTAL, ms=9, mew=2, label="features, averaging or afferents alone")
        axes.plot(rows, whole, "o", color=INK, ms=4, label="the whole decision")
        axes.set(yscale="log", title=task.replace("_", " "))
        write_out_log_ticks(axes.yaxis)
        axes.grid(axis="y")
        name_ticks(axes, names)
        axes.tick_params(axis="x", labelsize=6.5)
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("energy estimate (nJ)")
    add_legend(figure, panels, ncols=2)
    return figure


def _style(family: str) -> dict[str, Any]:
    index = FAMILIES.index(family) if family in FAMILIES else 0
    filled = "none" if family == EARLY else COLOURS[index]
    size = 8 if MARKS[index] == "*" else 4.5
    edge = COLOURS[index] if family in FAMILIES else INK
    return {"marker": MARKS[index], "color": edge, "mfc": filled, "mec": edge, "ms": size}


def write_out_log_ticks(axis: Axis) -> None:
    """Few ticks, written out, on a logarithmic axis after its data are drawn.

    Decades if it spans more than two; else 1, 2 and 5 of each; round steps below a factor of four.
    """
    low, high = sorted(axis.get_view_interval())
    subs = (1.0,) if high > 100 * low else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=subs) if high > 4 * low else MaxNLocator(3))
    axis.set_major_formatter(StrMethodFormatter("{x:,.10g}"))
    axis.set_minor_formatter(NullFormatter())
