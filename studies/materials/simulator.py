"""One piezoelectric element under probes of four materials: the experiment of the materials paper, simulated.

A shaker presses a probe of 1 mm on one element of a P(VDF-TrFE) film (its Sec. II-B) with a static load and a sinusoid
on top. The probe transmits the force according to its mechanical impedance, and touches the film over a circle that
grows and shrinks with the force according to its elasticity and its losses; the force on the electrode becomes charge.
Equations, sources and mismatches: docs/contact-materials-simulator.md.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple

import numpy as np
from neurotact_parts.studies.materials.lock_in import lock_in, phase_between
from neurotact_parts.studies.memory import check_room
from pydantic import Field, model_validator

from neurotact.data.dataset import Simulator
from neurotact.data.recordings import LABEL, Recordings
from neurotact.lazily import lazily
from neurotact.spec import Spec

with lazily():
    import pandas as pd


Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, lt=0.3)]

CHANNELS = ("force", "output")
PATTERN = ("frequency_Hz", "force_N", "phase_deg", "amplitude_mV")
"""The four measures of a pattern, in the paper's order."""
CYCLE_POINTS = 64
HARMONICS = 8
RADII = 1024
EPSILON_0 = 8.854e-12
"""Permittivity of vacuum, F/m."""


class ProbeSpec(Spec):
    """A rod of one material, shaker at one end, film at the other."""

    density_kg_per_m3: float = Field(gt=0)
    """Density of the rod."""
    modulus_GPa: float = Field(gt=0)
    """Young's modulus along the rod, at 1 Hz."""
    contact_modulus_GPa: float = Field(gt=0)
    """Contact modulus of the rod's end: E / (1 - ν²), or its equivalent for a transversely isotropic solid; at 1 Hz."""
    loss_factor: float = Field(ge=0, lt=1)
    """Tangent of the loss angle of both moduli, which does not depend on frequency."""
    spread: Share = 0.0
    """Standard deviation of both moduli between spots and rods, over their mean."""


PROBES = {
    "brass": ProbeSpec(density_kg_per_m3=8500, modulus_GPa=95, contact_modulus_GPa=107, loss_factor=0.001, spread=0.01),
    "wood": ProbeSpec(density_kg_per_m3=500, modulus_GPa=11, contact_modulus_GPa=4.6, loss_factor=0.02, spread=0.1),
    "plastic": ProbeSpec(
        density_kg_per_m3=1200, modulus_GPa=2.35, contact_modulus_GPa=2.7, loss_factor=0.01, spread=0.03
    ),
    "lead": ProbeSpec(density_kg_per_m3=2100, modulus_GPa=12, contact_modulus_GPa=12.5, loss_factor=0.01, spread=0.1),
}
"""Brass, wood along its grain, polycarbonate, pencil lead; densities of Sec. II-B."""


class FilmSpec(Spec):
    """A P(VDF-TrFE) film glued on glass, and the electrode under it."""

    thickness_um: float = Field(default=100.0, gt=0)
    """Thickness of the film."""
    electrode_um: float = Field(default=500.0, gt=0)
    """Diameter of one microelectrode."""
    d33_pC_per_N: float = Field(default=38.0, gt=0)
    """d33 of the free film at 1 Hz, positive for pressure."""
    d31_pC_per_N: float = Field(default=11.0, ge=0)
    """d31 of the free film at 1 Hz; its charge is opposite to that of d33."""
    piezoelectric_loss: float = Field(default=0.03, ge=0, lt=1)
    """Tangent of the loss angle of d33 and d31."""
    modulus_GPa: float = Field(default=3.0, gt=0)
    """Young's modulus at 1 Hz."""
    poisson: float = Field(default=0.4, ge=0, lt=0.5)
    """Poisson's ratio."""
    mechanical_loss: float = Field(default=0.075, ge=0, lt=1)
    """Tangent of the loss angle of the modulus."""
    permittivity: float = Field(default=8.0, gt=0)
    """Relative permittivity at 1 Hz."""
    dielectric_loss: float = Field(default=0.02, ge=0, lt=1)
    """Tangent of the loss angle of the permittivity."""
    substrate_GPa: float = Field(default=75.0, gt=0)
    """E / (1 - ν²) of the glass below."""


