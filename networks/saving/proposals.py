"""What a search tries next: each way alone, the ways that pay together, then points near the best and TPE's in turn,
then the best again.

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
"""Trainings of a point that is to be used, beside the first: with weights and validation trials of their own."""
FINALISTS = 5
"""Points that are trained again, at most."""


Key = tuple[tuple[str, int], ...]
"""A point to compare by: its ways that save, and how much."""


class Candidate(NamedTuple):
    """A point as it decides, in one trial."""

    trial: Trial
    how: str

    @property
    def accuracy(self) -> float:
        return self.trial.decided[self.how]["validation_accuracy"]

    def energy(self, prices: str) -> float:
        return self.trial.decided[self.how][prices]


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
            filter(None, (_new(found(first, ways, asked), known) for found in (_alone, _together, *_turn(first)))), []
        )
        points = points[: min(left, max(BATCH, len(points)))]
    jobs = [Job(len(trials) + number, point) for number, point in enumerate(points)]
    return jobs or _again(trials, asked)


def key_of(point: Point) -> Key:
    """A point to compare by: without ways of which nothing is used."""
    return tuple(sorted((name, amount) for name, amount in point.items() if amount))


def _new(points: Sequence[Point], known: set[Key]) -> list[Point]:
    found = {key_of(point): dict(key_of(point)) for point in points}
    return [point for key, point in found.items() if key not in known]


def _alone(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    return [{name: way.middle} for name, way in ways.items()]


def _together(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    """The ways that save, the one that loses the least for it first, ever more of them together.

    Once with the amounts that were tried alone, and once with the least amounts.
    """
    ranked = [(one.name, one.amount) for one in _worth(first, ways, asked)]
    points = []
    for n in range(len(ranked), 1, -2):
        points += [dict(ranked[:n]), {name: 1 for name, _ in ranked[:n]}]
    return points


class _Worth(NamedTuple):
    """A way that saves alone: the accuracy that it loses for each halving, its name, the amount that was tried."""

    lost: float
    name: str
    amount: int


def _worth(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[_Worth]:
    """The ways that save alone, the one that loses the least for it first."""
    base, worth = Candidate(first[0], WHOLE), []
    for trial in first:
        alone = [(name, amount) for name, amount in key_of(trial.point) if amount == ways[name].middle]
        if len(alone) == len(trial.point) == 1 and not trial.error:
            one = Candidate(trial, WHOLE)
            halvings = _halvings(one, base, asked)
            if halvings > -math.log2(1 - LEAST_SAVED):
                worth.append(_Worth((base.accuracy - one.accuracy) / halvings, *alone[0]))
    return sorted(worth)


def _halvings(one: Candidate, base: Candidate, asked: Asked) -> float:
    """How often the energy is halved; SOPs that are saved count a little, so that they decide where energy does not."""
    sops = base.trial.decided[base.how]["sops_total"], one.trial.decided[one.how]["sops_total"]
    energy = math.log2(base.energy(asked.prices) / one.energy(asked.prices))
    return energy + 0.1 * math.log2(max(1.0, sops[0]) / max(1.0, sops[1]))


def _turn(first: Sequence[Trial]) -> Sequence[Any]:
    """Points near the best and those of TPE, in turn; the other kind where one has nothing new."""
    return (_near, _by_tpe) if len(first) // BATCH % 2 else (_by_tpe, _near)


def _near(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    """One amount more of one way than the cheapest point that kept the accuracy, the ways that pay first."""
    base, keys = Candidate(first[0], WHOLE), [one.name for one in _worth(first, ways, asked)]
    kept = [one for one in candidates(first) if is_within(one.accuracy, base.accuracy, asked.loss)]
    at = min(kept, key=lambda one: one.energy(asked.prices)).trial.point
    known = {key_of(trial.point) for trial in first}
    points = [{**at, name: amount} for name in keys if (amount := at.get(name, 0) + 1) < len(ways[name].amounts)]
    return [point for point in points if key_of(point) not in known][:BATCH]


def _by_tpe(first: Sequence[Trial], ways: Mapping[str, Way], asked: Asked) -> list[Point]:
    """Points of NNI's TPE, which knows all trials by a trade-off of accuracy and energy."""
    base, n = Candidate(first[0], WHOLE), len(first)
    halving = HALVING[n // BATCH % len(HALVING)]
    space = {name: {"_type": "choice", "_value": [*range(len(way.amounts))]} for name, way in ways.items()}
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
    """The run itself and one finalist after the other, trained again."""
    done = {(key_of(trial.point), trial.member) for trial in trials}
    left = asked.n_again - sum(trial.member > 1 for trial in trials)
    wanted = [] if (key_of({}), MEMBERS[0]) in done else [key_of({})]
    finalist = next_finalist(trials, asked)
    wanted += [] if finalist is None else [finalist]
    jobs = [(dict(point), member) for point in wanted for member in MEMBERS][:left]
    return [Job(len(trials) + number, point, member) for number, (point, member) in enumerate(jobs)]


def next_finalist(trials: Sequence[Trial], asked: Asked) -> Key | None:
    """The next point to train again, of those that kept the accuracy in the search, by their energy.

    The cheapest first; then the middle one between the dearest that lost too much and the cheapest that held, or the
    run: the more a network costs, the more it keeps.
    """
    searched, again = (means(part, asked) for part in _parted(trials))
    base = searched[key_of({}), WHOLE]
    order = sorted(
        (one.energy, key)
        for key, one in searched.items()
        if one.energy < base.energy and key[0] and keeps(one, base, asked)
    )
    kept = list(dict.fromkeys(key[0] for _, key in order))
    low, high = -1, len(kept)
    for place, point in enumerate(kept):
        if any(key[0] == point for key in again):
            holds = any(keeps(one, again[key_of({}), WHOLE], asked) for key, one in again.items() if key[0] == point)
            low, high = (low, min(high, place)) if holds else (max(low, place), high)
    between = range(low + 1, high)
    return kept[between[0 if low < 0 else len(between) // 2]] if len(between) else None


def _parted(trials: Sequence[Trial]) -> tuple[list[Trial], list[Trial]]:
    """The trials of the search, and those that were trained again."""
    return [trial for trial in trials if trial.member == 1], [trial for trial in trials if trial.member > 1]


class Mean(NamedTuple):
    """A point as it decides: means over trainings. right: of each validation trial, training by training."""

    accuracy: float
    energy: float
    right: np.ndarray


def means(trials: Sequence[Trial], asked: Asked) -> dict[tuple[Key, str], Mean]:
    """Each point in each way in which it decides."""
    groups: dict[tuple[Key, str], list[Candidate]] = {}
    for one in candidates(trials):
        groups.setdefault((key_of(one.trial.point), one.how), []).append(one)
    return {
        key: Mean(
            float(np.mean([one.accuracy for one in every])),
            float(np.mean([one.energy(asked.prices) for one in every])),
            np.concatenate([one.trial.right[one.how] for one in every]),
        )
        for key, every in groups.items()
    }


def judged(trials: Sequence[Trial], asked: Asked) -> dict[tuple[Key, str], Mean]:
    """The points that may be used, by trainings that did not choose them, with the run; all where none was repeated.

    What a search chose is the luckiest of many on the trials that chose it; others tell what it keeps.
    """
    searched, again = (means(part, asked) for part in _parted(trials))
    found = again if len({key for key, _ in again}) > 1 else searched
    n = {key: len(one.right) for key, one in found.items()}
    # early exit that only some trainings use is not compared
    return {key: one for key, one in found.items() if n[key] == max(n.values()) and key in searched}


def keeps(one: Mean, base: Mean, asked: Asked) -> bool:
    """Whether a point keeps the accuracy: its mean is at most the allowed loss below that of the run."""
    return bool(is_within(one.accuracy, base.accuracy, asked.loss))
