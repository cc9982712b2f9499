"""Long recordings of a finger that rests, touches a grating, holds still and slips, with the onset of each known.

The finger, the plates and all signals are those of `simulator`; what a slide there has in steady state, a finger here
has while it slips. Force and speed change in time: pressing and lifting take `press_ms`, and a slip gains and loses its
speed in `ramp_ms`. Both times are assumptions, as are the durations; no accuracy was used to set any.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from neurotact_parts.studies.memory import check_room
from neurotact_parts.studies.texture import simulator
from neurotact_parts.studies.texture.simulator import GratingsSpec, PLATE_mm, Slide
from pydantic import Field

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import Recordings
from neurotact.spec import Spec


class SlipsSpec(Spec):
    """Long recordings with contacts and slips.

    >>> SlipsSpec(recordings=3).n_trials
    3
    """

    recordings: int = Field(default=12, ge=1)
    """Recordings, each of one grating after another."""
    duration_s: float = Field(default=30.0, gt=0)
    """Duration of each."""
    seed: int = Field(default=0, ge=0)
    """Random seed; a recording depends on it and on its number alone."""
    sampling_rate_Hz: float = Field(default=2000.0, gt=60)
    """Sampling rate of the sensor's electronics."""
    rest_s: tuple[float, float] = (0.8, 2.0)
    """Shortest and longest time in the air before a contact; between them it is uniform, as all times are."""
    hold_s: tuple[float, float] = (0.5, 1.5)
    """Of holding still, before a slip and after it."""
    slip_s: tuple[float, float] = (0.5, 1.5)
    """Of a slip."""
    slips: float = Field(default=0.7, ge=0, le=1)
    """Share of the contacts with a slip: a contact alone does not announce one."""
    forces_N: tuple[float, float] = (3.0, 12.0)
    """Least and largest force of a contact."""
    speeds_mm_per_s: tuple[float, float] = (8.6, 13.7)
    """Least and largest speed of a slip."""
    press_ms: float = Field(default=50.0, gt=0)
    """Time in which the force rises at a contact, and falls at its end."""
    ramp_ms: float = Field(default=50.0, gt=0)
    """Time in which a slip gains its speed, and loses it."""

    @property
    def n_trials(self) -> int:
        """Recordings in all."""
        return self.recordings

    @property
    def finger(self) -> GratingsSpec:
        """The finger and the plates."""
        return GratingsSpec(seed=self.seed, sampling_rate_Hz=self.sampling_rate_Hz)


class Touch(NamedTuple):
    """A contact: when it begins and ends, when its slip does (the same time twice without one), and the slide."""

    begin_s: float
    slip_s: float
    still_s: float
    end_s: float
    slide: Slide

    @property
    def marked(self) -> Iterator[tuple[float, float, str]]:
        """Begin, end and label of each stretch."""
        if self.still_s == self.slip_s:
            yield self.begin_s, self.end_s, "contact"
            return
        yield self.begin_s, self.slip_s, "contact"
        yield self.slip_s, self.still_s, "slip"
        yield self.still_s, self.end_s, "contact"


def simulate(spec: SlipsSpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """Recordings in mV, whose marks are `contact` and `slip`; unmarked time is rest.

    >>> felt = simulate(SlipsSpec(recordings=1, duration_s=8))
    >>> felt.signals.shape, sorted(felt.marks["label"].unique())
    ((1, 16000, 8), ['contact', 'slip'])
    """
    n_samples, n_taxels = round(spec.duration_s * spec.sampling_rate_Hz), len(spec.finger.taxel_gains)
    check_room(spec.recordings, n_samples, n_taxels)
    signals, rows = np.empty((spec.recordings, n_samples, n_taxels), np.float32), []
    for number in range(spec.recordings):
        rng = np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=(number,)))
        touches = [*touches_of(spec, rng)]
        signals[number] = record(spec, touches, n_samples, rng)
        rows += [(number, *mark) for touch in touches for mark in touch.marked]
        if progress is not None:
            progress(number + 1, spec.recordings)
    marks = dict(zip(("trial", "start_s", "stop_s", "label"), zip(*rows, strict=True), strict=True)) if rows else None
    conditions = {"label": ["session"] * spec.recordings, "session": np.arange(spec.recordings)}
    source = f"simulated slips {spec.digest()}"
    return Recordings(signals, spec.sampling_rate_Hz, "mV", conditions, source=source, marks=marks)


