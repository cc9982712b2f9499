"""A study may sweep its simulation, and train on more windows of a trial than it tests."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import studies_here

from neurotact.data.dataset import load_recordings
from neurotact.data.hdf5 import load_spikes
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import WindowSpec
from neurotact.encoders.encoding import encode_recordings
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.networks.training import tasks
from neurotact.networks.training.tasks import Task
from neurotact.report import front
from neurotact.studies import runner, store, study
from neurotact.studies.cell import task_of
from neurotact.studies.preparation import dataset_of

TINY = Path(__file__).parent / "tiny.toml"
START = "dataset.parameters.start_mm"
UNSWEPT = {
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
    "network.hidden": 4,
    "sweep.seed": [0],
}
STARTS = {f"sweep.{START}": [1.0, 3.0], **UNSWEPT}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    what = study.resolve(TINY, STARTS)
    folder = tmp_path_factory.mktemp("starts")
    with studies_here():
        runner.run(what, folder)
        yield what, folder


def test_each_cell_works_on_the_recordings_of_its_own_start(run):
    what, folder = run
    cells = list(study.cells(what))
    assert [cell.source["parameters"]["start_mm"] for cell in cells] == [1.0, 3.0]
    for cell in cells:
        recorded = load_recordings(dataset_of(what, cell)).conditions
        trains = load_spikes(folder / cell.given)
        assert trains.conditions.equals(recorded)
        alone = study.resolve(TINY, {**UNSWEPT, START: cell.source["parameters"]["start_mm"]})
        assert [one.digest() for one in study.cells(alone)] == [cell.digest()]
    first, second = (load_spikes(folder / cell.given) for cell in cells)
    assert any(not np.array_equal(*pair) for pair in zip(first.steps, second.steps, strict=True))


def test_tables_name_the_start_of_each_row(run):
    for name in ("results", "encoding"):
        table = pd.read_csv(run[1] / f"{name}.csv")
        assert sorted(set(table[START])) == [1.0, 3.0]


def test_every_encoding_stays_listed_and_is_not_made_again(run):
    what, folder = run
    paths = [folder / cell.given for cell in study.cells(what)]
    listed = read_json(folder / "spikes" / store.FILES)["files"]
    assert {path.name for path in paths} <= set(listed)
    made = [path.stat().st_mtime_ns for path in paths]
    (folder / "results.csv").unlink()
    runner.run(what, folder)
    assert [path.stat().st_mtime_ns for path in paths] == made


def test_a_lost_encoding_of_a_later_start_is_made_again_the_same(run):
    what, folder = run
    path = folder / list(study.cells(what))[1].given
    before = path.read_bytes()
    path.unlink()
    runner.run(what, folder)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"sweep.dataset.parameters.start_mm": [1.0, -2.0]}, "start_mm: must be >= 0; got -2"),
        ({"sweep.dataset.parameters.strat_mm": [1.0]}, "did you mean 'start_mm'"),
        ({"sweep.dataset.parameters.start_mm": [1.0], "baselines": "linear"}, "baselines describes one set"),
        (
            {"sweep.dataset.parameters.start_mm": [1.0], "dataset.simulate": None, "dataset.file": "x.h5"},
            "needs dataset.simulate",
        ),
        ({"sweep.dataset & training_windows": [["all", 1], ["any", 2]]}, "'any' is not a subset"),
        ({"training_windows": 0}, "training_windows: must be >= 1"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused_before_anything_runs(overrides, message):
    with pytest.raises(InputError) as refusal:
        study.resolve(TINY, overrides)
    assert message in str(refusal.value)


def test_more_windows_are_trained_on_and_validated_than_tested(run):
    first = next(study.cells(run[0]))
    trains = encode_recordings(load_recordings(dataset_of(run[0], first)), first.encoder)
    window = WindowSpec(length_ms=50.0, start_ms=100.0, hop_ms=20.0, per_trial=1)
    split = SplitSpec(validation=0.2, test=0.2)
    plain = tasks.sides_of(trains, Task(window=window, split=split))
    more = tasks.sides_of(trains, Task(window=window, split=split, training_windows=4))
    assert len(more.train.labels) == 4 * len(plain.train.labels)
    assert len(more.validation.labels) == 4 * len(plain.validation.labels)
    assert more.test.spikes.equal(plain.test.spikes)
    assert more.train.spikes[::4].equal(plain.train.spikes)


def test_training_windows_name_another_cell_and_their_absence_none():
    none, some = (next(study.cells(study.resolve(TINY, {**STARTS, **more}))) for more in ({}, {"training_windows": 3}))
    assert none.digest() != some.digest()
    assert none.seeds == some.seeds


def test_opponents_have_as_many_windows_of_a_trial_as_networks(tmp_path):
    """More or fewer to train and to be chosen on, and those of the test."""
    sizes = []
    for tested, trained in ((1, None), (1, 4), (3, 2)):
        more = {"window.per_trial": tested, **({} if trained is None else {"training_windows": trained})}
        what = study.resolve(TINY, {**UNSWEPT, "window.hop_ms": 20.0, "baselines": "linear", **more})
        with studies_here():
            runner.run(what, tmp_path / f"{tested} {trained}")
        rows = pd.read_csv(tmp_path / f"{tested} {trained}" / "baselines.csv")
        (of_all,) = rows[["n_train", "n_validation", "n_test"]].drop_duplicates().to_numpy()
        sizes.append(of_all)
        side = next(iter(study.cells(what)))
        assert of_all.tolist() == [
            len(one.labels)
            for one in tasks.sides_of(load_spikes(tmp_path / f"{tested} {trained}" / side.given), task_of(side))
        ]
    assert (sizes[1] == sizes[0] * [4, 4, 1]).all()
    assert (sizes[2] == sizes[0] * [2, 2, 3]).all()


@pytest.mark.parametrize("key", ["training_windows", "window.per_trial"])
def test_opponents_of_the_first_windows_are_not_compared_with_networks_of_others(key):
    changes = {**UNSWEPT, "window.hop_ms": 20.0, "baselines": "linear", f"sweep.{key}": [1, 2]}
    what, one = study.resolve(TINY, changes), study.resolve(TINY, {**UNSWEPT, "baselines": "linear"})
    row = {"classifier": "ridge", "input": "signals: made", "t_ref_ra_ms": None, "t_ref_sa_ms": None, "dataset": "all",
           "accuracy_validation": 0.9, "accuracy_test": 0.9, "energy_estimate_nJ": 1.0}  # fmt: skip
    tables = {"baselines": pd.DataFrame([row])}
    assert len(front.baselines_of(one, tables, {"dataset": "all"})) == 1
    assert front.baselines_of(what, tables, {"dataset": "all"}) == []
