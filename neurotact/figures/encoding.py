"""Figures of encoded touch: rasters, spike counts, firing rates, inter-spike intervals.

They correspond to the texture paper's Figs. 5, 6 and 10. Tables are those of a study's `encoding.csv` with the column
`pair`.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.data.spikes import SpikeTrains
from neurotact.figures.columns import in_unit
from neurotact.figures.raster import name_populations, paint_events
from neurotact.figures.style import (
    INK,
    MUTED,
    PAIR_AXIS,
    PALE,
    RA,
    SA,
    TOTAL,
    add_legend,
    name_ticks,
    new_figure,
    printed,
    sequence,
    series_style,
)

POPULATIONS = (("sa", "SA-I", SA, "Blues"), ("ra", "RA-I", RA, "Oranges"))
NAMES = ("SA-I", "RA-I")
"""The first population and the others, as the columns of tables count them."""


class Classes(NamedTuple):
    """The classes in drawing order, with their names.

    word: the kind of class, such as "grating"; short and long: the names on an axis and in a title.
    are_ordered: whether their order has a meaning, so that a line may join them.
    """

    word: str
    order: tuple[str, ...]
    short: Mapping[str, str]
    long: Mapping[str, str]
    are_ordered: bool = False

    @property
    def ticks(self) -> list[str]:
        return [self.short[label] for label in self.order]


@printed
def draw_rasters(
    trains: SpikeTrains,
    trials: Sequence[Sequence[int | None]],
    rows: Sequence[str],
    columns: Sequence[str],
    start_s: float,
    stop_s: float,
    window_s: float,
) -> Figure:
    """A grid of rasters between two times; the first `window_s`, which a network receives, are shaded.

    trials: the trial in each row and column; None if there is none.
    """
    figure = new_figure(1.35 * len(rows) + 0.6)
    grid = figure.subplots(len(rows), len(columns), sharex=True, squeeze=False)
    for row, row_name in enumerate(rows):
        for column, column_name in enumerate(columns):
            axes, trial = grid[row, column], trials[row][column]
            axes.axvspan(start_s, start_s + window_s, color=PALE, alpha=0.6, lw=0, gid="window")
            axes.axhline(trains.is_sa.sum() - 0.5, color=PALE, lw=0.6)
            axes.set(xlim=(start_s, stop_s), yticks=[])
            if column == 0:
                name_populations(axes, trains)
            if row == 0:
                axes.set_title(column_name)
            if trial is None:
                _say(axes, "no trial")
                continue
            paint_events(axes, trains, trial, start_s, stop_s)
            if not any(len(line.get_xdata()) for line in axes.lines if line.get_gid()):
                _say(axes, "silent")
        if row_name:
            grid[row, -1].annotate(
                row_name, (1.02, 0.5), xycoords="axes fraction", rotation=-90, va="center", fontweight="bold"
            )
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    figure.supylabel("afferents, one row each", fontsize=8)
    return figure


@printed
def draw_spike_counts(
    table: pd.DataFrame,
    shown: Sequence[str],
    classes: Classes,
    names: Sequence[str] = NAMES,
    pair: str = PAIR_AXIS,
) -> Figure:
    """Spikes per second of both populations and their sum over the t_ref pairs, a panel per class (Fig. 6).

    pair: the words of the axis of the pairs.
    """
    pairs = list(dict.fromkeys(table["pair"]))
    figure = new_figure(2.4)
    panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    ticks = np.arange(len(pairs))
    bars = (("sa", names[0], SA, ""), ("ra", names[1], RA, ""), ("total", "both", TOTAL, "////"))
    for axes, label in zip(panels, shown, strict=True):
        rows = table[table["label"] == label].groupby("pair", sort=False).mean(numeric_only=True).reindex(pairs)
        for index, (kind, name, colour, hatch) in enumerate(bars):
            heights = rows[f"spikes_{kind}_per_s"]
            look = {"color": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0}  # grey print needs the hatch
            axes.bar(ticks + (index - 1) * 0.27, heights, 0.25, label=name, **look)
        name_ticks(axes, pairs)
        axes.set(title=classes.long[label], xlabel=pair)
        axes.grid(axis="y")
    panels[0].set_ylabel("spikes per second of touch")
    add_legend(figure, panels, ncols=3, handlelength=1.0)
    return figure


@printed
def draw_rates(table: pd.DataFrame, by: Sequence[str], classes: Classes, names: Sequence[str] = NAMES) -> Figure:
    """Firing rates of each class under each condition, as a share of the population's highest (Fig. 10a)."""
    table = table.assign(condition=_condition_names(table, by))
    conditions = list(dict.fromkeys(table["condition"]))
    figure = new_figure(0.26 * len(classes.order) + 1.3, min(7.2, 3.8 + 0.8 * len(conditions)))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, name, (kind, _, _, colours) in zip(panels, names, POPULATIONS, strict=True):
        rates = table.pivot_table(index="label", columns="condition", values=f"spikes_{kind}_per_s", aggfunc="mean")
        rates = rates.reindex(index=list(classes.order), columns=conditions).to_numpy(dtype=float)
        _paint_matrix(axes, rates, colours)
        axes.set_title(f"{name} (1 = {np.nanmax(rates):.0f} spikes/s)")
        axes.set_xticks(np.arange(len(conditions)) + 0.5, conditions, fontsize=7)
        axes.set_yticks(np.arange(len(classes.order)) + 0.5, classes.ticks)
        axes.set_ylim(len(classes.order), 0)
    panels[0].set_ylabel(classes.word)
    return figure


