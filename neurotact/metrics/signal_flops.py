"""What it costs to condition or to reduce a signal, for the ledger of `neurotact.metrics.flops`."""

import math
from dataclasses import dataclass
from typing import Literal

from neurotact.errors import InputError, nearest
from neurotact.metrics.flops import BYTES, SQUARE_ROOT, Cost, Layer


@dataclass(frozen=True)
class Averaging(Layer):
    """Means over pieces of a signal: `samples` of every channel become `steps`.

    An addition a sample and a product a step.

    >>> Averaging(samples=500, steps=50, channels=2).cost().acs
    1000
    """

    samples: int
    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        means = self.steps * self.channels
        return Cost(acs=self.samples * self.channels, other_flops=means, bytes=BYTES * self.channels)


@dataclass(frozen=True)
class StandardisedSteps(Layer):
    """Each step of each channel times the channel's scale plus its offset."""

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        parameters = 2 * self.channels
        return Cost(macs=self.steps * self.channels, parameters=parameters, bytes=BYTES * parameters)


@dataclass(frozen=True)
class ScaledSteps(Layer):
    """Each step of each channel times the channel's scale, with nothing added.

    >>> ScaledSteps(steps=300, channels=16).cost().parameters
    16
    """

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        return Cost(other_flops=self.steps * self.channels, parameters=self.channels, bytes=BYTES * self.channels)


@dataclass(frozen=True)
class Interpolation(Layer):
    """Linear interpolation onto another clock: `steps` steps of every channel between the two samples beside each.

    A step of a channel takes a difference and a MAC, `left + weight (right - left)`. What a step needs once for all
    channels is an addition, the position's increment, and a comparison, whether the next sample begins. Kept are two
    samples a channel and the position.

    >>> spent = Interpolation(steps=300, channels=16).cost()
    >>> spent.macs, spent.acs, spent.other_flops
    (4800, 5100, 300)
    """

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        n = self.steps * self.channels
        return Cost(macs=n, acs=n + self.steps, other_flops=self.steps, bytes=BYTES * (2 * self.channels + 1))


@dataclass(frozen=True)
class BaselineRemoval(Layer):
    """Each sample of each channel minus the channel's level, which is kept.

    The level is that of the first sample (`first`, for nothing), the mean (an addition a sample and a product) or the
    median (a sort: a comparison a sample and a doubling; it alone keeps the samples). It is found over as many samples
    as it is taken off. The mean so far (`running`, and `start` until it is kept) costs an addition and a product a
    sample, what an EMA follows (`high-pass`) a MAC and a product.

    >>> BaselineRemoval(samples=300, channels=8, level="mean").cost().flops
    4808
    """

    samples: int
    channels: int = 1
    level: Literal["first", "mean", "median", "start", "running", "high-pass"] = "mean"

    def cost(self) -> Cost:
        if self.level not in BASELINES:
            raise InputError(f"BaselineRemoval.level: '{self.level}' is unknown; {nearest(self.level, BASELINES)}")
        n = self.samples * self.channels
        kept = self.channels * (1 + (self.samples if self.level == "median" else 0))
        sums = n if self.level in ("mean", "start", "running") else 0
        products = {"mean": self.channels, "start": n, "running": n, "high-pass": n}.get(self.level, 0)
        comparisons = n * math.ceil(math.log2(self.samples)) if self.level == "median" else 0
        macs = n if self.level == "high-pass" else 0
        return Cost(macs=macs, acs=n + sums, other_flops=products + comparisons, bytes=BYTES * kept)


BASELINES = ("first", "mean", "median", "start", "running", "high-pass")


@dataclass(frozen=True)
class Rectification(Layer):
    """The absolute value of each step of each channel."""

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        return Cost(other_flops=self.steps * self.channels)


@dataclass(frozen=True)
class LevelSpreadRate(Layer):
    """Mean, deviation and mean absolute change of every channel, in one pass over the signal.

    A sample adds to the sum, its square to the sum of squares, and the size of its difference from the sample before to
    a third sum; at the end three products, the variance's MAC and a root.

    >>> LevelSpreadRate(samples=500, channels=8).cost().macs
    4008
    """

    samples: int
    channels: int = 1

    def cost(self) -> Cost:
        n = self.samples * self.channels
        ends = self.channels * (3 + SQUARE_ROOT)
        sums = 4 * self.channels  # three, and the sample before
        return Cost(macs=n + self.channels, acs=3 * n, other_flops=n + ends, bytes=BYTES * sums)
