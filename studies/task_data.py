"""A recognition task of any paper, as it is given to every family of classifiers."""

from typing import NamedTuple

import numpy as np


class TaskData(NamedTuple):
    """A recognition task as inputs for every family of classifiers.

    features: `(example, feature)`, the inputs of the paper's classifiers, not standardised.
    sequences: `(example, time, channel)` float32, the conditioned signal in `unit`, at `sampling_rate_Hz`.
    labels: `(example,)` class names; groups: `(example,)`, examples of one group stay on one side of a split.
    """

    features: np.ndarray
    sequences: np.ndarray
    sampling_rate_Hz: float
    unit: str
    labels: np.ndarray
    groups: np.ndarray
