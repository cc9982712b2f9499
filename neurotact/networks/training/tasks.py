"""What a network is trained and tested on: the windows of the trials on each side of a split."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import torch
from pydantic import Field

from neurotact.data import hdf5
from neurotact.data.augmentation import NONE
from neurotact.data.copies import copies_of
from neurotact.data.recordings import LABEL, Recordings, Trials, select_conditions
from neurotact.data.spikes import SpikeTrains, empty_raster
from neurotact.data.splits import (
    Split,
    Splits,
    SplitSpec,
    hold_out,
    split_conditions,
    split_touches,
    training_touches,
    turns_of,
)
from neurotact.data.trial_choice import LeaveOut, TrialChoice, Where, chosen_trials, values_in_words
from neurotact.data.window_choice import ARGUMENTS, Words, suited_window
from neurotact.data.windows import Windows, WindowSpec
from neurotact.errors import InputError
from neurotact.metrics.synops import REFUSED
from neurotact.networks.definition import recipe
from neurotact.networks.definition.learned import Balance, LearnSpec
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.networks.training import balancing, events, numbers
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.provenance import SIDES
from neurotact.progress import Tell
from neurotact.spec import OneOrMore, Spec, build

LEAST_KEPT = 10
"""Trials kept for a test at the conditions of training, at least: fewer tell little and are missed in training."""


class Task(Spec):
    """What a network is trained and tested on: which trials, which windows, which sides of the split."""

    where: Where = {}
    """Conditions of the trials that are used; the others are as if they were not in the file."""
    leave_out: LeaveOut = {}
    """Conditions of trials that are not used, or classes."""
    window: WindowSpec = WindowSpec()
    split: SplitSpec = SplitSpec()
    stratify: tuple[str, ...] = ()
    subset: dict[str, Any] = {}
    training_windows: int | None = Field(default=None, ge=1)
    """Windows per trial for training and validation, `window.hop_ms` apart; if absent, as many as for testing."""
    exit_tolerance: float = Field(default=0.01, ge=0, lt=1)
    exit_choice: Literal["least", "steady"] = "least"
    """least: the least patience within the tolerance on validation windows, as in the texture paper's studies. steady:
    the patience from which on all are within it, on validation windows, and on these and training windows together."""
    refuse: float | None = Field(default=None, gt=0, lt=1, exclude_if=lambda share: share is None)
    """Share of known touches that may be refused, so that others are (`exit.refusal`); if absent, each has a class."""
    augmentation: str = NONE
    """Which varied copies of training trials are trained on, too: their kind, or `none`."""
    balance: Balance = "none"
    """Whose training windows count the same in sum: those of each class, or of each condition within a class, too."""
    varied_validation: bool = False
    """Whether validation is on these copies of validation trials, too: where it cannot leave out a condition."""
    target: OneOrMore = Field(default=(), exclude_if=lambda target: not target)
    """The conditions whose numbers a network tells of a window; if there are none, it tells the class of the trial.
    `events`: it tells the mark in force at the end of a window."""
    false_alarms_per_h: float | None = Field(default=None, ge=0, exclude_if=lambda rate: rate is None)
    """Of a detector, how many false alarms are allowed on validation recordings; 10 when absent."""
    parts: int = Field(default=1, ge=1, exclude_if=lambda n: n == 1)
    """In how many parts each recording is cut in time, which are then the trials."""
    seen: float = Field(default=0.0, ge=0, lt=1)
    """Share of the training trials that are kept for a test at the conditions of training."""
    gone = {"exit_by": "stability"}

    @property
    def choice(self) -> TrialChoice:
        """The trials that are used."""
        return TrialChoice(self.where, self.leave_out)

    @property
    def detects(self) -> bool:
        """Whether events are learned."""
        return self.target == (events.TARGET,)

    @property
    def numbers(self) -> tuple[str, ...]:
        """The conditions whose numbers are learned."""
        return () if self.detects else tuple(self.target)

    @property
    def balanced_columns(self) -> list[str]:
        """The conditions whose values count the same within a class."""
        return balancing.columns_of(self.balance, self.split, self.stratify)

    @property
    def training_window(self) -> WindowSpec:
        """The windows of trials for training and validation."""
        more = {} if self.training_windows is None else {"per_trial": self.training_windows}
        return self.window.model_copy(update=more)


def task_of(
    source: str,
    window: WindowSpec,
    split: Splits,
    exit_tolerance: float = 0.01,
    where: Any = None,
    leave_out: Any = None,
    learn: LearnSpec = LearnSpec(),
) -> Task:
    """The task that the arguments of a command or a call describe; InputError names `source` and the wrong value.

    where, leave_out: as of `TrialChoice.of`.
    """
    choice = TrialChoice.of(where, leave_out)._asdict()
    table = {"window": window, "split": split.one, "stratify": split.stratify, "exit_tolerance": exit_tolerance}
    return build(Task, {**table, **choice, **learn.model_dump(), "exit_choice": "steady"}, source=source)


def of_file(
    source: str, spikes: str | Path, window: WindowSpec, split: Splits, exit_tolerance: float = 0.01,
    where: Any = None, leave_out: Any = None, learn: LearnSpec = LearnSpec(), network: RSNNSpec = RSNNSpec(),
) -> tuple[SpikeTrains, Task]:  # fmt: skip
    """The spike trains of a file and the task of `task_of` on them, with windows that suit them, or the network."""
    path = path_of(spikes)
    task = task_of(source, window, split, exit_tolerance, where, leave_out, learn)
    trains = load_spikes(path, task, tell=True)
    if task.detects:
        suited = events.tool("detector_windows")(task.window, network)
        task = task.model_copy(update={"window": suited, "parts": events.tool("parts_for")(trains, suited)})
        return events.in_parts(trains, task.parts), task
    return trains, with_suited_window(task, trains, ARGUMENTS)


def check_refuse(trains: SpikeTrains, task: Task) -> None:
    """InputError if the task refuses touches where they cannot be told from known ones."""
    if task.refuse is not None and task.target:
        raise InputError("refuse: is for classes, and a target is of numbers; give one of them")
    if task.refuse is not None and REFUSED in names_of(trains, task):
        raise InputError(f"refuse: '{REFUSED}' is a class already; leave it out, or give it another name")


def path_of(spikes: object) -> Path:
    """The path of a file of spikes; InputError for spikes in memory, which no run folder could find again."""
    if not isinstance(spikes, (str, Path)):
        raise InputError(
            f"spikes: must be the path of a file; got {type(spikes).__name__}; nt.save(spikes, 'spikes.h5') writes one"
        )
    return Path(spikes)


def with_suited_window(task: Task, trains: SpikeTrains, words: Words) -> Task:
    """The task with windows that suit the spike trains, where they are not given."""
    return task.model_copy(update={"window": suited_window(trains, task.window, words)})


def load_spikes(path: str | Path, task: Task, *, tell: bool = False) -> SpikeTrains:
    """The spike trains of the trials that a task uses; with `tell` a line says how many they are."""
    return events.in_parts(chosen_trials(hdf5.load_spikes(path), task.choice, str(path), tell=tell), task.parts)


def kind_of_copies(trains: SpikeTrains, given: str | None, tell: Tell) -> str:
    """Which varied copies of a file are trained on."""
    held = [] if trains.variations is None else sorted({*trains.variations.kind.tolist()})
    if given is None and len(held) > 1:
        raise InputError(
            f"`augmentation`: the file holds several kinds of varied copies; name one of {', '.join(held)}"
        )
    if given not in (None, NONE, *held):
        have = (
            f"it has {', '.join(held)}" if held else f"encode them with `nt.encode_file(..., augmentation={given!r})`"
        )
        raise InputError(f"`augmentation`: the file holds no varied copies '{given}'; {have}")
    kind = given or (held[0] if held else NONE)
    if kind != NONE and given is None:
        tell(f"training: also on the varied copies in the file ({kind})")
    return kind


class Sides(NamedTuple):
    """Windows for training, validation and test."""

    train: Examples
    validation: Examples
    test: Examples


def sides_of(trains: SpikeTrains, task: Task, split: Split | None = None) -> Sides:
    """The windows of each side of the split, within the trials that the task's subset selects.

    split: replaces the split that the task draws.
    """
    sides = trials_of(trains, task, split)
    train, of = _with_copies(trains, task, sides.train)
    train = train._replace(weights=_weights(_learned(trains, task, of, train.labels), task))
    if task.varied_validation:
        validation, held = _with_copies(trains, task, sides.validation)
    else:
        validation, windows = examples_of(trains, sides.validation, task, task.training_window)
        held = windows.trial
    validation = validation._replace(of=torch.from_numpy(copies_of(trains).first[held]))
    found = Sides(train, validation, examples_of(trains, sides.test, task)[0])
    scale = numbers.Scale.of(train)
    return found if scale is None else Sides(*(side._replace(deviation=scale.deviation.float()) for side in found))


def with_every_condition(trains: SpikeTrains, task: Task) -> Task | None:
    """The task after validation has chosen: nothing is left out for it, so that training has every other condition.

    Validation trials are then drawn from the conditions of training; test trials are the same. None where validation
    leaves no condition out. A network that is trained without the condition of validation knows less than it could: of
    made-up textures at an untrained speed such networks had 70 to 82 %, and 95 to 96 % when trained again with it.
    """
    if not turns_of(trains.conditions, task.split):
        return None
    again = task.model_copy(update={"split": task.split.model_copy(update={"nested": False})})
    try:
        trials_of(trains, again)
    except InputError as error:
        tested = values_in_words(task.split.test_where)  # Python may show warnings of the same words once
        warnings.warn(
            f"where {tested} is tested, training is not repeated with the condition that validation leaves out "
            f"({error})",
            stacklevel=2,
        )
        return None
    return again


def seen_trials(trains: SpikeTrains, task: Task) -> np.ndarray:
    """The training trials that are kept for a test at the conditions of training; none if the task keeps none."""
    every = trials_of(trains, task.model_copy(update={"seen": 0.0})).train
    return np.setdiff1d(every, trials_of(trains, task).train)


def seen_side(trains: SpikeTrains, task: Task) -> Examples | None:
    """The windows that test the conditions of training; None if the task keeps none."""
    kept = seen_trials(trains, task)
    return examples_of(trains, kept, task)[0] if len(kept) else None


def _learned(trains: SpikeTrains, task: Task, of: np.ndarray, labels: torch.Tensor) -> pd.DataFrame:
    """The conditions of windows, with the label that is learned. of: the trial of each."""
    table = trains.conditions.iloc[of]
    return table.assign(**{LABEL: labels.numpy()}) if task.detects else table


def _weights(conditions: pd.DataFrame, task: Task) -> torch.Tensor | None:
    """The weights of training windows, `(window,)` float32; None if they are all 1. conditions: of each window."""
    found = balancing.weights(conditions, task.balance, task.balanced_columns)
    return None if found is None else torch.from_numpy(found.astype(np.float32))


def balance_note(trains: SpikeTrains, task: Task) -> list[str]:
    """What the balance of a task changes, in one line; none without one."""
    if task.balance == "none":
        return []
    cuts = [*_cuts(trains, task, trials_of(trains, task).train)]
    labels = torch.cat([labels_of(trains, replace(cut.windows, trial=cut.trial), task) for cut in cuts])
    conditions = _learned(trains, task, np.concatenate([cut.trial for cut in cuts]), labels)
    return [balancing.note(conditions, task.balance, task.balanced_columns)]


class _Cut(NamedTuple):
    """Windows of spike trains, and the recorded trial that each is of, or of whose copy: `(window,)`."""

    trains: SpikeTrains
    windows: Windows
    trial: np.ndarray


def _cuts(trains: SpikeTrains, task: Task, trials: np.ndarray) -> Iterator[_Cut]:
    """The windows of some trials for training or validation, then those of their varied copies."""
    own = trains.cut(task.training_window, trials)
    yield _Cut(trains, own, own.trial)
    if task.augmentation == NONE:
        return
    if trains.variations is None:
        raise InputError(f"spikes: hold no varied copies, and training asks for '{task.augmentation}'; encode them")
    varied, before = trains.variations.only(trains.variations.rows(trials, task.augmentation)), 0
    for block in varied.source.blocks(varied.places):
        windows = block.cut(task.training_window)
        yield _Cut(block.within(windows), windows, varied.of[before + windows.trial])
        before += len(block)


def _with_copies(trains: SpikeTrains, task: Task, trials: np.ndarray) -> tuple[Examples, np.ndarray]:
    """The windows of some trials for training or validation, and of their varied copies; the trial of each window."""
    cuts = [*_cuts(trains, task, trials)]
    of, before = np.concatenate([cut.trial for cut in cuts]), 0
    labels = torch.cat([labels_of(trains, replace(cut.windows, trial=cut.trial), task) for cut in cuts])
    spikes = empty_raster(len(of), cuts[0].windows.n_steps, len(trains.afferents))
    for cut in cuts:
        cut.trains.raster(cut.windows, into=spikes[before : before + len(cut.trial)])
        before += len(cut.trial)
    return Examples(torch.from_numpy(spikes), labels), of


def trials_of(trains: SpikeTrains, task: Task, split: Split | None = None) -> Split:
    """The trials of each side of the split, within those that the task's subset selects; `split` as for `sides_of`.

    Raises InputError if the training trials have fewer than two classes, and as `numbers.check` does. Without a
    condition that tells them apart, the sides have equal shares of each class, or of similar numbers.
    """
    inside = np.flatnonzero(select_conditions(trains.conditions, task.subset))
    split = split or split_of(trains, task)
    sides = Split(*(np.intersect1d(side, inside) for side in split))
    if task.seen:
        kept = _kept(trains, sides.train, task)
        sides = sides._replace(train=np.setdiff1d(sides.train, kept))
    empty = [name for name, side in zip(SIDES, sides, strict=True) if not len(side)]
    if empty:
        raise InputError(f"split: no {empty[0]} trial is left within the subset {task.subset}; split otherwise")
    if task.numbers:
        numbers.check(trains.conditions, task.numbers, sides.train)
        return sides
    names, labels = names_of(trains, task), trains.labels[sides.train]  # gathered from all trials at every call
    if task.detects:
        labels = events.labels_of(trains, trains.cut(task.training_window, sides.train))
    known = [names[label] for label in np.unique(labels)]
    if len(known) < 2:
        raise InputError(
            f"spikes: the training trials hold too few classes ({', '.join(known) or 'none'}); give at least two"
        )
    return sides


def split_of(touches: Trials | SpikeTrains, task: Task) -> Split:
    """The split that a task draws of recordings, or of their spikes."""
    if not task.target:
        return split_touches(touches, task.stratify, task.split)
    chosen, groups = task.split, 0
    table, is_random = touches.conditions, not (chosen.test_where or chosen.group or chosen.order)
    if task.numbers:
        numbers.check(table, task.numbers, np.arange(len(table)))
        groups = numbers.groups_of(table, task.numbers) if is_random else 0
    return split_conditions(table.assign(**{LABEL: groups}), task.stratify, chosen, copies_of(touches).first)


def network_for(network: RSNNSpec, task: Task) -> RSNNSpec:
    """The network for what a task learns: for events one that forgets, for numbers one with a loss of numbers."""
    spec = events.tool("detector_network")(network, task.window) if task.detects else network
    return numbers.spec_for(spec, task.numbers)


def to_calibrate(recordings: Recordings, task: Task, known: Where) -> Recordings:
    """The distinct training recordings with known conditions, as gains are fitted to them: a target as classes."""
    if task.target:
        train = copies_of(recordings).distinct(split_of(recordings, task).train)
    else:
        train = training_touches(recordings, task.stratify, task.split)
    train = np.intersect1d(train, np.flatnonzero(select_conditions(recordings.conditions, known)))
    training = recordings.select(train)
    return events.tool("classes_of_target")(training, task) if task.target else training


def _kept(trains: SpikeTrains, train: np.ndarray, task: Task) -> np.ndarray:
    """The training trials that are kept for a test at the conditions of training; none if too few would be."""
    if task.seen * len(train) < LEAST_KEPT:
        return train[:0]
    try:
        return held_out(trains, train, task.seen, task.split.seed)
    except InputError:
        return train[:0]


def held_out(trains: SpikeTrains, chosen: np.ndarray, share: float, seed: int) -> np.ndarray:
    """About this share of the chosen trials, by class, with their copies; InputError if a class has too few."""
    return chosen[hold_out(trains.labels[chosen], share, seed, _among(copies_of(trains).first, chosen))]


def _among(first: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of each chosen trial the place of its first copy among them.

    >>> _among(np.array([0, 1, 1, 3]), np.array([1, 2, 3])).tolist()
    [0, 0, 2]
    """
    _, begin, which = np.unique(first[chosen], return_index=True, return_inverse=True)
    return begin[which]


