"""What a study takes from the recordings that it is given: window, seeds, clock, and what it refuses."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.conditioning import conditioned_length
from neurotact.data.onset import LATEST
from neurotact.data.recordings import Recordings
from neurotact.data.splits import split_conditions
from neurotact.data.windows import WindowSpec, cut
from neurotact.errors import InputError
from neurotact.studies import loading, preparation, study, suited
from neurotact.studies.suited import Recorded
from neurotact.tables import read_table


def save(path, lengths, rate_Hz=500.0):
    conditions = pd.DataFrame({"label": ["felt", "silk"] * (len(lengths) // 2)})
    signals = [np.zeros((n, 2), np.float32) for n in lengths]
    hdf5.save_recordings(Recordings(signals, rate_Hz, "mV", conditions), path)
    return path


@given(
    st.lists(st.integers(2, 5000), min_size=1, max_size=30),
    st.sampled_from([35.6, 93.0, 200.0, 500.0, 1000.0, 2000.0, 1234.5]),
    st.floats(0, LATEST),
    st.sampled_from([{}, {"window.length_ms": 1.0}, {"window.length_ms": 0.75}, {"window.start_ms": 0}]),
)
def test_a_window_fits_into_every_trial(lengths, rate_Hz, touch, asked):
    steps = np.array([conditioned_length(n, rate_Hz, 1000.0) for n in lengths])
    shortest_ms = float(steps.min())
    asked = {key: max(1.0, np.floor(value * shortest_ms)) if value else value for key, value in asked.items()}
    table, _ = suited.window(Recorded(steps / 1000.0, rate_Hz, touch_s=touch * shortest_ms / 1e3), asked)
    windows = cut(steps, 1000.0, WindowSpec(**table))
    counts = np.bincount(windows.trial, minlength=len(steps))
    assert counts.min() >= 1
    assert counts.max() <= suited.MOST_PER_TRIAL
    assert windows.n_steps <= asked.get("window.length_ms", suited.LONGEST_MS)


def test_windows_start_with_the_touch_unless_a_start_is_given():
    trials = Recorded(np.full(20, 2.5), 100.0, touch_s=0.4409)
    table, notes = suited.window(trials)
    assert table == {"length_ms": 2000.0, "per_trial": 1, "start_ms": 440.0}
    assert notes[1].startswith("Windows start 440 ms after the start of a trial: before, trials differ less than half")
    table, notes = suited.window(Recorded(np.array([0.9, 2.0, 2.0]), 100.0, touch_s=0.3))
    assert table["length_ms"] == 600
    assert "600 ms (the shortest trial, 600 ms from 300 ms on)" in notes[0]
    assert "Trial 0 lasts 900 ms, the median trial 2,000 ms, and every window must fit into it;" in notes[-1]
    assert suited.window(trials, {"window.length_ms": 2200})[0]["start_ms"] == 300
    assert "start_ms" not in suited.window(trials, {"window.length_ms": 2500})[0]
    for given_start in ({"window.start_ms": 100}, {"window.start_ms": 0}, {"window.align": "onset"}):
        table, notes = suited.window(trials, given_start)
        assert "start_ms" not in table  # the given one is set with the study
        assert not [note for note in notes if "Windows start" in note]
    _, notes = suited.window(Recorded(np.full(20, 5.0), 100.0, touch_s=0.5), {"window.per_trial": 1})
    assert notes[-1].startswith("Only 2,000 ms of the median trial, 4,500 ms from there on, are used;")


def test_many_trials_have_fewer_windows_each():
    assert suited.window(Recorded(np.full(1000, 10.0), 1000.0))[0]["per_trial"] == 2
    assert suited.window(Recorded(np.full(1001, 10.0), 1000.0))[0]["per_trial"] == 1
    short = {"window.length_ms": 300}
    assert suited.window(Recorded(np.full(1000, 10.0), 1000.0), short)[0]["per_trial"] == 4
    assert suited.window(Recorded(np.full(5000, 10.0), 1000.0), short)[0]["per_trial"] == 2


def test_a_given_window_is_kept_and_an_odd_trial_is_named():
    assert suited.window(Recorded(np.array([2.0, 2.0]), 1000.0), {"window.length_ms": 250})[0] == {
        "length_ms": 250.0,
        "per_trial": 4,
    }
    table, (note,) = suited.window(Recorded(np.array([1.9, 1.9]), 1000.0), {"window.per_trial": 1})
    assert table["per_trial"] == 1
    assert "1900 ms (the shortest trial, 1,900 ms), one window per trial;" in note
    assert "2000 ms (2 s at most), one window per trial;" in suited.window(Recorded(np.full(9, 2.1), 100.0))[1][0]
    _, notes = suited.window(Recorded(np.array([2.0, 0.1, 2.0]), 1000.0))
    assert "Trial 1 lasts 100 ms, the median trial 2,000 ms" in notes[-1]


def test_windows_that_leave_most_of_the_trials_out_are_named_with_the_remedy():
    trials = Recorded(np.array([5.0, 5.0, 9.0]), 1000.0)
    _, notes = suited.window(trials, {"window.per_trial": 1})
    assert notes[-1].startswith("Only the first 2,000 ms of the median trial, 5,000 ms, are used;")
    assert len(suited.window(trials)[1]) == 1
    for place in ({"window.start_ms": 2000}, {"window.align": "onset"}, {"window.length_ms": 1000.0}):
        assert len(suited.window(trials, {"window.per_trial": 1, **place})[1]) == 1


def test_windows_that_overlap_cover_less():
    trials = Recorded(np.full(20, 6.0), 100.0)
    _, notes = suited.window(trials, {"window.hop_ms": 500.0})
    assert "the first 2,500 ms of the median trial" in notes[-1]  # two windows of 2 s, 500 ms apart
    _, notes = suited.window(trials)
    assert not [note for note in notes if "are used" in note]


def test_a_file_of_spikes_is_refused_with_what_takes_it(tmp_path):
    signals = [50 * np.random.default_rng(0).normal(size=(300, 2))] * 2
    hdf5.save_spikes(
        nt.encode(Recordings(signals, 2000.0, "mV", pd.DataFrame({"label": ["a", "b"]}))), tmp_path / "s.h5"
    )
    with pytest.raises(
        InputError, match=r"s\.h5: holds spikes, .* neurotact train and then neurotact infer --early-exit"
    ):
        loading.resolve("own-recordings", data=tmp_path / "s.h5")


def test_a_slow_recording_is_told_what_its_clock_means():
    (note,) = suited.clock(Recorded(np.ones(2), 93.0), 1000.0)
    assert "recorded at 93 Hz, where a sample lasts 10.8 ms" in note
    (note,) = suited.clock(Recorded(np.ones(2), 5000.0), 1000.0)
    assert "smoothed and resampled" in note
    assert suited.clock(Recorded(np.ones(2), 1000.0), 1000.0) == suited.clock(Recorded(np.ones(2), 93.0), None) == []


def test_the_rest_before_the_touch_is_left_out(tmp_path):
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 0.1, (12, 300, 2))
    signals[:, 60:] += rng.normal(0, 5, (12, 1, 2))
    touches = Recordings(signals, 100.0, "mV", {"label": ["felt", "silk"] * 6})
    hdf5.save_recordings(touches, tmp_path / "touches.h5")
    what = loading.resolve("own-recordings", data=tmp_path / "touches.h5")
    assert what.window == WindowSpec(length_ms=2000.0, start_ms=600.0, per_trial=1)
    what = loading.resolve("own-recordings", data=tmp_path / "touches.h5", overrides={"window.start_ms": 0})
    assert what.window.start_ms == 0


def test_the_shipped_study_takes_any_recordings(tmp_path):
    path = save(tmp_path / "touches.h5", [300] * 12, 93.0)
    what = loading.resolve("own-recordings", data=path)
    assert what.dataset.file == str(path)
    assert what.window == WindowSpec(length_ms=2000.0, per_trial=1)
    assert what.sweep["seed"] == [0]
    assert len(what.notes) == 3
    changed = loading.resolve("own-recordings", {"window.length_ms": 300.0, "sweep.seed": [5]}, data=path)
    assert changed.window == WindowSpec(length_ms=300.0, per_trial=4)
    assert changed.sweep["seed"] == [5]
    assert not any(note.startswith("Seeds") for note in changed.notes)


@pytest.mark.parametrize(
    ("n_trials", "given", "folds", "seeds"),
    [
        (12, {}, 5, [0]),
        (8, {}, None, [0, 1, 2]),  # four of a class: fewer than the folds
        (302, {}, None, [0, 1, 2]),  # 45 test trials of one split
        (12, {"sweep.seed": [3]}, None, [3]),
        (12, {"split.group": ("place",)}, None, [0, 1, 2]),
        (12, {"split.folds": 3, "sweep.split.fold": [0, 1, 2]}, 3, [0, 1, 2]),
    ],
)
def test_few_trials_are_each_tested_once_unless_a_split_or_seeds_are_given(tmp_path, n_trials, given, folds, seeds):
    what = loading.resolve("own-recordings", given, data=save(tmp_path / "touches.h5", [20] * n_trials))
    assert what.split.folds == folds
    assert what.sweep["seed"] == seeds
    assert what.sweep.get("split.fold") == ([*range(folds)] if folds else None)
    assert any(note.startswith(f"Split: 5 folds with one random seed each, so that each of the {n_trials} trials")
               for note in what.notes) == (folds == 5)  # fmt: skip


def test_folds_of_few_trials_test_each_trial_once(tmp_path):
    path = save(tmp_path / "touches.h5", [20] * 26)
    what = loading.resolve("own-recordings", data=path)
    conditions = hdf5.load_recordings(path).conditions
    splits = {cell.split.fold: cell.split for cell in study.cells(what)}
    tested = [split_conditions(conditions, (), split).test for split in splits.values()]
    assert sorted(np.concatenate(tested).tolist()) == [*range(26)]


def test_the_baselines_of_a_fold_are_those_of_a_study_of_that_fold_alone(tmp_path, caplog):
    noise = np.random.default_rng(0)
    signals = [noise.normal(n % 2, 1.0, (150, 2)).astype(np.float32) for n in range(24)]
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 12})
    hdf5.save_recordings(Recordings(signals, 500.0, "mV", conditions), tmp_path / "touches.h5")
    small = {"sweep.seed": [0], "split.folds": 3, "sweep.network.hidden": [4]}
    pair = {"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]]}

    def fitted(**fold):
        what = loading.resolve("own-recordings", {**small, **pair, **fold}, data=tmp_path / "touches.h5")
        folder = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        preparation.prepare(folder, what, list(study.cells(what)))
        return read_table(folder / "baselines.csv")

    both = fitted(**{"sweep.split.fold": [0, 2]})
    assert {", fold 0: conditioning.baseline", ", fold 2: conditioning.baseline"} <= {
        record.getMessage().partition(" = ")[0].partition("touches.h5")[2] for record in caplog.records
    }
    for fold in (0, 2):
        mine = both[both["split.fold"] == fold].drop(columns="split.fold").reset_index(drop=True)
        pd.testing.assert_frame_equal(mine, fitted(**{"split.fold": fold}))
    assert "SVM" in set(both["classifier"])


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("own-recordings", None, "own-recordings: names no recordings; give a file with --data"),
        ("own-recordings", "away.h5", "--data away.h5: there is no such file"),
        ("refractory-period", "touches.h5", r"names its own recordings \(dataset.simulate\)"),
        ("contact-materials", "touches.h5", "makes or reads its own recordings"),
    ],
)
def test_recordings_that_are_missing_or_too_many_are_refused(tmp_path, monkeypatch, name, data, words):
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "touches.h5", [600] * 12)
    with pytest.raises(InputError, match=words):
        loading.resolve(name, data=data)


def test_reasons_belong_to_a_whole_study_that_ships():
    assert loading.resolve("refractory-period").as_shipped
    assert not loading.resolve("refractory-period", quick=True).as_shipped
    assert not loading.resolve("refractory-period", {"sweep.seed": [1]}).as_shipped
