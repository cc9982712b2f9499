"""Specs: TOML files that people read, copy and edit, loaded into frozen models.

A spec is found by name (`sa1-ra1-lif`) among those that ship, or by path. Overrides are dotted keys
relative to the spec (`sa1.t_ref_ms=5`). Whatever is wrong with one is an InputError that names the
key and the file.
"""

import hashlib
import json
import logging
import math
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import date, time
from functools import lru_cache, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    ParamSpec,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
)

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

import neurotact
from neurotact.errors import InputError, closest, nearest, some
from neurotact.files import existing, read_text
from neurotact.notebook import html_of

log = logging.getLogger("neurotact")

DEEPEST = 32
"""Nested tables and lists, at most."""
LARGEST, SMALLEST = 1e15, 1e-100
"""Magnitudes of a number in a spec; beyond them, the steps and sizes computed from it overflow."""
LONGEST = 2_000_000
"""Characters of a spec, at most."""

IN_WORDS = {
    "number": "a number", "integer": "a whole number", "boolean": "true or false", "string": "text", "tuple": "a list",
    "list": "a list",
}  # fmt: skip
"""What must stand there, by the name that pydantic gives it."""

SCHEMA = 2
"""The form of saved studies, trainings and searches. It changes when a new key or a new meaning would make an earlier
one another than it was; then only the folder of an earlier form is refused, and no key needs to know of others."""

KINDS = ("encoders", "networks", "networks/spaces", "studies", "prices")


@dataclass_transform(kw_only_default=True, field_specifiers=(Field,))
class _InOurWords(type(BaseModel)):
    """Makes `RSNNSpec(hiden=30)` raise the same error as a file with that key."""

    if not TYPE_CHECKING:  # a type checker must see the keys of each spec

        def __call__(cls, *args, **keys):
            try:
                return super().__call__(*args, **keys)
            except ValidationError as error:
                raise InputError(f"{_explain(cls, error)} ({cls.public or cls.__name__})") from error


class Spec(BaseModel, metaclass=_InOurWords):
    """A frozen table of parameters that knows its keys and refuses any other; InputError names the first wrong one.

    >>> class Gain(Spec):
    ...     gain: float = 1.0
    >>> Gain(gian=2.0)
    Traceback (most recent call last):
    neurotact.errors.InputError: gian: unknown key; did you mean 'gain'? (Gain)
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
    folder: ClassVar[str] = ""
    public: ClassVar[str] = ""
    """The name of the spec in Python's front door, `nt`, if it has one of its own there."""
    decided: ClassVar[Mapping[str, str]] = {}
    """Dotted keys of a protocol's parameters that something else sets, and what sets them; setting or sweeping one is
    refused."""
    gone: ClassVar[Mapping[str, Any]] = {}
    """Keys of earlier versions that saved files may hold, and the value that said nothing: it is left out. Any other is
    refused as an unknown key."""

    @model_validator(mode="before")
    @classmethod
    def _without_gone(cls, table: Any) -> Any:
        if not cls.gone or not isinstance(table, Mapping):
            return table
        return {key: value for key, value in table.items() if key not in cls.gone or value != cls.gone[key]}

    def __repr_name__(self) -> str:
        return self.public or type(self).__name__

    def __repr_args__(self) -> Iterator[tuple[str, Any]]:
        """The keys that differ from their defaults, which a short text of the spec needs.

        >>> class Gain(Spec):
        ...     gain: float = 1.0
        ...     unit: str = "mV"
        >>> Gain(gain=2.0), Gain()
        (Gain(gain=2.0), Gain())
        """
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if field.is_required() or value != field.get_default(call_default_factory=True):
                yield name, value

    def _repr_html_(self) -> str:
        """All keys with their values, in a notebook."""
        return html_of(self, {key: str(value) for key, value in leaves(self.model_dump(mode="json")).items()})

    @classmethod
    def any_of(cls) -> "Mapping[str, type[Spec]]":
        """Of a spec that stands for any one of several, those by their names; else empty."""
        return {}

    @classmethod
    def keys_with(cls, model: object) -> Collection[str]:
        """Of a spec whose key `model` names a part with keys of its own: the keys of it with that part; else empty."""
        return ()

    @classmethod
    def of_parts(cls, asked: str | None) -> Mapping[str, Mapping[str, Any]]:
        """The tables that the names of parts stand for, unless a file has that name: another package brings none.

        asked: a name that is looked for again, where it is new.
        """
        return {}

    def given(self) -> dict[str, Any]:
        """The keys that it was made with, those in tables dotted.

        >>> class Gain(Spec):
        ...     gain: float = 1.0
        ...     unit: str = "mV"
        >>> Gain(unit="mV").given()
        {'unit': 'mV'}
        """
        keys: dict[str, Any] = {}
        for name in (name for name in type(self).model_fields if name in self.model_fields_set):
            value = getattr(self, name)
            inner = {f"{name}.{key}": each for key, each in value.given().items()} if isinstance(value, Spec) else {}
            keys |= inner if isinstance(value, Spec) else {name: value}
        return keys

    def check_given(self) -> None:
        """Refuse what has no effect, where a spec is an argument; a study may sweep what gives it one."""

    def digest(self) -> str:
        """Twelve hexadecimal digits that identify the content, independent of key order and comments.

        >>> class Gain(Spec):
        ...     gain: float = 1.0
        >>> Gain().digest() == Gain(gain=1.0).digest() != Gain(gain=2.0).digest()
        True
        """
        return digest(self.model_dump(mode="json"))