class AmplifierSpec(Spec):
    """The charge amplifier, and its recorded output."""

    feedback_pF: float = Field(default=100.0, gt=0)
    """Feedback capacitor, which sets the gain."""
    feedback_GOhm: float = Field(default=1.0, gt=0)
    """Feedback resistor, which sets the lower corner."""
    cable_pF: float = Field(default=100.0, ge=0)
    """Capacitance of the cable at the input."""
    gain_bandwidth_MHz: float = Field(default=1.0, gt=0)
    """Gain-bandwidth product of the operational amplifier."""
    low_pass_Hz: float = Field(default=500.0, gt=0)
    """Corner of the filter before the converter."""
    noise_mV_rms: float = Field(default=1.0, ge=0)
    """White noise of amplifier and converter."""
    drift_mV_rms: float = Field(default=2.0, ge=0)
    """Pyroelectric drift, below the amplifier's lower corner."""
    hum_mV: float = Field(default=2.0, ge=0)
    """Amplitude of the mains interference in the output."""
    mains_Hz: float = Field(default=50.0, gt=0)
    """Frequency of the mains."""
    jitter_mains: Share = 0.001
    """Standard deviation of the mains' frequency over its nominal value."""


class ContactMaterialsSpec(Spec):
    """The probes, the protocol and the physics of one simulated experiment.

    >>> ContactMaterialsSpec().n_trials
    600
    """

    trials: int = Field(default=15, ge=1)
    """Patterns of each material, force and frequency: 600 in all (Sec. IV-A)."""
    seed: int = Field(default=0, ge=0)
    """Random seed: the same one gives the same bytes; a trial's numbers depend only on its own conditions."""
    frequencies_Hz: tuple[Positive, ...] = Field(default=(5.0, 15.0, 30.0, 45.0, 70.0), min_length=1)
    """Frequencies of the shaker (Sec. II-B)."""
    forces_N: tuple[Positive, ...] = Field(default=(0.2, 0.4), min_length=1)
    """Amplitudes of the dynamic force (Sec. II-B)."""
    duration_s: float = Field(default=2.0, gt=0)
    """Length of a recording."""
    sampling_rate_Hz: float = Field(default=2000.0, gt=0)
    """Sampling rate of force sensor and amplifier."""

    probes: dict[str, ProbeSpec] = Field(default=PROBES, min_length=1)
    """The rod of each material."""
    film: FilmSpec = FilmSpec()
    amplifier: AmplifierSpec = AmplifierSpec()

    probe_diameter_mm: float = Field(default=1.0, gt=0)
    """Diameter of the probe (Sec. II-B)."""
    probe_length_mm: float = Field(default=20.0, gt=0)
    """Length of the rod."""
    crown_mm: float = Field(default=100.0, gt=0)
    """Radius of curvature of the probe's end: a cut that is flat to 1.25 µm over 1 mm."""
    preload_N: float = Field(default=1.0, gt=0)
    """Static force that keeps probe and film together."""
    hold_s: float = Field(default=10.0, gt=0)
    """Creep time under the static force before a recording."""
    holder_g: float = Field(default=20.0, ge=0)
    """Moving mass between the force sensor's crystal and the probe."""
    force_V_per_N: float = Field(default=1.0, gt=0)
    """Sensitivity of the force sensor with its conditioner."""
    force_noise_mN_rms: float = Field(default=2.0, ge=0)
    """White noise of the force sensor."""

    landing: Literal["repeated", "random"] = "random"
    """Repeated: each probe is placed once for all of its trials, as in a jig. Random: it is placed again for every
    trial, as by hand. A placement fixes the preload, the crown, the position and the moduli."""
    jitter_force: Share = 0.02
    """Standard deviation of a trial's dynamic force over the set force; the sensor measures it."""
    jitter_preload: Share = 0.1
    """Standard deviation of the static force over its mean; the piezoelectric sensor does not measure it."""
    jitter_crown: Share = 0.2
    """Standard deviation of the crown over its mean: the probe's tilt varies."""
    jitter_place_um: float = Field(default=50.0, ge=0)
    """Standard deviation of the probe's position over the electrode, along each axis."""
    jitter_gain: Share = 0.01
    """Standard deviation of the film's piezoelectric constant over its mean, as from one or two kelvins."""

    @model_validator(mode="after")
    def _fits_together(self) -> ContactMaterialsSpec:
        for name in ("frequencies_Hz", "forces_N"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name} holds a value twice; name each condition once")
        if HARMONICS * max(self.frequencies_Hz) >= self.sampling_rate_Hz / 2:
            raise ValueError(f"frequencies_Hz must be below 1/{2 * HARMONICS} of sampling_rate_Hz")
        if self.duration_s * min(self.frequencies_Hz) < 1:
            raise ValueError("duration_s is shorter than one period of the lowest of frequencies_Hz")
        if max(self.forces_N) * (1 + 3 * self.jitter_force) >= self.preload_N * (1 - 3 * self.jitter_preload):
            raise ValueError("preload_N must exceed forces_N by enough that probe and film never separate")
        return self

    @property
    def n_samples(self) -> int:
        """Samples per trial."""
        return round(self.duration_s * self.sampling_rate_Hz)

    @property
    def n_trials(self) -> int:
        """Trials in all: materials x forces x frequencies x trials of each."""
        return self.trials * len(self.probes) * len(self.forces_N) * len(self.frequencies_Hz)


