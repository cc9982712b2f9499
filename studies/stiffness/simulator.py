"""A robot gripper with four PVDF taxels that grasps and releases three objects of different stiffness.

The experiment is that of the stiffness paper, Sec. IV: soft rubber, hard rubber and rigid wood, 12 placements of 20
grasps each, a second of grasp and two of release, at 5 cm/s to 3 % of 35 N. The signals are *as recorded*. Equations,
sources and mismatches: docs/stiffness-simulator.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from neurotact_parts.studies.memory import check_room
from pydantic import Field, model_validator

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


SUBSTEPS = 4
"""Steps of the equation of motion per sample: 0.125 ms at 2 kS/s, a fifth of the fastest time constant."""
MOST_CANDIDATES = 10_000
"""Maximum number of placements tried until one touches a taxel; nearly every one does with the published values."""
PLACEMENT_KEY, GRASP_KEY, PATCH_KEY = 0, 1, 2


class MaterialSpec(Spec):
    """The material of an object, as a cylinder under a flat jaw: `F = k d (1 + c d')`, d the indentation."""

    stiffness_N_per_mm: float = Field(gt=0)
    """k: the force of a line contact is nearly linear in its depth."""
    damping_s_per_mm: float = Field(default=0.0, ge=0)
    """c: the share by which the force rises for each mm/s (Hunt and Crossley 1975)."""


class StiffnessSpec(Spec):
    """The objects, the protocol and the physics of one simulated experiment.

    Values without a source are calibrated to the peaks that the paper and real PVDF recordings show, never to accuracy.

    >>> StiffnessSpec().n_trials
    720
    """

    placements: int = Field(default=12, ge=1)
    """Positions of the arm for each object (stiffness paper, Sec. IV-B)."""
    grasps: int = Field(default=20, ge=1)
    """Grasps in each position (the same)."""
    seed: int = Field(default=0, ge=0)
    """Random seed: the same one gives the same bytes; a grasp depends only on its object, placement and number."""
    sampling_rate_Hz: float = Field(default=2000.0, gt=0)
    """Sampling rate of the sensor's electronics (Sec. IV-A)."""
    grasp_s: float = Field(default=1.0, gt=0)
    """Duration of the grasp."""
    release_s: float = Field(default=2.0, gt=0)
    """A trial is a second of grasp and two of release (Sec. IV-B)."""

    objects: dict[str, MaterialSpec] = Field(
        default={
            "SR": MaterialSpec(stiffness_N_per_mm=0.8, damping_s_per_mm=0.006),
            "HR": MaterialSpec(stiffness_N_per_mm=4.0, damping_s_per_mm=0.004),
            "RW": MaterialSpec(stiffness_N_per_mm=200.0, damping_s_per_mm=0.001),
        },
        min_length=1,
    )
    """Soft rubber, hard rubber and rigid wood (Sec. IV-B); cylinders of 20 mm and about 0.05 MPa, 0.25 MPa, wood."""
    radius_mm: float = Field(default=15.0, gt=0)
    """Radius of the cylinders, which sets the growth of the contact's width with its depth."""
    pad: MaterialSpec = MaterialSpec(stiffness_N_per_mm=25.0, damping_s_per_mm=0.003)
    """Tape, substrate and protective layer of the patch, in series with every object (Sec. IV-A)."""

    speed_mm_per_s: float = Field(default=50.0, gt=0)
    """Speed of the closing jaw (Sec. IV-B)."""
    force_N: float = Field(default=0.03 * 35.0, gt=0)
    """Force at which the jaw stops: 3 % of 35 N (Sec. IV-B)."""
    jaw_kg: float = Field(default=0.06, gt=0)
    """Moving mass of the jaw."""
    drive_N_s_per_mm: float = Field(default=0.1, gt=0)
    """Gain of the jaw's speed loop: the force for each mm/s below the set speed."""
    gap_mm: tuple[float, float] = (5.0, 15.0)
    """Distance from the open jaw to the object, drawn uniformly."""

    taxel_x_mm: tuple[float, ...] = Field(default=(-5.0, 5.0, -5.0, 5.0), min_length=1)
    """Positions of the taxels across the cylinder: a pitch of 1 cm (Sec. IV-A)."""
    taxel_y_mm: tuple[float, ...] = Field(default=(-5.0, -5.0, 5.0, 5.0), min_length=1)
    """Positions of the taxels along the cylinder."""
    reach_mm: float = Field(default=8.0, gt=0)
    """A placement puts the line of contact anywhere within this distance of the patch's middle."""
    contact_mm: float = Field(default=3.0, gt=0)
    """At least one taxel lies as near to the line of contact as this ("at least one sensor ... in contact")."""
    turn_deg: float = Field(default=20.0, ge=0, lt=90)
    """Largest angle between cylinder and patch."""
    tilt: float = Field(default=0.4, ge=0, lt=1)
    """Largest share by which the load rises from the patch's middle to a row of taxels: jaws are not quite parallel."""
    blur_mm: float = Field(default=1.5, gt=0)
    """Spread (standard deviation) of a line load by the protective layer."""

    sensitivity_mV: float = Field(default=32.0, gt=0)
    """Voltage step for each newton on each mm of the footprint's width, over the taxel's 2 mm."""
    gain_spread: float = Field(default=0.15, ge=0, lt=0.3)
    """Standard deviation of the taxels' sensitivities over their mean; they are fixed for a patch."""
    high_pass_Hz: float = Field(default=1.0, gt=0)
    """High-pass corner of film and charge amplifier (bandwidth from 1 Hz, Sec. IV-A)."""
    noise_mV_rms: float = Field(default=0.23, ge=0)
    """White noise of the electronics: that of the quiet channels of the real PVDF patch."""

    jitter_speed: float = Field(default=0.03, ge=0, lt=0.3)
    """Standard deviation of the jaw's speed between grasps, over its mean."""
    jitter_force: float = Field(default=0.05, ge=0, lt=0.3)
    """Standard deviation of the force at which the jaw stops, over its mean."""
    jitter_stiffness: float = Field(default=0.05, ge=0, lt=0.3)
    """Standard deviations between grasps, over the mean."""
    jitter_position_mm: float = Field(default=0.5, ge=0)
    """Standard deviation of the line of contact between grasps."""
    jitter_turn_deg: float = Field(default=2.0, ge=0)
    """Standard deviation of the angle between cylinder and patch between grasps."""
    jitter_tilt: float = Field(default=0.05, ge=0)
    """Standard deviations of a grasp about its placement."""

    @model_validator(mode="after")
    def _fits_together(self) -> StiffnessSpec:
        if self.n_samples < 1:
            raise ValueError("grasp_s and release_s are shorter than one sample")
        if len(self.taxel_x_mm) != len(self.taxel_y_mm):
            raise ValueError(
                f"taxel_x_mm has {len(self.taxel_x_mm)} places but taxel_y_mm has {len(self.taxel_y_mm)}; "
                "give one each per taxel"
            )
        if not 0 < self.gap_mm[0] <= self.gap_mm[1]:
            raise ValueError("gap_mm must be two distances above 0, the shorter first")
        if self.gap_mm[1] / self.speed_mm_per_s > 0.6 * self.grasp_s:
            raise ValueError("gap_mm takes most of grasp_s to close; lower it or raise speed_mm_per_s")
        return self

    @property
    def n_samples(self) -> int:
        """Samples per trial."""
        return round((self.grasp_s + self.release_s) * self.sampling_rate_Hz)

    @property
    def n_trials(self) -> int:
        """Trials in all: objects x placements x grasps."""
        return len(self.objects) * self.placements * self.grasps


