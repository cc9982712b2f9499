"""Early exit: stop a trial when its leading class has stood long enough (texture paper, Algorithm 1)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.errors import InputError


@dataclass(frozen=True)
class ExitRule:
    """Exit when the leading class is unchanged for `patience` + 1 consecutive steps.

    The class that leads has the largest count of readout spikes so far or, where the readout is an integrator, the
    largest sum.

    patience: steps; None never exits, so that the full window is simulated.
    from_first_spike: count from the first step at which the trial's readout moves (`validated`): its first spike, or
        the first hidden spike that an integrator adds; not from its first step (the paper's Algorithm 1, where a
        silent readout is led by class 0).
    """

    patience: int | None = None
    from_first_spike: bool = False

    def __post_init__(self) -> None:
        if self.patience is not None and self.patience < 1:
            raise InputError(f"patience: must be >= 1 step; got {self.patience}")


FULL_WINDOW = ExitRule()


class Leader(NamedTuple):
    """The race of the classes: counts `(trial, class)`, who leads and for how many steps it has stood.

    `standing` is 0 before the first step, and 1 at the step where a leader is first seen. `heard` says whether the
    readout has moved.
    """

    counts: Tensor
    index: Tensor
    standing: Tensor
    standing_since_spike: Tensor
    heard: Tensor

    @staticmethod
    def start(n_trials: int, n_classes: int, device: torch.device, level: Tensor | None = None) -> "Leader":
        """Before the first step.

        level: what an integrator has of each class then, its bias, `(class,)`; absent, spikes are counted from 0.
        """
        zero = torch.zeros(n_trials, dtype=torch.int64, device=device)
        none = torch.zeros(n_classes, dtype=torch.int64, device=device) if level is None else level
        counts = none.expand(n_trials, n_classes).clone()
        return Leader(counts, zero, zero, zero, zero.to(torch.bool))

    def after(self, gained: Tensor) -> "Leader":
        """The race one step later, `gained` being spikes or what an integrator adds; ties go to the lowest index."""
        counts = self.counts + gained
        index = counts.argmax(dim=1)
        same = index == self.index
        standing = torch.where(same, self.standing + 1, 1)
        heard = self.heard | gained.any(dim=1)
        since = torch.where(same & heard, self.standing_since_spike + 1, heard.to(torch.int64))
        return Leader(counts, index, standing, since, heard)

    def exits(self, rule: ExitRule) -> Tensor:
        """Which trials stop now, `(trial,)` boolean."""
        if rule.patience is None:
            return torch.zeros_like(self.index, dtype=torch.bool)
        return (self.standing_since_spike if rule.from_first_spike else self.standing) > rule.patience

    def select(self, keep: Tensor) -> "Leader":
        return Leader(*(part[keep] for part in self))
