"""A sequence of signals that is kept in a temporary file when it is large."""

import tempfile
import weakref
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from typing import overload

import numpy as np

from neurotact.errors import InputError

IN_MEMORY_BYTES = 8_000_000
"""A larger sequence is written to the file."""


class Spool(Sequence[np.ndarray]):
    """Float32 signals `(time, channel)` of one number of channels, read back one at a time.

    The file has no name and is deleted with the last reference. Raises InputError if there is no space for it.

    >>> signals = Spool(np.full((n, 2), n, np.float32) for n in (1, 3))
    >>> [signal.shape for signal in signals], float(signals[1][2, 0])
    ([(1, 2), (3, 2)], 3.0)
    """

    def __init__(self, signals: Iterable[np.ndarray]) -> None:
        self._file = tempfile.SpooledTemporaryFile(IN_MEMORY_BYTES)  # noqa: SIM115 (lives as long as the sequence)
        weakref.finalize(self, self._file.close)
        self._starts: list[int] = []
        self._shapes: list[tuple[int, ...]] = []
        self._change: Callable[[int], np.ndarray] | None = None
        for signal in signals:
            self._starts.append(self._file.tell())
            self._shapes.append(signal.shape)
            try:
                self._file.write(np.ascontiguousarray(signal, np.float32).data)
            except OSError as error:
                raise InputError(
                    f"{tempfile.gettempdir()}: cannot hold the signals ({error.strerror}); "
                    "free space there or name another folder in TMPDIR"
                ) from error

    def then(self, change: Callable[[np.ndarray], np.ndarray]) -> "Spool":
        """The same signals, of which each is changed when it is read, and keeps its length.

        >>> float(Spool([np.ones((3, 2), np.float32)]).then(lambda signal: 2 * signal)[0][0, 0])
        2.0
        """
        changed = copy(self)
        changed._change = lambda index: change(self[index])
        return changed

    @property
    def lengths(self) -> list[int]:
        """Samples of each signal."""
        return [shape[0] for shape in self._shapes]

    def __len__(self) -> int:
        return len(self._shapes)

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[np.ndarray]: ...
    def __getitem__(self, index: int | slice) -> np.ndarray | Sequence[np.ndarray]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if self._change is not None:
            return self._change(index)
        shape = self._shapes[index]
        self._file.seek(self._starts[index])
        return np.frombuffer(self._file.read(4 * shape[0] * shape[1]), np.float32).reshape(shape)
