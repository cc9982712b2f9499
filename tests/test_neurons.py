import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from lif_intervals import lif_isi_steps

from neurotact.neurons import (
    LIF,
    decay_per_step,
    lif_start,
    lif_step,
    refractory_steps,
)

RATE_HZ = 2000.0


def neurons() -> st.SearchStrategy[LIF]:
    return st.builds(
        lambda tau, n, reset: LIF(decay_per_step(tau, RATE_HZ), n, v_reset_mV=reset),
        st.floats(0.2, 50.0),
        st.integers(0, 40),
        st.sampled_from([-65.0, -70.0, -60.0, -55.5]),
    )


def run(neuron: LIF, drive_mV: np.ndarray) -> np.ndarray:
    """Spikes of drives `(time, neuron)`."""
    state = lif_start(neuron, drive_mV.shape[1:], drive_mV.dtype)
    spikes = np.zeros(drive_mV.shape, bool)
    for t, drive in enumerate(drive_mV):
        spikes[t], state = lif_step(neuron, drive, state)
    return spikes


def exact_steps(neuron: LIF, drive_mV: float, start_mV: float) -> float:
    """Steps from a start to threshold as a real number, from the solution of the differential equation."""
    gap = neuron.v_threshold_mV - neuron.v_rest_mV
    start = start_mV - neuron.v_rest_mV
    return math.log((drive_mV - start) / (drive_mV - gap)) / -math.log(neuron.decay)


def whole_steps(exact: float) -> set[int]:
    """Rounded up; both neighbours where rounding errors of the membrane may decide between them."""
    return {max(1, math.ceil(exact - 1e-6)), max(1, math.ceil(exact + 1e-6))}


# --- the f-I curve -----------------------------------------------------------------------------------


@given(neurons(), st.lists(st.floats(10.05, 2000.0), min_size=1, max_size=20))
@examples(40)
def test_every_interval_at_constant_drive_is_the_closed_form(neuron, drives):
    closed = [lif_isi_steps(neuron, drive) for drive in drives]
    latest = max(exact_steps(neuron, drive, neuron.v_rest_mV) for drive in drives)
    spikes = run(neuron, np.tile(drives, (int(latest + 3 * max(closed)) + 3, 1)))
    for drive, isi, train in zip(drives, closed, spikes.T, strict=True):
        exact = exact_steps(neuron, drive, neuron.v_reset_mV)
        allowed = {neuron.refractory_steps + steps for steps in whole_steps(exact)}
        assert isi in allowed
        found = np.diff(np.flatnonzero(train))
        assert len(found) >= 2
        # Exactly the closed form; only at a whole number of steps may a rounding error choose its neighbour.
        assert set(found.tolist()) <= (allowed if len(allowed) > 1 else {isi})
        # The first spike starts from rest and has no silent steps before it.
        assert np.flatnonzero(train)[0] + 1 in whole_steps(exact_steps(neuron, drive, neuron.v_rest_mV))


@pytest.mark.parametrize(("drive_mV", "t_ref_ms", "isi"), [(32.0, 1.0, 10), (32.0, 5.0, 18), (20.0, 1.0, 16)])
def test_intervals_worked_by_hand(drive_mV, t_ref_ms, isi):
    # tau_mem 10 ms at 2 kS/s is 20 steps: 20 ln(32 / 22) = 7.49 and 20 ln(20 / 10) = 13.86, rounded up, after t_ref.
    neuron = LIF(decay_per_step(10.0, RATE_HZ), refractory_steps(t_ref_ms, RATE_HZ))
    assert lif_isi_steps(neuron, drive_mV) == isi
    spikes = run(neuron, np.full((200, 1), drive_mV))
    assert set(np.diff(np.flatnonzero(spikes[:, 0]))) == {isi}


@given(neurons(), st.floats(-100.0, 9.99))
@examples(40)
def test_below_threshold_it_never_fires(neuron, drive):
    assert lif_isi_steps(neuron, drive) == math.inf
    assert not run(neuron, np.full((300, 1), drive)).any()


def test_the_f_i_curve_rises_with_drive_and_falls_with_t_ref():
    drives = np.linspace(10.1, 300, 200)
    last = np.full(200, 0.0)
    for n in (0, 2, 10, 20):
        isi = np.array([lif_isi_steps(LIF(decay_per_step(10.0, RATE_HZ), n), d) for d in drives])
        assert (np.diff(isi) <= 0).all()
        assert (isi > last).all()
        last = isi
    assert last.min() == 21  # the shortest interval is n + 1 steps


# --- the refractory period ---------------------------------------------------------------------------


