"""The report of a study: its figures and one HTML file that opens anywhere, offline."""

from base64 import b64encode
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from neurotact.data.columns import in_unit, quantity
from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.export.encoding_figures import Classes
from neurotact.export.network_figures import over_seeds
from neurotact.export.style import Drawn, save
from neurotact.export.tables import write_table
from neurotact.files import existing, read_json, write_text
from neurotact.spec import to_toml
from neurotact.studies import ledger, report_cells, report_page, report_search, report_selection, selection
from neurotact.studies import study as studies
from neurotact.studies.cell import is_done
from neurotact.studies.claims import Verdict, judge
from neurotact.studies.preparation import spikes_path
from neurotact.studies.report_encoding import encoding_drawings, name_classes
from neurotact.studies.report_extra import extra_drawings
from neurotact.studies.report_networks import network_drawings
from neurotact.studies.report_page import Table
from neurotact.studies.selection import Selection
from neurotact.studies.study import Cell, StudySpec, cells, swept_columns

DOWNLOADS = {
    "results.csv": "one row a trained network",
    "results.json": "the same",
    "sops.csv": "the SOP report: what each network's decisions cost, and with early exit",
    "sops.json": "the same",
    "sops.md": "the same, to be read",
    "encoding.csv": "firing of both populations for each class and condition",
    "searches.csv": "every trial of every cell's search",
    "selection.csv": "what each step of the selection saw and chose",
    "baseline.csv": "the linear classifier",
    "ledger.csv": "what a decision costs: operations, memory, SOPs, an estimate of energy",
    "cut_short.csv": "each network on the first so many ms of its windows",
    "exit_curve.csv": "each network with early exit, over patience",
    "conditions.csv": "each network under each condition",
    "signals.csv": "amplitude and principal frequency of the signals",
    "same_drive.csv": "spikes of an afferent under the same drive, over refractory periods",
    "timings.csv": "time that each cell took",
    "study.toml": "the study as it was run, every part whole",
    "versions.json": "versions of what computed it",
    "data.json": "the recordings' hash",
}
MEASURES = ["accuracy_validation", "accuracy_test", "sops_total", "exit_accuracy", "exit_steps", "exit_sops_total"]


EXTRA_TABLES = ("cut_short", "exit_curve", "conditions", "signals", "same_drive")
NETWORK_COLUMNS = {
    "setting": "data set",
    "pair": "t_ref RA-I & SA-I (ms)",
    "hidden": "N",
    "seed": "seed",
    "accuracy_validation": "validation accuracy (%)",
    "accuracy_test": "test accuracy (%)",
    "sops_total": "SOPs",
    "exit_accuracy": "accuracy with early exit (%)",
    "exit_steps": "steps with early exit",
    "exit_sops_total": "SOPs with early exit",
}
LEDGER_HEADS = {
    "name": "decision by",
    "macs": "MACs",
    "acs": "ACs",
    "other_flops": "other FLOPs",
    "flops": "FLOPs",
    "parameters": "parameters",
    "bytes": "memory (bytes)",
    "sops": "SOPs",
    "signal_ms": "signal (ms)",
    "energy_estimate_nJ": "energy, estimate (nJ)",
}


class Entry(NamedTuple):
    """A cell of a table that can be sorted: what is read, and what it is sorted by."""

    text: str
    value: str | float


