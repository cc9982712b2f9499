"""Choosing when to stop: the patience of a network, from readout rasters of whole windows.

`validated_rule` picks one patience per network on validation trials and never sees a test label; `steady_rule` also
looks at the training trials, so that few validation trials do not mislead it; `oracle_exit` reproduces the texture
paper's Algorithm 1, which knows the true label. All patiences are judged at once: a trial exits at the first step at
which its leader has stood for patience + 1 steps.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.networks.early_exit import ExitRule, Leader


class Exits(NamedTuple):
    """Where each trial stops for every patience from 1 to the window's length T, `(trial, T)` int64 each.

    steps: simulated steps, T where there is no exit; labels: the class that leads then.
    Column p - 1 belongs to patience p.
    """

    steps: Tensor
    labels: Tensor


class ExitCurve(NamedTuple):
    """What patience buys, a row per patience from 1 to the window's length: `(patience,)` each.

    The last row is the full window: a leader cannot stand longer than that.
    """

    patience: Tensor
    accuracy: Tensor
    mean_steps: Tensor


class OracleExit(NamedTuple):
    """Algorithm 1's results, `(trial,)` int64: Time_new, index_op and the patience that it ended with."""

    steps: Tensor
    labels: Tensor
    patience: Tensor


def exits(rasters: Tensor | np.ndarray, from_first_spike: bool = True, level: Tensor | None = None) -> Exits:
    """Exit step and label of every trial for every patience.

    rasters: readout spikes of whole windows, `(trial, time, class)`, zeros and ones (not cumulated), as
        `RSNN.simulate` gives them; of an integrator what it adds at each step.
    from_first_spike: as in ExitRule.
    level: where an integrator begins, `RSNN.level`; absent, spikes are counted.

    >>> exits(torch.tensor([[[0, 1], [0, 0], [0, 0]]])).steps.tolist()
    [[2, 3, 3]]
    """
    spikes = _checked(rasters, level)
    n_trials, n_steps, n_classes = spikes.shape
    leader = Leader.start(n_trials, n_classes, spikes.device, level)
    first = torch.full((n_trials, n_steps + 1), n_steps, dtype=torch.int64, device=spikes.device)
    leading = torch.empty(n_trials, n_steps, dtype=torch.int64, device=spikes.device)
    for t in range(n_steps):
        leader = leader.after(spikes[:, t])
        leading[:, t] = leader.index
        standing = leader.standing_since_spike if from_first_spike else leader.standing
        # A leader that has stood s steps stood s - 1 a step before: the first s is the first of at least s.
        first.scatter_reduce_(1, standing[:, None], torch.full_like(standing[:, None], t + 1), "amin")
    # Patience p exits at standing p + 1; none stands T + 1 steps, so that patience T is the full window.
    steps = torch.cat([first[:, 2:], first.new_full((n_trials, 1), n_steps)], dim=1)
    return Exits(steps, leading.gather(1, steps - 1))


def exit_curve(
    rasters: Tensor | np.ndarray,
    labels: Tensor | np.ndarray,
    from_first_spike: bool = True,
    level: Tensor | None = None,
) -> ExitCurve:
    """Accuracy and mean steps over patience; arguments as for `exits`, with the true classes `(trial,)`.

    >>> curve = exit_curve(torch.tensor([[[1, 0], [0, 1], [0, 1]]]), torch.tensor([1]))
    >>> curve.accuracy.tolist(), curve.mean_steps.tolist()
    ([0.0, 1.0, 1.0], [2.0, 3.0, 3.0])
    """
    found = exits(rasters, from_first_spike, level)
    right = found.labels == _labels(labels, found)[:, None]
    patience = torch.arange(1, found.steps.shape[1] + 1, device=found.steps.device)
    return ExitCurve(patience, right.double().mean(dim=0), found.steps.double().mean(dim=0))


def validated_rule(
    rasters: Tensor | np.ndarray,
    labels: Tensor | np.ndarray,
    tolerance: float = 0.0,
    level: Tensor | None = None,
) -> ExitRule:
    """The rule of least patience whose accuracy is within `tolerance` of the full window's.

    rasters, labels, level: of *validation* trials, as for `exit_curve`.
    tolerance: accuracy that may be lost, such as 0.01 for one point; a rule may also be more accurate.
    The rule counts from the first step at which the readout moves; a trial that does not exit runs the full window.

    >>> validated_rule(torch.tensor([[[1, 0], [0, 1], [0, 1]]]), torch.tensor([1])).patience
    2
    """
    curve = exit_curve(rasters, labels, from_first_spike=True, level=level)
    return ExitRule(int(curve.patience[_within(curve.accuracy, tolerance)][0]), from_first_spike=True)


