"""Numbers of an answer as a report writes them."""

import math
from decimal import Decimal
from typing import Any, NamedTuple

import pandas as pd

from neurotact.metrics.paired import p_in_words
from neurotact.metrics.referee import Verdict

UNITS = ((1e9, "J"), (1e6, "mJ"), (1e3, "µJ"))
"""Of an energy, in nJ, from the largest; below the last it is in nJ, and in pJ where it has two zeros there."""
SMALL_nJ = 0.00995


class Measure(NamedTuple):
    """What an answer is told in: the heads of the columns of its score and of its cost.

    A score whose head ends in (%) is a share, which is written in percent.
    """

    score: str = "test accuracy (%)"
    cost: str = ""

    @property
    def what(self) -> str:
        """The score in words, without its unit."""
        return self.score.removesuffix("(%)").strip()

    def of(self, value: float) -> str:
        """A value of the score."""
        return percent(value) if scale(self.score) > 1 else f"{value:.4g}"

    def points(self, difference: float) -> str:
        """A difference of two scores, or an error."""
        return f"{100 * difference:.1f} points" if scale(self.score) > 1 else f"{difference:.3g}"

    def with_error(self, value: float, error: float) -> str:
        """A value of the score with its standard error, where that is known."""
        if math.isnan(error):
            return self.of(value)
        factor = scale(self.score)
        return f"{factor * value:.1f} ± {factor * error:.1f}{' %' if factor > 1 else ''}"

    def spent(self, value: float) -> str:
        """A cost with its head, whose unit comes first.

        >>> heads = "FLOPs", "FLOPs (paper's count)", "energy (nJ)"
        >>> [Measure(cost=head).spent(635.0) for head in heads]
        ['635 FLOPs', "635 FLOPs (paper's count)", '635 nJ (energy)']
        """
        if math.isnan(value):
            return "a cost that is not counted"
        what, _, unit = self.cost.removesuffix(")").partition(" (")
        return f"{count(value)} {unit} ({what})" if unit and " " not in unit else f"{count(value)} {self.cost}"


def scale(head: str) -> float:
    """By what a measure is multiplied to be read: a head that ends in (%) asks for percent."""
    return 100.0 if head.endswith("(%)") else 1.0


def spread(head: str, mean: Any, sd: Any = None) -> str:
    """A mean and its standard deviation in a column of a table, which is a dash where there is none.

    >>> spread("accuracy (%)", 0.912, 0.031), spread("SOPs", 4031.7, 12.0), spread("N", 7.0), spread("ms", 403.17)
    ('91.2 ± 3.1', '4,032 ± 12', '7', '403.17')
    """
    if mean is None or pd.isna(mean):
        return "-"
    factor = scale(head)
    value, deviation = factor * float(mean), 0.0 if sd is None or pd.isna(sd) else factor * float(sd)
    digits = 1 if factor > 1 else 0 if abs(value) >= 1000 else 2 if abs(value) >= 1 else 4
    text = f"{value:,.0f}" if value == round(value) and factor == 1 else f"{value:,.{digits}f}"
    return f"{text} ± {deviation:,.{digits}f}" if deviation else text


def chance_of(verdict: Verdict) -> str:
    """The p-value of a verdict, in words.

    >>> chance_of(Verdict("better", 0, 0.0002, 45, 1)), chance_of(Verdict("tie", 2, 0.312, 45, 6))
    ('45 test trials, p < 0.001', '45 test trials, p = 0.3 after correction for 6 comparisons')
    """
    return f"{verdict.n} test trials, {p_of(verdict)}"


def p_of(verdict: Verdict) -> str:
    """The p-value alone, and for how many comparisons it is corrected."""
    p = p_in_words(verdict.p)
    return p if verdict.opponents == 1 else f"{p} after correction for {verdict.opponents} comparisons"


def percent(share: float) -> str:
    """
    >>> percent(0.9333)
    '93.3 %'
    """
    return f"{100 * share:.1f} %"


def count(value: float, digits: int = 3) -> str:
    """A number of operations, or another: so many digits, with commas and without an exponent.

    >>> count(41234.0), count(7.26), count(1.234e7), count(0.0714, 2)
    ('41,200', '7.26', '12,300,000', '0.071')
    """
    return "not counted" if math.isnan(value) else f"{Decimal(f'{value:.{digits}g}'):,f}"


def milliseconds(value: float) -> str:
    """
    >>> milliseconds(420.4), milliseconds(0.25), milliseconds(1055.2)
    ('420 ms', '0.25 ms', '1,055 ms')
    """
    return f"{round(value):,} ms" if value >= 100 else f"{count(value)} ms"


def energy(nJ: float) -> str:
    """
    >>> energy(0.812), energy(999.8), energy(12345.0), energy(1.2e6), energy(0.0042)
    ('0.812 nJ', '1 µJ', '12.3 µJ', '1.2 mJ', '4.2 pJ')
    """
    size, unit = next((pair for pair in UNITS if nJ >= 0.9995 * pair[0]), (1.0, "nJ"))
    if 0 < nJ < SMALL_nJ:
        size, unit = 1e-3, "pJ"
    return count(nJ) if math.isnan(nJ) else f"{count(nJ / size)} {unit}"
