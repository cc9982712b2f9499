"""Figures of the systems before the texture paper and its RSNN: accuracy over signal, features, encoders and costs."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from neurotact.figures.style import (
    INK,
    MUTED,
    PALE,
    Drawn,
    add_legend,
    bars,
    keep_within,
    new_figure,
    printed,
    series_style,
)

CLASSIFIERS = ("kNN", "SVM", "ELM", "SNN", "RSNN")
PARTS = (("flops_encoder", "encoder"), ("flops_features", "features"), ("flops_classifier", "classifier"))
PART_SERIES = (0, 3, 2)
"""Colours and shapes of the parts, other than those of the afferents."""
USUAL_ms = 150.0
"""The window of the comparisons at one window: the texture paper's choice."""


def drawings(results: pd.DataFrame) -> Iterator[Drawn]:
    """The figures of the report, from `results.csv`."""
    at_ms = window_shown(results)
    yield Drawn(
        "accuracy-over-signal",
        "Accuracy over the length of the signal",
        draw_over_signal(results),
        "Test accuracy over the length of the signal before a decision. For each plain classifier, the best "
        "features on validation trials of that window; they need all of it. Hollow: a spiking "
        "network with early exit. Bars: deviations over random starts. Dotted: chance.",
        "Accuracy rises with the signal for all; curves of kNN, SVM, ELM, SNN and RSNN for each encoder.",
    )
    yield Drawn(
        "features-and-classifiers",
        f"Features and classifiers at {at_ms:g} ms",
        draw_grid(results, at_ms),
        f"Test accuracy (%) of every system on windows of {at_ms:g} ms, decided at the window's end. Bold, with its "
        "reference: a system of the texture paper's Table I.",
        "A grid of accuracies: a row per pair of features and classifier, a column per encoder.",
    )
    yield Drawn(
        "accuracy-over-cost",
        f"Accuracy and cost at {at_ms:g} ms",
        draw_over_cost(results, at_ms),
        f"Test accuracy over the operations of a decision on {at_ms:g} ms, encoder included; hollow: early exit.",
        "Points of accuracy over FLOPs on a logarithmic axis, a panel per encoder.",
    )
    yield Drawn(
        "parts-of-the-cost",
        f"Distribution of the operations at {at_ms:g} ms",
        draw_parts(results, at_ms),
        "Operations of encoder, features and classifier, and of all three, for the systems of the texture paper's "
        "Table I, its references in brackets, and for the networks on each encoder.",
        "A mark for each part and one for the sum of each system on a logarithmic axis; the Izhikevich encoder alone "
        "costs more than a whole network on LIF.",
    )


def window_shown(results: pd.DataFrame) -> float:
    """The window nearest to the usual one."""
    windows = np.unique(results["window_ms"])
    return float(windows[np.abs(windows - USUAL_ms).argmin()])


def best_features(results: pd.DataFrame) -> pd.DataFrame:
    """For each encoder, classifier and window, the rows of the best features on validation trials.

    >>> rows = pd.DataFrame({"encoder": "LIF", "classifier": "kNN", "window_ms": 50.0, "decision": "window",
    ...                      "features": ["rate", "image"], "accuracy_validation": [0.5, 0.6],
    ...                      "accuracy_test": [0.7, 0.55]})
    >>> best_features(rows)["features"].tolist()
    ['image']
    """
    whole = results[results["decision"] == "window"]
    keys = ["encoder", "classifier", "window_ms"]
    means = whole.groupby([*keys, "features"], as_index=False)["accuracy_validation"].mean()
    best = means.loc[means.groupby(keys)["accuracy_validation"].idxmax(), [*keys, "features"]]
    return whole.merge(best, on=[*keys, "features"])


@printed
def draw_over_signal(results: pd.DataFrame) -> Figure:
    """A panel per encoder, a line per classifier, over the length of the signal."""
    encoders = list(dict.fromkeys(results["encoder"]))
    figure = new_figure(2.9)
    panels = figure.subplots(1, len(encoders), sharey=True, squeeze=False)[0]
    best, early = best_features(results), results[results["decision"] == "early exit"]
    for axes, encoder in zip(panels, encoders, strict=True):
        for index, classifier in enumerate(_there(CLASSIFIERS, results["classifier"])):
            style = series_style(index)
            for rows, shown in (
                (best, {"label": classifier}),
                (early, {"linestyle": ":", "markerfacecolor": "white"}),
            ):
                mine = rows[(rows["encoder"] == encoder) & (rows["classifier"] == classifier)].groupby("window_ms")
                if not len(mine):
                    continue
                accuracy = 100 * mine["accuracy_test"].mean()
                spread = bars(accuracy, 100 * mine["accuracy_test"].std(ddof=0))
                signal_ms = mine["signal_ms"].mean()
                axes.errorbar(signal_ms, accuracy, spread, markersize=4, capsize=1.5, elinewidth=0.7, **style, **shown)
        axes.axhline(12.5, color=MUTED, linestyle=":", linewidth=0.8, label="chance")
        axes.plot([], [], "o:", color=INK, markerfacecolor="white", markersize=4, label="early exit")
        axes.set(title=encoder, xscale="log", xlabel="signal (ms)", ylim=(0, 100))
        ticks = sorted(set(results["window_ms"]))
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.grid(True)
    keep_within(panels)
    panels[0].set_ylabel("test accuracy (%)")
    add_legend(figure, panels, ncols=len(CLASSIFIERS) + 2)
    return figure