@given(neurons(), st.integers(0, 2**32), st.floats(0.0, 300.0))
@examples(60)
def test_no_interval_is_shorter_than_the_refractory_steps_and_one(neuron, seed, deviation):
    drive = np.random.default_rng(seed).normal(10.0, deviation, (200, 8))
    for train in run(neuron, drive).T:
        assert (np.diff(np.flatnonzero(train)) >= neuron.refractory_steps + 1).all()


@given(st.integers(0, 20))
def test_an_enormous_drive_gives_the_shortest_interval(n):
    spikes = run(LIF(0.9, n), np.full((100, 1), 1e6))[:, 0]
    assert np.flatnonzero(spikes).tolist() == list(range(0, 100, n + 1))


@given(st.integers(1, 20), st.integers(0, 2**32))
@examples(40)
def test_drive_in_the_silent_steps_is_ignored(n, seed):
    neuron = LIF(0.95, n)
    drive = np.random.default_rng(seed).normal(12.0, 30.0, (150, 1))
    spikes = run(neuron, drive)[:, 0]
    silent = np.zeros(150, bool)
    for t in np.flatnonzero(spikes):
        silent[t + 1 : t + 1 + n] = True
    other = drive.copy()
    other[silent] = 1e9
    assert np.array_equal(run(neuron, other)[:, 0], spikes)


def test_the_membrane_stays_at_reset_while_silent():
    neuron = LIF(0.5, 2, v_reset_mV=-70.0)
    state = lif_start(neuron, (1,), np.dtype(float))
    seen = []
    for _ in range(5):
        fired, state = lif_step(neuron, np.array([40.0]), state)
        seen.append((bool(fired[0]), float(state.membrane_mV[0]), int(state.silent_steps[0])))
    # U_inf = -25: from -65 half way is -45, a spike; two silent steps at -70; then half way is -47.5, a spike.
    assert seen == [(True, -70, 2), (False, -70, 1), (False, -70, 0), (True, -70, 2), (False, -70, 1)]


@pytest.mark.parametrize(
    ("t_ref_ms", "rate_Hz", "steps"),
    [(1.0, 2000.0, 2), (10.0, 2000.0, 20), (0.0, 2000.0, 0), (0.3, 10000.0, 3), (5.0, 1000.0, 5), (1.1, 1e5, 110)],
)
def test_whole_refractory_periods(t_ref_ms, rate_Hz, steps):
    assert refractory_steps(t_ref_ms, rate_Hz) == steps


@pytest.mark.parametrize(("t_ref_ms", "rate_Hz", "steps"), [(1.2, 2000.0, 3), (0.1, 2000.0, 1), (1.0, 485.0, 1)])
def test_broken_refractory_periods_are_rounded_up_with_a_warning(t_ref_ms, rate_Hz, steps):
    with pytest.warns(UserWarning, match=rf"t_ref of {t_ref_ms} ms is .* rounded up to {steps} "):
        assert refractory_steps(t_ref_ms, rate_Hz) == steps


# --- the membrane ------------------------------------------------------------------------------------


@given(st.floats(0.2, 50.0), st.floats(-200, 9.0), st.integers(1, 200))
@examples(60)
def test_the_step_is_the_exact_solution_whatever_the_step_is(tau_ms, drive, n):
    # n steps of dt and one step of n dt arrive at one place: the solution, not an Euler step.
    small, large = (LIF(decay_per_step(tau_ms, RATE_HZ / k), 0) for k in (1, n))
    state = start = lif_start(small, (1,), np.dtype(float))
    for _ in range(n):
        _, state = lif_step(small, np.array([drive]), state)
    _, leap = lif_step(large, np.array([drive]), start)
    assert state.membrane_mV == pytest.approx(leap.membrane_mV, abs=1e-9)


def test_the_step_keeps_the_float_type_and_the_state_it_was_given():
    for dtype in (np.float32, np.float64):
        neuron = LIF(0.9, 2)
        before = lif_start(neuron, (3, 2), np.dtype(dtype))
        kept = before.membrane_mV.copy(), before.silent_steps.copy()
        spikes, after = lif_step(neuron, np.full((3, 2), 200, dtype), before)
        assert spikes.dtype == bool
        assert spikes.all()
        assert after.membrane_mV.dtype == dtype
        assert np.array_equal(before.membrane_mV, kept[0])
        assert np.array_equal(before.silent_steps, kept[1])


@given(neurons(), st.integers(0, 2**32), st.floats(-50, 50))
@examples(40)
def test_only_differences_of_potential_matter(neuron, seed, shift):
    drive = np.random.default_rng(seed).normal(10.0, 30.0, (100, 4))
    shift = round(shift)
    moved = replace(
        neuron,
        v_rest_mV=neuron.v_rest_mV + shift,
        v_reset_mV=neuron.v_reset_mV + shift,
        v_threshold_mV=neuron.v_threshold_mV + shift,
    )
    assert np.array_equal(run(neuron, drive), run(moved, drive))
