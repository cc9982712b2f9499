"""The simulated squeezes compared with the signals of the compliance paper.

    python benchmarks/compliance_calibration.py [-o DIR]

Prints every fact with its target and the simulated value; with `-o` writes them as a table and draws the figures of
docs/compliance-simulator.md. No classifier is trained here, and none was used to set the parameters.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from neurotact_parts.studies.compliance.curve_features import curve_features, instants
from neurotact_parts.studies.compliance.figures import draw_curves, draw_features
from neurotact_parts.studies.compliance.simulator import (
    CHANNELS,
    SENSORS,
    ComplianceSpec,
    displacement_mm,
    draw_exploration,
    load_objects,
    press,
    simulate,
    skin_of,
    tactile_images,
    trial_generator,
)
from signal_facts import Fact, keep, print_facts

from neurotact.figures.style import INK, SERIES, add_legend, new_figure, printed, save

OVOIDS = {"orange": (22, 23, 24), "green": (25, 26, 27), "blue": (16, 17, 18), "purple": (19, 20, 21)}
"""Objects by colour from low to high stiffness (Sec. 3.3)."""
SHOWN = ("OBJ-4", "OBJ-17", "OBJ-18", "OBJ-35", "OBJ-37", "OBJ-42")
ELASTOMERS = (6, 7, 16, 17, 18, 31, 32, 37, 38, 39, 40, 41)
SMOOTHED = 8
"""Samples that are averaged before the search for the largest value."""


class Measured(NamedTuple):
    """One exploration of every object: `force_N` `(object, time)`, `curves` `(object, time, 12)`; largest readings."""

    spec: ComplianceSpec
    force_N: np.ndarray
    curves: np.ndarray
    largest_counts: np.ndarray


def measure(spec: ComplianceSpec) -> Measured:
    """Simulate, and measure the force and the largest readings."""
    things = list(load_objects())
    generators = [trial_generator(spec.seed, i + 1, 0) for i in range(len(things))]
    explored = [draw_exploration(spec, *pair) for pair in zip(things, [0] * len(things), generators, strict=True)]
    done = press(spec, things, explored)
    largest = [
        max(
            tactile_images(spec, sensor, thing, how, done.force_N[i], done.deformation_mm[i], generators[i]).max()
            for sensor in SENSORS
        )
        for i, (thing, how) in enumerate(zip(things, explored, strict=True))
    ]
    curves = np.asarray(simulate(spec.model_copy(update={"trials": 1})).signals)
    return Measured(spec, done.force_N, curves, np.array(largest))


def facts_of(measured: Measured) -> list[Fact]:
    """The paper's statements on movement, sensors and curves, with the simulated values."""
    return [*movement_facts(measured), *curve_facts(measured), *sensor_facts(measured)]


def movement_facts(measured: Measured) -> list[Fact]:
    """The facts of jaw and force."""
    spec, force_N = measured.spec, measured.force_N
    turn_s = spec.peak / spec.sampling_rate_Hz
    first = np.quantile(force_N[:, 0], [0, 0.5, 1])
    highest = force_N.max(axis=1)
    return [
        Fact(
            "explorations and classes",
            "Secs. 3.4 and 5.1",
            "47 of each of 42, 1974",
            f"{ComplianceSpec().trials} of {len(load_objects())}, {ComplianceSpec().n_trials}",
            ComplianceSpec().n_trials == 1974,
        ),
        Fact(
            "time to the turn",
            "Sec. 3.4: 12 mm at 10 mm/s",
            "1.2 s at 485 Hz",
            f"{turn_s:.3f} s, sample {spec.peak}",
            abs(turn_s - 1.2) < 0.01,
        ),
        Fact(
            "force at the first sample",
            "Sec. 3.4",
            "0.1 N",
            f"{first[1]:.3f} N ({first[0]:.3f} to {first[2]:.3f})",
            abs(first[1] - 0.1) < 0.01,
        ),
        Fact(
            "force at the turn",
            "Sec. 3.4: jaws are compliant, so that rigid objects cause no damage",
            "rigid objects stay below jaw stiffness x travel",
            f"{highest.min():.1f} to {highest.max():.1f} N of {spec.machine_N_per_mm * spec.travel_mm:.0f} N",
            bool(highest.max() < spec.machine_N_per_mm * spec.travel_mm),
        ),
    ]