def write(study: StudySpec, folder: Path) -> Path:
    """Write `report.html`, its figures, `results.json` and the SOP report from what a run left; the page's path.

    Raises InputError when `results.csv` or `encoding.csv` is not there or a claim names a column that is not there.
    """
    swept = swept_columns(study)
    results = with_setting(with_pair(pd.read_csv(existing(folder / "results.csv"))), swept)
    encoding = with_pair(read_encoding(folder / "encoding.csv"))
    done = [cell for cell in cells(study) if is_done(folder, cell)]
    trains = first_spikes(folder, done)
    classes = name_classes(encoding, trains.conditions if trains else None)
    course = selection.follow(study, selection.in_folder(folder)) if study.selection else None
    chosen = course.found if course else None
    extra = extra_tables(folder)
    trials = report_search.trials_table(folder, done, results)
    shown = drawings(study, folder, done, results, encoding, trains, classes, chosen)
    more = extra_drawings(study, results, extra, classes)
    figures = [keep(drawn, folder) for drawn in chain(shown, _searches(study, trials), more)]
    found = report_cells.cell_details(folder, done, classes)
    details = found if len(found) == len(results) else [{} for _ in range(len(results))]
    for index, detail in enumerate(details):
        detail["search"] = report_search.of_cell(trials, index)
    if len(trials):
        write_table(trials.drop(columns=["pair", "setting"]), folder / report_search.TRIALS)
    write_table(results.drop(columns=["pair", "setting"]), folder / "results.json")
    report_cells.write_sops(report_cells.sops_table(results, swept), folder, study.title)
    ledger_rows = _ledger(folder, results, trains, study.network is None or study.network.recurrent)
    tables = {"results": results, "encoding": encoding, **extra}
    if chosen:
        tables["selection"] = selection.as_table(chosen)
        write_table(tables["selection"], folder / "selection.csv")
    verdicts = [judge(claim, tables) for claim in study.claims]
    page_data = report_cells.page_data(results, details, classes)
    page_data |= {"best": report_selection.best_row(chosen, results)} if chosen else {}
    page = template("report.html.jinja").render(
        study=study,
        n_done=len(results),
        n_cells=len(course.digests if course else list(cells(study))),
        selection=report_selection.shown(course, study.selection) if course and study.selection else [],
        verdicts=verdicts,
        tally=tally(verdicts),
        figures=figures,
        networks=networks_table(results),
        network_heads=list(NETWORK_COLUMNS.values()),
        settings=list(dict.fromkeys(results["setting"])),
        means=means_table(results),
        searches=report_search.table(trials, results),
        baseline=baseline_table(folder),
        ledger=ledger_rows,
        ledger_about=ledger.ABOUT,
        timing=timing_sentence(folder),
        downloads=listed(folder, DOWNLOADS),
        specs=_specs(study),
        seeds=study.sweep.get("seed", [0]),
        versions=if_there(folder / "versions.json"),
        data=if_there(folder / "data.json"),
        page=report_page.parts(page_data, report_page.NETWORKS),
    )
    write_text(folder / "report.html", page)
    return folder / "report.html"


def drawings(
    study: StudySpec,
    folder: Path,
    done: list[Cell],
    results: pd.DataFrame,
    encoding: pd.DataFrame,
    trains: SpikeTrains | None,
    classes: Classes,
    found: Selection | None = None,
) -> Iterator[Drawn]:
    """The figures that these tables and this run folder allow, in the order of the report.

    found: what was selected; the figures of networks then show those at the window length of the selection.
    """
    if found is not None and study.selection is not None:
        yield from report_selection.drawings(found, results, study.selection)
        results, done = report_selection.at_choice(found, results, done)
    yield from encoding_drawings(study, trains, encoding, classes)
    yield from network_drawings(study, folder, done, results, classes)


def extra_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """The tables that only some studies leave, by name."""
    paths = {name: folder / f"{name}.csv" for name in EXTRA_TABLES}
    found = {name: pd.read_csv(path) for name, path in paths.items() if path.is_file()}
    return {name: with_pair(table) if "t_ref_ra_ms" in table else table for name, table in found.items()}


def _searches(study: StudySpec, trials: pd.DataFrame) -> Iterator[Drawn]:
    return report_search.drawings(trials, study.search) if study.search else iter(())


def read_encoding(path: Path) -> pd.DataFrame:
    """The encoding table; a class may be called "None", and an interval may be missing."""
    missing = {"isi_sa_ms": [""], "isi_ra_ms": [""]}
    return pd.read_csv(existing(path), dtype={"label": str}, keep_default_na=False, na_values=missing)


