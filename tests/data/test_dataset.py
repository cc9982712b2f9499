"""A data set has one source, which decides what a study is of, wherever it lies; its trials are the same as arrays."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.comparison.set_arrays import as_arrays, from_arrays

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.dataset import DatasetSpec, load_recordings, load_touches, until
from neurotact.data.digests import content_digest
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.errors import InputError
from neurotact.spec import build


def made(lengths=(30, 40), rate_Hz=100.0) -> Recordings:
    noise = np.random.default_rng(0)
    signals = [noise.normal(size=(length, 2)).astype(np.float32) for length in lengths]
    return Recordings(signals, rate_Hz, "mV", [f"class{trial % 2}" for trial in range(len(lengths))])


def of_arrays(**keys) -> DatasetSpec:
    return build(DatasetSpec, {"arrays": {"path": "a.npz", "sampling_rate_Hz": 20.0, "unit": "count"} | keys}, "test")


def test_the_rate_and_the_unit_of_arrays_decide_and_their_place_does_not():
    here, moved = of_arrays(), of_arrays(path="b.npz")
    assert here.identity() == moved.identity()
    assert here.identity() != of_arrays(unit="mV").identity()
    assert here.identity() != of_arrays(sampling_rate_Hz=21.0).identity()


def test_arrays_of_a_study_are_read_as_a_user_reads_them(tmp_path):
    path = str(tmp_path / "a.npz")
    np.savez(path, X=np.random.default_rng(0).normal(size=(4, 30, 2)), label=["felt", "silk"] * 2)
    read = load_touches(of_arrays(path=path))
    assert isinstance(read, Recordings)
    assert (read.sampling_rate_Hz, read.unit) == (20.0, "count")
    assert content_digest(read) == content_digest(nt.read_arrays(path, 20.0, "count"))


@given(st.floats(1.0, 600.0), st.sampled_from([35.6, 100.0, 2000.0]))
@examples(20)
def test_a_beginning_holds_the_sample_at_its_end(end_ms, rate_Hz):
    whole = made((2000, 10), rate_Hz)
    long, short = until(whole, end_ms).signals
    assert (len(long) - 1) / rate_Hz >= end_ms * 1e-3 - 1e-6 > (len(long) - 2) / rate_Hz - 1e-6
    assert len(short) == min(10, len(long))
    np.testing.assert_array_equal(long, whole.signals[0][: len(long)])


@given(st.lists(st.integers(1, 20), min_size=2, max_size=4), st.integers(0, 99))
@examples(5)
def test_spikes_are_the_same_after_they_were_arrays(lengths, seed):
    noise = np.random.default_rng(seed)
    rasters = [(noise.random((length, 3)) < 0.3).astype(np.uint8) for length in lengths]
    conditions = pd.DataFrame({"label": ["a", "b"] * 2, "speed": 1.5}).iloc[: len(lengths)]
    given_ = from_rasters(rasters, 200.0, ("k1", "k2", "k3"), conditions)
    found = from_arrays(as_arrays(given_), "test")
    assert isinstance(found, SpikeTrains)
    assert content_digest(found) == content_digest(given_)
    assert found.trial_steps.tolist() == lengths


def test_other_trials_than_those_of_the_spec_are_refused(tmp_path):
    touches = made()
    hdf5.save_recordings(touches, tmp_path / "touches.h5")
    spec = DatasetSpec(file=str(tmp_path / "touches.h5"), content=content_digest(touches))
    assert content_digest(load_recordings(spec)) == spec.content
    with pytest.raises(InputError, match="its trials changed since this study began"):
        load_touches(spec.model_copy(update={"content": "0" * 16}))


def test_of_a_file_no_more_is_read_than_the_trials_that_are_used(tmp_path, monkeypatch):
    """So a first look at a file above the limit on one input needs no other limit."""
    every = made([12_500] * 12)
    hdf5.save_recordings(every, tmp_path / "touches.h5")
    monkeypatch.setenv("NEUROTACT_MAX_MB", "1")
    with pytest.raises(InputError, match="holds 1 MB, more than the limit of 1 MB; set NEUROTACT_MAX_MB"):
        load_recordings(DatasetSpec(file=str(tmp_path / "touches.h5")))
    some = load_recordings(DatasetSpec(file=str(tmp_path / "touches.h5"), at_most=6))
    assert len(some) == 6
    kept = load_recordings(DatasetSpec(file=str(tmp_path / "touches.h5"), leave_out={"label": "class0"}))
    np.testing.assert_array_equal(kept.signals[2], every.signals[5])
