"""The outcome of a training: its result, the comparison of its accuracy, and cautions."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

import pandas as pd

from neurotact import files
from neurotact.data.conditioning import acausal_note
from neurotact.data.copies import copies_of
from neurotact.data.spikes import SpikeTrains
from neurotact.data.splits import Split
from neurotact.metrics import starts
from neurotact.networks.training import cautions, comparison, numbers, tasks
from neurotact.networks.training.comparison import Comparison, Trials, compare
from neurotact.networks.training.events import tool
from neurotact.networks.training.model_selection import Choice
from neurotact.networks.training.tasks import Sides, Task
from neurotact.networks.training.trainer import Trained
from neurotact.networks.use import measuring


class Outcome(NamedTuple):
    """The outcome of a training.

    row: its numbers. confusion: test windows by true and chosen class, `(class, class)`, empty where numbers are
    learned; classes: their names, or the targets.
    compared: its accuracy, and what it is compared with. cautions: what may be wrong, one line each.
    step_ms: a step of the encoder's clock.
    acausal: a note on the encoder's baseline; None if windows depend only on the past.
    """

    row: dict[str, Any]
    confusion: list[list[int]]
    classes: tuple[str, ...]
    compared: Comparison
    cautions: list[str]
    step_ms: float
    acausal: str | None
    start: str = starts.ONE
    """What is said of the start of the weights."""
    refused: str = ""
    """What is said of touches that are none of the classes."""
    tables: Mapping[str, pd.DataFrame] = {}
    told: Collection[str] = ()
    """Of a detector, its tables by the names of their files, and what it comes to, in words."""

    def as_json(self) -> dict[str, Any]:
        """The content of `result.json`."""
        return {
            "row": files.without_nan(self.row),
            "confusion": self.confusion,
            "compared": self.compared._asdict(),
            "cautions": self.cautions,
        }

    def lines(self) -> list[str]:
        """The accuracy, the cost and the confusions in words."""
        told, at = (comparison.percent, "") if self.confusion else (numbers.scored, "a score of ")
        costs = comparison.costs(self.row, self.step_ms, lambda score: f"{at}{told(score)}")
        first, last = [*self.told], [*comparison.recurrence(self.row)]
        if self.confusion:
            last.append(comparison.confused(self.confusion, self.classes))
        else:
            first, last = [*numbers.lines(self.row, self.classes)], []
        return [
            *first,
            *comparison.lines(self.compared, self.start, told),
            costs,
            *last,
            *([self.refused] if self.refused else []),
            *([self.acausal] if self.acausal else []),
        ]


class Chosen(NamedTuple):
    """A training before the last one: its task, and what it chose."""

    task: Task
    choice: Choice


def summary_of(result: Mapping[str, Any]) -> dict[str, Any]:
    """The content of `result.json` in one row: the numbers, then those of `Comparison`, and `cautions`."""
    compared = {name: value for name, value in result["compared"].items() if name != "accuracy"}
    return {**result["row"], **compared, "cautions": result.get("cautions", [])}


def outcome_of(
    fitted: Trained,
    sides: Sides,
    trains: SpikeTrains,
    task: Task,
    command: cautions.Command = "train",
    searched: Collection[str] = (),
    chosen: Chosen | None = None,
) -> Outcome:
    """Measure a trained network on its test windows.

    command: whose options the remedies of its cautions name. searched: keys of the network that a search has chosen.
    chosen: on which task a training before the last one chose, and what; None if there is one training.
    """
    result = measuring.measure(fitted, sides, trains.populations)
    last = None
    if chosen is not None:
        result["row"] |= chosen.choice.row()
        task, last, sides = chosen.task, sides, tasks.sides_of(trains, chosen.task)
    parts = tasks.trials_of(trains, task)
    copies = copies_of(trains)
    distinct = Split(*map(copies.distinct, parts))
    held, tested = ((task.training_window, parts.validation), (task.window, parts.test))
    trials = Trials(*(copies.first[trains.cut(window, side).trial] for window, side in (held, tested)))
    names = tasks.names_of(trains, task)
    tables, told = {}, []
    if task.detects:
        found, tables, told = tool("judge_detector")(fitted.network, trains, parts.test, fitted.detector)
        result["row"] |= found
    if task.numbers:
        result["row"] |= numbers.errors(result["values"], sides.test.labels.numpy(), names, trials.test)
    compared = compare(result["right"], sides, trials, len(names), last)
    return Outcome(
        result["row"],
        result["confusion"],
        names,
        compared,
        [
            *cautions.copies(*_counts(parts, distinct)),
            *_cautions(fitted, trains, distinct, task, compared, command, searched),
        ],
        1e3 / trains.sampling_rate_Hz,
        acausal_note(trains.encoder),
        starts.FITTED if fitted.network.spec.own is None and not fitted.network.spec.hidden else starts.ONE,
        "" if fitted.refusal is None or not fitted.refusal.whole else _refused(result["row"], fitted.refusal.in_words),
        tables,
        told,
    )


def _refused(row: Mapping[str, Any], known: str) -> str:
    answered = f"{row['answered']:.1%} of test windows answered, {row['accuracy_answered']:.1%} of these right"
    return f"none of these: {answered}; {known}"


def _counts(parts: Split, distinct: Split) -> tuple[int, int]:
    """The numbers of copies and of trials on all sides."""
    n_trials = sum(map(len, parts))
    return n_trials - sum(map(len, distinct)), n_trials


def _cautions(
    fitted: Trained,
    trains: SpikeTrains,
    parts: Split,
    task: Task,
    compared: Comparison,
    command: cautions.Command,
    searched: Collection[str],
) -> Iterator[str]:
    told = numbers.scored if task.numbers else comparison.percent
    guess = max(compared.chance, compared.commonest)
    yield from cautions.not_learned(compared.accuracy, compared.low, guess, command, told)
    spec = fitted.network.spec
    yield from cautions.worse_than_baseline(compared, spec, command, searched, fitted.training.n_members, told)
    yield from cautions.training(fitted.training.table(), spec.training, command=command)
    yield from cautions.exit_not_used(fitted.held)
    if task.target:
        return
    known = sorted(set(trains.labels[parts.train].tolist()))
    tested = trains.labels[parts.test]
    per_class = {trains.classes[label]: int((tested == label).sum()) for label in known}
    yield from cautions.few_test_trials(per_class, task.split, command)
    if fitted.refusal is not None and not fitted.refusal.whole:
        yield fitted.refusal.in_words
