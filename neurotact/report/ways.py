"""The report of a study of a way that is a module: its configurations, their scores and their costs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.figures.style import bars
from neurotact.files import write_json
from neurotact.report import first_screen, page, sentences, way_answer
from neurotact.report.front import Front
from neurotact.report.page import Entry, Table
from neurotact.report.way_answer import WayAnswer, name_of, words
from neurotact.report.wording import count, scale, spread
from neurotact.spec import to_toml
from neurotact.studies import way_cells
from neurotact.studies.store import ANSWER, is_done
from neurotact.studies.way import ALL_SETS, Listed, Named, View, module_of, optional
from neurotact.studies.way_study import WayStudy, cells
from neurotact.tables import means_over, read_table, write_table

DOWNLOADS = {
    "answer.json": "the first screen of this report for programs",
    "results.csv": "one row a run, with its accuracy and its costs",
    "results.json": "the same",
    "means.csv": "means and standard deviations of each configuration",
    "means.md": "the same as a Markdown table",
    "timings.csv": "time that each part of the study and each cell took",
    "study.toml": "the study as it was run, every parameter",
    "versions.json": "versions of what computed it",
    "data.json": "the hashes of the data",
}


FIRST_LOOK = "this is a first look, with fewer settings and seeds; run the whole study for an answer to build on"
LOG_FROM = 30.0
"""Costs that differ by more than this factor stand on a logarithmic axis."""


def write(study: WayStudy, folder: Path) -> Path:
    """Write `report.html`, its figures, `results.json` and the means from what a run left; the page's path.

    Raises InputError when `results.csv` is not there or a claim names a column that is not there.
    """
    module = module_of(study.way)
    results = _read_results(folder / "results.csv", module.VIEW)
    means = over_rows(results, module.VIEW)
    write_table(results, folder / "results.json")
    for suffix in (".csv", ".md"):
        write_table(means, folder / f"means{suffix}", f"# {study.title}\n\n{module.VIEW.note}")
    told = _told(study, results)
    found = way_answer.answers(_with_choice(results, means, module.VIEW), module.VIEW, results)
    shown = seen(means, module.VIEW, found, told.tables, told.named)
    write_json(folder / ANSWER, told.as_json(shown["fronts"]))
    every = list(cells(study))
    arrays = way_cells.load_arrays(folder / every[0].given)
    parameters = {key: value for key, value in study.parameters.items() if key != "data"}
    return page.write(
        "protocol.html.jinja",
        study,
        folder,
        n_done=sum(is_done(folder, cell) for cell in every),
        n_cells=len(every),
        tables={"results": results},
        figures=module.draw(results, arrays),
        downloads=DOWNLOADS,
        specs={"Parameters": to_toml(parameters), "Data": to_toml(study.parameters.get("data", {}))},
        seeds=study.sweep.get("seed", [study.parameters.get("seed", 0)]),
        data=page.if_there(folder / "data.json"),
        cautions=told.cautions,
        **shown,
    )


class _Told(NamedTuple):
    """What a way says of a run in words: answers by their setting, what makes them worth little, and their tables."""

    named: Mapping[str, Named]
    cautions: list[str]
    tables: dict[str, list[Table]]

    def as_json(self, fronts: Sequence[Front]) -> dict[str, Any]:
        """The first screen for programs: the sentences of the way where it has its own, else those of the fronts."""
        tables = self.tables if self.named else {front.setting: front.tables for front in fronts}
        return {
            "answers": [
                {
                    "dataset": name,
                    "headline": one.headline,
                    "details": [*one.details],
                    "next": {"words": one.next[0], "commands": [*one.next[1]]},
                }
                for name, one in self.named.items()
            ]
            or [front.in_words() for front in fronts],
            "tables": [table.as_json() | {"setting": name} for name, several in tables.items() for table in several],
            "cautions": self.cautions,
        }


def _told(study: WayStudy, results: pd.DataFrame) -> _Told:
    module = module_of(study.way)
    named, cautions, tables = (optional(module, name) for name in ("named", "cautions", "tables"))
    first_look = [FIRST_LOOK] if study.first_look else []
    return _Told(
        named(results) if named else {},
        first_look + (cautions(results) if cautions else []),
        {name: [_listed(one, module.VIEW) for one in several] for name, several in tables(results).items()}
        if tables
        else {},
    )


def _listed(what: Listed, view: View) -> Table:
    """A table of a way as text.

    >>> view = View((), {"accuracy": "accuracy (%)", "sops": "SOPs"}, "sops", "accuracy")
    >>> rows = pd.DataFrame({"way": ["pruning"], "accuracy": [0.9], "low": [0.8], "high": [1.02], "sops": [41234.0]})
    >>> _listed(Listed("the front", rows), view).rows
    [['pruning', '90.0 (80 to 100)', '41,200']]
    """
    columns = [column for column in what.rows if column not in ("low", "high")]
    heads = [view.measures.get(column, column) for column in columns]
    rows = [[_in_words(row, column, head, view) for column, head in zip(columns, heads, strict=True)]
            for row in what.rows.to_dict("records")]  # fmt: skip
    return Table(what.caption, heads, rows, 1, what.first)


def _in_words(row: Mapping[Any, Any], column: str, head: str, view: View) -> str:
    value, factor = row[column], scale(head)
    if isinstance(value, str):
        return value
    if pd.isna(value):
        return "-"
    text = f"{factor * value:.1f}" if factor > 1 else count(value)
    if column != view.score or pd.isna(row.get("low")):
        return text
    low, high = (min(max(factor * row[end], 0.0), factor) if factor > 1 else row[end] for end in ("low", "high"))
    return f"{text} ({low:.0f} to {high:.0f})" if factor > 1 else f"{text} ({count(low)} to {count(high)})"


def seen(
    means: pd.DataFrame,
    view: View,
    answers: Sequence[WayAnswer] = (),
    tables: Mapping[str, Sequence[Table]] = {},
    named: Mapping[str, Named] = {},
) -> dict[str, Any]:
    """What `protocol.html.jinja` shows of the means of `over_rows`: its answers, points and table, and their words.

    tables, named: of an answer by its setting, in place of the table of the best of each kind and of its sentences.
    """
    every = [answers[0]._replace(setting=ALL_SETS)] if ALL_SETS in named else []
    return {
        "fronts": [_front(one, tables.get(one.setting), named.get(one.setting)) for one in (*every, *answers)],
        "n_rows": int(means["rows"].sum()),
        "note": view.note,
        "costs": {column: view.measures[column] for column in _costs(means, view)},
        "score": view.measures[view.score],
        "heads": [*map(words, view.by), *view.measures.values()],
        "rows": _rows(means, view),
        "page": page.parts(_page_data(means, view, named) | {"fronts": _drawn(answers, named)}, page.PROTOCOL),
    }


def _drawn(answers: Sequence[WayAnswer], named: Mapping[str, Named]) -> dict[str, Any]:
    """What the page draws of each answer: best and cheapest point, guessing in the unit of the axis, what has names."""
    every = {ALL_SETS: {"named": named[ALL_SETS].what, "is_joined": True}} if ALL_SETS in named else {}
    return every | {
        one.setting: {
            "best": one.best.index,
            "cheapest": one.cheapest.index,
            "chance": _number(scale(one.measure.score) * one.guess),
            "named": named[one.setting].what if one.setting in named else "",
        }
        for one in answers
    }


def _read_results(path: Path, view: View) -> pd.DataFrame:
    """A run's results.csv, with a dash where what names a configuration is missing."""
    table = read_table(path)
    texts = [column for column in view.by if column in table and table[column].isna().any()]
    return table.assign(**{column: table[column].fillna("-") for column in texts})


