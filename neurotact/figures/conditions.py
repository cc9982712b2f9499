"""Figures of conditions: accuracy of networks and signals under each of them (Figs. 9 and 12)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from neurotact.figures.style import INK, MUTED, new_figure, printed, sequence, series_style


@printed
def draw_conditions(table: pd.DataFrame) -> Figure:
    """Accuracy of networks (rows) under every condition (columns); outlined if the condition was not in training.

    table: dataset (of training), condition (in words), known, accuracy_test; means over the rest are drawn.
    """
    rows, columns = (list(dict.fromkeys(table[name])) for name in ("dataset", "condition"))
    groups = table.groupby(["dataset", "condition"], sort=False)
    share = groups["accuracy_test"].mean().unstack("condition").loc[rows, columns]
    unknown = ~groups["known"].all().unstack("condition").loc[rows, columns].to_numpy(bool)
    figure = new_figure(0.42 * len(rows) + 1.7)
    axes = figure.subplots()
    mesh = axes.pcolormesh(100 * share, cmap="Blues", vmin=0, vmax=100, edgecolors="white", linewidth=0.8)
    for (down, across), value in np.ndenumerate(share.to_numpy(float)):
        colour = "white" if value > 0.6 else INK
        weight = "bold" if unknown[down, across] else "normal"
        axes.text(across + 0.5, down + 0.5, f"{100 * value:.1f}", ha="center", va="center", color=colour, weight=weight)
        if unknown[down, across]:
            box = Rectangle((across + 0.03, down + 0.04), 0.94, 0.92, fill=False, ec="#D55E00", lw=1.8, gid="unknown")
            axes.add_patch(box)
    axes.set_xticks(np.arange(len(columns)) + 0.5, [name.replace(", ", "\n") for name in columns])
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows)
    axes.set(xlabel="tested on", ylabel="trained on")
    axes.set_ylim(len(rows), 0)
    axes.tick_params(length=0)
    figure.colorbar(mesh, ax=axes, label="test accuracy (%)")
    return figure


@printed
def draw_signals(table: pd.DataFrame, names: Sequence[str]) -> Figure:
    """Peak of the strongest taxel over force (left) and principal frequency over gratings (right; Fig. 12, Sec. III-A).

    table: of `signals.csv`; names: of the gratings, in the order of their numbers.
    """
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2)
    gratings, speeds = sorted(set(table["grating"])), sorted(set(table["speed_mm_per_s"]))
    for shade, grating, name in zip(sequence(len(gratings)), gratings, names, strict=True):
        peaks = table[table["grating"] == grating].groupby("force_N")["peak_mV"].mean()
        left.plot(peaks.index, peaks, marker="o", ms=3, color=shade, label=name)
    left.set(xlabel="force (N)", ylabel="peak (mV)", title="strongest taxel, conditioned")
    left.set_xticks(sorted(set(table["force_N"])))
    left.set_ylim(bottom=0)
    left.legend(title="grating", ncols=2)
    for index, speed in enumerate(speeds):
        rows = table[table["speed_mm_per_s"] == speed]
        means = rows.groupby("grating")[["principal_Hz", "expected_Hz"]].mean()
        style: Any = {**series_style(index), "mfc": "none", "ms": 5, "ls": ""}
        right.plot(means.index, means["principal_Hz"], label=f"{speed:g} mm/s", **style)
        right.plot(means.index, means["expected_Hz"], color=MUTED, lw=0.9, label="speed / (pitch + 1 mm)")
    right.set_xticks(gratings, names)
    right.set(xlabel="grating", ylabel="principal frequency (Hz)", title="highest line of the spectrum")
    right.set_ylim(bottom=0)
    _legend(right)
    for axes in (left, right):
        axes.grid(axis="y")
    return figure


@printed
def draw_same_drive(table: pd.DataFrame, published: Sequence[tuple[float, float]]) -> Figure:
    """Spikes of one afferent over its refractory period, a line per drive (Fig. 4).

    table: of `same_drive.csv`; published: pairs of t_ref_ms and spikes.
    """
    figure = new_figure(2.6, 4.6)
    axes = figure.subplots()
    recorded = table[table["drive"] == "recorded"]
    labels = list(dict.fromkeys(recorded["label"]))
    for label, shade in zip(labels, sequence(len(labels)), strict=True):
        rows = recorded[recorded["label"] == label]
        axes.plot(rows["t_ref_ms"], rows["spikes"], marker=".", color=shade, label=f"recorded, {label}")
    constant = table[table["drive"] == "constant"]
    axes.plot(constant["t_ref_ms"], constant["spikes"], ls="--", color=MUTED, marker=".", label="constant")
    style: Any = {"ls": "", "marker": "D", "ms": 7, "mfc": "none", "mec": "#D55E00", "mew": 1.3, "zorder": 4}
    for t_ref_ms, spikes in published:
        axes.plot(t_ref_ms, spikes, label="published", **style)
    axes.set(xlabel=r"$t_\mathrm{ref}$ (ms)", ylabel="spikes")
    axes.set_xticks(sorted(set(table["t_ref_ms"])))
    axes.set_ylim(bottom=0)
    axes.grid(axis="y")
    _legend(axes, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _legend(axes: Axes, **location: Any) -> None:
    """A legend with each label once."""
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(list(handles.values()), list(handles), **location)
