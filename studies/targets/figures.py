"""Figures of a study with a target: what was told beside the truth, operating curves, and what each way costs."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from neurotact_parts.studies.comparison.figures import write_out_log_ticks
from neurotact_parts.studies.targets.ways import EVENTS, Compared

from neurotact.figures.columns import name_of
from neurotact.figures.style import INK, MUTED, SA, SERIES, Drawn, add_legend, new_figure, new_panels, printed
from neurotact.studies.store import result_of

POINTS = 40
"""Of an operating curve."""


def drawings(compared: Mapping[str, Compared], folder: Path, target: Sequence[str]) -> Iterator[Drawn]:
    """For each data set what the chosen network told, and the score of each way over its energy."""
    for number, (setting, one) in enumerate(compared.items(), 1):
        last = f"-{number}" if len(compared) > 1 else ""
        of = f" ({setting})" if len(compared) > 1 else ""
        results = [result_of(folder, cell)["tables"] for cell in one.chosen.cells]
        if [*target] == [EVENTS]:
            curves = [pd.DataFrame(tables["operating_curve"]) for tables in results]
            yield Drawn(
                f"operating-curve{last}", f"Hits and false alarms{of}", draw_curves(curves, one),
                "The chosen network at each threshold, the mean over trainings; the point is at the threshold that "
                "validation chose, and rivals are at theirs.",
                "Share of events found against false alarms an hour.",
            )  # fmt: skip
        else:
            told = pd.concat([pd.DataFrame(tables["told"]) for tables in results])
            yield Drawn(
                f"told{last}", f"What the chosen network told of test trials{of}", draw_told(told, target),
                "Each point is a test window of one training. On the line the network tells the true number.",
                f"What was told against the truth, of {', '.join(target)}.",
            )  # fmt: skip
        yield Drawn(
            f"score-and-energy{last}", f"Score and energy{of}", draw_costs(one, [*target] == [EVENTS]),
            "Networks and rivals on test trials; whiskers are 95 % intervals.", "Score against energy.",
        )  # fmt: skip


@printed
def draw_told(told: pd.DataFrame, target: Sequence[str]) -> Figure:
    """A panel per number."""
    figure, panels = new_panels(len(target), 3, 2.9)
    for axes, name in zip(panels, target, strict=True):
        true, value = told[f"true_{name}"], told[f"told_{name}"]
        ends = [min(true.min(), value.min()), max(true.max(), value.max())]
        axes.plot(ends, ends, color=MUTED, lw=0.8, ls="--", zorder=0)
        axes.plot(true, value, "o", ms=3, mew=0, alpha=0.5, color=SA)
        axes.set(xlabel=f"true {name_of(name)}", ylabel=f"told {name_of(name)}", aspect="equal")
        axes.grid()
    return figure


@printed
def draw_curves(curves: Sequence[pd.DataFrame], compared: Compared) -> Figure:
    """The operating curve, a mean over trainings at equal quantiles of the lead, and the point of each way."""
    figure = new_figure(3.2)
    axes = figure.subplots()
    at = [curve.sort_values("threshold").iloc[np.linspace(0, len(curve) - 1, POINTS).astype(int)] for curve in curves]
    alarms, hits = (np.mean([rows[key] for rows in at], axis=0) for key in ("false_alarms_per_h", "hit_share"))
    axes.plot(alarms, 100 * hits, color=SA, label="chosen network, each threshold")
    for way in compared.others:
        _point(axes, way.found, marker="s", color=MUTED, ms=4, label="rivals")
    _point(axes, compared.chosen.found, marker="o", color=INK, ms=6, label="chosen network")
    most = max(one.found["false_alarms_per_h"] for one in (compared.chosen, *compared.others))
    axes.set(xlabel="false alarms an hour", ylabel="events found (%)", ylim=(0, 102), xlim=(0, 1.1 * most or None))
    axes.grid()
    add_legend(figure, [axes], ncols=3)
    return figure


def _point(axes: Axes, found: Mapping[str, float], **style: Any) -> None:
    axes.plot(found["false_alarms_per_h"], 100 * found["hit_share"], ls="none", **style)


@printed
def draw_costs(compared: Compared, is_events: bool) -> Figure:
    """The score of each way over its energy, with its interval."""
    figure = new_figure(3.4)
    axes = figure.subplots()
    groups = {
        "chosen network": [compared.chosen],
        "networks": [one for one in compared.networks if one is not compared.chosen],
        "rivals on signals": [one for one in compared.others if one.of_signals],
        "rivals on spikes": [one for one in compared.others if not one.of_signals],
    }
    for (label, ways), (colour, marker) in zip(groups.items(), SERIES, strict=False):
        known = [one for one in ways if one.nJ > 0]
        if not known:
            continue
        scores = np.array([one.score for one in known])
        ends = np.array([one.interval for one in known]).T
        whiskers = np.maximum([scores - ends[0], ends[1] - scores], 0.0)
        size = 7 if label == "chosen network" else 4
        axes.errorbar([one.nJ for one in known], scores, whiskers, fmt=marker, color=colour, ms=size, elinewidth=0.7,
                      alpha=0.9, label=label)  # fmt: skip
    axes.set(xscale="log", xlabel=f"energy estimate per {'second' if is_events else 'answer'} (nJ)", ylabel="score")
    axes.set_ylim(max(axes.get_ylim()[0], -1.0), None)
    write_out_log_ticks(axes.xaxis)
    axes.grid()
    add_legend(figure, [axes], ncols=4)
    return figure