def over_rows(results: pd.DataFrame, view: View) -> pd.DataFrame:
    """Means and standard deviations of each configuration, as `tables.means_over` gives them.

    >>> view = View(("kind",), {"accuracy": "accuracy (%)", "flops": "FLOPs"}, "flops", "accuracy")
    >>> rows = pd.DataFrame({"kind": ["elm", "elm"], "accuracy": [0.5, 1.0], "flops": [10, 10]})
    >>> over_rows(rows, view)[["kind", "rows", "accuracy", "flops"]].values.tolist()
    [['elm', 2, 0.75, 10.0]]
    """
    return means_over(results, view.by, [name for name in view.measures if name in results], "rows")


def _with_choice(results: pd.DataFrame, means: pd.DataFrame, view: View) -> pd.DataFrame:
    """The means with the validation accuracy by which an answer chooses, where the view does not show it."""
    choice = way_answer.VALIDATION
    if choice not in results or choice in means:
        return means
    spread = means_over(results, view.by, [choice], "rows")
    return means.assign(**{column: spread[column] for column in (choice, f"{choice}_sd")})


def _rows(means: pd.DataFrame, view: View) -> list[list[Entry]]:
    return [
        [Entry(name_of(row[column]), page.plain(row[column])) for column in view.by]
        + [_entry(head, row.get(measure), row.get(f"{measure}_sd")) for measure, head in view.measures.items()]
        for row in means.to_dict("records")
    ]


