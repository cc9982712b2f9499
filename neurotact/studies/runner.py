"""Running a study: its cells, each done once, whatever interrupts it; then its tables and report."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pandas as pd

from neurotact import files
from neurotact.errors import InputError
from neurotact.export.tables import read_table, write_table
from neurotact.progress import say, track
from neurotact.spec import digest
from neurotact.studies import encoded, kinds, manifest
from neurotact.studies.cell import cell_folder, damage, discard, is_done, result_of, timing_of, write_cell
from neurotact.studies.executors import executor
from neurotact.studies.kinds import AnyCell, MapCells, Study
from neurotact.studies.preparation import check_files, spikes_path
from neurotact.studies.protocol_study import ProtocolCell, ProtocolStudy, swept_values
from neurotact.studies.report import afferents, networks, protocol
from neurotact.studies.report.tables import read_encoding
from neurotact.studies.study import SOURCE, Cell, StudySpec, swept_columns, to_toml, value_at
from neurotact.studies.versions import versions

STUDY = "study.toml"
VERSIONS = "versions.json"


def run(study: Study, folder: Path, workers: int = 2, scheduler: str | None = None) -> Path:
    """Run what is not yet done of `study` in `folder`, then write tables and report; the report's path.

    scheduler: address of a Dask scheduler, whose workers compute the cells in place of `workers` processes here.
    Each cell trains with one thread and seeds of its own, so that who computes it changes no number.
    What was damaged since it was written is written again, and a line on stderr names it.
    Raises InputError when the folder holds another study or anything else, when another process works in it, and when
    the scheduler cannot be used.
    """
    with files.locked(folder), ExitStack() as at_last:
        with executor(workers, scheduler) as map_cells:
            _claim(folder, study)
            files.sweep(folder)
            at_last.callback(files.sweep, folder)  # of worker processes that were stopped
            _compute(study, folder, map_cells)
        return finish(study, folder)


def _compute(study: Study, folder: Path, map_cells: MapCells) -> None:
    """Write what cells share and what each leaves, as far as it is not there or damaged."""
    with track("prepare", 1) as advance:
        kinds.prepare(study, folder)
        advance(1, "")
    for cell, place, why in _damaged(study, folder):
        say(f"{place}: {why}; computed again")
        discard(folder, cell)
    for name, asked in kinds.steps(study, folder):
        todo = [cell for cell in asked if not is_done(folder, cell)]
        if todo:
            with track(name, len(todo)) as advance:
                for cell, left in map_cells(todo, folder):
                    write_cell(left, cell, folder)
                    advance(1, "")


def report(folder: Path) -> Path:
    """Write tables and report again from the cells that are done; the report's path.

    A damaged cell is left out, and a line on stderr names it. Raises InputError when anything else was changed, and
    when another process works in the folder.
    """
    study = load(folder)
    with files.locked(folder):
        files.sweep(folder)
        check_files(folder, [VERSIONS])
        kinds.check(study, folder)
        for cell, place, why in _damaged(study, folder):
            if not is_done(folder, cell):
                say(f"{place}: {why}; left out, neurotact study resume {folder} computes it again")
        return finish(study, folder)


def load(folder: Path) -> Study:
    """The study that a run folder holds; InputError when it holds none, or `study.toml` was edited."""
    path = files.existing(folder, "folder") / STUDY
    again = f"neurotact study run NAME -o {folder}"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with {again}")
    study, known = kinds.read_back(path), manifest.read(folder)
    if known is None:
        raise InputError(
            f"{folder}: its {manifest.FILES} is damaged or missing, or an earlier neurotact made it, so that nothing "
            f"can be checked; {again} checks each cell, and computes again what cannot be checked"
        )
    if known.made_from != _made_from(study):
        raise InputError(
            f"{path}: was changed since the study began; restore it with {again}, or run the changed study into "
            f"another folder: neurotact study run {path} -o ANOTHER"
        )
    return study


def finish(study: Study, folder: Path) -> Path:
    """Write the tables, the figures and the report from what the cells left; the report's path."""
    every = kinds.asked_for(study, folder)
    done = [cell for cell in every if is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run neurotact study resume {folder}")
    if len(done) < len(every):
        say(f"{folder}: {len(done)} of {len(every)} cells are done; the report shows these")
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
    """Firing under each condition, once for each encoder; swept keys of the encoder and the simulation come last."""
    keys = [key for key in swept_columns(study) if key.startswith(("encoder.", SOURCE))]
    tables = {}
    for cell in done:
        if cell.spikes_name not in tables:
            table = read_encoding(spikes_path(folder, cell).with_suffix(".csv"))
            tables[cell.spikes_name] = table.assign(**{key: value_at(cell, key) for key in keys})
    return pd.concat(tables.values(), ignore_index=True)


def _timings_table(folder: Path, done: list[AnyCell]) -> pd.DataFrame:
    rows = [{"cell": cell.digest(), "seconds": None, **timing_of(folder, cell)} for cell in done]
    return pd.DataFrame(rows)


def _damaged(study: Study, folder: Path) -> Iterator[tuple[AnyCell, str, str]]:
    """Each cell that was done and is no longer whole, where it lies in the run folder, and why."""
    for cell in kinds.cells(study):
        why = damage(folder, cell)
        if why is not None:
            yield cell, cell_folder(folder, cell).relative_to(folder).as_posix(), why


def _claim(folder: Path, study: Study) -> None:
    """Make `folder` this study's; refuse one that is another's.

    A folder without a manifest, which got lost or was never there, is taken by the study that it holds.
    """
    path, known, made_from = folder / STUDY, manifest.read(folder), _made_from(study)
    if known is not None:
        is_ours = known.made_from == made_from
    elif path.is_file():
        is_ours = _made_from(kinds.read_back(path)) == made_from
    elif files.is_free(folder):
        is_ours = True
    else:
        raise InputError(f"{folder}: is not empty and holds no study; choose another folder")
    if not is_ours:
        raise InputError(f"{folder}: already holds another study; choose another folder or remove it")
    manifest.seal(folder, [], made_from)
    files.write_text(path, to_toml(study))
    _keep_versions(folder)


def _keep_versions(folder: Path) -> None:
    """Write the versions that a study begins with; a line on stderr tells which others it goes on with."""
    here, began = versions(), manifest.sound_json(folder, VERSIONS)
    if began is None:
        manifest.tell("", manifest.flaws(folder, [VERSIONS]), "written again with the versions that are here now")
        files.write_json(folder / VERSIONS, here)
        manifest.seal(folder, [VERSIONS])
        return
    others = [name for name in here if name != "python" and here[name] != began.get(name)]
    if others:
        told = ", ".join(f"{name} {here[name]} (was {began.get(name)})" for name in others)
        say(f"{folder}: goes on with other versions than it began with, numbers may differ: {told}")


def _made_from(study: Study) -> dict[str, str]:
    """What decides the numbers of a study, for its manifest: not its claims and words, nor where its files lie."""
    table = study.model_dump(mode="json", exclude={"title", "about", "claims"})
    for key in ("file", "path"):
        table.get("dataset", {}).pop(key, None)
    return {"settings": digest(table)}
