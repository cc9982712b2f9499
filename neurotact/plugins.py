"""Parts that are found by name and never imported: simulators, readers and protocols, ours and other packages'.

A part is an entry point of the group `neurotact.simulators`, `neurotact.readers` or `neurotact.protocols` in the
`pyproject.toml` of the package that provides it (`docs/plugins.md`).
"""

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from neurotact.errors import InputError, nearest

Group = Literal["simulators", "readers", "protocols"]


def names(group: Group) -> list[str]:
    """The names of the parts of a group in the installed packages, sorted; nothing is imported.

    >>> "gratings" in names("simulators")
    True
    """
    return sorted(_found(group))


def load(group: Group, name: str) -> Any:
    """Import the part of a group with this name.

    Raises InputError when there is none, when two packages provide one of that name, or when it cannot be imported.

    >>> load("protocols", "stifness")
    Traceback (most recent call last):
    neurotact.errors.InputError: protocols: there is none called 'stifness'; did you mean 'stiffness'?
    """
    found = _found(group).get(name)
    if found is None:
        raise InputError(f"{group}: there is none called '{name}'; {nearest(name, names(group))}")
    if len(found) > 1:
        packages = " and ".join(sorted(_package(point) for point in found))
        raise InputError(f"{group}: '{name}' is provided by {packages}; uninstall one of them")
    try:
        return found[0].load()
    except (ImportError, AttributeError) as error:
        package = _package(found[0])
        raise InputError(f"{group}: '{name}' of {package} cannot be imported ({error}); update {package}") from error


@lru_cache
def _found(group: Group) -> dict[str, list[EntryPoint]]:
    """Entry points by name; a package that is installed twice counts once."""
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in entry_points(group=f"neurotact.{group}"):
        found.setdefault(point.name, {})[f"{_package(point)} {point.value}"] = point
    return {name: list(points.values()) for name, points in found.items()}


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else "an unknown package"
