"""Laws of the simulated touches: stress, movement, electronics, seeds, and the published signal facts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.touch_modality.activity import ActivityBand, find_activity
from neurotact_parts.studies.touch_modality.contacts import (
    BrushSpec,
    FingerSpec,
    Motion,
    WasherSpec,
    contact_stress,
    touch,
)
from neurotact_parts.studies.touch_modality.simulator import (
    MODALITIES,
    TOUCHES,
    Stroke,
    TouchModalitySpec,
    each_person,
    move,
    record,
    simulate,
)

from neurotact.errors import InputError
from neurotact.spec import build

SPEC = TouchModalitySpec(people=2)
SHORT = TouchModalitySpec(people=2, recording_s=2.0, hesitation_s=0.1, duration_s=0.5)
QUIET = {"noise_mV_rms": 0.0, "hum_mV": 0.0, "offset_mV": 0.0}
STROKE = Stroke(1.0, 2.0, 1, 34.0, 0.0, 0.0, 0.5, 0.0, backwards=False)
GAINS = np.ones(16)


def resting_tool(n=400, load_N=1.0):
    still = np.zeros(n)
    return Motion(still, still, still, np.full(n, load_N), 3000.0)


@pytest.fixture(scope="module")
def people():
    """Eight people, as (label, activity or None, peak deviation in mV)."""
    rows = []
    for signals, table in each_person(TouchModalitySpec(people=8)):
        for signal, label in zip(signals, table.label, strict=True):
            peak_mV = 1e3 * np.abs(signal - 1.65).max()
            rows.append((label, find_activity(signal, ActivityBand()), peak_mV))
    return rows


def test_everybody_touches_twelve_times():
    touches = simulate(SHORT)
    assert np.asarray(touches.signals).shape == (2 * TOUCHES, 6000, 16)
    assert (touches.unit, touches.sampling_rate_Hz) == ("V", 3000.0)
    assert (touches.conditions.groupby(["person", "label", "direction"]).size() == 2).all()
    assert list(touches.conditions.person) == [0] * TOUCHES + [1] * TOUCHES


def test_seed_repeats_bit_for_bit_and_fewer_people_are_a_prefix():
    two, one = list(each_person(SHORT)), list(each_person(SHORT.model_copy(update={"people": 1})))
    np.testing.assert_array_equal(two[0][0], one[0][0])
    assert two[0][1].equals(one[0][1])
    other = next(each_person(SHORT.model_copy(update={"seed": 1})))
    assert not np.array_equal(other[0], one[0][0])


@pytest.mark.parametrize("tool", [FingerSpec(), BrushSpec(), WasherSpec()], ids=["finger", "brush", "washer"])
def test_stress_integrates_to_the_load(tool):
    """A fine grid of taxels far beyond the contact sums up to the force, but for the share that vibrates."""
    motion = resting_tool(load_N=0.7)
    contact = touch(tool, motion, 0.3, np.random.default_rng(0))
    grid_mm = np.arange(-45.0, 45.1, 1.5)
    field = contact_stress(contact, motion, grid_mm, cover_mm=3.0)
    force_N = field.sum(axis=1) * 1e-3 * 1.5**2
    np.testing.assert_allclose(force_N, 0.7 * contact.share.sum(axis=1) * (1 + contact.vibration), rtol=1e-6)
    assert np.mean(force_N) == pytest.approx(0.7, rel=0.6)  # at rest a tuft, an oval rim keeps whatever load it has


def test_the_brush_is_wide_and_the_washer_narrow():
    across_mm = {}
    for name, tool in {"finger": FingerSpec(), "brush": BrushSpec(), "washer": WasherSpec()}.items():
        motion = resting_tool()
        contact = touch(tool, motion, 0.0, np.random.default_rng(1))
        grid_mm = np.arange(-40.0, 40.1, 1.0)
        field = contact_stress(contact, motion, grid_mm, 3.0).mean(axis=0).reshape(len(grid_mm), -1).sum(axis=1)
        mean_mm = (field * grid_mm).sum() / field.sum()
        across_mm[name] = np.sqrt((field * (grid_mm - mean_mm) ** 2).sum() / field.sum())
    assert across_mm["washer"] < across_mm["finger"] < across_mm["brush"]


def test_a_vertical_stroke_is_a_horizontal_one_transposed():
    spec = SPEC.model_copy(update=QUIET)
    both = [record(spec, STROKE, "sliding", d, GAINS, np.random.default_rng(2)) for d in ("horizontal", "vertical")]
    turned = both[1].reshape(-1, 4, 4).transpose(0, 2, 1).reshape(-1, 16)
    np.testing.assert_array_equal(both[0], turned)


@given(passes=st.integers(1, 3), backwards=st.booleans(), duration_s=st.floats(0.3, 4.0))
def test_a_movement_covers_its_span_and_rests_at_its_ends(passes, backwards, duration_s):
    stroke = STROKE._replace(passes=passes, backwards=backwards, duration_s=duration_s)
    motion = move(SPEC, stroke, np.random.default_rng(3))
    assert np.ptp(motion.along_mm) == pytest.approx(34.0, rel=1e-3)
    assert motion.travelled_mm[-1] == pytest.approx(34.0 * passes, rel=0.02)
    assert motion.along_mm[0] == pytest.approx(17.0 if backwards else -17.0)
    assert abs(motion.speed_mm_per_s[0]) < 1e-9
    slope = np.gradient(motion.along_mm, 1 / 3000.0)
    np.testing.assert_allclose(slope[1:-1], motion.speed_mm_per_s[1:-1], atol=0.02 * np.abs(slope).max() + 1e-9)
    assert motion.load_N[0] == 0
    assert motion.load_N.max() <= 0.5 * (1 + SPEC.tremor)


def test_a_constant_press_is_forgotten_with_the_high_pass_constant():
    spec = SPEC.model_copy(update={**QUIET, "tremor": 0.0, "wobble_mm": 0.0, "span_mm": 0.0})
    stroke = STROKE._replace(span_mm=0.0, duration_s=3.0, across_mm=5.0, middle_mm=5.0, force_N=5.0)
    signal = record(spec, stroke, "sliding", "horizontal", GAINS, np.random.default_rng(4))[:, 10] - 1.65
    assert signal[:2990] == pytest.approx(0, abs=spec.step_mV * 1e-3)
    pressed = signal[3000 + 600 : 3000 + 1800]
    assert pressed.min() < -0.05  # a press is negative
    time_s = np.arange(len(pressed)) / 3000.0
    slope = np.polyfit(time_s, np.log(-pressed), 1)[0]
    assert slope == pytest.approx(-2 * np.pi * spec.high_pass_Hz, rel=0.05)
    assert signal[3000 + 9000 :].max() > 0.05  # and a release positive


def test_voltages_are_quantised_and_saturate():
    spec = SPEC.model_copy(update={"sensitivity_mV_per_kPa": 1e5})
    signal = record(spec, STROKE, "sliding", "horizontal", GAINS, np.random.default_rng(5))
    assert signal.min() >= 0
    assert signal.max() <= 3.3 + 1e-3
    steps = np.asarray(signal, np.float64) * 1e3 / spec.step_mV
    np.testing.assert_allclose(steps, np.round(steps), atol=2e-3)


def test_ridges_vibrate_at_speed_over_ridge_distance():
    tool, rate_Hz, speed = FingerSpec(stick_depth=0.0), 3000.0, 45.0
    n = 6000
    motion = Motion(np.zeros(n), np.zeros(n), np.full(n, speed), np.ones(n), rate_Hz)
    vibration = touch(tool, motion, 0.0, np.random.default_rng(6)).vibration
    spectrum = np.abs(np.fft.rfft(vibration)) ** 2
    frequency_Hz = np.fft.rfftfreq(n, 1 / rate_Hz)
    assert (spectrum * frequency_Hz).sum() / spectrum.sum() == pytest.approx(speed / tool.ridge_mm, rel=0.25)


def test_rest_stays_inside_the_activity_band():
    spec = TouchModalitySpec(people=1, sensitivity_mV_per_kPa=1e-6)
    assert all(find_activity(s, ActivityBand()) is None for signals, _ in each_person(spec) for s in signals)


def test_a_touch_is_silent_when_it_is_too_light(people):
    """About 7 of 96, as 60 of 840, by the range in which people's habits spread it."""
    silent = sum(activity is None for _, activity, _ in people)
    assert 1 <= silent <= 16
    assert all((peak_mV <= 30.5) == (activity is None) for _, activity, peak_mV in people)


