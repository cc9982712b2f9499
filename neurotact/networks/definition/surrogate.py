"""Surrogate gradients: a step forward, a smooth slope backward (texture paper, Eq. 7)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from neurotact.neurons import Decay


@dataclass(frozen=True)
class FastSigmoid:
    """Theta(x) with Theta(0) = 0; its gradient is that of the fast sigmoid, `1 / (1 + scale |x|)^2`.

    In the reference implementation, any callable that maps U - threshold to spikes can replace it, such as those of
    `snntorch.surrogate`.

    >>> x = torch.tensor([-0.1, 0.0, 0.2], requires_grad=True)
    >>> spikes = FastSigmoid(10.0)(x)
    >>> spikes.sum().backward()
    >>> spikes.tolist(), [round(g, 4) for g in x.grad.tolist()]
    ([0.0, 0.0, 1.0], [0.25, 1.0, 0.1111])
    """

    scale: Decay = 10.0

    def __call__(self, x: Tensor) -> Tensor:
        return _FastSigmoidStep.apply(x, self.scale)  # pyright: ignore[reportReturnType]


class _FastSigmoidStep(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, scale: Decay) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx.save_for_backward(x)
        ctx.scale = scale
        return (x > 0).to(x.dtype)

    @staticmethod
    def backward(ctx, grad: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        (x,) = ctx.saved_tensors
        return grad / (1 + ctx.scale * x.abs()) ** 2, None
