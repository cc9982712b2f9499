"""The report of a protocol study: its configurations, their scores and their costs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from neurotact.figures.style import bars
from neurotact.report import page, protocol_answer
from neurotact.report.page import Entry, Table
from neurotact.report.protocol_answer import ProtocolAnswer, name_of, scale, words
from neurotact.spec import to_toml
from neurotact.studies import protocol_cell
from neurotact.studies.protocol import View, module_of
from neurotact.studies.protocol_study import ProtocolStudy, cells
from neurotact.studies.store import is_done
from neurotact.tables import means_over, read_table, write_table

DOWNLOADS = {
    "results.csv": "one row a run, with its accuracy and its costs",
    "results.json": "the same",
    "means.csv": "means and standard deviations of each configuration",
    "means.md": "the same as a Markdown table",
    "timings.csv": "time that each cell took",
    "study.toml": "the study as it was run, every parameter",
    "versions.json": "versions of what computed it",
    "data.json": "the hashes of the data",
}


class Front(NamedTuple):
    """What the first screen shows of one answer."""

    setting: str
    headline: str
    details: list[str]
    table: Table


LOG_FROM = 30.0
"""Costs that differ by more than this factor stand on a logarithmic axis."""


def write(study: ProtocolStudy, folder: Path) -> Path:
    """Write `report.html`, its figures, `results.json` and the means from what a run left; the page's path.

    Raises InputError when `results.csv` is not there or a claim names a column that is not there.
    """
    module = module_of(study.protocol)
    results = read_results(folder / "results.csv", module.VIEW)
    means = over_rows(results, module.VIEW)
    write_table(results, folder / "results.json")
    for suffix in (".csv", ".md"):
        write_table(means, folder / f"means{suffix}", f"# {study.title}\n\n{module.VIEW.note}")
    every = list(cells(study))
    arrays = protocol_cell.load_arrays(protocol_cell.arrays_path(folder, every[0]))
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
        answers=module.answers(results) if hasattr(module, "answers") else [],  # pyright: ignore
        **seen(means, module.VIEW, protocol_answer.answers(_with_choice(results, means, module.VIEW), module.VIEW)),
    )


def seen(means: pd.DataFrame, view: View, found: Sequence[ProtocolAnswer] = ()) -> dict[str, Any]:
    """What `protocol.html.jinja` shows of the means of `over_rows`: its answers, points and table, and their words."""
    return {
        "fronts": [
            Front(
                one.setting,
                protocol_answer.headline(one, view),
                list(protocol_answer.details(one, view)),
                protocol_answer.table(one, view),
            )
            for one in found
        ],
        "n_rows": int(means["rows"].sum()),
        "note": view.note,
        "cost": view.measures[view.cost],
        "score": view.measures[view.score],
        "heads": [*map(words, view.by), *view.measures.values()],
        "rows": _rows(means, view),
        "page": page.parts(_page_data(means, view) | {"fronts": protocol_answer.as_json(found, view)}, page.PROTOCOL),
    }


def read_results(path: Path, view: View) -> pd.DataFrame:
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
    choice = protocol_answer.VALIDATION
    if choice not in results or choice in means:
        return means
    found = means_over(results, view.by, [choice], "rows")
    return means.assign(**{column: found[column] for column in (choice, f"{choice}_sd")})


def _rows(means: pd.DataFrame, view: View) -> list[list[Entry]]:
    return [
        [Entry(name_of(row[column]), page.plain(row[column])) for column in view.by]
        + [_entry(head, row.get(measure), row.get(f"{measure}_sd")) for measure, head in view.measures.items()]
        for row in means.to_dict("records")
    ]


def _entry(head: str, mean: Any, sd: Any) -> Entry:
    """A mean and its spread as they are read; a head that ends in (%) asks for percent."""
    if mean is None or pd.isna(mean):
        return Entry("-", "")
    factor = scale(head)
    spread = 0.0 if sd is None or pd.isna(sd) else factor * float(sd)
    value = factor * float(mean)
    digits = 1 if factor > 1 else 0 if abs(value) >= 1000 else 2 if abs(value) >= 1 else 4
    whole = value == round(value) and factor == 1
    text = f"{value:,.0f}" if whole else f"{value:,.{digits}f}"
    return Entry(f"{text} ± {spread:,.{digits}f}" if spread else text, value)


def _page_data(means: pd.DataFrame, view: View) -> dict[str, Any]:
    """One point per configuration; series differ in what is named first beside the answer's setting."""
    factor = scale(view.measures[view.score])
    whole = 100.0 if factor > 1 else None
    named = [column for column in view.by if column not in view.apart]
    costs = means[view.cost].to_numpy(float)
    known = costs[np.isfinite(costs) & (costs > 0)]
    points = [
        {
            "name": ", ".join(f"{words(column)} {name_of(row[column])}" for column in view.by),
            "setting": protocol_answer.setting_of([row[column] for column in view.apart], view),
            "series": name_of(row[named[0]]),
            "x": _number(row[view.cost]),
            "y": _number(factor * row[view.score]),
            "bar": bars(factor * row[view.score], factor * row[f"{view.score}_sd"], whole)[:, 0].tolist(),
        }
        for row in means.to_dict("records")
    ]
    is_log = len(known) == len(costs) and len(known) > 0 and known.max() > LOG_FROM * known.min()
    axes = {"cost": view.measures[view.cost], "score": view.measures[view.score]}
    return {"points": points, **axes, "log": bool(is_log), "whole": whole}


def _number(value: float) -> float | None:
    return None if pd.isna(value) else float(value)
