"""What a search of hyperparameters is asked for: its spec, and the space of values that it tries.

Spaces are written in NNI's terms, `_type` and `_value`; their keys are keys of the network.
"""

import math
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from neurotact import effects
from neurotact import spec as specs
from neurotact.errors import InputError, nearest
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec

SPACES = "networks/spaces"
Space = Mapping[str, Mapping[str, Any]]
ARGUMENTS = {
    "choice": "a list of values, each once",
    "randint": "[lower, upper): two whole numbers, the lower one first",
    "uniform": "[low, high], low < high",
    "quniform": "[low, high, q], low < high and q > 0",
    "loguniform": "[low, high], 0 < low < high",
    "qloguniform": "[low, high, q], 0 < low < high and q > 0",
    "normal": "[mean, deviation], deviation > 0",
    "qnormal": "[mean, deviation, q], deviation and q > 0",
    "lognormal": "[mean, deviation] of the logarithm, deviation > 0",
    "qlognormal": "[mean, deviation, q], mean and deviation of the logarithm, deviation and q > 0",
}
"""What `_value` contains for each `_type`."""
LARGEST_LOGARITHM = math.log(specs.LARGEST)


class SearchSpec(Spec):
    """How hyperparameters are searched: `[search]` of a study, the options of `neurotact tune`, `nt.Search`."""

    public = "Search"
    space: dict[str, dict[str, Any]] = Field(default={}, json_schema_extra={"metavar": "NAME"})
    """What is searched: the name or path of a space in NNI's terms; if absent, around the network's choices. Or the
    space itself, a table of `_type` and `_value` for each key of the network; a study must name one."""
    tuner: Literal["tpe", "random", "grid"] = "tpe"
    """How trials are proposed: by NNI's tree-structured Parzen estimator, at random, or every point of a grid."""
    trials: int = Field(default=100, ge=1)
    """Number of networks to train."""
    batch: int = Field(default=8, ge=1)
    """Trials proposed together, each without the others' results; another number gives other proposals."""
    seed: int = Field(default=0, ge=0, le=2**32 - 1)
    """Random seed of the search."""
    objective: Literal["accuracy", "accuracy-sops"] = "accuracy"
    """Validation accuracy, or this minus `sops_weight` times log10(SOPs) with the Pareto front of both."""
    sops_weight: float = Field(default=0.1, ge=0)
    """w in accuracy - w log10(SOPs), which `objective="accuracy-sops"` maximises. With 0.1, half the SOPs are worth
    three points of accuracy."""
    max_sops: float | None = Field(default=None, gt=0)
    """Budget of the best network: mean SOPs per window. Any network within the budget has a higher value than any
    beyond it."""
    assessor: Literal["median-stop", "none"] = "median-stop"
    """median-stop stops trials below the median early; none trains all to the end. Those below: whose best epoch is
    below the median of the finished trials' mean so far."""
    start_epoch: int = Field(default=10, ge=1)
    """First epoch after which a trial may be stopped."""
    first: dict[str, Any] | None = None
    """Values of the keys of the space for the first trial, such as those of the network as given; the tuner proposes
    the others. If absent, it proposes all."""

    @field_validator("space", mode="before")
    @classmethod
    def _is_a_space(cls, value: Any) -> Any:
        value = load_space(value) if isinstance(value, (str, Path)) else value
        return _flatten(value) if isinstance(value, Mapping) else value

    @field_validator("space")
    @classmethod
    def _has_arguments(cls, space: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        if not space:
            raise ValueError("holds no key; name at least one, as in hidden = { _type = 'choice', _value = [20, 30] }")
        for key, dimension in space.items():
            complaint = _complaint(dimension)
            if complaint:
                raise ValueError(f"'{key}' {complaint}")
        return space

    @model_validator(mode="after")
    def _begins_within_its_keys(self) -> "SearchSpec":
        other = sorted({*(self.first or {})} - {*self.space})
        if other:
            raise ValueError(f"first: '{other[0]}' is not in the space; remove it, or search it")
        return self

    def check_given(self) -> None:
        effects.check_given(self.given(), objective=self.objective, assessor=self.assessor)

    def value(self, accuracy: float, sops: float) -> float:
        """What the tuner maximises.

        >>> spec = SearchSpec(space={"hidden": {"_type": "choice", "_value": [20]}}, objective="accuracy-sops")
        >>> round(spec.value(0.9, 1000.0), 6)
        0.6
        >>> round(spec.model_copy(update={"max_sops": 100.0}).value(0.9, 1000.0), 6)
        -1.4
        """
        value = accuracy
        if self.objective == "accuracy-sops":
            value -= self.sops_weight * math.log10(max(sops, 1.0))
        if self.max_sops is not None and sops > self.max_sops:
            value -= 1 + math.log10(sops / self.max_sops)
        return value

    @property
    def weighs_sops(self) -> bool:
        """Whether SOPs count as well as accuracy; their Pareto front is then shown."""
        return self.objective == "accuracy-sops" or self.max_sops is not None


def load_space(name: str | Path) -> dict[str, dict[str, Any]]:
    """The shipped space of this name, or the space at this path.

    >>> load_space("texture")["training.batch"]
    {'_type': 'choice', '_value': [64, 128]}
    """
    return _flatten(specs.read(specs.find(SPACES, name)))


def _flatten(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables of a space as dotted keys: `[training.batch]` means `"training.batch"`.

    >>> _flatten({"training": {"batch": {"_type": "choice", "_value": [64]}}})
    {'training.batch': {'_type': 'choice', '_value': [64]}}
    """
    flat: dict[str, Any] = {}
    for key, value in table.items():
        is_table = isinstance(value, Mapping) and value and not any(inner.startswith("_") for inner in value)
        flat |= _flatten(value, f"{prefix}{key}.") if is_table else {prefix + key: value}
    return flat


def check(space: Space, network: RSNNSpec, source: str) -> None:
    """Refuse a space that would propose a key or a value which `network` cannot have; InputError names both.

    Every choice is tried; for a range, both ends and a point between.
    """
    if not space:
        raise InputError(f"{source}: is missing; name at least one key, as in hidden = {{ _type = ..., _value = ... }}")
    for key, dimension in space.items():
        for value in _samples(dimension):
            try:
                apply(network, {key: value}, source)
            except InputError as error:
                is_whole = "a whole number" in str(error) and dimension["_type"] not in ("choice", "randint")
                hint = "; search whole numbers with quniform and q = 1" if is_whole else ""
                raise InputError(f"{error}{hint}") from None


def values_of(network: RSNNSpec, space: Space) -> dict[str, Any]:
    """A network's own values of the keys of a space, without those that it does not have.

    >>> values_of(RSNNSpec(hidden=40), {"hidden": {}, "training.batch": {}, "readout_tau_ms": {}})
    {'hidden': 40, 'training.batch': 128}
    """
    values = {}
    for key in space:
        value = attrgetter(key)(network)
        if value is not None:
            values[key] = list(value) if isinstance(value, tuple) else value
    return values


def apply(network: RSNNSpec, parameters: Mapping[str, Any], source: str) -> RSNNSpec:
    """`network` with dotted keys replaced.

    >>> apply(RSNNSpec(), {"hidden": 50, "training.batch": 64}, "example").training.batch
    64
    """
    return specs.build(RSNNSpec, specs.override(network.model_dump(mode="json"), parameters), source)


def tidy(dimension: Mapping[str, Any], value: Any) -> Any:
    """A proposed number without rounding errors: multiples of q rounded, whole numbers as integers.

    >>> tidy({"_type": "quniform", "_value": [0.1, 1, 0.1]}, 3 * 0.1)
    0.3
    """
    kind, arguments = dimension["_type"], dimension["_value"]
    if kind == "randint":
        return round(min(max(value, arguments[0]), arguments[1] - 1))
    if not kind.startswith("q"):
        return value
    neat = float(f"{value:.12g}")
    return int(neat) if float(arguments[2]).is_integer() and neat.is_integer() else neat


def _complaint(dimension: Mapping[str, Any]) -> str:
    """What is wrong with a `_type` and its `_value`; empty if nothing is."""
    if set(dimension) != {"_type", "_value"}:
        return "must have _type and _value, and nothing else, as in { _type = 'choice', _value = [20, 30] }"
    kind, arguments = dimension["_type"], dimension["_value"]
    if not isinstance(kind, str) or kind not in ARGUMENTS:
        return f"has the _type '{kind}', which NNI does not know; {nearest(str(kind), list(ARGUMENTS))}"
    if not isinstance(arguments, (list, tuple)) or not _suits(kind, list(arguments)):
        return f"has the _value {arguments!r}, but a {kind} needs {ARGUMENTS[kind]}"
    return ""


def _suits(kind: str, arguments: list[Any]) -> bool:
    if kind == "choice":
        is_once = all(value not in arguments[:index] for index, value in enumerate(arguments))
        return bool(arguments) and is_once and not any(isinstance(value, Mapping) for value in arguments)
    if len(arguments) != (3 if kind.startswith("q") else 2) or not all(map(_is_number, arguments)):
        return False
    first, second, *q = arguments
    if kind == "randint":
        return isinstance(first, int) and isinstance(second, int) and first < second
    if any(step <= 0 for step in q):
        return False
    if "normal" in kind:
        return second > 0 and ("log" not in kind or abs(first) <= LARGEST_LOGARITHM)
    return first < second and (first > 0 or "log" not in kind)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _samples(dimension: Mapping[str, Any]) -> list[Any]:
    """Every choice; for a range, its ends and a point between, as they would be proposed."""
    kind, arguments = dimension["_type"], dimension["_value"]
    if kind == "choice":
        return list(arguments)
    first, second = arguments[:2]
    if kind == "randint":
        return [first, second - 1]
    if "normal" in kind:  # No ends: a draw that the network cannot have fails its trial.
        points = [math.exp(first) if "log" in kind else first]
    else:
        points = [first, first + 0.3717 * (second - first), second]
    if kind.startswith("q"):
        q = arguments[2]
        points = [round(point / q) * q for point in (*points, points[0] + q, points[0] + 2 * q)]
        if "normal" not in kind:
            points = [min(max(point, first), second) for point in points]
    return [tidy(dimension, point) for point in points]
