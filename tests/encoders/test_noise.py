"""Noise belongs to the samples of a trial: the same at any index, in any file and pieces; other noise for others."""

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.encoders import poisson
from neurotact_parts.encoders.random_numbers import between, digests, random_integers

from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.encoders import encoding
from neurotact.encoders.encoding import encode_file, encode_recordings
from neurotact.encoders.specs import encode, load
from neurotact.encoders.transformer import SpikeEncoder
from neurotact.errors import InputError

RATE_Hz = 1000.0
AS_RECORDED = {"conditioning": {"baseline": "none"}}
NOISY = {
    "poisson": AS_RECORDED,
    "mechanoreceptor": {**AS_RECORDED, "sa1.gain": 1.0},
    "mechanoreceptor-pc": {**AS_RECORDED, "sa1.gain": 1.0},
}
SEVERAL = 4.5
"""Standard errors that a mean of many thousand numbers stays within."""


def touches(n_trials=5, n_steps=200, n_taxels=2, seed=0):
    """Noise about 20, of trials of several lengths."""
    rng = np.random.default_rng(seed)
    return [20 + rng.normal(0, 1, (n_steps + 7 * trial, n_taxels)).astype("f4") for trial in range(n_trials)]


def recorded(signals, unit="mV"):
    return Recordings(signals, RATE_Hz, unit, pd.DataFrame({"label": ["felt"] * len(signals)}))


def spikes_of(trains):
    return [(steps.tolist(), units.tolist()) for steps, units in zip(trains.steps, trains.units, strict=True)]


@pytest.mark.parametrize("name", NOISY)
@given(order=st.permutations(range(5)).flatmap(lambda all: st.integers(1, 5).map(lambda n: all[:n])))
@examples(5)
def test_a_trial_has_its_spikes_at_any_index_and_beside_any_others(name, order):
    signals, encoder = touches(), load(name, NOISY[name])
    whole = spikes_of(encode_recordings(recorded(signals, encoder.unit), encoder))
    chosen = encode_recordings(recorded([signals[trial] for trial in order], encoder.unit), encoder)
    assert spikes_of(chosen) == [whole[trial] for trial in order]
    assert all(steps for steps, _ in whole)


@pytest.mark.parametrize("name", NOISY)
def test_every_door_gives_a_trial_its_spikes(name, tmp_path, monkeypatch):
    signals, encoder = [signal[:200] for signal in touches()], load(name, NOISY[name])
    alone = [np.argwhere(encode(signal[None], RATE_Hz, encoder)[0][0]).tolist() for signal in signals]
    precise = [np.argwhere(encode(signal[None].astype("f8"), RATE_Hz, encoder)[0][0]).tolist() for signal in signals]
    assert precise == alone
    transformer = SpikeEncoder(encoder, sampling_rate_Hz=RATE_Hz, unit=encoder.unit).fit(np.stack(signals))
    assert [np.argwhere(raster).tolist() for raster in transformer.transform(np.stack(signals[::-1]))] == alone[::-1]
    encode_file(recorded(signals[::-1], encoder.unit), encoder, tmp_path / "spikes.h5")
    read = hdf5.load_spikes(tmp_path / "spikes.h5")
    events = [np.c_[steps, units].tolist() for steps, units in zip(read.steps, read.units, strict=True)]
    assert [sorted(of_trial) for of_trial in events] == alone[::-1]
    monkeypatch.setattr(encoding, "is_long", lambda *_: True)  # every trial by itself, in pieces
    monkeypatch.setattr(encoding, "PIECE_VALUES", 70)
    in_pieces = encode_recordings(recorded(signals, encoder.unit), encoder)
    assert [
        np.c_[steps, units].tolist() for steps, units in zip(in_pieces.steps, in_pieces.units, strict=True)
    ] == alone


@pytest.mark.parametrize("name", NOISY)
def test_new_trials_share_no_more_spikes_at_one_index_than_at_two(name):
    encoder = load(name, NOISY[name])
    first, second = (encode(np.stack([s[:200] for s in touches(8, seed=seed)]), RATE_Hz, encoder)[0] for seed in (1, 2))
    shared = np.array([[(one & two).sum() / (one | two).sum() for two in second] for one in first])
    here, there = np.diag(shared), shared[~np.eye(8, dtype=bool)]
    assert abs(here.mean() - there.mean()) < SEVERAL * np.hypot(here.std() / np.sqrt(8), there.std() / np.sqrt(56))


def test_as_many_trials_as_one_likes_are_drawn_at_once(monkeypatch):
    signal, encoder = np.stack([signal[:50] for signal in touches(7)]), load("poisson")
    at_once, _ = encode(signal, RATE_Hz, encoder)
    monkeypatch.setattr(poisson, "VALUES", 250)
    np.testing.assert_array_equal(encode(signal, RATE_Hz, encoder)[0], at_once)


@pytest.mark.parametrize("name", NOISY)
def test_a_state_of_other_trials_is_refused(name):
    encoder = load(name)
    _, state = encode(np.ones((2, 9, 1)), RATE_Hz, encoder)
    for other in ((3, 9, 1), (2, 9, 2)):
        with pytest.raises(InputError, match="state: is of 2 trials of 1 taxels, and the signal has"):
            encode(np.ones(other), RATE_Hz, encoder, state)


