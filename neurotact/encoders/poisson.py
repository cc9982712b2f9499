"""SA-I and RA-I afferents as Poisson processes whose rate is the drive (texture paper, Table I, its reference 18)."""

from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders.afferents import checked, drives
from neurotact.encoders.random_numbers import random_integers
from neurotact.encoders.refractory import RefractoryMs
from neurotact.errors import InputError
from neurotact.neurons import refractory_steps, silenced
from neurotact.spec import Spec


class PoissonType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain_Hz: float = Field(gt=0)
    """Firing rate per unit of the conditioned signal (SA-I) or per unit per ms (RA-I)."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time after a spike; none in a Poisson process proper."""

    @property
    def gain(self) -> float:
        """The gain under its common name, in its own unit."""
        return self.gain_Hz


class PoissonSpec(Spec):
    """An SA-I and an RA-I population of Poisson afferents over every taxel (`encoders/poisson.toml`)."""

    folder: ClassVar[str] = "encoders"

    model: Literal["poisson"] = "poisson"
    """Poisson processes."""
    unit: str = "mV"
    """The unit of the recordings."""
    seed: int = Field(default=0, ge=0, lt=2**63)
    """Random seed: the same spec and recordings give the same spikes."""
    conditioning: ConditioningSpec = ConditioningSpec()
    sa1: PoissonType
    """Driven by the signal."""
    ra1: PoissonType
    """Driven by the signal's rate of change."""


class PoissonState(NamedTuple):
    """The state of the encoder between pieces.

    trials: numbers of the trials, which seed their random numbers, `(trial,)`.
    step: number of steps done.
    silent_steps: remaining dead steps, `(trial, 2 taxel)`.
    last: the signal's last sample, `(trial, taxel)`; None before the first.
    """

    trials: np.ndarray
    step: int
    silent_steps: np.ndarray
    last: np.ndarray | None


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: PoissonSpec,
    state: PoissonState | None = None,
    *,
    trials: np.ndarray | None = None,
) -> tuple[np.ndarray, PoissonState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    A step holds a spike with the probability `1 - exp(-rate dt)` that a Poisson process of the drive's rate has one
    or more events in it; a negative drive is a rate of 0. Each afferent of each trial has its own random numbers,
    one per step, so that they do not depend on pieces, other trials or other taxels.

    trials: numbers of the trials, `(trial,)`, which seed their random numbers; 0, 1, ... when absent. A given state
        takes precedence.

    >>> spec = PoissonSpec(sa1=PoissonType(gain_Hz=20.0), ra1=PoissonType(gain_Hz=100.0))
    >>> spikes, _ = encode(np.full((1, 20000, 1), 5.0), 2000.0, spec)  # 10 s at 100 Hz
    >>> spikes.shape, 900 < spikes[..., 0].sum() < 1100, int(spikes[..., 1].sum())
    ((1, 20000, 2), np.True_, 0)
    """
    signal = checked(signal)
    n_trials, n_steps, n_taxels = signal.shape
    if state is None:
        numbers = np.arange(n_trials) if trials is None else np.asarray(trials)
        state = PoissonState(numbers, 0, np.zeros((n_trials, 2 * n_taxels), np.int32), None)
    if state.trials.shape != (n_trials,):
        raise InputError(f"trials: {state.trials.size} numbers for {n_trials} trials; give one per trial")
    gains = ((spec.sa1.gain_Hz,), (spec.ra1.gain_Hz * sampling_rate_Hz * 1e-3,))
    rates_Hz, last = drives(signal, gains, state.last)
    spikes = np.zeros(rates_Hz.shape, np.uint8)
    drawn = random_integers(spec.seed, state.trials, state.step, n_steps, n_taxels, n_copies=2)
    for i, afferent, integers in drawn:
        uniform = (integers >> np.uint64(11)) * 2.0**-53
        expected = np.maximum(rates_Hz[i, :, afferent], 0.0).astype(np.float64) / sampling_rate_Hz
        spikes[i, :, afferent] = uniform < -np.expm1(-expected)
    dead = [refractory_steps(kind.t_ref_ms, sampling_rate_Hz) for kind in (spec.sa1, spec.ra1)]
    silent_steps = _silence(spikes, np.repeat(dead, n_taxels), state.silent_steps) if any(dead) else state.silent_steps
    return spikes, PoissonState(state.trials, state.step + n_steps, silent_steps, last)


def _silence(spikes: np.ndarray, dead_steps: np.ndarray, silent_steps: np.ndarray) -> np.ndarray:
    """Remove the spikes in the dead time of others, in place; returns the remaining dead steps."""
    for t in range(spikes.shape[1]):
        fired = (spikes[:, t] != 0) & (silent_steps == 0)
        spikes[:, t] = fired
        silent_steps = silenced(silent_steps, fired, dead_steps)
    return silent_steps
