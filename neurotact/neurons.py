"""The neurons: each differential equation stands here once, as a pure step from state to state.

Afferents are leaky integrate-and-fire neurons stepped on numpy arrays; the neurons of networks are current-based LIF
neurons stepped on torch tensors. Texture paper, Eqs. 1, 4, 5 and 6. Those of special encoders stand beside these.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Union, get_args

import numpy as np

from neurotact.errors import InputError, nearest

if TYPE_CHECKING:  # encoders need no torch
    from torch import Tensor

# --- afferent LIF -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class LIF:
    """A leaky integrate-and-fire neuron on a clock (texture paper, Eq. 1 and Table II).

    While it is not refractory, `U <- U_inf + (U - U_inf) * decay` with `U_inf = v_rest + drive`: the exact
    solution of `tau_mem dU/dt = -(U - v_rest) + drive` for a drive that is constant over a step.
    `U >= v_threshold` spikes; then U stays at v_reset and drive is ignored for `refractory_steps` steps.
    """

    decay: float
    """exp(-dt / tau_mem)."""
    refractory_steps: int
    v_rest_mV: float = -65.0
    v_reset_mV: float = -65.0
    v_threshold_mV: float = -55.0


class LIFState(NamedTuple):
    """Membrane potential in mV and the silent steps still to come, both of one shape."""

    membrane_mV: np.ndarray
    silent_steps: np.ndarray


def lif_start(neuron: LIF, shape: tuple[int, ...], dtype: np.dtype) -> LIFState:
    """The resting state of a group of neurons."""
    return LIFState(np.full(shape, neuron.v_rest_mV, dtype), np.zeros(shape, np.int32))


def lif_step(neuron: LIF, drive_mV: np.ndarray, state: LIFState) -> tuple[np.ndarray, LIFState]:
    """One step: `(spikes, next state)`; spikes are boolean, of the drive's shape and float type.

    >>> neuron = LIF(decay=0.5, refractory_steps=1)
    >>> state = lif_start(neuron, (1,), np.dtype(float))
    >>> spikes = []
    >>> for _ in range(6):
    ...     fired, state = lif_step(neuron, np.array([16.0]), state)
    ...     spikes.append(int(fired[0]))
    >>> spikes
    [0, 1, 0, 0, 1, 0]
    """
    kind = drive_mV.dtype.type
    target = kind(neuron.v_rest_mV) + drive_mV
    membrane = target + (state.membrane_mV - target) * kind(neuron.decay)
    awake = state.silent_steps == 0
    membrane = np.where(awake, membrane, kind(neuron.v_reset_mV))
    fired = awake & (membrane >= kind(neuron.v_threshold_mV))
    silent = silenced(state.silent_steps, fired, neuron.refractory_steps)
    return fired, LIFState(np.where(fired, kind(neuron.v_reset_mV), membrane), silent)


def silenced(silent_steps: np.ndarray, fired: np.ndarray, n_silent: int | np.ndarray) -> np.ndarray:
    """The silent steps still to come after one step, int32: `n_silent` after a spike, else one less.

    >>> silenced(np.array([0, 0, 2]), np.array([True, False, False]), 5).tolist()
    [5, 0, 1]
    """
    return np.where(fired, n_silent, np.maximum(silent_steps - 1, 0)).astype(np.int32)


def refractory_steps(t_ref_ms: float, sampling_rate_Hz: float) -> int:
    """The silent steps of a refractory period, rounded up (with a warning) when not whole.

    >>> refractory_steps(5.0, 2000.0)
    10
    """
    steps = t_ref_ms * 1e-3 * sampling_rate_Hz
    if steps >= 2**31:
        raise InputError(f"t_ref_ms: {t_ref_ms:g} ms is {steps:g} steps, more than 32 bits count; shorten it")
    if abs(steps - round(steps)) <= 1e-9 * max(1.0, steps):
        return round(steps)
    rounded = math.ceil(steps)
    warnings.warn(
        f"t_ref of {t_ref_ms} ms is {steps:g} steps at {sampling_rate_Hz:g} Hz; rounded up to {rounded} "
        f"({1e3 * rounded / sampling_rate_Hz:g} ms)",
        stacklevel=2,
    )
    return rounded


def decay_per_step(tau_ms: float, sampling_rate_Hz: float) -> float:
    """exp(-dt / tau), the factor by which a leaky quantity falls in one step."""
    return math.exp(-1e3 / (tau_ms * sampling_rate_Hz))


# --- afferent LIF between samples -------------------------------------------------------------------


@dataclass(frozen=True)
class ExactLIF:
    """The neuron of `LIF` without a clock: its drive is constant between two samples, and it spikes at any time.

    From U towards U_inf = v_rest + drive, the membrane crosses v_threshold after
    `tau_mem ln((U_inf - U) / (U_inf - v_threshold))`, and never where U_inf <= v_threshold. Then U stays at v_reset,
    and drive is ignored, for t_ref. This is the limit of `LIF` for ever shorter steps (the closed form that
    event-driven simulators use: Brette et al. 2007, doi 10.1007/s10827-007-0038-6, Sec. 2.2).
    """

    tau_mem_ms: float
    t_ref_ms: np.ndarray
    """Above 0, `(neuron,)`."""
    v_rest_mV: float = -65.0
    v_reset_mV: float = -65.0
    v_threshold_mV: float = -55.0


class ExactLIFState(NamedTuple):
    """Membrane potential in mV and the refractory time still to come in ms, both `(trial, neuron)` float64."""

    membrane_mV: np.ndarray
    refractory_ms: np.ndarray


class _SpikeTimes(NamedTuple):
    """Spikes of a group of neurons within an interval, one row a spike.

    which: its neuron, as an index of the flattened `(trial, neuron)`. time_ms: since the interval's begin.
    """

    which: np.ndarray
    time_ms: np.ndarray


def exact_lif_start(neuron: ExactLIF, n_trials: int) -> ExactLIFState:
    """The resting state of a group of neurons."""
    shape = (n_trials, len(neuron.t_ref_ms))
    return ExactLIFState(np.full(shape, neuron.v_rest_mV), np.zeros(shape))


def exact_lif_interval(
    neuron: ExactLIF, drive_mV: np.ndarray, state: ExactLIFState, duration_ms: float
) -> tuple[_SpikeTimes, ExactLIFState]:
    """An interval of constant drive, `(trial, neuron)`: `(spikes, next state)`. A spike at its end belongs to it.

    >>> neuron = ExactLIF(tau_mem_ms=10.0, t_ref_ms=np.array([5.0]))
    >>> spikes, state = exact_lif_interval(neuron, np.array([[20.0]]), exact_lif_start(neuron, 1), 20.0)
    >>> spikes.time_ms.round(2).tolist()  # 10 ln 2, and again after 5 + 10 ln 2
    [6.93, 18.86]
    >>> state.refractory_ms.round(2).tolist()
    [[3.86]]
    """
    tau_ms, threshold_mV = neuron.tau_mem_ms, neuron.v_threshold_mV
    target = neuron.v_rest_mV + drive_mV
    # Rounding could leave a membrane at the threshold that it has not crossed.
    membrane = np.minimum(state.membrane_mV, math.nextafter(threshold_mV, -math.inf))
    begin = np.minimum(state.refractory_ms, duration_ms)
    after = target + (membrane - target) * np.exp((begin - duration_ms) / tau_ms)
    wait = state.refractory_ms - begin
    which = np.flatnonzero((after >= threshold_mV) & (target > threshold_mV))
    goal, t_ref_ms = target.ravel()[which], neuron.t_ref_ms[which % len(neuron.t_ref_ms)]
    room = goal - threshold_mV
    first = begin.ravel()[which] + tau_ms * np.log((goal - membrane.ravel()[which]) / room)
    first = np.minimum(first, duration_ms)
    isi = t_ref_ms + tau_ms * np.log((goal - neuron.v_reset_mV) / room)
    n_spikes = 1 + ((duration_ms - first) / isi).astype(np.int64)
    since = duration_ms - (first + (n_spikes - 1) * isi)
    awake = np.maximum(since - t_ref_ms, 0.0)
    after.reshape(-1)[which] = goal + (neuron.v_reset_mV - goal) * np.exp(-awake / tau_ms)
    wait.reshape(-1)[which] = np.maximum(t_ref_ms - since, 0.0)
    nth = np.arange(n_spikes.sum()) - np.repeat(np.cumsum(n_spikes) - n_spikes, n_spikes)
    times = np.repeat(first, n_spikes) + nth * np.repeat(isi, n_spikes)
    return _SpikeTimes(np.repeat(which, n_spikes), times), ExactLIFState(after, wait)


# --- current-based LIF ------------------------------------------------------------------------------

Membrane = Literal["eq4", "delayed", "immediate"]
Reset = Literal["zero", "subtract", "hard"]
Decay = Union["Tensor", float]
SpikeFunction = Callable[["Tensor"], "Tensor"]
FAST_SIGMOID = "fast-sigmoid"
"""The surrogate gradient that the compiled kernels have."""


class CubaLIFState(NamedTuple):
    """Synaptic current I[t], membrane potential U[t], spikes s[t] and s[t-1], and adaptation A[t].

    Each is `(trial, neuron)`. A[t] stays 0 in a layer without adaptation.
    """

    current: Tensor
    membrane: Tensor
    spikes: Tensor
    spikes_before: Tensor
    adaptation: Tensor


class Adaptation(NamedTuple):
    """A threshold that rises with each spike of its neuron and decays (LSNN: Bellec et al. 2018, NeurIPS).

    `A[t+1] = rho A[t] + s[t]`, `theta[t] = threshold + k A[t]` and `s[t] = 1 where U[t] > theta[t]`; the surrogate
    derivative is that at |U - theta|, and the gradient through A is carried. LSNN adds (1 - rho) s[t]: its beta is
    k / (1 - rho); A without this factor is that of e-prop (Bellec et al. 2020, doi 10.1038/s41467-020-17236-y).
    Float arithmetic rounds U - k A, which is compared with the threshold.

    The reset `subtract` takes off theta, as in LSNN: what is left is the excess over the threshold that was crossed,
    and the next spike is as far as after the other resets. (e-prop takes off the threshold alone: the membrane stays
    k A higher, and the raised threshold hardly slows the neuron.) Like any reset it carries no gradient, not through A
    either.

    >>> import torch
    >>> Adaptation(strength=0.5, decay=0.9).lowered(torch.tensor([2.0]), torch.tensor([1.0]))
    tensor([1.5000])
    """

    strength: Decay
    """k, in units of the threshold's own; above 0."""
    decay: Decay
    """rho = exp(-dt / tau_adaptation)."""

    def after(self, state: CubaLIFState) -> Tensor:
        """A[t+1], from the state at t."""
        return self.decay * state.adaptation + state.spikes

    def lowered(self, membrane: Tensor, adaptation: Tensor) -> Tensor:
        """U - k A: a neuron spikes where this is above its threshold."""
        return membrane - self.strength * adaptation

    def raised(self, threshold: Decay, adaptation: Tensor) -> Tensor:
        """The threshold as far as it is raised: theta = threshold + k A."""
        return threshold + self.strength * adaptation


