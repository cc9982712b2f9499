"""Every test of two classifiers on learners that are equal: it tells them apart in at most one of twenty studies."""

from collections.abc import Callable

import equal_learners
import numpy as np
import pytest
from equal_learners import Split
from hypothesis import settings
from levels import QUICK, thinned

from neurotact.metrics import paired, referee, resampled
from neurotact.metrics.paired import Paired


def sizes(found: list[Split]) -> tuple[int, int]:
    train, test = (
        np.mean([len(side) for side in sides]) for sides in zip(*((s.train, s.test) for s in found), strict=True)
    )
    return round(train), round(test)


def differences(found: list[Split], other: int) -> np.ndarray:
    return np.array([one.shares(one.test)[0] - one.shares(one.test)[other] for one in found])


def over_splits(found: list[Split], other: int) -> Paired:
    return resampled.compare_over_splits(differences(found, other), *sizes(found))


def by_interval(found: list[Split], other: int) -> Paired:
    """Clear where the interval omits 0: without a correction, for a single opponent."""
    interval = resampled.resampled_interval(differences(found, other), *sizes(found), within=resampled.DIFFERENCES)
    return Paired(interval.mean, 0.0 if interval.low > 0 or interval.high < 0 else 1.0, 1)


def by_trial(found: list[Split], other: int) -> Paired:
    """Trial by trial, over the splits that test a trial, as a report of networks compares."""
    trials = np.concatenate([one.test for one in found])
    right = np.concatenate([one.right[:, one.test] for one in found], axis=1)
    return paired.compare_by_trial(*(paired.by_trial(trials, right[learner]) for learner in (0, other)))


def by_shares(found: list[Split], other: int) -> Paired:
    """As if different trials of the first split were tested."""
    test = found[0].test
    return paired.compare_shares(*(found[0].shares(test)[learner] for learner in (0, other)), len(test))


def verdict(found: list[Split], compare: Callable[[list[Split], int], Paired]) -> str:
    return referee.judge([compare(found, other) for other in range(1, len(found[0].right))]).kind


@thinned("how", [
    {"n": 120, "learners": 2, "splits": 5}, {"n": 199, "learners": 2, "splits": 10},
    {"n": 60, "learners": 2, "splits": 3}, {"n": 400, "learners": 2, "splits": 20, "apart": 1.0},
    {"n": 100, "learners": 2, "splits": 5, "kind": "folds"},
    {"n": 50, "learners": 2, "splits": 10, "kind": "folds", "apart": 1.0},
    {"n": 200, "learners": 2, "splits": 8, "kind": "groups"}, {"n": 199, "learners": 4, "splits": 10},
])  # fmt: skip
@pytest.mark.parametrize("compare", [over_splits, by_interval, by_trial, by_shares])
def test_equal_learners_are_told_apart_in_at_most_one_of_twenty_studies(compare, how):
    if compare is by_interval and how["learners"] > 2:
        return  # an interval is of one comparison
    studies = 100 if settings.default.max_examples == QUICK else 500
    claims = equal_learners.claims(lambda rng: verdict(equal_learners.study(rng, **how), compare), studies)
    assert claims <= equal_learners.most(studies)


@pytest.mark.parametrize("compare", [over_splits, by_interval, by_trial])
def test_a_better_learner_is_told_apart(compare):
    how = {"n": 199, "learners": 2, "splits": 10, "best": 2.0}
    assert equal_learners.claims(lambda rng: verdict(equal_learners.study(rng, **how), compare), 20) >= 15
