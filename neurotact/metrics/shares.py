"""The confidence interval and the standard error of a share of independent trials."""

import math
from statistics import NormalDist

Z_95 = 1.959963984540054
"""The 97.5 percentile of the normal distribution."""


def wilson_interval(share: float, n: int, chosen_of: int = 1) -> tuple[float, float]:
    """The 95 % interval of a share of `n` independent trials (Wilson 1927, doi 10.1080/01621459.1927.10502953).

    chosen_of: of how many shares it is the most extreme; the interval is then wider (Bonferroni).

    >>> [round(end, 3) for end in wilson_interval(0.5, 10)]
    [0.237, 0.763]
    >>> [round(end, 3) for end in wilson_interval(0.5, 10, chosen_of=5)]
    [0.184, 0.816]
    """
    z = Z_95 if chosen_of == 1 else NormalDist().inv_cdf(1 - 0.025 / chosen_of)
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def standard_error(share: float, n: int) -> float:
    """Standard error of a share of `n` independent trials, with two correct and two wrong ones added.

    It is not zero if all trials are correct (Agresti and Coull 1998).

    >>> round(standard_error(1.0, 16), 4), round(standard_error(0.5, 96), 4)
    (0.0671, 0.05)
    """
    middle = (share * n + 2) / (n + 4)
    return math.sqrt(middle * (1 - middle) / (n + 4))
