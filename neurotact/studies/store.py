"""The files of a run folder, with checksums: an edited or damaged file is detected and never used.

Every folder of a run that contains results (the run's own, `spikes`, `data`, each of `cells/<digest>`) has one
`files.json`. It is written after the files that it lists. It contains the SHA-256 of each file and of its sources, and
its bytes depend on these files alone.
"""

import hashlib
import json
import math
import re
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from neurotact import files
from neurotact.errors import InputError
from neurotact.progress import say
from neurotact.studies.engine import AnyCell, Files

FILES, CELLS = "files.json", "cells"
ANSWER, PAGE = "answer.json", "report.html"
"""The first screen of a report for programs, where its study has an answer in words, and the report."""
BASELINES = ("baselines.csv", "baselines_trials.csv")
"""What the classifiers beside the networks of a study reach, and each of their trials."""
STUDY, RECORDINGS = "STUDY", "RECORDINGS"
"""Stand in the commands of answer.json for the folder and the recordings of the study, wherever they are."""
DATA = "data.json"
"""Describes the recordings of a run: their hash, number of trials, classes."""
RESULT = "result.json"
TIMING = "timing.json"
"""The time of a cell, or of the parts of a study: the only file that differs from run to run; no manifest lists it."""
Flaws = dict[str, str | None]
"""The flaw of each file, in words that follow its name; None for a file that was never completely written."""
MISSING = "is missing"


class _Manifest(NamedTuple):
    """The content of a `files.json`: the SHA-256 of each file by its name in the folder, and of their sources."""

    made_from: dict[str, str]
    files: dict[str, str]


def seal(folder: Path, names: Iterable[str], made_from: Mapping[str, str] | None = None) -> None:
    """List files of a folder with their present hashes. Earlier entries stay if the sources are the same.

    made_from: hashes of the sources of the files, by name; None means as listed before.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> files.write_text(folder / "result.csv", "accuracy")
    >>> seal(folder, ["result.csv"], {"spikes": "ab12"})
    >>> flaws(folder, ["result.csv"], {"spikes": "ab12"})
    {}
    >>> flaws(folder, ["result.csv", "sops.csv"], {"spikes": "cd34"})
    {'result.csv': 'was made from other spikes', 'sops.csv': None}
    >>> files.write_text(folder / "result.csv", "100 %")
    >>> flaws(folder, ["result.csv"])
    {'result.csv': 'was changed'}
    """
    known = read(folder) or _Manifest({}, {})
    sources = known.made_from if made_from is None else dict(made_from)
    before = known.files if known.made_from == sources else {}
    listed = before | {name: files.sha256(folder / name) for name in names}
    table = {"made_from": dict(sorted(sources.items())), "files": dict(sorted(listed.items()))}
    files.write_json(folder / FILES, table)


def read(folder: Path) -> _Manifest | None:
    """The manifest of a folder; None if it is missing or damaged."""
    try:
        table = files.read_json(folder / FILES)
    except InputError:
        return None
    parts: list[Any] = [table.get(name) for name in _Manifest._fields] if isinstance(table, dict) else []
    are_texts = [isinstance(part, dict) and all(isinstance(text, str) for text in part.values()) for part in parts]
    return _Manifest(*parts) if parts and all(are_texts) else None


def flaws(folder: Path, names: Iterable[str], made_from: Mapping[str, str] | None = None) -> Flaws:
    """The files among `names` that differ from the manifest, with their flaws; empty if all agree with it.

    made_from: the sources that the files must have; None if any are allowed.
    """
    known = read(folder)
    by_name = {name: _flaw(folder, name, known, made_from) for name in names}
    return {name: flaw for name, flaw in by_name.items() if flaw != ""}


def _flaw(folder: Path, name: str, known: _Manifest | None, made_from: Mapping[str, str] | None) -> str | None:
    """As `flaws`, for one file; an empty text if it is not damaged."""
    path = folder / name
    if known is None and (folder / FILES).is_file():
        return f"cannot be checked, since {FILES} is damaged"
    if known is None or name not in known.files:
        return f"is not listed in {FILES}" if path.is_file() else None
    if made_from is not None and known.made_from != made_from:
        keys = {*made_from, *known.made_from}
        return f"was made from other {min(key for key in keys if made_from.get(key) != known.made_from.get(key))}"
    if not path.is_file():
        return MISSING
    if path.stat().st_size > files.max_bytes():  # no file of a run is so large, and hashing it may take hours
        return "was changed"
    return "" if files.sha256(path) == known.files[name] else "was changed"


def say_flaws(folder: str, by_name: Flaws, remedy: str) -> None:
    """Print a line on stderr for each damaged file that was completely written before.

    folder: the name of the folder, with a slash at its end.
    """
    for name, flaw in by_name.items():
        if flaw is not None:
            say(f"{folder}{name}: {flaw}; {remedy}")


def check(folder: Path, paths: Iterable[str]) -> None:
    """Raise InputError if one of these files was changed; files that do not exist are ignored."""
    for path in paths:
        parent, name = (folder / path).parent, Path(path).name
        flaw = flaws(parent, [name]).get(name)
        if flaw is not None and (parent / name).is_file():
            raise InputError(f"{folder / path}: {flaw}; {resuming(folder)} writes it again")


def sound_json(folder: Path, name: str) -> Any:
    """The content of a listed JSON file; None if it differs from the manifest."""
    return None if flaws(folder, [name]) else files.read_json(folder / name)


