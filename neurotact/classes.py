"""What names a class: any label but a measurement."""

import math
from collections.abc import Iterable
from typing import Any

NO_CLASSES = (
    "holds numbers that are not whole, such as {:g}, which name no classes; give each trial a whole number or a text, "
    "as in 'soft', such as a range of these numbers; to learn the numbers themselves, give them as a condition and "
    "train with `target`"
)
"""The refusal of measurements as classes, of which the first is shown."""


def measurement_in(labels: Iterable[Any]) -> float | None:
    """The first label that is a number, but not a whole one: a measurement, which names no class; None without one.

    >>> measurement_in(["felt", 2, 1.0]), measurement_in([1.0, 0.37]), measurement_in(["0.37"])
    (None, 0.37, None)
    """
    numbers = (float(label) for label in labels if isinstance(label, float))
    return next((number for number in numbers if math.isfinite(number) and number % 1), None)
