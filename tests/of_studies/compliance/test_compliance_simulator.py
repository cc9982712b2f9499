"""Laws of the simulated squeezes, and the signal facts that the compliance paper prints."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.compliance.curve_features import instants
from neurotact_parts.studies.compliance.simulator import (
    CHANNELS,
    OBJECTS_FILE,
    SENSORS,
    ComplianceSpec,
    SkinSpec,
    displacement_mm,
    draw_exploration,
    footprint,
    load_objects,
    press,
    simulate,
    skin_of,
    tactile_images,
    taxel_gains,
)
from neurotact_parts.studies.compliance.tactile_moments import moment_weights

from neurotact.errors import InputError
from neurotact.spec import build

COARSE = {"sampling_rate_Hz": 50.0}
STEADY = {
    "noise_counts": 0.0,
    "mismatch": 0.0,
    "habit_mm": 0.0,
    "jitter_place_mm": 0.0,
    "jitter_angle_deg": 0.0,
    "jitter_travel": 0.0,
    "jitter_start_ms": 0.0,
    "jitter_touch": 0.0,
    "jitter_gain": 0.0,
}


def explore(spec, label, seed=0):
    """One exploration of an object: the object, how it went, force and deformation over time."""
    (thing,) = (thing for thing in load_objects() if thing.label == label)
    how = draw_exploration(spec, thing, 0, np.random.default_rng(seed))
    done = press(spec, [thing], [how])
    return thing, how, done.force_N[0], done.deformation_mm[0]


def test_there_are_the_42_objects_of_table_1():
    objects = load_objects()
    assert [thing.label for thing in objects] == [f"OBJ-{i}" for i in range(1, 43)]
    table = pd.read_csv(OBJECTS_FILE).set_index("label")
    assert table.loc["OBJ-2", "object"] == "eggplant"
    four, five = (table.loc[label, "finger_a_mm":"finger_b_mm"].tolist() for label in ("OBJ-4", "OBJ-5"))
    assert four == five[::-1]  # one foam cube, turned
    assert (table["exponent"] >= 1).all()
    losses = table["fast_loss"] + table["slow_loss"]
    assert losses.between(0, 1, inclusive="neither").all()
    # Stiffness by colour (Sec. 3.3): orange low, green middle-low, blue middle-high, purple high.
    order = [table.loc[f"OBJ-{first}", "force_at_5mm_N"] for first in (22, 25, 16, 19)]
    assert order == sorted(order)
    assert len(set(order)) == 4


def test_recordings_are_balanced_and_named():
    spec = ComplianceSpec(trials=2, **COARSE)
    touch = simulate(spec)
    assert np.asarray(touch.signals).shape == (84, 121, 12)
    assert (touch.unit, touch.channels, len(touch.classes)) == ("count", CHANNELS, 42)
    assert (touch.conditions.groupby("label").size() == 2).all()
    assert touch.conditions["exploration"].tolist() == [0] * 42 + [1] * 42


def test_the_published_experiment_has_its_size():
    spec = ComplianceSpec()
    assert (spec.n_trials, spec.sampling_rate_Hz) == (1974, 485.0)
    assert spec.peak == 582  # 12 mm at 10 mm/s
    assert spec.n_samples == 1165
    assert spec.finger.rows * spec.finger.pitch_mm == pytest.approx(40.7)
    assert spec.finger.columns * spec.finger.pitch_mm == pytest.approx(15.0, abs=0.3)


def test_seed_repeats_bit_for_bit_and_others_differ():
    spec = ComplianceSpec(trials=1, seed=3, **COARSE)
    first = np.asarray(simulate(spec).signals)
    np.testing.assert_array_equal(first, simulate(spec).signals)
    assert not np.array_equal(first, simulate(spec.model_copy(update={"seed": 4})).signals)


def test_moments_are_those_of_the_images():
    spec = ComplianceSpec(trials=1, **COARSE)
    signal = np.asarray(simulate(spec).signals)[16]
    thing = load_objects()[16]
    rng = np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=(17, 0)))
    how = draw_exploration(spec, thing, 0, rng)
    done = press(spec, [thing], [how])
    for s, sensor in enumerate(SENSORS):
        skin = skin_of(spec, sensor)
        images = tactile_images(spec, sensor, thing, how, done.force_N[0], done.deformation_mm[0], rng)
        moments = images.reshape(-1, skin.rows * skin.columns) @ moment_weights(skin.rows, skin.columns)
        np.testing.assert_allclose(signal[:, 6 * s : 6 * s + 6], moments, rtol=1e-6)


def test_images_are_whole_counts_in_range():
    spec = ComplianceSpec(trials=1, counts=255, **COARSE)
    thing, how, force_N, deformation_mm = explore(spec, "OBJ-42")
    images = tactile_images(spec, "finger", thing, how, 100 * force_N, deformation_mm, np.random.default_rng(0))
    assert (images == np.rint(images)).all()
    assert images.min() >= 0
    assert 200 < images.max() <= 255


@pytest.mark.parametrize("label", ["OBJ-1", "OBJ-4", "OBJ-31", "OBJ-37", "OBJ-38", "OBJ-42"])
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_bears_the_whole_force(label, sensor):
    spec = ComplianceSpec(trials=1, **COARSE)
    thing, how, force_N, deformation_mm = explore(spec, label)
    s = SENSORS.index(sensor)
    share = footprint(skin_of(spec, sensor), thing, s, how, force_N, deformation_mm)
    np.testing.assert_allclose(share.sum(axis=1), 1.0, rtol=1e-5)
    assert share.min() >= 0
    far_off = how._replace(place_mm=(500.0, 500.0))
    np.testing.assert_allclose(
        footprint(skin_of(spec, sensor), thing, s, far_off, force_N, deformation_mm).sum(axis=1), 1.0
    )


def test_an_exploration_starts_at_first_touch_and_turns_where_it_is_told():
    spec = ComplianceSpec(trials=1, **STEADY)
    for label in ("OBJ-4", "OBJ-17", "OBJ-28"):
        _, how, force_N, _ = explore(spec, label)
        assert force_N[0] == pytest.approx(0.1, rel=1e-3)
        assert abs(int(force_N.argmax()) - spec.peak) <= 1
        path_mm = displacement_mm(spec, how)
        assert path_mm[spec.peak] == pytest.approx(12.0)
        assert np.abs(np.diff(path_mm)).max() * spec.sampling_rate_Hz == pytest.approx(10.0, rel=1e-6)


def test_loading_and_unloading_differ_as_the_paper_says():
    """Sec. 2: hysteresis makes the curve lopsided, so that H2 falls below H1."""
    spec = ComplianceSpec(trials=1, **STEADY)
    when = instants(spec.peak)
    things = list(load_objects())
    explored = [draw_exploration(spec, thing, 0, np.random.default_rng(0)) for thing in things]
    force_N = press(spec, things, explored).force_N
    assert (force_N[:, when.h2] < force_N[:, when.h1]).all()
    assert (force_N[:, when.h1] < force_N[:, when.maximum]).all()


def test_stiffer_objects_press_harder():
    spec = ComplianceSpec(trials=1, **STEADY)
    peaks = [explore(spec, f"OBJ-{i}")[2].max() for i in (22, 25, 16, 19)]
    assert peaks == sorted(peaks)


def test_a_turned_ovoid_swaps_its_faces():
    spec = ComplianceSpec(trials=1, **STEADY, finger=ComplianceSpec().palm)
    down, up = (explore(spec, label) for label in ("OBJ-16", "OBJ-17"))
    finger_down = footprint(spec.finger, down[0], 0, down[1], down[2], down[3])
    palm_up = footprint(spec.palm, up[0], 1, up[1], up[2], up[3])
    ratio = (finger_down > 0).sum(axis=1)[60:100] / (palm_up > 0).sum(axis=1)[60:100]
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)
    assert (finger_down[582] > 0).sum() > (footprint(spec.finger, up[0], 0, up[1], up[2], up[3])[582] > 0).sum()


def test_the_palm_bears_the_weight_too():
    spec = ComplianceSpec(trials=1, **STEADY)
    thing, how, force_N, deformation_mm = explore(spec, "OBJ-10")
    still = np.zeros_like(force_N)
    rng = np.random.default_rng(0)
    assert tactile_images(spec, "finger", thing, how, still, deformation_mm, rng).sum() == 0
    assert (tactile_images(spec, "palm", thing, how, still, deformation_mm, rng).sum(axis=1) > 0).all()


def test_crosstalk_is_larger_on_the_palm_and_keeps_the_sum():
    """Sec. 3.1: domes and laser cuts keep the finger's taxels apart, the palm has one sheet."""
    spec = ComplianceSpec()
    assert spec.palm.crosstalk > spec.finger.crosstalk
    point = {"rows": 5, "columns": 5, "pitch_mm": 3.7, "cover_N_per_mm3": 1, "spread_mm": 1e-3, "half_force_N": 1e9}
    thing, how, _, _ = explore(ComplianceSpec(trials=1, **STEADY), "OBJ-31")
    reads = {}
    for crosstalk in (0.0, 0.1):
        one = ComplianceSpec(trials=1, **STEADY, finger=SkinSpec(crosstalk=crosstalk, **point), counts=10**12)
        reads[crosstalk] = tactile_images(
            one, "finger", thing, how, np.array([1.0]), np.array([0.0]), np.random.default_rng(0)
        )
    np.testing.assert_allclose(reads[0.1].sum(), reads[0.0].sum(), rtol=1e-4)
    mixed = (reads[0.1] / reads[0.1].sum()).reshape(5, 5)
    assert mixed[2, 2] == pytest.approx(0.6, abs=0.01)
    assert mixed[1, 2] == pytest.approx(0.1, abs=0.01)


