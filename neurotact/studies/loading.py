"""Studies by name or path, and the engine of each: only this module tells ways that are an engine from the others."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from neurotact import plugins
from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.studies import automatic, study, way_cells, way_study
from neurotact.studies.automatic import CHOICE
from neurotact.studies.engine import Engine
from neurotact.studies.study import StudySpec
from neurotact.studies.way_study import WayStudy

Study = StudySpec | WayStudy


def engine_of(what: Study) -> Engine:
    """How the cells of a study are prepared and run: by the engine that its way is, or by that of all other ways."""
    return _own_engine(what.way) or way_cells.ENGINE


def _own_engine(way: Any) -> Engine | None:
    """The engine that a way is; None for a module with `load` and `run`, or a name that is no text."""
    part = plugins.load("ways", way) if isinstance(way, str) else None
    return part if isinstance(part, Engine) else None


def resolve(
    name: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> Study:
    """Load a study file with its complete parts; see `study.resolve` and `way_study.resolve`."""
    path = specs.find(StudySpec.folder, name)
    table = automatic.table_of(path)
    if "protocol" in table and "dataset" not in table:
        raise InputError(f"{path}: its key `protocol` is now called `way`; rename it")
    overrides = {**(overrides or {})}
    way, asked = table.get("way", study.NETWORKS), overrides.get("way")
    if way != study.NETWORKS and asked not in (None, study.NETWORKS, way):
        raise InputError(f"target: {path.stem} is a study of its own way, of classes; own-recordings takes targets")
    if "way" in table and _own_engine(way) is None:
        return way_study.resolve(table, path, overrides, quick=quick, data=data)
    engine = _own_engine(asked or way)
    if engine is not None and engine.own is not None:
        overrides |= engine.own(table, overrides, quick, data)
    found = study.resolve(name, overrides, quick=quick, data=data)
    next(engine_of(found).cells(found), None)  # the way refuses here what it cannot run
    return found


def choice_changes(where: Mapping[str, Any], leave_out: Mapping[str, Any]) -> dict[str, Any]:
    """The trials that a study uses, as changes of it; none if it uses all."""
    return {key: dict(value) for key, value in zip(CHOICE, (where, leave_out), strict=True) if value}


def read_back(path: Path) -> Study:
    """The resolved study of a run folder; InputError for one that was saved in another form."""
    fix = "remove the folder, or run the study in another one"
    table = specs.unsaved(specs.read(path), f"{path.parent}: its {path.name} is a study", fix)
    own = _own_engine(table.get("way", study.NETWORKS))
    return specs.build(WayStudy if own is None else StudySpec, table, source=str(path))
