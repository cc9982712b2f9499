"""Tables without an effect: the rows of a study, with their values exchanged among its conditions."""

from collections.abc import Collection
from functools import lru_cache
from itertools import permutations, product
from math import factorial, prod

import numpy as np
import pandas as pd

TRIED = 5040
"""All arrangements are tried up to this number; beyond it `DRAWS` random ones."""
DRAWS = 999
SEED = 0


def blocks_of(rows: pd.DataFrame, condition: np.ndarray, leave: Collection[str] = ()) -> np.ndarray:
    """The block of each row: rows that agree in every column whose values occur as often under each condition.

    Such a column, as a seed, is crossed with the conditions; a measured one is not. condition: of each row, `(row,)`,
    from 0. leave: columns that are no block, as those that make the conditions.

    >>> rows = pd.DataFrame({"pair": ["1&1", "1&1", "5&5", "5&5"], "seed": [0, 1, 0, 1], "x": [0.1, 0.2, 0.3, 0.4]})
    >>> blocks_of(rows, np.array([0, 0, 1, 1]), leave=["pair"]).tolist()
    [0, 1, 0, 1]
    """
    codes, n_conditions = np.zeros(len(rows), dtype=int), int(condition.max()) + 1
    for column in rows.columns.difference([*leave], sort=False):
        code, values = pd.factorize(rows[column], use_na_sentinel=False)
        if len(values) * n_conditions > len(rows):
            continue
        counts = np.bincount(code * n_conditions + condition, minlength=len(values) * n_conditions)
        counts = counts.reshape(-1, n_conditions)
        if (counts == counts[:, :1]).all():
            codes = np.unique(codes * len(values) + code, return_inverse=True)[1]
    return codes


def arrangements(blocks: np.ndarray) -> np.ndarray:
    """For each arrangement and row the row that gives its value, `(arrangement, row)`; the first changes none.

    >>> arrangements(np.array([0, 1, 0])).tolist()
    [[0, 1, 2], [2, 1, 0]]
    """
    return _arranged(tuple(blocks.tolist()))


def n_distinct(blocks: np.ndarray, classes: np.ndarray) -> int:
    """How many arrangements a rule can tell apart that reads rows of a class alike; both numbered from 0.

    >>> n_distinct(np.zeros(6, dtype=int), np.array([0, 0, 0, 1, 1, 1]))
    20
    """
    n_classes = int(classes.max()) + 1
    counts = np.bincount(blocks * n_classes + classes, minlength=n_classes * (int(blocks.max()) + 1))
    per_block = counts.reshape(-1, n_classes).tolist()
    return prod(factorial(sum(block)) // prod(map(factorial, block)) for block in per_block)


@lru_cache(maxsize=16)
def _arranged(blocks: tuple[int, ...]) -> np.ndarray:
    members = [np.flatnonzero(np.array(blocks) == block) for block in sorted(set(blocks))]
    places = np.concatenate(members)
    if prod(factorial(len(rows)) for rows in members) <= TRIED:
        found = np.array([np.concatenate(each) for each in product(*(permutations(rows) for rows in members))])
    else:
        rng = np.random.default_rng(SEED)
        drawn = [rng.permuted(np.tile(rows, (DRAWS, 1)), axis=1) for rows in members]
        found = np.vstack([places, np.hstack(drawn)])
    arranged = np.empty_like(found)
    arranged[:, places] = found
    return arranged
