"""What survives an encoder: a signal and what its spikes give back, over frequency, and what they tell of the class."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from neurotact_parts.encoders.survival.survival import Survival

from neurotact.figures.raster import PALETTE
from neurotact.figures.style import INK, MUTED, RA, SA, new_figure, printed


@printed
def draw_survival(survival: Survival) -> Figure:
    """Three panels.

    Left: the liveliest taxel's signal in one stretch, what is decoded, and its spikes below. Middle: power of the
    signal and of the error of the linear filter over frequency: where the error is lower, the signal survives. Right:
    bits that the counts so far tell of the class, mean over afferents, and what they would by chance.
    """
    figure = new_figure(2.6)
    signal, spectrum, told = figure.subplots(1, 3, width_ratios=(1.7, 1, 1))
    _draw_signal(signal, survival)
    lines = survival.spectra.frequency_Hz > 0
    for values, name, colour in ((survival.spectra.power, "signal", INK), (survival.spectra.error, "error", RA)):
        spectrum.loglog(survival.spectra.frequency_Hz[lines], values[lines], color=colour, label=name)
    spectrum.set(xlabel="frequency (Hz)", ylabel="power (sd²)", title=f"{survival.spectra.snr_dB:.1f} dB survive")
    spectrum.legend(handlelength=1.0)
    told.plot(survival.told.time_ms, survival.told.class_bits, color=SA, label="told")
    told.plot(survival.told.time_ms, survival.told.by_chance, "--", color=MUTED, label="by chance")
    told.set(xlabel="time (ms)", ylabel="information about the class (bit)", title="mean over afferents")
    told.set_ylim(bottom=min(0.0, float(survival.told.class_bits.min())))
    told.legend(handlelength=1.4)
    return figure


def _draw_signal(axes: Axes, survival: Survival) -> None:
    shown = survival.shown
    axes.plot(shown.time_ms, shown.signal, color=INK, label="signal")
    axes.plot(shown.time_ms, shown.linear, color=RA, label="linear filter")
    if shown.own.notna().any():
        axes.plot(shown.time_ms, shown.own, color=PALETTE[2], lw=0.8, label="own decoder")
    values = np.concatenate([shown.signal, shown.linear.dropna(), shown.own.dropna()])
    low, height = float(values.min()), float(np.ptp(values)) or 1.0
    names = list(survival.table.population[:-1])
    for row, name in enumerate(names):
        times = survival.events.time_ms[survival.events.population == name]
        y = low - (0.12 + 0.1 * row) * height
        axes.vlines(times, y - 0.04 * height, y + 0.04 * height, color=SA if row == 0 else PALETTE[row], lw=0.7)
        axes.text(1.01, y, name, transform=axes.get_yaxis_transform(), ha="left", va="center", fontsize=6)
    axes.set(xlabel="time (ms)", ylabel="signal (sd)", title="one taxel")
    axes.set_ylim(low - (0.1 + 0.1 * len(names)) * height, float(values.max()) + 0.25 * height)
    axes.legend(ncols=3, loc="upper left", handlelength=1.2, fontsize=6.5)
