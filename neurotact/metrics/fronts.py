"""The Pareto front of a trade-off."""

import numpy as np


def pareto_front(cost: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """The points that no other dominates, by a cost at most as high and a gain at least as high, one of them strictly.

    cost, gain: `(point,)`; a point with NaN is never on the front. Equal points are on it together.

    >>> pareto_front(np.array([1.0, 2.0, 3.0]), np.array([0.8, 0.7, 0.9])).tolist()
    [True, False, True]
    """
    cost, gain = np.asarray(cost, float), np.asarray(gain, float)
    cheaper, better = cost[:, None] <= cost, gain[:, None] >= gain
    strictly = (cost[:, None] < cost) | (gain[:, None] > gain)
    beaten = (cheaper & better & strictly).any(axis=0)
    return ~beaten & np.isfinite(cost) & np.isfinite(gain)
