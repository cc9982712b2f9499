"""The report of trained networks: accuracy, spikes, synaptic operations, and the trade-off."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from neurotact import plugins
from neurotact.baselines import opponents
from neurotact.data.spikes import SpikeTrains
from neurotact.encoders.cost import NOT_COUNTED
from neurotact.errors import number_of
from neurotact.figures.columns import quantity
from neurotact.figures.encoding import Classes
from neurotact.figures.style import Drawn
from neurotact.files import write_json
from neurotact.metrics import referee
from neurotact.metrics.prices import NEURONS, WIDE
from neurotact.networks.use import ledger
from neurotact.networks.use.ledger import Afferents
from neurotact.progress import say
from neurotact.report import details, front, page, periods, robustness
from neurotact.report.encoding_drawings import encoding_drawings, name_classes, names_of
from neurotact.report.extra_drawings import extra_drawings
from neurotact.report.front import Front
from neurotact.report.network_drawings import network_drawings
from neurotact.report.page import Entry, Table, plain
from neurotact.report.tables import (
    afferents_of,
    extra_tables,
    first_spikes,
    in_words_of_split,
    key_in_words,
    tables_beside,
    with_pair,
    with_setting,
)
from neurotact.report.wording import count, percent, spread
from neurotact.spec import to_toml
from neurotact.studies import measures, store
from neurotact.studies import study as studies
from neurotact.studies.encoding_tables import read_encoding
from neurotact.studies.store import ANSWER, is_done
from neurotact.studies.study import (
    SPLIT,
    Cell,
    StudySpec,
    cells,
    encoder_columns,
    has_one_window,
    split_columns,
    swept_columns,
)
from neurotact.studies.way import HEADS
from neurotact.tables import over_seeds, read_table, size_of, write_table

DOWNLOADS = {
    "results.csv": "one row per trained network",
    "results.json": "the same",
    "sops.csv": "the SOP report: the cost of each network's decisions, also with early exit",
    "sops.json": "the same",
    "sops.md": "the same as a Markdown table",
    "encoding.csv": "firing of both populations for each class and condition, in the classified windows and over the "
    "whole touch",
    "searches.csv": "every trial of every cell's search",
    "selection.csv": "input and choice of each step of the selection",
    "answer.json": "the first screen of this report for programs",
    "baselines.csv": "classical classifiers on the same windows",
    "baselines_trials.csv": "the validation and test trials that each of them classifies correctly",
    "encoders.csv": "each encoder and refractory period: accuracies, signal given back, cost",
    "ledger.csv": "the cost of a decision: operations, memory, SOPs, an estimate of energy",
    "conditions.csv": "each network under each condition",
    "timings.csv": "time that each part of the study and each cell took",
    "study.toml": "the study as run, with all its specs",
    "versions.json": "versions of the software",
    "data.json": "the recordings' hash",
}
MEASURES = ["accuracy_validation", "accuracy_test", "sops_total", "exit_accuracy", "early_ms", "exit_sops_total"]
NAMES = ["pair", "setting"]
"""Columns that name a network in words; they are shown, and not written to files."""
EVERY = "every encoder"
"""What the page calls the answer of all encoders side by side, beside those of each."""
CALIBRATED = "Encoder, calibrated on the training trials of the first network"
NETWORK_COLUMNS = {
    "setting": "data set",
    "pair": "t_ref (ms)",
    "hidden": "N",
    "seed": "seed",
    "accuracy_validation": "validation accuracy (%)",
    "accuracy_test": "test accuracy (%)",
    "sops_total": "SOPs",
    "exit_accuracy": "accuracy with early exit (%)",
    "early_ms": "ms with early exit",
    "exit_sops_total": "SOPs with early exit",
}


class Steps(NamedTuple):
    """What a way whose cells are run in steps adds to the page, as far as it is known.

    n_cells: of all steps so far. shown: each step, with title, rule, outcome and table. tables: further ones, by name.
    best_row: the row that the page shows first. drawings: figures before the others. chosen: the rows of results and
    the cells that figures of networks are of.
    """

    n_cells: int
    shown: Sequence[Any] = ()
    tables: Mapping[str, pd.DataFrame] = {}
    best_row: int | None = None
    drawings: Sequence[Drawn] = ()
    chosen: tuple[pd.DataFrame, list[Cell]] | None = None


def write(
    study: StudySpec, folder: Path, steps: Callable[[pd.DataFrame, list[Cell], list[Cell]], Steps] | None = None
) -> Path:
    """Write `report.html`, its figures, `results.json` and the SOP report from the files of a run; the page's path.

    steps: of the results with the columns `pair` and `setting`, all cells, and those that are done.
    Raises InputError when `results.csv` or `encoding.csv` is missing or a claim names a missing column.
    """
    swept = swept_columns(study)
    results = with_setting(with_pair(read_table(folder / "results.csv"), study), study)
    encoding = with_pair(read_encoding(folder / "encoding.csv"), study)
    every = list(cells(study))
    done = [cell for cell in every if is_done(folder, cell)]
    trains = first_spikes(folder, done)
    classes = name_classes(encoding, trains.conditions if trains else None)
    course = steps(results, every, done) if steps else Steps(len(every))
    extra = extra_tables(study, folder)
    searches = plugins.load_function("tools", "searches_of")(study, folder, done, results) if study.search else None
    beside = tables_beside(study, folder)
    baselines, told_apart = beside.get("baselines"), (robustness.REMEDIES, measures.INTEGERS)
    beside |= {name: extra[name] for name in (measures.RECONSTRUCTION,) if name in extra}
    beside |= {name: with_setting(extra[name], study) for name in told_apart if name in extra}
    afferents, n_classes = afferents_of(folder, done), len(trains.classes) if trains else 0
    spent = front.costs_of(study, results, afferents, n_classes)
    fronts = list(front.fronts(study, folder, done, results.join(spent), trains, afferents, beside))
    cautions = front.beware(study, folder, done, fronts, trains)
    among = plugins.load_function("tools", "among_encoders")(study, fronts, results.join(spent), beside)
    shared = {"among": among.words, "tables": [among.table.as_json()]} if among and among.table else {}
    places = {str(file): store.RECORDINGS for file in [study.dataset.recordings] if file}
    places[str(folder.absolute())] = store.STUDY
    write_json(folder / ANSWER, _answers_as_json(fronts, cautions, places) | shared)
    shown = fronts[_first_shown(fronts)]
    of_best = shown.cells[shown.answer.rows.index(shown.answer.best)]
    best = of_best if course.best_row is None else course.best_row
    best = among.cell if among and among.cell is not None else best
    costs = _ledger(study, results, baselines, afferents, n_classes)
    left = {**course.tables}
    left |= {"encoders": among.every} if among else {}
    _write_tables(folder, study.title, results, swept, costs, left)
    if searches is not None and len(searches.trials):
        write_table(searches.trials.drop(columns=NAMES), folder / "searches.csv")
    test_trials = {one.setting: one.answer.trials.test for one in fronts}
    rows, of_rows = course.chosen or (results, done)
    levels = front.levels(fronts)
    return page.write(
        "networks.html.jinja",
        study,
        folder,
        n_done=len(results),
        n_cells=course.n_cells,
        tables={"results": results, "encoding": encoding, **extra, **left, **beside},
        figures=chain(
            course.drawings,
            encoding_drawings(study, trains, encoding, classes),
            network_drawings(study, folder, of_rows, rows.join(spent), classes, levels, test_trials),
            searches.drawings if searches else (),
            extra_drawings(study, results, extra, classes),
        ),
        downloads=DOWNLOADS | {f"{one.table}.csv": one.download for one in measures.requested(study.measures).values()},
        specs=_specs(study, trains),
        counted=_counted(results),
        compared=opponents.in_words(study.baselines if has_one_window(study) else "none"),
        fronts=fronts,
        first=_first_shown(fronts),
        cautions=cautions,
        among=among if among and among.table else None,
        every=EVERY,
        chosen=front.chosen(trains, done),
        seeds=study.sweep.get("seed", [0]),
        data=page.if_there(folder / "data.json"),
        selection=course.shown,
        networks=networks_table(results.join(spent), study),
        network_heads=[*network_columns(study).values()],
        means=means_table(results.join(spent), study),
        searches=searches.table if searches else None,
        conditions=[
            *robustness.tables(study, front.of_setting(beside, robustness.REMEDIES, shown.setting), shown.answer.best),
            *robustness.class_table(shown.classes, shown.answer.best),
        ],
        baselines=_baselines_table(baselines, study, front.in_integers(beside, shown.setting, shown.answer.best)),
        ledger=_ledger_table(costs),
        ledger_about=f"{ledger.ABOUT[study.encoding_in]} {study.prices.in_words()}",
        pair_word=periods.head(study),
        page=page.parts(
            _page_data(folder, done, results, spent, searches, classes, fronts, trains, among.drawn if among else {})
            | {"best": best, "pairWord": periods.head(study), "populations": names_of(study)},
            page.NETWORKS,
        ),
    )


def _counted(results: pd.DataFrame) -> str:
    """What a run has trained, in words.

    >>> _counted(pd.DataFrame({"pair": ["1&1", "5&5"], "hidden": [30, 30], "dataset": ["all"] * 2, "seed": [0, 0]}))
    '2 networks: 2 pairs of refractory periods, 1 size, 1 data set, 1 seed'
    """
    are_pairs = results["pair"].str.contains("&", regex=False).any()
    period = "pair of refractory periods" if are_pairs else "refractory period"
    axes = {"pair": period, "hidden": "size", "dataset": "data set", "seed": "seed"}
    results = results.assign(hidden=results.apply(size_of, axis=1))
    parts = [number_of(results[column].nunique(), word) for column, word in axes.items()]
    return f"{number_of(len(results), 'network')}: {', '.join(parts)}"


def _first_shown(fronts: Sequence[Front]) -> int:
    """The data set that the page shows first: that of the network with the highest accuracy on validation trials."""
    return referee.best_of([front.answer.best.way(front.answer.trials) for front in fronts])


def _write_tables(
    folder: Path,
    title: str,
    results: pd.DataFrame,
    swept: list[str],
    costs: pd.DataFrame | None,
    left: Mapping[str, pd.DataFrame],
) -> None:
    """The page's downloads besides the tables of the run."""
    write_table(results.drop(columns=NAMES), folder / "results.json")
    details.write_sops(details.sops_table(results, swept), folder, title)
    if costs is not None:
        write_table(costs, folder / "ledger.csv")
    for name, table in left.items():
        write_table(table, folder / f"{name}.csv")


