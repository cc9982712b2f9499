"""Events as one matrix of -1, 0 and 1: a row per channel and a last row with the time of each column, as ST-MNIST has.

See et al. 2020 (arXiv 2005.04319): -1 is OFF, 1 is ON, and times are not evenly spaced.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neurotact.data.readers.formats import Arrays
from neurotact.errors import InputError

SIGNED_MATRIX = "a matrix of -1, 0 and 1 with the times of its columns as the last row"
"""One of the layouts of events, in words."""


def holds_events(matrix: np.ndarray) -> bool:
    """Whether a matrix is a `SIGNED_MATRIX`, of which the last row rises.

    >>> holds_events(np.array([[1, 0, 0], [0, -1, 1], [0.1, 0.25, 0.3]]))
    True
    >>> holds_events(np.array([[1, 0, 0], [0, -1, 1], [0, 0, 1]])), holds_events(np.array([[1, 2], [0.1, 0.2]]))
    (False, False)
    """
    if matrix.ndim != 2 or matrix.dtype.kind not in "iuf" or min(matrix.shape) < 2:
        return False
    rows, times, signs = matrix[:-1], matrix[-1], (-1, 0, 1)
    if not (np.diff(times) >= 0).all() or np.isin(times, signs).all() or not np.isin(rows[0], signs).all():
        return False  # as nearly all signals, which may be large
    return bool(np.isin(rows, signs).all() and rows.any())


def matrix_of(held: Arrays, path: Path) -> np.ndarray:
    """The only matrix of a file, which holds events; InputError for another file."""
    shapes: Mapping[str, tuple[int, ...]] = {name: values.shape for name, values in held.arrays.items()}
    if len(shapes) != 1 or not holds_events(matrix := next(iter(held.arrays.values()))):
        shown = ", ".join(f"'{name}' of the shape {shape}" for name, shape in [*shapes.items()][:3]) or "no matrix"
        turned = len(shapes) == 1 and holds_events(next(iter(held.arrays.values())).T)
        fix = "turn it" if turned else "read signals with neurotact import arrays, or save events as .npz"
        raise InputError(f"{path}: holds {shown} where {SIGNED_MATRIX} is expected; {fix}")
    return matrix


def events_of(matrix: np.ndarray) -> dict[str, np.ndarray]:
    """The time in s, channel and polarity of each event of a matrix, in the order of their times.

    >>> matrix = np.array([[1, 0, 0], [0, -1, 1], [0.1, 0.25, 0.3]])
    >>> {name: values.tolist() for name, values in events_of(matrix).items()}
    {'time_s': [0.1, 0.25, 0.3], 'channel': [0, 1, 1], 'polarity': [1, -1, 1]}
    """
    column, channel = np.nonzero(matrix[:-1].T)
    polarity = matrix[channel, column].astype(np.int8)
    return {"time_s": matrix[-1, column].astype(np.float64), "channel": channel, "polarity": polarity}
