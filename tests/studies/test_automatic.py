"""What a study takes from the recordings that it is given: window, seeds, clock, and what it refuses."""

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.main import get_command

import neurotact as nt
from neurotact.api import specs, studies
from neurotact.cli.studies import app
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.data.splits import split_conditions
from neurotact.data.window_choice import Timing
from neurotact.data.windows import WindowSpec
from neurotact.errors import InputError
from neurotact.studies import automatic, loading, networks, preparation, study
from neurotact.studies.automatic import Recorded
from neurotact.tables import read_table

ONES = Timing(np.ones(2), 1000.0)


def save(path, lengths, rate_Hz=500.0):
    conditions = pd.DataFrame({"label": ["felt", "silk"] * (len(lengths) // 2)})
    signals = [np.zeros((n, 2), np.float32) for n in lengths]
    hdf5.save_recordings(Recordings(signals, rate_Hz, "mV", conditions), path)
    return path


def test_keys_of_a_window_are_dotted_and_their_times_numbers():
    timing = Timing(np.full(20, 2.5), 1000.0, touch_s=0.44)
    given = {"window.length_ms": 300.0, "sweep.seed": [1]}
    table, notes = automatic.window(timing, given)
    assert table == {"length_ms": 300.0, "per_trial": 4, "start_ms": 440.0}
    assert notes[1].endswith("change it with `settings={'window.start_ms': 0}`.")
    for key in ("length_ms", "start_ms", "hop_ms"):
        for wrong in ("long", True, -1.0, float("nan")):
            with pytest.raises(InputError, match=rf"^window\.{key}: must be .*; got .* \(`settings`\)"):
                automatic.window(timing, {f"window.{key}": wrong})


def test_a_file_of_spikes_is_refused_with_what_takes_it(tmp_path):
    signals = [50 * np.random.default_rng(0).normal(size=(300, 2))] * 2
    hdf5.save_spikes(
        nt.encode(Recordings(signals, 2000.0, "mV", pd.DataFrame({"label": ["a", "b"]}))), tmp_path / "s.h5"
    )
    with pytest.raises(InputError, match=r"s\.h5: holds spikes, .* `nt.train` and then `nt.infer"):
        loading.resolve("own-recordings", data=tmp_path / "s.h5")


def test_a_slow_recording_is_told_what_its_clock_means():
    (note,) = automatic.clock(Recorded(ONES, 93.0), 1000.0)
    assert "recorded at 93 Hz, where a sample lasts 10.8 ms" in note
    (note,) = automatic.clock(Recorded(ONES, 5000.0), 1000.0)
    assert "smoothed and resampled" in note
    assert automatic.clock(Recorded(np.ones(2), 1000.0), 1000.0) == automatic.clock(Recorded(ONES, 93.0), None) == []


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
    assert len(what.notes) == 5
    changed = loading.resolve("own-recordings", {"window.length_ms": 300.0, "sweep.seed": [5]}, data=path)
    assert changed.window == WindowSpec(length_ms=300.0, per_trial=4)
    assert changed.sweep["seed"] == [5]
    assert not any(note.startswith("Seeds") for note in changed.notes)


@given(st.floats(1, 5000))
def test_refractory_periods_follow_the_rate_of_the_sensor(rate_Hz):
    sample_ms, axis = 1e3 / rate_Hz, study.PAIR
    tried, alone = (automatic.periods_of(axis, word, max(1.0, sample_ms)) for word in ("auto", "auto equal"))
    every = [one for one, other in alone if one == other]
    assert alone == [pair for pair in tried if len({*pair}) == 1] == [[one, one] for one in every]
    assert every == automatic.periods_of("encoder.t_ref_ms", "auto", max(1.0, sample_ms))
    assert every[0] == 1.0
    assert all(a < b and b % 1 == 0 for a, b in pairwise(every))
    if sample_ms <= 5:
        assert tried == [[1, 1], [1, 5], [5, 5], [1, 10], [5, 10], [10, 10]]
        assert not automatic.of_periods(sample_ms)
    else:
        assert any(sample_ms <= one < sample_ms + 1.001 for one in every)
        (note,) = automatic.of_periods(sample_ms)
        short = [f"{one:g}" for one in every if one < sample_ms]
        assert note.endswith(f": {', '.join(short)} ms.")


@pytest.mark.parametrize(("rate_Hz", "longest"), [(1000.0, 10), (150.0, 27), (35.6, 29)])
def test_the_study_tries_periods_of_its_sensor_and_given_ones_stay(tmp_path, rate_Hz, longest):
    path, axis = save(tmp_path / "touches.h5", [300] * 12, rate_Hz), study.PAIR
    whole, quick = (loading.resolve("own-recordings", quick=is_quick, data=path).sweep[axis] for is_quick in (0, 1))
    assert quick == [pair for pair in whole if pair[0] == pair[1]]
    assert whole[-1] == [longest, longest]
    taxels = loading.resolve("own-recordings", {"encoder": "send-on-delta"}, data=path).sweep
    assert taxels["encoder.t_ref_ms"] == [pair[0] for pair in quick]
    given = loading.resolve("own-recordings", {f"sweep.{axis}": [[3, 2]]}, quick=True, data=path)
    assert given.sweep[axis] == [[3, 2]]
    assert not any(note.startswith("Refractory") for note in given.notes)


@pytest.mark.parametrize(
    ("n_trials", "given", "folds", "seeds"),
    [
        (12, {}, 5, [0]),
        (10, {}, 5, [0]),  # five of a class: as many as the folds
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


@pytest.mark.thorough
def test_the_baselines_of_a_fold_are_those_of_a_study_of_that_fold_alone(tmp_path, caplog):
    noise = np.random.default_rng(0)
    signals = [noise.normal(n % 2, 1.0, (150, 2)).astype(np.float32) for n in range(24)]
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 12})
    hdf5.save_recordings(Recordings(signals, 500.0, "mV", conditions), tmp_path / "touches.h5")
    small = {"sweep.seed": [0], "split.folds": 3, "sweep.network.hidden": [4], "baselines": "quick"}
    pair = {"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[1, 1]]}

    def fitted(**fold):
        what = loading.resolve("own-recordings", {**small, **pair, **fold}, data=tmp_path / "touches.h5")
        folder = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        cells = list(study.cells(what))
        assert preparation.prepare(folder, what, cells)
        beside = networks.ENGINE.beside(folder, what, cells, True)
        beside.write({place: beside.run(beside.jobs[place]) for place in reversed(range(len(beside.jobs)))})
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
        ("own-recordings", None, "own-recordings: names no recordings; give a file with `data="),
        ("own-recordings", "away.h5", "`data='away.h5'`: there is no such file"),
        ("own-recordings", "x" * 300, "there is no such file"),
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


def at_speeds(path):
    conditions = {"label": ["felt", "silk"] * 9, "speed": np.repeat([450, 150, 300], 6)}
    touches = Recordings(np.zeros((18, 20, 2), np.float32), 500.0, "mV", conditions)
    hdf5.save_recordings(touches, path)
    return path


def test_each_value_of_a_condition_is_tested_and_never_trained(tmp_path, monkeypatch):
    path, asked = at_speeds(tmp_path / "touches.h5"), []
    monkeypatch.setattr(studies, "_run", lambda what, *_: asked.append(what) or pd.DataFrame())
    nt.run_study("own-recordings", tmp_path / "run", data=path, split=nt.Split(leave_out_each="speed"))
    conditions = hdf5.load_recordings(path).conditions
    tested = []
    for split in {str(cell.split): cell.split for cell in study.cells(asked[0])}.values():
        sides = split_conditions(conditions, (), split)
        (speed,) = set(conditions["speed"][sides.test])
        assert speed not in set(conditions["speed"][sides.train])
        assert set(conditions["speed"][sides.train]).isdisjoint(conditions["speed"][sides.validation])
        tested += sides.test.tolist()
    assert sorted(tested) == [*range(18)]


def at_pairs(path, speeds=3, forces=3):
    rows = [(label, s, f) for s in range(speeds) for f in range(forces) for label in ("felt", "silk") for _ in range(3)]
    conditions = pd.DataFrame(rows, columns=["label", "speed", "force"])
    hdf5.save_recordings(Recordings(np.zeros((len(rows), 20, 2), np.float32), 500.0, "mV", conditions), path)
    return path


@pytest.mark.parametrize(("where", "tested"), [(None, 9), ({"speed": [0, 1], "force": 2}, 2)])
def test_each_pair_of_values_is_tested_and_neither_value_trained(tmp_path, monkeypatch, where, tested):
    path, asked = at_pairs(tmp_path / "touches.h5"), []
    monkeypatch.setattr(studies, "_run", lambda what, *_: asked.append(what) or pd.DataFrame())
    split = nt.Split(leave_out_each=["speed", "force"], test_where=where or {})
    nt.run_study("own-recordings", tmp_path / "run", data=path, split=split)
    conditions, pairs = hdf5.load_recordings(path).conditions, set()
    for split in {str(cell.split): cell.split for cell in study.cells(asked[0])}.values():
        sides = split_conditions(conditions, (), split)
        ((speed, force),) = {*conditions.iloc[sides.test][["speed", "force"]].itertuples(index=False, name=None)}
        for side in sides[:2]:
            assert speed not in set(conditions["speed"][side])
            assert force not in set(conditions["force"][side])
        pairs.add((speed, force))
    assert len(pairs) == tested
    notes = " ".join(asked[0].notes)
    assert f"{tested} pairs of speed and force are tested in turn" in notes
    assert "best on validation trials of another speed and force" in notes
    assert asked[0].sweep["seed"] == [0]
    again = study.to_toml(asked[0])
    (tmp_path / "again.toml").write_text(again)
    assert [*study.cells(loading.read_back(tmp_path / "again.toml"))] == [*study.cells(asked[0])]


def test_a_pair_that_leaves_too_few_trials_is_refused_before_anything_runs(tmp_path):
    path = at_pairs(tmp_path / "touches.h5", 2, 2)
    touches = hdf5.load_recordings(path)
    silk = (touches.conditions["label"] == "silk") & (touches.conditions["speed"] == 0)
    hdf5.save_recordings(touches.select(~silk.to_numpy()), tmp_path / "fewer.h5")
    with pytest.raises(InputError, match=r"cannot test speed = 1, force = 0, .* left aside"):
        nt.run_study(
            "own-recordings",
            tmp_path / "run",
            data=tmp_path / "fewer.h5",
            split=nt.Split(leave_out_each=["speed", "force"]),
        )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"split": {"leave_out_each": "speed", "test_where": {"label": "felt"}}, "data": "touches.h5"}, "drop 'label'"),
        (
            {"settings": {"split.leave_aside": True, "split.test_where": {"speed": 150}}, "data": "touches.h5"},
            "split.leave_aside: has no effect without several conditions",
        ),
        ({"split": {"leave_out_each": "speed"}}, "needs `data`, a file of recordings"),
        (
            {"split": {"leave_out_each": "sped"}, "data": "touches.h5"},
            "no condition is called 'sped'; did you mean 'speed'",
        ),
        ({"split": {"leave_out_each": "speed", "folds": 3}, "data": "touches.h5"}, "both select the test trials"),
    ],
)
def test_a_condition_that_cannot_be_left_out_is_refused(tmp_path, monkeypatch, given, message):
    monkeypatch.chdir(tmp_path)
    at_speeds(tmp_path / "touches.h5")

    def run(split=None, **options) -> None:
        nt.run_study("own-recordings", "run", split=nt.Split(**(split or {})), **options)

    with pytest.raises(InputError, match=message):
        run(**given)


