"""Unknown conditions stay unknown: in training, in validation, and in the gains of the encoder."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import studies_here

from neurotact.data.hdf5 import load_spikes
from neurotact.errors import InputError
from neurotact.files import read_json
from neurotact.networks.training import run_folder, tasks
from neurotact.report import report
from neurotact.studies import runner, study
from neurotact.studies.store import cell_folder

TINY = Path(__file__).parents[1] / "studies" / "tiny.toml"
UNKNOWN = {
    "dataset.subsets": {"every": {}, "without 12 N": {"force_N": [3.0]}},
    "dataset.parameters.forces_N": [3.0, 12.0],
    "sweep.dataset": ["every", "without 12 N"],
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
    "network.hidden": 4,
    "sweep.seed": [0],
    "test_every_condition": True,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    what = study.resolve(TINY, UNKNOWN)
    folder = tmp_path_factory.mktemp("unknown")
    with studies_here():
        runner.run(what, folder)
    report.write(folder)
    return what, folder


def test_each_network_is_tested_on_the_same_trials_of_every_condition(run):
    table = pd.read_csv(run[1] / "conditions.csv")
    assert table[["dataset", "force_N", "known"]].values.tolist() == [
        ["every", 3.0, True], ["every", 12.0, True], ["without 12 N", 3.0, True], ["without 12 N", 12.0, False],
    ]  # fmt: skip
    assert table.groupby("force_N").n_test.nunique().tolist() == [1, 1]
    assert table.groupby("force_N").spikes_sa.nunique().tolist() == [1, 1]


def test_what_is_known_has_the_accuracy_of_the_results(run):
    table, results = (pd.read_csv(run[1] / name) for name in ("conditions.csv", "results.csv"))
    known = table[table.known]
    means = (known.accuracy_test * known.n_test).groupby(known.dataset).sum() / known.groupby("dataset").n_test.sum()
    assert results.set_index("dataset").accuracy_test.to_dict() == pytest.approx(means.to_dict())


def test_no_trial_of_an_unknown_condition_is_in_training_or_validation(run):
    _, cell = study.cells(run[0])
    restored = run_folder.restore(cell_folder(run[1], cell))
    trains = load_spikes(restored.spikes_path)
    inside = np.flatnonzero(trains.conditions.force_N == 3.0)
    sides = tasks.sides_of(trains, restored.task)
    assert sum(len(side.labels) for side in sides) == len(inside)
    examples, _ = tasks.examples_of(trains, inside, restored.task)
    held = {window.tobytes() for window in examples.spikes.numpy()}
    assert {window.tobytes() for side in sides for window in side.spikes.numpy()} <= held


def test_the_figure_outlines_what_was_unknown(run):
    svg = (run[1] / "figures" / "conditions.svg").read_text()
    assert svg.count('id="unknown') == 1


def test_gains_are_fitted_without_the_unknown_conditions():
    every, without = study.cells(study.resolve(TINY, {**UNKNOWN, "calibrate": True}))
    assert every.spikes_name != without.spikes_name
    both = study.cells(study.resolve(TINY, {**UNKNOWN, "calibrate": True, "test_every_condition": False}))
    assert len({cell.spikes_name for cell in both}) == 1


def test_conditions_must_be_named():
    with pytest.raises(InputError, match=r"needs dataset\.stratify"):
        study.resolve(TINY, {"test_every_condition": True, "dataset.stratify": []})


def test_what_a_cell_measures_besides_changes_its_folder_but_not_its_training():
    plain = list(study.cells(study.resolve(TINY)))
    more = list(study.cells(study.resolve(TINY, {"cut_short_ms": [10.0], "exit_patiences": [3]})))
    assert {cell.digest() for cell in plain}.isdisjoint(cell.digest() for cell in more)
    assert [cell.seeds for cell in plain] == [cell.seeds for cell in more]


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A run that asks for every other table."""
    drive = {"spikes": 4, "duration_s": 0.2, "trials": 1}
    asked = {"cut_short_ms": [10.0, 50.0], "exit_patiences": [5, 20], "signals": True, "same_drive": drive}
    small = {"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]], "network.hidden": 4}
    what = study.resolve(TINY, {**asked, **small, "dataset.stratify": ["force_N", "speed_mm_per_s"]})
    folder = tmp_path_factory.mktemp("told")
    with studies_here():
        runner.run(what, folder)
    report.write(folder)
    return what, folder


@pytest.mark.thorough
def test_the_tables_of_cells_are_written_once_each_with_the_sweep(told):
    what, folder = told
    cut, curve, results = (pd.read_csv(folder / f"{name}.csv") for name in ("cut_short", "exit_curve", "results"))
    assert len(cut) == 2 * len(results)
    assert len(curve) == 6 * len(results)  # two patiences in three modes
    whole = cut[cut.cut_ms == 50.0]
    assert whole.accuracy_test.tolist() == results.accuracy_test.tolist()
    assert whole.sops_total.tolist() == pytest.approx(results.sops_total.tolist())
    kept = read_json(cell_folder(folder, next(study.cells(what))) / "result.json")["tables"]
    assert set(kept) == {"cut_short", "exit_curve"}


@pytest.mark.thorough
def test_the_tables_of_recordings_are_written(told):
    assert len(pd.read_csv(told[1] / "signals.csv")) == 2
    assert set(pd.read_csv(told[1] / "same_drive.csv").drive) == {"constant", "recorded"}


@pytest.mark.thorough
def test_each_table_has_its_figure_and_its_download(told):
    drawn = {path.stem for path in (told[1] / "figures").glob("*.svg")}
    assert {"cut-short", "exit-curves", "signals", "same-drive"} <= drawn
    page = (told[1] / "report.html").read_text()
    for name in ("cut_short", "exit_curve", "signals", "same_drive"):
        assert f'download="{name}.csv"' in page
