"""SA-I and RA-I afferents as Poisson processes whose rate is the drive (texture paper, Table I, its reference 18)."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.random_numbers import check_continued, digests, random_integers
from pydantic import Field

from neurotact.encoders.afferents import drives
from neurotact.encoders.model import EncoderSpec, Model, RefractoryMs, checked
from neurotact.metrics.flops import Cost, changed, with_weights
from neurotact.neurons import refractory_steps, silenced
from neurotact.spec import Spec

VALUES = 32_768
"""Steps of taxels whose random numbers are drawn at once: so many stay in a cache."""


class PoissonType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain_Hz: float = Field(gt=0)
    """Firing rate per unit of the conditioned signal (SA-I) or per unit per ms (RA-I)."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time after a spike; none in a Poisson process proper."""


class PoissonSpec(EncoderSpec):
    """An SA-I and an RA-I population of Poisson afferents over every taxel (`encoders/poisson.toml`)."""

    model: Literal["poisson"] = "poisson"
    """Poisson processes."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """Random seed: a trial has the same spikes whenever its samples and the spec are the same."""
    sa1: PoissonType
    """Driven by the signal."""
    ra1: PoissonType
    """Driven by the signal's rate of change."""


class PoissonState(NamedTuple):
    """The state of the encoder between pieces.

    digest: of the samples so far, from which the random numbers are drawn, `(trial, taxel)` uint64.
    step: number of steps done.
    silent_steps: remaining dead steps, `(trial, 2 taxel)`.
    last: the signal's last sample, `(trial, taxel)`; None before the first.
    """

    digest: np.ndarray
    step: int
    silent_steps: np.ndarray
    last: np.ndarray | None


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: PoissonSpec, state: PoissonState | None = None
) -> tuple[np.ndarray, PoissonState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    A step holds a spike with the probability `1 - exp(-rate dt)` that a Poisson process of the drive's rate has one
    or more events in it; a negative drive is a rate of 0. The random numbers of an afferent depend on the seed, its
    place on the skin and the samples of its taxel so far (`random_numbers.py`), so that pieces, other trials and other
    taxels do not change them. Trials of the same samples give the same spikes; more of them need other seeds.

    >>> spec = PoissonSpec(sa1=PoissonType(gain_Hz=20.0), ra1=PoissonType(gain_Hz=100.0))
    >>> spikes, _ = encode(np.full((1, 20000, 1), 5.0), 2000.0, spec)  # 10 s at 100 Hz
    >>> spikes.shape, 900 < spikes[..., 0].sum() < 1100, int(spikes[..., 1].sum())
    ((1, 20000, 2), np.True_, 0)
    """
    signal = checked(signal)
    n_trials, n_steps, n_taxels = signal.shape
    if state is None:
        digest, silent = np.zeros((n_trials, n_taxels), np.uint64), np.zeros((n_trials, 2 * n_taxels), np.int32)
        state = PoissonState(digest, 0, silent, None)
    check_continued(state.digest, signal)
    gains = ((spec.sa1.gain_Hz,), (spec.ra1.gain_Hz * sampling_rate_Hz * 1e-3,))
    rates_Hz, last = drives(signal, gains, state.last)
    spikes, after = np.zeros(rates_Hz.shape, np.uint8), state.digest.copy()
    at_once = max(1, VALUES // max(1, n_steps * n_taxels))
    for first in range(0, n_trials, at_once):
        block = slice(first, first + at_once)
        digest, after[block] = digests(signal[block], state.step, state.digest[block])
        for copy in range(2):
            its = slice(copy * n_taxels, (copy + 1) * n_taxels)
            uniform = (random_integers(spec.seed, digest, copy) >> np.uint64(11)) * 2.0**-53
            expected = np.maximum(rates_Hz[block, :, its], 0.0).astype(np.float64) / sampling_rate_Hz
            spikes[block, :, its] = uniform < -np.expm1(-expected)
    dead = [refractory_steps(kind.t_ref_ms, sampling_rate_Hz) for kind in (spec.sa1, spec.ra1)]
    silent_steps = _silence(spikes, np.repeat(dead, n_taxels), state.silent_steps) if any(dead) else state.silent_steps
    return spikes, PoissonState(after, state.step + n_steps, silent_steps, last)


def _silence(spikes: np.ndarray, dead_steps: np.ndarray, silent_steps: np.ndarray) -> np.ndarray:
    """Remove the spikes in the dead time of others, in place; returns the remaining dead steps."""
    for t in range(spikes.shape[1]):
        fired = (spikes[:, t] != 0) & (silent_steps == 0)
        spikes[:, t] = fired
        silent_steps = silenced(silent_steps, fired, dead_steps)
    return silent_steps


def cost(_spec: Mapping[str, Any], taxels: int, steps: int, _step_ms: float) -> Cost:
    """The cost of an encoder over that many steps.

    Per afferent and step: gain times drive, a random number and the comparison of both. The number is counted as a
    linear congruential one, a MAC, the cheapest that serves; the chance of a step as the drive itself. RA-I takes a
    difference and its absolute value beside.
    """
    state = 3 * taxels  # a random number of each afferent, the sample before
    step = Cost(macs=2, acs=1, multiplications=2, comparisons=2 + 1, weights_accesses=2, **changed(state // taxels))
    return with_weights(2, state) + step.times(taxels * steps)


MODEL = Model("Poisson afferents", PoissonSpec, encode, PoissonState, cost=cost)