SpecT = TypeVar("SpecT", bound=Spec)
P = ParamSpec("P")
R = TypeVar("R")


def apart(names: Any) -> Any:
    """The names in one text, with commas between them; anything else as it is."""
    return tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else names


if TYPE_CHECKING:
    Names = Any  # a checker must not refuse one text
    OneOrMore = Sequence[str]
else:
    Names = Annotated[tuple[str, ...], BeforeValidator(apart)]
    OneOrMore = Annotated[tuple[str, ...], BeforeValidator(lambda name: (name,) if isinstance(name, str) else name)]
"""Names, as a list or as one text: of one name, or with commas between several (`Names`)."""


def chosen(how: str) -> dict[str, Any]:
    """Of a field: what a command or a function takes where it is not given, in words, in place of its default."""
    return {"chosen": how}


def specs_of(function: Callable[..., Any]) -> dict[str, type[Spec]]:
    """The parameters of a function that are specs of their own, such as `window`."""
    return specs_in(signature(function).parameters)


def specs_in(parameters: Mapping[str, Parameter]) -> dict[str, type[Spec]]:
    """Those of these parameters that are specs of their own."""
    kinds = {name: each.annotation for name, each in parameters.items()}
    return {name: kind for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, Spec)}


def takes_specs(function: Callable[P, R]) -> Callable[P, R]:
    """A function that refuses fields of its specs beside them, other objects in their place, and void fields."""
    names, kinds = [*signature(function).parameters], specs_of(function)

    @wraps(function)
    def checked(*args: P.args, **keywords: P.kwargs) -> R:
        given = {**dict(zip(names, args, strict=False)), **keywords}
        refuse_fields(given.keys() - {*names}, kinds, function.__name__)
        for name, kind in kinds.items():
            value = given.get(name, kind)
            if isinstance(value, kind):
                value.check_given()
            elif value is not kind:
                raise InputError(
                    f"{name}: must be an nt.{kind.public or kind.__name__}(...); got {type(value).__name__}"
                )
        return function(*args, **keywords)

    return checked


def refuse_fields(keys: Iterable[str], specs: Mapping[str, type[Spec]], source: str) -> None:
    """InputError, which says where it belongs, for the first key that is a field of one of a function's specs."""
    for key in keys:
        for name, kind in specs.items():
            field = key.removeprefix(f"{name}_")
            if field in kind.model_fields:
                public = kind.public or kind.__name__
                raise InputError(f"{source}: `{key}` is a field of `{name}`: `{name}=nt.{public}({field}=...)`")


def digest(value: Any) -> str:
    """Twelve hexadecimal digits that identify any JSON-like value."""
    canonical = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:12]


