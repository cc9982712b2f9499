"""Validation as the test is: where test trials have another condition, validation leaves one out of the training side.

Validation trials of trained conditions say nothing of an untrained one: on presses at another speed than in training,
ten classifiers were equal on such trials and from 33 to 65 % right on test trials.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

LARGEST = 0.6
"""Share of the trials outside the test side that validation may leave out at most."""
MOST_TURNS = 7
"""Turns of validation at most: with more values of a condition, a turn leaves out several."""
SHOWN = 3
"""Turns that a sentence names."""

Turn = tuple[str, ...]
"""The units that one turn leaves out."""


def units_of(conditions: pd.DataFrame, columns: Iterable[str]) -> np.ndarray:
    """The values of each trial in the columns in words, as `speed = 300, force_N = 6`, `(trial,)`."""
    parts = [f"{column} = " + conditions[column].astype(str) for column in columns]
    return np.array([", ".join(values) for values in zip(*parts, strict=True)])


def turns_of(units: np.ndarray, labels: np.ndarray, rest: np.ndarray) -> list[Turn]:
    """The units that validation can leave out in turn: the others keep every class for training.

    units, labels: of all trials, `(trial,)`. rest: the trials that are not tested. Empty if none can be left out.

    >>> units, labels = np.repeat(["speed = 1", "speed = 2", "speed = 3"], 4), np.array(["felt", "silk"] * 6)
    >>> turns_of(units, labels, np.arange(8)), turns_of(units, labels, np.arange(4))
    ([('speed = 1',), ('speed = 2',)], [])
    """
    known = [str(unit) for unit in np.unique(units[rest])]
    n_turns = min(MOST_TURNS, len(known))
    classes = np.unique(labels[rest])

    def can_be_left_out(turn: Turn) -> bool:
        others = rest[~np.isin(units[rest], turn)]
        return np.array_equal(np.unique(labels[others]), classes) and len(rest) - len(others) <= LARGEST * len(rest)

    return [turn for turn in (tuple(known[first::n_turns]) for first in range(n_turns)) if can_be_left_out(turn)]


def note(columns: Iterable[str], turns: Sequence[Turn], *, varied: bool = False) -> str:
    """How validation chooses for a test on other values of some conditions, in one sentence.

    turns: of `turns_of`; none if validation cannot leave out any. varied: whether it is on varied copies, too.

    >>> note(["speed"], [("speed = 150",), ("speed = 300",)])
    'Validation leaves out one speed of the training trials in turn, as the test does (speed = 150; speed = 300)'
    """
    named = " and ".join(columns)
    if not turns:
        copies = " and on varied copies of them" if varied else ""
        return (
            f"Validation ranks nothing for this test: training trials have too few values of {named} to leave one out, "
            f"so that it is on trials of the trained ones{copies}"
        )
    some = "; ".join(" or ".join(turn) for turn in turns[:SHOWN]) + ("; ..." if len(turns) > SHOWN else "")
    what = "one" if all(len(turn) == 1 for turn in turns) else "some values of"
    return f"Validation leaves out {what} {named} of the training trials in turn, as the test does ({some})"
