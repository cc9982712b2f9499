"""Laws of the simulated gratings, and the calibration facts on a small experiment."""

import numpy as np
import pytest

from neurotact.data.recordings import select_conditions
from neurotact.encoders.afferents import AfferentSpec
from neurotact.errors import InputError
from neurotact.papers.texture import calibration as gratings_calibration
from neurotact.papers.texture.simulator import (
    GratingsSpec,
    Slide,
    contact,
    draw_slide,
    ridge_signal,
    simulate,
    trial_generator,
)
from neurotact.spec import build, load

SMALL = {"pitches_mm": (4.0, 0.5), "forces_N": (12.0,), "duration_s": 0.3}
SILENT = {"noise_mV_rms": 0.0, "slip_mV_rms": 0.0, "jitter_speed": 0.0, "jitter_force": 0.0, "jitter_gain": 0.0}


@pytest.fixture(scope="module")
def experiment():
    """All forces and speeds of the three gratings that the paper shows."""
    return simulate(GratingsSpec(trials=12, pitches_mm=(4.0, 2.0, 0.5)))


def test_recordings_are_balanced_and_named():
    spec = GratingsSpec(trials=2, duration_s=0.05)
    touch = simulate(spec)
    assert touch.signals.shape == (96, 100, 8)
    assert touch.signals.dtype == np.float32
    assert (touch.unit, touch.sampling_rate_Hz, len(touch)) == ("mV", 2000.0, spec.n_trials)
    assert touch.classes == ("P0.5", "P1.0", "P1.5", "P2.0", "P2.5", "P3.0", "P3.5", "P4.0")
    assert (touch.conditions.groupby(["label", "force_N", "speed_mm_per_s"]).size() == 2).all()
    first = touch.conditions[touch.conditions.grating == 1]
    assert set(first.label) == {"P4.0"}
    assert set(first.pitch_mm) == {4.0}
    assert sorted(set(touch.conditions.trial)) == [0, 1]


def test_labels_name_every_pitch_apart():
    touch = simulate(GratingsSpec(trials=1, duration_s=0.01, pitches_mm=(2.0, 0.25, 0.75), forces_N=(3.0,)))
    assert touch.classes == ("P0.25", "P0.75", "P2.0")


def test_seed_repeats_bit_for_bit():
    spec = GratingsSpec(trials=2, seed=7, **SMALL)
    np.testing.assert_array_equal(simulate(spec).signals, simulate(spec).signals)
    other = simulate(spec.model_copy(update={"seed": 8})).signals
    assert not np.array_equal(simulate(spec).signals, other)


def test_fewer_trials_are_a_prefix_of_more():
    few, more = (simulate(GratingsSpec(trials=n, **SMALL)) for n in (3, 5))
    np.testing.assert_array_equal(few.signals, more.signals[: len(few)])
    assert few.conditions.equals(more.conditions[: len(few)])


def test_a_trial_does_not_depend_on_which_others_are_simulated():
    every = simulate(GratingsSpec(trials=2, duration_s=0.1))
    only = {"pitches_mm": (2.0,), "forces_N": (6.0,), "speeds_mm_per_s": (13.7,)}
    alone = simulate(GratingsSpec(trials=2, duration_s=0.1, **only))
    same = select_conditions(every.conditions, {"label": "P2.0", "force_N": 6.0, "speed_mm_per_s": 13.7})
    np.testing.assert_array_equal(every.select(same).signals, alone.signals)


def test_principal_frequency_is_speed_over_period():
    spec = GratingsSpec(trials=4, duration_s=4.0, forces_N=(12.0,), jitter_speed=0.0)
    touch = simulate(spec)
    strongest = np.asarray(touch.signals)[:, :, 0]
    spectrum = np.abs(np.fft.rfft(strongest - strongest.mean(axis=1, keepdims=True), axis=1))
    frequency_Hz = np.fft.rfftfreq(strongest.shape[1], 1 / 2000)
    for (pitch_mm, speed), group in touch.conditions.groupby(["pitch_mm", "speed_mm_per_s"]):
        peak_Hz = frequency_Hz[spectrum[group.index].mean(axis=0).argmax()]
        assert peak_Hz == pytest.approx(speed / (pitch_mm + 1.0), abs=1 / 4.0)


def test_without_noise_and_jitter_trials_differ_only_by_phase():
    spec = GratingsSpec(trials=2, pitches_mm=(2.0,), forces_N=(12.0,), speeds_mm_per_s=(8.6,), duration_s=1.0, **SILENT)
    first, second = np.asarray(simulate(spec).signals)[:, :, 0]
    phases = [draw_slide(spec, 2.0, 12.0, 8.6, trial_generator(0, 2.0, 12.0, 8.6, t)).phase for t in (0, 1)]
    shift = (phases[1] - phases[0]) * (3.0 / 8.6) * 2000
    if shift < 0:
        first, second, shift = second, first, -shift
    whole, part = int(shift), shift - int(shift)
    between = (1 - part) * first[whole:-1] + part * first[whole + 1 :]
    np.testing.assert_allclose(second[: len(between)], between, atol=0.1)
    assert np.abs(second).max() > 5