def test_a_sweep_of_tables_is_refused_with_the_key_to_sweep(tmp_path):
    path = at_speeds(tmp_path / "touches.h5")
    with pytest.raises(InputError, match=r"has a table.*sweep 'split\.test_where\.speed' instead"):
        loading.resolve("own-recordings", {"sweep.split.test_where": [{"speed": 150}]}, data=path)


def slow_touches(path, rate_Hz):
    conditions = {"label": ["felt", "silk"] * 9, "speed": np.repeat([450, 150, 300], 6)}
    touches = Recordings(np.zeros((18, round(2 * rate_Hz), 2), np.float32), rate_Hz, "mV", conditions)
    hdf5.save_recordings(touches, path)
    return path


@pytest.mark.parametrize(
    ("rate_Hz", "given", "integration"),
    [
        (93.0, {}, "exact"),
        (999.0, {}, "exact"),
        (1000.0, {}, "clock"),
        (2000.0, {}, "clock"),
        (93.0, {"encoder.integration": "clock"}, "clock"),
        (2000.0, {"encoder.integration": "exact"}, "exact"),
        (93.0, {"encoder": "sa1-ra1-lif-biological"}, "exact"),
        (93.0, {"sweep.encoder.ra1.t_ref_ms & encoder.sa1.t_ref_ms": [[0, 0], [5, 5]]}, "clock"),
    ],
)
def test_afferents_of_a_slow_sensor_are_computed_once_per_sample(tmp_path, rate_Hz, given, integration):
    what = loading.resolve("own-recordings", given, data=slow_touches(tmp_path / "touches.h5", rate_Hz))
    assert what.encoder.integration == integration
    assert {cell.encoder.integration for cell in study.cells(what)} == {integration}
    said = any("once per sample" in note for note in what.notes)
    assert said == (integration == "exact" and rate_Hz != 1000.0)


