"""A PVDF finger that slides over ridged plates: the gratings of the texture paper, simulated.

The plates are those of its Sec. II-B (ridges of 1 mm, gaps of 4 to 0.5 mm), the forces, speeds and trials those of
Sec. II-C. Only the slide is simulated. It starts at the same place each time, as with a motorised axis, or
anywhere on the plate, as by hand. The signals are *as recorded*: the moving average at 30 Hz belongs to the
encoder's conditioning. Equations, sources and mismatches: docs/gratings-simulator.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.exporters.live.finger import Control, Finger
from neurotact_parts.studies.memory import check_room
from pydantic import Field, model_validator

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import Recordings
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


Positive = Annotated[float, Field(gt=0)]

REFERENCE_FORCE_N = 12.0
REFERENCE_PITCH_MM = 4.0
"""The amplitudes of a spec are those of grating 1 at 12 N."""

TABLE_POINTS = 4096

PLATE_mm = 140.0
"""The ridged part of a plate: 200 mm without the flat margin of 30 mm at each end."""
GRAIN_mm = 0.01
"""Distance between the points of a plate's roughness: finer than the mount transmits, about 0.2 mm."""
START = "start"
"""The condition that distinguishes a repeated start from a random one."""
REPEATED, RANDOM = "repeated", "random"
CONDITIONS = ("grating", "pitch_mm", "force_N", "speed_mm_per_s", START, "trial")
"""Conditions of a trial, besides its label."""
FIRST_BY_HAND = 1_000_000_000
"""Trials from this number on are slides by hand."""