def _entry(head: str, mean: Any, sd: Any) -> Entry:
    return Entry("-", "") if mean is None or pd.isna(mean) else Entry(spread(head, mean, sd), scale(head) * float(mean))


def _front(one: WayAnswer, tables: Sequence[Table] | None, named: Named | None) -> Front:
    shown = tables or [first_screen.table_of_configurations(one)]
    if named is None:
        return Front(one.setting, one, first_screen.figures(one), [*sentences.details(one)], shown)
    return Front(one.setting, one, [], [*named.details], shown, told=named.headline, next=named.next)


def _page_data(means: pd.DataFrame, view: View, answers: Mapping[str, Named]) -> dict[str, Any]:
    """One point per configuration; series differ in what is named first beside the answer's setting.

    Where an answer names points, labels are by its setting those of each cost.
    """
    factor = scale(view.measures[view.score])
    whole = 100.0 if factor > 1 else None
    named = [column for column in view.by if column not in view.apart]
    costs = {column: view.measures[column] for column in _costs(means, view)}
    points = [
        {
            "name": ", ".join(f"{words(column)} {name_of(row[column])}" for column in view.by),
            "setting": way_answer.setting_of([row[column] for column in view.apart], view),
            "series": name_of(row[named[0]]),
            "costs": {column: _number(row[column]) for column in costs},
            "y": _number(factor * row[view.score]),
            "labels": _labels(row, view, answers),
            "bar": bars(factor * row[view.score], factor * row[f"{view.score}_sd"], whole)[:, 0].tolist(),
        }
        for row in means.to_dict("records")
    ]
    return {
        "points": points,
        "costs": costs,
        "score": view.measures[view.score],
        "log": [column for column in costs if _is_wide(means[column].to_numpy(float))],
        "whole": whole,
    }


def _labels(row: Mapping[Any, Any], view: View, answers: Mapping[str, Named]) -> dict[str, dict[str, str]]:
    """The names of a point by answer and cost, without costs by which it is not drawn, and answers that name none."""
    setting, found = way_answer.setting_of([row[column] for column in view.apart], view), {}
    for name, apart in ((setting, view.apart), (ALL_SETS, ())):
        key = tuple(str(row[column]) for column in view.by if column not in apart)
        if name in answers and (labels := answers[name].labels):
            found[name] = {cost: texts[key] for cost, texts in labels.items() if key in texts}
    return found


def _costs(means: pd.DataFrame, view: View) -> list[str]:
    """The columns that may stand on the axis of the cost: the view's own, then time and energy where there are any."""
    others = [column for column in way_answer.SPENT if column in view.measures and column in means]
    return list(dict.fromkeys([view.cost, *others]))


def _is_wide(costs: np.ndarray) -> bool:
    """Whether costs are all known and differ so much that they are read on a logarithmic axis."""
    known = costs[np.isfinite(costs) & (costs > 0)]
    return len(known) == len(costs) > 0 and bool(known.max() > LOG_FROM * known.min())


def _number(value: float) -> float | None:
    return None if pd.isna(value) else float(value)
