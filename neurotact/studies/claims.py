"""Published claims compared with our results: each has a rule in the study file, and a verdict.

A rule reads one column (`measure`) of one table of a run (`results.csv`, `encoding.csv` ...), averaged over the rows
that `where` selects.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import pandas as pd
from pydantic import model_validator

from neurotact.data.recordings import select_conditions
from neurotact.errors import InputError, nearest
from neurotact.figures.columns import in_unit, name_of, quantity
from neurotact.spec import Spec


class Claim(Spec):
    """One published statement.

    kind `value`: the measure is within `tolerance` of `value`; the best over the columns `best_over`, if given.
    kind `at_least`, `at_most`: the measure does not fall below (rise above) `value`; with `each`, in no selected row.
    kind `change`: the measure changes from `against` to `where` by `value` within `tolerance`, as a share of
        `against` when `relative`; computed for each combination of the other swept columns, then averaged.
    kind `order`: the measure falls (ties allowed) along `order`; each place contains one or more selections.
    """

    name: str
    """Its name in the report."""
    source: str
    """Table or figure of the paper."""
    published: str
    """The paper's statement, as displayed."""
    kind: Literal["value", "at_least", "at_most", "change", "order"]
    """The rule, as above."""
    measure: str
    """The column of the table that the rule reads."""
    table: Literal[
        "results", "encoding", "selection", "cut_short", "exit_curve", "conditions", "signals", "same_drive"
    ] = "results"
    """The table with this column."""
    where: dict[str, Any] = {}
    """Columns and values that select rows."""
    against: dict[str, Any] = {}
    """With `change`: selects the rows with which the rows of `where` are compared."""
    best_over: tuple[str, ...] = ()
    """Columns over which the best value is taken, such as the hidden size."""
    each: bool = False
    """With `at_least` and `at_most`: every selected row must satisfy the bound, not their mean."""
    relative: bool = False
    """With `change`: as a share of `against`."""
    value: float | None = None
    """The published value, or bound."""
    tolerance: float | None = None
    """Maximum distance of the measure from `value`."""
    order: tuple[tuple[dict[str, Any], ...], ...] = ()
    """With `order`: the selections, from the largest value to the smallest."""
    why: str = ""
    """One sentence, from evidence: why the study as shipped does not reproduce it."""

    @model_validator(mode="after")
    def _is_complete(self) -> "Claim":
        needed = {"value": ("value", "tolerance"), "change": ("value", "tolerance", "against"), "order": ("order",)}
        for key in needed.get(self.kind, ("value",)):
            if getattr(self, key) in (None, {}, ()):
                raise ValueError(f"a claim of kind '{self.kind}' needs '{key}'")
        if self.kind == "order" and (len(self.order) < 2 or not all(self.order)):
            raise ValueError("order: needs at least two places, each with at least one selection")
        return self

    @property
    def rule(self) -> str:
        """The rule as a sentence, with the column that it reads in parentheses.

        >>> Claim(name="n", source="s", published="p", kind="at_least", measure="accuracy_test", value=0.9,
        ...       where={"pair": "1&1"}, best_over=("hidden",)).rule
        'The mean of test accuracy (accuracy_test) is at least 0.9 for t_ref 1&1 ms, at the best N'
        """
        what = f"{'Every value' if self.each else 'The mean'} of {name_of(self.measure)} ({self.measure})"
        if self.kind == "order":
            return f"{what} falls, ties allowed, along {_chain(self.order)}{_for(self.where)}"
        value, tolerance = ("" if number is None else f"{number:,.8g}" for number in (self.value, self.tolerance))
        if self.kind == "change":
            shared = {key: value for key, value in self.where.items() if self.against.get(key) == value}
            before, after = (
                _words({key: value for key, value in side.items() if key not in shared})
                for side in (self.against, self.where)
            )
            by = f"{'the share ' if self.relative else ''}{value} ± {tolerance}"
            return f"{what} changes by {by} from {before} to {after}{_for(shared)}"
        bounds = {"value": f"{value} ± {tolerance}", "at_least": f"at least {value}"}
        best = f", at the best {' and '.join(map(_axis, self.best_over))}" if self.best_over else ""
        return f"{what} is {bounds.get(self.kind, f'at most {value}')}{_for(self.where)}{best}"


class Verdict(NamedTuple):
    """A claim, our figure as text, and whether it is reproduced; None when this run cannot decide."""

    claim: Claim
    ours: str
    reproduced: bool | None

    @property
    def why(self) -> str:
        """Why it is not reproduced; empty if it is, if this run cannot decide, or if the reason is unknown."""
        return self.claim.why if self.reproduced is False else ""


