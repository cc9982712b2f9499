"""Izhikevich afferents: the laws of every encoder, the f-I curve, and how far the integration step is trusted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.encoders.izhikevich import (
    Izhikevich,
    IzhikevichSpec,
    IzhikevichType,
    encode,
    izhikevich_start,
    izhikevich_step,
)

from neurotact.encoders import specs
from neurotact.errors import InputError

RATE_HZ = 2000.0


def spec(sa=3.0, ra=8.7, **values) -> IzhikevichSpec:
    return IzhikevichSpec(sa1=IzhikevichType(gain_mV_per_ms=sa), ra1=IzhikevichType(gain_mV_per_ms=ra), **values)


def held(current_mV_per_ms, n_steps=2000, rate_Hz=RATE_HZ, **values) -> np.ndarray:
    """SA-I spikes, `(time, current)`, of constant currents."""
    currents = np.atleast_1d(np.asarray(current_mV_per_ms, float))
    signal = np.broadcast_to(currents, (1, n_steps, len(currents)))
    return encode(signal, rate_Hz, spec(sa=1.0, **values))[0][0, :, : signal.shape[2]].astype(int)


@st.composite
def touches(draw) -> np.ndarray:
    shape = draw(st.integers(1, 3)), draw(st.integers(0, 80)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    wave = 10 * np.sin(np.arange(shape[1]) / 30)[None, :, None] * rng.random((shape[0], 1, shape[2]))
    signal = wave + draw(st.floats(0, 3)) * rng.normal(size=shape)
    return signal.astype(draw(st.sampled_from([np.float32, np.float64])))


@given(touches(), st.floats(0, 1))
@examples(30)
def test_pieces_equal_the_whole(signal, cut):
    whole, end = encode(signal, RATE_HZ, spec())
    at = round(cut * signal.shape[1])
    first, state = encode(signal[:, :at], RATE_HZ, spec())
    second, state = encode(signal[:, at:], RATE_HZ, spec(), state)
    assert np.array_equal(np.concatenate([first, second], axis=1), whole)
    assert np.array_equal(state.neurons.membrane_mV, end.neurons.membrane_mV)
    assert state.neurons.membrane_mV.dtype == signal.dtype


@given(touches(), st.integers(0, 2**32))
@examples(30)
def test_permuting_trials_and_taxels_permutes_trials_and_afferents(signal, seed):
    rng = np.random.default_rng(seed)
    trials, taxels = rng.permutation(len(signal)), rng.permutation(signal.shape[2])
    spikes, _ = encode(signal, RATE_HZ, spec())
    moved, _ = encode(signal[trials][:, :, taxels], RATE_HZ, spec())
    assert np.array_equal(moved, spikes[trials][:, :, np.concatenate([taxels, signal.shape[2] + taxels])])


def test_the_rate_grows_with_the_current_and_is_zero_where_the_neuron_rests():
    # At rest (5 - b)^2 >= 4 * 0.04 (140 + I): no equilibrium is left above I = 4.
    currents = np.array([-5.0, 0.0, 3.0, 4.2, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0, 60.0, 100.0])
    settled = held(currents, 4000)[1000:].sum(axis=0)
    assert (settled[:3] == 0).all()
    assert (np.diff(settled[2:]) > 0).all()


def test_recovery_lengthens_the_first_interval_into_the_last():
    intervals = np.diff(np.flatnonzero(held(10.0)[:, 0]))
    assert intervals[0] < 0.5 * intervals[-1]
    assert intervals[-1] - intervals[-2] <= 1


def test_halving_the_integration_step_moves_rates_little_and_less():
    currents = np.array([5.0, 8.0, 15.0, 30.0, 60.0])
    counts = {h: held(currents, 2000, euler_step_ms=h).sum(axis=0) for h in (0.5, 0.1, 0.025)}
    exact = counts[0.025]
    assert (abs(counts[0.1] - exact) <= np.maximum(1, 0.03 * exact)).all()
    assert abs(counts[0.1] - exact).sum() < abs(counts[0.5] - exact).sum()


def test_the_integration_converges_to_first_order():
    def membrane_after_2_ms(euler_steps):
        neuron = Izhikevich(2.0 / euler_steps, euler_steps)
        fired, state = izhikevich_step(neuron, np.array([10.0]), izhikevich_start(neuron, (1,), np.dtype(float)))
        assert not fired
        return state.membrane_mV[0]

    exact = membrane_after_2_ms(20_000)
    errors = [abs(membrane_after_2_ms(n) - exact) for n in (80, 160, 320)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.15)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(1.0, abs=0.1)


def test_the_clock_divides_into_whole_euler_steps():
    for rate_Hz, steps in ((1000.0, 10), (2000.0, 5), (3000.0, 4), (20000.0, 1)):
        neuron = spec().neuron(rate_Hz)
        assert neuron.euler_steps == steps
        assert neuron.euler_step_ms * steps == pytest.approx(1e3 / rate_Hz)
        assert neuron.euler_step_ms <= 0.1 + 1e-12


def test_the_clock_changes_rates_little():
    rates = [held(20.0, round(2 * rate), rate).sum() for rate in (1000.0, 2000.0, 4000.0)]
    assert max(rates) - min(rates) <= 0.03 * min(rates)


def test_ra_feels_the_change_per_ms_whatever_the_clock():
    for rate_Hz in (1000.0, 2000.0, 4000.0):
        ramp = (2.0 * np.arange(int(rate_Hz)) * 1e3 / rate_Hz)[None, :, None]
        mine = encode(ramp, rate_Hz, spec(sa=1e-6, ra=10.0))[0][0, 1:, 1].sum()
        assert mine == pytest.approx(held(20.0, int(rate_Hz), rate_Hz).sum(), abs=1)


def test_a_clock_that_is_too_slow_and_a_drive_that_is_too_strong_are_refused():
    with pytest.raises(InputError, match="clock of 1 kHz or more; got 100 Hz"):
        encode(np.zeros((1, 5, 1)), 100.0, spec())
    with pytest.raises(InputError, match=r"integration in steps of 0\.1 ms is unstable"):
        encode(np.full((1, 5, 1), -1e4), RATE_HZ, spec())
    # Just above that limit the neuron is silent, as it should be.
    assert held(-2000.0).sum() == 0


@pytest.mark.parametrize(
    ("change", "complaint"),
    [({"v_peak_mV": -70.0}, "v_peak_mV must be above c_mV"), ({"b_per_ms": 0.3}, "without a resting potential")],
)
def test_a_neuron_that_cannot_rest_is_refused(change, complaint):
    with pytest.raises(InputError, match=complaint):
        specs.load("izhikevich", change)


def test_the_shipped_spec_is_regular_spiking():
    neuron = specs.load("izhikevich").neuron(RATE_HZ)
    assert (neuron.a_per_ms, neuron.b_per_ms, neuron.c_mV, neuron.d_mV_per_ms) == (0.02, 0.2, -65.0, 8.0)
