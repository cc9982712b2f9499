"""The answer of a whole run on one's own recordings compares network and baseline trial by trial."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.metrics import paired
from neurotact.report import front, report
from neurotact.report.answer import answer
from neurotact.studies import loading, runner, study
from neurotact.studies.store import cell_folder
from neurotact.tables import read_table

SMALL = {
    "baselines": "quick",
    "sweep.seed": [0, 1],
    "split.folds": 3,
    "sweep.split.fold": [0, 2],
    "window.length_ms": 150.0,
    "window.per_trial": 2,
    "sweep.network.hidden": [6],
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]],
    "network.training.epochs": 2,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paired")
    noise = np.random.default_rng(3)
    signals = [noise.normal(0.5 * (n % 2), 1.0, (200, 2)).cumsum(axis=0).astype(np.float32) for n in range(24)]
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 12})
    hdf5.save_recordings(Recordings(signals, 500.0, "mV", conditions), folder / "touches.h5")
    what = loading.resolve("own-recordings", SMALL, data=folder / "touches.h5")
    runner.run(what, folder / "run")
    report.write(folder / "run")
    return what, folder / "run"


def results_of(what, folder):
    for cell in study.cells(what):
        yield cell, json.loads((cell_folder(folder, cell) / "result.json").read_text())


@pytest.mark.thorough
def test_shares_of_trials_add_up_to_the_accuracies(run):
    what, folder = run
    for _, result in results_of(what, folder):
        assert np.mean([*result["right"].values()]) == pytest.approx(result["row"]["accuracy_test"])
        assert set(result["right"].values()) <= {0.0, 0.5, 1.0}  # two windows a trial
    table = read_table(folder / "baselines.csv")
    for side in ("validation", "test"):
        its = read_table(folder / "baselines_trials.csv").query(f"side == '{side}'")
        np.testing.assert_allclose(its.groupby("baseline")["right"].mean(), table[f"accuracy_{side}"])


@pytest.mark.thorough
def test_the_answer_pairs_the_trials_of_each_split(run):
    what, folder = run
    (found,) = json.loads((folder / "answer.json").read_text())["answers"]
    table, trials = read_table(folder / "baselines.csv"), read_table(folder / "baselines_trials.csv")
    trials = trials[trials["side"] == "test"]
    classifier, _, seen = found["verdict"]["decisive"].partition(" on ")
    source = "spikes" if " spikes " in seen else "signals"
    seen = f"{source}: {seen.partition('(')[2].removesuffix(')')}"
    its = table.index[(table["classifier"] == classifier) & (table["input"] == seen)]
    assert len(its) == 2  # a row of each fold
    spiking = {fold: [] for fold in (0, 2)}
    for cell, result in results_of(what, folder):
        right = result["exit_right" if found["used"] == "early" else "right"]
        spiking[cell.split.fold].append(pd.Series(right).rename(index=int))
    pairs = []
    for row in its:
        other = trials[trials["baseline"] == row].set_index("trial")["right"]
        mine = pd.concat(spiking[table.loc[row, "split.fold"]], axis=1).mean(axis=1)
        assert set(mine.index) == set(other.index)
        pairs += [(mine[trial], other[trial]) for trial in other.index]
    expected = paired.compare(*np.array(pairs).T)
    assert (found["verdict"]["n"], found["verdict"]["opponents"]) == (expected.n, len(found["rivals"]))
    assert expected.p <= found["verdict"]["p"] <= min(1.0, expected.p * len(found["rivals"])) or expected.p == 1.0
    assert f"{expected.n} test trials" in found["headline"] or found["kind"] in ("nothing learned", "unclear")


@pytest.mark.thorough
def test_where_single_trials_are_unknown_the_shares_are_compared(run):
    _, folder = run
    table = folder / "baselines_trials.csv"
    kept = table.read_bytes()
    table.unlink()
    try:
        report.write(folder)
        (found,) = json.loads((folder / "answer.json").read_text())["answers"]
        assert found["verdict"]["n"] == found["test_trials"]
    finally:
        table.write_bytes(kept)


@pytest.mark.thorough
def test_what_eight_bits_cost_baselines_and_network_is_told(run, tmp_path, monkeypatch):
    _, made = run
    table, trials = read_table(made / "baselines.csv"), read_table(made / "baselines_trials.csv")
    for side in ("validation_8bit", "test_8bit"):
        its = trials[trials["side"] == side].groupby("baseline")["right"].mean()
        np.testing.assert_allclose(its, table[f"accuracy_{side}"])
    folder, asked = shutil.copytree(made, tmp_path / "run"), []
    for name, wrong in (("baselines.csv", 0.0), ("integers.csv", 0.125)):
        read_table(folder / name).assign(accuracy_test_8bit=wrong).to_csv(folder / name, index=False)
    right = trials["right"].where(trials["side"] != "test_8bit", 0.0)
    trials.assign(right=right).to_csv(folder / "baselines_trials.csv", index=False)
    monkeypatch.setattr(front.answers, "answer", lambda *given, **more: asked.append(given) or answer(*given, **more))
    page = report.write(folder).read_text(encoding="utf-8").replace("\xa0", " ")
    assert "baselines are chosen anew, accuracy on test windows falls (1&amp;1 ms with 6 neurons" in page
    assert all(
        words in page for words in (" to 12.5 %; ", " to 0.0 %; ", "with 8-bit weights has 12.5 % on test windows")
    )
    (networks, before, _, _, compare, *_), (_, after, _, _, compare_rounded, *_) = asked
    assert {one.accuracy for one in after} == {0.0} != {one.accuracy for one in before}
    assert compare(networks[0], before[0]) != compare_rounded(networks[0], after[0])