def _page_data(
    folder: Path,
    done: list[Cell],
    results: pd.DataFrame,
    spent: pd.DataFrame,
    searches: Any,
    classes: Classes,
    fronts: Sequence[Front],
    trains: SpikeTrains | None,
    among: Mapping[str, Any],
) -> dict[str, Any]:
    """The data of the page's script; among: the picture of all encoders side by side, which comes first."""
    of_cells = details.cell_details(folder, done, classes)
    all_details = of_cells if len(of_cells) == len(results) else [{} for _ in range(len(results))]
    shown = [searches.of_cell(index) if searches else None for index in range(len(all_details))]
    all_details = [{**detail, "search": one} for detail, one in zip(all_details, shown, strict=True)]
    drawn = {EVERY: among} if among else {}
    drawn |= {one.setting: front.as_json(one) for one in fronts}
    step_ms = None if trains is None else 1e3 / trains.sampling_rate_Hz
    return {**details.page_data(results, spent, all_details, classes), "fronts": drawn, "stepMs": step_ms}


def _answers_as_json(fronts: Sequence[Front], cautions: Sequence[str], places: Mapping[str, str]) -> dict[str, Any]:
    """The first screen for programs: for each data set the answer in words and numbers, and the warnings.

    places: names that stand for paths in commands, so that these bytes do not depend on the place of the study.
    """
    return {
        "answers": [
            {
                **one.in_words(),
                "next": {"words": one.next[0], "commands": [store.moved(command, places) for command in one.next[1]]},
                "interval": list(one.answer.interval),
                "test_trials": one.answer.trials.test,
                **front.as_json(one),
            }
            for one in fronts
        ],
        "cautions": list(cautions),
    }


