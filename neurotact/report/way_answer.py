"""The answer of a way that is a module, from its configurations.

A verdict is over splits (`metrics.resampled`), or on the test trials of a single one; without knowing which rows test
the same trials there is none. Errors are those of the same test; where it is impossible, standard errors over rows,
which are rather too small.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.figures.columns import in_unit
from neurotact.metrics import referee
from neurotact.metrics.paired import Paired, compare_shares
from neurotact.metrics.referee import Verdict, Way
from neurotact.metrics.resampled import (
    LEAST_SPLITS,
    compare_over_splits,
    least_difference_over_splits,
    resampled_error,
    sizes_of,
)
from neurotact.metrics.shares import standard_error
from neurotact.report.answer import Answer, opponents_of
from neurotact.report.wording import Measure, scale
from neurotact.studies.way import HEADS, View

VALIDATION = "accuracy_validation"
SIDES, N_VALIDATION = ("n_train", "n_test"), "n_validation"
SIZES = (*SIDES, N_VALIDATION, "test_trials", "validation_trials")
"""Columns of results with the sizes of a split, as of `resampled.sizes_of`; the first two are needed."""
SPENT = {"signal_ms": "ms of signal", "energy_estimate_nJ": HEADS["energy_estimate_nJ"]}
"""What the first screen shows beside the view's own cost, where the run holds it."""


class Configuration(NamedTuple):
    """One configuration, means over its rows.

    index: its row in the table of means. kind: the first of what names it. chosen_by, choice_error: what it is chosen
    by and its standard error, NaN if unknown. accuracy, error: the same of what is reported, which may be another
    score. All as the run holds them. costs: those that are known, by their heads, the view's own first. by_split: means
    over the rows of each split, with its sizes; None if splits or sizes are unknown.
    """

    index: int
    name: str
    kind: str
    chosen_by: float
    choice_error: float
    accuracy: float
    error: float
    cost: float
    rows: int
    costs: Mapping[str, float]
    by_split: pd.DataFrame | None = None

    @property
    def way(self) -> Way:
        """What the referee knows of it."""
        return Way(self.chosen_by, self.choice_error, self.cost)


WayAnswer = Answer[Configuration, Configuration]


def answers(means: pd.DataFrame, view: View, results: pd.DataFrame | None = None) -> list[WayAnswer]:
    """An answer for each combination of `view.apart`, those whose choices saw test data last.

    means: of `ways.over_rows`; configurations without a score are left out. Where some have a validation accuracy,
    those without one are not chosen: such as early exit, which is the same network again. results: the rows of these
    means, which `View.splits` assigns to splits; without them nothing is tested.

    >>> view = View(("kind",), {"accuracy_test": "test accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy_test")
    >>> rows = {"kind": ["elm", "svm"], "rows": [4, 4], "accuracy_test": [0.90, 0.89], "accuracy_test_sd": [0.04, 0.02]}
    >>> (found,) = answers(pd.DataFrame(rows | {"flops": [900.0, 300.0], "flops_sd": [0.0, 0.0]}), view)
    >>> found.best.name, found.cheapest.name
    ('elm', 'svm')
    """
    by_split = {} if results is None else dict(_by_split(results, view))
    known = means[means[view.score].notna()]
    groups = known.groupby(list(view.apart), sort=False) if view.apart else [((), known)]
    ordered = sorted(groups, key=lambda group: _is_optimistic(group[0], view))
    return [_answer(key, rows, view, by_split) for key, rows in ordered if len(rows)]


def _is_optimistic(key: tuple[Any, ...], view: View) -> bool:
    return any(str(value) in view.optimistic for value in key)


def _by_split(results: pd.DataFrame, view: View) -> Iterator[tuple[int, pd.DataFrame]]:
    """Of each configuration, by its row in the table of means, the means of its rows by split.

    Nothing where splits or their sizes are unknown, or what is reported is no share.
    """
    score = results[view.score]
    is_share = scale(view.measures[view.score]) > 1 and bool(score.dropna().between(0, 1).all())
    if view.splits is None or not is_share or not {*SIDES} <= {*results}:
        return
    columns = [name for name in (view.score, VALIDATION, *SIZES) if name in results]
    named = [name for name in view.splits if name in results]
    for index, (_, rows) in enumerate(results.groupby(list(view.by), sort=False, dropna=False)):
        known = rows[rows[view.score].notna() & rows[[*SIDES]].notna().all(axis=1)]
        if len(known):
            yield index, known.groupby(named or np.zeros(len(known)), dropna=False)[columns].mean()


def _answer(key: tuple[Any, ...], rows: pd.DataFrame, view: View, by_split: Mapping[int, pd.DataFrame]) -> WayAnswer:
    choice = VALIDATION if VALIDATION in rows and rows[VALIDATION].notna().any() else view.score
    every = tuple(
        _configuration(int(str(index)), row, view, choice, by_split.get(int(str(index))))
        for index, row in rows.iterrows()
    )
    best, cheapest = (every[choose([one.way for one in every])] for choose in (referee.best_of, referee.cheapest_of))
    column, names = view.spiking or (view.by[0], ())
    spikes = rows[column].isin(names).tolist() if names else []
    ours, others = (
        tuple(one for one, its in zip(every, spikes, strict=False) if its == side) for side in (True, False)
    )
    spiking, _ = opponents_of(ours, [one.way for one in ours])
    baseline, rivals = opponents_of(others, [one.way for one in others])
    untested = "" if spiking is None else next((why for one in rivals if (why := _why_untested(spiking, one))), "")
    measure = Measure(view.measures[view.score], view.measures[view.cost])
    verdict, least, doubts = None, None, [*_doubts(every, key, view, choice)]
    if spiking is not None and rivals and not untested:
        verdict = referee.judge([_compared(spiking, rival, view) for rival in rivals])
        least, on = _tested_on(spiking, rivals[verdict.decisive], verdict, measure)
        doubts.append(on)
    return Answer(
        every,
        best,
        cheapest,
        best.choice_error,
        spiking,
        others,
        baseline,
        rivals,
        verdict,
        float(rows["chance"].mean()) if "chance" in rows else math.nan,
        setting_of(key, view),
        measure,
        choice == VALIDATION,
        untested,
        least,
        tuple(doubts),
    )


