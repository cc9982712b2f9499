"""The reference of specs: every key with its default, unit, range and meaning, from the models that read them."""

import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from neurotact import plugins
from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.dataset import simulator
from neurotact.encoders.model import usable
from neurotact.figures import columns
from neurotact.networks.definition.space import SearchSpec
from neurotact.networks.definition.specs import RSNNSpec
from neurotact.spec import Spec, to_toml
from neurotact.studies import measures
from neurotact.studies.claims import Claim
from neurotact.studies.study import StudySpec
from neurotact.studies.way_study import WayStudy

Model = type[Spec]
Row = tuple[str, str, str, str]
"""Key, default, what it takes, meaning."""

UNITS = {
    "mm_per_s2": "mm/s²", "N_per_mm3": "N/mm³", "N_per_mm": "N/mm", "kg_per_m3": "kg/m³", "pC_per_N": "pC/N",
    "V_per_N": "V/N", "mV_per_ms": "mV/ms", "s_per_mm": "s/mm", "N_s_per_mm": "N s/mm", "mN_rms": "mN (RMS)",
    "mV_rms": "mV (RMS)", "per_ms": "1/ms", "per_mm": "1/mm", "per_N": "1/N", "deg": "°", "um": "µm", "GOhm": "GΩ",
    **columns.UNITS, **{unit: unit for unit in ("MHz", "mN", "GPa", "pF", "kg", "g")},
}  # fmt: skip
"""Ends of keys, and the units that they stand for; the longest end counts."""
SHARED: dict[Model, str] = {
    ConditioningSpec: "conditioning",
    RSNNSpec: "networks",
    SearchSpec: "search",
    Claim: "claims",
}
"""Tables that stand in several specs, or are long: the heading under which their keys are listed once."""
LARGEST = 2**31
"""Bounds from here on are those of a computer's numbers, and not shown."""
SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


def unit_of(key: str) -> str:
    """The unit in which a key is given, as its name says; nothing where it names none.

    >>> unit_of("sa1.t_ref_ms"), unit_of("speed_mm_per_s"), unit_of("hidden")
    ('ms', 'mm/s', '')
    """
    ends = [end for end in UNITS if key.endswith(f"_{end}")]
    return UNITS[max(ends, key=len)] if ends else ""


def page() -> str:
    """The reference in Markdown."""
    return "\n\n".join([*_encoders(), *_networks(), *_studies(), *_simulators()])


def _encoders() -> Iterator[str]:
    yield "## Encoders\n\n`encoders/*.toml`, `neurotact encode --set`, `encoder.…` of a study."
    for name, model in usable().items():
        yield from _section(f'### `model = "{name}"`', model.spec)
    yield from _section("### Conditioning", ConditioningSpec, "conditioning")


def _networks() -> Iterator[str]:
    yield from _section(
        "## Networks", RSNNSpec, about="`networks/*.toml`, `neurotact train --set`, `network.…` of a study."
    )
    yield from _section("## Search", SearchSpec, about="`neurotact tune`, `search.…` of a study.")


def _studies() -> Iterator[str]:
    yield "## Studies\n\n`studies/*.toml`, `neurotact study run --set`."
    yield from _section("### Of spiking networks", StudySpec)
    about = "Keys of a study of spiking networks, or of its table `measures`; each asks for a further table."
    yield from _section("### Measures", measures.every(), about=about)
    yield from _section("### Of another way", WayStudy)
    yield from _section("### Claims", Claim, "claims")


def _simulators() -> Iterator[str]:
    yield "## Simulators\n\n`neurotact simulate NAME --set`, `dataset.parameters` of a study."
    for name in plugins.names("simulators"):
        found = simulator(name)
        yield from _section(f"### `simulate {name}`", found.model, about=found.about)


def _section(heading: str, model: Model, prefix: str = "", about: str = "") -> Iterator[str]:
    yield heading
    yield about or _plain(inspect.getdoc(model) or "")
    rows = [f"| `{key}` | {' | '.join(map(_cell, cells))} |" for key, *cells in rows_of(model, prefix)]
    yield "\n".join(["| key | default | takes | meaning |", "|---|---|---|---|", *rows])


