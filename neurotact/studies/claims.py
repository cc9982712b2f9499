"""Published claims that are compared with our results: each has a rule in the study file.

A rule reads one column (`measure`) of one table of a run (`results.csv`, `encoding.csv` ...), averaged over the rows
that `where` selects. The tool `verdicts_on` judges it.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, model_validator

from neurotact.errors import nearest
from neurotact.figures.columns import in_unit, name_of, quantity
from neurotact.spec import Spec
from neurotact.studies import measures

LEVELS = ("value", "at_least", "at_most")
CONTRASTS = ("change", "equal")
TABLES = ("results", "encoding", "selection", "conditions")
"""The tables of studies that no measure brings."""


def _known(table: str) -> str:
    if table not in TABLES and table not in (of_measures := measures.tables()):
        raise ValueError(f"is no table; {nearest(table, [*TABLES, *sorted(of_measures)])}")
    return table


class Claim(Spec):
    """One published statement.

    kind `value`: the measure is within `tolerance` of `value`; the best over the columns `best_over`, if given.
    kind `at_least`, `at_most`: the measure does not fall below (rise above) `value`; with `each`, in no selected row.
    kind `change`: the measure changes from `against` to `where` in the direction of `value`, by `value` within
        `tolerance`, as a share of `against` when `relative`; computed for each combination of the other swept columns,
        then averaged. A change by 0 has no direction, so it holds without an effect too: use `equal`.
    kind `equal`: the 95 % interval of the change from `against` to `where`, over the rows that differ in nothing else,
        is within `tolerance` of 0.
    kind `order`: the measure falls along `order`, without ties; each place contains one or more selections.
    """

    name: str
    """Its name in the report."""
    source: str
    """Table or figure of the paper."""
    published: str
    """The paper's statement, as displayed."""
    kind: Literal["value", "at_least", "at_most", "change", "equal", "order"]
    """The rule, as above."""
    measure: str
    """The column of the table that the rule reads."""
    table: Annotated[str, AfterValidator(_known)] = "results"
    """The table with this column: `results`, `encoding`, `selection`, `conditions`, or that of a measure."""
    where: dict[str, Any] = {}
    """Columns and values that select rows."""
    against: dict[str, Any] = {}
    """With `change` and `equal`: selects the rows with which the rows of `where` are compared."""
    best_over: tuple[str, ...] = ()
    """Columns over which the best value is taken, such as the hidden size."""
    each: bool = False
    """With `at_least` and `at_most`: every selected row must satisfy the bound, not their mean."""
    relative: bool = False
    """With `change` and `equal`: as a share of `against`."""
    value: float | None = None
    """The published value, or bound."""
    tolerance: float | None = None
    """Maximum distance of the measure from `value`; with `equal`, of the change from 0."""
    order: tuple[tuple[dict[str, Any], ...], ...] = ()
    """With `order`: the selections, from the largest value to the smallest."""
    exchange: tuple[str, ...] = ()
    """Conditions among which values are exchanged, to see whether the rule holds without the effect; by default those
    in which the compared selections differ, or those of `where`. `equal` needs those that do change the measure."""
    fitted: str = ""
    """What was chosen so that the claim holds: then it is a fit, and not reproduced."""
    why: str = ""
    """One sentence, from evidence: why the study as shipped does not reproduce it."""

    @model_validator(mode="after")
    def _is_complete(self) -> "Claim":
        needed = {
            "value": ("value", "tolerance"),
            "change": ("value", "tolerance", "against"),
            "equal": ("tolerance", "against", "exchange"),
            "order": ("order",),
        }
        for key in needed.get(self.kind, ("value",)):
            if getattr(self, key) in (None, {}, ()):
                raise ValueError(f"a claim of kind '{self.kind}' needs '{key}'")
        if self.kind == "order" and (len(self.order) < 2 or not all(self.order)):
            raise ValueError("order: needs at least two places, each with at least one selection")
        return self

    @property
    def selections(self) -> list[dict[str, Any]]:
        """The conditions that the rule reads, or compares."""
        if self.kind == "order":
            return [{**self.where, **where} for place in self.order for where in place]
        return [self.where, self.against] if self.kind in CONTRASTS else [self.where]

    @property
    def exchanged(self) -> tuple[str, ...]:
        """The columns among whose values the measured values are exchanged."""
        one, *others = self.selections
        columns = dict.fromkeys(column for where in self.selections for column in where)
        differ = [c for c in columns if any(other.get(c) != one.get(c) for other in others)]
        return self.exchange or tuple(differ if others else columns)

    @property
    def rule(self) -> str:
        """The rule as a sentence, with the column that it reads in parentheses.

        >>> Claim(name="n", source="s", published="p", kind="at_least", measure="accuracy_test", value=0.9,
        ...       where={"pair": "1&1"}, best_over=("hidden",)).rule
        'The mean of test accuracy (accuracy_test) is at least 0.9 for t_ref 1&1 ms, at the best N'
        """
        what = f"{'Every value' if self.each else 'The mean'} of {name_of(self.measure)} ({self.measure})"
        if self.kind == "order":
            return f"{what} falls along {_chain(self.order)}{_for(self.where)}"
        value, tolerance = ("" if number is None else f"{number:,.8g}" for number in (self.value, self.tolerance))
        if self.kind in CONTRASTS:
            shared = {key: value for key, value in self.where.items() if self.against.get(key) == value}
            before, after = (
                _words({key: value for key, value in side.items() if key not in shared})
                for side in (self.against, self.where)
            )
            share = "the share " if self.relative else ""
            if self.kind == "equal":
                by = f"changes by less than {share}{tolerance}, as the 95 % interval says,"
            else:
                by = f"{'falls' if value.startswith('-') else 'rises'} by {share}{value.lstrip('-')} ± {tolerance}"
            return f"{what} {by} from {before} to {after}{_for(shared)}"
        bounds = {"value": f"{value} ± {tolerance}", "at_least": f"at least {value}"}
        best = f", at the best {' and '.join(map(_axis, self.best_over))}" if self.best_over else ""
        return f"{what} is {bounds.get(self.kind, f'at most {value}')}{_for(self.where)}{best}"


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
