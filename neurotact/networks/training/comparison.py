"""How good a test accuracy is: its interval, chance, and classifiers on the same spikes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.preprocessing import StandardScaler

from neurotact.baselines import opponent
from neurotact.baselines.features import counted
from neurotact.metrics import power, referee, starts
from neurotact.metrics.decision import otherwise
from neurotact.metrics.paired import by_trial, compare_by_trial
from neurotact.metrics.referee import Verdict, Way
from neurotact.metrics.shares import standard_error, wilson_interval
from neurotact.networks.training import numbers
from neurotact.networks.training.epochs import Examples
from neurotact.networks.training.tasks import Sides
from neurotact.progress import say

BINS = 10
"""Time bins of a window, in which spikes are counted."""


class Comparison(NamedTuple):
    """A network's test accuracy and what it is compared with; all accuracies are shares of windows.

    low, high: the 95 % interval of `accuracy`, over `trials` test trials: of this network, not of another start.
    chance: of guessing each class equally often.
    commonest: of always choosing the most frequent class of training.
    Of numbers, accuracies are mean scores (`opponent.right`), and the last two are that of the mean of training.
    baseline: the classifier on the same spikes with the highest accuracy on validation windows, and its test accuracy.
    verdict: whether the network is clearly better or worse than the classifiers that validation cannot tell from that
    one, or neither (`tie`), by the referee; rival: the one that decides, its test accuracy, and p after correction for
    so many opponents.
    """

    accuracy: float
    low: float
    high: float
    trials: int
    chance: float
    commonest: float
    baseline: str
    baseline_accuracy: float
    verdict: str
    rival: str
    rival_accuracy: float
    p: float
    opponents: int = 1


class Opponent(NamedTuple):
    """A classifier on the spikes of the same windows: its name, and by trial the share of windows it has right."""

    name: str
    validation: dict[int, float]
    test: dict[int, float]
    accuracy_validation: float
    accuracy_test: float


class Trials(NamedTuple):
    """The trial of each validation and of each test window, `(window,)`."""

    validation: np.ndarray
    test: np.ndarray


def compare(
    right: Sequence[float], sides: Sides, trials: Trials, n_classes: int, last: Sides | None = None
) -> Comparison:
    """Measure chance and classifiers on the windows of a network; right: whether it has each test window right.

    last: as of `opponents_of`. The interval counts trials, because windows of one trial are not independent.
    """
    accuracy, n_trials = float(np.mean(right)), len(np.unique(trials.test))
    opponents = list(opponents_of(sides, trials, last))
    is_number = sides.train.labels.ndim > 1
    ways = [Way(one.accuracy_validation, _error(one, is_number=is_number), right=one.validation) for one in opponents]
    best = opponents[referee.best_of(ways)]
    rivals = [opponents[index] for index in referee.level_with_best(ways)]
    own = by_trial(trials.test, right)
    verdict = referee.judge([compare_by_trial(own, rival.test) for rival in rivals])
    rival = rivals[verdict.decisive]
    low, high = numbers.interval(np.array(right), trials.test) if is_number else wilson_interval(accuracy, n_trials)
    return Comparison(
        accuracy,
        low,
        high,
        n_trials,
        *_guessed(sides, n_classes),
        best.name,
        best.accuracy_test,
        verdict.kind,
        rival.name,
        rival.accuracy_test,
        verdict.p,
        verdict.opponents,
    )


def _error(one: Opponent, *, is_number: bool) -> float:
    """One standard error of the accuracy of an opponent on validation trials, or of its mean score."""
    if not is_number:
        return standard_error(one.accuracy_validation, len(one.validation))
    scores = [*one.validation.values()]
    return float(np.std(scores, ddof=1) / len(scores) ** 0.5) if len(scores) > 1 else np.nan


def _guessed(sides: Sides, n_classes: int) -> tuple[float, float]:
    """The accuracies of guesses: of each class equally often, of the commonest; of numbers twice that of the mean."""
    known, test = sides.train.labels, sides.test
    if known.ndim > 1:
        mean = known.double().mean(dim=0).expand(len(test.labels), -1)
        score = float(opponent.right(mean, test.labels, test.deviation).mean())
        return score, score
    return 1 / n_classes, float((test.labels == int(known.bincount().argmax())).double().mean())


def opponents_of(sides: Sides, trials: Trials, last: Sides | None = None) -> Iterator[Opponent]:
    """Classifiers on each afferent's spikes, counted over the window and in time bins, sized on validation windows.

    last: the sides to which a classifier is fitted again after that, with the same test windows; None: it is not.
    """
    n_steps = sides.train.spikes.shape[1]
    for n_bins in sorted({1, min(BINS, n_steps)}):
        inputs = _inputs(sides, n_bins)
        again = None if last is None else _inputs(last, n_bins)
        tells = "classes" if inputs.y_train.ndim == 1 else "numbers"
        for name, one in opponent.joined("features", "quick", tells).items():
            n_train = len((inputs if again is None else again).y_train)
            if one.most_examples is not None and n_train > one.most_examples:
                say(f"baselines: no {name}: {n_train} training windows, at most {one.most_examples}")
                continue
            with opponent.named(name):
                best = opponent.best_of(one, inputs, 0)
            held = opponent.right(best.fitted.predict(inputs.validation), inputs.y_validation)
            used, of = (best, inputs) if again is None else (best.again(again), again)
            tested = opponent.right(used.fitted.predict(of.test), of.y_test)
            shares = by_trial(trials.validation, held), by_trial(trials.test, tested)
            source = "counts" if n_bins == 1 else f"{n_bins} time bins"
            yield Opponent(f"{name} on {source}", *shares, float(held.mean()), float(tested.mean()))


def _inputs(sides: Sides, n_bins: int) -> opponent.Sides:
    """Spikes of each afferent in time bins, standardised on the training side, as numbers are."""
    if scale := numbers.Scale.of(sides.train):
        sides = Sides(*map(scale.standard, sides))
    features = [_counts(side, n_bins) for side in sides]
    scaler = StandardScaler().fit(features[0])
    return opponent.Sides(*map(scaler.transform, features), *(side.labels.numpy() for side in sides))


def percent(share: float) -> str:
    """An accuracy in words."""
    return f"{100 * share:.1f} %"


def lines(against: Comparison, start: str = starts.ONE, told: Callable[[float], str] = percent) -> tuple[str, str]:
    """The accuracy, and what it is compared with, in words.

    start: what is said of the start of the weights. told: of an accuracy: `numbers.scored` of numbers.
    """
    accuracy, low, high, chance, commonest, baseline, rival = (
        told(share)
        for share in (
            against.accuracy, against.low, against.high, against.chance, against.commonest, against.baseline_accuracy,
            against.rival_accuracy,
        )
    )  # fmt: skip
    tie = Verdict("tie", 0, against.p, against.trials, against.opponents)
    verdict = {
        "better": "the network is clearly better",
        "worse": f"{against.rival} {rival} is clearly better than the network",
        "tie": power.in_words(tie) if told is percent and power.is_too_weak(tie) else "no clear difference",
    }[against.verdict]
    guesses, what = f"chance {chance}, always the commonest class {commonest}", "accuracy"
    if told is not percent:
        guesses, what = f"the mean of training {commonest}", "score (1 is perfect)"
    return (
        f"{what} {accuracy} (95 % interval {low} to {high}, {against.trials} test trials); {start}",
        f"baselines: {guesses}, best on the same spikes: {against.baseline} {baseline}; {verdict}",
    )


def costs(row: Mapping[str, Any], step_ms: float, told: Callable[[float], str] = percent) -> str:
    """The cost of a decision with and without early exit, in words, from a row of results.

    step_ms: a step of the encoder's clock. told: says an accuracy.

    >>> row = {"sops_total": 1200.0, "window_steps": 1000, "spikes_sa": 30.0, "spikes_ra": 12.0,
    ...        "exit_sops_total": 600.0, "exit_steps": 420.0, "exit_accuracy": 0.9}
    >>> print(costs(row, 1.0))
    a decision costs 1,200 SOPs, 42 input spikes and 1,000 ms; with early exit 600 SOPs and 420 ms, at 90.0 %
    """
    spikes = sum(value for key, value in row.items() if key.startswith("spikes_"))  # a column for each population
    sops, early = row["sops_total"], row["exit_sops_total"]
    counted = ["", "", "; SOPs are not counted"]
    if sops is not None and not np.isnan(sops):
        counted = [f"{sops:,.0f} SOPs, ", f"{early:,.0f} SOPs and ", ""]
    whole = f"a decision costs {counted[0]}{spikes:,.0f} input spikes and {row['window_steps'] * step_ms:,.4g} ms"
    if row.get("exit_patience", 1) is None:  # there is no early exit
        return f"{whole}{counted[2]}"
    return (
        f"{whole}; with early exit {counted[1]}"
        f"{row['exit_steps'] * step_ms:,.4g} ms, at {told(row['exit_accuracy'])}{counted[2]}"
    )


def recurrence(row: Mapping[str, Any]) -> list[str]:
    """What was tried beside the network that stays, what it gained on validation windows, and why it stopped, in words.

    Nothing where nothing else was tried.

    >>> print(*recurrence({"recurrence_gain": 0.005, "sops_recurrent": 0.0}))
    hidden neurons: without recurrence; with it, validation accuracy changes by +0.5 points, within the standard error; to choose otherwise, set model
    """  # noqa: E501
    lines = []
    if row.get("smallest_accuracy") is not None:
        lines = [f"{_from_the_smallest(row)}; {otherwise('hidden')}"]
    if (gain := row.get("recurrence_gain")) is None:
        return lines
    if row["sops_recurrent"] > 0:
        words = f"with recurrence; validation accuracy gains {100 * gain:.1f} points"
    else:
        words = f"without recurrence; with it, validation accuracy changes by {100 * gain:+.1f} points"
        words += ", within the standard error" if gain > 0 else ""
    return [*lines, f"hidden neurons: {words}; {otherwise('model')}"]


def _from_the_smallest(row: Mapping[str, Any]) -> str:
    """Which of the networks from the smallest up stays, and why no larger one, in words.

    >>> _from_the_smallest({"smallest_accuracy": 1.0, "sops_input": 0.0})
    'all validation windows are right without a hidden layer; nothing larger was tried'
    >>> _from_the_smallest({"smallest_accuracy": 0.9, "layer_gain": 0.005, "sops_input": 0.0})
    'no hidden layer: 90.0 % of the validation windows are right without one; with it +0.5 points, within the standard error'
    >>> _from_the_smallest({"smallest_accuracy": 0.9, "layer_gain": 0.1, "sops_input": 9.0})
    'a hidden layer: 90.0 % of the validation windows are right without it; with it +10.0 points, and all are right; no path past it was tried'
    """  # noqa: E501
    share, gain, path = row["smallest_accuracy"], row.get("layer_gain"), row.get("path_gain")
    if gain is None:
        return "all validation windows are right without a hidden layer; nothing larger was tried"
    without = f"{100 * share:.1f} % of the validation windows are right without"
    if not row["sops_input"] > 0:
        return f"no hidden layer: {without} one; with it {_points(gain)}"
    layer = f"{without} it; with it {100 * gain:+.1f} points"
    if path is None:
        return f"a hidden layer: {layer}, and all are right; no path past it was tried"
    if row.get("direct"):
        return f"a hidden layer and a path past it: {layer}; with the path {100 * path:+.1f} points more"
    return f"a hidden layer: {layer}; with a path past it {_points(path)}"


def _points(gain: float) -> str:
    """A gain that is too small, in points."""
    return f"{100 * gain:+.1f} points{', within the standard error' if gain > 0 else ''}"


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


def _counts(examples: Examples, n_bins: int) -> np.ndarray:
    """Spikes of each afferent in time bins, `(window, bin * afferent)`."""
    return counted(examples.spikes.numpy(), n_bins).reshape(len(examples.labels), -1).astype(float)
