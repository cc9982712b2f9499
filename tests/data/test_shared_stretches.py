"""Stretches that trials share: windows of one recording and events on another clock are found, and others are not."""

from itertools import product
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neurotact.data import conditioning, doubtful
from neurotact.data.doubtful import shared_stretches
from neurotact.data.recordings import Recordings
from neurotact.data.spikes import SpikeTrains, TrialSpikes, from_trials


def counts(seed: int, length: int, taxels: int = 3) -> np.ndarray:
    """Noisy presses as whole counts of a converter, between rests."""
    rng = np.random.default_rng(seed)
    press = 200 * np.sin(np.arange(length) / rng.uniform(15, 40))[:, None].clip(0) * rng.uniform(0.5, 1, taxels)
    return np.round(500 + press + 4 * rng.standard_normal((length, taxels)))


def recordings_of(signals) -> Recordings:
    return Recordings(signals, 1000.0, "count", ["a"] * len(signals))


def train_of(seed: int, n: int = 300, lasts: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Steps and afferents of irregular spikes."""
    rng = np.random.default_rng(seed)
    spikes = np.unique(rng.integers(0, lasts, n) * 4 + rng.integers(0, 4, n))
    return spikes // 4, spikes % 4


def trains_of(trials) -> SpikeTrains:
    rows = [TrialSpikes(steps, units.astype(np.uint16), int(steps.max(initial=0)) + 1) for steps, units in trials]
    return from_trials(rows, 1000.0, tuple("pqrs"), pd.DataFrame({"label": ["a"] * len(rows)}))


def found_in(touches) -> list[tuple[int, int]]:
    return [(each.trial, each.other) for each in shared_stretches(touches, np.arange(len(touches)))]


@given(st.integers(0, 99), st.integers(150, 600), st.floats(0.15, 0.95), st.integers(1, 5), st.booleans())
def test_windows_that_overlap_share_their_samples(seed, length, share, taxels, is_whole):
    """Whatever the length, the overlap, the taxels and the order; others of the same kind share nothing."""
    overlap = int(share * length)
    whole = counts(seed, 3 * length, taxels)
    whole = whole if is_whole else whole + np.random.default_rng(seed).random(whole.shape)
    windows = [whole[:length], whole[length - overlap : 2 * length - overlap]]
    signals = [counts(seed + 1, length, taxels), windows[1], counts(seed + 2, length, taxels), windows[0]]
    if overlap * min(taxels, 4) < 120:
        return
    (stretch,) = shared_stretches(recordings_of(signals), np.arange(4))
    assert (stretch.trial, stretch.other, stretch.later) == (3, 1, length - overlap)
    assert 0.8 * overlap - 20 <= stretch.n <= overlap


@given(st.integers(0, 99), st.integers(0, 5000), st.integers(80, 300))
def test_spikes_on_another_clock_share_their_intervals(seed, shift, n):
    steps, units = train_of(seed)
    part = slice(len(steps) - n, None) if n < len(steps) else slice(None)
    later = steps[part] - steps[part][0] + shift
    trains = trains_of([train_of(seed + 1), (steps, units), train_of(seed + 2), (later, units[part])])
    (stretch,) = shared_stretches(trains, np.arange(4))
    assert (stretch.trial, stretch.other) == (3, 1)
    assert stretch.later == shift - steps[part][0]
    assert stretch.n > 0.9 * n - 20 or stretch.n > 0.9 * len(steps) - 20


@pytest.mark.parametrize("signals", [
    [np.linspace(0, 900, 300).round()[:, None]] * 2, [np.full((300, 2), 5.0)] * 2,
    [np.round(np.minimum(np.arange(400) + 10 * i, 300))[:, None] for i in range(3)],
    [np.repeat([[0.0], [5.0], [9.0]], 100, axis=0), np.repeat([[0.0], [5.0], [9.0]], 90, axis=0)],
])  # fmt: skip
def test_rests_ramps_and_steps_are_equal_by_chance(signals):
    assert not found_in(recordings_of(signals))


def test_regular_spikes_are_equal_by_chance():
    """Saturated afferents, of which the spikes come one after the other, at equal intervals."""
    for period, n in product(range(5, 25), (2, 4)):
        units = np.tile(np.arange(n), 800 // n)
        steps = np.arange(800) // n * period + units
        assert not found_in(trains_of([(steps, units), (steps + 1, units), (steps[:500], units[:500])]))


def test_equal_values_for_other_times_are_no_stretch():
    """A slow sensor that gives the same values, each held for another time."""
    rng = np.random.default_rng(0)
    values = rng.integers(0, 999, (300, 1)).astype(float)
    held = [np.repeat(values, rng.integers(1, 6, len(values)), axis=0) for _ in range(2)]
    assert not found_in(recordings_of(held))
    assert found_in(recordings_of([held[0], held[0][200:]]))


def test_a_short_stretch_first_hides_no_long_one():
    """A trial begins as an earlier one, and goes on as another."""
    short, long = counts(0, 400), counts(1, 400)
    found = shared_stretches(recordings_of([short, long, np.concatenate([short[350:], long[20:370]])]), np.arange(3))
    assert [(each.trial, each.other) for each in found] == [(2, 1)]


@given(st.integers(0, 99), st.integers(1, 4))
def test_presses_of_one_kind_share_nothing(seed, taxels):
    signals = [counts(seed + trial, 500, taxels) for trial in range(6)]
    assert not found_in(recordings_of(signals))
    assert not found_in(trains_of([train_of(seed + trial, 500, 600) for trial in range(6)]))


def test_long_trials_are_read_in_pieces():
    whole = counts(0, 4000)
    signals = [whole[:3000], whole[2700:], counts(1, 2000)]
    expected = shared_stretches(recordings_of(signals), np.arange(3))
    assert [(each.trial, each.other, each.later) for each in expected] == [(1, 0, -2700)]
    with patch.object(conditioning, "PIECE_VALUES", 500):
        assert shared_stretches(recordings_of(signals), np.arange(3)) == expected


@pytest.mark.parametrize("kind", ["samples", "spikes"])
def test_an_import_says_them_once(kind, caplog):
    whole = counts(0, 900)
    steps, units = train_of(0)
    touches = recordings_of([whole[:400], whole[300:700], counts(1, 400), whole[:400]])
    if kind == "spikes":
        touches = trains_of([(steps, units), (steps[80:] - steps[80], units[80:]), train_of(1), (steps, units)])
    doubtful.check(touches.select([0, 1, 2]), "in/")
    (line,) = caplog.messages
    assert line.startswith(f"in/: 1 of 3 trials shares a stretch of {kind} with another one: trial 1 with trial 0 (")
    assert line.endswith("and `group` keeps its trials together")
    caplog.clear()
    doubtful.check(touches.select([0, 2, 3]), "in/")  # copies have their own line
    assert "stretch" not in caplog.text
