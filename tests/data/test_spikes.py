"""Spike trains are events and rasters alike."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.baselines.features import bin_edges
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.windows import Windows, WindowSpec, cut
from neurotact.errors import InputError

N_AFFERENTS = 4
RASTERS = st.lists(
    st.integers(1, 12).flatmap(lambda n: hnp.arrays(np.uint8, (n, N_AFFERENTS), elements=st.integers(0, 1))),
    min_size=1, max_size=4,
)  # fmt: skip


def trains_of(rasters) -> SpikeTrains:
    names = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")
    return from_rasters(rasters, 1000.0, names, pd.DataFrame({"label": [f"c{i % 2}" for i in range(len(rasters))]}))


@given(RASTERS)
def test_a_raster_comes_back_from_its_events(rasters):
    trains = trains_of(rasters)
    assert trains.trial_steps.tolist() == [len(r) for r in rasters]
    for trial, raster in enumerate(rasters):
        whole = Windows(np.array([trial]), np.array([0]), len(raster))
        np.testing.assert_array_equal(trains.raster(whole)[0], raster)


@given(RASTERS)
def test_events_are_in_order_of_time_and_as_many_as_the_spikes(rasters):
    trains = trains_of(rasters)
    for steps, units, raster in zip(trains.steps, trains.units, rasters, strict=True):
        assert len(steps) == len(units) == raster.sum()
        assert (np.diff(steps) >= 0).all()


@given(RASTERS, st.integers(1, 12), st.integers(1, 5))
def test_a_window_of_the_events_is_the_slice_of_the_raster(rasters, length, hop):
    trains = trains_of(rasters)
    windows = cut(trains.trial_steps, 1000.0, WindowSpec(length_ms=min(length, *map(len, rasters), 12), hop_ms=hop))
    found = trains.raster(windows)
    for i, (trial, start) in enumerate(zip(windows.trial, windows.start, strict=True)):
        np.testing.assert_array_equal(found[i], rasters[trial][start : start + windows.n_steps])


@given(RASTERS, st.integers(1, 12), st.integers(1, 5), st.integers(1, 12))
def test_counts_in_bins_are_sums_of_the_raster(rasters, length, hop, n_bins):
    trains = trains_of(rasters)
    windows = cut(trains.trial_steps, 1000.0, WindowSpec(length_ms=min(length, *map(len, rasters), 12), hop_ms=hop))
    edges = bin_edges(windows.n_steps, min(n_bins, windows.n_steps))
    expected = np.add.reduceat(trains.raster(windows), edges[:-1], axis=1, dtype=np.int64)
    np.testing.assert_array_equal(trains.binned(windows, edges), expected)


@given(RASTERS, st.randoms())
def test_a_selection_keeps_spikes_and_conditions_together(rasters, random):
    trains = trains_of(rasters)
    order = random.sample(range(len(rasters)), random.randint(1, len(rasters)))
    chosen = trains.select(np.array(order))
    assert chosen.conditions.label.tolist() == [f"c{i % 2}" for i in order]
    assert chosen.trial_steps.tolist() == [len(rasters[i]) for i in order]
    for place, trial in enumerate(order):
        np.testing.assert_array_equal(chosen.steps[place], trains.steps[trial])
        np.testing.assert_array_equal(chosen.units[place], trains.units[trial])


def test_spike_trains_are_chosen_by_lists_and_masks_of_their_length_alone():
    trains = trains_of([np.zeros((1 + i, N_AFFERENTS), np.uint8) for i in range(3)])
    assert trains.select([2, 0]).trial_steps.tolist() == [3, 1]
    assert trains.select([True, False, True]).trial_steps.tolist() == [1, 3]
    assert trains != trains.select([0, 1, 2])
    for wrong in ([True], [3], [], [0.0]):
        with pytest.raises(InputError, match=r"^select: "):
            trains.select(wrong)


def test_the_first_half_of_the_afferents_is_slowly_adapting():
    assert trains_of([np.zeros((1, N_AFFERENTS), np.uint8)]).is_sa.tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": [np.array([3, 1])], "units": [np.array([0, 1])]}, "trial 0 has spikes out of order"),
        # Whole numbers without a sign wrap around where they fall, so that their differences are never negative.
        ({"steps": [np.array([3, 1], np.uint16)], "units": [np.array([0, 1])]}, "trial 0 has spikes out of order"),
        ({"steps": [np.array([-1, 1])], "units": [np.array([0, 1])]}, "outside its time"),
        ({"steps": [np.array([1, 5])], "units": [np.array([0, 1])]}, "outside its time"),
        ({"steps": [np.array([1, 2])], "units": [np.array([0, 4])]}, "or its afferents"),
        ({"steps": [np.array([1, 2])], "units": [np.array([-1, 0])]}, "or its afferents"),
        ({"steps": [np.array([1, 2])], "units": [np.array([0])]}, "trial 0 has spikes"),
        ({"steps": [np.array([[1, 2]])], "units": [np.array([[0, 1]])]}, "trial 0 has spikes"),
        ({"steps": [np.array([0.5, 1])], "units": [np.array([0, 1])]}, "trial 0 has spikes"),
        ({"trial_steps": np.array([[5]])}, "trial_steps: must be a whole number per trial; got int64 of shape (1, 1)"),
        ({"trial_steps": np.array([5.0])}, "trial_steps: must be a whole number per trial; got float64"),
        ({"trial_steps": np.array([2**62])}, "trial_steps: must lie between 0 and 2^40 steps; got 4611686018427387904"),
        ({"trial_steps": np.array([-1])}, "trial_steps: must lie between 0 and 2^40 steps; got -1"),
        ({"trial_steps": np.array([5, 5])}, "differ in number of trials"),
        ({"conditions": pd.DataFrame({"label": [""]})}, "trial 0 has an empty label"),
        ({"conditions": pd.DataFrame({"lable": ["a"]})}, "no column 'label'"),
        ({"sampling_rate_Hz": 0.0}, "sampling_rate_Hz must be a positive number"),
    ],
)
def test_spikes_that_do_not_fit_together_are_refused(changes, message):
    with pytest.raises(InputError) as refusal:
        replace(trains_of([np.zeros((5, N_AFFERENTS), np.uint8)]), **changes)
    assert message in str(refusal.value)


def test_a_raster_that_no_memory_holds_is_refused():
    trains = replace(trains_of([np.zeros((5, N_AFFERENTS), np.uint8)]), trial_steps=np.array([2**40]))
    one = Windows(np.array([0]), np.array([0]), 2**40)
    with pytest.raises(InputError, match=r"the raster of 1 windows, \d+ steps and 4 afferents: holds [\d,]+ MB, more"):
        trains.raster(one)