def right_of_patience(rasters: Tensor | np.ndarray, labels: Tensor | np.ndarray, level: Tensor | None = None) -> Tensor:
    """How many trials are right with each patience from 1 to the window's length, `(patience,)`; as for `exit_curve`.

    >>> right_of_patience(torch.tensor([[[1, 0], [0, 1], [0, 1]]]), torch.tensor([1])).tolist()
    [0, 1, 1]
    """
    found = exits(rasters, from_first_spike=True, level=level)
    return (found.labels == _labels(labels, found)[:, None]).sum(dim=0)


def steady_rule(validation: Tensor, n_validation: int, training: Tensor, n_training: int, tolerance: float) -> ExitRule:
    """The rule of least patience from which on no patience loses more than `tolerance`, on both kinds of trials.

    validation, training: trials that are right with each patience, as of `right_of_patience`, of so many trials. The
    loss is measured on validation trials, and on all trials together. With 20 validation trials one is 5 points, and
    a patience that is lucky on them is often not on others: on real presses (20 validation trials, 6 networks)
    `validated_rule` lost 7.6 points of test accuracy on average, and this rule 1.5.

    >>> steady_rule(torch.tensor([3, 2, 3]), 3, torch.tensor([9, 9, 9]), 9, tolerance=0.1).patience
    3
    """
    accuracies = (validation / n_validation, (validation + training) / (n_validation + n_training))
    lost = ~torch.stack([_within(accuracy.double(), tolerance) for accuracy in accuracies]).all(dim=0)
    worst = torch.nonzero(lost)
    return ExitRule(int(worst[-1]) + 2 if len(worst) else 1, from_first_spike=True)


def _within(accuracy: Tensor, tolerance: float) -> Tensor:
    """Whether the accuracy with each patience is within `tolerance` of the full window's, its last."""
    if not 0 <= tolerance <= 1:
        raise InputError(f"tolerance: is an accuracy from 0 to 1; got {tolerance}")
    # Accuracies are multiples of 1 / trials: a rounding error of the tolerance must not decide.
    return accuracy >= accuracy[-1] - tolerance - 1e-9


def oracle_exit(
    rasters: Tensor | np.ndarray, labels: Tensor | np.ndarray, patience: int, level: Tensor | None = None
) -> OracleExit:
    """The texture paper's Algorithm 1, line 17 read as count = 0: knows the true label, so reproduces, not predicts.

    Each trial starts with `patience`. While its exit label is wrong, patience is raised by one (the paper says
    "adjusting the Patience"); a patience without an exit gives the full window. A trial that is never right runs
    the full window, with that label and patience T. Counts from the first step, where a silent readout is led
    by class 0.

    >>> oracle_exit(torch.tensor([[[1, 0], [0, 1], [0, 1]]]), torch.tensor([1]), patience=1)._asdict()
    {'steps': tensor([3]), 'labels': tensor([1]), 'patience': tensor([2])}
    """
    ExitRule(patience)  # refuses a patience below 1
    found = exits(rasters, from_first_spike=False, level=level)
    n_steps = found.steps.shape[1]
    start = min(patience, n_steps) - 1
    right = found.labels[:, start:] == _labels(labels, found)[:, None]
    # argmax finds the first true; the last column stands in where none is.
    at = torch.where(right.any(dim=1), start + right.to(torch.uint8).argmax(dim=1), n_steps - 1)[:, None]
    return OracleExit(found.steps.gather(1, at)[:, 0], found.labels.gather(1, at)[:, 0], at[:, 0] + 1)


def _checked(rasters: Tensor | np.ndarray, level: Tensor | None) -> Tensor:
    spikes = torch.as_tensor(rasters)
    if spikes.ndim != 3 or 0 in spikes.shape:
        raise InputError(f"rasters: have shape {tuple(spikes.shape)} where some (trial, time, class) is expected")
    if level is not None:
        return spikes.detach()
    if not ((spikes == 0) | (spikes == 1)).all():
        raise InputError("rasters: hold zeros and ones, a readout spike each; got other values (cumulated counts?)")
    return spikes.detach().to(torch.int64)


def _labels(labels: Tensor | np.ndarray, found: Exits) -> Tensor:
    true = torch.as_tensor(labels, device=found.labels.device)
    if true.shape != found.labels.shape[:1]:
        raise InputError(f"labels: have shape {tuple(true.shape)} where ({len(found.labels)},) is expected")
    return true
