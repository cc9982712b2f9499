"""Moving window: an event where the signal is a threshold above (ON) or below (OFF) the mean of its last samples.

Kasabov et al. 2016, doi 10.1016/j.neunet.2015.09.011; compared with other encoders in Petro, Kasabov and Kiss 2020,
doi 10.1109/TNNLS.2019.2906158.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from neurotact_parts.encoders.send_on_delta import sum_of_steps
from pydantic import Field

from neurotact.encoders.model import ON_OFF, EncoderSpec, Model, RefractoryMs, both, checked, over_time
from neurotact.metrics.flops import Cost, with_weights
from neurotact.neurons import refractory_steps, silenced


class MovingWindowSpec(EncoderSpec):
    """ON and OFF events of every taxel (`encoders/moving-window.toml`)."""

    model: Literal["moving-window"] = "moving-window"
    """An event where the signal differs from the mean of its last samples."""
    threshold: float = Field(gt=0)
    """Difference from the mean that gives an event, in the unit of the conditioned signal."""
    window_ms: float = Field(default=50.0, gt=0, le=1e4)
    """Length of the mean, at least one step of the clock."""
    t_ref_ms: RefractoryMs = 0.0
    """Dead time of a taxel after an event, ON or OFF."""


class MovingWindowState(NamedTuple):
    """The last samples of each taxel, their sum, and the silent steps still to come.

    past: `(trial, window, taxel)`, a ring. total: `(trial, taxel)` float64. n_steps: steps done. silent_steps:
    `(trial, taxel)`.
    """

    past: np.ndarray
    total: np.ndarray
    n_steps: int
    silent_steps: np.ndarray


def encode(
    signal: np.ndarray, sampling_rate_Hz: float, spec: MovingWindowSpec, state: MovingWindowState | None = None
) -> tuple[np.ndarray, MovingWindowState]:
    """Events of conditioned signals, `(trial, time, taxel)` to `(trial, time, 2 taxel)` uint8, ON first.

    ON where `x > base + threshold`, OFF where `x < base - threshold`; the base is the mean of the samples before this
    one, as many as the window holds, of fewer at the beginning. The first sample gives no event.

    >>> jump = np.array([0.0, 0.0, 7.0, 7.0, 7.0]).reshape(1, 5, 1)
    >>> spikes, _ = encode(jump, 1000.0, MovingWindowSpec(threshold=3.0, window_ms=2.0))
    >>> spikes[0, :, 0].tolist()
    [0, 0, 1, 1, 0]
    """
    signal = checked(signal)
    threshold = signal.dtype.type(spec.threshold)
    n_silent = refractory_steps(spec.t_ref_ms, sampling_rate_Hz)
    n_trials, _, n_taxels = signal.shape
    n_window = _window_steps(spec.window_ms, 1e3 / sampling_rate_Hz)

    def step(x: np.ndarray, state: MovingWindowState) -> tuple[np.ndarray, MovingWindowState]:
        n_held = min(state.n_steps, n_window)
        base = (state.total / n_held).astype(x.dtype) if n_held else x
        awake = state.silent_steps == 0
        up, down = awake & (x > base + threshold), awake & (x < base - threshold)
        slot = state.n_steps % n_window
        total = state.total + x - state.past[:, slot]
        state.past[:, slot] = x
        silent = silenced(state.silent_steps, up | down, n_silent)
        return both(up, down), MovingWindowState(state.past, total, state.n_steps + 1, silent)

    if state is None:
        past = np.zeros((n_trials, n_window, n_taxels), signal.dtype)
        state = MovingWindowState(past, np.zeros((n_trials, n_taxels)), 0, np.zeros((n_trials, n_taxels), np.int32))
    return over_time(signal, state._replace(past=state.past.copy()), step, 2 * n_taxels)


def _window_steps(window_ms: float, step_ms: float) -> int:
    """Steps of the clock in the window, at least one."""
    return max(1, round(window_ms / step_ms))


def cost(spec: Mapping[str, Any], taxels: int, steps: int, step_ms: float) -> Cost:
    """The cost of an encoder, given as a table, over `steps` steps of `step_ms`.

    Per taxel and step: the new sample is added to the sum and the oldest taken off, their mean is a product, the signal
    minus it a difference, and then the comparisons with the threshold above and below.
    """
    updates, n_window = taxels * steps, _window_steps(spec["window_ms"], step_ms) if step_ms else 1
    state = (n_window + 2) * taxels  # the samples, their sum, the refractory counter
    moved = {"weights_accesses": updates, "states_accesses": 6 * updates}  # oldest and newest sample, sum, counter
    return with_weights(1, state, acs=3 * updates, multiplications=updates, comparisons=2 * updates, **moved)


MODEL = Model(
    "moving-window events", MovingWindowSpec, encode, MovingWindowState, ON_OFF, cost,
    decode=sum_of_steps, repeats=True,
)  # fmt: skip