def _specs_folder(kind: str) -> Path:
    """The folder of the shipped specs of a kind (one of `KINDS`), beside the package.

    Installed they are packages of their own, such as `neurotact_parts.studies`; in a checkout the folder `studies`.
    """
    beside = Path(neurotact.__file__).parents[1]
    installed = beside / "neurotact_parts"
    return (installed if installed.is_dir() else beside) / kind


def shipped(kind: str) -> list[Path]:
    """The shipped specs of a kind (one of `KINDS`), by name; those of studies may be in folders of it."""
    folder = _specs_folder(kind)
    found = [*folder.glob("*.toml"), *(folder.glob("*/*.toml") if kind == "studies" else ())]
    return sorted(found, key=lambda path: path.stem)


def find(kind: str, name: str | Path, others: Iterable[str] = ()) -> Path:
    """The file of a spec given by name or by path; InputError, with the nearest of `others` too, if there is none."""
    if str(name).endswith(".toml") or "/" in str(name):
        return existing(name)
    known = {path.stem: path for path in shipped(kind)}
    if str(name) not in known:
        names = [*dict.fromkeys([*known, *others])]
        raise InputError(f"{name}: there is no such spec in {kind}; {nearest(str(name), names)}")
    return known[str(name)]


def table_of(model: type[Spec], name: str | Path) -> tuple[dict[str, Any], str]:
    """The table of a spec given by name or by path, and where it is from; a file comes before a part of that name."""
    is_file = str(name) in {path.stem for path in shipped(model.folder)}
    parts = model.of_parts(None if is_file else str(name))
    if str(name) in parts and not is_file:
        return dict(parts[str(name)]), f"the model {name}"
    path = find(model.folder, name, parts)
    return read(path), str(path)


def text(path: Path) -> str:
    """The text of a spec file; InputError when it is not UTF-8, or longer than any spec."""
    if existing(path).stat().st_size > LONGEST:
        raise InputError(f"{path}: is longer than {LONGEST:,} bytes, which no spec is; check the file")
    return read_text(path)


def read(path: Path) -> dict[str, Any]:
    """The table in a TOML file; InputError when it does not parse or holds a number that no spec can have."""
    try:
        table = tomllib.loads(text(path))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not valid TOML ({error}); fix that line") from error
    return _plain(table, str(path))


