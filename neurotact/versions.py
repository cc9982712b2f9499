"""What a study's numbers may depend on besides its specs."""

import importlib.metadata
import platform

from neurotact import __version__
from neurotact.backend import native

PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "pandas", "h5py", "snntorch", "nni", "pydantic")


def versions() -> dict[str, str]:
    """Versions of Python, of neurotact and of the packages that it computes with, the machine and the backend.

    `instructions` are those that torch computes with, such as AVX2: with others, its last bits differ.
    """
    import torch  # a process that only starts others does without

    known = {name: importlib.metadata.version(name) for name in PACKAGES}
    backend = "native" if native is not None else "reference"
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "backend": backend,
        "neurotact": __version__,
        **known,
    }