class Touch(NamedTuple):
    """The actual values of one trial; `probe` has this trial's moduli, `phase` is in radian."""

    probe: ProbeSpec
    frequency_Hz: float
    force_N: float
    preload_N: float
    crown_m: float
    off_centre_m: float
    gain: float
    phase: float


def simulate(spec: ContactMaterialsSpec, progress: Callable[[int, int], None] | None = None) -> Recordings:
    """Every probe at every force and frequency: the force sensor and the output, in V, `(trial, time, 2)` float32.

    conditions: label (the material), set_force_N, frequency_Hz, trial. Rows go trial by trial through all conditions,
        so fewer trials give a prefix of more.
    progress: called as (trials done, trials in all).

    >>> touch = simulate(ContactMaterialsSpec(trials=1, frequencies_Hz=(30.0,)))
    >>> touch.signals.shape, touch.channels, touch.classes
    ((8, 4000, 2), ('force', 'output'), ('brass', 'lead', 'plastic', 'wood'))
    """
    check_room(spec.n_trials, spec.n_samples, len(CHANNELS))
    conditions = _conditions(spec)
    signals = np.empty((len(conditions), spec.n_samples, len(CHANNELS)), np.float32)
    rows = zip(conditions.label, conditions.set_force_N, conditions.frequency_Hz, conditions.trial, strict=True)
    for i, (material, force_N, frequency_Hz, trial) in enumerate(rows):
        rng = trial_generator(spec.seed, material, force_N, frequency_Hz, trial)
        signals[i] = record(spec, draw_touch(spec, material, force_N, frequency_Hz, rng), rng)
        if progress is not None and (i % 40 == 39 or i + 1 == len(conditions)):
            progress(i + 1, len(conditions))
    source = f"simulated contact materials {spec.digest()}"
    return Recordings(signals, spec.sampling_rate_Hz, "V", conditions, channels=CHANNELS, source=source)


