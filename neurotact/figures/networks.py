"""Figures of networks: accuracy, synaptic operations, their trade-off, confusions, training.

They correspond to the texture paper's Fig. 11. Tables are those of a study's `results.csv` with the columns `pair` and
`setting` (the data set and all other swept keys, in words).
"""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from neurotact.figures.labels import label_points
from neurotact.figures.style import (
    INK,
    MUTED,
    PAIR_AXIS,
    add_legend,
    bars,
    keep_within,
    name_ticks,
    new_figure,
    new_panels,
    printed,
    sequence,
    series_style,
)
from neurotact.metrics.fronts import pareto_front
from neurotact.metrics.shares import wilson_interval
from neurotact.tables import LAYERS, NETWORK, over_seeds, size_of, sized

TITLE_WIDTH = 44
"""Characters of a title over half of a figure."""


class Published(NamedTuple):
    """A published value; `hidden` is None if it is the best over sizes or their mean."""

    setting: str
    pair: str
    hidden: int | None
    measure: str
    value: float


class Spent(NamedTuple):
    """A cost of networks: columns of the whole window and of early exit, name, words of an axis, scale and unit."""

    whole: str
    early: str
    name: str
    words: str
    scale: float
    unit: str


COSTS = (
    Spent("sops_total", "exit_sops_total", "synaptic operations", "SOPs per sample (thousands)", 1e-3, "k"),
    Spent("whole_nJ", "early_nJ", "energy", "energy per decision, an estimate (nJ)", 1.0, "nJ"),
    Spent("whole_spikes", "early_spikes", "input spikes", "input spikes per decision", 1.0, "spikes"),
    Spent("whole_ms", "early_ms", "time to decision", "time to decision (ms)", 1.0, "ms"),
)


def cost_of(results: pd.DataFrame) -> Spent:
    """The first of `COSTS` that is counted: a network of another package may count none of its operations."""
    return next((one for one in COSTS if one.whole in results and results[one.whole].notna().any()), COSTS[0])


@printed
def draw_accuracy_and_sops(
    results: pd.DataFrame, published: Sequence[Published] = (), chance: float | None = None, pair: str = PAIR_AXIS
) -> Figure:
    """Test accuracy (left) and synaptic operations (right) by t_ref pair and size, a row per data set (Fig. 11).

    Means over seeds with their standard deviation, each seed as a dot; diamonds are published values. pair: the words
    of the axis of the pairs.
    """
    settings, pairs = (list(dict.fromkeys(results[column])) for column in NETWORK[:2])
    sizes = list(dict.fromkeys(results.sort_values("hidden", kind="stable").apply(size_of, axis=1)))
    figure = new_figure(1.9 * len(settings) + 0.8)
    grid = figure.subplots(len(settings), 2, squeeze=False, sharex=True, sharey="col")
    measures = (("accuracy_test", "test accuracy (%)", 100.0), ("sops_total", "SOPs per sample (thousands)", 1e-3))
    for row, setting in enumerate(settings):
        rows = results[results["setting"] == setting]
        for axes, (measure, words, scale) in zip(grid[row], measures, strict=True):
            _paint_networks(axes, rows, pairs, sizes, measure, scale)
            marks = [p for p in published if p.setting == setting and p.measure == measure and p.pair in pairs]
            _paint_published(axes, marks, pairs, sizes, scale)
            axes.set(title=_title(setting, settings), ylabel=words)
            axes.set_xticks(range(len(pairs)), pairs)
            axes.grid(axis="y")
            if rows[measure].isna().all():
                axes.text(0.5, 0.5, "not counted", transform=axes.transAxes, ha="center", color=MUTED)
    for axes in grid[-1]:
        axes.set_xlabel(pair)
    grid[0, 1].set_ylim(bottom=0)
    keep_within(grid[:, 0])
    if chance is not None:
        _mark_chance(list(grid[:, 0]), chance)
    add_legend(figure, grid.ravel(), ncols=6, handlelength=1.2)
    return figure


