"""What a search tries next: each way alone, the ways that pay together, then TPE's points, then the best again.

Everything is decided by the trials that are done, in batches whose size belongs to the search: a search that goes on
proposes what an uninterrupted one would, and the number of worker processes changes nothing.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from neurotact_parts.networks.saving.trial import WHOLE, Job, Trial
from neurotact_parts.networks.saving.ways import Point, Way
from neurotact_parts.networks.search import tuning

from neurotact.metrics.decision import is_within

BATCH = 4
"""Trials that are proposed together."""
HALVING = (0.01, 0.03, 0.003)
"""Accuracy that half the energy is worth in what TPE maximises, in turn: so points along the front are looked for."""
LEAST_SAVED = 0.02
"""A way alone that saves less energy and fewer SOPs than this share is not joined with others."""
MEMBERS = (2, 3)
"""Trainings of a point that is to be used, beside the first: with weights and an order of windows of their own."""
FINALISTS = 4
"""Points that are trained again, at most."""


class Candidate(NamedTuple):
    """A point as it decides, in one trial."""

    trial: Trial
    how: str

    @property
    def accuracy(self) -> float:
        return self.trial.decided[self.how]["validation_accuracy"]

    def energy(self, prices: str) -> float:
        return self.trial.decided[self.how][prices]

    @property
    def key(self) -> tuple[Any, ...]:
        """The point, and how it decides."""
        return (*sorted(self.trial.point.items()), self.how)


class Asked(NamedTuple):
    """What a search is asked for. trials: trainings in all. loss: accuracy that may be lost. prices: a list's name."""

    trials: int
    loss: float
    prices: str
    seed: int

    @property
    def n_again(self) -> int:
        """Trainings that are kept for the finalists and for the run itself."""
        per_point = len(MEMBERS)
        of_points = min(FINALISTS + 1, self.trials // (3 * per_point))
        return per_point * of_points if of_points > 1 else 0


def next_batch(trials: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Job]:
    """The next trials; none when all are done. Trial 0 is the run itself, which is not trained.

    trials: of whole batches.
    """
    if not trials:
        return [Job(0, {})]
    first = [trial for trial in trials if trial.member == 1]
    left = asked.trials - asked.n_again - (len(first) - 1)
    points: list[Point] = []
    if left > 0:
        known = {key_of(trial.point) for trial in first}
        points = next(
            filter(None, (_new(found(first, ways, asked), known) for found in (_alone, _together, _by_tpe))), []
        )
        points = points[: min(left, max(BATCH, len(points)))]
    jobs = [Job(len(trials) + number, point) for number, point in enumerate(points)]
    return jobs or _again(trials, asked)


def key_of(point: Point) -> tuple[Any, ...]:
    """A point to compare by: without ways of which nothing is used."""
    return tuple(sorted((name, amount) for name, amount in point.items() if amount))


def _new(points: Sequence[Point], known: set[tuple[Any, ...]]) -> list[Point]:
    found = {key_of(point): dict(key_of(point)) for point in points}
    return [point for key, point in found.items() if key not in known]


def _alone(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    return [{name: way.middle} for name, way in ways.items()]


def _together(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    """The ways that save, the one that loses the least for it first, ever more of them together.

    Once with the amounts that were tried alone, and once with the least amounts.
    """
    base, worth = Candidate(first[0], WHOLE), []
    for trial in first:
        alone = [(name, amount) for name, amount in key_of(trial.point) if amount == ways[name].middle]
        if len(alone) == len(trial.point) == 1 and not trial.error:
            one = Candidate(trial, WHOLE)
            halvings = _halvings(one, base, asked)
            if halvings > -math.log2(1 - LEAST_SAVED):
                worth.append(((base.accuracy - one.accuracy) / halvings, *alone[0]))
    ranked = [(name, amount) for _, name, amount in sorted(worth)]
    points = []
    for n in range(len(ranked), 1, -2):
        points += [dict(ranked[:n]), {name: 1 for name, _ in ranked[:n]}]
    return points


def _halvings(one: Candidate, base: Candidate, asked: Asked) -> float:
    """How often the energy is halved; SOPs that are saved count a little, so that they decide where energy does not."""
    sops = base.trial.decided[base.how]["sops_total"], one.trial.decided[one.how]["sops_total"]
    energy = math.log2(base.energy(asked.prices) / one.energy(asked.prices))
    return energy + 0.1 * math.log2(max(1.0, sops[0]) / max(1.0, sops[1]))


def _by_tpe(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    """Points of NNI's TPE, which knows all trials by a trade-off of accuracy and energy."""
    base, n = Candidate(first[0], WHOLE), len(first)
    halving = HALVING[n // BATCH % len(HALVING)]
    space = {name: {"_type": "randint", "_value": [0, len(way.amounts)]} for name, way in ways.items()}
    known = []
    for trial in first:
        if not trial.error:
            value = max(one.accuracy + halving * _halvings(one, base, asked) for one in candidates([trial]))
            known.append(({name: trial.point.get(name, 0) for name in ways}, value))
    return tuning.proposed(space, known, BATCH, seed=asked.seed + n)


def candidates(trials: Sequence[Trial]) -> list[Candidate]:
    """Each point in each way in which it decides."""
    return [Candidate(trial, how) for trial in trials for how in trial.decided]


def _again(trials: Sequence[Trial], asked: Asked) -> list[Job]:
    """The run itself and the next finalist, trained again, until one holds and no training is left."""
    done = {(key_of(trial.point), trial.member) for trial in trials}
    left = asked.n_again - sum(trial.member > 1 for trial in trials)
    wanted = [dict(key_of({}))] if (key_of({}), MEMBERS[0]) not in done else []
    wanted += [dict(point) for point in finalists(trials, asked) if (point, MEMBERS[0]) not in done]
    jobs = [(point, member) for point in wanted[:2] for member in MEMBERS][:left]
    return [Job(len(trials) + number, point, member) for number, (point, member) in enumerate(jobs)]


def finalists(trials: Sequence[Trial], asked: Asked) -> list[tuple[Any, ...]]:
    """The points that are worth to be trained again, the cheapest first, of those that have kept the accuracy so far.

    Of points that were trained again the mean counts.
    """
    found = confirmed(trials, asked)
    base = found[key_of({}), WHOLE]
    keeps = [
        (one.energy, key)
        for (key, _), one in found.items()
        if key and is_within(one.accuracy, base.accuracy, asked.loss)
    ]
    keeps = [(energy, key) for energy, key in sorted(keeps) if energy < base.energy]
    return list(dict.fromkeys(key for _, key in keeps))


class Mean(NamedTuple):
    """A point as it decides: means over its trainings. right: of each validation trial, over trainings."""

    accuracy: float
    energy: float
    sops: float
    right: np.ndarray
    trials: tuple[Trial, ...]


def confirmed(trials: Sequence[Trial], asked: Asked) -> dict[tuple[tuple[Any, ...], str], Mean]:
    """Each point in each way in which it decides.

    The first training of a point that was chosen is the luckiest of many: where there are others, these count alone.
    """
    groups: dict[tuple[tuple[Any, ...], str], list[Candidate]] = {}
    for one in candidates(trials):
        groups.setdefault((key_of(one.trial.point), one.how), []).append(one)
    found = {}
    for key, every in groups.items():
        again = [one for one in every if one.trial.member > 1] or every
        found[key] = Mean(
            float(np.mean([one.accuracy for one in again])),
            float(np.mean([one.energy(asked.prices) for one in again])),
            float(np.mean([one.trial.decided[one.how]["sops_total"] for one in again])),
            np.mean([one.trial.right[one.how] for one in again], axis=0),
            tuple(one.trial for one in every),
        )
    return found