def with_pair(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the t_ref pair as the paper writes it, RA-I first, in the column `pair`.

    >>> with_pair(pd.DataFrame({"t_ref_ra_ms": [1.0], "t_ref_sa_ms": [10.0]}))["pair"].tolist()
    ['1&10']
    """
    periods = zip(table["t_ref_ra_ms"], table["t_ref_sa_ms"], strict=True)
    return table.assign(pair=[f"{ra:g}&{sa:g}" for ra, sa in periods])


def with_setting(results: pd.DataFrame, swept: list[str]) -> pd.DataFrame:
    """The table with, in the column `setting`, the data set and what else was swept, in words.

    >>> rows = pd.DataFrame({"dataset": ["mixed"], "window.length_ms": [50.0]})
    >>> with_setting(rows, ["window.length_ms"])["setting"].tolist()
    ['mixed, window.length 50 ms']
    """
    swept = [key for key in swept if key in results]
    words = [
        ", ".join([str(row["dataset"]), *(f"{quantity(key)[0]} {in_unit(key, row[key])}" for key in swept)])
        for _, row in results.iterrows()
    ]
    return results.assign(setting=words)


def tally(verdicts: list[Verdict]) -> str:
    """How many claims hold, in words.

    >>> tally([])
    ''
    """
    if not verdicts:
        return ""
    judged = [verdict.reproduced for verdict in verdicts if verdict.reproduced is not None]
    missing = len(verdicts) - len(judged)
    return f"{sum(judged)} of {len(judged)} claims reproduced" + (f", {missing} not in this run" if missing else "")


def means_table(results: pd.DataFrame) -> Table:
    """Means over seeds ± SD of each network."""
    measures = [measure for measure in MEASURES if measure in results]
    rows = [
        [str(row["setting"]), str(row["pair"]), str(row["hidden"]), str(row["seeds"])]
        + [_spread(measure, row[measure], row[f"{measure}_sd"]) for measure in measures]
        for _, row in over_seeds(results, measures).iterrows()
    ]
    columns = ["data set", "t_ref RA-I & SA-I (ms)", "N", "seeds", *(NETWORK_COLUMNS[measure] for measure in measures)]
    return Table("Means over seeds ± SD (n - 1)", columns, rows, n_heads=3)


def networks_table(results: pd.DataFrame) -> list[list[Entry]]:
    """A row a trained network, of the columns of `NETWORK_COLUMNS`."""
    order = results[["t_ref_ra_ms", "t_ref_sa_ms"]].apply(tuple, axis=1).rank(method="dense")
    return [
        [
            Entry(_entry(column, row[column]), int(order[index]) if column == "pair" else plain(row[column]))
            for column in NETWORK_COLUMNS
        ]
        for index, row in results.iterrows()
    ]


def baseline_table(folder: Path) -> Table | None:
    """The linear baseline as text; None where the study has none."""
    path = folder / "baseline.csv"
    if not path.is_file():
        return None
    found = pd.read_csv(path)
    shares = {"accuracy_validation", "accuracy_test", "chance", "majority_class"}
    heads = [f"{c.replace('_', ' ')} (%)" if c in shares else c.replace("_", " ") for c in found.columns]
    rows = [
        [f"{100 * value:.1f}" if column in shares else _number(value) for column, value in row.items()]
        for row in found.to_dict("records")
    ]
    caption = "Logistic regression on the mean and deviation of each taxel, on the same windows and the same split"
    return Table(caption, heads, rows, n_heads=1)


def _ledger(folder: Path, results: pd.DataFrame, trains: SpikeTrains | None, recurrent: bool) -> Table | None:
    """What a decision costs, written to ledger.csv too; None where no spikes say how many afferents there are."""
    if trains is None:
        return None
    path = folder / "baseline.csv"
    baseline = pd.read_csv(path) if path.is_file() else None
    sizes = {"n_afferents": len(trains.afferents), "n_classes": len(trains.classes)}
    table = ledger.study_ledger(
        results, baseline, **sizes, rate_Hz=trains.sampling_rate_Hz, recurrent=recurrent, encoder=trains.encoder
    )
    write_table(table, folder / "ledger.csv")
    rows = [[row[0], *(f"{value:,.6g}" for value in row[1:])] for row in table.itertuples(index=False, name=None)]
    return Table("What a decision costs", [LEDGER_HEADS[column] for column in table.columns], rows, n_heads=1)


def timing_sentence(folder: Path) -> str:
    """What the cells took, in words; nothing where timings.csv is not there."""
    path = folder / "timings.csv"
    if not path.is_file():
        return ""
    timings = pd.read_csv(path)
    if timings.empty:
        return ""
    seconds = timings["seconds"]
    took = (
        f"{len(timings)} cells took {_duration(seconds.sum())} of worker time: {seconds.median():.1f} s in the median, "
        f"{seconds.max():.1f} s at most"
    )
    if "epochs" not in timings:
        return f"{took}."
    return f"{took}, for {timings['epochs'].min():.0f} to {timings['epochs'].max():.0f} epochs of training each."


def keep(drawn: Drawn, folder: Path) -> dict[str, Any]:
    """Write a figure into a run folder; what the page needs of it, the picture itself among it."""
    for suffix in (".svg", ".png"):
        save(drawn.figure, folder / "figures" / f"{drawn.name}{suffix}")
        drawn.figure.set_layout_engine("none")  # Laid out once: quicker, and both files look the same.
    svg = (folder / "figures" / f"{drawn.name}.svg").read_bytes()
    width = round(96 * drawn.figure.get_figwidth())
    source = f"data:image/svg+xml;base64,{b64encode(svg).decode()}"
    return {"source": source, "width": width, **{k: getattr(drawn, k) for k in ("name", "title", "caption", "alt")}}


def listed(folder: Path, downloads: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """The files of a run folder that its page hands on: name, what it is, and a link that holds it."""
    return [(name, what, inline(folder / name)) for name, what in downloads.items() if (folder / name).is_file()]


def inline(path: Path) -> str:
    """A file as a link that works wherever the page goes."""
    kinds = {".csv": "text/csv", ".json": "application/json", ".md": "text/markdown", ".toml": "application/toml"}
    return f"data:{kinds[path.suffix]};base64,{b64encode(path.read_bytes()).decode()}"


def first_spikes(folder: Path, done: list[Cell]) -> SpikeTrains | None:
    """The spike trains of the first done cell that are there."""
    held = next((spikes_path(folder, cell) for cell in done if spikes_path(folder, cell).is_file()), None)
    return load_spikes(held) if held else None


def template(name: str):
    """A page's template; what it is not given is an error."""
    environment = Environment(
        loader=PackageLoader("neurotact.studies", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def _specs(study: StudySpec) -> dict[str, str]:
    """The study's parts as TOML; the whole of it is the first."""
    parts = {name: getattr(study, name).model_dump(mode="json", exclude_none=True) for name in studies.PARTS}
    return {"Whole study": studies.to_toml(study), **{name.capitalize(): to_toml(part) for name, part in parts.items()}}


def if_there(path: Path) -> dict[str, Any]:
    """What a JSON file holds; nothing where there is none."""
    return read_json(path) if path.is_file() else {}


def _spread(measure: str, mean: float, sd: float) -> str:
    if pd.isna(mean):
        return "-"
    scale, digits = (100.0, 1) if "accuracy" in measure else (1.0, 0)
    mean_text = f"{scale * mean:,.{digits}f}"
    return mean_text if pd.isna(sd) else f"{mean_text} ± {scale * sd:,.{digits}f}"


def _entry(column: str, value: Any) -> str:
    if column in MEASURES:
        return _spread(column, value, float("nan"))
    return str(value)


def plain(value: Any) -> str | float:
    """What a table is sorted by; nothing where a number is missing."""
    if isinstance(value, str):
        return value
    return "" if pd.isna(value) else float(value)


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
