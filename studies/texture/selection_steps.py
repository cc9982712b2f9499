"""The way `selection` in a report: each step's rule, table and outcome, and its figures."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from neurotact_parts.studies.texture import selection, selection_figures
from neurotact_parts.studies.texture.selection import Attempt, Course, Network, Rule, Selection

from neurotact.errors import number_of
from neurotact.figures.style import Drawn
from neurotact.report import networks as report
from neurotact.report.page import Table
from neurotact.studies import networks
from neurotact.studies.study import LENGTH, Cell, StudySpec
from neurotact.tables import over_seeds, sized


class Shown(NamedTuple):
    """A step: its title, its rule, its outcome, and its table; no table if it has not run yet."""

    title: str
    rule: str
    outcome: str
    table: Table | None


HEADS = {
    LENGTH: "window (ms)",
    "pair": "t_ref RA-I & SA-I (ms)",
    "hidden": "N",
    "networks": "networks",
    "accuracy_validation": "validation accuracy (%)",
    "sops_validation": "SOPs, validation windows",
    "verdict": "verdict",
    "accuracy_test": "test accuracy (%)",
    "sops_total": "SOPs, test windows",
    "exit_accuracy": "test accuracy, early exit (%)",
    "exit_steps": "steps, early exit",
    "exit_sops_total": "SOPs, early exit",
    "exit_saved": "SOPs saved (%)",
    "oracle_accuracy": "test accuracy, paper's exit (%)",
    "oracle_steps": "steps, paper's exit",
    "oracle_saved": "SOPs saved, paper's exit (%)",
    "window_steps": "steps of the window",
}
JUDGED = ("accuracy_validation", "sops_validation", "verdict", "accuracy_test", "sops_total")


def write(study: StudySpec, folder: Path) -> Path:
    """The page of a selection, as that of networks with its steps."""
    rule = selection.rule_of(study)

    def steps(results: pd.DataFrame, every: list[Cell], done: list[Cell]) -> report.Steps:
        course = selection.follow(rule, every, selection.in_folder(folder))
        known = report.Steps(len(course.digests), shown(course, rule))
        if (found := course.found) is None:
            return known
        return known._replace(
            tables={"selection": selection.as_table(found)},
            best_row=best_row(found, results),
            drawings=[*drawings(found, results, rule)],
            chosen=at_choice(found, results, done),
        )

    return report.write(study, folder, steps)


def shown(course: Course, rule: Rule) -> list[Shown]:
    """The steps of a selection; for an incomplete one, also the cells that it waits for."""
    if course.found is None:
        waiting = f"This step needs {number_of(len(course.due), 'cell')}; not all are done."
        return [Shown(course.steps[-1].name, "", waiting, None)]
    selection = course.found
    steps = [_lengths(selection, rule)]
    for attempt in selection.attempts:
        steps += [_networks(attempt, rule), _persistence(attempt)]
    return [
        step._replace(title=f"{number}. {step.title}")
        for number, step in enumerate([*steps, _exits(selection)], start=1)
    ]


def at_choice(course: Selection, results: pd.DataFrame, done: list[Cell]) -> tuple[pd.DataFrame, list[Cell]]:
    """The rows and the done cells at T_min, for the figures of networks."""
    rows = results[results[LENGTH] == course.last.length_ms]
    return rows, [cell for cell in done if cell.window.length_ms == course.last.length_ms]


def best_row(course: Selection, results: pd.DataFrame) -> int:
    """The row that the page shows first: the most accurate seed of the network with the fewest SOPs."""
    pair, hidden = course.last.chosen[0]
    own = (results["pair"] == pair) & (results["hidden"] == hidden) & (results[LENGTH] == course.last.length_ms)
    return int(results["accuracy_validation"].where(own, -1.0).to_numpy().argmax())


def drawings(course: Selection, results: pd.DataFrame, rule: Rule) -> Iterator[Drawn]:
    """Window lengths, the networks at T_min, and the selected networks over window lengths.

    results: a run's `results.csv` with the columns `pair` and `setting`.
    """
    first = results[results["pair"] == course.first_pair]
    sizes = over_seeds(first.assign(setting=first[LENGTH]), ["accuracy_validation", "sops_validation"])
    figure = selection_figures.draw_lengths(
        sizes.rename(columns={"setting": LENGTH}), course.lengths, rule.length_tolerance
    )
    outcome = _least_words(course)
    caption = (
        f"Validation accuracy and SOPs of each size (means over seeds) over window lengths, t_ref {course.first_pair} "
        f"ms, and the mean over sizes. {outcome} As the texture paper's Fig. 8, but on validation trials."
    )
    yield Drawn("selection-lengths", "The shortest accurate window", figure, caption, outcome)
    attempt = course.last
    figure = selection_figures.draw_choice(attempt.networks, rule.accuracy_tolerance)
    caption = (
        f"Every network at {attempt.length_ms:g} ms on validation trials (means over seeds); numbers are hidden sizes. "
        f"{_chosen_words(attempt)}"
    )
    yield Drawn("selection-choice", "The best trade-off", figure, caption, _chosen_words(attempt))
    table = attempt.persistence.assign(name=_names(attempt.persistence))
    order = [_name(network) for network in attempt.chosen]
    others = [name for name in dict.fromkeys(table["name"]) if name not in order]
    pairs = list(dict.fromkeys(attempt.networks["pair"]))
    figure = selection_figures.draw_persistence(table, [*order, *others], attempt.length_ms, pairs)
    caption = (
        "The selected networks"
        + (" and the most accurate one" if others else "")
        + " over window lengths, on validation "
        f"trials. {_persists_words(attempt)} As the texture paper's Fig. 13."
    )
    yield Drawn("selection-persistence", "Whether it persists", figure, caption, _persists_words(attempt))


def _lengths(course: Selection, rule: Rule) -> Shown:
    says = (
        f"T_min is the shortest window whose validation accuracy, the mean over sizes and seeds at t_ref "
        f"{course.first_pair} ms, is within {100 * rule.length_tolerance:g} points of the best length's."
    )
    table = _table(course.lengths, "Window lengths", (LENGTH, "networks", *JUDGED), 1)
    return Shown("Window length", says, _least_words(course), table)


def _networks(attempt: Attempt, rule: Rule) -> Shown:
    rest = f"; {rule.networks} in all, each with another t_ref pair" if rule.networks > 1 else ""
    says = (
        f"Among the networks whose mean validation accuracy over seeds is within {100 * rule.accuracy_tolerance:g} "
        f"points of the best, the one with the fewest SOPs on validation windows{rest}."
    )
    table = _table(attempt.networks, f"Networks at {attempt.length_ms:g} ms", ("pair", "hidden", *JUDGED), 2)
    return Shown(f"Trade-off at {attempt.length_ms:g} ms", says, _chosen_words(attempt), table)


def _persistence(attempt: Attempt) -> Shown:
    says = (
        f"A trade-off persists if the rule of the window length, applied to each selected network alone, gives "
        f"{attempt.length_ms:g} ms or less; else the next longer window is tried."
    )
    table = _table(attempt.persistence, "Window lengths of each network", ("pair", "hidden", LENGTH, *JUDGED), 3)
    return Shown(f"Persistence from {attempt.length_ms:g} ms", says, _persists_words(attempt), table)


def _exits(course: Selection) -> Shown:
    rows = course.last.networks[course.last.networks["chosen"]].sort_values("rank")
    rows = rows.assign(
        exit_saved=1 - rows["exit_sops_total"] / rows["sops_total"],
        oracle_saved=1 - rows["oracle_sops_total"] / rows["sops_total"],
    )
    says = (
        "The patience of early exit is the smallest that keeps the validation accuracy within the study's tolerance; "
        "the paper's own exit (its Algorithm 1), which uses the true label, is shown for comparison."
    )
    words = [
        f"{row['pair']}, {sized(row)} stops after "
        f"{course.last.length_ms * row['exit_steps'] / row['window_steps']:.0f} of {course.last.length_ms:g} ms "
        f"({row['exit_steps']:.0f} of {row['window_steps']:.0f} steps) and saves {100 * row['exit_saved']:.1f} % of "
        "the SOPs"
        for _, row in rows.iterrows()
    ]
    columns = (
        "pair", "hidden", "window_steps", "accuracy_test", "sops_total", "exit_accuracy", "exit_steps", "exit_saved",
        "oracle_accuracy", "oracle_steps", "oracle_saved",
    )  # fmt: skip
    table = _table(rows, f"Early exit of the selected networks, {course.last.length_ms:g} ms", columns, 2)
    return Shown("Early exit", says, f"{'; '.join(words)}.", table)


def _least_words(course: Selection) -> str:
    lengths = course.lengths
    chosen = lengths[lengths["chosen"]].iloc[0]
    best = lengths.loc[lengths["accuracy_validation"].idxmax()]
    return (
        f"T_min is {chosen[LENGTH]:g} ms: {100 * chosen['accuracy_validation']:.1f}; the best length, "
        f"{best[LENGTH]:g} ms, has {100 * best['accuracy_validation']:.1f} %."
    )


def _chosen_words(attempt: Attempt) -> str:
    networks = attempt.networks
    best = networks[networks["best"]].iloc[0]
    chosen = networks[networks["chosen"]].sort_values("rank")
    words = [
        f"{row['pair']}, {sized(row)} "
        f"({100 * (row['accuracy_validation'] - best['accuracy_validation']):+.1f} points, "
        f"{100 * (row['sops_validation'] / best['sops_validation'] - 1):+.0f} % SOPs)"
        for _, row in chosen.iterrows()
    ]
    return (
        f"Selected: {'; '.join(words)}, compared with the most accurate, {best['pair']}, {sized(best)} "
        f"({100 * best['accuracy_validation']:.1f} %). {int(networks['within'].sum())} of {len(networks)} networks are "
        "within the tolerance."
    )


def _persists_words(attempt: Attempt) -> str:
    words = [
        f"{_name(network)} {'keeps' if kept else 'does not keep'} {attempt.length_ms:g} ms"
        for network, kept in zip(attempt.chosen, attempt.persists, strict=True)
    ]
    return f"{'; '.join(words)}."


def _table(rows: pd.DataFrame, caption: str, columns: tuple[str, ...], n_heads: int) -> Table:
    if "verdict" in columns:
        rows = rows.assign(verdict=[_verdict(row) for _, row in rows.iterrows()])
    body = [[_text(column, row[column]) for column in columns] for _, row in rows.iterrows()]
    return Table(caption, [HEADS[column] for column in columns], body, n_heads)


def _verdict(row: pd.Series) -> str:
    if not row["within"]:
        return "not accurate enough"
    if row["chosen"]:
        return f"selected, {row['rank']:g}." if "rank" in row else "shortest"
    return "accurate enough"


def _text(column: str, value: object) -> str:
    if isinstance(value, str):
        return value
    number = float(value)  # pyright: ignore[reportArgumentType]
    if math.isnan(number) and ("sops" in column or column.endswith("_saved")):
        return "not counted"
    if "accuracy" in column or column.endswith("_saved"):
        return f"{100 * number:.1f}"
    return f"{number:,.0f}" if "sops" in column or "steps" in column else f"{number:g}"


def _name(network: Network) -> str:
    return f"{network.pair}, N = {network.hidden}"


def _names(table: pd.DataFrame) -> list[str]:
    return [_name(Network(pair, hidden)) for pair, hidden in zip(table["pair"], table["hidden"], strict=True)]


ENGINE = networks.ENGINE._replace(cells=selection.cells, steps=selection.steps, wanted=selection.wanted, report=write)
"""The entry point `selection` of the group `neurotact.ways`."""
