"""FLOPs as the papers count them, for comparison with the ledger of `neurotact.metrics.flops`.

Stiffness paper, Tables I and II: n samples per peak and channel, N hidden neurons, nf features, nc classes. The touch
modality paper prints three numbers and no formula (its Table I); `touch_modality_flops` is a formula that yields them.
"""

from typing import Literal

from neurotact.errors import InputError, nearest

SLFN = Literal["S-ELM", "R-ELM", "H-ELM", "S-FC", "R-FC"]
FeatureSet = Literal["4F", "8F", "16F"]

MOMENTS_OF = {"4F": 1, "8F": 2, "16F": 4}
"""Moments per channel in a feature set: mean; mean and STD; and with skewness and kurtosis (four channels)."""
CHANNELS = 4

TOUCH_MODALITY_FLOPS = {("LSTM", 10): 2950, ("GRU", 10): 2228, ("GRU", 12): 2960}
"""FLOPs per block as printed, by cell and neurons, for 16 taxels and 3 classes (touch modality paper, Table I)."""


def moving_average_flops(n: int) -> int:
    """Two-sample moving average of n samples: 3n (stiffness paper, Sec. III-B)."""
    return 3 * n


def mean_flops(n: int) -> int:
    """Mean of n samples: n + 1 (stiffness paper, Table I)."""
    return n + 1


def std_flops(n: int) -> int:
    """Standard deviation for a known mean: 3n + 5 (stiffness paper, Table I)."""
    return 3 * n + 5


def skewness_flops(n: int) -> int:
    """Skewness for known mean and STD: 2n + 7 (stiffness paper, Table I)."""
    return 2 * n + 7


def kurtosis_flops(n: int) -> int:
    """Kurtosis for known mean and STD: 2n + 5 (stiffness paper, Table I)."""
    return 2 * n + 5


def preprocessing_flops(features: FeatureSet, n: int = 150, channels: int = CHANNELS) -> int:
    """The moving average and the moments of one grasp peak: the part of Table III before the classifier.

    >>> [preprocessing_flops(features) for features in ("4F", "8F", "16F")]
    [2404, 4224, 6672]
    """
    if features not in MOMENTS_OF:
        raise InputError(f"features: there is no set '{features}'; {nearest(str(features), list(MOMENTS_OF))}")
    moments = (mean_flops, std_flops, skewness_flops, kurtosis_flops)[: MOMENTS_OF[features]]
    return channels * (moving_average_flops(n) + sum(moment(n) for moment in moments))


def slfn_flops(classifier: SLFN, N: float, nf: int, nc: int) -> float:
    """One decision of a single-layer network (stiffness paper, Table II).

    N: hidden neurons (a mean for several networks); nf: features; nc: classes, 1 for regression.

    >>> slfn_flops("R-FC", N=51, nf=8, nc=3), slfn_flops("H-ELM", N=100, nf=16, nc=3)
    (1224, 3600)
    """
    if classifier == "H-ELM":
        return N * (2 * nf + 1) + nc * N
    activation = {"S-ELM": 14, "S-FC": 14, "R-ELM": 2, "R-FC": 2}.get(classifier)
    if activation is None:
        known = ["S-ELM", "R-ELM", "H-ELM", "S-FC", "R-FC"]
        raise InputError(f"classifier: '{classifier}' is not in Table II; {nearest(str(classifier), known)}")
    return N * (2 * nf + activation) + 2 * nc * N


def slfn_unit_flops(
    classifier: SLFN, features: FeatureSet, N: float, nc: int = 3, n: int = 150, channels: int = CHANNELS
) -> float:
    """The whole processing unit, from the peak to the class (stiffness paper, Table III).

    >>> slfn_unit_flops("R-FC", "8F", N=51)
    5448
    """
    before = preprocessing_flops(features, n, channels)
    nf = channels * MOMENTS_OF[features]
    return before + slfn_flops(classifier, N, nf, nc)


def touch_modality_flops(cell: Literal["LSTM", "GRU"], units: int, inputs: int = 16, classes: int = 3) -> int:
    """A formula that yields the three published FLOPs per block exactly; inferred, the paper states none.

    `g (4 units² + 2 inputs units + 2) + 2 classes units + 2` with g = 4 gates (LSTM) or 3 (GRU). Four operations for a
    recurrent weight and none for the cell's own products and activations are not a count of an inference; they agree
    with a count of how Keras *draws* the weights (orthogonal 4, uniform 2 per weight), which the paper does not
    mention. Use it only for comparison with published values; the ledger's `LSTM` and `GRU` give the cost of a step.

    >>> [touch_modality_flops(cell, units) for cell, units in TOUCH_MODALITY_FLOPS]
    [2950, 2228, 2960]
    """
    gates = {"LSTM": 4, "GRU": 3}.get(cell)
    if gates is None:
        raise InputError(f"cell: must be LSTM or GRU; got '{cell}'")
    return gates * (4 * units**2 + 2 * inputs * units + 2) + 2 * classes * units + 2
