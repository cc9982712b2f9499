"""What the compiled encoders of this package share: signals and states with their taxels padded to whole vectors."""

from typing import Any

import numpy as np

from neurotact.backend import Backend, use_native
from neurotact.encoders.native import threads_of

VECTOR_BYTES = 64
"""Of the widest vectors."""


def is_compiled(signal: np.ndarray, backend: Backend) -> bool:
    """Whether the kernel encodes this signal; InputError where it is asked for and cannot."""
    return use_native(backend, signal.dtype in (np.float32, np.float64), "signals in float32 or float64")


def padded(values: np.ndarray, kind: Any, *, lanes: int = 0) -> np.ndarray:
    """A copy in another type with zeros behind the last axis, which becomes a multiple of the vectors' length.

    lanes: that length; 0 for as many as the type has.

    >>> padded(np.ones((1, 3)), np.float64).tolist()
    [[1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
    """
    lanes = lanes or VECTOR_BYTES // np.dtype(kind).itemsize
    to = np.zeros((*values.shape[:-1], -(-values.shape[-1] // lanes) * lanes), kind)
    to[..., : values.shape[-1]] = values
    return to


class Signals:
    """A conditioned signal `(trial, time, taxel)` as the kernels take it, and its spikes of so many populations."""

    def __init__(self, signal: np.ndarray, n_populations: int, *, lanes: int = 0) -> None:
        lanes = lanes or VECTOR_BYTES // signal.itemsize
        fits = signal.shape[2] % lanes == 0 and signal.flags.c_contiguous
        self._signal = signal if fits else padded(signal, signal.dtype, lanes=lanes)
        self._n_taxels = signal.shape[2]
        n_trials, n_steps, self.pitch = self._signal.shape
        self._spikes = np.zeros((n_trials, n_steps, n_populations, self.pitch), np.uint8)

    @property
    def given(self) -> dict[str, Any]:
        """The arguments that each of the kernels takes."""
        n_trials, n_steps, pitch = self._signal.shape
        return {
            "is_double": self._signal.dtype == np.float64, "trials": n_trials, "steps": n_steps, "pitch": pitch,
            "signal": address(self._signal), "spikes": address(self._spikes),
            "threads": threads_of(n_trials),
        }  # fmt: skip

    @property
    def spikes(self) -> np.ndarray:
        """`(trial, time, afferent)` uint8."""
        n_trials, n_steps, n_populations, _ = self._spikes.shape
        return self.of_taxels(self._spikes).reshape(n_trials, n_steps, n_populations * self._n_taxels)

    def of_taxels(self, values: np.ndarray) -> np.ndarray:
        """Without what pads the taxels."""
        return np.ascontiguousarray(values[..., : self._n_taxels])


def address(values: np.ndarray) -> int:
    """Where an array lies; 0 if it has no values."""
    return values.ctypes.data if values.size else 0
