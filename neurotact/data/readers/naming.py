"""The class and the conditions of a file: from its sub-folders, a pattern of its name, or a table of conditions."""

import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import pandas as pd
from pydantic import Field, model_validator

from neurotact.data.readers.headings import named_table
from neurotact.data.readers.tables import NUMBER, columns_of
from neurotact.data.recordings import LABEL
from neurotact.errors import InputError, nearest
from neurotact.spec import Names, Spec

FILE = "file"
FIELD = re.compile(r"\{([^{}]*)\}")
TEXTS = (".csv", ".tsv", ".txt", ".lvm")
SUFFIXES = (*TEXTS, ".npz", ".npy", ".mat", ".tdms")


class NamingSpec(Spec):
    """The source of the class and the conditions of a file.

    A pattern holds names in braces, `{label}_F{force}_{repetition}.csv`; each stands for one character or more, as few
    as fit. Values that are numbers in every file become numbers; `label` stays text.
    """

    levels: Names = ()
    """For each sub-folder, from the top: a condition (`speed`), or a pattern (`{speed}mm_per_s`). Deeper folders are
    read too. `label` alone if neither pattern nor table gives the label."""
    pattern: str | None = None
    """Pattern of the file's name; of the end of its path if the pattern holds a `/`."""
    table: str | None = Field(default=None)
    """A CSV file with the column `file`, the path or the name of each file, and a column for each condition."""
    label: str | None = None
    """The condition that is the class, where none is called `label`."""

    @model_validator(mode="after")
    def _names_each_condition_once(self) -> "NamingSpec":
        if self.pattern is not None and not FIELD.search(self.pattern):
            raise ValueError(f"pattern must hold a name in braces, such as {{label}}; got {self.pattern!r}")
        patterns = [*self.levels, *([] if self.pattern is None else [self.pattern])]
        names = [name for pattern in patterns for name in _fields(pattern)]
        wrong = [name for name in names if not name.isidentifier()]
        twice = [name for name in names if names.count(name) > 1]
        if wrong:
            raise ValueError(f"a condition is a word of letters, digits and _; got {wrong[0]!r}")
        if twice or FILE in names:
            raise ValueError(f"{(twice or [FILE])[0]!r} is named twice; give each condition once")
        return self

    @property
    def is_label_by_folder(self) -> bool:
        """Whether the label is the first sub-folder because nothing else is given."""
        is_given = bool(self.levels) or self.table is not None or self.label not in (None, LABEL)
        return not is_given and LABEL not in _fields(self.pattern or "")


def conditions_of(files: Sequence[str], naming: NamingSpec, folder: Path) -> pd.DataFrame:
    """One row per file (paths within `folder`): label, the other conditions, file.

    Raises InputError for a file that does not fit a level, the pattern or the table, and if no label is given.

    >>> naming = NamingSpec(levels="label", pattern="F{force}_{repetition}.csv")
    >>> conditions_of(["felt/F3_0.csv", "felt/F6_0.csv"], naming, Path("my-data")).values.tolist()
    [['felt', 3, 0, 'felt/F3_0.csv'], ['felt', 6, 0, 'felt/F6_0.csv']]
    """
    table = _read_table(naming.table, files) if naming.table is not None else {file: {} for file in files}
    levels = (LABEL,) if naming.is_label_by_folder else naming.levels
    rows = []
    for file in files:
        parts = [_of_levels(file, levels, folder), _of_pattern(file, naming.pattern, folder), table[file]]
        names = [name for part in parts for name in part]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(f"{naming.table}: the condition '{twice[0]}' is also given by the file's path or name")
        rows.append({name: value for part in parts for name, value in part.items()})
    conditions = _with_label(pd.DataFrame(rows), naming.label, folder)
    for name in conditions.columns.drop(LABEL):
        conditions[name] = _as_numbers(conditions[name])
    conditions = conditions[[LABEL, *conditions.columns.drop(LABEL)]]
    conditions[FILE] = list(files)
    return conditions


