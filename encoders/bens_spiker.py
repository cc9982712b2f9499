"""Ben's spiker algorithm (BSA): a spike where taking a filter's response off the signal leaves it smaller.

Schrauwen and Van Campenhout 2003, doi 10.1109/IJCNN.2003.1224019. The same filter decodes: the spikes, convolved with
it, are the signal.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.compiled import Signals, address, is_compiled, padded
from neurotact_parts.encoders.decoding import filtered, hann
from pydantic import Field

from neurotact.backend import Backend, native
from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, both, checked, over_time
from neurotact.metrics.flops import Cost, changed, with_weights


class BensSpikerSpec(EncoderSpec):
    """Spikes of the positive (ON) and of the negative part (OFF) of every taxel (`encoders/bens-spiker.toml`)."""

    model: Literal["bens-spiker"] = "bens-spiker"
    """Ben's spiker algorithm (BSA)."""
    gain: float = Field(gt=0)
    """Factor on the conditioned signal: 1 / gain is the signal that a spike in every step stands for."""
    threshold: float = Field(default=0.955, gt=0, lt=1)
    """By how much a spike must lessen the sum of the magnitudes, as a share of the most that it can."""
    filter_ms: float = Field(default=40.0, gt=0)
    """Length of the filter, a Hann window; the spikes come this much later."""


class BensSpikerState(NamedTuple):
    """What earlier spikes have left of the last samples, of the positive and the negative part.

    `(trial, tap, 2 taxel)`, the oldest first; zeros before the first sample.
    """

    remaining: np.ndarray


def encode(
    signal: np.ndarray,
    sampling_rate_Hz: float,
    spec: BensSpikerSpec,
    state: BensSpikerState | None = None,
    *,
    backend: Backend = "auto",
) -> tuple[np.ndarray, BensSpikerState]:
    """Spikes of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, ON first.

    s is the gain times the positive part of the signal (ON), or times its negative part (OFF). With a filter h of M
    taps and sum 1, a spike is where `sum |s[j] - h[j]| <= sum |s[j]| - threshold` over the next M samples, and h is
    taken off them. It must know these samples: the spike of a step comes M - 1 steps later, so that the encoder is
    causal. Both implementations give the same spikes and states.

    >>> spikes, _ = encode(np.full((1, 1000, 1), 2.0), 1000.0, BensSpikerSpec(gain=0.1))
    >>> round(float(spikes[0, 200:, 0].mean()), 1)  # gain times signal
    0.2
    """
    signal = checked(signal)
    taps = hann(spec.filter_ms, 1e3 / sampling_rate_Hz).astype(signal.dtype)
    if state is None:
        state = BensSpikerState(np.zeros((len(signal), len(taps), 2 * signal.shape[2]), signal.dtype))
    return (_compiled if is_compiled(signal, backend) else _by_steps)(signal, taps, spec, state)


def _by_steps(
    signal: np.ndarray, taps: np.ndarray, spec: BensSpikerSpec, state: BensSpikerState
) -> tuple[np.ndarray, BensSpikerState]:
    """The definition, step by step."""
    kind, filter_h = signal.dtype.type, taps[:, None]
    gain, threshold = kind(spec.gain), kind(spec.threshold)

    def step(x: np.ndarray, state: BensSpikerState) -> tuple[np.ndarray, BensSpikerState]:
        parts = gain * both(np.maximum(x, 0), np.maximum(-x, 0))
        window = np.concatenate([state.remaining[:, 1:], parts[:, None]], axis=1)
        without = window - filter_h
        fired = np.abs(without).sum(axis=1) <= np.abs(window).sum(axis=1) - threshold
        return fired, BensSpikerState(np.where(fired[:, None], without, window))

    return over_time(signal, state, step, 2 * signal.shape[2])


def _compiled(
    signal: np.ndarray, taps: np.ndarray, spec: BensSpikerSpec, state: BensSpikerState
) -> tuple[np.ndarray, BensSpikerState]:
    """With the kernel."""
    signals, (n_trials, _, n_taxels) = Signals(signal, 2), signal.shape
    remaining = padded(state.remaining.reshape(n_trials, len(taps), 2, n_taxels), signal.dtype)
    native.bens_spiker(  # pyright: ignore[reportOptionalMemberAccess]
        **signals.given, gain=spec.gain, threshold=spec.threshold, n_taps=len(taps), taps=address(taps),
        remaining=address(remaining),
    )  # fmt: skip
    return signals.spikes, BensSpikerState(signals.of_taxels(remaining).reshape(state.remaining.shape))


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of an encoder, given as a table, over `steps` steps of `step_ms`.

    Of the positive and the negative part of a taxel, per step: the gain is a product and the part a comparison; the
    error with the filter takes a difference, a magnitude and a sum for each tap, that without it a magnitude and a sum;
    both are subtracted and compared with the threshold. Taking the filter off at a spike is rare and not counted.
    """
    parts, taps = 2 * taxels, max(1, round(spec["filter_ms"] / step_ms)) if step_ms else 1
    moved = {"weights_accesses": taps, **changed(taps)}
    step = Cost(acs=3 * taps + 1, multiplications=1, comparisons=2 * taps + 2, **moved)
    return with_weights(2 + taps, parts * taps) + step.times(parts * steps)


def _decode(signed: np.ndarray, step_ms: float, spec: BensSpikerSpec) -> np.ndarray:
    taps = hann(spec.filter_ms, step_ms)
    return filtered(signed, taps, len(taps) - 1) / spec.gain


MODEL = Model("Ben's spiker", BensSpikerSpec, encode, BensSpikerState, ON_OFF, cost, decode=_decode)
