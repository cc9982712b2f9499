"""What encoders that go step by step share: the loop over time, and the refractory period of a channel."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

StateT = TypeVar("StateT")


def over_time(
    signal: np.ndarray,
    state: StateT,
    step: Callable[[np.ndarray, StateT], tuple[np.ndarray, StateT]],
    n_afferents: int,
) -> tuple[np.ndarray, StateT]:
    """The spikes of a step function over a signal `(trial, time, taxel)`, and the state after it.

    Spikes are `(trial, time, afferent)` uint8.
    step: from the samples of one time, `(trial, taxel)`, and a state to spikes `(trial, afferent)` and the next state.

    >>> over_time(np.ones((1, 3, 1)), 0, lambda x, n: (x > n, n + 1), 1)[0].ravel().tolist()
    [1, 0, 0]
    """
    spikes = np.empty((len(signal), signal.shape[1], n_afferents), np.uint8)
    for t in range(signal.shape[1]):
        spikes[:, t], state = step(signal[:, t], state)
    return spikes, state


def silenced(silent_steps: np.ndarray, fired: np.ndarray, n_silent: int) -> np.ndarray:
    """The silent steps still to come after one step, int32: `n_silent` after a spike, else one less.

    >>> silenced(np.array([0, 0, 2]), np.array([True, False, False]), 5).tolist()
    [5, 0, 1]
    """
    return np.where(fired, np.int32(n_silent), np.maximum(silent_steps - 1, 0)).astype(np.int32)


def both(positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """ON before OFF, `(trial, taxel)` each to `(trial, 2 taxel)`."""
    return np.concatenate([positive, negative], axis=1)
