"""The choice of an exit rule: the patience of a network, from readouts of full windows, and what it loses.

`least` chooses one patience per network on validation trials and uses no test label. `steady` also uses the
training trials, because few validation trials may mislead. `oracle_exit` reproduces the texture paper's Algorithm 1,
which knows the true label. All patiences are evaluated together: a trial exits at the first step at which its leading
class has led for patience + 1 steps.
A rule that is chosen and judged on the same trials looks better than it is: of many patiences, one does well by luck.
So validation trials are divided into folds, and the rule that the other folds choose is judged on each.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.stats import beta, norm
from torch import Tensor

from neurotact.baselines.opponent import right
from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.networks.definition.readouts import Integration
from neurotact.networks.exit.rule import FULL_WINDOW, ExitRule, Leader


class _Exits(NamedTuple):
    """Exit step and label of each trial for each patience, `(trial, patience)` int64 each.

    steps: simulated steps, the window's length T without an exit; labels: the class that leads then, or the numbers,
    `(trial, patience, number)` float64.
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
    rasters: Tensor | np.ndarray, from_first_spike: bool = True, integration: Integration | None = None,
    band: tuple[float, ...] = (),
) -> _Exits:  # fmt: skip
    """Exit step and label of every trial for every patience.

    rasters: readout spikes of full windows, `(trial, time, class)`, zeros and ones (not cumulated), as
        `RSNN.simulate` returns them; for an integrator, its input at each step.
    from_first_spike, band: as in ExitRule.
    integration: of an integrator, `RSNN.integration`; if absent, spikes are counted.

    >>> exits(torch.tensor([[[0, 1], [0, 0], [0, 0]]])).steps.tolist()
    [[2, 3, 3]]
    """
    spikes = _checked(rasters, integration)
    n_trials, n_steps, _ = spikes.shape
    first = torch.full((n_trials, n_steps + 1), n_steps, dtype=torch.int64, device=spikes.device)
    told = []
    for t, leader in enumerate(_leaders(spikes, integration, band)):
        told.append(leader.counts if band else leader.index)
        standing = leader.standing_since_spike if from_first_spike else leader.standing
        # A class that has led for s steps led for s - 1 a step before: the first s is the first of at least s.
        first.scatter_reduce_(1, standing[:, None], torch.full_like(standing[:, None], t + 1), "amin")
    # Patience p exits at standing p + 1. No class leads for T + 1 steps: patience T is the full window.
    steps = torch.cat([first[:, 2:], first.new_full((n_trials, 1), n_steps)], dim=1)
    return _Exits(steps, torch.stack(told, dim=1)[torch.arange(n_trials, device=spikes.device)[:, None], steps - 1])


def _leaders(spikes: Tensor, integration: Integration | None, band: tuple[float, ...] = ()) -> Iterator[Leader]:
    """The leading classes after each step."""
    integration = None if integration is None else integration.detach()
    leader = Leader.start(spikes.shape[0], spikes.shape[2], spikes.device, integration, band)
    for t in range(spikes.shape[1]):
        leader = leader.after(spikes[:, t], integration, band)
        yield leader


def is_right(decisions: _Exits, labels: Tensor | np.ndarray, deviation: Tensor | None = None) -> Tensor:
    """Whether each rule decides each trial correctly, `(trial, rule)`, or its score (`opponent.right`)."""
    true = _labels(labels, decisions)
    if true.ndim == 1:
        return decisions.labels == true[:, None]
    n_rules = decisions.steps.shape[1]
    return right(decisions.labels.flatten(0, 1), true.repeat_interleave(n_rules, 0), deviation).reshape(-1, n_rules)


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


def patience_rule(index: int, steps_per_bin: int = 1, band: tuple[float, ...] = ()) -> ExitRule:
    """The rule of a column of `exits`, counted from the first step at which the readout changes.

    steps_per_bin: steps of the input's clock for one of the rasters.
    """
    return ExitRule((index + 1) * steps_per_bin, from_first_spike=True, band=band)


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
    if true.shape != decisions.labels[:, 0].shape:
        raise InputError(
            f"labels: have shape {tuple(true.shape)} where {tuple(decisions.labels[:, 0].shape)} is expected"
        )
    return true


FOLDS = 10
CONFIDENCE = 0.95
"""Of the upper bound, one-sided."""


class ExitChoice(NamedTuple):
    """A rule of early exit, and what rules that were chosen in the same way lose on other trials.

    losses: by validation trial, the share of its windows that are right on the whole window minus that with early exit,
    by a rule that the trial did not choose; empty if unknown. tolerance: accuracy that may be lost.
    """

    rule: ExitRule
    losses: Mapping[int, float]
    tolerance: float

    @property
    def bound(self) -> float:
        """The upper bound of the loss."""
        return float(upper_bound([*self.losses.values()], of_numbers=bool(self.rule.band)))

    @property
    def used(self) -> ExitRule:
        """The rule as it is used: that of the whole window where the loss may exceed the tolerance."""
        return self.rule if is_tolerated(self.bound, self.tolerance) else FULL_WINDOW

    @property
    def is_refused(self) -> bool:
        """Whether there is a rule of early exit that is not used."""
        return not self.rule.never and self.used.never

    @property
    def in_words(self) -> str:
        """What is known of the loss."""
        return in_words(self.bound, self.tolerance, of_numbers=bool(self.rule.band))


class Judged(NamedTuple):
    """Decisions of windows by each of ascending rules, the last of which is the full window.

    right: whether each is right, `(window, rule)` boolean, or its score. labels, trial: the class, or the first number,
    and the trial of each window, `(window,)`.
    """

    right: np.ndarray
    labels: np.ndarray
    trial: np.ndarray


