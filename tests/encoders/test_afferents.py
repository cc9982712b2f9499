from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from lif_intervals import lif_isi_steps

from neurotact.encoders.afferents import AfferentSpec, AfferentType, encode
from neurotact.encoders.specs import afferent_names
from neurotact.errors import InputError

RATE_HZ = 2000.0


def spec(t_ref_sa_ms: float = 1.0, t_ref_ra_ms: float = 1.0, **values) -> AfferentSpec:
    return AfferentSpec(
        sa1=AfferentType(gain=3.2, t_ref_ms=t_ref_sa_ms), ra1=AfferentType(gain=16.0, t_ref_ms=t_ref_ra_ms), **values
    )


@st.composite
def touches(draw, least_steps: int = 0) -> np.ndarray:
    """Signals that drive both populations: slow waves of some mV with noise on them."""
    shape = draw(st.integers(1, 3)), draw(st.integers(least_steps, 120)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    wave = 10 * np.sin(np.arange(shape[1]) / 30)[None, :, None] * rng.random((shape[0], 1, shape[2]))
    signal = wave + draw(st.floats(0, 3)) * rng.normal(size=shape)
    return signal.astype(draw(st.sampled_from([np.float32, np.float64])))


def in_pieces(signal, encoder, cuts):
    """The spikes of a signal that is encoded in pieces, and the state after the last; cuts: shares of its length."""
    bounds = [0, *sorted(round(cut * signal.shape[1]) for cut in cuts), signal.shape[1]]
    pieces, state = [], None
    for start, stop in pairwise(bounds):
        spikes, state = encode(signal[:, start:stop], RATE_HZ, encoder, state)
        pieces.append(spikes)
    return np.concatenate(pieces, axis=1), state


t_refs = st.sampled_from([0.0, 0.5, 1.0, 5.0, 10.0])


@given(touches(), t_refs, t_refs, st.lists(st.floats(0, 1), min_size=1, max_size=3))
@examples(50)
def test_pieces_equal_the_whole(signal, t_ref_sa, t_ref_ra, cuts):
    encoder = spec(t_ref_sa, t_ref_ra)
    whole, end = encode(signal, RATE_HZ, encoder)
    found, state = in_pieces(signal, encoder, cuts)
    assert np.array_equal(found, whole)
    assert state is not None
    for mine, its in zip((*end.sa1, *end.ra1), (*state.sa1, *state.ra1), strict=True):
        assert np.array_equal(mine, its)


@given(touches(), st.integers(0, 2**32))
@examples(40)
def test_permuting_taxels_permutes_afferents(signal, seed):
    n_taxels = signal.shape[2]
    order = np.random.default_rng(seed).permutation(n_taxels)
    spikes, _ = encode(signal, RATE_HZ, spec())
    permuted, _ = encode(signal[:, :, order], RATE_HZ, spec())
    assert np.array_equal(permuted, spikes[:, :, np.concatenate([order, n_taxels + order])])


@given(touches(), st.integers(0, 2**32))
@examples(30)
def test_trials_do_not_touch_each_other(signal, seed):
    order = np.random.default_rng(seed).permutation(len(signal))
    spikes, _ = encode(signal, RATE_HZ, spec())
    assert np.array_equal(encode(signal[order], RATE_HZ, spec())[0], spikes[order])


@given(touches(least_steps=2), t_refs, t_refs)
@examples(50)
def test_no_interval_is_shorter_than_t_ref_and_a_step(signal, t_ref_sa, t_ref_ra):
    spikes, _ = encode(5 * signal, RATE_HZ, spec(t_ref_sa, t_ref_ra))
    n_taxels = signal.shape[2]
    for trial in spikes:
        for afferent, train in enumerate(trial.T):
            n = round((t_ref_sa if afferent < n_taxels else t_ref_ra) * 1e-3 * RATE_HZ)
            assert (np.diff(np.flatnonzero(train)) >= n + 1).all()


def test_sa_comes_before_ra_and_each_feels_its_own():
    # Taxel 0 is pressed and held, taxel 1 jumps up and down, taxel 2 rests.
    signal = np.zeros((1, 400, 3))
    signal[0, :, 0] = 10.0
    signal[0, ::2, 1] = 2.0
    spikes, _ = encode(signal, RATE_HZ, spec())
    sa, ra = spikes[0, :, :3].sum(axis=0), spikes[0, :, 3:].sum(axis=0)
    assert sa[0] > 30
    assert ra[1] > 30
    assert [sa[1], sa[2], ra[0], ra[2]] == [0, 0, 0, 0]
    assert afferent_names(("a", "b", "c")) == ("SA-I a", "SA-I b", "SA-I c", "RA-I a", "RA-I b", "RA-I c")
    assert spikes.dtype == np.uint8


def test_a_held_press_and_a_ramp_fire_at_the_closed_form():
    encoder = spec(t_ref_sa_ms=5.0, t_ref_ra_ms=1.0)
    held = encode(np.full((1, 600, 1), 10.0), RATE_HZ, encoder)[0][0]
    sa = encoder.neuron(encoder.sa1, RATE_HZ)
    assert set(np.diff(np.flatnonzero(held[:, 0]))) == {lif_isi_steps(sa, 32.0)}
    # 2 mV per ms at a gain of 16 mV per (mV/ms) is a drive of 32 mV, downward as upward, at any sampling rate.
    for rate_Hz in (1000.0, 2000.0, 4000.0):
        ra = encoder.neuron(encoder.ra1, rate_Hz)
        for slope in (2.0, -2.0):
            ramp = (slope * np.arange(600) * 1e3 / rate_Hz)[None, :, None]
            fired = np.flatnonzero(encode(ramp, rate_Hz, encoder)[0][0, :, 1])
            assert set(np.diff(fired)) == {lif_isi_steps(ra, 32.0)}


def test_sa_takes_the_sign_and_ra_does_not():
    wave = 10 * np.sin(np.arange(300) / 40)[None, :, None]
    signal = wave + np.random.default_rng(0).normal(0, 1, (1, 300, 2))
    up, down = (encode(s, RATE_HZ, spec())[0] for s in (signal, -signal))
    assert not np.array_equal(up[:, :, :2], down[:, :, :2])
    assert np.array_equal(up[:, :, 2:], down[:, :, 2:])
    assert up[:, :, 2:].any()


def test_ra_does_not_start_with_a_jump():
    spikes, _ = encode(np.full((1, 50, 1), 1000.0), RATE_HZ, spec())
    assert spikes[..., 1].sum() == 0


def test_longer_refractory_periods_give_fewer_spikes():
    signal = np.random.default_rng(0).normal(0, 6, (4, 1000, 4))
    counts = [encode(signal, RATE_HZ, spec(t, t))[0].sum() for t in (1.0, 5.0, 10.0)]
    assert counts[0] > counts[1] > counts[2] > 0


def test_what_cannot_be_encoded_is_refused():
    for signal in (np.zeros((10, 2)), np.zeros((1, 10, 2), int)):
        with pytest.raises(InputError, match=r"must be a float array \(trial, time, taxel\)"):
            encode(signal, RATE_HZ, spec())
    with pytest.raises(InputError, match="v_threshold_mV must be above"):
        spec(v_threshold_mV=-65.0)


def test_nothing_encodes_to_nothing():
    assert encode(np.zeros((0, 10, 2)), RATE_HZ, spec())[0].shape == (0, 10, 4)
    assert encode(np.zeros((2, 0, 2)), RATE_HZ, spec())[0].shape == (2, 0, 4)


@given(touches(), t_refs, st.floats(0.2, 3), st.floats(1, 4))
@examples(60)
def test_a_higher_gain_never_lowers_a_spike_count(signal, t_ref, gain, factor):
    """Whatever is silent at times: between two spikes of the weaker afferent the stronger one spikes at least once.

    SA-I is driven by the signal's size here: a signed drive may pull the stronger afferent further below rest.
    """
    counts = []
    for k in (gain, gain * factor):
        kinds = (AfferentType(gain=k, t_ref_ms=t_ref), AfferentType(gain=5 * k, t_ref_ms=t_ref))
        spikes, _ = encode(np.abs(signal), RATE_HZ, AfferentSpec(sa1=kinds[0], ra1=kinds[1]))
        counts.append(spikes.sum(axis=1, dtype=int))
    assert (counts[1] >= counts[0]).all()
