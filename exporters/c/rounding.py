"""Rounded weights in training: the forward pass uses whole multiples of a step, gradients pass unchanged.

This is the straight-through estimator (Hinton 2012; Bengio, Leonard and Courville 2013, arXiv 1308.3432): the trained
weights stay unrounded and get the gradient of the rounded ones.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from neurotact.networks.definition.rsnn import RSNN


class Grid(NamedTuple):
    """The values of a weight: `step k`, with a whole number k from -most to most."""

    step: float
    most: int

    @torch.no_grad()
    def nearest(self, weights: Tensor) -> Tensor:
        """The nearest weights on the grid, halves to even, in the weights' float type.

        >>> Grid(0.5, 3).nearest(torch.tensor([0.2, 0.3, -1.1, 9.0])).tolist()
        [0.0, 0.5, -1.0, 1.5]
        """
        whole = (weights.double() / self.step).round().clamp(-self.most, self.most)
        return (whole * self.step).to(weights.dtype)


class SeenRounded(nn.Module):
    """Weights rounded for the forward pass; their gradient passes unchanged.

    >>> weights = torch.tensor([0.2, 0.3], requires_grad=True)
    >>> seen = SeenRounded(Grid(0.5, 3))(weights)
    >>> (3 * seen).sum().backward()
    >>> seen.tolist(), weights.grad.tolist()
    ([0.0, 0.5], [3.0, 3.0])
    """

    def __init__(self, grid: Grid) -> None:
        super().__init__()
        self.grid = grid

    def forward(self, weights: Tensor) -> Tensor:
        # The difference is exactly 0: the sum is on the grid to the last bit.
        return self.grid.nearest(weights) + (weights - weights.detach())


@contextmanager
def seen_rounded(network: RSNN, grids: Mapping[str, Grid]) -> Iterator[None]:
    """In this context the network uses these weights rounded; afterwards they stay rounded.

    grids: by the name of the weights, such as `w_in`.

    >>> net = RSNN(2, 2, hidden=3, sampling_rate_Hz=1000.0, generator=torch.Generator().manual_seed(0))
    >>> with seen_rounded(net, {"w_out": Grid(0.25, 1)}):
    ...     trained = dict(net.named_parameters())["parametrizations.w_out.original"]
    ...     _ = trained.data.add_(5.0)
    >>> net.w_out.unique().tolist()
    [0.25]
    """
    for name, grid in grids.items():
        parametrize.register_parametrization(network, name, SeenRounded(grid))
    try:
        yield
    finally:
        for name in grids:
            parametrize.remove_parametrizations(network, name, leave_parametrized=True)