def means_table(results: pd.DataFrame, study: StudySpec) -> Table:
    """Means over seeds, and over splits where several were run, ± SD of each network."""
    measures = [measure for measure in MEASURES if measure in results]
    rows = [
        [str(row["setting"]), str(row["pair"]), size_of(row), str(row["seeds"])]
        + [spread(NETWORK_COLUMNS[measure], row[measure], row[f"{measure}_sd"]) for measure in measures]
        for _, row in over_seeds(results, measures).iterrows()
    ]
    columns = [
        "data set",
        f"{periods.head(study)} (ms)",
        "N",
        "trainings",
        *(NETWORK_COLUMNS[measure] for measure in measures),
    ]
    over = "seeds and splits" if any(str(column).startswith(SPLIT) for column in results) else "seeds"
    return Table(f"Means over {over} ± SD (n - 1)", columns, rows, n_heads=3)


def network_columns(study: StudySpec) -> dict[str, str]:
    """The columns of the table of networks and their heads: `NETWORK_COLUMNS`, and after the seed the swept split."""
    columns = {}
    for column, head in (NETWORK_COLUMNS | {"pair": f"{periods.head(study)} (ms)"}).items():
        columns[column] = head
        if column == "seed":
            columns |= {key: _head_of_split(key) for key in split_columns(study)}
    return columns


