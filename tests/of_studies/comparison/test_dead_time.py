"""A dead time drops what comes too soon after a spike of the same afferent, and nothing else."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from neurotact_parts.studies.comparison.dead_time import with_dead_time

from neurotact.data.spikes import from_rasters
from neurotact.data.windows import Windows
from neurotact.errors import InputError

rasters = arrays.arrays(
    np.uint8, st.tuples(st.just(2), st.integers(1, 30), st.integers(1, 3)), elements=st.integers(0, 1)
)


def trains_of(raster):
    conditions = pd.DataFrame({"label": ["a", "b"]})
    return from_rasters(raster, 1000.0, tuple(f"ON taxel{i}" for i in range(raster.shape[2])), conditions)


def raster_of(trains, raster):
    return trains.raster(Windows(np.arange(2), np.zeros(2, np.int64), raster.shape[1]))


@given(rasters, st.integers(0, 6))
def test_spikes_are_those_of_a_neuron_that_is_silent_after_each(raster, steps):
    expected = np.zeros_like(raster)
    for trial in range(2):
        for afferent in range(raster.shape[2]):
            silent_until = -1
            for step in range(raster.shape[1]):
                if raster[trial, step, afferent] and step > silent_until:
                    expected[trial, step, afferent] = 1
                    silent_until = step + steps
    assert (raster_of(with_dead_time(trains_of(raster), steps), raster) == expected).all()


@given(rasters)
def test_no_dead_time_drops_nothing(raster):
    assert (raster_of(with_dead_time(trains_of(raster), 0), raster) == raster).all()


def test_a_negative_dead_time_is_refused():
    with pytest.raises(InputError, match="dead time: must be 0 steps or more"):
        with_dead_time(trains_of(np.ones((2, 3, 1), np.uint8)), -1)
