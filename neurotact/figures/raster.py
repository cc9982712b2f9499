"""Spike trains as a raster plot, with the signal above it, and as a table of events."""

from collections.abc import Iterable
from numbers import Integral
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.figures.columns import in_unit
from neurotact.figures.style import INK, RA, SA, TOTAL, new_figure, printed, save
from neurotact.tables import write_table

PALETTE = (SA, RA, TOTAL, "#CC79A7", "#56B4E9", INK)
"""Colours of populations, in their order."""
ROW_in = 0.15
MOST_NAMED = 64


@printed
def draw_raster(
    trains: SpikeTrains,
    trial: int,
    signal: tuple[np.ndarray, float, str] | None = None,
    start_s: float = 0.0,
    stop_s: float | None = None,
) -> Figure:
    """The spikes of one trial, each population in its colour, under the signal that drove it (texture, Fig. 12).

    signal: `(time, taxel)`, its sampling rate in Hz and its unit.
    start_s, stop_s: the part to draw; to the trial's end when `stop_s` is None.
    Raises InputError for a trial that does not exist and for an empty part.

    >>> from neurotact.data.spikes import from_rasters
    >>> raster = np.eye(4, 2, dtype=np.uint8)[None]
    >>> felt = from_rasters(raster, 1000.0, ("SA-I taxel1", "RA-I taxel1"), pd.DataFrame({"label": ["felt"]}))
    >>> [axes.get_xlabel() for axes in draw_raster(felt, trial=0).axes]
    ['time (s)']
    """
    start_s, stop_s = _stretch(trains, trial, start_s, stop_s)
    n_afferents = len(trains.afferents)
    raster_in = float(np.clip(ROW_in * n_afferents, 1.2, 9.0))
    if signal is None:
        figure = new_figure(raster_in + 0.8)
        below = figure.subplots()
    else:
        figure = new_figure(raster_in + 2.4)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, raster_in])
        _paint_signal(above, *signal, start_s, stop_s)
    paint_events(below, trains, trial, start_s, stop_s)
    _name_afferents(below, trains)
    below.set(xlabel="time (s)", ylabel="afferent of taxel", xlim=(start_s, stop_s))
    handles = [line for line in below.lines if line.get_gid()]
    figure.align_ylabels()
    figure.legend(handles=handles, loc="outside upper right", ncols=2, handlelength=1.0)
    figure.suptitle(_title(trains, trial), x=0.01, ha="left", fontsize=8.5, fontweight="bold")
    return figure


def write_raster(
    trains: SpikeTrains,
    trial: int,
    path: str | Path,
    signal: tuple[np.ndarray, float, str] | None = None,
    start_s: float = 0.0,
    stop_s: float | None = None,
) -> None:
    """Draw one trial into a .png, .svg or .pdf; InputError for another suffix."""
    _check_suffix(path, (".png", ".svg", ".pdf"))
    save(draw_raster(trains, trial, signal, start_s, stop_s), path)


def write_events(trains: SpikeTrains, path: str | Path, trials: Iterable[int] | None = None) -> None:
    """Write spikes as a .csv of events: trial, afferent, type and time_s, one line each; InputError for another suffix.

    trials: all of them when absent; the table has their numbers in `trains`.
    """
    _check_suffix(path, (".csv",))
    chosen = range(len(trains)) if trials is None else [existing_trial(trains, trial) for trial in trials]
    names = np.array(trains.afferents, dtype=object)
    types = np.array([name.split(" ")[0] for name in trains.afferents], dtype=object)
    units = np.concatenate([np.empty(0, np.int64), *(trains.units[t] for t in chosen)]).astype(np.int64)
    steps = np.concatenate([np.empty(0, np.int64), *(trains.steps[t] for t in chosen)])
    trial = np.repeat(np.array(chosen, np.int64), [len(trains.steps[t]) for t in chosen])
    times_s = steps / trains.sampling_rate_Hz
    table = pd.DataFrame({"trial": trial, "afferent": names[units], "type": types[units], "time_s": times_s})
    write_table(table, path)


def painted_populations(trains: SpikeTrains) -> list[tuple[str, str, np.ndarray]]:
    """Each population with its colour and its afferents: SA-I blue, RA-I orange, the others in the palette's order.

    >>> from neurotact.data.spikes import from_rasters
    >>> felt = from_rasters(np.zeros((1, 2, 2)), 1000.0, ("ON a", "OFF a"), pd.DataFrame({"label": ["felt"]}))
    >>> [kind for kind, _, _ in painted_populations(felt)]
    ['ON', 'OFF']
    """
    populations = trains.populations
    own = {name: colour for name, colour in (("SA-I", SA), ("RA-I", RA)) if name in populations}
    free = [colour for colour in PALETTE if colour not in own.values()]
    others = [name for name in populations if name not in own]
    colours = own | {name: free[i % len(free)] for i, name in enumerate(others)}
    return [(name, colours[name], rows) for name, rows in populations.items()]


