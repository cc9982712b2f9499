"""The choice of an exit rule: the patience of a network, from readout rasters of full windows.

`least` chooses one patience per network on validation trials and uses no test label. `steady` also uses the
training trials, because few validation trials may mislead. `oracle_exit` reproduces the texture paper's Algorithm 1,
which knows the true label. All patiences are evaluated together: a trial exits at the first step at which its leading
class has led for patience + 1 steps.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.exit.early_exit import ExitRule, Leader


class _Exits(NamedTuple):
    """Exit step and label of each trial for each patience, `(trial, patience)` int64 each.

    steps: simulated steps, the window's length T without an exit; labels: the class that leads then.
    Column p - 1 belongs to patience p, from 1 to T.
    """

    steps: Tensor
    labels: Tensor


class _OracleExit(NamedTuple):
    """Algorithm 1's results, `(trial,)` int64: Time_new, index_op and the patience that it ended with."""

    steps: Tensor
    labels: Tensor
    patience: Tensor


def exits(
    rasters: Tensor | np.ndarray, from_first_spike: bool = True, integration: Integration | None = None
) -> _Exits:
    """Exit step and label of every trial for every patience.

    rasters: readout spikes of full windows, `(trial, time, class)`, zeros and ones (not cumulated), as
        `RSNN.simulate` returns them; for an integrator, its input at each step.
    from_first_spike: as in ExitRule.
    integration: of an integrator, `RSNN.integration`; if absent, spikes are counted.

    >>> exits(torch.tensor([[[0, 1], [0, 0], [0, 0]]])).steps.tolist()
    [[2, 3, 3]]
    """
    spikes = _checked(rasters, integration)
    n_trials, n_steps, _ = spikes.shape
    first = torch.full((n_trials, n_steps + 1), n_steps, dtype=torch.int64, device=spikes.device)
    leading = torch.empty(n_trials, n_steps, dtype=torch.int64, device=spikes.device)
    for t, leader in enumerate(_leaders(spikes, integration)):
        leading[:, t] = leader.index
        standing = leader.standing_since_spike if from_first_spike else leader.standing
        # A class that has led for s steps led for s - 1 a step before: the first s is the first of at least s.
        first.scatter_reduce_(1, standing[:, None], torch.full_like(standing[:, None], t + 1), "amin")
    # Patience p exits at standing p + 1. No class leads for T + 1 steps: patience T is the full window.
    steps = torch.cat([first[:, 2:], first.new_full((n_trials, 1), n_steps)], dim=1)
    return _Exits(steps, leading.gather(1, steps - 1))


def _leaders(spikes: Tensor, integration: Integration | None) -> Iterator[Leader]:
    """The leading classes after each step."""
    integration = None if integration is None else integration.detach()
    leader = Leader.start(spikes.shape[0], spikes.shape[2], spikes.device, integration)
    for t in range(spikes.shape[1]):
        leader = leader.after(spikes[:, t], integration)
        yield leader


def is_right(decisions: _Exits, labels: Tensor | np.ndarray) -> Tensor:
    """Whether each rule decides each trial correctly, `(trial, rule)`."""
    return decisions.labels == _labels(labels, decisions)[:, None]


def least(right: Tensor, n_trials: int, tolerance: float) -> int:
    """The first of ascending rules whose accuracy is within `tolerance` of the last rule's, the full window's.

    right: how many *validation* trials each rule decides correctly (`is_right`, summed over trials).
    tolerance: accuracy that may be lost, such as 0.01 for one point; a rule may also be more accurate.

    >>> least(torch.tensor([0, 1, 1]), 1, tolerance=0.0)
    1
    """
    return int(torch.nonzero(_within(right.double() / n_trials, tolerance))[0])


def steady(validation: Tensor, n_validation: int, training: Tensor, n_training: int, tolerance: float) -> int:
    """The first of ascending rules from which on every rule loses at most `tolerance`, on both kinds of trials.

    validation, training: how many of the trials each rule decides correctly (`is_right`, summed over trials).
    The loss is measured on validation trials, and on all trials together. With 20 validation trials, one is 5 points,
    and a patience that does well on them by chance often does not on others: on real presses (20 validation trials, 6
    networks) `least` lost 7.6 points of test accuracy on average, and `steady` 1.5.

    >>> steady(torch.tensor([3, 2, 3]), 3, torch.tensor([9, 9, 9]), 9, tolerance=0.1)
    2
    """
    sides = ((validation, n_validation), (validation + training, n_validation + n_training))
    lost = ~torch.stack([_within(right.double() / n_trials, tolerance) for right, n_trials in sides]).all(dim=0)
    worst = torch.nonzero(lost)
    return int(worst[-1]) + 1 if len(worst) else 0


