"""Laws of the simulated grasps: mechanics, the film's answer, what the recordings show, random numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.stiffness.peaks import PeakSpec, find_peaks
from neurotact_parts.studies.stiffness.simulator import (
    Contact,
    Grasp,
    MaterialSpec,
    StiffnessSpec,
    close_and_open,
    draw_grasp,
    footprint,
    in_series,
    patch_gains,
    record,
    simulate,
)

from neurotact.errors import InputError

STILL = StiffnessSpec(noise_mV_rms=0.0, gain_spread=0.0)


@pytest.fixture(scope="module")
def experiment():
    return simulate(StiffnessSpec(grasps=5))


def grasp(stiffness=4.0, damping=0.004, speed=50.0, force=1.05, gap=10.0, offset=-5.0, turn=0.0, tilt=0.0):
    return Grasp(stiffness, damping, speed, force, gap, offset, turn, tilt)


def rise_samples(force: np.ndarray) -> int:
    """From contact to 99 % of the highest force."""
    return int((force >= 0.99 * force.max()).argmax() - (force > 0).argmax())


def test_the_protocol_is_the_papers(experiment):
    """Three objects, 12 placements, 4 channels at 2 kS/s, 3 s (stiffness paper, Sec. IV)."""
    assert StiffnessSpec().n_trials == 720
    assert experiment.signals.shape == (3 * 12 * 5, 6000, 4)
    assert (experiment.sampling_rate_Hz, experiment.unit) == (2000.0, "mV")
    assert experiment.classes == ("HR", "RW", "SR")
    assert StiffnessSpec().force_N == pytest.approx(1.05)


def test_a_grasp_dips_and_its_release_rises(experiment):
    """Stiffness paper, Fig. 2, and the real PVDF recordings."""
    smooth = np.apply_along_axis(lambda x: np.convolve(x, np.ones(20) / 20, "same"), 1, experiment.signals)
    held, freed = smooth[:, :2000], smooth[:, 2000:]
    deepest = held.min(axis=1).argmin(axis=1)
    trials = np.arange(len(smooth))
    assert (held.argmin(axis=1)[trials, deepest] > 180).all()
    assert (held.min(axis=1)[trials, deepest] < -0.8).all()
    assert (freed.max(axis=1)[trials, deepest] > 0.8).all()
    assert (np.abs(smooth[:, -1000:-20]).max(axis=(1, 2)) < 0.3).all()


def test_peaks_and_noise_are_those_of_the_real_patch(experiment):
    """Filtered peaks of 1 to 15 mV, quiet channels about 0.23 mV rms (real PVDF recordings)."""
    before = experiment.signals[:, :180]
    assert before.std() == pytest.approx(0.23, rel=0.02)
    smooth = np.apply_along_axis(lambda x: np.convolve(x, np.ones(10) / 10, "same"), 1, experiment.signals)
    depth = -smooth.min(axis=(1, 2))
    assert depth.min() > 1.0
    assert 8.0 < depth.max() < 15.0


def test_each_grasp_shows_one_peak(experiment):
    counts = [len(find_peaks(signal, PeakSpec(threshold=1.5)).minimum) for signal in experiment.signals]
    assert counts == [1] * len(counts)


@examples(3)
@given(st.integers(0, 2**32 - 1))
def test_the_jaw_stops_at_the_set_force_and_holds(seed):
    rng = np.random.default_rng(seed)
    low, high = np.array([(0.5, 25.0), (0.0, 0.006), (30.0, 80.0), (0.5, 2.0)]).T
    drawn = rng.uniform(low, high, (100, 4))
    stiffness, damping, speed, force = drawn.T
    felt = close_and_open(STILL, [grasp(*values) for values in drawn])
    assert (felt.force_N >= 0).all()
    # It overshoots by what the jaw moves while it brakes, m / b in seconds, and by a step of the computation.
    braking_mm = speed * (STILL.jaw_kg / (1e3 * STILL.drive_N_s_per_mm) + 2 / 8000)
    highest = felt.force_N.max(axis=1)
    assert (highest <= (force + stiffness * braking_mm) * (1 + damping * speed)).all()
    held = felt.force_N[:, 1500:2000]
    assert (held.min(axis=1) >= force / (1 + damping * speed)).all()
    np.testing.assert_allclose(held, stiffness[:, None] * felt.indentation_mm[:, 1500:2000], rtol=1e-9)
    assert np.ptp(held, axis=1).max() < 1e-9
    assert (felt.force_N[:, -1] == 0).all()


def test_the_rise_lasts_as_long_as_the_way_into_the_object():
    """At constant speed v the force F is reached after F / (k v) (no damping, a drive that does not yield)."""
    hard_drive = STILL.model_copy(update={"drive_N_s_per_mm": 5.0, "jaw_kg": 0.6})
    for stiffness in (0.5, 1.0, 2.0):
        felt = close_and_open(hard_drive, [grasp(stiffness, 0.0)])
        expected_ms = 1e3 * 1.05 / (stiffness * 50.0)
        assert rise_samples(felt.force_N[0]) / 2 == pytest.approx(expected_ms, abs=1.5)


def test_the_stiffer_the_faster():
    drawn = [grasp(stiffness) for stiffness in (0.8, 2.0, 4.0, 10.0, 22.0)]
    forces = close_and_open(STILL, drawn).force_N
    rises = [rise_samples(force) for force in forces]
    assert rises == sorted(rises, reverse=True)
    assert len(set(rises)) == len(rises)


def test_the_film_forgets_a_constant_force_with_its_time_constant():
    load = np.zeros(4000)
    load[100:] = 1.0
    signal = record(STILL, grasp(), Contact(load, np.zeros(4000)), np.ones(4), np.random.default_rng(0))
    step = signal[100, 0]
    assert step == pytest.approx(-32.0 * footprint(STILL, grasp(), np.zeros(1))[0, 0], rel=1e-6)
    time_constant = round(2000 / (2 * np.pi * 1.0))
    assert signal[100 + time_constant, 0] == pytest.approx(step / np.e, rel=1e-3)


@given(st.floats(0.0, 3.0), st.floats(-0.4, 0.4))
def test_a_footprint_holds_the_whole_force(indentation, tilt):
    """Summed over taxels that cover the width, the shares make 1 at any depth."""
    x = np.arange(-60.0, 60.0, 0.25)
    row = STILL.model_copy(update={"taxel_x_mm": tuple(x), "taxel_y_mm": tuple(np.zeros_like(x))})
    share = footprint(row, grasp(tilt=tilt), np.array([indentation]))
    assert share.sum() * 0.25 == pytest.approx(1.0, rel=1e-6)


def test_a_deeper_contact_is_wider_and_lighter_in_its_middle():
    shares = footprint(STILL, grasp(), np.array([0.0, 0.5, 2.0]))
    assert (np.diff(shares[:, 0]) < 0).all()
    assert (np.diff(shares[:, 1]) > 0).all()


def test_compliances_in_series_add():
    found = in_series(MaterialSpec(stiffness_N_per_mm=2.0), MaterialSpec(stiffness_N_per_mm=6.0))
    assert found.stiffness_N_per_mm == pytest.approx(1.5)


def test_a_grasp_depends_on_its_own_key_alone(experiment):
    fewer = simulate(StiffnessSpec(placements=2, grasps=3))
    rows = experiment.conditions.query("placement <= 2 and grasp <= 3").index
    np.testing.assert_array_equal(fewer.signals, experiment.signals[rows])
    other = simulate(StiffnessSpec(placements=1, grasps=1, seed=1))
    assert not np.array_equal(other.signals, fewer.signals[[0, 6, 12]])


def test_every_placement_has_a_taxel_near_its_contact():
    spec = StiffnessSpec(jitter_position_mm=0.0, jitter_turn_deg=0.0)
    x, y = np.array(spec.taxel_x_mm), np.array(spec.taxel_y_mm)
    for placement in range(1, 40):
        found = draw_grasp(spec, "SR", placement, 1)
        turn = np.deg2rad(found.turn_deg)
        assert np.abs((x - found.offset_mm) * np.cos(turn) + y * np.sin(turn)).min() <= spec.contact_mm
        assert abs(found.offset_mm) <= spec.reach_mm


def test_a_patch_has_its_own_gains():
    assert patch_gains(StiffnessSpec(seed=1)).tolist() != patch_gains(StiffnessSpec(seed=2)).tolist()
    assert patch_gains(STILL).tolist() == [1.0] * 4


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"taxel_x_mm": (0.0,)}, "one each per taxel"),
        ({"gap_mm": (5.0, 2.0)}, "shorter first"),
        ({"gap_mm": (5.0, 40.0)}, "raise speed_mm_per_s"),
        ({"objects": {}}, "objects"),
    ],
)
def test_what_cannot_be_is_refused(changes, complaint):
    with pytest.raises(InputError, match=complaint):
        StiffnessSpec(**changes)
