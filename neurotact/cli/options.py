"""Options of commands: those of a function of `neurotact.api`, with its names and its defaults."""

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, get_origin

import typer
from pydantic.fields import FieldInfo

from neurotact.errors import InputError
from neurotact.spec import Spec, apart, as_text, build, override, parse_assignments, parse_choice, parse_where, specs_of

LABEL = "label"
"""The condition of a value alone: the class."""
MOST_SEEDS = 2**63 - 2
"""Largest seed of a training, which draws its order from the next seed."""
MOST_WORKERS = 1024

Texts = list[str] | None
SetOption = Annotated[
    Texts, typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the spec; may be repeated.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it already exists.")]
OutFile = Annotated[Path, typer.Option("-o", "--out", dir_okay=False, help="The file to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
RunFolder = Annotated[Path, typer.Argument(help="The folder of a trained network.")]
MovedSpikes = Annotated[
    Path | None, typer.Option("--spikes", help="The spikes that the run was trained on, if they were moved.")
]
StudyFolder = Annotated[Path, typer.Argument(help="The folder of a study.")]


def option(kind: Any, help: str, *names: str, **more: Any) -> Any:
    """The annotation of an option with values of this kind; further arguments as of `typer.Option`."""
    return Annotated[kind, typer.Option(*names, help=help, **more)]


def flag(name: str, help: str) -> Any:
    """The annotation of an option without a value."""
    return option(bool, help, name)


REPLACED = flag("--force", "Replace a training that is in the folder.")
OPTIONS: dict[str, Any] = {
    "settings": SetOption,
    "spikes": Annotated[Path, typer.Argument(help="An HDF5 file of spikes, as encode writes it.")],
    "run": RunFolder,
    "recordings": Annotated[Path, typer.Argument(help="An HDF5 file of recordings.")],
    "path": Annotated[Path, typer.Argument(help="The folder or file to read.")],
    "folder": option(Path, "The folder to write.", "-o", "--out"),
    "out": OutFile,
    "force": Force,
    "encoder": option(str, "Name or path of an encoder spec."),
    "device": option(str, "A torch device: cpu, cuda, cuda:1, mps."),
    "workers": option(
        int | None, "Worker processes; the results do not depend on it.", min=1, max=MOST_WORKERS, show_default="2"
    ),
    "scheduler": option(
        str | None, "Run on the workers of this Dask scheduler, such as tcp://host:8786.", metavar="ADDRESS"
    ),
    "seed": option(int, "Random seed of the weights and of the order of windows.", min=0, max=MOST_SEEDS),
    "where": option(
        Texts, "Use these trials alone, as in speed=300 or speed=300,450 or material!=wood; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
    "leave_out": option(
        Texts, "Leave these trials out, as in material=wood; a value alone is a class, as in rest; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
    "exit_tolerance": option(
        float, "Validation accuracy that early exit may lose, as a share of 1.", "--exit-tolerance", "--tolerance"
    ),
    "allow_other_encoder": flag("--allow-other-encoder", "Accept spikes of an encoder other than the one in training."),
}  # fmt: skip
"""The option of each parameter of functions of `neurotact.api` that several commands have."""


NAMES = {
    "split.seed": "split_seed", "onset.deviations": "onset_deviations", "length_ms": "window_ms",
    "naming.table": "conditions",
}  # fmt: skip
"""Options that are not called as the field of their spec: the end of its path, and the name."""
IN_PYTHON = {"onset.bin_ms", "validation", "test", "nested", "leave_aside", "first"}
"""Fields of specs that no option has."""


def name_of(path: str) -> str:
    """What the option of a field is called, by the path of the field, such as "split.seed"; that of a parameter, too.

    >>> name_of("window.onset.deviations"), name_of("split.seed"), name_of("search.seed"), name_of("force")
    ('onset_deviations', 'split_seed', 'seed', 'force')
    """
    parts = path.split(".")
    ends = [".".join(parts[place:]) for place in range(len(parts))]
    return next((NAMES[end] for end in ends if end in NAMES), parts[-1])


def fields_of(parameter: str, kind: type[Spec], some: str = "", *, in_python: bool = False) -> dict[str, FieldInfo]:
    """The fields of a spec that options have, by their paths.

    some: the names of the options of some fields, in place of all. in_python: with the fields that no option has.
    """
    found: dict[str, FieldInfo] = {}

    def add(path: str, kind: type[Spec]) -> None:
        for key, field in kind.model_fields.items():
            if isinstance(field.annotation, type) and issubclass(field.annotation, Spec):
                add(f"{path}.{key}", field.annotation)
            else:
                found[f"{path}.{key}"] = field

    add(parameter, kind)
    wanted = some.split()
    kept = [path for path in found if in_python or not any(path.endswith(f".{end}") for end in IN_PYTHON)]
    return {path: found[path] for path in kept if not wanted or name_of(path) in wanted}


def _is_where(field: FieldInfo) -> bool:
    """Whether a field holds conditions of trials with their values: a table that is not called otherwise."""
    return get_origin(field.annotation) is dict and not field.json_schema_extra


def of_field(path: str, field: FieldInfo) -> Any:
    """The annotation of the option of a field: its type, bounds and default, and the first sentence of its help."""
    more: dict[str, Any] = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    is_one_text = any(getattr(each, "func", None) is apart for each in field.metadata)
    is_list = _is_where(field) or (get_origin(field.annotation) is tuple and not is_one_text)
    kind: Any = list[str] if is_list else str if get_origin(field.annotation) in (dict, tuple) else field.annotation
    bounds = {key: getattr(each, key) for each in field.metadata for key in ("ge", "le") if hasattr(each, key)}
    default = more.get("chosen", field.default if field.default not in (None, (), {}) else False)
    written = "--" + name_of(path).replace("_", "-")
    text = (field.description or "").replace("\n", " ").partition(". ")[0].rstrip(".")
    if kind is bool:
        return flag(written, f"{_as_options(text)}.")
    return option(
        kind | None,
        _as_options(text) + ("; may be repeated." if kind == list[str] else "."),
        written,
        metavar="CONDITION=VALUE" if _is_where(field) else more.get("metavar"),
        show_default=default if default is False else _as_options(as_text(default)),
        min=bounds.get("ge"),
        max=bounds.get("le"),
    )


def _as_options(text: str) -> str:
    """A text with its fields, in backquotes, as options.

    >>> _as_options('With `align="onset"`: later than `start_ms`, as `split.seed` says')
    'With --align onset: later than --start-ms, as --split-seed says'
    """
    marked = re.compile(r'`([\w.]+)(?:="(\S+)")?`')
    return marked.sub(lambda m: f"--{name_of(m[1]).replace('_', '-')}" + (f" {m[2]}" if m[2] else ""), text)


def calling(function: Callable[..., Any], **described: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function that calls one of `neurotact.api`, whose arguments it receives as `given`.

    The parameters that `OPTIONS` or `described` has are options of the command, with their defaults, and so are the
    fields of those that are specs: all, or those whose options `described` names. Other parameters of the decorated
    function are options of the command alone.
    """

    def decorated(run: Callable[..., None]) -> Callable[..., None]:
        options, specs = OPTIONS | described, specs_of(function)
        theirs: list[inspect.Parameter] = []
        for name, param in _parameters(function).items():
            if name in specs:
                theirs += of_spec(name, specs[name], described)
            elif options.get(name):
                theirs.append(_option(param, options[name]))
        own = [param.replace(kind=param.KEYWORD_ONLY) for name, param in _parameters(run).items() if name != "given"]

        def command(**values: Any) -> None:
            run(arguments(function, values), **{param.name: values[param.name] for param in own})

        command.__doc__ = run.__doc__
        command.__signature__ = inspect.Signature([*theirs, *own])  # pyright: ignore[reportFunctionMemberAccess]
        command.__annotations__ = {param.name: param.annotation for param in (*theirs, *own)}
        return command

    return decorated


def of_spec(name: str, kind: type[Spec], described: Mapping[str, Any] = {}) -> list[inspect.Parameter]:
    """The fields of a parameter that is a spec, as options; described: as of `calling`."""
    return [
        inspect.Parameter(
            name_of(path),
            inspect.Parameter.KEYWORD_ONLY,
            default=False if field.annotation is bool else None,
            annotation=described.get(name_of(path)) or of_field(path, field),
        )
        for path, field in fields_of(name, kind, described.get(name, "")).items()
    ]


def arguments(function: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a function of `neurotact.api` from the values of options, of which None is not given.

    >>> from neurotact.api.encoding import encode_file
    >>> arguments(encode_file, {"out": Path("a.h5"), "where": ["speed=300"], "encoder": None, "as_json": True})
    {'out': PosixPath('a.h5'), 'where': {'speed': [300]}, 'leave_out': {}}
    """
    parsed = {**values}
    if "where" in values:
        parsed["where"], parsed["leave_out"] = parse_choice(values["where"] or [], values.get("leave_out") or [], LABEL)
    if "settings" in values:
        parsed["settings"] = parse_assignments(values["settings"] or [])
    others = {key: value for key, value in values.items() if key not in _parameters(function)}
    parsed |= {name: spec_of(name, kind, others, function.__name__) for name, kind in specs_of(function).items()}
    return {name: parsed[name] for name in _parameters(function) if parsed.get(name) is not None}


def spec_of(parameter: str, kind: type[Spec], values: Mapping[str, Any], source: str) -> Spec | None:
    """The spec that options describe; None where none of them is given."""
    fields, table = fields_of(parameter, kind), {}
    for path, field in fields.items():
        value = values.get(name_of(path))
        if value is not None and value is not False and value != []:
            key = path.removeprefix(f"{parameter}.")
            table[key] = parse_where(value, f"`{name_of(path)}`") if _is_where(field) else value
    try:
        return build(kind, override({}, table), source) if table else None
    except InputError as error:
        key, _, rest = str(error).partition(":")
        named = f"`{name_of(key)}`" if f"{parameter}.{key}" in fields else parameter if key == "spec" else key
        raise InputError(f"{named}:{rest}") from error


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(function).parameters


def _option(parameter: inspect.Parameter, described: Any) -> inspect.Parameter:
    """A parameter as an option: one that cannot be absent must be given; a list is absent in place of empty."""
    is_needed = parameter.default in (None, "") and described.__origin__ in (Path, str)
    default = parameter.empty if is_needed else None if parameter.default == () else parameter.default
    return parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=described, default=default)
