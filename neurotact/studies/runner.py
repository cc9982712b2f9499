"""Running a study: each cell once, also after interruptions; then its tables."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact import effects, files
from neurotact.errors import InputError, some
from neurotact.interrupt import stop_if_asked
from neurotact.networks import population
from neurotact.progress import say, track
from neurotact.spec import digest, leaves, without_defaults
from neurotact.studies import manifest
from neurotact.studies.executors import MapCells, executor
from neurotact.studies.loading import Study, engine_of, read_back
from neurotact.studies.preparation import check_files
from neurotact.studies.protocol_study import placeless
from neurotact.studies.store import AnyCell, cell_folder, damage, discard, is_done, timing_of, write_cell
from neurotact.studies.study import LATER_KEYS, StudySpec, to_toml
from neurotact.tables import write_table
from neurotact.versions import versions

STUDY = "study.toml"
VERSIONS = "versions.json"
DEVICE = "device"
WORDS = {"title", "about", "claims", "notes", "as_shipped", "first_look"}
"""Keys of a study that change none of its numbers."""
LONGEST_VALUE = 40
"""Characters of each value in a message on two different studies."""


def run(
    study: Study, folder: Path, workers: int | None = None, scheduler: str | None = None, device: str = "cpu"
) -> None:
    """Run the unfinished cells of `study` in `folder`, then write its tables; `report.write` shows them.

    workers: processes of this machine, 2 if None. scheduler: address of a Dask scheduler, whose workers compute cells
    in their place.
    device: a torch device that trains the networks in their place, all together; "cpu": no such device.
    Each cell trains with one thread and its own random seeds: no number depends on where it is computed.
    A damaged file is written again, and a line on stderr names it.
    Raises InputError if the folder contains another study or anything else, if another process works in it, and if
    the scheduler cannot be used.
    """
    effects.check(workers=workers, scheduler=scheduler, device=device)
    with files.locked(folder), ExitStack() as at_last:
        is_new = files.is_free(folder)
        with executor(workers or 2, scheduler, device) as map_cells:
            _claim(folder, study, device)
            files.sweep(folder)
            at_last.callback(files.sweep, folder)  # drafts of worker processes that were stopped
            try:
                _compute(study, folder, map_cells)
            except InputError:
                if is_new and not any(is_done(folder, cell) for cell in engine_of(study).cells()):
                    files.empty(folder)  # so that the user can correct the command and repeat it
                raise
        _write_tables(study, folder)


def _compute(study: Study, folder: Path, map_cells: MapCells) -> None:
    """Write the missing and the damaged files: shared inputs, and the files of each cell."""
    engine = engine_of(study)
    with track("prepare", 1) as advance:
        engine.prepare(folder)
        advance(1, "")
    stop_if_asked()
    for cell, place, why in _damaged(study, folder):
        say(f"{place}: {why}; computed again")
        discard(folder, cell)
    for name, asked in engine.steps(folder):
        todo = [cell for cell in asked if not is_done(folder, cell)]
        before = len(asked) - len(todo)
        if before and todo:
            say(f"{folder}: resumes; {before} of {len(asked)} {name} are already done")
        if todo:
            with track(name, len(asked), done=before) as advance:
                for cell, result_files in map_cells(engine, todo, folder):
                    write_cell(result_files, cell, folder)
                    advance(1, "")
                    stop_if_asked()


def write_tables(folder: Path) -> None:
    """Write the tables of a run again from the finished cells.

    A damaged cell is left out, and a line on stderr names it. Raises InputError if any other file was changed, and if
    another process works in the folder.
    """
    study = load(folder)
    with files.locked(folder):
        files.sweep(folder)
        check_files(folder, [VERSIONS])
        engine_of(study).check(folder)
        for cell, place, why in _damaged(study, folder):
            if not is_done(folder, cell):
                say(f"{place}: {why}; left out, neurotact study resume {folder} computes it again")
        _write_tables(study, folder)


def load(folder: Path) -> Study:
    """The study of a run folder; InputError if there is none, or if `study.toml` was edited."""
    path = files.existing(folder, "folder") / STUDY
    again = f"neurotact study run NAME -o {folder}"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with {again}")
    study, known = read_back(path), manifest.read(folder)
    if known is None:
        raise InputError(
            f"{folder}: its {manifest.FILES} is damaged or missing, or an earlier neurotact made it, and no file "
            f"can be checked; {again} checks each cell, and computes again those that cannot be checked"
        )
    if known.made_from != _made_from(study):
        raise InputError(
            f"{path}: was changed since the study began; restore it with {again}, or run the changed study in "
            f"another folder: neurotact study run {path} -o ANOTHER"
        )
    return study


def _write_tables(study: Study, folder: Path) -> None:
    """Write the tables of the finished cells."""
    engine = engine_of(study)
    every = engine.asked_for(folder)
    done = [cell for cell in every if is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run neurotact study resume {folder}")
    if len(done) < len(every):
        say(f"{folder}: {len(done)} of {len(every)} cells are done; the tables contain only these")
    write_table(_timings_table(folder, done), folder / "timings.csv")
    for name, table in engine.tables(folder, done).items():
        write_table(table, folder / name)


def _timings_table(folder: Path, done: list[AnyCell]) -> pd.DataFrame:
    rows = [{"cell": cell.digest(), "seconds": None, **timing_of(folder, cell)} for cell in done]
    return pd.DataFrame(rows)


def _damaged(study: Study, folder: Path) -> Iterator[tuple[AnyCell, str, str]]:
    """Each finished cell that is damaged, its path in the run folder, and the reason."""
    for cell in engine_of(study).cells():
        why = damage(folder, cell)
        if why is not None:
            yield cell, cell_folder(folder, cell).relative_to(folder).as_posix(), why


def _claim(folder: Path, study: Study, device: str = "cpu") -> None:
    """Claim `folder` for this study; InputError if it belongs to another.

    A folder without a manifest belongs to the study that it contains.
    """
    path, known, made_from = folder / STUDY, manifest.read(folder), _made_from(study)
    if known is not None:
        is_ours = known.made_from == made_from
    elif path.is_file():
        is_ours = _made_from(read_back(path)) == made_from
    elif files.is_free(folder):
        is_ours = True
    else:
        raise InputError(f"{folder}: is not empty and holds no study; choose another folder")
    if not is_ours:
        raise InputError(
            f"{folder}: already holds another study{_differing(study, path)}; choose another folder or remove it"
        )
    manifest.seal(folder, [], made_from)
    files.write_text(path, to_toml(study))
    _save_versions(folder, device)


def _differing(study: Study, path: Path) -> str:
    """The keys of a study with other values in a run folder's `study.toml`, in words; empty if it cannot be read."""
    try:
        there, here = (leaves(each.model_dump(mode="json", exclude=WORDS)) for each in (read_back(path), study))
    except InputError:
        return ""
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    if not keys:
        return ""
    shown = [f"{key} = {_short(there.get(key))}, here {_short(here.get(key))}" for key in keys]
    return f" ({some(shown, 3, '; ')})"


