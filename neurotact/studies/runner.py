"""Running a study: its spec becomes cells, each cell is computed once, also after interruptions; then its tables.

A damaged file is written again, and a line on stderr names it.
"""

import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact import effects, files
from neurotact import spec as specs
from neurotact.errors import InputError, some
from neurotact.interrupt import stop_if_asked
from neurotact.lazily import lazily
from neurotact.progress import say, track
from neurotact.studies import store
from neurotact.studies.engine import AnyCell, Engine, MapCells
from neurotact.studies.executors import executor
from neurotact.studies.loading import Study, engine_of, read_back
from neurotact.studies.store import CELLS, cell_folder, is_done
from neurotact.studies.study import Cell, to_toml
from neurotact.tables import read_table, write_table
from neurotact.versions import versions
from neurotact.workers import in_a_process

with lazily():
    from neurotact.networks.definition import recipe

STUDY = "study.toml"
VERSIONS = "versions.json"
TIMINGS = "timings.csv"
LONGEST_VALUE = 40
"""Characters of each value in a message on two different studies."""


def run(study: Study, folder: Path, workers: int | None = None, scheduler: str | None = None) -> None:
    """Run the unfinished cells of `study` in `folder`, then write its tables; `report.write` shows them.

    workers: processes of this machine, 2 if None. scheduler: address of a Dask scheduler, whose workers compute cells
    in their place.
    Each cell trains with one thread and its own random seeds: no number depends on where it is computed.
    Raises InputError if the folder contains another study or anything else, if another process works in it, and if
    the scheduler cannot be used.
    """
    effects.check(workers=workers, scheduler=scheduler)
    engine = engine_of(study)
    cells = list(engine.cells(study))
    with files.locked(folder), ExitStack() as at_last:
        is_new = files.is_free(folder)
        with executor(workers or 2, scheduler) as map_cells:
            _claim(folder, study)
            files.sweep(folder)
            at_last.callback(files.sweep, folder)  # drafts of worker processes that were stopped
            try:
                _compute(engine, study, cells, folder, map_cells)
            except InputError:
                if (folder / CELLS).exists() or store.read((folder / cells[0].given).parent) is not None:
                    say(f"{folder}: keeps what is done; {store.resuming(folder)}, or the corrected command, goes on")
                elif is_new:
                    files.empty(folder)  # so that the user can correct the command and repeat it
                raise
        _write_tables(engine, study, cells, folder)


def _compute(engine: Engine, study: Study, cells: list[Any], folder: Path, map_cells: MapCells) -> None:
    """Write the missing and the damaged files: shared inputs, and the files of each cell."""
    with track("prepare", 1) as advance:
        _save_versions(folder)  # in a process, the first, whose server loads for seconds
        at_once = in_a_process(engine.prepare, folder, study, cells)
        advance(1, "")
    stop_if_asked()
    for cell in cells:
        why = store.damage(folder, cell)
        if why is not None:
            say(f"{_place(cell)}: {why}; computed again")
            store.discard(folder, cell)
    unfinished = (
        cell.network for cell in cells if isinstance(cell, Cell) and cell.network and not is_done(folder, cell)
    )
    for line in dict.fromkeys(line for network in unfinished for line in recipe.joined_cost(network)):
        say(line)
    beside, made = engine.beside(folder, study, cells, at_once), {}
    for name, step_cells in engine.steps(study, cells, folder):
        todo: list[AnyCell] = [cell for cell in step_cells if not is_done(folder, cell)]
        before = len(step_cells) - len(todo)
        if before and todo:
            say(f"{folder}: resumes; {before} of {len(step_cells)} {name} are already done")
        n_beside = len(beside.jobs) if beside else 0
        if todo or n_beside:
            what = f"{name} and {beside.name}" if beside else name
            with track(what, len(step_cells) + n_beside, done=before) as advance:
                for job, left in map_cells(engine, todo, folder, beside):
                    if isinstance(job, int):
                        made[job] = left
                    else:
                        store.write_cell(left, job, folder)
                    if beside and len(made) == n_beside:
                        beside.write(made)
                        beside = None
                    advance(1, "")
                    stop_if_asked()


def write_tables(folder: Path) -> None:
    """Write the tables of a run again from the finished cells.

    A damaged cell is left out, and a line on stderr names it. Raises InputError if any other file was changed, and if
    another process works in the folder.
    """
    study = load(folder)
    engine = engine_of(study)
    cells = list(engine.cells(study))
    with files.locked(folder):
        files.sweep(folder)
        store.check(folder, [VERSIONS])
        engine.check(folder, study, cells)
        for cell in cells:
            why = store.damage(folder, cell)
            if why is not None and not is_done(folder, cell):
                say(f"{_place(cell)}: {why}; left out, {store.resuming(folder)} computes it again")
        if beside := engine.beside(folder, study, cells, True):
            say(f"{folder}: {beside.name} are not done; left out, {store.resuming(folder)} computes them")
        _write_tables(engine, study, cells, folder)


