"""Grasp peaks: where they are cut, and that pieces give what the whole gives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.stiffness.peaks import PeakSpec, find_peaks, next_peaks, peaks_start

from neurotact.errors import InputError


def drop(depth=3.0, at=200, channel=1, length=1000, channels=4):
    """A quiet recording with one triangular drop whose minimum lies at `at`."""
    signal = np.zeros((length, channels), np.float32)
    signal[at - 20 : at + 21, channel] = -depth * (1 - np.abs(np.arange(-20, 21)) / 21)
    return signal


def test_the_papers_window():
    """30 samples before the minimum and 120 from it on, of all channels (stiffness paper, Sec. IV-B)."""
    signal = drop() + np.arange(4, dtype=np.float32) * 0.01
    peaks = find_peaks(signal, PeakSpec())
    assert (peaks.minimum.tolist(), peaks.channel.tolist()) == ([200], [1])
    np.testing.assert_array_equal(peaks.samples[0], signal[170:320])
    assert PeakSpec().n_samples == 150


def test_any_channel_triggers_and_the_deepest_places_the_peak():
    signal = drop(depth=1.5, at=200, channel=0) + drop(depth=4.0, at=230, channel=3)
    peaks = find_peaks(signal, PeakSpec())
    assert (peaks.minimum.tolist(), peaks.channel.tolist()) == ([230], [3])


def test_a_rise_does_not_trigger_and_neither_does_what_is_above_the_threshold():
    assert len(find_peaks(-drop(depth=5.0), PeakSpec()).minimum) == 0
    assert len(find_peaks(drop(depth=0.99), PeakSpec(threshold=1.0)).minimum) == 0
    assert len(find_peaks(drop(depth=1.0), PeakSpec(threshold=1.0)).minimum) == 1


def test_nothing_triggers_while_at_rest():
    signal = drop(at=200) + drop(at=500)
    assert find_peaks(signal, PeakSpec(rest=2000)).minimum.tolist() == [200]
    assert find_peaks(signal, PeakSpec(rest=100)).minimum.tolist() == [200, 500]


def test_a_peak_that_the_recording_cuts_short_is_left_out():
    assert len(find_peaks(drop(at=200, length=319), PeakSpec()).minimum) == 0
    assert len(find_peaks(drop(at=200, length=320), PeakSpec()).minimum) == 1
    assert len(find_peaks(drop(at=25), PeakSpec()).minimum) == 0
    early_then_whole = find_peaks(drop(at=25) + drop(at=500), PeakSpec(rest=50))
    assert early_then_whole.minimum.tolist() == [500]


@st.composite
def recordings_in_pieces(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    length = draw(st.integers(0, 300))
    signal = rng.standard_normal((length, draw(st.integers(1, 3))))
    for at in rng.integers(0, length, draw(st.integers(0, 4))) if length else ():
        signal[at : at + 5] -= rng.uniform(2, 6)
    cuts = sorted(draw(st.lists(st.integers(0, length), max_size=12)))
    spec = PeakSpec(
        threshold=draw(st.sampled_from([1.5, 2.5, 4.0])),
        before=draw(st.integers(0, 20)),
        after=draw(st.integers(1, 30)),
        search=draw(st.integers(1, 30)),
        rest=draw(st.integers(0, 60)),
    )
    return signal, cuts, spec


@given(recordings_in_pieces())
def test_pieces_give_the_peaks_of_the_whole(drawn):
    signal, cuts, spec = drawn
    whole = find_peaks(signal, spec)
    state = peaks_start(signal.shape[1], signal.dtype)
    parts = []
    for piece in np.split(signal, cuts):
        found, state = next_peaks(piece, spec, state)
        parts.append(found)
        assert len(state.kept) <= spec.before + spec.search + spec.after
    for name in ("minimum", "channel", "samples"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(whole, name))


@given(recordings_in_pieces())
def test_every_peak_is_what_the_rule_says(drawn):
    signal, _, spec = drawn
    peaks = find_peaks(signal, spec)
    for minimum, channel, samples in zip(*peaks, strict=True):
        assert signal[minimum, channel] <= -spec.threshold
        np.testing.assert_array_equal(samples, signal[minimum - spec.before : minimum + spec.after])
    assert (np.diff(peaks.minimum) >= spec.after + spec.rest).all()


def test_pieces_of_other_channels_are_refused():
    with pytest.raises(InputError, match="4 channels"):
        next_peaks(np.zeros((10, 3)), PeakSpec(), peaks_start(4))
    with pytest.raises(InputError, match="time, channel"):
        find_peaks(np.zeros(10), PeakSpec())
