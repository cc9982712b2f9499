"""Fixed-point words of a few bits, one scale for all features (compliance paper, Sec. 5)."""

from typing import NamedTuple

import numpy as np

from neurotact.errors import InputError


class FixedPoint(NamedTuple):
    """Unsigned words of `bits`: code 0 is 0, the largest code is `full_scale`; values outside saturate.

    >>> FixedPoint(bits=8, full_scale=510.0).codes(np.array([-3.0, 4.0, 5.0, 510.0, 900.0])).tolist()
    [0.0, 2.0, 2.0, 255.0, 255.0]
    """

    bits: int
    full_scale: float

    @property
    def largest(self) -> int:
        """The largest code, 2^bits - 1."""
        return 2**self.bits - 1

    def codes(self, values: np.ndarray) -> np.ndarray:
        """The nearest code of each value (ties to even), as float64 whole numbers, `values`' shape."""
        scaled = np.rint(np.asarray(values, np.float64) * (self.largest / self.full_scale))
        return np.clip(scaled, 0.0, float(self.largest))


def fit_fixed_point(features: np.ndarray, bits: int) -> FixedPoint:
    """The common scale whose end is the largest of all `features`: pass only training examples.

    One scale for every moment, feature and sensor, as in one datapath: a moment with small values uses few codes.
    Raises InputError for bits < 1 or features that are all <= 0.

    >>> fit_fixed_point(np.array([[1.0, 30.0], [2.0, 60.0]]), bits=4)
    FixedPoint(bits=4, full_scale=60.0)
    """
    largest = float(np.max(features))
    if bits < 1:
        raise InputError(f"bits: must be >= 1; got {bits}")
    if not (np.isfinite(largest) and largest > 0):
        raise InputError(f"features: the largest is {largest}; an unsigned scale needs a positive, finite one")
    return FixedPoint(bits, largest)
