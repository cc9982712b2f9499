"""Whether published claims are reproduced by a run.

A claim is reproduced only if its rule holds and would rarely hold without the effect: in the same table, with values
exchanged among the conditions (`exchange`), the rule holds as clearly in at most `ALPHA` of the arrangements.
So where nothing has an effect a claim is reproduced at most that often, whatever its rule (a permutation test: Fisher
1935, The Design of Experiments, Sec. 21).
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from enum import StrEnum
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.studies.exchange import arrangements, blocks_of, n_distinct
from scipy.stats import t

from neurotact.data.recordings import select_conditions
from neurotact.errors import InputError, nearest
from neurotact.metrics.paired import p_in_words
from neurotact.studies.claims import CONTRASTS, LEVELS, Claim

ALPHA = 0.05
"""A claim is reproduced if its rule holds without the effect at most this often."""
CLOSE = 1e-9
"""Numbers that differ by less, as a share of the largest, are equal."""
BASELINES = "baselines"
"""The table of opponents that are no networks; a claim that holds for them too says nothing about a network."""


class State(StrEnum):
    """What is known of a claim."""

    REPRODUCED = "reproduced"
    FAILS = "not reproduced"
    CHANCE = "holds without the effect too"
    BASELINE = "holds for a baseline too"
    FIT = "holds by a fit"
    FEW = "holds, in too few rows to tell"
    MISSING = "not in this run"


class Verdict(NamedTuple):
    """A claim, our figure as text, and its state.

    p: how often the rule holds as clearly without the effect; None when this run cannot decide.
    """

    claim: Claim
    ours: str
    state: State
    p: float | None = None

    @property
    def reproduced(self) -> bool | None:
        """Whether it is reproduced; None when this run cannot decide."""
        return None if self.state is State.MISSING else self.state is State.REPRODUCED

    @property
    def holds(self) -> bool:
        """Whether its rule holds, which alone shows nothing."""
        return self.state not in (State.FAILS, State.MISSING)

    @property
    def told(self) -> str:
        """The state in words, with p where it decided.

        >>> claim = Claim(name="n", source="s", published="p", kind="at_least", measure="accuracy_test", value=0.9)
        >>> Verdict(claim, "95 %", State.CHANCE, 0.4).told, Verdict(claim, "95 %", State.REPRODUCED, 0.0004).told
        ('holds without the effect too, p = 0.4', 'yes, p < 0.001')
        """
        words = {State.REPRODUCED: "yes", State.FAILS: "no"}.get(self.state, str(self.state))
        if self.state is State.FIT:
            words += f" of {self.claim.fitted}"
        if self.p is None or self.state not in (State.REPRODUCED, State.CHANCE):
            return words
        return f"{words}, {p_in_words(self.p)}"

    @property
    def why(self) -> str:
        """Why it is not reproduced; empty if its rule holds, if this run cannot decide, or if the reason is unknown."""
        return self.claim.why if self.state is State.FAILS else ""


def verdicts_on(claims: Iterable[Claim], tables: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """What the page of a run shows of a study's claims: the verdicts that it decides, their tally, and shared reasons.

    tables: of the run, by name. Raises InputError when a claim names a missing column.
    """
    judged = [judge(claim, tables) for claim in claims]
    verdicts = [verdict for verdict in judged if verdict.reproduced is not None]
    return {"verdicts": verdicts, "tally": tally(judged), "alpha": ALPHA, "reasons": _shared_reasons(verdicts)}


def tally(verdicts: list[Verdict]) -> str:
    """The number of reproduced claims, and of those in each other state whose rule holds, in words.

    >>> tally([])
    ''
    """
    if not verdicts:
        return ""
    counts = Counter(verdict.state for verdict in verdicts)
    missing = counts.pop(State.MISSING, 0)
    parts = [f"{counts[State.REPRODUCED]} of {len(verdicts) - missing} claims reproduced"]
    for state in (State.CHANCE, State.BASELINE, State.FIT, State.FEW):
        many = str(state).replace("holds", "hold", counts[state] != 1)
        parts += [f"{counts[state]} {many}"] if counts[state] else []
    parts += [f"{missing} need cells that this run does not hold"] if missing else []
    return "; ".join(parts)


def _shared_reasons(verdicts: Iterable[Verdict]) -> dict[str, int]:
    """The reasons shared by several claims that are not reproduced, numbered in the order of the claims."""
    given = Counter(verdict.why for verdict in verdicts if verdict.why)
    shared = (why for why, times in given.items() if times > 1)
    return {why: number for number, why in enumerate(shared, start=1)}


def judge(claim: Claim, tables: Mapping[str, pd.DataFrame]) -> Verdict:
    """The verdict on a claim from the tables of a run, by their names; an incomplete selection has no verdict.

    >>> pairs = ["1&1", "5&5"] * 5
    >>> accuracies = [0.9, 0.7, 0.92, 0.71, 0.91, 0.69, 0.9, 0.72, 0.92, 0.7]
    >>> results = pd.DataFrame({"pair": pairs, "accuracy_test": accuracies, "seed": [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]})
    >>> claim = Claim(name="1&1 is accurate", source="Fig. 11", published="90.2 %", kind="value",
    ...               measure="accuracy_test", where={"pair": "1&1"}, value=0.902, tolerance=0.01)
    >>> judge(claim, {"results": results})[1:]
    ('91 %', <State.REPRODUCED: 'reproduced'>, 0.03125)
    """
    if claim.table not in tables:
        return _missing(claim)
    table = tables[claim.table]
    if claim.measure not in table:
        raise InputError(
            f"claim '{claim.name}': there is no column '{claim.measure}'; {nearest(claim.measure, list(table))}"
        )
    try:
        pool = _pool(claim, table)
        cells = _cells(claim, pool)
        found = _without_the_effect(claim, pool, cells)
    except _NotInThisRunError:
        return _missing(claim)
    return Verdict(
        claim, _told(claim, cells, found.parts), _state(claim, found, tables), found.p if found.holds else None
    )


def _missing(claim: Claim) -> Verdict:
    return Verdict(claim, str(State.MISSING), State.MISSING)


def _state(claim: Claim, found: "_Found", tables: Mapping[str, pd.DataFrame]) -> State:
    if not found.holds:
        return State.FAILS
    if claim.fitted:
        return State.FIT
    if found.least > ALPHA:
        return State.FEW
    if found.p > ALPHA:
        return State.CHANCE
    return State.BASELINE if _holds_for_baselines(claim, tables) else State.REPRODUCED


class _NotInThisRunError(Exception):
    pass


class _Pool(NamedTuple):
    """The rows among which values are exchanged.

    rows: those that have a value: a silent population has no interval. selected: of each selection, its rows,
    `(selection, row)`. condition: of each row, from 0.
    """

    rows: pd.DataFrame
    selected: np.ndarray
    condition: np.ndarray


class _Cells(NamedTuple):
    """The groups of rows whose means a rule reads, `(cell, row)`, and the name of each."""

    members: np.ndarray
    names: list[str]


class _Found(NamedTuple):
    """A rule on our table: the means that it read, whether it holds, and p and its least possible value."""

    parts: np.ndarray
    holds: bool
    p: float
    least: float


def _pool(claim: Claim, table: pd.DataFrame) -> _Pool:
    columns = dict.fromkeys(column for where in claim.selections for column in where)
    unknown = [column for column in (*columns, *claim.exchange) if column not in table]
    if unknown:
        raise InputError(f"claim: there is no column '{unknown[0]}'; {nearest(unknown[0], list(table))}")
    measured = table[table[claim.measure].notna()]
    try:
        selected = np.array([select_conditions(measured, where) for where in claim.selections])
    except InputError as error:
        raise _NotInThisRunError from error
    if not (claim.exchanged and (claim.exchange or claim.kind in LEVELS)):
        among = selected.any(axis=0)
        _, condition = np.unique(selected[:, among], axis=1, return_inverse=True)
        return _Pool(measured[among], selected[:, among], condition.ravel())
    fixed = [{c: value for c, value in where.items() if c not in claim.exchanged} for where in claim.selections]
    among = np.any([select_conditions(measured, where) for where in fixed], axis=0)
    rows = measured[among]
    return _Pool(rows, selected[:, among], rows.groupby([*claim.exchanged], dropna=False).ngroup().to_numpy())


def _cells(claim: Claim, pool: _Pool) -> _Cells:
    """Of levels the selected rows, in groups of `best_over`; of contrasts all of `where`, then all of `against`."""
    if claim.kind == "order":
        return _Cells(pool.selected, [])
    if claim.kind in CONTRASTS:
        after, before = pool.selected
        groups = _groups(claim, pool)
        members = [[side & (groups == group) for group in np.unique(groups)] for side in (after, before)]
        pairs = [pair for pair in zip(*members, strict=True) if all(side.any() for side in pair)]
        if not pairs:
            raise _NotInThisRunError
        return _Cells(np.concatenate([*zip(*pairs, strict=True)]), [])
    (selected,) = pool.selected
    if claim.best_over:
        groups = pool.rows.groupby([*claim.best_over]).ngroup().to_numpy()
        members = selected & (groups == np.unique(groups[selected])[:, None])
        names = [pool.rows[rows][[*claim.best_over]].iloc[0].tolist() for rows in members]
        return _Cells(members, [", ".join(map(str, name)) for name in names])
    if claim.each:
        return _Cells(np.eye(len(selected), dtype=bool)[selected], [])
    return _Cells(pool.selected, [])


def _groups(claim: Claim, pool: _Pool) -> np.ndarray:
    """The group of each row within which the two sides of a contrast are compared."""
    if claim.kind == "equal":
        differ = {column for column, value in claim.where.items() if claim.against.get(column) != value}
        inside = pool.selected.any(axis=0)
        groups = np.zeros(len(pool.rows), dtype=int)
        groups[inside] = blocks_of(pool.rows[inside], pool.selected[0, inside].astype(int), {claim.measure, *differ})
        return groups
    fixed = {*claim.where, *claim.against, "seed", "pair", "t_ref_ra_ms", "t_ref_sa_ms"}
    others = [c for c in ("dataset", "hidden", "label") if c in pool.rows and c not in fixed]
    return pool.rows.groupby(others).ngroup().to_numpy() if others else np.zeros(len(pool.rows), dtype=int)


def _without_the_effect(claim: Claim, pool: _Pool, cells: _Cells) -> _Found:
    blocks = blocks_of(pool.rows, pool.condition, {claim.measure, *claim.exchanged})
    values = pool.rows[claim.measure].to_numpy(float)
    shares = (cells.members / cells.members.sum(axis=1, keepdims=True)).T
    arranged = arrangements(blocks)
    parts = values[arranged] @ shares
    if claim.kind in CONTRASTS and np.isnan(_changes(claim, parts[:1])).all():
        raise _NotInThisRunError
    ranks = _ranks(values, blocks)[arranged] @ shares
    holds, strength = _weigh(claim, parts, ranks)
    clear = float(np.mean(strength >= strength[0] - CLOSE * np.abs(strength[0])))
    if claim.kind == "equal" and len(cells.members) < 4:  # one difference has no interval
        return _Found(parts[0], bool(holds[0]), clear, 1.0)
    return _Found(parts[0], bool(holds[0]), clear, 1 / n_distinct(blocks, _classes(claim, pool, cells)))


def _ranks(values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Ranks within blocks."""
    return pd.Series(values).groupby(blocks).rank().to_numpy()


