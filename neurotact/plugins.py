"""Parts that are found by name and never imported, ours and other packages'.

A part is an entry point of one of the groups in `Group`, such as `neurotact.readers`, in the `pyproject.toml` of the
package that provides it (`docs/plugins.md`).
"""

from collections.abc import Callable
from functools import lru_cache
from importlib import invalidate_caches
from importlib.metadata import Distribution, EntryPoint, entry_points
from typing import Any, Literal

from neurotact.errors import InputError, first_line, nearest

Group = Literal[
    "simulators",
    "readers",
    "formats",
    "encoders",
    "networks",
    "surrogates",
    "losses",
    "opponents",
    "ways",
    "measures",
    "prices",
    "exporters",
    "tools",
]
OURS = __name__.partition(".")[0]


def names(group: Group) -> list[str]:
    """The names of the parts of a group in the installed packages, sorted; nothing is imported.

    >>> "gratings" in names("simulators")
    True
    """
    return sorted(_found(group))


def in_order(group: Group) -> list[str]:
    """The names of a group, ours first, as our `pyproject.toml` has them, then those of other packages."""
    return sorted(_found(group), key=lambda name: not is_ours(group, name))


def modules(group: Group) -> list[str]:
    """The modules of our parts of a group, sorted; nothing is imported.

    >>> modules("opponents")[0]
    'neurotact_parts.opponents.elm'
    """
    return sorted({_found(group)[name][0].module for name in names(group) if is_ours(group, name)})


def of_others(group: Group) -> dict[str, str]:
    """The names of the parts of other packages, sorted, with the package that brings each; nothing is imported.

    >>> of_others("encoders")
    {}
    """
    others = [name for name in names(group) if not is_ours(group, name)]
    return {name: " and ".join(sorted(map(_package, _found(group)[name]))) for name in others}


def is_ours(group: Group, name: str) -> bool:
    """Whether neurotact itself has a part of that name."""
    return OURS in map(_package, _found(group).get(name, ()))


def load(group: Group, name: str, kind: type | None = None) -> Any:
    """Import the part of a group with this name.

    Raises InputError, which names the package, when there is none, when two packages provide one of that name, when it
    cannot be imported, and when it is not of a `kind`.

    >>> load("ways", "stifness")
    Traceback (most recent call last):
    neurotact.errors.InputError: ways: there is none called 'stifness'; did you mean 'stiffness'?
    """
    points = _found(group)[known(group, name)]
    if len(points) > 1:
        raise _twice(group, name, [_package(point) for point in points])
    try:
        part = points[0].load()
    except (Exception, SystemExit) as error:  # the code of another package runs here
        raise InputError(
            f"{_about(group, name)} cannot be imported ({first_line(error)}); update or remove it"
        ) from error
    if kind is not None and not isinstance(part, kind):
        raise unfit(group, name, f"is of the type {type(part).__name__} where a {kind.__name__} is expected")
    return part


def has(group: Group, name: object) -> bool:
    """Whether an installed package has a part of that name, which is not imported.

    A name that is not found is looked for again: its package may have been installed since, as in a notebook, or the
    list may be that of the process from which a worker was forked.

    >>> has("encoders", "burst"), has("encoders", "brust")
    (True, False)
    """
    if not isinstance(name, str):
        return False
    if name not in _found(group):
        _found.cache_clear()
        invalidate_caches()
    return name in _found(group)


def known(group: Group, name: str) -> str:
    """The name, if a part of a group has it, which is not imported; else InputError with the nearest one.

    >>> known("losses", "cross-entropy")
    'cross-entropy'
    """
    if not has(group, name):
        raise InputError(f"{group}: there is none called '{name}'; {nearest(name, names(group))}")
    return name


def load_function(group: Group, name: str) -> Callable[..., Any]:
    """`load`, of a group whose parts are functions; each is loaded once."""
    part = _loaded(group, name)
    if not callable(part):
        raise unfit(group, name, f"is of the type {type(part).__name__} where a function is expected")
    return part


def unfit(group: Group, name: str, why: str) -> InputError:
    """The error for a part that can be imported and not used; `why`, in words."""
    return InputError(f"{_about(group, name)} {why}; update or remove it")


def refuse_taken(group: Group, name: str) -> None:
    """InputError if another package has a part of a name that neurotact has, as a part or as a command."""
    others = [package for package in map(_package, _found(group).get(name, [])) if package != OURS]
    if others:
        raise _twice(group, name, [OURS, *others])


def _twice(group: Group, name: str, packages: list[str]) -> InputError:
    others = [package for package in packages if package != OURS]
    remedy = f"uninstall {others[0]}" if len(others) < len(packages) and others else "uninstall one of them"
    return InputError(f"{group}: '{name}' is provided by {' and '.join(sorted(packages))}; {remedy}")


def _about(group: Group, name: str) -> str:
    (point,) = _found(group)[name]
    return f"{group}: '{name}' of the package {_package(point)} ({point.value})"


@lru_cache
def _loaded(group: Group, name: str) -> Any:
    return load(group, name)


@lru_cache
def _found(group: Group) -> dict[str, list[EntryPoint]]:
    """Entry points by name; a package that is installed twice counts once."""
    by_name: dict[str, dict[str, EntryPoint]] = {}
    for point in entry_points(group=f"neurotact.{group}"):
        by_name.setdefault(point.name, {})[f"{_package(point)} {point.value}"] = point
    return {name: list(points.values()) for name, points in by_name.items()}


def _package(point: EntryPoint) -> str:
    return _name_of(point.dist) if point.dist else "an unknown package"


@lru_cache
def _name_of(package: Distribution) -> str:
    """The name in the metadata, whose text is long: it is parsed once."""
    return package.name
