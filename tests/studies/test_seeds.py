"""Published numbers come out again: a key that is added later changes no seed of a network that does not use it."""

import hashlib
import json
from typing import Any

import pytest
from pydantic import Field

from neurotact.data.conditioning import ConditioningSpec
from neurotact.data.contact import OnsetSpec
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders.specs import load
from neurotact.networks.definition.seeds import drawn
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.search.tuning import SearchSpec
from neurotact.networks.training.tasks import Task
from neurotact.studies import study
from neurotact.studies.study import EarlyExitSpec

SEEDS = {
    "early-exit": "02316e44ecd819d6",
    "refractory-period": "561479db5eb8bc99",
    "training-length": "3a7888d02914622e",
    "unknown-start": "5989b25e33c64cf3",
}
"""Of the cells of shipped studies, with which the numbers in the documentation were computed."""
SPACE = {"hidden": {"_type": "choice", "_value": [20, 30]}}


@pytest.mark.parametrize("name", SEEDS)
def test_the_seeds_of_a_shipped_study_stay(name):
    seeds = [cell.seeds for cell in study.cells(study.resolve(name))]
    assert hashlib.sha256(json.dumps(seeds).encode()).hexdigest()[:16] == SEEDS[name]


SPECS = [
    RSNNSpec(), TrainingSpec(), RSNNSpec(recipe="default"), Task(), WindowSpec(), OnsetSpec(), SplitSpec(),
    EarlyExitSpec(), ConditioningSpec(), SearchSpec(space=SPACE),
    *(part for name in ("sa1-ra1-lif", "izhikevich", "poisson") for part in (load(name), load(name).sa1)),
]  # fmt: skip
"""One of each kind from which seeds are drawn."""


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: type(spec).__name__)
def test_a_new_key_changes_no_seed_before_it_is_used(spec):
    class Grown(type(spec)):
        added: float = Field(default=0.0)

    Grown.__name__ = type(spec).__name__
    given: dict[str, Any] = {key: getattr(spec, key) for key in spec.model_fields_set}
    assert drawn(Grown(**given)) == drawn(spec) != drawn(Grown(**given, added=1.0))


@pytest.mark.parametrize(
    ("less", "more"),
    [
        (RSNNSpec(), RSNNSpec(readout="max")),
        (RSNNSpec(), RSNNSpec(training=TrainingSpec(temperature=2.0))),
        (RSNNSpec(), RSNNSpec(training=TrainingSpec(epochs=3))),
        (RSNNSpec(recipe="default"), RSNNSpec(recipe="default", hidden=30)),
        (Task(), Task(training_windows=3)),
        ([Task(), 0], [Task(), 1]),
    ],
)
def test_what_a_network_uses_decides_its_seeds(less, more):
    assert drawn(less) != drawn(more)


def test_tables_and_lists_may_hold_specs():
    assert drawn({"network": RSNNSpec()}) == drawn({"network": RSNNSpec(readout="count")}) != drawn([RSNNSpec()])
