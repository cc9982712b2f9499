"""The Python reference: every name that the package and its rooms export, once, from its docstring."""

import inspect
import pkgutil
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType

import neurotact
from neurotact.spec import Spec


def rooms() -> list[ModuleType]:
    """The package, then each room that exports names."""
    found = (import_module(f"neurotact.{room.name}") for room in pkgutil.iter_modules(neurotact.__path__) if room.ispkg)
    return [neurotact, *(room for room in found if getattr(room, "__all__", ()))]


def exported() -> dict[str, object]:
    """What is exported, by its first full name: a room's names that the front door has too are not repeated."""
    found: dict[str, object] = {}
    for room in rooms():
        for name in room.__all__:
            what = getattr(room, name)
            if not isinstance(what, str) and all(what is not other for other in found.values()):
                found[f"{room.__name__}.{name}"] = what
    return found


def page() -> str:
    """The reference in Markdown."""
    return "\n\n".join(_lines(exported()))


def _lines(names: dict[str, object]) -> Iterator[str]:
    for room in rooms():
        own = {name: what for name, what in names.items() if name.rpartition(".")[0] == room.__name__}
        yield f"## `{room.__name__}`"
        if room is not neurotact:
            yield inspect.getdoc(room) or ""
            yield from _elsewhere(room, own)
        for heading, is_of in (("Functions", inspect.isfunction), ("Classes", inspect.isclass)):
            chosen = {name: what for name, what in own.items() if is_of(what)}
            if chosen:
                yield f"### {heading}" if room is neurotact else ""
                yield from (_directive(name, what) for name, what in sorted(chosen.items()))


def _elsewhere(room: ModuleType, own: dict[str, object]) -> Iterator[str]:
    also = [name for name in sorted(room.__all__) if f"{room.__name__}.{name}" not in own]
    if also:
        links = ", ".join(f"[`{name}`](#neurotact.{name})" for name in also)
        yield f"Exports names of `neurotact` too: {links}."


def _directive(name: str, what: object) -> str:
    if inspect.isfunction(what):
        return _rest(f".. autofunction:: {name}")
    assert inspect.isclass(what), name
    if issubclass(what, Spec):
        return _rest(f".. autoclass:: {name}\n   :no-members:") + "\n\nIts keys: [specs](specs.md)."
    return _rest(f".. autoclass:: {name}\n   :members:")


def _rest(text: str) -> str:
    return f"```{{eval-rst}}\n{text}\n```"
