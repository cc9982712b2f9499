"""Validation as the test is: where test trials have another condition, validation leaves one out of the training side.

Validation trials of trained conditions say nothing of an untrained one: on presses at another speed than in training,
ten classifiers were equal on such trials and from 33 to 65 % right on test trials.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

LARGEST = 0.6
"""Share of the trials outside the test side that validation may leave out at most."""
MOST_TURNS = 7
"""Turns of validation at most: with more values of a condition, a turn leaves out several."""
LEAST_APART = 0.2
"""Share of these trials that are left for training at least where trials that share a value are left aside, too: one
pair of 3 x 3, of which one is tested and one validates."""
SHOWN = 3
"""Turns that a sentence names."""


class Turn(NamedTuple):
    """The units that validation leaves out in one turn, and those that are on no side since they share a value."""

    held: tuple[str, ...]
    aside: tuple[str, ...] = ()


def units_of(conditions: pd.DataFrame, columns: Iterable[str]) -> np.ndarray:
    """The values of each trial in the columns in words, as `speed = 300, force_N = 6`, `(trial,)`."""
    parts = [f"{column} = " + conditions[column].astype(str) for column in columns]
    return np.array([", ".join(values) for values in zip(*parts, strict=True)])


def turns_of(units: np.ndarray, labels: np.ndarray, rest: np.ndarray) -> list[Turn]:
    """The units that validation can leave out in turn: the others keep every class for training.

    units, labels: of all trials, `(trial,)`. rest: the trials that are not tested. Empty if none can be left out.

    >>> units, labels = np.repeat(["speed = 1", "speed = 2", "speed = 3"], 4), np.array(["felt", "silk"] * 6)
    >>> [turn.held for turn in turns_of(units, labels, np.arange(8))], turns_of(units, labels, np.arange(4))
    ([('speed = 1',), ('speed = 2',)], [])
    """
    classes = np.unique(labels[rest])

    def can_be_left_out(held: tuple[str, ...]) -> bool:
        others = rest[~np.isin(units[rest], held)]
        return np.array_equal(np.unique(labels[others]), classes) and len(rest) - len(others) <= LARGEST * len(rest)

    return [Turn(held) for held in _in_turns(units[rest]) if can_be_left_out(held)]


def turns_apart(conditions: pd.DataFrame, columns: Sequence[str], labels: np.ndarray, rest: np.ndarray) -> list[Turn]:
    """The combinations of values that validation can leave out in turn, with every trial that shares one of the values.

    Less does not ask what the test asks: of gratings, all kinds of varied copies were equal at another force, and 85 to
    100 % right at another force and speed. Successive turns differ in every column. labels, rest: as of `turns_of`.
    Empty if less than `LEAST_APART` of the trials, or not every class, would be left for training.

    >>> table = pd.DataFrame([(speed, force) for speed in (1, 2, 3, 4) for force in (5, 6, 7)])
    >>> table = pd.concat([table] * 2, ignore_index=True).set_axis(["speed", "force"], axis=1)
    >>> first, *others = turns_apart(table, ["speed", "force"], np.repeat(["felt", "silk"], 12), np.arange(24))
    >>> first.held, len(first.aside), others[0].held
    (('speed = 1, force = 5',), 5, ('speed = 2, force = 6',))
    """
    units, classes = units_of(conditions, columns)[rest], np.unique(labels[rest])
    values = [units_of(conditions, [column])[rest] for column in columns]
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


def note(
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

    >>> note(["speed"], [Turn(("speed = 150",)), Turn(("speed = 300",))])
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
