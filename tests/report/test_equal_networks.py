"""Of networks, encoders and baselines that are equally accurate, a report hardly ever calls one better or worse."""

import equal_learners
import numpy as np
from equal_learners import CLASSES, Split
from hypothesis import settings
from levels import QUICK, thinned
from neurotact_parts.studies.comparison import encoder_choice
from neurotact_parts.studies.comparison.encoder_choice import Choice

from neurotact.metrics import paired
from neurotact.report.answer import Baseline, Decision, Network, Trials, answer

HOW = [
    {"n": 199, "learners": 6, "splits": 5},
    {"n": 199, "learners": 6, "splits": 1},
    {"n": 60, "learners": 2, "splits": 10},
    {"n": 400, "learners": 4, "splits": 20, "apart": 1.2},
    {"n": 100, "learners": 8, "splits": 5, "kind": "folds"},
    {"n": 199, "learners": 4, "splits": 6, "kind": "groups"},
]


class Told:
    """The learners of a study as a report reads them: means over splits, and each trial once."""

    def __init__(self, found: list[Split]):
        sides = [[one.validation for one in found], [one.test for one in found]]
        self.trials = Trials(*(len(np.unique(np.concatenate(side))) for side in sides))
        self.right = [[_by_trial(found, at, side) for side in sides] for at in range(len(found[0].right))]
        shares = [[one.shares(one.validation), one.shares(one.test)] for one in found]
        self.validation, self.test = np.mean(shares, axis=0)

    def network(self, at: int, cost: float = 1.0) -> Network:
        whole = Decision(float(self.test[at]), cost, 100.0, 10.0, cost)
        return Network(f"{at}&{at}", 20, 1, float(self.validation[at]), whole, None)


def _by_trial(found: list[Split], at: int, side: list[np.ndarray]) -> dict[int, float]:
    right = [one.right[at][part] for one, part in zip(found, side, strict=True)]
    return paired.by_trial(np.concatenate(side), np.concatenate(right))


def of_answer(rng, **how) -> str:
    """The verdict of a report, whose networks are the first half of the learners."""
    told = Told(equal_learners.study(rng, **how))
    n = len(told.test)
    baselines = [
        Baseline(str(at), float(told.validation[at]), float(told.test[at]), 1.0, (at,), told.right[at][0])
        for at in range(n // 2, n)
    ]
    networks = [told.network(at) for at in range(n // 2)]

    def compare(network: Network, baseline: Baseline):
        one = int(network.pair.partition("&")[0])
        return paired.compare_by_trial(told.right[one][1], told.right[baseline.rows[0]][1])

    return answer(networks, baselines, 1 / CLASSES, told.trials, compare).kind


def of_encoders(rng, **how) -> str:
    """Better: told from all others. Worse: what test trials show to be less accurate, or is named for it."""
    told = Told(equal_learners.study(rng, **how))
    costs = rng.permutation(len(told.test)) + 1.0
    among = [
        Choice(f"e{at}", None, told.network(at, float(cost)), told.trials, None, None) for at, cost in enumerate(costs)
    ]
    said = encoder_choice.sentence(sorted(among, key=lambda one: -one.network.validation))
    if "is more accurate than all others" in said:
        return "better"
    return "worse" if "clearly less accurate" in said else "tie"


def n_studies() -> int:
    return 60 if settings.default.max_examples == QUICK else 150


@thinned("how", HOW)
def test_of_equal_classifiers_a_network_is_called_better_or_worse_in_at_most_one_of_twenty_reports(how):
    claims = equal_learners.claims(lambda rng: of_answer(rng, **how), n_studies())
    assert claims <= equal_learners.most(n_studies())


@thinned("how", HOW)
def test_of_equal_encoders_one_is_told_from_the_others_in_at_most_one_of_twenty_reports(how):
    claims = equal_learners.claims(lambda rng: of_encoders(rng, **how), n_studies())
    assert claims <= equal_learners.most(n_studies())


def test_a_better_network_and_a_better_encoder_are_found():
    how = {"n": 199, "learners": 2, "splits": 10, "best": 2.0}
    assert equal_learners.claims(lambda rng: of_answer(rng, **how), 20) >= 15
    assert equal_learners.claims(lambda rng: of_encoders(rng, **how), 20) >= 15
