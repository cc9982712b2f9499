"""Figures of the effect of afferent gains: distributions of inter-spike intervals, rates over gain and t_ref.

They correspond to the texture paper's Sec. III-A and IV-A on its scaling coefficients. Tables are those of a study
without a network: `isi.csv`, and `results.csv` with the columns `gain_sa` and `gain_ra`.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, PercentFormatter

from neurotact.figures.encoding import POPULATIONS, Classes
from neurotact.figures.style import INK, MUTED, SERIES, add_legend, new_figure, printed, sequence, series_style

COMPROMISE = (
    ("isi_overlap_{}", "overlap of the ISIs\nof two classes", 1.0),
    ("silent_share_{}", "silent trials (%)", 100.0),
    ("latency_{}_ms", "first spike after (ms)", 1.0),
)
"""The trade-off in the paper: column, words, scale."""
GAIN_UNITS = {"SA-I": "mV per unit of the signal", "RA-I": "mV per unit and ms"}


@printed
def draw_isi_distributions(isi: pd.DataFrame, t_ref_ms: float, classes: Classes) -> Figure:
    """One row per population, a column per gain: the share of each class's intervals in each bin, at one t_ref."""
    isi = isi[isi["t_ref_ms"] == t_ref_ms]
    gains = {name: sorted(set(isi["gain"][isi["population"] == name])) for _, name, _, _ in POPULATIONS}
    n_columns = max(map(len, gains.values()))
    figure = new_figure(4.6)
    grid = figure.subplots(len(gains), n_columns, sharex=True, sharey="row", squeeze=False)
    for panels, (name, values) in zip(grid, gains.items(), strict=True):
        for axes, gain in zip(panels, values, strict=False):
            rows = isi[(isi["population"] == name) & (isi["gain"] == gain)]
            _paint_distributions(axes, rows, classes)
            axes.set_title(f"{name}, gain {gain:g}")
        for axes in panels[len(values) :]:
            axes.set_visible(False)
        _begin_at_zero(panels)
        panels[0].set_ylabel(f"share of {name} intervals")
    for axes in grid[-1]:
        axes.set_xlabel("inter-spike interval (ms)")
    add_legend(figure, grid.ravel(), ncols=min(len(classes.order), 8), handlelength=1.2, title=classes.word)
    return figure


@printed
def draw_gain_and_t_ref(rows: pd.DataFrame) -> Figure:
    """Firing rate (above) and mean inter-spike interval (below) of both populations over gain and t_ref."""
    figure = new_figure(4.6)
    grid = figure.subplots(2, 2, squeeze=False)
    measures = (("spikes_{}_per_s", "spikes per second"), ("isi_{}_ms", "mean interval (ms)"))
    for panels, (column, words) in zip(grid, measures, strict=True):
        for axes, (kind, name, _, colours) in zip(panels, POPULATIONS, strict=True):
            cells = over_gain_and_t_ref(rows, kind, column.format(kind))
            _paint_matrix(axes, cells, colours)
            axes.set_title(f"{name}: {words}")
            axes.set(xlabel=r"$t_\mathrm{ref}$ (ms)", ylabel=f"gain ({GAIN_UNITS[name]})")
    return figure


@printed
def draw_compromise(rows: pd.DataFrame) -> Figure:
    """The drawbacks of high gains (overlapping intervals of classes) and of low ones (silence, late spikes)."""
    figure = new_figure(4.2)
    grid = figure.subplots(len(POPULATIONS), len(COMPROMISE), squeeze=False, sharey="col")
    for panels, (kind, name, _, _) in zip(grid, POPULATIONS, strict=True):
        for axes, (column, words, scale) in zip(panels, COMPROMISE, strict=True):
            cells = scale * over_gain_and_t_ref(rows, kind, column.format(kind))
            for index, (t_ref_ms, shade) in enumerate(zip(cells.columns, sequence(cells.shape[1]), strict=True)):
                style = series_style(index) | {"color": shade, "ms": 4}
                axes.plot(cells.index, cells[t_ref_ms], label=f"{t_ref_ms:g} ms", **style)
            _name_gains(axes, list(cells.index))
            axes.set(ylabel=words, xlabel=f"{name} gain ({GAIN_UNITS[name]})")
            axes.grid(axis="y")
    for column in grid.T:
        _begin_at_zero(column)
    add_legend(figure, grid.ravel(), ncols=6, title=r"$t_\mathrm{ref}$")
    return figure


