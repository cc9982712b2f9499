"""The commands that make something else of a trained run: fine-tune, export."""

import inspect
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer

from neurotact.api import deployment as api
from neurotact.api import tools
from neurotact.cli.options import (
    MOST_SEEDS,
    REPLACED,
    Force,
    Json,
    MovedSpikes,
    RunFolder,
    calling,
    flag,
    of_spec,
    option,
    spec_of,
)
from neurotact.cli.output import print_json, show, unless
from neurotact.cli.words import say
from neurotact.effects import NoEffectError, is_given
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.plugins import names
from neurotact.spec import Spec

with lazily():
    import pandas as pd


@calling(
    tools.fine_tune,
    weight_bits=option(int, "Bits of a weight in the integer variant of C: 2 to 8."),
    state_bits=option(int | None, "Bits of a state in the integer variant: 8 to 16, or 24; chosen when absent."),
    epochs=option(int, "Epochs of training; 0 only rounds.", min=0),
    seed=option(int | None, "Random seed of the order of windows.", min=0, max=MOST_SEEDS, show_default="0"),
    spikes=MovedSpikes,
    force=REPLACED,
)
def fine_tune(given: dict[str, Any], as_json: Json = False) -> None:
    """Continue the training of a network with rounded weights, for an export with few bits.

    The rounded network is saved as a new run; neurotact export --to c writes it with these bits. The best epoch on
    validation windows is saved, or the network that is only rounded, if that is better.
    """
    row = tools.fine_tune(**given, tell=unless(as_json))
    if as_json:
        print_json(pd.DataFrame([row]))
    else:
        print(f"next: neurotact export {shlex.quote(str(given['folder']))} --to c -o chain/")
    for caution in row["cautions"]:
        say(caution)


OF_CHAINS = {
    "recordings": option(Path | None, "The recordings that the run was trained on, if they were moved."),
    "spikes": MovedSpikes,
    "prove": option(
        int | None, "Run the export, and compare this many test trials spike by spike.", min=0, show_default="0"
    ),
}  # fmt: skip
"""The options of exporters that the command describes: those of chains."""


def _export(
    run: RunFolder,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The folder or file to write.")] = None,
    to: Annotated[str | None, typer.Option("--to", metavar="NAME")] = None,
    check: Annotated[
        str | None, typer.Option(help="List what this chip cannot run: xyloaudio2, loihi2 or spinnaker2.")
    ] = None,
    force: Force = False,
    **options: Any,
) -> None:
    """Write a trained run as C, NIR or in another form, or check it against a chip."""
    given = {name: value for name, value in options.items() if is_given(value)}
    if check is not None:
        for name, value in {**given, "out": out, "to": to, "force": force}.items():
            if is_given(value):
                raise NoEffectError(f"`{name}`: has no effect with `check`, which writes nothing; leave it out")
        tools.check_chip(run, check, tell=show)
        return
    if to is None or out is None:
        raise InputError(f"export: needs --to NAME ({', '.join(names('exporters'))}) and -o, or --check TARGET")
    for name, kind in _specs_of(api.usable()).items():
        fields = {each.name: given.pop(each.name) for each in of_spec(name, kind) if each.name in given}
        given |= {name: spec_of(name, kind, fields, "export")} if fields else {}
    api.export(run, out, to, force=force, tell=show, **given)


def __getattr__(name: str) -> Callable[..., None]:
    """The command `export`, with the options of the exporters that are installed now."""
    if name != "export_command":
        raise AttributeError(name)
    exporters = api.usable()
    own = [param for param in inspect.signature(_export).parameters.values() if param.kind != param.VAR_KEYWORD]
    about = {"to": option(str | None, _abouts(), "--to")}
    own = [param.replace(annotation=about.get(param.name, param.annotation)) for param in own]
    theirs = [param for param in _options_of(exporters) if param.name not in {each.name for each in own}]

    def command(**values: Any) -> None:
        _export(**values)

    command.__doc__ = _export.__doc__
    command.__signature__ = inspect.Signature(  # pyright: ignore[reportFunctionMemberAccess]
        [param.replace(kind=param.KEYWORD_ONLY) for param in (*own, *theirs)]
    )
    command.__annotations__ = {param.name: param.annotation for param in (*own, *theirs)}
    return command


def _abouts() -> str:
    """Each exporter with its line, or the reason why it cannot be used."""
    return "; ".join(f"{to}: {_about(to)}" for to in names("exporters")) + "."


def _about(name: str) -> str:
    try:
        return api.exporter(name).about
    except InputError as error:
        return f"cannot be used: {error}"


def _options_of(exporters: dict[str, api.Exporter]) -> Iterator[inspect.Parameter]:
    """A parameter of the command for each option of exporters, of those that have it; absent unless it is given."""
    owners: dict[str, list[str]] = {}
    for to, each in exporters.items():
        for name in each.parameters:
            owners.setdefault(name, []).append(to)
    specs = _specs_of(exporters)
    for name, having in owners.items():
        first = exporters[having[0]]
        if name in specs:
            yield from of_spec(name, specs[name])
            continue
        if name in OF_CHAINS:
            described = OF_CHAINS[name]
        elif name in first.options:
            described = _described(first.parameters[name], f"With --to {' or '.join(having)}: {first.options[name]}")
        else:
            continue
        absent = False if bool in get_args(described)[:1] else None
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=absent, annotation=described)


def _specs_of(exporters: dict[str, api.Exporter]) -> dict[str, type[Spec]]:
    """The parameters of exporters that are specs."""
    return {name: kind for each in exporters.values() for name, kind in each.specs.items()}


def _described(parameter: inspect.Parameter, help: str) -> Any:
    """The option of a parameter, with its type."""
    kinds = get_args(parameter.annotation) if get_origin(parameter.annotation) is not Literal else ()
    kind = next((kind for kind in (Path, int, float, str) if kind in kinds), parameter.annotation)
    written = "--" + parameter.name.replace("_", "-")
    if kind is bool:
        return flag(written, help)
    default = str(parameter.default) if is_given(parameter.default) else False
    return option(kind | None, help, written, show_default=default)
