"""A study of any other way than networks: a spec that names the way, its parameters, and its sweep; its cells.

A study file may contain a table `[with_data]`: dotted keys that are set if `data` names a file. It may have its own
`title` and `about`, and a table `[with_data.quick]` in place of `[quick]`.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from pydantic import model_validator

from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.spec import Spec
from neurotact.studies import automatic, sweeps
from neurotact.studies.claims import Claim
from neurotact.studies.way import Own, module_of, optional

WORDS = ("title", "about")
"""Keys of `[with_data]` that are not parameters."""


class WayStudy(Spec):
    """A study of one system (`studies/*.toml` with the key `way`)."""

    folder: ClassVar[str] = "studies"
    words: ClassVar[set[str]] = {"title", "about", "claims", "notes", "as_shipped", "first_look"}
    title: str
    """Heading of the report."""
    about: str = ""
    """The question of the study, in a sentence or two, below the heading."""
    way: str
    """The name of an entry point of the group `neurotact.ways`."""
    parameters: dict[str, Any] = {}
    """Of the way; a resolved study has all of them."""
    sweep: dict[str, list[Any]]
    """Values of each axis: a dotted key of the parameters, or several joined by ` & `."""
    claims: tuple[Claim, ...] = ()
    """Published statements with which the results are compared."""
    notes: tuple[str, ...] = ()
    """As of `StudySpec`."""
    first_look: bool = False
    """Whether this is a smaller sweep of the same kind (`quick`)."""
    as_shipped: bool = False
    """As of `StudySpec`."""

    @model_validator(mode="after")
    def _has_a_sweep(self) -> "WayStudy":
        sweeps.check(self.sweep)
        return self

    def digest(self) -> str:
        """As of `StudySpec`."""
        return specs.digest(_placeless(self.model_dump(mode="json", exclude=self.words)))


class WayCell(Spec):
    """One run of a way: everything that decides its numbers."""

    way: str
    parameters: dict[str, Any]

    def digest(self) -> str:
        """As for every spec, but without the path of a file that has a `content`."""
        return specs.digest(_placeless(self.model_dump(mode="json")))

    @property
    def given(self) -> str:
        """The input file of the cell in a run folder."""
        return f"data/{self.data_name}.npz"

    @property
    def data_name(self) -> str:
        """The digest of the parameters that decide the arrays that the cell shares with others."""
        return specs.digest([self.way, _placeless(self.parameters["data"])])

    def built(self) -> Any:
        """The parameters as the way's own spec."""
        return specs.build(module_of(self.way).Parameters, self.parameters, source=f"way {self.way}")


def _placeless(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table without each `path` or `file` that has a `content` next to it: the content alone decides the numbers.

    >>> _placeless({"mine": {"file": "touches.h5", "content": "ab12"}, "theirs": {"path": "fabrics"}})
    {'mine': {'content': 'ab12'}, 'theirs': {'path': 'fabrics'}}
    """
    ignored = {"path", "file"} if table.get("content") is not None else set()
    inner = {key: _placeless(value) if isinstance(value, Mapping) else value for key, value in table.items()}
    return {key: value for key, value in inner.items() if key not in ignored}


def resolve(
    table: dict[str, Any],
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> WayStudy:
    """The study in a file's table, with its complete parameters.

    overrides: dotted keys of the parameters (`data.trials`, or in full `parameters.data.trials`), or `sweep.KEY`.
    quick: apply the file's `[quick]` table of overrides first.
    data: a file of the user, in place of the recordings that the study makes or reads. Raises InputError if its
        way does not accept one.
    """
    quick_overrides, with_data = (specs.pop_table(table, key, path) for key in ("quick", "with_data"))
    table["parameters"] = automatic.placed(table.get("parameters", {}), path)
    changes = dict(overrides or {})
    if data is None:
        changes = {**(quick_overrides if quick else {}), **changes}
    else:
        table |= {key: with_data.pop(key) for key in WORDS if key in with_data}
        own_quick = specs.pop_table(with_data, "quick", path)
        changes = {**with_data, **(own_quick if quick else {}), **changes}
    changes = {key.removeprefix("parameters."): value for key, value in changes.items()}
    if data is None and {*automatic.CHOICE} & {*changes}:
        raise InputError(f"`where`, `leave_out`: {path.name} makes or reads its own recordings; leave them out")
    if data is not None:
        changes, table["notes"] = _own(table, path, data, changes)
    table |= {"first_look": True} if quick else {}
    others = sweeps.unswept(table.setdefault("sweep", {}), changes, path)
    table = specs.override(table, {f"parameters.{key}": value for key, value in others.items()})
    if not (overrides or quick or data) and path in specs.shipped(WayStudy.folder):
        table["as_shipped"] = True
    study = specs.build(WayStudy, table, source=str(path))
    model = module_of(study.way).Parameters
    swept = sweeps.keys(study.sweep)
    specs.refuse({**others, **dict.fromkeys(swept)}, model.decided)
    first = next(sweeps.points(study.sweep))
    # Swept keys may have no default: the first point supplies their values while the defaults of the others are set.
    whole = specs.build(model, specs.override(study.parameters, first), source=f"parameters of {path}")
    given = whole.model_dump(mode="json", exclude_none=True, exclude={key for key in swept if "." not in key})
    study = study.model_copy(update={"parameters": given})
    list(cells(study))  # A wrong value in a sweep raises an error here, before any cell runs.
    return study


def _own(table: Mapping[str, Any], path: Path, data: str | Path, given: Mapping[str, Any]) -> Own:
    """The changes of a study's way for a file of the user."""
    make = optional(module_of(str(table["way"])), "own")
    if make is None:
        raise InputError(f"`data`: {path.name} makes or reads its own recordings; leave `data` out")
    return make(automatic.file_of(data), given)


def cells(study: WayStudy) -> Iterator[WayCell]:
    """The cells in the order of the sweep: the first axis is the slowest."""
    model = module_of(study.way).Parameters
    if "data" not in model.model_fields:
        raise InputError(f"way {study.way}: its Parameters lack the field 'data'")
    for point in sweeps.points(study.sweep):
        table = specs.override(study.parameters, point)
        parameters = specs.build(model, table, source=f"sweep of {study.title}")
        yield WayCell(way=study.way, parameters=parameters.model_dump(mode="json", exclude_none=True))


def swept_values(study: WayStudy, cell: WayCell) -> dict[str, Any]:
    """The swept values of a cell, by the last name of each key, or by the whole key if two have the same last name."""
    keys = sweeps.keys(study.sweep)
    ends = [key.rpartition(".")[2] for key in keys]
    named = {}
    for key, end in zip(keys, ends, strict=True):
        value = cell.parameters
        for name in key.split("."):
            value = value.get(name) if isinstance(value, Mapping) else None
        named[end if ends.count(end) == 1 else key] = str(value) if isinstance(value, (list, dict)) else value
    return named