def test_trials_that_are_the_same_have_the_same_noise_and_other_seeds_give_more():
    encoder, same = load("poisson"), np.full((2, 300, 2), 20.0)
    spikes, _ = encode(same, RATE_Hz, encoder)
    np.testing.assert_array_equal(spikes[0], spikes[1])
    assert (encode(same, RATE_Hz, encoder.model_copy(update={"seed": 1}))[0] != spikes).any()
    assert (spikes[0, :, 0] != spikes[0, :, 1]).any()  # each taxel has its own


def test_both_populations_of_a_taxel_draw_apart():
    """A change of 1 each ms under a level of 1 or so: SA-I and RA-I have about the same rate, and other numbers."""
    encoder = load("poisson", {"sa1.gain_Hz": 300.0, "ra1.gain_Hz": 300.0})
    level = 1 + 0.5 * (-1.0) ** np.arange(2000)
    sa1, ra1 = encode(level[None, :, None], RATE_Hz, encoder)[0][0].T != 0
    assert abs((sa1 & ra1).mean() - sa1.mean() * ra1.mean()) < SEVERAL * 0.2 / np.sqrt(2000)


# --- the numbers ------------------------------------------------------------------------------------

N_STEPS, BEFORE = 4000, 20
ONE = np.float32(1.0)
KINDS = {
    "white": np.random.default_rng(0).normal(size=(3, BEFORE + N_STEPS, 2)).astype("f4"),
    "constant, of which the last bit differs": np.stack(
        [np.full((BEFORE + N_STEPS, 2), x) for x in (ONE, np.nextafter(ONE, ONE + 1), np.nextafter(ONE, 0 * ONE))]
    ),
    "counts": np.random.default_rng(1).integers(0, 3, (3, BEFORE + N_STEPS, 2)).astype("f4"),
    "the same but for the first sample": np.where(
        np.arange(BEFORE + N_STEPS)[:, None] == 0, np.arange(3)[:, None, None], np.zeros((1, 1, 2))
    ).astype("f4"),
}


def start(signal):
    return np.zeros((len(signal), signal.shape[2]), np.uint64)


def series_of(signal):
    """Every sequence of numbers: of each trial, taxel, copy and seed, `(series, time)`.

    Without the first steps, where some trials of counts are still the same.
    """
    digest = digests(signal, 0, start(signal))[0][:, -N_STEPS:]
    seeds = (0, 1, 2**62)
    drawn = np.stack([random_integers(seed, digest, copy) for seed in seeds for copy in (0, 1)])
    return drawn.transpose(0, 1, 3, 2).reshape(-1, N_STEPS)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_are_uniform_and_apart_over_trials_taxels_copies_seeds_and_steps(kind):
    series = series_of(KINDS[kind])
    assert len(np.unique(series)) == series.size
    for bit in range(64):
        share = ((series >> np.uint64(bit)) & np.uint64(1)).mean(axis=1)
        assert abs(share - 0.5).max() < SEVERAL * 0.5 / np.sqrt(N_STEPS), bit
    z = ((series >> np.uint64(11)) * 2.0**-53 - 0.5) * np.sqrt(12)
    assert abs((z**2).mean() - 1) < SEVERAL * np.sqrt(0.8 / z.size)
    for lag in (1, 2, 3, 10):
        assert abs((z[:, lag:] * z[:, :-lag]).mean()) < SEVERAL / np.sqrt(z.size)
    for lag in (0, 1):
        pairs = [(z[i, lag:] * z[j, : N_STEPS - lag]).mean() for i, j in combinations(range(len(z)), 2)]
        assert max(map(abs, pairs)) < 5 / np.sqrt(N_STEPS)  # of some 600 pairs


@given(at=st.integers(0, 59), taxel=st.integers(0, 1), up=st.booleans())
@examples(10)
def test_a_last_bit_changes_all_numbers_of_its_taxel_from_its_sample_on(at, taxel, up):
    signal = touches(1, 60)[0][None]
    other = signal.copy()
    other[0, at, taxel] = np.nextafter(signal[0, at, taxel], np.float32(np.inf if up else 0))
    here, there = (random_integers(0, digests(each, 0, start(each))[0], 0)[0] for each in (signal, other))
    is_changed = np.zeros((60, 2), bool)
    is_changed[at:, taxel] = True
    np.testing.assert_array_equal(here != there, is_changed)


@given(cut=st.integers(0, 40), kind=st.sampled_from(["f4", "f8"]), zero=st.sampled_from([0.0, -0.0]))
@examples(10)
def test_digests_are_of_the_values_of_samples_in_any_pieces(cut, kind, zero):
    signal = np.where(np.arange(40)[:, None] % 3, touches(2, 40)[0], 0.0)[None]
    as_given = np.where(signal == 0, zero, signal).astype(kind)
    whole, end = digests(signal, 0, start(signal))
    first, so_far = digests(as_given[:, :cut], 0, start(signal))
    second, after = digests(as_given[:, cut:], cut, so_far)
    np.testing.assert_array_equal(np.concatenate([first, second], axis=1), whole)
    np.testing.assert_array_equal(after, end)
    assert all(len(np.unique(column)) == 40 for column in whole[0].T)


def test_steps_of_a_finer_clock_have_numbers_of_their_own_in_any_pieces():
    digest, _ = digests(np.zeros((1, 3, 1)), 0, np.zeros((1, 1), np.uint64))
    step_of = np.repeat([0, 1, 2], 5)
    whole = random_integers(0, between(digest, step_of, 0), 0).ravel()
    assert len(np.unique(whole)) == 15
    later = random_integers(0, between(digest[:, 1:], step_of[5:] - 1, 5), 0).ravel()
    np.testing.assert_array_equal(later, whole[5:])
