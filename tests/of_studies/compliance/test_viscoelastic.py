"""Soft bodies between jaws: closed forms, equilibrium, hysteresis."""

import numpy as np
import pytest
from neurotact_parts.studies.compliance.viscoelastic import Bodies, deformation_at, squeeze

DT_S = 1 / 485


def body(stiffness=3.0, exponent=1.5, losses=(0.0, 0.0), permanent_set=0.0):
    return Bodies(
        *(np.array([value], float) for value in (stiffness, exponent)),
        np.array([losses], float),
        np.array([permanent_set]),
    )


def ramp(n=300, travel_mm=12.0):
    return travel_mm * (1.0 - np.abs(np.arange(2 * n + 1) / n - 1.0))[None]


def run(bodies, commanded_mm, machine=4.0, relaxation_s=(0.15, 1.5)):
    return squeeze(bodies, commanded_mm, commanded_mm.argmax(axis=1), relaxation_s, machine, DT_S)


@pytest.mark.parametrize("machine", [0.5, 4.0, 50.0])
def test_object_and_jaws_share_the_commanded_displacement(machine):
    rng = np.random.default_rng(0)
    n = 300
    bodies = Bodies(
        np.exp(rng.uniform(np.log(0.05), np.log(60), n)),
        rng.uniform(1.0, 2.0, n),
        rng.uniform(0.0, 0.3, (n, 2)),
        rng.uniform(0.0, 0.3, n),
    )
    begun_mm = deformation_at(bodies, np.full(n, 0.1)) + 0.1 / machine
    commanded_mm = ramp() + begun_mm[:, None]
    done = run(bodies, commanded_mm, machine)
    touching = done.force_N > 0
    gap_mm = done.deformation_mm + done.force_N / machine - commanded_mm
    assert np.abs(gap_mm[touching]).max() < 1e-6
    assert (done.deformation_mm <= commanded_mm + 1e-6).all()
    assert (done.force_N >= 0).all()
    np.testing.assert_allclose(done.force_N[:, 0], 0.1, rtol=1e-6)


def test_an_elastic_body_between_stiff_jaws_follows_its_power_law_both_ways():
    commanded_mm = ramp()
    done = run(body(), commanded_mm, machine=1e6)
    np.testing.assert_allclose(done.force_N, 3.0 * done.deformation_mm**1.5, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(done.force_N, done.force_N[:, ::-1], rtol=1e-6, atol=1e-6)


def test_relaxation_after_a_step_is_the_sum_of_exponentials():
    losses, relaxation_s = (0.2, 0.3), (0.15, 1.5)
    held_mm = np.full((1, 1500), 5.0)
    held_mm[0, 0] = 0.0
    force = squeeze(body(2.0, 1.0, losses), held_mm, np.array([1500]), relaxation_s, 1e9, DT_S).force_N[0]
    time_s = DT_S * (np.arange(1500) - 1)
    # The step is a ramp within one sample, of which each term keeps (1 - exp(-dt/tau)) tau/dt.
    kept = [(1 - np.exp(-DT_S / tau)) * tau / DT_S for tau in relaxation_s]
    expected = 10.0 * (
        0.5 + sum(g * k * np.exp(-time_s / tau) for g, k, tau in zip(losses, kept, relaxation_s, strict=True))
    )
    np.testing.assert_allclose(force[1:], expected[1:], rtol=1e-6)


@pytest.mark.parametrize("lossy", [body(losses=(0.1, 0.15)), body(permanent_set=0.1)])
def test_losses_make_unloading_fall_below_loading(lossy):
    commanded_mm = ramp()
    force = run(lossy, commanded_mm).force_N[0]
    there, back = force[: 300 + 1], force[300:][::-1]
    assert (back[30:-1] < there[30:-1]).all()
    area_N_mm = np.trapezoid(there, commanded_mm[0, :301]) - np.trapezoid(back, commanded_mm[0, :301])
    assert area_N_mm > 0


def test_a_faster_squeeze_meets_a_stiffer_body():
    slow, fast = (run(body(losses=(0.2, 0.2)), ramp(n)).force_N.max() for n in (3000, 100))
    assert fast > 1.02 * slow


def test_a_slow_approach_starts_at_the_force_that_was_asked():
    soft = body(losses=(0.1, 0.2))
    start_mm = deformation_at(soft, np.array([0.1]))
    commanded_mm = ramp() + start_mm + 0.1 / 4.0
    assert run(soft, commanded_mm).force_N[0, 0] == pytest.approx(0.1)


def test_bodies_do_not_touch_each_other():
    stiff, soft = body(20.0), body(0.5, losses=(0.1, 0.1))
    both = Bodies(*(np.concatenate(parts) for parts in zip(stiff, soft, strict=True)))
    together = run(both, np.repeat(ramp(), 2, axis=0))
    for i, alone in enumerate((stiff, soft)):
        np.testing.assert_allclose(together.force_N[i], run(alone, ramp()).force_N[0], rtol=1e-12)
