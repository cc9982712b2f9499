"""The accuracy of networks under each condition."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from neurotact.figures.style import INK, new_figure, printed


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
