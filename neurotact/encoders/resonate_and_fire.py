"""Resonate-and-fire: neurons that answer to a frequency of the signal (Izhikevich 2001).

Izhikevich 2001, doi 10.1016/S0893-6080(01)00078-8, Eqs. 1 and 2. Under each taxel there are two, of a low and of a high
frequency, as slowly adapting and Pacinian afferents prefer other vibrations.
"""

from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders.afferents import checked
from neurotact.encoders.refractory import RefractoryMs
from neurotact.encoders.stepping import over_time
from neurotact.errors import InputError
from neurotact.neurons import Resonator, ResonatorState, refractory_steps, resonator_start, resonator_step
from neurotact.spec import Spec


class ResonatorType(Spec):
    """One population: a resonator under each taxel."""

    frequency_Hz: float = Field(gt=0)
    """Eigenfrequency."""
    gain_per_ms: float = Field(gt=0)
    """Current I per unit of the conditioned signal."""
    t_ref_ms: RefractoryMs = 1.0
    """Refractory period; the oscillation goes on in it."""

    @property
    def gain(self) -> float:
        """The gain under its common name, in its own unit."""
        return self.gain_per_ms


class ResonateAndFireSpec(Spec):
    """A LOW and a HIGH population of resonators over every taxel (`encoders/resonate-and-fire.toml`)."""

    folder: ClassVar[str] = "encoders"

    model: Literal["resonate-and-fire"] = "resonate-and-fire"
    """Resonate-and-fire neurons."""
    unit: str = "mV"
    """The unit of the recordings."""
    tau_ms: float = Field(default=20.0, gt=0)
    """Time constant with which an oscillation dies away (-1 / b)."""
    conditioning: ConditioningSpec = ConditioningSpec()
    low: ResonatorType
    """Resonators of a low frequency, driven by the signal."""
    high: ResonatorType
    """Resonators of a high frequency, driven by the signal."""


class ResonateAndFireState(NamedTuple):
    """The state of both populations, `(trial, taxel)` each."""

    low: ResonatorState
    high: ResonatorState


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: ResonateAndFireSpec, state: ResonateAndFireState | None = None
) -> tuple[np.ndarray, ResonateAndFireState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, LOW first.

    Raises InputError for a frequency that is not below half the clock.

    >>> kinds = {"low": ResonatorType(frequency_Hz=10, gain_per_ms=0.15),
    ...          "high": ResonatorType(frequency_Hz=40, gain_per_ms=0.15)}
    >>> time_s = np.arange(0, 1, 1e-3)[None, :, None]
    >>> fired = [encode(np.sin(2 * np.pi * f * time_s), 1000.0, ResonateAndFireSpec(**kinds))[0] for f in (10, 40)]
    >>> [spikes[0].sum(axis=0).tolist() for spikes in fired]
    [[10, 0], [0, 39]]
    """
    signal = checked(signal)
    n_trials, _, n_taxels = signal.shape
    resonators = tuple(
        _resonator(kind, part, spec.tau_ms, sampling_rate_Hz) for part, kind in (("low", spec.low), ("high", spec.high))
    )
    if state is None:
        state = ResonateAndFireState(*(resonator_start((n_trials, n_taxels), signal.dtype) for _ in resonators))

    def step(x: np.ndarray, state: ResonateAndFireState) -> tuple[np.ndarray, ResonateAndFireState]:
        (low, after_low), (high, after_high) = (
            resonator_step(neuron, x, own) for neuron, own in zip(resonators, state, strict=True)
        )
        return np.concatenate([low, high], axis=1), ResonateAndFireState(after_low, after_high)

    return over_time(signal, state, step, 2 * n_taxels)


def _resonator(kind: ResonatorType, part: str, tau_ms: float, sampling_rate_Hz: float) -> Resonator:
    if kind.frequency_Hz >= sampling_rate_Hz / 2:
        raise InputError(
            f"{part}.frequency_Hz: {kind.frequency_Hz:g} Hz is not below half the clock of {sampling_rate_Hz:g} Hz; "
            "lower it, or set conditioning.resample_Hz"
        )
    return Resonator(
        step_ms=1e3 / sampling_rate_Hz,
        tau_ms=tau_ms,
        frequency_Hz=kind.frequency_Hz,
        gain_per_ms=kind.gain_per_ms,
        refractory_steps=refractory_steps(kind.t_ref_ms, sampling_rate_Hz),
    )