class GratingsSpec(Spec):
    """The plates, the protocol and the physics of one simulated experiment.

    Values without a source are calibrated to the published amplitudes, spike counts and firing rates; see
    `python benchmarks/gratings_calibration.py`.

    >>> GratingsSpec(trials=3).n_trials
    144
    """

    trials: int = Field(default=100, ge=1)
    """Slides for each grating, force and speed (texture paper, Sec. II-C)."""
    seed: int = Field(default=0, ge=0)
    """Random seed: the same one gives the same bytes; a trial's numbers depend only on its own conditions."""
    duration_s: float = Field(default=1.25, gt=0)
    """Duration of the slide (a trial): a 1 s window starts after 0.25 s, when filters and membranes have settled."""
    sampling_rate_Hz: float = Field(default=2000.0, gt=0)
    """Sampling rate of the sensor's electronics (Sec. II-A)."""

    pitches_mm: tuple[Positive, ...] = Field(default=(4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5), min_length=1)
    """The gap between ridges, gratings 1 to 8 (Sec. II-B)."""
    ridge_width_mm: float = Field(default=1.0, gt=0)
    """The spatial period is pitch + ridge width."""
    forces_N: tuple[Positive, ...] = Field(default=(3.0, 6.0, 12.0), min_length=1)
    """Indentation forces (Sec. II-C)."""
    speeds_mm_per_s: tuple[Positive, ...] = Field(default=(8.6, 13.7), min_length=1)
    """Set sliding speeds (Sec. II-C)."""
    speed_factor: float = Field(default=1.0733, gt=0)
    """Real speed over the set one: grating 1 has its principal frequency at 1.846 Hz in the public recordings."""

    start: Literal["repeated", "random", "both"] = REPEATED
    """Repeated: every slide starts at `start_mm`, as on a motorised axis. Random: anywhere on the plate, as by hand."""
    start_mm: float = Field(default=4.41, ge=0, le=PLATE_mm)
    """Position of the first taxel at the trial's first sample, from the middle of a plate's first ridge; the same for
    all plates. Only grating 1 determines it, modulo its period of 5 mm."""
    start_jitter_ms: float = Field(default=16.0, ge=0)
    """Standard deviation of the start time of a repeated slide."""

    press_mV: float = Field(default=13.7, ge=0)
    """Pressure signal of a ridge that covers the taxel: the step before the high-pass, grating 1 at 12 N."""
    skin_mm: float = Field(default=0.06, gt=0)
    """Blur (standard deviation) of a ridge's footprint by the skin's thickness, at 12 N."""
    drape: float = Field(default=0.14, ge=0)
    """Compliance: the skin in a gap bends over the ridge and adds this part of the gap to the blur."""
    catch_mV: float = Field(default=13.0, ge=0)
    """Oscillation of the finger when the skin catches or leaves a ridge's edge, grating 1 at 12 N."""
    edge_mm: float = Field(default=0.02, gt=0)
    """Roundness (standard deviation) of a ridge's edge in contact with the skin's surface at 12 N."""
    slip_mV_rms: float = Field(default=7.6, ge=0)
    """Stick-slip noise under a ridge that covers the taxel, grating 1 at 12 N; white, then coloured by the mount."""
    friction_repeats: float = Field(default=0.82, ge=0, le=1)
    """Share of that noise's power that belongs to the plate: the same at the same place in every slide."""
    sag_mm: float = Field(default=0.14, ge=0)
    """Compliance: catch and slip grow with the gap g as g / (g + sag), since the skin sinks less into a narrow gap."""
    mount_Hz: float = Field(default=29.0, gt=0)
    """Resonance of the finger on its mount."""
    mount_damping: float = Field(default=0.15, gt=0, lt=1)
    """Damping ratio of that resonance."""
    high_pass_Hz: float = Field(default=1.0, gt=0)
    """High-pass corner of the piezoelectric film and its amplifier (the paper: <= 1 Hz)."""

    load_exponent: float = Field(default=0.2, ge=0)
    """Amplitude grows as (spatial period) ** this: fewer ridges share the load."""
    force_exponent: float = Field(default=0.5, ge=0)
    """Amplitude grows as force ** this (1/3 for a ball on a plane, 1/2 for a roller, 1 for a spring)."""
    flattening_exponent: float = Field(default=1 / 3, ge=0)
    """The contact widens, and both blurs with it, as force ** this (Hertz: 1/3)."""

    taxel_along_mm: tuple[float, ...] = Field(default=(0.0, 1.3, 2.7, 4.1, 0.6, 2.0, 3.4, 5.0), min_length=1)
    """Position of each taxel along the slide: its phase."""
    taxel_gains: tuple[float, ...] = Field(default=(1.0, 1.05, 0.85, -0.8, 0.33, 0.1, 0.1, 0.1), min_length=1)
    """Share of the signal on each taxel, negative for reversed polarity (public recordings)."""

    noise_mV_rms: float = Field(default=0.25, ge=0)
    """White noise of the electronics: the quietest channels of the public recordings change by 0.28 mV per sample."""
    jitter_speed: float = Field(default=0.003, ge=0, lt=0.3)
    """Standard deviation of a trial's speed over the set speed."""
    jitter_force: float = Field(default=0.07, ge=0, lt=0.3)
    """Standard deviation of a trial's force over the set force."""
    jitter_gain: float = Field(default=0.04, ge=0, lt=0.3)
    """Standard deviation of a taxel's gain over its mean, drawn for each trial and taxel."""

    @model_validator(mode="after")
    def _fits_together(self) -> GratingsSpec:
        if len(self.taxel_along_mm) != len(self.taxel_gains):
            raise ValueError(
                f"taxel_along_mm has {len(self.taxel_along_mm)} places but taxel_gains has "
                f"{len(self.taxel_gains)} gains; give one each per taxel"
            )
        for name in ("pitches_mm", "forces_N", "speeds_mm_per_s"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name} holds a value twice; name each condition once")
        if self.mount_Hz >= self.sampling_rate_Hz / 2:
            raise ValueError("mount_Hz must be below half of sampling_rate_Hz")
        if self.n_samples < 1:
            raise ValueError("duration_s is shorter than one sample")
        return self

    @property
    def n_samples(self) -> int:
        """Samples per trial."""
        return round(self.duration_s * self.sampling_rate_Hz)

    @property
    def n_trials(self) -> int:
        """Trials in all: gratings x forces x speeds x kinds of start x trials of each."""
        conditions = len(self.pitches_mm) * len(self.forces_N) * len(self.speeds_mm_per_s) * len(self.starts)
        return self.trials * conditions

    @property
    def starts(self) -> tuple[str, ...]:
        """The kinds of start that are simulated."""
        return (REPEATED, RANDOM) if self.start == "both" else (self.start,)


class Slide(NamedTuple):
    """The actual values of one trial: `gains` is `(taxel,)`, `start_mm` the position of the first taxel at its first
    sample, from the middle of the plate's first ridge.
    """

    pitch_mm: float
    force_N: float
    speed_mm_per_s: float
    start_mm: float
    gains: np.ndarray