def over_gain_and_t_ref(rows: pd.DataFrame, kind: str, column: str) -> pd.DataFrame:
    """A measure of one population, a row per gain and a column per t_ref, means over all other swept keys.

    >>> rows = pd.DataFrame({"gain_sa": [1.8, 3.2], "t_ref_sa_ms": [1.0, 1.0], "spikes_sa_per_s": [25.0, 78.0]})
    >>> over_gain_and_t_ref(rows, "sa", "spikes_sa_per_s")[1.0].tolist()
    [25.0, 78.0]
    """
    table = rows.assign(**{column: rows[column].astype(float)})
    return table.pivot_table(index=f"gain_{kind}", columns=f"t_ref_{kind}_ms", values=column, aggfunc="mean")


def _paint_distributions(axes: Axes, rows: pd.DataFrame, classes: Classes) -> None:
    edges = np.unique(np.concatenate([rows["isi_from_ms"], rows["isi_to_ms"]]))
    middles = np.sqrt(edges[1:] * edges[:-1])
    shades = sequence(len(classes.order)) if classes.are_ordered else _class_colours(len(classes.order))
    for label, shade in zip(classes.order, shades, strict=True):
        mine = rows[rows["label"] == label].set_index("isi_from_ms")["share"]
        axes.plot(middles, mine.reindex(edges[:-1], fill_value=0.0), color=shade, label=classes.short[label], lw=1.0)
    axes.set_xscale("log")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(axis="y")


def _paint_matrix(axes: Axes, cells: pd.DataFrame, colours: str) -> None:
    """Colours by the logarithm, the values written into the cells; the highest gain on top."""
    values = cells.to_numpy(float)
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    scale = LogNorm(0.8 * low, 1.05 * high)
    axes.pcolormesh(np.where(values > 0, values, np.nan), cmap=colours, norm=scale, edgecolors="white", lw=0.8)
    for (row, column), value in np.ndenumerate(values):
        is_dark = np.isfinite(value) and value > 0 and scale(value) > 0.6
        text = "-" if not np.isfinite(value) else f"{value:.3g}"
        ink = "white" if is_dark else INK
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize=7, color=ink)
    axes.set_xticks(np.arange(cells.shape[1]) + 0.5, [f"{value:g}" for value in cells.columns])
    axes.set_yticks(np.arange(cells.shape[0]) + 0.5, [f"{value:g}" for value in cells.index])
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)


def _begin_at_zero(panels: Sequence[Axes]) -> None:
    """A common scale of panels, from zero to slightly above the largest value."""
    values = [np.asarray(line.get_ydata(), float) for axes in panels for line in axes.lines]
    largest = max((float(np.nanmax(y)) for y in values if np.isfinite(y).any()), default=0.0)
    panels[0].set_ylim(0, 1.08 * largest if largest > 0 else 1.0)


def _name_gains(axes: Axes, gains: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator(list(gains)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(list(gains), [f"{gain:g}" for gain in gains])
    axes.tick_params(axis="x", color=MUTED)


def _class_colours(n: int) -> list[str]:
    """Colours of unordered classes: those of the style if enough, then up to twenty distinct ones, then a scale.

    >>> len(set(_class_colours(20)))
    20
    """
    if n <= len(SERIES):
        return [colour for colour, _ in SERIES[:n]]
    if n <= 20:  # the ten strong colours before the ten pale ones
        return [to_hex(colormaps["tab20"](2 * (i % 10) + i // 10)) for i in range(n)]
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0, 0.95, n))]