def patience_rule(index: int, steps_per_bin: int = 1) -> ExitRule:
    """The rule of a column of `exits`, counted from the first step at which the readout changes.

    steps_per_bin: steps of the input's clock for one of the rasters.
    """
    return ExitRule((index + 1) * steps_per_bin, from_first_spike=True)


def _within(accuracy: Tensor, tolerance: float) -> Tensor:
    """Whether the accuracy of each rule is within `tolerance` of the last one's, the full window's."""
    if not 0 <= tolerance <= 1:
        raise InputError(f"tolerance: is an accuracy from 0 to 1; got {tolerance}")
    return is_within(accuracy, accuracy[-1], tolerance)


def printed_exits(rasters: Tensor | np.ndarray, integration: Integration | None = None) -> _Exits:
    """Exit step and label of every trial for every patience, by the texture paper's Algorithm 1 as it is printed.

    Its line 17 resets `counter`, a variable that is used nowhere else, and never `count`: the steps at which the
    leading class is that of the step before add up over the whole window, and their number ends it.

    >>> printed_exits(torch.tensor([[[0, 1], [0, 1], [1, 0], [0, 1]]])).steps.tolist()
    [[2, 3, 4, 4]]
    """
    spikes = _checked(rasters, integration)
    n_steps = spikes.shape[1]
    leading = torch.stack([leader.index for leader in _leaders(spikes, integration)], dim=1)
    unchanged = torch.nn.functional.pad((leading[:, 1:] == leading[:, :-1]).long(), (1, 0)).cumsum(dim=1)
    patiences = torch.arange(1, n_steps + 1, device=spikes.device).expand(len(leading), -1).contiguous()
    steps = (torch.searchsorted(unchanged.contiguous(), patiences) + 1).clamp(max=n_steps)
    return _Exits(steps, leading.gather(1, steps - 1))


def oracle_exit(
    rasters: Tensor | np.ndarray,
    labels: Tensor | np.ndarray,
    patience: int,
    integration: Integration | None = None,
    *,
    as_printed: bool = False,
) -> _OracleExit:
    """The texture paper's Algorithm 1, line 17 read as count = 0; it knows the true label, so it is no prediction.

    as_printed: read line 17 as it stands, see `printed_exits`.
    Each trial starts with `patience`. While its exit label is wrong, patience is raised by one (the paper says
    "adjusting the Patience"); a patience without an exit gives the full window. A trial that is never right runs
    the full window, with that label and patience T. Steps count from the first one, where class 0 leads a silent
    readout.

    >>> oracle_exit(torch.tensor([[[1, 0], [0, 1], [0, 1]]]), torch.tensor([1]), patience=1)._asdict()
    {'steps': tensor([3]), 'labels': tensor([1]), 'patience': tensor([2])}
    """
    ExitRule(patience)  # refuses a patience below 1
    decisions = printed_exits(rasters, integration) if as_printed else exits(rasters, False, integration)
    n_steps = decisions.steps.shape[1]
    start = min(patience, n_steps) - 1
    right = is_right(decisions, labels)[:, start:]
    # argmax finds the first true; without one, the last column is used.
    steps = torch.where(right.any(dim=1), start + right.to(torch.uint8).argmax(dim=1), n_steps - 1)[:, None]
    return _OracleExit(decisions.steps.gather(1, steps)[:, 0], decisions.labels.gather(1, steps)[:, 0], steps[:, 0] + 1)


def _checked(rasters: Tensor | np.ndarray, integration: Integration | None) -> Tensor:
    spikes = torch.as_tensor(rasters)
    if spikes.ndim != 3 or 0 in spikes.shape:
        raise InputError(f"rasters: have shape {tuple(spikes.shape)} where some (trial, time, class) is expected")
    if integration is not None:
        return spikes.detach()
    if not ((spikes == 0) | (spikes == 1)).all():
        raise InputError("rasters: hold zeros and ones, a readout spike each; got other values (cumulated counts?)")
    return spikes.detach().to(torch.int64)


def _labels(labels: Tensor | np.ndarray, decisions: _Exits) -> Tensor:
    true = torch.as_tensor(labels, device=decisions.labels.device)
    if true.shape != decisions.labels.shape[:1]:
        raise InputError(f"labels: have shape {tuple(true.shape)} where ({len(decisions.labels)},) is expected")
    return true
