"""A hand that squeezes and releases 42 objects between finger and palm: the compliance paper's experiment, simulated.

The objects are those of its Table 1, the movement that of its Sec. 3.4, the sensors those of its Sec. 3.1. The outputs
are the raw moments of both tactile images over time. Equations, sources, and our choices where the paper gives none:
docs/compliance-simulator.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from neurotact_parts.studies.compliance.tactile_moments import NAMES, moment_weights
from neurotact_parts.studies.compliance.viscoelastic import Bodies, Squeeze, deformation_at, squeeze
from neurotact_parts.studies.memory import check_room
from pydantic import Field, model_validator

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import Recordings
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


SENSORS = ("finger", "palm")
CHANNELS = tuple(f"{sensor} {name}" for sensor in SENSORS for name in NAMES)
"""The twelve curves of an exploration."""

OBJECTS_FILE = Path(__file__).with_name("compliance_objects.csv")
RELAXATION_S = (0.15, 1.5)
"""Time constants of the fast and the slow loss of every object: within an exploration (2.4 s), and about its length."""
GRAVITY_N_PER_G = 9.81e-3
FLAT_POWER = 8
"""|u/a|^8 + |v/b|^8 <= 1 is a rectangle with slightly rounded corners."""


class SkinSpec(Spec):
    """One tactile array."""

    rows: int = Field(ge=1)
    """Taxels along one side."""
    columns: int = Field(ge=1)
    """Taxels along the other side."""
    pitch_mm: float = Field(gt=0)
    """Distance of neighbouring taxels."""
    cover_N_per_mm3: float = Field(gt=0)
    """Stiffness of the cover as an elastic foundation: modulus over thickness."""
    spread_mm: float = Field(gt=0)
    """Spread of a point load by the cover."""
    crosstalk: float = Field(ge=0, lt=0.2)
    """Share of a taxel's force that each of its four neighbours reads."""
    half_force_N: float = Field(gt=0)
    """Force on a taxel at which its conductance is half of its limit."""


class ComplianceSpec(Spec):
    """The protocol, the sensors and the spread of one simulated experiment; the objects are in a separate table.

    >>> ComplianceSpec(trials=3).n_trials
    126
    """

    trials: int = Field(default=47, ge=1)
    """Explorations of each object (compliance paper, Sec. 3.4)."""
    seed: int = Field(default=0, ge=0)
    """Random seed: the same one gives the same bytes; an exploration's numbers depend only on its object and number."""
    sampling_rate_Hz: float = Field(default=485.0, gt=0)
    """Sampling rate of the finger (Sec. 3.1); the palm is read at the same instants."""
    speed_mm_per_s: float = Field(default=10.0, gt=0)
    """Speed of the palm (Sec. 3.4)."""
    travel_mm: float = Field(default=12.0, gt=0)
    """Largest displacement from first touch (Sec. 3.4)."""
    touch_N: float = Field(default=0.1, gt=0)
    """Force at which an exploration begins (Sec. 3.4)."""
    machine_N_per_mm: float = Field(default=4.0, gt=0)
    """Stiffness of finger, palm and their mounts, which the paper mentions without a value."""

    finger: SkinSpec = SkinSpec(
        rows=11, columns=4, pitch_mm=3.7, cover_N_per_mm3=2.7, spread_mm=2.8, crosstalk=0.01, half_force_N=10.0
    )
    """40.7 x 15.0 mm at 3.7 mm (Sec. 3.1): 11 x 4 taxels, one dome each, laser-cut to keep them apart."""
    palm: SkinSpec = SkinSpec(
        rows=16, columns=16, pitch_mm=3.7, cover_N_per_mm3=0.7, spread_mm=3.6, crosstalk=0.06, half_force_N=10.0
    )
    """A continuous sheet (Sec. 3.1). Its size is only in a drawing: 16 x 16 at the finger's pitch is ours."""

    counts: int = Field(default=4095, ge=1)
    """Largest reading of a taxel: 12 bits."""
    noise_counts: float = Field(default=3.0, ge=0)
    """White noise of a reading, rms."""
    mismatch: float = Field(default=0.05, ge=0, lt=0.3)
    """Standard deviation of taxel gains over their mean; the gains of a sensor are fixed."""

    stiffness_spread: float = Field(default=1.0, ge=0, le=3)
    """Factor on the variation and the decrease of each object's stiffness over explorations (table of objects)."""
    habit_mm: float = Field(default=2.0, ge=0)
    """Standard deviation of an object's usual position, along each axis: an operator has one position for each."""
    placing: Literal["repeated", "random"] = "random"
    """Repeated: an object is placed once for all of its explorations, as in a jig. Random: it is placed again for
    each, as by hand."""
    jitter_place_mm: float = Field(default=1.0, ge=0)
    """Standard deviation of each placement around the usual position, along each axis."""
    jitter_angle_deg: float = Field(default=5.0, ge=0)
    """Standard deviation of the orientation of each placement."""
    jitter_travel: float = Field(default=0.01, ge=0, lt=0.1)
    """Standard deviation of the distance travelled, and with it of the speed, over the commanded one."""
    jitter_start_ms: float = Field(default=4.0, ge=0)
    """Standard deviation of the start of the movement on the sensors' clock."""
    jitter_touch: float = Field(default=0.2, ge=0, lt=0.3)
    """Standard deviation of the force that starts an exploration over `touch_N`."""
    jitter_gain: float = Field(default=0.01, ge=0, lt=0.3)
    """Standard deviation of a whole sensor's gain from exploration to exploration."""

    @model_validator(mode="after")
    def _moves(self) -> ComplianceSpec:
        if self.peak < 2:
            raise ValueError("sampling_rate_Hz is too low for this speed: fewer than 2 samples before the turn")
        return self

    @property
    def peak(self) -> int:
        """The sample at which the commanded movement turns."""
        return round(self.travel_mm / self.speed_mm_per_s * self.sampling_rate_Hz)

    @property
    def n_samples(self) -> int:
        """Samples of an exploration, there and back."""
        return 2 * self.peak + 1

    @property
    def n_trials(self) -> int:
        """Explorations in all."""
        return self.trials * len(load_objects())


