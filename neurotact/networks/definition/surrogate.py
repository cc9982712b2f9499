"""Surrogate gradients: a step forward, a smooth slope backward (texture paper, Eq. 7).

Another package adds a slope by an entry point of the group `neurotact.surrogates`: a function of U - threshold and of
the spec's scale lambda, both tensors or numbers, which gives the derivative of a spike.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from neurotact import plugins
from neurotact.neurons import FAST_SIGMOID, Decay, SpikeFunction


def spike_function(surrogate: str, scale: float) -> SpikeFunction:
    """The step with the slope of a surrogate, by its name.

    >>> spike_function("fast-sigmoid", 5.0)
    FastSigmoid(scale=5.0)
    >>> x = torch.tensor([0.0, 0.2], requires_grad=True)
    >>> spike_function("arctan", 5.0)(x).sum().backward()
    >>> [round(g, 4) for g in x.grad.tolist()]
    [1.0, 0.2884]
    """
    if surrogate == FAST_SIGMOID:
        return FastSigmoid(scale)
    return _Sloped(plugins.load_function("surrogates", surrogate), scale)


def fast_sigmoid(x: Tensor, scale: Decay) -> Tensor:
    """`1 / (1 + scale |x|)^2` (Zenke and Ganguli 2018)."""
    return 1 / (1 + scale * x.abs()) ** 2


def arctan(x: Tensor, scale: Decay) -> Tensor:
    """`1 / (1 + (pi scale x / 2)^2)` (Fang et al. 2021), 1 at the threshold like the fast sigmoid."""
    return 1 / (1 + (math.pi / 2 * scale * x) ** 2)


@dataclass(frozen=True)
class _Sloped:
    """A step whose gradient is the `slope` of U - threshold and of a scale."""

    slope: Callable[[Tensor, Decay], Tensor]
    scale: Decay

    def __call__(self, x: Tensor) -> Tensor:
        return _Step.apply(x, self.slope, self.scale)  # pyright: ignore[reportReturnType]


class _Step(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, slope: Callable, scale: Decay) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx.save_for_backward(x)
        ctx.slope, ctx.scale = slope, scale
        return (x > 0).to(x.dtype)

    @staticmethod
    def backward(ctx, grad: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        (x,) = ctx.saved_tensors
        return grad * ctx.slope(x, ctx.scale), None, None


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
