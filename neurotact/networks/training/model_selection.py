"""Selection on validation trials, and the last training after it, with the condition that validation left out.

Where the test is on conditions that no training trial has, validation trials have a condition that training trials have
not: they choose the kind of varied copies, the epoch and the exit rule. What that came to is kept (`Choice`), since
validation trials of the last training have only conditions that are trained on, and say nothing of the test.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from neurotact.data.augmentation import NONE, UNRANKED, AugmentationSpec
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import SplitSpec, turns_of
from neurotact.metrics import paired
from neurotact.networks.definition.network import Network
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.exit.rule import ExitRule, SavedBand
from neurotact.networks.training import ensemble, epochs, tasks, trainer
from neurotact.networks.training.epochs import Checkpoint, Epoch, Examples
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import measuring
from neurotact.spec import Spec


class Choice(Spec):
    """What a training chose on validation trials of another condition."""

    network: RSNNSpec
    """The network, with its recipe resolved."""
    exit_patience: int | None = Field(default=None, ge=1)
    exit_band: SavedBand = Field(default=(), exclude_if=lambda band: not band)
    gone = {"exit_margin": None}
    accuracy_validation: float = Field(le=1)
    exit_accuracy_validation: float = Field(le=1)
    exit_losses: dict[int, float] = {}
    """By validation trial, as of `ExitChoice`; a choice of an earlier version has none."""
    recurrence_gain: float | None = None
    smallest_accuracy: float | None = Field(default=None, le=1)
    layer_gain: float | None = None
    path_gain: float | None = None
    """Of validation accuracy, or score of numbers; None if it was not tried (`epochs.Training`)."""

    @classmethod
    def of(cls, fitted: Trained, validation: Examples) -> "Choice":
        """Of a trained network and its validation windows."""
        return cls(
            network=ensemble.spec_of(fitted.network, fitted.training.n_members),
            exit_patience=fitted.rule.patience,
            exit_band=fitted.rule.band,
            accuracy_validation=fitted.training.best.validation_accuracy,
            exit_accuracy_validation=measuring.exit_accuracy(fitted, validation),
            exit_losses={} if fitted.held is None else dict(fitted.held.losses),
            **{name: getattr(fitted.training, name) for name in epochs.GAINS},
        )

    @property
    def rule(self) -> ExitRule:
        """The rule of early exit."""
        return ExitRule(self.exit_patience, from_first_spike=True, band=self.exit_band)

    def given_to(self, last: Trained, task: Task) -> Trained:
        """The network of the last training with the rule of this choice, and what is known of its loss."""
        return last.with_rule(self.rule, ExitChoice(self.rule, self.exit_losses, task.exit_tolerance))

    def row(self) -> dict[str, float]:
        """The columns of results by which networks are compared: their accuracies at a condition not trained on."""
        columns = {"accuracy_validation", "exit_accuracy_validation", *epochs.GAINS}
        return self.model_dump(include=columns, exclude_none=True)


def last(
    trains: SpikeTrains, choice: Choice, task: Task, seeds: tuple[int, int], **options: Any
) -> tuple[Trained, Sides]:
    """Train the chosen network; task: of `tasks.with_every_condition`, options: of `trainer.fit`."""
    fitted, sides = trainer.fit(trains, choice.network, task, seeds, **options)
    return trainer.refusing(choice.given_to(fitted, task), sides.validation, task), sides


PART, CLEAR = 0.25, 2.0
"""After this share of the epochs one kind of copies goes on, among those within so many standard errors of the best."""
SEEN = 0.15
"""Share of the training trials that are kept for a test at the conditions of training."""


class Tried(NamedTuple):
    """A training with one kind of varied copies; seen: its accuracy at conditions of training, None if unknown.

    sides: `trainings` leaves out the spikes of training windows, and keeps their labels.
    choice: of the last training, what the one before it chose.
    """

    task: Task
    fitted: Trained
    sides: Sides
    seen: float | None = None
    choice: Choice | None = None

    @property
    def validation(self) -> float:
        """The accuracy on validation windows, which chooses."""
        return self.fitted.training.best.validation_accuracy

    @property
    def validated(self) -> dict[str, float]:
        """The columns of results that are of the choice, in place of this training's own; empty without a choice."""
        return {} if self.choice is None else self.choice.row()

    def row(self) -> dict[str, Any]:
        """A row of `remedies.csv`; the validation accuracy of the last training does not compare."""
        network, test = self.fitted.network, self.sides.test
        inferred = network.infer(test.spikes)
        return {
            "augmentation": self.task.augmentation,
            "accuracy_validation": self.validation if self.choice is None else None,
            "accuracy_seen": self.seen,
            "accuracy_test": measuring.accuracy_of(inferred, test),
            "sops_total": float(measuring.synops_of(inferred, network).total.mean()),
            "n_train": len(self.sides.train.labels),
        }