@dataclass(frozen=True)
class CubaLIF:
    """A current-based LIF neuron (texture paper, Eqs. 4 to 6): which membrane, which reset, which recurrent delay.

    membrane: `eq4` b(U[t] + I[t]) (texture paper), `delayed` b U[t] + I[t] (SpyTorch),
        `immediate` b U[t] + I[t+1] (snnTorch, NIR), with b = exp(-dt / tau_mem).
    reset: `zero` multiplies that sum by (1 - s[t]) (texture paper, SpyTorch, snnTorch), `subtract` takes the
        threshold off it, raised where it adapts, `hard` sets U[t] to 0 before it is formed (NIR, Loihi). The reset
        carries no gradient.
    recurrent_delay_steps: d of the recurrent input V s[t-d] to I[t+1]: 0 (texture paper, snnTorch) or 1 (SpyTorch).

    Step t transmits s[t] under `eq4` and `delayed`, and s[t+1] under `immediate`. So what comes back in step t was
    transmitted d steps before under `eq4` and `delayed`, and d + 1 steps before under `immediate`.

    The Braille-reading study has two networks: its recurrent one, after SpyTorch's tutorials, is `delayed`, `zero`
    and d = 1; the one for Loihi is `immediate`, `hard` and d = 0.
    """

    membrane: Membrane = "eq4"
    reset: Reset = "zero"
    recurrent_delay_steps: int = 0

    def __post_init__(self) -> None:
        if self.recurrent_delay_steps not in (0, 1):
            raise InputError(f"recurrent_delay_steps: must be 0 or 1; got {self.recurrent_delay_steps!r}")
        for key, value, known in (("membrane", self.membrane, Membrane), ("reset", self.reset, Reset)):
            if value not in get_args(known):
                raise InputError(f"{key}: '{value}' is unknown; {nearest(value, get_args(known))}")


