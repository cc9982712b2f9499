"""A protocol study: a spec that names the system of a paper, its parameters, and what to sweep; its cells.

A study file may hold a table `[with_data]`: dotted keys that are set where `--data` names a file, with a `title` and an
`about` of its own and a table `[with_data.quick]` in place of `[quick]`.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

from pydantic import model_validator

from neurotact import spec as specs
from neurotact.errors import InputError
from neurotact.spec import Spec
from neurotact.studies import suited, sweeps
from neurotact.studies.claims import Claim
from neurotact.studies.protocol import Own, module_of, optional

WORDS = ("title", "about")
"""Keys of `[with_data]` that are none of the parameters."""


class ProtocolStudy(Spec):
    """A study of one system (`studies/*.toml` with the key `protocol`)."""

    folder: ClassVar[str] = "studies"
    later_keys: ClassVar[tuple[str, ...]] = ("notes", "first_look")

    title: str
    """Heading of the report."""
    about: str = ""
    """What the study asks, in a sentence or two, below the heading."""
    protocol: str
    """The name of an entry point of the group `neurotact.protocols`."""
    parameters: dict[str, Any] = {}
    """Of the protocol; once resolved, all of them."""
    sweep: dict[str, list[Any]]
    """Values of each axis: a dotted key of the parameters, or several joined by ` & `."""
    claims: tuple[Claim, ...] = ()
    """Published statements that the results are judged by."""
    notes: tuple[str, ...] = ()
    """As of `StudySpec`."""
    first_look: bool = False
    """Whether this is a smaller sweep of the same kind (`--quick`)."""
    as_shipped: bool = False
    """As of `StudySpec`."""

    @model_validator(mode="after")
    def _has_a_sweep(self) -> "ProtocolStudy":
        sweeps.check(self.sweep)
        return self


class ProtocolCell(Spec):
    """One run of a protocol: everything that decides its numbers."""

    protocol: str
    parameters: dict[str, Any]

    def digest(self) -> str:
        """As of every spec, wherever a file lies whose content is named."""
        return specs.digest(placeless(self.model_dump(mode="json")))

    @property
    def given(self) -> str:
        """The file in a run folder that the cell works on."""
        return f"data/{self.data_name}.npz"

    @property
    def data_name(self) -> str:
        """The digest of what decides the arrays that the cell shares with others."""
        return specs.digest([self.protocol, placeless(self.parameters["data"])])

    def built(self) -> Any:
        """The parameters as the protocol's own spec."""
        return specs.build(module_of(self.protocol).Parameters, self.parameters, source=f"protocol {self.protocol}")


def placeless(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table without each `path` beside which the `content` of what lies there is named: that alone decides.

    >>> placeless({"mine": {"path": "touches.h5", "content": "ab12"}, "theirs": {"path": "fabrics"}})
    {'mine': {'content': 'ab12'}, 'theirs': {'path': 'fabrics'}}
    """
    hidden = {"path"} if table.get("content") is not None else set()
    inner = {key: placeless(value) if isinstance(value, Mapping) else value for key, value in table.items()}
    return {key: value for key, value in inner.items() if key not in hidden}


def resolve(
    table: dict[str, Any],
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    quick: bool = False,
    data: str | Path | None = None,
) -> ProtocolStudy:
    """The study in a file's table, with its parameters whole.

    overrides: dotted keys of the parameters (`data.trials`, or in full `parameters.data.trials`), or `sweep.KEY`.
    quick: apply the file's `[quick]` table of overrides first.
    data: a file of one's own, in place of the recordings that the study makes or reads. Raises InputError where its
        protocol takes none.
    """
    quick_overrides, with_data = (specs.pop_table(table, key, path) for key in ("quick", "with_data"))
    changes = dict(overrides or {})
    if data is None:
        changes = {**(quick_overrides if quick else {}), **changes}
    else:
        table |= {key: with_data.pop(key) for key in WORDS if key in with_data}
        own_quick = specs.pop_table(with_data, "quick", path)
        changes = {**with_data, **(own_quick if quick else {}), **changes}
    changes = {key.removeprefix("parameters."): value for key, value in changes.items()}
    if data is not None:
        changes, table["notes"] = _own(table, path, data, changes)
    table |= {"first_look": True} if quick else {}
    others = sweeps.unswept(table.setdefault("sweep", {}), changes, path)
    table["parameters"] = specs.override(table.get("parameters", {}), others)
    if not (overrides or quick or data) and path in specs.shipped(ProtocolStudy.folder):
        table["as_shipped"] = True
    study = specs.build(ProtocolStudy, table, source=str(path))
    model = module_of(study.protocol).Parameters
    swept = sweeps.keys(study.sweep)
    specs.refuse({**others, **dict.fromkeys(swept)}, model.decided)
    first = next(sweeps.points(study.sweep))
    # Swept keys may have no default: the first point stands for them while the others are made whole.
    whole = specs.build(model, specs.override(study.parameters, first), source=f"parameters of {path}")
    given = _without(whole.model_dump(mode="json", exclude_none=True), [key for key in swept if "." not in key])
    study = study.model_copy(update={"parameters": given})
    list(cells(study))  # A wrong value in a sweep is refused here, before anything runs.
    return study


def _own(table: Mapping[str, Any], path: Path, data: str | Path, given: Mapping[str, Any]) -> Own:
    """What the protocol of a study makes of a file of one's own."""
    make = optional(module_of(str(table["protocol"])), "own")
    if make is None:
        raise InputError(f"--data: {path.name} makes or reads its own recordings; leave --data out")
    return make(suited.file_of(data), given)


def cells(study: ProtocolStudy) -> Iterator[ProtocolCell]:
    """The cells in the order of the sweep: the first axis is the slowest."""
    model = module_of(study.protocol).Parameters
    if "data" not in model.model_fields:
        raise InputError(f"protocol {study.protocol}: its Parameters lack the field 'data'")
    for point in sweeps.points(study.sweep):
        table = specs.override(study.parameters, point)
        parameters = specs.build(model, table, source=f"sweep of {study.title}")
        yield ProtocolCell(protocol=study.protocol, parameters=parameters.model_dump(mode="json", exclude_none=True))


def swept_values(study: ProtocolStudy, cell: ProtocolCell) -> dict[str, Any]:
    """What the sweep decided of a cell, by the last name of each key, or the whole key where two end alike."""
    keys = sweeps.keys(study.sweep)
    ends = [key.rpartition(".")[2] for key in keys]
    named = {}
    for key, end in zip(keys, ends, strict=True):
        value = _at(cell.parameters, key)
        if value is None:  # at its default, a key that came later is not written
            value = _at(cell.built(), key)
        named[end if ends.count(end) == 1 else key] = str(value) if isinstance(value, (list, dict)) else value
    return named


def _at(place: Any, key: str) -> Any:
    """What stands at a dotted key, in tables or specs; None where nothing does."""
    for name in key.split("."):
        place = place.get(name) if isinstance(place, Mapping) else getattr(place, name, None)
    return place


def _without(table: dict[str, Any], keys: list[str]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in keys}
