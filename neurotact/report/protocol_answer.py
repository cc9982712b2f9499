"""What a run of a protocol answers: the best configuration, the cheapest within its error, and what stands beside it.

The referee (`metrics.referee`) chooses by validation rows where the run holds them; test rows tell. Errors are standard
errors over the rows of a configuration (seeds, splits, folds); rows that share examples are not independent, so that
they are rather too small.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import pandas as pd

from neurotact.figures.columns import in_unit
from neurotact.metrics import referee
from neurotact.metrics.paired import Paired, compare_means
from neurotact.metrics.referee import Verdict, Way
from neurotact.report.answer import count
from neurotact.report.page import Figure, Table
from neurotact.studies.protocol import HEADS, View

VALIDATION = "accuracy_validation"
SPENT = {"signal_ms": "ms of signal", "energy_estimate_nJ": HEADS["energy_estimate_nJ"]}
"""What the first screen shows beside the view's own cost, where the run holds it."""
MOST_KINDS = 8
"""Kinds of configurations in the first table; all of them stand in the table of every configuration."""


class Configuration(NamedTuple):
    """One configuration, means over its rows.

    index: its row in the table of means. kind: the first of what names it. chosen_by, choice_error: what it is chosen
    by and its standard error, NaN with one row. score, error: the same of what is reported. All scores as the run holds
    them.
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

    @property
    def way(self) -> Way:
        """What the referee knows of it."""
        return Way(self.chosen_by, self.choice_error, math.inf if math.isnan(self.cost) else self.cost)


class ProtocolAnswer(NamedTuple):
    """The answer for one task or rule of a run, whose configurations can be compared.

    setting: its name; empty where there is only one. cheapest: the cheapest within the best one's error.
    spiking: the best that spikes; None where the view names no kinds. others: all without spikes. rivals: those of them
    that validation cannot tell from the best, `other`. verdict: on `spiking` against them; None without an error.
    chance: the accuracy of guessing; None where the run does not hold it.
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


def answers(means: pd.DataFrame, view: View) -> list[ProtocolAnswer]:
    """An answer for each combination of `view.apart`, those whose choices saw test data last.

    means: of `protocol.over_rows`; configurations without a score are left out. Where some have a validation accuracy,
    those without one are not chosen: such as early exit, which is the same network again.

    >>> view = View(("kind",), {"accuracy_test": "test accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy_test")
    >>> rows = {"kind": ["elm", "svm"], "rows": [4, 4], "accuracy_test": [0.90, 0.89], "accuracy_test_sd": [0.04, 0.02]}
    >>> (found,) = answers(pd.DataFrame(rows | {"flops": [900.0, 300.0], "flops_sd": [0.0, 0.0]}), view)
    >>> found.best.name, found.cheapest.name
    ('elm', 'svm')
    """
    known = means[means[view.score].notna()]
    groups = known.groupby(list(view.apart), sort=False) if view.apart else [((), known)]
    all_answers = [_answer(key, rows, view) for key, rows in groups if len(rows)]
    return sorted(all_answers, key=lambda one: one.is_optimistic)


def _answer(key: tuple[Any, ...], rows: pd.DataFrame, view: View) -> ProtocolAnswer:
    is_validated = VALIDATION in rows and bool(rows[VALIDATION].notna().any())
    choice = VALIDATION if is_validated else view.score
    rows_ = [_configuration(int(str(index)), row, view, choice) for index, row in rows.iterrows()]
    best, cheapest = (rows_[choose([one.way for one in rows_])] for choose in (referee.best_of, referee.cheapest_of))
    spiking, others, other, rivals, verdict = None, (), None, (), None
    if view.spiking is not None:
        column, names = view.spiking
        are_spiking = dict(zip(rows.index, rows[column].isin(names), strict=True))
        sides = [[one for one in rows_ if are_spiking[one.index] == is_spiking] for is_spiking in (True, False)]
        spiking, other = (side[referee.best_of([one.way for one in side])] if side else None for side in sides)
        others = tuple(sides[1])
        level = referee.level_with_best([one.way for one in sides[1]]) if sides[1] else []
        rivals = tuple(sides[1][index] for index in level)
        comparisons = [one for one in (_compared(spiking, rival) for rival in rivals) if one is not None]
        verdict = referee.judge(comparisons) if comparisons and len(comparisons) == len(rivals) else None
    chance = float(rows["chance"].mean()) if "chance" in rows and rows["chance"].notna().any() else None
    setting = setting_of(key, view)
    is_optimistic = any(str(value) in view.optimistic for value in key)
    return ProtocolAnswer(
        setting, rows_, best, cheapest, spiking, others, other, rivals, verdict, chance, is_validated, is_optimistic
    )


