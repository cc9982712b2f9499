"""The choice of a calibrated encoder's gains: limits and separation over the gain, with ISI distributions."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from neurotact.figures.style import INK, MUTED, PALE, RA, SA, TOTAL, new_figure, printed
from neurotact.tables import natural

COLOURS = {"SA-I": SA, "RA-I": RA}
UNITS = {"SA-I": "mV per sd", "RA-I": "mV per sd/ms"}
CMAPS = {"SA-I": "Blues", "RA-I": "Oranges"}
FURTHER = TOTAL, "Greens"
"""Colour and map of another population, such as PC."""
BELOW, ABOVE = 1 / 2, 8
"""Gains drawn next to the chosen one, as multiples of it."""


@printed
def draw_calibration(
    table: pd.DataFrame, isi: pd.DataFrame, units: Mapping[str, str] = UNITS, thresholds: Collection[str] = ()
) -> Figure:
    """The populations of a calibration, one row each.

    table, isi: of a `Calibration`. units: of the gain of each population. thresholds: populations with a threshold in
    place of a gain. Left: share of silent trials and of intervals at the refractory floor, and the classes' separation;
    the chosen gain is marked, gains outside a limit are shaded.
    Right: the ISI distributions of the classes at half of the chosen gain, at it, and at eight times it (texture paper,
    Sec. III-A), over the intervals: one row per class, darker for more intervals; above them, the share of trials
    and afferents without an interval.
    """
    labels = sorted(set(isi["label"].astype(str)), key=natural)
    afferents = list(dict.fromkeys(table["afferent"]))
    figure = new_figure(max(5.2, 3.0 + 0.28 * len(labels)) * len(afferents) / 2)
    grid = figure.add_gridspec(2 * len(afferents), 5, width_ratios=(1.6, 1, 1, 1, 0.06))
    for row, afferent in enumerate(afferents):
        colour, cmap = COLOURS.get(afferent, FURTHER[0]), CMAPS.get(afferent, FURTHER[1])
        rows = table[table["afferent"] == afferent].sort_values("gain")
        shares, separation = (figure.add_subplot(grid[2 * row + i, 0]) for i in range(2))
        is_threshold = afferent in thresholds
        what = "threshold" if is_threshold else "gain"
        _draw_search(shares, separation, rows, colour, f"{afferent} {what} ({units[afferent]})")
        shares.set_title(afferent, pad=14)
        gains = _gains_beside(rows, is_threshold=is_threshold)
        mine = isi[isi["afferent"] == afferent]
        shown = [_distributions(mine[mine["gain"] == gain], labels) for gain in gains.values()]
        darkest = float(shown[1][1].max()) or 1.0  # of the chosen gain: a class of one interval must not pale the rest
        for column, ((title, gain), intervals) in enumerate(zip(gains.items(), shown, strict=True)):
            axes = figure.add_subplot(grid[2 * row : 2 * row + 2, column + 1])
            isi_ms, shares_of, none = intervals
            mesh = _draw_distributions(axes, isi_ms, shares_of, labels if column == 0 else [], darkest, cmap)
            axes.set_title(f"{title}: {gain:g}", pad=14)
            axes.text(0.5, 1.02, f"no interval: {none:.0%}", transform=axes.transAxes, ha="center", fontsize=6.5)
            axes.set_xlabel("ISI (ms)")
        bar = figure.colorbar(mesh, cax=figure.add_subplot(grid[2 * row : 2 * row + 2, 4]), extend="max")
        bar.set_label(f"share of {afferent} intervals")
        bar.ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], min_n_ticks=2))
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1.0))
    return figure


def _gains_beside(rows: pd.DataFrame, *, is_threshold: bool) -> dict[str, float]:
    """The gains or thresholds whose distributions are drawn, by their names."""
    chosen = float(rows["gain"][rows["chosen"]].iloc[0])
    low, high = (1 / ABOVE, 1 / BELOW) if is_threshold else (BELOW, ABOVE)
    factors = {"too low": low, "chosen": 1, "too high": high}
    return {title: _nearest(rows["gain"].to_numpy(), chosen * factor) for title, factor in factors.items()}


def _draw_search(shares: Axes, separation: Axes, rows: pd.DataFrame, colour: str, quantity: str) -> None:
    gain = rows["gain"].to_numpy()
    chosen = rows[rows["chosen"]].iloc[0]
    for column, line, ink in (("silent_share", "--", MUTED), ("floor_share", "-", INK)):
        shares.plot(gain, rows[column], line, color=ink)
    named = ((0.0, "left", MUTED, "silent trials"), (1.0, "right", INK, "ISIs at the floor"))
    for x, side, ink, name in named:
        shares.text(x, 1.03, name, transform=shares.transAxes, ha=side, va="bottom", color=ink, fontsize=7)
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


def _distributions(isi: pd.DataFrame, labels: Sequence[str]) -> tuple[np.ndarray, np.ndarray, float]:
    """The bins' middles in ms, the share of each class's intervals in them `(class, bin)`, and the share without."""
    finite = isi[np.isfinite(isi["isi_ms"])]
    shares = finite.pivot_table(index="label", columns="isi_ms", values="share", sort=True).reindex(list(labels))
    values = shares.fillna(0.0).to_numpy(float)
    totals = values.sum(axis=1, keepdims=True)
    none = abs(1 - finite["share"].sum() / len(labels))
    return shares.columns.to_numpy(float), values / np.where(totals > 0, totals, 1.0), none


def _draw_distributions(
    axes: Axes, isi_ms: np.ndarray, shares: np.ndarray, labels: Sequence[str], darkest: float, cmap: str
) -> QuadMesh:
    """One row per class, named if `labels` are given; shares from `darkest` on have one colour."""
    steps = np.sqrt(isi_ms[1:] * isi_ms[:-1])
    outer = (steps[0], steps[-1]) if len(steps) else (1.1 * isi_ms[0], 0.9 * isi_ms[0])
    edges = np.concatenate([[isi_ms[0] ** 2 / outer[0]], steps, [isi_ms[-1] ** 2 / outer[1]]])
    mesh = axes.pcolormesh(edges, np.arange(len(shares) + 1), shares, cmap=cmap, vmin=0, vmax=darkest)
    axes.set_xscale("log")
    axes.set_ylim(len(shares), 0)
    axes.set_yticks(np.arange(len(shares)) + 0.5, labels or [""] * len(shares))
    axes.tick_params(axis="y", length=0)
    axes.hlines(np.arange(1, len(shares)), edges[0], edges[-1], color="white", lw=0.8)
    return mesh


def _nearest(values: np.ndarray, wanted: float) -> float:
    return float(values[np.argmin(np.abs(np.log(values / wanted)))])
