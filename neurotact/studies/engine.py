"""What the runner asks of a study, whatever it sweeps."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd

from neurotact.spec import Spec
from neurotact.studies.store import AnyCell, Files

Load = Callable[[Path], Any]
"""What a cell works on, from its file in a run folder."""
RunCell = Callable[[Any, Any, Path | None], Files]
"""What a cell leaves, from the cell, what it works on, and the folder where an interrupted search goes on."""
StudyType = TypeVar("StudyType", bound=Spec)
CellType = TypeVar("CellType", bound=AnyCell)


class Engine(ABC, Generic[StudyType, CellType]):
    """Carries out one kind of study: which cells there are, what they share, what each leaves, and the tables of all.

    study: the resolved study.
    load_given, run_cell: functions of a module, since processes and machines that hold no engine call them.
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
        """Write what cells share into a run folder, in a process of its own, whose memory is then free again."""

    @abstractmethod
    def check(self, folder: Path) -> None:
        """Refuse a run folder where what `prepare` wrote was changed."""

    @abstractmethod
    def tables(self, folder: Path, done: Sequence[CellType]) -> Mapping[str, pd.DataFrame]:
        """The tables of the cells that are done, by the names of their files; the first is `results.csv`."""

    def steps(self, folder: Path) -> Iterator[tuple[str, list[CellType]]]:
        """What is run one after the other, by name; a later step may depend on what the cells before it left."""
        yield "cells", self.cells()

    def asked_for(self, folder: Path) -> list[CellType]:
        """The cells to run, as far as what is done says."""
        return self.cells()


MapCells = Callable[[Engine, list[AnyCell], Path], Iterator[tuple[AnyCell, Files]]]
"""Computes cells from what they work on in a run folder; yields each with what it leaves, as it is done."""
