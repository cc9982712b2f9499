"""Whether the compiled kernels run for the weights of a network."""

import torch

from neurotact import backend
from neurotact.backend import Backend, native

__all__ = ["Backend", "native", "use_native"]


def use_native(chosen: Backend, like: torch.Tensor) -> bool:
    """Whether the compiled kernels run for weights like `like`: on the CPU, in float32 or float64."""
    applies = like.device.type == "cpu" and like.dtype in (torch.float32, torch.float64)
    return backend.use_native(chosen, applies, "weights on the CPU in float32 or float64")
