"""Public tactile data sets: description, licence and download.

A set is downloaded if its files and their hashes are known; for the others, manual steps are printed. Files that
exist and are undamaged are not downloaded again. Archives are unpacked beside themselves.
"""

import gzip
import hashlib
import logging
import shlex
import shutil
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from neurotact.errors import InputError, nearest, optional
from neurotact.files import DRAFT, whole

REGISTRY = Path(__file__).parent / "registry"


class _PublicSet(NamedTuple):
    """A public data set.

    about, licence, size, citation, page: printed. reader: the `neurotact import` command that reads it; empty
    if there is none. base_url: of the files in the registry of its name, which may be a DOI at Zenodo or figshare; None
    if it is downloaded by hand, as `by_hand` says. folder: where the files are below the set's own folder. opens: the
    file that the reader takes.
    """

    about: str
    licence: str
    size: str
    citation: str
    page: str
    reader: str
    by_hand: str
    base_url: str | None = None
    folder: str = ""
    opens: str = ""


SETS = {
    name: _PublicSet(**fields)
    for name, fields in tomllib.loads((REGISTRY / "sets.toml").read_text(encoding="utf-8")).items()
}
"""Data sets by the names that `neurotact fetch` takes."""


def public_set(name: str) -> _PublicSet:
    """The set of that name; if there is none, InputError names the nearest."""
    if name not in SETS:
        raise InputError(f"fetch: there is no set '{name}'; {nearest(name, list(SETS))}")
    return SETS[name]


def registry_of(name: str) -> dict[str, str]:
    """The files of a set and their hashes (`sha256:...`, `md5:...`), as pooch takes them; empty if they are unknown."""
    path = REGISTRY / f"{name}.txt"
    if not path.is_file():
        return {}
    return dict(line.rsplit(" ", 1) for line in path.read_text(encoding="utf-8").splitlines())


def missing(name: str, folder: Path) -> list[str]:
    """The files of a set that are not in `folder`, are damaged there, or are not unpacked."""
    target = folder / public_set(name).folder
    return [file for file, known in registry_of(name).items() if not _is_whole(target / file, known)]


def fetch(
    name: str, folder: Path, progress: Callable[[int, str], None] | None = None, *, base_url: str | None = None
) -> int:
    """Download the missing files of a set into `folder`; returns their number.

    progress: called with 1 and its name after each file. base_url: replaces the set's own, for a mirror.
    Raises InputError, with the manual steps, for a set that is not downloaded, for a failed connection, and for a file
    that differs from the published one.
    """
    about = public_set(name)
    url, wanted = base_url or about.base_url, missing(name, folder)
    if url is None:
        raise InputError(f"{name}: {_by_hand(name, folder)}")
    target = folder / about.folder
    for file in wanted:
        _download(name, url + file, file, target, folder)
        if progress:
            progress(1, file)
    return len(wanted)


def _by_hand(name: str, folder: Path) -> str:
    """The manual steps for a set that is not downloaded."""
    about = public_set(name)
    place = shlex.quote(str(folder / about.opens))
    then = f"; then run neurotact import {about.reader} {place} -o {name}.h5" if about.reader else ""
    return f"{about.by_hand} from {about.page} to {folder / about.folder}{then}"


def _download(name: str, url: str, file: str, target: Path, folder: Path) -> None:
    """One file, whole or not at all: pooch loads it beside its place, checks the hash and renames it; then unpacked."""
    pooch = optional("pooch", "fetch: the package pooch is not installed; pip install pooch")
    pooch.get_logger().setLevel(logging.ERROR)
    try:
        pooch.retrieve(url, registry_of(name)[file], fname=file, path=target)
        _unpack(target / file)
    except (OSError, ValueError, KeyError) as error:  # of requests and the disk, of pooch, of a record of another form
        if isinstance(error, ValueError) and "does not match" in str(error):
            what = "is not the published file (its hash differs)"
        else:
            what = f"cannot be downloaded ({(str(error).splitlines() or [type(error).__name__])[0][:120]})"
        raise InputError(f"{name}: {url} {what}; {_by_hand(name, folder)}") from error


def _unpack(path: Path) -> None:
    """What an archive holds beside it, whole or not at all, in a folder or a file of its name."""
    unpacked = _unpacked(path)
    if path.suffix == ".gz":
        with gzip.open(path) as packed, whole(unpacked) as draft, draft.open("wb") as plain:
            shutil.copyfileobj(packed, plain)
    elif unpacked != path:
        with tempfile.TemporaryDirectory(prefix=DRAFT, dir=path.parent) as draft:
            shutil.unpack_archive(path, Path(draft) / unpacked.name)
            shutil.rmtree(unpacked, ignore_errors=True)
            (Path(draft) / unpacked.name).rename(unpacked)


def _unpacked(path: Path) -> Path:
    """Where the content of a file is once it is unpacked; the file itself if it is no archive."""
    return path.with_suffix("") if path.suffix in (".gz", ".zip") else path


def _is_whole(path: Path, known: str) -> bool:
    """Whether a file exists with this hash and, of an archive, whether its content exists, too."""
    if not path.is_file() or not _unpacked(path).exists():
        return False
    algorithm, _, digest = known.partition(":")
    with path.open("rb") as file:
        return hashlib.file_digest(file, algorithm).hexdigest() == digest
