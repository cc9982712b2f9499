"""Moments against SciPy, and that pieces give what the whole gives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.stiffness.moments import (
    moments,
    moments_finish,
    moments_start,
    moments_update,
    peak_features,
)
from neurotact_parts.studies.stiffness.peaks import PeakSpec, find_peaks, next_peaks, peaks_start
from scipy import stats

from neurotact.errors import InputError


@given(st.integers(0, 2**32 - 1), st.integers(2, 200), st.integers(1, 4), st.floats(-1e3, 1e3))
def test_moments_are_scipys(seed, n, channels, level):
    signal = level + np.random.default_rng(seed).gamma(2.0, size=(3, n, channels))
    found = moments(signal)
    assert found.shape == (3, 4, channels)
    np.testing.assert_allclose(found[:, 0], signal.mean(axis=1))
    np.testing.assert_allclose(found[:, 1], signal.std(axis=1))
    np.testing.assert_allclose(found[:, 2], stats.skew(signal, axis=1), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found[:, 3], stats.kurtosis(signal, axis=1, fisher=False), rtol=1e-7)


@given(st.integers(0, 2**32 - 1), st.integers(1, 150), st.lists(st.integers(0, 150), max_size=10))
def test_pieces_give_the_moments_of_the_whole(seed, n, cuts):
    signal = np.random.default_rng(seed).gamma(2.0, size=(n, 4)) - 3.0
    state = moments_start(4)
    for piece in np.split(signal, sorted(min(cut, n) for cut in cuts)):
        state = moments_update(state, piece)
    assert state.n == n
    np.testing.assert_allclose(moments_finish(state), moments(signal), rtol=1e-9, atol=1e-9)


def test_a_channel_that_does_not_vary():
    assert moments(np.full((5, 1), 2.0)).ravel().tolist() == [2.0, 0.0, 0.0, 0.0]


def test_the_moving_average_by_hand():
    # alpha 0.5 from 0, 4, 4: 0, 2, 3; mean 5/3.
    peaks = np.array([[[0.0], [4.0], [4.0]]])
    assert peak_features(peaks, 0.5, order=1).tolist() == [[pytest.approx(5 / 3)]]
    assert peak_features(peaks, 1.0, order=1).tolist() == [[pytest.approx(8 / 3)]]


def test_sets_are_prefixes_moment_by_moment():
    peaks = np.random.default_rng(0).standard_normal((5, 150, 4))
    everything = peak_features(peaks, 0.3)
    assert everything.shape == (5, 16)
    np.testing.assert_array_equal(peak_features(peaks, 0.3, order=1), everything[:, :4])
    np.testing.assert_array_equal(peak_features(peaks, 0.3, order=2), everything[:, :8])


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 3000), max_size=8))
def test_the_chain_in_pieces_gives_the_features_of_the_whole(seed, cuts):
    """Recording to features, a piece at a time: the chain as a device runs it."""
    rng = np.random.default_rng(seed)
    signal = 0.2 * rng.standard_normal((3000, 4))
    signal[700:800] -= 5.0 * np.hanning(100)[:, None] * rng.random(4)
    signal[700:800, 0] -= 3.0 * np.hanning(100)
    spec = PeakSpec(threshold=1.5)
    state = peaks_start(4, signal.dtype)
    rows = []
    for piece in np.split(signal, sorted(cuts)):
        found, state = next_peaks(piece, spec, state)
        rows.append(peak_features(found.samples, 0.5))
    whole = peak_features(find_peaks(signal, spec).samples, 0.5)
    assert len(whole) == 1
    np.testing.assert_allclose(np.concatenate(rows), whole, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: moments(np.zeros(5)), "time, channel"),
        (lambda: moments(np.zeros((0, 2))), "no samples"),
        (lambda: moments_update(moments_start(3), np.zeros((5, 2))), "does not fit"),
        (lambda: peak_features(np.zeros((1, 5, 2)), 0.0), "alpha"),
        (lambda: peak_features(np.zeros((1, 5, 2)), 0.5, order=5), "four moments"),
    ],
)
def test_what_cannot_be_is_refused(call, complaint):
    with pytest.raises(InputError, match=complaint):
        call()