class Face(NamedTuple):
    """Geometry of the contact with a sensor: radii of curvature, half lengths of a flat face, or ring and tube radius.

    a lies along the rows of the sensor (along the finger), b along its columns.
    """

    shape: Literal["curved", "flat", "ring"]
    a_mm: float
    b_mm: float


class TouchedObject(NamedTuple):
    """A row of the table of objects."""

    label: str
    position: str
    mass_g: float
    force_at_5mm_N: float
    exponent: float
    losses: tuple[float, float]
    permanent_set: float
    spread: float
    """Standard deviation of the stiffness from exploration to exploration, over its mean."""
    softening: float
    """Share of the stiffness that is lost over the whole series of explorations."""
    faces: tuple[Face, Face]
    summit_mm: tuple[float, float]
    """Position of the object's highest point relative to its middle: not 0 for a pear."""
    roughness: float


@cache
def load_objects() -> tuple[TouchedObject, ...]:
    """The 42 objects of Table 1 with our physical parameters, OBJ-1 first.

    >>> [(thing.label, thing.faces[0].shape) for thing in load_objects()][36:38]
    [('OBJ-37', 'ring'), ('OBJ-38', 'curved')]
    """
    table = pd.read_csv(OBJECTS_FILE)
    return tuple(
        TouchedObject(
            row["label"],
            row["position"],
            row["mass_g"],
            row["force_at_5mm_N"],
            row["exponent"],
            (row["fast_loss"], row["slow_loss"]),
            row["permanent_set"],
            row["spread"],
            row["softening"],
            (
                Face(row["finger_shape"], row["finger_a_mm"], row["finger_b_mm"]),
                Face(row["palm_shape"], row["palm_a_mm"], row["palm_b_mm"]),
            ),
            (row["summit_a_mm"], row["summit_b_mm"]),
            row["roughness"],
        )
        for row in table.to_dict("records")
    )


