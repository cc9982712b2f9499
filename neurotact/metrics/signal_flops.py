"""The cost of conditioning and reduction of a signal, for the ledger of `neurotact.metrics.flops`."""

import math
from dataclasses import dataclass
from typing import Literal

from neurotact.errors import InputError, nearest
from neurotact.metrics.flops import BYTES, Cost, Layer


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
        return Cost(acs=self.samples * self.channels, multiplications=means, bytes=BYTES * self.channels)


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
        return Cost(multiplications=self.steps * self.channels, parameters=self.channels, bytes=BYTES * self.channels)


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
        return Cost(macs=n, acs=n + self.steps, comparisons=self.steps, bytes=BYTES * (2 * self.channels + 1))


@dataclass(frozen=True)
class BaselineRemoval(Layer):
    """Each sample of each channel minus the channel's level, which is stored.

    The level is the first sample (`first`, free), the mean (an addition per sample and a product) or the
    median (a sort: a comparison per sample and doubling; only it stores the samples). It is computed over the same
    samples that it is subtracted from. The mean so far costs an addition and a division per sample: of all (`running`)
    or of the first `start` (None: all), after which it is constant (`start`); an EMA (`high-pass`) a MAC and a product.

    >>> BaselineRemoval(samples=300, channels=8, level="mean").cost().flops
    4808
    >>> BaselineRemoval(samples=300, channels=8, level="start", start=100).cost().divisions
    800
    """

    samples: int
    channels: int = 1
    level: Literal["first", "mean", "median", "start", "running", "high-pass"] = "mean"
    start: int | None = None

    def cost(self) -> Cost:
        if self.level not in BASELINES:
            raise InputError(f"BaselineRemoval.level: '{self.level}' is unknown; {nearest(self.level, BASELINES)}")
        n = self.samples * self.channels
        kept = self.channels * (1 + (self.samples if self.level == "median" else 0))
        heard = self.samples if self.start is None or self.level == "running" else min(self.start, self.samples)
        so_far = Cost(acs=1, divisions=1).times(heard * self.channels)
        level = {
            "first": Cost(),
            "mean": Cost(acs=n, multiplications=self.channels),
            "median": Cost(comparisons=n * math.ceil(math.log2(self.samples))),
            "start": so_far,
            "running": so_far,
            "high-pass": Cost(macs=n, multiplications=n),
        }[self.level]
        return level + Cost(acs=n, bytes=BYTES * kept)


BASELINES = ("first", "mean", "median", "start", "running", "high-pass")


@dataclass(frozen=True)
class Rectification(Layer):
    """The absolute value of each step of each channel."""

    steps: int
    channels: int = 1

    def cost(self) -> Cost:
        return Cost(comparisons=self.steps * self.channels)


@dataclass(frozen=True)
class LevelSpreadRate(Layer):
    """Mean, deviation and mean absolute change of every channel, in one pass over the signal.

    A sample adds to the sum, its square to the sum of squares, and the magnitude of its difference from the previous
    sample to a third sum; at the end three products, the variance's MAC and a root.

    >>> LevelSpreadRate(samples=500, channels=8).cost().macs
    4008
    """

    samples: int
    channels: int = 1

    def cost(self) -> Cost:
        ends = Cost(macs=1, multiplications=3, divisions=1)
        sums = 4 * self.channels  # three, and the previous sample
        each = Cost(macs=1, acs=3, comparisons=1).times(self.samples) + ends
        return each.times(self.channels) + Cost(bytes=BYTES * sums)


@dataclass(frozen=True)
class BandPowers(Layer):
    """The logarithm of a signal's power in bands of frequency: a window, a real FFT, squares, sums.

    A real FFT of n samples takes n log2(n) multiplications and 1.5 n log2(n) additions (radix 2, half of the complex
    transform); the window is a multiplication per sample.

    >>> BandPowers(samples=256, bands=8, channels=2).cost().macs
    512.0
    """

    samples: int
    bands: int
    channels: int = 1

    def cost(self) -> Cost:
        n, transform = self.samples, self.samples * math.log2(max(2, self.samples))
        one = Cost(macs=float(n), acs=1.5 * transform + n, multiplications=transform + n, exponentials=self.bands)
        return one.times(self.channels) + Cost(bytes=BYTES * self.channels * n)


@dataclass(frozen=True)
class FixedConvolutions(Layer):
    """MiniRocket's features: nine-tap convolutions with weights of -1 and 2, and comparisons with biases.

    channels: of the sequence. dilations: how many different ones. convolved: channels, added up over all convolutions.
    biases: number of features. At each step the sum of nine taps is made once per dilation and channel (eight
    additions); a convolution then adds three taps, multiplies by 3 and subtracts that sum for each of its channels; a
    feature is a comparison and a count per step, and a product at the end.

    >>> FixedConvolutions(samples=100, channels=1, dilations=1, convolved=84, biases=84).cost().acs
    42800
    """

    samples: int
    channels: int
    dilations: int
    convolved: int
    biases: int

    def cost(self) -> Cost:
        n = self.samples
        additions = 8 * self.dilations * self.channels + 4 * self.convolved
        return Cost(
            acs=n * (additions + self.biases),
            multiplications=n * self.convolved + self.biases,
            comparisons=n * self.biases,
            parameters=self.biases,
            bytes=BYTES * (self.biases + n * self.channels),
        )


@dataclass(frozen=True)
class PooledStates(Layer):
    """Mean and maximum over `steps` steps of each of `units` states: an addition and a comparison each."""

    units: int
    steps: int

    def cost(self) -> Cost:
        n = self.units * self.steps
        return Cost(acs=n, multiplications=self.units, comparisons=n, bytes=2 * BYTES * self.units)
