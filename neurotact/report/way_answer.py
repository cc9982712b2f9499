"""What a run of a way answers: the best configuration, the cheapest within its error, and what stands beside it.

The referee (`metrics.referee`) chooses by validation rows where the run holds them; test rows tell. A verdict is over
splits (`metrics.resampled`), or on the test trials of a single one; without knowing which rows test the same trials
there is none. Errors are those of the same test; where it is impossible, standard errors over rows, which are rather
too small.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

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
from neurotact.report.answer import count
from neurotact.report.page import Figure, Table
from neurotact.studies.way import HEADS, View

VALIDATION = "accuracy_validation"
SIDES, TRIALS, N_VALIDATION = ("n_train", "n_test"), "test_trials", "n_validation"
"""Columns of results with the sizes of a split: training and test examples, test trials, validation trials."""
SPENT = {"signal_ms": "ms of signal", "energy_estimate_nJ": HEADS["energy_estimate_nJ"]}
"""What the first screen shows beside the view's own cost, where the run holds it."""
MOST_KINDS = 8
"""Kinds of configurations in the first table; all of them stand in the table of every configuration."""


class Configuration(NamedTuple):
    """One configuration, means over its rows.

    index: its row in the table of means. kind: the first of what names it. chosen_by, choice_error: what it is chosen
    by and its standard error, NaN if unknown. score, error: the same of what is reported. All scores as the run holds
    them. by_split: means over the rows of each split, with its sizes; None if splits or sizes are unknown.
    """

    index: int
    name: str
    kind: str
    chosen_by: float
    choice_error: float
    score: float
    error: float
    cost: float
    rows: int
    spent: dict[str, float]
    by_split: pd.DataFrame | None = None

    @property
    def way(self) -> Way:
        """What the referee knows of it."""
        return Way(self.chosen_by, self.choice_error, self.cost)


class WayAnswer(NamedTuple):
    """The answer for one task or rule of a run, whose configurations can be compared.

    setting: its name; empty where there is only one. cheapest: the cheapest within the best one's error.
    spiking: the best that spikes; None where the view names no kinds. others: all without spikes. rivals: those of them
    that validation cannot tell from the best, `other`. verdict: on `spiking` against them; None if there is nothing to
    compare, or no test. chance: the accuracy of guessing; None where the run does not hold it. untested: why there is
    no test; empty if there is one.
    """

    setting: str
    configurations: list[Configuration]
    best: Configuration
    cheapest: Configuration
    spiking: Configuration | None
    others: tuple[Configuration, ...]
    other: Configuration | None
    rivals: tuple[Configuration, ...]
    verdict: Verdict | None
    chance: float | None
    is_validated: bool
    is_optimistic: bool
    untested: str = ""


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
    all_answers = [_answer(key, rows, view, by_split) for key, rows in groups if len(rows)]
    return sorted(all_answers, key=lambda one: one.is_optimistic)


def _by_split(results: pd.DataFrame, view: View) -> Iterator[tuple[int, pd.DataFrame]]:
    """Of each configuration, by its row in the table of means, the means of its rows by split.

    Nothing where splits or their sizes are unknown, or what is reported is no share.
    """
    score = results[view.score]
    is_share = scale(view.measures[view.score]) > 1 and bool(score.dropna().between(0, 1).all())
    if view.splits is None or not is_share or not {*SIDES} <= {*results}:
        return
    columns = [name for name in (view.score, VALIDATION, *SIDES, TRIALS, N_VALIDATION) if name in results]
    named = [name for name in view.splits if name in results]
    for index, (_, rows) in enumerate(results.groupby(list(view.by), sort=False, dropna=False)):
        known = rows[rows[view.score].notna() & rows[[*SIDES]].notna().all(axis=1)]
        if len(known):
            yield index, known.groupby(named or np.zeros(len(known)), dropna=False)[columns].mean()


