"""The compiled encoders beside the core against their definitions: the same spikes, the same states."""

import platform

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.encoders import bens_spiker, izhikevich, mechanoreceptor

from neurotact.backend import native
from neurotact.encoders.specs import load
from neurotact.errors import InputError
from neurotact.networks.definition.native import isas, set_isa

pytestmark = [
    pytest.mark.skipif(native is None, reason="the kernels are not compiled here"),
    pytest.mark.usefixtures("kernels_as_before"),
]

MODULES = {"izhikevich": izhikevich, "bens-spiker": bens_spiker, "mechanoreceptor": mechanoreceptor}
SPECS = {
    "izhikevich": load("izhikevich", {"c_mV": -60.0, "euler_step_ms": 0.13}),
    "bens-spiker": load("bens-spiker", {"gain": 0.05, "filter_ms": 9.0}),
    "mechanoreceptor": load("mechanoreceptor", {"sa1.gain": 0.1, "sa1.fits": [1, 2], "ra1.fits": [2, 3, 9]}),
    "of pressure alone": load("mechanoreceptor", {"sa1.gain": 0.1, "noise": False, "conduction": False}),
    "with pc": load("mechanoreceptor-pc", {"pc.fits": [1, 4], "seed": 5, "sa1.t_ref_ms": 30.0}),
}
RATES_Hz = (1000.0, 2000.0, 8000.0, 1000.0 / 0.93)
ROUNDING = 0.0 if platform.machine() in ("x86_64", "AMD64") else 1e-9
"""Elsewhere SciPy's normal quantiles are computed with fused multiply-adds."""


def touch(n_trials=5, n_steps=300, n_taxels=5, kind="f4", seed=0) -> np.ndarray:
    walk = np.random.default_rng(seed).normal(size=(n_trials, n_steps, n_taxels)).cumsum(axis=1)
    return walk.astype(kind)


def encoded(name, signal, rate_Hz, state=None, backend="native"):
    return MODULES[SPECS[name].model].encode(signal, rate_Hz, SPECS[name], state, backend=backend)


def flat(state) -> list[np.ndarray]:
    """All arrays of a state."""
    if isinstance(state, tuple):
        return [array for part in state for array in flat(part)]
    return [] if state is None else [np.asarray(state)]


def assert_same(one, other):
    assert len(flat(one)) == len(flat(other))
    for a, b in zip(flat(one), flat(other), strict=True):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("name", SPECS)
@given(
    shape=st.tuples(st.integers(0, 9), st.integers(0, 150), st.integers(1, 35)),
    cut=st.integers(0, 150),
    rate_Hz=st.sampled_from(RATES_Hz),
    kind=st.sampled_from(["f4", "f8"]),
    isa=st.sampled_from(isas() if native else ["plain"]),
    n_threads=st.integers(1, 3),
    seed=st.integers(0, 99),
)
@examples(12)
def test_spikes_and_states_are_the_definition_s_in_one_piece_and_in_two(
    name, shape, cut, rate_Hz, kind, isa, n_threads, seed
):
    set_isa(isa)
    torch.set_num_threads(n_threads)
    signal = touch(*shape, kind=kind, seed=seed)
    wanted, end = encoded(name, signal, rate_Hz, backend="reference")
    whole, state = encoded(name, signal, rate_Hz)
    np.testing.assert_array_equal(whole, wanted)
    assert_same(state, end)
    first, state = encoded(name, signal[:, :cut], rate_Hz)
    second, state = encoded(name, signal[:, cut:], rate_Hz, state)
    np.testing.assert_array_equal(np.concatenate([first, second], axis=1), wanted)
    assert_same(state, end)


@pytest.mark.parametrize("name", SPECS)
def test_both_populations_spike(name):
    spikes, _ = encoded(name, touch(n_steps=2000), 2000.0)
    rates = spikes.reshape(5, 2000, -1, 5).mean(axis=(0, 1, 3))
    assert np.all(rates > 1e-4)
    assert np.all(rates < 0.5)


@pytest.mark.parametrize("name", SPECS)
@pytest.mark.parametrize("view", [lambda s: s[:, ::2], lambda s: s[..., 1:4], lambda s: s[::-1], lambda s: s.T])
def test_any_layout_of_signals(name, view):
    signal = view(touch(12, 60, 16))
    assert np.array_equal(*(encoded(name, signal, 2000.0, backend=b)[0] for b in ("native", "reference")))


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_clock_that_is_no_whole_number_has_the_spikes_of_the_one_beside_it(backend):
    near = (1075.0, float(np.nextafter(1075.0, 0)))  # the second is a fraction of numbers of 53 bits
    whole, other = (encoded("of pressure alone", touch(2, 900), rate_Hz, backend=backend)[0] for rate_Hz in near)
    assert whole.any()
    np.testing.assert_array_equal(whole, other)


@pytest.mark.parametrize("backend", ["native", "reference"])
def test_a_too_low_current_is_refused_by_both(backend):
    with pytest.raises(InputError, match="drives a current of -8680 mV/ms"):
        encoded("izhikevich", np.full((1, 9, 1), -4000.0), 2000.0, backend=backend)


def test_other_float_types_have_the_definition_alone():
    signal = touch(kind="f2")
    encoded("bens-spiker", signal, 2000.0, backend="auto")
    with pytest.raises(InputError, match="'native' needs signals in float32 or float64"):
        encoded("bens-spiker", signal, 2000.0)