def candidates(augmentation: AugmentationSpec | None, conditions: pd.DataFrame, split: SplitSpec) -> tuple[str, ...]:
    """The kinds of copies to train with: those that `auto` chooses among, if validation can choose; `none` without any.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 4, "speed": [150, 150, 300, 300] * 2})
    >>> candidates(AugmentationSpec(), table, SplitSpec(test_where={"speed": 300}))
    ('time+gain',)
    """
    kinds = (NONE,) if augmentation is None else augmentation.candidates
    return kinds if turns_of(conditions, split) else kinds[-1:]


def are_unranked(kinds: Sequence[str], conditions: pd.DataFrame, split: SplitSpec) -> bool:
    """Whether copies of every kind are trained on where no validation trials are of another condition.

    Validation trials then vary as training trials do, since recorded ones would rank for the conditions of training.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 6, "speed": [150] * 4 + [300] * 4 + [450] * 4})
    >>> fast, slow = SplitSpec(test_where={"speed": 300}), table[table.speed < 400]
    >>> [are_unranked(["time+gain"], known, fast) for known in (table, slow)], are_unranked(["gain"], slow, fast)
    ([False, True], False)
    """
    is_every = len(kinds) == 1 and kinds[0] in UNRANKED
    return is_every and bool(split.test_where) and not turns_of(conditions, split)


class RuledOut(NamedTuple):
    """A kind of varied copies that is not trained to the end: its best epoch of so many.

    first: the kind that goes on, and its best epoch of as many.
    """

    kind: str
    epoch: Epoch
    epochs: int
    first: tuple[str, Epoch]

    def __str__(self) -> str:
        (name, other), own = self.first, self.epoch
        return (
            f"copies '{self.kind}' are ruled out after {self.epochs} epochs: {100 * own.validation_accuracy:.0f} % of "
            f"validation trials of another condition and a loss of {own.validation_loss:.2g}, behind '{name}' with "
            f"{100 * other.validation_accuracy:.0f} % and {other.validation_loss:.2g}"
        )

    def row(self) -> dict[str, Any]:
        """A row of `remedies.csv`."""
        columns = {"accuracy_validation": self.epoch.validation_accuracy, "ruled_out": self.epochs}
        return {"augmentation": self.kind, **columns, "chosen": False, "last": False}


Begun = Mapping[str, Checkpoint | Tried]
"""Trainings by their kind of copies: where they go on, or what came of them if they were done early."""


def rule_out(
    trains: SpikeTrains,
    spec: RSNNSpec,
    task: Task,
    seeds: tuple[int, int],
    kinds: Sequence[str],
    progress: Any = None,
) -> tuple[Begun, list[RuledOut]]:
    """Begin the training with each kind of varied copies; the one that goes on, and which are ruled out (`first_of`).

    Without copies a network has seen fewer windows by then: that training is not judged, and tells what copies gain.
    The training that goes on is as if nothing had been judged; one that is done by then is kept.
    """
    copied = [kind for kind in kinds if kind != NONE]
    if len(copied) < 2:
        return {}, []
    begun: dict[str, Checkpoint | Tried] = {}
    epoch: dict[str, Epoch] = {}
    for kind in copied:
        try:
            done = begun[kind] = _trained(trains, spec, _task_of(task, kind), seeds, progress=progress, until=PART)
            epoch[kind] = done.fitted.training.best
        except trainer.Paused as paused:
            begun[kind], epoch[kind] = paused.checkpoint, paused.best
    first = first_of(epoch, len(np.unique(copies_of(trains).first[tasks.trials_of(trains, task).validation])))
    out = [
        RuledOut(kind, epoch[kind], len(one.epochs), (first, epoch[first]))
        for kind, one in begun.items()
        if kind != first and isinstance(one, Checkpoint)
    ]
    return {kind: one for kind, one in begun.items() if kind not in {each.kind for each in out}}, out