def examples_of(
    trains: SpikeTrains, trials: np.ndarray, task: Task, window: WindowSpec | None = None
) -> tuple[Examples, Windows]:
    """The windows of some trials, cut as for a test or by `window`; they refer to trials of `trains`."""
    windows = trains.cut(window or task.window, trials)
    return Examples(torch.from_numpy(trains.raster(windows)), labels_of(trains, windows, task)), windows


def labels_of(trains: SpikeTrains, windows: Windows, task: Task) -> torch.Tensor:
    """What a network learns of windows.

    The index of the class of each one's trial, `(window,)` int64; of a task with a target the numbers of the trial,
    `(window, target)` float32; of a detector the index of the label in force at the end.
    """
    if task.detects:
        return events.labels_of(trains, windows)
    if task.target:
        return torch.from_numpy(numbers.of_trials(trains.conditions, task.numbers)[windows.trial])
    return torch.from_numpy(trains.labels[windows.trial])


def names_of(trains: SpikeTrains, task: Task | None = None) -> tuple[str, ...]:
    """The names of the readout neurons: the targets, or the classes of all trials, into which labels are indices."""
    if task is None or not task.target:
        return trains.classes
    return task.numbers or events.names_of(trains)


def seen(trains: SpikeTrains, task: Task) -> recipe.Seen:
    """The properties of the training windows that a recipe uses."""
    training, _ = _with_copies(trains, task, trials_of(trains, task).train)
    return recipe.Seen.of(training.spikes, trains.sampling_rate_Hz)


def warn_of_onsets(trains: SpikeTrains, window: WindowSpec) -> None:
    """Warn if windows should start at the onset of contact and some do not."""
    complaint = trains.onset_complaint(window)
    if complaint:
        warnings.warn(complaint, stacklevel=3)
