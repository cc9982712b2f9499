"""What running a study asks of either kind: the sweep of a spiking network, or a paper's own protocol."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from neurotact import spec as specs
from neurotact.data.hdf5 import load_spikes
from neurotact.data.spikes import SpikeTrains
from neurotact.studies import cell, preparation, protocol_cell, protocol_study, selection, study
from neurotact.studies.cell import AnyCell, Files
from neurotact.studies.protocol import Arrays
from neurotact.studies.protocol_study import ProtocolCell, ProtocolStudy
from neurotact.studies.study import StudySpec
from neurotact.workers import in_a_process

Study = StudySpec | ProtocolStudy
Given = SpikeTrains | Arrays
"""What a cell works on: the spikes of its encoder, or the arrays of its protocol."""
MapCells = Callable[[list[AnyCell], Path], Iterator[tuple[AnyCell, Files]]]
"""Computes cells from what they work on in a run folder; yields each with what it leaves, as it is done."""


def resolve(name: str | Path, overrides: Mapping[str, Any] | None = None, *, quick: bool = False) -> Study:
    """Load a study file with its parts whole; see `study.resolve` and `protocol_study.resolve`."""
    path = specs.find(StudySpec.folder, name)
    table = specs.read(path)
    if "protocol" in table:
        return protocol_study.resolve(table, path, overrides, quick=quick)
    return study.resolve(path, overrides, quick=quick)


def read_back(path: Path) -> Study:
    """The resolved study that a run folder holds."""
    table = specs.read(path)
    return specs.build(ProtocolStudy if "protocol" in table else StudySpec, table, source=str(path))


def cells(what: Study) -> list[AnyCell]:
    """The cells in the order of the sweep."""
    return list(protocol_study.cells(what) if isinstance(what, ProtocolStudy) else study.cells(what))


def steps(what: Study, folder: Path) -> Iterator[tuple[str, list[AnyCell]]]:
    """What is run one after the other, by name: all cells at once, unless a selection says which come next."""
    if isinstance(what, StudySpec) and what.selection is not None:
        for step in selection.steps(what, folder):
            yield step.name, list(step.cells)
    else:
        yield "cells", cells(what)


def asked_for(what: Study, folder: Path) -> list[AnyCell]:
    """The cells to run: all of the sweep, or of a selection those of its steps so far."""
    if isinstance(what, StudySpec) and what.selection is not None:
        return list(selection.asked_for(what, folder))
    return cells(what)


def prepare(what: Study, folder: Path) -> None:
    """Write what cells share into a run folder, in a process of its own, whose memory is then free again."""
    if isinstance(what, ProtocolStudy):
        in_a_process(protocol_cell.prepare, folder, list(protocol_study.cells(what)))
    else:
        in_a_process(preparation.prepare, folder, what, list(study.cells(what)))


def check(what: Study, folder: Path) -> None:
    """Refuse a run folder where what `prepare` wrote was changed."""
    if isinstance(what, ProtocolStudy):
        protocol_cell.check(folder, protocol_study.cells(what))
    else:
        preparation.check(folder, what, list(study.cells(what)))


def given_path(folder: Path, one: AnyCell) -> Path:
    """Where a run folder holds what a cell works on."""
    return folder / one.given


def load_given(path: Path) -> Given:
    """What a cell works on, from its file."""
    return protocol_cell.load_arrays(path) if path.suffix == ".npz" else load_spikes(path)


def run_cell(one: AnyCell, given: Any, kept: Path | None = None) -> Files:
    """What a cell leaves. It may run on any machine: it reads and keeps nothing but what is passed."""
    return protocol_cell.run_cell(one, given) if isinstance(one, ProtocolCell) else cell.run_cell(one, given, kept)
