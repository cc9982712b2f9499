"""Early exit: stop a trial when its leading class has stood long enough (texture paper, Algorithm 1)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.errors import InputError


@dataclass(frozen=True)
class ExitRule:
    """Exit when the leading readout neuron is unchanged for `patience` + 1 consecutive steps.

    patience: steps; None never exits, so that the full window is simulated.
    from_first_spike: count from the trial's first readout spike (`validated`), not from its first step (the
        paper's Algorithm 1, where a silent readout is led by class 0).
    """

    patience: int | None = None
    from_first_spike: bool = False

    def __post_init__(self) -> None:
        if self.patience is not None and self.patience < 1:
            raise InputError(f"patience: must be >= 1 step; got {self.patience}")


FULL_WINDOW = ExitRule()


class Leader(NamedTuple):
    """The race of the readout neurons: counts `(trial, class)`, who leads and for how many steps it has stood.

    `standing` is 0 before the first step, and 1 at the step where a leader is first seen.
    """

    counts: Tensor
    index: Tensor
    standing: Tensor
    standing_since_spike: Tensor

    @staticmethod
    def start(n_trials: int, n_classes: int, device: torch.device) -> "Leader":
        zero = torch.zeros(n_trials, dtype=torch.int64, device=device)
        return Leader(torch.zeros(n_trials, n_classes, dtype=torch.int64, device=device), zero, zero, zero)

    def after(self, spikes: Tensor) -> "Leader":
        """The race one step later; ties go to the lowest index."""
        counts = self.counts + spikes
        index = counts.argmax(dim=1)
        same = index == self.index
        standing = torch.where(same, self.standing + 1, 1)
        heard = counts.any(dim=1)
        since = torch.where(same & heard, self.standing_since_spike + 1, heard.to(torch.int64))
        return Leader(counts, index, standing, since)

    def exits(self, rule: ExitRule) -> Tensor:
        """Which trials stop now, `(trial,)` boolean."""
        if rule.patience is None:
            return torch.zeros_like(self.index, dtype=torch.bool)
        return (self.standing_since_spike if rule.from_first_spike else self.standing) > rule.patience

    def select(self, keep: Tensor) -> "Leader":
        return Leader(*(part[keep] for part in self))