def _doubts(every: Sequence[Configuration], key: tuple[Any, ...], view: View, choice: str) -> Iterator[str]:
    """What makes the choice of the best and the cheapest worth less, in sentences."""
    names = dict.fromkeys(one.name for one in every if math.isnan(one.cost))
    if names and view.cost != "sops_total":  # which only networks have
        yield f"Not counted, and so never among the cheapest: {', '.join(names)}."
    if choice != VALIDATION:
        yield "The run holds no validation accuracy: the best is chosen by what is shown, which flatters it."
    if _is_optimistic(key, view):
        yield "Choices of this protocol saw test data, so that its accuracies flatter."


def _tested_on(spiking: Configuration, rival: Configuration, verdict: Verdict, measure: Measure) -> tuple[float, str]:
    """The least difference that a verdict can find clear, and on what the verdict rests, in words."""
    both = _on_common(spiking, rival)
    assert both is not None
    n_splits, (n_train, n_test, trials), n = len(both[0]), sizes_of(both[0]), verdict.opponents
    if n_splits == 1:
        said = f"The comparison is of {round(trials)} test trials of one split, and says nothing of other splits"
        least = referee.least_difference(round(trials), n)
    else:
        said = f"The comparison is over {n_splits} splits, which tell as much as {verdict.n} independent trials"
        least = least_difference_over_splits(n_splits, n_train, n_test, n, trials)
    if verdict.kind == "tie":
        said += f"; no difference {'' if math.isinf(least) else f'below {measure.points(least)} '}could be clear"
    return least, f"{said}."


def _on_common(one: Configuration, other: Configuration) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    """The splits on which both were tested; None if they are unknown."""
    if one.by_split is None or other.by_split is None:
        return None
    common = one.by_split.index.intersection(other.by_split.index)
    return one.by_split.loc[common], other.by_split.loc[common]


def _why_untested(one: Configuration, other: Configuration) -> str:
    """Why two configurations are not compared; empty where they are."""
    both = _on_common(one, other)
    if both is None:
        return "the run does not say which rows test the same trials, and how many"
    n_splits = len(both[0])
    if not n_splits:
        return f"{one.name} and {other.name} share no split"
    return f"{n_splits} splits are too few" if 1 < n_splits < LEAST_SPLITS else ""


def _compared(one: Configuration, other: Configuration, view: View) -> Paired:
    """The differences of their reported shares over splits, or the two shares of the trials of a single split."""
    both = _on_common(one, other)
    assert both is not None
    mine, its = (rows[view.score].to_numpy() for rows in both)
    n_train, n_test, trials = sizes_of(both[0])
    if len(mine) == 1:
        return compare_shares(mine.item(), its.item(), round(trials))
    return compare_over_splits(mine - its, n_train, n_test, trials)


def _configuration(index: int, row: pd.Series, view: View, choice: str, by_split: pd.DataFrame | None) -> Configuration:
    named = [column for column in view.by if column not in view.apart]
    parts = [str(row[column]) if isinstance(row[column], str) else f"{words(column)} {name_of(row[column])}"
             for column in named if row[column] != "-"]  # fmt: skip
    heads = {view.cost: view.measures[view.cost]} | {column: SPENT[column] for column in SPENT if column != view.cost}
    costs = {head: float(row[column]) for column, head in heads.items() if column in row}
    return Configuration(
        index,
        ", ".join(parts),
        name_of(row[named[0]]),
        float(row[choice]),
        _error(row, choice, by_split),
        float(row[view.score]),
        _error(row, view.score, by_split),
        float(row[view.cost]),
        int(row["rows"]),
        {head: value for head, value in costs.items() if not math.isnan(value)},
        by_split,
    )


def _error(row: pd.Series, measure: str, by_split: pd.DataFrame | None) -> float:
    """One standard error of a mean: over splits, of the trials of a single one, or over rows if splits are unknown."""
    if by_split is None:
        return float(row[f"{measure}_sd"]) / math.sqrt(row["rows"])
    known = by_split[by_split[measure].notna()]
    side = "validation" if measure == VALIDATION else "test"
    if len(known) > 1:
        return resampled_error(known[measure].to_numpy(), *sizes_of(known, side))
    is_known = side == "test" or (N_VALIDATION in known and known[N_VALIDATION].any())
    return (
        standard_error(known[measure].item(), round(sizes_of(known, side)[2])) if len(known) and is_known else math.nan
    )


def setting_of(values: Sequence[Any], view: View) -> str:
    """What tells an answer from the others of a run, its values of `view.apart`, in words."""
    return ", ".join(in_unit(column, value) for column, value in zip(view.apart, values, strict=True))


def name_of(value: Any) -> str:
    """A value as a page names it.

    >>> name_of(0.5), name_of("elm"), name_of(100.0)
    ('0.5', 'elm', '100')
    """
    return f"{value:g}" if isinstance(value, float) else str(value)


def words(column: str) -> str:
    """A column's name in words.

    >>> words("n_max")
    'n max'
    """
    return column.replace("_", " ").replace(".", " ")
