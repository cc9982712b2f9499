"""Poisson afferents: random numbers that neither pieces nor neighbours change, and the statistics of the process."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.encoders.poisson import PoissonSpec, PoissonType, encode
from neurotact_parts.studies.texture.spike_features import isi_cv

RATE_HZ = 2000.0


def spec(seed=0, sa=100.0, ra=300.0, t_ref_ms=0.0) -> PoissonSpec:
    return PoissonSpec(
        seed=seed, sa1=PoissonType(gain_Hz=sa, t_ref_ms=t_ref_ms), ra1=PoissonType(gain_Hz=ra, t_ref_ms=t_ref_ms)
    )


@st.composite
def touches(draw) -> np.ndarray:
    shape = draw(st.integers(1, 3)), draw(st.integers(0, 60)), draw(st.integers(1, 3))
    signal = np.random.default_rng(draw(st.integers(0, 2**32))).normal(5, 5, shape)
    return signal.astype(draw(st.sampled_from([np.float32, np.float64])))


@given(touches(), st.sampled_from([0.0, 2.0]), st.lists(st.floats(0, 1), min_size=1, max_size=3))
@examples(40)
def test_pieces_equal_the_whole(signal, t_ref_ms, cuts):
    whole, end = encode(signal, RATE_HZ, spec(t_ref_ms=t_ref_ms))
    bounds = [0, *sorted(round(cut * signal.shape[1]) for cut in cuts), signal.shape[1]]
    pieces, state = [], None
    for start, stop in pairwise(bounds):
        spikes, state = encode(signal[:, start:stop], RATE_HZ, spec(t_ref_ms=t_ref_ms), state)
        pieces.append(spikes)
    assert np.array_equal(np.concatenate(pieces, axis=1), whole)
    assert state is not None
    assert state.step == end.step == signal.shape[1]
    assert np.array_equal(state.silent_steps, end.silent_steps)


@given(touches(), st.integers(0, 2**32))
@examples(40)
def test_a_trial_keeps_its_spikes_wherever_it_stands(signal, seed):
    order = np.random.default_rng(seed).permutation(len(signal))
    spikes, _ = encode(signal, RATE_HZ, spec())
    assert np.array_equal(encode(signal[order], RATE_HZ, spec())[0], spikes[order])


@given(touches(), st.integers(0, 2**32))
@examples(40)
def test_an_afferent_hears_its_own_taxel_alone(signal, seed):
    n_taxels = signal.shape[2]
    spikes, _ = encode(signal, RATE_HZ, spec())
    others = np.random.default_rng(seed).normal(size=signal.shape).astype(signal.dtype)
    for taxel in range(n_taxels):
        mixed = others.copy()
        mixed[:, :, taxel] = signal[:, :, taxel]
        mine = [taxel, n_taxels + taxel]
        assert np.array_equal(encode(mixed, RATE_HZ, spec())[0][:, :, mine], spikes[:, :, mine])


def distinct(signal: np.ndarray) -> np.ndarray:
    """The same trials but for a few millionths, so that each has its own random numbers."""
    return signal * (1 + 1e-6 * np.arange(len(signal)))[:, None, None]


def test_permuting_taxels_permutes_the_rates():
    signal = np.broadcast_to(np.array([1.0, 2.0, 4.0]), (1, 40_000, 3))
    counts = encode(signal, RATE_HZ, spec(ra=1.0))[0].sum(axis=1)[0, :3]
    permuted = encode(signal[:, :, [2, 0, 1]], RATE_HZ, spec(ra=1.0))[0].sum(axis=1)[0, :3]
    # Counts of 2000, 4000 and 8000 spread by their square roots: the differences stay below five deviations.
    assert (abs(permuted.astype(int) - counts[[2, 0, 1]]) < 5 * np.sqrt(2.0 * counts[[2, 0, 1]])).all()


def test_the_rate_is_that_of_the_drive_and_counts_spread_as_poisson_counts():
    n_trials, seconds, rate_Hz = 400, 1.0, 40.0
    signal = distinct(np.full((n_trials, round(seconds * RATE_HZ), 1), rate_Hz / 100.0))
    spikes = encode(signal, RATE_HZ, spec())[0][:, :, :1]
    # In a step the chance is 1 - exp(-rate dt); the count is binomial, of Fano factor 1 - p.
    chance = 1 - np.exp(-rate_Hz / RATE_HZ)
    counts = spikes.sum(axis=1, dtype=int)
    mean = counts.mean()
    assert mean == pytest.approx(chance * RATE_HZ * seconds, abs=5 * np.sqrt(rate_Hz / n_trials))
    assert counts.var() / mean == pytest.approx(1 - chance, abs=5 * np.sqrt(2 / n_trials))
    assert np.nanmean(isi_cv(spikes)) == pytest.approx(1.0, abs=0.1)


def test_a_dead_time_lowers_the_rate_as_renewal_theory_says():
    rate_Hz, t_ref_ms = 200.0, 5.0
    signal = distinct(np.full((20, 10_000, 1), rate_Hz / 100.0))
    spikes = encode(signal, RATE_HZ, spec(t_ref_ms=t_ref_ms))[0][:, :, 0]
    # A mean interval of the dead steps and of 1 / p steps, p the chance of a step.
    interval = t_ref_ms * 1e-3 * RATE_HZ + 1 / (1 - np.exp(-rate_Hz / RATE_HZ))
    assert spikes.mean() == pytest.approx(1 / interval, rel=0.03)
    for train in spikes:
        assert np.diff(np.flatnonzero(train)).min() >= t_ref_ms * 1e-3 * RATE_HZ + 1


def test_a_negative_drive_is_silent_and_an_immense_one_fires_at_every_step():
    signal = np.full((1, 100, 2), -10.0)
    assert encode(signal, RATE_HZ, spec())[0].sum() == 0
    assert encode(-1e6 * signal, RATE_HZ, spec())[0][:, :, :2].all()


def test_seeds_trials_and_afferents_draw_apart():
    signal = distinct(np.full((2, 2000, 2), 5.0))
    spikes, again = (encode(signal, RATE_HZ, spec())[0] for _ in range(2))
    assert np.array_equal(spikes, again)
    other = encode(signal, RATE_HZ, spec(seed=1))[0]
    trains = [*spikes[0, :, :2].T, *spikes[1, :, :2].T, *other[0, :, :2].T]
    assert all(not np.array_equal(a, b) for i, a in enumerate(trains) for b in trains[:i])


def test_the_numbers_are_the_same_on_every_machine():
    # These steps were drawn once, of whole numbers that every machine computes alike, and must not move.
    spikes, _ = encode(np.full((1, 120, 1), 2.0), RATE_HZ, spec())
    assert np.flatnonzero(spikes[0, :, 0]).tolist() == [13, 29, 32, 59, 61, 63, 83, 108, 110]
