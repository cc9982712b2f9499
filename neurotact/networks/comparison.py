"""How good a test accuracy is: its interval, chance, and a linear classifier on the same spikes."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from neurotact.metrics.linear import fit_linear
from neurotact.metrics.shares import wilson_interval
from neurotact.networks.tasks import Sides
from neurotact.networks.training import Examples


class Comparison(NamedTuple):
    """A network's test accuracy and what it is compared with; all are shares of windows.

    low, high: the 95 % interval of `accuracy`, over `trials` test trials.
    chance: of guessing each class equally often.
    commonest: of always choosing the most frequent class of training.
    linear: of logistic regression on the spike counts of the same windows, trained on the same training windows.
    """

    accuracy: float
    low: float
    high: float
    trials: int
    chance: float
    commonest: float
    linear: float


def compare(accuracy: float, sides: Sides, n_trials: int, n_classes: int) -> Comparison:
    """Measure chance and the linear classifier on the windows on which `accuracy` was measured.

    n_trials: test trials; the interval counts trials, because windows of one trial are not independent.
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


def lines(found: Comparison) -> tuple[str, str]:
    """The accuracy, and what it is compared with, in words."""
    accuracy, low, high, chance, commonest, linear = (
        f"{100 * share:.1f} %"
        for share in (found.accuracy, found.low, found.high, found.chance, found.commonest, found.linear)
    )
    return (
        f"accuracy {accuracy} (95 % interval {low} to {high}, {found.trials} test trials)",
        f"baselines: chance {chance}, always the commonest class {commonest}, logistic regression on counts {linear}",
    )


def costs(row: Mapping[str, Any], step_ms: float) -> str:
    """The cost of a decision with and without early exit, in words, from a row of results.

    step_ms: a step of the encoder's clock.

    >>> row = {"sops_total": 1200.0, "window_steps": 1000, "spikes_sa": 30.0, "spikes_ra": 12.0,
    ...        "exit_sops_total": 600.0, "exit_steps": 420.0, "exit_accuracy": 0.9}
    >>> print(costs(row, 1.0))
    a decision costs 1,200 SOPs, 42 input spikes and 1,000 ms; with early exit 600 SOPs and 420 ms, at 90.0 %
    """
    spikes = sum(value for key, value in row.items() if key.startswith("spikes_"))  # a column for each population
    return (
        f"a decision costs {row['sops_total']:,.0f} SOPs, {spikes:,.0f} input spikes and "
        f"{row['window_steps'] * step_ms:,.4g} ms; with early exit {row['exit_sops_total']:,.0f} SOPs and "
        f"{row['exit_steps'] * step_ms:,.4g} ms, at {100 * row['exit_accuracy']:.1f} %"
    )


def confused(matrix: Sequence[Sequence[int]], classes: Sequence[str], most: int = 3) -> str:
    """The pairs of classes that are mistaken most often, in words.

    matrix: windows by true and chosen class.

    >>> print(confused([[8, 2], [0, 9]], ["felt", "silk"]))
    most confused: felt for silk (2 of 10)
    """
    counts = np.array(matrix)
    wrong = [(int(counts[i, j]), i, j) for i, j in np.argwhere(counts) if i != j]
    if not wrong:
        return "no test window is mistaken"
    worst = sorted(wrong, key=lambda one: (-one[0], one[1], one[2]))[:most]
    return "most confused: " + ", ".join(
        f"{classes[i]} for {classes[j]} ({n} of {counts[i].sum()})" for n, i, j in worst
    )


def _counts(examples: Examples) -> np.ndarray:
    return np.stack([window.sum(dim=0).numpy() for window in examples.spikes]).astype(float)
