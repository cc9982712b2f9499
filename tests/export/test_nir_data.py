"""Spikes as NIR's data and back."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

import neurotact as nt
from neurotact.data.spikes import from_rasters
from neurotact.errors import InputError

nir = pytest.importorskip("nir")


def trains(raster: np.ndarray, rate_Hz: float):
    names = tuple(f"neuron {index}" for index in range(raster.shape[2]))
    return from_rasters(raster, rate_Hz, names, pd.DataFrame({"label": ["a"] * len(raster)}))


@given(
    seed=st.integers(0, 999), n_trials=st.integers(1, 4), n_steps=st.integers(1, 400), n=st.integers(1, 6),
    rate_Hz=st.sampled_from([1000.0, 2000.0, 44100.0, 20.0, 333.3]),
)  # fmt: skip
@examples(60)
def test_spikes_come_back_gridded_from_a_file_and_as_events(tmp_path, seed, n_trials, n_steps, n, rate_Hz):
    raster = np.random.default_rng(seed).random((n_trials, n_steps, n)) < 0.3
    given_trains = trains(raster, rate_Hz)
    nir.write_data(tmp_path / "spikes.nir", nt.to_nir_data(given_trains))
    data = nir.read_data(tmp_path / "spikes.nir")
    gridded = data.nodes["input"].observables["spikes"]
    assert (gridded.data == raster).all()
    events = gridded.to_event(n_steps * n)
    for back in (nt.from_nir_data(data, ["a"] * n_trials), nt.from_nir_data(events, sampling_rate_Hz=rate_Hz)):
        assert back.sampling_rate_Hz == pytest.approx(rate_Hz)
        assert back.trial_steps.tolist() == given_trains.trial_steps.tolist()
        for name in ("steps", "units"):
            assert [its.tolist() for its in getattr(back, name)] == [
                its.tolist() for its in getattr(given_trains, name)
            ]
    assert nt.from_nir_data(data, ["a"] * n_trials).classes == ("a",)


def test_what_is_no_spikes_is_refused():
    gridded = nt.to_nir_data(trains(np.ones((1, 3, 2), bool), 100.0))
    unequal = from_rasters([np.ones((2, 1)), np.ones((3, 1))], 1.0, ("a",), pd.DataFrame({"label": ["x", "y"]}))
    idx, time = np.array([[0, 0]]), np.array([[0.011, 0.012]])
    for call, complaint in (
        (lambda: nt.to_nir_data(unequal), "trials of 2 to 3 steps; NIR's data have one length"),
        (
            lambda: nt.from_nir_data(gridded, node="hidden"),
            "node: 'hidden' has no spikes in these data; there are input",
        ),
        (lambda: nt.from_nir_data(gridded, ["a", "b"]), "labels: 2 for 1 samples"),
        (lambda: nt.from_nir_data(gridded, sampling_rate_Hz=100.0), "state their own step"),
        (lambda: nt.from_nir_data(nir.TimeGriddedData(np.full((1, 2, 2), 0.5), 0.1)), "other than 0 and 1"),
        (lambda: nt.from_nir_data(nir.EventData(idx, time, 1, 0.1)), "events have no clock"),
        (lambda: nt.from_nir_data(nir.EventData(idx, time, 1, 0.1), sampling_rate_Hz=100.0), "two events of a neuron"),
        (lambda: nt.from_nir_data(nir.EventData(idx, time, 1, 0.01), sampling_rate_Hz=1e3), "outside its 0.01 s"),
        (lambda: nt.from_nir_data(nir.EventData(idx + 1, time, 1, 0.1), sampling_rate_Hz=1e3), "or its neurons"),
        (lambda: nt.from_nir_data(nir.ValuedEventData(idx, time, 1, 0.1, time)), "ValuedEventData, not spikes"),
    ):
        with pytest.raises(InputError, match=complaint):
            call()
