"""A choice among candidates: the first whose merit is within an error of the best one's, and a note that says so.

Candidates stand in the order of preference: first what is there already, or what costs least. Another candidate must be
better by more than the error.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from neurotact.metrics.shares import standard_error

ROUNDING = 1e-9
"""Merits that differ by less are equal: means of several differ in their last bits, which must not decide."""

Candidate = TypeVar("Candidate")


def is_within(merit: Any, best: Any, error: float) -> Any:
    """Whether a merit is at most an error below the best: of numbers, or element by element of arrays; NaN never is.

    >>> is_within(0.85, 0.88, 0.03), is_within(0.84, 0.88, 0.03), is_within(math.nan, 0.88, 0.03)
    (True, False, False)
    """
    return merit >= best - error - ROUNDING


@dataclass(frozen=True)
class Decision(Generic[Candidate]):
    """What is chosen for a key of a spec.

    merits: of each candidate, in the order of preference; NaN of one that failed. error: how far below the best one
        is as good.

    >>> found = Decision.of_shares("conditioning.baseline", {"none": 0.85, "start": 0.7, "high-pass": 0.88}, n=100)
    >>> found.chosen
    'none'
    >>> print(found.note("accuracy"))
    conditioning.baseline = 'none' is chosen, the first within one standard error of the best; accuracy: 'none' 85 %, 'start' 70 %, 'high-pass' 88 %; to choose otherwise, set conditioning.baseline
    """  # noqa: E501

    key: str
    merits: Mapping[Candidate, float]
    error: float = 0.0

    @classmethod
    def of_shares(cls, key: str, shares: Mapping[Candidate, float], n: int) -> "Decision[Candidate]":
        """By shares of `n` independent trials, with the standard error of the highest."""
        return cls(key, shares, standard_error(_highest(shares), n))

    @property
    def chosen(self) -> Candidate:
        """The first within the error of the best; the first of all if no merit is known."""
        best = _highest(self.merits)
        good = [one for one, merit in self.merits.items() if is_within(merit, best, self.error)]
        return (good or [*self.merits])[0]

    def note(self, measured: str, effect: str = "", override: str = "") -> str:
        """The choice in a sentence.

        measured: what the merits are. effect: of the choice. override: what to set for another one; absent: the key.
        """
        how = "is left out" if self.chosen is None else f"= {_shown(self.chosen)} is chosen"
        return (
            f"{self.key} {how}, the first within one standard error of the best{effect and ': '}{effect}; "
            f"{self.compared(measured)}; {otherwise(override or self.key)}"
        )

    def compared(self, measured: str) -> str:
        """The merit of each candidate, in words; the unit of a number is that of the key."""
        unit = f" {self.key.rpartition('_')[2]}"
        of_each = (
            f"{_shown(one)}{unit if isinstance(one, float) else ''} "
            f"{'failed' if math.isnan(merit) else f'{100 * merit:.0f} %'}"
            for one, merit in self.merits.items()
        )
        return f"{measured}: {', '.join(of_each)}"


def otherwise(override: str) -> str:
    """What to set for another choice, as every note on a choice says it."""
    return f"to choose otherwise, set {override}"


def _highest(merits: Mapping[Any, float]) -> float:
    return max((merit for merit in merits.values() if not math.isnan(merit)), default=math.nan)


def _shown(value: Any) -> str:
    """A value of a key.

    >>> _shown(True), _shown(30.0), _shown((0.5, 1.0)), _shown(None)
    ('true', '30', '[0.5, 1]', 'none')
    """
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else repr(value)
