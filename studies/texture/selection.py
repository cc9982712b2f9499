"""The way `selection`: the network of the best trade-off, step by step, in the loop of the texture paper's Fig. 7.

1. The first pair of refractory periods, over all window lengths and sizes, gives T_min, the shortest window that is
   accurate enough.
2. All pairs and sizes at T_min give the networks of the best trade-off.
3. These networks over all window lengths show whether the trade-off persists: by the rule of step 1, they are also
   accurate enough at T_min. If one is not, the next longer window is tried from step 2 on.

Each step is a part of the study's sweep, which depends on the results of earlier steps. Only results on validation
trials decide (`Rule`). Early exit, the loop's last step, is measured in every cell.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from pydantic import Field

from neurotact.encoders.specs import t_ref_pair_ms
from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.spec import Spec, build
from neurotact.studies import study
from neurotact.studies.engine import Step
from neurotact.studies.store import is_done, result_of
from neurotact.studies.study import LENGTH, PAIR, SOURCE, Cell, StudySpec

JUDGED = ("accuracy_validation", "sops_validation")
"""Columns that decide the selection."""
SHOWN = (
    "accuracy_test", "sops_total", "exit_accuracy", "exit_steps", "exit_sops_total",
    "oracle_accuracy", "oracle_steps", "oracle_sops_total", "window_steps",
)  # fmt: skip
"""Columns that are shown for each network and do not affect the selection."""
Row = dict[str, Any]


class Rule(Spec):
    """How the best trade-off is selected: the `parameters` of such a study.

    All criteria use validation trials and means over seeds, and over swept keys of the simulation.
    """

    length_tolerance: float = Field(default=0.08, ge=0, lt=1)
    """T_min is the shortest window with an accuracy within this of the accuracy of the best length."""
    accuracy_tolerance: float = Field(default=0.08, ge=0, lt=1)
    """A network is accurate enough if it is within this of the best; of these, the fewest SOPs decide."""
    networks: int = Field(default=2, ge=1)
    """Networks to select, each with another pair of refractory periods."""


class Network(NamedTuple):
    """A pair of refractory periods in ms, RA-I first as in the paper, and a size."""

    pair: str
    hidden: int


class Attempt(NamedTuple):
    """Steps 2 and 3 at one window length.

    networks: of `by_network`. persistence: of `over_lengths`. persists: for each chosen network, in that order.
    """

    length_ms: float
    networks: pd.DataFrame
    persistence: pd.DataFrame
    persists: tuple[bool, ...]

    @property
    def chosen(self) -> list[Network]:
        """The selected networks, the fewest SOPs first."""
        return _networks(self.networks[self.networks["chosen"]])


class Selection(NamedTuple):
    """The loop's result: step 1 (of `by_length`, at the first pair), and every attempt; the last one is valid."""

    first_pair: str
    lengths: pd.DataFrame
    attempts: tuple[Attempt, ...]

    @property
    def last(self) -> Attempt:
        return self.attempts[-1]


class Course(NamedTuple):
    """The state of the loop: its steps, the cells that it needs next, and its result at the end."""

    steps: list[Step]
    due: list[Cell]
    found: Selection | None

    @property
    def digests(self) -> set[str]:
        """The digests of the cells of all steps so far; a cell may occur more than once."""
        return {cell.digest() for step in self.steps for cell in step.cells}


def rule_of(what: StudySpec) -> Rule:
    """The rule of a study; InputError for a wrong key, and for a sweep of something else."""
    swept = {axis for axis in what.sweep if axis != "seed" and not axis.startswith(SOURCE)}
    if swept != {LENGTH, PAIR, "network.hidden"}:
        raise InputError(
            f"selection needs a sweep of '{LENGTH}', '{PAIR}' and 'network.hidden'; beside them only seed and keys "
            f"of {SOURCE.rstrip('.')}, over which it averages"
        )
    if layered := [size for size in what.sweep["network.hidden"] if isinstance(size, list)]:
        raise InputError(f"selection compares sizes of one hidden layer; give a number in place of {layered[0]}")
    return build(Rule, what.parameters, source=f"parameters of {what.title}")


def cells(what: StudySpec) -> Iterator[Cell]:
    """All cells of the sweep, of which each step requests some."""
    rule_of(what)
    return study.cells(what)