@pytest.mark.parametrize("given", ["clock", "exact", None])
def test_an_encoder_that_sets_its_integration_keeps_it(tmp_path, given):
    mine = "" if given is None else f"integration = '{given}'\n"
    (tmp_path / "mine.toml").write_text(f"{mine}[sa1]\ngain = 1.0\n[ra1]\ngain = 1.0\n")
    own = {"encoder": str(tmp_path / "mine.toml")}
    what = loading.resolve("own-recordings", own, data=slow_touches(tmp_path / "touches.h5", 93.0))
    assert what.encoder.integration == (given or "exact")


def test_an_encoder_without_membranes_has_no_integration(tmp_path):
    what = loading.resolve("own-recordings", {"encoder": "send-on-delta"}, data=slow_touches(tmp_path / "t.h5", 93.0))
    assert not hasattr(what.encoder, "integration")


@given(length_ms=st.floats(1, 10_000), own_ms=st.floats(1, 200))
def test_membranes_follow_the_window_and_are_never_shorter_than_their_own(length_ms, own_ms):
    chosen_ms = automatic.membrane_ms(length_ms, own_ms)
    assert chosen_ms >= own_ms
    assert chosen_ms in (own_ms, automatic.LONGEST_MS) or abs(chosen_ms - length_ms / 20) <= 0.05
    assert automatic.membrane_ms(2 * length_ms, own_ms) >= chosen_ms


