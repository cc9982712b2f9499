"""Functions of packages beside this one, each found by its name in the group `neurotact.tools` and loaded when used."""

from typing import Any

from neurotact import plugins

TOOLS = ("check_chip", "fine_tune", "from_nir", "live", "to_nir")


def __getattr__(name: str) -> Any:
    if name in TOOLS:
        return plugins.load_function("tools", name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
