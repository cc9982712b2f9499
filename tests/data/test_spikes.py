"""Spike trains are events and rasters alike."""

import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.data.windows import Windows, WindowSpec, cut

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


def test_the_first_half_of_the_afferents_is_slowly_adapting():
    assert trains_of([np.zeros((1, N_AFFERENTS), np.uint8)]).is_sa.tolist() == [True, True, False, False]
