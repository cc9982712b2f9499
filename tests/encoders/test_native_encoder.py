"""The compiled encoder against the definition: the same spikes and the same state, to the last bit."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples

from neurotact.backend import native
from neurotact.encoders.afferents import AfferentSpec, AfferentType, EncoderState, encode
from neurotact.errors import InputError
from neurotact.networks.definition.native import isas, set_isa

pytestmark = [
    pytest.mark.skipif(native is None, reason="the kernels are not compiled here"),
    pytest.mark.usefixtures("kernels_as_before"),
]


def touch(n_trials=3, n_steps=200, n_taxels=8, dtype=np.float32, seed=0) -> np.ndarray:
    walk = np.random.default_rng(seed).normal(size=(n_trials, n_steps, n_taxels)).cumsum(axis=1)
    return walk.astype(dtype)


def spec(sa_ms=2.0, ra_ms=5.0) -> AfferentSpec:
    return AfferentSpec(sa1=AfferentType(gain=3.2, t_ref_ms=sa_ms), ra1=AfferentType(gain=16.0, t_ref_ms=ra_ms))


def same(one: EncoderState, other: EncoderState) -> bool:
    pairs = [*zip(one.sa1, other.sa1, strict=True), *zip(one.ra1, other.ra1, strict=True), (one.last, other.last)]
    return all(np.array_equal(a, b) for a, b in pairs)


@given(
    shape=st.tuples(st.integers(0, 4), st.integers(1, 120), st.integers(1, 35)),
    cut=st.integers(0, 120),
    refractory=st.tuples(st.sampled_from([0.0, 1.0, 5.0]), st.sampled_from([0.0, 2.0, 20.0])),
    dtype=st.sampled_from([np.float32, np.float64]),
    isa=st.sampled_from(isas() if native else ["plain"]),
    n_threads=st.integers(1, 4),
    seed=st.integers(0, 99),
)
@examples(60)
def test_spikes_and_state_are_the_reference_s_in_one_piece_and_in_two(
    shape, cut, refractory, dtype, isa, n_threads, seed
):
    set_isa(isa)
    torch.set_num_threads(n_threads)
    signal, which = touch(*shape, dtype=dtype, seed=seed), spec(*refractory)
    wanted, end = encode(signal, 2000.0, which, backend="reference")
    whole, state = encode(signal, 2000.0, which, backend="native")
    assert np.array_equal(whole, wanted)
    assert same(state, end)
    first, state = encode(signal[:, :cut], 2000.0, which, backend="native")
    second, state = encode(signal[:, cut:], 2000.0, which, state, backend="native")
    assert np.array_equal(np.concatenate([first, second], axis=1), wanted)
    if signal[:, :cut].size and signal[:, cut:].size:
        assert same(state, end)


def test_it_spikes():
    assert 0.01 < encode(touch(), 2000.0, spec(), backend="native")[0].mean() < 0.2


@pytest.mark.parametrize("view", [lambda s: s[:, ::2], lambda s: s[..., 1:6], lambda s: s[..., ::2], lambda s: s[::-1]])
def test_any_layout_of_signals(view):
    signal = view(touch())
    assert np.array_equal(*(encode(signal, 2000.0, spec(), backend=b)[0] for b in ("native", "reference")))


def test_the_output_array_is_written_and_returned():
    signal = touch()
    out = np.full((3, 200, 16), 7, np.uint8)
    spikes, _ = encode(signal, 2000.0, spec(), out=out, backend="native")
    assert spikes is out
    assert np.array_equal(out, encode(signal, 2000.0, spec(), backend="reference")[0])


@pytest.mark.parametrize("out", [np.zeros((3, 200, 15), np.uint8), np.zeros((3, 200, 16), np.int8)])
def test_an_output_array_that_does_not_fit_is_refused(out):
    with pytest.raises(InputError, match="out: must be"):
        encode(touch(), 2000.0, spec(), out=out, backend="native")


def test_the_state_that_comes_in_stays_as_it_was():
    _, state = encode(touch(), 2000.0, spec(), backend="native")
    before = [part.copy() for part in (*state.sa1, *state.ra1)]
    encode(touch(), 2000.0, spec(), state, backend="native")
    assert all(map(np.array_equal, before, (*state.sa1, *state.ra1)))
