"""Burst: after each cycle its mean drive is sent as a burst, of more and closer spikes the stronger it was.

Park et al. 2019, doi 10.1145/3316781.3317822; number and intervals as in Guo et al. 2021,
doi 10.3389/fnins.2021.638474.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from neurotact.encoders.afferents import drives
from neurotact.encoders.model import EncoderSpec, Model, checked, over_time
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, changed, in_registers, with_weights
from neurotact.neurons import silenced
from neurotact.spec import Spec


class BurstType(Spec):
    """One population: an afferent of this type under each taxel."""

    gain: float = Field(gt=0)
    """Intensity per unit of the conditioned signal (SA-I) or per unit per ms (RA-I), in a cycle's mean; at most 1."""


class BurstSpec(EncoderSpec):
    """An SA-I and an RA-I population of bursts over every taxel (`encoders/burst.toml`)."""

    model: Literal["burst"] = "burst"
    """A burst after each cycle, of more and closer spikes the stronger it was."""
    cycle_ms: float = Field(default=50.0, gt=0)
    """Time between the beginnings of two bursts."""
    most_spikes: int = Field(default=5, ge=1, le=100)
    """Spikes of a burst at an intensity of 1 (N_max)."""
    shortest_isi_ms: float = Field(default=2.0, gt=0)
    """Interval of a burst's spikes at an intensity of 1 (T_min)."""
    longest_isi_ms: float = Field(default=10.0, gt=0)
    """Interval towards an intensity of 0 (T_max)."""
    sa1: BurstType
    """Driven by the signal."""
    ra1: BurstType
    """Driven by the signal's rate of change."""

    @model_validator(mode="after")
    def _fits_in_a_cycle(self) -> "BurstSpec":
        if self.longest_isi_ms < self.shortest_isi_ms:
            raise ValueError("longest_isi_ms must be at least shortest_isi_ms")
        if (self.most_spikes - 1) * self.longest_isi_ms >= self.cycle_ms:
            raise ValueError("cycle_ms must be above (most_spikes - 1) * longest_isi_ms: a burst ends before the next")
        return self


class BurstState(NamedTuple):
    """The state of the encoder between pieces, `(trial, 2 taxel)` each except `n_steps` and `last`.

    n_steps: steps done. total: sum of the drive in this cycle. left: spikes of the burst still to come. interval: its
    steps. wait: steps until the next spike. last: the signal's last sample, `(trial, taxel)`; None before the first.
    """

    n_steps: int
    total: np.ndarray
    left: np.ndarray
    interval: np.ndarray
    wait: np.ndarray
    last: np.ndarray | None


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: BurstSpec, state: BurstState | None = None
) -> tuple[np.ndarray, BurstState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, SA-I first.

    The intensity P is the gain times the mean drive of a cycle, from 0 to 1. The next cycle begins with a burst of
    `most_spikes P` spikes, `longest - (longest - shortest) P` apart, both rounded (the number is rounded up in Guo et
    al.; here a drive near zero is silent). So a burst tells what came before it: the encoder is causal. Cycles count
    from the first sample.

    Raises InputError for a shortest interval below a step of the clock.

    >>> kinds = {"sa1": BurstType(gain=0.5), "ra1": BurstType(gain=1.0)}
    >>> spec = BurstSpec(cycle_ms=20.0, most_spikes=6, longest_isi_ms=3.9, **kinds)
    >>> spikes, _ = encode(np.ones((1, 60, 1)), 1000.0, spec)  # P = 0.5: three spikes, 3 ms apart
    >>> np.flatnonzero(spikes[0, :, 0]).tolist()
    [20, 23, 26, 40, 43, 46]
    """
    signal = checked(signal)
    n_cycle, step_ms = round(spec.cycle_ms * 1e-3 * sampling_rate_Hz), 1e3 / sampling_rate_Hz
    if spec.shortest_isi_ms < step_ms * (1 - 1e-9):
        raise InputError(
            f"shortest_isi_ms: {spec.shortest_isi_ms:g} ms is less than a step of {step_ms:g} ms; lengthen it, or set "
            "conditioning.resample_Hz"
        )
    kind, (n_trials, _, n_taxels) = signal.dtype.type, signal.shape
    shortest, longest = (kind(ms / step_ms) for ms in (spec.shortest_isi_ms, spec.longest_isi_ms))
    gains = ((spec.sa1.gain,), (spec.ra1.gain * sampling_rate_Hz * 1e-3,))
    if state is None:
        shape = n_trials, 2 * n_taxels
        nothing = np.zeros(shape, np.int32)
        state = BurstState(0, np.zeros(shape, signal.dtype), nothing, nothing, nothing, None)
    drive, last = drives(signal, gains, state.last)

    def step(now: np.ndarray, state: BurstState) -> tuple[np.ndarray, BurstState]:
        total, left, interval, wait = state.total, state.left, state.interval, state.wait
        if state.n_steps and state.n_steps % n_cycle == 0:
            intensity = np.clip(total / kind(n_cycle), 0, 1)
            left = np.rint(spec.most_spikes * intensity).astype(np.int32)
            interval = np.rint(longest - (longest - shortest) * intensity).astype(np.int32)
            total, wait = np.zeros_like(total), np.zeros_like(wait)
        fired = (left > 0) & (wait == 0)
        wait = silenced(wait, fired, interval - 1)
        after = BurstState(state.n_steps + 1, total + now, (left - fired).astype(np.int32), interval, wait, None)
        return fired, after

    spikes, after = over_time(drive, state, step, 2 * n_taxels)
    return spikes, after._replace(last=last)


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of an encoder, given as a table, over `steps` steps of `step_ms`.

    Per afferent and step: the drive is added up and the time to the next spike compared; RA-I takes a difference and
    its absolute value beside. Per afferent and cycle: gain, limits from 0 to 1 (two comparisons), number of spikes (a
    product, rounded) and interval (a MAC, rounded).
    """
    afferents, updates = 2 * taxels, taxels * steps
    cycle = max(1, round(spec["cycle_ms"] / step_ms)) if step_ms else 1
    bursts = in_registers(macs=1, multiplications=2, comparisons=2 + 2).times(afferents * (steps / cycle))
    state = 4 * afferents + taxels + 1  # sum, spikes left, interval, time to the next; sample before; step
    return with_weights(2, state, acs=3 * updates, comparisons=3 * updates, **changed(3, updates)) + bursts


MODEL = Model("burst afferents", BurstSpec, encode, BurstState, cost=cost)