def cuba_lif_start(trials: int | Sequence[int], n_neurons: int, like: Tensor) -> CubaLIFState:
    """The zero state, with the float type and device of `like`; trials: their number, or `(network, trial)`."""
    zero = like.new_zeros((*([trials] if isinstance(trials, int) else trials), n_neurons))
    return CubaLIFState(zero, zero, zero, zero, zero)


def recurrent_spikes(neuron: CubaLIF, state: CubaLIFState) -> Tensor:
    """The spikes that drive `I[t+1]` through the recurrent weights: s[t-d].

    >>> import torch
    >>> values = (0.0, 0.0, 1.0, 0.0, 0.0)  # s[t] = 1, s[t-1] = 0
    >>> state = CubaLIFState(*(torch.full((1, 1), value) for value in values))
    >>> [recurrent_spikes(CubaLIF(recurrent_delay_steps=d), state).item() for d in (0, 1)]
    [1.0, 0.0]
    """
    return state.spikes_before if neuron.recurrent_delay_steps else state.spikes


def transmitted_spikes(neuron: CubaLIF, following: CubaLIFState) -> Tensor:
    """The spikes that the step to a state has transmitted: s[t+1] under `immediate`, else s[t]."""
    return following.spikes if neuron.membrane == "immediate" else following.spikes_before


