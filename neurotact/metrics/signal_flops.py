"""What it costs to reduce a signal before a classifier sees it, for the ledger of `neurotact.metrics.flops`."""

from dataclasses import dataclass

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