@printed
def draw_grid(results: pd.DataFrame, at_ms: float) -> Figure:
    """A row per pair of features and classifier, a column per encoder; the accuracy is written into each cell."""
    rows = results[(results["window_ms"] == at_ms) & (results["decision"] == "window")]
    systems = list(dict.fromkeys(zip(rows["features"], rows["classifier"], strict=True)))
    encoders = list(dict.fromkeys(rows["encoder"]))
    table = rows.groupby(["features", "classifier", "encoder"])["accuracy_test"].mean()
    names = rows.fillna({"as_in": ""}).groupby(["features", "classifier", "encoder"])["as_in"].first()
    values = np.array([[100 * table.get((*system, e), np.nan) for e in encoders] for system in systems])
    figure = new_figure(0.5 + 0.21 * len(systems), 5.0)
    axes = figure.subplots()
    axes.imshow(values, cmap="Blues", vmin=0, vmax=100, aspect="auto")
    for i, system in enumerate(systems):
        for j, encoder in enumerate(encoders):
            name = str(names.get((*system, encoder), "") or "")
            text = "-" if np.isnan(values[i, j]) else f"{values[i, j]:.1f}" + (f"  {name}" if name else "")
            weight = "bold" if name else "normal"
            axes.text(j, i, text, ha="center", va="center", color="white" if values[i, j] > 55 else INK, weight=weight)
    axes.set_xticks(range(len(encoders)), encoders)
    axes.set_yticks(range(len(systems)), [f"{features} → {classifier}" for features, classifier in systems])
    axes.tick_params(length=0)
    axes.xaxis.tick_top()
    axes.set_title(f"Test accuracy (%), windows of {at_ms:g} ms", pad=8)
    for side in axes.spines.values():
        side.set_visible(False)
    return figure


@printed
def draw_over_cost(results: pd.DataFrame, at_ms: float) -> Figure:
    """A panel per encoder, a point per system, over the operations of a decision."""
    rows = results[results["window_ms"] == at_ms]
    encoders = list(dict.fromkeys(rows["encoder"]))
    figure = new_figure(2.9)
    panels = figure.subplots(1, len(encoders), sharex=True, sharey=True, squeeze=False)[0]
    keys = ["features", "classifier", "decision"]
    for axes, encoder in zip(panels, encoders, strict=True):
        means = rows[rows["encoder"] == encoder].groupby(keys, as_index=False)[["accuracy_test", "flops"]].mean()
        for index, classifier in enumerate(_there(CLASSIFIERS, rows["classifier"])):
            for decision, face in (("window", None), ("early exit", "white")):
                mine = means[(means["classifier"] == classifier) & (means["decision"] == decision)]
                style = series_style(index)
                shown = {"markerfacecolor": face} if face else {"label": classifier}
                axes.plot(mine["flops"], 100 * mine["accuracy_test"], linestyle="", markersize=4.5, **style, **shown)
        axes.plot([], [], "o", color=INK, markerfacecolor="white", markersize=4.5, label="early exit")
        axes.set(title=encoder, xscale="log", xlabel="FLOPs of a decision", ylim=(0, 100))
        axes.grid(True)
    keep_within(panels)
    panels[0].set_ylabel("test accuracy (%)")
    add_legend(figure, panels, ncols=len(CLASSIFIERS) + 1)
    return figure


@printed
def draw_parts(results: pd.DataFrame, at_ms: float) -> Figure:
    """Operations of the three parts of each system and of all of them, as marks on a logarithmic axis.

    Marks, not bars: a logarithmic axis has no zero to which a length could refer.
    """
    rows = results[(results["window_ms"] == at_ms) & (results["decision"] == "window")].fillna({"as_in": ""})
    rows = rows[(rows["as_in"] != "") | rows["classifier"].isin(("SNN", "RSNN"))]
    keys = ["encoder", "features", "classifier", "as_in"]
    means = rows.groupby(keys, sort=False)[[column for column, _ in PARTS]].mean()
    figure = new_figure(0.9 + 0.22 * max(1, len(means)))
    axes = figure.subplots()
    y = np.arange(len(means))
    axes.hlines(y, means.where(means > 0).min(axis=1), means.sum(axis=1), color=PALE, lw=2.0, zorder=1)
    for index, (column, name) in enumerate(PARTS):
        values = means[column].to_numpy()
        # A part without operations has no mark.
        drawn = np.where(values > 0, values, np.nan)
        axes.plot(drawn, y, ls="", ms=5, label=name, **series_style(PART_SERIES[index]))
    axes.plot(means.sum(axis=1), y, ls="", marker="|", ms=10, mew=2.0, color=INK, label="all of them")
    names = [
        f"{encoder}, {classifier if features == 'spikes' else f'{features} → {classifier}'} {as_in}".rstrip()
        for encoder, features, classifier, as_in in means.index
    ]
    axes.set_yticks(y, names)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set(xscale="log", xlabel=f"FLOPs of a decision on {at_ms:g} ms")
    axes.grid(True, axis="x")
    add_legend(figure, [axes], ncols=len(PARTS) + 1)
    return figure


def _there(names: tuple[str, ...], column: pd.Series) -> list[str]:
    return [name for name in names if (column == name).any()]