def _answer(key: tuple[Any, ...], rows: pd.DataFrame, view: View, by_split: Mapping[int, pd.DataFrame]) -> WayAnswer:
    is_validated = VALIDATION in rows and bool(rows[VALIDATION].notna().any())
    choice = VALIDATION if is_validated else view.score
    rows_ = [
        _configuration(int(str(index)), row, view, choice, by_split.get(int(str(index))))
        for index, row in rows.iterrows()
    ]
    best, cheapest = (rows_[choose([one.way for one in rows_])] for choose in (referee.best_of, referee.cheapest_of))
    spiking, others, other, rivals, verdict, untested = None, (), None, (), None, ""
    if view.spiking is not None:
        column, names = view.spiking
        are_spiking = dict(zip(rows.index, rows[column].isin(names), strict=True))
        sides = [[one for one in rows_ if are_spiking[one.index] == is_spiking] for is_spiking in (True, False)]
        spiking, other = (side[referee.best_of([one.way for one in side])] if side else None for side in sides)
        others = tuple(sides[1])
        level = referee.level_with_best([one.way for one in sides[1]]) if sides[1] else []
        rivals = tuple(sides[1][index] for index in level)
    if spiking is not None and rivals:
        untested = next((why for rival in rivals if (why := _why_untested(spiking, rival))), "")
        verdict = None if untested else referee.judge([_compared(spiking, rival, view) for rival in rivals])
    chance = float(rows["chance"].mean()) if "chance" in rows and rows["chance"].notna().any() else None
    setting = setting_of(key, view)
    is_optimistic = any(str(value) in view.optimistic for value in key)
    return WayAnswer(
        setting, rows_, best, cheapest, spiking, others, other, rivals, verdict, chance, is_validated, is_optimistic,
        untested,
    )  # fmt: skip


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
    spent = {column: float(row[column]) for column in SPENT if column in row and column != view.cost}
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
        {column: value for column, value in spent.items() if not math.isnan(value)},
        by_split,
    )


def _error(row: pd.Series, measure: str, by_split: pd.DataFrame | None) -> float:
    """One standard error of a mean: over splits, of the trials of a single one, or over rows if splits are unknown."""
    if by_split is None:
        return float(row[f"{measure}_sd"]) / math.sqrt(row["rows"])
    known = by_split[by_split[measure].notna()]
    if len(known) > 1:
        return resampled_error(known[measure].to_numpy(), *sizes_of(known))
    n_validation = known[N_VALIDATION].sum() if N_VALIDATION in known else 0
    trials = n_validation if measure == VALIDATION else sizes_of(known)[2] if len(known) else 0
    return standard_error(known[measure].item(), round(trials)) if trials else math.nan


def headline(answer: WayAnswer, view: View) -> str:
    """The result in one sentence: the verdict, and the numbers that it rests on."""
    said = verdict(answer)
    return f"{said}: {evidence(answer, view)}" if said else evidence(answer, view)


def verdict(answer: WayAnswer) -> str:
    """The verdict of the headline, without its numbers; empty where there is nothing to compare."""
    if answer.spiking is None or answer.other is None:
        return ""
    return {
        "better": "Spiking is more accurate",
        "worse": "Spiking costs accuracy",
        "tie": "No clear difference between spiking and the others",
        "untested": f"Not tested, since {answer.untested}",
    }[kind_of(answer)]


def evidence(answer: WayAnswer, view: View) -> str:
    """The numbers of the headline."""
    guess = "" if answer.chance is None else f"; guessing reaches {_score(answer.chance, view)}"
    if answer.spiking is None or answer.other is None:
        return f"{_told(answer.best, view)} at {_cost(answer.best.cost, view)}{guess}."
    return f"{_told(answer.spiking, view)}; {_rivals(answer, view)}{guess}."


def figures(answer: WayAnswer, view: View) -> list[Figure]:
    """The score and the costs of the best configuration that spikes, or of the best one, beside the best other.

    >>> measures = {"accuracy": "accuracy (%)", "flops": "FLOPs"}
    >>> view = View(("kind",), measures, "flops", "accuracy", spiking=("kind", ("rsnn",)))
    >>> rows = {"kind": ["rsnn", "svm"], "rows": [4, 4], "accuracy": [0.9, 0.89], "accuracy_sd": [0.04, 0.02]}
    >>> (found,) = answers(pd.DataFrame(rows | {"flops": [900.0, 300.0]}), view)
    >>> for one in figures(found, view):
    ...     print(one.what, one.value, one.of, one.against, sep=" | ")
    accuracy | 90.0 % | ± 2.0 points, rsnn | svm: 89.0 ± 1.0 %
    FLOPs | 900 | rsnn | svm: 300
    """
    shown, other = answer.spiking or answer.best, answer.other if answer.spiking else None
    error = "" if math.isnan(shown.error) else f"± {_points(shown.error, view)}, "
    guess = "" if answer.chance is None else f"guessing: {_score(answer.chance, view)}"
    beside = f"{other.name}: {_with_error(other, view)}" if other else guess
    theirs = _costs(other, view) if other else {}
    return [
        Figure(_what(view), _score(shown.score, view), f"{error}{shown.name}", beside),
        *(
            Figure(
                head,
                count(value),
                shown.name,
                f"{other.name}: {count(theirs[head])}" if other and head in theirs else "",
            )
            for head, value in _costs(shown, view).items()
        ),
    ]


def _costs(one: Configuration, view: View) -> dict[str, float]:
    """The known costs of a configuration by their heads, the view's own first."""
    costs = {view.measures[view.cost]: one.cost} | {SPENT[column]: value for column, value in one.spent.items()}
    return {head: value for head, value in costs.items() if not math.isnan(value)}


