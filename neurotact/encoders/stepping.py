"""What encoders that go step by step share: the loop over time, and ON before OFF."""

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


def both(positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """ON before OFF, `(trial, taxel)` each to `(trial, 2 taxel)`."""
    return np.concatenate([positive, negative], axis=1)
