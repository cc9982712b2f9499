"""The costs of the features of `spike_features` and the distances of `spike_distances`, as layers of the ledger.

Each counts the operations per spike and those at the window's end, from measured spikes (means need not be
whole). References of distances are stored as spike times, and filtered or compared when a trial arrives. Spikes are
read from a buffer, features written to one; counts, sums, times and traces are states.
"""

from dataclasses import dataclass

from neurotact.errors import InputError
from neurotact.metrics.flops import BYTES, Cost, Layer, passed


@dataclass(frozen=True)
class _OfSpikes(Layer):
    """The common part of these layers: the number of afferents and of their spikes in a window."""

    afferents: int
    spikes: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.spikes >= 0:
            raise InputError(f"{type(self).__name__}.spikes: must be >= 0; got {self.spikes}")

    def kept(self, states: float, changes: float, made: float) -> dict[str, float]:
        """The memory of so many states, which are read or written so often, and of the spikes and features."""
        held = int(BYTES * states)
        return {"bytes": held, "states_bytes": held, "states_accesses": changes, **passed(self.spikes, made)}


@dataclass(frozen=True)
class Rates(_OfSpikes):
    """Average rates: a count per spike; a product per afferent."""

    def cost(self) -> Cost:
        n = self.afferents
        return Cost(acs=self.spikes, multiplications=n, **self.kept(n, 2 * self.spikes, n))


@dataclass(frozen=True)
class Intervals(_OfSpikes):
    """Mean of the intervals and, with `variation`, their coefficient of variation.

    A spike takes a difference and an addition, and a MAC for the square. An afferent takes a division, and another MAC,
    root and division for the variation.
    """

    variation: bool = True

    def cost(self) -> Cost:
        squares = self.spikes * self.variation
        divisions = self.afferents * (3 if self.variation else 1)
        macs = squares + self.afferents * self.variation
        each = 3 + self.variation  # last spike, count, sum, sum of squares, which a spike changes
        kept = self.kept(self.afferents * each, 2 * each * self.spikes, self.afferents)
        return Cost(macs=macs, acs=2 * self.spikes, divisions=divisions, **kept)


@dataclass(frozen=True)
class BinFanoFactors(_OfSpikes):
    """Fano factors over `bins` bins: a count per spike; a MAC per bin; a product, a MAC and a division per afferent."""

    bins: int = 1

    def cost(self) -> Cost:
        n = self.afferents
        kept = self.kept(3 * n, 2 * self.spikes + 4 * n * self.bins, n)  # a bin's count, and the sums that it adds to
        return Cost(macs=n * (self.bins + 1), acs=self.spikes, multiplications=n, divisions=n, **kept)


@dataclass(frozen=True)
class CoOccurrences(_OfSpikes):
    """Pairs of spikes within a lag: a difference, a comparison and a count for each of `pairs` (measured)."""

    pairs: float = 0.0

    def cost(self) -> Cost:
        counts = self.afferents * (self.afferents + 1) / 2
        kept = self.kept(counts + self.spikes, 3 * self.pairs + self.spikes, counts)  # each time is written once
        return Cost(acs=2 * self.pairs, comparisons=self.pairs, **kept)


@dataclass(frozen=True)
class DelayedTraces(_OfSpikes):
    """Traces that decay at each of `steps` steps (a product per afferent) and rise by one per spike; reads are free."""

    steps: int = 1
    delays: int = 1

    def cost(self) -> Cost:
        n, decays = self.afferents, self.afferents * self.steps
        kept = self.kept(n * (1 + self.delays), 2 * (decays + self.spikes), n * self.delays)
        return Cost(acs=self.spikes, multiplications=decays, **kept)


@dataclass(frozen=True)
class GreyImages(_OfSpikes):
    """A count per spike; a comparison and a product per pixel."""

    columns: int = 1

    def cost(self) -> Cost:
        pixels = self.afferents * self.columns
        kept = {**self.kept(pixels / BYTES, 2 * self.spikes, pixels), "buffers_bytes": pixels}  # a byte each
        return Cost(acs=self.spikes, multiplications=pixels, comparisons=pixels, **kept)


@dataclass(frozen=True)
class VanRossum(_OfSpikes):
    """Distances to `references` trials with `reference_spikes` spikes in all.

    The trial is filtered in both directions (a MAC per step, afferent and direction). Each spike of a reference reads
    the filtered trace and adds it; a reference takes two additions, a product and a root. Its own norm is stored.
    """

    steps: int = 1
    references: int = 1
    reference_spikes: float = 0.0

    def cost(self) -> Cost:
        traces, stored = self.afferents * self.steps, self.reference_spikes + self.references
        moved = self.kept(traces, 2 * 2 * traces + self.reference_spikes, self.references)
        return Cost(
            **{**moved, "bytes": int(BYTES * (stored + traces))},
            weights_accesses=stored,
            macs=2 * traces,
            acs=self.reference_spikes + 2 * self.references,
            multiplications=self.references,
            divisions=self.references,
            parameters=int(self.reference_spikes) + self.references,
        )


@dataclass(frozen=True)
class VictorPurpura(_OfSpikes):
    """Distances to `references` trials by the recursion over `pairs` pairs of spikes, measured over all afferents.

    A pair takes a difference, its absolute value, two additions and two minima; times are stored in units of cost, and
    the deletions on both sides share one addition.
    """

    references: int = 1
    reference_spikes: float = 0.0
    pairs: float = 0.0

    def cost(self) -> Cost:
        moved = self.kept(2 * self.spikes, 3 * self.pairs, self.references)  # a sum of the last row, and a time
        return Cost(
            **{**moved, "bytes": int(BYTES * (self.reference_spikes + 2 * self.spikes))},
            weights_accesses=self.reference_spikes,
            acs=3 * self.pairs + self.afferents * self.references,
            comparisons=3 * self.pairs,
            parameters=int(self.reference_spikes),
        )


@dataclass(frozen=True)
class NearestOf(Layer):
    """The `neighbours` nearest of `references` known distances: a comparison per distance and neighbour."""

    references: int
    neighbours: int = 1

    def cost(self) -> Cost:
        return Cost(comparisons=self.references * self.neighbours, **passed(self.references, self.neighbours))