def _conditions(spec: ContactMaterialsSpec) -> pd.DataFrame:
    rows = [
        (material, force_N, frequency_Hz, trial)
        for trial in range(spec.trials)
        for material in spec.probes
        for force_N in spec.forces_N
        for frequency_Hz in spec.frequencies_Hz
    ]
    return pd.DataFrame(rows, columns=[LABEL, "set_force_N", "frequency_Hz", "trial"])


def patterns(recordings: Recordings, force_V_per_N: float = 1.0) -> pd.DataFrame:
    """One row per trial: label and the paper's four measures, by lock-in at the shaker's frequency (Sec. II-B).

    frequency_Hz: as set; force_N: amplitude measured by the force sensor; phase_deg: lead of the output over the
    force; amplitude_mV: of the output.

    >>> table = patterns(simulate(ContactMaterialsSpec(trials=1, frequencies_Hz=(30.0,))))
    >>> list(table.columns), bool(abs(table.force_N[0] - 0.2) < 0.03)
    (['label', 'frequency_Hz', 'force_N', 'phase_deg', 'amplitude_mV'], True)
    """
    signals = np.asarray(recordings.signals)
    frequencies = recordings.conditions["frequency_Hz"].to_numpy(float)
    phasors = np.empty((len(recordings), len(CHANNELS)), np.complex128)
    for frequency_Hz in np.unique(frequencies):
        mine = frequencies == frequency_Hz
        waveforms = np.moveaxis(signals[mine], 1, 2)
        phasors[mine] = lock_in(waveforms, frequency_Hz, recordings.sampling_rate_Hz, window="hann")
    force, output = phasors.T
    columns = (frequencies, np.abs(force) / force_V_per_N, phase_between(output, force), 1e3 * np.abs(output))
    table = pd.DataFrame(dict(zip(PATTERN, columns, strict=True)))
    table.insert(0, LABEL, recordings.conditions[LABEL].to_numpy())
    return table


def trial_generator(seed: int, material: str, force_N: float, frequency_Hz: float, trial: int) -> np.random.Generator:
    """The random numbers of one trial, independent of all others: keyed by its conditions, to 0.001 of a unit."""
    key = (zlib.crc32(material.encode()), round(force_N * 1e3), round(frequency_Hz * 1e3), trial)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw_touch(
    spec: ContactMaterialsSpec, material: str, force_N: float, frequency_Hz: float, rng: np.random.Generator
) -> Touch:
    """The variation between trials: phase (uniform), the others normal, within 3 deviations.

    A repeated placement is drawn from the spec's seed and the material, not from `rng`.
    """
    phase = rng.uniform(0.0, 2.0 * np.pi)
    drawn = _deviates(rng)
    moduli, _, preload, crown, along, across, _ = drawn if spec.landing == "random" else _landing(spec.seed, material)
    _, force, *_, gain = drawn
    probe = spec.probes[material]
    stiffer = 1.0 + probe.spread * moduli
    this_probe = probe.model_copy(
        update={
            "modulus_GPa": probe.modulus_GPa * stiffer,
            "contact_modulus_GPa": probe.contact_modulus_GPa * stiffer,
        }
    )
    return Touch(
        this_probe,
        frequency_Hz,
        force_N * (1.0 + spec.jitter_force * force),
        spec.preload_N * (1.0 + spec.jitter_preload * preload),
        spec.crown_mm * 1e-3 * (1.0 + spec.jitter_crown * crown),
        spec.jitter_place_um * 1e-6 * np.hypot(along, across),
        1.0 + spec.jitter_gain * gain,
        phase,
    )


def _deviates(rng: np.random.Generator) -> np.ndarray:
    """Deviates of moduli, force, preload, crown, position (along, across) and gain, in deviations."""
    return np.clip(rng.standard_normal(7), -3.0, 3.0)


def _landing(seed: int, material: str) -> np.ndarray:
    """The deviates of a probe's single placement; its key is shorter than any key of a trial."""
    return _deviates(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(material.encode()),))))


