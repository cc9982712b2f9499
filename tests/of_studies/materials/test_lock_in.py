"""Laws of the lock-in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.studies.materials.lock_in import lock_in, phase_between

from neurotact.errors import InputError

windows = st.sampled_from(["rectangular", "hann"])


def sine(amplitude, phase, frequency_Hz, rate_Hz, n_samples, offset=0.0):
    return offset + amplitude * np.cos(2 * np.pi * frequency_Hz * np.arange(n_samples) / rate_Hz + phase)


@given(
    amplitude=st.floats(1e-3, 1e3),
    phase=st.floats(-np.pi, np.pi),
    offset=st.floats(-10, 10),
    cycles=st.floats(0.75, 40.3),
    per_cycle=st.floats(8.0, 300.0),
    window=windows,
)
def test_a_sine_is_found_exactly_over_any_number_of_periods(amplitude, phase, offset, cycles, per_cycle, window):
    frequency_Hz, rate_Hz = 7.0, 7.0 * per_cycle
    signal = sine(amplitude, phase, frequency_Hz, rate_Hz, int(cycles * per_cycle) + 2, offset * amplitude)
    phasor = lock_in(signal, frequency_Hz, rate_Hz, window)
    assert abs(phasor - amplitude * np.exp(1j * phase)) < 1e-7 * amplitude


@given(seed=st.integers(0, 1000), window=windows, factor=st.floats(-5, 5))
def test_it_is_linear_and_sees_each_row_by_itself(seed, window, factor):
    first, second = np.random.default_rng(seed).normal(size=(2, 173))
    both = lock_in(np.stack([first, second]), 13.0, 500.0, window)
    together = lock_in(first + factor * second, 13.0, 500.0, window)
    np.testing.assert_allclose(together, both[0] + factor * both[1], atol=1e-12)


@given(later=st.integers(0, 300), phase=st.floats(-3, 3))
def test_a_later_start_turns_the_phasor(later, phase):
    signal = sine(1.0, phase, 11.0, 1000.0, 900)
    early, late = lock_in(signal[:500], 11.0, 1000.0), lock_in(signal[later : later + 500], 11.0, 1000.0)
    assert abs(late - early * np.exp(2j * np.pi * 11.0 * later / 1000.0)) < 1e-9


def test_over_whole_periods_it_is_the_average_against_the_reference():
    noise = np.random.default_rng(0).normal(size=400)
    reference = np.exp(-2j * np.pi * 15.0 * np.arange(400) / 1000.0)
    assert lock_in(noise, 15.0, 1000.0) == pytest.approx(2 * (noise * reference).mean(), abs=1e-12)


def test_a_hann_window_is_deafer_to_the_mains():
    mains = sine(1.0, 0.3, 50.07, 2000.0, 4000)
    leaks = [abs(lock_in(mains, 45.0, 2000.0, window)) for window in ("rectangular", "hann")]
    assert leaks[1] < 0.2 * leaks[0]


def test_phase_between_wraps():
    one, other = np.exp(1j * np.radians([170.0, 10.0])), np.exp(1j * np.radians([-170.0, 350.0]))
    np.testing.assert_allclose(phase_between(one, other), [-20.0, 20.0])


@pytest.mark.parametrize("frequency_Hz", [0.0, -5.0, 500.0, 700.0])
def test_a_frequency_out_of_range_is_refused(frequency_Hz):
    with pytest.raises(InputError, match="is not between 0 and 500 Hz"):
        lock_in(np.zeros(100), frequency_Hz, 1000.0)


def test_less_than_half_a_period_is_refused():
    with pytest.raises(InputError, match="less than half a period"):
        lock_in(np.zeros(99), 5.0, 1000.0)
