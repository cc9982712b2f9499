"""Of ways to save or changes of the recipe that are equally accurate, one is hardly ever called better or worse."""

import re

import equal_learners
import pandas as pd
from equal_learners import Split
from hypothesis import settings
from levels import QUICK, thinned
from neurotact_parts.studies.comparison import fronts, recipe_ablation

STUDIES = {
    "how": [
        {"n": 199, "learners": 16, "splits": 5},
        {"n": 199, "learners": 12, "splits": 1},
        {"n": 199, "learners": 6, "splits": 10},
        {"n": 199, "learners": 6, "splits": 3},
        {"n": 400, "learners": 4, "splits": 20, "apart": 1.2},
        {"n": 100, "learners": 8, "splits": 5, "kind": "folds"},
        {"n": 199, "learners": 8, "splits": 6, "kind": "groups"},
    ]
}


def rows(rng, found: list[Split]) -> pd.DataFrame:
    """Rows as both studies leave them; the first learner saves nothing, the costs of others are lower."""
    shares = [1.0, *(1 - rng.permutation(range(1, len(found[0].right))) / len(found[0].right))]
    return pd.DataFrame([
        {"set": "made", "way": f"way {at}" if at else fronts.NOTHING, "setting": f"setting {at}", "seed": seed,
         "change": f"change {at}" if at else recipe_ablation.WHOLE, "accuracy_test": tested,
         "accuracy_validation": held, **dict.fromkeys(fronts.COSTS, 1000 * shares[at]),
         "n_train": len(one.train), "n_test": len(one.test)}
        for seed, one in enumerate(found)
        for at, (tested, held) in enumerate(zip(one.shares(one.test), one.shares(one.validation), strict=True))
    ])  # fmt: skip


def of_ways(rng, **how) -> str:
    """Worse: a setting of which test windows are said to show it, or one that costs clear points as the cheapest."""
    compared = fronts.Compared.of(rows(rng, equal_learners.study(rng, **how)), fronts.SOPS)
    found = compared.savings()
    if compared.worse or found.cheapest is None:
        return "worse"
    one = compared.settings[found.cheapest]
    return "worse" if found.is_clear and fronts.interval_of(one.lost, one.rows).low > 0 else "tie"


def of_changes(rng, **how) -> str:
    return "better" if better(rows(rng, equal_learners.study(rng, **how))) else "tie"


def better(results: pd.DataFrame) -> str:
    """The changes that are said to be clearly better; empty without any."""
    (made,) = recipe_ablation.named(results).values()
    (said,) = re.findall(r"^Clearly better, .*: (.*)\.$", "\n".join(made.details), re.MULTILINE)
    assert ("Change the recipe" in made.headline) == (said != "none")
    return said.replace("none", "")


def n_studies() -> int:
    return 60 if settings.default.max_examples == QUICK else 150


@thinned("how", STUDIES["how"])
def test_of_equal_ways_one_is_called_worse_in_at_most_one_of_twenty_studies(how):
    claims = equal_learners.claims(lambda rng: of_ways(rng, **how), n_studies())
    assert claims <= equal_learners.most(n_studies())


@thinned("how", STUDIES["how"])
def test_of_equal_changes_one_is_called_better_in_at_most_one_of_twenty_studies(how):
    claims = equal_learners.claims(lambda rng: of_changes(rng, **how), n_studies())
    assert claims <= equal_learners.most(n_studies())


def test_a_better_change_and_a_worse_way_are_found():
    """The first learner is better: to take its place is worse, so that a change of it is not said to be better."""
    how = {"n": 199, "learners": 3, "splits": 10, "best": 2.0}

    def swapped(rng) -> str:
        found = equal_learners.study(rng, **how)
        said = better(rows(rng, [one._replace(right=one.right[::-1]) for one in found]))
        return "better" if said == "change 2" else "tie"

    assert equal_learners.claims(swapped, 20) >= 15
    assert equal_learners.claims(lambda rng: of_changes(rng, **how), 20) <= 1
