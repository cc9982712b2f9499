"""The kernel of membranes in closed form against its definition: the same steps, in any pieces.

Its logarithms and exponentials may differ from NumPy's in the last bit. A spike would be in another step if it were
that near to the border between two: of some 10^12 spikes one.
"""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.studies.texture import reader as fabricslide

from neurotact.backend import native
from neurotact.encoders.closed_form import encode
from neurotact.encoders.specs import load
from neurotact.networks.definition.native import isas, set_isa
from neurotact.neurons import ExactLIFState

pytestmark = [
    pytest.mark.usefixtures("kernels_as_before"),
    pytest.mark.skipif(native is None, reason="the kernels are not compiled here"),
    pytest.mark.filterwarnings("ignore:.*count as one"),
]
OPTIONS = [
    {},
    {"sa1.grades": [0.5, 1.0, 4.0]},
    {"sa1.rate_ms": 20.0},
    {"ra1.change": "both", "ra1.grades": [1.0, 3.0]},
    {"sa1.opposite": True, "v_reset_mV": -70.0, "tau_mem_ms": 3.0},
]


def spec_of(**settings):
    given = {"integration": "exact", "conditioning.resample_Hz": 1000.0, "sa1.gain": 1.5, "ra1.gain": 30.0}
    return load("sa1-ra1-lif", {**given, **settings})


def touch(n_trials=3, n_samples=40, n_taxels=4, dtype=np.float32, seed=0):
    """Signals of some 20 mV, with changes as large from sample to sample."""
    steps = np.random.default_rng(seed).normal(0, 12, (n_trials, n_samples, n_taxels))
    return (steps.cumsum(axis=1) / 3).astype(dtype)


def assert_same(one, other):
    np.testing.assert_array_equal(one[0], other[0])
    for name, ours in one[1]._asdict().items():
        theirs = getattr(other[1], name)
        if name in ExactLIFState._fields:
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-9)
        else:
            np.testing.assert_array_equal(ours, theirs)


@given(
    shape=st.tuples(st.integers(0, 17), st.integers(0, 60), st.integers(1, 9)),
    cut=st.integers(0, 60),
    rate_Hz=st.sampled_from([20.0, 93.0, 333.3, 1000.0]),
    clock_Hz=st.sampled_from([None, 40.0, 200.0, 1000.0]),
    periods=st.tuples(st.floats(0.1, 3), st.sampled_from([0.2, 5.0, 70.0])),
    options=st.sampled_from(OPTIONS),
    gain=st.sampled_from([0.3, 1.5, 300.0]),
    dtype=st.sampled_from([np.float32, np.float64]),
    isa=st.sampled_from(isas() if native else ["plain"]),
    n_threads=st.integers(1, 4),
    seed=st.integers(0, 99),
)
@examples(60)
def test_steps_and_state_are_the_definition_s_in_one_piece_and_in_two(
    shape, cut, rate_Hz, clock_Hz, periods, options, gain, dtype, isa, n_threads, seed
):
    set_isa(isa)
    torch.set_num_threads(n_threads)
    settings = {"sa1.gain": gain, "sa1.t_ref_ms": periods[0], "ra1.t_ref_ms": periods[1]}
    spec = spec_of(**options, **settings, **{"conditioning.resample_Hz": clock_Hz})
    signal = touch(*shape, dtype=dtype, seed=seed)
    wanted = encode(signal, rate_Hz, spec, backend="reference")
    assert_same(encode(signal, rate_Hz, spec, backend="native"), wanted)
    first, state = encode(signal[:, :cut], rate_Hz, spec, backend="native")
    second, state = encode(signal[:, cut:], rate_Hz, spec, state, backend="native")
    np.testing.assert_array_equal(np.concatenate([first, second], axis=1), wanted[0])


@pytest.mark.parametrize("view", [lambda s: s[:, ::2], lambda s: s[..., 1:3], lambda s: s[..., ::2], lambda s: s[::-1]])
def test_any_layout_of_signals(view):
    signal = view(touch())
    kernel, definition = (encode(signal, 93.0, spec_of(), backend=each) for each in ("native", "reference"))
    assert_same(kernel, definition)
    assert 0.01 < kernel[0].mean() < 0.5


def test_the_state_that_comes_in_stays_as_it_was():
    _, state = encode(touch(), 93.0, spec_of(), backend="native")
    before = [np.copy(part) for part in state[:4]]
    encode(touch(seed=1), 93.0, spec_of(), state, backend="native")
    assert all(map(np.array_equal, before, state[:4]))


@pytest.mark.thorough
def test_real_recordings_have_the_definition_s_steps(data_folder):
    recordings = fabricslide.read(data_folder / "fabricslide").select(np.arange(0, 644, 40))
    rate_Hz = recordings.sampling_rate_Hz
    for clock_Hz in (None, 2.7 * rate_Hz, 1000.0):
        spec = spec_of(**{"conditioning.resample_Hz": clock_Hz})
        for signal in recordings.signals:
            moved = signal - signal.mean(axis=0, dtype=np.float32)
            scaled = 12 * moved[None] / moved.std().clip(1.0)
            kernel, definition = (encode(scaled, rate_Hz, spec, backend=each) for each in ("native", "reference"))
            assert_same(kernel, definition)
            assert kernel[0].any()
