"""None of these: a decision is refused where the leading class leads by too little.

The least lead is chosen on validation windows. Of new known touches at most the stated share is refused on average,
whatever the leads are (split conformal prediction: Vovk, Gammerman and Shafer 2005, Algorithmic Learning in a Random
World). What one validation side chooses refuses a share that has a beta distribution (Vovk 2012, ACML 25:475).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import beta
from torch import Tensor

from neurotact.networks.exit.rule import leads


class Refusal(NamedTuple):
    """The least leads of a network, chosen on validation windows.

    share: of known touches that may be refused. whole, early: the least lead of whole windows, and with early exit.
    trials: of validation.
    """

    share: float
    whole: float
    early: float
    trials: int

    @classmethod
    def of(cls, share: float, whole: Tensor, early: Tensor, trials: int) -> "Refusal":
        """By the readouts of validation windows at their decisions, `(window, class)`; of few trials nothing."""
        known = (leads(readout).numpy() if _rank(share, trials) else np.empty(0) for readout in (whole, early))
        least = [least_lead(each, share) for each in known]
        return cls(share, least[0], least[1], trials)

    @property
    def interval(self) -> tuple[float, float]:
        """Where the share of new known touches that is refused lies, 95 %, by trials; less if leads are tied."""
        n = _rank(self.share, self.trials)
        low, high = beta.ppf((0.025, 0.975), n, self.trials + 1 - n) if n else (0.0, 0.0)
        return float(low), float(high)

    @property
    def in_words(self) -> str:
        """What is refused.

        >>> print(Refusal(0.05, 2.0, 1.0, 99).in_words)
        the smallest leads, of 5 % of known touches, are refused: of new ones 1.7 to 10 % (95 %, 99 validation trials)
        >>> print(Refusal(0.05, 0.0, 0.0, 18).in_words)
        nothing is refused: 5 % of known touches need 19 validation trials, not 18; refuse more, or record more
        """
        share = f"{100 * self.share:.3g} % of known touches"
        if not _rank(self.share, self.trials):
            need = f"{share} need {math.ceil(1 / self.share - 1 - 1e-9)} validation trials, not {self.trials}"
            return f"nothing is refused: {need}; refuse more, or record more"
        if not self.whole:
            return f"nothing is refused: {share} have no lead; train longer, or with another readout than counts"
        low, high = (100 * end for end in self.interval)
        known = f"{low:.2g} to {high:.2g} % (95 %, {self.trials} validation trials)"
        return f"the smallest leads, of {share}, are refused: of new ones {known}"


def least_lead(known: np.ndarray, share: float) -> float:
    """The lead below which at most this share of further windows like those `known` is on average; 0 refuses none.

    It is just below one of these leads, so that rounding decides nothing.

    >>> [round(least_lead(np.arange(1.0, 20.0), share), 6) for share in (0.04, 0.05, 0.1)]
    [0.0, 1.0, 2.0]
    """
    n = _rank(share, len(known))
    return (1 - 1e-9) * float(np.sort(known)[n - 1]) if n else 0.0


def _rank(share: float, n: int) -> int:
    """Of n known leads in order, the number of the one below which a share of others is."""
    return int(share * (n + 1) + 1e-9)
