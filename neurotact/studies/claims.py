"""Published claims beside our results: each is a rule written in the study file, and its verdict.

A rule reads one column (`measure`) of `results.csv` or `encoding.csv`, averaged over the rows that `where` selects.
"""

from itertools import pairwise
from typing import Any, Literal, NamedTuple

import pandas as pd
from pydantic import model_validator

from neurotact.data.recordings import select_conditions
from neurotact.errors import InputError, nearest
from neurotact.spec import Spec


class Claim(Spec):
    """One published statement.

    kind `value`: the measure lies within `tolerance` of `value`; the best over the columns `best_over`, if given.
    kind `at_least`, `at_most`: the measure does not fall below (rise above) `value`; in no selected row, if `each`.
    kind `change`: the measure changes from `against` to `where` by `value` within `tolerance`, as a share of
        `against` when `relative`; formed for each combination of the other swept columns, then averaged.
    kind `order`: the measure falls (ties allowed) along `order`; each place holds one or more selections.
    """

    name: str
    source: str
    """Table or figure of the paper."""
    published: str
    """What the paper says, as it is shown."""
    kind: Literal["value", "at_least", "at_most", "change", "order"]
    measure: str
    table: Literal["results", "encoding"] = "results"
    where: dict[str, Any] = {}
    against: dict[str, Any] = {}
    best_over: tuple[str, ...] = ()
    each: bool = False
    relative: bool = False
    value: float | None = None
    tolerance: float | None = None
    order: tuple[tuple[dict[str, Any], ...], ...] = ()

    @model_validator(mode="after")
    def _is_complete(self) -> "Claim":
        needed = {"value": ("value", "tolerance"), "change": ("value", "tolerance", "against"), "order": ("order",)}
        for key in needed.get(self.kind, ("value",)):
            if getattr(self, key) in (None, {}, ()):
                raise ValueError(f"a claim of kind '{self.kind}' needs '{key}'")
        return self

    @property
    def rule(self) -> str:
        """The rule in words."""
        at = f", at {_words(self.where)}" if self.where else ""
        if self.kind == "order":
            places = [" and ".join(map(_words, place)) for place in self.order]
            return f"{self.measure} falls along {' > '.join(places)}{at}"
        if self.kind == "change":
            what = f"{'relative ' if self.relative else ''}change of {self.measure}"
            return f"{what} from {_words(self.against)} to {_words(self.where)}: {self.value} ± {self.tolerance}"
        bounds = {"value": f"{self.value} ± {self.tolerance}", "at_least": f">= {self.value}"}
        bound = bounds.get(self.kind, f"<= {self.value}")
        best = f", best over {' and '.join(self.best_over)}" if self.best_over else ""
        return f"{'every' if self.each else 'mean'} {self.measure}{at}{best}: {bound}"


class Verdict(NamedTuple):
    """A claim, our figure as text, and whether it is reproduced; None when this run cannot tell."""

    claim: Claim
    ours: str
    reproduced: bool | None


def judge(claim: Claim, results: pd.DataFrame, encoding: pd.DataFrame) -> Verdict:
    """Hold a claim against the tables of a run.

    >>> results = pd.DataFrame({"pair": ["1&1", "5&5"], "accuracy_test": [0.9, 0.8], "seed": [0, 0]})
    >>> claim = Claim(name="1&1 is accurate", source="Fig. 11", published="90.2 %", kind="value",
    ...               measure="accuracy_test", where={"pair": "1&1"}, value=0.902, tolerance=0.02)
    >>> judge(claim, results, results)[1:]
    ('0.9', True)
    """
    table = results if claim.table == "results" else encoding
    if claim.measure not in table:
        raise InputError(
            f"claim '{claim.name}': there is no column '{claim.measure}'; {nearest(claim.measure, list(table))}"
        )
    try:
        if claim.kind == "order":
            return _judge_order(claim, table)
        if claim.kind == "change":
            return _judge_change(claim, table)
        return _judge_level(claim, table)
    except _NotInThisRunError:
        return Verdict(claim, "not in this run", None)


class _NotInThisRunError(Exception):
    pass


def _rows(table: pd.DataFrame, claim: Claim, where: dict[str, Any]) -> pd.DataFrame:
    """The rows that `where` selects and that hold a value: a silent population has no interval."""
    unknown = [column for column in where if column not in table]
    if unknown:
        raise InputError(f"claim: there is no column '{unknown[0]}'; {nearest(unknown[0], list(table))}")
    measured = table[table[claim.measure].notna()]
    try:
        return measured[select_conditions(measured, where)]
    except InputError as error:
        raise _NotInThisRunError from error


def _mean(table: pd.DataFrame, claim: Claim, where: dict[str, Any]) -> float:
    return float(_rows(table, claim, where)[claim.measure].mean())


def _means(rows: pd.DataFrame, by: list[str], measure: str) -> pd.Series:
    """Means for each combination of `by`; one mean when there is none."""
    return pd.Series(rows.groupby(by)[measure].mean() if by else [rows[measure].mean()])


def _judge_level(claim: Claim, table: pd.DataFrame) -> Verdict:
    rows = _rows(table, claim, claim.where)
    measured, best = rows[claim.measure], ""
    if claim.best_over:
        means = rows.groupby(list(claim.best_over))[claim.measure].mean()
        ours, best = float(means.max()), f" at {', '.join(claim.best_over)} = {means.idxmax()}"
    elif claim.each:
        ours = float(measured.min() if claim.kind == "at_least" else measured.max())
    else:
        ours = float(measured.mean())
    assert claim.value is not None
    if claim.kind == "value":
        holds = abs(ours - claim.value) <= (claim.tolerance or 0.0)
    else:
        holds = ours >= claim.value if claim.kind == "at_least" else ours <= claim.value
    return Verdict(claim, f"{ours:.3g}{best}", holds)


def _judge_change(claim: Claim, table: pd.DataFrame) -> Verdict:
    fixed = {*claim.where, *claim.against, "seed", "pair", "t_ref_ra_ms", "t_ref_sa_ms"}
    others = [c for c in ("dataset", "hidden", "label") if c in table and c not in fixed]
    sides = (_rows(table, claim, where) for where in (claim.where, claim.against))
    after, before = (_means(rows, others, claim.measure) for rows in sides)
    difference = after - before
    change = (difference / before if claim.relative else difference).dropna()
    if change.empty:
        raise _NotInThisRunError
    assert claim.value is not None
    ours = float(change.mean())
    spread = f" ± {change.std(ddof=0):.3f}" if len(change) > 1 else ""
    return Verdict(claim, f"{ours:+.3f}{spread}", abs(ours - claim.value) <= (claim.tolerance or 0.0))


def _judge_order(claim: Claim, table: pd.DataFrame) -> Verdict:
    places = [[_mean(table, claim, {**claim.where, **where}) for where in place] for place in claim.order]
    falls = all(min(before) >= max(after) for before, after in pairwise(places))
    shown = " > ".join(", ".join(f"{value:.4g}" for value in place) for place in places)
    return Verdict(claim, shown, falls)


def _words(where: dict[str, Any]) -> str:
    return ", ".join(_word(value) if key == "pair" else f"{key} {_word(value)}" for key, value in where.items())


def _word(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return " or ".join(map(_word, value))
    return f"{value:g}" if isinstance(value, (int, float)) else str(value)