def follow(rule: Rule, every: Sequence[Cell], row_of: Callable[[Cell], Row | None]) -> Course:
    """The loop as far as results are known.

    every: all cells of the sweep, in its order.
    row_of: returns a cell's row of results.csv, or None if the cell is not done.
    """
    course = _course(rule, every)
    steps = [next(course)]
    while True:
        rows = [row_of(cell) for cell in steps[-1].cells]
        known = [row for row in rows if row is not None]
        if len(known) < len(rows):
            return Course(steps, steps[-1].cells, None)
        try:
            steps.append(course.send(_frame(steps[-1].cells, known)))
        except StopIteration as end:
            return Course(steps, [], end.value)


def in_folder(folder: Path) -> Callable[[Cell], Row | None]:
    """A function that returns the row of a cell that is done in a run folder, otherwise None."""

    def row_of(cell: Cell) -> Row | None:
        return result_of(folder, cell)["row"] if is_done(folder, cell) else None

    return row_of


def steps(what: StudySpec, every: list[Cell], folder: Path) -> Iterator[Step]:
    """Each step in turn; its cells must be done in `folder` before the next step is requested."""
    rule = rule_of(what)
    while (course := follow(rule, every, in_folder(folder))).due:
        yield course.steps[-1]


def wanted(what: StudySpec, every: list[Cell], folder: Path) -> list[Cell]:
    """The cells of all steps so far."""
    digests = follow(rule_of(what), every, in_folder(folder)).digests
    return [cell for cell in every if cell.digest() in digests]


def by_length(rows: pd.DataFrame, rule: Rule) -> pd.DataFrame:
    """Step 1: means for each window length over sizes and seeds, from the shortest.

    Columns: window.length_ms, networks, those of JUDGED and SHOWN, within (the tolerance of the best), chosen.

    >>> rows = pd.DataFrame({LENGTH: [100.0, 150.0, 200.0], "accuracy_validation": [0.7, 0.9, 0.95]})
    >>> by_length(rows, Rule(length_tolerance=0.06))["chosen"].tolist()
    [False, True, False]
    """
    table = _means(rows, [LENGTH]).sort_values(LENGTH, ignore_index=True)
    accuracy = table["accuracy_validation"]
    within = is_within(accuracy, accuracy.max(), rule.length_tolerance)
    return table.assign(within=within, chosen=within & ~within.shift(fill_value=False).cummax())


def by_network(rows: pd.DataFrame, rule: Rule) -> pd.DataFrame:
    """Step 2: means for each pair and size over seeds, in the order of the sweep.

    Columns: pair, hidden, networks, those of JUDGED and SHOWN, within (the tolerance of the best), best, chosen, and
    rank (of the chosen ones by SOPs, from 1; 0 for others). Ties: the first one in the sweep.

    >>> rows = pd.DataFrame({"pair": ["1&1", "5&5", "5&5"], "hidden": [30, 30, 40], "sops_validation": [9e3, 6e3, 7e3],
    ...                      "accuracy_validation": [0.9, 0.85, 0.84]})
    >>> by_network(rows, Rule())["rank"].tolist()
    [2, 1, 0]
    """
    table = _means(rows, ["pair", "hidden"])
    accuracy = table["accuracy_validation"]
    within = is_within(accuracy, accuracy.max(), rule.accuracy_tolerance)
    cheapest = table[within].sort_values("sops_validation", kind="stable").drop_duplicates("pair")
    ranks = {index: rank for rank, index in enumerate(cheapest.index[: rule.networks], start=1)}
    rank = pd.Series(ranks, dtype=int).reindex(table.index, fill_value=0)
    best = table.index == accuracy.idxmax()
    return table.assign(within=within, best=best, chosen=rank > 0, rank=rank)