def record(spec: ContactMaterialsSpec, touch: Touch, rng: np.random.Generator) -> np.ndarray:
    """The recorded waveforms of one trial, `(time, channel)` float32 in V: force sensor and output."""
    angle = 2.0 * np.pi * touch.frequency_Hz * np.arange(spec.n_samples) / spec.sampling_rate_Hz + touch.phase
    force_N = touch.force_N * np.cos(angle) + 1e-3 * spec.force_noise_mN_rms * rng.standard_normal(spec.n_samples)
    output_mV = np.polyval([*output_harmonics(spec, touch)[::-1], 0.0], np.exp(1j * angle)).real
    output_mV += _electrical_noise(spec, rng)
    return np.stack([spec.force_V_per_N * force_N, 1e-3 * output_mV], axis=1).astype(np.float32)


def output_harmonics(spec: ContactMaterialsSpec, touch: Touch) -> np.ndarray:
    """Noiseless output in mV as phasors of the fundamental and its harmonics, `(HARMONICS,)`; the force has phase 0.

    >>> spec = ContactMaterialsSpec()
    >>> touch = Touch(spec.probes["brass"], 30.0, 0.2, 1.0, 0.1, 0.0, 1.0, 0.0)
    >>> bool(20 < abs(output_harmonics(spec, touch)[0]) < 60)
    True
    """
    on_electrode_N = np.fft.rfft(electrode_force_N(spec, touch))[1 : HARMONICS + 1] * 2.0 / CYCLE_POINTS
    frequency_Hz = touch.frequency_Hz * np.arange(1, HARMONICS + 1)
    charge_pC = touch.gain * charge_constant(spec.film, frequency_Hz) * on_electrode_N
    return charge_pC * amplifier_gain(spec, frequency_Hz)


def electrode_force_N(spec: ContactMaterialsSpec, touch: Touch) -> np.ndarray:  # noqa: N802
    """Force that falls on the electrode over one period, `(CYCLE_POINTS,)`; the measured force is a cosine."""
    carrier = np.exp(2j * np.pi * np.arange(CYCLE_POINTS) / CYCLE_POINTS)
    static_m, static_Pa = static_contact(spec, touch)
    softness = 1.0 / contact_modulus_Pa(spec.film, touch.probe, touch.frequency_Hz, static_m)
    dynamic_N = touch.force_N * force_passed_on(spec, touch, 2.0 * static_m / softness)
    force_N = touch.preload_N + (dynamic_N * carrier).real
    # Hertz's a³ = 3RF / 4E*, with the modulus an operator in time (Lee and Radok 1960): each part of the force
    # indents through the compliance at its own frequency, so that the contact lags behind the force.
    strain = touch.preload_N / static_Pa + (dynamic_N * softness * carrier).real
    radius_m = np.cbrt(0.75 * touch.crown_m * strain)
    return force_N * electrode_share(spec, radius_m, touch.off_centre_m)


def static_contact(spec: ContactMaterialsSpec, touch: Touch) -> tuple[float, float]:
    """Radius in m and modulus E* in Pa of the contact under the preload, after it has crept for `hold_s`."""
    creep_Hz = 1.0 / (2.0 * np.pi * spec.hold_s)
    radius_m = spec.probe_diameter_mm * 0.5e-3
    modulus_Pa = 0.0
    for _ in range(20):  # the film's weight falls with the contact's width, so radius and modulus converge together
        modulus_Pa = abs(contact_modulus_Pa(spec.film, touch.probe, creep_Hz, radius_m))
        radius_m = float(np.cbrt(0.75 * touch.crown_m * touch.preload_N / modulus_Pa))
    return radius_m, modulus_Pa


