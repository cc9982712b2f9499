"""Raw moments of a tactile image: total, position and spread of the pressure (compliance paper, Eq. 1)."""

import numpy as np

from neurotact.errors import InputError

ORDERS = ((0, 0), (0, 1), (1, 0), (0, 2), (2, 0), (1, 1))
"""The six orders (p, q) with p + q <= 2, in the order in which the paper's tables add them (Tables 3 and 5)."""
NAMES = tuple(f"M{p}{q}" for p, q in ORDERS)


def moment_weights(rows: int, columns: int) -> np.ndarray:
    """Weight of each taxel in each moment, `(taxel, moment)` float64: x^p y^q, taxels row by row.

    x is the row and y the column, both counted from 1 (Eq. 1).

    >>> moment_weights(1, 3)[:, NAMES.index("M02")].tolist()
    [1.0, 4.0, 9.0]
    """
    x, y = np.meshgrid(np.arange(1.0, rows + 1), np.arange(1.0, columns + 1), indexing="ij")
    return np.stack([(x**p * y**q).ravel() for p, q in ORDERS], axis=1)


def raw_moments(images: np.ndarray) -> np.ndarray:
    """M_pq = sum over x and y of x^p y^q I(x, y), `(..., moment)` float64, in the unit of the image.

    images: `(..., row, column)`. Raises InputError for anything without rows and columns.
    Source: compliance paper, Eq. 1.

    >>> dict(zip(NAMES, raw_moments(np.array([[0, 2], [1, 0]])).tolist()))
    {'M00': 3.0, 'M01': 5.0, 'M10': 4.0, 'M02': 9.0, 'M20': 6.0, 'M11': 6.0}
    """
    images = np.asarray(images)
    if images.ndim < 2 or 0 in images.shape[-2:]:
        raise InputError(f"tactile image: has shape {images.shape}; give (..., row, column) with at least one taxel")
    rows, columns = images.shape[-2:]
    return images.reshape(*images.shape[:-2], rows * columns) @ moment_weights(rows, columns)