def over_lengths(rows: pd.DataFrame, rule: Rule) -> pd.DataFrame:
    """Step 3: for each network, its means over seeds at each window length, judged as in step 1.

    Columns: pair, hidden, then those of `by_length`.
    """
    parts = []
    for (pair, hidden), own in rows.groupby(["pair", "hidden"], sort=False):
        table = by_length(own, rule)
        table.insert(0, "pair", pair)
        table.insert(1, "hidden", hidden)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def as_table(selection: Selection) -> pd.DataFrame:
    """All steps as `selection.csv`: one row per window length, network, or network and window length.

    Columns: step (`window length`, `trade-off`, `persistence`, with `, not kept` for attempts that were rejected; and
    `choice`, the selected networks), window.length_ms, pair, hidden (empty where all sizes are averaged), networks
    (trained networks in the means), those of JUDGED and SHOWN, within, best, chosen, rank, persists, and the share of
    steps that early exit runs: exit_share, oracle_share (by the paper's own rule, which knows the true label).
    """
    start = selection.lengths.assign(step="window length", pair=selection.first_pair)
    parts = [start]
    for attempt in selection.attempts:
        kept = "" if attempt is selection.last else ", not kept"
        trade = attempt.networks.assign(step=f"trade-off{kept}", **{LENGTH: attempt.length_ms})
        parts += [trade, attempt.persistence.assign(step=f"persistence{kept}")]
    choice = trade[trade["chosen"]].sort_values("rank").assign(step="choice", persists=list(selection.last.persists))
    table = pd.concat([*parts, choice], ignore_index=True)
    for rule in ("exit", "oracle"):
        table[f"{rule}_share"] = table[f"{rule}_steps"] / table["window_steps"]
    table["hidden"] = table["hidden"].astype("Int64")
    table["rank"] = table["rank"].astype("Int64")
    flags = {flag: table[flag].astype("boolean").astype("Int64") for flag in ("within", "best", "chosen", "persists")}
    first = ["step", LENGTH, "pair", "hidden", "networks"]
    return table.assign(**flags)[[*first, *(column for column in table if column not in first)]]


def _course(rule: Rule, every: Sequence[Cell]) -> Generator[Step, pd.DataFrame, Selection]:
    """Yield each step and receive the rows of its cells; return the result at the end."""
    start = _network(every[0]).pair
    rows = yield Step(f"window lengths at {start}", [cell for cell in every if _network(cell).pair == start])
    lengths = by_length(rows, rule)
    at_least_ms = float(lengths[LENGTH][lengths["chosen"]].iloc[0])
    attempts = []
    for length_ms in lengths[LENGTH][lengths[LENGTH] >= at_least_ms]:
        here = f"{length_ms:g} ms"
        rows = yield Step(f"trade-off at {here}", [cell for cell in every if cell.window.length_ms == length_ms])
        networks = by_network(rows, rule)
        watched = {*_networks(networks[networks["chosen"] | networks["best"]])}
        rows = yield Step(f"persistence from {here}", [cell for cell in every if _network(cell) in watched])
        table = over_lengths(rows, rule)
        attempt = Attempt(float(length_ms), networks, table, ())
        persists = tuple(_least_ms(table, network) <= length_ms for network in attempt.chosen)
        attempts.append(attempt._replace(persists=persists))
        if all(persists):
            break
    return Selection(start, lengths, tuple(attempts))


def _means(rows: pd.DataFrame, by: list[str]) -> pd.DataFrame:
    groups = rows.groupby(by, sort=False)
    measures = [measure for measure in (*JUDGED, *SHOWN) if measure in rows]
    return groups[measures].mean().assign(networks=groups.size()).reset_index()


def _least_ms(table: pd.DataFrame, network: Network) -> float:
    """The window length that the rule of step 1 selects for a network."""
    own = table[(table["pair"] == network.pair) & (table["hidden"] == network.hidden)]
    return float(own[LENGTH][own["chosen"]].iloc[0])


def _networks(table: pd.DataFrame) -> list[Network]:
    """The networks of a table of step 2, the chosen ones first, by their rank."""
    ordered = table.assign(last=table["rank"] == 0).sort_values(["last", "rank"], kind="stable")
    return [Network(str(pair), int(hidden)) for pair, hidden in zip(ordered["pair"], ordered["hidden"], strict=True)]


def _network(cell: Cell) -> Network:
    assert cell.network is not None
    sa_ms, ra_ms = t_ref_pair_ms(cell.encoder)
    return Network(f"{ra_ms:g}&{sa_ms:g}", cell.network.joined_hidden)


def _frame(done: list[Cell], rows: list[Row]) -> pd.DataFrame:
    named = [{"pair": _network(cell).pair, LENGTH: cell.window.length_ms} for cell in done]
    return pd.DataFrame([{**row, **name} for row, name in zip(rows, named, strict=True)])
