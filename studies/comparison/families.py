"""Every opponent on one task: its input, the choice by validation, the cost of a decision.

Features and sequences are standardised on training examples; sequences are first averaged to the steps of the opponent.
"""

import numpy as np
from neurotact_parts.studies.task_data import TaskData
from sklearn.preprocessing import StandardScaler

from neurotact.baselines import opponent
from neurotact.baselines.features import averaged
from neurotact.baselines.opponent import Opponent, Sides, standardised
from neurotact.baselines.opponents import MOST_SAMPLES, gru_steps
from neurotact.data.splits import Split
from neurotact.metrics.flops import Layer
from neurotact.metrics.signal_flops import Averaging, StandardisedSteps

STEPS = 50
"""Steps of the input sequences of LSTM and GRU."""
NAMES = {"LSTM": "LSTM of the last state", "GRU": "GRU of the last state", "pooled GRU": "GRU"}
"""Opponents that this study calls otherwise."""


def opponent_of(family: str) -> Opponent:
    """The opponent that a family of this study is.

    >>> opponent_of("pooled GRU").takes
    'sequences'
    """
    return opponent.load(NAMES.get(family, family))


def feature_sides(task: TaskData, split: Split) -> Sides:
    """The features of each side, standardised on the training side."""
    scaler = StandardScaler().fit(task.features[split.train])
    return Sides(*(scaler.transform(task.features[side]) for side in split), *(task.labels[side] for side in split))


def sequence_sides(task: TaskData, split: Split, family: str = "GRU") -> Sides:
    """The sequences of each side, averaged to the family's steps, each channel standardised on the training side."""
    sequences = np.asarray(task.sequences, float)
    n_samples = sequences.shape[1]
    if family in ("LSTM", "GRU"):
        n_steps = min(STEPS, n_samples)
    elif opponent_of(family).takes == "signals":
        n_steps = min(MOST_SAMPLES, n_samples)
    else:
        n_steps = gru_steps(1e3 * n_samples / task.sampling_rate_Hz, n_samples)
    return standardised(averaged(sequences, n_steps), task.labels, split)


def averaging(n_samples: int, n_steps: int, n_channels: int) -> tuple[Layer, ...]:
    """The cost of averaging `n_samples` samples to `n_steps` steps; empty if the numbers are equal."""
    return () if n_steps >= n_samples else (Averaging(n_samples, n_steps, n_channels),)


def slowing(n_samples: int, sides: Sides) -> tuple[Layer, ...]:
    """The cost of averaging and standardising a sequence of `n_samples` samples."""
    _, n_steps, n_channels = sides.train.shape
    return (*averaging(n_samples, n_steps, n_channels), StandardisedSteps(n_steps, n_channels))
