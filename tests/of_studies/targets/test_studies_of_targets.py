"""Studies whose networks tell numbers or detect events: what they train on, what they refuse, what they answer."""

import itertools
import json
import math
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from browser import browser
from hypothesis import given
from hypothesis import strategies as st
from in_process import studies_here, typed, without_pictures
from levels import examples, thinned
from neurotact_parts.streams import detector
from neurotact_parts.streams.detector import DetectorSpec, Heard
from neurotact_parts.streams.long_recordings import parts_of_recordings
from neurotact_parts.studies.targets import engine, report, rivals, trials, words
from neurotact_parts.studies.targets.rivals import EVERY_MS, Sliding, values_of
from neurotact_parts.studies.targets.ways import Compared, Way, networks_of, rivals_of
from sklearn.base import BaseEstimator, ClassifierMixin

import neurotact as nt
from neurotact import spec as specs
from neurotact.baselines import opponents
from neurotact.baselines.opponent import Opponent, Sides, best_of
from neurotact.baselines.opponents import Cuts, Input
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec
from neurotact.data.windows import Windows, WindowSpec
from neurotact.errors import InputError
from neurotact.metrics.flops import Cost, Dense
from neurotact.metrics.prices import MEMORY_45NM
from neurotact.networks.definition.specs import RSNNSpec, TrainingSpec
from neurotact.networks.training import tasks
from neurotact.networks.training.tasks import Task
from neurotact.studies import loading, preparation, runner, tables_beside
from neurotact.studies.cell import run_cell, task_of
from neurotact.studies.store import cell_folder, result_of

FEW = {
    "calibrate": False,
    "encoder.conditioning.baseline": "start",
    "encoder.sa1.gain": 8.0,
    "encoder.ra1.gain": 60.0,
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[5, 5]],
    "sweep.network.hidden": [0],
    "baselines": "linear",
    "seed": 0,
}
AS_TYPED = [word for key, value in FEW.items() for word in ("--set", f"{key}={json.dumps(value)}")]


def presses(n=40, seed=0, **columns) -> Recordings:
    """Presses of a force, each held for 150 ms at a speed that changes nothing."""
    rng = np.random.default_rng(seed)
    force = rng.uniform(1, 5, n).round(3)
    signals = rng.normal(0, 0.05, (n, 300, 2))
    signals[:, 100:250] += force[:, None, None] * np.array([1.0, 0.6])
    table = {"label": ["press"] * n, "force_N": force, "speed": np.resize([1, 2], n), "same": 7.0, "who": "me"}
    return Recordings(signals.astype(np.float32), 1000.0, "mV", pd.DataFrame({**table, **columns}))


