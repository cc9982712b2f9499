"""How good a test accuracy is: its interval, chance, and a linear classifier on the same spikes."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from neurotact.metrics.linear import fit_linear
from neurotact.networks.trained import Sides
from neurotact.networks.training import Examples

Z_95 = 1.959963984540054
"""The 97.5 percentile of the normal distribution."""


class Comparison(NamedTuple):
    """A network's test accuracy beside what it should be measured against; all are shares of windows.

    low, high: the 95 % interval of `accuracy`, over `trials` test trials.
    chance: of guessing one of the classes, each as often.
    commonest: of always answering the class that is commonest in training.
    linear: of logistic regression on the spike counts of the same windows, trained on the same side.
    """

    accuracy: float
    low: float
    high: float
    trials: int
    chance: float
    commonest: float
    linear: float


def wilson_interval(share: float, n: int) -> tuple[float, float]:
    """The 95 % interval of a share of `n` independent trials (Wilson 1927, doi 10.1080/01621459.1927.10502953).

    >>> [round(end, 3) for end in wilson_interval(0.5, 10)]
    [0.237, 0.763]
    """
    middle = (share + Z_95**2 / (2 * n)) / (1 + Z_95**2 / n)
    half = Z_95 / (1 + Z_95**2 / n) * math.sqrt(share * (1 - share) / n + Z_95**2 / (4 * n**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def compare(accuracy: float, sides: Sides, n_trials: int, n_classes: int) -> Comparison:
    """Measure chance and the linear classifier on the windows on which `accuracy` was measured.

    n_trials: test trials: windows of one trial are not independent, so that the interval counts trials.
    """
    commonest = int(sides.train.labels.bincount().argmax())
    return Comparison(
        accuracy,
        *wilson_interval(accuracy, n_trials),
        n_trials,
        1 / n_classes,
        float((sides.test.labels == commonest).double().mean()),
        linear_accuracy(sides.train, sides.test),
    )


def linear_accuracy(training: Examples, test: Examples) -> float:
    """Test accuracy of logistic regression on each afferent's spikes per window, standardised on training windows."""
    model = fit_linear(_counts(training), training.labels.numpy())
    return float(model.score(_counts(test), test.labels.numpy()))


def lines(found: Comparison, sops: float) -> tuple[str, str]:
    """What `neurotact train` says at its end.

    sops: synaptic operations per window.
    """
    accuracy, low, high, chance, commonest, linear = (
        f"{100 * share:.1f} %"
        for share in (found.accuracy, found.low, found.high, found.chance, found.commonest, found.linear)
    )
    return (
        f"accuracy {accuracy} (95 % interval {low} to {high}, {found.trials} test trials), "
        f"{sops:.0f} synaptic operations per window",
        f"chance {chance}, always the commonest class {commonest}, logistic regression on spike counts {linear}",
    )


def complaints(found: Comparison) -> Iterator[str]:
    """Warnings of a network that has learned nothing, or clearly less than the linear classifier."""
    guess = max(found.chance, found.commonest)
    if found.low <= guess:
        yield (
            f"training: an accuracy of {100 * found.accuracy:.1f} % is not clearly above chance "
            f"({100 * guess:.1f} %); give more trials, a longer window (--window-ms), or an encoder for this sensor "
            "(neurotact calibrate)"
        )
    if found.linear > found.high:
        yield (
            f"training: logistic regression on the spike counts of the same windows is better, "
            f"{100 * found.linear:.1f} % against {100 * found.accuracy:.1f} %; try --network default, more hidden "
            "neurons (--set hidden=100) or neurotact tune"
        )


def _counts(examples: Examples) -> np.ndarray:
    return np.stack([window.sum(dim=0).numpy() for window in examples.spikes]).astype(float)
