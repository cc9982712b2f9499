"""Formats of files, a module each; those of tables are listed here by their suffixes."""

from importlib import import_module
from pathlib import Path

from neurotact.data.readers.table.cells import Table
from neurotact.errors import InputError, nearest
from neurotact.files import check_size, existing

TABLES = {
    ".tdms": "tdms", ".parquet": "parquet", ".wav": "sound", ".flac": "sound", ".bag": "rosbag", ".mcap": "rosbag",
    ".db3": "rosbag",
}  # fmt: skip
"""Modules whose `read(path)` returns the tables in a file by their names."""


def tables_in(path: str | Path, wanted: str | None = None) -> dict[str, Table]:
    """The tables of a file, or the one that is wanted; InputError if there is none of that name."""
    path = existing(path)
    check_size(path, path.stat().st_size)
    tables = import_module(f"{__name__}.{TABLES[path.suffix.lower()]}").read(path)
    if wanted is not None and wanted not in tables:
        raise InputError(f"{path}: holds no group '{wanted[:40]}' of numbers; {nearest(wanted, [*tables])}")
    return tables if wanted is None else {wanted: tables[wanted]}
