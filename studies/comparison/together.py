"""All ways to save together, and each of them taken away again: what does a way still save when all else is saved?

Validation accuracy chooses: of each way the setting with the least energy that keeps the accuracy; then one way after
the other, the one that saves most first, each of which stays if all that stay keep the accuracy together.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd
from neurotact_parts.studies.comparison.fronts import COSTS, ENERGY, NOTHING, SOPS, in_signs, interval_of, not_learned
from neurotact_parts.studies.comparison.saving import Setting

from neurotact.metrics.decision import is_within
from neurotact.studies.way import Listed

TOGETHER = "together"
WITHOUT = f"{TOGETHER} without "
KEEPING = "what keeps the accuracy"
"""The setting of these ways in results: it differs from seed to seed, and the column `TOGETHER` says what it is."""
LOSS = 0.01
"""Accuracy on validation windows that may be lost."""
CLOCKS = {"step_ms", "longest_steps"}
"""Keys of one clock, of which a setting has one."""


class Part(NamedTuple):
    """A way, and its setting as keys of a `Setting`."""

    way: str
    keys: Mapping[str, Any]


def parts_of(tried: Sequence[tuple[str, Setting]], rows: Sequence[Mapping[str, Any]]) -> list[Part]:
    """Of each way the setting with the least energy that keeps the accuracy, the way that saves most first.

    A way whose keys another one has already is left out. tried, rows: in the same order; the first saves nothing.

    >>> ways = [("nothing saved", Setting()), ("slower clock", Setting(step_ms=5)), ("hidden", Setting(hidden=0.5))]
    >>> found = [(0.9, 9.0), (0.9, 6.0), (0.8, 3.0)]
    >>> rows = [{"accuracy_validation": share, "energy_estimate_nJ": energy} for share, energy in found]
    >>> parts_of(ways, rows)
    [Part(way='slower clock', keys={'step_ms': 5.0})]
    """
    base, *others = rows
    saving = sorted(
        (row[ENERGY], number)
        for number, row in enumerate(others, 1)
        if row[ENERGY] < base[ENERGY] and is_within(row["accuracy_validation"], base["accuracy_validation"], LOSS)
    )
    parts: list[Part] = []
    for _, number in saving:
        way, setting = tried[number]
        keys, taken = setting.model_dump(exclude_defaults=True), {key for part in parts for key in part.keys}
        clash = taken & {*keys} or (CLOCKS & taken and CLOCKS & {*keys})
        if not clash and way not in {part.way for part in parts}:
            parts.append(Part(way, keys))
    return parts


def joined(parts: Sequence[Part]) -> Setting:
    """The setting of several ways.

    >>> joined([Part("slower clock", {"step_ms": 5.0}), Part("hidden", {"hidden": 0.5})]).hidden
    0.5
    """
    return Setting(**{key: value for part in parts for key, value in part.keys.items()})


def rows_of(
    tried: Sequence[tuple[str, Setting]],
    rows: Sequence[Mapping[str, Any]],
    measure: Callable[[Setting], dict[str, Any]],
    named: Callable[[Setting], str],
) -> Iterator[dict[str, Any]]:
    """The row of all ways together, and one without each; none where no two ways keep the accuracy together."""

    def row(way: str, used: Sequence[Part]) -> dict[str, Any]:
        setting = joined(used)
        return {"way": way, "setting": KEEPING, **measure(setting), TOGETHER: named(setting)}

    kept: list[Part] = []
    whole: dict[str, Any] = {}
    for part in parts_of(tried, rows):
        more = row(TOGETHER, [*kept, part]) if kept else {}
        if not kept or is_within(more["accuracy_validation"], rows[0]["accuracy_validation"], LOSS):
            kept, whole = [*kept, part], more
    if not whole:
        return
    yield whole
    for part in kept:
        yield row(f"{WITHOUT}{part.way}", [other for other in kept if other is not part])


def alone(results: pd.DataFrame) -> pd.DataFrame:
    """The rows of single ways."""
    return results[~results["way"].str.startswith(TOGETHER)]


def shown(results: pd.DataFrame) -> pd.DataFrame:
    """The rows of single ways, and of all together where each seed has them: a mean over fewer is of other splits."""
    seeds, of_set = (results.groupby(of)["seed"].transform("nunique") for of in (["set", "way"], ["set"]))
    is_short = (results["way"] == TOGETHER) & (seeds < of_set)
    return results[~(results["way"].str.startswith(WITHOUT) | is_short)]


def labels(results: pd.DataFrame, cost: str) -> dict[tuple[str, str], str]:
    """The name in a picture of all ways together, of one set; empty without them."""
    base, mine = results[results["way"] == NOTHING], shown(results)
    mine = mine[mine["way"] == TOGETHER]
    if mine.empty or base.empty:
        return {}
    return {(TOGETHER, KEEPING): f"all together {in_signs(_left(mine, base, cost), _lost(mine, base).mean())}"}


def answers(results: pd.DataFrame) -> list[str]:
    """A sentence for each set: what all ways together cost and save; none where nothing was learned."""
    several, found = results["set"].nunique() > 1, []
    for name, rows in results.groupby("set", sort=False):
        base, mine = rows[rows["way"] == NOTHING], rows[rows["way"] == TOGETHER]
        if len(mine) and len(base) and not not_learned(base):
            said = f"all ways together {_words(mine, base)}."
            found.append(f"{name}: {said}" if several else f"{said[0].upper()}{said[1:]}")
    return found


def listed(results: pd.DataFrame) -> Iterator[Listed]:
    """What is left with all ways together, and without each of them, of one set."""
    base = results[results["way"] == NOTHING]
    parts = [(way, part) for way, part in results.groupby("way", sort=False) if str(way).startswith(TOGETHER)]
    if parts and len(base):
        table = pd.DataFrame([
            {"ways": way, "seeds": len(part), "lost (points)": f"{100 * _lost(part, base).mean():.1f}",
             **{f"{called.unit} left": f"{100 * _left(part, base, cost):.0f} %" for cost, called in COSTS.items()}}
            for way, part in parts
        ])  # fmt: skip
        yield Listed(
            "All ways together: of each way the setting with the least energy that loses at most "
            f"{100 * LOSS:g} point of validation accuracy. Without a way, all others stay: what it still saves is the "
            "difference from the first row.",
            table,
        )


def _left(part: pd.DataFrame, base: pd.DataFrame, cost: str) -> float:
    return float(part[cost].mean() / base.loc[base["seed"].isin(part["seed"]), cost].mean())


def _lost(part: pd.DataFrame, base: pd.DataFrame) -> pd.Series:
    """Test accuracy that is lost, seed by seed."""
    return base.set_index("seed")["accuracy_test"].sub(part.set_index("seed")["accuracy_test"]).dropna()


def _words(part: pd.DataFrame, base: pd.DataFrame) -> str:
    lost = interval_of(_lost(part, base).to_numpy(), part)
    within = "" if pd.isna(lost.low) else f" ({100 * lost.low:.1f} to {100 * lost.high:.1f})"
    left = " and ".join(f"{100 * _left(part, base, cost):.0f} % of the {COSTS[cost].called}" for cost in (SOPS, ENERGY))
    return f"lose {100 * lost.mean:.1f} points{within} and leave {left}"
