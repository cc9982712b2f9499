"""The optional package `nir`, which contains the node classes."""

from typing import Any

from neurotact.errors import optional


def nir() -> Any:
    """The package; InputError if it is not installed."""
    return optional("nir", "nir: cannot be imported ({}); pip install 'neurotact[nir]'")