def slips(n=12, seed=0, duration_s=6.0) -> Recordings:
    """Recordings of rest, contact and a slip in it, which shakes the sensor."""
    rng = np.random.default_rng(seed)
    signals, rows = rng.normal(0, 0.05, (n, round(1000 * duration_s), 2)), []
    for trial in range(n):
        for begin in np.arange(0.6, duration_s - 1.6, 2.0) + rng.uniform(0, 0.3):
            at = [round(1000 * time) for time in (begin, begin + 0.5, begin + 1.0)]
            signals[trial, at[0] : at[2]] += 3.0
            signals[trial, at[1] : at[2], 0] += 4 * np.sin(np.arange(at[2] - at[1]) / 4)
            rows += [(trial, begin, begin + 0.5, "contact"), (trial, begin + 0.5, begin + 1.0, "slip")]
    marks = pd.DataFrame(rows, columns=["trial", "start_s", "stop_s", "label"])
    table = pd.DataFrame({"label": ["session"] * n, "force_N": np.arange(n) + 1.0})
    return Recordings(signals.astype(np.float32), 1000.0, "mV", table, marks=marks)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with recordings of presses and of slips, and a study of each, run as typed."""
    folder = tmp_path_factory.mktemp("targets")
    hdf5.save_recordings(presses(), folder / "presses.h5")
    hdf5.save_recordings(slips(), folder / "slips.h5")
    return folder


@pytest.fixture(scope="module")
def numbers(place):
    return ran(place, "presses", "--target", "force_N", "--target", "speed")


@pytest.fixture(scope="module")
def events(place):
    few = ["sweep.network.hidden=[12]", "split.seed=1", "network.training.epochs=4"]
    more = [word for key in few for word in ("--set", key)]
    return ran(place, "slips", "--target", "events", "--false-alarms-per-h", "300", *more)


def ran(place, name, *options):
    with studies_here() as patch:
        without_pictures(patch)
        command = ["study", "run", "own-recordings", "--quick", "--data", f"{name}.h5", "-o", name]
        done = typed(*command, *AS_TYPED, *options, cwd=place)
    assert done.code == 0, done.err
    answer = json.loads((place / name / "answer.json").read_text())["answers"][0]
    return SimpleNamespace(done=done, folder=place / name, answer=answer, study=runner.load(place / name))


def test_a_study_of_numbers_says_how_exactly_how_soon_and_at_what_cost(numbers):
    out, answer = numbers.done.out, numbers.answer
    for what in ("error of force_N: ", "error of speed: ", "score: ", "energy per answer: ", "time to answer: "):
        assert f"\n{what}" in out
    assert answer["short"] in out.splitlines()[-1]
    network, results = answer["network"], pd.read_csv(numbers.folder / "results.csv").iloc[0]
    for key in ("rmse_force_N", "r2_force_N", "rmse_speed"):
        assert network[key] == pytest.approx(results[key])
    assert network["score"] == pytest.approx(results["accuracy_test"])
    assert network["rmse_force_N_low"] < network["rmse_force_N"] < network["rmse_force_N_high"]
    assert network["energy_nJ"] > 0
    assert answer["rival"]["name"].startswith("ridge regression on ")
    assert answer["test_trials"] == 6


def test_a_study_of_numbers_says_what_early_exit_saves_and_loses(numbers):
    results, told = (pd.read_csv(numbers.folder / f"{name}.csv") for name in ("results", "told"))
    early, row = numbers.answer["early_exit"], results.iloc[0]
    assert early["ms"] == pytest.approx(
        1000 * row["exit_steps"] / hdf5.load_spikes(spikes_of(numbers)).sampling_rate_Hz
    )
    assert early["score"] == pytest.approx(row["exit_accuracy"])
    error = told["early_force_N"] - told["true_force_N"]
    assert early["rmse_force_N"] == pytest.approx((error**2).mean() ** 0.5) == pytest.approx(row["exit_rmse_force_N"])
    assert early["energy_nJ"] <= numbers.answer["network"]["energy_nJ"]
    said = f"Early exit is {'used' if early['used'] else 'not used'}: "
    assert sum(line.startswith(said) for line in numbers.answer["details"]) == 1


def spikes_of(found):
    return found.folder / next(engine.cells(found.study)).given


@pytest.mark.parametrize("bound", [0.004, 0.5, math.nan])
def test_early_exit_is_in_the_answer_where_the_bound_of_its_loss_allows_it(bound, numbers):
    cell, target = next(engine.cells(numbers.study)), ["force_N", "speed"]
    whole = {"whole_ms": 300.0, "whole_nJ": 6.0, "whole_sops": 9.0, "whole_spikes": 8.0}
    early = {"early_ms": 120.0, "early_nJ": 4.0, "early_sops": 3.0, "early_spikes": 2.0}
    rows = pd.DataFrame([{"pair": "5", "hidden": 0, **whole, **early}])
    (way,) = networks_of(numbers.folder, rows, [cell], target)
    assert way.early is not None
    assert way.nJ == 6.0
    assert (way.early.way.nJ, way.early.way.sops, way.early.way.found["ms"]) == (4.0, 3.0, 120.0)
    way = way._replace(early=way.early._replace(bound=bound))
    page = words.screen("touch", Compared.of([way], []), target, "a list", "cells/a")
    (figure,) = (one for one in page.figures if one.what == "time to answer")
    is_used = bound <= 0.01
    assert figure.value == ("120 ms" if is_used else "300 ms")
    assert ("energy 4 nJ" in figure.of and figure.of.endswith("300 ms without")) == is_used
    assert page.numbers["early_exit"]["used"] == is_used
    assert sum("with early exit" in row[0] for row in page.tables[0].rows) == is_used
    known = "no rule saves steps" if math.isnan(bound) else f"it may lose up to {bound:.2g} of the score"
    assert any(line.startswith(f"Early exit is {'' if is_used else 'not '}used: {known}") for line in page.details)


def test_a_study_of_events_says_how_many_how_soon_how_often_wrong_and_at_what_cost(events):
    out, answer = events.done.out, events.answer
    for what in ("events found: ", "delay: ", "false alarms: ", "energy per second: "):
        assert f"\n{what}" in out
    network, row = answer["network"], pd.read_csv(events.folder / "results.csv").iloc[0]
    for key in ("hits", "misses", "false_alarms", "false_alarms_per_h", "delay_ms", "hit_share"):
        assert network[key] == pytest.approx(row[key], nan_ok=True)
    assert answer["rival"]["hits"] > 0
    listed = pd.read_csv(events.folder / "events.csv")
    assert (listed["outcome"] == "hit").sum() == row["hits"]
    assert answer["network"]["chosen_on_s"] == 60.0  # ten recordings of 6 s were not tested


def test_a_detector_costs_by_the_second_and_seeds_are_no_further_events(events):
    network, row = events.answer["network"], pd.read_csv(events.folder / "results.csv").iloc[0]
    assert network["sops"] == pytest.approx(row["sops_total"] / 0.3)
    (cell,) = engine.cells(events.study)
    assert task_of(cell).false_alarms_per_h == 300
    rows = pd.DataFrame({"pair": "5", "hidden": [12, 12], "whole_ms": 300.0, "whole_nJ": 6.0, "whole_sops": 1.0,
                         "whole_spikes": 1.0})  # fmt: skip
    (twice,) = networks_of(events.folder, rows, [cell, cell], ["events"])
    for key in ("hits", "misses", "false_alarms", "tested_s", "hit_share_low"):
        assert twice.found[key] == pytest.approx(network[key])
    assert twice.nJ == pytest.approx(20.0)


@thinned("kind", ["numbers", "events"])
def test_networks_are_chosen_by_validation_trials(kind, request):
    found = request.getfixturevalue(kind)
    cell = next(engine.cells(found.study))
    sides = tasks.trials_of(hdf5.load_spikes(found.folder / cell.given), task_of(cell))
    result = result_of(found.folder, cell)
    assert {*map(int, result["held"])} == {*sides.validation.tolist()}
    assert {*map(int, result["right"])} == {*sides.test.tolist()}


@thinned("kind", ["numbers", "events"])
def test_a_study_is_reported_again_and_resumed_as_it_was(kind, request):
    found = request.getfixturevalue(kind)
    before = {name: (found.folder / name).read_bytes() for name in ("answer.json", "results.csv", "ways.csv")}
    with studies_here() as patch:
        without_pictures(patch)
        for word in ("report", "resume"):
            done = typed("study", word, found.folder)
            assert done.code == 0, done.err
            assert done.out.splitlines()[-1] == found.done.out.splitlines()[-1]
    assert {name: (found.folder / name).read_bytes() for name in before} == before
    page = (found.folder / "report.html").read_text().replace("\xa0", " ")
    assert found.answer["short"] in page


@pytest.mark.parametrize("kind", ["numbers", "events"])
def test_a_study_that_a_run_wrote_is_the_same_study(kind, request, monkeypatch):
    """Also where its folds are others than those that detectors have by themselves."""
    found = request.getfixturevalue(kind)
    monkeypatch.chdir(found.folder.parent)
    path = found.folder / "study.toml"
    assert loading.resolve(path) == found.study
    table = specs.read(path)
    renamed, earlier = found.folder.parent / f"{kind}-renamed.toml", found.folder.parent / f"{kind}-earlier.toml"
    renamed.write_text(specs.to_toml({**table, "notes": ["Of a run."]}))
    assert loading.resolve(renamed) == found.study.model_copy(update={"notes": ("Of a run.",)})
    earlier.write_text(specs.to_toml({key: value for key, value in table.items() if key != "as_run"}))
    assert loading.resolve(earlier) == found.study.model_copy(update={"as_run": False})
    folds = {"split.folds": 3, "sweep.split.fold": [0, 1, 2], "sweep.seed": [0]}
    other = found.folder.parent / f"{kind}.toml"
    other.write_text(specs.to_toml(loading.resolve(path, folds).model_dump(mode="json", exclude_none=True)))
    assert loading.resolve(other) == loading.resolve(path, folds)
    longer = loading.resolve(path, {"window.length_ms": 400.0})
    assert longer.window.length_ms == 400.0
    assert longer.title == found.study.title


def test_the_network_of_a_study_tells_numbers_outside_of_it(numbers):
    chosen = numbers.folder / numbers.answer["chosen_folder"]
    cell = next(engine.cells(numbers.study))
    told = nt.infer(chosen, numbers.folder / cell.given)
    test = told[told["split"] == "test"] if "split" in told else told[told["side"] == "test"]
    wrong = test["predicted_force_N"] - test["true_force_N"]
    assert np.sqrt(np.square(wrong).mean()) == pytest.approx(numbers.answer["network"]["rmse_force_N"], rel=1e-4)


def test_networks_and_rivals_are_compared_by_one_score(numbers):
    """A rival's score is of its error in units of the training deviation, as a network's."""
    cell = next(engine.cells(numbers.study))
    trains, task = hdf5.load_spikes(numbers.folder / cell.given), task_of(cell)
    sides = tasks.sides_of(trains, task)
    deviation = sides.test.deviation.numpy()
    rows = pd.read_csv(numbers.folder / "baselines.csv")
    squares = sum((rows[f"rmse_{name}"] / deviation[k]) ** 2 for k, name in enumerate(task.numbers)) / 2
    assert rows["accuracy_test"].to_numpy() == pytest.approx((1 - squares).to_numpy(), abs=1e-5)


def test_the_error_of_a_rival_is_over_all_windows_of_unequal_folds(numbers):
    """As that of a network is; a mean over folds would count the windows of a small one for more."""
    rows = pd.read_csv(numbers.folder / "baselines.csv").iloc[[0, 0]].reset_index(drop=True)
    rows = rows.assign(n_test=[2, 10], rmse_force_N=[1.0, 3.0])
    trials = pd.DataFrame({"baseline": [0, 0], "side": ["validation", "test"], "trial": [0, 1], "right": [0.5, 0.5]})
    tables = {"baselines": rows, "baselines_trials": trials}
    (rival,) = rivals_of(tables, numbers.study, ["force_N"], rows.iloc[0].to_dict())
    assert rival.found["rmse_force_N"] == pytest.approx(((2 * 1 + 10 * 9) / 12) ** 0.5)


# What it trains on


def test_networks_of_a_study_are_those_of_a_training_outside_of_it(numbers, tmp_path):
    """The recipe knows that they tell numbers."""
    few = next(engine.cells(numbers.study)).model_copy(
        update={"network": RSNNSpec(recipe="default", hidden=3, training=TrainingSpec(epochs=1))}
    )
    spikes = numbers.folder / few.given
    left = run_cell(few, hdf5.load_spikes(spikes))
    settings = {"hidden": 3, "training.epochs": 1}
    learn = nt.Learn(target=few.source["target"])
    window = nt.Window(length_ms=few.window.length_ms, per_trial=1)
    nt.train(spikes, tmp_path / "run", settings=settings, window=window, learn=learn)
    saved = json.loads((tmp_path / "run" / "network.json").read_text())["spec"]
    mine = json.loads(left["network.json"])["spec"]
    assert saved["readout_stretches"] == mine["readout_stretches"]
    assert saved["training"]["loss"] == mine["training"]["loss"]


@given(
    st.integers(0, 50),
    st.sampled_from([{}, {"folds": 3, "fold": 1}, {"group": ("speed",)}, {"test_where": {"speed": 2}}]),
)
@examples(15)
def test_gains_are_calibrated_on_the_trials_that_networks_train_on(seed, split):
    touches = presses(seed=seed, **({"speed": np.resize(range(6), 40)} if "group" in split else {}))
    task = Task(target=["force_N"], split=SplitSpec(**{"seed": seed, **split}), window=WindowSpec(length_ms=100))
    encoded = nt.encode(touches, settings={"sa1.gain": 8.0, "ra1.gain": 60.0})
    assert tasks.split_of(touches, task).train.tolist() == tasks.trials_of(encoded, task).train.tolist()


def test_no_test_trial_reaches_the_calibration(place, monkeypatch):
    seen = []

    def fit(training, start, **_):
        seen.append(training)
        return SimpleNamespace(encoder=start)

    monkeypatch.setattr(preparation, "calibration_for", lambda *_, **__: (fit, 1))
    changes = {key: value for key, value in FEW.items() if not key.startswith(("calibrate", "encoder"))}
    for name, target in (("presses", ["force_N"]), ("slips", ["events"])):
        more = {"sweep.network.hidden": [4], "split.seed": 3} if target == ["events"] else {}
        given = {**changes, **more, "way": "targets", "parameters": {"target": target}}
        what = loading.resolve("own-recordings", given, data=place / f"{name}.h5")
        cell = next(loading.engine_of(what).cells(what))
        recordings = preparation.recordings_of(what, cell)
        preparation.encoder_of(cell, recordings, {})
        split = tasks.split_of(recordings, task_of(cell))
        known = {recordings.signals[trial].tobytes() for trial in split.train}
        if target == ["events"]:  # stretches of them, behind their beginning
            heads = {recordings.signals[trial][:200].tobytes() for trial in split.train}
            assert {signal[:200].tobytes() for signal in seen[-1].signals} <= heads
            assert {*seen[-1].classes} == {"none", "contact", "slip"}
        else:
            assert {signal.tobytes() for signal in seen[-1].signals} == known
            assert len(seen[-1].classes) > 1


@given(st.lists(st.floats(0, 100).map(lambda x: round(x, 1)), min_size=20, max_size=80).filter(lambda v: len({*v}) > 1))
@examples(30)
def test_ranges_hold_every_trial_once_and_do_not_overlap(values):
    table = pd.DataFrame({"label": "x", "force_N": values})
    ranged = trials.with_ranges(Recordings(np.zeros((len(values), 5, 1)), 100.0, "mV", table), "force_N")
    labels = ranged.conditions["label"]
    assert labels.nunique() >= 2
    ends = sorted((own["force_N"].min(), own["force_N"].max()) for _, own in ranged.conditions.groupby(labels))
    assert all(before[1] < after[0] for before, after in itertools.pairwise(ends))


def test_ranges_are_of_the_first_number_also_where_most_trials_have_the_same():
    touches = presses(speed=[1] * 3 + [2] * 37)
    for target in (["speed", "force_N"], ["force_N", "speed"]):
        ranged = trials.classes_of_target(touches, Task(target=target))
        assert all(label.startswith(target[0]) for label in ranged.classes)
        assert len(ranged.classes) == (2 if target[0] == "speed" else 4)


def test_few_long_recordings_are_cut_outside_of_marks_and_lose_nothing():
    touches = slips(n=2, duration_s=20.0)
    parts = parts_of_recordings(touches)
    assert len(parts) == 10
    assert sum(parts.lengths) == sum(touches.lengths)
    assert parts.marks is not None
    assert touches.marks is not None
    assert len(parts.marks) == len(touches.marks)
    begins = parts.conditions["part_begin_s"].to_numpy()[parts.marks["trial"]]
    assert sorted(begins + parts.marks["start_s"]) == pytest.approx(sorted(touches.marks["start_s"]))
    assert parts_of_recordings(slips(n=10, duration_s=3.0)).lengths.tolist() == [3000] * 10


def test_each_recording_of_detectors_is_tested_once_and_each_has_a_hidden_layer(place):
    given = {"way": "targets", "parameters": {"target": ["events"]}}
    touches = hdf5.load_recordings(place / "slips.h5")
    for quick, sizes in ((True, {20}), (False, {20, 50})):
        what = loading.resolve("own-recordings", given, quick=quick, data=place / "slips.h5")
        cells = [*loading.engine_of(what).cells(what)]
        assert {cell.network.hidden for cell in cells} == sizes
        splits = {cell.split.model_dump_json(): tasks.split_of(touches, task_of(cell)).test for cell in cells}
        assert sorted(np.concatenate([*splits.values()]).tolist()) == [*range(12)]
        assert {(cell.window.per_trial, cell.window.hop_ms, cell.network.model) for cell in cells} == {
            (None, 75, "snn")
        }
    what = loading.resolve("own-recordings", {**given, "split.test": 0.3}, data=place / "slips.h5")
    assert "split.fold" not in what.sweep


# Rivals


def test_a_rival_that_knows_the_truth_finds_every_event_at_once():
    touches = slips(n=10)
    task = Task(target=["events"], window=WindowSpec(length_ms=300, hop_ms=75), false_alarms_per_h=0)
    trains = nt.encode(touches, settings={"sa1.gain": 8.0, "ra1.gain": 60.0, "conditioning.baseline": "start"})
    sliding = Sliding.of(trains, task)
    truth = np.eye(3)[sliding.labels]
    every = sliding.heard(truth, range(10))
    rule = detector.rule_for(every, task)
    found = detector.tally(every, rule)
    late = [begin for one in every for _, begin, _ in one.marked if begin < 0.3]
    assert (found.missed, found.false_alarms, late) == (0, 0, [])
    assert rule.steps == 1
    assert found.delays_ms.min() >= 0
    assert found.delays_ms.max() <= EVERY_MS
    assert detector.scores(every, rule) == dict.fromkeys(range(10), 1.0)
    apart = np.diff(sliding.cuts.windows.start[sliding.cuts.sides[0]])
    assert {*apart[apart > 0]} == {80}  # near the hop of the network's windows


def test_the_rule_of_a_rival_knows_no_test_recording():
    touches = slips(n=10)
    task = Task(target=["events"], window=WindowSpec(length_ms=300, hop_ms=75), false_alarms_per_h=300)
    trains = nt.encode(touches, settings={"sa1.gain": 8.0, "ra1.gain": 60.0, "conditioning.baseline": "start"})
    sliding = Sliding.of(trains, task)
    (one, *_) = opponents.spike_inputs(trains, (5.0, 5.0), sliding.cuts, "linear")
    rival = one.opponents["logistic regression"]
    tested = np.isin(sliding.cuts.windows.trial, sliding.parts.test)
    mixed = np.where(tested[:, None], np.random.default_rng(0).permutation(one.features), one.features)
    rows = [rivals._row(each, "rival", rival, sliding, MEMORY_45NM) for each in (one, one._replace(features=mixed))]
    for key in ("detector_threshold", "detector_steps"):
        assert rows[0][key] == rows[1][key]
    assert rows[0][opponents.RIGHT]["validation"] == rows[1][opponents.RIGHT]["validation"]
    assert rows[0][opponents.RIGHT]["test"] != rows[1][opponents.RIGHT]["test"]
    assert np.mean([*rows[0][opponents.RIGHT]["validation"].values()]) > 0.5
    assert rows[0]["nJ_per_s"] > 0


def test_the_rule_of_a_rival_is_chosen_on_recordings_that_it_was_not_fitted_to():
    """A rival that knows by heart the windows that it was fitted to, and nothing else."""
    touches = slips(n=10)
    task = Task(target=["events"], window=WindowSpec(length_ms=300, hop_ms=75), false_alarms_per_h=100)
    trains = nt.encode(touches, settings={"sa1.gain": 8.0, "ra1.gain": 60.0, "conditioning.baseline": "start"})
    sliding = Sliding.of(trains, task)
    trial, fitted = sliding.cuts.windows.trial, []

    class ByHeart(ClassifierMixin, BaseEstimator):
        def fit(self, x, y):
            self.classes_, self.known_ = np.arange(3), {*x[:, 0].round(6)}
            fitted.append({*trial[np.isin(place.round(6), [*self.known_])]})
            return self

        def predict_proba(self, x):
            return np.stack([[0.0, 0, 0]] * len(x)) + np.isin(x[:, :1].round(6), [*self.known_]) * np.array([[0, 1, 0]])

        def predict(self, x):
            return self.predict_proba(x).argmax(axis=1)

    features = np.arange(len(trial), dtype=float)[:, None]
    train = sliding.cuts.sides[0]
    place = (features[:, 0] - features[train].mean()) / features[train].std()
    made = Input("spikes", "made", (5.0, 5.0), features, Cost(), {})
    row = rivals._row(made, "rival", Opponent("By heart.", ByHeart), sliding, MEMORY_45NM)
    assert fitted[0] == {*sliding.parts.train}
    assert all(one < fitted[0] for one in fitted[1:])
    assert sorted(np.concatenate([[*(fitted[0] - one)] for one in fitted[1:]])) == sliding.parts.train.tolist()
    held = len(sliding.parts.train) + len(sliding.parts.validation)
    assert row["chosen_on_s"] == pytest.approx(6.0 * held)
    assert row["chosen_with_false_alarms"] == 0  # what it says of windows by heart is nowhere in them


def test_what_a_rival_was_not_trained_on_has_its_least_value():
    fitted = SimpleNamespace(classes_=np.array([0, 2]), predict_proba=lambda x: np.array([[0.9, 0.1]] * len(x)))
    assert np.allclose(np.exp(values_of(fitted, np.zeros((2, 1)), 3)), [[0.901, 0.101, 0.101]] * 2)


def test_a_linear_machine_stands_for_that_of_votes(events, place, monkeypatch):
    monkeypatch.setattr(
        rivals, "_row", lambda _one, name, rival, *_: {"classifier": name, "is": rival, "t_ref_ra_ms": None}
    )
    study, recordings = events.study.model_copy(update={"baselines": "quick"}), hdf5.load_recordings(place / "slips.h5")
    (cell,) = engine.cells(study)
    rows = [*rivals.rows_of(events.folder, recordings, study, cell, [cell], is_first=True)]
    assert {row["classifier"] for row in rows} == {"logistic regression", "linear SVM", "ELM", "extra trees"}
    assert [row["is"] for row in rows if row["classifier"] == "linear SVM"] == [rivals.LINEAR_SVM] * 4
    x, y = np.array([[0.0], [0.1], [1.0], [1.1]]), np.array([0, 0, 1, 1])
    fitted = best_of(rivals.LINEAR_SVM, Sides(x, x, x, y, y, y), 0)
    told = values_of(fitted.fitted, x, 2)
    assert (told.argmax(axis=1) == y).all()
    assert fitted.layers == (Dense(1, 1),)  # whose sign tells both


@pytest.mark.parametrize("kind", ["numbers", "events"])
def test_rivals_on_spikes_are_compared_with_networks_on_the_same_spikes(kind, request, place):
    """Of a sweep over a key of the encoder, each value has rivals of its own, and those on signals stand beside all."""
    run, key = request.getfixturevalue(kind), "encoder.tau_mem_ms"
    study = run.study.model_copy(update={"sweep": {**run.study.sweep, key: [5.0, 50.0]}, "baselines": "readout"})
    recordings = hdf5.load_recordings(place / f"{run.folder.name}.h5")
    name = next(engine.cells(run.study)).spikes_name
    for cell in engine.cells(study):  # their spikes differ in a study; here each is at the place of its own
        if cell.spikes_name != name and not (run.folder / cell.given).exists():
            shutil.copy(run.folder / f"spikes/{name}.h5", run.folder / cell.given)
    cells = [*{cell.spikes_name: cell for cell in engine.cells(study)}.values()]
    made = (
        tables_beside.rows_of(run.folder, recordings, study, cell, [cell], is_first=cell is cells[0]) for cell in cells
    )
    rows = pd.DataFrame([*itertools.chain(*made)])
    of_spikes = rows["input"].str.startswith("spikes")
    assert rows[key].isna().equals(~of_spikes)
    assert set(rows.loc[of_spikes, key]) == {5.0, 50.0}
    scores = {5.0: 0.25, 50.0: 0.75}
    trials = pd.DataFrame(
        [(at, side, trial, scores.get(row[key], 0.5)) for at, row in rows.iterrows()
         for side in ("validation", "test") for trial in range(3)],
        columns=["baseline", "side", "trial", "right"],
    )  # fmt: skip
    target = engine.parameters_of(study.parameters).target
    tables = {"baselines": rows.drop(columns=opponents.RIGHT), "baselines_trials": trials}
    for value, score in scores.items():
        found = [*rivals_of(tables, study, target, {key: value})]
        assert {np.mean([*one.tested.values()]) for one in found if one.of_signals} == {0.5}
        assert {np.mean([*one.tested.values()]) for one in found if not one.of_signals} == {score}


@given(st.lists(st.sampled_from(["hit", "miss", "false alarm", "quiet"]), min_size=1, max_size=6))
def test_the_score_of_a_recording_is_its_share_of_hits_among_events_and_false_alarms(what):
    """Each second of a recording holds an event that is found, one that is missed, a false alarm, or nothing."""
    values, marked = np.tile([1.0, 0.0], (10 * len(what), 1)), []
    for second, kind in enumerate(what):
        begin = 10 * second + 3
        if kind in ("hit", "false alarm"):
            values[begin : begin + 3] = [0.0, 1.0]
        if kind in ("hit", "miss"):
            marked.append((1, begin / 10, (begin + 5) / 10))
    one = Heard(4, values, 0.1, len(what), marked)
    counted = [kind for kind in what if kind != "quiet"]
    expected = counted.count("hit") / len(counted) if counted else 1.0
    assert detector.scores([one], DetectorSpec(threshold=0, steps=1)) == {4: pytest.approx(expected)}


@given(st.integers(0, 30))
@examples(10)
def test_rivals_of_numbers_err_in_units_and_score_in_deviations(seed):
    rng = np.random.default_rng(seed)
    x, labels = rng.normal(size=(60, 3)), rng.normal(5, 20, (60, 2)).astype(np.float32)
    sides = tuple(np.repeat(np.arange(3), 20) == side for side in range(3))
    cuts = Cuts(Windows(np.arange(60), np.zeros(60, int), 10), 1000.0, sides, tells="numbers")
    ridge = opponents.joined("features", "linear", "numbers")
    (row,) = opponents.rows([Input("signals", "made", None, x, Cost(), ridge)], labels, cuts)
    deviation = labels[sides[0]].astype(float).std(axis=0)
    squares = (np.array(row[opponents.ERRORS]) / deviation) ** 2
    assert row["accuracy_test"] == pytest.approx(1 - squares.mean())
    assert np.mean([*row[opponents.RIGHT]["test"].values()]) == pytest.approx(row["accuracy_test"])
    assert (np.array(row[opponents.ERRORS]) > 0.2 * deviation).all()  # the inputs tell nothing


# The referee and its words


def way(kind, score, nJ=10.0, source="signals (made)", n=12, cells=()):
    each = {str(trial): score + 0.01 * (trial % 3) for trial in range(n)}
    found = {"rmse_force_N": 1 - score, "rmse_force_N_low": 0.1, "rmse_force_N_high": 0.9, "mae_force_N": 0.2,
             "r2_force_N": score, "ms": 100.0}  # fmt: skip
    return Way(kind, source, each, each, nJ, found, 5.0, 6.0, cells)


NETWORK = way("network, 20 neurons", 0.8, 30.0, "spikes of 5&5 ms", cells=(None,))


@pytest.mark.parametrize(
    ("score", "kind", "lead"),
    [
        (0.5, "better", "Spiking is more exact"),
        (0.95, "worse", "Spiking costs exactness"),
        (0.8, "tie", "No clear difference"),
    ],
)
def test_the_verdict_is_one_sentence_with_both_errors(score, kind, lead):
    compared = Compared.of([NETWORK], [way("ridge regression", score)])
    assert compared.kind == kind
    said = words.screen("all", compared, ["force_N"], "memory-45nm", "cells/a")
    assert said.verdict.startswith(lead)
    assert ("; spiking takes 3 times as much energy as ridge regression" in said.verdict) == (kind == "tie")
    assert ": the chosen network errs by 0.2 N of force (95 % interval 0.1 to 0.9)" in said.verdict
    assert f"by {1 - score:.3g} N" in said.verdict
    assert said.verdict.count(". ") == 0


@pytest.mark.parametrize(("apart_ms", "said"), [(-40.0, "40 ms sooner"), (40.0, "40 ms later"), (0.0, "")])
def test_detectors_that_find_as_much_are_told_apart_by_their_delays(apart_ms, said):
    found = {"hits": 9, "events_test": 10, "delay_ms": 100.0, "false_alarms_per_h": 5.0}
    rival = way("ELM", 0.8)._replace(found=found, delays_ms={str(n): 100.0 + n for n in range(12)})
    ours = NETWORK._replace(found=found, delays_ms={str(n): 100.0 + n + apart_ms for n in range(12)})
    told = words._Events(Compared.of([ours], [rival])).verdict()
    assert told.startswith("No clear difference in what is found")
    assert (said or "no more") in told if said else "ms later" not in told


@pytest.mark.parametrize("allowed", [5.0, 20.0])
def test_a_detector_with_more_false_alarms_than_were_allowed_is_told_of(allowed):
    found = {"false_alarms_per_h": 30.0, "false_alarms_per_h_low": 12.0}
    compared = Compared.of([NETWORK._replace(found=found)], [])
    of = SimpleNamespace(parameters={"target": ["events"], "false_alarms_per_h": allowed})
    told = [*report._alarms({"all": compared}, of)]
    assert [line.startswith("the chosen detector has 30 false alarms an hour") for line in told] == [True] * (
        allowed < 12
    )
    for heard_s, cannot in ((3599 * 3 / allowed, True), (3601 * 3 / allowed, False)):
        heard = Compared.of([NETWORK._replace(found={"false_alarms_per_h": 0.0, "chosen_on_s": heard_s})], [])
        told = [*report._alarms({"all": heard}, of)]
        most = 3.689 * 3600 / heard_s
        assert [f"as {allowed:g} an hour: without one in them, up to {most:.3g} are" in line for line in told] == [
            True
        ] * cannot


def test_nothing_is_learned_where_the_mean_does_as_well():
    compared = Compared.of([way("network", -0.015, source="spikes", cells=(None,))], [way("ridge regression", 0.5)])
    assert compared.kind == "nothing learned"
    assert "Nothing was learned" in words.screen("all", compared, ["force_N"], "p", "c").verdict


def test_the_cheapest_within_the_error_is_chosen_on_validation_and_energy_compared_with_the_cheapest_fair_rival():
    dear = NETWORK._replace(kind="network, 50 neurons", nJ=90.0, held={**NETWORK.held, "0": 0.81})
    fair, poor = way("ridge regression", 0.8, 3.0), way("extra trees regression", 0.2, 1.0)
    compared = Compared.of([dear, NETWORK], [fair, poor])
    assert compared.best is dear
    assert compared.chosen is NETWORK
    assert compared.comparable is fair
    (figure,) = (one for one in words.screen("all", compared, ["force_N"], "p", "c").figures if "energy" in one.what)
    assert figure.against.startswith("10 times as much as ridge regression")


@pytest.mark.parametrize(("chosen", "which"), [("5&5", "it"), ("1&1", "5&5 ms")])
def test_the_first_screen_tells_the_period_and_what_it_saves(chosen, which):
    spent = {"1&1": 40.0, "5&5": 30.0, "10&10": 20.0}
    held = {pair: NETWORK.held if pair == chosen else dict.fromkeys(NETWORK.held, 0.5) for pair in spent}
    held["5&5"] = {name: max(0.6, held["5&5"][name]) for name in NETWORK.held}
    every = [NETWORK._replace(nJ=nJ, sops=nJ, pair=pair, held=held[pair], source=f"spikes of {pair} ms")
             for pair, nJ in spent.items()]  # fmt: skip
    said = words.screen("all", Compared.of(every, []), ["force_N"], "p", "c").period
    assert said.startswith(
        f"Validation prefers a refractory period of {chosen} ms: beside 1&1 ms, both with 20 neurons, "
    )
    assert f", {which} takes 25 % fewer SOPs and 25 % less energy, and has a score of 0.810 against 0.810, no" in said
    one = [NETWORK._replace(pair="5&5"), NETWORK._replace(pair="1&1", kind="network, no hidden layer")]
    assert words.screen("all", Compared.of(one[:1], []), ["force_N"], "p", "c").period == ""
    assert words.screen("all", Compared.of(one, []), ["force_N"], "p", "c").period == ""


def test_the_first_five_rows_are_the_chosen_network_and_the_best_rivals():
    others = [way(f"rival {n}", 0.5 + 0.01 * n, 3.0) for n in range(20)]
    (table,) = words.screen("all", Compared.of([NETWORK], others), ["force_N"], "p", "c").tables
    assert [row[0].partition(" on ")[0] for row in table.few.rows] == [
        "network, 20 neurons", "rival 19", "rival 18", "rival 17", "rival 16",
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["numbers", "events"])
def test_the_next_step_tests_every_trial_and_then_takes_the_network_along(kind, request):
    found = request.getfixturevalue(kind)
    page = (found.folder / "report.html").read_text()
    again = f"neurotact study run {found.folder}/study.toml --folds 5 -o {found.folder}-folds"
    assert (again in page) == (found.study.split == SplitSpec())
    split = SplitSpec(folds=5)
    folded = found.study.model_copy(update={"split": split})
    said, commands = report._next(folded, found.folder, "cells/a")
    file = found.study.dataset.file
    export = f"neurotact export {found.folder}/cells/a --to c --recordings {file} -o {found.folder}/c"
    assert (said, commands) == (("Take the chosen network along, as C:", [export]) if kind == "numbers" else ("", ()))


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1400, "light")])
@pytest.mark.parametrize("kind", ["numbers", "events"])
def test_in_a_browser_a_page_has_five_rows_and_is_accessible(kind, width, scheme, request, tmp_path):
    with browser(tmp_path / "profile") as chromium:
        chromium.open(request.getfixturevalue(kind).folder / "report.html", width, scheme=scheme)
        chromium.wait_for("document.querySelector('#plot .points path')")
        assert chromium.evaluate("document.querySelector('#answer .scroll tbody').rows.length") <= 5
        chromium.assert_accessible()
        assert chromium.evaluate("document.documentElement.scrollWidth") <= width
        assert chromium.complaints == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scores", "is_bent"), [((0.6, 0.998), True), ((-2.0, 0.95), True), ((0.6, 0.7), False), ((0.6, 1.0), False)]
)
def test_in_a_browser_scores_near_1_have_room(scores, is_bent, numbers, tmp_path):
    given = iter(scores)
    page = tmp_path / "report.html"
    page.write_text(re.sub(r'"y":[0-9.]+', lambda _: f'"y":{next(given)}', (numbers.folder / page.name).read_text()))
    with browser(tmp_path / "profile") as chromium:
        chromium.open(page, 1400)
        chromium.wait_for("document.querySelector('#plot .points path')")
        drawn = dict(chromium.evaluate(
            "document.getElementById('plot').data.flatMap((t) => (t.customdata ?? []).map((i, at) => [i, t.y[at]]))"
        ))  # fmt: skip
        axis = chromium.evaluate(
            "(({ tickvals, ticktext }) => [tickvals, ticktext])(document.getElementById('plot').layout.yaxis)"
        )
    heights = [-np.log10(1 - score) for score in scores] if is_bent else scores
    assert drawn == {n: pytest.approx(height) for n, height in enumerate(heights)}
    assert (axis[0] is not None) == is_bent
    for height, text in zip(*axis, strict=True) if is_bent else ():
        assert float(text) == pytest.approx(1 - 10**-height)


# Refusals


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("presses", ["--target", "force"], "there is no condition 'force'; did you mean 'force_N'?"),
        ("presses", ["--target", "who"], "condition 'who' holds no numbers"),
        ("presses", ["--target", "same"], "all training trials have same = 7"),
        ("presses", ["--target", "events"], "has no annotations in time"),
        ("slips", ["--target", "events", "--target", "force_N"], "'events' stands alone"),
        ("presses", ["--target", "force_N", "--false-alarms-per-h", "5"], "`false_alarms_per_h`|false-alarms-per-h"),
        ("presses", ["--false-alarms-per-h", "5"], "false-alarms-per-h"),
        (
            "slips",
            ["--target", "events", "--set", "early_exit.tolerance=0.1"],
            "early_exit.tolerance: a detector runs on without windows",
        ),
        ("presses", ["--target", "force_N", "--set", "augmentation.kind=none"], "augmentation.kind: is of classes"),
        ("presses", ["--target", "force_N", "--set", "balance=classes"], "balance: is of classes"),
        ("presses", ["--target", "force_N", "--set", "search.trials=3"], "search.trials: is of classes"),
        ("presses", ["--target", "force_N", "--set", "sweep.window.length_ms=[50,100]"], "sweep.window.length_ms: "),
        ("presses", ["--target", "force_N", "--set", "network.readout=max"], "integrator"),
    ],
)
def test_what_has_no_meaning_is_refused_in_a_sentence(place, name, options, said):
    done = typed("study", "run", "own-recordings", "--data", f"{name}.h5", "-o", "no", *options, cwd=place)
    assert done.code == 2, done.out
    assert re.search(said, done.err.replace("--", "")), done.err
    assert not (place / "no").exists()


@pytest.mark.parametrize(
    ("study", "said"),
    [
        ("ways-to-save", "is a study of its own way"),
        ("network-selection", "is a study of its own way"),
        ("which-encoder", "encoders are compared by classes"),
    ],
)
def test_other_studies_take_no_target(place, study, said):
    done = typed("study", "run", study, "--data", "presses.h5", "-o", "no", "--target", "force_N", cwd=place)
    assert done.code == 2
    assert said in done.err


def test_a_python_call_takes_what_a_command_takes(place):
    with pytest.raises(InputError, match="refuse"):
        nt.run_study("own-recordings", place / "no", data=place / "presses.h5", learn=nt.Learn(refuse=0.1))
    learn = nt.Learn(target="force_N", balance="classes")
    with pytest.raises(InputError, match="balance: is of classes"):
        nt.run_study("own-recordings", place / "no", data=place / "presses.h5", learn=learn)
    with pytest.raises(InputError, match="data"):
        nt.run_study("own-recordings", place / "no", learn=nt.Learn(target="force_N"))
    assert cell_folder(place, next(engine.cells(_resolved(place)))).name


def _resolved(place):
    given = {**FEW, "way": "targets", "parameters": {"target": ["force_N"]}}
    return loading.resolve("own-recordings", given, data=place / "presses.h5")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("presses", ["--target", "force_N", "--test-where", "speed=2"]),
        ("presses", ["--target", "force_N", "--leave-out-each", "speed"]),
        ("presses", ["--target", "force_N", "--folds", "3", "--where", "speed=1"]),
        ("presses", ["--target", "force_N", "--set", "baselines=none"]),
        ("presses", ["--target", "force_N", "--set", "sweep.network.hidden=[0, 3]"]),
        ("few", ["--target", "events", "--set", "sweep.network.hidden=[12]", "--set", "network.training.epochs=4"]),
    ],
)
@pytest.mark.filterwarnings("ignore:training. :UserWarning")
def test_other_splits_and_sets_are_answered_too(place, name, options, tmp_path):
    if name == "few":
        hdf5.save_recordings(slips(n=3, duration_s=24.0), place / "few.h5")
    with studies_here() as patch:
        without_pictures(patch)
        command = ["study", "run", "own-recordings", "--quick", "--data", place / f"{name}.h5", "-o", tmp_path / "run"]
        done = typed(*command, *AS_TYPED, *options)
    assert done.code == 0, done.err
    answer = json.loads((tmp_path / "run" / "answer.json").read_text())["answers"][0]
    assert ("no rival was fitted" in answer["short"]) == ("baselines=none" in options)
    assert done.out.splitlines()[-1] == f"{answer['short']}."
    if "--folds" in options:
        assert answer["test_trials"] == 20
    if name == "few":
        assert answer["network"]["tested_s"] == pytest.approx(12.0)  # two of twelve parts
