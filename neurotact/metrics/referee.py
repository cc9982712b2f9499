"""The referee: which of several ways to decide is best, which is the cheapest at the same accuracy, what may be said.

Everything that names a best network, baseline or exit asks these functions. Choices use validation trials alone; a
claim is judged on test trials against every opponent that validation cannot tell from the best one.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from scipy.stats import fisher_exact

from neurotact.errors import InputError
from neurotact.metrics.decision import is_within
from neurotact.metrics.paired import LEVEL, Paired, compare_by_trial, sign_test
from neurotact.metrics.shares import standard_error

GAP = 0.01
"""The probability below which an accuracy on test trials is clearly not that of validation trials."""
ROUNDING = 1e-9
"""Differences of accuracies that are smaller are those of their last bits."""
Kind = Literal["better", "worse", "tie"]


class Way(NamedTuple):
    """What the referee knows of one way to decide.

    validation: its accuracy on validation trials. error: one standard error of it; NaN if unknown. cost: of a decision;
    infinite or NaN if it is not counted. right: by validation trial, the share of its windows that are decided
    correctly; None if unknown.
    """

    validation: float
    error: float = 0.0
    cost: float = math.inf
    right: Mapping[Any, float] | None = None


class Verdict(NamedTuple):
    """The result of a comparison with several opponents on test trials.

    kind: better than all of them, worse than one of them, or neither (tie). decisive: the index of the opponent that
    decides: the closest one if better, the clearest one if worse, otherwise the most accurate one. p: of the comparison
    with it, after Holm's correction for `opponents` comparisons. n: its test trials.
    """

    kind: Kind
    decisive: int
    p: float
    n: int
    opponents: int


def best_of(ways: Sequence[Way]) -> int:
    """The index of the highest accuracy on validation trials; of equal ones, the cheapest, then the first.

    >>> best_of([Way(0.9, cost=5.0), Way(0.9, cost=3.0), Way(0.8, cost=1.0)])
    1
    """
    return max(range(len(ways)), key=lambda index: (_rounded(ways[index].validation), -_cost(ways[index])))


def within_error(ways: Sequence[Way]) -> list[int]:
    """The indices of all ways within one standard error of the best; if that is unknown, of those as accurate as it.

    >>> within_error([Way(0.9, 0.03), Way(0.87), Way(0.8)])
    [0, 1]
    """
    at = best_of(ways)
    best, error = ways[at].validation, 0.0 if math.isnan(ways[at].error) else ways[at].error
    return [index for index, way in enumerate(ways) if index == at or is_within(way.validation, best, error)]


def cheapest_of(ways: Sequence[Way]) -> int:
    """The index of the cheapest way among those `within_error`; of equal ones, the more accurate.

    >>> cheapest_of([Way(0.9, 0.03, 5.0), Way(0.88, 0.03, 3.0), Way(0.8, 0.03, 1.0)])
    1
    """
    return min(within_error(ways), key=lambda index: (_cost(ways[index]), -ways[index].validation))


def may_be_cheapest(ways: Sequence[Way], n_trials: int, noise: Sequence[float]) -> list[int]:
    """The indices that `cheapest_of` could give with a thousandth of the trials left out, at least one, or other noise.

    n_trials: independent validation trials. noise: of each way, one standard error of its accuracy by other causes,
    such as the start of its weights. With one index, no thousandth of the trials decides: whatever is left out, another
    index alone is never found.

    >>> ways = [Way(1.0, 0.014, 5.0), Way(0.99, 0.017, 3.0), Way(0.96, 0.02, 1.0)]
    >>> may_be_cheapest(ways, 97, [0.001] * 3), may_be_cheapest(ways, 97, [0.01] * 3)
    ([1], [0, 1])
    """
    at, first = range(len(ways)), best_of(ways)
    out = max(1, math.ceil(n_trials / 1000))
    kept = max(1, n_trials - out)
    shares = [_rounded(max(0.0, way.validation)) for way in ways]
    # Trials that are left out were all right, or all wrong.
    low = [max(0.0, (n_trials * share - out) / kept) for share in shares]
    high = [min(1.0, n_trials * share / kept) for share in shares]
    errors = [_errors(ways[i], shares[i], (low[i], high[i]), n_trials, kept) for i in at]
    may_lead = [i for i in at if high[i] >= max(low)]
    most = max(errors[i][1] for i in may_lead)

    def apart(one: int) -> float:
        return math.hypot(noise[one], noise[first])

    def may_keep(one: int) -> bool:
        by_trials = all(low[best] - high[one] <= most + ROUNDING for best in at)
        return by_trials or shares[first] - shares[one] <= errors[first][1] + apart(one) + ROUNDING

    def surely_keeps(one: int) -> bool:
        by_trials = all(best == one or high[best] - low[one] <= errors[best][0] + ROUNDING for best in may_lead)
        lost = shares[first] - shares[one]
        return by_trials and (lost <= ROUNDING or lost <= errors[first][0] - apart(one) + ROUNDING)

    sure = [i for i in at if surely_keeps(i)]
    return [i for i in at if may_keep(i) and not any(_cost(ways[other]) < _cost(ways[i]) for other in sure)]


def _errors(way: Way, share: float, ends: tuple[float, float], n_trials: int, kept: int) -> tuple[float, float]:
    """The least and the largest error of a way whose accuracy lies between `ends`, on `kept` of its trials."""
    error = 0.0 if math.isnan(way.error) else way.error
    every = [error * standard_error(end, kept) / standard_error(share, n_trials) for end in (share, *ends)]
    return min(every), max(every)


def level_with_best(ways: Sequence[Way]) -> list[int]:
    """The indices of all ways that validation cannot tell from the best one, which is among them.

    A paired test on common validation trials tells a way from the best if its p is below `LEVEL`. Without single trials
    the accuracies must differ by more than two standard errors of their difference. A way within one standard error of
    the best is never told apart. An error that is not known (NaN) tells nothing: then a way with another accuracy is
    not said to be level.

    >>> level_with_best([Way(0.95, 0.03), Way(0.9, 0.04), Way(0.5, 0.07)])
    [0, 1]
    >>> level_with_best([Way(0.9, math.nan), Way(0.8, math.nan)])
    [0]
    """
    best, near = ways[best_of(ways)], {*within_error(ways)}
    return [index for index, way in enumerate(ways) if index in near or _is_level(best, way)]


def _is_level(best: Way, other: Way) -> bool:
    if best.right and other.right and best.right.keys() & other.right.keys():
        return compare_by_trial(best.right, other.right).p >= LEVEL
    return best.validation - other.validation <= 2 * math.hypot(best.error, other.error)


def holm(p: Sequence[float]) -> list[float]:
    """The p-values of several comparisons after Holm's correction (1979, Scandinavian Journal of Statistics 6:65).

    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    corrected, largest = [0.0] * len(p), 0.0
    for rank, index in enumerate(sorted(range(len(p)), key=lambda index: p[index])):
        largest = max(largest, min(1.0, (len(p) - rank) * p[index]))
        corrected[index] = largest
    return corrected