def _classes(claim: Claim, pool: _Pool, cells: _Cells) -> np.ndarray:
    """A number for each row; the rule reads rows with the same number alike."""
    members = pool.selected if claim.each else cells.members
    if claim.kind == "order":
        members = np.array([place.any(axis=0) for place in _places(claim, members)])
    return np.unique(members, axis=1, return_inverse=True)[1].ravel()


def _places(claim: Claim, cells: np.ndarray, axis: int = 0) -> list[np.ndarray]:
    """The cells of each place of an order, along `axis`."""
    return np.split(cells, np.cumsum([len(place) for place in claim.order])[:-1], axis=axis)


def _weigh(claim: Claim, parts: np.ndarray, ranks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the means that a rule reads, `(arrangement, cell)`: whether it holds, and how clearly.

    A change is the clearer the larger it is; an order the larger its least step in mean ranks, since its steps may
    differ by orders of magnitude. A level or an equality holds or does not: its tolerance is the claim.
    """
    close = CLOSE * (1.0 if claim.relative else np.abs(parts[0]).max())
    value, tolerance = claim.value or 0.0, (claim.tolerance or 0.0) + close
    if claim.kind == "order":
        return _least_step(claim, parts) > close, _least_step(claim, ranks)
    if claim.kind == "change":
        change = _mean(_changes(claim, parts))
        is_near, forward = np.abs(change - value) <= tolerance, np.sign(value) * change
        return (is_near & (forward > close), forward) if value else (is_near, is_near.astype(float))
    if claim.kind == "equal":
        middle, half = _interval(_changes(claim, parts))
        holds = np.abs(middle) + half <= tolerance
    else:
        ours = _level(claim, parts)
        holds = {
            "value": np.abs(ours - value) <= tolerance,
            "at_least": ours >= value - close,
            "at_most": ours <= value + close,
        }[claim.kind]
    return holds, holds.astype(float)


def _level(claim: Claim, parts: np.ndarray) -> np.ndarray:
    return parts.min(axis=1) if claim.each and claim.kind == "at_least" else parts.max(axis=1)


def _least_step(claim: Claim, parts: np.ndarray) -> np.ndarray:
    """The least distance from a place of an order to the next; negative where they overlap."""
    steps = pairwise(_places(claim, parts, axis=1))
    return np.min([before.min(axis=1) - after.max(axis=1) for before, after in steps], axis=0)


def _changes(claim: Claim, parts: np.ndarray) -> np.ndarray:
    after, before = np.split(parts, 2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (after - before) / before if claim.relative else after - before


def _mean(changes: np.ndarray) -> np.ndarray:
    """Means without what is no number, as 0 of 0."""
    known = ~np.isnan(changes)
    with np.errstate(invalid="ignore"):
        return np.where(known, changes, 0.0).sum(axis=1) / known.sum(axis=1)


def _interval(changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The middle and half the width of the 95 % interval of the mean; no width where there is one change."""
    middle, n = changes.mean(axis=1), changes.shape[1]
    if n < 2:
        return middle, np.zeros_like(middle)
    return middle, t.ppf(0.975, n - 1) * changes.std(axis=1, ddof=1) / np.sqrt(n)


def _holds_for_baselines(claim: Claim, tables: Mapping[str, pd.DataFrame]) -> bool:
    """Whether the rule holds in the rows of opponents, by the conditions that they have."""
    if BASELINES not in tables or claim.table != "results" or claim.measure not in tables[BASELINES]:
        return False
    table = tables[BASELINES].dropna(axis=1)
    if claim.measure not in table or (claim.kind not in LEVELS and not {*claim.exchanged} <= {*table}):
        return False
    where, against = ({c: v for c, v in side.items() if c in table} for side in (claim.where, claim.against))
    alike = claim.model_copy(update={"where": where, "against": against, "exchange": (), "best_over": ()})
    try:
        pool = _pool(alike, table)
        return _without_the_effect(alike, pool, _cells(alike, pool)).holds
    except _NotInThisRunError:
        return False


def _told(claim: Claim, cells: _Cells, parts: np.ndarray) -> str:
    """Our figures as text."""
    if claim.kind == "order":
        places = [[_figure(claim.measure, value, 4) for value in place] for place in _places(claim, parts)]
        return " > ".join(map(", ".join, places))
    if claim.kind in CONTRASTS:
        return _told_change(claim, _changes(claim, parts[None]))
    ours, best = float(_level(claim, parts[None])[0]), ""
    if claim.best_over:
        best = f" at {', '.join(claim.best_over)} = {cells.names[int(parts.argmax())]}"
        if len(parts) == 1:
            best += f", the only {'size' if claim.best_over == ('hidden',) else 'one'} run"
    return f"{_figure(claim.measure, ours, 3)}{best}"


def _told_change(claim: Claim, changes: np.ndarray) -> str:
    is_share = claim.relative or _is_share(claim.measure)
    scale, unit = (100.0, " %" if claim.relative else " points") if is_share else (1.0, "")
    n = changes.shape[1]
    if claim.kind == "equal" and n > 1:
        (middle,), (half,) = _interval(scale * changes)
        return f"{middle:+.3g} ({middle - half:.3g} to {middle + half:.3g}){unit}"
    spread = f" ± {scale * np.nanstd(changes):.3g}" if n > 1 else ""
    return f"{scale * _mean(changes)[0]:+.3g}{spread}{unit}"


def _figure(measure: str, value: float, digits: int) -> str:
    """A number as papers print it: shares in percent; whole numbers from 1000 on, in place of an exponent."""
    if _is_share(measure):
        return f"{100 * value:.{digits}g} %"
    return f"{value:,.0f}" if abs(value) >= 999.5 else f"{value:.{digits}g}"


def _is_share(measure: str) -> bool:
    """Whether a column contains shares of one, such as `accuracy_test`."""
    return bool({"accuracy", "error", "share"} & set(measure.split("_")))