def first_of(epoch: Mapping[str, Epoch], n: int) -> str:
    """Of the names whose accuracy is not clearly below the best, the one with the lowest loss; n: validation trials.

    Accuracies of a few trials are often equal, or all 100 %: the loss still tells then.
    """
    worse = clearly_worse({name: one.validation_accuracy for name, one in epoch.items()}, n)
    return min((name for name in epoch if name not in worse), key=lambda name: epoch[name].validation_loss)


def clearly_worse(accuracies: Mapping[str, float], n: int) -> list[str]:
    """The names whose accuracy is below the best by more than `CLEAR` standard errors of the difference.

    n: the trials of each accuracy. The errors are those of different trials: of the same trials they are less. Both
    they and the difference are taken with one more trial right and one more wrong (Agresti and Caffo 2000, doi
    10.1080/00031305.2000.10474560).

    >>> clearly_worse({"time": 0.9, "gain": 0.6, "time+gain": 0.85}, 40)
    ['gain']
    """
    best = max(accuracies.values())

    def variance(accuracy: float) -> float:
        share = (accuracy * n + 1) / (n + 2)
        return share * (1 - share) / (n + 2)

    error = {name: math.sqrt(variance(best) + variance(one)) for name, one in accuracies.items()}
    of_more = n / (n + 2)
    return [name for name, one in accuracies.items() if (best - one) * of_more > CLEAR * error[name]]


def trainings(
    trains: SpikeTrains,
    spec: RSNNSpec,
    task: Task,
    seeds: tuple[int, int],
    kinds: Sequence[str],
    progress: Any = None,
    begun: Begun = MappingProxyType({}),
) -> Iterator[Tried]:
    """A training with each kind of varied copies, all from the same initial weights; begun: of `rule_out`.

    A single kind was not chosen on validation trials of another condition; these then vary as training trials do.
    """
    varied = are_unranked(kinds, trains.conditions, task.split)
    for kind in kinds:
        start = begun.get(kind)
        own = _task_of(task, kind).model_copy(update={"varied_validation": varied})
        is_done = isinstance(start, Tried)
        yield start if is_done else _trained(trains, spec, own, seeds, progress=progress, start=start)


def _task_of(task: Task, kind: str) -> Task:
    return task.model_copy(update={"augmentation": kind})


def _trained(trains: SpikeTrains, spec: RSNNSpec, task: Task, seeds: tuple[int, int], **options: Any) -> Tried:
    fitted, sides = trainer.fit(trains, spec, task, seeds, **options)
    return Tried(task, fitted, _without_training(sides), _accuracy_seen(fitted, trains, task))


def _without_training(sides: Sides) -> Sides:
    """The sides without the spikes of training windows, which are most of all, while other kinds are trained."""
    _, *shape = sides.train.spikes.shape
    return sides._replace(train=sides.train._replace(spikes=sides.train.spikes.new_zeros(0, *shape)))


def _accuracy_seen(fitted: Trained, trains: SpikeTrains, task: Task) -> float | None:
    """The accuracy on trials that are kept for a test at the conditions of training; None if none are."""
    seen = tasks.seen_side(trains, task)
    return None if seen is None else measuring.accuracy_of(fitted.network.infer(seen.spikes), seen)


def best_of(tried: Sequence[Tried]) -> Tried:
    """The training with the highest accuracy on validation windows; of equal ones that with the lowest loss."""
    return max(tried, key=lambda one: (one.validation, -one.fitted.training.best.validation_loss))


def again(trains: SpikeTrains, chosen: Tried, seeds: tuple[int, int], progress: Any = None) -> Tried:
    """The chosen training once more, with the condition that validation left out; itself where it left none out."""
    task = tasks.with_every_condition(trains, chosen.task)
    if task is None:
        return chosen
    choice = Choice.of(chosen.fitted, chosen.sides.validation)
    fitted, sides = last(trains, choice, task, seeds, progress=progress)
    return Tried(task, fitted, sides, _accuracy_seen(fitted, trains, task), choice)


def right_seen(network: Network, trains: SpikeTrains, task: Task) -> dict[int, float]:
    """The share of correct windows of each trial that is kept for a test at the conditions of training.

    Copies of a trial are one trial, the first of them. Empty if the task keeps none.
    """
    kept = tasks.seen_trials(trains, task)
    if not len(kept):
        return {}
    examples, windows = tasks.examples_of(trains, kept, task)
    return paired.by_trial(
        copies_of(trains).first[windows.trial], measuring.right_of(network.infer(examples.spikes), examples)
    )
