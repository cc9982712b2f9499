"""SA-I and RA-I afferents as Izhikevich neurons: the usual encoding before the texture paper (its Table I)."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from neurotact.data.conditioning import ConditioningSpec
from neurotact.encoders.afferents import checked, drives
from neurotact.errors import InputError
from neurotact.metrics.flops import IzhikevichAfferents
from neurotact.neurons import (
    Izhikevich,
    IzhikevichState,
    izhikevich_least_current,
    izhikevich_rest_mV,
    izhikevich_start,
    izhikevich_step,
)
from neurotact.spec import Spec

LONGEST_STEP_ms = 1.0
"""Longest step of the clock: in a longer one, two spikes would fall into one step."""


class IzhikevichType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain_mV_per_ms: float = Field(gt=0)
    """Current I per unit of the conditioned signal (SA-I) or per unit per ms (RA-I)."""

    t_ref_ms: ClassVar[float] = 0.0
    """There is none: the recovery u keeps the neuron silent after a spike."""

    @property
    def gain(self) -> float:
        """The gain under its common name, in its own unit."""
        return self.gain_mV_per_ms


class IzhikevichSpec(Spec):
    """An SA-I and an RA-I population of Izhikevich neurons over every taxel (`encoders/izhikevich.toml`)."""

    folder: ClassVar[str] = "encoders"

    model: Literal["izhikevich"] = "izhikevich"
    """Izhikevich neurons."""
    unit: str = "mV"
    """The unit of the recordings."""
    a_per_ms: float = Field(default=0.02, gt=0)
    """Rate of the recovery u."""
    b_per_ms: float = 0.2
    """Sensitivity of u to v."""
    c_mV: float = -65.0
    """Reset value of v after a spike."""
    d_mV_per_ms: float = 8.0
    """Increment of u at a spike."""
    v_peak_mV: float = 30.0
    """Peak of v, at which a spike is cut off."""
    euler_step_ms: float = Field(default=0.1, ge=1e-3, le=0.5)
    """The longest step of the integration; a step of the clock is divided evenly."""
    conditioning: ConditioningSpec = ConditioningSpec()
    sa1: IzhikevichType
    """Driven by the signal."""
    ra1: IzhikevichType
    """Driven by the signal's rate of change."""

    @model_validator(mode="after")
    def _can_fire(self) -> "IzhikevichSpec":
        if self.v_peak_mV <= self.c_mV:
            raise ValueError("v_peak_mV must be above c_mV, else the neuron fires at every step")
        if math.isnan(izhikevich_rest_mV(self.neuron(1e3))):
            raise ValueError("b_per_ms leaves the neuron without a resting potential; keep (5 - b)^2 >= 22.4")
        return self

    def neuron(self, sampling_rate_Hz: float) -> Izhikevich:
        """The neuron of both populations on a clock."""
        step_ms = 1e3 / sampling_rate_Hz
        euler_steps = _euler_steps(step_ms, self.euler_step_ms)
        return Izhikevich(
            euler_step_ms=step_ms / euler_steps,
            euler_steps=euler_steps,
            a_per_ms=self.a_per_ms,
            b_per_ms=self.b_per_ms,
            c_mV=self.c_mV,
            d_mV_per_ms=self.d_mV_per_ms,
            v_peak_mV=self.v_peak_mV,
        )


class IzhikevichEncoderState(NamedTuple):
    """The state of the encoder between pieces: all neurons `(trial, 2 taxel)` and the last sample `(trial, taxel)`.

    `last` is None before the first sample.
    """

    neurons: IzhikevichState
    last: np.ndarray | None


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: IzhikevichSpec, state: IzhikevichEncoderState | None = None
) -> tuple[np.ndarray, IzhikevichEncoderState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    As in `afferents.encode`: the state is an argument and a result, the arithmetic is in the signal's float type.
    Raises InputError for a clock below 1 kHz, and for a current too negative for the integration step.

    >>> spec = IzhikevichSpec(sa1=IzhikevichType(gain_mV_per_ms=1.0), ra1=IzhikevichType(gain_mV_per_ms=5.0))
    >>> spikes, _ = encode(np.full((1, 1000, 1), 10.0), 2000.0, spec)
    >>> spikes.shape, spikes.sum(axis=1).tolist()
    ((1, 1000, 2), [[12, 0]])
    """
    signal = checked(signal)
    if sampling_rate_Hz * LONGEST_STEP_ms < 1e3 * (1 - 1e-9):
        raise InputError(
            f"sampling_rate_Hz: Izhikevich afferents need a clock of 1 kHz or more; got {sampling_rate_Hz:g} Hz; "
            "set conditioning.resample_Hz = 1000.0"
        )
    neuron = spec.neuron(sampling_rate_Hz)
    if state is None:
        shape = (signal.shape[0], 2 * signal.shape[2])
        state = IzhikevichEncoderState(izhikevich_start(neuron, shape, signal.dtype), None)
    gains = ((spec.sa1.gain_mV_per_ms,), (spec.ra1.gain_mV_per_ms * sampling_rate_Hz * 1e-3,))
    current, last = drives(signal, gains, state.last)
    least = izhikevich_least_current(neuron)
    if current.min(initial=0.0) < least:
        raise InputError(
            f"sa1.gain_mV_per_ms: the signal drives a current of {current.min():.4g} mV/ms, and below {least:.4g} the "
            f"integration in steps of {neuron.euler_step_ms:g} ms is unstable; lower the gain or euler_step_ms"
        )
    spikes, neurons = np.empty(current.shape, np.uint8), state.neurons
    for t in range(signal.shape[1]):
        spikes[:, t], neurons = izhikevich_step(neuron, current[:, t], neurons)
    return spikes, IzhikevichEncoderState(neurons, last)


def layer(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> IzhikevichAfferents:
    """The layer of the cost ledger for an encoder given as a table, over `steps` steps of `step_ms`."""
    return IzhikevichAfferents(taxels, steps, _euler_steps(step_ms, spec["euler_step_ms"]))


def _euler_steps(step_ms: float, longest_ms: float) -> int:
    """Steps of the integration in a step of the clock."""
    return max(1, math.ceil(step_ms / longest_ms - 1e-9))