def pop_table(table: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    """The table under `key`, removed from `table`; empty if it is absent."""
    value = table.pop(key, {})
    if not isinstance(value, dict):
        raise InputError(f"{key}: must be a table; got {value!r} ({path})")
    return value


def _plain(value: Any, source: str, key: str = "", depth: int = 0) -> Any:
    """The values of a TOML text, dates as text; InputError for a number or a nesting beyond the limits."""
    if depth > DEEPEST:
        raise InputError(f"{key[:40]}...: is nested more than {DEEPEST} tables or lists deep; flatten it ({source})")
    if isinstance(value, dict):
        return {name: _plain(v, source, f"{key}.{name}" if key else name, depth + 1) for name, v in value.items()}
    if isinstance(value, list):
        return [_plain(v, source, f"{key}.{index}", depth + 1) for index, v in enumerate(value)]
    if isinstance(value, (date, time)):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{key}: must be a finite number; got {value} ({source})")
        if value and not SMALLEST <= abs(value) <= LARGEST:
            raise InputError(f"{key}: must be between {SMALLEST:g} and {LARGEST:g} in size; got {value} ({source})")
    if isinstance(value, int) and not _is_within_64_bits(value):
        raise InputError(f"{key}: must be a number within 64 bits; got one of {value.bit_length()} bits ({source})")
    return value


def _is_within_64_bits(value: Any) -> bool:
    return not isinstance(value, int) or -(2**63) <= value < 2**63


def load(model: type[SpecT], name: str | Path, overrides: Mapping[str, Any] | None = None) -> SpecT:
    """Load the spec called `name` (or at that path) into `model`, after `overrides` of dotted keys."""
    table, source = table_of(model, name)
    return build(model, _changed(model, table, overrides or {}), source=source)


def _changed(model: type[Spec], table: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """A table after its overrides; of another part than before, the keys that it does not have are left out, told."""
    name = overrides.get("model")
    kept = model.keys_with(name) if name != table.get("model") else ()
    left = tuple(key for key in table if kept and key not in kept)
    if left:
        _say_left_out(str(name), left)
    return override({key: value for key, value in table.items() if key not in left}, overrides)


@lru_cache
def _say_left_out(model: str, keys: tuple[str, ...]) -> None:
    log.warning("model = '%s' has keys of its own: left out from the spec: %s", model, some(keys, 5))


def resolve(model: type[SpecT], what: str | Path | SpecT, overrides: Mapping[str, Any] | None = None) -> SpecT:
    """The spec with the name or path `what`, or `what` itself, after `overrides` of dotted keys."""
    if isinstance(what, (str, Path)):
        return load(model, what, overrides)
    if not isinstance(what, model):
        kind = model.folder.removesuffix("s") or "spec"
        raise InputError(f"{kind}: must be a name, a path or an {model.__name__}; got {type(what).__name__}")
    if not overrides:
        return what
    return build(type(what), _changed(type(what), what.model_dump(mode="json"), overrides), source="settings")


def build(model: type[SpecT], table: Mapping[str, Any], source: str) -> SpecT:
    """Validate a table; InputError names the first wrong key, what it must be, and `source`.

    A number in quotes is refused, and so are 1 for true and a whole number beyond 64 bits.
    """
    try:
        built = model.model_validate(table)
    except ValidationError as error:
        raise InputError(f"{_explain(model, error)} ({source})") from error
    for key, given, taken in _misread(table, built.model_dump(mode="json")):
        wanted = "true or false" if isinstance(taken, bool) else "a number"
        wanted += "" if _is_within_64_bits(taken) else " within 64 bits"
        raise InputError(f"{key}: must be {wanted}; got {given!r} ({source})")
    return built


def saved(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a spec as a folder of results stores it: with the number of its form."""
    return {"schema": SCHEMA, **table}


def unsaved(table: Mapping[str, Any], holds: str, fix: str) -> dict[str, Any]:
    """What `saved` was given; InputError for another form.

    holds: the folder and what it holds, and `fix`, what to do then, for the message.

    >>> unsaved(saved({"hidden": 20}), "run: holds a training", "start again")
    {'hidden': 20}
    >>> unsaved({"hidden": 20}, "run: holds a training", "start again")
    Traceback (most recent call last):
    neurotact.errors.InputError: run: holds a training of another neurotact (schema none, here 2); start again
    """
    schema = table.get("schema")
    if schema != SCHEMA:
        raise InputError(f"{holds} of another neurotact (schema {schema or 'none'}, here {SCHEMA}); {fix}")
    return {key: value for key, value in table.items() if key != "schema"}


def override(table: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `table` with dotted keys replaced; missing tables on the way are made.

    >>> override({"sa1": {"t_ref_ms": 1}}, {"sa1.t_ref_ms": 5})
    {'sa1': {'t_ref_ms': 5}}
    """
    result = json.loads(json.dumps(table, default=str))
    for dotted, value in checked_settings(overrides).items():
        *path, last = dotted.split(".")
        if len(path) > DEEPEST:
            raise InputError(f"{dotted[:40]}...: names tables more than {DEEPEST} deep; no spec has that key")
        node = result
        for key in path:
            node = node.setdefault(key, {})
            if not isinstance(node, dict):
                raise InputError(f"{dotted}: '{key}' is a value, not a table; remove the keys after it")
        node[last] = value.tolist() if hasattr(value, "tolist") else value  # NumPy's numbers as Python's own
    return result


def checked_settings(settings: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Changes of a spec as a mapping, which may be empty; InputError for anything but a mapping of dotted keys.

    >>> checked_settings(["sa1.t_ref_ms=5"])
    Traceback (most recent call last):
    neurotact.errors.InputError: settings: must map dotted keys to values, such as {'sa1.t_ref_ms': 5}; got list
    """
    if settings is None:
        return {}
    if isinstance(settings, Mapping) and all(isinstance(key, str) for key in settings):
        return settings
    raise InputError(
        f"settings: must map dotted keys to values, such as {{'sa1.t_ref_ms': 5}}; got {type(settings).__name__}"
    )


def leaves(given: Mapping[str, Any]) -> dict[str, Any]:
    """The dotted keys that are given, with those inside tables.

    >>> leaves({"encoder.sa1": {"gain": 3.2}, "seed": 0})
    {'encoder.sa1.gain': 3.2, 'seed': 0}
    """
    flat: dict[str, Any] = {}
    for key, value in given.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{name}": inner for name, inner in leaves(value).items()}
        else:
            flat[key] = value
    return flat


def refuse(given: Mapping[str, Any], decided: Mapping[str, str]) -> None:
    """InputError for a given dotted key that something else sets: setting it would change nothing.

    decided: for each such key, what sets it and what to do instead, in words.
    """
    for key in leaves(given):
        if key in decided:
            raise InputError(f"{key}: {decided[key]}")


def parse_assignments(assignments: list[str]) -> dict[str, Any]:
    """`["sa1.t_ref_ms=5", "model=lif"]` as a table of dotted keys; values are read as TOML, else as text.

    >>> parse_assignments(["sa1.t_ref_ms=5", "hidden=[20, 30]", "membrane=eq4"])
    {'sa1.t_ref_ms': 5, 'hidden': [20, 30], 'membrane': 'eq4'}
    """
    parsed: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise InputError(f"`settings` {assignment}: must read KEY=VALUE, as in sa1.t_ref_ms=5")
        parsed[key.strip()] = _plain(_value_of(text, assignment), "`settings`", key.strip())
    return parsed


def assignments_of(settings: Mapping[str, Any], sign: str = "=") -> list[str]:
    """Settings as they are typed, `KEY=VALUE`; `VALUE` is the place for one, which `...` stands for in Python.

    >>> assignments_of({"sa1.t_ref_ms": 5.0, "window.length_ms": ..., "membrane": "eq4"})
    ['sa1.t_ref_ms=5', 'window.length_ms=VALUE', 'membrane=eq4']
    """
    return [f"{key}{sign}{as_text(value)}" for key, value in settings.items()]


def as_text(value: Any) -> str:
    """A value as it is typed.

    >>> as_text(300.0), as_text(...), as_text("eq4")
    ('300', 'VALUE', 'eq4')
    """
    if value is ...:
        return "VALUE"
    return f"{value:g}" if isinstance(value, float) else str(value)


def parse_where(assignments: list[str], option: str) -> dict[str, list[Any]]:
    """`["speed=300,450", "subject=ann"]` as the values of each condition; one that is named twice has both values.

    >>> parse_where(["speed=300,450", "subject=ann", "subject=bob"], "`test_where`")
    {'speed': [300, 450], 'subject': ['ann', 'bob']}
    """
    where: dict[str, list[Any]] = {}
    for assignment in assignments:
        column, equals, text = assignment.partition("=")
        if not equals or not column.strip() or not text.strip() or column.rstrip()[-1:] in "!<>":
            raise InputError(f"{option} {assignment}: must read CONDITION=VALUE, as in speed=450 or speed=300,450")
        whole = _value_of(text, assignment, option)
        if isinstance(whole, str) and whole == text.strip():  # no quotes, so that a comma parts values
            whole = [_value_of(part, assignment, option) for part in text.split(",") if part.strip()]
        values = _plain(whole if isinstance(whole, list) else [whole], option, column.strip())
        where.setdefault(column.strip(), []).extend(values)
    return where


def parse_choice(
    where: list[str], leave_out: list[str], classes: str, options: tuple[str, str] = ("`where`", "`leave_out`")
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The conditions of the trials to keep and to leave out; CONDITION!=VALUE in one is CONDITION=VALUE in the other.

    classes: the condition that a value alone means among those to leave out. options: the parameters, for messages.

    >>> parse_choice(["speed=300", "material!=wood"], ["rest,moving"], "label")
    ({'speed': [300]}, {'material': ['wood'], 'label': ['rest', 'moving']})
    """
    leave_out = [word if "=" in word else f"{classes}={word}" for word in leave_out]
    sides: tuple[dict[str, Any], dict[str, Any]] = {}, {}
    for side, assignments in enumerate((where, leave_out)):
        for assignment in assignments:
            is_not = assignment.partition("=")[0].endswith("!")
            parsed = parse_where([assignment.replace("!=", "=", 1) if is_not else assignment], options[side])
            for column, values in parsed.items():
                sides[is_not ^ side].setdefault(column, []).extend(values)
    return sides


def _value_of(text: str, assignment: str, option: str = "`settings`") -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()
    except (ValueError, RecursionError) as error:  # more digits or brackets than Python reads
        raise InputError(f"{option} {assignment[:40]}...: cannot be read ({error}); write a simpler value") from error


def to_toml(table: Mapping[str, Any]) -> str:
    """`table` as TOML text that `read` gives back equal; None values are left out.

    >>> print(to_toml({"a": 1, "b": {"c": [1.5, "x"]}}), end="")
    a = 1
    <BLANKLINE>
    [b]
    c = [1.5, "x"]
    """
    return "\n".join(_toml_lines(table, ())).strip() + "\n"


def _toml_lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [f"{_toml_key(k)} = {toml_value(v)}" for k, v in table.items() if not _is_table(v) and v is not None]
    for key, value in table.items():
        here = (*path, _toml_key(key))
        if isinstance(value, Mapping):
            lines += ["", f"[{'.'.join(here)}]", *_toml_lines(value, here)]
        elif _is_table(value):
            for row in value:
                lines += ["", f"[[{'.'.join(here)}]]", *_toml_lines(row, here)]
    return lines


def _is_table(value: Any) -> bool:
    is_rows = isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)
    return isinstance(value, Mapping) or is_rows


def _toml_key(key: str) -> str:
    return key if key.replace("-", "").replace("_", "").isalnum() and key.isascii() else toml_value(key)


def toml_value(value: Any) -> str:
    """A value as assignments and files take it.

    >>> toml_value([1.5, "x", True])
    '[1.5, "x", true]'
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml_key(k)} = {toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def _explain(model: type[BaseModel], error: ValidationError) -> str:
    """The first error of pydantic, in the words of the spec."""
    first = error.errors()[0]
    path, known = _place(model, first["loc"])
    key = ".".join(path) or "spec"
    if first["type"] == "extra_forbidden":
        inner = first["input"] if isinstance(first["input"], Mapping) else {}
        return f"{key}: unknown key; {_meant(path, known, model, inner)}"
    if first["type"] == "union_tag_invalid":
        about = first.get("ctx", {})
        tags = [tag.strip("' ") for tag in about["expected_tags"].split(",")]
        return f"{key}.model: '{about['tag']}' is unknown; {nearest(about['tag'], tags)}"
    if first["type"] == "missing":
        return f"{key}: is missing; add it"
    if first["type"] in ("model_type", "dict_type"):
        return f"{key}: must be a table; got {first['input']!r}"
    own = first.get("ctx", {}).get("error")
    names_key = isinstance(own, InputError) or re.match(r"[\w.]+: ", str(own))
    if names_key and isinstance(first["input"], Mapping):
        return ".".join([*path, str(own)])  # of the keys of a part, which says where
    message = first["msg"].replace("Input should be ", "must be ").replace("Value error, ", "")
    message = re.sub(
        r"^Tuple should have at least (\d+) item(s?) after validation, not", r"needs at least \1 value\2, not", message
    )
    message = re.sub(r"\ba valid (\w+)(, .*)?", lambda match: IN_WORDS.get(match[1], match[0]), message)
    for words, sign in (
        ("greater than or equal to", ">="),
        ("less than or equal to", "<="),
        ("greater than", ">"),
        ("less than", "<"),
    ):
        message = message.replace(words, sign)
    given = first["input"]
    return f"{key}: {message}" + ("" if isinstance(given, (dict, Mapping)) else f"; got {given!r}")


def _meant(path: list[str], known: list[str], model: Any, inner: Mapping[str, Any]) -> str:
    """What an unknown key was meant to be: the same key elsewhere in the spec, else the nearest one.

    A key of the same table is named alone, any other with the tables that hold it. known: the keys of that table.
    inner: the keys in an unknown table; its name may be too much.
    """
    key, names = path[-1], {dotted: dotted.rpartition(".")[2] for dotted in keys_of(model)}
    beside = [".".join([*path[:-1], name]) for name in known]
    others = [name for dotted, name in names.items() if dotted not in beside]
    if ".".join(path) in names:  # of another model in the same place
        return nearest(key, known)
    # The name of an unknown table may be too much: what it holds is then a key of the table around it.
    near = key if key in others else next((name for name in inner if name in known), None)
    if near is None and closest(key, known) is None:
        near = next((name for name in inner if name in names.values()), None)
    is_bare = len(path) == 1  # a key that stands in a table means one of that table
    if near is None and (is_bare or closest(key, known) is None) and closest(key, [*known, *others]) not in known:
        near = closest(key, others)
    if near is None:
        return nearest(key, known)
    # The deepest first: a key that stands alone is more often one of an encoder's populations than of a whole study.
    places = sorted((dotted for dotted, name in names.items() if name == near), key=lambda key: -key.count("."))
    quoted = [f"'{key}'" for key in places]
    return f"did you mean {some(quoted, 3, ' or ')}?"


def keys_of(model: Any, before: str = "") -> dict[str, None]:
    """The dotted keys of a model and of the tables in it, each once; a union has those of all its tables."""
    keys: dict[str, None] = {}
    for table in _models_in(model):
        for name, field in table.model_fields.items():
            keys[f"{before}{name}"] = None
            if not _holds_many(field.annotation):
                keys |= keys_of(field.annotation, f"{before}{name}.")
    return keys


def _holds_many(annotation: Any) -> bool:
    """Whether a value is a list or a table of keys that the user names, so that no key leads into it."""
    kinds = [annotation, *get_args(annotation)]
    return any(get_origin(kind) in (list, tuple, dict, Mapping) for kind in kinds)


def _misread(given: Any, taken: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Keys where text or a truth value is given for a number, or the other way round, or too large a whole number."""
    if isinstance(given, Mapping) and isinstance(taken, Mapping):
        for name in (name for name in given if name in taken):
            yield from _misread(given[name], taken[name], f"{key}.{name}" if key else str(name))
    elif isinstance(given, (list, tuple)) and isinstance(taken, list):
        kinds = {*map(type, given), *map(type, taken)}
        if len(kinds) == 1 and kinds <= {str, bool, int, float}:
            return  # all alike, such as the thousands of trials of a network
        for index, pair in enumerate(zip(given, taken, strict=False)):
            yield from _misread(*pair, f"{key}.{index}")
    elif isinstance(taken, (bool, int, float)):
        mixed = isinstance(given, str) or isinstance(given, bool) != isinstance(taken, bool)
        if mixed or not _is_within_64_bits(taken):
            yield key, given, taken


def _place(model: Any, location: tuple[int | str, ...]) -> tuple[list[str], list[str]]:
    """The path of an error, as the keys that lead there, and all known keys of that table."""
    path: list[str] = []
    known: list[str] = []
    here = model
    for part in map(str, location):
        choices = _tagged(here)
        if part in choices:  # here pydantic gives the chosen model of a union, which is not a key
            here = choices[part]
            continue
        path.append(part)
        if part.isdigit():
            continue
        table = next(iter(_models_in(here)), None)
        known = list(table.model_fields) if table is not None else []
        field = table.model_fields.get(part) if table is not None else None
        here = field.annotation if field is not None else None
    return path, known


def _tagged(annotation: Any) -> dict[str, Any]:
    """The models of which a key holds any one, by their names."""
    if hasattr(annotation, "any_of"):
        return dict(annotation.any_of())
    return {name: kind for part in get_args(annotation) for name, kind in _tagged(part).items()}


def _models_in(annotation: Any) -> list[Any]:
    if hasattr(annotation, "model_fields"):
        return [*_tagged(annotation).values()] or [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
