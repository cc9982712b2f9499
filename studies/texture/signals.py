"""Signals before encoding: amplitude and principal frequency of each class and condition."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.data.conditioning import condition
from neurotact.data.recordings import LABEL, Recordings
from neurotact.encoders.model import EncoderSpec
from neurotact.figures.encoding import Classes
from neurotact.figures.style import MUTED, Drawn, new_figure, printed, sequence, series_style
from neurotact.studies.measures import Measure
from neurotact.studies.study import Cell, StudySpec

LEAST_Hz = 1.0
"""Below this frequency, a spectrum of about a second shows drift, not texture."""
LINE_Hz = 1 / 16
"""Distance between the lines of a spectrum, so that its highest line separates frequencies."""
RIDGE_mm = 1.0
"""Width of the ridges of every grating in the texture paper (Sec. II-B); its pitch is the gap between ridges."""


def signal_table(recordings: Recordings, encoder: EncoderSpec, by: Iterable[str], start_ms: float) -> pd.DataFrame:
    """Means over the trials of each class and combination of the conditions in `by`, from `start_ms` on.

    Signals are conditioned as for the encoder; each trial must last longer than `start_ms`.
    Columns: label, for gratings also grating and pitch_mm, `by`, peak_<unit> (highest magnitude
    on the strongest taxel), principal_Hz (highest line of that taxel's mean amplitude spectrum), and for
    gratings expected_Hz, the set speed / (pitch + 1 mm).
    """
    conditioned = condition(recordings.to_unit(encoder.unit), encoder.conditioning)
    start = round(start_ms * 1e-3 * conditioned.sampling_rate_Hz)
    signals = [signal[start:] for signal in conditioned.signals]
    peaks = np.array([np.abs(signal).max(axis=0) for signal in signals])
    names = [LABEL, *(name for name in ("grating", "pitch_mm") if name in recordings.conditions), *by]
    rows = []
    for _, group in recordings.conditions.groupby([LABEL, *by], sort=False):
        trials = group.index.to_numpy()
        taxel = int(peaks[trials].mean(axis=0).argmax())
        row: dict[str, Any] = group.iloc[0][names].to_dict()
        row[f"peak_{conditioned.unit}"] = float(peaks[trials, taxel].mean())
        row["principal_Hz"] = principal_frequency(
            [signals[trial][:, taxel] for trial in trials], conditioned.sampling_rate_Hz
        )
        if {"pitch_mm", "speed_mm_per_s"} <= set(row):
            row["expected_Hz"] = row["speed_mm_per_s"] / (row["pitch_mm"] + RIDGE_mm)
        rows.append(row)
    return pd.DataFrame(rows)


def principal_frequency(signals: Iterable[np.ndarray], rate_Hz: float) -> float:
    """The highest line above 1 Hz of the mean amplitude spectrum of signals `(time,)`.

    >>> time_s = np.arange(2000) / 2000
    >>> principal_frequency([np.sin(2 * np.pi * 4.3 * time_s), np.cos(2 * np.pi * 4.3 * time_s)], 2000.0)
    4.3125
    """
    n_padded = round(rate_Hz / LINE_Hz)
    frequencies = np.fft.rfftfreq(n_padded, 1.0 / rate_Hz)
    spectrum = np.mean([np.abs(np.fft.rfft(x - x.mean(), n_padded)) / len(x) for x in signals], axis=0)
    return float(frequencies[np.where(frequencies >= LEAST_Hz, spectrum, 0.0).argmax()])


@printed
def draw_signals(table: pd.DataFrame, names: Sequence[str]) -> Figure:
    """Peak of the strongest taxel over force (left) and principal frequency over gratings (right; Fig. 12, Sec. III-A).

    table: of `signals.csv`; names: of the gratings, in the order of their numbers.
    """
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2)
    gratings, speeds = sorted(set(table["grating"])), sorted(set(table["speed_mm_per_s"]))
    for shade, grating, name in zip(sequence(len(gratings)), gratings, names, strict=True):
        peaks = table[table["grating"] == grating].groupby("force_N")["peak_mV"].mean()
        left.plot(peaks.index, peaks, marker="o", ms=3, color=shade, label=name)
    left.set(xlabel="force (N)", ylabel="peak (mV)", title="strongest taxel, conditioned")
    left.set_xticks(sorted(set(table["force_N"])))
    left.set_ylim(bottom=0)
    left.legend(title="grating", ncols=2)
    for index, speed in enumerate(speeds):
        rows = table[table["speed_mm_per_s"] == speed]
        means = rows.groupby("grating")[["principal_Hz", "expected_Hz"]].mean()
        style: Any = {**series_style(index), "mfc": "none", "ms": 5, "ls": ""}
        right.plot(means.index, means["principal_Hz"], label=f"{speed:g} mm/s", **style)
        right.plot(means.index, means["expected_Hz"], color=MUTED, lw=0.9, label="speed / (pitch + 1 mm)")
    right.set_xticks(gratings, names)
    right.set(xlabel="grating", ylabel="principal frequency (Hz)", title="highest line of the spectrum")
    right.set_ylim(bottom=0)
    legend_once(right)
    for axes in (left, right):
        axes.grid(axis="y")
    return figure


def legend_once(axes: Axes, **location: Any) -> None:
    """A legend with each label once."""
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(list(handles.values()), list(handles), **location)


def _table(folder: Path, study: StudySpec, cells: Sequence[Cell], recordings: Recordings) -> pd.DataFrame:
    return signal_table(recordings, study.encoder, study.dataset.stratify, study.window.start_ms)


def _drawn(study: StudySpec, results: pd.DataFrame, table: pd.DataFrame, classes: Classes) -> Iterator[Drawn]:
    if "expected_Hz" not in table:
        return
    names = [classes.short[label] for label in table.sort_values("grating")["label"].unique()]
    figure = draw_signals(table, names)
    peaks = ", ".join(
        f"{mean:.1f} mV at {force:g} N" for force, mean in table.groupby("force_N")["peak_mV"].mean().items()
    )
    off_Hz = (table["principal_Hz"] - table["expected_Hz"]).abs().max()
    caption = (
        "Left: highest magnitude on the strongest taxel, mean over trials and speeds, as the texture paper's Fig. 12. "
        "Right: the highest line of its spectrum, and speed / (pitch + 1 mm), the frequency of the ridges: at most "
        f"{off_Hz:.2f} Hz apart. Signals are conditioned as for the afferents."
    )
    low, high = table["principal_Hz"].min(), table["principal_Hz"].max()
    alt = f"Mean peak {peaks}; principal frequencies from {low:.1f} to {high:.1f} Hz."
    yield Drawn("signals", "Amplitude and principal frequency", figure, caption, alt)


MEASURE = Measure(
    bool,
    "Also measure the amplitude and the principal frequency of each class and condition: the table signals.csv.",
    "signals",
    "amplitude and principal frequency of the signals",
    of_study=_table,
    draw=_drawn,
)
"""The entry point `signals` of the group `neurotact.measures`."""