@pytest.mark.slow
def test_seventy_people_touch_as_published():
    """60 of 840 patterns silent, 20 of each modality; activity of about 2 s; a few onsets too late for 6144 samples."""
    silent, seconds, late = dict.fromkeys(MODALITIES, 0), [], 0
    for signals, table in each_person(TouchModalitySpec()):
        for signal, label in zip(signals, table.label, strict=True):
            activity = find_activity(signal, ActivityBand())
            silent[label] += activity is None
            if activity:
                seconds.append((activity.last - activity.first) / 3000.0)
                late += activity.first > 30000 - 6144
    assert all(count == pytest.approx(20, abs=4) for count in silent.values())
    assert np.mean(seconds) == pytest.approx(2.0, abs=0.1)
    assert 0 < late < 10


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"people": 0}, "people: must be >= 1"),
        ({"back_and_forth": [0.5, 0.4]}, "shares >= 0 that sum to 1"),
        ({"low_pass_Hz": 1600.0}, "low_pass_Hz must be below half"),
        ({"baseline_V": 4.0}, "baseline_V must lie between"),
        ({"recording_s": 1.0}, "at least 1 s after start_s"),
        ({"finger": {"pad": 3}}, "did you mean 'pad_mm'"),
        ({"force_spread": [-1, 0]}, r"force_spread\.0: must be >= 0"),
    ],
)
def test_spec_refuses_what_does_not_fit(table, words):
    with pytest.raises(InputError, match=words):
        build(TouchModalitySpec, table, "here")