def paint_events(axes: Axes, trains: SpikeTrains, trial: int, start_s: float, stop_s: float) -> None:
    """Each spike between the two times as a tick in its afferent's row, the first afferent on top."""
    times = np.asarray(trains.steps[trial]) / trains.sampling_rate_Hz
    inside = (times >= start_s) & (times < stop_s)
    times, units = times[inside], np.asarray(trains.units[trial], np.int64)[inside]
    for kind, colour, rows in painted_populations(trains):
        is_kind = np.isin(units, rows)
        x, y = times[is_kind], units[is_kind]
        # One path of separate strokes: an SVG of ten thousand lines would be ten times the size.
        strokes = np.stack([y - 0.4, y + 0.4, np.full(len(y), np.nan)], axis=1)
        axes.plot(np.repeat(x, 3), strokes.ravel(), color=colour, lw=0.7, solid_capstyle="butt", label=kind, gid=kind)
    axes.set(xlim=(start_s, stop_s), ylim=(len(trains.afferents) - 0.4, -0.6))


def _name_afferents(axes: Axes, trains: SpikeTrains) -> None:
    """Taxels' names as ticks in their population's colour; only the populations if there are too many."""
    if len(trains.afferents) > MOST_NAMED:
        name_populations(axes, trains)
        return
    names = [name.partition(" ")[2] or name for name in trains.afferents]
    axes.set_yticks(range(len(names)), [name.removeprefix("taxel") for name in names], fontsize=6.5)
    colour_of = {row: colour for _, colour, rows in painted_populations(trains) for row in rows.tolist()}
    for row, label in enumerate(axes.get_yticklabels()):
        label.set_color(colour_of[row])
    axes.tick_params(axis="y", length=0)


def name_populations(axes: Axes, trains: SpikeTrains) -> None:
    """One tick per population, in its colour, in the middle of its rows."""
    kinds = painted_populations(trains)
    axes.set_yticks([rows.mean() for _, _, rows in kinds], [kind for kind, _, _ in kinds])
    for label, (_, colour, _) in zip(axes.get_yticklabels(), kinds, strict=True):
        label.set(color=colour, fontweight="bold")
    axes.tick_params(axis="y", length=0)


def _paint_signal(axes: Axes, signal: np.ndarray, rate_Hz: float, unit: str, start_s: float, stop_s: float) -> None:
    """Every taxel's signal `(time, taxel)` between two times."""
    signal = np.asarray(signal)
    if signal.ndim != 2 or not len(signal):
        raise InputError(f"signal: must be (time, taxel) and not empty; got shape {signal.shape}")
    first, last = round(start_s * rate_Hz), round(stop_s * rate_Hz)
    shown = signal[first:last]
    times = (first + np.arange(len(shown))) / rate_Hz
    # Even shades, assigned by the golden ratio, so that neighbours differ.
    n_taxels = signal.shape[1]
    dealt = np.argsort(np.argsort(np.arange(n_taxels) * 0.618 % 1.0))
    shades = colormaps["viridis"](0.92 * dealt / max(n_taxels - 1, 1))
    for taxel, shade in enumerate(shades):
        axes.plot(times, shown[:, taxel], color=shade, lw=0.8, label=f"{taxel + 1}")
    axes.set_ylabel(f"signal ({unit})" if unit else "signal")
    axes.grid(axis="y")
    if signal.shape[1] <= 8:
        axes.legend(title="taxel", loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.0, labelspacing=0.15)


def _title(trains: SpikeTrains, trial: int) -> str:
    """The trial's class and conditions in words, and how far its spikes are held."""
    row = trains.conditions.iloc[trial]
    others = [in_unit(str(c), row[c]) for c in trains.conditions.columns if str(c).endswith(("_N", "_mm_per_s"))]
    until_s, is_cut = trains.until_s or 0, trains.held_steps[trial] < trains.trial_steps[trial]
    shown = [f"spikes of the first {until_s:g} s alone"] if is_cut else []
    return ", ".join([f"Trial {trial}: {row['label']}", *others, *shown])


def _stretch(trains: SpikeTrains, trial: int, start_s: float, stop_s: float | None) -> tuple[float, float]:
    end_s = float(trains.trial_steps[existing_trial(trains, trial)] / trains.sampling_rate_Hz)
    stop_s = end_s if stop_s is None else min(stop_s, end_s)
    if not 0 <= start_s < stop_s:
        raise InputError(f"raster: start {start_s:g} s must be >= 0 and before the end at {stop_s:g} s")
    return start_s, stop_s


def existing_trial(trains: SpikeTrains, trial: int) -> int:
    """The number of a trial; InputError if it does not exist."""
    if not (isinstance(trial, Integral) and 0 <= trial < len(trains)):
        raise InputError(f"trial {trial}: there is no such trial; trials count from 0 to {len(trains) - 1}")
    return trial


def _check_suffix(path: str | Path, suffixes: tuple[str, ...]) -> None:
    if Path(path).suffix.lower() not in suffixes:
        raise InputError(
            f"{path}: does not end with {' or '.join(suffixes)}; a raster is drawn to .png, .svg or .pdf "
            "and its events are written to .csv"
        )
