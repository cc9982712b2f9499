"""Running a study: its cells, each done once, whatever interrupts it; then its tables and report."""

import sys
from pathlib import Path

import pandas as pd

from neurotact import files
from neurotact.errors import InputError
from neurotact.export.tables import read_table, write_table
from neurotact.progress import track
from neurotact.studies import encoded, kinds
from neurotact.studies.cell import cell_folder, is_done, result_of, write_cell
from neurotact.studies.executors import executor
from neurotact.studies.kinds import AnyCell, Study
from neurotact.studies.preparation import spikes_path
from neurotact.studies.protocol_study import ProtocolCell, ProtocolStudy, swept_values
from neurotact.studies.report import afferents, networks, protocol
from neurotact.studies.report.tables import read_encoding
from neurotact.studies.study import Cell, StudySpec, swept_columns, to_toml, value_at
from neurotact.studies.versions import versions


def run(study: Study, folder: Path, workers: int = 2, scheduler: str | None = None) -> Path:
    """Run what is not yet done of `study` in `folder`, then write tables and report; the report's path.

    scheduler: address of a Dask scheduler, whose workers compute the cells in place of `workers` processes here.
    Each cell trains with one thread and seeds of its own, so that who computes it changes no number.
    Raises InputError when the folder holds another study or anything else, and when the scheduler cannot be used.
    """
    with executor(workers, scheduler) as map_cells:
        _claim(folder, study)
        with track("prepare", 1) as advance:
            kinds.prepare(study, folder)
            advance(1, "")
        for name, asked in kinds.steps(study, folder):
            todo = [cell for cell in asked if not is_done(folder, cell)]
            if todo:
                with track(name, len(todo)) as advance:
                    for cell, left in map_cells(todo, folder):
                        write_cell(left, cell, folder)
                        advance(1, "")
    return finish(study, folder)


def load(folder: Path) -> Study:
    """The study that a run folder holds."""
    path = files.existing(folder, "folder") / "study.toml"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with neurotact study run NAME -o {folder}")
    return kinds.read_back(path)


def finish(study: Study, folder: Path) -> Path:
    """Write the tables, the figures and the report from what the cells left; the report's path."""
    every = kinds.asked_for(study, folder)
    done = [cell for cell in every if is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run neurotact study resume {folder}")
    if len(done) < len(every):
        print(f"{folder}: {len(done)} of {len(every)} cells are done; the report shows these", file=sys.stderr)
    write_table(_timings_table(folder, done), folder / "timings.csv")
    if isinstance(study, ProtocolStudy):
        ran = [cell for cell in done if isinstance(cell, ProtocolCell)]
        write_table(protocol_table(study, folder, ran), folder / "results.csv")
        return protocol.write(study, folder)
    trained = [cell for cell in done if isinstance(cell, Cell)]
    write_table(results_table(study, folder, trained), folder / "results.csv")
    write_table(encoding_table(study, folder, trained), folder / "encoding.csv")
    if study.network is None:
        places = [cell_folder(folder, cell) for cell in trained]
        rows = read_table(folder / "results.csv")
        write_table(encoded.isi_table(places, rows, swept_columns(study)), folder / encoded.ISI)
        return afferents.write(study, folder)
    for name, table in extra_tables(study, folder, trained).items():
        write_table(table, folder / f"{name}.csv")
    return networks.write(study, folder)


def protocol_table(study: ProtocolStudy, folder: Path, done: list[ProtocolCell]) -> pd.DataFrame:
    """The rows of all cells, in the order of the sweep; what was swept stands first."""
    rows = []
    for cell in done:
        swept = swept_values(study, cell)
        rows += [{**swept, **row} for row in result_of(folder, cell)["rows"]]
    return pd.DataFrame(rows)


def results_table(study: StudySpec, folder: Path, done: list[Cell]) -> pd.DataFrame:
    """One row a cell, in the order of the sweep; swept keys without a column of their own come last."""
    rows = []
    for cell in done:
        extra = {key: value_at(cell, key) for key in swept_columns(study)}
        rows.append({**result_of(folder, cell)["row"], **extra})
    return pd.DataFrame(rows)


def extra_tables(study: StudySpec, folder: Path, done: list[Cell]) -> dict[str, pd.DataFrame]:
    """By name, the tables that cells left besides their row; each line begins with its cell's sweep."""
    found: dict[str, list[dict]] = {}
    for cell in done:
        result = result_of(folder, cell)
        keys = {name: result["row"][name] for name in ("dataset", "t_ref_ra_ms", "t_ref_sa_ms", "hidden", "seed")}
        keys |= {key: value_at(cell, key) for key in swept_columns(study)}
        for name, lines in result.get("tables", {}).items():
            found.setdefault(name, []).extend({**keys, **line} for line in lines)
    return {name: pd.DataFrame(lines) for name, lines in found.items()}


def encoding_table(study: StudySpec, folder: Path, done: list[Cell]) -> pd.DataFrame:
    """Firing under each condition, once for each encoder; swept keys of the encoder come last."""
    keys = [key for key in swept_columns(study) if key.startswith("encoder.")]
    tables = {}
    for cell in done:
        if cell.spikes_name not in tables:
            table = read_encoding(spikes_path(folder, cell).with_suffix(".csv"))
            tables[cell.spikes_name] = table.assign(**{key: value_at(cell, key) for key in keys})
    return pd.concat(tables.values(), ignore_index=True)


def _timings_table(folder: Path, done: list[AnyCell]) -> pd.DataFrame:
    rows = [{"cell": c.digest(), **files.read_json(cell_folder(folder, c) / "timing.json")} for c in done]
    return pd.DataFrame(rows)


def _claim(folder: Path, study: Study) -> None:
    """Make `folder` this study's; refuse one that is another's."""
    path = folder / "study.toml"
    if path.is_file():
        if _numbers(load(folder)) != _numbers(study):
            raise InputError(f"{folder}: already holds another study; choose another folder or remove it")
    elif not files.is_free(folder):
        raise InputError(f"{folder}: is not empty and holds no study; choose another folder")
    files.write_text(path, to_toml(study))
    files.write_json(folder / "versions.json", versions())


def _numbers(study: Study) -> Study:
    """What decides the numbers of a study: claims only judge them, and may be mended in a folder that holds some."""
    return study.model_copy(update={"claims": ()})
