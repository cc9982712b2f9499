"""Figures of the compliance study: curves and their features, Tables 3 and 5 as curves, figure of merit, confusions."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from neurotact_parts.studies.compliance.curve_features import instants
from neurotact_parts.studies.compliance.fpga_resources import (
    REMARKS,
    CLASSIFIER_DELAYS_us,
    classifier_delay_us,
    published_accuracy,
    published_resources,
)
from neurotact_parts.studies.compliance.simulator import CHANNELS, SENSORS
from neurotact_parts.studies.compliance.tactile_moments import NAMES
from sklearn.metrics import confusion_matrix

from neurotact.figures.style import (
    INK,
    MUTED,
    PALE,
    SERIES,
    Drawn,
    add_legend,
    keep_within,
    new_figure,
    printed,
    sequence,
    series_style,
)

OURS = {"honest": SERIES[0][0], "paper": SERIES[4][0]}
"""Colours of the two protocols; published values are dark."""
LEAKS = "paper (chosen on test data)"
SENSOR_CHOICES = ("finger", "palm", "finger and palm")


def draw_features(curves: np.ndarray, peak: int, sampling_rate_Hz: float) -> Drawn:
    """AR, MAX, H1 and H2 on M00 of the finger (Fig. 1). curves: `(time, curve)` of one exploration of OBJ-2."""
    return Drawn(
        "compliance-features",
        "The four features of a curve (Fig. 1)",
        _features(curves[:, CHANNELS.index("finger M00")], peak, sampling_rate_Hz),
        "M00 of the finger while OBJ-2 is squeezed and released. The instants are those of the commanded movement: the "
        "turn, 2/3 of the time to it, and 1/3 of that time after it. Hysteresis leaves H2 below H1.",
        "A curve that rises and falls, with its area shaded and three instants marked.",
    )


@printed
def _features(curve: np.ndarray, peak: int, sampling_rate_Hz: float) -> Figure:
    figure = new_figure(1.9)
    time_s = np.arange(len(curve)) / sampling_rate_Hz
    when = instants(peak)
    panels = figure.subplots(1, 4, sharey=True)
    for axes, name, sample in zip(panels, ("AR", "MAX", "H1", "H2"), (None, *when), strict=True):
        axes.plot(time_s, curve, color=INK, linewidth=0.9)
        if sample is None:
            axes.fill_between(time_s, curve, color=SERIES[1][0], alpha=0.5, linewidth=0)
        else:
            axes.plot([sample / sampling_rate_Hz] * 2, [0, curve[sample]], color=MUTED, linestyle=":")
            axes.plot(sample / sampling_rate_Hz, curve[sample], "o", color=SERIES[4][0], markersize=5)
        axes.set(title=name, xlabel="time (s)")
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("M00, finger (counts)")
    return figure


def draw_curves(curves: Mapping[str, np.ndarray], sampling_rate_Hz: float) -> Drawn:
    """The six moments of both sensors (Fig. 6). curves: `(time, curve)` of one exploration of each object."""
    return Drawn(
        "compliance-curves",
        "Moment curves of two objects (Fig. 6)",
        _curves(curves, sampling_rate_Hz),
        "One exploration each of OBJ-17 (an ovoid, standing) and OBJ-38 (a toroid, standing). Each moment is divided "
        "by its own largest value, since M20 is tens of times M00 (largest counts above). All six rise and fall "
        "together; below M00 is the difference of the others from it, smoothed over 50 ms. The palm starts "
        "above 0: it carries the weight.",
        "For each object and sensor M00, which rises and falls in 2.4 s; below it the other five moments minus M00.",
    )


@printed
def _curves(curves: Mapping[str, np.ndarray], sampling_rate_Hz: float) -> Figure:
    """M00 of each object and sensor, and below it the differences of the other moments from it."""
    figure = new_figure(2.6 * len(curves) + 0.4)
    grid = figure.subplots(
        2 * len(curves), 2, sharex=True, sharey="row", squeeze=False, height_ratios=[1.1, 1.0] * len(curves)
    )
    for row, (label, signal) in enumerate(curves.items()):
        for s, sensor in enumerate(SENSORS):
            own = signal[:, s * len(NAMES) : (s + 1) * len(NAMES)]
            above, below = grid[2 * row : 2 * row + 2, s]
            _paint_moments(above, below, own, sampling_rate_Hz)
            above.set_title(f"{label}, {sensor}: M00 ≤ {own[:, 0].max():,.0f}, M20 ≤ {own[:, 4].max():,.0f}")
        grid[2 * row, 0].set_ylabel("M00 (share)")
        grid[2 * row + 1, 0].set_ylabel("from M00 (points)")
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    add_legend(figure, grid.ravel(), ncols=6, handlelength=1.2)
    return figure


SMOOTHED_s = 0.05
"""Length of the running mean of the differences: shorter than any visible change, longer than the noise."""


def _paint_moments(above: Axes, below: Axes, own: np.ndarray, sampling_rate_Hz: float) -> None:
    """M00 as a share of its largest value, and the differences of the other moments' shares from it, in points."""
    time_s = np.arange(len(own)) / sampling_rate_Hz
    shares = own / own.max(axis=0)
    above.plot(time_s, shares[:, 0], color=SERIES[0][0], linewidth=1.0, label=NAMES[0])
    above.set_ylim(0, 1.08)
    n = max(1, round(SMOOTHED_s * sampling_rate_Hz))
    kernel = np.ones(n) / n
    below.axhline(0, color=MUTED, linewidth=0.7)
    for i in range(1, len(NAMES)):
        apart = 100 * np.convolve(shares[:, i] - shares[:, 0], kernel, mode="same")
        inside = slice(n // 2, len(apart) - n // 2)  # only complete means
        below.plot(time_s[inside], apart[inside], color=SERIES[i][0], linewidth=0.9, label=NAMES[i])
    below.grid(axis="y")


def draw_accuracy(results: pd.DataFrame, with_pca: bool) -> Drawn:
    """Accuracy over the number of moments, with Table 3 (without PCA) or Table 5 (with PCA).

    results: rows only with or only without components; of each cell the `chosen` combination is drawn.
    """
    table = 5 if with_pca else 3
    return Drawn(
        f"compliance-table-{table}",
        f"Test accuracy {'with' if with_pca else 'without'} PCA (Table {table})",
        _accuracy(results[results["chosen"]], published_accuracy().query(f"table == {table}")),
        "The best combination of features per cell. Dark: published, a triangle where the paper prints “less than”. "
        f"Blue: honest, the combination and the repetition of k-means chosen on validation data. Orange: {LEAKS}, as "
        "the published numbers are.",
        "A panel for each choice of sensors and number of bits; accuracy rises with the number of moments.",
    )


@printed
def _accuracy(chosen: pd.DataFrame, published: pd.DataFrame) -> Figure:
    widths = sorted(set(chosen["bits"]))
    figure = new_figure(1.5 * len(SENSOR_CHOICES) + 0.6)
    grid = figure.subplots(len(SENSOR_CHOICES), len(widths), sharex=True, sharey=True, squeeze=False)
    for line, sensors in zip(grid, SENSOR_CHOICES, strict=True):
        for axes, bits in zip(line, widths, strict=True):
            for protocol, colour in OURS.items():
                rows = _of(chosen, protocol=protocol, sensors=sensors, bits=bits)
                means = rows.groupby("moments")["accuracy_test"].mean()
                words = LEAKS if protocol == "paper" else protocol
                axes.plot(means.index, 100 * means, marker="o", markersize=3, color=colour, label=f"ours, {words}")
            theirs = _of(published, sensor=sensors, bits=bits).sort_values("moments")
            exact = theirs[~theirs["below"]]
            axes.plot(exact["moments"], 100 * exact["accuracy"], "-D", color=INK, markersize=3, label="published")
            bound = theirs[theirs["below"]]
            style: Any = {"ls": "", "marker": "v", "color": INK, "ms": 4}
            axes.plot(bound["moments"], 100 * bound["accuracy"], label="published as “less than”", **style)
            axes.set_title(f"{sensors}, {bits} bits")
            axes.set_ylim(0, 100)
            axes.grid(axis="y")
    for axes in grid[-1]:
        axes.set(xlabel="number of moments", xticks=range(1, 7))
    for axes in grid[:, 0]:
        axes.set_ylabel("test accuracy (%)")
    keep_within(grid.ravel())
    add_legend(figure, grid.ravel(), ncols=4)
    return figure


def draw_merit(results: pd.DataFrame) -> Iterator[Drawn]:
    """Figs. 10 and 13: the figure of merit over the published resource counts: published accuracies and ours."""
    for table, number, words in ((4, 10, "without PCA"), (6, 13, "with PCA")):
        cases = published_resources().query(f"table == {table}")
        yield Drawn(
            f"compliance-merit-{table}",
            f"Figure of merit {words} (Fig. {number}, Table {table})",
            _merit(cases, results),
            "Accuracy over inputs, bits and resources (Eqs. 2 and 3), as a share of the best case. Resources are the "
            "published ones throughout; only the accuracy differs between bar and marks. Hatched: "
            + "; ".join(f"the row of {_case(row)} {REMARKS[row.remark]}" for row in cases.itertuples() if row.remark)
            + ".",
            "Bars by case; the first moment of finger and palm with d5 and 12 bits is the best.",
        )


@printed
def _merit(cases: pd.DataFrame, results: pd.DataFrame) -> Figure:
    figure = new_figure(0.3 * len(cases) + 0.9)
    axes = figure.subplots()
    places = np.arange(len(cases))[::-1]
    best = cases[cases["remark"] != "no accuracy"]["merit"].max()
    for y, row in zip(places, cases.itertuples(), strict=True):
        hatch: dict[str, Any] = {"hatch": "////", "edgecolor": MUTED} if row.remark else {}
        bound = "≤ " if row.remark == "no accuracy" else ""
        axes.barh(y, row.merit / best, 0.62, color=PALE, linewidth=0.6, **hatch)
        axes.text(1.03, y, f"{bound}{100 * row.accuracy:.1f} %", va="center", fontsize=7)
    axes.fill_between([], [], color=PALE, label="published, with its accuracy")
    for protocol, colour in OURS.items():
        ours = np.array([_our_accuracy(results, protocol, row) for row in cases.itertuples()])
        merits = ours * cases["merit"].to_numpy() / cases["accuracy"].to_numpy()
        if np.isfinite(merits).any():
            words = LEAKS if protocol == "paper" else protocol
            axes.plot(merits / best, places, "o", color=colour, markersize=4, label=f"ours, {words}")
    axes.set_yticks(places, [_case(row) for row in cases.itertuples()])
    axes.set(xlim=(0, 1.02), xlabel="figure of merit, share of the published best")
    add_legend(figure, [axes], ncols=3)
    return figure


def _case(row: Any) -> str:
    components = f", nC{row.components}" if row.components else ""
    return f"{row.sensor}, nMom{row.moments}, {row.combination}, {row.bits} bits{components}"


def _our_accuracy(results: pd.DataFrame, protocol: str, row: Any) -> float:
    case = {"sensors": row.sensor, "moments": row.moments, "combination": row.combination, "bits": row.bits}
    rows = _of(results, protocol=protocol, components=row.components, **case)
    return float(rows["accuracy_test"].mean())


def _of(table: pd.DataFrame, **where: Any) -> pd.DataFrame:
    """The rows whose columns have these values, if any."""
    keep = np.ones(len(table), bool)
    for column, value in where.items():
        keep &= (table[column] == value).to_numpy()
    return table[keep]


def draw_delay() -> Drawn:
    """Fig. 15: delay of features and classifier over the classifier's inputs."""
    return Drawn(
        "compliance-delay",
        "Delay from the last sample to the label (Fig. 15)",
        _delay(),
        "Feature extraction as published for each case (Tables 4 and 6) and the classifier on the line through the two "
        "delays in the text (ringed: 82 µs for 8 inputs, 65.7 µs for 3). The line is ours. PCA saves time if the delay "
        "of the inputs that it removes exceeds its own.",
        "Delays that grow with the number of inputs; cases with PCA have few inputs.",
    )


@printed
def _delay() -> Figure:
    figure = new_figure(2.4)
    axes = figure.subplots()
    for table, words in ((4, "without PCA (Table 4)"), (6, "with PCA (Table 6)")):
        cases = published_resources().query(f"table == {table}")
        total_us = cases["delay_us"] + classifier_delay_us(cases["inputs"].to_numpy())
        style = series_style(0 if table == 4 else 4)
        axes.plot(cases["inputs"], total_us, linestyle="none", markersize=4.5, label=words, **style)
    line = np.array([1, 38])
    axes.plot(line, classifier_delay_us(line), ":", color=MUTED, label="classifier alone")
    printed_us = {8: 82.0, 3: 65.7}
    assert printed_us.keys() == CLASSIFIER_DELAYS_us.keys()
    axes.plot(list(printed_us), list(printed_us.values()), "o", mfc="none", color=INK, markersize=9, label="printed")
    axes.set(xlabel="inputs of the classifier", ylabel="delay (µs)")
    axes.grid(axis="y")
    add_legend(figure, [axes], ncols=4)
    return figure


def draw_projection(components: Mapping[str, np.ndarray], labels: np.ndarray) -> Drawn:
    """Fig. 12: three principal components of each choice of sensors. components: `(example, 3)`."""
    return Drawn(
        "compliance-components",
        "Three principal components: finger, palm, both (Fig. 12)",
        _projection(components, labels),
        "Six moments, d5, 8 bits; fitted on training vectors. A dot is an exploration, an ellipse two standard "
        "deviations of a class. Number: the median distance from a class mean to its nearest neighbour, over the "
        "median deviation within a class; larger means more separate classes.",
        "Three columns of scattered classes, the second component and the third over the first.",
    )


@printed
def _projection(components: Mapping[str, np.ndarray], labels: np.ndarray) -> Figure:
    figure = new_figure(4.2)
    grid = figure.subplots(2, len(components), squeeze=False)
    classes = sorted(set(labels))
    colours = sequence(len(classes))
    for column, (sensors, points) in enumerate(components.items()):
        for axes, other in zip(grid[:, column], (1, 2), strict=True):
            for label, colour in zip(classes, colours, strict=True):
                _scatter(axes, points[labels == label][:, [0, other]], colour)
            axes.set_ylabel(f"PC{other + 1}")
            axes.ticklabel_format(style="sci", scilimits=(-2, 4))
        grid[0, column].set_title(f"{sensors}: {separation(points, labels):.2f}")
        grid[1, column].set_xlabel("PC1 (codes)")
    return figure


def separation(points: np.ndarray, labels: np.ndarray) -> float:
    """Median over classes of the distance to the nearest other mean, over the median rms deviation within a class.

    >>> separation(np.array([[0.0], [2.0], [10.0], [12.0]]), np.array(["a", "a", "b", "b"]))
    10.0
    """
    classes = sorted(set(labels))
    means = np.array([points[labels == label].mean(axis=0) for label in classes])
    within = [np.sqrt(points[labels == label].var(axis=0).sum()) for label in classes]
    between = np.linalg.norm(means[:, None] - means, axis=-1) + np.diag(np.full(len(classes), np.inf))
    return float(np.median(between.min(axis=1)) / np.median(within))


def _scatter(axes: Axes, points: np.ndarray, colour: Any) -> None:
    axes.plot(*points.T, ".", color=colour, markersize=1.0, alpha=0.4)
    if len(points) < 3:
        return
    spread, axes_of = np.linalg.eigh(np.cov(points.T))
    angle = np.rad2deg(np.arctan2(axes_of[1, 1], axes_of[0, 1]))
    long, short = 4 * np.sqrt(np.maximum(spread[::-1], 0.0))
    axes.add_patch(Ellipse(tuple(points.mean(axis=0)), long, short, angle=angle, fill=False, ec=colour, lw=0.7))


def draw_confusion(truth: np.ndarray, predicted: np.ndarray, components: int) -> Drawn:
    """Figs. 11 and 14: confusions of the published best case. truth, predicted: `(example,)`, "OBJ-1" and so on."""
    number, words = (14, f"{components} components") if components else (11, "no PCA")
    right = float((truth == predicted).mean())
    return Drawn(
        f"compliance-confusion-{components}",
        f"Confusions of the best case, {words} (Fig. {number})",
        _confusion(truth, predicted),
        f"Finger and palm, M00, d5, 12 bits, {words}, protocol honest: {100 * right:.1f} % of {len(truth)} test "
        "vectors. The paper's best repetition, chosen on its test set, has "
        f"{'94.6' if components else '94.5'} % of 673. Rows sum to 100 %.",
        "A matrix of 42 by 42, mostly on its diagonal.",
    )


@printed
def _confusion(truth: np.ndarray, predicted: np.ndarray) -> Figure:
    classes = sorted(set(truth) | set(predicted), key=lambda label: int(label.removeprefix("OBJ-")))
    shares = 100 * confusion_matrix(truth, predicted, labels=classes, normalize="true")
    figure = new_figure(5.4, 5.8)
    axes = figure.subplots()
    image = axes.imshow(shares, cmap="Blues", vmin=0, vmax=100)
    numbers = [label.removeprefix("OBJ-") for label in classes]
    axes.set_xticks(range(len(classes)), numbers, fontsize=5)
    axes.set_yticks(range(len(classes)), numbers, fontsize=5)
    axes.set(xlabel="predicted (object)", ylabel="true (object)")
    for i, j in zip(*np.nonzero((shares >= 10) & ~np.eye(len(classes), dtype=bool)), strict=True):
        ink = "white" if shares[i, j] > 60 else INK
        axes.text(j, i, f"{shares[i, j]:.0f}", ha="center", va="center", fontsize=4, color=ink)
    figure.colorbar(image, ax=axes, label="share of the true class (%)", shrink=0.7)
    return figure
