"""Figures of the contact materials: their signals, their patterns, and errors compared with the published tables."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from neurotact.figures.style import INK, add_legend, bars, keep_within, name_ticks, new_figure, printed, series_style

CLASSIFIERS = ("RELM", "RLS", "SVM")
SETUPS = ("A", "B", "C")
ORDER = ("brass", "wood", "plastic", "lead")
PERIODS = 2
DASHES = ("-", (0, (4, 2)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1)))
"""Line styles of the materials in their order, so that overlapping curves are distinguishable."""
UNITS = {"RELM": "neurons", "RLS": "kernels", "SVM": "support vectors"}

PUBLISHED_PAIRS = {
    "brass vs wood": {"A": (0.07, 0.09, 0.08), "B": (0.15, 0.09, 0.08), "C": (0.21, 0.17, 0.18)},
    "brass vs plastic": {"A": (0.0, 0.02, 0.01), "B": (0.0, 0.02, 0.01), "C": (0.08, 0.02, 0.03)},
    "brass vs lead": {"A": (0.07, 0.07, 0.08), "B": (0.10, 0.08, 0.10), "C": (0.12, 0.05, 0.04)},
    "wood vs plastic": {"A": (0.0, 0.0, 0.02), "B": (0.01, 0.0, 0.02), "C": (0.03, 0.04, 0.04)},
    "wood vs lead": {"A": (0.0, 0.0, 0.0), "B": (0.02, 0.0, 0.0), "C": (0.04, 0.0, 0.0)},
    "plastic vs lead": {"A": (0.0, 0.0, 0.0), "B": (0.02, 0.0, 0.0), "C": (0.07, 0.0, 0.0)},
}
"""Tables I to III: errors on test patterns of RELM, RLS and SVM."""
PUBLISHED_ERROR = {"A": (0.114, 0.105, 0.112), "B": (0.123, 0.116, 0.126), "C": (0.378, 0.216, 0.208)}
"""Tables IV to VI: mean errors of RELM, RLS and SVM on all four materials."""
PUBLISHED_UNITS = {"A": (184, 1200, 258.4), "B": (124, 1200, 187.2), "C": (26, 1200, 287.4)}
"""Tables IV to VI: neurons, kernels and support vectors."""


@printed
def draw_waveforms(arrays: Mapping[str, np.ndarray]) -> Figure:
    """Measured force and output over a few periods, one curve per material.

    arrays: waveforms `(material, time, channel)` in V (force, output), waveform_labels, waveform_frequency_Hz and
    sampling_rate_Hz. Each curve begins where its force is largest.
    """
    figure = new_figure(2.4)
    force, output = figure.subplots(1, 2)
    rate_Hz, frequency_Hz = float(arrays["sampling_rate_Hz"]), float(arrays["waveform_frequency_Hz"])
    n_period = round(rate_Hz / frequency_Hz)
    n_shown = min(PERIODS * n_period, arrays["waveforms"].shape[1] - n_period)
    time_ms = 1e3 * np.arange(n_shown) / rate_Hz
    for label, waveform in zip(arrays["waveform_labels"].tolist(), arrays["waveforms"], strict=True):
        start = int(waveform[:n_period, 0].argmax())
        shown = waveform[start : start + n_shown]
        dash = DASHES[ORDER.index(label)] if label in ORDER else "-"
        style: Any = {"color": _style(label)["color"], "ls": dash, "lw": 1.2}
        force.plot(time_ms, shown[:, 0], label=label, **style)
        output.plot(time_ms, 1e3 * shown[:, 1], **style)
    force.set(title=f"Force sensor, {frequency_Hz:g} Hz", ylabel="force sensor (V)")
    output.set(title=f"Charge amplifier, {frequency_Hz:g} Hz", ylabel="output (mV)")
    for axes in (force, output):
        axes.set_xlabel("time (ms)")
        axes.grid(axis="y")
    add_legend(figure, [force], ncols=4, handlelength=3.0)
    return figure


@printed
def draw_patterns(arrays: Mapping[str, np.ndarray]) -> Figure:
    """Phase and amplitude of each pattern at each frequency, a column per set force; lines join the means.

    Frequencies are evenly spaced, so that the materials of one frequency are side by side without reaching the next.

    arrays: features `(pattern, 4)` of frequency, force, phase and amplitude; labels; set_force_N. The phase is shown
    minus its mean over all patterns of that frequency, which the amplifier's corner causes: probes differ by far less.
    """
    features, labels, set_force_N = arrays["features"].copy(), arrays["labels"], arrays["set_force_N"]
    forces_N = np.unique(set_force_N)
    figure = new_figure(4.6)
    panels = np.atleast_2d(figure.subplots(2, len(forces_N), sharex=True, squeeze=False))
    names = [*(n for n in ORDER if n in labels), *sorted(set(labels.tolist()) - set(ORDER))]
    frequencies = np.unique(features[:, 0])
    common = {f: features[features[:, 0] == f, 2].mean() for f in frequencies}
    features[:, 2] -= [common[f] for f in features[:, 0]]
    for column, force_N in enumerate(forces_N):
        for index, name in enumerate(names):
            mine = features[(labels == name) & (set_force_N == force_N)]
            x = np.arange(len(frequencies)) + 0.2 * (index - (len(names) - 1) / 2)
            along = x[np.searchsorted(frequencies, mine[:, 0])]
            for axes, measure in zip(panels[:, column], (2, 3), strict=True):
                means = [mine[mine[:, 0] == f, measure].mean() for f in frequencies]
                style = _style(name)
                axes.plot(along, mine[:, measure], ls="", ms=2, alpha=0.35, mew=0, **style)
                axes.plot(x, means, ms=4, lw=0.9, label=name, **style)
        panels[0, column].set_title(f"set force {force_N:g} N")
        panels[1, column].set(xlabel="frequency (Hz)", ylim=(0, None))
        panels[1, column].set_xticks(np.arange(len(frequencies)), [f"{f:g}" for f in frequencies])
        panels[0, column].set_ylim(-1.1 * np.abs(features[:, 2]).max(), 1.1 * np.abs(features[:, 2]).max())
        for axes in panels[:, column]:
            axes.grid(axis="y")
    panels[0, 0].set_ylabel("phase (°), minus the mean\nof that frequency")
    panels[1, 0].set_ylabel("amplitude (mV)")
    figure.align_ylabels()
    add_legend(figure, [panels[0, 0]], ncols=len(names))
    return figure


@printed
def draw_pairs(results: pd.DataFrame) -> Figure:
    """Test errors of each pair of materials, a panel per set-up; published ones are open marks of the same shape.

    results: rows of two-class problems with problem, setup, classifier and error_test.
    """
    figure = new_figure(3.0)
    setups = [s for s in SETUPS if s in set(results["setup"])]
    panels = figure.subplots(1, len(setups), sharey=True, squeeze=False)[0]
    problems = list(dict.fromkeys(results["problem"]))
    for axes, setup in zip(panels, setups, strict=True):
        rows = results[results["setup"] == setup]
        published = [PUBLISHED_PAIRS.get(problem, {}).get(setup) for problem in problems]
        _draw_beside(axes, rows, "problem", problems, "error_test", published)
        axes.set_title(f"Set-up {setup}")
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=None))
        name_ticks(axes, problems)
    panels[0].set(ylabel="test error (%)", ylim=(0, panels[0].get_ylim()[1]))
    keep_within(panels, 1.0)
    add_legend(figure, [panels[0]], ncols=4)
    return figure


@printed
def draw_multiclass(results: pd.DataFrame) -> Figure:
    """Error and units on all four materials, a group per set-up, with the published ones as open marks.

    results: rows of the four-class problem with setup, classifier, error_test and units.
    """
    figure = new_figure(2.7)
    errors, units = figure.subplots(1, 2)
    setups = [s for s in SETUPS if s in set(results["setup"])]
    _draw_beside(errors, results, "setup", setups, "error_test", [PUBLISHED_ERROR[s] for s in setups])
    _draw_beside(units, results, "setup", setups, "units", [PUBLISHED_UNITS[s] for s in setups])
    errors.set(title="Error on all four materials", ylabel="test error (%)", xlabel="set-up")
    errors.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0, symbol=None))
    there = [f"{name}: {unit}" for name, unit in UNITS.items() if name in set(results["classifier"])]
    units.set(title="Units of the four machines", ylabel="units", xlabel=f"set-up\n{', '.join(there)}")
    for axes in (errors, units):
        name_ticks(axes, setups)
        axes.set_ylim(0, 1.06 * axes.get_ylim()[1])
    keep_within([errors], 1.0)
    add_legend(figure, [errors], ncols=4)
    return figure


def _draw_beside(
    axes: Axes, rows: pd.DataFrame, group: str, names: list[str], measure: str, published: list[Any]
) -> None:
    """Means and deviations of each classifier in each group, side by side, and published values in the same shape."""
    classifiers = [c for c in CLASSIFIERS if c in set(rows["classifier"])]
    for index, classifier in enumerate(classifiers):
        mine = rows[rows["classifier"] == classifier].groupby(group)[measure]
        mean, deviation = mine.mean().reindex(names), mine.std(ddof=0).reindex(names).fillna(0.0)
        x = np.arange(len(names)) + 0.22 * (index - (len(classifiers) - 1) / 2)
        style = series_style((0, 2, 4)[CLASSIFIERS.index(classifier)])
        spread = bars(mean, deviation, 1.0 if measure.startswith("error") else None)
        axes.errorbar(x, mean, spread, ls="", ms=4, lw=0.9, label=classifier, **style)
        printed_values = [p[CLASSIFIERS.index(classifier)] if p else np.nan for p in published]
        hollow: Any = {"ls": "", "marker": style["marker"], "mfc": "none", "mec": INK, "mew": 0.8, "clip_on": False}
        axes.plot(x, printed_values, ms=6.5, gid="published", **hollow)
    axes.plot([], [], ls="", marker="o", ms=6.5, mfc="none", mec=INK, mew=0.8, label="published, same shape")
    axes.grid(axis="y")


def _style(material: str) -> dict[str, Any]:
    return series_style(ORDER.index(material) if material in ORDER else len(ORDER))
