"""Figures of networks on part of their window: cut short (texture paper, Figs. 8 and 13), early exit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from neurotact.figures.labels import label_points
from neurotact.figures.style import (
    INK,
    MUTED,
    PAIR_TITLE,
    add_legend,
    bars,
    keep_within,
    new_figure,
    printed,
    sequence,
    series_style,
)

MODES = {
    "validated": "counted from the first readout spike",
    "oracle": "Algorithm 1, which uses the true label",
    "printed": "Algorithm 1 to the letter: its count is never reset",
}
PANELS = (("accuracy_test", "test accuracy (%)", 100.0), ("sops_total", "SOPs per sample (thousands)", 1e-3))
COSTS = (
    ("spikes", "afferent spikes per decision"),
    ("kSOPs", "SOPs per decision (thousands)"),
    ("window.length_ms", "window length (ms)"),
)
"""The costs of a decision: one panel each of `draw_costs`."""
EXIT_MEASURES = (
    ("accuracy_lost", "accuracy lost (points)", 100.0),
    ("exit_ms", "decides after (ms)", 1.0),
    ("sops_saved", "SOPs saved (%)", 100.0),
)
"""Losses and savings of early exit: column, words and scale of one panel each of `draw_exit_curves`."""


def _mean_and_deviation(table: pd.DataFrame, by: Sequence[str], measure: str) -> pd.DataFrame:
    """Means over sizes and seeds for each combination of `by`, and the deviation over seeds of the means over sizes.

    Columns: `by`, mean, sd (0 with one seed).

    >>> rows = {"cut_ms": [50.0] * 4, "hidden": [20, 20, 30, 30], "seed": [0, 1, 0, 1], "x": [1.0, 2.0, 3.0, 4.0]}
    >>> _mean_and_deviation(pd.DataFrame(rows), ["cut_ms"], "x").round(3).to_dict("records")
    [{'cut_ms': 50.0, 'mean': 2.5, 'sd': 0.707}]
    """
    over_sizes = table.groupby([*by, "seed"], sort=False)[measure].mean().reset_index()
    groups = over_sizes.groupby(list(by), sort=False)[measure]
    return pd.DataFrame({"mean": groups.mean(), "sd": groups.std().fillna(0.0)}).reset_index()


@printed
def draw_cut_short(table: pd.DataFrame) -> Figure:
    """Accuracy (left) and SOPs (right) against the length of the input, a row per t_ref pair.

    table: of `cut_short.csv`, with the columns `pair`, `panel` (its row's title) and `trained_ms`.
    The thick line joins networks on the whole window of their training; a thin line is one of them, cut short.
    """
    titles = list(dict.fromkeys(table["panel"]))
    lengths = sorted(set(table["trained_ms"]))
    figure = new_figure(2.1 * len(titles) + 0.7)
    grid = figure.subplots(len(titles), 2, squeeze=False, sharex=True, sharey="col")
    shades = dict(zip(lengths, sequence(len(lengths)), strict=True))
    for line, title in zip(grid, titles, strict=True):
        rows = table[table["panel"] == title]
        for axes, (measure, words, scale) in zip(line, PANELS, strict=True):
            means = _mean_and_deviation(rows, ["trained_ms", "cut_ms"], measure)
            for length, shade in shades.items():
                of = means[means["trained_ms"] == length]
                style: Any = {"color": shade, "marker": ".", "ms": 4, "lw": 0.9, "ls": "--"}
                axes.plot(of["cut_ms"], scale * of["mean"], label=f"trained on {length:g} ms, cut short", **style)
            whole = means[means["trained_ms"] == means["cut_ms"]].sort_values("cut_ms")
            style = {"color": INK, "marker": "o", "ms": 4, "lw": 1.4, "elinewidth": 1.0, "zorder": 3}
            mean = scale * whole["mean"]
            spread = bars(mean, scale * whole["sd"], 100.0 if measure == "accuracy_test" else None)
            axes.errorbar(whole["cut_ms"], mean, spread, label="trained on that length", **style)
            axes.set(title=title, ylabel=words)
            axes.grid()
    for axes in grid[-1]:
        axes.set_xscale("log")
        cuts = sorted(set(table["cut_ms"]))
        axes.set_xticks(cuts, [f"{cut:g}" for cut in cuts])
        axes.minorticks_off()
        axes.set_xlabel("length of the input (ms)")
    grid[0, 1].set_ylim(bottom=0)
    keep_within(grid[:, 0])
    add_legend(figure, [grid[0, 0]], ncols=3)
    return figure


@printed
def draw_costs(results: pd.DataFrame) -> Figure:
    """Test accuracy against the cost of a decision: spikes, SOPs and milliseconds; a line per t_ref pair.

    results: of `results.csv`, with the columns `pair` and `window.length_ms`, a point per length; means over sizes and
    seeds, with the deviation over seeds of the accuracy. Points of the first pair are labelled with the length in ms.
    """
    spikes = results[[name for name in results if name.startswith("spikes_")]].sum(axis=1)
    results = results.assign(spikes=spikes, kSOPs=1e-3 * results["sops_total"])
    figure = new_figure(3.2)
    panels = figure.subplots(1, len(COSTS), sharey=True)
    by = ["pair", "window.length_ms"]
    accuracy = _mean_and_deviation(results, by, "accuracy_test")
    to_label = []
    for axes, (cost, words) in zip(panels, COSTS, strict=True):
        paid = results.groupby(by, sort=False)[cost].mean() if cost not in by else None
        for index, pair in enumerate(dict.fromkeys(results["pair"])):
            rows = accuracy[accuracy["pair"] == pair].sort_values("window.length_ms")
            lengths = rows["window.length_ms"]
            x = lengths.to_numpy(float) if paid is None else paid[pair].reindex(lengths).to_numpy(float)
            y = 100.0 * rows["mean"].to_numpy(float)
            spread = bars(y, 100.0 * rows["sd"].to_numpy(float), 100.0)
            style: Any = {"ms": 4, "lw": 1.1, "elinewidth": 0.7, **series_style(index)}
            axes.errorbar(x, y, spread, label=f"{pair} ms", **style)
            if index == 0 and paid is not None:
                to_label.append((axes, x, y, [f"{length:g} ms" for length in lengths], style["color"]))
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.tick_params(axis="x", labelsize=7)
        axes.margins(x=0.12, y=0.08)
        axes.set(xlabel=words)
        axes.grid()
    panels[0].set_ylabel("test accuracy (%)")
    keep_within(panels)
    add_legend(figure, panels, ncols=6, title=PAIR_TITLE)
    for axes, x, y, words, colour in to_label:
        label_points(axes, x, y, words, fontsize=6.5, color=colour, gid="length")
    return figure


@printed
def draw_exit_curves(table: pd.DataFrame, chosen: pd.DataFrame, published: pd.DataFrame, step_ms: float) -> Figure:
    """Accuracy lost, time to the decision and SOPs saved over patience, a row per t_ref pair, both modes of early exit.

    table: of `exit_curve.csv` with `panel`. chosen: panel and exit_patience of each network, chosen on validation.
    published: panel, patience and steps of the texture paper's Table V. step_ms: of the clock; patience is drawn in
    milliseconds, with its steps above the first row.
    """
    table = table.assign(patience_ms=step_ms * table["patience"], exit_ms=step_ms * table["exit_steps"])
    titles = list(dict.fromkeys(table["panel"]))
    figure = new_figure(2.1 * len(titles) + 1.1)
    grid = figure.subplots(len(titles), len(EXIT_MEASURES), squeeze=False, sharex=True, sharey="col")
    for line, title in zip(grid, titles, strict=True):
        rows = table[table["panel"] == title]
        for axes, (measure, words, scale) in zip(line, EXIT_MEASURES, strict=True):
            for index, (mode, name) in enumerate(MODES.items()):
                _paint_curve(axes, rows[rows["mode"] == mode], measure, scale, name, 4 * index)
            for patience in sorted(set(chosen[chosen["panel"] == title]["exit_patience"])):
                axes.axvline(step_ms * patience, color=MUTED, lw=0.7, ls=":", label="chosen on validation trials")
            axes.set_title(title, pad=6)
            axes.set_ylabel(words)
            axes.grid(axis="y")
        whole_ms = float((rows["exit_ms"] / (1.0 - rows["steps_saved"])).max())
        line[1].axhline(whole_ms, color=MUTED, lw=0.9, ls="-.", label="whole window")
        for _, mark in published[published["panel"] == title].iterrows():
            style: Any = {"ls": "", "marker": "D", "ms": 7, "mfc": "none", "mec": INK, "mew": 1.3, "zorder": 4}
            line[1].plot(step_ms * mark["patience"], step_ms * mark["steps"], label="published, Algorithm 1", **style)
    grid[0, 1].set_ylim(bottom=0)
    for axes in grid[0]:
        steps = axes.secondary_xaxis("top", functions=(lambda ms: ms / step_ms, lambda n: n * step_ms))
        steps.set_xlabel("patience (steps)")
    for axes in grid[-1]:
        axes.set_xlabel("patience (ms)")
    add_legend(figure, grid.ravel(), ncols=3)
    return figure


def _paint_curve(axes: Axes, rows: pd.DataFrame, measure: str, scale: float, name: str, series: int) -> None:
    """Means with a band of the deviation over networks."""
    wide = scale * rows.pivot_table(index="patience_ms", columns=["hidden", "seed"], values=measure)
    colour = series_style(series)["color"]
    mean = wide.mean(axis=1)
    # SOPs saved are a share; accuracy may also rise; neither exceeds 100 %.
    below, above = bars(mean, wide.std(axis=1), 100.0 if measure == "sops_saved" else None)
    ends = np.array([mean - below, mean + above])
    if measure == "accuracy_lost":
        ends = np.clip(ends, -100.0, 100.0)
    axes.fill_between(wide.index.to_numpy(float), *ends, color=colour, alpha=0.15, lw=0)
    axes.plot(wide.index, mean, label=name, **{**series_style(series), "ms": 3})
