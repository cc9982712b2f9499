"""Digests of trials: the same for the same content, another for any other."""

import hashlib
import struct
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.digests import recorded_digest, recorded_trials, spike_digests
from neurotact.data.hdf5 import load_recordings, load_spikes, save_recordings, save_spikes
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, from_rasters
from neurotact.encoders.encoding import encode_recordings
from neurotact.encoders.specs import load

NAMES = ("SA-I a", "SA-I b", "RA-I a", "RA-I b")


def recorded_digests(recordings: Recordings) -> tuple[str, ...]:
    return tuple(recorded_digest(recordings, trial) for trial in range(len(recordings)))


def touch(n_trials=3, lengths=None) -> Recordings:
    rng = np.random.default_rng(0)
    signals = [rng.normal(0, 5, (n, 2)) for n in lengths or [40] * n_trials]
    return Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": [f"c{i % 2}" for i in range(len(signals))]}))


def spikes() -> SpikeTrains:
    rasters = np.random.default_rng(1).integers(0, 2, (3, 30, 4)).astype(np.uint8)
    return from_rasters(rasters, 1000.0, NAMES, pd.DataFrame({"label": ["felt", "silk", "felt"]}))


def test_the_digest_of_a_trial_is_what_it_was():
    """Files and networks hold digests: these may not change from one version to the next."""
    one = Recordings([np.arange(6).reshape(3, 2)], 1000.0, "mV", pd.DataFrame({"label": ["felt"]}))
    content = b'[1000.0, "mV", ["taxel1", "taxel2"], [3, 2]]' + struct.pack("<6f", 0, 1, 2, 3, 4, 5)
    assert recorded_digests(one) == (hashlib.sha256(content).hexdigest()[:16],)
    felt = from_rasters(np.array([[[0, 1], [1, 0]]]), 1000.0, ("SA-I a", "RA-I a"), one.conditions)
    content = b'[1000.0, ["SA-I a", "RA-I a"], 2, 2]' + struct.pack("<4q", 0, 1, 1, 0)
    assert spike_digests(felt) == (hashlib.sha256(content).hexdigest()[:16],)


def test_spikes_without_digests_are_of_recordings_that_look_alike():
    trains, chosen = replace(encode_recordings(touch(), load("sa1-ra1-lif")), trial_digests=()), np.array([2, 0])
    found = recorded_trials(touch(), trains, chosen)
    assert found is not None
    assert found.tolist() == [2, 0]
    assert recorded_trials(touch(4), trains, chosen) is None


@pytest.mark.parametrize(
    "change",
    [
        {"sampling_rate_Hz": 1000.5}, {"unit": "V"}, {"channels": ("left", "right")},
        {"signals": [-s for s in touch().signals]}, {"signals": [s[:-1] for s in touch().signals]},
        {"signals": [np.nextafter(s, np.float32(np.inf)) for s in touch().signals]},
        {"signals": [s.T.reshape(s.shape) for s in touch().signals]},
    ],
)  # fmt: skip
def test_any_other_recording_has_another_digest(change):
    assert {*recorded_digests(replace(touch(), **change))}.isdisjoint(recorded_digests(touch()))


def test_labels_and_places_are_no_part_of_a_digest():
    recordings = touch()
    relabelled = replace(recordings, conditions=pd.DataFrame({"label": ["x", "y", "z"], "force_N": [1, 2, 3]}))
    assert recorded_digests(relabelled) == recorded_digests(recordings)
    assert recorded_digests(recordings.select(np.array([2, 0]))) == tuple(
        recorded_digests(recordings)[i] for i in (2, 0)
    )
    stacked = replace(recordings, signals=np.stack(list(recordings.signals)))
    assert recorded_digests(stacked) == recorded_digests(recordings)


@given(lengths=st.lists(st.integers(20, 60), min_size=1, max_size=4), t_ref_ms=st.sampled_from([1.0, 5.0]))
def test_digests_outlive_files_and_do_not_depend_on_the_encoder(tmp_path, lengths, t_ref_ms):
    recordings = touch(lengths=lengths)
    save_recordings(recordings, tmp_path / "touch.h5")
    trains = encode_recordings(load_recordings(tmp_path / "touch.h5"), load("sa1-ra1-lif", {"sa1.t_ref_ms": t_ref_ms}))
    save_spikes(trains, tmp_path / "spikes.h5")
    again = load_spikes(tmp_path / "spikes.h5")
    assert again.trial_digests == trains.trial_digests == recorded_digests(recordings)
    assert spike_digests(again) == spike_digests(trains)


def test_selected_trials_keep_their_digests():
    trains = encode_recordings(touch(), load("sa1-ra1-lif"))
    assert trains.select(np.array([2, 1])).trial_digests == tuple(trains.trial_digests[i] for i in (2, 1))
    assert replace(trains, trial_digests=()).select(np.array([2, 1])).trial_digests == ()


@pytest.mark.parametrize(
    "change",
    [
        {"sampling_rate_Hz": 2000.0}, {"afferents": NAMES[::-1]}, {"trial_steps": np.full(3, 31)},
        {"units": [3 - u for u in spikes().units]}, {"steps": [np.maximum(s - 1, 0) for s in spikes().steps]},
        {"steps": [s[:-1] for s in spikes().steps], "units": [u[:-1] for u in spikes().units]},
    ],
)  # fmt: skip
def test_any_other_spikes_have_another_digest(change):
    trains = spikes()
    assert {*spike_digests(replace(trains, **change))}.isdisjoint(spike_digests(trains))
    relabelled = replace(trains, conditions=pd.DataFrame({"label": ["x", "y", "z"]}))
    assert spike_digests(relabelled) == spike_digests(trains)
