"""Studies by name or path, and the engine of each kind: only this module distinguishes the kinds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neurotact import spec as specs
from neurotact.studies import protocol_study, study
from neurotact.studies.engine import Engine
from neurotact.studies.network_engine import NetworkEngine
from neurotact.studies.protocol_engine import ProtocolEngine
from neurotact.studies.protocol_study import ProtocolStudy
from neurotact.studies.study import StudySpec
from neurotact.studies.suited import CHOICE

Study = StudySpec | ProtocolStudy


def resolve(
    name: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> Study:
    """Load a study file with its complete parts; see `study.resolve` and `protocol_study.resolve`."""
    path = specs.find(StudySpec.folder, name)
    table = specs.read(path)
    if "protocol" in table:
        return protocol_study.resolve(table, path, overrides, quick=quick, data=data)
    return study.resolve(name, overrides, quick=quick, data=data)


def choice_changes(where: Mapping[str, Any], leave_out: Mapping[str, Any]) -> dict[str, Any]:
    """The trials that a study uses, as changes of it; none if it uses all."""
    return {key: dict(value) for key, value in zip(CHOICE, (where, leave_out), strict=True) if value}


def read_back(path: Path) -> Study:
    """The resolved study of a run folder."""
    table = specs.read(path)
    return specs.build(ProtocolStudy if "protocol" in table else StudySpec, table, source=str(path))


def engine_of(study: Study) -> Engine:
    """The engine of a study of a protocol, or of encoders and networks."""
    return ProtocolEngine(study) if isinstance(study, ProtocolStudy) else NetworkEngine(study)
