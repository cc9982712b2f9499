"""Numbers that a network tells of a window: conditions of its trial, learned standardised and told in their units.

In training the numbers of the training side have the mean 0 and the deviation 1. Afterwards their scale is folded into
the weights and the bias of the readout, which is linear in the spikes that it hears: its values are in units wherever
the network runs.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from neurotact.data.readers.table.cells import NUMBER
from neurotact.errors import InputError, in_digits, nearest
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.rsnn import RSNN
from neurotact.networks.definition.specs import OF_NUMBERS, RSNNSpec
from neurotact.networks.training.epochs import Examples

OF_CLASSES = ("cross-entropy", "hinge")
RESAMPLES = 2000
"""Draws of test trials, with replacement, from which intervals are."""
GROUPS, PER_GROUP = 5, 10
"""Most groups of similar numbers that each side of a split has its share of, and trials in one on average at least."""


def of_trials(conditions: pd.DataFrame, target: Sequence[str]) -> np.ndarray:
    """The numbers of trials, `(trial, target)` float32; NaN where a trial has none.

    >>> of_trials(pd.DataFrame({"force_N": [3, 6]}), ["force_N", "speed"]).tolist()
    [[3.0, nan], [6.0, nan]]
    """
    absent = pd.Series(np.nan, conditions.index)
    columns = [pd.to_numeric(conditions.get(name, absent), errors="coerce") for name in target]
    return np.stack([column.to_numpy(np.float32, na_value=np.nan) for column in columns], axis=1)


def check(conditions: pd.DataFrame, target: Sequence[str], training: np.ndarray) -> None:
    """Refuse a target that is no numeric condition of every trial, or that all training trials share.

    Texts such as 01 are numbers here, though names elsewhere.
    """
    numeric = [str(name) for name in conditions if _is_numeric(conditions[name])]
    for name in target:
        if name not in conditions:
            raise InputError(f"target: there is no condition '{name}'; {nearest(name, numeric)}")
        column = conditions[name] if name not in numeric else pd.to_numeric(conditions[name])
        if name not in numeric or column.dtype == bool:
            raise InputError(
                f"target: condition '{name}' holds no numbers, such as '{column.iloc[0]}'; leave `target` out to learn "
                "classes"
            )
        finite = np.isfinite(column.to_numpy(float))
        if not finite.all():
            raise InputError(f"target: trial {int((~finite).argmax())} has no '{name}'; add it, or leave its trial out")
        if np.ptp(column.to_numpy(float)[training]) == 0:
            raise InputError(
                f"target: all training trials have {name} = {column.iloc[training[0]]:g}, so that nothing can be "
                "learned; record others, or split otherwise"
            )


def _is_numeric(column: pd.Series) -> bool:
    is_number = pd.api.types.is_numeric_dtype(column)
    return is_number or all(isinstance(value, str) and NUMBER.fullmatch(value) for value in column)


def groups_of(conditions: pd.DataFrame, target: Sequence[str]) -> np.ndarray:
    """Groups of trials with similar numbers of the first target, of which each side of a split has its share.

    >>> groups_of(pd.DataFrame({"force_N": np.arange(20.0)}), ["force_N"]).tolist()[8:12]
    [0, 0, 1, 1]
    """
    n = max(1, min(GROUPS, len(conditions) // PER_GROUP))
    ranks = pd.to_numeric(conditions[target[0]]).rank(method="min").to_numpy()
    return ((ranks - 1) * n // max(1, len(conditions))).astype(np.int64)


def spec_for(spec: RSNNSpec, target: Sequence[str]) -> RSNNSpec:
    """The network for a target, with a loss of numbers where none is given; for classes the same.

    Raises InputError for a network that has no value in units: its readout spikes, or its loss is of classes.
    """
    training = spec.training
    if not target:
        if training.loss in OF_NUMBERS:
            raise InputError(f"training.loss: '{training.loss}' is of numbers; name them with `target`, or set another")
        return spec
    is_chosen = spec.recipe is not None and "readout" not in spec.model_fields_set
    if spec.own is not None:
        raise InputError(f"target: model = '{spec.model}' learns classes alone; numbers need model = 'rsnn' or 'snn'")
    if not is_chosen and spec.readout != "integrator":
        raise InputError(
            f"target: readout = '{spec.readout}' tells classes; numbers need readout = 'integrator', the choice of "
            "network='default'"
        )
    if training.temperature != 1:
        raise InputError("training.temperature: scales scores of classes, and `target` asks for numbers; leave it out")
    if training.loss not in OF_CLASSES:
        return spec
    if "loss" in training.model_fields_set:
        raise InputError(f"training.loss: '{training.loss}' is of classes; numbers need {' or '.join(OF_NUMBERS)}")
    return spec.model_copy(update={"training": training.model_copy(update={"loss": OF_NUMBERS[0]})})


class Scale(NamedTuple):
    """The mean and the deviation of the numbers of training windows, `(target,)` float64 each."""

    mean: Tensor
    deviation: Tensor

    @classmethod
    def of(cls, training: Examples) -> "Scale | None":
        """Of training windows; None of classes."""
        if training.labels.ndim == 1:
            return None
        numbers = training.labels.double()
        return cls(numbers.mean(dim=0), numbers.std(dim=0, correction=0))

    def standard(self, side: Examples) -> Examples:
        """Windows with standardised numbers."""
        return side._replace(labels=((side.labels.double() - self.mean) / self.deviation).float(), deviation=None)

    @torch.no_grad()
    def fold(self, network: Network) -> None:
        """Give the values of a network their units, in place."""
        assert isinstance(network, RSNN)
        assert network.bias is not None
        for weights in (network.w_out, network.w_stretch):
            if weights is not None:
                weights.copy_(weights.double() * self.deviation)
        network.bias.copy_(network.bias.double() * self.deviation + self.mean)


def interval(values: np.ndarray, trials: np.ndarray) -> tuple[float, float]:
    """The 95 % interval of a mean over windows, from test trials that are drawn with replacement.

    values: of each window, `(window,)`. trials: of each window. The percentile bootstrap (Efron 1979, doi
    10.1214/aos/1176344552).

    >>> low, high = interval(np.array([0.0, 1.0, 0.0, 1.0]), np.array([0, 1, 2, 3]))
    >>> low, high
    (0.0, 1.0)
    """
    _, of = np.unique(trials, return_inverse=True)
    sums, counts = np.bincount(of, values), np.bincount(of)
    drawn = np.random.default_rng(0).integers(0, len(sums), (RESAMPLES, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def errors(values: np.ndarray, labels: np.ndarray, names: Sequence[str], trials: np.ndarray) -> dict[str, float]:
    """Errors of each target in its unit, as columns of results.

    values, labels: `(window, target)`; trials: of each window. Root-mean-square error with its 95 % interval, mean
    absolute error, and R^2, 1 less the squared error over that of the mean of these windows.

    >>> found = errors(np.array([[1.0], [4.0]]), np.array([[1.0], [3.0]]), ["force_N"], np.arange(2))
    >>> round(found["rmse_force_N"], 3), found["mae_force_N"], found["r2_force_N"]
    (0.707, 0.5, 0.5)
    """
    found = {}
    for name, value, label in zip(names, values.T, labels.T, strict=True):
        squares, spread = (value - label) ** 2, float(np.square(label - label.mean()).mean())
        low, high = interval(squares, trials)
        found |= {
            f"rmse_{name}": float(np.sqrt(squares.mean())),
            f"rmse_{name}_low": low**0.5,
            f"rmse_{name}_high": high**0.5,
            f"mae_{name}": float(np.abs(value - label).mean()),
            f"r2_{name}": 1 - float(squares.mean()) / spread if spread else float("nan"),
        }
    return found


def lines(row: dict[str, float], names: Sequence[str]) -> Iterator[str]:
    """The errors of each target in words, from a row of results.

    >>> row = {"rmse_force_N": 0.71, "rmse_force_N_low": 0.6, "rmse_force_N_high": 0.8, "mae_force_N": 0.5,
    ...        "r2_force_N": 0.5}
    >>> print(*lines(row, ["force_N"]))
    force_N: root-mean-square error 0.71 (95 % interval 0.6 to 0.8), mean absolute error 0.5, R² 0.50
    """
    for name in names:
        rmse, low, high, mean = (row[key.format(name)] for key in ("rmse_{}", "rmse_{}_low", "rmse_{}_high", "mae_{}"))
        yield (
            f"{name}: root-mean-square error {in_digits(rmse)} (95 % interval {in_digits(low)} to "
            f"{in_digits(high)}), mean absolute error {in_digits(mean)}, R² {row[f'r2_{name}']:.2f}"
        )


def scored(value: float) -> str:
    """A mean score in words."""
    return f"{value:.3f}"