def contact_modulus_Pa(film: FilmSpec, probe: ProbeSpec, frequency_Hz: float, radius_m: float) -> complex:  # noqa: N802
    """E* of probe on film (Hertz): complex; its phase is the loss angle of the contact.

    The film has the weight I0(thickness / radius) of a thin layer, the glass the rest (Gao, Chiu and
    Lee 1992).
    """
    in_probe = 1.0 / lossy(1e9 * probe.contact_modulus_GPa, probe.loss_factor, frequency_Hz)
    in_film = (1.0 - film.poisson**2) / lossy(1e9 * film.modulus_GPa, film.mechanical_loss, frequency_Hz)
    in_glass = 1e-9 / film.substrate_GPa
    layer = layer_share(1e-6 * film.thickness_um / radius_m, film.poisson)
    return complex(1.0 / (in_probe + layer * in_film + (1.0 - layer) * in_glass))


def layer_share(thickness: float, poisson: float) -> float:
    """I0: share of a layer in the compliance of layer and substrate; thickness in contact radii.

    >>> round(layer_share(1e9, 0.4), 6), round(layer_share(1e-9, 0.4), 6)
    (1.0, 0.0)
    """
    bulk = (1.0 - 2.0 * poisson) * thickness * np.log1p(thickness**-2.0) - thickness / (1.0 + thickness**2)
    return float(2.0 / np.pi * np.arctan(thickness) + bulk / (2.0 * np.pi * (1.0 - poisson)))


def force_passed_on(spec: ContactMaterialsSpec, touch: Touch, stiffness_N_per_m: complex) -> complex:
    """Force at the probe's tip over the measured one: holder as a mass, probe as a lossy rod, contact as a spring.

    The rod is a line of mechanical impedance Z = A √(ρE); with F and v at its two ends,
    F1 = F2 cos(βl) + j Z sin(βl) v2 and v1 = v2 cos(βl) + j sin(βl) F2 / Z, β = ω √(ρ/E).
    """
    omega = 2.0 * np.pi * touch.frequency_Hz
    probe = touch.probe
    area_m2 = np.pi * (spec.probe_diameter_mm * 0.5e-3) ** 2
    modulus_Pa = lossy(1e9 * probe.modulus_GPa, probe.loss_factor, touch.frequency_Hz)
    impedance = area_m2 * np.sqrt(probe.density_kg_per_m3 * modulus_Pa)
    along = omega * np.sqrt(probe.density_kg_per_m3 / modulus_Pa) * spec.probe_length_mm * 1e-3
    tip = 1j * omega / stiffness_N_per_m
    top = tip * np.cos(along) + 1j * np.sin(along) / impedance
    measured = np.cos(along) + 1j * impedance * np.sin(along) * tip + 1j * omega * spec.holder_g * 1e-3 * top
    return complex(1.0 / measured)


def electrode_share(spec: ContactMaterialsSpec, radius_m: np.ndarray, off_centre_m: float) -> np.ndarray:
    """Share of the force on the electrode: Hertz's pressure over a circle off the electrode's centre.

    radius_m: of the contact, `(...,)`; no wider than the probe.

    >>> spec = ContactMaterialsSpec()
    >>> electrode_share(spec, np.array([1e-4, 5e-4]), 0.0).round(2).tolist()
    [1.0, 0.35]
    """
    edge_m = spec.film.electrode_um * 0.5e-6
    within = (np.arange(RADII) + 0.5) / RADII  # share of the force within a circle of this many contact radii:
    circles = np.sqrt(1.0 - (1.0 - within) ** (2 / 3))
    widest = spec.probe_diameter_mm * 0.5e-3
    r = np.minimum(np.asarray(radius_m, float), widest)[..., None] * circles
    beside = max(off_centre_m, 1e-9)
    cosine = (r**2 + beside**2 - edge_m**2) / (2.0 * r * beside)
    return (np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi).mean(axis=-1)


def charge_constant(film: FilmSpec, frequency_Hz: np.ndarray) -> np.ndarray:
    """Complex charge per force in pC/N of a film clamped laterally by its substrate: d33 - 2 d31 ν / (1 - ν).

    >>> complex(charge_constant(FilmSpec(piezoelectric_loss=0.0), np.array(30.0))).real.__round__(2)
    23.33
    """
    clamped = film.d33_pC_per_N - 2.0 * film.d31_pC_per_N * film.poisson / (1.0 - film.poisson)
    return clamped / lossy(1.0, film.piezoelectric_loss, frequency_Hz)