def _with_label(conditions: pd.DataFrame, label: str | None, folder: Path) -> pd.DataFrame:
    """The conditions of each file, that which is the class called `label`."""
    names = [*map(str, conditions.columns)]
    if label is not None and label not in names:
        if not names:
            raise InputError(
                f"{folder}: no condition is called {label}, as no condition is named; name the sub-folders with "
                f"`levels={label!r}`, or leave out `label`: the first sub-folder is the class"
            )
        raise InputError(f"{folder}: no condition is called {label}; {nearest(label, names)}")
    if label not in (None, LABEL):
        if LABEL in names:
            raise InputError(f"{folder}: a condition is called label already; rename it, or leave out `label`")
        conditions = conditions.rename(columns={label: LABEL})
    if LABEL not in conditions:
        fix = (
            f"name it with `label`, of {', '.join(names)}"
            if names
            else "add it with `levels`, `pattern` or `conditions`"
        )
        raise InputError(f"{folder}: no condition is called label, the class of each file; {fix}")
    return conditions


def _fields(pattern: str) -> list[str]:
    """The names in a pattern; a level without braces is a name."""
    return FIELD.findall(pattern) if "{" in pattern else [pattern]


def _compiled(pattern: str) -> re.Pattern[str]:
    """A pattern with names in braces as a regular expression of named groups."""
    parts = FIELD.split(pattern)  # text, name, text, ...
    return re.compile("".join(re.escape(part) if i % 2 == 0 else f"(?P<{part}>[^/]+?)" for i, part in enumerate(parts)))


def _of_levels(file: str, levels: Sequence[str], folder: Path) -> dict[str, str]:
    above = PurePosixPath(file).parts[:-1]
    if len(above) < len(levels):
        raise InputError(
            f"{folder / file}: is {len(above)} sub-folders deep, but `levels` names {len(levels)} "
            f"({', '.join(levels)}); move it, or name fewer levels"
        )
    levels_found = {}
    for level, folder_name in zip(levels, above, strict=False):
        if "{" not in level:
            levels_found[level] = folder_name
            continue
        match = _compiled(level).fullmatch(folder_name)
        if match is None:
            raise InputError(
                f"{folder / file}: the folder '{folder_name}' does not fit the level {level}; rename one of them"
            )
        levels_found |= match.groupdict()
    return levels_found


def _of_pattern(file: str, pattern: str | None, folder: Path) -> dict[str, str]:
    if pattern is None:
        return {}
    path = PurePosixPath(file)
    if not pattern.lower().endswith(SUFFIXES):
        path = path.with_suffix("")
    depth = pattern.count("/") + 1
    match = _compiled(pattern).fullmatch("/".join(path.parts[-depth:]))
    if match is None:
        raise InputError(f"{folder / file}: its name does not fit the pattern {pattern}; rename it or move it away")
    return match.groupdict()


def _read_table(path: str, files: Sequence[str]) -> dict[str, dict[str, str]]:
    """The conditions of each file, by the table in `path`."""
    table = named_table(Path(path))
    if FILE not in table.names:
        raise InputError(f"{path}: has no column 'file', the path of each file; {nearest(FILE, [*table.names])}")
    if "" in table.names:
        raise InputError(f"{path}: column {table.names.index('') + 1} has no name; give it one, or remove it")
    columns = columns_of(table)
    by_name: dict[str, list[str]] = {}
    for file in files:
        by_name.setdefault(PurePosixPath(file).name, []).append(file)
    rows: dict[str, dict[str, str]] = {}
    for number, row in enumerate(zip(*(columns[name].tolist() for name in table.names), strict=True), table.first_line):
        given = dict(zip(table.names, row, strict=True))
        name = given.pop(FILE)
        fitting = [name] if name in files else by_name.get(name, [])
        if len(fitting) != 1:
            why = "is not a file of recordings in the folder" if not fitting else f"is the name of {len(fitting)} files"
            raise InputError(f"{path}: line {number}: '{name[:80]}' {why}; give its path within the folder")
        if fitting[0] in rows:
            raise InputError(f"{path}: line {number}: '{name[:80]}' already has a line above; drop one of them")
        rows[fitting[0]] = given
    absent = [file for file in files if file not in rows]
    if absent:
        raise InputError(f"{path}: has no line for {absent[0]} ({len(absent)} in all); add it or move the file away")
    return rows


def _as_numbers(values: pd.Series) -> pd.Series:
    """Texts as numbers if all of them are; a leading zero, as in 007, makes a name."""
    texts = values.astype(str)
    if not all(NUMBER.fullmatch(text) and not re.match(r"[+-]?0\d", text) for text in texts):
        return values
    return pd.to_numeric(texts)