def _compared(one: Configuration | None, other: Configuration) -> Paired | None:
    """Their reported scores, by Welch's t test over rows; None if one of them has no error."""
    if one is None or math.isnan(one.error) or math.isnan(other.error):
        return None
    return compare_means((one.score, one.error, one.rows), (other.score, other.error, other.rows))


def _configuration(index: int, row: pd.Series, view: View, choice: str) -> Configuration:
    named = [column for column in view.by if column not in view.apart]
    parts = [str(row[column]) if isinstance(row[column], str) else f"{words(column)} {name_of(row[column])}"
             for column in named if row[column] != "-"]  # fmt: skip
    spent = {column: float(row[column]) for column in SPENT if column in row and column != view.cost}
    return Configuration(
        index,
        ", ".join(parts),
        name_of(row[named[0]]),
        float(row[choice]),
        _error(row, choice),
        float(row[view.score]),
        _error(row, view.score),
        float(row[view.cost]),
        int(row["rows"]),
        {column: value for column, value in spent.items() if not math.isnan(value)},
    )


def _error(row: pd.Series, measure: str) -> float:
    return float(row[f"{measure}_sd"]) / math.sqrt(row["rows"])


def headline(answer: ProtocolAnswer, view: View) -> str:
    """The result in one sentence: the verdict, and the numbers that it rests on."""
    said = verdict(answer)
    return f"{said}: {evidence(answer, view)}" if said else evidence(answer, view)


def verdict(answer: ProtocolAnswer) -> str:
    """The verdict of the headline, without its numbers; empty where there is nothing to compare."""
    if answer.spiking is None or answer.other is None:
        return ""
    if answer.verdict is None:
        return "A comparison of single rows, without an error"
    return {
        "better": "Spiking is more accurate",
        "worse": "Spiking costs accuracy",
        "tie": "No clear difference between spiking and the others",
    }[kind_of(answer)]


def evidence(answer: ProtocolAnswer, view: View) -> str:
    """The numbers of the headline."""
    guess = "" if answer.chance is None else f"; guessing reaches {_score(answer.chance, view)}"
    if answer.spiking is None or answer.other is None:
        return f"{_told(answer.best, view)} at {_cost(answer.best.cost, view)}{guess}."
    return f"{_told(answer.spiking, view)}; {_rivals(answer, view)}{guess}."


def figures(answer: ProtocolAnswer, view: View) -> list[Figure]:
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


def kind_of(answer: ProtocolAnswer) -> referee.Kind:
    """The verdict on spiking. A table with a more accurate row without spikes contradicts `better`: that is a tie."""
    assert answer.verdict is not None
    return "tie" if answer.verdict.kind == "better" and _unranked(answer) is not None else answer.verdict.kind


def _unranked(answer: ProtocolAnswer) -> Configuration | None:
    """A configuration without spikes that validation ranks lower, and whose score is at least that of spiking."""
    assert answer.spiking is not None
    lower = [one for one in answer.others if one not in answer.rivals and one.score >= answer.spiking.score]
    return max(lower, key=lambda one: one.score, default=None)


def _rivals(answer: ProtocolAnswer, view: View) -> str:
    """What spiking is compared with, in words."""
    assert answer.other is not None
    if answer.verdict is not None and answer.verdict.kind == "better" and (lower := _unranked(answer)) is not None:
        return f"{lower.name}, which validation ranks lower, has {_score(lower.score, view)}"
    if answer.verdict is not None and len(answer.rivals) > 1:
        worst, best = _ends(answer.rivals)
        return (
            f"{len(answer.rivals)} without spikes that validation cannot tell apart have {_score(worst.score, view)} "
            f"({worst.name}) to {_score(best.score, view)} ({best.name})"
        )
    return f"the best without spikes, {answer.other.name}, has {_score(answer.other.score, view)}"


