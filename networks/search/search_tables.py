"""Tables of a search: trials, Pareto front of accuracy and SOPs, best network, importance of hyperparameters."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.networks.search.journal import FINISHED, Trial, best_of
from neurotact_parts.networks.search.search import Problem
from sklearn.ensemble import RandomForestRegressor
from sklearn.inspection import permutation_importance

from neurotact import files, spec
from neurotact.errors import number_of
from neurotact.metrics.fronts import pareto_front
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import void_keys
from neurotact.tables import write_table


def write_tables(problem: Problem, folder: Path, trials: Sequence[Trial]) -> None:
    """Write the results of the journal: best.toml, trials.csv and, if SOPs count too, pareto.csv."""
    best = best_of(trials)
    table = trials_table(trials)
    write_table(table, folder / "trials.csv")
    if problem.search.weighs_sops:
        write_table(front_table(table), folder / "pareto.csv")
    network = problem.network_of(best.parameters)
    comment = f"# The best of {number_of(len(trials), 'trial')} (trial {best.id}), by {value_words(problem.search)}.\n"
    table = network.model_dump(mode="json")
    if network.recipe is None:  # what has no effect, such as a searched scale of recurrent weights, is refused by train
        table = spec.override(table, {key: None for key in void_keys(network) if key in spec.leaves(table)})
    files.write_text(folder / "best.toml", comment + spec.to_toml(table))


def trials_table(trials: Sequence[Trial]) -> pd.DataFrame:
    """One row per trial: id, outcome, epochs, value, accuracy_validation, sops_total, its parameters, error.

    >>> trials_table([Trial(0, {"hidden": 20}, [0.5, 0.75], "finished", 0.75, 900.0, 0.75)]).iloc[0].to_dict()
    {'id': 0, 'outcome': 'finished', 'epochs': 2, 'value': 0.75, 'accuracy_validation': 0.75, 'sops_total': 900.0, \
'hidden': 20, 'error': ''}
    """
    rows = [
        {
            "id": trial.id,
            "outcome": trial.outcome,
            "epochs": len(trial.epochs),
            "value": trial.value,
            "accuracy_validation": trial.accuracy,
            "sops_total": trial.sops,
            **{key: as_cell(value) for key, value in trial.parameters.items()},
            "error": trial.error or "",
        }
        for trial in trials
    ]
    numbers = ["value", "accuracy_validation", "sops_total"]
    return pd.DataFrame(rows).astype(dict.fromkeys(numbers, float))


def by_rank(table: pd.DataFrame) -> pd.DataFrame:
    """The finished trials of a table, the best first, in the order of `journal.best_of`.

    >>> outcomes = ["finished", "stopped", "finished"]
    >>> rows = pd.DataFrame({"outcome": outcomes, "value": [0.9, 0.95, 0.9], "sops_total": [3.0, 1.0, 2.0]})
    >>> by_rank(rows).index.tolist()
    [2, 0]
    """
    finished = table[table["outcome"] == FINISHED]
    return finished.sort_values(["value", "sops_total"], ascending=[False, True], kind="stable")


def front_table(table: pd.DataFrame) -> pd.DataFrame:
    """The finished trials that no other beats in both validation accuracy and SOPs, by SOPs."""
    finished = table[table["outcome"] == FINISHED]
    front = finished[pareto_front(finished["sops_total"].to_numpy(), finished["accuracy_validation"].to_numpy())]
    return front.sort_values(["sops_total", "id"]).drop(columns=["outcome", "error"])


def as_cell(value: Any) -> Any:
    """A hyperparameter as a cell of a table."""
    return value if isinstance(value, (int, float, str)) else json.dumps(value)


def value_words(search: SearchSpec) -> str:
    """What the search maximises, in words."""
    words = "validation accuracy"
    if search.objective == "accuracy-sops":
        words += f" - {search.sops_weight:g} log10(SOPs)"
    return words if search.max_sops is None else f"{words} within {search.max_sops:,g} SOPs"


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
