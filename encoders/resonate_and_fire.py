"""Resonate-and-fire: neurons that answer to a frequency of the signal (Izhikevich 2001).

Izhikevich 2001, doi 10.1016/S0893-6080(01)00078-8, Eqs. 1 and 2. Under each taxel there are two, of a low and of a high
frequency, as slowly adapting and Pacinian afferents prefer other vibrations.
"""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.encoders.model import EncoderSpec, Model, Population, RefractoryMs, checked, over_time
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, with_weights
from neurotact.neurons import refractory_steps, silenced
from neurotact.spec import Spec


@dataclass(frozen=True)
class Resonator:
    """A resonate-and-fire neuron on a clock (Izhikevich 2001, doi 10.1016/S0893-6080(01)00078-8, Eqs. 1 and 2).

    `z' = (b + i w) z + I` with `b = -1 / tau`, `w = 2 pi f` and `I = gain x`; Re z is like a current, Im z like a
    potential. `Im z >= 1` spikes: z <- i. A step is the exact solution for an I that is constant over it:
    `z <- z e + I (e - 1) / (b + i w)` with `e = exp((b + i w) dt)`. For `refractory_steps` after a spike z goes on and
    no spike is sent.
    """

    step_ms: float
    tau_ms: float
    frequency_Hz: float
    gain_per_ms: float
    refractory_steps: int = 0

    @property
    def factors(self) -> tuple[complex, complex]:
        """The factors of z and of x in a step."""
        rate = complex(-1 / self.tau_ms, 2e-3 * math.pi * self.frequency_Hz)
        turn = cmath.exp(rate * self.step_ms)
        return turn, self.gain_per_ms * (turn - 1) / rate


class ResonatorState(NamedTuple):
    """Re z and Im z, and the silent steps still to come, all of one shape."""

    current: np.ndarray
    potential: np.ndarray
    silent_steps: np.ndarray


def resonator_start(shape: tuple[int, ...], dtype: np.dtype) -> ResonatorState:
    """The resting state of a group of resonators."""
    return ResonatorState(np.zeros(shape, dtype), np.zeros(shape, dtype), np.zeros(shape, np.int32))


def resonator_step(neuron: Resonator, x: np.ndarray, state: ResonatorState) -> tuple[np.ndarray, ResonatorState]:
    """One step: `(spikes, next state)`; spikes are boolean, of the signal's shape and float type.

    >>> neuron = Resonator(step_ms=1.0, tau_ms=50.0, frequency_Hz=100.0, gain_per_ms=1.6)
    >>> state, spikes = resonator_start((1,), np.dtype(float)), []
    >>> for x in (1.0, 0.0, 0.0, 0.0):  # a pulse; the oscillation is at its height a quarter of 10 ms later
    ...     fired, state = resonator_step(neuron, np.array([x]), state)
    ...     spikes.append(int(fired[0]))
    >>> spikes
    [0, 1, 0, 0]
    """
    kind, (turn, driven) = x.dtype.type, neuron.factors
    current = kind(turn.real) * state.current - kind(turn.imag) * state.potential + kind(driven.real) * x
    potential = kind(turn.imag) * state.current + kind(turn.real) * state.potential + kind(driven.imag) * x
    fired = (potential >= 1) & (state.silent_steps == 0)
    silent = silenced(state.silent_steps, fired, neuron.refractory_steps)
    current, potential = np.where(fired, kind(0), current), np.where(fired, kind(1), potential)
    return fired, ResonatorState(current, potential, silent)


class ResonatorType(Spec):
    """One population: a resonator under each taxel."""

    frequency_Hz: float = Field(gt=0)
    """Eigenfrequency."""
    gain_per_ms: float = Field(gt=0)
    """Current I per unit of the conditioned signal."""
    t_ref_ms: RefractoryMs = 1.0
    """Refractory period; the oscillation goes on in it."""


class ResonateAndFireSpec(EncoderSpec):
    """A LOW and a HIGH population of resonators over every taxel (`encoders/resonate-and-fire.toml`)."""

    model: Literal["resonate-and-fire"] = "resonate-and-fire"
    """Resonate-and-fire neurons."""
    tau_ms: float = Field(default=20.0, gt=0)
    """Time constant with which an oscillation dies away (-1 / b)."""
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


def cost(_spec: Mapping[str, Any], taxels: int, steps: int, _step_ms: float) -> Cost:
    """The cost of an encoder over that many steps.

    Per resonator and step: Re z and Im z take three MACs each, two for the turn and one for the signal, whose gain is
    in its factor; then the comparison with the threshold. Resets are rare and not counted.
    """
    afferents = 2 * taxels
    updates = afferents * steps
    moved = {"weights_accesses": updates, **changed(3, updates)}
    return with_weights(2, 3 * afferents, macs=6 * updates, comparisons=updates, **moved)


MODEL = Model(
    "resonate-and-fire afferents", ResonateAndFireSpec, encode, ResonateAndFireState,
    (Population("LOW", "low"), Population("HIGH", "high")), cost,
)  # fmt: skip
