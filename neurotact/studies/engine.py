"""What the runner needs of a way: how a study becomes cells, a cell gets its input, and input becomes a row."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import pandas as pd

Files = dict[str, bytes]
"""The files of a cell: the content of each, by its path in the cell's folder."""
Results = Sequence[tuple[Any, dict[str, Any]]]
"""Finished cells in the order of the sweep, each with the content of its result.json."""


class AnyCell(Protocol):
    """A cell of any study, with what its files require."""

    def digest(self) -> str:
        """The digest of everything that decides the cell's numbers: the name of its folder."""
        ...

    @property
    def given(self) -> str:
        """The input file of the cell in a run folder."""
        ...


class Step(NamedTuple):
    """A part of the sweep: its purpose, and its cells."""

    name: str
    cells: list[Any]


def _all_at_once(study: Any, cells: list[Any], folder: Path) -> Iterator[Step]:
    """A single step with every cell."""
    yield Step("cells", cells)


class Beside(NamedTuple):
    """What is computed beside the cells, by worker processes of this machine: its name, and jobs that need no cell.

    write: writes the results of `run`, by the places of their jobs, when all are there. at_once: whether several
    processes can do jobs at once; if not, one does all of them before the first cell.
    """

    name: str
    run: Callable[[Any], Any]
    jobs: Sequence[Any]
    write: Callable[[Mapping[int, Any]], None]
    at_once: bool


def _nothing_beside(folder: Path, study: Any, cells: list[Any], at_once: bool) -> Beside | None:
    """None."""


def _every_cell(study: Any, cells: list[Any], folder: Path) -> list[Any]:
    """All cells."""
    return cells


class Engine(NamedTuple):
    """How the studies of a way run, as functions of modules, which other processes and machines can call.

    cells: all cells of a study, in the order of its sweep.
    prepare: writes the inputs that cells share into a run folder; called in a process, which then frees its memory.
        Says whether several processes can hold them at once.
    beside: what is missing beside the cells; None if nothing is. at_once: as `prepare` says.
    check: raises InputError if a file that `prepare` wrote was changed.
    load: the input of a cell from its file.
    run: the files of a cell, from the cell, its input, the folder from which an interrupted search resumes, and whether
        it tells how long a training takes.
    tables: the tables of finished cells, by file name; the first is `results.csv`.
    steps: the cells in steps, each of which is done before the next is asked for; by default all are one step.
    wanted: the cells of all steps as far as results are known.
    report: writes the page of a run folder and gives its path; None for the page of such studies.
    own: the changes of a study that becomes one of this way, from its table, the given ones, `quick` and `data`.
    """

    cells: Callable[[Any], Iterator[Any]]
    prepare: Callable[[Path, Any, list[Any]], bool]
    check: Callable[[Path, Any, list[Any]], None]
    load: Callable[[Path], Any]
    run: Callable[[Any, Any, Path | None, bool], Files]
    tables: Callable[[Path, Any, Results], Mapping[str, pd.DataFrame]]
    beside: Callable[[Path, Any, list[Any], bool], Beside | None] = _nothing_beside
    steps: Callable[[Any, list[Any], Path], Iterator[Step]] = _all_at_once
    wanted: Callable[[Any, list[Any], Path], list[Any]] = _every_cell
    report: Callable[[Any, Path], Path] | None = None
    own: Callable[[Mapping[str, Any], Mapping[str, Any], bool, str | Path | None], Mapping[str, Any]] | None = None


MapCells = Callable[[Engine, list[AnyCell], Path, Beside | None], Iterator[tuple[Any, Any]]]
"""Does the jobs beside the cells, and computes cells from their inputs in a run folder.

Yields each cell with its files, and the place of each job with its result, as soon as it is finished."""
