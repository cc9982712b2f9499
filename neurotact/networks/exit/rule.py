"""Early exit: stop a trial when its leading class is stable (texture paper, Algorithm 1), or the numbers it tells."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from neurotact.errors import InputError, number_of
from neurotact.networks.definition.readouts import Integration


@dataclass(frozen=True)
class ExitRule:
    """Exit when the leading class, or every number, is unchanged for `patience` + 1 consecutive steps.

    The leading class has the largest count of readout spikes so far or, if the readout is an integrator, the largest
    value.

    patience: steps of the input's clock; a network on a slower clock counts whole steps of its own (`in_bins`).
    from_first_spike: count from the first step at which the trial's readout changes (`validated`): its first spike, or
        the first hidden spike that an integrator adds. Otherwise count from the first step, as in the paper's
        Algorithm 1, where class 0 leads a silent readout.
    least_lead: a leading class that leads by less at the decision is refused: the touch is none of the classes.
    band: how far each number may move from the value that it had when the count began, in its unit, and still be
        unchanged. Empty for classes.
    Without patience no trial exits: the full window is simulated.
    """

    patience: int | None = None
    from_first_spike: bool = False
    least_lead: float = 0.0
    band: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.patience is not None and self.patience < 1:
            raise InputError(f"patience: must be >= 1 step; got {self.patience}")

    @property
    def never(self) -> bool:
        """Whether no trial exits."""
        return self.patience is None

    def told(self, labels: Tensor, readout: Tensor) -> Tensor:
        """The decisions `(trial,)` by the leading classes and readouts `(trial, class)`; none is the number of classes.

        >>> ExitRule(least_lead=2).told(torch.tensor([0, 1]), torch.tensor([[3, 1], [3, 4]])).tolist()
        [0, 2]
        """
        return labels.masked_fill(leads(readout) < self.least_lead, readout.shape[1]) if self.least_lead else labels

    def in_bins(self, n: int) -> "ExitRule":
        """The rule of a network that is computed once in `n` steps: a patience of whole bins, at least one.

        >>> ExitRule(20).in_bins(5).patience, ExitRule(2).in_bins(5).patience
        (4, 1)
        """
        return self if n == 1 or self.patience is None else replace(self, patience=max(1, self.patience // n))


FULL_WINDOW = ExitRule()
SavedBand = tuple[Annotated[float, Field(ge=0)], ...]
"""The band of a rule in a table that is read."""


def check_band(band: Sequence[float], numbers: Sequence[str]) -> None:
    """Raise ValueError for a saved band without a value for each number that a network tells; none for classes.

    >>> check_band((0.5,), ("force_N", "depth_mm"))
    Traceback (most recent call last):
    ValueError: exit_band: has 1 value, but the network tells 2 numbers; write the file again
    """
    if band and len(band) != len(numbers):
        told = number_of(len(numbers), "number") if numbers else "classes"
        raise ValueError(f"exit_band: has {number_of(len(band), 'value')}, but the network tells {told}; "
                         "write the file again")  # fmt: skip


def leads(readout: Tensor) -> Tensor:
    """By how much the leading class exceeds the next one, `(trial,)`, of counts or values `(trial, class)`."""
    first, second = readout.topk(2, dim=1).values.unbind(dim=1)
    return first - second


class Leader(NamedTuple):
    """Counts or values of the classes `(trial, class)`, the leading class, and for how many steps it has led.

    `standing` is 0 before the first step, and 1 at the step where a class first leads. `heard`: whether the readout has
    changed. `leaky`: y of an integrator that leaks, `(trial, class)`; else None. `stood`: of numbers, the values since
    which they stand, `(trial, number)`: then no class leads, and `standing` counts steps within the band.
    """

    counts: Tensor
    index: Tensor
    standing: Tensor
    standing_since_spike: Tensor
    heard: Tensor
    leaky: Tensor | None = None
    stood: Tensor | None = None

    @staticmethod
    def start(
        n_trials: int, n_classes: int, device: torch.device, integration: Integration | None = None,
        band: tuple[float, ...] = (),
    ) -> "Leader":  # fmt: skip
        """Before the first step; without an `integration` spikes are counted from 0. band: as of `ExitRule`."""
        zero = torch.zeros(n_trials, dtype=torch.int64, device=device)
        leaky = None
        if integration is None:
            counts = zero[:, None].expand(n_trials, n_classes).clone()
        else:
            y, counts = integration.start(n_trials)
            leaky = y if integration.leaks else None
        return Leader(counts, zero, zero, zero, zero.to(torch.bool), leaky, counts if band else None)

    def after(self, gained: Tensor, integration: Integration | None = None, band: tuple[float, ...] = ()) -> "Leader":
        """The state one step later; `gained`: spikes, or the input of an integrator. Ties go to the lowest index."""
        leaky = self.leaky
        if integration is None or leaky is None:
            counts = self.counts + gained
        else:
            leaky, counts = integration.after(gained, leaky, self.counts)
        index, stood = counts.argmax(dim=1), self.stood
        if stood is None:
            same = index == self.index
        else:
            same = ((counts - stood).abs() <= counts.new_tensor(band)).all(dim=1)
            index, stood = self.index, torch.where(same[:, None], stood, counts)
        standing = torch.where(same, self.standing + 1, 1)
        changed = self.heard | gained.any(dim=1)
        since = torch.where(same & changed, self.standing_since_spike + 1, changed.to(torch.int64))
        return Leader(counts, index, standing, since, changed, leaky, stood)

    def exits(self, rule: ExitRule) -> Tensor:
        """Which trials stop now, `(trial,)` boolean."""
        if rule.patience is None:
            return torch.zeros_like(self.index, dtype=torch.bool)
        return (self.standing_since_spike if rule.from_first_spike else self.standing) > rule.patience

    def select(self, keep: Tensor) -> "Leader":
        """The state of some trials."""
        return Leader(*(None if part is None else part[keep] for part in self))  # pyright: ignore[reportArgumentType]
