"""Figures of the selection of a network: over window lengths, over networks, and over window lengths again.

They correspond to the texture paper's Figs. 7, 8 and 13. Tables are the parts of a study's `selection.csv`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator

from neurotact.figures.labels import label_points
from neurotact.figures.style import (
    INK,
    MUTED,
    PAIR_AXIS,
    PALE,
    add_legend,
    keep_within,
    new_figure,
    printed,
    sequence,
    series_style,
)
from neurotact.tables import sized

LENGTH = "window.length_ms"
MEASURES = (
    ("accuracy_validation", "validation accuracy (%)", 100.0),
    ("sops_validation", "SOPs per window (thousands)", 1e-3),
)


@printed
def draw_lengths(networks: pd.DataFrame, means: pd.DataFrame, tolerance: float) -> Figure:
    """Accuracy and SOPs of each size over window lengths, their mean, and the shortest length within the tolerance.

    networks: a row per size and window length (means over seeds). means: a row per window length (also over sizes).
    """
    figure = new_figure(2.7)
    panels = figure.subplots(1, 2)
    sizes = sorted(set(networks["hidden"]))
    for axes, (measure, words, scale) in zip(panels, MEASURES, strict=True):
        for index, (size, shade) in enumerate(zip(sizes, sequence(len(sizes)), strict=True)):
            rows = networks[networks["hidden"] == size].sort_values(LENGTH)
            style = series_style(index) | {"color": shade, "ms": 3.5, "lw": 0.8}
            axes.plot(rows[LENGTH], scale * rows[measure], label=f"N = {size}", **style)
        axes.plot(means[LENGTH], scale * means[measure], color=INK, lw=1.8, label="mean")
        _name_lengths(axes, means[LENGTH].tolist())
        axes.set(ylabel=words)
        axes.set_ylim(bottom=0)
    keep_within(panels[:1])
    best = 100 * means["accuracy_validation"].max()
    panels[0].axhspan(best - 100 * tolerance, best, color=PALE, alpha=0.6, lw=0, label="within the tolerance")
    _mark_least(panels, float(means[LENGTH][means["chosen"]].iloc[0]))
    add_legend(figure, panels, ncols=4, handlelength=2.2)
    return figure


@printed
def draw_choice(networks: pd.DataFrame, tolerance: float) -> Figure:
    """Accuracy against SOPs of every network on validation trials; the chosen ones are ringed and numbered.

    Networks are labelled with their hidden size if there is space.

    networks: a row per pair and size (means over seeds), of the step that was kept.
    """
    figure = new_figure(3.4)
    axes = figure.subplots()
    x, y = 1e-3 * networks["sops_validation"], 100 * networks["accuracy_validation"]
    for index, pair in enumerate(dict.fromkeys(networks["pair"])):
        own = networks["pair"] == pair
        style = series_style(index) | {"ms": 5, "ls": ""}
        axes.plot(x[own], y[own], label=pair, **style)
    chosen = networks[networks["chosen"]].sort_values("rank")
    ring: Any = {"ls": "", "marker": "o", "ms": 12, "mfc": "none", "mec": INK, "mew": 1.4}
    axes.plot(x[chosen.index], y[chosen.index], gid="chosen", **ring)
    axes.axhspan(y.max() - 100 * tolerance, y.max(), color=PALE, alpha=0.6, lw=0, label="within the tolerance")
    axes.plot([], [], label="selected", **ring | {"ms": 9})
    axes.set(xlabel="SOPs per window (thousands)", ylabel="validation accuracy (%)")
    axes.set_xlim(left=0)
    axes.margins(y=0.12)
    keep_within([axes])
    axes.grid()
    add_legend(figure, [axes], ncols=4, title=PAIR_AXIS)
    order = [*chosen.index, *networks.index.difference(chosen.index)]
    names = [f"{row['rank']:g}. {sized(row)}" for _, row in chosen.iterrows()]
    names += [f"{hidden}" for hidden in networks["hidden"][order[len(chosen) :]]]
    label_points(axes, x[order], y[order], names, fontsize=6.5, gid="size")
    return figure


@printed
def draw_persistence(table: pd.DataFrame, names: Sequence[str], least_ms: float, pairs: Sequence[str]) -> Figure:
    """Accuracy and SOPs of the selected networks and of the most accurate one over window lengths.

    table: one row per network and window length, with the columns `name` and `pair`; names: in drawing order. pairs: of
    `draw_choice`, for the same colours; a second network of a pair is dashed.
    """
    pair_of = table.groupby("name")["pair"].first()
    looks = {
        name: series_style(list(pairs).index(pair_of[name]))
        | {"ls": "--" if pair_of[name] in [pair_of[other] for other in names[:index]] else "-"}
        for index, name in enumerate(names)
    }
    figure = new_figure(2.6)
    panels = figure.subplots(1, 2)
    for axes, (measure, words, scale) in zip(panels, MEASURES, strict=True):
        for name in names:
            rows = table[table["name"] == name].sort_values(LENGTH)
            axes.plot(rows[LENGTH], scale * rows[measure], label=name, ms=4, **looks[name])
        _name_lengths(axes, sorted(set(table[LENGTH])))
        axes.set(ylabel=words)
        axes.set_ylim(bottom=0)
    keep_within(panels[:1])
    _mark_least(panels, least_ms)
    add_legend(figure, panels, ncols=3)
    return figure


def _name_lengths(axes: Axes, lengths_ms: Sequence[float]) -> None:
    """A logarithmic axis with a tick at each length; if two labels would touch, the second is omitted."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(lengths_ms)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    reach = np.log(max(lengths_ms) / min(lengths_ms)) if len(lengths_ms) > 1 else 1.0
    names, last = [], -np.inf
    for length_ms in lengths_ms:
        is_clear = np.log(length_ms) - last > 0.085 * reach
        names.append(f"{length_ms:g}" if is_clear else "")
        last = np.log(length_ms) if is_clear else last
    axes.set_xticks(list(lengths_ms), names)
    axes.set_xlabel("window length (ms)")
    axes.grid(axis="y")


def _mark_least(panels: Sequence[Axes], length_ms: float) -> None:
    for axes in panels:
        label = f"window chosen: {length_ms:g} ms"
        axes.axvline(length_ms, color=MUTED, lw=1.0, ls=":", label=label, gid="least", zorder=1)