def _short(value: Any) -> str:
    text = "absent" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def _save_versions(folder: Path, device: str) -> None:
    """Write the versions with which a study starts; a line on stderr shows those that changed when it resumes.

    A device is one of them; the processes of a CPU, where most studies run, are not named.
    """
    trained_on = {} if device == "cpu" else {DEVICE: population.kind_of(device)}
    here, at_start = versions() | trained_on, manifest.sound_json(folder, VERSIONS)
    if at_start is None:
        manifest.say_flaws("", manifest.flaws(folder, [VERSIONS]), "written again with the present versions")
        files.write_json(folder / VERSIONS, here)
        manifest.seal(folder, [VERSIONS])
        return
    at_start, here = {DEVICE: "cpu", **at_start}, {DEVICE: "cpu", **here}
    others = [name for name in here if name != "python" and here[name] != at_start.get(name)]
    if others:
        changes = ", ".join(f"{name} {here[name]} (was {at_start.get(name, 'not recorded')})" for name in others)
        say(f"{folder}: resumes with other versions than at its start, numbers may differ: {changes}")


def _made_from(study: Study) -> dict[str, str]:
    """The settings that decide the numbers of a study, for its manifest: without claims, words and file paths."""
    table = study.model_dump(mode="json", exclude=WORDS)
    table = without_defaults(study, table, LATER_KEYS) if isinstance(study, StudySpec) else table
    for key in ("file", "path"):
        table.get("dataset", {}).pop(key, None)
    return {"settings": digest(placeless(table))}
