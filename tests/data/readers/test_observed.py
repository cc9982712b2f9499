"""Trials that were not observed whole: an unobserved unit never reads as silent unasked."""

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.readers.events.observed import observed_trials, touching, within
from typer.testing import CliRunner

import neurotact as nt
from neurotact.cli import app
from neurotact.errors import InputError

N_TRIALS = 20
STARTS = np.arange(N_TRIALS) * 2.0
"""Trials of 1 s, one every 2 s."""

spans = st.lists(
    st.tuples(st.integers(0, 30), st.integers(0, 9)).map(lambda pair: (pair[0], pair[0] + pair[1])), max_size=6
)
trials = st.lists(st.tuples(st.integers(0, 30), st.integers(1, 9)), min_size=1, max_size=6)


@given(trials, spans)
def test_a_trial_is_observed_and_touched_as_its_moments_are(trials, spans):
    """Against a count of moments: tenths of a second of an hour, of which each is within intervals or not."""
    start, stop = (np.array(each, float) for each in zip(*((a, a + n) for a, n in trials), strict=True))
    intervals = np.array(spans, float).reshape(-1, 2)
    moments = np.arange(0, 60, 0.1) + 0.05
    inside = ((moments[:, None] > intervals[:, 0]) & (moments[:, None] < intervals[:, 1])).any(axis=1)
    of_trial = [inside[(moments > a) & (moments < b)] for a, b in zip(start, stop, strict=True)]
    assert within(start, stop, intervals, 1e-6).tolist() == [bool(each.all()) for each in of_trial]
    assert touching(start, stop, intervals, 1e-6).tolist() == [bool(each.any()) for each in of_trial]


