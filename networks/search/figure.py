"""The figure of a hyperparameter search: values over trials, importance of keys, and the front of two objectives."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from neurotact_parts.networks.search import search_tables
from neurotact_parts.networks.search.journal import Trial
from neurotact_parts.networks.search.search import Problem
from neurotact_parts.networks.search.search_tables import Importance

from neurotact.figures.style import INK, MUTED, add_legend, keep_within, new_figure, printed, save

FINISHED, STOPPED, FAILED = "#0072B2", "#E69F00", "#D55E00"


def save_found(problem: Problem, trials: Sequence[Trial], folder: Path) -> None:
    """Write the results of a search: `search.write_tables`, and the figure `search.png`."""
    search_tables.write_tables(problem, folder, trials)
    table = search_tables.trials_table(trials)
    front = search_tables.front_table(table) if problem.search.weighs_sops else None
    shares = search_tables.importance(table, list(problem.search.space))
    save(draw_search(table, shares, front, search_tables.value_words(problem.search)), folder / "search.png")


@printed
def draw_search(
    trials: pd.DataFrame, importance: Importance | None, front: pd.DataFrame | None = None, unit: str = "value"
) -> Figure:
    """Value of each trial and the best so far; the importance of each key; with two objectives, the Pareto front.

    trials: id, outcome (finished, stopped, failed), value, accuracy_validation, sops_total and one column per key.
    front: the rows of `trials` that no other dominates, by SOPs.
    unit: the meaning of the value, in words.
    """
    beside = (importance is not None) + (front is not None)
    figure = new_figure(5.2 if beside == 2 else 2.7)
    if beside == 2:
        places = figure.add_gridspec(2, 2)
        panels = [figure.add_subplot(cell) for cell in (places[0, :], places[1, 0], places[1, 1])]
    else:
        places = figure.add_gridspec(1, 1 + beside, width_ratios=[1.7, 1.0][: 1 + beside])
        panels = [figure.add_subplot(cell) for cell in places]
    over_trials, *others = panels
    _paint_values(over_trials, trials, unit)
    if importance is not None:
        _paint_importance(others.pop(0), importance, search_tables.by_rank(trials).iloc[0])
    if front is not None:
        _paint_front(others.pop(0), trials, front)
    add_legend(figure, panels, ncols=5, handlelength=1.4)
    return figure


def best_so_far(trials: pd.DataFrame) -> np.ndarray:
    """The largest value of the finished trials up to each one, `(trial,)`; NaN before the first.

    >>> best_so_far(pd.DataFrame({"value": [0.5, 0.9, 0.6], "outcome": ["finished", "stopped", "finished"]})).tolist()
    [0.5, 0.5, 0.6]
    """
    return trials["value"].where(trials["outcome"] == "finished").cummax().ffill().to_numpy(float)


def _paint_values(axes: Axes, trials: pd.DataFrame, unit: str) -> None:
    """Dots for trials, hollow if stopped, crosses on the axis if failed; a line for the best."""
    small = 3.5 if len(trials) < 200 else 2.2
    for outcome, face, edge in (("finished", FINISHED, FINISHED), ("stopped", "white", STOPPED)):
        these = trials[trials["outcome"] == outcome]
        if len(these):
            style = {"ls": "", "marker": "o", "ms": small, "mfc": face, "mec": edge, "mew": 0.7, "alpha": 0.75}
            axes.plot(these["id"], these["value"], label=f"{outcome} ({len(these)})", gid=outcome, **style)
    best = search_tables.by_rank(trials).iloc[0]
    axes.step(trials["id"], best_so_far(trials), where="post", color=INK, label="best so far", gid="best", lw=1.2)
    failed = trials[trials["outcome"] == "failed"]
    if len(failed):
        low = axes.get_ylim()[0]
        axes.plot(failed["id"], [low] * len(failed), ls="", marker="x", ms=4, color=FAILED, clip_on=False,
                  label=f"failed ({len(failed)})", gid="failed")  # fmt: skip
        axes.set_ylim(bottom=low)
    axes.set(title=f"Best {best['value']:.3f}, trial {best['id']}", xlabel="trial", ylabel=unit)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(-0.02 * len(trials), 1.02 * len(trials))
    axes.grid(axis="y")


def _paint_importance(axes: Axes, importance: Importance, best: pd.Series) -> None:
    """One bar per key, the most important on top, with the best trial's value next to its name."""
    keys = sorted(importance.drop, key=lambda key: importance.drop[key])
    drops = [max(importance.drop[key], 0.0) for key in keys]
    axes.barh(range(len(keys)), drops, height=0.62, color="#56B4E9", gid="importance")
    names = [f"{key} ({best[key]:g})" if isinstance(best[key], (int, float, np.number)) else key for key in keys]
    axes.set_yticks(range(len(keys)), names)
    axes.tick_params(axis="y", length=0)
    axes.set(title=f"Importance (R² {max(importance.r2, 0.0):.2f})", xlabel="loss of R² when shuffled")
    axes.grid(axis="x")


def _paint_front(axes: Axes, trials: pd.DataFrame, front: pd.DataFrame) -> None:
    finished = trials[trials["outcome"] == "finished"]
    axes.plot(1e-3 * finished["sops_total"], 100 * finished["accuracy_validation"], ls="", marker="o", ms=2.5,
              color=FINISHED, alpha=0.6)  # fmt: skip
    axes.plot(1e-3 * front["sops_total"], 100 * front["accuracy_validation"], drawstyle="steps-post", color=INK,
              marker="o", ms=3.5, lw=0.9, gid="front")  # fmt: skip
    best = search_tables.by_rank(trials).iloc[0]
    axes.plot(1e-3 * best["sops_total"], 100 * best["accuracy_validation"], ls="", marker="D", ms=7, mfc="none",
              mec="#D55E00", mew=1.3, label="chosen")  # fmt: skip
    axes.set(title="Pareto front", xlabel="SOPs per sample (thousands)", ylabel="validation accuracy (%)")
    axes.set_xscale("log")
    keep_within([axes])
    axes.grid(color="#e6e6e6")
    axes.tick_params(axis="x", which="minor", labelsize=6.5, color=MUTED)