def amplifier_gain(spec: ContactMaterialsSpec, frequency_Hz: np.ndarray) -> np.ndarray:
    """Complex output of the charge amplifier and its filter in mV per pC.

    The film's own lossy capacitance and the cable's load an amplifier of finite gain.
    """
    amplifier, film = spec.amplifier, spec.film
    corner_Hz = amplifier_corner_Hz(amplifier)
    plate_m2 = np.pi * (film.electrode_um * 0.5e-6) ** 2
    permittivity = EPSILON_0 * film.permittivity / lossy(1.0, film.dielectric_loss, frequency_Hz)
    film_pF = 1e12 * permittivity * plate_m2 / (1e-6 * film.thickness_um)
    open_loop = 1e6 * amplifier.gain_bandwidth_MHz / (1j * frequency_Hz)
    loading = 1.0 + (1.0 + (film_pF + amplifier.cable_pF) / amplifier.feedback_pF) / open_loop
    high_pass = 1j * frequency_Hz / (1j * frequency_Hz + corner_Hz)
    low_pass = 1.0 / (1.0 + 1j * frequency_Hz / amplifier.low_pass_Hz)
    return 1e3 / amplifier.feedback_pF * high_pass * low_pass / loading


def amplifier_corner_Hz(amplifier: AmplifierSpec) -> float:  # noqa: N802
    """Lower corner of the charge amplifier: 1 / (2π R C) of its feedback.

    >>> round(amplifier_corner_Hz(AmplifierSpec()), 2)
    1.59
    """
    return 1.0 / (2.0 * np.pi * amplifier.feedback_GOhm * 1e9 * amplifier.feedback_pF * 1e-12)


def lossy(value: float, loss: float, frequency_Hz: np.ndarray | float) -> np.ndarray:
    """A modulus with a constant loss angle: value (jf / 1 Hz)^n, tan(nπ/2) = loss.

    Causality couples both: with a constant loss, the stiffness grows as f^n. Dividing by it gives a compliance, a
    permittivity or a piezoelectric constant, which fall and lag in the same way.

    >>> modulus = complex(lossy(3.0, 0.075, 30.0))
    >>> round(modulus.imag / modulus.real, 6), round(abs(modulus), 2)
    (0.075, 3.53)
    """
    return value * (1j * np.asarray(frequency_Hz)) ** (2.0 / np.pi * np.arctan(loss))


def _electrical_noise(spec: ContactMaterialsSpec, rng: np.random.Generator) -> np.ndarray:
    """The output without any force, `(time,)` in mV: white noise, mains, pyroelectric drift."""
    from scipy.signal import lfilter

    amplifier, rate_Hz = spec.amplifier, spec.sampling_rate_Hz
    white, steps = rng.standard_normal((2, spec.n_samples))
    mains_Hz = amplifier.mains_Hz * (1.0 + amplifier.jitter_mains * np.clip(rng.standard_normal(), -3.0, 3.0))
    hum = np.cos(2.0 * np.pi * mains_Hz * np.arange(spec.n_samples) / rate_Hz + rng.uniform(0.0, 2.0 * np.pi))
    keeps = np.exp(-2.0 * np.pi * amplifier_corner_Hz(amplifier) / rate_Hz)
    steps[1:] *= np.sqrt(1.0 - keeps**2)  # so that the drift has unit variance from its first sample on
    wander = lfilter([1.0], [1.0, -keeps], steps)
    return amplifier.noise_mV_rms * white + amplifier.hum_mV * hum + amplifier.drift_mV_rms * wander


SIMULATOR = Simulator(
    "Probes of four materials shaken on one piezoelectric element (materials paper).",
    ContactMaterialsSpec,
    simulate,
)