def choose(validation: Judged, tolerance: float, training: tuple[torch.Tensor, int] | None = None) -> int:
    """The index of the rule that validation windows choose: by `least`, or by `steady` where training windows help.

    training: how many training windows each rule decides correctly, `(rule,)`, and their number. `steady` then also
    looks for the first rule from which on the upper bound of the loss is within the tolerance, where there are enough
    trials for one: a rule that loses as much as it may would be refused.
    """
    right = torch.from_numpy(validation.right.sum(axis=0))
    if training is None:
        return least(right, len(validation.right), tolerance)
    index = steady(right, len(validation.right), *training, tolerance)
    bounds = upper_bound(_lost(validation), of_numbers=validation.right.dtype != bool)
    above = np.flatnonzero(~is_tolerated(bounds, tolerance))
    safe = int(above[-1]) + 1 if len(above) else 0
    return max(index, safe) if safe < len(right) - 1 else index


def losses(validation: Judged, tolerance: float, training: tuple[torch.Tensor, int] | None = None) -> dict[int, float]:
    """The loss of early exit on each validation trial, by the rule that trials of the other folds `choose`.

    Empty for a single trial, which leaves no other to choose.

    >>> right = np.array([[0, 1], [1, 1], [1, 1]], bool)
    >>> losses(Judged(right, np.zeros(3, int), np.arange(3)), tolerance=0.1)
    {0: 1.0, 1: 0.0, 2: 0.0}
    """
    fold, found = _folds(validation), {}
    for held in range(fold.max() + 1) if fold.any() else ():
        inside, outside = (Judged(*(part[side] for part in validation)) for side in (fold == held, fold != held))
        rule = choose(outside, tolerance, training)
        found |= dict(zip(np.unique(inside.trial).tolist(), _lost(inside)[:, rule].tolist(), strict=True))
    return dict(sorted(found.items()))


def _folds(validation: Judged) -> np.ndarray:
    """The fold of each window: trials in turn, class by class, so that a class is in as many folds as it can be."""
    trials, first, of = np.unique(validation.trial, return_index=True, return_inverse=True)
    turn = np.empty(len(trials), np.int64)
    turn[np.argsort(validation.labels[first], kind="stable")] = np.arange(len(trials))
    return turn[of] % min(FOLDS, len(trials))


def _lost(validation: Judged) -> np.ndarray:
    """The share of the windows of each trial that each rule loses, `(trial, rule)`, in the order of the trials."""
    order = np.argsort(validation.trial, kind="stable")
    _, first, n = np.unique(validation.trial[order], return_index=True, return_counts=True)
    right = np.add.reduceat(validation.right[order].astype(np.float64), first) / n[:, None]
    return right[:, -1:] - right


def upper_bound(losses: ArrayLike, *, of_numbers: bool = False) -> np.ndarray:
    """The 95 % upper bound of a mean loss of independent trials; 1 without any.

    losses: paired differences of shares, from -1 to 1, `(trial,)` or `(trial, rule)`. The bound for paired proportions
    of Bonett and Price (2012, Journal of Educational and Behavioral Statistics 37:479), which adds one trial each way,
    and at least that of Clopper and Pearson (1934, Biometrika 26:404) for the trials that are lost on balance: without
    any loss the former alone would be too low.
    of_numbers: losses are of scores, which have no least: the largest loss of a trial, or gain, then stands for 1.

    >>> [round(float(upper_bound([0.0] * n)), 3) for n in (0, 30, 299)]
    [1.0, 0.095, 0.01]
    >>> round(float(upper_bound([0.02] + [0.0] * 29, of_numbers=True) / upper_bound([1.0] + [0.0] * 29)), 6)
    0.02
    """
    values = np.asarray(losses, float)
    if not len(values):
        return np.ones(values.shape[1:])
    most = np.abs(values).max(axis=0) if of_numbers else np.ones(values.shape[1:])
    values = values / np.where(most > 0, most, 1.0)
    n, total = len(values), values.sum(axis=0)
    mean = total / (n + 2)
    variance = ((values**2).sum(axis=0) + 2) / (n + 2) - mean**2
    paired = mean + norm.ppf(CONFIDENCE) * np.sqrt(variance / (n + 2))
    lost = np.clip(total, 0, n)
    exact = np.where(lost < n, beta.ppf(CONFIDENCE, lost + 1, np.maximum(n - lost, math.ulp(1.0))), 1.0)
    return most * np.minimum(1.0, np.maximum(paired, exact))


def is_tolerated(bound: ArrayLike, tolerance: float) -> np.ndarray:
    """Whether an upper bound of the loss is within the tolerance, so that early exit is used."""
    return np.asarray(bound) <= tolerance


def in_words(bound: float, tolerance: float, *, of_numbers: bool = False) -> str:
    """What is known of the loss.

    >>> in_words(0.095, 0.01)
    'it may lose up to 9.5 points, of which 1 is allowed (95 % bound from validation trials that did not choose it)'
    >>> in_words(1.0, 0.01)[:29]
    'it may lose up to 100 points,'
    """
    points = f"{float(f'{100 * bound:.2g}'):g} points, of which {100 * tolerance:.3g} is allowed"
    score = f"{bound:.2g} of the score, of which {tolerance:.3g} is allowed"
    return (
        f"it may lose up to {score if of_numbers else points} "
        f"({100 * CONFIDENCE:.0f} % bound from validation trials that did not choose it)"
    )