def curve_facts(measured: Measured) -> list[Fact]:
    """The facts of the moments over time."""
    spec, rate_Hz = measured.spec, measured.spec.sampling_rate_Hz
    m00 = measured.curves[:, :, [CHANNELS.index("finger M00"), CHANNELS.index("palm M00")]]
    smooth = m00[:, : m00.shape[1] // SMOOTHED * SMOOTHED].reshape(len(m00), -1, SMOOTHED, 2).mean(axis=2)
    late_ms = 1e3 * ((smooth.argmax(axis=1) + 0.5) * SMOOTHED - 0.5 - spec.peak) / rate_Hz
    _, largest, h1, h2 = curve_features(m00[:, :, :1], spec.peak, rate_Hz)[:, 0].T
    return [
        Fact(
            "M00 is largest where the movement turns",
            "Fig. 1b",
            "every object, both sensors",
            f"within {np.abs(late_ms).max():.0f} ms",
            bool(np.abs(late_ms).max() < 50),
        ),
        *hysteresis_facts(spec, h1, h2),
        *stiffness_facts(largest),
    ]


def hysteresis_facts(spec: ComplianceSpec, h1: np.ndarray, h2: np.ndarray) -> list[Fact]:
    """h1, h2: of the finger's M00, `(object,)` in counts."""
    below = 1.0 - h2 / h1
    noise = spec.noise_counts * np.sqrt(2 * spec.finger.rows * spec.finger.columns)
    elastic = np.array(ELASTOMERS) - 1
    clear = (h1 - h2)[elastic] > 3 * noise
    return [
        Fact(
            "the curve is lopsided: H2 below H1",
            "Sec. 2: hysteresis",
            "every object",
            f"finger: {100 * below.min():.1f} to {100 * below.max():.1f} % below",
            bool((below > 0).all()),
        ),
        Fact(
            "of elastomers too",
            "Sec. 2: can be significant in elastomers",
            f"most of {len(elastic)} above thrice the noise of H1 - H2",
            f"{clear.sum()}; {100 * below[elastic].min():.1f} to {100 * below[elastic].max():.1f} % below, "
            f"noise {100 * noise / h1[elastic].mean():.1f} %",
            bool(clear.mean() > 0.5),
        ),
    ]


def stiffness_facts(largest: np.ndarray) -> list[Fact]:
    """largest: MAX of the finger's M00, `(object,)` in counts."""
    by_colour = np.array([largest[np.array(places) - 1] for places in OVOIDS.values()])
    apart = largest[[3, 37, 41]]
    return [
        Fact(
            "stiffness of the ovoids by colour",
            "Sec. 3.3",
            "orange < green < blue < purple in MAX, each position",
            ", ".join(f"{colour} {peaks.mean():,.0f}" for colour, peaks in zip(OVOIDS, by_colour, strict=True)),
            bool((np.diff(by_colour, axis=0) > 0).all()),
        ),
        Fact(
            "a foam cube, a toroid and a carrot are far apart",
            "Fig. 6: curves of objects differ",
            "in MAX of the finger's M00",
            f"{apart[0]:,.0f}, {apart[1]:,.0f}, {apart[2]:,.0f} counts",
            bool((np.diff(apart) > 0.5 * apart[:-1]).all()),
        ),
    ]


def sensor_facts(measured: Measured) -> list[Fact]:
    """The facts of finger and palm."""
    spec = measured.spec
    long_mm, wide_mm = (n * spec.finger.pitch_mm for n in (spec.finger.rows, spec.finger.columns))
    return [
        Fact(
            "size of the finger",
            "Sec. 3.1",
            "40.7 x 15.0 mm at 3.7 mm",
            f"{long_mm:.1f} x {wide_mm:.1f} mm, {spec.finger.rows} x {spec.finger.columns} taxels",
            abs(long_mm - 40.7) < 0.1 and abs(wide_mm - 15.0) < 0.3,
        ),
        Fact(
            "crosstalk",
            "Sec. 3.1: domes and laser cuts only on the finger",
            "finger < palm",
            f"{100 * spec.finger.crosstalk:.0f} % and {100 * spec.palm.crosstalk:.0f} % to each neighbour",
            spec.finger.crosstalk < spec.palm.crosstalk,
        ),
        Fact(
            "no taxel saturates",
            "Sec. 3.1: registers the image as objects are pressed",
            f"below {spec.counts} counts",
            f"{measured.largest_counts.min():.0f} to {measured.largest_counts.max():.0f} counts",
            bool(measured.largest_counts.max() < spec.counts),
        ),
    ]


class Shown(NamedTuple):
    """One exploration: displacement and force `(time,)`, and both images at the turn, `(row, column)`."""

    label: str
    displacement_mm: np.ndarray
    force_N: np.ndarray
    finger: np.ndarray
    palm: np.ndarray


@printed
def draw_squeezes(explorations: Sequence[Shown]) -> Figure:
    """Force over displacement, there and back, and both tactile images at the turn; a column per object.

    Each force plot has its own scale, to show the shape of the curve; all images share one.
    """
    figure = new_figure(4.4)
    grid = figure.subplots(3, len(explorations), height_ratios=(1.3, 1.2, 1.2))
    largest = max(max(one.finger.max(), one.palm.max()) for one in explorations)
    for column, one in zip(grid.T, explorations, strict=True):
        turn = int(one.displacement_mm.argmax())
        column[0].plot(one.displacement_mm[: turn + 1], one.force_N[: turn + 1], color=INK, label="squeeze")
        column[0].plot(one.displacement_mm[turn:], one.force_N[turn:], color=SERIES[4][0], label="release")
        column[0].set(title=one.label, xticks=(0, 6, 12), ylim=(0, None))
        for axes, image in zip(column[1:], (one.finger, one.palm), strict=True):
            drawn = axes.imshow(image, cmap="viridis", vmin=0, vmax=largest)
            axes.set(xticks=(), yticks=())
    for axes in grid[0]:
        axes.set_xlabel("squeezed (mm)")
    for axes, words in zip(grid[:, 0], ("force (N)", "finger", "palm"), strict=True):
        axes.set_ylabel(words)
    figure.colorbar(drawn, ax=grid[1:].ravel().tolist(), label="a taxel's reading (counts)", fraction=0.03)
    add_legend(figure, grid[0], ncols=2)
    return figure


def shown(spec: ComplianceSpec, labels: Sequence[str] = SHOWN) -> list[Shown]:
    """Force, deformation and the images at the turn of one exploration of each object."""
    found = []
    for i, thing in enumerate(load_objects()):
        if thing.label not in labels:
            continue
        rng = trial_generator(spec.seed, i + 1, 0)
        how = draw_exploration(spec, thing, 0, rng)
        done = press(spec, [thing], [how])
        force_N, deformation_mm = done.force_N[0], done.deformation_mm[0]
        images = []
        for sensor in SENSORS:
            skin = skin_of(spec, sensor)
            read = tactile_images(spec, sensor, thing, how, force_N, deformation_mm, rng)[instants(spec.peak).maximum]
            images.append(read.reshape(skin.rows, skin.columns))
        found.append(Shown(thing.label, displacement_mm(spec, how), force_N, images[0], images[1]))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Print every fact with its target, and whether it holds."""
    parser = argparse.ArgumentParser(prog="python benchmarks/compliance_calibration.py", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, help="folder for facts.csv and the figures")
    given = parser.parse_args(arguments)
    spec = ComplianceSpec()
    measured = measure(spec)
    facts = facts_of(measured)
    print_facts(facts)
    if given.out is not None:
        keep(facts, given.out)
        two = {label: measured.curves[int(label.removeprefix("OBJ-")) - 1] for label in ("OBJ-17", "OBJ-38")}
        rate_Hz = spec.sampling_rate_Hz
        save(draw_squeezes(shown(spec)), given.out / "compliance-squeezes.png")
        save(draw_curves(two, rate_Hz).figure, given.out / "compliance-curves.png")
        save(draw_features(measured.curves[1], spec.peak, rate_Hz).figure, given.out / "compliance-features.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