def kind_of(answer: WayAnswer) -> referee.Kind | Literal["untested"]:
    """The verdict on spiking. A table with a more accurate row without spikes contradicts `better`: that is a tie."""
    if answer.verdict is None:
        return "untested"
    return "tie" if answer.verdict.kind == "better" and _unranked(answer) is not None else answer.verdict.kind


def _unranked(answer: WayAnswer) -> Configuration | None:
    """A configuration without spikes that validation ranks lower, and whose score is at least that of spiking."""
    assert answer.spiking is not None
    lower = [one for one in answer.others if one not in answer.rivals and one.score >= answer.spiking.score]
    return max(lower, key=lambda one: one.score, default=None)


def _rivals(answer: WayAnswer, view: View) -> str:
    """What spiking is compared with, in words."""
    assert answer.other is not None
    if answer.verdict is not None and answer.verdict.kind == "better" and (lower := _unranked(answer)) is not None:
        return f"{lower.name}, which validation ranks lower, has {_score(lower.score, view)}"
    if answer.verdict is not None and len(answer.rivals) > 1:
        worst, best = _ends(answer.rivals)
        is_unsure = math.isnan(answer.other.choice_error)
        level = "are equal on validation rows" if is_unsure else "validation cannot tell apart"
        return (
            f"{len(answer.rivals)} without spikes that {level} have {_score(worst.score, view)} "
            f"({worst.name}) to {_score(best.score, view)} ({best.name})"
        )
    return f"the best without spikes, {answer.other.name}, has {_score(answer.other.score, view)}"


def details(answer: WayAnswer, view: View) -> Iterator[str]:
    """What the cheapest within the error saves, and what the reader must know of the choice, in sentences."""
    best, cheapest = answer.best, answer.cheapest
    rows = "validation" if answer.is_validated else "test"
    if math.isnan(best.choice_error):
        few = "one row" if best.rows == 1 else "too few splits"
        yield f"{best.name} has {few}, so that its error is not known."
    elif cheapest.index == best.index and not math.isnan(best.cost):
        yield f"{best.name} is also the cheapest within its error ({_points(best.choice_error, view)} on {rows} rows)."
    elif cheapest.index != best.index:
        yield (
            f"Within the error of {best.name} ({_points(best.choice_error, view)} on {rows} rows), {cheapest.name} is "
            f"the cheapest: {_saved(best, cheapest, view)}, {_lost(best, cheapest, view)}."
        )
    uncounted = dict.fromkeys(one.name for one in answer.configurations if math.isnan(one.cost))
    if uncounted and view.cost != "sops_total":  # which only networks have
        yield f"Not counted, and so never among the cheapest: {', '.join(uncounted)}."
    if not answer.is_validated:
        yield "The run holds no validation accuracy: the best is chosen by what is shown, which flatters it."
    if answer.is_optimistic:
        yield "Choices of this protocol saw test data, so that its accuracies flatter."
    if answer.verdict is not None:
        yield _tested_on(answer, view)


def _tested_on(answer: WayAnswer, view: View) -> str:
    """On what the verdict rests, and below which difference there can be none."""
    assert answer.spiking is not None
    assert answer.verdict is not None
    both = _on_common(answer.spiking, answer.rivals[answer.verdict.decisive])
    assert both is not None
    n_splits, (n_train, n_test, trials), n = len(both[0]), sizes_of(both[0]), answer.verdict.opponents
    if n_splits == 1:
        said = f"The comparison is of {round(trials)} test trials of one split, and says nothing of other splits"
        least = referee.least_difference(round(trials), n)
    else:
        said = f"The comparison is over {n_splits} splits, which tell as much as {answer.verdict.n} independent trials"
        least = least_difference_over_splits(n_splits, n_train, n_test, n, trials)
    if kind_of(answer) != "tie":
        return f"{said}."
    return f"{said}; no difference {'' if math.isinf(least) else f'below {_points(least, view)} '}could be clear."


