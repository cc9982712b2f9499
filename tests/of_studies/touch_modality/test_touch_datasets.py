"""Datasets A, B and C: exact windows on a ramp, exact inverses, and the authors' public code as an oracle."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.touch_modality.datasets import (
    STEP_COUNTS,
    TOUCH_SAMPLES,
    dataset_b,
    dataset_c,
    window_bounds,
)
from neurotact_parts.studies.touch_modality.touches import TouchData, touches_of

from neurotact.data.hdf5 import save_recordings
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError

RAMP = np.arange(TOUCH_SAMPLES, dtype=np.float64)[None, :, None] * np.ones(16)


def public_code(pattern, out=20, slot=614):
    """Dataset_C.m as its authors published it for N = 20, in its own 1-based inclusive indices."""
    means = np.zeros((out, pattern.shape[1]))
    u = 1
    for e in range(1, out + 1):
        stop = slot + u if e < out else len(pattern)
        means[e - 1] = pattern[u - 1 : stop].mean(axis=0)
        u += slot // 2
    return means


def algorithm_1(sensor, n_steps):
    """Algorithm 1 of the paper for one sensor, its index slips (u for j in both conditions) mended."""
    slot = len(sensor) // n_steps
    u, means = 1, []
    for j in range(1, n_steps + 1):
        means.append(sensor[u - 1 : slot + u].mean() if j < n_steps else sensor[u - 1 :].mean())
        u += slot // 2
    return np.array(means)


def touches_in(folder, signals):
    """What `touches_of` makes of recordings of these signals, the first two slides and the others rolls."""
    labels = pd.DataFrame({"label": ["sliding"] * 2 + ["rolling"] * (len(signals) - 2)})
    save_recordings(Recordings(signals, 3000.0, "V", labels), folder / "touches.h5")
    return touches_of(TouchData(recordings=str(folder / "touches.h5")))


def test_a_drops_silent_recordings_and_says_how_many_there_were(tmp_path):
    rng = np.random.default_rng(0)
    signals = [1.65 + 0.02 * rng.uniform(-1, 1, (8000, 16)) for _ in range(5)]
    for index, onset in ((1, 700), (4, 7990)):
        signals[index][onset:, 7] = 1.9
    touches = touches_in(tmp_path, signals)
    assert touches.labels.tolist() == ["rolling", "sliding"]
    assert touches.recorded == {"sliding": 2, "rolling": 3}
    assert touches.patterns.shape == (2, TOUCH_SAMPLES, 16)
    np.testing.assert_array_equal(touches.patterns[0], signals[4][-TOUCH_SAMPLES:].astype(np.float32))
    np.testing.assert_array_equal(touches.patterns[1], signals[1][650 : 650 + TOUCH_SAMPLES].astype(np.float32))


def test_a_of_silent_recordings_alone_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"touches\.h5: no signal leaves the band 1\.62 to 1\.68 V"):
        touches_in(tmp_path, [np.full((7000, 16), 1.65)] * 3)


def test_b_is_24_images_whose_blocks_slide_as_filters_do():
    pattern = np.random.default_rng(1).normal(size=(1, TOUCH_SAMPLES, 16))
    images = dataset_b(pattern)
    assert images.shape == (1, 24, 64, 64)
    for frame in (0, 1, 15, 16, 17, 255, 256, 6143):
        image, place = divmod(frame, 256)
        row, column = divmod(place, 16)
        block = images[0, image, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        np.testing.assert_array_equal(block, pattern[0, frame].reshape(4, 4))


@given(n_patterns=st.integers(1, 3), n_images=st.integers(1, 4), seed=st.integers(0, 99))
def test_b_has_an_exact_inverse(n_patterns, n_images, seed):
    patterns = np.random.default_rng(seed).normal(size=(n_patterns, 256 * n_images, 16))
    images = dataset_b(patterns)
    framed = images.reshape(n_patterns, n_images, 16, 4, 16, 4)
    np.testing.assert_array_equal(framed.transpose(0, 1, 2, 4, 3, 5).reshape(patterns.shape), patterns)


def test_b_refuses_what_fills_no_image():
    with pytest.raises(InputError, match="patterns of 100 samples and 16 channels do not fill images"):
        dataset_b(np.zeros((1, 100, 16)))


@pytest.mark.parametrize("n_steps", STEP_COUNTS)
def test_c_on_a_ramp_is_the_middle_of_each_window(n_steps):
    hop = TOUCH_SAMPLES // n_steps
    start = hop * np.arange(n_steps)
    middle = start + (2 * hop - 1) / 2
    middle[-1] = (start[-1] + TOUCH_SAMPLES - 1) / 2
    np.testing.assert_array_equal(dataset_c(RAMP, n_steps)[0, :, 3], middle.astype(np.float32))


@pytest.mark.parametrize("n_steps", STEP_COUNTS)
def test_printed_c_on_a_ramp_is_algorithm_1(n_steps):
    slot = TOUCH_SAMPLES // n_steps
    start = (slot // 2) * np.arange(n_steps)
    middle = start + slot / 2
    middle[-1] = (start[-1] + TOUCH_SAMPLES - 1) / 2
    np.testing.assert_array_equal(dataset_c(RAMP, n_steps, "printed")[0, :, 3], middle.astype(np.float32))
    sensor = np.random.default_rng(2).normal(size=TOUCH_SAMPLES)
    ours = dataset_c(sensor[None, :, None], n_steps, "printed")[0, :, 0]
    np.testing.assert_allclose(ours, algorithm_1(sensor, n_steps), rtol=1e-5, atol=1e-7)


def test_printed_windows_cover_only_half_before_the_last():
    bounds = window_bounds(TOUCH_SAMPLES, 20, "printed")
    assert bounds[-2, 1] < TOUCH_SAMPLES / 2
    assert bounds[-1, 1] - bounds[-1, 0] > TOUCH_SAMPLES / 2


def test_the_public_code_at_20_steps_is_ours_but_for_one_sample():
    """Its windows are 614 + 1 samples every 307: on a ramp, half a sample later; the last window is the same."""
    theirs, ours = public_code(RAMP[0]), dataset_c(RAMP, 20)[0]
    np.testing.assert_array_equal(theirs[:-1] - ours[:-1], 0.5)
    np.testing.assert_array_equal(theirs[-1], ours[-1])
    pattern = np.random.default_rng(3).normal(size=(TOUCH_SAMPLES, 16))
    step = np.abs(public_code(pattern) - dataset_c(pattern[None], 20)[0])
    assert step.max() < np.ptp(pattern) / 614


@given(n_samples=st.integers(1, 7000), n_steps=st.integers(1, 300), rule=st.sampled_from(["overlap", "printed"]))
def test_windows_lie_in_the_pattern_and_reach_both_its_ends(n_samples, n_steps, rule):
    try:
        bounds = window_bounds(n_samples, n_steps, rule)
    except InputError:
        assert n_samples // n_steps // (1 if rule == "overlap" else 2) < 1
        return
    assert bounds.shape == (n_steps, 2)
    assert (bounds[:, 0] < bounds[:, 1]).all()
    assert bounds[0, 0] == 0
    assert bounds[-1, 1] == n_samples
    assert (bounds <= n_samples).all()
    if rule == "overlap":
        assert (bounds[1:, 0] <= bounds[:-1, 1]).all()  # no sample is left out


@given(shift=st.floats(-5, 5), scale=st.floats(0.1, 10))
def test_c_commutes_with_shift_and_scale(shift, scale):
    patterns = np.random.default_rng(4).normal(size=(2, 640, 3))
    np.testing.assert_allclose(
        dataset_c(patterns * scale + shift, 10), dataset_c(patterns, 10) * scale + shift, rtol=1e-5, atol=1e-5
    )
