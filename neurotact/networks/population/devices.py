"""The device of a population: a CUDA device, or Triton's interpreter on the CPU, which tests the same code."""

import os
from importlib.util import find_spec

import torch

from neurotact.errors import InputError

INTERPRET = "TRITON_INTERPRET"


def device_of(name: str) -> torch.device:
    """The device of this name (`cuda`, `cuda:1`) to train a population on.

    With TRITON_INTERPRET=1 in the environment it is the CPU; the interpreter then runs the kernels, very slowly.
    Raises InputError, in one line, if Triton or the device is absent.
    """
    if not name.startswith("cuda"):
        raise InputError(f"--device {name}: is not a device; give cuda, cuda:1 and so on, or cpu")
    if find_spec("triton") is None:
        raise InputError(
            f"--device {name}: needs Triton, which is not installed; pip install 'neurotact[gpu]' (Linux x86-64)"
        )
    if interpreted():
        return torch.device("cpu")
    if not torch.cuda.is_available():
        raise InputError(f"--device {name}: PyTorch finds no CUDA device here; leave --device out to use the CPU")
    device = torch.device(name)
    if (device.index or 0) >= torch.cuda.device_count():
        raise InputError(
            f"--device {name}: is one of {torch.cuda.device_count()} devices, counted from 0; choose another"
        )
    return device


def interpreted() -> bool:
    """Whether Triton runs its kernels in its interpreter; Triton reads this when it is first imported."""
    return os.environ.get(INTERPRET, "0").lower() in ("1", "true", "on", "yes", "y")
