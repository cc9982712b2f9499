"""Simulated gratings, drawn as the texture paper's Figs. 5, 6, 10 and 12."""

from pathlib import Path

import numpy as np
import pandas as pd
from gratings_facts import (
    FORCE_N,
    PAIR_CONDITIONS,
    SHOWN,
    STRONG_TAXELS,
    SETTLED_s,
    SPEED_mm_per_s,
    mean_spectrum,
    with_periods,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.data.conditioning import ConditioningSpec, condition
from neurotact.data.recordings import LABEL, Recordings, select_conditions
from neurotact.encoders.afferents import AfferentSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.figures.encoding import Classes, draw_isis, draw_rasters, draw_rates, draw_spike_counts
from neurotact.figures.style import INK, PALE, RA, SA, add_legend, new_figure, printed, save


@printed
def draw_signals(recordings: Recordings, encoder: AfferentSpec) -> Figure:
    """One second of gratings 1, 5 and 8 at 12 N, both speeds: as recorded (pale) and after the EMA; and the spectra.

    One colour per speed. The strong taxels are drawn above each other, each about its own line.
    """
    how = ConditioningSpec(ema_cutoff_Hz=encoder.conditioning.ema_cutoff_Hz, baseline="mean")
    smooth = condition(recordings, how)
    speeds = sorted(recordings.conditions.speed_mm_per_s.unique())
    colours = dict(zip(speeds, (SA, RA), strict=False))
    figure = new_figure(6.0)
    grid = figure.subplots(len(SHOWN), len(speeds) + 1, squeeze=False, width_ratios=[1.3] * len(speeds) + [1.0])
    for row, grating in enumerate(SHOWN):
        for column, speed in enumerate(speeds):
            here = {"grating": grating, "force_N": FORCE_N, "speed_mm_per_s": speed}
            trials = np.flatnonzero(select_conditions(recordings.conditions, here))
            recorded, smoothed = recordings.signals[trials[0]], smooth.signals[trials[0]]
            _paint_trial(grid[row, column], recorded, smoothed, recordings, colours[speed])
            grid[row, column].set_title(f"grating {grating}, {speed:g} mm/s")
            strongest = np.asarray(recordings.signals)[trials][:, round(SETTLED_s * recordings.sampling_rate_Hz) :, 0]
            frequency_Hz, spectrum = mean_spectrum(strongest, recordings.sampling_rate_Hz)
            low = frequency_Hz <= 80
            grid[row, -1].plot(frequency_Hz[low], spectrum[low], color=colours[speed], label=f"{speed:g} mm/s")
        grid[row, -1].set(title="spectrum of taxel 1", xlabel="frequency (Hz)", ylabel="mV")
        grid[row, 0].set_ylabel("taxel")
    for axes in grid[-1, :-1]:
        axes.set_xlabel("time (s)")
    add_legend(figure, [grid[0, -1]], ncols=2)
    return figure


APART_mV = 20.0
"""Distance between the lines of two taxels."""


def _paint_trial(axes: Axes, recorded: np.ndarray, smooth: np.ndarray, recordings: Recordings, colour: str) -> None:
    start = round(SETTLED_s * recordings.sampling_rate_Hz)
    time_s = np.arange(len(recorded) - start) / recordings.sampling_rate_Hz
    lines = -APART_mV * np.arange(STRONG_TAXELS)
    for taxel, line in enumerate(lines):
        axes.axhline(line, color=PALE, lw=0.6, zorder=0)
        axes.plot(time_s, line + recorded[start:, taxel], color=colour, lw=0.3, alpha=0.35)
        axes.plot(time_s, line + smooth[start:, taxel], color=colour, lw=0.9)
    axes.set_yticks(lines, [f"{taxel + 1}" for taxel in range(STRONG_TAXELS)])
    axes.set_ylim(lines[-1] - APART_mV, APART_mV)
    right = time_s[-1] * 1.03
    low = lines[-1] - 0.95 * APART_mV
    axes.plot([right, right], [low, low + APART_mV], color=INK, lw=1.5, clip_on=False)
    axes.text(0.98 * right, low, f"{APART_mV:g} mV", ha="right", va="bottom", fontsize=6.5)


def draw_all(recordings: Recordings, firing: pd.DataFrame, encoder: AfferentSpec, folder: Path) -> None:
    """The figures of the calibration, into `folder`."""
    conditions = recordings.conditions.drop_duplicates("grating").sort_values("grating")
    labels = tuple(conditions[LABEL])
    numbers = dict(zip(labels, conditions.grating.astype(str), strict=True))
    names = {label: f"Grating {numbers[label]} ({label[1:]} mm)" for label in labels}
    classes = Classes("grating", labels, numbers, names)
    shown = [labels[g - 1] for g in SHOWN]
    fig6 = firing[(firing.force_N == FORCE_N) & (firing.speed_mm_per_s == SPEED_mm_per_s)]
    first = firing[firing.pair == "1&1"]
    slow = first[first.speed_mm_per_s == SPEED_mm_per_s]
    save(draw_signals(recordings, encoder), folder / "gratings-signals.png")
    save(draw_spike_counts(fig6, shown, classes), folder / "gratings-spike-counts.png")
    save(draw_rates(first, PAIR_CONDITIONS, classes), folder / "gratings-rates.png")
    save(draw_isis(slow, "force_N", classes), folder / "gratings-isis.png")
    forces = sorted(recordings.conditions.force_N.unique())
    few = recordings.select(
        select_conditions(recordings.conditions, {"grating": SHOWN, "speed_mm_per_s": SPEED_mm_per_s, "trial": 0})
    )
    trains = encode_recordings(few, with_periods(encoder, 1, 1))
    trials = [[_row(trains.conditions, g, f) for g in SHOWN] for f in forces]
    rasters = draw_rasters(
        trains, trials, [f"{f:g} N" for f in forces], [names[s] for s in shown], SETTLED_s, SETTLED_s + 1.0, 0.15
    )
    save(rasters, folder / "gratings-rasters.png")


def _row(conditions: pd.DataFrame, grating: int, force_N: float) -> int:
    return int(np.flatnonzero(select_conditions(conditions, {"grating": grating, "force_N": force_N}))[0])
