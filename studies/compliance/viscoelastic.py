"""Force and deformation of soft bodies between two jaws: elastic power law, relaxation, permanent set.

Quasi-linear viscoelasticity (Fung): the elastic force F_e of the deformation u passes through a spectrum of
relaxation, F = (1 - sum g) F_e + sum Q_i, with dQ_i/dt = g_i dF_e/dt - Q_i / tau_i. Loading follows
F_e = stiffness u^exponent; unloading follows F_max ((u - u_set) / (u_max - u_set))^exponent, since a part u_set of the
largest deformation does not recover at once. The jaws act as a spring, so commanded = u + F / machine.
"""

from typing import NamedTuple

import numpy as np

NEWTON_STEPS = 4
"""Newton steps per sample; enough for a residual below a nanometre (checked in the tests)."""


class Bodies(NamedTuple):
    """Soft bodies, one entry each, `(body,)`; `losses` is `(body, term)`, the share of force that each term relaxes."""

    stiffness: np.ndarray
    """Stiffness of loading, N / mm^exponent."""
    exponent: np.ndarray
    """>= 1: 1 flat faces, 1.5 Hertzian contacts."""
    losses: np.ndarray
    permanent_set: np.ndarray
    """Share of the largest deformation that remains during unloading."""


class Squeeze(NamedTuple):
    """Force in N and deformation in mm, each `(body, time)`."""

    force_N: np.ndarray
    deformation_mm: np.ndarray


def deformation_at(bodies: Bodies, force_N: np.ndarray) -> np.ndarray:
    """The deformation in mm, `(body,)`, at which a slow approach reaches `force_N`, the relaxing terms at rest."""
    lasting = (1.0 - bodies.losses.sum(axis=1)) * bodies.stiffness
    return (force_N / lasting) ** (1.0 / bodies.exponent)


def squeeze(
    bodies: Bodies,
    commanded_mm: np.ndarray,
    turn: np.ndarray,
    relaxation_s: tuple[float, ...],
    machine_N_per_mm: float,
    dt_s: float,
) -> Squeeze:
    """Move the jaws by `commanded_mm`, `(body, time)`; unloading begins after sample `turn`, `(body,)`.

    relaxation_s: tau_i of each term of `losses`. At the first sample the bodies have relaxed. The force is never
    tensile: a body that recovers more slowly than the jaws separates from them.

    >>> spring = Bodies(np.array([2.0]), np.array([1.0]), np.zeros((1, 1)), np.zeros(1))
    >>> done = squeeze(spring, np.array([[0.0, 3.0, 0.0]]), np.array([1]), (1.0,), machine_N_per_mm=4.0, dt_s=0.01)
    >>> done.force_N.round(6).tolist(), done.deformation_mm.round(6).tolist()
    ([[0.0, 4.0, 0.0]], [[0.0, 2.0, 0.0]])
    """
    n_bodies, n_samples = commanded_mm.shape
    decay = np.exp(-dt_s / np.array(relaxation_s))
    # After a ramp of F_e within the step, this part of it is in Q_i at its end (exact for a constant slope).
    carried = bodies.losses * (1.0 - decay) * np.array(relaxation_s) / dt_s
    lasting, instant = 1.0 - bodies.losses.sum(axis=1), carried.sum(axis=1)
    u, elastic = _at_rest(bodies, commanded_mm[:, 0], machine_N_per_mm)
    held, u_max, force_max = np.zeros_like(bodies.losses), u, elastic
    force_N, deformation_mm = np.zeros((n_bodies, n_samples)), np.zeros((n_bodies, n_samples))
    for t in range(n_samples):
        unloading = t > turn
        relaxed = (held * decay).sum(axis=1) - instant * elastic
        for _ in range(NEWTON_STEPS):
            now, slope = _elastic_force(bodies, u, u_max, force_max, unloading)
            force, stiffness = (lasting + instant) * now + relaxed, (lasting + instant) * slope
            excess = u + force / machine_N_per_mm - commanded_mm[:, t]
            u = np.clip(u - excess / (1.0 + stiffness / machine_N_per_mm), 0.0, None)
        u = np.minimum(u, commanded_mm[:, t])  # the jaws only push
        now, _ = _elastic_force(bodies, u, u_max, force_max, unloading)
        held = held * decay + carried * (now - elastic)[:, None]
        elastic = now
        force_N[:, t] = np.maximum(lasting * now + held.sum(axis=1), 0.0)
        deformation_mm[:, t] = u
        u_max, force_max = np.where(unloading, u_max, u), np.where(unloading, force_max, now)
    return Squeeze(force_N, deformation_mm)


def _at_rest(bodies: Bodies, commanded_mm: np.ndarray, machine_N_per_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Deformation and elastic force, `(body,)` each, under jaws at rest for a long time."""
    lasting = 1.0 - bodies.losses.sum(axis=1)
    none, loading = np.zeros_like(commanded_mm), np.zeros(len(commanded_mm), bool)
    u = commanded_mm.astype(np.float64)
    for _ in range(20):  # start above: Newton's method on a convex function then only descends
        now, slope = _elastic_force(bodies, u, none, none, loading)
        excess = u + lasting * now / machine_N_per_mm - commanded_mm
        u = np.clip(u - excess / (1.0 + lasting * slope / machine_N_per_mm), 0.0, None)
    return u, _elastic_force(bodies, u, none, none, loading)[0]


def _elastic_force(
    bodies: Bodies, u: np.ndarray, u_max: np.ndarray, force_max: np.ndarray, unloading: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """F_e and its slope over u on the current branch of each body."""
    power = bodies.exponent - 1.0
    left_mm = bodies.permanent_set * u_max
    span = np.where(unloading, np.maximum(u_max - left_mm, 1e-12), 1.0)
    along = np.where(unloading, np.maximum(u - left_mm, 0.0) / span, u)
    scale = np.where(unloading, force_max, bodies.stiffness)
    rising = scale * along**power
    return rising * along, bodies.exponent * rising / span
