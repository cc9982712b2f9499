"""What a study's numbers may depend on besides its specs."""

import importlib.metadata
import platform

from neurotact import __version__
from neurotact.backend import native

PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "pandas", "h5py", "snntorch", "nni", "pydantic")


def versions() -> dict[str, str]:
    """Versions of Python, of neurotact and of the packages that it computes with, the machine and the backend."""
    found = {name: importlib.metadata.version(name) for name in PACKAGES}
    backend = "native" if native is not None else "reference"
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "backend": backend,
        "neurotact": __version__,
        **found,
    }
