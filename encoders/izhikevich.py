"""SA-I and RA-I afferents as Izhikevich neurons: the usual encoding before the texture paper (its Table I)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.compiled import Signals, address, is_compiled, padded
from pydantic import Field, model_validator

from neurotact.backend import Backend, native
from neurotact.encoders.afferents import drives
from neurotact.encoders.model import EncoderSpec, Model, checked
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, in_registers, with_weights
from neurotact.spec import Spec

LONGEST_STEP_ms = 1.0
"""Longest step of the clock: in a longer one, two spikes would fall into one step."""


@dataclass(frozen=True)
class Izhikevich:
    """An Izhikevich neuron on a clock (Izhikevich 2003, doi 10.1109/TNN.2003.820440, Eqs. 1 to 3).

    `v' = 0.04 v^2 + 5 v + 140 - u + I`, `u' = a (b v - u)`; `v >= v_peak` spikes: v <- c, u <- u + d.
    v in mV, t in ms; so u and the current I are in mV/ms. The default constants are those of regular spiking.
    Each step of the clock is `euler_steps` forward Euler steps; it holds one spike at most.
    """

    euler_step_ms: float
    euler_steps: int
    a_per_ms: float = 0.02
    b_per_ms: float = 0.2
    c_mV: float = -65.0
    d_mV_per_ms: float = 8.0
    v_peak_mV: float = 30.0


class IzhikevichState(NamedTuple):
    """Membrane potential v in mV and recovery u in mV/ms, both of one shape."""

    membrane_mV: np.ndarray
    recovery_mV_per_ms: np.ndarray


def izhikevich_rest_mV(neuron: Izhikevich) -> float:  # noqa: N802
    """The stable membrane potential without a current; NaN where there is none.

    >>> izhikevich_rest_mV(Izhikevich(euler_step_ms=0.1, euler_steps=5))
    -70.0
    """
    slope = 5 - neuron.b_per_ms
    inside = slope**2 - 4 * 0.04 * 140
    return round((-slope - math.sqrt(inside)) / 0.08, 9) if inside >= 0 else math.nan


def izhikevich_least_current(neuron: Izhikevich) -> float:
    """The current in mV/ms below which forward Euler overshoots the resting branch and fires where no neuron would.

    The branch is stable while `|1 + h (0.08 v + 5)| < 1`; this is the current that holds v at that limit, b v = u.
    """
    limit_mV = (-2 / neuron.euler_step_ms - 5) / 0.08
    return -((0.04 * limit_mV + 5) * limit_mV + 140 - neuron.b_per_ms * limit_mV)


def izhikevich_start(neuron: Izhikevich, shape: tuple[int, ...], dtype: np.dtype) -> IzhikevichState:
    """The resting state of a group of neurons."""
    rest_mV = izhikevich_rest_mV(neuron)
    return IzhikevichState(np.full(shape, rest_mV, dtype), np.full(shape, neuron.b_per_ms * rest_mV, dtype))


def izhikevich_step(
    neuron: Izhikevich, current_mV_per_ms: np.ndarray, state: IzhikevichState
) -> tuple[np.ndarray, IzhikevichState]:
    """One step of the clock: `(spikes, next state)`; spikes are boolean, of the current's shape and float type.

    >>> neuron = Izhikevich(euler_step_ms=0.1, euler_steps=10)  # a clock of 1 ms
    >>> state, spikes = izhikevich_start(neuron, (1,), np.dtype(float)), []
    >>> for _ in range(100):
    ...     fired, state = izhikevich_step(neuron, np.array([10.0]), state)
    ...     spikes.append(fired[0])
    >>> np.flatnonzero(spikes).tolist()
    [3, 21, 66]
    """
    h, v, u = neuron.euler_step_ms, state.membrane_mV, state.recovery_mV_per_ms
    fired = np.zeros(v.shape, bool)
    for _ in range(neuron.euler_steps):
        slope = (0.04 * v + 5) * v + 140 - u + current_mV_per_ms
        u = u + h * neuron.a_per_ms * (neuron.b_per_ms * v - u)
        v = v + h * slope
        peak = v >= neuron.v_peak_mV
        if peak.any():
            v = np.where(peak, v.dtype.type(neuron.c_mV), v)
            u = u + peak * v.dtype.type(neuron.d_mV_per_ms)
            fired |= peak
    return fired, IzhikevichState(v, u)


class IzhikevichType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain_mV_per_ms: float = Field(gt=0)
    """Current I per unit of the conditioned signal (SA-I) or per unit per ms (RA-I)."""


class IzhikevichSpec(EncoderSpec):
    """An SA-I and an RA-I population of Izhikevich neurons over every taxel (`encoders/izhikevich.toml`)."""

    model: Literal["izhikevich"] = "izhikevich"
    """Izhikevich neurons."""
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
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: IzhikevichSpec,
    state: IzhikevichEncoderState | None = None,
    *,
    backend: Backend = "auto",
) -> tuple[np.ndarray, IzhikevichEncoderState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    As in `afferents.encode`: the state is an argument and a result, the arithmetic is in the signal's float type; both
    implementations give the same spikes and states.
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
    gains = spec.sa1.gain_mV_per_ms, spec.ra1.gain_mV_per_ms * sampling_rate_Hz * 1e-3
    spikes, state, lowest = (_compiled if is_compiled(signal, backend) else _by_steps)(signal, neuron, gains, state)
    least = izhikevich_least_current(neuron)
    if lowest < least:
        raise InputError(
            f"sa1.gain_mV_per_ms: the signal drives a current of {lowest:.4g} mV/ms, and below {least:.4g} the "
            f"integration in steps of {neuron.euler_step_ms:g} ms is unstable; lower the gain or euler_step_ms"
        )
    return spikes, state


_Encoded = tuple[np.ndarray, IzhikevichEncoderState, float]
"""Spikes, the next state, and the lowest current, if that is below 0."""


def _by_steps(
    signal: np.ndarray, neuron: Izhikevich, gains: tuple[float, float], state: IzhikevichEncoderState
) -> _Encoded:
    """The definition, step by step."""
    current, last = drives(signal, ((gains[0],), (gains[1],)), state.last)
    spikes, neurons = np.empty(current.shape, np.uint8), state.neurons
    with np.errstate(over="ignore", invalid="ignore"):  # what a too low current makes is not returned
        for t in range(signal.shape[1]):
            spikes[:, t], neurons = izhikevich_step(neuron, current[:, t], neurons)
    return spikes, IzhikevichEncoderState(neurons, last), float(current.min(initial=0.0))


def _compiled(
    signal: np.ndarray, neuron: Izhikevich, gains: tuple[float, float], state: IzhikevichEncoderState
) -> _Encoded:
    """With the kernel."""
    signals, kind, (n_trials, n_steps, n_taxels) = Signals(signal, 2), signal.dtype, signal.shape
    membrane, recovery = (padded(values.reshape(n_trials, 2, n_taxels), kind) for values in state.neurons)
    last = padded(np.zeros((n_trials, n_taxels)) if state.last is None else state.last, kind)
    lowest = native.izhikevich(  # pyright: ignore[reportOptionalMemberAccess]
        **signals.given, sa_gain=gains[0], ra_gain=gains[1], step_ms=neuron.euler_step_ms,
        recovers=neuron.euler_step_ms * neuron.a_per_ms, b=neuron.b_per_ms, c=neuron.c_mV, d=neuron.d_mV_per_ms,
        peak=neuron.v_peak_mV, euler_steps=neuron.euler_steps, has_last=state.last is not None,
        last=address(last), membrane=address(membrane), recovery=address(recovery),
    )  # fmt: skip
    neurons = (signals.of_taxels(values).reshape(n_trials, 2 * n_taxels) for values in (membrane, recovery))
    following = signals.of_taxels(last) if n_steps else state.last
    return signals.spikes, IzhikevichEncoderState(IzhikevichState(*neurons), following), lowest


def _euler_steps(step_ms: float, longest_ms: float) -> int:
    """Steps of the integration in a step of the clock."""
    return max(1, math.ceil(step_ms / longest_ms - 1e-9))


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of an encoder, given as a table, over `steps` steps of `step_ms`.

    Per afferent and Euler step: v' takes two MACs, `(0.04 v + 5) v + 140`, a subtraction and an addition; u' a product
    and a subtraction, `b v - u`; the steps of both a MAC each; then a comparison with the peak. Per step of the clock
    the gain is a product, and RA-I takes a difference and its absolute value beside. Resets are rare and not counted.
    """
    afferents, euler_steps = 2 * taxels, _euler_steps(step_ms, spec["euler_step_ms"])
    euler = in_registers(macs=4, acs=3, multiplications=1, comparisons=1).times(afferents * steps * euler_steps)
    state = 2 * afferents + taxels  # v and u of both, the sample before
    step = Cost(acs=1, multiplications=2, comparisons=1, weights_accesses=2, **changed(state // taxels))
    return with_weights(2, state) + euler + step.times(taxels * steps)


MODEL = Model(
    "Izhikevich afferents", IzhikevichSpec, encode, IzhikevichEncoderState, cost=cost,
    not_streamed="a sample far below rest would make their integration unstable",
)  # fmt: skip
