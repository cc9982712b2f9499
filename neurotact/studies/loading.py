"""Studies by name or path, and the kind of each: only this module distinguishes the kinds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neurotact import spec as specs
from neurotact.data.hdf5 import load_spikes
from neurotact.studies import cell, network_tables, preparation, protocol_cell, protocol_study, study, suited
from neurotact.studies.kind import Kind
from neurotact.studies.protocol_study import ProtocolStudy
from neurotact.studies.study import StudySpec
from neurotact.studies.suited import CHOICE

Study = StudySpec | ProtocolStudy
NETWORKS = Kind(
    study.cells, preparation.prepare, preparation.check, load_spikes, cell.run_cell, network_tables.tables
)  # fmt: skip
"""Studies of spiking networks, or of afferents alone: cells share recordings and the spikes of every swept encoder."""
PROTOCOL = Kind(
    protocol_study.cells, protocol_cell.prepare, protocol_cell.check, protocol_cell.load_arrays,
    protocol_cell.run_cell, protocol_cell.tables,
)  # fmt: skip
"""Studies of a paper's own system: cells share the arrays of its data."""


def kind_of(what: Study) -> Kind:
    """The kind of a study."""
    return PROTOCOL if isinstance(what, ProtocolStudy) else NETWORKS


def resolve(
    name: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> Study:
    """Load a study file with its complete parts; see `study.resolve` and `protocol_study.resolve`."""
    path = specs.find(StudySpec.folder, name)
    table = suited.table_of(path)
    if "protocol" in table:
        return protocol_study.resolve(table, path, overrides, quick=quick, data=data)
    return study.resolve(name, overrides, quick=quick, data=data)


def choice_changes(where: Mapping[str, Any], leave_out: Mapping[str, Any]) -> dict[str, Any]:
    """The trials that a study uses, as changes of it; none if it uses all."""
    return {key: dict(value) for key, value in zip(CHOICE, (where, leave_out), strict=True) if value}


def read_back(path: Path) -> Study:
    """The resolved study of a run folder; InputError for one that was saved in another form."""
    fix = "remove the folder, or run the study in another one"
    table = specs.unsaved(specs.read(path), f"{path.parent}: its {path.name} is a study", fix)
    return specs.build(ProtocolStudy if "protocol" in table else StudySpec, table, source=str(path))