class Exploration(NamedTuple):
    """The actual values of one exploration."""

    stiffness: float
    """Stiffness of the object over its mean."""
    travel: float
    """Distance travelled over the commanded one."""
    start_s: float
    touch_N: float
    place_mm: tuple[float, float]
    """Position of the object's summit relative to the middle of both sensors."""
    angle_rad: float
    gains: tuple[float, float]


def simulate(spec: ComplianceSpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """Raw moments over time of every exploration, float32 `(exploration, time, curve)` in counts; CHANNELS names them.

    conditions: label ("OBJ-1"), object (1 to 42), position, exploration. Rows go exploration by exploration through
        all objects, so fewer trials give a prefix of more.
    progress: called as (explorations done, explorations in all).

    >>> touch = simulate(ComplianceSpec(trials=1, sampling_rate_Hz=20.0))
    >>> np.asarray(touch.signals).shape, touch.unit, touch.channels[6]
    ((42, 49, 12), 'count', 'palm M00')
    """
    check_room(spec.n_trials, spec.n_samples, len(CHANNELS))
    for skin in (spec.finger, spec.palm):
        check_room(1, spec.n_samples, skin.rows * skin.columns)
    rows = [(i, trial) for trial in range(spec.trials) for i in range(len(load_objects()))]
    things = [load_objects()[i] for i, _ in rows]
    generators = [trial_generator(spec.seed, i + 1, trial) for i, trial in rows]
    explored = [
        draw_exploration(spec, thing, trial, rng)
        for thing, (_, trial), rng in zip(things, rows, generators, strict=True)
    ]
    pressed = press(spec, things, explored)
    signals = np.empty((len(rows), spec.n_samples, len(CHANNELS)), np.float32)
    for n, (thing, how, rng) in enumerate(zip(things, explored, generators, strict=True)):
        for s, sensor in enumerate(SENSORS):
            skin = skin_of(spec, sensor)
            images = tactile_images(spec, sensor, thing, how, pressed.force_N[n], pressed.deformation_mm[n], rng)
            signals[n, :, 6 * s : 6 * s + 6] = images @ moment_weights(skin.rows, skin.columns)
        if progress is not None and (n % 42 == 41):
            progress(n + 1, len(rows))
    conditions = pd.DataFrame(
        [(thing.label, i + 1, thing.position, trial) for thing, (i, trial) in zip(things, rows, strict=True)],
        columns=["label", "object", "position", "exploration"],
    )
    source = f"simulated compliance {spec.digest()}"
    return Recordings(signals, spec.sampling_rate_Hz, "count", conditions, CHANNELS, source)


def skin_of(spec: ComplianceSpec, sensor: str) -> SkinSpec:
    """The array of `sensor`, one of SENSORS."""
    return spec.finger if sensor == "finger" else spec.palm


def trial_generator(seed: int, *key: int) -> np.random.Generator:
    """The random numbers of one exploration, keyed by its object (1 to 42) and number, independent of all others."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw_exploration(spec: ComplianceSpec, thing: TouchedObject, trial: int, rng: np.random.Generator) -> Exploration:
    """The variation between explorations, normal within 3 deviations; fruit and vegetables soften with each squeeze."""
    stiffness, travel, start, touch, along, across, angle, *gains = np.clip(rng.standard_normal(9), -3.0, 3.0)
    number = int(thing.label.removeprefix("OBJ-"))
    of_object = np.clip(trial_generator(spec.seed, number).standard_normal(5), -3.0, 3.0)
    habit_mm = spec.habit_mm * of_object[:2] + thing.summit_mm
    if spec.placing == "repeated":
        along, across, angle = of_object[2:]
    series = trial / (spec.trials - 1) if spec.trials > 1 else 0.0
    softened = 1.0 - spec.stiffness_spread * thing.softening * series
    return Exploration(
        softened * (1.0 + spec.stiffness_spread * thing.spread * stiffness),
        1.0 + spec.jitter_travel * travel,
        1e-3 * spec.jitter_start_ms * start,
        spec.touch_N * (1.0 + spec.jitter_touch * touch),
        (habit_mm[0] + spec.jitter_place_mm * along, habit_mm[1] + spec.jitter_place_mm * across),
        float(np.deg2rad(spec.jitter_angle_deg * angle)),
        (1.0 + spec.jitter_gain * gains[0], 1.0 + spec.jitter_gain * gains[1]),
    )


def displacement_mm(spec: ComplianceSpec, how: Exploration) -> np.ndarray:
    """Position of the palm, `(time,)` from first touch: up and down at one speed."""
    time_s = np.arange(spec.n_samples) / spec.sampling_rate_Hz - how.start_s
    turn_s = spec.peak / spec.sampling_rate_Hz
    return spec.travel_mm * how.travel * np.clip(1.0 - np.abs(time_s / turn_s - 1.0), 0.0, None)


def press(spec: ComplianceSpec, things: list[TouchedObject], explored: list[Exploration]) -> Squeeze:
    """Force and deformation of each exploration, `(exploration, time)`, of the corresponding object in `things`."""
    exponent = np.array([thing.exponent for thing in things])
    at_5mm_N = np.array([thing.force_at_5mm_N for thing in things])
    bodies = Bodies(
        at_5mm_N / 5.0**exponent * np.array([how.stiffness for how in explored]),
        exponent,
        np.array([thing.losses for thing in things]),
        np.array([thing.permanent_set for thing in things]),
    )
    touch_N = np.array([how.touch_N for how in explored])
    begun_mm = deformation_at(bodies, touch_N) + touch_N / spec.machine_N_per_mm
    commanded_mm = np.array([displacement_mm(spec, how) for how in explored]) + begun_mm[:, None]
    turn, dt_s = commanded_mm.argmax(axis=1), 1 / spec.sampling_rate_Hz
    return squeeze(bodies, commanded_mm, turn, RELAXATION_S, spec.machine_N_per_mm, dt_s)


def tactile_images(
    spec: ComplianceSpec,
    sensor: str,
    thing: TouchedObject,
    how: Exploration,
    force_N: np.ndarray,
    deformation_mm: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """The readings of a sensor, `(time, taxel)` whole counts in float32, taxels row by row."""
    skin = skin_of(spec, sensor)
    s = SENSORS.index(sensor)
    # The palm is below and also carries the weight.
    borne_N = force_N + (thing.mass_g * GRAVITY_N_PER_G if sensor == "palm" else 0.0)
    share = footprint(skin, thing, s, how, borne_N, deformation_mm)
    taxel_N = _mix(skin, share * borne_N[:, None].astype(np.float32))
    conductance = taxel_N / (taxel_N + np.float32(skin.half_force_N))
    counts = taxel_gains(spec, sensor) * np.float32(spec.counts * how.gains[s]) * conductance
    counts += np.float32(spec.noise_counts) * rng.standard_normal(counts.shape, np.float32)
    return np.clip(np.rint(counts), 0, spec.counts)


def taxel_gains(spec: ComplianceSpec, sensor: str) -> np.ndarray:
    """Gain of each taxel over the mean, `(taxel,)` float32: a property of the sensor, common to all explorations."""
    skin = skin_of(spec, sensor)
    drawn = trial_generator(spec.seed, 0, SENSORS.index(sensor)).standard_normal(skin.rows * skin.columns)
    return (1.0 + spec.mismatch * np.clip(drawn, -3.0, 3.0)).astype(np.float32)


def footprint(
    skin: SkinSpec, thing: TouchedObject, s: int, how: Exploration, borne_N: np.ndarray, deformation_mm: np.ndarray
) -> np.ndarray:
    """Share of the force on each taxel, `(time, taxel)` float32; a row sums to 1.

    The cover is an elastic foundation, so pressure is 1 - rho within rho < 1: a paraboloid under a curved face, nearly
    uniform under a flat one, a ridge along a ring.
    """
    face = thing.faces[s]
    u, v = _object_axes(skin, how)
    depth_mm = _face_share(thing, s) * deformation_mm + _cover_depth_mm(skin, face, borne_N)
    reach = skin.spread_mm**2
    if face.shape == "curved":
        terms, scales = (u**2, v**2), (face.a_mm * depth_mm + reach, face.b_mm * depth_mm + reach)
    elif face.shape == "flat":
        half_a, half_b = (np.hypot(side, skin.spread_mm) + 0.0 * depth_mm for side in (face.a_mm, face.b_mm))
        terms, scales = (u**FLAT_POWER, v**FLAT_POWER), (half_a**FLAT_POWER, half_b**FLAT_POWER)
    else:
        off_ring = (np.hypot(u, v) - face.a_mm) ** 2
        terms, scales = (off_ring, np.zeros_like(u)), (face.b_mm * depth_mm + reach, np.ones_like(depth_mm))
    rho = np.stack([1.0 / scales[0], 1.0 / scales[1]], axis=1).astype(np.float32) @ np.stack(terms).astype(np.float32)
    pressure = np.maximum(np.float32(1.0) - rho, 0.0) * _relief(thing, u, v)
    # A face entirely between taxels or off the array loads the nearest taxel.
    empty = pressure.sum(axis=1) == 0.0
    pressure[empty, rho[empty].argmin(axis=1)] = 1.0
    return pressure / pressure.sum(axis=1, keepdims=True)


def _object_axes(skin: SkinSpec, how: Exploration) -> tuple[np.ndarray, np.ndarray]:
    """Position of each taxel in the object's own axes, `(taxel,)` each, in mm."""
    x, y = np.meshgrid(
        (np.arange(skin.rows) - (skin.rows - 1) / 2) * skin.pitch_mm,
        (np.arange(skin.columns) - (skin.columns - 1) / 2) * skin.pitch_mm,
        indexing="ij",
    )
    x, y = x.ravel() - how.place_mm[0], y.ravel() - how.place_mm[1]
    cosine, sine = np.cos(how.angle_rad), np.sin(how.angle_rad)
    return cosine * x + sine * y, cosine * y - sine * x


def _radius_mm(face: Face) -> float:
    """Geometric mean of the radii of curvature; a flat face counts as a sphere of ten times its half length."""
    factor = 10.0 if face.shape == "flat" else 1.0
    return factor * float(np.sqrt(face.a_mm * face.b_mm))


def _face_share(thing: TouchedObject, s: int) -> float:
    """Part of the deformation on this side: Hertz contacts under one force deform as radius^(-1/3)."""
    yields = [_radius_mm(face) ** (-1 / 3) for face in thing.faces]
    return yields[s] / sum(yields)


def _cover_depth_mm(skin: SkinSpec, face: Face, force_N: np.ndarray) -> np.ndarray:
    """Depth of a paraboloid in an elastic foundation: F = pi k R h^2."""
    return np.sqrt(force_N / (np.pi * skin.cover_N_per_mm3 * _radius_mm(face)))


def _relief(thing: TouchedObject, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The object's bumps, `(taxel,)` float32: a fixed pattern that moves with the object, 1 if it is smooth."""
    rng = np.random.default_rng(int(thing.label.removeprefix("OBJ-")))
    waves = rng.uniform((0.3, 0.3, 0.0, 0.0), (0.8, 0.8, 2 * np.pi, 2 * np.pi), (2, 4))  # rad/mm and rad
    bumps = np.sum([np.sin(k * u + p) * np.sin(m * v + q) for k, m, p, q in waves], axis=0)
    return np.float32(1.0) + (0.5 * thing.roughness * bumps).astype(np.float32)


def _mix(skin: SkinSpec, taxel_N: np.ndarray) -> np.ndarray:
    """Crosstalk: each taxel adds a share of its force to the readings of its four neighbours, and keeps the rest."""
    images = taxel_N.reshape(-1, skin.rows, skin.columns)
    mixed = (1.0 - 4.0 * skin.crosstalk) * images
    given = np.float32(skin.crosstalk) * images
    mixed[:, 1:] += given[:, :-1]
    mixed[:, :-1] += given[:, 1:]
    mixed[:, :, 1:] += given[:, :, :-1]
    mixed[:, :, :-1] += given[:, :, 1:]
    return mixed.reshape(taxel_N.shape)


SIMULATOR = Simulator(
    "42 objects squeezed between two tactile arrays: the moments of their images (compliance paper).",
    ComplianceSpec,
    simulate,
)