def judge(claim: Claim, tables: Mapping[str, pd.DataFrame]) -> Verdict:
    """The verdict on a claim from the tables of a run, by their names; an incomplete selection has no verdict.

    >>> results = pd.DataFrame({"pair": ["1&1", "5&5"], "accuracy_test": [0.9, 0.8], "seed": [0, 0]})
    >>> claim = Claim(name="1&1 is accurate", source="Fig. 11", published="90.2 %", kind="value",
    ...               measure="accuracy_test", where={"pair": "1&1"}, value=0.902, tolerance=0.02)
    >>> judge(claim, {"results": results})[1:]
    ('90 %', True)
    """
    if claim.table not in tables:
        return Verdict(claim, "not in this run", None)
    table = tables[claim.table]
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
    """The rows that `where` selects and that have a value: a silent population has no interval."""
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
    """Means for each combination of `by`; one mean if `by` is empty."""
    return pd.Series(rows.groupby(by)[measure].mean() if by else [rows[measure].mean()])


def _judge_level(claim: Claim, table: pd.DataFrame) -> Verdict:
    rows = _rows(table, claim, claim.where)
    measured, best = rows[claim.measure], ""
    if claim.best_over:
        means = rows.groupby(list(claim.best_over))[claim.measure].mean()
        ours, best = float(means.max()), f" at {', '.join(claim.best_over)} = {means.idxmax()}"
        if len(means) == 1:
            best += f", the only {'size' if claim.best_over == ('hidden',) else 'one'} run"
    elif claim.each:
        ours = float(measured.min() if claim.kind == "at_least" else measured.max())
    else:
        ours = float(measured.mean())
    assert claim.value is not None
    if claim.kind == "value":
        holds = abs(ours - claim.value) <= (claim.tolerance or 0.0)
    else:
        holds = ours >= claim.value if claim.kind == "at_least" else ours <= claim.value
    return Verdict(claim, f"{_figure(claim.measure, ours, 3)}{best}", holds)


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
    scale, unit = (
        (100.0, " %" if claim.relative else " points") if claim.relative or _is_share(claim.measure) else (1.0, "")
    )
    spread = f" ± {scale * change.std(ddof=0):.3g}" if len(change) > 1 else ""
    return Verdict(claim, f"{scale * ours:+.3g}{spread}{unit}", abs(ours - claim.value) <= (claim.tolerance or 0.0))


def _judge_order(claim: Claim, table: pd.DataFrame) -> Verdict:
    places = [[_mean(table, claim, {**claim.where, **where}) for where in group] for group in claim.order]
    falls = all(min(before) >= max(after) for before, after in pairwise(places))
    shown = " > ".join(", ".join(_figure(claim.measure, value, 4) for value in group) for group in places)
    return Verdict(claim, shown, falls)


def _figure(measure: str, value: float, digits: int) -> str:
    """A number as papers print it: shares in percent; whole numbers from 1000 on, in place of an exponent."""
    if _is_share(measure):
        return f"{100 * value:.{digits}g} %"
    return f"{value:,.0f}" if abs(value) >= 999.5 else f"{value:.{digits}g}"


def _is_share(measure: str) -> bool:
    """Whether a column contains shares of one, such as `accuracy_test`."""
    return bool({"accuracy", "error", "share"} & set(measure.split("_")))


def _for(where: dict[str, Any]) -> str:
    return f" for {_words(where)}" if where else ""


def _chain(order: tuple[tuple[dict[str, Any], ...], ...]) -> str:
    """The places of an order; words that all places share are written once."""
    pairs_alone = all(set(where) == {"pair"} for group in order for where in group)
    places = [" and ".join(str(where["pair"]) if pairs_alone else _words(where) for where in group) for group in order]
    return f"t_ref {' > '.join(places)} ms" if pairs_alone else " > ".join(places)


def _words(where: dict[str, Any]) -> str:
    return ", ".join(_word(column, value) for column, value in where.items())


def _word(column: str, value: Any) -> str:
    """A condition as the rule shows it; several values of one condition are alternatives."""
    if isinstance(value, (list, tuple)):
        value = " or ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in value)
    if column == "pair":
        return f"t_ref {value} ms"
    known = {"label": "class", "dataset": "data set", "hidden": "N ="}
    if column in known:
        return f"{known[column]} {value}"
    name, unit = quantity(column)
    return in_unit(column, value) if unit else f"{name} {value}"


def _axis(column: str) -> str:
    return {"hidden": "N", "pair": "t_ref pair"}.get(column, quantity(column)[0])
