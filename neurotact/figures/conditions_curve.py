"""The figure of accuracy at an untrained condition over the number of trained ones."""

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from neurotact.figures.style import MUTED, add_legend, new_figure, printed, series_style


@printed
def draw_conditions_curve(table: pd.DataFrame, column: str) -> Figure:
    """Accuracy of each tested value over the number of trained ones, their mean, and that at trained values."""
    figure = new_figure(3.2, 5.2)
    axes = figure.add_subplot()
    for tested, rows in table.groupby("tested", sort=False):
        axes.plot(rows["trained"], 100 * rows["accuracy_test"], color=MUTED, linewidth=0.8, alpha=0.8)
        axes.annotate(
            f"{tested:g}" if isinstance(tested, (int, float)) else str(tested),
            (rows["trained"].iloc[-1], 100 * rows["accuracy_test"].iloc[-1]),
            xytext=(4, 0), textcoords="offset points", va="center", fontsize=7, color=MUTED,
        )  # fmt: skip
    means = table.groupby("trained")[["accuracy_test", "accuracy_seen"]].mean()
    axes.plot(means.index, 100 * means["accuracy_test"], label="untrained values, mean", **series_style(0))
    axes.plot(means.index, 100 * means["accuracy_seen"], label="trained values", **series_style(1))
    axes.set_xlabel(f"trained values of {column}")
    axes.set_ylabel("test accuracy (%)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 103)
    add_legend(figure, [axes], 2)
    return figure
