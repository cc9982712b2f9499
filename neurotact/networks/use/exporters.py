"""The door of exporters: forms in which a trained run leaves, found by name."""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from neurotact import files, plugins
from neurotact.effects import NoEffectError
from neurotact.errors import InputError
from neurotact.lazily import lazily
from neurotact.progress import Tell, untold
from neurotact.spec import Spec, refuse_fields, specs_in

with lazily():
    from neurotact.networks.use import fitted


class Exporter(NamedTuple):
    """A form in which a trained run leaves (entry point group `neurotact.exporters`).

    about: what it writes, in one line.
    export: called as `export(run, out, **options)`, with a run folder or a fitted classifier
        (`neurotact_parts.streams.chain.chain_of` makes a chain of either), the path to write, and the options that are
        given; what it returns `nt.export` returns. An existing path is refused before, unless `export` has the options
        `force` and refuses itself. If it has `tell`, it is called with the lines to print.
    options: what each option of its own is, in one line; its type and default are those of the parameter.

    >>> Exporter("The classes, as text.", lambda run, out: Path(out).write_text("felt, silk")).about
    'The classes, as text.'
    """

    about: str
    export: Callable[..., Any]
    options: Mapping[str, str] = {}

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        """Of `export`, after the run and the path."""
        known = getattr(inspect.unwrap(self.export), "__globals__", {})
        given = [*inspect.signature(self.export).parameters.values()][2:]  # the first may be of a module not loaded yet
        kinds = (
            eval(each.annotation, known) if isinstance(each.annotation, str) else each.annotation for each in given
        )
        return {each.name: each.replace(annotation=kind) for each, kind in zip(given, kinds, strict=True)}

    @property
    def specs(self) -> Mapping[str, type[Spec]]:
        """Those of these parameters that are specs, such as `streamed`."""
        return specs_in(self.parameters)


def exporter(name: str) -> Exporter:
    """The exporter of that name; InputError when there is none, or it cannot be used."""
    loaded = plugins.load("exporters", name, Exporter)
    if not callable(loaded.export):
        raise plugins.unfit("exporters", name, "has nothing to call")
    unknown = sorted({*loaded.options} - {*loaded.parameters})
    if unknown:
        raise plugins.unfit("exporters", name, f"describes the option '{unknown[0]}', which it does not have")
    return loaded


def export(
    run: "fitted.Fitted",
    out: str | Path,
    to: str,
    *,
    force: bool = False,
    tell: Tell = untold,
    **options: Any,
) -> Any:
    """Write a trained run in the form of the exporter `to`, such as "c", "nir" or one of another package.

    run: a run folder that `train` wrote, or a fitted `SpikingClassifier` or a pipeline that ends in one.
    out: the folder or file to write. force: replace it. tell: called with what the command prints.
    options: those of the exporter, as of `export_c` and `export_nir`. Returns what it returns.
    Raises InputError for an exporter that is not there, for options that it does not have, and as it does.

    >>> made = nt.export("run", "chain", "c", variant="float")
    >>> Path("chain/touch.c").is_file()
    True
    """
    chosen = exporter(to)
    has = chosen.parameters
    for name, value in options.items():
        if name not in has and value is not None:
            refuse_fields([name], chosen.specs, "export")
            first = next(iter(value.given()), name) if isinstance(value, Spec) else name
            raise NoEffectError(f"`{first}`: has no effect with `to={to!r}`; {_owners(name)}leave it out")
    given = {**options, "force": force, "tell": tell}
    if "force" not in has:
        files.check_new(out, force=force)
    return chosen.export(run, out, **{name: value for name, value in given.items() if name in has})


def _owners(name: str) -> str:
    """The exporters that have an option, in words; one that cannot be imported has none."""
    owners = [f"`to={other!r}`" for other, found in usable().items() if name in found.parameters]
    return f"it belongs to {' and '.join(owners)}; " if owners else ""


def usable() -> dict[str, Exporter]:
    """The exporters by name, without those that cannot be used."""
    return {name: found for name in plugins.names("exporters") if (found := _if_usable(name)) is not None}


def _if_usable(name: str) -> Exporter | None:
    try:
        return exporter(name)
    except InputError:
        return None
