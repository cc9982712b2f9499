"""Features of spike trains, counted by hand and by loops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture import spike_features as features

from neurotact.errors import InputError
from neurotact.metrics.spike_trains import events_of_raster, rates_Hz


@st.composite
def rasters(draw) -> np.ndarray:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(6, 40), st.integers(1, 4)))
    density = draw(st.floats(0, 1))
    return (np.random.default_rng(draw(st.integers(0, 2**32))).random(shape) < density).astype(np.uint8)


EVERY = {
    "rates": lambda x: rates_Hz(x, 2000.0),
    "isis": lambda x: features.mean_isis(x, 2000.0),
    "variations": features.isi_variations,
    "fano": lambda x: features.bin_fano_factors(x, 3),
    "pairs": lambda x: features.co_occurrences(x, 4),
    "delays": lambda x: features.delayed_traces(x, 2000.0, tau_ms=2.0, delay_ms=1.0, n_delays=3),
    "images": lambda x: features.grey_images(x, 3, 2),
}


@pytest.mark.parametrize("feature", EVERY.values(), ids=EVERY.keys())
@given(raster=rasters())
@examples(25)
def test_a_row_a_trial_finite_alike_for_rasters_and_events(feature, raster):
    found = feature(raster)
    assert len(found) == len(raster)
    assert np.isfinite(found).all()
    assert np.array_equal(found, feature(events_of_raster(raster)))
    for trial in range(len(raster)):  # no trial sees another
        assert np.array_equal(feature(raster[trial : trial + 1])[0], found[trial])


@given(rasters(), st.integers(0, 8))
@examples(40)
def test_co_occurrences_are_the_pairs_within_the_lag(raster, lag):
    found = features.co_occurrence(raster, lag)
    assert np.array_equal(found, found.transpose(0, 2, 1))
    for trial in range(len(raster)):
        times = [np.flatnonzero(train) for train in raster[trial].T]
        for a, mine in enumerate(times):
            for b, its in enumerate(times):
                near = (abs(mine[:, None] - its[None, :]) <= lag).sum()
                assert found[trial, a, b] == ((near - len(mine)) // 2 if a == b else near)


@given(rasters())
@examples(25)
def test_a_lag_as_long_as_the_window_pairs_every_spike_with_every_other(raster):
    counts = raster.sum(axis=1, dtype=int)
    found = features.co_occurrence(raster, raster.shape[1])
    expected = counts[:, :, None] * counts[:, None, :]
    itself = np.arange(raster.shape[2])
    expected[:, itself, itself] = counts * (counts - 1) // 2
    assert np.array_equal(found, expected)


def test_the_triangle_holds_each_pair_of_afferents_once():
    raster = np.zeros((1, 5, 3), np.uint8)
    raster[0, 0] = 1  # all three fire together
    assert features.co_occurrences(raster, 0).tolist() == [[0, 1, 1, 0, 1, 0]]


@given(rasters(), st.integers(1, 3))
@examples(40)
def test_the_fano_factor_of_bins_is_that_of_trials_made_of_the_bins(raster, bin_steps):
    n_bins = raster.shape[1] // bin_steps
    cut = raster[:, : n_bins * bin_steps].reshape(len(raster), n_bins, bin_steps, -1)
    found = features.bin_fano_factors(raster, bin_steps)
    for mine, trial in zip(found, cut, strict=True):
        counts = trial.sum(axis=1, dtype=int)
        np.testing.assert_allclose(mine, counts.var(axis=0) / np.maximum(counts.mean(axis=0), 1e-9), atol=1e-12)


@given(rasters(), st.floats(0.3, 20.0), st.integers(1, 8))
@examples(40)
def test_traces_are_those_of_a_leaky_sum(raster, tau_ms, n_delays):
    found = features.delayed_traces(raster, 1000.0, tau_ms=tau_ms, delay_ms=2.0, n_delays=n_delays)
    trace, every = np.zeros((len(raster), raster.shape[2])), []
    for step in range(raster.shape[1]):
        trace = trace * np.exp(-1 / tau_ms) + raster[:, step]
        every.append(trace)
    back = [raster.shape[1] - 1 - 2 * k for k in range(n_delays)]
    expected = [every[step] if step >= 0 else np.zeros_like(trace) for step in back]
    np.testing.assert_allclose(found, np.concatenate(expected, axis=1), atol=1e-9)


@given(rasters(), st.integers(1, 5), st.integers(1, 4))
@examples(40)
def test_an_image_is_as_bright_as_its_bins_are_full(raster, columns, white):
    images = features.grey_images(raster, columns, white)
    assert images.dtype == np.uint8
    assert images.shape == (len(raster), raster.shape[2], columns)
    width = raster.shape[1] // columns
    for column in range(columns):
        stop = raster.shape[1] if column == columns - 1 else (column + 1) * width
        counts = raster[:, column * width : stop].sum(axis=1, dtype=int)
        assert np.array_equal(images[:, :, column], np.minimum(counts, white) * 255 // white)


def test_silent_afferents_have_a_say_and_no_nan():
    silent = np.zeros((1, 20, 2), np.uint8)
    silent[0, 5, 0] = 1
    assert features.mean_isis(silent, 2000.0).tolist() == [[10.0, 10.0]]  # the window: no interval was shorter
    assert features.isi_variations(silent).tolist() == [[0.0, 0.0]]
    assert features.bin_fano_factors(silent, 10).tolist() == [[0.5, 0.0]]


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda x: features.bin_fano_factors(x, 20), "leave 1 bins"),
        (lambda x: features.bin_fano_factors(x, 0), "bin_steps: must be >= 1"),
        (lambda x: features.co_occurrence(x, -1), "lag_steps: must be >= 0"),
        (lambda x: features.grey_images(x, 21, 1), "no 21 columns"),
        (lambda x: features.grey_images(x, 2, 0), "white: must be >= 1"),
        (lambda x: features.delayed_traces(x, 1e3, tau_ms=1.0, delay_ms=1.0, n_delays=0), "n_delays: must be >= 1"),
        (lambda x: features.mean_isis(events_of_raster(x)._replace(trial_steps=np.array([20, 10])), 1e3), "one length"),
    ],
)
def test_what_makes_no_feature_is_refused(call, complaint):
    with pytest.raises(InputError, match=complaint):
        call(np.zeros((2, 20, 2), np.uint8))
