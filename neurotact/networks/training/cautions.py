"""Cautions about a training or its test: one line each, with the fix."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd

from neurotact.data.splits import SplitSpec
from neurotact.errors import number_of
from neurotact.networks.definition.specs import BEST_MEMBERS, MOST_HIDDEN, RSNNSpec, TrainingSpec
from neurotact.networks.exit.patience import ExitChoice
from neurotact.networks.training.comparison import Comparison, percent
from neurotact.networks.training.epochs import NOT_KEPT

Command = Literal["train", "tune", "fine-tune"]
"""The command that an outcome is of: a remedy names only options that it has."""
MEMBER = "member"
"""Column of a training log: which of the networks that were trained an epoch is of (`epochs.Epoch`)."""
FEW_PER_CLASS = 5
"""With fewer test trials, the accuracy of a class says little."""


def not_learned(
    accuracy: float, low: float, guess: float, command: Command = "train", told: Callable[[float], str] = percent
) -> Iterator[str]:
    """low: lower end of the accuracy's interval. guess: the accuracy of guessing. told: as of `comparison.lines`.

    >>> list(not_learned(0.9, 0.8, 0.5))
    []
    """
    if low <= guess:
        yield (
            f"{'an accuracy' if told is percent else 'a value'} of {told(accuracy)} is not clearly above chance "
            f"({told(guess)}); "
            f"{_again(command) or 'give'} more trials, a longer window (`length_ms`), or an encoder for this sensor "
            "(`nt.calibrate`)"
        )


def worse_than_baseline(
    comparison: Comparison,
    spec: RSNNSpec,
    command: Command = "train",
    searched: Collection[str] = (),
    members: int = 1,
    told: Callable[[float], str] = percent,
) -> Iterator[str]:
    """Whether a classifier on the same spikes is clearly better than the network of this spec.

    searched: keys of the network that a search has chosen. members: how many networks were joined into it. told: as of
    `comparison.lines`.
    """
    if comparison.verdict == "worse":
        is_rsnn = spec.own is None
        is_larger_possible = is_rsnn and spec.hidden <= MOST_HIDDEN // 2 and "hidden" not in searched
        larger = 2 * spec.hidden // members or 50
        can_join = spec.readout == "integrator" and not spec.learn and 0 < BEST_MEMBERS * spec.hidden <= MOST_HIDDEN
        joins = command == "train" and members == 1 and spec.input_deviation is not None and can_join
        last = {"train": "`nt.tune`", "tune": "more trials (`trials`)", "fine-tune": "`nt.tune`"}[command]
        if told is not percent:  # which no search takes
            last = "a longer window (`length_ms`)"
        remedies = [
            *(["`network='default'`"] if is_rsnn and spec.input_deviation is None else []),
            *([f"more hidden neurons (`settings={{'hidden': {larger}}}`)"] if is_larger_possible else []),
            *([f"{BEST_MEMBERS} networks joined (`settings={{'effort': 'best'}}`)"] if joins else []),
            last,
        ]
        yield (
            f"{comparison.rival} of the same spikes is better, {told(comparison.rival_accuracy)} "
            f"against {told(comparison.accuracy)}; {_again(command) or 'try'} {' or '.join(remedies)}"
        )


def copies(n_copies: int, n_trials: int) -> Iterator[str]:
    """n_copies: trials that are copies of others, among `n_trials`.

    >>> print(*copies(1, 20))
    1 of 20 trials is a copy of another one (neurotact info); copies are on one side, and intervals count them once
    """
    if n_copies:
        what = "is a copy of another one" if n_copies == 1 else "are copies of others"
        yield (
            f"{n_copies} of {n_trials} trials {what} (neurotact info); copies are on one side, and intervals count "
            "them once"
        )


def calibrated(encoder: Mapping[str, Any], each: str) -> Iterator[str]:
    """Whether spikes that are tested in several turns come from one encoder that was calibrated.

    encoder: its table, as spikes have it. each: what has a turn, as an argument, such as "split=nt.Split(folds=5)".

    >>> list(calibrated({"conditioning": {"baseline": "start"}}, "split=nt.Split(folds=5)"))
    []
    >>> print(*calibrated({"conditioning": {"scale": [2.0]}}, "split=nt.Split(folds=5)"))
    the encoder was calibrated once for all tests: if on trials of this file, it knows trials that are tested; `nt.run_study(..., split=nt.Split(folds=5))` of own-recordings calibrates for each test without its trials
    """  # noqa: E501
    if (encoder.get("conditioning") or {}).get("scale") is not None:
        yield (
            "the encoder was calibrated once for all tests: if on trials of this file, it knows trials that are "
            f"tested; `nt.run_study(..., {each})` of own-recordings calibrates for each test without its trials"
        )


def _again(command: Command) -> str:
    """What changes a network that is only fine-tuned: its training. Empty for the others, whose options change it."""
    return "train the run again with" if command == "fine-tune" else ""


def few_test_trials(per_class: Mapping[str, int], split: SplitSpec | None, command: Command = "train") -> Iterator[str]:
    """per_class: test trials of each class. split: the one that chose them; None if another line says what to do next.

    >>> by_day = SplitSpec(order="day")
    >>> print(*few_test_trials({"felt": 3, "silk": 12}, by_day))
    class 'felt' has 3 test trials: one of them is 33.3 points of its accuracy, and 6.7 points of all 15; record more
    >>> print(*few_test_trials({"felt": 1, "silk": 9}, by_day))
    class 'felt' has 1 test trial: its accuracy is 0 or 100 %, and one trial is 10.0 points of all 10; record more
    >>> [words.rpartition("; ")[2] for words in few_test_trials({"felt": 1}, SplitSpec())]
    ['record more, or test every trial once with `split=nt.Split(folds=5)`']
    """
    few = {name: n for name, n in per_class.items() if n < FEW_PER_CLASS}
    total = sum(per_class.values())
    if not few or not total:
        return
    fewest = min(few, key=lambda name: few[name])
    n = few[fewest]
    own = {0: "one trial is", 1: "its accuracy is 0 or 100 %, and one trial is"}
    share = own.get(n, f"one of them is {100 / max(n, 1):.1f} points of its accuracy, and")
    all_of = f"{share} {100 / total:.1f} points of all {total}"
    trials = number_of(n, "test trial")
    others = (
        f"{len(few)} of {len(per_class)} classes have fewer than {FEW_PER_CLASS} test trials; " if len(few) > 1 else ""
    )
    remedy = "" if split is None else "; record more"
    if split is not None and not (split.test_where or split.order or split.folds):
        folds = "split=nt.Split(folds=5)"
        every_fold = f"`{folds}`" if command == "train" else f"`nt.train(..., {folds})`"
        remedy += f", or test every trial once with {every_fold}"
    yield f"{others}class '{fewest}' has {trials}: {all_of}{remedy}"


def exit_not_used(choice: ExitChoice | None) -> Iterator[str]:
    """choice: the rule of early exit and its losses on validation trials; None if it is given.

    >>> from neurotact.networks.exit.rule import ExitRule
    >>> print(*exit_not_used(ExitChoice(ExitRule(20), dict.fromkeys(range(20), 0.0), 0.01)))
    early exit is not used: it may lose up to 14 points, of which 1 is allowed (95 % bound from validation trials that did not choose it); record more trials, or accept a larger loss (`exit_tolerance`)
    """  # noqa: E501
    if choice is not None and choice.is_refused:
        yield (
            f"early exit is not used: {choice.in_words}; record more trials, or accept a larger loss (`exit_tolerance`)"
        )


def training(log: pd.DataFrame, spec: TrainingSpec, keys: str = "", command: Command = "train") -> Iterator[str]:
    """Whether a training diverged, or stopped at its largest number of epochs.

    log: one row per epoch (`training.csv`), of several networks if they were trained. keys: what stands before
    `training.` where the spec is set.
    If the learning rates fall to 0, all epochs always run: no caution.

    >>> print(*training(pd.DataFrame({"epoch": [1, 2], "train_loss": [2.0, np.inf]}), TrainingSpec(), "network."))
    the loss became infinite; lower the learning rate (`settings={'network.training.learning_rate': 0.0005}`)
    """
    if MEMBER in log:
        kept = log[log[MEMBER] != NOT_KEPT]
        members = [own.drop(columns=MEMBER) for _, own in kept.groupby(MEMBER)]
        if len(members) > 1:
            yield from together([list(training(own, spec, keys, command)) for own in members])
            return
        (log,) = members
    losses = log["train_loss"].to_numpy(float)
    if not len(losses):
        return
    key, _, value = spec.lower_rate.partition("=")
    rate = f"learning rate (`settings={{'{keys}{key}': {value}}}`)"
    lower = f"{_again(command)} a lower {rate}" if _again(command) else f"lower the {rate}"
    if not np.isfinite(losses).all():
        yield f"the loss became infinite; {lower}"
    elif losses[-1] > max(losses[0], 2 * losses.min()):
        yield f"training diverged, from a loss of {losses.min():.3g} to {losses[-1]:.3g}; {lower}"
    elif spec.schedule == "constant" and len(losses) >= spec.epochs and log["epoch"].max() + 1 >= spec.epochs:
        yield f"training stopped after epoch {spec.epochs}, its last, before it converged; raise {keys}training.epochs"


def together(lists: Sequence[Sequence[str]]) -> list[str]:
    """Each caution of several networks once, with its number of networks, in the order of first occurrence.

    >>> together([["it diverged"], [], ["it diverged"]])
    ['2 of 3 networks: it diverged']
    """
    counts: dict[str, int] = {}
    for cautions in lists:
        for caution in cautions:
            counts[caution] = counts.get(caution, 0) + 1
    return [f"{n} of {len(lists)} networks: {caution}" for caution, n in counts.items()]