@printed
def draw_isis(table: pd.DataFrame, vary: str | None, classes: Classes, names: Sequence[str] = NAMES) -> Figure:
    """Mean inter-spike interval of each class, one colour per value of `vary` (Fig. 10b).

    If the population is silent for a class, there is a gap.
    """
    values = sorted(set(table[vary])) if vary else [None]
    shades = sequence(len(values))
    figure = new_figure(2.5)
    panels = figure.subplots(1, 2)
    for axes, name, (kind, _, _, _) in zip(panels, names, POPULATIONS, strict=True):
        for index, (value, shade) in enumerate(zip(values, shades, strict=True)):
            rows = table if value is None else table[table[vary] == value]
            isis = rows.groupby("label")[f"isi_{kind}_ms"].mean().reindex(list(classes.order)).to_numpy(dtype=float)
            style = series_style(index) | {"color": shade, "ms": 4, "ls": "-" if classes.are_ordered else ""}
            axes.plot(np.arange(len(isis)), isis, label=in_unit(vary, value) if vary else name, **style)
        column = table[f"isi_{kind}_ms"].to_numpy(dtype=float)
        if not np.isfinite(column).any():
            _say(axes, "silent")
        else:
            axes.set_ylim(0, 1.08 * np.nanmax(column))
        name_ticks(axes, classes.ticks)
        axes.set(title=name, xlabel=classes.word, ylabel="mean inter-spike interval (ms)")
        axes.grid(axis="y")
    if vary:
        add_legend(figure, panels, ncols=min(len(values), 6))
    return figure


def _condition_names(table: pd.DataFrame, by: Sequence[str]) -> list[str]:
    """Each row's conditions on separate lines, with their units.

    >>> _condition_names(pd.DataFrame({"force_N": [3.0], "speed_mm_per_s": [8.6]}), ["force_N", "speed_mm_per_s"])
    ['3 N\\n8.6 mm/s']
    """
    return ["\n".join(in_unit(column, row[column]) for column in by) or "all trials" for _, row in table.iterrows()]


def _paint_matrix(axes: Axes, values: np.ndarray, colours: str) -> None:
    """A matrix as shares of its highest value, written into its cells."""
    highest = np.nanmax(values)
    shares = values / highest if highest > 0 else values
    axes.pcolormesh(shares, cmap=colours, vmin=0, vmax=1, edgecolors="white", linewidth=0.8)
    for (row, column), share in np.ndenumerate(shares):
        text = "-" if np.isnan(share) else f"{share:.2f}"
        ink = "white" if share > 0.6 else INK
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=6.5, color=ink)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)


def _say(axes: Axes, words: str) -> None:
    """A text in place of an empty drawing."""
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="bottom", color=MUTED)