def _head_of_split(key: str) -> str:
    unit = quantity(key)[1]
    return f"{in_words_of_split(key)} ({unit})" if unit else in_words_of_split(key)


def networks_table(results: pd.DataFrame, study: StudySpec) -> list[list[Entry]]:
    """One row per trained network, with the columns of `network_columns`."""
    order = results[["t_ref_ra_ms", "t_ref_sa_ms"]].apply(tuple, axis=1).rank(method="dense")
    columns = list(network_columns(study))
    return [
        [
            Entry(
                spread(NETWORK_COLUMNS[column], row[column])
                if column in MEASURES
                else size_of(row)
                if column == "hidden"
                else str(row[column]),
                int(order[index]) if column == "pair" else plain(row[column]),
            )
            for column in columns
        ]
        for index, row in results.iterrows()
    ]


def _baselines_table(baselines: pd.DataFrame | None, study: StudySpec, own: float | None) -> Table | None:
    """The classical baselines as text; None if the study has none. own: of the best network in 8-bit integers."""
    if baselines is None:
        return None
    rows = [
        [
            f"{row['classifier']}",
            row["input"],
            periods.NONE if pd.isna(row["t_ref_ra_ms"]) else pair,
            row["dataset"],
            *(f"{100 * row[name]:.1f}" for name in ("accuracy_validation", "accuracy_test")),
            "not rounded" if pd.isna(narrow := row.get(f"accuracy_test{opponents.ROUNDED}")) else f"{100 * narrow:.1f}",
            "not counted" if pd.isna(row["flops"]) else f"{row['flops']:,.0f}",
            count(row["energy_estimate_nJ"]),
            row["settings"],
        ]
        for row, pair in zip(baselines.to_dict("records"), periods.of_rows(baselines, study), strict=True)
    ]
    heads = [
        "classifier", "input", f"{periods.head(study)} (ms)", "data set", "validation accuracy (%)",
        "test accuracy (%)", "with 8-bit weights (%)", "FLOPs", HEADS["energy_estimate_nJ"],
        "chosen on validation windows",
    ]  # fmt: skip
    windows = "the same windows" if has_one_window(study) else "the windows of the first network alone,"
    caption = f"Classifiers without spikes in their decision, on {windows} and the same split"
    if own is not None:
        caption += f"; the network of the answer with 8-bit weights has {percent(own)} on test windows"
    return Table(caption, heads, rows, n_heads=2)


