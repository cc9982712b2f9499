"""Latency: in each cycle an afferent fires once, the sooner the stronger its drive (time to first spike).

The order of first spikes of human tactile afferents tells force direction and shape (Johansson and Birznieks 2004,
doi 10.1038/nn1177). A threshold that falls exponentially makes the latency a logarithm of the drive, as in T2FSNN
(Park et al. 2020, doi 10.1109/DAC18072.2020.9218689).
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from neurotact.encoders.afferents import drives
from neurotact.encoders.model import EncoderSpec, Model, checked, over_time
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, in_registers, with_weights
from neurotact.spec import Spec


class LatencyType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain: float = Field(gt=0)
    """Drive per unit of the conditioned signal (SA-I) or per unit per ms (RA-I); a drive of 1 fires at once."""


class LatencySpec(EncoderSpec):
    """An SA-I and an RA-I population of one spike a cycle over every taxel (`encoders/latency.toml`)."""

    model: Literal["latency"] = "latency"
    """One spike a cycle, the sooner the stronger the drive."""
    cycle_ms: float = Field(default=50.0, gt=0)
    """Length of a cycle."""
    tau_ms: float = Field(default=15.0, gt=0)
    """Time constant of the falling threshold; the weakest drive that fires is `exp(-cycle_ms / tau_ms)`."""
    begins: Literal["clock", "contact"] = "clock"
    """Cycles follow each other from the first sample on, or each contact begins one cycle."""
    contact: float = Field(default=0.2, gt=0)
    """With `begins = "contact"`: the SA-I drive of a taxel from which on there is contact."""
    quiet_ms: float = Field(default=50.0, ge=0)
    """With `begins = "contact"`: for how long no drive may have reached `contact` before."""
    sa1: LatencyType
    """Driven by the signal."""
    ra1: LatencyType
    """Driven by the signal's rate of change."""


class LatencyState(NamedTuple):
    """The state of the encoder between pieces.

    since: steps since the cycle began, `(trial,)`; if as many as a cycle has, none is open. sent: whether an afferent
    has fired in it, `(trial, 2 taxel)`. quiet: steps since the last contact, `(trial,)`. last: the signal's last one,
    `(trial, taxel)`; None before the first.
    """

    since: np.ndarray
    sent: np.ndarray
    quiet: np.ndarray
    last: np.ndarray | None


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: LatencySpec, state: LatencyState | None = None
) -> tuple[np.ndarray, LatencyState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    At a time t after the beginning of a cycle an afferent fires if its drive D has reached `exp(-t / tau)` and it has
    not fired in this cycle: a constant drive fires at `t = tau ln(1 / D)`. No future is needed, so that cycles go on in
    a stream: they count from its first sample (or from a contact), and not from the windows that a network decides.
    Windows whose length and distance are multiples of a cycle see each cycle whole.

    With `begins = "contact"` a cycle opens when an SA-I drive reaches `contact` after `quiet_ms` without; after it all
    are silent until the next contact.

    Raises InputError for a cycle shorter than two steps of the clock.

    >>> spec = LatencySpec(tau_ms=10.0, sa1=LatencyType(gain=1.0), ra1=LatencyType(gain=1.0))
    >>> strength = np.exp([-2.0, -1.0, 0.0])  # fire after 2, 1 and 0 tau
    >>> spikes, _ = encode(np.tile(strength, (1, 50, 1)), 1000.0, spec)
    >>> spikes[0, :, :3].argmax(axis=0).tolist()
    [20, 10, 0]
    """
    signal = checked(signal)
    longest = 2**31 - 1  # steps that int32 counts: longer than any trial
    n_cycle, n_quiet = (min(longest, round(ms * 1e-3 * sampling_rate_Hz)) for ms in (spec.cycle_ms, spec.quiet_ms))
    if n_cycle < 2:
        raise InputError(f"cycle_ms: {spec.cycle_ms:g} ms is below two steps at {sampling_rate_Hz:g} Hz; lengthen it")
    kind, (n_trials, _, n_taxels) = signal.dtype.type, signal.shape
    # Slightly below the exponential, so that a drive that equals it in decimals fires.
    falling = np.exp(-np.arange(n_cycle) * 1e3 / (sampling_rate_Hz * spec.tau_ms)) * (1 - 1e-6)
    levels = np.append(falling, np.inf).astype(kind)
    gains = ((spec.sa1.gain,), (spec.ra1.gain * sampling_rate_Hz * 1e-3,))
    on_contact = spec.begins == "contact"
    if state is None:
        state = LatencyState(
            np.full(n_trials, n_cycle, np.int32),
            np.zeros((n_trials, 2 * n_taxels), bool),
            np.full(n_trials, n_quiet, np.int32),
            None,
        )
    drive, last = drives(signal, gains, state.last)

    def step(now: np.ndarray, state: LatencyState) -> tuple[np.ndarray, LatencyState]:
        touched = (now[:, :n_taxels] >= kind(spec.contact)).any(axis=1)
        open_ = state.since < n_cycle
        begins = touched & (state.quiet >= n_quiet) & ~open_ if on_contact else ~open_
        since = np.where(begins, 0, state.since).astype(np.int32)
        sent = state.sent & ~begins[:, None]
        fired = ~sent & (now >= levels[np.minimum(since, n_cycle)][:, None])
        quiet = np.where(touched, 0, np.minimum(state.quiet + 1, n_quiet)).astype(np.int32)
        after = LatencyState(np.minimum(since + 1, n_cycle).astype(np.int32), sent | fired, quiet, None)
        return fired, after

    spikes, after = over_time(drive, state, step, 2 * n_taxels)
    return spikes, after._replace(last=last)


def cost(_spec: Mapping[str, Any], taxels: int, steps: int, _step_ms: float) -> Cost:
    """The cost of an encoder over that many steps.

    Per afferent and step: gain times drive and the comparison with the falling threshold; RA-I takes a difference and
    its absolute value beside. The threshold falls by one product a step, for all.
    """
    state = 3 * taxels + 2  # fired or not, the sample before; the threshold and the cycle's step
    falls = in_registers(multiplications=steps)
    step = Cost(acs=1, multiplications=2, comparisons=2 + 1, weights_accesses=2, **changed(3))
    return with_weights(2, state) + step.times(taxels * steps) + falls


MODEL = Model("latency afferents", LatencySpec, encode, LatencyState, cost=cost)
