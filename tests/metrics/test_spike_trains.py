import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture.firing import latencies_ms
from neurotact_parts.studies.texture.spike_features import isi_cv, isi_mean_ms

from neurotact.errors import InputError
from neurotact.metrics.spike_trains import (
    events,
    events_of_raster,
    isis_ms,
    rates_Hz,
    spike_counts,
)

RASTER = np.zeros((2, 10, 2), np.uint8)
RASTER[0, [0, 2, 6], 0] = 1  # intervals of 2 and 4 steps
RASTER[1, [1, 9], 0] = 1  # 8 steps
RASTER[1, 5, 1] = 1


@st.composite
def rasters(draw) -> np.ndarray:
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 30), st.integers(1, 4)))
    density = draw(st.floats(0, 1))
    return (np.random.default_rng(draw(st.integers(0, 2**32))).random(shape) < density).astype(np.uint8)


def as_lists(raster: np.ndarray):
    found = [np.nonzero(trial) for trial in raster]
    return events([s for s, _ in found], [u for _, u in found], [raster.shape[1]] * len(raster), raster.shape[2])


def test_definitions_on_a_raster_counted_by_hand():
    rate_Hz = 2000.0  # 10 steps are 5 ms
    assert spike_counts(RASTER).tolist() == [[3, 0], [2, 1]]
    assert rates_Hz(RASTER, rate_Hz).tolist() == [[600.0, 0.0], [400.0, 200.0]]
    intervals = isis_ms(RASTER, rate_Hz)
    assert intervals.trial.tolist() == [0, 0, 1]
    assert intervals.afferent.tolist() == [0, 0, 0]
    assert intervals.isi_ms.tolist() == [1.0, 2.0, 4.0]
    np.testing.assert_array_equal(isi_mean_ms(RASTER, rate_Hz), [[1.5, np.nan], [4.0, np.nan]])
    # Intervals 2 and 4: mean 3, deviation 1. One interval has no variation to speak of.
    np.testing.assert_allclose(isi_cv(RASTER), [[1 / 3, np.nan], [np.nan, np.nan]])


@given(rasters())
def test_the_latency_is_that_of_the_first_spike(raster):
    found = latencies_ms(as_lists(raster), 1000.0)
    for (trial, afferent), latency in np.ndenumerate(found):
        spikes = np.flatnonzero(raster[trial, :, afferent])
        assert latency == spikes[0] if len(spikes) else np.isnan(latency)


@given(rasters())
@examples(60)
def test_events_and_rasters_agree(raster):
    for found in (as_lists(raster), events_of_raster(raster)):
        assert np.array_equal(spike_counts(found), spike_counts(raster))
        np.testing.assert_array_equal(rates_Hz(found, 2000.0), rates_Hz(raster, 2000.0))
        np.testing.assert_array_equal(isi_cv(found), isi_cv(raster))
        for a, b in zip(isis_ms(found, 2000.0), isis_ms(raster, 2000.0), strict=True):
            np.testing.assert_array_equal(a, b)


@given(rasters())
@examples(60)
def test_intervals_are_the_differences_within_each_trial_and_afferent(raster):
    intervals = isis_ms(raster, 1000.0)
    cv = isi_cv(raster)
    for trial in range(raster.shape[0]):
        for afferent in range(raster.shape[2]):
            expected = np.diff(np.flatnonzero(raster[trial, :, afferent]))
            mine = (intervals.trial == trial) & (intervals.afferent == afferent)
            np.testing.assert_array_equal(intervals.isi_ms[mine], expected)
            if len(expected) < 2:
                assert np.isnan(cv[trial, afferent])
            else:
                assert cv[trial, afferent] == pytest.approx(expected.std() / expected.mean(), abs=1e-12)


def test_a_regular_train_and_a_poisson_train():
    regular = np.zeros((5, 1000, 1), np.uint8)
    regular[:, ::10] = 1
    assert isi_cv(regular) == pytest.approx(0.0)
    poisson = np.random.default_rng(0).random((500, 4000, 1)) < 0.02
    assert np.nanmean(isi_cv(poisson)) == pytest.approx(1.0, abs=0.1)


def test_trials_of_different_lengths():
    found = events([np.array([8, 0, 4]), np.array([3])], [np.array([1, 1, 0]), np.array([0])], np.array([20, 5]), 2)
    assert rates_Hz(found, 1000.0).tolist() == [[50.0, 100.0], [200.0, 0.0]]
    assert isis_ms(found, 1000.0).isi_ms.tolist() == [8.0]


def test_nothing_at_all():
    empty = events([], [], np.array([], int), 3)
    assert spike_counts(empty).shape == (0, 3)
    assert isi_cv(empty).shape == (0, 3)
    assert isis_ms(np.zeros((2, 5, 3), np.uint8), 1000.0).isi_ms.size == 0


@pytest.mark.parametrize(
    ("steps", "units", "lengths", "complaint"),
    [
        ([[10]], [[0]], [10], "trial 0 has a spike of afferent 0 at step 10"),
        ([[-1]], [[0]], [10], "outside"),
        ([[1]], [[2]], [10], "afferent 2"),
        ([[1, 1]], [[0, 0]], [10], "twice"),
        ([[1, 2]], [[0]], [10], "more steps than units"),
        ([[1]], [[0], [0]], [10], "1 trials of steps, 2 of units"),
        ([[1]], [[0]], [10, 10], "2 lengths"),
    ],
)
def test_events_that_do_not_fit_are_refused(steps, units, lengths, complaint):
    with pytest.raises(InputError, match=complaint):
        events([np.array(s) for s in steps], [np.array(u) for u in units], np.array(lengths), 2)


def test_rasters_and_rates_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="zeros and ones"):
        spike_counts(np.full((1, 2, 2), 2, np.uint8))
    with pytest.raises(InputError, match="shape"):
        spike_counts(np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match="sampling_rate_Hz"):
        rates_Hz(RASTER, 0.0)
    with pytest.raises(InputError, match="without steps"):
        rates_Hz(np.zeros((1, 0, 2), np.uint8), 1000.0)