def judge(comparisons: Sequence[Paired]) -> Verdict:
    """Compare a way with each of its opponents, at least one; each comparison is the way minus the opponent.

    Better: clearly more accurate than every opponent. Worse: clearly less accurate than at least one. If there is no
    difference at all, either is said in at most 5 % of the cases.

    >>> judge([Paired(0.1, 0.01, 40), Paired(0.05, 0.3, 40)]).kind, judge([Paired(-0.1, 0.02, 40)]).kind
    ('tie', 'worse')
    """
    corrected = holm([comparison.p for comparison in comparisons])
    indices = range(len(comparisons))

    def verdict(kind: Kind, decisive: int) -> Verdict:
        return Verdict(kind, decisive, corrected[decisive], comparisons[decisive].n, len(comparisons))

    lost = [index for index in indices if comparisons[index].difference < 0 and corrected[index] < LEVEL]
    if lost:
        return verdict("worse", min(lost, key=lambda index: (corrected[index], comparisons[index].difference)))
    if all(comparisons[index].difference > 0 and corrected[index] < LEVEL for index in indices):
        return verdict("better", max(indices, key=lambda index: (corrected[index], -comparisons[index].difference)))
    return verdict("tie", min(indices, key=lambda index: comparisons[index].difference))


def least_difference(n_trials: int, opponents: int = 1, discordance: float | None = None) -> float:
    """The least difference of two accuracies, as a share, that `judge` can find clear on so many test trials.

    opponents: comparisons of Holm's correction. discordance: the share of trials on which exactly one of both is right;
    without it the least difference of all, where every trial that differs favors the same one. Infinite if no
    difference can be clear. It is that of McNemar's exact test of trials that are right or wrong as a whole. Raises
    InputError for no opponent, for a negative number of trials, and for a discordance outside 0 to 1.

    >>> round(least_difference(9), 2), least_difference(5), round(least_difference(90, opponents=3), 2)
    (0.67, inf, 0.08)
    >>> least_difference(100, discordance=0.2)
    0.1
    """
    if n_trials < 0 or opponents < 1 or not 0 <= (discordance or 0.0) <= 1:
        given = f"got {n_trials}, {opponents} and {discordance}"
        raise InputError(f"n_trials, opponents, discordance: give 0 or more, 1 or more, and a share; {given}")
    if discordance is None:
        ways = ((n, 0) for n in range(n_trials + 1))
    else:
        apart = round(discordance * n_trials)
        ways = ((apart - n_worse, n_worse) for n_worse in range(apart // 2, -1, -1))
    clear = (better - worse for better, worse in ways if opponents * sign_test(better, worse) < LEVEL)
    return next((surplus / n_trials for surplus in clear), math.inf)


def is_gap(validation: float, n_validation: int, test: float, n_test: int, level: float = GAP) -> bool:
    """Whether an accuracy is clearly lower on test trials than on validation trials (Fisher's exact test, p < level).

    >>> is_gap(1.0, 45, 0.43, 180), is_gap(0.95, 20, 0.9, 40)
    (True, False)
    """
    if test >= validation or min(n_validation, n_test) < 1:
        return False
    right = [round(validation * n_validation), round(test * n_test)]
    table = [[right[0], n_validation - right[0]], [right[1], n_test - right[1]]]
    return float(fisher_exact(table, alternative="greater").pvalue) < level  # pyright: ignore[reportAttributeAccessIssue]


def _cost(way: Way) -> float:
    """What is not counted is never the cheapest."""
    return math.inf if math.isnan(way.cost) else way.cost


def _rounded(share: float) -> float:
    """Means over seeds in another order differ in their last bits, which must not decide."""
    return -math.inf if math.isnan(share) else round(share, 12)