def session(path, observed=(), invalid=(), **more):
    """An NWB file of four units that fire every 0.1 s, and of trials of two cloths in two phases.

    observed: the intervals of each unit. more: datasets by their place, with __ for /.
    """
    times = np.arange(0, 2 * N_TRIALS, 0.1) + 0.05
    texts = h5py.string_dtype()
    with h5py.File(path, "w") as file:
        file["units/id"] = np.arange(4)
        file["units/spike_times"] = np.tile(times, 4)
        file["units/spike_times_index"] = len(times) * np.arange(1, 5)
        file["units/quality"] = np.array(["good", "noise", "good", "good"], texts)
        file["intervals/trials/id"] = np.arange(N_TRIALS)
        file["intervals/trials/start_time"], file["intervals/trials/stop_time"] = STARTS, STARTS + 1
        file["intervals/trials/cloth"] = np.array(["felt", "silk"] * (N_TRIALS // 2), texts)
        file["intervals/trials/phase"] = np.array(["early"] * (N_TRIALS // 2) + ["late"] * (N_TRIALS // 2), texts)
        if observed:
            file["units/obs_intervals"] = np.array([each for unit in observed for each in unit], float).reshape(-1, 2)
            file["units/obs_intervals_index"] = np.cumsum([len(unit) for unit in observed])
        if len(invalid):
            ends = np.array(invalid, float)
            file["intervals/invalid_times/start_time"], file["intervals/invalid_times/stop_time"] = ends.T
        for place, value in more.items():
            file[place.replace("__", "/")] = np.array(value, texts) if isinstance(value[0], str) else np.asarray(value)
    return path


def read(path, where=None, **settings) -> nt.SpikeTrains:
    found = nt.read_nwb(path, label="cloth", step_ms=10, **settings, where=where)
    assert isinstance(found, nt.SpikeTrains)
    return found


WHOLE = [[0.0, 2 * N_TRIALS]]


def test_a_session_that_is_observed_whole_says_nothing(tmp_path, caplog):
    assert len(read(session(tmp_path / "a.nwb"))) == N_TRIALS
    pieces = [[start, start + 2.0] for start in STARTS]  # intervals that follow one another are one
    rounded = [[start - 0.5, start + 1 - 0.004] for start in STARTS]  # to a step
    observed = (WHOLE, pieces, rounded, [])  # the last: nothing is said of it
    assert len(read(session(tmp_path / "a.nwb", observed, invalid=[[1.0, 2.0], [1.5, 1.9]]))) == N_TRIALS
    assert not [line for line in caplog.messages if "in no trial" not in line]


def test_trials_that_a_unit_does_not_observe_are_left_out_and_counted(tmp_path, caplog):
    path = session(tmp_path / "a.nwb", (WHOLE, [[0.5, 99.0]], WHOLE, [[0.0, 38.5]]))
    found = read(path)
    assert len(found) == N_TRIALS - 2
    assert found.conditions["cloth" if "cloth" in found.conditions else "label"].tolist() == ["silk", "felt"] * 9
    assert {*np.concatenate(found.units).tolist()} == {0, 1, 2, 3}
    assert (
        f"{path}: 2 of 20 trials are left out: 2 are not observed whole by unit1 (observes 19 of 20), unit3 (observes "
        "19 of 20)" in caplog.messages
    )


def test_more_than_a_tenth_is_refused_with_the_units_to_leave_out(tmp_path, caplog):
    path = session(tmp_path / "a.nwb", (WHOLE, [[0.0, 5.0]], WHOLE, [[30.0, 99.0]]))
    with pytest.raises(InputError) as refusal:
        read(path)
    assert str(refusal.value) == (
        f"{path}: 20 of 20 trials would be left out, more than 10 %: 20 are not observed whole by unit1 (observes 3 of "
        "20), unit3 (observes 5 of 20), of which 2 observe fewer than half; leave units out with "
        "`leave_out_units={'name': 'unit1'}`, or read what was not observed as silent with `unobserved='silent'`"
    )
    assert len(read(path, leave_out_units={"name": ["unit1", "unit3"]})) == N_TRIALS
    assert "2 of 4 units are kept: without name = unit1 or unit3" in caplog.text
    silent = read(path, unobserved="silent")
    assert len(silent) == N_TRIALS
    assert (
        "20 of 20 trials are kept, and read as silent what was not observed: 20 are not observed whole by unit1"
        in caplog.text
    )
    part = session(tmp_path / "b.nwb", (WHOLE, [[0.0, 30.5]], WHOLE, WHOLE))
    with pytest.raises(InputError, match="leave these trials out with `unobserved='leave-out'`, or read what was not"):
        read(part)
    assert len(read(part, unobserved="leave-out")) == 15
    late = session(tmp_path / "c.nwb", ([[19.0, 99.0]],) * 4)  # of the trials that are asked for, all are observed
    assert len(read(late, where={"phase": "late"})) == N_TRIALS // 2


@pytest.mark.parametrize(("n_lost", "policy", "is_kept"), [
    (2, None, True), (3, None, False), (19, "leave-out", True), (20, "leave-out", False),
])  # fmt: skip
def test_some_trials_are_left_and_no_more_than_a_tenth_are_left_out_unasked(n_lost, policy, is_kept):
    observed = np.arange(N_TRIALS)[None] >= n_lost
    if is_kept:
        assert observed_trials(observed, ["a"], policy, "a.nwb", fix="drop {}").sum() == N_TRIALS - n_lost
        return
    with pytest.raises(InputError, match=f"a.nwb: {n_lost} of 20 trials would be left out.*drop a"):
        observed_trials(observed, ["a"], policy, "a.nwb", fix="drop {}")


@pytest.mark.parametrize("series", [None, "touch"])
def test_trials_that_touch_invalid_times_are_left_out(tmp_path, series, caplog):
    path = session(tmp_path / "a.nwb", invalid=[[2.9, 3.0], [3.0, 4.1], [39.0, 99.0]])
    with h5py.File(path, "r+") as file:
        file["acquisition/touch/data"] = np.random.default_rng(0).normal(size=(40 * 50, 2))
        file["acquisition/touch/starting_time"] = 0.0
        file["acquisition/touch/starting_time"].attrs["rate"] = 50.0
    asked = {"label": "cloth"} | ({"step_ms": 10} if series is None else {"series": series, "unit": "V"})
    found = nt.read_nwb(path, **asked)
    assert len(found) == N_TRIALS - 2
    assert f"{path}: 2 of 20 trials are left out: 2 touch invalid times" in caplog.messages
    assert len(nt.read_nwb(path, **asked, unobserved="silent")) == N_TRIALS
    with pytest.raises(InputError, match=r"more than 10 %: 20 touch invalid times; read what was not observed as s"):
        nt.read_nwb(session(tmp_path / "b.nwb", invalid=[[0.0, 99.0]]), label="cloth")


def test_units_are_chosen_by_their_columns_and_those_of_their_electrodes(tmp_path, caplog):
    electrodes = {
        "general__extracellular_ephys__electrodes__id": [10, 11, 12],
        "general__extracellular_ephys__electrodes__location": ["S1", "M1", "S1"],
        "units__electrodes": [0, 1, 2, 0, 2], "units__electrodes_index": [1, 2, 4, 5],
    }  # fmt: skip
    path = session(tmp_path / "a.nwb", **electrodes)
    assert read(path, units={"quality": "good"}).afferents == ("unit0", "unit2", "unit3")
    found = read(path, units={"location": "S1"}, leave_out_units={"name": "unit0"})
    assert found.afferents == ("unit2", "unit3")
    whole = read(path)
    for mine, its, units in zip(found.steps, whole.steps, whole.units, strict=True):
        assert mine.tolist() == its[units >= 2].tolist()
    assert "2 of 4 units are kept: location = S1 without name = unit0" in caplog.text
    with pytest.raises(
        InputError, match=r"`units`: no unit has quality = god; did you mean 'good'\? quality is good, noi"
    ):
        read(path, units={"quality": "god"})
    with pytest.raises(InputError, match="`units`: there is no column 'qualty'; did you mean 'quality'"):
        read(path, units={"qualty": "good"})
    with pytest.raises(InputError, match="`units` is for spikes of units; drop it"):
        nt.read_nwb(path, label="cloth", series="touch", units={"quality": "good"})
    words = ["import", "nwb", str(path), "--label", "cloth", "--step-ms", "10", "--units", "quality=good"]
    words += ["--units", "name!=unit0", "--where", "cloth=silk", "--where", "phase=late", "-o", str(tmp_path / "a.h5")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.exception
    mine = nt.load(tmp_path / "a.h5")
    assert isinstance(mine, nt.SpikeTrains)
    assert mine.afferents == ("unit2", "unit3")
    assert mine.conditions["label"].tolist() == ["silk"] * 5
    assert mine.conditions["phase"].tolist() == ["late"] * 5


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"units__obs_intervals": [[0.0, 9.0]], "units__obs_intervals_index": [1, 1, 1]}, "obs_intervals_index does"),
        ({"units__obs_intervals": [0.0, 9.0], "units__obs_intervals_index": [1, 1, 1, 1]}, "has the shape (2,) where"),
        ({"units__obs_intervals": [[9.0, 0.0]], "units__obs_intervals_index": [1, 1, 1, 1]}, "interval 0 lasts from 9"),
        ({"units__obs_intervals": [[0.0, np.nan]], "units__obs_intervals_index": [1, 1, 1, 1]}, "from 0 s to nan s"),
    ],
)  # fmt: skip
def test_intervals_that_fit_nothing_are_refused(tmp_path, more, message):
    with pytest.raises(InputError) as refusal:
        read(session(tmp_path / "a.nwb", **more))
    assert message in str(refusal.value)


def test_columns_of_a_series_have_the_names_of_its_electrodes(tmp_path):
    path = session(tmp_path / "a.nwb", general__extracellular_ephys__electrodes__id=[7, 8, 9])
    with h5py.File(path, "r+") as file:
        file["acquisition/touch/data"] = np.random.default_rng(0).normal(size=(40 * 50, 2))
        file["acquisition/touch/electrodes"] = [2, 0]
        file["acquisition/touch/starting_time"] = 0.0
        file["acquisition/touch/starting_time"].attrs["rate"] = 50.0
    asked = {"label": "cloth", "series": "touch", "unit": "V"}
    found = nt.read_nwb(path, **asked)
    assert isinstance(found, nt.Recordings)
    assert found.channels == ("electrode9", "electrode7")
    with h5py.File(path, "r+") as file:
        file["general/extracellular_ephys/electrodes/label"] = np.array(["tip", "palm", "nail"], h5py.string_dtype())
    named = nt.read_nwb(path, **asked)
    assert isinstance(named, nt.Recordings)
    assert named.channels == ("nail", "tip")
