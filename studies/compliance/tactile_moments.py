"""Raw moments of a tactile image: total, position and spread of the pressure (compliance paper, Eq. 1)."""

import numpy as np

ORDERS = ((0, 0), (0, 1), (1, 0), (0, 2), (2, 0), (1, 1))
"""The six orders (p, q) with p + q <= 2, in the order in which the paper's tables add them (Tables 3 and 5)."""
NAMES = tuple(f"M{p}{q}" for p, q in ORDERS)


def moment_weights(rows: int, columns: int) -> np.ndarray:
    """Weight of each taxel in each moment, `(taxel, moment)` float64: x^p y^q, taxels row by row.

    x is the row and y the column, both from 1 (Eq. 1). `images.reshape(-1, rows * columns)` times these weights,
    for images `(image, row, column)`, are the moments.

    >>> moment_weights(1, 3)[:, NAMES.index("M02")].tolist()
    [1.0, 4.0, 9.0]
    """
    x, y = np.meshgrid(np.arange(1.0, rows + 1), np.arange(1.0, columns + 1), indexing="ij")
    return np.stack([(x**p * y**q).ravel() for p, q in ORDERS], axis=1)
