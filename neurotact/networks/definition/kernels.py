"""Where a network computes: on which torch device, and whether the compiled kernels run for its weights."""

import torch

from neurotact import backend
from neurotact.backend import Backend, native
from neurotact.errors import InputError

__all__ = ["Backend", "device_of", "native", "use_native"]


def use_native(chosen: Backend, like: torch.Tensor) -> bool:
    """Whether the compiled kernels run for weights like `like`: on the CPU, in float32 or float64."""
    applies = like.device.type == "cpu" and like.dtype in (torch.float32, torch.float64)
    return backend.use_native(chosen, applies, "weights on the CPU in float32 or float64")


def device_of(name: str) -> torch.device:
    """The torch device of this name; InputError if torch cannot use it."""
    try:
        torch.zeros(1, device=name).item()
        return torch.device(name)
    except (RuntimeError, AssertionError, TypeError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"`device={name!r}`: torch cannot use it here ({why}); try cpu") from error
