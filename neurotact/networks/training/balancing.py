"""Weights of training windows, so that classes, and conditions within a class, count the same in the loss.

Touches are rarely recorded equally often in each class and at each condition. The cross-entropy of a window is weighted
by the inverse of the number of windows like it, as by scikit-learn's `class_weight="balanced"` (King and Zeng 2001,
"Logistic regression in rare events data", doi 10.1093/oxfordjournals.pan.a004868). Use costs the same.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from neurotact.data.recordings import LABEL
from neurotact.data.splits import SplitSpec
from neurotact.errors import InputError
from neurotact.networks.definition.learned import Balance

WITHIN = 1e-9
"""Relative difference of equal weights, by rounding."""


class _Words(NamedTuple):
    """How the user writes the balance, with a place for it, and the conditions to stratify."""

    balance: str
    stratify: str


ARGUMENTS = _Words("`balance='{}'`", "`stratify`")
"""The parameters of functions that train a network."""
SETTINGS = _Words("`settings={{'balance': '{}'}}`", "`settings={'dataset.stratify': ...}`")
"""The keys of a study."""


def columns_of(balance: Balance, split: SplitSpec, stratify: Sequence[str], words: _Words = ARGUMENTS) -> list[str]:
    """The conditions that `conditions` balances: those that the split names; none for another balance.

    stratify: conditions that are balanced over the sides of the split. Raises InputError if the split names none.

    >>> columns_of("conditions", SplitSpec(test_where={"speed": 450}), ["force"])
    ['speed', 'force']
    """
    if balance != "conditions":
        return []
    columns = [*dict.fromkeys([*split.test_where, *split.group, *stratify])]
    if not columns:
        raise InputError(
            f"{words.balance.format(balance)}: balances the conditions that the split names, and it names none; give "
            f"{words.balance.format('classes')}, or a condition with `test_where`, `group` or {words.stratify}"
        )
    return columns


def weights(conditions: pd.DataFrame, balance: Balance, columns: Sequence[str]) -> np.ndarray | None:
    """A weight for each training window, `(window,)` with the mean 1; None if all are 1.

    conditions: of the trial of each window. balance: `classes`: the weights of each class have the same sum.
    `conditions`: within a class, those of each combination of values in `columns` have, too.

    >>> table = pd.DataFrame({"label": ["felt", "felt", "felt", "silk"], "speed": [1, 1, 2, 1]})
    >>> weights(table, "classes", []).round(2).tolist(), weights(table, "conditions", ["speed"]).tolist()
    ([0.67, 0.67, 0.67, 2.0], [0.5, 0.5, 1.0, 2.0])
    >>> weights(table[2:], "classes", []) is None
    True
    """
    if balance == "none":
        return None
    labels = conditions[LABEL].astype(str).to_numpy()
    kinds = conditions[[LABEL, *columns]].astype(str).agg("\n".join, axis=1).to_numpy()
    of_class = pd.Series(kinds).groupby(labels).transform("nunique").to_numpy()
    alike = pd.Series(kinds).groupby(kinds).transform("size").to_numpy()
    found = len(labels) / (len(np.unique(labels)) * of_class * alike)
    return None if np.ptp(found) <= WITHIN else found


def note(conditions: pd.DataFrame, balance: Balance, columns: Sequence[str], words: _Words = ARGUMENTS) -> str:
    """What a balance does to training windows, in one line; arguments as of `weights`.

    >>> table = pd.DataFrame({"label": ["felt", "felt", "felt", "silk"]})
    >>> note(table, "classes", []), note(table[2:], "classes", [])
    ('training: windows count 0.667 to 2 times, so that each class counts the same', "training: `balance='classes'` changes nothing, since each class has as many windows already")
    """  # noqa: E501
    found = weights(conditions, balance, columns)
    what = f"each class at each {' and '.join(columns)}" if columns else "each class"
    if found is None:
        asked = words.balance.format(balance)
        return f"training: {asked} changes nothing, since {what} has as many windows already"
    within = f"each class, and within it each {' and '.join(columns)}," if columns else what
    return f"training: windows count {found.min():.3g} to {found.max():.3g} times, so that {within} counts the same"