def test_signal_is_proportional_to_gain_and_quiet_taxels_stay_small():
    spec = GratingsSpec(trials=1, forces_N=(12.0,), **SILENT)
    peaks = np.abs(np.asarray(simulate(spec).signals)).max(axis=(0, 1))
    np.testing.assert_allclose(peaks / peaks[0], np.abs(spec.taxel_gains), rtol=0.02)
    assert (peaks > 8).sum() in (2, 3)
    assert (peaks[3:] <= 2.0).all()


@pytest.mark.parametrize("pitch_mm", [4.0, 2.0, 0.5])
def test_amplitude_grows_with_force(pitch_mm):
    spec = GratingsSpec()
    slides = [Slide(pitch_mm, force_N, 8.6, 0.0, np.ones(8)) for force_N in (3.0, 6.0, 12.0)]
    peaks = [np.abs(ridge_signal(spec, slide)).max() for slide in slides]
    assert peaks[0] < peaks[1] < peaks[2]
    assert peaks[2] > 1.4 * peaks[0]


def test_ridge_signal_has_no_mean_and_contact_covers_the_ridges_share():
    spec, slide = GratingsSpec(), Slide(3.0, 12.0, 8.6, 0.0, np.ones(8))
    assert ridge_signal(spec, slide).mean() == pytest.approx(0.0, abs=1e-9)
    cover = contact(spec, slide)
    assert cover.mean() == pytest.approx(1.0 / 4.0)
    assert cover.min() > -1e-9
    assert cover.max() < 1 + 1e-9


def test_noise_is_white_and_as_strong_as_said():
    touch = simulate(GratingsSpec(trials=4, press_mV=0, catch_mV=0, slip_mV_rms=0))
    noise = np.asarray(touch.signals)
    assert noise.std() == pytest.approx(0.2, rel=0.01)
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < 0.02 * noise.var()


def test_slip_noise_keeps_its_power_at_any_sampling_rate():
    only = {"press_mV": 0.0, "catch_mV": 0.0, "noise_mV_rms": 0.0, "forces_N": (12.0,), "pitches_mm": (4.0,)}
    rms = [np.asarray(simulate(GratingsSpec(trials=40, sampling_rate_Hz=f, **only)).signals).std() for f in (1e3, 4e3)]
    assert rms[0] == pytest.approx(rms[1], rel=0.1)


def test_progress_is_told_to_the_end():
    told = []
    simulate(GratingsSpec(trials=30, **SMALL), lambda done, total: told.append((done, total)))
    assert told[-1] == (120, 120)
    assert told == sorted(told)


NEGATIVE = [
    "trials",
    "seed",
    "duration_s",
    "sampling_rate_Hz",
    "ridge_width_mm",
    "press_mV",
    "skin_mm",
    "drape",
    "catch_mV",
    "edge_mm",
    "slip_mV_rms",
    "sag_mm",
    "mount_Hz",
    "mount_damping",
    "high_pass_Hz",
    "load_exponent",
    "force_exponent",
    "flattening_exponent",
    "noise_mV_rms",
    "jitter_speed",
    "jitter_force",
    "jitter_gain",
]


@pytest.mark.parametrize("key", NEGATIVE)
def test_spec_refuses_negative_values(key):
    with pytest.raises(InputError, match=f"^{key}: must be"):
        build(GratingsSpec, {key: -1}, "here")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"pitches_mm": [2.0, -0.5]}, r"pitches_mm\.1: must be > 0"),
        ({"forces_N": []}, "forces_N"),
        ({"speeds_mm_per_s": [8.6, 8.6]}, "speeds_mm_per_s holds a value twice"),
        ({"taxel_gains": [1.0]}, "give one of each a taxel"),
        ({"duration_s": 1e-5}, "shorter than one sample"),
        ({"mount_Hz": 1500.0}, "mount_Hz must be below half"),
        ({"pitch_mm": [2.0]}, "did you mean 'pitches_mm'"),
    ],
)
def test_spec_refuses_what_does_not_fit(table, words):
    with pytest.raises(InputError, match=words):
        build(GratingsSpec, table, "here")


def test_calibration_facts_hold_on_a_small_experiment(experiment, monkeypatch):
    encoder = load(AfferentSpec, "sa1-ra1-lif")
    # Three gratings stand in for eight: they are numbered 1, 2 and 3 here.
    monkeypatch.setattr(gratings_calibration, "SHOWN", (1, 2, 3))
    measured = gratings_calibration.measure(experiment, encoder)
    facts = [
        *gratings_calibration.signal_facts(measured.signals),
        *gratings_calibration.count_facts(measured.firing),
        *gratings_calibration.rate_facts(measured.firing),
    ]
    missed = [f"{fact.fact}: {fact.target}; {fact.reached}" for fact in facts if not fact.holds]
    assert not missed
