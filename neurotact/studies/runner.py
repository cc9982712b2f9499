"""Running a study: its cells, each done once, whatever interrupts it; then its tables."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd

from neurotact import files
from neurotact.errors import InputError
from neurotact.interrupt import stop_if_asked
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
"""Keys of a study that decide none of its numbers."""
MOST_NAMED, LONGEST_VALUE = 3, 40
"""Keys that are named where two studies differ, and characters of each value."""


def run(study: Study, folder: Path, workers: int = 2, scheduler: str | None = None, device: str = "cpu") -> None:
    """Run what is not yet done of `study` in `folder`, then write its tables; `report.write` shows them.

    scheduler: address of a Dask scheduler, whose workers compute the cells in place of `workers` processes here.
    device: a CUDA device that trains networks in their place, all at once.
    Each cell trains with one thread and seeds of its own, so that who computes it changes no number.
    What was damaged since it was written is written again, and a line on stderr names it.
    Raises InputError when the folder holds another study or anything else, when another process works in it, and when
    the scheduler cannot be used.
    """
    with files.locked(folder), ExitStack() as at_last:
        is_new = files.is_free(folder)
        with executor(workers, scheduler, device) as map_cells:
            _claim(folder, study, device)
            files.sweep(folder)
            at_last.callback(files.sweep, folder)  # of worker processes that were stopped
            try:
                _compute(study, folder, map_cells)
            except InputError:
                if is_new and not any(is_done(folder, cell) for cell in engine_of(study).cells()):
                    files.empty(folder)  # so that the command can be mended and given again
                raise
        _write_tables(study, folder)


def _compute(study: Study, folder: Path, map_cells: MapCells) -> None:
    """Write what cells share and what each leaves, as far as it is not there or damaged."""
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
            say(f"{folder}: goes on; {before} of {len(asked)} {name} are done already")
        if todo:
            with track(name, len(asked), done=before) as advance:
                for cell, left in map_cells(engine, todo, folder):
                    write_cell(left, cell, folder)
                    advance(1, "")
                    stop_if_asked()


def write_tables(folder: Path) -> None:
    """Write the tables of a run again from the cells that are done.

    A damaged cell is left out, and a line on stderr names it. Raises InputError when anything else was changed, and
    when another process works in the folder.
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
    """The study that a run folder holds; InputError when it holds none, or `study.toml` was edited."""
    path = files.existing(folder, "folder") / STUDY
    again = f"neurotact study run NAME -o {folder}"
    if not path.is_file():
        raise InputError(f"{folder}: holds no study; start one with {again}")
    study, known = read_back(path), manifest.read(folder)
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


def _write_tables(study: Study, folder: Path) -> None:
    """Write the tables of the cells that are done."""
    engine = engine_of(study)
    every = engine.asked_for(folder)
    done = [cell for cell in every if is_done(folder, cell)]
    if not done:
        raise InputError(f"{folder}: no cell is done yet; run neurotact study resume {folder}")
    if len(done) < len(every):
        say(f"{folder}: {len(done)} of {len(every)} cells are done; the tables show these")
    write_table(_timings_table(folder, done), folder / "timings.csv")
    for name, table in engine.tables(folder, done).items():
        write_table(table, folder / name)


def _timings_table(folder: Path, done: list[AnyCell]) -> pd.DataFrame:
    rows = [{"cell": cell.digest(), "seconds": None, **timing_of(folder, cell)} for cell in done]
    return pd.DataFrame(rows)


def _damaged(study: Study, folder: Path) -> Iterator[tuple[AnyCell, str, str]]:
    """Each cell that was done and is no longer whole, where it lies in the run folder, and why."""
    for cell in engine_of(study).cells():
        why = damage(folder, cell)
        if why is not None:
            yield cell, cell_folder(folder, cell).relative_to(folder).as_posix(), why


def _claim(folder: Path, study: Study, device: str = "cpu") -> None:
    """Make `folder` this study's; refuse one that is another's.

    A folder without a manifest, which got lost or was never there, is taken by the study that it holds.
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
    _keep_versions(folder, device)


def _differing(study: Study, path: Path) -> str:
    """Which keys of a study have other values in a run folder's `study.toml`; nothing where that cannot be read."""
    try:
        there, here = (leaves(each.model_dump(mode="json", exclude=WORDS)) for each in (read_back(path), study))
    except InputError:
        return ""
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    if not keys:
        return ""
    shown = [f"{key} = {_short(there.get(key))}, here {_short(here.get(key))}" for key in keys[:MOST_NAMED]]
    more = f" and {len(keys) - MOST_NAMED} more keys" if len(keys) > MOST_NAMED else ""
    return f" ({'; '.join(shown)}{more})"


def _short(value: Any) -> str:
    text = "absent" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def _keep_versions(folder: Path, device: str) -> None:
    """Write the versions that a study begins with; a line on stderr tells which others it goes on with.

    A GPU is one of them; the CPU, where most studies run, is not named.
    """
    gpu = {} if device == "cpu" else {DEVICE: "cuda"}
    here, began = versions() | gpu, manifest.sound_json(folder, VERSIONS)
    if began is None:
        manifest.say_flaws("", manifest.flaws(folder, [VERSIONS]), "written again with the versions that are here now")
        files.write_json(folder / VERSIONS, here)
        manifest.seal(folder, [VERSIONS])
        return
    began, here = {DEVICE: "cpu", **began}, {DEVICE: "cpu", **here}
    others = [name for name in here if name != "python" and here[name] != began.get(name)]
    if others:
        told = ", ".join(f"{name} {here[name]} (was {began.get(name, 'not recorded')})" for name in others)
        say(f"{folder}: goes on with other versions than it began with, numbers may differ: {told}")


def _made_from(study: Study) -> dict[str, str]:
    """What decides the numbers of a study, for its manifest: not its claims and words, nor where its files lie."""
    table = study.model_dump(mode="json", exclude=WORDS)
    table = without_defaults(study, table, LATER_KEYS) if isinstance(study, StudySpec) else table
    for key in ("file", "path"):
        table.get("dataset", {}).pop(key, None)
    return {"settings": digest(placeless(table))}