def table(answer: WayAnswer, view: View) -> Table:
    """The best of each kind, the cheapest within the error, and guessing."""
    kinds: dict[str, Configuration] = {}
    for one in sorted(answer.configurations, key=lambda one: (math.isnan(one.chosen_by), -one.chosen_by)):
        kinds.setdefault(one.kind, one)
    shown = list(kinds.values())[:MOST_KINDS]
    shown += [one for one in _named(answer) if one not in shown]
    spent = [column for column in SPENT if any(column in one.spent for one in shown)]
    marks = [(answer.best, "best")]
    if not math.isnan(answer.best.choice_error):
        marks.append((answer.cheapest, "cheapest within its error"))
    rows = []
    for one in shown:
        said = " and ".join(word for of, word in marks if of.index == one.index)
        row = [f"{one.name}{': ' if said else ''}{said}", _with_error(one, view), count(one.cost)]
        rows.append([*row, *(count(one.spent[column]) if column in one.spent else "-" for column in spent)])
    if answer.chance is not None:
        rows.append(["guessing", _score(answer.chance, view), *[""] * (1 + len(spent))])
    least, most = (of(one.rows for one in shown) for of in (min, max))
    over = f"{least} to {most}" if least < most else f"{most}"
    error = "" if all(math.isnan(one.error) for one in shown) else " ± their standard error"
    what = f"means over {over} rows of results.csv{error}" if most > 1 else f"one row of results.csv each{error}"
    setting = f", {answer.setting}" if answer.setting else ""
    chosen = ", chosen on validation rows" if answer.is_validated else ""
    caption = f"The best of each kind{setting}{chosen}: {what}."
    heads = ["configuration", view.measures[view.score], view.measures[view.cost], *(SPENT[column] for column in spent)]
    return Table(caption, heads, rows, n_heads=1)


def _named(answer: WayAnswer) -> list[Configuration]:
    """Every configuration that a sentence of the answer may name, each once."""
    known = [answer.cheapest, answer.other, answer.spiking]
    if answer.verdict is not None:
        known += [*_ends(answer.rivals), _unranked(answer)]
    return list({one.index: one for one in known if one is not None}.values())


def _ends(rivals: Sequence[Configuration]) -> tuple[Configuration, Configuration]:
    """The least and the most accurate one."""
    worst, best = (choose(rivals, key=lambda one: one.score) for choose in (min, max))
    return worst, best


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


def scale(head: str) -> float:
    """By what a measure is multiplied to be read: a head that ends in (%) asks for percent."""
    return 100.0 if head.endswith("(%)") else 1.0


def _unit(view: View) -> str:
    return " %" if scale(view.measures[view.score]) > 1 else ""


def _score(value: float, view: View) -> str:
    factor = scale(view.measures[view.score])
    return f"{factor * value:.1f} %" if factor > 1 else f"{value:.4g}"


def _told(one: Configuration, view: View) -> str:
    return f"{one.name} has a {_what(view)} of {_score(one.score, view)}"


def _what(view: View) -> str:
    """The score in words, without its unit."""
    return view.measures[view.score].removesuffix("(%)").strip()


def _with_error(one: Configuration, view: View) -> str:
    if math.isnan(one.error):
        return _score(one.score, view)
    factor = scale(view.measures[view.score])
    return f"{factor * one.score:.1f} ± {factor * one.error:.1f}{_unit(view)}"


def _points(share: float, view: View) -> str:
    factor = scale(view.measures[view.score])
    return f"{factor * share:.1f} points" if factor > 1 else f"{share:.3g}"


def _cost(value: float, view: View) -> str:
    """A cost with its head, whose unit comes first.

    >>> [_cost(635.0, View((), {"x": head}, "x", "x")) for head in ("FLOPs", "FLOPs (paper's count)", "energy (nJ)")]
    ['635 FLOPs', "635 FLOPs (paper's count)", '635 nJ (energy)']
    """
    if math.isnan(value):
        return "a cost that is not counted"
    head = view.measures[view.cost]
    what, _, unit = head.removesuffix(")").partition(" (")
    return f"{count(value)} {unit} ({what})" if unit and " " not in unit else f"{count(value)} {head}"


def _saved(before: Configuration, after: Configuration, view: View) -> str:
    if math.isnan(before.cost):
        return f"{_cost(after.cost, view)} against {_cost(before.cost, view)}"
    both = f"{_cost(after.cost, view)} against {count(before.cost)}"
    return f"{100 * (1 - after.cost / before.cost):.0f} % less, {both}" if before.cost > 0 else both


def _lost(before: Configuration, after: Configuration, view: View) -> str:
    lost = before.score - after.score
    if abs(scale(view.measures[view.score]) * lost) < 0.05:
        return f"at the same score, {_score(after.score, view)}"
    return (
        f"and its score is {_points(abs(lost), view)} {'lower' if lost > 0 else 'higher'}, {_score(after.score, view)}"
    )


def as_json(all_answers: Sequence[WayAnswer], view: View) -> dict[str, Any]:
    """What the page draws of each answer: its best and cheapest point, and guessing in the unit of the axis."""
    factor = scale(view.measures[view.score])
    return {
        one.setting: {
            "best": one.best.index,
            "cheapest": one.cheapest.index,
            "chance": None if one.chance is None else factor * one.chance,
        }
        for one in all_answers
    }