class Grasp(NamedTuple):
    """The actual values of one grasp: the contact, the jaw, and the position of the object on the patch."""

    stiffness_N_per_mm: float
    damping_s_per_mm: float
    speed_mm_per_s: float
    force_N: float
    gap_mm: float
    offset_mm: float
    turn_deg: float
    tilt: float


class Contact(NamedTuple):
    """Force in N and indentation in mm over time, `(trial, time)` each."""

    force_N: np.ndarray
    indentation_mm: np.ndarray


def simulate(spec: StiffnessSpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """Grasps of every object, in mV, float32 `(trial, time, taxel)`.

    conditions: label (the object), placement and grasp (from 1), stiffness_N_per_mm (object and pad together), force_N
        (the highest of the contact).
    progress: called as (trials done, trials in all).

    >>> touch = simulate(StiffnessSpec(placements=1, grasps=2))
    >>> touch.signals.shape, touch.unit, touch.classes
    ((6, 6000, 4), 'mV', ('HR', 'RW', 'SR'))
    """
    check_room(spec.n_trials, spec.n_samples, len(spec.taxel_x_mm))
    conditions = pd.DataFrame(
        [
            (label, placement, grasp)
            for label in spec.objects
            for placement in range(1, spec.placements + 1)
            for grasp in range(1, spec.grasps + 1)
        ],
        columns=["label", "placement", "grasp"],
    )
    keys = list(conditions.itertuples(index=False, name=None))
    drawn = [draw_grasp(spec, *key) for key in keys]
    forces = close_and_open(spec, drawn)
    gains = patch_gains(spec)
    signals = np.empty((len(keys), spec.n_samples, len(spec.taxel_x_mm)), np.float32)
    for i, (key, grasp) in enumerate(zip(keys, drawn, strict=True)):
        contact = Contact(forces.force_N[i], forces.indentation_mm[i])
        signals[i] = record(spec, grasp, contact, gains, _generator(spec, GRASP_KEY, *key, 1))
        if progress is not None and (i % 48 == 47 or i + 1 == len(keys)):
            progress(i + 1, len(keys))
    conditions["stiffness_N_per_mm"] = [grasp.stiffness_N_per_mm for grasp in drawn]
    conditions["force_N"] = forces.force_N.max(axis=1)
    return Recordings(signals, spec.sampling_rate_Hz, "mV", conditions, source=f"simulated grasps {spec.digest()}")


def in_series(a: MaterialSpec, b: MaterialSpec) -> MaterialSpec:
    """Two contacts in a row: compliances add; each damps by its share of the indentation.

    >>> soft = MaterialSpec(stiffness_N_per_mm=1.0, damping_s_per_mm=0.004)
    >>> in_series(soft, MaterialSpec(stiffness_N_per_mm=1.0))
    MaterialSpec(stiffness_N_per_mm=0.5, damping_s_per_mm=0.002)
    """
    stiffness = 1.0 / (1.0 / a.stiffness_N_per_mm + 1.0 / b.stiffness_N_per_mm)
    damping = sum(part.damping_s_per_mm * stiffness / part.stiffness_N_per_mm for part in (a, b))
    return MaterialSpec(stiffness_N_per_mm=stiffness, damping_s_per_mm=damping)


def draw_grasp(spec: StiffnessSpec, label: str, placement: int, grasp: int) -> Grasp:
    """The variation: the placement's line of contact (uniform), each grasp about it (normal, within 3 deviations)."""
    offset, turn, tilt = _draw_placement(spec, _generator(spec, PLACEMENT_KEY, label, placement))
    rng = _generator(spec, GRASP_KEY, label, placement, grasp, 0)
    gap = rng.uniform(*spec.gap_mm)
    z = np.clip(rng.standard_normal(6), -3.0, 3.0)
    material = spec.objects[label]
    varied = material.model_copy(
        update={"stiffness_N_per_mm": material.stiffness_N_per_mm * (1.0 + spec.jitter_stiffness * z[0])}
    )
    contact = in_series(varied, spec.pad)
    return Grasp(
        contact.stiffness_N_per_mm,
        contact.damping_s_per_mm,
        spec.speed_mm_per_s * (1.0 + spec.jitter_speed * z[1]),
        spec.force_N * (1.0 + spec.jitter_force * z[2]),
        gap,
        offset + spec.jitter_position_mm * z[3],
        turn + spec.jitter_turn_deg * z[4],
        tilt + spec.jitter_tilt * z[5],
    )


def close_and_open(spec: StiffnessSpec, grasps: list[Grasp]) -> Contact:
    """Jaws that close, stop and open: force and indentation of every grasp.

    `m v' = b (u - v) - F`, `F = k d (1 + c v)`, never below 0: u is the set speed until F reaches the set force, then
    0, and from the end of the grasp on the set speed outwards. The drive's screw does not turn back during a grasp.
    """
    table = np.array([grasp[:5] for grasp in grasps])
    stiffness, damping, speed, stop_N, gap = table.T
    n_samples, dt_s = spec.n_samples, 1.0 / (spec.sampling_rate_Hz * SUBSTEPS)
    opens_at = round(spec.grasp_s * spec.sampling_rate_Hz)
    position, velocity, force = -gap, np.zeros(len(table)), np.zeros(len(table))
    holding = np.zeros(len(table), bool)
    forces, indentations = (np.empty((n_samples, len(table))) for _ in range(2))
    for sample in range(n_samples):
        forces[sample], indentations[sample] = force, np.maximum(position, 0.0)
        closing = sample < opens_at
        for _ in range(SUBSTEPS):
            wanted = np.where(holding, 0.0, speed) if closing else -speed
            # 1 N moves 1 kg by 1000 mm/s² a second.
            velocity = velocity + dt_s * 1e3 / spec.jaw_kg * (spec.drive_N_s_per_mm * (wanted - velocity) - force)
            if closing:
                velocity = np.maximum(velocity, 0.0)
            position = np.maximum(position + dt_s * velocity, -gap)
            depth = np.maximum(position, 0.0)
            force = np.maximum(stiffness * depth * (1.0 + damping * velocity), 0.0)
            holding |= force >= stop_N
    return Contact(forces.T, indentations.T)


def record(
    spec: StiffnessSpec, grasp: Grasp, contact: Contact, gains: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The recorded signal of one grasp, `(time, taxel)` float32 in mV: the film's response to its load, and noise."""
    from scipy.signal import lfilter

    load = contact.force_N[:, None] * footprint(spec, grasp, contact.indentation_mm)
    decay = np.exp(-2.0 * np.pi * spec.high_pass_Hz / spec.sampling_rate_Hz)
    answer = lfilter([1.0, -1.0], [1.0, -decay], load, axis=0)
    noise = rng.standard_normal(load.shape, np.float32)
    return (-spec.sensitivity_mV * gains * answer).astype(np.float32) + np.float32(spec.noise_mV_rms) * noise


def footprint(spec: StiffnessSpec, grasp: Grasp, indentation_mm: np.ndarray) -> np.ndarray:
    """Share of the force on each mm of width at each taxel, `(time, taxel)` in 1/mm.

    A Gaussian across the line of contact whose variance is that of the layer and of the contact's own width: a
    cylinder of radius R pressed in by d touches over about sqrt(R d) to each side.
    """
    turn = np.deg2rad(grasp.turn_deg)
    x, y = np.array(spec.taxel_x_mm), np.array(spec.taxel_y_mm)
    across = (x - grasp.offset_mm) * np.cos(turn) + y * np.sin(turn)
    along = y * np.cos(turn) - (x - grasp.offset_mm) * np.sin(turn)
    row_mm = max(float(np.abs(y).max()), 1e-9)
    variance = spec.blur_mm**2 + 0.5 * spec.radius_mm * indentation_mm[:, None]
    tilted = np.maximum(1.0 + grasp.tilt * along / row_mm, 0.0)
    return tilted * np.exp(-0.5 * across**2 / variance) / np.sqrt(2.0 * np.pi * variance)


def patch_gains(spec: StiffnessSpec) -> np.ndarray:
    """Sensitivities of the patch's taxels over their mean, `(taxel,)`."""
    z = _generator(spec, PATCH_KEY).standard_normal(len(spec.taxel_x_mm))
    return 1.0 + spec.gain_spread * np.clip(z, -3.0, 3.0)


def _draw_placement(spec: StiffnessSpec, rng: np.random.Generator) -> tuple[float, float, float]:
    """Offset, turn and tilt of a placement that has a taxel near its line of contact."""
    for offset, turn, tilt in islice(_candidates(spec, rng), MOST_CANDIDATES):
        angle = np.deg2rad(turn)
        x, y = np.array(spec.taxel_x_mm), np.array(spec.taxel_y_mm)
        distance = np.abs((x - offset) * np.cos(angle) + y * np.sin(angle))
        if distance.min() <= spec.contact_mm:
            return offset, turn, tilt
    raise InputError(
        f"contact_mm: of {MOST_CANDIDATES} placements within reach_mm = {spec.reach_mm:g} none has a taxel within "
        f"{spec.contact_mm:g} mm of the line of contact; lower reach_mm or raise contact_mm"
    )


def _candidates(spec: StiffnessSpec, rng: np.random.Generator) -> Iterator[tuple[float, float, float]]:
    scales = np.array([spec.reach_mm, spec.turn_deg, spec.tilt])
    while True:
        offset, turn, tilt = rng.uniform(-scales, scales)
        yield float(offset), float(turn), float(tilt)


def _generator(spec: StiffnessSpec, *key: int | str) -> np.random.Generator:
    """The random numbers for one key, independent of all others."""
    numbers = [int.from_bytes(part.encode(), "big") % 2**32 if isinstance(part, str) else part for part in key]
    return np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=numbers))


SIMULATOR = Simulator(
    "A gripper with four PVDF channels on objects of three stiffnesses (stiffness paper).",
    StiffnessSpec,
    simulate,
)
