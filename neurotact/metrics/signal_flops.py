"""The cost of conditioning and reduction of a signal, for the ledger of `neurotact.metrics.flops`."""

from dataclasses import dataclass
from typing import Literal

from neurotact.errors import InputError, nearest
from neurotact.metrics.flops import Cost, Layer, changed, in_registers, passed, with_weights


@dataclass(frozen=True)
class Averaging(Layer):
    """Means over pieces of a signal: `samples` of every channel become `steps`.

    An addition per sample and a product per step.

    >>> Averaging(samples=500, steps=50, channels=2).cost().acs
    1000
    """

    samples: int
    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        means = self.steps * self.channels
        n = self.samples * self.channels
        return with_weights(0, self.channels, acs=n, multiplications=means, **changed(n), **passed(0, means))


@dataclass(frozen=True)
class StandardisedSteps(Layer):
    """Each step of each channel times the channel's scale plus its offset."""

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        parameters = 2 * self.channels
        n = self.steps * self.channels
        return with_weights(parameters, macs=n, weights_accesses=2 * n)  # a step at a time, on its way to what follows


@dataclass(frozen=True)
class ScaledSteps(Layer):
    """Each step of each channel times the channel's scale, with nothing added.

    >>> ScaledSteps(steps=300, channels=16).cost().parameters
    16
    """

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        n = self.steps * self.channels
        return with_weights(self.channels, multiplications=n, weights_accesses=n)


@dataclass(frozen=True)
class Interpolation(Layer):
    """Linear interpolation onto another clock: `steps` steps of every channel, each between two samples.

    A step of a channel takes a difference and a MAC, `left + weight (right - left)`. Once per step for all channels, an
    addition increments the position and a comparison checks for the next sample. The state is two samples per channel
    and the position.

    >>> spent = Interpolation(steps=300, channels=16).cost()
    >>> spent.macs, spent.acs, spent.comparisons
    (4800, 5100, 300)
    """

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        n = self.steps * self.channels
        moved = 2 * n + 2 * self.steps  # both samples of each channel; the position is read and written
        state = 2 * self.channels + 1
        return with_weights(0, state, macs=n, acs=n + self.steps, comparisons=self.steps, states_accesses=moved)


@dataclass(frozen=True)
class BaselineRemoval(Layer):
    """Each sample of each channel minus the channel's level, which is stored.

    The level is the first sample (`first`, free) or the mean (an addition per sample and a product), over the same
    samples that it is subtracted from. The mean so far of the first `start` samples (None: all), after which it is
    constant (`start`), costs an addition and a division each; an EMA (`high-pass`) a MAC and a product per sample.

    >>> BaselineRemoval(samples=300, channels=8, level="mean").cost().flops
    4808
    >>> BaselineRemoval(samples=300, channels=8, level="start", start=100).cost().divisions
    800
    """

    samples: int
    channels: int = 1
    level: Literal["first", "mean", "start", "high-pass"] = "mean"
    start: int | None = None

    def cost(self) -> Cost:
        if self.level not in BASELINES:
            raise InputError(f"BaselineRemoval.level: '{self.level}' is unknown; {nearest(self.level, BASELINES)}")
        n = self.samples * self.channels
        heard = self.samples if self.start is None else min(self.start, self.samples)
        so_far = Cost(acs=1, divisions=1, **changed(1)).times(heard * self.channels)
        level = {
            "first": Cost(),
            "mean": Cost(acs=n, multiplications=self.channels, states_accesses=4 * n),  # summed and kept; read again
            "start": so_far,
            "high-pass": Cost(macs=n, multiplications=n, **changed(n)),
        }[self.level]
        return level + with_weights(0, self.channels, acs=n, states_accesses=n)


BASELINES = ("first", "mean", "start", "high-pass")


@dataclass(frozen=True)
class Rectification(Layer):
    """The absolute value of each step of each channel."""

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        return in_registers(comparisons=self.steps * self.channels)