def touches_of(spec: SlipsSpec, rng: np.random.Generator) -> Iterator[Touch]:
    """The contacts of one recording, as many as end within it."""
    finger, end_s = spec.finger, 0.0
    while True:
        begin_s = end_s + rng.uniform(*spec.rest_s)
        slip_s = begin_s + rng.uniform(*spec.hold_s)
        still_s = slip_s + (rng.uniform(*spec.slip_s) if rng.random() < spec.slips else 0.0)
        end_s = still_s + (rng.uniform(*spec.hold_s) if still_s > slip_s else 0.0)
        pitch_mm, at = rng.choice(finger.pitches_mm), (rng.uniform(*spec.forces_N), rng.uniform(*spec.speeds_mm_per_s))
        slide = simulator.draw_slide(finger, float(pitch_mm), *at, simulator.RANDOM, rng)
        if end_s > spec.duration_s:
            return
        yield Touch(begin_s, slip_s, still_s, end_s, slide)


def ramp(time_s: np.ndarray, begin_s: float, end_s: float, rise_s: float) -> np.ndarray:
    """0 outside of a stretch and 1 within, by straight lines that begin with it and end with it.

    >>> ramp(np.array([0.0, 1.0, 2.0, 3.0, 4.0]), 0.0, 4.0, 2.0).tolist()
    [0.0, 0.5, 1.0, 0.5, 0.0]
    """
    return np.clip(np.minimum(time_s - begin_s, end_s - time_s) / min(rise_s, (end_s - begin_s) / 2 or 1), 0.0, 1.0)


def record(spec: SlipsSpec, touches: list[Touch], n_samples: int, rng: np.random.Generator) -> np.ndarray:
    """The recorded signal, `(time, taxel)` float32 in mV."""
    from scipy.signal import bilinear, lfilter

    finger, rate_Hz = spec.finger, spec.sampling_rate_Hz
    n_taxels = len(finger.taxel_gains)
    pressed, caught, rubbed = (np.zeros((n_samples, n_taxels)) for _ in range(3))
    for touch in touches:
        slide, here = touch.slide, slice(round(touch.begin_s * rate_Hz), round(touch.end_s * rate_Hz) + 1)
        time_s = np.arange(n_samples)[here] / rate_Hz
        force = ramp(time_s, touch.begin_s, touch.end_s, 1e-3 * spec.press_ms)[:, None]
        speed = ramp(time_s, touch.slip_s, touch.still_s, 1e-3 * spec.ramp_ms)[:, None]
        place_mm = slide.start_mm + slide.speed_mm_per_s * np.cumsum(speed, axis=0) / rate_Hz
        along = (place_mm % PLATE_mm + np.array(finger.taxel_along_mm)) / (slide.pitch_mm + finger.ridge_width_mm)
        scale = force * simulator.loading(finger, slide) * slide.gains
        sag = simulator.sagging(finger, slide.pitch_mm)
        covered = simulator.look_up(simulator.contact(finger, slide), along)
        pressed[here] += scale * finger.press_mV * covered
        caught[here] += scale * finger.catch_mV * sag * simulator.look_up(edges(finger, slide), along)
        repeats, fresh = finger.friction_repeats, rng.standard_normal((len(time_s), 1))
        drive = np.sqrt(repeats) * simulator.plate_friction(finger, slide, place_mm) + np.sqrt(1 - repeats) * fresh
        rubbed[here] += scale * finger.slip_mV_rms * sag * np.sqrt(speed) * covered * drive
    angular = 2 * np.pi * finger.mount_Hz
    mount = bilinear([1 / angular, 0], [1 / angular**2, 2 * finger.mount_damping / angular, 1], rate_Hz)
    corner = 1 / (2 * np.pi * finger.high_pass_Hz)
    signal = lfilter(*bilinear([corner, 0], [corner, 1], rate_Hz), pressed, axis=0) + lfilter(*mount, caught, axis=0)
    signal += simulator.mount_noise(finger, rubbed)
    noise = rng.standard_normal((n_samples, n_taxels))
    return (signal + finger.noise_mV_rms * noise).astype(np.float32)


def edges(finger: GratingsSpec, slide: Slide) -> np.ndarray:
    """What the skin's surface catches on over one spatial period: a ridge with rounded edges."""
    ridges, wavenumber = simulator.ridge_harmonics(finger, slide.pitch_mm)
    rounded = simulator.blur(wavenumber, finger.edge_mm * simulator.flattening(finger, slide))
    return np.fft.irfft(ridges * rounded, simulator.TABLE_POINTS) * simulator.TABLE_POINTS


SIMULATOR = Simulator("A PVDF finger that touches gratings and slips, in long recordings.", SlipsSpec, simulate)
