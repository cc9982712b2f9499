"""Figures of the study of real hardness: accuracy with its confidence and cost, and the presses themselves."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.figures.style import INK, MUTED, SERIES, Drawn, add_legend, keep_within, new_figure, printed
from neurotact.metrics.resampled import resampled_interval
from neurotact.report.wording import energy


def accuracy_and_cost(results: pd.DataFrame) -> Drawn:
    """Mean accuracy over splits with its confidence interval, and the estimated energy of a decision."""
    means = intervals(results)
    best = [rows.loc[rows["mean"].idxmax()] for _, rows in means.groupby("protocol", sort=False)]
    words = "; ".join(
        f"{row['protocol']}, {row['chain']} with {row['features']}, {100 * row['mean']:.1f} % "
        f"({100 * row['low']:.1f} to {100 * row['high']:.1f})"
        for row in best
    )
    caption = (
        "Mean test accuracy over splits (dot), with its 95 % interval (corrected for splits that share presses), and "
        f"that of each split (grey); the estimated energy of a decision's arithmetic. The most accurate: {words}."
    )
    alt = "; ".join(
        f"{row['chain']} {row['features']} {100 * row['mean']:.1f} % at {energy(row['energy_estimate_nJ'])}"
        for _, row in means.iterrows()
    )
    return Drawn("accuracy-and-cost", "Accuracy and its cost", draw_accuracy_and_cost(results), caption, alt)


def presses(arrays: Mapping[str, np.ndarray]) -> Drawn:
    """The input of both chains: the deepest taxel of each cube's presses."""
    caption = (
        "Smoothed presses, the input of both chains: the deepest taxel of every press, by cube; mean (line), middle "
        "half (shade) and the single presses (pale). The minimum is at 0."
    )
    return Drawn("presses", "The presses", draw_presses(arrays), caption, caption)


def intervals(results: pd.DataFrame) -> pd.DataFrame:
    """Mean accuracy and 95 % interval of each chain and set of features, with its mean energy estimate.

    Columns: protocol, chain, features, energy_estimate_nJ, mean, low, high (NaN for one or two splits).
    """
    rows = []
    for (protocol, chain, features), group in results.groupby(["protocol", "chain", "features"], sort=False):
        values = group["accuracy_test"].to_numpy(float)
        sides = int(group["n_train"].mean()), int(group["n_test"].mean())
        interval = resampled_interval(values, *sides)
        rows.append([protocol, chain, features, group["energy_estimate_nJ"].mean(), *interval])
    return pd.DataFrame(rows, columns=["protocol", "chain", "features", "energy_estimate_nJ", "mean", "low", "high"])


@printed
def draw_accuracy_and_cost(results: pd.DataFrame) -> Figure:
    """A row per chain and set of features; a panel per protocol (grey: single splits), and the energy of a decision."""
    means = intervals(results)
    protocols, chains = (list(dict.fromkeys(means[column])) for column in ("protocol", "chain"))
    places = [(chain, name) for chain in chains for name in dict.fromkeys(means["features"][means["chain"] == chain])]
    heights = {key: row + 0.5 * chains.index(key[0]) for row, key in enumerate(places)}
    figure = new_figure(1.1 + 0.17 * max(heights.values()))
    grid = figure.subplots(1, len(protocols) + 1, sharey=True, width_ratios=[2] * len(protocols) + [1.2])
    for axes, protocol in zip(grid, protocols, strict=False):
        _paint_accuracy(axes, results[results["protocol"] == protocol], heights)
        axes.set(title=protocol, xlabel="test accuracy (%)")
        keep_within([axes], axis="x")
    energy = means.groupby(["chain", "features"], sort=False)["energy_estimate_nJ"].mean()
    grid[-1].barh([heights[str(chain), str(name)] for chain, name in energy.index], energy, 0.6, color=MUTED)
    grid[-1].set(title="cost of a decision", xlabel="energy estimate (nJ)")
    for axes in grid:
        axes.grid(axis="x")
    grid[0].set_yticks(list(heights.values()), [f"{chain}, {name}" for chain, name in places])
    grid[0].invert_yaxis()
    add_legend(figure, [grid[0]], ncols=2)
    return figure


def _paint_accuracy(axes: Axes, rows: pd.DataFrame, heights: Mapping[tuple[str, str], float]) -> None:
    """The mean of each chain and set of features with its interval, over its splits; from the least of them on."""
    y = [heights[key] for key in zip(rows["chain"], rows["features"], strict=True)]
    axes.plot(100 * rows["accuracy_test"], y, ls="", marker="|", ms=6, mew=0.7, color=MUTED, label="single splits")
    means = intervals(rows)
    y = [heights[key] for key in zip(means["chain"], means["features"], strict=True)]
    mean, low, high = (100 * means[end].fillna(means["mean"]) for end in ("mean", "low", "high"))
    style: Any = {"fmt": "o", "ms": 4, "lw": 0.9, "capsize": 2, "color": SERIES[0][0]}
    axes.errorbar(mean, y, xerr=[mean - low, high - mean], label="mean and its 95 % interval", **style)


@printed
def draw_presses(arrays: Mapping[str, np.ndarray]) -> Figure:
    """A panel per cube."""
    names = sorted(set(arrays["labels"].tolist()), key=lambda name: (len(name), name))
    figure = new_figure(2.2)
    grid = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(grid, names, strict=True):
        presses = arrays["presses"][arrays["labels"] == name]
        deepest = presses.min(axis=1).argmin(axis=1)
        lines = presses[np.arange(len(presses)), :, deepest]
        lowest = int(np.median(lines.argmin(axis=1)))
        time_ms = 1e3 * (np.arange(lines.shape[1]) - lowest) / float(arrays["sampling_rate_Hz"])
        axes.plot(time_ms, lines.T, color=MUTED, lw=0.3, alpha=0.35)
        axes.fill_between(time_ms, *np.quantile(lines, (0.25, 0.75), axis=0), color=MUTED, alpha=0.4, lw=0)
        axes.plot(time_ms, lines.mean(axis=0), color=INK, lw=1.2)
        axes.set(title=name, xlabel="time (ms)")
        axes.grid(axis="y")
    grid[0].set_ylabel("deepest taxel (mV)")
    return figure