def simulate(spec: GratingsSpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """Slides over every grating at every force and speed, in mV, float32 `(trial, time, taxel)`.

    conditions: label ("P4.0", the pitch), grating (1 is the first pitch), pitch_mm, force_N, speed_mm_per_s (as set),
        start ("repeated" or "random"), trial. Rows go trial by trial through all conditions, so fewer trials give a
        prefix of more.
    progress: called as (trials done, trials in all).

    >>> touch = simulate(GratingsSpec(trials=1, pitches_mm=(4.0, 0.5), forces_N=(12.0,)))
    >>> touch.signals.shape, touch.unit, touch.classes
    ((4, 2500, 8), 'mV', ('P0.5', 'P4.0'))
    """
    _check_room(spec, spec.n_trials)
    conditions = _conditions(spec)
    signals = np.empty((len(conditions), spec.n_samples, len(spec.taxel_gains)), np.float32)
    rows = conditions[["pitch_mm", "force_N", "speed_mm_per_s", START, "trial"]].itertuples(index=False, name=None)
    for i, (pitch_mm, force_N, speed_mm_per_s, start, trial) in enumerate(rows):
        rng = trial_generator(spec, pitch_mm, force_N, speed_mm_per_s, start, trial)
        slide = draw_slide(spec, pitch_mm, force_N, speed_mm_per_s, start, rng)
        signals[i] = record(spec, slide, rng)
        if progress is not None and (i % 48 == 47 or i + 1 == len(conditions)):
            progress(i + 1, len(conditions))
    return Recordings(signals, spec.sampling_rate_Hz, "mV", conditions, source=f"simulated gratings {spec.digest()}")


def _conditions(spec: GratingsSpec) -> pd.DataFrame:
    rows = [
        (_label(pitch), grating, pitch, force, speed, start, trial)
        for trial in range(spec.trials)
        for grating, pitch in enumerate(spec.pitches_mm, start=1)
        for force in spec.forces_N
        for speed in spec.speeds_mm_per_s
        for start in spec.starts
    ]
    return pd.DataFrame(rows, columns=["label", *CONDITIONS])


def _label(pitch_mm: float) -> str:
    return f"P{pitch_mm:g}" if f"{pitch_mm:g}" != f"{pitch_mm:.0f}" else f"P{pitch_mm:.1f}"


def trial_generator(
    spec: GratingsSpec, pitch_mm: float, force_N: float, speed_mm_per_s: float, start: str, trial: int
) -> np.random.Generator:
    """The random numbers of one trial, independent of all others: keyed by its conditions, to 0.001 of a unit."""
    start_key = 1 + round(spec.start_mm * 1e3) if start == REPEATED else 0
    key = (round(pitch_mm * 1e3), round(force_N * 1e3), round(speed_mm_per_s * 1e3), trial, start_key)
    return np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=key))


def draw_slide(
    spec: GratingsSpec, pitch_mm: float, force_N: float, speed_mm_per_s: float, start: str, rng: np.random.Generator
) -> Slide:
    """The variation between trials: start, speed, force and gains (normal, within 3 deviations; a random start is
    uniform over the plate).
    """
    anywhere_mm = PLATE_mm * rng.random()
    late, speed, force, *gains = np.clip(rng.standard_normal(3 + len(spec.taxel_gains)), -3.0, 3.0)
    real_mm_per_s = spec.speed_factor * speed_mm_per_s * (1.0 + spec.jitter_speed * speed)
    repeated_mm = spec.start_mm - real_mm_per_s * 1e-3 * spec.start_jitter_ms * late
    return Slide(
        pitch_mm,
        force_N * (1.0 + spec.jitter_force * force),
        real_mm_per_s,
        repeated_mm if start == REPEATED else anywhere_mm,
        np.array(spec.taxel_gains) * (1.0 + spec.jitter_gain * np.array(gains)),
    )


def _check_room(spec: GratingsSpec, n_trials: int) -> None:
    """InputError if all slides, or one with its settling time, take more memory than one input may."""
    check_room(n_trials, spec.n_samples, len(spec.taxel_gains))
    check_room(1, _settling_samples(spec), len(spec.taxel_gains))


def record(spec: GratingsSpec, slide: Slide, rng: np.random.Generator) -> np.ndarray:
    """The recorded signal of one slide, `(time, taxel)` float32 in mV: ridges, friction and noise."""
    rate_Hz, n_taxels = spec.sampling_rate_Hz, len(spec.taxel_gains)
    n_settle = _settling_samples(spec)
    period_mm = slide.pitch_mm + spec.ridge_width_mm
    time_s = np.arange(-n_settle, spec.n_samples) / rate_Hz
    place_mm = (slide.start_mm + slide.speed_mm_per_s * time_s)[:, None]
    along = (place_mm + np.array(spec.taxel_along_mm)) / period_mm
    signal = look_up(ridge_signal(spec, slide), along[n_settle:])
    if spec.slip_mV_rms > 0:
        rubbing = look_up(contact(spec, slide), along)
        fresh, of_plate = rng.standard_normal((len(time_s), 1)), plate_friction(spec, slide, place_mm)
        repeats = spec.friction_repeats
        drive = rubbing * (np.sqrt(repeats) * of_plate + np.sqrt(1.0 - repeats) * fresh)
        scale = spec.slip_mV_rms * loading(spec, slide) * sagging(spec, slide.pitch_mm)
        signal += scale * mount_noise(spec, drive)[n_settle:]
    noise = rng.standard_normal((spec.n_samples, n_taxels), np.float32)
    return (signal * slide.gains).astype(np.float32) + np.float32(spec.noise_mV_rms) * noise


