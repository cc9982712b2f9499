"""Figures of the stiffness study: the trade-off (Fig. 6), accuracy by N_max (Table III), signals (Figs. 2 and 5)."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.figures.style import (
    INK,
    MUTED,
    SERIES,
    Drawn,
    add_legend,
    keep_within,
    new_figure,
    printed,
    series_style,
)

CLASSIFIERS = ("R-FC", "S-FC", "R-ELM", "S-ELM", "H-ELM")
FEATURES = ("4F", "8F", "16F")
N_MAX = (50, 100, 200, 300)
PUBLISHED_ACCURACY = {
    # At N_max 50, 100, 200, 300, in percent, from the references and differences of Table III.
    ("R-FC", "4F"): (79.8, 80.2, 81.4, 81.7),
    ("R-FC", "8F"): (94.4, 94.7, 94.8, 94.7),
    ("R-FC", "16F"): (95.5, 95.4, 95.4, 95.5),
    ("S-FC", "4F"): (83.2, 83.1, 82.9, 83.1),
    ("S-FC", "8F"): (94.0, 94.0, 94.0, 94.1),
    ("S-FC", "16F"): (95.3, 95.3, 95.5, 95.4),
    ("R-ELM", "4F"): (83.7, 87.2, 89.6, 90.6),
    ("R-ELM", "8F"): (88.9, 93.8, 95.3, 95.7),
    ("R-ELM", "16F"): (87.8, 92.5, 94.1, 94.6),
    ("S-ELM", "4F"): (79.4, 82.8, 84.4, 84.7),
    ("S-ELM", "8F"): (90.2, 94.1, 95.9, 96.3),
    ("S-ELM", "16F"): (87.5, 91.7, 93.8, 94.5),
    ("H-ELM", "4F"): (63.8, 72.8, 79.8, 82.7),
    ("H-ELM", "8F"): (79.8, 86.5, 89.8, 91.1),
    ("H-ELM", "16F"): (84.1, 89.7, 92.8, 93.5),
}
PUBLISHED_FLOPS = {
    # At N_max = 100.
    "R-FC": (3444, 5448, 8592),
    "S-FC": (3972, 6024, 9116),
    "R-ELM": (3924, 6504, 10472),
    "S-ELM": (5064, 7752, 11456),
    "H-ELM": (3556, 6164, 10128),
}


def trade_off(results: pd.DataFrame) -> Drawn:
    """Accuracy against FLOPs of the whole unit at N_max = 100 (or the largest run below it), as Fig. 6."""
    n_max = max([n for n in results["n_max"].unique() if n <= 100], default=int(results["n_max"].min()))
    rows = results[results["n_max"] == n_max]
    means = rows.groupby(["protocol", "classifier", "features"], sort=False)[["flops", "accuracy_test"]].mean()
    best = means["accuracy_test"].idxmax()
    caption = (
        f"Mean test accuracy against the FLOPs of the whole unit, N_max = {n_max}, a line per classifier through the "
        "sets 4F, 8F and 16F: published (stiffness paper, Fig. 6 and Table III), and ours by protocol."
    )
    alt = f"Best of ours: {best[1]} with {best[2]}, {100 * means['accuracy_test'].max():.1f} % ({best[0]})."
    return Drawn("trade-off", "Accuracy against FLOPs", draw_trade_off(means), caption, alt)


def by_n_max(results: pd.DataFrame) -> Drawn:
    """Accuracy by N_max, ours and published (Table III)."""
    first = results["protocol"].iloc[0]
    rows = results[results["protocol"] == first]
    caption = (
        f"Mean test accuracy by the largest allowed number of hidden neurons: ours above (protocol "
        f"{first}), published below (Table III)."
    )
    return Drawn("by-n-max", "Accuracy by N_max", draw_by_n_max(rows), caption, caption)


def signals(arrays: Mapping[str, np.ndarray]) -> Drawn:
    """A grasp of each object, and the mean peak of each (Figs. 2 and 5)."""
    caption = (
        "Left: one simulated grasp and release of each object, one colour per channel. Right: the deepest channel of "
        "all its peaks, each divided by its depth: mean and middle half. Softer objects have a longer rise."
    )
    return Drawn("signals", "Signals and their peaks", draw_signals(arrays), caption, caption)


@printed
def draw_trade_off(means: pd.DataFrame) -> Figure:
    """A panel for the published values and one per protocol; means indexed by protocol, classifier, features."""
    protocols = list(dict.fromkeys(means.index.get_level_values("protocol")))
    figure = new_figure(3.1)
    grid = figure.subplots(1, 1 + len(protocols), sharex=True, sharey=True, squeeze=False)[0]
    for index, classifier in enumerate(CLASSIFIERS):
        accuracy = [PUBLISHED_ACCURACY[classifier, features][1] for features in FEATURES]
        grid[0].plot(
            1e-3 * np.array(PUBLISHED_FLOPS[classifier]), accuracy, label=classifier, ms=4, **series_style(index)
        )
        for axes, protocol in zip(grid[1:], protocols, strict=True):
            keys = [(protocol, classifier, features) for features in FEATURES]
            there = means.loc[[key for key in keys if key in means.index]]
            axes.plot(
                1e-3 * there["flops"], 100 * there["accuracy_test"], label=classifier, ms=4, **series_style(index)
            )
    titles = (f"ours, {protocol}{' (leaks)' if protocol == 'paper' else ''}" for protocol in protocols)
    for axes, title in zip(grid, ["published", *titles], strict=True):
        axes.set_title(title)
        axes.grid()
    keep_within(grid)
    figure.supxlabel("FLOPs of the whole unit (thousands)", size="medium")
    grid[0].set_ylabel("test accuracy (%)")
    add_legend(figure, grid, ncols=5)
    return figure


@printed
def draw_by_n_max(rows: pd.DataFrame) -> Figure:
    """A column per feature set: ours above, published below, on one scale."""
    figure = new_figure(4.2)
    grid = figure.subplots(2, len(FEATURES), sharex=True, sharey=True)
    means = rows.groupby(["features", "classifier", "n_max"])["accuracy_test"].mean()
    for (above, below), features in zip(grid.T, FEATURES, strict=True):
        for index, classifier in enumerate(CLASSIFIERS):
            style = series_style(index)
            if (features, classifier) in means.index:
                ours = means.loc[features, classifier]
                above.plot(ours.index, 100 * ours, label=classifier, ms=4, **style)
            below.plot(N_MAX, PUBLISHED_ACCURACY[classifier, features], ms=4, label=classifier, **style)
        above.set_title(features)
        below.set(xlabel="$N_\\mathrm{max}$", xticks=N_MAX)
    for axes in grid.ravel():
        axes.grid(axis="y")
    keep_within(grid.ravel())
    for axes, whose in zip(grid[:, 0], ("ours", "published"), strict=True):
        axes.set_ylabel(f"{whose}\ntest accuracy (%)")
    add_legend(figure, grid.ravel(), ncols=5)
    return figure


@printed
def draw_signals(arrays: Mapping[str, np.ndarray]) -> Figure:
    """Recordings on the left, normalised peaks on the right, a row per object."""
    labels, rate_Hz = arrays["shown_labels"], float(arrays["sampling_rate_Hz"])
    figure = new_figure(1.35 * len(labels) + 0.9)
    grid = figure.subplots(len(labels), 2, squeeze=False, sharex="col", sharey="col", width_ratios=(2, 1))
    for (left, right), label, signal in zip(grid, labels, arrays["shown"], strict=True):
        for channel, values in enumerate(signal.T):
            name = f"channel {channel + 1}"
            left.plot(np.arange(len(signal)) / rate_Hz, values, lw=0.5, color=channel_colour(channel), label=name)
        left.set(ylabel=f"{label}\nsignal (mV)")
        _paint_peaks(right, arrays["peaks"][arrays["labels"] == label], rate_Hz)
        for axes in (left, right):
            axes.grid(axis="y")
    grid[-1, 0].set_xlabel("time (s)")
    grid[-1, 1].set_xlabel("time from the cut (ms)")
    add_legend(figure, [grid[0, 0], grid[0, 1]], ncols=6, handlelength=1.4)
    return figure


def channel_colour(channel: int) -> str:
    """The colour of a channel in every figure of signals."""
    return SERIES[(0, 4, 2, 3, 1, 5)[channel % len(SERIES)]][0]


def _paint_peaks(axes: Axes, peaks: np.ndarray, rate_Hz: float) -> None:
    """The deepest channel of each peak over its depth: mean and quartiles."""
    deepest = peaks.min(axis=1).argmin(axis=1)
    lowest = peaks[np.arange(len(peaks)), :, deepest]
    shape = lowest / -lowest.min(axis=1, keepdims=True)
    time_ms = 1e3 * np.arange(shape.shape[1]) / rate_Hz
    low, high = np.quantile(shape, (0.25, 0.75), axis=0)
    axes.fill_between(time_ms, low, high, color=MUTED, alpha=0.35, lw=0, label="middle half of the peaks")
    axes.plot(time_ms, shape.mean(axis=0), color=INK, lw=0.9, label="their mean")
    axes.set_ylabel("over its depth")
