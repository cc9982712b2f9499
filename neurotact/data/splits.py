"""Splits of trials into training, validation and test: at random, by group, by condition, in order, by folds.

No trial is on two sides and, if groups are named, no group is. Windows follow their trial. Copies of a trial
(`data.copies`) are on its side: the first of them is divided with the other trials, and counts once.
Validation is as the test is: where test trials have another condition, validation leaves one out of the training side.
Validation trials of trained conditions say nothing of an untrained one: on presses at another speed than in training,
ten classifiers were equal on such trials and from 33 to 65 % right on test trials.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count, product
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from neurotact import effects
from neurotact.data.copies import copies_of, joined, name_of
from neurotact.data.recordings import LABEL, Trials, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.data.trial_choice import Where, trials_with, values_in_words
from neurotact.errors import InputError, nearest, number_of, some
from neurotact.lazily import lazily
from neurotact.spec import OneOrMore, Spec

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

MANY_TESTS = 12
"""Tests of combinations beyond which a line says how to have fewer."""
MOST_SEED = 2**32 - 2
"""Largest seed of a split, which also uses the next one; scikit-learn takes 32 bits."""
CONDITION: dict[str, Any] = {"metavar": "CONDITION"}
"""Of a field: the value names a condition of the trials."""
AS_RECORDED = "trial"
"""The value of `order` that means the order in the file, if no condition has this name."""
MOST_HELD = 0.6
"""Share of the trials outside the test side that validation may leave out at most."""
MOST_TURNS = 7
"""Turns of validation at most: with more values of a condition, a turn leaves out several."""
LEAST_APART = 0.2
"""Share of these trials that are left for training at least where trials that share a value are left aside, too: one
pair of 3 x 3, of which one is tested and one validates."""
SHOWN = 3
"""Turns that a sentence names."""


class SplitSpec(Spec):
    """The division of trials (70/15/15 at random in the texture paper)."""

    validation: float = Field(default=0.15, gt=0, lt=1)
    """Share of all trials; with `test_where` or `folds`, which select the test trials, share of the other trials."""
    test: float = Field(default=0.15, gt=0, lt=1)
    """Share of all trials; unused with `test_where` and `folds`."""
    seed: int = Field(default=0, ge=0, le=MOST_SEED)
    """Random seed of the split into training, validation and test."""
    group: OneOrMore = Field(default=(), json_schema_extra=CONDITION)
    """Trials with the same value of this condition, such as subject, are never split. Of several, with the same
    values of all."""
    test_where: Where = {}
    """Test on these trials and train on the others, as in speed=450 or speed=300,450. In a file and in Python
    `{ speed = 450, force_N = [3, 6] }`: a trial is tested if each condition has the value, or one of the values."""
    leave_aside: bool = False
    """With several conditions in `test_where`, use no trial that has some of them and not all: no training or
    validation trial shares a value with the test trials."""
    nested: bool = True
    """With `test_where`, validate on one of the other values of its conditions, which no training trial has; the random
    seed chooses which. Otherwise, and where there are too few of them, on random trials."""
    order: str | None = Field(default=None, json_schema_extra=CONDITION)
    """Test on the last trials of each class, in the order of this condition; trial: the order of the file. Validation
    is on those before them."""
    folds: int | None = Field(default=None, ge=2)
    """Divide the trials into this many folds and test on one; where networks are trained for several splits, on each in
    turn, or on `fold` alone."""
    fold: int = Field(default=0, ge=0)
    """The fold that is tested, from 0."""

    @model_validator(mode="after")
    def _leaves_training_trials(self) -> SplitSpec:
        if self.validation + self.test >= 1:
            raise ValueError("validation + test must be below 1, so that trials are left for training")
        return self

    @model_validator(mode="after")
    def _is_one_way_to_choose_test_trials(self) -> SplitSpec:
        ways = [name for name in ("test_where", "order", "folds") if getattr(self, name)]
        if len(ways) > 1:
            raise ValueError(f"{ways[0]} and {ways[1]} both select the test trials; give one of them")
        if self.order is not None and self.group:
            raise ValueError("order divides the trials of each class and may split a group; give order or group")
        if self.fold >= (self.folds or 1):
            hint = f"be 0 to {self.folds - 1}" if self.folds else "be given together with folds, the number of folds"
            raise ValueError(f"fold must {hint}; got {self.fold}")
        return self

    @property
    def validates_elsewhere(self) -> bool:
        """Whether validation is on another value of the tested conditions than training, where there are enough."""
        return bool(self.test_where) and self.nested and not self.group


class Splits(SplitSpec):
    """How trials are divided once, or several times in turn; `nt.Split`.

    >>> Splits(folds=5, group="subject").is_in_turn, Splits(folds=5, fold=0).is_in_turn
    (True, False)
    """

    public = "Split"
    stratify: OneOrMore = Field(default=(), json_schema_extra=CONDITION)
    """A condition to balance in the split, besides the class."""
    leave_out_each: OneOrMore = Field(default=(), json_schema_extra=CONDITION)
    """Test on each value of this condition in turn, as in speed; no training trial has that value. Of several, such as
    speed and force, each pair of values is tested, of which no training trial has one. `test_where` chooses among
    these values."""
    repeats: int = Field(default=1, ge=1, le=1000)
    """Number of random splits, one network each; their seeds count upwards from `split.seed`."""

    @model_validator(mode="after")
    def _has_one_turn(self) -> Splits:
        for other in ("order", "folds"):
            if self.leave_out_each and getattr(self, other):
                raise ValueError(f"`leave_out_each` and `{other}` both select the test trials; give one of them")
        if self.repeats > 1 and self.order:
            raise ValueError("`repeats`: the test trials of `order` are the same for every seed; drop it")
        return self

    @property
    def every_fold(self) -> bool:
        """Whether each fold is tested in turn: where none is named."""
        return self.folds is not None and "fold" not in self.model_fields_set

    @property
    def is_in_turn(self) -> bool:
        """Whether several divisions are made in turn, where a network can be trained for each."""
        return self.every_fold or bool(self.leave_out_each) or self.repeats > 1

    @property
    def one(self) -> SplitSpec:
        """The division without its turns: of folds the first, where none is named."""
        return SplitSpec.model_validate({key: getattr(self, key) for key in SplitSpec.model_fields})

    def check_given(self) -> None:
        given = {f"split.{key}" if key == "seed" else key for key in self.given()}
        beside = {key: getattr(self, key) for key in ("order", "folds", "test_where", "leave_out_each")}
        if self.leave_out_each:
            given -= {"nested"}
        effects.check_given(sorted(given), **beside)

    def check_single(self, function: str) -> None:
        """Refuse turns where a function, such as "tune", divides trials once."""
        for key in ("leave_out_each", "repeats"):
            if key in self.given():
                raise InputError(f"`{key}`: has no effect in {function}, which divides trials once; leave it out")


def values_to_leave_out(conditions: pd.DataFrame, column: str) -> list[Any]:
    """The values of a condition, of which each is tested in turn and never trained on, in ascending order.

    Raises InputError for an unknown condition, for one that a trial lacks, and for one with a single value.

    >>> values_to_leave_out(pd.DataFrame({"label": ["felt", "silk"], "speed": [300, 150]}), "speed")
    [150, 300]
    """
    if column == LABEL:
        raise InputError(f"`leave_out_each`: '{LABEL}' is the class, and every class is trained on; name a condition")
    if column not in conditions:
        known = [str(name) for name in conditions.columns if name != LABEL]
        raise InputError(f"`leave_out_each`: no condition is called '{column}'; {nearest(column, known)}")
    if conditions[column].isna().any():
        raise InputError(f"`leave_out_each`: trial {int(conditions[column].isna().argmax())} has no '{column}'; add it")
    values = sorted(set(conditions[column].tolist()), key=lambda value: (isinstance(value, str), value))
    if len(values) < 2:
        raise InputError(f"`leave_out_each`: all trials have {column} = {values[0]}; record another value")
    return values


def each_left_out(
    conditions: pd.DataFrame, columns: Sequence[str], test_where: Mapping[str, Any] | None = None
) -> list[dict[str, Any]]:
    """The tests of each value of a condition in turn, or of each combination of values of several that trials have.

    In ascending order. test_where: values of some of these conditions; the others are not tested.
    Raises InputError for an unknown condition, and for one with a single value or one that no trial has.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 2, "speed": [300, 150] * 2, "force": [1, 1, 2, 2]})
    >>> each_left_out(table, ["speed"])
    [{'speed': 150}, {'speed': 300}]
    >>> each_left_out(table, ["speed", "force"], {"speed": 150})
    [{'speed': 150, 'force': 1}, {'speed': 150, 'force': 2}]
    """
    values = [values_to_leave_out(conditions, column) for column in columns]
    for column in (column for place, column in enumerate(columns) if column in columns[:place]):
        raise InputError(f"`leave_out_each`: names '{column}' twice; name each condition once")
    for column in test_where or {}:
        if column not in columns:
            raise InputError(
                f"`test_where`: beside `leave_out_each` it chooses among the values of {' and '.join(columns)}; drop "
                f"'{column}', or name it in `leave_out_each`, too"
            )
    chosen = conditions.iloc[_where(conditions, test_where or {})]
    known = set(zip(*(chosen[column].tolist() for column in columns), strict=True))
    return [dict(zip(columns, test, strict=True)) for test in product(*values) if test in known]


def check_each(
    conditions: pd.DataFrame, tests: Sequence[Mapping[str, Any]], spec: SplitSpec, first: np.ndarray | None = None
) -> list[str]:
    """How many combinations are tested, and how many trials are left aside, in one line; none for a single condition.

    tests: of `each_left_out`. spec, first: as of `split_conditions`. Raises InputError, which names the combination,
    where a split is impossible, as where too few trials are left.

    >>> rows = [(label, speed, force) for label in ("felt", "silk") for speed in (1, 2) for force in (3, 4)] * 3
    >>> table = pd.DataFrame(rows, columns=["label", "speed", "force"])
    >>> print(*check_each(table, each_left_out(table, ["speed", "force"]), SplitSpec()))
    4 pairs of speed and force are tested in turn; trials that share a tested value are left aside: 12 of 24
    """
    columns, counts, is_apart = [*tests[0]], [], False
    for test in tests if len(columns) > 1 else ():
        own = spec.model_copy(update={"test_where": dict(test), "leave_aside": True})
        try:
            sides = split_conditions(conditions, (), own, first)
        except InputError as error:
            raise InputError(
                f"`leave_out_each`: cannot test {values_in_words(test)}, with the trials that share one of these "
                f"values left aside ({error}); test others (`test_where`), or leave out each of a single condition"
            ) from error
        counts.append(len(conditions) - sum(map(len, sides)))
        is_apart |= counts[-1] > aside_of(conditions, own).sum()
    if not counts:
        return []
    noun = combination(columns)
    tested = f"1 {noun} of {{}} is tested" if len(tests) == 1 else f"{len(tests)} {noun}s of {{}} are tested in turn"
    n_aside = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else f"{counts[0]}"
    shared = "tested or validated value" if is_apart else "tested value"
    line = (
        f"{tested.format(' and '.join(columns))}; trials that share a {shared} are left aside: {n_aside} of "
        f"{len(conditions)}"
    )
    if len(tests) <= MANY_TESTS:
        return [line]
    return [f"{line}. `test_where={{{columns[0]!r}: {tests[0][columns[0]]!r}}}` tests fewer"]


class Turn(NamedTuple):
    """The units that validation leaves out in one turn, and those that are on no side since they share a value."""

    held: tuple[str, ...]
    aside: tuple[str, ...] = ()


class Split(NamedTuple):
    """Sorted indices of trials, of which none is in two; together they are all trials but those left aside."""

    train: np.ndarray
    validation: np.ndarray
    test: np.ndarray


def split_trials(labels: np.ndarray, spec: SplitSpec, first: np.ndarray | None = None) -> Split:
    """Divide trials at random within each class. Windows follow their trial, so none leaks across.

    labels: one value per trial, `(trial,)`; pass class and condition joined to balance conditions too.
    first: of `data.copies.Copies`; without it, no trial is a copy.
    Raises InputError when a class has too few trials for all three sides.

    >>> split = split_trials(np.repeat([0, 1], 20), SplitSpec())
    >>> [len(part) for part in split]
    [28, 6, 6]
    """
    labels = np.asarray(labels)
    if first is not None:
        return _with_copies(first, labels, lambda distinct: split_trials(labels[distinct], spec))
    split = _drawn(labels, spec)
    if split is not None:
        return split
    values, counts = np.unique(labels, return_counts=True)
    few = counts.argmin()
    enough = (np.append(labels, np.repeat(values, (n - counts).clip(0))) for n in count(counts[few] + 1))
    least = counts[few] + next(more for more, its in enumerate(enough, 1) if _drawn(its, spec) is not None)
    raise InputError(
        f"split: class '{values[few]}' has {number_of(counts[few], 'trial')}, too few to train, validate and test on; "
        f"give at least {least} trials per class for these shares"
    )


def _drawn(labels: np.ndarray, spec: SplitSpec) -> Split | None:
    """Trials drawn at random within each class; None if a class would not be on every side."""
    from sklearn.model_selection import train_test_split

    n_classes, n_trials = len(np.unique(labels)), len(labels)
    n_test, n_validation = (max(n_classes, round(n_trials * share)) for share in (spec.test, spec.validation))
    try:
        rest, test = train_test_split(np.arange(n_trials), test_size=n_test, stratify=labels, random_state=spec.seed)
        train, validation = train_test_split(
            rest, test_size=n_validation, stratify=labels[rest], random_state=spec.seed + 1
        )
    except ValueError:  # a class has a single trial for two sides, or there are fewer trials than classes
        return None
    split = Split(*map(np.sort, (train, validation, test)))
    return split if all(len(np.unique(labels[side])) == n_classes for side in split) else None


def split_touches(touches: Trials | SpikeTrains, stratify: Iterable[str], spec: SplitSpec) -> Split:
    """Split recordings or spike trains as `split_conditions`, with copies of a trial on its side.

    >>> from neurotact.data.recordings import Recordings
    >>> walks = np.random.default_rng(0).standard_normal((12, 50, 2)).cumsum(axis=1)
    >>> twice = Recordings(np.concatenate([walks, walks]), 1000.0, "mV", ["felt", "silk"] * 12)
    >>> [(side % 12).tolist() for side in split_touches(twice, (), SplitSpec())][1:]
    [[5, 10, 5, 10], [8, 11, 8, 11]]
    """
    return split_conditions(touches.conditions, stratify, spec, copies_of(touches).first)


def training_touches(recordings: Trials, stratify: Iterable[str], spec: SplitSpec) -> np.ndarray:
    """The training trials of a split without copies of one another, for fitting an encoder; warns of those left out."""
    repeats = copies_of(recordings)
    training = split_conditions(recordings.conditions, stratify, spec, repeats.first).train
    distinct = repeats.distinct(training)
    if n_copies := len(training) - len(distinct):
        where = recordings.source or "recordings"
        log.warning("%s: copies of training trials are left out of the fit: %d", where, n_copies)
    return distinct


def split_conditions(
    conditions: pd.DataFrame, stratify: Iterable[str], spec: SplitSpec, first: np.ndarray | None = None
) -> Split:
    """Split trials as `spec` says, balanced over the class and the `stratify` columns.

    first: of `data.copies.Copies`; without it, no trial is a copy. A copy has the stratum and the place in the order of
    the first; its group and that of the first are one. Copies on two sides of `test_where`, and copies with different
    values of the condition `order`, are refused.
    Training trials hold every class. Raises InputError, which names the class or the group, if that is impossible.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 8, "speed": [300, 300, 450, 450] * 4})
    >>> split = split_conditions(table, (), SplitSpec(test_where={"speed": 450}))
    >>> split.test.tolist()
    [2, 3, 6, 7, 10, 11, 14, 15]
    >>> len(split.train), len(split.validation)
    (6, 2)
    """
    labels, strata = conditions[LABEL].astype(str).to_numpy(dtype=str), _strata(conditions, stratify)
    first = np.arange(len(conditions)) if first is None else first
    _check_copies(conditions, first, spec)
    if spec.order is not None:
        ranks = _ranks(conditions, spec.order)
        return _with_copies(first, labels, lambda distinct: _in_order(strata[distinct], ranks[distinct], spec))
    groups = groups_of(conditions, spec.group)
    if groups is None and not spec.test_where and spec.folds is None:
        return _with_copies(first, labels, lambda distinct: split_trials(strata[distinct], spec))
    groups = None if groups is None else groups[joined(groups, first)]
    tested = _where(conditions, spec.test_where) if spec.test_where else None
    turns, aside, held = turns_of(conditions, spec), aside_of(conditions, spec), None
    if turns:
        units, turn = _units_of(conditions, spec.test_where), turns[spec.seed % len(turns)]
        held, aside = np.isin(units, turn.held), aside | np.isin(units, turn.aside)

    def divided(distinct: np.ndarray) -> Split:
        own = None if groups is None else groups[distinct]
        test = None if tested is None else np.flatnonzero(np.isin(distinct, tested))
        trials = _Trials(labels[distinct], strata[distinct], own, spec)
        return _divided(trials, test, None if held is None else held[distinct], aside[distinct])

    return _with_copies(first, labels, divided)


def _with_copies(first: np.ndarray, labels: np.ndarray, divided: Callable[[np.ndarray], Split]) -> Split:
    """The split of all trials of which no two copies are on different sides.

    divided: called with the trials that are no copies, ascending; returns the split of these.
    """
    distinct = np.unique(first)
    n_copies = len(first) - len(distinct)
    if not n_copies:
        return divided(distinct)
    try:
        split = divided(distinct)
    except InputError as error:
        copies = "1 is a copy and does" if n_copies == 1 else f"{n_copies} are copies and do"
        raise InputError(f"{error} (of the {len(first)} trials {copies} not count)") from error
    sides = Split(*(np.flatnonzero(np.isin(first, distinct[side])) for side in split))
    absent = np.setdiff1d(labels, labels[sides.train])
    if len(absent):
        raise InputError(
            f"split: no training trial of class '{absent[0]}' is left, since its trials are copies of trials of other "
            "classes; give each touch one class"
        )
    return sides


def _divided(trials: _Trials, test: np.ndarray | None, held: np.ndarray | None, aside: np.ndarray) -> Split:
    """The split of trials by group, by condition or by folds.

    test: the trials that a condition chooses. held: which trials validation leaves out, `(trial,)`, if none is drawn.
    aside: which are on no side, `(trial,)`.
    """
    spec, every = trials.spec, np.arange(len(trials.labels))
    if test is not None:
        trials.check_whole_groups(test)
    elif spec.folds is not None:
        test = trials.fold(spec.folds, spec.fold)
    else:
        test = trials.share(every, spec.test, spec.seed)
    rest = np.setdiff1d(every[~aside], test)
    if held is not None and held[rest].any():
        trials.check_trained(rest[~held[rest]])
        return Split(rest[~held[rest]], rest[held[rest]], test)
    is_share_of_rest = bool(spec.test_where) or spec.folds is not None
    share = spec.validation if is_share_of_rest else spec.validation / (1 - spec.test)
    validation = trials.share(rest, share, spec.seed + 1)
    return Split(np.setdiff1d(rest, validation), validation, test)


def turns_of(conditions: pd.DataFrame, spec: SplitSpec) -> list[Turn]:
    """The values of the tested conditions that validation leaves out in turn, one for each seed; empty if none.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 6, "speed": [150, 150, 300, 300, 450, 450] * 2})
    >>> turns_of(table, SplitSpec(test_where={"speed": 450}))
    [Turn(held=('speed = 150',), aside=()), Turn(held=('speed = 300',), aside=())]
    """
    if not spec.validates_elsewhere:
        return []
    rest = np.setdiff1d(np.flatnonzero(~aside_of(conditions, spec)), _where(conditions, spec.test_where))
    labels = conditions[LABEL].astype(str).to_numpy(dtype=str)
    if spec.leave_aside:
        return _turns_apart(conditions, [*spec.test_where], labels, rest)
    return _turns(_units_of(conditions, spec.test_where), labels, rest)


def aside_of(conditions: pd.DataFrame, spec: SplitSpec) -> np.ndarray:
    """Which trials have some of the tested conditions and not all, and are on no side, `(trial,)` boolean.

    >>> table = pd.DataFrame({"speed": [1, 1, 2, 2], "force": [3, 4, 3, 4]})
    >>> aside_of(table, SplitSpec(test_where={"speed": 1, "force": 3}, leave_aside=True)).tolist()
    [False, True, True, False]
    """
    if not (spec.leave_aside and spec.test_where):
        return np.zeros(len(conditions), bool)
    has = [
        select_conditions(conditions, {column: value}, "split.test_where") for column, value in spec.test_where.items()
    ]
    return np.any(has, axis=0) & ~np.all(has, axis=0)


def validation_note(
    conditions: pd.DataFrame, spec: SplitSpec, *, varied: bool = False, at_most: int | None = None, again: bool = True
) -> str:
    """How validation chooses for a test on other conditions, in one sentence.

    varied: whether it is on varied copies, too. at_most: the number of its turns, if not all are taken.
    again: as of `_validation_in_words`.
    """
    turns = turns_of(conditions, spec)[:at_most]
    why = "" if spec.nested else "split.nested is false"
    if spec.group:
        why = f"split.group keeps trials of one {' and '.join(spec.group)} together"
    return _validation_in_words(spec.test_where, turns, varied=varied, pairs=spec.leave_aside, why=why, again=again)


def check_stratify(conditions: pd.DataFrame, stratify: Iterable[str] | None, spec: SplitSpec) -> None:
    """InputError for an unknown condition to balance; NoEffectError where no side of the split is drawn at random."""
    for column in stratify or ():
        _known(conditions, column, "`stratify`")
    effects.check(stratify=[*(stratify or ())], drawn=not turns_of(conditions, spec))


def hold_out_groups(labels: np.ndarray, groups: np.ndarray, share: float, seed: int) -> np.ndarray:
    """About this share of the examples, in whole groups, `(held,)` indices; the other groups keep every class.

    labels, groups: `(example,)`. Several divisions of the groups are drawn; the one with most classes on both sides is
    used.
    Raises InputError for a single group, and where a class would be left without a training example.

    >>> held = hold_out_groups(np.repeat(["felt", "silk"], 20), np.arange(40) // 4, 0.2, seed=0)
    >>> len(held), len(set(held // 4)), np.unique(held // 20).tolist()
    (8, 2, [0, 1])
    """
    return _in_groups(labels, groups).share(np.arange(len(labels)), share, seed)


def folds_of_groups(labels: np.ndarray, groups: np.ndarray, n_folds: int, seed: int) -> np.ndarray | None:
    """The fold of each example, `(example,)`, in whole groups, at most `n_folds`; None for a single group.

    labels, groups: `(example,)`.

    >>> folds = folds_of_groups(np.repeat(["felt", "silk"], 20), np.arange(40) // 4, 5, seed=0)
    >>> [len({*of_group}) for of_group in folds.reshape(-1, 4)], np.unique(folds).tolist()
    ([1, 1, 1, 1, 1, 1, 1, 1, 1, 1], [0, 1, 2, 3, 4])
    """
    n_folds = min(n_folds, len(np.unique(groups)))
    if n_folds < 2:
        return None
    trials, folds = _in_groups(labels, groups), np.empty(len(labels), np.int64)
    for fold, tested in enumerate(trials._folds_of(np.arange(len(labels)), n_folds, seed)):
        folds[tested] = fold
    return folds


def _in_groups(labels: np.ndarray, groups: np.ndarray) -> _Trials:
    return _Trials(labels, labels, np.unique(groups, return_inverse=True)[1], SplitSpec(group=("groups",)))


def hold_out(labels: np.ndarray, share: float, seed: int | np.random.RandomState, first: np.ndarray) -> np.ndarray:
    """About this share of the examples, by class, for validation, `(held,)` indices.

    first: the first example that each one equals, `(example,)`; equal ones are held out together. If a class repeats
    too few patterns for that, they are not copies, and each example counts for itself.
    Raises InputError if a class has too few examples.

    >>> hold_out(np.repeat(["felt", "silk"], 6), 0.2, 0, np.arange(12) // 2 * 2).tolist()
    [0, 1, 8, 9]
    """
    from sklearn.model_selection import train_test_split

    distinct = np.unique(first)
    values, counts = np.unique(labels[distinct], return_counts=True)
    n_held = max(len(values), round(share * len(distinct)))
    if counts.min() < 2 or n_held > len(distinct) - len(values):
        if len(distinct) == len(labels):
            raise InputError(f"{len(labels)} examples of {len(values)} classes are too few to hold some out; give more")
        return hold_out(labels, share, seed, np.arange(len(labels)))
    _, held = train_test_split(distinct, test_size=n_held, stratify=labels[distinct], random_state=seed)
    return np.flatnonzero(np.isin(first, held))


class _Trials(NamedTuple):
    """Trials with their classes, their strata (class and conditions), and their groups; None: each trial is a group."""

    labels: np.ndarray
    strata: np.ndarray
    groups: np.ndarray | None
    spec: SplitSpec

    def share(self, trials: np.ndarray, share: float, seed: int) -> np.ndarray:
        """About this share of `trials`, drawn at random in whole groups; the others keep every class."""
        if self.groups is None:
            return self._random_share(trials, share, seed)
        n_groups = len(np.unique(self.groups[trials]))
        self._check_left(trials, n_groups)
        wanted = min(max(2, round(1 / share)), n_groups)
        chosen = self._best(self._folds_of(trials, wanted, seed), trials)
        self.check_trained(np.setdiff1d(trials, chosen))
        return np.sort(chosen)

    def fold(self, n_folds: int, fold: int) -> np.ndarray:
        """One of the folds of all trials, in whole groups; the others keep every class."""
        every = np.arange(len(self.labels))
        if self.groups is None:
            values, counts = np.unique(self.labels, return_counts=True)
            if counts.min() < n_folds:
                raise InputError(
                    f"split.folds: class '{values[counts.argmin()]}' has {number_of(counts.min(), 'trial')}, fewer "
                    f"than the {n_folds} folds; choose fewer folds"
                )
        else:
            self._check_groups(len(np.unique(self.groups)), n_folds)
        chosen = self._folds_of(every, n_folds, self.spec.seed)[fold]
        if not len(chosen):
            raise InputError(f"split.fold: fold {fold} of {n_folds} holds no group; choose fewer folds")
        self.check_trained(np.setdiff1d(every, chosen))
        return np.sort(chosen)

    def check_whole_groups(self, test: np.ndarray) -> None:
        """Refuse test trials that split a group."""
        if self.groups is None:
            return
        parted = np.intersect1d(self.groups[test], np.delete(self.groups, test))
        if len(parted):
            raise InputError(
                f"split.test_where: the group {parted[0]} ({', '.join(self.spec.group)}) has trials on both sides; "
                "drop the group, or test on conditions that keep it whole"
            )

    def _random_share(self, trials: np.ndarray, share: float, seed: int) -> np.ndarray:
        from sklearn.model_selection import train_test_split

        strata = self.strata[trials]
        values, counts = np.unique(strata, return_counts=True)
        self.check_trained(trials)
        n_found = max(len(values), round(share * len(trials)))
        if counts.min() < 2 or n_found + len(values) > len(trials):
            rarest = values[counts.argmin()]
            raise InputError(
                f"split: class '{rarest}' has {number_of(counts.min(), 'trial')} outside the test side, too few to "
                "train and validate on; add trials"
            )
        _, chosen = train_test_split(trials, test_size=n_found, stratify=strata, random_state=seed)
        self.check_trained(np.setdiff1d(trials, chosen))
        return np.sort(chosen)

    def _folds_of(self, trials: np.ndarray, n_folds: int, seed: int) -> list[np.ndarray]:
        from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

        kind = StratifiedKFold if self.groups is None else StratifiedGroupKFold
        folds = kind(n_folds, shuffle=True, random_state=seed)
        groups = None if self.groups is None else self.groups[trials]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a condition with fewer trials than folds is not balanced
            try:
                pairs = list(folds.split(trials, self.strata[trials], groups))
            except ValueError:  # every class and condition is rarer than the folds: balance the classes alone
                pairs = list(folds.split(trials, np.zeros(len(trials)), groups))
        return [trials[test] for _, test in pairs]

    def _best(self, folds: list[np.ndarray], trials: np.ndarray) -> np.ndarray:
        """Among the folds that leave every class to the others, the first one with most classes."""

        def merit(fold: np.ndarray) -> tuple[int, int]:
            left = np.setdiff1d(trials, fold)
            return len(np.unique(self.labels[left])), len(np.unique(self.labels[fold]))

        return max((fold for fold in folds if len(fold)), key=merit)

    def check_trained(self, training: np.ndarray) -> None:
        """Refuse training trials that lack a class."""
        absent = np.setdiff1d(self.labels, self.labels[training])
        if len(absent):
            raise InputError(
                f"split: no training trial of class '{absent[0]}' is left; split otherwise or drop the class"
            )

    def _check_left(self, trials: np.ndarray, n_groups: int) -> None:
        """Refuse a single group that is left after the test took the others: a part of it must validate."""
        assert self.groups is not None
        values, by = np.unique(self.groups).tolist(), ", ".join(self.spec.group)
        if n_groups >= 2 or len(values) == n_groups:
            return self._check_groups(n_groups, 2)
        if self.spec.test_where:
            raise InputError(
                f"split.group: without the test trials one value of {by} is left, where two are needed, to train and "
                "to validate on; leave out `group`"
            )
        fix = f"to test on one of them, give `test_where={{{by!r}: {values[-1]!r}}}` in place of `group`"
        raise InputError(
            f"split.group: {by} has {len(values)} values ({some(values)}) where at least three are needed, to train, "
            f"to validate and to test on; {'group by another condition' if len(self.spec.group) > 1 else fix}"
        )

    def _check_groups(self, n_groups: int, wanted: int) -> None:
        if n_groups < wanted:
            raise InputError(
                f"split.group: {', '.join(self.spec.group)} makes {number_of(n_groups, 'group')} where {wanted} are "
                "needed; group by another condition, or choose fewer folds"
            )


def _in_order(strata: np.ndarray, ranks: np.ndarray, spec: SplitSpec) -> Split:
    """Within each stratum the first trials are for training, the next for validation, the last for test."""
    sides: list[list[np.ndarray]] = [[], [], []]
    for value in np.unique(strata):
        trials = np.flatnonzero(strata == value)
        trials = trials[np.argsort(ranks[trials], kind="stable")]
        n_validation, n_test = (max(1, round(share * len(trials))) for share in (spec.validation, spec.test))
        n_train = len(trials) - n_validation - n_test
        if n_train < 1:
            raise InputError(
                f"split: class '{value}' has {number_of(len(trials), 'trial')}, too few to train, validate and test "
                "on; add trials"
            )
        for side, part in zip(sides, np.split(trials, (n_train, n_train + n_validation)), strict=True):
            side.append(part)
    return Split(*(np.sort(np.concatenate(side)) for side in sides))


def _check_copies(conditions: pd.DataFrame, first: np.ndarray, spec: SplitSpec) -> None:
    """Refuse copies on two sides of a condition, and copies with two places in the order of one."""
    copies = np.flatnonzero(first != np.arange(len(first)))
    if not len(copies):
        return
    if spec.test_where:
        group = np.isin(np.arange(len(first)), _where(conditions, spec.test_where)) + 2 * aside_of(conditions, spec)
        key, what = "split.test_where", f"only one of them has {values_in_words(spec.test_where)}"
    elif spec.order is not None and spec.order in conditions:
        group = conditions[spec.order].astype(str).to_numpy(dtype=str)
        key, what = "split.order", f"they have different values of '{spec.order}'"
    else:
        return
    parted = copies[group[copies] != group[first[copies]]]
    if len(parted):
        copy, copied = (name_of(conditions, trial) for trial in (int(parted[0]), int(first[parted[0]])))
        more = f" ({len(parted)} such copies)" if len(parted) > 1 else ""
        raise InputError(
            f"{key}: {copy} is a copy of {copied}, but {what}{more}; remove the one with the wrong condition, or split "
            "otherwise"
        )


def _ranks(conditions: pd.DataFrame, order: str) -> np.ndarray:
    """The rank of each trial in the order of a condition."""
    if order == AS_RECORDED and order not in conditions:
        return np.arange(len(conditions))
    column = conditions[_known(conditions, order, "split.order")]
    if column.isna().any():
        raise InputError(f"split.order: trial {int(column.isna().argmax())} has no '{order}'; order by another column")
    values = column if column.dtype.kind in "iufbM" else column.astype(str)
    return values.rank(method="first").to_numpy()


def _where(conditions: pd.DataFrame, where: Mapping[str, Any]) -> np.ndarray:
    """The trials with the given conditions; every single value must be one that a trial has."""
    source = "split.test_where"
    for column, wanted in where.items():
        trials_with(conditions, column, wanted, source)
    return np.flatnonzero(select_conditions(conditions, where, source))


def _strata(conditions: pd.DataFrame, stratify: Iterable[str]) -> np.ndarray:
    strata = conditions[LABEL].astype(str)
    for column in stratify:
        strata = strata + " " + conditions[_known(conditions, column, "dataset.stratify")].astype(str)
    return strata.to_numpy(dtype=str)


def groups_of(conditions: pd.DataFrame, group: Iterable[str]) -> np.ndarray | None:
    """The name of each trial's group; None if no group is requested."""
    columns = [conditions[_known(conditions, column, "split.group")].astype(str) for column in group]
    return None if not columns else np.array([", ".join(values) for values in zip(*columns, strict=True)])


def _known(conditions: pd.DataFrame, column: str, key: str) -> str:
    if column not in conditions:
        known = list(map(str, conditions.columns))
        raise InputError(f"{key}: there is no condition '{column}'; {nearest(column, known)}")
    return column


def _units_of(conditions: pd.DataFrame, columns: Iterable[str]) -> np.ndarray:
    """The values of each trial in the columns in words, as `speed = 300, force_N = 6`, `(trial,)`."""
    parts = [f"{column} = " + conditions[column].astype(str) for column in columns]
    return np.array([", ".join(values) for values in zip(*parts, strict=True)])


def _turns(units: np.ndarray, labels: np.ndarray, rest: np.ndarray) -> list[Turn]:
    """The units that validation can leave out in turn: the others keep every class for training.

    units, labels: of all trials, `(trial,)`. rest: the trials that are not tested. Empty if none can be left out.

    >>> units, labels = np.repeat(["speed = 1", "speed = 2", "speed = 3"], 4), np.array(["felt", "silk"] * 6)
    >>> [turn.held for turn in _turns(units, labels, np.arange(8))], _turns(units, labels, np.arange(4))
    ([('speed = 1',), ('speed = 2',)], [])
    """
    classes = np.unique(labels[rest])

    def can_be_left_out(held: tuple[str, ...]) -> bool:
        others = rest[~np.isin(units[rest], held)]
        return np.array_equal(np.unique(labels[others]), classes) and len(rest) - len(others) <= MOST_HELD * len(rest)

    return [Turn(held) for held in _in_turns(units[rest]) if can_be_left_out(held)]


def _turns_apart(conditions: pd.DataFrame, columns: Sequence[str], labels: np.ndarray, rest: np.ndarray) -> list[Turn]:
    """The combinations of values that validation can leave out in turn, with every trial that shares one of the values.

    Less does not ask what the test asks: of gratings, all kinds of varied copies were equal at another force, and 85 to
    100 % right at another force and speed. Successive turns differ in every column. labels, rest: as of `_turns`.
    Empty if less than `LEAST_APART` of the trials, or not every class, would be left for training.

    >>> table = pd.DataFrame([(speed, force) for speed in (1, 2, 3, 4) for force in (5, 6, 7)])
    >>> table = pd.concat([table] * 2, ignore_index=True).set_axis(["speed", "force"], axis=1)
    >>> first, *others = _turns_apart(table, ["speed", "force"], np.repeat(["felt", "silk"], 12), np.arange(24))
    >>> first.held, len(first.aside), others[0].held
    (('speed = 1, force = 5',), 5, ('speed = 2, force = 6',))
    """
    units, classes = _units_of(conditions, columns)[rest], np.unique(labels[rest])
    values = [_units_of(conditions, [column])[rest] for column in columns]
    axes, turns = [_in_turns(each) for each in values], []
    for places in sorted(product(*(range(len(axis)) for axis in axes)), key=lambda places: _diagonal(places, axes)):
        chosen = zip(values, axes, places, strict=True)
        shares = np.array([np.isin(each, axis[place]) for each, axis, place in chosen])
        held, left = shares.all(axis=0), ~shares.any(axis=0)
        if held.any() and left.mean() >= LEAST_APART and np.array_equal(np.unique(labels[rest[left]]), classes):
            turns.append(Turn(*(tuple(np.unique(units[some]).tolist()) for some in (held, ~held & ~left))))
    return turns


def _in_turns(units: np.ndarray) -> list[tuple[str, ...]]:
    """The units in at most `MOST_TURNS` parts."""
    known = [str(unit) for unit in np.unique(units)]
    n_turns = min(MOST_TURNS, len(known))
    return [tuple(known[first::n_turns]) for first in range(n_turns)]


def _diagonal(places: Sequence[int], axes: Sequence[Sequence[object]]) -> tuple[int, ...]:
    """The rank of a cell of a grid on its diagonals: successive cells differ in every axis.

    >>> sorted([(0, 0), (0, 1), (1, 0), (1, 1)], key=lambda places: _diagonal(places, [[1, 2], [3, 4]]))
    [(0, 0), (1, 1), (0, 1), (1, 0)]
    """
    first, *others = places
    return *((place - first) % len(axis) for place, axis in zip(others, axes[1:], strict=True)), first


def combination(columns: Sequence[str]) -> str:
    """What values of several conditions are together."""
    return "pair" if len(columns) == 2 else "combination"


def _validation_in_words(
    columns: Iterable[str],
    turns: Sequence[Turn],
    *,
    varied: bool = False,
    pairs: bool = False,
    why: str = "",
    again: bool = True,
) -> str:
    """How validation chooses for a test on other values of some conditions, in one sentence.

    turns: of `splits.turns_of`; none if validation leaves out none. varied: whether it is on varied copies, too.
    pairs: whether the test is on combinations of values, each of which is untrained. why: there are no turns; too few
    values if empty. again: whether the values that are left out are trained on after the choice.

    >>> _validation_in_words(["speed"], [Turn(("speed = 150",)), Turn(("speed = 300",))])
    'Validation leaves out one speed of the training trials in turn, as the test does (speed = 150; speed = 300); after the choice all are trained on'
    """  # noqa: E501
    columns = [*columns]
    named = " and ".join(columns)
    if not turns:
        copies = " and on varied copies of them" if varied else ""
        why = why or f"training trials have too few values of {named} to leave one out"
        return f"Validation ranks nothing for this test: {why}, so that it is on trials of trained values{copies}"
    some = "; ".join(" or ".join(turn.held) for turn in turns[:SHOWN]) + ("; ..." if len(turns) > SHOWN else "")
    is_one = all(len(turn.held) == 1 for turn in turns)
    what = f"{'one' if is_one else 'some values of'} {named} of the training trials in turn"
    if pairs:
        noun = combination(columns)
        some_of = f"{f'one {noun}' if is_one else f'some {noun}s'} of {named}"
        what = f"{some_of} in turn, and all trials that share a value with it"
    then = "; after the choice all are trained on" if again else ""
    return f"Validation leaves out {what}, as the test does ({some}){then}"
