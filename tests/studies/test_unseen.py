"""A study that tests untrained conditions: what it trains on, what it chooses, what its report says."""

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_process import studies_here, without_pictures
from levels import examples

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.augmentation import CANDIDATES, EVERY
from neurotact.data.recordings import Recordings
from neurotact.data.splits import SplitSpec
from neurotact.errors import InputError
from neurotact.networks.training import model_selection
from neurotact.report import robustness
from neurotact.report.answer import Decision, Network
from neurotact.report.robustness import TRAINED, hardest, sentence
from neurotact.report.tables import LAST_TRAINING, afferents_of
from neurotact.studies import automatic, loading, runner, study
from neurotact.studies.cell import run_cell

FEW = {
    "calibrate": False,
    "encoder.conditioning.baseline": "start",
    "encoder.conditioning.start_ms": 1.0,  # the first sample
    "network": "rsnn",
    "network.hidden": 4,
    "network.training.epochs": 1,
    "sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[5, 5]],
    "seed": 0,
    "baselines": "linear",
    "augmentation.copies": 1,
}


def presses(path, speeds=(1, 2, 3), each=8, late=False):
    """Presses that last as long as their speed has it, of two strengths; with `late` they begin at different times."""
    rng, rows, signals = np.random.default_rng(0), [], []
    for speed in speeds:
        for trial in range(2 * each):
            label = ("soft", "hard")[trial % 2]
            begin = 100 + (int(rng.integers(0, 420)) if late else 0)
            signal = rng.normal(0, 0.05, (600, 2))
            signal[begin : begin + 300 // speed] += (3, 6)[trial % 2] * np.array([1.0, 0.6])
            signals.append(signal)
            rows.append({"label": label, "speed": speed})
    hdf5.save_recordings(Recordings(signals, 1000.0, "mV", pd.DataFrame(rows)), path)
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    place = tmp_path_factory.mktemp("unseen")
    path = presses(place / "touches.h5", each=20)
    with studies_here() as patch:
        without_pictures(patch)
        nt.run_study("own-recordings", place / "run", FEW, data=path, split=nt.Split(leave_out_each="speed"))
    return place / "run"


def test_kinds_that_are_ruled_out_are_said_once_and_count_in_no_mean(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(model_selection, "clearly_worse", lambda accuracies, n: CANDIDATES[1:])
    settings = {**FEW, "network.training.epochs": 4, "network.training.patience": 4, "baselines": "none"}
    with studies_here() as patch:
        without_pictures(patch)
        path = presses(tmp_path / "touches.h5")
        nt.run_study("own-recordings", tmp_path / "run", settings, data=path, split=nt.Split(leave_out_each="speed"))
    remedies = pd.read_csv(tmp_path / "run" / "remedies.csv")
    out = remedies[remedies["augmentation"].isin(CANDIDATES[1:]) & ~remedies["last"]]
    assert len(out) == 3 * 3
    assert (out["ruled_out"] == 1).all()
    assert out["accuracy_validation"].between(0, 1).all()
    assert out[["accuracy_test", "sops_total"]].isna().all(axis=None)
    assert not out["chosen"].any()
    others = remedies.drop(out.index)
    assert others["ruled_out"].isna().all()
    assert others["accuracy_test"].notna().all()
    whole = runner.load(tmp_path / "run")
    cell = next(iter(loading.engine_of(whole).cells(whole)))
    for tells in (True, False):
        run_cell(cell, hdf5.load_spikes(tmp_path / "run" / cell.given), tells=tells)
    said = capsys.readouterr().err
    assert [said.count(f"copies '{kind}' are ruled out after 1 epochs") for kind in CANDIDATES[1:]] == [1, 1, 1]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "after the same epochs: time in 3, gain in 3, time+gain in 3." in page
    assert "means over 3 trainings" in page


def test_the_best_on_validation_of_what_is_trained_to_the_end_is_used(run):
    remedies, results = (pd.read_csv(run / f"{name}.csv") for name in ("remedies", "results"))
    for speed, every in remedies.groupby("split.test_where.speed"):
        tried = every[~every["last"]]
        assert sorted(tried["augmentation"]) == sorted([*CANDIDATES, EVERY])
        tried = tried[tried["ruled_out"].isna()]
        assert len(tried) == 2
        assert tried["augmentation"].iloc[0] == "none"
        (chosen,) = tried[tried["chosen"]].to_dict("records")
        assert chosen["accuracy_validation"] == tried["accuracy_validation"].max()
        (used,) = results[results["split.test_where.speed"] == speed].to_dict("records")
        (last,) = every[every["last"]].to_dict("records")
        assert used["augmentation"] == last["augmentation"] == chosen["augmentation"]
        assert [used[f"accuracy_{side}"] for side in ("test", "seen")] == [last["accuracy_test"], last["accuracy_seen"]]
        assert used["accuracy_validation"] == chosen["accuracy_validation"]
        assert last["n_train"] > chosen["n_train"]
        n = tried.set_index("augmentation")["n_train"]
        assert (n.drop("none") == 2 * n["none"]).all()
    baselines = pd.read_csv(run / "baselines.csv")
    kinds = baselines["settings"].str.extract("varied copies: (.*)")[0]
    assert kinds.isin([*CANDIDATES, EVERY]).all()


def test_the_report_says_what_is_lost_and_gained(run):
    page = (run / "report.html").read_text()
    assert 'id="conditions"' in page
    _, _, caption = page.partition('id="figure-training"')
    assert LAST_TRAINING in caption.partition("</figure>")[0]
    assert page.count(LAST_TRAINING) >= 1 + len(pd.read_csv(run / "results.csv"))
    for words in ("speed = 1", "speed = 2", "speed = 3", "at trained conditions (%)", "Each kind of varied copies"):
        assert words in page
    _, _, trained = page.partition("Every trained network (")
    assert "tested speed" in re.findall(r"<th[^>]*>([^<]*)</th>", trained.partition("</thead>")[0])
    _, _, by_class = page.partition("Each class by ")
    heads = re.findall(r"<th[^>]*>([^<]*)</th>", by_class.partition("</table>")[0])
    assert heads == ["class", TRAINED, "speed = 1", "speed = 2", "speed = 3", "hard", "soft"]
    assert by_class.partition("</table>")[0].count("(20)") == 6
    (answer,) = nt.study_answer(run)["answers"]
    assert any(line.startswith("At untrained conditions the network is right in") for line in answer["details"])


def test_where_each_value_is_tested_no_folds_are_advised(tmp_path):
    """Every trial is a test trial already, and `--folds` is refused beside `--leave-out-each`."""
    path = presses(tmp_path / "touches.h5", speeds=(1, 2), each=2)
    given = {**FEW, "augmentation.kind": "none", "baselines": "none"}
    with studies_here() as patch:
        without_pictures(patch)
        nt.run_study("own-recordings", tmp_path / "run", given, data=path, split=nt.Split(leave_out_each="speed"))
    (few,) = [line for line in nt.study_answer(tmp_path / "run")["cautions"] if "test trials" in line]
    assert few.startswith("2 of 2 classes have fewer than 5 test trials")
    assert few.endswith("; record more")


def test_costs_are_of_the_afferents_of_each_turn(run, tmp_path):
    cell = next(study.cells(runner.load(run)))
    turns = [cell.model_copy(update={"encoded_ms": end_ms}) for end_ms in (300.0, 301.0, 302.0)]
    (tmp_path / "spikes").mkdir()
    for turn in turns:
        shutil.copy(run / cell.given, tmp_path / turn.given)
    with h5py.File(tmp_path / turns[1].given, "a") as file:
        file.attrs["encoder"] = json.dumps({**json.loads(file.attrs["encoder"]), "tau_mem_ms": 7.0})
    found = afferents_of(tmp_path, turns)
    assert [one.encoder["tau_mem_ms"] == 7.0 for one in found] == [False, True, False]
    trains = hdf5.load_spikes(run / cell.given)
    assert found[0] == (len(trains.afferents), trains.encoder, trains.sampling_rate_Hz, trains.recorded_Hz)
    (tmp_path / turns[1].given).unlink()
    assert afferents_of(tmp_path, turns) == [found[0]] * 3
    assert afferents_of(tmp_path / "elsewhere", turns) == [None] * 3


def test_a_resumed_study_has_the_same_copies(run):
    before = (run / "results.csv").read_bytes()
    for path in (run / "spikes").glob("*.h5"):
        path.unlink()
    with studies_here() as patch:
        without_pictures(patch)
        nt.resume_study(run)
    assert (run / "results.csv").read_bytes() == before


def test_two_values_leave_no_choice_and_say_so(tmp_path):
    path = presses(tmp_path / "touches.h5", speeds=(1, 2))
    what = loading.resolve("own-recordings", {**FEW, "sweep.split.test_where.speed": [1, 2]}, data=path)
    assert any("too few values of speed to choose" in note for note in what.notes)


def test_without_another_condition_nothing_changes(tmp_path):
    path = presses(tmp_path / "touches.h5")
    plain = loading.resolve("own-recordings", FEW, data=path)
    assert not any("copies" in note for note in plain.notes)
    assert all(cell.augmentation is None for cell in study.cells(plain))
    kept = loading.resolve("own-recordings", {**FEW, "augmentation.kind": "gain"}, data=path)
    assert all(cell.augmentation is not None for cell in study.cells(kept))
    without = {**FEW, "augmentation.kind": "none", "split.test_where": {"speed": 3}}
    assert all(cell.augmentation is None for cell in study.cells(loading.resolve("own-recordings", without, data=path)))


def test_keys_of_copies_without_their_part_are_refused(tmp_path):
    path = presses(tmp_path / "touches.h5")
    asked = {**FEW, "split.test_where": {"speed": 3}, "augmentation.taxel_share": 0.5}
    with pytest.raises(InputError, match=r"augmentation.taxel_share: has no effect without 'taxels'"):
        loading.resolve("own-recordings", {**asked, "augmentation.kind": "gain"}, data=path)
    for unmade in (asked, {**FEW, "augmentation.taxel_share": 0.5}, {**FEW, "augmentation.time_factor": 3}):
        with pytest.raises(InputError, match=r"has no effect without '(taxels|time)' in augmentation\.kind"):
            loading.resolve("own-recordings", unmade, data=path)
    loading.resolve(
        "own-recordings", {**FEW, "split.test_where": {"speed": 3}, "augmentation.time_factor": 3}, data=path
    )
    what = loading.resolve("own-recordings", {**asked, "augmentation.kind": "gain+taxels"}, data=path)
    assert any("and with 50 % of the taxels at rest" in note for note in what.notes)


@pytest.mark.parametrize("late", [False, True])
def test_windows_start_at_contact_where_touches_begin_at_different_times(tmp_path, late):
    path = presses(tmp_path / "touches.h5", late=late)
    what = loading.resolve("own-recordings", {**FEW, "split.test_where": {"speed": 3}}, data=path)
    assert what.window.align == ("onset" if late else "trial")
    several = {**FEW, "split.test_where": {"speed": 3}, "window.length_ms": 20, "window.per_trial": 2}
    what = loading.resolve("own-recordings", several, data=path)
    assert what.window.per_trial == 2
    assert any("up to 2 windows per trial" in note for note in what.notes)
    fixed = {**FEW, "split.test_where": {"speed": 3}, "window.start_ms": 90}
    assert loading.resolve("own-recordings", fixed, data=path).window.align == "trial"
    assert loading.resolve("own-recordings", FEW, data=path).window.align == "trial"


@pytest.mark.parametrize("late", [False, True])
def test_copies_that_begin_later_are_for_windows_that_do_not_begin_at_contact(tmp_path, late):
    path = presses(tmp_path / "touches.h5", late=late)
    what = loading.resolve("own-recordings", {**FEW, "split.test_where": {"speed": 3}}, data=path)
    assert (EVERY in what.augmentation.candidates) == (not late)
    assert late or what.augmentation.shift_ms == min(500.0, what.window.length_ms)
    without = {**FEW, "split.test_where": {"speed": 3}, "augmentation.any_start": False}
    assert EVERY not in loading.resolve("own-recordings", without, data=path).augmentation.candidates


@pytest.mark.parametrize(
    ("changes", "is_chosen"),
    [
        ({}, True),
        ({"encoder.sa1.grades": [1.0]}, False),
        ({"choose_grades": False}, False),
        ({"augmentation.kind": "none"}, False),
        ({"split.test_where": {}}, False),
    ],
)
def test_grades_are_chosen_for_other_conditions_beside_copies_unless_they_are_given(tmp_path, changes, is_chosen):
    elsewhere = {**FEW, "calibrate": True, "split.test_where": {"speed": 3}}
    what = loading.resolve("own-recordings", {**elsewhere, **changes}, data=presses(tmp_path / "touches.h5"))
    assert {cell.choose_grades for cell in study.cells(what)} == {is_chosen}


def test_of_many_trials_each_has_one_copy_and_it_is_said(tmp_path, monkeypatch):
    path, asked = presses(tmp_path / "touches.h5"), {**FEW, "split.test_where": {"speed": 3}}
    asked.pop("augmentation.copies", None)
    assert loading.resolve("own-recordings", asked, data=path).augmentation.copies == 3
    monkeypatch.setattr(automatic, "MANY", 10)
    what = loading.resolve("own-recordings", asked, data=path)
    assert what.augmentation.copies == 1
    assert any("one of each trial since there are many" in note for note in what.notes)
    given = loading.resolve("own-recordings", {**asked, "augmentation.copies": 2}, data=path)
    assert given.augmentation.copies == 2
    assert not any("one of each trial" in note for note in given.notes)


def test_fewer_networks_are_trained_since_each_takes_several_trainings(tmp_path):
    path = presses(tmp_path / "touches.h5")
    asked = {"split.test_where": {"speed": 3}}
    sweep = loading.resolve("own-recordings", asked, data=path).sweep
    assert {key: sweep[key] for key in automatic.FEWER} == automatic.FEWER
    each = loading.resolve("own-recordings", {"sweep.split.test_where.speed": [1, 2, 3]}, data=path)
    assert each.sweep["seed"] == [0]
    own = loading.resolve("own-recordings", {**asked, "sweep.network.hidden": [5, 9, 20]}, data=path).sweep
    assert own["network.hidden"] == [5, 9, 20]


def test_the_sentence_tells_losses_and_gains():
    network = Network("5&5", 20, 1, 0.9, Decision(0.9, 1.0, 1.0, 1.0, None), None)
    rows = {"pair": "5&5", "hidden": 20, "augmentation": ["none", "time", "time"], "chosen": [False, True, False]}
    rows |= {"accuracy_seen": [0.9, 0.95, 0.97], "accuracy_test": [0.5, 0.8, 0.9], "last": [False, False, True]}
    assert sentence(pd.DataFrame(rows), network) == [
        "At untrained conditions the network is right in 90.0 % of whole windows, at trained ones in 97.0 %: 7.0 "
        "points are lost; varied copies of training trials gain 30.0 points before the last training."
    ]
    last = pd.DataFrame(rows)[:2].assign(last=[False, True])
    (said,) = sentence(last, network)
    assert said.endswith("gain 30.0 points.")
    alone = pd.DataFrame(rows)[1:2].assign(last=True)
    assert sentence(alone, network) == [
        "At untrained conditions the network is right in 80.0 % of whole windows, at trained ones in 95.0 %: 15.0 "
        "points are lost."
    ]
    assert sentence(None, network) == []


def classes(trained, untrained):
    """A table of classes: right and trials of each, at trained conditions and at one that is not."""
    return pd.DataFrame([
        {"label": label, "condition": condition, "trials": trials, "right": right / trials}
        for condition, shares in ((TRAINED, trained), ("speed = 1", untrained))
        for label, (right, trials) in shares.items()
    ])  # fmt: skip


def test_classes_are_at_the_tested_conditions_in_their_order(monkeypatch):
    """Not in that of their letters, nor in that in which the first class has them."""
    trials = pd.DataFrame({"label": ["silk", "silk", "felt", "felt"], "speed": [90, 300, 90, 1000]})
    tests = {90: {"0": 1.0, "2": 0.5}, 300: {"1": 0.0}, 1000: {"3": 1.0}}
    cells = [SimpleNamespace(split=SplitSpec(test_where={"speed": speed})) for speed in tests]
    monkeypatch.setattr(robustness, "result_of", lambda _, cell: {"right": tests[cell.split.test_where["speed"]]})
    trains = nt.Recordings(np.zeros((4, 5, 1)), 1000.0, "mV", trials)  # of which conditions are read, as of spikes
    found = robustness.by_class(Path(), cells, trains)  # pyright: ignore[reportArgumentType]
    network = Network("5&5", 20, 1, 0.9, Decision(0.9, 1.0, 1.0, 1.0, None), None)
    (shown,) = robustness.class_table(found, network)
    assert shown.columns == ["class", "speed = 90", "speed = 300", "speed = 1000"]
    assert shown.rows == [["felt", "50.0 (1)", "", "100.0 (1)"], ["silk", "100.0 (1)", "0.0 (1)", ""]]


def test_the_class_that_loses_most_is_named():
    trained = {"felt": (20, 20), "linen": (20, 20), "silk": (19, 20)}
    untrained = {"felt": (36, 40), "linen": (12, 40), "silk": (34, 40)}
    assert hardest(classes(trained, untrained)) == [
        "'linen' loses most at untrained conditions: it is right in 30.0 % of 40 trials, at trained ones in 100.0 % of "
        "20; the other classes in 87.5 % and 97.5 %."
    ]


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 20)), min_size=1, max_size=4))
@examples(20)
def test_no_class_is_named_where_all_lose_alike_or_chance_may_be_the_reason(counts):
    alike = {str(label): counts[0] for label in range(len(counts))}
    assert hardest(classes({label: (seen, 6) for label, (seen, _) in alike.items()},
                           {label: (at, 20) for label, (_, at) in alike.items()})) == []  # fmt: skip
    few = {str(label): (seen % 2, 1) for label, (seen, _) in enumerate(counts)}
    untrained = {str(label): (at, 20) for label, (_, at) in enumerate(counts)}
    assert hardest(classes(few, untrained)) == []  # one trained trial a class tells nothing


def test_a_class_that_is_wrong_at_trained_conditions_too_loses_nothing():
    trained, untrained = {"felt": (20, 20), "linen": (6, 20)}, {"felt": (38, 40), "linen": (12, 40)}
    assert hardest(classes(trained, untrained)) == []


def test_a_search_trains_without_copies_and_refuses_them_by_name(tmp_path):
    path = presses(tmp_path / "touches.h5")
    space = {"surrogate_scale": {"_type": "choice", "_value": [5, 10]}}
    asked = {**FEW, "split.test_where": {"speed": 3}, "search": {"space": space, "trials": 2, "batch": 2}}
    what = loading.resolve("own-recordings", asked, data=path)
    assert all(cell.augmentation is None for cell in study.cells(what))
    assert not any("copies" in note for note in what.notes)
    with pytest.raises(InputError, match="a search trains without varied copies"):
        loading.resolve("own-recordings", {**asked, "augmentation.kind": "time"}, data=path)
