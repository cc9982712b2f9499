"""Onset: where a touch begins in many trials."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data.onset import (
    BINS,
    LATEST,
    common_onset_s,
    common_spike_onset_s,
    evenly,
)
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import from_rasters
from neurotact.networks.training import ranges

RATE_HZ = 200.0


def touches(onset, rng, n_trials=40, n_samples=600, jitter=0, vibrates=False):
    """Trials at rest, with a level or a vibration of random size from about `onset` on, of various lengths."""
    signals = []
    for _ in range(n_trials):
        signal = rng.normal(0, 0.2, (n_samples + int(rng.integers(100)), 3))
        begin = onset + int(rng.integers(-jitter, jitter + 1))
        size = rng.uniform(0, 10, 3)
        signal[begin:] += rng.normal(0, 1, signal[begin:].shape) * size if vibrates else size
        signals.append(signal)
    return Recordings(signals, RATE_HZ, "mV", {"label": ["a", "b"] * (n_trials // 2)})


@given(onset=st.integers(24, 190), seed=st.integers(0, 99), vibrates=st.booleans())
def test_the_touch_begins_within_a_bin_of_its_onset(onset, seed, vibrates):
    found = common_onset_s(touches(onset, np.random.default_rng(seed), vibrates=vibrates)) * RATE_HZ
    assert abs(found - onset) <= 600 // BINS + 2  # the shortest trial has up to 699 samples


def test_touches_that_begin_at_various_times_begin_between_the_first_and_the_last():
    found = common_onset_s(touches(120, np.random.default_rng(0), jitter=40)) * RATE_HZ
    assert 80 <= found <= 160


@given(
    seed=st.integers(0, 99),
    scale=st.floats(1e-3, 1e3),
    offset=st.floats(-1e4, 1e4),
    onset=st.sampled_from([0, 60, 150]),
)
def test_neither_unit_nor_labels_nor_order_move_it(seed, scale, offset, onset):
    rng = np.random.default_rng(seed)
    trials = touches(onset, rng, n_trials=10)
    order = rng.permutation(10)
    other = Recordings(
        [np.asarray(trials.signals[at], np.float64) * scale + offset * scale for at in order],
        RATE_HZ, "V", {"label": ["x"] * 5 + ["y"] * 5},
    )  # fmt: skip
    assert common_onset_s(other) == common_onset_s(trials)


@given(
    seed=st.integers(0, 99),
    onset=st.sampled_from([0, 60, 150]),
    scale=st.sampled_from([1e-3, 1.0, 1e5]),
    kind=st.sampled_from(["unit", "noise", "offset"]),
)
def test_one_taxel_of_any_unit_does_not_decide(seed, onset, scale, kind):
    rng = np.random.default_rng(seed)
    trials = touches(onset, rng)
    signals = [np.asarray(signal, np.float64) for signal in trials.signals]
    for at, signal in enumerate(signals):
        if kind == "unit":
            signal[:, 1] *= scale
        else:  # a taxel that is not touched: noise, or another value in each trial
            noise = rng.normal(0, scale, (len(signal), 1))
            more = noise if kind == "noise" else rng.normal(0, scale) + noise / 100
            signals[at] = np.hstack([signal, more])
    other = Recordings(signals, RATE_HZ, "mV", {"label": ["a", "b"] * 20})
    assert abs(common_onset_s(other) - common_onset_s(trials)) * RATE_HZ <= 700 // BINS


def test_trials_that_begin_in_contact_start_at_once():
    assert common_onset_s(touches(0, np.random.default_rng(0))) == 0
    assert common_onset_s(touches(0, np.random.default_rng(1), vibrates=True)) == 0
    assert common_onset_s(Recordings(np.zeros((4, 30, 2)), RATE_HZ, "mV", {"label": [*"abab"]})) == 0
    assert common_onset_s(Recordings(np.ones((2, 1, 1)), RATE_HZ, "mV", {"label": [*"ab"]})) == 0


@pytest.mark.parametrize(("onset", "glitch"), [(0, 120), (120, 30), (120, 500)])
def test_a_glitch_in_one_trial_does_not_decide(onset, glitch):
    trials = touches(onset, np.random.default_rng(0))
    trials.signals[7][glitch] += 1e6
    found = common_onset_s(trials) * RATE_HZ
    assert abs(found - onset) <= 600 // BINS + 2


def test_many_taxels_of_which_each_trial_touches_few_show_the_onset():
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 0.2, (60, 300, 100))
    for trial in signals:
        trial[50:, rng.choice(100, 5, replace=False)] += 8
    found = common_onset_s(Recordings(signals, RATE_HZ, "mV", {"label": ["a", "b"] * 30})) * RATE_HZ
    assert abs(found - 50) <= 300 // BINS


def test_sensors_that_drift_apart_show_no_onset():
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 1, (60, 600, 3)).cumsum(axis=1)
    assert common_onset_s(Recordings(signals, RATE_HZ, "mV", {"label": ["a", "b"] * 30})) == 0


@given(st.integers(1, 400), st.integers(0, 99))
def test_most_of_the_shortest_trial_is_left(n_samples, seed):
    signals = np.random.default_rng(seed).normal(0, 1, (4, n_samples, 2))
    found = common_onset_s(Recordings(signals, RATE_HZ, "mV", {"label": [*"abab"]}))
    assert 0 <= found * RATE_HZ <= LATEST * n_samples


def spiking(onset, rng, n_trials=40, n_steps=600):
    """Spike trains with a rate of 1 % at rest, and of up to 30 % from `onset` on, of various lengths."""
    rasters = []
    for _ in range(n_trials):
        rates = np.full((n_steps + int(rng.integers(100)), 3), 0.01)
        rates[onset:] = rng.uniform(0.01, 0.3, 3)
        rasters.append(rng.random(rates.shape) < rates)
    return from_rasters(rasters, RATE_HZ, ("SA-I a", "SA-I b", "RA-I a"), pd.DataFrame({"label": ["a", "b"] * 20}))


@given(onset=st.integers(24, 190), seed=st.integers(0, 99))
def test_the_touch_begins_in_spikes_within_two_bins_of_its_onset(onset, seed):
    found = common_spike_onset_s(spiking(onset, np.random.default_rng(seed))) * RATE_HZ
    assert abs(found - onset) <= 2 * (600 // BINS + 2)


@given(n_steps=st.integers(1, 130), seed=st.integers(0, 99))
def test_spike_trains_that_begin_in_contact_start_near_their_beginning(n_steps, seed):
    rng = np.random.default_rng(seed)
    steady = rng.random((40, n_steps, 20)) < rng.uniform(0, 1, (40, 1, 20))
    trains = from_rasters(steady, RATE_HZ, tuple(map(str, range(20))), pd.DataFrame({"label": ["a", "b"] * 20}))
    assert common_spike_onset_s(trains) * RATE_HZ <= 2 * np.ceil(n_steps / BINS)


def test_spike_trains_without_spikes_or_time_start_at_once():
    conditions = pd.DataFrame({"label": [*"abab"]})
    silent = from_rasters(np.zeros((4, 30, 2)), RATE_HZ, ("a", "b"), conditions)
    assert common_spike_onset_s(silent) == 0
    empty = from_rasters([np.zeros((n, 2)) for n in (30, 0, 30, 30)], RATE_HZ, ("a", "b"), conditions)
    assert common_spike_onset_s(empty) == 0
    assert common_spike_onset_s(from_rasters(np.zeros((4, 30, 0)), RATE_HZ, (), conditions)) == 0
    assert common_spike_onset_s(from_rasters([], RATE_HZ, ("a",), conditions[:0])) == 0


@given(st.integers(1, 400), st.integers(1, 60))
def test_trials_that_are_chosen_are_as_far_apart_as_whole_numbers_can_be(n_trials, most):
    chosen = evenly(n_trials, most)
    assert len(chosen) == min(n_trials, most)
    assert chosen[0] == 0
    assert most == 1 or chosen[-1] == n_trials - 1
    assert len(chosen) < 3 or np.ptp(np.diff(chosen)) <= 1
    assert ranges.evenly(np.arange(n_trials) + 7, most).tolist() == (chosen + 7).tolist()