def _ledger(
    study: StudySpec,
    results: pd.DataFrame,
    baselines: pd.DataFrame | None,
    afferents: Sequence[Afferents | None],
    n_classes: int,
) -> pd.DataFrame | None:
    """The cost of a decision; None without spikes, since the number of afferents is then unknown, or the rate at which
    their conditioning ran.
    """
    known = [one for one in afferents if one is not None]
    if study.network is None or len(known) < len(results):
        return None
    if not all(one.is_countable for one in known):
        say(f"report: {NOT_COUNTED}")
        return None
    if baselines is not None:
        baselines = baselines.assign(input=[*_inputs(baselines, study)])
    parts = []
    for model, rows in results.groupby("encoder", sort=False) if "encoder" in results else [(None, results)]:
        own = baselines
        if model is not None and baselines is not None:  # those on signals once, on spikes those of this encoder
            own = baselines[(baselines["encoder"] == model) | (baselines["encoder"].isna() & (not parts))]
        made_by = [known[index] for index in rows.index]
        how = {"afferents": made_by, "n_classes": n_classes, "prices": study.prices}
        how["encoding"] = study.encoding_in == "processor"
        table = ledger.study_ledger(study.network, rows, own, **how)
        parts.append(table if model is None else table.assign(name=f"{model}: " + table["name"]))
    return pd.concat(parts, ignore_index=True)


def _inputs(baselines: pd.DataFrame, study: StudySpec) -> Iterator[str]:
    """The input of each baseline with what a study sweeps of its encoder, by which its cost differs."""
    keys = [key for key in encoder_columns(study) if key in baselines and key != "encoder"]
    for row, pair in zip(baselines.to_dict("records"), periods.of_rows(baselines, study), strict=True):
        own = [periods.named(pair)] if pd.notna(row["t_ref_ra_ms"]) and pair != periods.NONE else []
        yield ", ".join([row["input"], *own, *(key_in_words(key, row[key]) for key in keys if pd.notna(row[key]))])


def _ledger_table(costs: pd.DataFrame | None) -> Table | None:
    if costs is None:
        return None
    parts = [name for name in costs if str(name).endswith("s_bytes") or str(name).startswith(WIDE)]
    shown = costs.drop(columns=["prices", *NEURONS, *parts])
    rows = [[row[0], *(count(value, 6) for value in row[1:])] for row in shown.itertuples(index=False, name=None)]
    return Table(
        "Operations and energy of each decision",
        ["decision by", *(HEADS[column] for column in shown.columns[1:])],
        rows,
        n_heads=1,
    )


def _specs(study: StudySpec, trains: SpikeTrains | None) -> dict[str, str]:
    """The study's parts as TOML; a calibrated encoder as found for the first cell."""
    parts = {name: getattr(study, name).model_dump(mode="json", exclude_none=True) for name in studies.PARTS}
    shown = {name.capitalize(): part for name, part in parts.items()}
    if study.calibrate and trains is not None:
        fitted = {CALIBRATED if name == "Encoder" else name: part for name, part in shown.items()}
        shown = fitted | {CALIBRATED: _given(trains.encoder)}
    return {name: to_toml(part) for name, part in shown.items()}


def _given(part: Mapping[str, Any]) -> dict[str, Any]:
    """A table without absent values, which TOML cannot express."""
    return {
        key: _given(value) if isinstance(value, Mapping) else value for key, value in part.items() if value is not None
    }
