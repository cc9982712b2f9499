"""What encoders that go step by step share: the loop over time, and ON before OFF."""

from collections.abc import Callable, Sequence
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


def side_by_side(signals: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Signals `(time, taxel)` as one array `(trial, time, taxel)`, zeros after the shorter ones, and their lengths.

    No encoder looks ahead, so that what comes after a signal's end does not change its spikes.

    >>> together, n_steps = side_by_side([np.ones((2, 1)), np.ones((3, 1))])
    >>> together[:, :, 0].tolist(), n_steps.tolist()
    ([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0]], [2, 3])
    """
    n_steps = np.array([*map(len, signals)])
    if (n_steps == n_steps[0]).all():
        return np.stack(signals), n_steps
    together = np.zeros((len(signals), n_steps.max(), signals[0].shape[1]), signals[0].dtype)
    for row, signal in zip(together, signals, strict=True):
        row[: len(signal)] = signal
    return together, n_steps


def both(positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """ON before OFF, `(trial, taxel)` each to `(trial, 2 taxel)`."""
    return np.concatenate([positive, negative], axis=1)
