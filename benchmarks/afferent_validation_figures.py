"""The figures of docs/afferent-validation.md."""

from pathlib import Path

import numpy as np
from afferent_validation import (
    STANDARD,
    AMPLITUDES_um,
    DEPTHS_mm,
    FAST_mm_per_s,
    FREQUENCIES_Hz,
    LEAD_s,
    PERIODS_ms,
    RATE_Hz,
    RECORDED_um,
    SETTLED_s,
    STATIC_MODEL_Hz,
    encoders,
    fire,
    fire_repeatedly,
    locking,
    noisy,
    ramp,
    tuning,
    vibrations,
    with_t_ref,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurotact.figures.style import INK, MUTED, RA, SA, TOTAL, new_figure, printed, save

SHOWN = {"LIF": "LIF (today)", "biological": "LIF, biological", "mechanoreceptor": "fitted afferents"}
STYLES = {
    "LIF": (MUTED, ":"),
    "+ half-wave": (MUTED, "--"),
    "biological": ("#CC79A7", "-"),
    "mechanoreceptor": (SA, "-"),
}
REPEATS = 25
NAMES = {**SHOWN, "+ half-wave": "LIF, half-wave"}


@printed
def draw_ramps() -> Figure:
    """Spikes on a ramp that is held, under its depth, and the static rates over depth."""
    figure = new_figure(5.0)
    grid = figure.add_gridspec(4, 2, width_ratios=(2.0, 1.0), height_ratios=(0.5, 0.5, 1.2, 2.6))
    time_s = np.arange(len(STANDARD)) / RATE_Hz - LEAD_s
    above = figure.add_subplot(grid[0, 0])
    above.plot(time_s, STANDARD, color=INK)
    above.set(ylabel="depth\n(mm)", yticks=[0, 0.8], title="0.78 mm at 72 mm/s", xlim=(-LEAD_s, 0.6))
    above.tick_params(labelbottom=False)
    for row, (name, title) in enumerate(SHOWN.items(), start=1):
        axes = figure.add_subplot(grid[row, 0], sharex=above)
        _paint_raster(axes, {k: v[0] for k, v in fire(noisy(encoders()[name]), STANDARD).items()}, title)
        axes.tick_params(labelbottom=row == len(SHOWN))
    axes.set_xlabel("time from the ramp's start (s)")
    curve = figure.add_subplot(grid[:, 1])
    for name in SHOWN:
        rates = np.array([_late_of_each(name, depth) for depth in DEPTHS_mm])
        colour, line = STYLES[name]
        curve.plot(DEPTHS_mm, rates.mean(axis=1), line, color=colour, marker="o", ms=3, label=SHOWN[name])
        if name == "mechanoreceptor":
            curve.fill_between(DEPTHS_mm, rates.min(axis=1), rates.max(axis=1), color=colour, alpha=0.12, lw=0)
    curve.plot(DEPTHS_mm, STATIC_MODEL_Hz, "x", color=INK, ms=5, label="TouchSim, as published")
    curve.set(xlabel="depth (mm)", ylabel="late rate of SA-I (Hz)", title="static curve", ylim=(0, 140))
    curve.legend(loc="upper left")
    return figure


def _late_of_each(name: str, depth_mm: float) -> np.ndarray:
    last = round(0.5 * RATE_Hz)
    return fire(encoders()[name], ramp(depth_mm, FAST_mm_per_s))["SA-I"][0, -last:].sum(axis=0) / 0.5


def _paint_raster(axes: Axes, fired: dict[str, np.ndarray], title: str) -> None:
    """A row for each afferent, the first population on top."""
    row, ticks = 0, []
    for kind, colour in (("SA-I", SA), ("RA-I", RA), ("PC", TOTAL)):
        if kind not in fired:
            continue
        first = row
        for train in fired[kind].T:
            axes.vlines(np.flatnonzero(train) / RATE_Hz - LEAD_s, row - 0.42, row + 0.42, color=colour, lw=0.7)
            row += 1
        ticks.append(((first + row - 1) / 2, kind, colour))
    axes.set_ylim(row - 0.4, -0.6)
    axes.set_yticks([place for place, _, _ in ticks], [kind for _, kind, _ in ticks], fontsize=6.5)
    for label, (_, _, colour) in zip(axes.get_yticklabels(), ticks, strict=True):
        label.set_color(colour)
    axes.tick_params(axis="y", length=0)
    axes.set_title(title, loc="right", fontsize=7, fontweight="normal", pad=2)


@printed
def draw_tuning() -> Figure:
    """Thresholds over frequency, beside recorded ones."""
    figure = new_figure(3.0)
    for axes, kind in zip(figure.subplots(1, 2, sharey=True), ("RA-I", "PC"), strict=True):
        for name, (colour, line) in STYLES.items():
            found = tuning(name).get(kind)
            if found is None:
                continue
            axes.plot(FREQUENCIES_Hz, np.median(found.one, axis=1), line, color=colour, label=NAMES[name])
            if found.one.shape[1] > 2:
                low, high = found.one.min(axis=1), np.minimum(found.one.max(axis=1), AMPLITUDES_um[-1])
                axes.fill_between(FREQUENCIES_Hz, low, high, color=colour, alpha=0.12, lw=0)
        recorded = RECORDED_um[kind]
        axes.plot([*recorded], [*recorded.values()], "o", color=INK, ms=4, label="recorded")
        axes.set(xscale="log", yscale="log", xlabel="frequency (Hz)", title=kind, ylim=(0.02, 2500))
        axes.set_xticks([5, 10, 20, 50, 100, 200, 300], ["5", "10", "20", "50", "100", "200", "300"])
        axes.set_xticks([], minor=True)
        axes.grid(visible=True, which="major")
        axes.legend(loc="lower left" if kind == "RA-I" else "upper right")
    figure.axes[0].set_ylabel("threshold of one spike (µm)")
    return figure


@printed
def draw_locking() -> Figure:
    """Spikes a cycle over amplitude, and the phases of spikes."""
    figure = new_figure(2.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    shown = {"LIF": 0, "+ half-wave": 0, "mechanoreceptor": 1}
    for row, (name, afferent) in zip((0.0, 1.3, 2.6), shown.items(), strict=True):
        found, (colour, line) = locking(name, "RA-I"), STYLES[name]
        colour = RA if name == "mechanoreceptor" else colour
        label = "fitted afferent (fit 2)" if name == "mechanoreceptor" else NAMES[name]
        left.plot(AMPLITUDES_um, found.per_cycle[:, afferent], line, color=colour, label=label)
        turns = found.at_twice(afferent)
        if turns is not None:
            counts, edges = np.histogram(turns, bins=40, range=(0, 1))
            right.stairs(row + 0.9 * counts / counts.max(), edges, baseline=row, fill=True, color=colour)
        right.text(0.99, row + 0.94, label, ha="right", va="bottom", fontsize=7, color=INK)
    left.set(
        xscale="log", xlabel="amplitude at 50 Hz (µm)", ylabel="RA-I spikes a cycle", ylim=(0, 4.2), xlim=(10, 1000)
    )
    left.axhline(1, color="#e6e6e6", lw=0.8, zorder=0)
    left.legend(loc="upper left")
    right.set(xlabel="phase (cycles)", yticks=[], xlim=(0, 1), title="phases at twice that of a spike a cycle")
    return figure


@printed
def draw_periods() -> Figure:
    """What refractory periods do to the fitted afferents."""
    figure = new_figure(2.8)
    panels = figure.subplots(1, 3)
    tones = dict(zip(PERIODS_ms, ("#56B4E9", SA, INK), strict=True))
    encoder = encoders()["mechanoreceptor"]
    bins_ms = np.arange(0, 205, 5)
    for t_ref_ms, colour in tones.items():
        changed, label = with_t_ref(encoder, t_ref_ms), f"{t_ref_ms:g} ms"
        pressed = fire_repeatedly(changed, ramp(1.44, FAST_mm_per_s), REPEATS)["SA-I"]
        when_ms = 1e3 * (np.nonzero(pressed)[1] / RATE_Hz - LEAD_s)
        counts, edges = np.histogram(when_ms, bins=bins_ms)
        panels[0].stairs(counts / (pressed.shape[2] * REPEATS) / 0.005, edges, color=colour, label=label)
        for axes, kind, frequency_Hz in ((panels[1], "RA-I", 100.0), (panels[2], "PC", 200.0)):
            raster = fire(changed, vibrations(frequency_Hz, AMPLITUDES_um))[kind][:, round(SETTLED_s * RATE_Hz) :]
            axes.plot(AMPLITUDES_um, raster.sum(axis=1).mean(axis=1) / (1 - SETTLED_s), color=colour, label=label)
    panels[0].set(xlabel="time from the ramp's start (ms)", ylabel="rate (Hz)", title="SA-I, 1.44 mm", xlim=(0, 200))
    panels[0].legend(title="$t_\\mathrm{ref}$", loc="upper right")
    for axes, title in ((panels[1], "RA-I, 100 Hz"), (panels[2], "PC, 200 Hz")):
        axes.set(xscale="log", xlabel="amplitude (µm)", ylabel="rate (Hz)", title=title, ylim=(0, None))
    return figure


FIGURES = {
    "afferent-ramps": draw_ramps,
    "afferent-tuning": draw_tuning,
    "afferent-locking": draw_locking,
    "afferent-t-ref": draw_periods,
}


def draw_all(folder: Path) -> None:
    """Draw every figure into the folder."""
    for name, draw in FIGURES.items():
        save(draw(), folder / f"{name}.png")
