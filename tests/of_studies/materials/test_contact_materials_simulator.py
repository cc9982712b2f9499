"""Laws of the simulated contact materials, each part against its closed form."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.materials.simulator import (
    CYCLE_POINTS,
    PROBES,
    AmplifierSpec,
    ContactMaterialsSpec,
    FilmSpec,
    Touch,
    amplifier_corner_Hz,
    amplifier_gain,
    charge_constant,
    contact_modulus_Pa,
    draw_touch,
    electrode_force_N,
    electrode_share,
    force_passed_on,
    layer_share,
    lossy,
    output_harmonics,
    patterns,
    simulate,
    static_contact,
)

from neurotact.errors import InputError
from neurotact.spec import build

QUIET_AMPLIFIER = AmplifierSpec(noise_mV_rms=0, drift_mV_rms=0, hum_mV=0)
STILL = {
    "force_noise_mN_rms": 0.0,
    "jitter_force": 0.0,
    "jitter_preload": 0.0,
    "jitter_crown": 0.0,
    "jitter_place_um": 0.0,
    "jitter_gain": 0.0,
    "amplifier": QUIET_AMPLIFIER,
    "probes": {name: probe.model_copy(update={"spread": 0.0}) for name, probe in PROBES.items()},
}
materials = st.sampled_from(sorted(PROBES))
frequencies = st.floats(5.0, 70.0)


def touch_of(material, frequency_Hz=30.0, force_N=0.2, **changes):
    return Touch(PROBES[material], frequency_Hz, force_N, 1.0, 0.1, 0.0, 1.0, 0.0)._replace(**changes)


@pytest.fixture(scope="module")
def experiment():
    return simulate(ContactMaterialsSpec(trials=2))


def test_recordings_are_balanced_and_named(experiment):
    assert experiment.signals.shape == (80, 4000, 2)
    assert experiment.signals.dtype == np.float32
    assert (experiment.unit, experiment.channels) == ("V", ("force", "output"))
    assert experiment.classes == ("brass", "lead", "plastic", "wood")
    assert (experiment.conditions.groupby(["label", "set_force_N", "frequency_Hz"]).size() == 2).all()


def test_seed_repeats_bit_for_bit_and_fewer_trials_are_a_prefix(experiment):
    again = simulate(ContactMaterialsSpec(trials=1))
    np.testing.assert_array_equal(again.signals, experiment.signals[:40])
    other = simulate(ContactMaterialsSpec(trials=1, seed=1))
    assert not np.array_equal(other.signals, again.signals)


def test_a_trial_does_not_depend_on_which_others_are_simulated(experiment):
    alone = simulate(ContactMaterialsSpec(trials=2, probes={"wood": PROBES["wood"]}, frequencies_Hz=(45.0,)))
    same = (experiment.conditions.label == "wood") & (experiment.conditions.frequency_Hz == 45.0)
    np.testing.assert_array_equal(experiment.signals[same.to_numpy()], alone.signals)


LANDING = ("probe", "preload_N", "crown_m", "off_centre_m")


def landings(spec, material, n=4):
    """What a landing decides, and the rest, of some trials of two conditions."""
    generators = (np.random.default_rng(i) for i in range(n))
    touches = [draw_touch(spec, material, (0.2, 0.4)[i % 2], 30.0, rng) for i, rng in enumerate(generators)]
    return [tuple(getattr(touch, name) for name in LANDING) for touch in touches], touches


@given(material=materials, seed=st.integers(0, 99))
def test_a_repeated_landing_is_one_for_all_trials_of_a_probe(material, seed):
    spec = ContactMaterialsSpec(landing="repeated", seed=seed)
    of_landing, touches = landings(spec, material)
    assert len({str(one) for one in of_landing}) == 1
    assert len({touch.gain for touch in touches}) == len({touch.phase for touch in touches}) == len(touches)
    anew, _ = landings(spec.model_copy(update={"landing": "random"}), material)
    assert len({str(one) for one in anew}) == len(anew)
    other, _ = landings(spec.model_copy(update={"seed": seed + 1}), material)
    assert other[0] != of_landing[0]


def test_probes_that_land_once_land_apart():
    spec = ContactMaterialsSpec(landing="repeated")
    assert len({landings(spec, material)[1][0].crown_m for material in PROBES}) == len(PROBES)


def test_repeated_landings_scatter_less():
    spread = {}
    for landing in ("repeated", "random"):
        table = patterns(simulate(ContactMaterialsSpec(trials=8, landing=landing, frequencies_Hz=(30.0,))))
        table = table.assign(set_force_N=table.force_N.round(1))
        spread[landing] = table.groupby(["label", "set_force_N"]).amplitude_mV.std().mean()
    assert spread["repeated"] < 0.6 * spread["random"]


def test_patterns_recover_what_was_put_in():
    spec = ContactMaterialsSpec(trials=1, **STILL)
    table = patterns(simulate(spec))
    for i, row in enumerate(table.itertuples()):
        force_N = spec.forces_N[(i // 5) % 2]
        phasor = output_harmonics(spec, touch_of(row.label, row.frequency_Hz, force_N))[0]
        assert row.force_N == pytest.approx(force_N, rel=1e-5)
        assert row.amplitude_mV == pytest.approx(abs(phasor), rel=1e-5)
        assert row.phase_deg == pytest.approx(np.degrees(np.angle(phasor)), abs=1e-3)


def test_noise_is_as_strong_as_said():
    loud = AmplifierSpec(noise_mV_rms=3.0, drift_mV_rms=4.0, hum_mV=0)
    faint = {"frequencies_Hz": (70.0,), "forces_N": (1e-6,), "jitter_force": 0.0}
    output_mV = 1e3 * np.asarray(simulate(ContactMaterialsSpec(trials=20, amplifier=loud, **faint)).signals)[..., 1]
    assert output_mV.std() == pytest.approx(5.0, rel=0.1)
    neighbours = (output_mV[:, 1:] * output_mV[:, :-1]).mean()
    keeps = np.exp(-2 * np.pi * amplifier_corner_Hz(loud) / 2000)
    assert neighbours == pytest.approx(16.0 * keeps, rel=0.15)


@given(loss=st.floats(0, 0.5), low_Hz=frequencies, octave=st.floats(1.1, 10))
def test_a_loss_that_no_frequency_changes_stiffens_as_a_power(loss, low_Hz, octave):
    low, high = complex(lossy(2.0, loss, low_Hz)), complex(lossy(2.0, loss, low_Hz * octave))
    assert low.imag / low.real == pytest.approx(loss, abs=1e-9)
    # Kramers and Kronig for nearly constant loss: d ln|M| / d ln f = 2 δ / π.
    assert np.log(abs(high / low)) == pytest.approx(2 / np.pi * np.arctan(loss) * np.log(octave), abs=1e-9)


@given(radius_um=st.floats(20, 500))
def test_centred_share_is_the_integral_of_hertz_pressure(radius_um):
    spec = ContactMaterialsSpec()
    beyond = max(0.0, 1 - (250 / radius_um) ** 2) ** 1.5
    share = electrode_share(spec, np.array([radius_um * 1e-6]), 0.0)
    assert share[0] == pytest.approx(1 - beyond, abs=2e-3)


@given(radius_um=st.floats(50, 480), off_um=st.floats(0, 400))
def test_share_agrees_with_pressure_drawn_at_random(radius_um, off_um):
    rng = np.random.default_rng(0)
    r = radius_um * np.sqrt(1 - (1 - rng.random(40000)) ** (2 / 3))
    angle = rng.uniform(0, 2 * np.pi, r.size)
    inside = np.hypot(r * np.cos(angle) - off_um, r * np.sin(angle)) < 250
    share = electrode_share(ContactMaterialsSpec(), np.array([radius_um * 1e-6]), off_um * 1e-6)
    assert share[0] == pytest.approx(inside.mean(), abs=0.015)


@given(material=materials, preload_N=st.floats(0.7, 1.5))
def test_static_contact_is_hertz(material, preload_N):
    spec, touch = ContactMaterialsSpec(), touch_of(material, preload_N=preload_N)
    radius_m, modulus_Pa = static_contact(spec, touch)
    assert radius_m**3 == pytest.approx(0.75 * touch.crown_m * preload_N / modulus_Pa, rel=1e-9)
    creep_Hz = 1 / (2 * np.pi * spec.hold_s)
    assert modulus_Pa == pytest.approx(abs(contact_modulus_Pa(spec.film, touch.probe, creep_Hz, radius_m)), rel=1e-6)


def test_softer_probes_touch_more_widely():
    radii = [static_contact(ContactMaterialsSpec(), touch_of(m))[0] for m in ("brass", "lead", "wood", "plastic")]
    assert radii == sorted(radii)
    assert 100e-6 < radii[0] < radii[3] < 500e-6


def test_layer_share_goes_from_substrate_to_film():
    shares = [layer_share(thickness, 0.4) for thickness in (0.01, 0.1, 1.0, 10.0, 100.0)]
    assert shares == sorted(shares)
    assert 0 < shares[0] < 0.02
    assert shares[-1] > 0.98


@given(material=materials, frequency_Hz=frequencies)
def test_slow_rods_are_a_mass_on_springs(material, frequency_Hz):
    """At these frequencies the line is its first terms: masses over the compliance of rod and contact."""
    spec, probe, stiffness = ContactMaterialsSpec(), PROBES[material], 5e5 + 1e4j
    area = np.pi * 0.25e-6
    modulus = complex(lossy(probe.modulus_GPa * 1e9, probe.loss_factor, frequency_Hz))
    rod_kg = probe.density_kg_per_m3 * area * 0.02
    rod = area * modulus / 0.02
    inertia = 0.02 * (1 / stiffness + 1 / rod) + rod_kg * (1 / stiffness + 0.5 / rod)
    expected = 1 / (1 - (2 * np.pi * frequency_Hz) ** 2 * inertia)
    assert force_passed_on(spec, touch_of(material, frequency_Hz), stiffness) == pytest.approx(expected, rel=1e-4)


def test_without_losses_probe_and_contact_do_not_turn_the_phase():
    hard = {"mechanical_loss": 0.0, "piezoelectric_loss": 0.0, "dielectric_loss": 0.0}
    spec = ContactMaterialsSpec(film=FilmSpec(**hard))
    for name, probe in PROBES.items():
        touch = touch_of(name, probe=probe.model_copy(update={"loss_factor": 0.0}))
        fundamental = np.fft.rfft(electrode_force_N(spec, touch))[1]
        assert np.angle(fundamental) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("material", sorted(PROBES))
def test_contact_that_stays_on_the_electrode_passes_the_force_on(material):
    spec = ContactMaterialsSpec(film=FilmSpec(electrode_um=5000.0), holder_g=0.0)
    on_electrode = electrode_force_N(spec, touch_of(material))
    carrier = np.cos(2 * np.pi * np.arange(CYCLE_POINTS) / CYCLE_POINTS)
    np.testing.assert_allclose(on_electrode, 1.0 + 0.2 * carrier, atol=2e-4)


def test_a_wide_contact_loses_force_beyond_the_electrode_and_lags_less():
    """The circle that lags behind the force takes charge away a little late, so that what is left leads."""
    spec = ContactMaterialsSpec()
    brass, plastic = (np.fft.rfft(electrode_force_N(spec, touch_of(m)))[1] for m in ("brass", "plastic"))
    assert abs(plastic) < 0.7 * abs(brass)
    assert np.angle(plastic) > np.angle(brass)


@given(frequency_Hz=frequencies)
def test_amplifier_is_a_high_pass_and_a_low_pass(frequency_Hz):
    spec = ContactMaterialsSpec()
    corner = 1 / (2 * np.pi * 1e9 * 100e-12)
    ideal = 10.0 / (1 + corner / (1j * frequency_Hz)) / (1 + 1j * frequency_Hz / 500)
    found = amplifier_gain(spec, np.array([frequency_Hz]))[0]
    assert found == pytest.approx(ideal, rel=5e-4)
    assert abs(found) < abs(ideal) * (1 + 1e-6)


def test_charge_constant_of_a_clamped_film_lags_by_its_loss():
    constant = charge_constant(FilmSpec(), np.array([5.0, 70.0]))
    np.testing.assert_allclose(-constant.imag / constant.real, 0.03, rtol=1e-9)
    assert abs(constant[1]) < abs(constant[0]) < 38.0 - 2 * 11.0 * 0.4 / 0.6


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"trials": 0}, "trials: must be >= 1"),
        ({"frequencies_Hz": [5.0, 5.0]}, "frequencies_Hz holds a value twice"),
        ({"frequencies_Hz": [200.0]}, "frequencies_Hz must be below 1/16"),
        ({"duration_s": 0.1}, "duration_s is shorter than one period"),
        ({"preload_N": 0.4}, "probe and film never separate"),
        ({"probes": {}}, "probes"),
        ({"film": {"poisson": 0.5}}, r"film\.poisson: must be < 0.5"),
        ({"film": {"d33": 1.0}}, r"film\.d33: unknown key"),
        ({"jitter_gain": 0.5}, "jitter_gain: must be < 0.3"),
    ],
)
def test_spec_refuses_what_does_not_fit(table, words):
    with pytest.raises(InputError, match=words):
        build(ContactMaterialsSpec, table, "here")


def test_facts_of_the_paper(experiment):
    """Sec. II-B: forces as set; the output depends on force, frequency and material, in amplitude and in phase."""
    table = patterns(experiment).assign(set_force_N=experiment.conditions.set_force_N)
    assert (table.force_N / table.set_force_N - 1).abs().max() < 0.1
    by_force = table.groupby("set_force_N").amplitude_mV.mean()
    assert by_force[0.4] == pytest.approx(2 * by_force[0.2], rel=0.1)
    by_frequency = table.groupby("frequency_Hz").phase_deg.mean()
    assert (np.diff(by_frequency) < 0).all()
    assert isinstance(table, pd.DataFrame)
    assert table.groupby("label").amplitude_mV.mean().idxmin() == "plastic"
