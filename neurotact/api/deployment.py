"""A trained chain in a form of its own: exported."""

from typing import Any

from neurotact.networks.use.exporters import Exporter as Exporter
from neurotact.networks.use.exporters import export as export
from neurotact.networks.use.exporters import exporter
from neurotact.networks.use.exporters import usable as usable

EXPORTED = {"export_c": "c", "export_nir": "nir"}
"""Functions that are those of exporters, by their names in Python."""


def __getattr__(name: str) -> Any:
    if name in EXPORTED:
        return exporter(EXPORTED[name]).export
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
