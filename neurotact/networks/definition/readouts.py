"""Readouts that do not spike: how they add up their input, and the value that they decide on."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from neurotact.neurons import Decay


class Stretches(NamedTuple):
    """How a window is divided: an integrator has weights of its own in each stretch.

    number: K. steps: of the network's clock in one stretch; the last stretch has no end.

    >>> Stretches(2, 3).of_steps(5).tolist()
    [0, 0, 0, 1, 1]
    """

    number: int
    steps: int

    def of_steps(self, n_steps: int) -> Tensor:
        """The stretch of each step of a window, `(time,)` int64."""
        return (torch.arange(n_steps) // self.steps).clamp(max=self.number - 1)

    def of_step(self, step: int) -> int:
        """The stretch of a step, which counts from 0."""
        return min(step // self.steps, self.number - 1)

    def counts(self, spikes: Tensor) -> Tensor:
        """Spikes `(trial, time, neuron)` added up in each stretch, `(trial, K, neuron)`; differentiable.

        >>> Stretches(2, 1).counts(torch.ones(1, 3, 1)).tolist()
        [[[1.0], [2.0]]]
        """
        n_steps = spikes.shape[-2]
        ends = [min(k * self.steps, n_steps) for k in range(self.number)] + [n_steps]
        lengths = [stop - start for start, stop in pairwise(ends)]
        return torch.stack([part.sum(dim=-2) for part in spikes.split(lengths, dim=-2)], dim=-2)

    def sums(self, counts: Tensor, weights: Tensor) -> Tensor:
        """What `counts`, `(trial, K, neuron)`, add through weights `(K, neuron, class)`: `(trial, class)`."""
        return counts.flatten(-2) @ weights.flatten(-3, -2)

    def gains(self, spikes: Tensor, weights: Tensor) -> Tensor:
        """What spikes `(trial, time, neuron)` add in each step through weights `(K, neuron, class)`.

        `(trial, time, class)`.
        """
        return torch.einsum("nth,thc->ntc", spikes, weights[self.of_steps(spikes.shape[1]).to(weights.device)])


@dataclass(frozen=True)
class Integration:
    """y[t+1] = d y[t] + W s[t] from y[0] = 0, in float64; the class of the largest value decides.

    The value is b + y at the last step or, with `peak`, b + max over time of y, y[0] included. Both are readouts
    of surrogate-gradient learning: "last time step" and "max over time" (Cramer et al. 2020, doi
    10.1109/TNNLS.2020.3044364; the synaptic filter of their readout is left out). With d = 1 it is the sum over the
    window.

    level: b, the bias, `(class,)` float64. decay: d, the factor of y per step. peak: the maximum over time.
    Of many networks at once, level is `(network, 1, class)` and decay, unless it is 1 for all, `(network, 1, 1)`.

    >>> gained = torch.tensor([[[4.0], [0.0], [1.0]]])
    >>> level = torch.tensor([0.5], dtype=torch.float64)
    >>> [float(Integration(level, decay, peak).of(gained)) for decay, peak in ((1.0, False), (0.5, False), (0.5, True))]
    [5.5, 2.5, 4.5]
    """

    level: Tensor
    decay: Decay = 1.0
    peak: bool = False

    @property
    def leaks(self) -> bool:
        """Whether the value depends on the times of spikes, and not only on their number."""
        return self.peak or isinstance(self.decay, Tensor) or self.decay != 1

    def start(self, *trials: int) -> tuple[Tensor, Tensor]:
        """Y and the value before the first step, `(trial, class)` or `(network, trial, class)` each."""
        value = self.level.expand(*trials, self.level.shape[-1]).clone()
        return torch.zeros_like(value), value

    def after(self, gained: Tensor, y: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
        """Y and the value one step later; `gained` is W s[t]."""
        if not self.leaks:
            return y, value + gained
        y = self.decay * y + gained
        now = self.level + y
        # Among equal values, the earliest gets the gradient.
        return y, torch.where(now > value, now, value) if self.peak else now

    def over(self, gained: Tensor) -> Iterator[Tensor]:
        """The value after each step of windows `(trial, time, class)`."""
        y, value = self.start(*gained.shape[:-2])
        for gain in gained.unbind(dim=-2):
            y, value = self.after(gain, y, value)
            yield value

    def of(self, gained: Tensor) -> Tensor:
        """The value at the end of windows `(trial, time, class)`, `(trial, class)`."""
        if not self.leaks:
            return self.level + gained.sum(dim=-2)
        value = self.start(*gained.shape[:-2])[1]
        for value in self.over(gained):  # noqa: B007
            pass
        return value

    def detach(self) -> "Integration":
        """The same, without gradients."""
        return Integration(self.level.detach(), self.decay, self.peak)

    def cpu(self) -> "Integration":
        """The same for values on the CPU."""
        return Integration(self.level.cpu(), self.decay, self.peak)
