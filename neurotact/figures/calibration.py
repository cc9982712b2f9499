"""Why a calibrated encoder has its gains: limits and separation over the gain, ISI distributions beside them."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from neurotact.figures.style import INK, MUTED, PALE, RA, SA, class_colours, new_figure, printed

POPULATIONS = (("SA-I", SA, "mV per sd"), ("RA-I", RA, "mV per sd/ms"))
BELOW, ABOVE = 1 / 2, 8
"""Gains drawn beside the chosen one, as multiples of it."""


@printed
def draw_calibration(table: pd.DataFrame, isi: pd.DataFrame) -> Figure:
    """Both populations of a calibration: a row each.

    table, isi: of a `Calibration`. Left: share of silent trials and of intervals at the refractory floor, and the
    classes' separation; the chosen gain is marked, the gains that keep both limits have no shade. Right: the ISI
    distributions of the classes at half of the chosen gain, at it, and at eight times it (texture paper,
    Sec. III-A), over the intervals alone.
    """
    figure = new_figure(5.2)
    grid = figure.add_gridspec(4, 4, width_ratios=(1.5, 1, 1, 1))
    for row, (afferent, colour, unit) in enumerate(POPULATIONS):
        rows = table[table["afferent"] == afferent].sort_values("gain")
        shares, separation = (figure.add_subplot(grid[2 * row + i, 0]) for i in range(2))
        _draw_search(shares, separation, rows, colour, f"{afferent} gain ({unit})")
        shares.set_title(afferent, pad=14)
        chosen = float(rows["gain"][rows["chosen"]].iloc[0])
        panels: list[Axes] = []
        for column, (factor, title) in enumerate(((BELOW, "too low"), (1, "chosen"), (ABOVE, "too high"))):
            beside = panels[0] if panels else None
            axes = figure.add_subplot(grid[2 * row : 2 * row + 2, column + 1], sharex=beside, sharey=beside)
            panels.append(axes)
            gain = _nearest(rows["gain"].to_numpy(), chosen * factor)
            _draw_distributions(axes, isi[(isi["afferent"] == afferent) & (isi["gain"] == gain)])
            axes.set_title(f"{title}: {gain:g}")
            axes.tick_params(labelleft=column == 0)
            axes.set_xlabel("ISI (ms)")
        tallest = max(float(np.max(np.asarray(line.get_ydata()))) for axes in panels for line in axes.lines)
        panels[0].set_ylim(0, 1.3 * (tallest or 1.0))
        panels[0].set_ylabel(f"share of {afferent} intervals")
    handles, labels = figure.axes[2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 8), handlelength=1.2)
    return figure


def _draw_search(shares: Axes, separation: Axes, rows: pd.DataFrame, colour: str, quantity: str) -> None:
    gain = rows["gain"].to_numpy()
    chosen = rows[rows["chosen"]].iloc[0]
    for column, line, ink in (("silent_share", "--", MUTED), ("floor_share", "-", INK)):
        shares.plot(gain, rows[column], line, color=ink)
    named = ((0.0, "left", MUTED, "silent trials"), (1.0, "right", INK, "ISIs at the floor"))
    for place, side, ink, name in named:
        shares.text(place, 1.03, name, transform=shares.transAxes, ha=side, va="bottom", color=ink, fontsize=7)
    shares.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    shares.set_ylim(0, 1.02)
    shares.set_ylabel("share")
    shares.tick_params(labelbottom=False)
    separation.plot(gain, rows["separation"], color=colour)
    separation.plot(chosen["gain"], chosen["separation"], "o", color=colour)
    separation.set_ylim(min(0.0, 1.1 * rows["separation"].min()), 1.35 * max(rows["separation"].max(), 1e-3))
    separation.annotate(
        f"{chosen['gain']:g}", (chosen["gain"], chosen["separation"]), (0, 5), textcoords="offset points", ha="center"
    )
    separation.set_ylabel("separation (bit)")
    separation.set_xlabel(quantity)
    steps = np.sqrt(gain[1:] * gain[:-1])
    edges = np.concatenate([[gain[0] ** 2 / steps[0]], steps, [gain[-1] ** 2 / steps[-1]]])
    for axes in (shares, separation):
        axes.set_xscale("log")
        axes.set_xlim(edges[0], edges[-1])
        for left, right, admissible in zip(edges[:-1], edges[1:], rows["admissible"], strict=True):
            if not admissible:
                axes.axvspan(left, right, color=PALE, alpha=0.6, lw=0)


def _draw_distributions(axes: Axes, isi: pd.DataFrame) -> None:
    """A curve a class, each over its intervals; how many trials and afferents have none is written out."""
    heard = isi[np.isfinite(isi["isi_ms"])]
    labels = list(dict.fromkeys(isi["label"]))
    for colour, label in zip(class_colours(len(labels)), labels, strict=True):
        mine = heard[heard["label"] == label]
        total = mine["share"].sum()
        axes.plot(mine["isi_ms"], mine["share"] / total if total > 0 else mine["share"], color=colour, label=label)
    axes.set_xscale("log")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    none = abs(1 - heard["share"].sum() / len(labels))
    axes.text(0.97, 0.98, f"{none:.0%} of afferents\nwithout interval", transform=axes.transAxes, ha="right", va="top")


def _nearest(values: np.ndarray, wanted: float) -> float:
    return float(values[np.argmin(np.abs(np.log(values / wanted)))])