def test_produce_softens_as_it_is_squeezed_again():
    spec = ComplianceSpec(**STEADY)
    thing = load_objects()[8]
    first, last = (draw_exploration(spec, thing, trial, np.random.default_rng(0)).stiffness for trial in (0, 46))
    assert last / first == pytest.approx(1.0 - thing.softening)


@given(st.integers(0, 41), st.integers(0, 99))
def test_an_object_that_is_left_in_place_lies_there_in_every_exploration(index, seed):
    thing = load_objects()[index]

    def places(spec):
        explored = [draw_exploration(spec, thing, trial, np.random.default_rng(trial)) for trial in range(4)]
        return [(*how.place_mm, how.angle_rad) for how in explored], explored

    spec = ComplianceSpec(placing="repeated", seed=seed)
    left, explored = places(spec)
    anew, _ = places(spec.model_copy(update={"placing": "random"}))
    assert (len(set(left)), len(set(anew))) == (1, 4)
    assert len({how.touch_N for how in explored}) == 4
    still, _ = places(spec.model_copy(update={"jitter_place_mm": 0.0, "jitter_angle_deg": 0.0}))
    assert still[0] != left[0]  # it is not laid down exactly, only once


def test_taxel_gains_belong_to_the_sensor_not_to_the_exploration():
    spec = ComplianceSpec(trials=1, mismatch=0.2)
    gains = taxel_gains(spec, "finger")
    assert len(gains) == 44
    assert gains.std() == pytest.approx(0.2, rel=0.3)
    np.testing.assert_array_equal(gains, taxel_gains(spec.model_copy(update={"trials": 9}), "finger"))
    assert not np.array_equal(gains, taxel_gains(spec.model_copy(update={"seed": 1}), "finger"))
    thing, how, force_N, deformation_mm = explore(spec, "OBJ-5")
    noiseless = spec.model_copy(update={"noise_counts": 0.0})
    read, even = (
        tactile_images(one, "finger", thing, how, force_N, deformation_mm, np.random.default_rng(0))
        for one in (noiseless, noiseless.model_copy(update={"mismatch": 0.0}))
    )
    pressed = even > 100
    np.testing.assert_allclose(
        (read / np.maximum(even, 1))[pressed], np.broadcast_to(gains, read.shape)[pressed], atol=0.02
    )


@pytest.mark.parametrize("key", ["trials", "seed", "sampling_rate_Hz", "travel_mm", "noise_counts", "jitter_place_mm"])
def test_spec_refuses_negative_values(key):
    with pytest.raises(InputError, match=f"^{key}: must be"):
        build(ComplianceSpec, {key: -1}, "here")


def test_spec_refuses_a_movement_that_is_not_sampled():
    with pytest.raises(InputError, match="fewer than 2 samples"):
        build(ComplianceSpec, {"sampling_rate_Hz": 1.0}, "here")