@printed
def draw_trade_off(
    results: pd.DataFrame,
    levels: Mapping[str, Mapping[str, float]] = {},
    trials: Mapping[str, int] = {},
    pair: str = PAIR_AXIS,
) -> Figure:
    """Test accuracy against synaptic operations, or else `cost_of`, a panel per data set, with the Pareto fronts.

    A point is a t_ref pair and a size, its mean over seeds; filled for the full window, open with early exit, a thin
    line between the two. Bars are drawn only on the front of the full window, whose sizes N are labelled.

    levels: for each data set, accuracies at any cost, by name, as of the best other classifier and of guessing.
    trials: for each data set, its test trials; networks of a single seed get the 95 % interval for that number as bar.
    pair: the title of the legend of the pairs.
    """
    cost = cost_of(results)
    networks = over_seeds(results, ["accuracy_test", cost.whole, "exit_accuracy", cost.early])
    settings = list(dict.fromkeys(networks["setting"]))
    pairs = list(dict.fromkeys(networks["pair"]))
    figure, grid = new_panels(len(settings), 2, 3.3, 0.6)
    fronts = []
    for axes, setting in zip(grid, settings, strict=True):
        rows = networks[networks["setting"] == setting]
        _join_exits(axes, rows, pairs, cost)
        fronts.append(_paint_points(axes, rows, pairs, cost, trials.get(setting), filled=True))
        _paint_points(axes, rows, pairs, cost, None, filled=False)
        _mark_levels(axes, levels.get(setting, {}))
        axes.set(title=_title(setting, settings), xlabel=cost.words, ylabel="test accuracy (%)")
        axes.margins(0.1)
        axes.set_xlim(left=max(0.0, axes.get_xlim()[0]))
        axes.grid()
    keep_within(grid)
    add_legend(figure, grid, ncols=4, handlelength=2.2, title=pair)
    for axes, front in zip(grid, fronts, strict=True):
        names = [sized(row) for _, row in front.iterrows()]
        label_points(axes, front["x"], front["y"], names, fontsize=6.5, fontweight="bold", gid="front label")
    return figure


@printed
def draw_confusion(matrix: np.ndarray, names: Sequence[str], title: str) -> Figure:
    """Confusion matrix: shares of each true class's samples, their number in the cell."""
    matrix = np.asarray(matrix, float)
    shares = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1.0)
    side = 0.36 * len(names) + 1.5
    figure = new_figure(side, min(7.2, side + 0.9))
    axes = figure.subplots()
    mesh = axes.pcolormesh(shares, cmap="Blues", vmin=0, vmax=1, edgecolors="white", linewidth=0.8)
    for (true, taken), count in np.ndenumerate(matrix):
        if count:
            colour = "white" if shares[true, taken] > 0.6 else INK
            axes.text(taken + 0.5, true + 0.5, f"{count:.0f}", ha="center", va="center", fontsize=7, color=colour)
    ticks = np.arange(len(names)) + 0.5
    name_ticks(axes, names, ticks)
    axes.set_yticks(ticks, names)
    axes.set(title=title, xlabel="predicted class", ylabel="true class", aspect="equal")
    axes.set_ylim(len(names), 0)
    axes.tick_params(length=0)
    figure.colorbar(mesh, ax=axes, label="share of the true class", shrink=0.8)
    return figure


@printed
def draw_training(log: pd.DataFrame, kept: int) -> Figure:
    """Loss and accuracy over epochs on training and validation windows; a line marks the kept epoch."""
    figure = new_figure(2.2)
    panels = figure.subplots(1, 2)
    measures = (("loss", "loss", 1.0), ("accuracy", "accuracy (%)", 100.0))
    for axes, (what, words, scale) in zip(panels, measures, strict=True):
        for side, index in (("train", 0), ("validation", 4)):
            style = series_style(index) | {"marker": "", "ls": "-" if side == "validation" else "--"}
            name = "training" if side == "train" else side
            axes.plot(log["epoch"], scale * log[f"{side}_{what}"], label=name, **style)
        axes.axvline(kept, color=MUTED, lw=0.8, ls=":", label="kept")
        axes.set(xlabel="epoch", ylabel=words)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis="y")
    keep_within(panels[1:])
    add_legend(figure, panels, ncols=3)
    return figure


def _title(setting: str, settings: Sequence[str]) -> str:
    """A panel's title; empty for a single data set."""
    return fill(setting, TITLE_WIDTH) if len(settings) > 1 else ""


def _paint_networks(
    axes: Axes, rows: pd.DataFrame, pairs: Sequence[str], sizes: Sequence[str], measure: str, scale: float
) -> None:
    """Mean and deviation of all sizes side by side at each pair, the single seeds as faint dots."""
    means = over_seeds(rows, [measure])
    shades = sequence(len(sizes))
    for index, (size, shade) in enumerate(zip(sizes, shades, strict=True)):
        shift = _shift(index, len(sizes))
        seeds = rows[rows.apply(size_of, axis=1) == size]
        x = np.array([pairs.index(pair) for pair in seeds["pair"]], float) + shift
        axes.plot(x, scale * seeds[measure], ls="", marker=".", ms=2.5, color=shade, alpha=0.45, gid="seed")
        mean = means[means.apply(size_of, axis=1) == size].set_index("pair").reindex(pairs)
        y, sd = scale * mean[measure], scale * mean[f"{measure}_sd"]
        whole = 100.0 if measure.startswith("accuracy") else None
        style = series_style(index) | {"color": shade, "ms": 4, "ls": "", "elinewidth": 1.0}
        spread = bars(y, sd, whole)
        axes.errorbar(np.arange(len(pairs)) + shift, y, spread, label=sized({LAYERS: size}), gid="mean", **style)


