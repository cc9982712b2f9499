"""Adam for all members of a population together: each weight has its rate, each member its count of steps."""

from collections.abc import Sequence

import torch
from torch import Tensor

EPSILON = 1e-8
"""As in torch.optim.Adam; the steps equal its steps except for rounding in float32."""


class Adam:
    """Kingma and Ba 2015, Algorithm 1, for rows of weights `(member, weight)`, which steps change in place.

    rates: before any schedule, in the shape of `weights`. betas: of each member.
    """

    def __init__(self, weights: Tensor, rates: Tensor, betas: Sequence[tuple[float, float]]) -> None:
        self.weights, self.rates = weights, rates.to(weights.device)
        self.betas = torch.tensor(betas, dtype=torch.float64, device=weights.device)
        self.steps = torch.zeros(len(weights), dtype=torch.float64, device=weights.device)
        self.mean, self.square = torch.zeros_like(weights), torch.zeros_like(weights)

    @torch.no_grad()
    def step(self, members: Tensor, gradients: Tensor, shares: Tensor) -> None:
        """Step some members, `(place,)`, along their gradients `(place, weight)`.

        shares: the factors of their schedules on their rates, `(place,)`.
        """
        at = members.long()
        self.steps[at] += 1
        betas = self.betas[at]
        corrections = 1 - betas ** self.steps[at, None]
        first, second = (column[:, None].to(gradients.dtype) for column in (1 - betas).unbind(dim=1))
        mean, square = self.mean[at], self.square[at]
        mean = mean + first * (gradients - mean)
        square = (1 - second) * square + second * gradients * gradients
        scale = (shares.double() / corrections[:, 0])[:, None].to(gradients.dtype)
        root = corrections[:, 1].sqrt()[:, None].to(gradients.dtype)
        self.weights[at] -= self.rates[at] * scale * mean / (square.sqrt() / root + EPSILON)
        self.mean[at], self.square[at] = mean, square
