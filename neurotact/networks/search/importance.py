"""The importance of hyperparameters in a search, by permutation in random forests."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.ensemble import RandomForestRegressor
from sklearn.inspection import permutation_importance

FOREST_LEAST = 16
"""With fewer trials, no importance is estimated."""
TREES = 200
"""Of a forest."""


class Importance(NamedTuple):
    """drop: for each key of the network, the loss of R² when its values are shuffled; r2: R² of the prediction."""

    drop: Mapping[str, float]
    r2: float


def importance(table: pd.DataFrame, keys: Sequence[str]) -> Importance | None:
    """How strongly the value depends on each key, by permutation in random forests; None for too few trials.

    A forest fitted on every other trial predicts the rest, and the reverse. `drop` is the mean loss of R² over both
    when a key's values are shuffled among the predicted trials; `r2` is the mean R² of both.
    """
    trials = table[table["value"].notna()]
    varied = [key for key in keys if trials[key].nunique() > 1]
    if len(trials) < FOREST_LEAST or not varied or trials["value"].nunique() == 1:
        return None
    features = trials[varied].apply(_as_number)
    even = np.arange(len(trials)) % 2 == 0
    drops, scores = [], []
    for fitted in (even, ~even):
        forest = RandomForestRegressor(TREES, min_samples_leaf=2, random_state=0)
        forest.fit(features[fitted], trials["value"][fitted])
        unseen = (features[~fitted], trials["value"][~fitted])
        drops.append(permutation_importance(forest, *unseen, n_repeats=10, random_state=0)["importances_mean"])
        scores.append(forest.score(*unseen))
    return Importance(dict(zip(varied, np.mean(drops, axis=0).tolist(), strict=True)), float(np.mean(scores)))


def _as_number(column: pd.Series) -> pd.Series:
    return column if pd.api.types.is_numeric_dtype(column) else pd.Series(pd.factorize(column)[0], column.index)
