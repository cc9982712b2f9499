"""People who slide a finger, brush a paintbrush and roll a washer over a 4 x 4 piezoelectric array, simulated.

People, strokes and recordings are those of the touch-modality paper (Sec. IV): 70 people, three modalities, two
directions, twice each, 10 s at 3 kS/s through a charge amplifier around 1.65 V. The forces are set so that one touch in
fourteen is too light to leave the activity band, as published; no parameter is set by a classifier's accuracy.
Equations, sources and omissions: docs/touch-modality-simulator.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated, NamedTuple

import numpy as np
from neurotact_parts.studies.memory import check_room
from neurotact_parts.studies.touch_modality.contacts import (
    BrushSpec,
    FingerSpec,
    Motion,
    Tool,
    WasherSpec,
    contact_stress,
    touch,
)
from pydantic import Field, model_validator

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import Recordings
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


NotNegative = Annotated[float, Field(ge=0)]

MODALITIES = ("brushing", "rolling", "sliding")
DIRECTIONS = ("horizontal", "vertical")
REPETITIONS = 2
SIDE = 4
TOUCHES = len(MODALITIES) * len(DIRECTIONS) * REPETITIONS
"""Touches per person."""
PERSON_KEY, ARRAY_KEY = 1, 2
"""First word of the random key of a person and of the array; touches take 0."""


class TouchModalitySpec(Spec):
    """The people, their tools, the array and its electronics.

    >>> TouchModalitySpec(people=3).n_trials
    36
    """

    people: int = Field(default=70, ge=1)
    """Number of people (Sec. IV); with fewer, the first ones are the same."""
    seed: int = Field(default=0, ge=0)
    """Random seed: the same one gives the same bytes; a touch depends only on its person and its conditions."""
    recording_s: float = Field(default=10.0, gt=0)
    """Duration of a recording (Sec. IV)."""
    sampling_rate_Hz: float = Field(default=3000.0, gt=0)
    """Sampling rate (Sec. IV)."""

    finger: FingerSpec = FingerSpec()
    brush: BrushSpec = BrushSpec()
    washer: WasherSpec = WasherSpec()

    pitch_mm: float = Field(default=10.0, gt=0)
    """Distance of taxels."""
    cover_mm: float = Field(default=3.0, gt=0)
    """Standard deviation of the blur of a contact by the elastic cover."""
    gain_spread: float = Field(default=0.15, ge=0)
    """Deviation of the logarithm of the taxels' gains; one array for all people of a seed."""
    sensitivity_mV_per_kPa: float = Field(default=30.0, gt=0)
    """Sensitivity of film and charge amplifier together; a press gives a negative voltage."""
    high_pass_Hz: float = Field(default=1.0, gt=0)
    """High-pass corner of the charge amplifier."""
    low_pass_Hz: float = Field(default=1000.0, gt=0)
    """Low-pass corner of the charge amplifier."""
    baseline_V: float = 1.65
    """Half of the supply; the middle of the published activity band."""
    supply_V: float = Field(default=3.3, gt=0)
    """Signals saturate at 0 and here."""
    offset_mV: float = Field(default=3.0, ge=0)
    """Deviation of a channel's baseline, drawn for each touch."""
    noise_mV_rms: float = Field(default=2.0, ge=0)
    """White noise of the electronics."""
    hum_mV: float = Field(default=2.0, ge=0)
    """Amplitude of the mains at 50 Hz."""
    step_mV: float = Field(default=20000 / 2**16, gt=0)
    """Step of the acquisition board: 16 bits over 20 V."""

    start_s: float = Field(default=0.4, ge=0)
    """Earliest start of a touch; a random delay follows."""
    hesitation_s: float = Field(default=0.9, gt=0)
    """Scale of that delay, a gamma distribution of shape 2."""
    duration_s: float = Field(default=2.4, gt=0)
    """Duration of the contact, median; about 2 s of it are outside the activity band (Sec. IV-A)."""
    span_mm: float = Field(default=34.0, gt=0, le=1e4)
    """Length of a pass over the array, median."""
    back_and_forth: tuple[float, ...] = Field(default=(0.6, 0.3, 0.1), min_length=1)
    """Shares of people who pass once, twice, three times; each person has a habit for each modality."""
    dwell_s: float = Field(default=0.08, ge=0)
    """Pause at each turn."""
    rise_s: float = Field(default=0.12, gt=0)
    """Rise time of the load at contact; it falls as fast."""
    force_spread: tuple[NotNegative, NotNegative] = (0.7, 0.45)
    """Deviation of the logarithm of the force: between people (no force was prescribed), and between their touches."""
    tempo_spread: tuple[NotNegative, NotNegative] = (0.22, 0.15)
    """The same for the duration of a touch."""
    wobble_mm: float = Field(default=1.5, ge=0)
    """Amplitude of the hand's deviation across a stroke."""
    tremor: float = Field(default=0.06, ge=0, lt=0.5)
    """Share of the load with tremor, at 8 to 12 Hz."""

    @model_validator(mode="after")
    def _fits_together(self) -> TouchModalitySpec:
        if abs(sum(self.back_and_forth) - 1.0) > 1e-9 or min(self.back_and_forth) < 0:
            raise ValueError("back_and_forth must hold shares >= 0 that sum to 1")
        if self.low_pass_Hz >= self.sampling_rate_Hz / 2:
            raise ValueError("low_pass_Hz must be below half of sampling_rate_Hz")
        if not 0 < self.baseline_V < self.supply_V:
            raise ValueError("baseline_V must lie between 0 and supply_V")
        if self.recording_s < self.start_s + 1.0:
            raise ValueError("recording_s must leave at least 1 s after start_s")
        return self

    @property
    def n_samples(self) -> int:
        """Samples per touch."""
        return round(self.recording_s * self.sampling_rate_Hz)

    @property
    def n_trials(self) -> int:
        """Touches in all."""
        return self.people * TOUCHES

    def tool(self, modality: str) -> Tool:
        """The tool of a modality."""
        return {"sliding": self.finger, "brushing": self.brush, "rolling": self.washer}[modality]


