"""Formats of files that are no plain text, each a part that is found by its suffix (entry points `neurotact.formats`).

`contents`: what a file holds, by its first bytes.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from neurotact import plugins
from neurotact.data.readers.formats.contents import Content, check_content, damaged_as
from neurotact.data.readers.table.cells import Table
from neurotact.errors import InputError, nearest
from neurotact.files import check_size, existing

Cells = list[np.ndarray]
"""The matrices of a cell array of MATLAB, one after another."""
Holds = Literal["tables", "arrays"]


class Arrays(NamedTuple):
    """What a file of arrays holds. arrays: numbers and texts by name.

    cells: arrays of matrices of numbers, of any sizes, or of vectors alone. others: the names of what is not read.
    """

    arrays: Mapping[str, np.ndarray]
    cells: Mapping[str, Cells] = {}
    others: Sequence[str] = ()


class Format(NamedTuple):
    """How files of a suffix are read (entry point group `neurotact.formats`; the name is the suffix without its point).

    about: as in "a Parquet table". fix: what to do about a file that is damaged, or another one, as in "save it again".
    read: called as `read(path)`. It returns tables by their names, "" for the only one (`table_of` makes one), or
    `Arrays`: `holds` says which. What it raises for damaged bytes is said in one sentence with `fix`.
    contents: what the first bytes of such files say, if they are among what `contents` knows.

    >>> Format("a touch", "record it again", lambda path: Arrays({"press": np.ones((50, 3))}), "arrays").holds
    'arrays'
    """

    about: str
    fix: str
    read: Callable[[Path], Mapping[str, Table] | Arrays]
    holds: Holds = "tables"
    contents: tuple[Content, ...] = ()


def suffixes(holds: Holds | None = None) -> tuple[str, ...]:
    """The suffixes of all formats, in small letters; of those that hold tables or arrays, which imports them.

    >>> {".mat", ".tdms"} <= {*suffixes()}, ".mat" in suffixes("tables")
    (True, False)
    """
    names = plugins.in_order("formats")
    return tuple(f".{name}" for name in names if holds is None or _format(name).holds == holds)


def holding(path: Path) -> Holds | None:
    """What files of the suffix of this one hold; None if there is no such format."""
    suffix = path.suffix.lower()
    return _format(suffix[1:]).holds if suffix in suffixes() else None


def _format(name: str) -> Format:
    form = plugins.load("formats", name, Format)
    if not callable(form.read) or form.holds not in get_args(Holds):
        raise plugins.unfit("formats", name, "has nothing to call, or holds neither tables nor arrays")
    return form


def tables_in(path: str | Path, wanted: str | None = None, *, name: str | None = None) -> dict[str, Table]:
    """The tables of a file, or the one that is wanted; InputError if there is none of that name.

    name: of the format; that of the file's suffix when None.
    """
    tables = _read(Path(path), name, dict)
    if wanted is not None and wanted not in tables:
        raise InputError(f"{path}: holds no group '{wanted[:40]}' of numbers; {nearest(wanted, [*tables])}")
    return tables if wanted is None else {wanted: tables[wanted]}


def arrays_in(path: str | Path) -> Arrays:
    """The arrays of a file whose format holds some."""
    return _read(Path(path), None, Arrays)


def _read(path: Path, name: str | None, kind: type) -> Any:
    """What the format of a file reads there, which must be of a kind."""
    path, name = existing(path), name or path.suffix[1:].lower()
    form = _format(name)
    check_size(path, path.stat().st_size)
    if form.contents:
        check_content(path, *form.contents, wanted=form.about, fix=form.fix)
    with damaged_as(path, f"cannot be read as {form.about}", form.fix):
        held = form.read(path)
    values = held.values() if isinstance(held, dict) else ()
    if not isinstance(held, kind) or not all(isinstance(value, Table) for value in values):
        raise plugins.unfit("formats", name, f"gives a {type(held).__name__} where {form.holds} are expected")
    return held
