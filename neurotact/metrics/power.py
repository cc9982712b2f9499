"""When the test trials cannot show a difference: that is then said, and not that there is none."""

import math

from neurotact.metrics.referee import Verdict, least_difference
from neurotact.metrics.shares import wilson_interval

WEAK = 0.1
"""A test that shows no smaller difference of accuracies than this says too little for a verdict: of one opponent, that
of fewer than 60 test trials; of six, of fewer than 80."""


def _least_shown(verdict: Verdict, least: float | None) -> float:
    """The least difference that the test of a verdict can show: that of so many trials, if it is not given."""
    return least_difference(verdict.n, verdict.opponents) if least is None else least


def is_too_weak(verdict: Verdict, least: float | None = None) -> bool:
    """Whether a verdict found no clear difference where only one of more than `WEAK` would have shown.

    >>> [is_too_weak(Verdict("tie", 0, 1.0, n, 6)) for n in (12, 79, 80)]
    [True, True, False]
    """
    return verdict.kind == "tie" and _least_shown(verdict, least) > WEAK


def can_beat_guessing(n_trials: int, guess: float) -> bool:
    """Whether a classifier that is right in every trial is clearly better than guessing.

    >>> can_beat_guessing(3, 0.5), can_beat_guessing(4, 0.5)
    (False, True)
    """
    return n_trials > 0 and wilson_interval(1.0, n_trials)[0] > guess


def in_words(verdict: Verdict, least: float | None = None) -> str:
    """
    >>> in_words(Verdict("tie", 0, 1.0, 12, 6)), in_words(Verdict("tie", 0, 1.0, 5, 1))
    ('too few test trials: only differences of 67 points or more would show', 'too few test trials: no difference would show')
    """  # noqa: E501
    least = _least_shown(verdict, least)
    if math.isinf(least):
        return "too few test trials: no difference would show"
    return f"too few test trials: only differences of {100 * least:.0f} points or more would show"