@pytest.mark.parametrize(
    ("changes", "tau_ms"),
    [
        ({}, 50.0),
        ({"window.length_ms": 600}, 30.0),
        ({"window.length_ms": 100}, 10.0),
        ({"encoder.tau_mem_ms": 7}, 7.0),
        ({"split.test_where": {"speed": 2}}, 10.0),
        ({"sweep.split.test_where.speed": [1, 2, 3]}, 10.0),
    ],
)
def test_membranes_are_longer_where_conditions_are_trained_on(tmp_path, changes, tau_ms):
    path, speeds = tmp_path / "touches.h5", np.repeat([1, 2, 3], 8)
    conditions = pd.DataFrame({"label": ["felt", "silk"] * 12, "speed": speeds})
    nt.save(nt.Recordings([np.zeros((300, 2), np.float32)] * 24, 93.0, "count", conditions), path)
    what = loading.resolve("own-recordings", changes, data=path)
    assert {cell.encoder.tau_mem_ms for cell in study.cells(what)} == {tau_ms}
    assert {cell.calibrate.tau_mem_ms for cell in study.cells(what)} == {tau_ms}
    said = [note for note in what.notes if note.startswith("Afferents: membranes of")]
    assert len(said) == (tau_ms not in (7.0, 10.0))


def test_membranes_follow_the_shortest_of_swept_windows(tmp_path):
    path = slow_touches(tmp_path / "t.h5", 93.0)
    what = loading.resolve("own-recordings", {"sweep.window.length_ms": [700.0, 500.0, 900.0]}, data=path)
    assert {cell.encoder.tau_mem_ms for cell in study.cells(what)} == {25.0}
    assert any(note.startswith("Afferents: membranes of 25 ms, a twentieth of the shortest") for note in what.notes)


@pytest.mark.parametrize("sweep", [{"encoder.tau_mem_ms": [10.0, 30.0]}, {"encoder": ["sa1-ra1-lif"]}])
def test_swept_membranes_are_not_said_to_be_chosen(tmp_path, sweep):
    path = slow_touches(tmp_path / "t.h5", 93.0)
    what = loading.resolve("own-recordings", {f"sweep.{key}": values for key, values in sweep.items()}, data=path)
    assert {cell.encoder.tau_mem_ms for cell in study.cells(what)} == {*sweep.get("encoder.tau_mem_ms", [10.0])}
    assert not any(note.startswith("Afferents: membranes") for note in what.notes)


def test_other_models_keep_their_membranes(tmp_path):
    path = save(tmp_path / "touches.h5", [300] * 12, 93.0)
    what = loading.resolve("own-recordings", {"encoder": "izhikevich"}, data=path)
    assert not any(note.startswith("Afferents: membranes") for note in what.notes)


def test_the_help_of_a_study_names_the_studies_that_take_a_file(tmp_path):
    path, taking = save(tmp_path / "touches.h5", [600] * 12), set()
    for name in specs.spec_names("studies"):
        try:
            loading.resolve(name, data=path)
        except InputError as error:
            if "leave `data` out" in str(error):
                continue
        taking.add(name)
    group: Any = get_command(app)
    (option,) = (each for each in group.commands["run"].params if each.name == "data")
    assert {*re.findall(r"\w+-[\w-]+", option.help)} == taking