def details(answer: ProtocolAnswer, view: View) -> Iterator[str]:
    """What the cheapest within the error saves, and what the reader must know of the choice, in sentences."""
    best, cheapest = answer.best, answer.cheapest
    rows = "validation" if answer.is_validated else "test"
    if math.isnan(best.choice_error):
        yield f"{best.name} has one row, so that its error is not known."
    elif cheapest.index == best.index:
        yield f"{best.name} is also the cheapest within its error ({_points(best.choice_error, view)} on {rows} rows)."
    else:
        yield (
            f"Within the error of {best.name} ({_points(best.choice_error, view)} on {rows} rows), {cheapest.name} is "
            f"the cheapest: {_saved(best, cheapest, view)}, {_lost(best, cheapest, view)}."
        )
    if not answer.is_validated:
        yield "The run holds no validation accuracy: the best is chosen by what is shown, which flatters it."
    if answer.is_optimistic:
        yield "Choices of this protocol saw test data, so that its accuracies flatter."


def table(answer: ProtocolAnswer, view: View) -> Table:
    """The best of each kind, the cheapest within the error, and guessing."""
    kinds: dict[str, Configuration] = {}
    for one in sorted(answer.configurations, key=lambda one: (math.isnan(one.chosen_by), -one.chosen_by)):
        kinds.setdefault(one.kind, one)
    shown = list(kinds.values())[:MOST_KINDS]
    shown += [one for one in _named(answer) if one not in shown]
    spent = [column for column in SPENT if any(column in one.spent for one in shown)]
    marks = ((answer.best, "best"), (answer.cheapest, "cheapest within its error"))
    rows = []
    for one in shown:
        said = " and ".join(word for of, word in marks if of.index == one.index)
        row = [f"{one.name}{': ' if said else ''}{said}", _with_error(one, view), count(one.cost)]
        rows.append([*row, *(count(one.spent[column]) if column in one.spent else "-" for column in spent)])
    if answer.chance is not None:
        rows.append(["guessing", _score(answer.chance, view), *[""] * (1 + len(spent))])
    least, most = (of(one.rows for one in shown) for of in (min, max))
    over = f"{least} to {most}" if least < most else f"{most}"
    what = (
        f"means over {over} rows of results.csv ± their standard error" if most > 1 else "one row of results.csv each"
    )
    setting = f", {answer.setting}" if answer.setting else ""
    chosen = ", chosen on validation rows" if answer.is_validated else ""
    caption = f"The best of each kind{setting}{chosen}: {what}."
    heads = ["configuration", view.measures[view.score], view.measures[view.cost], *(SPENT[column] for column in spent)]
    return Table(caption, heads, rows, n_heads=1)


def _named(answer: ProtocolAnswer) -> list[Configuration]:
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
        return "an unknown cost"
    head = view.measures[view.cost]
    what, _, unit = head.removesuffix(")").partition(" (")
    return f"{count(value)} {unit} ({what})" if unit and " " not in unit else f"{count(value)} {head}"


def _saved(before: Configuration, after: Configuration, view: View) -> str:
    both = f"{_cost(after.cost, view)} against {count(before.cost)}"
    return f"{100 * (1 - after.cost / before.cost):.0f} % less, {both}" if before.cost > 0 else both


def _lost(before: Configuration, after: Configuration, view: View) -> str:
    lost = before.score - after.score
    if abs(scale(view.measures[view.score]) * lost) < 0.05:
        return f"at the same score, {_score(after.score, view)}"
    return (
        f"and its score is {_points(abs(lost), view)} {'lower' if lost > 0 else 'higher'}, {_score(after.score, view)}"
    )


def as_json(all_answers: Sequence[ProtocolAnswer], view: View) -> dict[str, Any]:
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
