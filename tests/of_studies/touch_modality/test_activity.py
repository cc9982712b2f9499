"""Onset of a touch in one trial, and what is cut from there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.touch_modality.activity import Activity, ActivityBand, cut_from_onset, find_activity

from neurotact.errors import InputError
from neurotact.spec import build

BAND = ActivityBand()


def resting(n_samples=200, n_channels=3):
    return np.full((n_samples, n_channels), 1.65)


def test_the_band_itself_is_rest():
    signal = resting()
    signal[10], signal[20] = BAND.low_V, BAND.high_V
    assert find_activity(signal, BAND) is None
    assert cut_from_onset(signal, 50, BAND) is None


@given(first=st.integers(0, 199), last=st.integers(0, 199), channels=st.tuples(st.integers(0, 2), st.integers(0, 2)))
def test_any_channel_on_either_side_counts(first, last, channels):
    first, last = sorted((first, last))
    signal = resting()
    signal[first, channels[0]], signal[last, channels[1]] = 1.6199, 1.6801
    assert find_activity(signal, BAND) == Activity(first, last)


@given(onset=st.integers(0, 199), lead=st.integers(0, 60), n_samples=st.integers(1, 200))
def test_the_cut_has_its_length_and_holds_the_onset(onset, lead, n_samples):
    signal = resting()
    signal[:, 1] += np.arange(200) * 1e-9  # tells the samples apart
    signal[onset, 0] = 1.7
    cut = cut_from_onset(signal, n_samples, ActivityBand(lead_samples=lead))
    assert cut is not None
    assert len(cut) == n_samples
    start = round((cut[0, 1] - 1.65) / 1e-9)
    assert start == min(max(onset - lead, 0), 200 - n_samples)
    if lead < n_samples:
        assert (cut[:, 0] == 1.7).sum() == 1


def test_start_is_that_of_the_public_code():
    """Its rule, 1-based: fire - 50, or 1 when earlier; from 23856 when later than that (of 30,000 samples)."""
    for onset in (0, 30, 49, 51, 5000, 23800, 23904):
        signal = resting(30000, 16)
        signal[onset:, 5] = 1.5
        signal[:, 0] = 1.65 + np.arange(30000) * 1e-9
        cut = cut_from_onset(signal, 6144, BAND)
        assert cut is not None
        fire = onset + 1
        theirs = fire - 50 if fire > 50 else 1
        assert round((cut[0, 0] - 1.65) / 1e-9) + 1 == theirs
    signal[:, 5] = 1.65
    signal[29000:, 5] = 1.5
    cut = cut_from_onset(signal, 6144, BAND)
    assert cut is not None
    # the public code stops at 29,999 of 30,000 samples here; ours ends with the recording
    assert round((cut[0, 0] - 1.65) / 1e-9) + 1 == 23856 + 1
    assert cut[-1, 0] == signal[-1, 0]


def test_a_short_recording_and_an_empty_band_are_refused():
    with pytest.raises(InputError, match="200 samples, fewer than the 6144"):
        cut_from_onset(resting(), 6144, BAND)
    with pytest.raises(InputError, match="low_V must be below high_V"):
        build(ActivityBand, {"low_V": 1.7}, "here")
