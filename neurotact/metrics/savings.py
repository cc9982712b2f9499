"""Which way is the cheapest of those that keep the accuracy: chosen on validation, and not said against test trials."""

from collections.abc import Callable, Collection, Sequence
from itertools import combinations
from typing import NamedTuple

from neurotact.metrics.paired import Paired
from neurotact.metrics.referee import LEVEL, Way, best_of, holm, level_with_best, within_error


class Savings(NamedTuple):
    """The cheapest of several ways to decide, as indices of them.

    best: the most accurate on validation trials. level: those that validation cannot tell from it. kept: those within
    its standard error that test trials do not show to be clearly less accurate than any other. cheapest: of these; None
    if there is none. contrary: ways that cost no more than the cheapest and are no less accurate on test trials, the
    most accurate first: with one, nothing is the cheapest.
    """

    best: int
    level: list[int]
    kept: list[int]
    cheapest: int | None
    contrary: list[int]

    @property
    def is_clear(self) -> bool:
        """Whether the cheapest may be called so: no other way speaks against it."""
        return self.cheapest is not None and not self.contrary


def worse_than_another(ways: Sequence[Way], compare: Callable[[int, int], Paired]) -> set[int]:
    """Of the ways within the error, those that test trials show to be clearly less accurate than any other way.

    compare: two ways, by their indices, the first minus the second. Holm's correction is for all these comparisons:
    of many ways that are equally accurate, chance sets some far apart.

    >>> ways = [Way(0.9, 0.02), Way(0.9, 0.02), Way(0.2, 0.02)]
    >>> worse_than_another(ways, lambda one, other: Paired(0.1, 0.01 if (one, other) == (0, 1) else 0.04, 40))
    {1}
    """
    near = {*within_error(ways)}
    pairs = [pair for pair in combinations(range(len(ways)), 2) if near & {*pair}]
    found = [compare(*pair) for pair in pairs]
    clear = [p < LEVEL for p in holm([one.p for one in found])]
    losers = {pair[one.difference > 0] for pair, one, is_clear in zip(pairs, found, clear, strict=True) if is_clear}
    return losers & near


def savings(
    ways: Sequence[Way],
    tested: Sequence[float],
    worse: Collection[int] = (),
    among: Collection[int] | None = None,
) -> Savings:
    """The cheapest of the ways that keep the accuracy, at least one way. No cost decides what keeps it.

    tested: the accuracy of each way on test trials. worse: the ways of which these show that they are clearly less
    accurate than another. among: the ways that may be the cheapest; any if None.

    >>> ways = [Way(0.9, 0.02, 10.0), Way(0.89, 0.02, 4.0), Way(0.7, 0.02, 1.0)]
    >>> savings(ways, [0.9, 0.9, 0.6]).cheapest
    1
    >>> savings(ways, [0.9, 0.8, 0.8]).contrary
    [2]
    """
    kept = [index for index in within_error(ways) if index not in worse and (among is None or index in among)]
    cheapest = min(kept, key=lambda index: (ways[index].cost, -ways[index].validation), default=None)
    contrary = []
    if cheapest is not None:
        contrary = [
            index
            for index in (range(len(ways)) if among is None else among)
            if ways[index].cost <= ways[cheapest].cost
            and tested[index] >= tested[cheapest]
            and (ways[index].cost, -tested[index]) != (ways[cheapest].cost, -tested[cheapest])
        ]
    contrary.sort(key=lambda index: (-tested[index], ways[index].cost))
    return Savings(best_of(ways), level_with_best(ways), kept, cheapest, contrary)
