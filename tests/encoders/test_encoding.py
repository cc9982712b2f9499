"""Encoding recordings: in memory, from a file and in pieces, the spikes are the same."""

from unittest.mock import patch

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_recordings import made, most_held

from neurotact.data import conditioning, hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders.encoding import encode_file, encode_recordings
from neurotact.encoders.specs import load
from neurotact.errors import InputError

OPTIONS = {
    "sa1-ra1-lif": {"conditioning.baseline": "start"},
    "izhikevich": {"conditioning.baseline": "none"},
    "poisson": {"conditioning.baseline": "start", "conditioning.resample_Hz": 1500.0, "sa1.t_ref_ms": 2.0},
    "mechanoreceptor": {"conditioning.baseline": "start"},
}


def touches(lengths, n_taxels=2, unit="mV") -> Recordings:
    rng = np.random.default_rng(3)
    signals = [10 * rng.normal(size=(n, n_taxels)) for n in lengths]
    return Recordings(signals, 2000.0, unit, pd.DataFrame({"label": [f"c{i % 2}" for i in range(len(lengths))]}))


def same_trains(one, other) -> None:
    for trial in range(len(other)):
        np.testing.assert_array_equal(one.steps[trial], other.steps[trial], strict=True)
        np.testing.assert_array_equal(one.units[trial], other.units[trial], strict=True)
    assert one.trial_steps.tolist() == other.trial_steps.tolist()
    assert (one.sampling_rate_Hz, one.afferents, one.encoder) == (
        other.sampling_rate_Hz,
        other.afferents,
        other.encoder,
    )
    pd.testing.assert_frame_equal(one.conditions, other.conditions, check_dtype=False)


@pytest.mark.parametrize("name", OPTIONS)
@examples(12)
@given(lengths=st.lists(st.integers(5, 60), min_size=1, max_size=4) | st.just([30] * 4), values=st.integers(12, 150))
def test_pieces_blocks_and_files_give_the_spikes_of_whole_trials_in_memory(tmp_path, name, lengths, values):
    recordings, spec = touches(lengths), load(name, OPTIONS[name])
    hdf5.save_recordings(recordings, tmp_path / "touch.h5")
    whole = encode_recordings(recordings, spec)
    with patch.object(conditioning, "PIECE_VALUES", values):
        done = []
        with hdf5.open_recordings(tmp_path / "touch.h5") as stored:
            same_trains(encode_recordings(stored, spec, done.append), whole)
            about = encode_file(stored, spec, tmp_path / "spikes.h5")
    assert sum(done) == len(lengths)
    assert about.trials == len(lengths)
    assert about.fired.tolist() == np.bincount(np.concatenate(whole.units), minlength=4).tolist()
    assert (about.steps, about.clock_Hz) == (whole.trial_steps.sum(), whole.sampling_rate_Hz)
    same_trains(hdf5.load_spikes(tmp_path / "spikes.h5"), whole)


def test_a_file_written_trial_by_trial_is_that_written_at_once(tmp_path):
    recordings, spec = touches([300, 200, 1000]), load("sa1-ra1-lif")
    encode_file(recordings, spec, tmp_path / "one.h5")
    with patch.object(conditioning, "PIECE_VALUES", 7), patch.object(hdf5, "FLUSHED_SPIKES", 10**9):
        encode_file(recordings.select(np.arange(3)), load("sa1-ra1-lif"), tmp_path / "other.h5")
    hdf5.save_spikes(encode_recordings(recordings, spec), tmp_path / "third.h5")
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "third.h5").read_bytes()


def test_what_is_wrong_in_a_long_trial_is_named_by_its_place_in_the_file(tmp_path):
    hdf5.save_recordings(touches([30, 400, 30]), tmp_path / "touch.h5")
    with h5py.File(tmp_path / "touch.h5", "a") as file:
        file["signals/values"][30 + 321, 1] = np.nan
    with (
        patch.object(conditioning, "PIECE_VALUES", 100),
        hdf5.open_recordings(tmp_path / "touch.h5") as stored,
        pytest.raises(InputError, match=r"touch\.h5: trial 1, sample 321, taxel2 is NaN or infinite; repair or drop"),
    ):
        encode_file(stored.select(np.array([1, 2])), load("sa1-ra1-lif"), tmp_path / "spikes.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["touch.h5"]


def test_another_unit_is_refused_however_long_the_trials_are():
    for values in (10, 10**6):
        with (
            patch.object(conditioning, "PIECE_VALUES", values),
            pytest.raises(InputError, match="signals are in 'count' but 'mV' is needed"),
        ):
            encode_recordings(touches([30, 30], unit="count"), load("sa1-ra1-lif"))


def test_no_more_of_the_signals_is_held_than_a_few_pieces(tmp_path):
    spec = load("sa1-ra1-lif", {"conditioning.baseline": "mean"})
    many, long = made([2000] * 200), made([400_000])
    with patch.object(conditioning, "PIECE_VALUES", 20_000):
        for recordings in (many, long):
            encode_file(recordings.select(np.array([0])), spec, tmp_path / "warm.h5")  # so that no import counts
            held = most_held(lambda recordings=recordings: encode_file(recordings, spec, tmp_path / "a.h5"))
            assert held < 800_000  # of 3.2 MB of signals
