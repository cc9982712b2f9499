"""The optional package `nir`, which contains the node classes."""

from typing import Any

from neurotact.errors import InputError


def nir() -> Any:
    """The package; InputError if it is not installed."""
    try:
        import nir as package  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(f"nir: cannot be imported ({error}); pip install 'neurotact[nir]'") from error
    return package
