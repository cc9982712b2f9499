"""Figures of the touch-modality study: recorded touches, accuracy over the number of steps, and costs.

They correspond to the paper's Figs. 2, 4 and 7. Tables are those of the study's `results.csv`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter
from neurotact_parts.opponents.pooled_gru import GRU
from neurotact_parts.studies.published_flops import touch_modality_flops
from neurotact_parts.studies.touch_modality.recurrent import LSTM

from neurotact.figures.style import INK, MUTED, PALE, SERIES, add_legend, keep_within, new_figure, printed, sequence
from neurotact.metrics.flops import Dense, cost

CELLS = {"LSTM": LSTM, "GRU": GRU}
TAXELS = (16, 64, 144, 256)
CLASSES = (3, 10, 20)
STEPS = (8, 10, 16, 20, 50, 100, 200, 256)
ACCURACY = "test accuracy (%)"
PUBLISHED = "#D55E00"
RANKS = ("strongest taxel", "second", "third")
RANK_COLOURS = tuple(SERIES[index][0] for index in (0, 4, 2))


@printed
def draw_touches(
    patterns: np.ndarray,
    windows: np.ndarray,
    labels: Sequence[str],
    sampling_rate_Hz: float,
    band_V: tuple[float, float],
) -> Figure:
    """One touch of each modality: its taxels over time, and the same averaged over windows.

    patterns: of Dataset A, `(touch, time, channel)` in V; windows: of Dataset C, `(touch, step, channel)` in V, drawn
    at a step's share of the touch.
    """
    figure = new_figure(3.9)
    axes = figure.subplots(2, len(patterns), sharey="row", squeeze=False)
    time_s, duration_s = np.arange(patterns.shape[1]) / sampling_rate_Hz, patterns.shape[1] / sampling_rate_Hz
    limit_mV = 1e3 * max(np.abs(windows - windows.mean(axis=1, keepdims=True)).max(), 1e-6)
    image = None
    for upper, lower, pattern, window, label in zip(axes[0], axes[1], patterns, windows, labels, strict=True):
        order = np.argsort(np.ptp(pattern, axis=0))
        for channel in order[:-3]:
            upper.plot(time_s, pattern[:, channel], color=PALE, linewidth=0.5, label="other taxels")
        for colour, rank, channel in zip(RANK_COLOURS, RANKS, order[:-4:-1], strict=False):
            upper.plot(time_s, pattern[:, channel], color=colour, linewidth=0.6, label=rank)
        upper.axhspan(*band_V, color=MUTED, alpha=0.12, linewidth=0, label="rest")
        upper.set_title(label)
        upper.set_xlabel("time (s)")
        shown = 1e3 * (window - np.median(window, axis=0)).T
        image = lower.imshow(
            shown,
            aspect="auto",
            cmap="RdBu_r",
            vmin=-limit_mV,
            vmax=limit_mV,
            interpolation="nearest",
            extent=(0.0, duration_s, len(shown) + 0.5, 0.5),
        )
        lower.set_xlabel(f"time (s), {len(window)} steps of {1e3 * duration_s / len(window):.0f} ms")
    axes[0, 0].set_ylabel("signal (V)")
    axes[1, 0].set_ylabel("taxel")
    if image is not None:
        figure.colorbar(image, ax=axes[1].tolist(), label="from its median (mV)", fraction=0.05)
    add_legend(figure, axes[0], ncols=5, handlelength=1.4)
    return figure


@printed
def draw_accuracy(
    results: pd.DataFrame, published: Mapping[tuple[str, int], Sequence[float]], touch_ms: float
) -> Figure:
    """Accuracy over the number of steps, a line per fold (Fig. 4): networks side by side, protocols below each other.

    Published values are shown only for the protocol `paper`.

    results: columns network, protocol, steps, fold, accuracy_test.
    published: accuracies of the five folds in percent, by network and steps. touch_ms: duration of N steps; a step's
    milliseconds are above.
    """
    networks, protocols = (list(dict.fromkeys(results[column])) for column in ("network", "protocol"))
    figure = new_figure(2.3 * len(protocols) + 1.0)
    axes = figure.subplots(len(protocols), len(networks), sharex=True, sharey=True, squeeze=False)
    for row, protocol in enumerate(protocols):
        for panel, network in zip(axes[row], networks, strict=True):
            here = results[(results["network"] == network) & (results["protocol"] == protocol)]
            means = {steps: float(np.mean(folds)) for (name, steps), folds in published.items() if name == network}
            _draw_folds(panel, here, means if protocol == "paper" else {})
            panel.set_title(network if row == 0 else "")
            panel.set_xlabel("steps N" if row == len(protocols) - 1 else "")
            if row == 0:
                _name_durations(panel, touch_ms)
        axes[row, 0].set_ylabel(f"{protocol}\n{ACCURACY}")
    keep_within(axes.ravel())
    add_legend(figure, axes.ravel().tolist(), ncols=5)
    return figure


def _draw_folds(panel: Axes, results: pd.DataFrame, published: Mapping[int, float]) -> None:
    table = 100 * results.pivot_table(index="steps", columns="fold", values="accuracy_test")
    for colour, fold in zip(sequence(table.shape[1]), table, strict=True):
        panel.plot(table.index, table[fold], ".-", color=colour, linewidth=0.8, label=f"fold {fold}")
    panel.plot(table.index, table.mean(axis=1), "o-", color=INK, linewidth=1.6, markersize=4, label="mean of folds")
    if published:
        steps = sorted(published)
        panel.plot(steps, [published[n] for n in steps], "--", color=PUBLISHED, label="published mean")
    panel.axhline(100 / 3, color=MUTED, linewidth=0.9, linestyle=":", label="chance")
    panel.set_xscale("log")
    panel.set_xticks(STEPS, [str(steps) for steps in STEPS], rotation=90)
    panel.minorticks_off()
    panel.grid(axis="y")


def _name_durations(panel: Axes, touch_ms: float) -> None:
    """An axis above, with the duration of a step."""
    above = panel.secondary_xaxis("top")
    above.set_xticks(STEPS, [f"{touch_ms / steps:.0f}" for steps in STEPS], rotation=90)
    above.minorticks_off()
    above.set_xlabel("a step (ms)")


@printed
def draw_other_steps(results: pd.DataFrame, steps: Sequence[int], touch_ms: float) -> Figure:
    """Accuracy of weights trained on N steps and used on M, a panel per network, means over folds.

    results: columns network, steps, fold and `used_on_<M>` for each M of `steps`. touch_ms: duration of N steps.
    """
    networks = list(dict.fromkeys(results["network"]))
    figure = new_figure(2.6)
    axes = figure.subplots(1, len(networks), sharey=True, squeeze=False)[0]
    trained = sorted(results["steps"].unique())
    chance, best = (
        100 / 3,
        100 * results.groupby(["network", "steps"])[[f"used_on_{m}" for m in steps]].mean().max().max(),
    )
    image = None
    for panel, network in zip(axes, networks, strict=True):
        here = results[results["network"] == network].groupby("steps")[[f"used_on_{m}" for m in steps]].mean()
        table = 100 * here.reindex(trained).to_numpy()
        image = panel.imshow(table, cmap="viridis", vmin=chance, vmax=best, aspect="auto")
        for (i, j), value in np.ndenumerate(table):
            colour = "white" if value < 0.5 * (chance + best) else INK
            panel.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=6, color=colour)
        panel.set_title(network)
        panel.set_xticks(range(len(steps)), [str(m) for m in steps])
        panel.set_yticks(range(len(trained)), [f"{n} ({touch_ms / n:.0f} ms)" for n in trained])
        panel.set_xlabel("used on M steps")
    axes[0].set_ylabel("trained on N steps (ms per step)")
    if image is not None:
        figure.colorbar(image, ax=axes.tolist(), label=ACCURACY, fraction=0.04)
    return figure


@printed
def draw_scaling(networks: Mapping[str, tuple[Literal["LSTM", "GRU"], int]]) -> Figure:
    """FLOPs of a step and trainable parameters over sensors, and FLOPs over classes (Fig. 7a, b).

    networks: cell and neurons by name. Lines are for 10 classes, their bands reach from 3 to 20; rings are published
    values.
    """
    figure = new_figure(2.7)
    flops, parameters, by_classes = figure.subplots(1, 3, squeeze=False)[0]
    for (colour, marker), (name, (cell, hidden)) in zip(SERIES, networks.items(), strict=False):
        few, middle, many = (
            [cost(CELLS[cell](n, hidden), Dense(hidden, classes, "softmax")) for n in TAXELS] for classes in CLASSES
        )
        for axes, measure in ((flops, "flops"), (parameters, "parameters")):
            low, line, high = ([getattr(one, measure) for one in costs] for costs in (few, middle, many))
            axes.fill_between(TAXELS, low, high, color=colour, alpha=0.25, lw=0)
            axes.plot(TAXELS, line, color=colour, marker=marker, ms=3, label=name)
        style: Any = {"ls": "", "marker": "o", "ms": 7, "mfc": "none", "mew": 0.9, "color": colour}
        flops.plot(TAXELS, [touch_modality_flops(cell, hidden, n, CLASSES[1]) for n in TAXELS], **style)
        least = [costs[0].flops for costs in (few, middle, many)]
        by_classes.plot(CLASSES, least, color=colour, marker=marker, ms=3)
        published = [touch_modality_flops(cell, hidden, TAXELS[0], classes) for classes in CLASSES]
        by_classes.plot(CLASSES, published, **style)
    flops.plot([], [], **(style | {"color": INK}), label="published")
    titles = ("FLOPs per step, 3 to 20 classes", "parameters, 3 to 20 classes", f"FLOPs per step, {TAXELS[0]} sensors")
    for axes, title, ticks in zip((flops, parameters, by_classes), titles, (TAXELS, TAXELS, CLASSES), strict=True):
        axes.set(title=title, xlabel="classes" if ticks is CLASSES else "sensors")
        axes.set_xticks(ticks)
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.grid(axis="y")
    add_legend(figure, [flops], ncols=len(networks) + 1)
    return figure


@printed
def draw_images(images: np.ndarray, labels: Sequence[str], shown: int = 5) -> Figure:
    """Some of the images of one touch of each class, all on one scale.

    images: of Dataset B in mV, `(touch, image, 64, 64)`.
    """
    figure = new_figure(1.1 + 1.25 * len(images))
    axes = figure.subplots(len(images), shown, squeeze=False)
    limit_mV = max(float(np.percentile(np.abs(images), 99.5)), 1e-6)
    numbers = np.linspace(0, images.shape[1] - 1, shown).round().astype(int)
    drawn = None
    for row, touch, label in zip(axes, images, labels, strict=True):
        for panel, number in zip(row, numbers, strict=True):
            drawn = panel.imshow(touch[number], cmap="RdBu_r", vmin=-limit_mV, vmax=limit_mV, interpolation="nearest")
            panel.set(xticks=[], yticks=[])
        row[0].set_ylabel(label)
    for panel, number in zip(axes[0], numbers, strict=True):
        panel.set_title(f"image {number + 1}")
    if drawn is not None:
        figure.colorbar(drawn, ax=axes.ravel().tolist(), label="from rest (mV)", fraction=0.03)
    return figure


@printed
def draw_image_networks(results: pd.DataFrame) -> Figure:
    """Training and test accuracy of each network, one mark per fold.

    results: rows with `network`, `protocol`, `fold`, `accuracy_train` and `accuracy_test`.
    """
    protocols = sorted(results["protocol"].unique())
    networks = list(dict.fromkeys(results["network"]))
    figure = new_figure(2.6)
    for panel, protocol in zip(
        figure.subplots(1, len(protocols), sharey=True, squeeze=False)[0], protocols, strict=True
    ):
        for x, ((colour, marker), network) in enumerate(zip(SERIES, networks, strict=False)):
            rows = results[(results["protocol"] == protocol) & (results["network"] == network)]
            along = x + (np.arange(len(rows)) - (len(rows) - 1) / 2) * 0.1
            panel.scatter(along, 100 * rows["accuracy_train"], marker=marker, facecolors="none", edgecolors=colour)
            panel.scatter(along, 100 * rows["accuracy_test"], marker=marker, color=colour)
        panel.axhline(60, color=PUBLISHED, linestyle="--", linewidth=0.9)
        panel.set_xticks(range(len(networks)), networks)
        panel.set_title(f"protocol {protocol}")
        panel.set_ylim(0, 102)
    figure.axes[0].set_ylabel("accuracy (%)")
    return figure