def rows_of(model: Model, prefix: str = "") -> Iterator[Row]:
    """Key, default, what it takes and its meaning, of every key of a model and of the tables within it."""
    for name, field in model.model_fields.items():
        key = f"{prefix}.{name}" if prefix else name
        inner = _models(field.annotation)
        if not inner:
            yield key, _default(field.get_default(call_default_factory=True)), _takes(key, field), _meaning(field)
        else:
            yield from _tables(key, field, inner)


def _tables(key: str, field: FieldInfo, inner: list[Model]) -> Iterator[Row]:
    """The rows of a key that holds tables: its own, where it may be absent or stands elsewhere, and their keys."""
    default = field.get_default(call_default_factory=True)
    many = {dict: "tables by name", tuple: "tables"}.get(get_origin(field.annotation), "table")
    meaning = _meaning(field) or _plain(inspect.getdoc(inner[0]) or "", first=True)
    if len(inner) > 1 or inner[0] in SHARED:
        needed = "required" if field.is_required() else ""
        yield key, needed, f"{many}: {', '.join(dict.fromkeys(map(_link, inner)))}", meaning
        return
    if many != "table" or default is None:
        yield key, _default(default), many, meaning
    yield from _inner(f"{key}.NAME" if many == "tables by name" else key, inner[0], default)


def _inner(key: str, model: Model, default: Any) -> Iterator[Row]:
    """The rows of a table within a table, with the defaults that it has there."""
    for inner, own, takes, meaning in rows_of(model, key):
        value = default
        for part in inner.removeprefix(f"{key}.").split("."):
            value = getattr(value, part, None)
        yield (
            inner,
            _default(value) if isinstance(default, Spec) and not isinstance(value, Spec) else own,
            takes,
            meaning,
        )


def _link(model: Model) -> str:
    return f"[{SHARED[model]}](#{SHARED[model]})" if model in SHARED else "[encoders](#encoders)"


def _models(annotation: Any) -> list[Model]:
    if inspect.isclass(annotation) and issubclass(annotation, Spec):
        return [*annotation.any_of().values()] or [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _default(value: Any) -> str:
    """A default as TOML; nothing for what may be left out."""
    if value is PydanticUndefined:
        return "required"
    if value is None or value in ((), {}, ""):
        return ""
    if isinstance(value, Mapping):
        return ", ".join(f"`{name}`" for name in value)
    return f"`{to_toml({'key': value}).removeprefix('key = ').strip()}`"


def _takes(key: str, field: FieldInfo) -> str:
    """The kind of value, its unit and its range."""
    kind, bounds = _kind(field.annotation), [*field.metadata, *_bounds(field.annotation)]
    signs = [f"{sign} {value:g}" for bound in bounds for name, sign in SIGNS.items()
             if isinstance(value := getattr(bound, name, None), (int, float)) and value < LARGEST]  # fmt: skip
    return ", ".join(part for part in (kind, unit_of(key), *dict.fromkeys(signs)) if part)


def _bounds(annotation: Any) -> list[Any]:
    """The bounds of the values within a list or an optional value."""
    marks = [m for mark in getattr(annotation, "__metadata__", ()) for m in getattr(mark, "metadata", [mark])]
    return marks + [bound for part in get_args(annotation) for bound in _bounds(part)]


KINDS = {bool: "true or false", int: "whole number", float: "number", str: "text", Any: "any value"}


def _kind(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f'`"{part}"`' if isinstance(part, str) else f"`{part}`" for part in parts)
    if origin is Annotated:
        return _kind(parts[0])
    if origin is tuple:
        return f"list of {_plural(_kind(parts[0]))}"
    if origin is dict:
        return "table"
    if origin is list:
        return f"list of {_plural(_kind(parts[0]))}"
    if origin is Union or len(parts) > 1:
        return " or ".join(_kind(part) for part in parts if part is not type(None))
    return KINDS.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _plural(kind: str) -> str:
    return f"{kind}s" if kind.endswith("number") else kind


def _meaning(field: FieldInfo) -> str:
    return _plain(field.description or "")


def _plain(text: str, *, first: bool = False) -> str:
    """A docstring's words, without its example, in one line per paragraph."""
    words = text.split(">>>")[0].strip()
    words = words.split("\n\n")[0] if first else words
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in re.split(r"\n\n+", words))


def _cell(text: str) -> str:
    return text.replace("\n\n", " ").replace("|", "\\|")