def cuba_lif_step(
    neuron: CubaLIF,
    current: Tensor,
    state: CubaLIFState,
    beta: Decay,
    threshold: Decay,
    spike: SpikeFunction,
    adaptation: Adaptation | None = None,
) -> tuple[Tensor, CubaLIFState]:
    """One step to the synaptic current `I[t+1]`: `(transmitted spikes, next state)`.

    `spike` maps U - threshold to what is transmitted, with its surrogate gradient; the reset acts where
    U > threshold, whatever is transmitted. With `adaptation` U - k A takes the place of U in both.

    >>> import torch
    >>> from neurotact.networks.definition.surrogate import FastSigmoid
    >>> state = cuba_lif_start(1, 1, torch.zeros(1))
    >>> sent = []
    >>> for drive in (1.5, 0.0, 0.0):
    ...     out, state = cuba_lif_step(CubaLIF(), torch.tensor([[drive]]), state, 0.9, 1.0, FastSigmoid(10.0))
    ...     sent.append(out.item())
    >>> sent
    [0.0, 0.0, 1.0]
    """
    compared = state.membrane if adaptation is None else adaptation.lowered(state.membrane, state.adaptation)
    keep = (compared <= threshold).to(current.dtype)
    carried = state.membrane * keep if neuron.reset == "hard" else state.membrane
    if neuron.membrane == "eq4":
        membrane = beta * (carried + state.current)
    elif neuron.membrane == "delayed":
        membrane = beta * carried + state.current
    else:
        membrane = beta * carried + current
    if neuron.reset == "zero":
        membrane = membrane * keep
    elif neuron.reset == "subtract":
        crossed = threshold if adaptation is None else adaptation.raised(threshold, state.adaptation)
        membrane = membrane - (1 - keep) * _detached(crossed)
    raised = state.adaptation if adaptation is None else adaptation.after(state)
    compared = membrane if adaptation is None else adaptation.lowered(membrane, raised)
    # The surrogates of snntorch give float32 whatever they are given.
    spikes = spike(compared - threshold).to(membrane.dtype)
    following = CubaLIFState(current, membrane, spikes, state.spikes, raised)
    return transmitted_spikes(neuron, following), following


def _detached(value: Decay) -> Decay:
    return value if isinstance(value, (int, float)) else value.detach()
