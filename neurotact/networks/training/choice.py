"""The last training of a network that is tested on untrained conditions: with the condition that validation left out.

The training before it chooses. What it came to is kept (`Choice`), since validation trials of the last one have only
conditions that are trained on, and say nothing of the test.
"""

from typing import Any

from pydantic import Field

from neurotact.data.spikes import SpikeTrains
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.early_exit import ExitRule
from neurotact.networks.exit.held_out import ExitChoice
from neurotact.networks.training import fitting, members
from neurotact.networks.training.fitting import Trained
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.training import Examples
from neurotact.networks.use import measuring
from neurotact.spec import Spec


class Choice(Spec):
    """What a training chose on validation trials of another condition."""

    network: RSNNSpec
    """The network, with its recipe resolved."""
    exit_patience: int | None = Field(default=None, ge=1)
    gone = {"exit_margin": None}
    accuracy_validation: float = Field(ge=0, le=1)
    exit_accuracy_validation: float = Field(ge=0, le=1)
    exit_losses: dict[int, float] = {}
    """By validation trial, as of `ExitChoice`; a choice of an earlier version has none."""
    recurrence_gain: float | None = Field(default=None, ge=-1, le=1)
    """Of validation accuracy; None if recurrence was not tried (`training.Training`)."""

    @classmethod
    def of(cls, fitted: Trained, validation: Examples) -> "Choice":
        """Of a trained network and its validation windows."""
        return cls(
            network=members.spec_of(fitted.network, fitted.training.n_members),
            exit_patience=fitted.rule.patience,
            accuracy_validation=fitted.training.best.validation_accuracy,
            exit_accuracy_validation=measuring.exit_accuracy(fitted, validation),
            exit_losses={} if fitted.held is None else dict(fitted.held.losses),
            recurrence_gain=fitted.training.recurrence_gain,
        )

    @property
    def rule(self) -> ExitRule:
        """The rule of early exit."""
        return ExitRule(self.exit_patience, from_first_spike=True)

    def given_to(self, last: Trained, task: Task) -> Trained:
        """The network of the last training with the rule of this choice, and what is known of its loss."""
        return last.with_rule(self.rule, ExitChoice(self.rule, self.exit_losses, task.exit_tolerance))

    def row(self) -> dict[str, float]:
        """The columns of results by which networks are compared: their accuracies at a condition not trained on."""
        columns = {"accuracy_validation", "exit_accuracy_validation", "recurrence_gain"}
        return self.model_dump(include=columns, exclude_none=True)


def last(
    trains: SpikeTrains, choice: Choice, task: Task, seeds: tuple[int, int], **options: Any
) -> tuple[Trained, Sides]:
    """Train the chosen network; task: of `tasks.with_every_condition`, options: of `fitting.fit`."""
    fitted, sides = fitting.fit(trains, choice.network, task, seeds, **options)
    return choice.given_to(fitted, task), sides