def fingerprint(path: Path) -> str | None:
    """The SHA-256 of a file, or of the names and contents of all files in a folder; None if neither exists.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> empty = fingerprint(folder)
    >>> files.write_text(folder / "touch.csv", "0")
    >>> fingerprint(folder) == empty, fingerprint(folder / "away")
    (False, None)
    """
    if path.is_dir():
        inside = sorted(one for one in path.rglob("*") if one.is_file())
        listed = [[one.relative_to(path).as_posix(), files.sha256(one)] for one in inside]
        return hashlib.sha256(json.dumps(listed).encode()).hexdigest()
    return files.sha256(path) if path.is_file() else None


@contextmanager
def timed(folder: Path, part: str, *, again: bool = True) -> Iterator[None]:
    """Add the seconds of the block to those of a part of a study, in `timing.json`.

    again: to those of earlier runs in the folder, whose work it goes on with; else in their place.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with timed(folder, "encode"):
    ...     pass
    >>> 0 <= parts_took(folder)["encode"] < 60
    True
    """
    began = perf_counter()
    yield
    add_time(folder, part, perf_counter() - began, again=again)


def add_time(folder: Path, part: str, seconds: float, *, again: bool = True) -> None:
    """As `timed`, of work that took so long."""
    known = parts_took(folder)
    files.write_json(folder / TIMING, {**known, part: seconds + (known.get(part, 0.0) if again else 0.0)})


def parts_took(folder: Path) -> dict[str, float]:
    """The seconds of each part of a study beside its cells; empty if the file is damaged, since no result needs it."""
    try:
        table = files.read_json(folder / TIMING)
    except InputError:
        return {}
    known: dict[str, Any] = table if isinstance(table, dict) else {}
    return {name: value for name, value in known.items() if type(value) in (int, float) and 0 <= value < math.inf}


def cell_folder(folder: Path, cell: AnyCell) -> Path:
    """The folder of a cell's files."""
    return folder / CELLS / cell.digest()


def write_cell(left: Files, cell: AnyCell, folder: Path) -> None:
    """Write the files of a cell into its folder, then the manifest, which marks the cell as done."""
    target = cell_folder(folder, cell)
    for name, content in sorted(left.items()):
        with files.whole(target / name) as draft:
            draft.write_bytes(content)
    seal(target, left.keys() - {TIMING}, _sources(folder, cell))


def is_done(folder: Path, cell: AnyCell) -> bool:
    """Whether the files of a cell are unchanged, and were made from the present spikes.

    Its result must exist; a report does not require the network and the other files, which a user may remove.
    """
    return all(flaw == MISSING and name != RESULT for name, flaw in _flaws_of(folder, cell).items())


def damage(folder: Path, cell: AnyCell) -> str | None:
    """Why a finished cell is damaged, in words; None if it is not damaged or was never finished."""
    return next((f"{name} {flaw}" for name, flaw in _flaws_of(folder, cell).items() if flaw is not None), None)


def _flaws_of(folder: Path, cell: AnyCell) -> Flaws:
    target = cell_folder(folder, cell)
    known = read(target)
    return flaws(target, dict.fromkeys([RESULT, *(known.files if known else ())]), _sources(folder, cell))


def _sources(folder: Path, cell: AnyCell) -> dict[str, str]:
    """A cell's own digest, and the SHA-256 of its input file."""
    given = folder / cell.given
    known = read(given.parent)
    return {"settings": cell.digest(), given.parent.name: known.files.get(given.name, "") if known else ""}


def discard(folder: Path, cell: AnyCell) -> None:
    """Remove all files of a cell."""
    target = cell_folder(folder, cell)
    try:
        shutil.rmtree(target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{target}: is damaged and cannot be removed ({reason}); remove it") from error


def result_of(folder: Path, cell: AnyCell) -> dict[str, Any]:
    """The result of a finished cell."""
    return files.read_json(cell_folder(folder, cell) / RESULT)


def timing_of(folder: Path, cell: AnyCell) -> dict[str, float]:
    """The seconds of a cell and, for a network, its epochs; empty if the file is damaged, since no result needs it."""
    try:
        table = files.read_json(cell_folder(folder, cell) / TIMING)
    except InputError:
        return {}
    parts = ("seconds", "epochs")
    known: dict[str, Any] = {name: table.get(name) for name in parts} if isinstance(table, dict) else {}
    return {name: value for name, value in known.items() if type(value) in (int, float) and 0 <= value < math.inf}


def resuming(folder: Path) -> str:
    """The command that goes on with the study in a folder.

    >>> resuming(Path("my runs/mine"))
    "neurotact study resume 'my runs/mine'"
    """
    return shlex.join(["neurotact", "study", "resume", str(folder)])


def moved(command: str, places: Mapping[str, str]) -> str:
    """A command whose paths begin elsewhere. places: the new beginning of a path, by the one that it has.

    >>> moved("neurotact study run STUDY/study.toml -o STUDY-more", {STUDY: "/my runs/mine"})
    "neurotact study run '/my runs/mine/study.toml' -o '/my runs/mine-more'"
    """
    words = shlex.split(command)
    for old, new in places.items():
        begins = re.compile(rf"{re.escape(old)}(?=[/\\-]|$)")
        words = [begins.sub(lambda _, new=new: new, word, count=1) if begins.match(word) else word for word in words]
    return shlex.join(words)