def load(folder: Path) -> Study:
    """The study of a run folder; InputError if there is none, or if `study.toml` was edited."""
    path = files.existing(folder, "folder") / STUDY
    again = f"neurotact study run NAME -o {shlex.quote(str(folder))}"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with {again}")
    study, known = read_back(path), store.read(folder)
    if known is None:
        raise InputError(
            f"{folder}: its {store.FILES} is damaged or missing, and no file can be checked; {again} checks each cell, "
            "and computes again those that cannot be checked"
        )
    if known.made_from != _made_from(study):
        raise InputError(
            f"{path}: was changed since the study began, or another version of neurotact began it; restore it with "
            f"{again}, or run this study in another folder: neurotact study run {shlex.quote(str(path))} -o ANOTHER"
        )
    return study


def _write_tables(engine: Engine, study: Study, cells: list[Any], folder: Path) -> None:
    """Write the tables of the finished cells."""
    every = engine.wanted(study, cells, folder)
    done = [cell for cell in every if is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run {store.resuming(folder)}")
    if len(done) < len(every):
        say(f"{folder}: {len(done)} of {len(every)} cells are done; the tables contain only these")
    tables = engine.tables(folder, study, [(cell, store.result_of(folder, cell)) for cell in done])
    for name, table in {TIMINGS: _timings(folder, done), **tables}.items():
        write_table(table, folder / name)


def _timings(folder: Path, done: Sequence[Any]) -> pd.DataFrame:
    """The seconds of each part of the study, and of each cell.

    Columns: part (`read`, `calibrate`, `encode`, `baselines`, `report`, and `train`, or `cell` without a network), cell
    (empty beside cells), seconds, and for networks epochs.
    """
    rows = [{"part": part, "seconds": seconds} for part, seconds in store.parts_took(folder).items()]
    for cell in done:
        timing = store.timing_of(folder, cell)
        part = "train" if "epochs" in timing else "cell"
        rows.append({"part": part, "cell": cell.digest(), "seconds": None, **timing})
    return pd.DataFrame(rows)


def add_report_time(folder: Path) -> None:
    """Add the time of the report to the timings of a run folder, after it is written."""
    table = read_table(folder / TIMINGS)
    own = {"part": "report", "seconds": store.parts_took(folder).get("report")}
    write_table(pd.concat([table[table["part"] != "report"], pd.DataFrame([own])]), folder / TIMINGS)


def _place(cell: AnyCell) -> str:
    return cell_folder(Path(), cell).as_posix()


def _claim(folder: Path, study: Study) -> None:
    """Claim `folder` for this study; InputError if it belongs to another, or to one that was saved in another form.

    A folder without a manifest belongs to the study that it contains. Where no cell has begun, another study, such as a
    corrected one, takes it over with the inputs that are made.
    """
    path, known, made_from = folder / STUDY, store.read(folder), _made_from(study)
    if known is not None:
        is_ours = known.made_from == made_from
    elif path.is_file():
        is_ours = _made_from(read_back(path)) == made_from
    elif files.is_free(folder):
        is_ours = True
    else:
        raise InputError(f"{folder}: is not empty and holds no study; choose another folder")
    if not is_ours and known is not None and not (folder / CELLS).exists():
        other = f"another study{_differing(study, path)}"
        say(f"{folder}: held {other}, of which no cell had begun; this one takes its place")
        for name in known.files:  # of the other study
            (folder / Path(name).name).unlink(missing_ok=True)
    elif not is_ours:
        raise InputError(
            f"{folder}: already holds another study{_differing(study, path)}; choose another folder or remove it"
        )
    text = to_toml(study)
    store.seal(folder, [], made_from)
    files.write_text(path, text)


def _made_from(study: Study) -> dict[str, str]:
    """What decides the numbers of a study, for its manifest."""
    return {"schema": str(specs.SCHEMA), "settings": study.digest()}


def _differing(study: Study, path: Path) -> str:
    """The keys of a study with other values in a run folder's `study.toml`, in words; empty if it is damaged.

    Raises InputError if it was saved in another form.
    """
    try:
        specs.read(path)
    except InputError:
        return ""
    there, here = (specs.leaves(spec.model_dump(mode="json", exclude=spec.words)) for spec in (read_back(path), study))
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    shown = [f"{key} = {_short(there.get(key))}, here {_short(here.get(key))}" for key in keys]
    return f" ({some(shown, 3, '; ')})" if shown else ""


def _short(value: Any) -> str:
    text = "absent" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def _save_versions(folder: Path) -> None:
    """Write the versions with which a study starts; a line on stderr shows those that changed when it resumes."""
    here, at_start = in_a_process(versions), store.sound_json(folder, VERSIONS)
    if at_start is None:
        store.say_flaws("", store.flaws(folder, [VERSIONS]), "written again with the present versions")
        files.write_json(folder / VERSIONS, here)
        store.seal(folder, [VERSIONS])
        return
    others = [name for name in here if name != "python" and here[name] != at_start.get(name)]
    if others:
        changes = ", ".join(f"{name} {here[name]} (was {at_start.get(name, 'not recorded')})" for name in others)
        say(f"{folder}: resumes with other versions than at its start, numbers may differ: {changes}")