def ridge_signal(spec: GratingsSpec, slide: Slide) -> np.ndarray:
    """One spatial period of the noiseless signal, `(TABLE_POINTS,)` in mV, at gain 1 and in steady state.

    The slide is periodic, so each harmonic of the ridges' profile goes through the skin's blur and then, at its
    frequency n v / period, through the piezoelectric high-pass (press) or the mount's resonance (catch). A
    harmonic above half of the sampling rate is dropped.

    >>> slide = Slide(4.0, 12.0, 8.6, 0.0, np.ones(8))
    >>> bool(8 < np.abs(ridge_signal(GratingsSpec(), slide)).max() < 16)
    True
    """
    ridges, wavenumber = ridge_harmonics(spec, slide.pitch_mm)
    frequency_Hz = slide.speed_mm_per_s * wavenumber
    press = spec.press_mV * blur(wavenumber, footprint_mm(spec, slide))
    catch = spec.catch_mV * sagging(spec, slide.pitch_mm) * blur(wavenumber, spec.edge_mm * flattening(spec, slide))
    harmonics = ridges * (
        press * _high_pass(frequency_Hz, spec.high_pass_Hz)
        + catch * _mount(frequency_Hz, spec.mount_Hz, spec.mount_damping)
    )
    harmonics[frequency_Hz >= spec.sampling_rate_Hz / 2] = 0.0
    return np.fft.irfft(harmonics, TABLE_POINTS) * TABLE_POINTS * loading(spec, slide)


def contact(spec: GratingsSpec, slide: Slide) -> np.ndarray:
    """Coverage of a taxel by a ridge over one spatial period, `(TABLE_POINTS,)`: 1 fully, 0 not at all."""
    ridges, wavenumber = ridge_harmonics(spec, slide.pitch_mm)
    return np.fft.irfft(ridges * blur(wavenumber, footprint_mm(spec, slide)), TABLE_POINTS) * TABLE_POINTS


def loading(spec: GratingsSpec, slide: Slide) -> float:
    """Amplitude relative to that of grating 1 at 12 N: force and the load that each ridge carries."""
    reference_mm = REFERENCE_PITCH_MM + spec.ridge_width_mm
    share = ((slide.pitch_mm + spec.ridge_width_mm) / reference_mm) ** spec.load_exponent
    return share * (slide.force_N / REFERENCE_FORCE_N) ** spec.force_exponent


def sagging(spec: GratingsSpec, pitch_mm: float) -> float:
    """Depth of the skin in a gap, relative to grating 1."""
    return pitch_mm / (pitch_mm + spec.sag_mm) * (REFERENCE_PITCH_MM + spec.sag_mm) / REFERENCE_PITCH_MM


def footprint_mm(spec: GratingsSpec, slide: Slide) -> float:
    """Blur of a ridge's footprint: the skin's thickness and its bending into the gap, wider under load."""
    return (spec.skin_mm + spec.drape * slide.pitch_mm) * flattening(spec, slide)


def flattening(spec: GratingsSpec, slide: Slide) -> float:
    """Width of the contact relative to that at 12 N."""
    return (slide.force_N / REFERENCE_FORCE_N) ** spec.flattening_exponent


