"""The choice of trials by their conditions: those to keep (`where`) and those to leave out."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import count
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BeforeValidator

from neurotact.data.recordings import LABEL, NOUNS, Trials, select_conditions
from neurotact.data.spikes import SpikeTrains
from neurotact.errors import InputError
from neurotact.lazily import lazily

with lazily():
    import pandas as pd


log = logging.getLogger("neurotact")

LEAST_OF_CLASS = 10
"""Trials of a class that are kept of a large file, if it has as many."""
GOLDEN = (5**0.5 - 1) / 2
"""Multiples of it spread evenly over 0 to 1, however many are taken."""
LEAST_OF_SIDES = 3
"""Trials of a class that are kept at least: one to train, one to validate and one to test on."""
Touches = TypeVar("Touches", bound=Trials | SpikeTrains)


def _plain_where(where: Any) -> Any:
    """Values of conditions with arrays and NumPy's numbers as Python's own, for writing to files.

    Raises ValueError for a value that is neither a number nor text, and for none at all.
    """
    if not isinstance(where, Mapping):
        return where
    plain = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in where.items()}
    for name, value in plain.items():
        values = value if isinstance(value, (list, tuple)) else [value]
        if not values or not all(isinstance(value, (str, int, float)) for value in values):
            raise ValueError(f"{name} must be a value or a list of values; got {value!r}")
    return plain


def _plain_leave_out(leave_out: Any) -> Any:
    """As `_plain_where`; a text such as "rest,moving", or a list of texts, names classes.

    >>> _plain_leave_out("rest,moving"), _plain_leave_out([]), _plain_leave_out({"speed": 300})
    ({'label': ['rest', 'moving']}, {}, {'speed': 300})
    """
    if leave_out is None:
        return {}
    if isinstance(leave_out, str):
        leave_out = [name.strip() for name in leave_out.split(",")]
    if isinstance(leave_out, (list, tuple)):
        leave_out = {LABEL: list(leave_out)} if leave_out else {}
    return _plain_where(leave_out)


Where = Annotated[dict[str, Any], BeforeValidator(_plain_where)]
"""Conditions with the values to choose, one or several each: `{"speed": 300, "force_N": [3, 6]}`."""
LeaveOut = Annotated[dict[str, Any], BeforeValidator(_plain_leave_out)]
"""Conditions with the values to leave out, or the names of classes."""


class TrialChoice(NamedTuple):
    """The trials to keep: those with a wanted value of every condition in `where`, without those in `leave_out`.

    A trial with a value of any condition in `leave_out` is left out. So `where` and `leave_out` with the same single
    condition part the trials in two.
    """

    where: Mapping[str, Any] = {}
    leave_out: Mapping[str, Any] = {}

    @classmethod
    def of(cls, where: Any = None, leave_out: Any = None) -> TrialChoice:
        """The choice that two arguments of a call describe; None is none. InputError for values of another kind.

        >>> TrialChoice.of({"speed": np.int64(300)}, "rest")
        TrialChoice(where={'speed': 300}, leave_out={'label': ['rest']})
        """
        try:
            choice = cls(_plain_where({} if where is None else where), _plain_leave_out(leave_out))
        except ValueError as error:
            raise InputError(f"where, leave_out: {error}") from error
        for name, given in zip(cls._fields, choice, strict=True):
            if not isinstance(given, Mapping) or not all(isinstance(column, str) for column in given):
                raise InputError(
                    f"{name}: must map conditions to values, such as {{'speed': 300}}; got {type(given).__name__}"
                )
        return choice

    def __bool__(self) -> bool:
        return bool(self.where or self.leave_out)

    def __str__(self) -> str:
        parts = [values_in_words(self.where)] if self.where else []
        return " ".join([*parts, *([f"without {values_in_words(self.leave_out)}"] if self.leave_out else [])])

    def among(self, columns: Collection[str]) -> TrialChoice:
        """The part of the choice that these conditions decide."""
        return self._part(lambda name: name in columns)

    def beyond(self, columns: Collection[str]) -> TrialChoice:
        """The part of the choice that these conditions leave open; both parts together are the choice."""
        return self._part(lambda name: name not in columns)

    def with_label(self, name: str) -> TrialChoice:
        """The choice with the class in place of the column `name` of a file, which is the class."""
        return TrialChoice(*({LABEL if key == name else key: value for key, value in part.items()} for part in self))

    def _part(self, is_in: Any) -> TrialChoice:
        return TrialChoice(*({name: value for name, value in part.items() if is_in(name)} for part in self))

    def keeps(self, conditions: pd.DataFrame, source: str, words: Words | None = None) -> np.ndarray:
        """Which trials are kept, `(trial,)` boolean.

        words: of messages; those of trials when None. Raises InputError for a condition or a value that no trial has,
        and where no trial is left; `source` begins it.

        >>> table = pd.DataFrame({"label": ["felt", "rest", "silk"], "speed": [300, 300, 450]})
        >>> TrialChoice.of({"speed": 300}, "rest").keeps(table, "touches.h5").tolist()
        [True, False, False]
        """
        words = words or TRIALS
        keep = np.ones(len(conditions), bool)
        for column, values in self.where.items():
            keep &= trials_with(conditions, column, values, f"{source}: {words.where}", words.nouns)
        for column, values in self.leave_out.items():
            keep &= ~trials_with(conditions, column, values, f"{source}: {words.leave_out}", words.nouns)
        if not keep.any():
            raise InputError(
                f"{source}: no {words.nouns[0]} is left of {len(conditions)} ({self}); choose at least one"
            )
        return keep

    def say(self, keep: np.ndarray, source: str, words: Words | None = None) -> None:
        """Say how many trials are kept."""
        noun = (words or TRIALS).nouns[0]
        log.warning("%s: %d of %d %ss are kept: %s", source, keep.sum(), len(keep), noun, self)


class Words(NamedTuple):
    """How messages name the options of a choice, and a row and a column of its table."""

    where: str
    leave_out: str
    nouns: tuple[str, str]


TRIALS = Words("`where`", "`leave_out`", NOUNS)
EVERY = TrialChoice()
"""No choice: every trial is kept."""


def chosen_trials(touches: Touches, choice: TrialChoice, source: str, *, tell: bool = True) -> Touches:
    """The recordings or the spike trains of the trials that a choice keeps; a line says how many.

    Raises InputError, which begins with `source`, as `TrialChoice.keeps`.
    """
    if not choice:
        return touches
    keep = choice.keeps(touches.conditions, source)
    if tell:
        choice.say(keep, source)
    return touches.select(keep)  # pyright: ignore[reportReturnType]  # of the same kind


def fewer_trials(touches: Touches, n: int | None) -> Touches:
    """At most n of the trials, by `evenly_of`; all if it is None.

    Raises InputError, which names the key `dataset.at_most` of a study, if a class would have fewer than
    `LEAST_OF_SIDES` of the trials that it has.
    """
    if n is None or n >= len(touches):
        return touches
    sizes = touches.conditions[LABEL].value_counts()
    least = int(sizes.clip(upper=LEAST_OF_SIDES).sum())
    if n < least:
        raise InputError(
            f"dataset.at_most: {n} trials of {len(sizes)} classes are too few to train, validate and test on; give at "
            f"least {least} ({LEAST_OF_SIDES} of each class)"
        )
    return touches.select(evenly_of(touches.conditions, n))  # pyright: ignore[reportReturnType]  # of the same kind


def evenly_of(conditions: pd.DataFrame, n: int) -> np.ndarray:
    """The places of at most n trials, evenly spaced within each class, and within each condition of it, ascending.

    A class keeps its share, but at least `LEAST_OF_CLASS` trials. Within it each value of the condition with the fewest
    values keeps its share, within that each value of the next condition, and so on as far as n allows.

    >>> table = pd.DataFrame({"label": ["felt", "silk"] * 6, "speed": [1] * 6 + [2] * 6})
    >>> evenly_of(table, 4).tolist(), len(evenly_of(table, 99))
    ([2, 3, 10, 11], 12)
    """
    if n >= len(conditions):
        return np.arange(len(conditions))
    codes = {str(name): pd.factorize(conditions[name].astype(str))[0] for name in conditions}
    others = sorted((name for name in codes if name != LABEL), key=lambda name: int(codes[name].max()))
    sizes = np.bincount(codes[LABEL])
    kept = np.maximum(n * sizes // len(conditions), np.minimum(sizes, LEAST_OF_CLASS))
    while kept.sum() > n:
        kept[kept.argmax()] -= 1
    turns, keys = count(), [codes[name] for name in others]
    of_classes = (_shares(np.flatnonzero(codes[LABEL] == label), keys, int(k), turns) for label, k in enumerate(kept))
    return np.sort(np.concatenate([*of_classes]))


def _shares(places: np.ndarray, keys: Sequence[np.ndarray], k: int, turns: Iterator[int]) -> np.ndarray:
    """Choose k of these places: of each value of the first key its share, and so on within it; evenly without keys.

    keys: a code of each place. turns: where shares are fractions, which of them are rounded up differs from turn to
    turn, so that not the same few values of a later key are taken of each value of an earlier one.
    """
    n = len(places)
    if k in (0, n):
        return places[:k]
    parts = np.split(places, np.arange(1, n))
    if keys:
        codes = keys[0][places]
        parts = [places[codes == code] for code in np.unique(codes)]
    offset = int(next(turns) * GOLDEN % 1 * n)
    ends = (np.cumsum([len(part) for part in parts]) * k + offset) // n
    shares = zip(parts, np.diff(ends, prepend=0).tolist(), strict=True)
    return np.concatenate([_shares(part, keys[1:], own, turns) for part, own in shares if own])


def trials_with(
    conditions: pd.DataFrame, column: str, values: Any, source: str, nouns: tuple[str, str] = NOUNS
) -> np.ndarray:
    """Which trials have one of these values of a condition; every single value must be one that a trial has."""
    keep = np.zeros(len(conditions), bool)
    for value in values if isinstance(values, (list, tuple)) else [values]:
        keep |= select_conditions(conditions, {column: value}, source, nouns)
    return keep


def values_in_words(where: Mapping[str, Any], joint: str = ", ") -> str:
    """Conditions and their values.

    >>> values_in_words({"speed": [300, 450], "force_N": 3})
    'speed = 300 or 450, force_N = 3'
    """
    several = {name: value if isinstance(value, (list, tuple)) else [value] for name, value in where.items()}
    return joint.join(f"{name} = {' or '.join(map(str, values))}" for name, values in several.items())
