"""What a search found: the points to use, chosen on validation alone, and how they do on test windows."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from neurotact_parts.networks.saving.proposals import Asked, Mean, candidates, judged, keeps, key_of
from neurotact_parts.networks.saving.trial import EARLY, WHOLE, Trial
from neurotact_parts.networks.saving.ways import Way
from scipy.stats import norm

from neurotact.metrics.fronts import pareto_front

CONFIDENCE = 0.95
MOST_POINTS = 5
"""Run folders that are written, at most."""
DIFFERING = {
    "encoder_ms": "encoder's clock {:g} ms", "network_ms": "clock {:g} ms", "afferents": "{} afferents",
    "hidden": "{} hidden", "window_ms": "window {:g} ms",
}  # fmt: skip
"""What may differ in a network, in words."""


class Chosen(NamedTuple):
    """A point to use. mean: over the trainings that judged it; trial: that of the search, whose network is used."""

    how: str
    mean: Mean
    trial: Trial


class Found(NamedTuple):
    """The points to use, the answer first if there is one; base: the run, which saves nothing.

    was_judged: whether points were trained again, with other weights and validation trials, before they were chosen.
    """

    base: Chosen
    points: list[Chosen]
    answer: Chosen | None
    was_judged: bool


def found(trials: Sequence[Trial], asked: Asked) -> Found:
    """The answer is the cheapest point that keeps the accuracy; beside it, the other points of the front."""
    every, searched = judged(trials, asked), {key_of(trial.point): trial for trial in trials if trial.member == 1}
    base = Chosen(WHOLE, every[key_of({}), WHOLE], trials[0])
    tried = {key: mean for key, mean in every.items() if key[0] and mean.energy < base.mean.energy}
    on_front = pareto_front(*(np.array([getattr(one, of) for one in tried.values()]) for of in ("energy", "accuracy")))
    points = [
        Chosen(how, mean, searched[point])
        for ((point, how), mean), is_on in zip(tried.items(), on_front, strict=True)
        if is_on
    ]
    points.sort(key=lambda one: one.mean.energy)
    answer = next((one for one in points if keeps(one.mean, base.mean, asked)), None)
    first = [] if answer is None else [answer]
    others = [one for one in points if one is not answer]
    return Found(base, [*first, *others][:MOST_POINTS], answer, any(trial.member > 1 for trial in trials))


def interval(lost: np.ndarray) -> tuple[float, float, float]:
    """A mean loss of independent trials and its 95 % interval (Bonett and Price 2012, one trial added each way).

    >>> [round(value, 3) for value in interval(np.array([0.0] * 98))]
    [0.0, -0.028, 0.028]
    """
    n, mean = len(lost), float(lost.mean())
    centre = lost.sum() / (n + 2)
    error = math.sqrt((((lost**2).sum() + 2) / (n + 2) - centre**2) / (n + 2))
    half = float(norm.ppf((1 + CONFIDENCE) / 2)) * error
    return mean, float(centre - half), float(centre + half)


def table(trials: Sequence[Trial], ways: Mapping[str, Way], names: Sequence[str]) -> pd.DataFrame:
    """A row for each trial in each way in which it decides: setting, accuracies, SOPs, energies, ms.

    names: of the price lists. Costs and choices are of validation windows; columns of `test_...` are told alone.
    """

    def setting(trial: Trial) -> dict[str, Any]:
        return {name: _amount(way, trial.point.get(name, 0)) for name, way in ways.items()}

    listed = pd.DataFrame([
        *({"trial": one.trial.id, "training": one.trial.member, "decides": one.how, **setting(one.trial),
           **one.trial.decided[one.how]} for one in candidates(trials)),
        *({"trial": trial.id, "training": trial.member, **setting(trial), "error": trial.error}
          for trial in trials if trial.error),
    ])  # fmt: skip
    return listed.rename(
        columns={f"{before}{name}": f"{before}{name}_nJ" for name in names for before in ("", "test_")}
    )


def _amount(way: Way, index: int) -> Any:
    """An amount of a way in a cell; empty where it saves nothing."""
    amount = way.amounts[index]
    return " ".join([f"{next(iter(amount.values()))}", *[*amount][1:]]) if amount else ""


def in_words(about: Mapping[str, Any], base: Mapping[str, Any], how: str) -> str:
    """What differs in a network from that of the run.

    >>> run = {"sa1": 1.0, "ra1": 1.0, "hidden": 50, "recurrent": False, "sparsity": 0.0}
    >>> in_words({**run, "sa1": 10.0, "ra1": 10.0, "hidden": 20, "sparsity": 0.75}, run, EARLY)
    't_ref 10 & 10 ms, 20 hidden, 75 % pruned, early exit'
    >>> in_words({**run, "rate_penalty": 0.1}, {**run, "rate_penalty": 0.0}, "whole window")
    'rate penalty 0.1'
    """
    parts = []
    if any(about.get(part) != base.get(part) for part in ("ra1", "sa1")):
        parts.append(f"t_ref {about['ra1']:g} & {about['sa1']:g} ms")
    for key, called in DIFFERING.items():
        if about.get(key) != base.get(key):
            parts.append(called.format(about[key]))
    if about.get("smoothed") != base.get("smoothed"):
        parts.append("no moving average")
    if about.get("direct") != base.get("direct"):
        parts.append("direct")
    if about["recurrent"] != base["recurrent"]:
        parts.append("not recurrent")
    if about.get("rate_penalty") != base.get("rate_penalty") and about["hidden"]:
        parts.append(f"rate penalty {about['rate_penalty']:g}")
    if about["sparsity"] != base["sparsity"]:
        parts.append(f"{100 * about['sparsity']:g} % pruned")
    return ", ".join([*parts, *([EARLY] if how == EARLY else [])]) or "nothing changed"