def ridge_harmonics(spec: GratingsSpec, pitch_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Fourier coefficients of a rectangular ridge and their wavenumbers in cycles per mm."""
    period_mm = pitch_mm + spec.ridge_width_mm
    wavenumber = np.arange(TABLE_POINTS // 2 + 1) / period_mm
    coefficients = np.sinc(wavenumber * spec.ridge_width_mm) * spec.ridge_width_mm / period_mm
    return coefficients.astype(np.complex128), wavenumber


def blur(wavenumber: np.ndarray, deviation_mm: float) -> np.ndarray:
    """A Gaussian blur at wavenumbers in cycles per mm."""
    return np.exp(-0.5 * (2.0 * np.pi * wavenumber * deviation_mm) ** 2)


def _high_pass(frequency_Hz: np.ndarray, corner_Hz: float) -> np.ndarray:
    """First order: a step decays with time constant 1 / (2 pi corner)."""
    return 1j * frequency_Hz / (1j * frequency_Hz + corner_Hz)


def _mount(frequency_Hz: np.ndarray, resonance_Hz: float, damping: float) -> np.ndarray:
    """Second order: a unit step rings as exp(-damping w t) sin(w t), w = 2 pi resonance, to first order in damping."""
    ratio = frequency_Hz / resonance_Hz
    return 1j * ratio / (1.0 - ratio**2 + 2j * damping * ratio)


def mount_noise(spec: GratingsSpec, drive: np.ndarray) -> np.ndarray:
    """White `(time, taxel)` noise through the mount's resonance as a digital band-pass, scaled to keep its power."""
    from scipy.signal import lfilter

    angle = 2.0 * np.pi * spec.mount_Hz / spec.sampling_rate_Hz
    width = np.sin(angle) * spec.mount_damping
    b = np.array([width, 0.0, -width]) / (1.0 + width)
    a = np.array([1.0, -2.0 * np.cos(angle) / (1.0 + width), (1.0 - width) / (1.0 + width)])
    # The output power of this filter for white input is b0 = width / (1 + width), in closed form.
    return lfilter(b / np.sqrt(b[0]), a, drive, axis=0)


def plate_friction(spec: GratingsSpec, slide: Slide, place_mm: np.ndarray) -> np.ndarray:
    """The plate's own stick-slip noise at positions of the finger; below 100 Hz equal to white noise of deviation 1.

    It is a function of the position only, so slides with the same start have the same noise.
    """
    plate = np.random.SeedSequence(spec.seed, spawn_key=(round(slide.pitch_mm * 1e3),))
    roughness = np.random.default_rng(plate).standard_normal(round(PLATE_mm / GRAIN_mm))
    # v / GRAIN_mm points pass per second: their power spreads over as many Hz, that of white noise over the rate.
    strength = np.sqrt(slide.speed_mm_per_s / (GRAIN_mm * spec.sampling_rate_Hz))
    return strength * look_up(roughness, place_mm / PLATE_mm)


def _settling_samples(spec: GratingsSpec) -> int:
    """Settling time, until the mount's ringing has fallen to exp(-6)."""
    return int(np.ceil(6.0 / (2.0 * np.pi * spec.mount_Hz * spec.mount_damping) * spec.sampling_rate_Hz))


def look_up(table: np.ndarray, along: np.ndarray) -> np.ndarray:
    """A periodic table at positions in periods, by linear interpolation."""
    position = (along - np.floor(along)) * len(table)
    before = position.astype(np.int64)
    weight = position - before
    closed = np.append(table, table[:2])
    return closed[before] + weight * (closed[before + 1] - closed[before])


def controls(spec: GratingsSpec) -> tuple[Control, ...]:
    """The controls of a slide: the grating, and force and speed within and around those of the paper."""
    names = tuple(_label(pitch) for pitch in spec.pitches_mm)
    return (
        Control("grating", "Grating", names[0], names),
        Control("force_N", "Force", spec.forces_N[-1], low=1.0, high=24.0, step=0.5),
        Control("speed_mm_per_s", "Speed", spec.speeds_mm_per_s[0], low=2.0, high=40.0, step=0.1),
    )


def slide_by_hand(spec: GratingsSpec, values: Mapping[str, Any], number: int) -> Recordings:
    """One slide with the controls' values, on the plates of `spec.seed`; its number is not a trial of `simulate`.

    >>> slide = slide_by_hand(GratingsSpec(), {"grating": "P2.5", "force_N": 5.0, "speed_mm_per_s": 10.0}, 0)
    >>> slide.signals.shape, slide.conditions["label"].tolist()
    ((1, 2500, 8), ['P2.5'])
    """
    pitch_mm = {_label(pitch): pitch for pitch in spec.pitches_mm}[values["grating"]]
    start = RANDOM if spec.start == "both" else spec.start
    _check_room(spec, 1)
    slide = (pitch_mm, values["force_N"], values["speed_mm_per_s"], start)
    rng = trial_generator(spec, *slide, FIRST_BY_HAND + number)
    signal = record(spec, draw_slide(spec, *slide, rng), rng)
    conditions = pd.DataFrame([(values["grating"], *slide, number)], columns=["label", *CONDITIONS[1:]])
    return Recordings(signal[None], spec.sampling_rate_Hz, "mV", conditions, source="a finger moved by hand")


SIMULATOR = Simulator(
    "A PVDF finger sliding over eight gratings (texture paper).",
    GratingsSpec,
    simulate,
    Finger(controls, slide_by_hand),
)