def _paint_published(
    axes: Axes, marks: Sequence[Published], pairs: Sequence[str], sizes: Sequence[str], scale: float
) -> None:
    """Published points at their pair and size; in the middle of the pair if no size is given."""
    for mark in marks:
        size = str(mark.hidden)
        shift = _shift(sizes.index(size), len(sizes)) if size in sizes else 0.0
        axes.plot(
            pairs.index(mark.pair) + shift,
            scale * mark.value,
            ls="",
            marker="D",
            ms=7,
            mfc="none",
            mec="#D55E00",
            mew=1.3,
            label="published",
            gid="published",
            zorder=4,
        )


def _shift(index: int, n: int) -> float:
    """The offset of the series at `index` of `n` from its tick."""
    return 0.0 if n == 1 else -0.3 + 0.6 * index / (n - 1)


def _mark_chance(panels: Sequence[Axes], chance: float) -> None:
    """A line at chance, if the panel's range includes it."""
    for axes in panels:
        low, high = axes.get_ylim()
        if low <= 100 * chance:
            axes.axhline(100 * chance, color=MUTED, lw=0.8, ls=":", label="chance")
            axes.set_ylim(low, high)


def _mark_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    """A line at each level; a level far below the points, by more than their range, is only in the legend."""
    low, high = axes.get_ylim()
    for dash, (name, level) in zip(("-.", ":"), levels.items(), strict=False):
        style = {"color": MUTED, "lw": 0.9, "ls": dash}
        if 100 * level < low - (high - low):
            axes.plot([], [], label=f"{name}: {100 * level:.3g} %, below", **style)
        else:
            axes.axhline(100 * level, label=name, gid="level", **style)


def _join_exits(axes: Axes, rows: pd.DataFrame, pairs: Sequence[str], cost: Spent) -> None:
    """A thin line from each network on the full window to the same network with early exit."""
    for index, pair in enumerate(pairs):
        mine = rows[rows["pair"] == pair]
        x = cost.scale * mine[[cost.whole, cost.early]].to_numpy(float)
        y = 100 * mine[["accuracy_test", "exit_accuracy"]].to_numpy(float)
        gap = np.full((len(mine), 1), np.nan)
        ends = (np.hstack([values, gap]).ravel() for values in (x, y))
        axes.plot(*ends, color=series_style(index)["color"], lw=0.6, alpha=0.6, zorder=1, gid="exit")


def _paint_points(
    axes: Axes, rows: pd.DataFrame, pairs: Sequence[str], cost: Spent, n_test: int | None, *, filled: bool
) -> pd.DataFrame:
    """Networks and their Pareto front with its bars, as in `draw_trade_off`; the front, a row each, as `x`, `y`."""
    scaled = (cost.scale, cost.whole if filled else cost.early), (100.0, "accuracy_test" if filled else "exit_accuracy")
    x, y = (scale * rows[name].to_numpy(float) for scale, name in scaled)
    x_sd, y_sd = (scale * rows[f"{name}_sd"].fillna(0.0).to_numpy(float) for scale, name in scaled)
    front = pareto_front(x, y)
    is_marked = front & filled
    for index, pair in enumerate(pairs):
        of_pair = (rows["pair"] == pair).to_numpy()
        style = series_style(index)
        face = style["color"] if filled else "white"
        label = pair if filled else None
        axes.plot(x[of_pair], y[of_pair], ls="", ms=4.5, mfc=face, label=label, zorder=3, **style)
    if is_marked.any():
        spread = bars(y[is_marked], y_sd[is_marked])
        if n_test and rows["seeds"].max() == 1:
            ends = 100.0 * np.array([wilson_interval(share / 100.0, n_test) for share in y[is_marked]]).T
            spread = np.abs(ends - y[is_marked])
        axes.errorbar(x[is_marked], y[is_marked], spread, x_sd[is_marked], fmt="none", ecolor=INK, elinewidth=0.7)
    order = np.flatnonzero(front)[np.argsort(x[front], kind="stable")]
    name = "Pareto front, full window" if filled else "Pareto front, early exit"
    style: Any = {"color": INK if filled else MUTED, "ls": "-" if filled else "--", "lw": 0.9}
    axes.plot(x[order], y[order], drawstyle="steps-post", zorder=2, gid=name, **style)
    axes.plot([], [], marker="o", ms=4.5, mfc=INK if filled else "white", label=name, **style)
    return rows.iloc[order].assign(x=x[order], y=y[order])
