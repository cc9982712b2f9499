"""A training starts from its seed and its split; a key that is added later changes no start that does not use it."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.contact import OnsetSpec
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.networks.definition.seeds import drawn, of_start
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import run_folder
from neurotact.networks.training.tasks import Task
from neurotact.studies import preparation, study
from neurotact.studies.cell import run_cell

TINY = Path(__file__).parent / "tiny.toml"


def cells_of(**changes):
    return [*study.cells(study.resolve(TINY, {key.replace("__", "."): value for key, value in changes.items()}))]


def test_networks_start_alike_where_split_and_seed_are_alike_and_nowhere_else():
    cells = cells_of(split__folds=3, sweep__split__fold=[0, 1, 2])
    starts = {(cell.seed, cell.split.fold): cell.seeds for cell in cells}
    assert len(cells) == 24  # two encoders and two sizes of each
    assert all(cell.seeds == starts[cell.seed, cell.split.fold] for cell in cells)
    assert len({seed for seeds in starts.values() for seed in seeds}) == 2 * len(starts) == 12
    assert {one.seeds for one in cells_of(split__seed=1)}.isdisjoint(one.seeds for one in cells_of())


def test_of_a_split_counts_what_repetitions_vary():
    tests = [SplitSpec(test_where=where) for where in ({}, {"speed": 450}, {"speed": 300}, {"force": 450})]
    assert len({of_start(0, split) for split in tests}) == len(tests)
    assert of_start(0, SplitSpec(test_where={"speed": 450.0})) == of_start(0, tests[1])
    assert of_start(0, SplitSpec(group=("subject",), validation=0.1)) == of_start(0, SplitSpec())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"network": "default", "sweep__seed": [3], "split__seed": 2},
        pytest.param({"sweep__seed": [1], "split__folds": 3, "split__fold": 1}, marks=pytest.mark.thorough),
    ],
)
def test_a_study_and_train_give_the_same_network(tmp_path, changes):
    what = study.resolve(TINY, {key.replace("__", "."): value for key, value in changes.items()})
    cell = next(study.cells(what))
    preparation.prepare(tmp_path, what, [cell])
    spikes = tmp_path / cell.given
    files = run_cell(cell, hdf5.load_spikes(spikes))
    of_split = ("folds", "fold") if cell.split.folds else ("validation", "test")
    split: dict[str, Any] = {key: getattr(cell.split, key) for key in ("seed", *of_split)}
    window: dict[str, Any] = {key: getattr(cell.window, key) for key in ("length_ms", "start_ms", "per_trial")}
    specs = {"split": nt.Split(**split, stratify=cell.source["stratify"]), "window": nt.Window(**window)}
    found = nt.train(spikes, tmp_path / "run", cell.network, **specs, seed=cell.seed)
    assert (tmp_path / "run" / run_folder.WEIGHTS).read_bytes() == files[run_folder.WEIGHTS]
    assert found["accuracy_test"] == json.loads(files["result.json"])["row"]["accuracy_test"]


SPECS = [
    RSNNSpec(), TrainingSpec(), RSNNSpec(recipe="default"), Task(), WindowSpec(), OnsetSpec(), SplitSpec(),
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
