"""The interface between the runner and each kind of study."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd

from neurotact.spec import Spec
from neurotact.studies.store import AnyCell, Files

Load = Callable[[Path], Any]
"""Loads the input of a cell from its file in a run folder."""
RunCell = Callable[[Any, Any, Path | None], Files]
"""Returns the files of a cell, from the cell, its input, and the folder from which an interrupted search resumes."""
StudyType = TypeVar("StudyType", bound=Spec)
CellType = TypeVar("CellType", bound=AnyCell)


class Engine(ABC, Generic[StudyType, CellType]):
    """Runs one kind of study: its cells, their shared inputs, the files of each cell, and the tables of all cells.

    study: the resolved study.
    load_given, run_cell: module-level functions, since other processes and machines call them without an engine.
    """

    load_given: Load
    run_cell: RunCell

    def __init__(self, study: StudyType) -> None:
        self.study = study

    @abstractmethod
    def cells(self) -> list[CellType]:
        """All cells of the sweep, in its order."""

    @abstractmethod
    def prepare(self, folder: Path) -> None:
        """Write the shared inputs of cells into a run folder, in a separate process that then frees its memory."""

    @abstractmethod
    def check(self, folder: Path) -> None:
        """Raise InputError if a file that `prepare` wrote was changed."""

    @abstractmethod
    def tables(self, folder: Path, done: Sequence[CellType]) -> Mapping[str, pd.DataFrame]:
        """The tables of the finished cells, by file name; the first is `results.csv`."""

    def steps(self, folder: Path) -> Iterator[tuple[str, list[CellType]]]:
        """The steps in order, each with its name and cells; a later step may depend on the results of earlier cells."""
        yield "cells", self.cells()

    def asked_for(self, folder: Path) -> list[CellType]:
        """The cells to run, as far as the finished cells decide them."""
        return self.cells()


MapCells = Callable[[Engine, list[AnyCell], Path], Iterator[tuple[AnyCell, Files]]]
"""Computes cells from their inputs in a run folder; yields each cell with its files as soon as it is finished."""