class Person(NamedTuple):
    """Habits: force and tempo as factors, passes of each modality, position of each modality and direction (mm)."""

    force: float
    tempo: float
    passes: np.ndarray
    across_mm: np.ndarray
    width: np.ndarray


class Stroke(NamedTuple):
    """The actual values of one touch."""

    start_s: float
    duration_s: float
    passes: int
    span_mm: float
    middle_mm: float
    across_mm: float
    force_N: float
    width: float
    backwards: bool


def simulate(spec: TouchModalitySpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """All touches in V, float32 `(touch, time, taxel)`; 1.6 GB for 70 people, so see `each_person` too.

    That is more than one input may take unless NEUROTACT_MAX_MB is raised.

    conditions: label (brushing, rolling, sliding), person, direction, repetition, force_N, duration_s, passes. Rows go
        person by person. Taxel 4 r + c is in row r and column c; a horizontal stroke runs along rows.
    progress: called as (touches done, touches in all), after each person.

    >>> touch = simulate(TouchModalitySpec(people=1))
    >>> touch.signals.shape, touch.unit, touch.classes
    ((12, 30000, 16), 'V', ('brushing', 'rolling', 'sliding'))
    """
    check_room(spec.n_trials, spec.n_samples, SIDE**2)
    signals = np.empty((spec.n_trials, spec.n_samples, SIDE**2), np.float32)
    tables = []
    for person, (touches, table) in enumerate(each_person(spec)):
        signals[person * TOUCHES : (person + 1) * TOUCHES] = touches
        tables.append(table)
        if progress is not None:
            progress((person + 1) * TOUCHES, spec.n_trials)
    conditions = pd.concat(tables, ignore_index=True)
    return Recordings(signals, spec.sampling_rate_Hz, "V", conditions, source=f"simulated touches {spec.digest()}")


def each_person(spec: TouchModalitySpec) -> Iterator[tuple[np.ndarray, pd.DataFrame]]:
    """The touches of one person after the other: `(TOUCHES, time, taxel)` in V and their conditions."""
    check_room(TOUCHES, spec.n_samples, SIDE**2)
    gains = np.exp(spec.gain_spread * _generator(spec.seed, ARRAY_KEY).standard_normal(SIDE**2))
    for index in range(spec.people):
        person = draw_person(spec, _generator(spec.seed, PERSON_KEY, index))
        signals = np.empty((TOUCHES, spec.n_samples, SIDE**2), np.float32)
        rows = []
        for touch_index, (m, d, r) in enumerate(np.ndindex(len(MODALITIES), len(DIRECTIONS), REPETITIONS)):
            rng = _generator(spec.seed, 0, index, m, d, r)
            stroke = draw_stroke(spec, person, m, d, rng)
            signals[touch_index] = record(spec, stroke, MODALITIES[m], DIRECTIONS[d], gains, rng)
            named = (MODALITIES[m], index, DIRECTIONS[d], r, stroke.force_N, stroke.duration_s, stroke.passes)
            rows.append(named)
        names = ["label", "person", "direction", "repetition", "force_N", "duration_s", "passes"]
        yield signals, pd.DataFrame(rows, columns=names)


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw_person(spec: TouchModalitySpec, rng: np.random.Generator) -> Person:
    """A person's habits; places are uniform over the array, as "a random position" is."""
    places = (len(MODALITIES), len(DIRECTIONS))
    reach_mm = 0.5 * SIDE * spec.pitch_mm
    return Person(
        force=float(np.exp(spec.force_spread[0] * rng.standard_normal())),
        tempo=float(np.exp(spec.tempo_spread[0] * rng.standard_normal())),
        passes=1 + rng.choice(len(spec.back_and_forth), len(MODALITIES), p=spec.back_and_forth),
        across_mm=rng.uniform(-reach_mm, reach_mm, places),
        width=rng.standard_normal(len(MODALITIES)),
    )


def draw_stroke(
    spec: TouchModalitySpec, person: Person, modality: int, direction: int, rng: np.random.Generator
) -> Stroke:
    """One touch of a person: its habits with the variation between touches."""
    force, tempo, span, middle, across, width = rng.standard_normal(6)
    duration_s = spec.duration_s * person.tempo * float(np.exp(spec.tempo_spread[1] * tempo))
    # a touch ends before the recording does
    duration_s = min(duration_s, spec.recording_s - spec.start_s - 0.5)
    latest_s = spec.recording_s - duration_s - 0.3
    return Stroke(
        start_s=min(spec.start_s + float(rng.gamma(2.0, spec.hesitation_s)), latest_s),
        duration_s=duration_s,
        passes=int(person.passes[modality]),
        span_mm=spec.span_mm * float(np.exp(0.2 * span)),
        middle_mm=4.0 * float(middle),
        across_mm=float(person.across_mm[modality, direction] + 2.0 * across),
        force_N=spec.tool(MODALITIES[modality]).force_N * person.force * float(np.exp(spec.force_spread[1] * force)),
        width=float((person.width[modality] + width) / np.sqrt(2.0)),
        backwards=bool(rng.random() < 0.5),
    )


def move(spec: TouchModalitySpec, stroke: Stroke, rng: np.random.Generator) -> Motion:
    """Kinematics and load of a stroke while it lasts.

    Each pass is a minimum-jerk movement (Flash and Hogan 1985): 10 u^3 - 15 u^4 + 6 u^5 of the span.
    """
    rate_Hz = spec.sampling_rate_Hz
    time_s = np.arange(max(int(stroke.duration_s * rate_Hz), 2)) / rate_Hz
    dwell_s = min(spec.dwell_s, 0.2 * stroke.duration_s / stroke.passes)
    pass_s = (stroke.duration_s - dwell_s * (stroke.passes - 1)) / stroke.passes
    number = np.minimum(time_s // (pass_s + dwell_s), stroke.passes - 1)
    u = np.minimum((time_s - number * (pass_s + dwell_s)) / pass_s, 1.0)
    turn = np.where((number % 2 == 1) != stroke.backwards, -1.0, 1.0)
    along = stroke.middle_mm + turn * stroke.span_mm * (u**3 * (10.0 - 15.0 * u + 6.0 * u**2) - 0.5)
    speed = turn * stroke.span_mm * 30.0 * u**2 * (1.0 - u) ** 2 / pass_s
    sway, shake = rng.uniform(0.0, 2.0 * np.pi, 2)
    sway_Hz, shake_Hz = rng.uniform(0.3, 1.0), rng.uniform(8.0, 12.0)
    across = stroke.across_mm + spec.wobble_mm * np.sin(2.0 * np.pi * sway_Hz * time_s + sway)
    rise_s = min(spec.rise_s, 0.4 * stroke.duration_s)
    envelope = _smooth_step(time_s / rise_s) * _smooth_step((stroke.duration_s - time_s) / rise_s)
    load = stroke.force_N * envelope * (1.0 + spec.tremor * np.sin(2.0 * np.pi * shake_Hz * time_s + shake))
    return Motion(along, across, speed, load, rate_Hz)


def record(
    spec: TouchModalitySpec, stroke: Stroke, modality: str, direction: str, gains: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The recorded voltages of one touch, `(time, taxel)` float32: stress, film, amplifier, noise, acquisition."""
    motion = move(spec, stroke, rng)
    contact = touch(spec.tool(modality), motion, stroke.width, rng)
    stress = contact_stress(contact, motion, taxels_mm(spec), spec.cover_mm)
    if direction == "vertical":
        stress = stress.reshape(-1, SIDE, SIDE).transpose(0, 2, 1).reshape(len(stress), -1)
    first = round(stroke.start_s * spec.sampling_rate_Hz)
    drive = np.zeros((spec.n_samples, SIDE**2))
    drive[first : first + len(stress)] = stress[: spec.n_samples - first] * (-spec.sensitivity_mV_per_kPa * gains)
    return _acquire(spec, _amplify(spec, drive, first), rng)


def taxels_mm(spec: TouchModalitySpec) -> np.ndarray:
    """Coordinates of the rows, and of the columns, from the middle of the array."""
    return spec.pitch_mm * (np.arange(SIDE) - 0.5 * (SIDE - 1))


def _amplify(spec: TouchModalitySpec, drive: np.ndarray, first: int) -> np.ndarray:
    """First-order high-pass and low-pass, each by the bilinear transform; the input is 0 before sample `first`."""
    from scipy.signal import lfilter

    k = np.tan(np.pi * spec.high_pass_Hz / spec.sampling_rate_Hz)
    signal = lfilter([1.0 / (1.0 + k), -1.0 / (1.0 + k)], [1.0, (k - 1.0) / (k + 1.0)], drive[first:], axis=0)
    k = np.tan(np.pi * spec.low_pass_Hz / spec.sampling_rate_Hz)
    drive[first:] = lfilter([k / (1.0 + k), k / (1.0 + k)], [1.0, (k - 1.0) / (k + 1.0)], signal, axis=0)
    return drive


def _acquire(spec: TouchModalitySpec, signal_mV: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    time_s = np.arange(len(signal_mV)) / spec.sampling_rate_Hz
    hum = spec.hum_mV * np.sin(2.0 * np.pi * 50.0 * time_s + rng.uniform(0.0, 2.0 * np.pi))
    offset = spec.baseline_V * 1e3 + spec.offset_mV * rng.standard_normal(signal_mV.shape[1])
    recorded = signal_mV.astype(np.float32)
    recorded += (offset + hum[:, None]).astype(np.float32)
    recorded += np.float32(spec.noise_mV_rms) * rng.standard_normal(signal_mV.shape, np.float32)
    np.clip(recorded, 0.0, spec.supply_V * 1e3, out=recorded)
    return np.round(recorded / np.float32(spec.step_mV)) * np.float32(spec.step_mV * 1e-3)


def _smooth_step(u: np.ndarray) -> np.ndarray:
    u = np.clip(u, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


SIMULATOR = Simulator(
    "People who slide, brush and roll on a 4 x 4 array (touch-modality paper).",
    TouchModalitySpec,
    simulate,
)
