"""Windows that are not given: they begin with the touch and fit into every trial."""

import dataclasses
import logging

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.onset import LATEST, common_onset_s
from neurotact.data.spikes import from_rasters
from neurotact.data.window_choice import (
    ARGUMENTS,
    LONGEST_MS,
    MOST_PER_TRIAL,
    Timing,
    choose,
    suited_window,
    timing_of,
)
from neurotact.data.windows import OF_CLASS, SHORTER, WindowSpec, check_fit, cut, long_enough
from neurotact.errors import InputError
from neurotact.studies import automatic


@given(
    st.lists(st.integers(2, 5000), min_size=1, max_size=30),
    st.sampled_from([35.6, 93.0, 200.0, 500.0, 1000.0, 2000.0, 1234.5]),
    st.floats(0, LATEST),
    st.sampled_from([{}, {"length_ms": 0.1}, {"length_ms": 0.75}, {"start_ms": 0}, {"start_ms": 0.4}]),
)
def test_a_window_fits_into_every_trial(lengths, clock_Hz, touch, shares):
    steps = np.array(lengths)
    shortest_ms = 1e3 * float(steps.min()) / clock_Hz
    asked = {key: max(1e3 / clock_Hz, share * shortest_ms) if share else 0.0 for key, share in shares.items()}
    table, _ = choose(Timing(steps / clock_Hz, clock_Hz, touch * shortest_ms / 1e3), asked)
    windows = cut(steps, clock_Hz, WindowSpec(**{**table, **asked}))
    counts = np.bincount(windows.trial, minlength=len(steps))
    assert np.count_nonzero(counts == 0) <= SHORTER * len(steps)
    assert counts[
        steps >= windows.n_steps + round(asked.get("start_ms", table.get("start_ms", 0)) * clock_Hz / 1e3)
    ].all()
    assert counts.max() <= MOST_PER_TRIAL
    assert windows.n_steps <= np.ceil(asked.get("length_ms", LONGEST_MS) * clock_Hz / 1e3)


def test_windows_start_with_the_touch_unless_a_start_is_given():
    trials = Timing(np.full(20, 2.5), 100.0, touch_s=0.4409)
    table, notes = choose(trials)
    assert table == {"length_ms": 2000.0, "per_trial": 1, "start_ms": 440.0}
    assert notes[1].startswith("Windows start 440 ms after the start of a trial: before, trials differ much less")
    table, notes = choose(Timing(np.array([0.9, 2.0, 2.0]), 100.0, touch_s=0.3))
    assert table["length_ms"] == 600
    assert "600 ms (the shortest trial, 600 ms from 300 ms on)" in notes[0]
    assert "Trial 0 lasts 900 ms, the median trial 2,000 ms, and every window must fit into it;" in notes[-1]
    assert choose(trials, {"length_ms": 2200})[0]["start_ms"] == 300
    assert "start_ms" not in choose(trials, {"length_ms": 2500})[0]
    for given_start in ({"start_ms": 100}, {"start_ms": 0}, {"align": "onset"}):
        table, notes = choose(trials, given_start)
        assert "start_ms" not in table
        assert not [note for note in notes if "Windows start" in note]
    _, notes = choose(Timing(np.full(20, 5.0), 100.0, touch_s=0.5), {"per_trial": 1})
    assert notes[-1].startswith("Only 2,000 ms of the median trial, 4,500 ms from there on, are used;")


@given(st.integers(25, 300), st.floats(0.5, 3.0), st.data())
def test_leaving_out_one_trial_hardly_changes_the_window(n, usual_s, data):
    """Trials within a twentieth of one another, and some far shorter ones: as many as the rule leaves out, or more."""
    rng, limit = np.random.default_rng(data.draw(st.integers(0, 99))), int(SHORTER * (n - 1))
    n_short = data.draw(st.sampled_from([*range(limit), limit + 2, limit + 3]))
    durations_s = usual_s * rng.uniform(1, 1.05, n)
    durations_s[:n_short] = usual_s * data.draw(st.floats(0.05, 0.5))
    every = choose(Timing(durations_s, 1000.0))[0]["length_ms"]
    fewer = choose(Timing(np.delete(durations_s, data.draw(st.integers(0, n - 1))), 1000.0))[0]["length_ms"]
    assert fewer == pytest.approx(every, rel=0.06, abs=1)
    assert (every >= min(1e3 * usual_s, LONGEST_MS) - 1) == (n_short <= limit)


def test_few_short_trials_are_left_out_and_named_once():
    durations_s = np.full(200, 1.5)
    durations_s[17] = 0.1
    table, notes = choose(Timing(durations_s, 1000.0))
    assert table == {"length_ms": 1500.0, "per_trial": 1}
    (named,) = [note for note in notes if "trial 17" in note]
    assert named == (
        "1 of 200 trials is shorter than a window and left out: trial 17, 100 ms; to use them, shorten `length_ms`."
    )
    windows = cut((1000 * durations_s).astype(int), 1000.0, WindowSpec(**table))
    assert windows.trial.tolist() == [*range(17), *range(18, 200)]


@given(st.integers(1, 60), st.integers(1, 60), st.integers(0, 6))
def test_no_class_loses_more_than_its_share_to_a_longer_window(n_first, n_other, n_short):
    classes = np.repeat([0, 1], [n_first, n_other])
    durations_ms = np.full(n_first + n_other, 1000.0)
    durations_ms[: min(n_short, n_first)] = 100.0
    kept = long_enough(durations_ms, classes)
    assert np.count_nonzero(~kept[classes == 0]) <= OF_CLASS * n_first
    assert np.count_nonzero(~kept) <= SHORTER * len(kept)
    may_go = min(n_short, n_first) <= min(OF_CLASS * n_first, SHORTER * len(kept))
    assert durations_ms[kept].min() == (1000 if may_go else 100)


def test_a_class_of_short_trials_keeps_windows():
    trains = late_touches(n_trials=60)
    brief = dataclasses.replace(
        trains, trial_steps=np.where(np.arange(60) == 3, 400, trains.trial_steps),
        steps=[*trains.steps[:3], trains.steps[3][:0], *trains.steps[4:]],
        units=[*trains.units[:3], trains.units[3][:0], *trains.units[4:]],
    )  # fmt: skip
    assert timing_of(brief).touch_s == pytest.approx(timing_of(trains).touch_s, abs=0.06)
    assert suited_window(brief, WindowSpec()).length_ms == 2000
    assert 3 not in nt.windows(brief).groups
    rare = dataclasses.replace(brief, conditions=pd.DataFrame({"label": ["felt"] * 3 + ["silk"] + ["felt"] * 56}))
    assert suited_window(rare, WindowSpec()).length_ms <= 400


def test_a_given_window_leaves_few_shorter_trials_out_and_names_them(caplog):
    steps = np.full(40, 3000)
    steps[7] = 500
    trains = from_rasters(
        [np.zeros((n, 2), bool) for n in steps], 1000.0, "ab", pd.DataFrame({"label": ["a", "b"] * 20})
    )
    assert suited_window(trains, WindowSpec(length_ms=1000, start_ms=0)).length_ms == 1000
    assert caplog.messages == ["1 of 40 trials is shorter than a window and left out: trial 7, 500 ms."]
    steps[[8, 9]] = 600
    with pytest.raises(InputError, match=r"trial 7 lasts 0\.500 s, less than the 1\.000 s"):
        check_fit(steps, 1000.0, WindowSpec(length_ms=1000))


def test_many_trials_have_fewer_windows_each():
    assert choose(Timing(np.full(1000, 10.0), 1000.0))[0]["per_trial"] == 2
    assert choose(Timing(np.full(1001, 10.0), 1000.0))[0]["per_trial"] == 1
    short = {"length_ms": 300}
    assert choose(Timing(np.full(1000, 10.0), 1000.0), short)[0]["per_trial"] == 4
    assert choose(Timing(np.full(5000, 10.0), 1000.0), short)[0]["per_trial"] == 2


def test_a_given_window_is_kept_and_an_odd_trial_is_named():
    assert choose(Timing(np.array([2.0, 2.0]), 1000.0), {"length_ms": 250})[0] == {
        "length_ms": 250.0,
        "per_trial": 4,
    }
    table, (note,) = choose(Timing(np.array([1.9, 1.9]), 1000.0), {"per_trial": 1})
    assert table["per_trial"] == 1
    assert "1900 ms (the shortest trial, 1900 ms), one window per trial;" in note
    assert "2000 ms (2 s at most), one window per trial;" in choose(Timing(np.full(9, 2.1), 100.0))[1][0]
    _, notes = choose(Timing(np.array([2.0, 0.1, 2.0]), 1000.0))
    assert "Trial 1 lasts 100 ms, the median trial 2,000 ms" in notes[-1]


def test_windows_that_leave_most_of_the_trials_out_are_named_with_the_remedy():
    trials = Timing(np.array([5.0, 5.0, 9.0]), 1000.0)
    _, notes = choose(trials, {"per_trial": 1})
    assert notes[-1].startswith("Only the first 2,000 ms of the median trial, 5,000 ms, are used;")
    assert len(choose(trials)[1]) == 1
    for place in ({"start_ms": 2000}, {"align": "onset"}, {"length_ms": 1000.0}):
        assert len(choose(trials, {"per_trial": 1, **place})[1]) == 1


def test_windows_that_overlap_cover_less():
    trials = Timing(np.full(20, 6.0), 100.0)
    _, notes = choose(trials, {"hop_ms": 500.0})
    assert "the first 2,500 ms of the median trial" in notes[-1]  # two windows of 2 s, 500 ms apart
    _, notes = choose(trials)
    assert not [note for note in notes if "are used" in note]


def test_a_start_after_the_end_of_a_trial_is_refused():
    with pytest.raises(InputError, match=r"window\.start_ms: trial 1 lasts 500 ms, so no window can start at 500 ms"):
        choose(Timing(np.array([2.0, 0.5, 2.0]), 1000.0), {"start_ms": 500.0})
    assert choose(Timing(np.array([2.0, 0.5, 2.0]), 1000.0), {"start_ms": 499.0})[0]["length_ms"] == 1


def late_touches(n_trials=12, n_steps=3000, begin=750):
    """Spike trains on a clock of 1 kHz, silent up to `begin`, then with a rate of their own."""
    rng = np.random.default_rng(0)
    rasters = rng.random((n_trials, n_steps, 3)) < rng.uniform(0, 0.2, (n_trials, 1, 3))
    rasters[:, :begin] = 0
    conditions = pd.DataFrame({"label": ["felt", "silk"] * (n_trials // 2)})
    return from_rasters(rasters, 1000.0, ("SA-I left", "SA-I right", "RA-I left"), conditions)


def test_spike_trains_are_cut_where_their_touch_begins(caplog):
    trains = late_touches()
    assert timing_of(trains).touch_s == pytest.approx(0.75, abs=0.061)
    start_ms = np.floor(1e3 * timing_of(trains).touch_s)
    assert suited_window(trains, WindowSpec()) == WindowSpec(length_ms=2000, start_ms=start_ms, per_trial=1)
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == [
        "Window",
        f"Windows start {start_ms:g} ms after the start of a trial",
    ]
    window = suited_window(trains, WindowSpec(start_ms=500, hop_ms=100, per_trial=2))
    assert window == WindowSpec(length_ms=2000, start_ms=500, hop_ms=100, per_trial=2)


def test_the_touch_of_encoded_recordings_is_that_of_the_recordings():
    rng = np.random.default_rng(0)
    signals = rng.normal(0, 0.1, (12, 600, 2))
    signals[:, 120:] += rng.normal(0, 5, (12, 1, 2))
    touches = nt.Recordings(signals, 200.0, "mV", pd.DataFrame({"label": ["felt", "silk"] * 6}))
    spikes = nt.encode(touches, settings={"conditioning.ema_cutoff_Hz": None, "conditioning.resample_Hz": 1000.0})
    assert spikes.touch_s == common_onset_s(touches) == 0.6
    assert timing_of(spikes).touch_s == timing_of(spikes.select([3])).touch_s == 0.6
    assert set(nt.windows(spikes).start_steps.tolist()) == {600}


def test_windows_from_the_onset_on_fit_after_it(caplog):
    begins = [100, 150, 200, 250, 300, 350, 400, 450, 500, 600, 650, 900]
    rasters = np.zeros((12, 1000, 2))
    for raster, begin in zip(rasters, begins, strict=True):
        raster[begin:] = 1
    trains = from_rasters(rasters, 1000.0, ("SA-I a", "RA-I a"), pd.DataFrame({"label": ["felt", "silk"] * 6}))
    window = suited_window(trains, WindowSpec(align="onset"))
    latest = trains.cut(window.model_copy(update={"length_ms": 1.0, "per_trial": 1})).start[-2]
    assert window.length_ms == 1000 - latest  # the last of twelve trials is the late one
    assert f"(the shortest trial, {window.length_ms:g} ms after its onset), up to 2 " in caplog.records[0].getMessage()
    assert trains.cut(window).start.tolist()[-3:] == [latest - 50, latest, latest]


def test_a_given_length_starts_with_the_trial_and_the_rest_is_named(caplog):
    trains = late_touches()
    for given_window in (WindowSpec(length_ms=800), WindowSpec(length_ms=150, start_ms=0), WindowSpec(length_ms=2900)):
        assert suited_window(trains, given_window) == given_window
    assert not caplog.records
    assert suited_window(trains, WindowSpec(length_ms=150), ARGUMENTS) == WindowSpec(length_ms=150)
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    touch_ms = np.floor(1e3 * timing_of(trains).touch_s)
    assert record.getMessage() == (
        f"The touch seems to begin {touch_ms:g} ms after the start of a trial, and windows before it hold only rest; "
        f"to leave them out, give `start_ms={touch_ms:g}`."
    )


def test_python_cuts_the_same_windows_without_a_length():
    trains = late_touches()
    made = nt.windows(trains)
    window = suited_window(trains, WindowSpec())
    assert (made.length_ms, len(made)) == (window.length_ms, len(trains))
    assert set(made.start_steps.tolist()) == {int(window.start_ms)}
    assert len(nt.windows(trains, nt.Window(length_ms=150))) == len(trains) * 20


def pressed(rng: np.random.Generator, onsets: np.ndarray, n_silent: int) -> nt.SpikeTrains:
    """Trials of 3 s at 1000 Hz, four afferents, that fire for 400 ms from their onset on; the first ones never do."""
    rasters = np.zeros((len(onsets), 3000, 4), bool)
    for raster, onset in zip(rasters[n_silent:], onsets[n_silent:], strict=True):
        raster[onset : onset + 400] = rng.random((400, 4)) < rng.uniform(0.1, 0.9)
    return from_rasters(rasters, 1000.0, "abcd", pd.DataFrame({"label": ["a", "b"] * (len(onsets) // 2)}))


@pytest.mark.parametrize(
    ("latest", "n_silent", "is_named"),
    [(2500, 0, True), (2500, 2, True), (2500, 6, False), (900, 0, False)],
    ids=["at any time", "few trials without", "many trials without", "all in the first half"],
)
def test_touches_that_begin_at_different_times_are_named_with_the_remedy(latest, n_silent, is_named, caplog):
    rng = np.random.default_rng(1)
    trains = pressed(rng, rng.integers(400, latest, 60), n_silent)
    with caplog.at_level(logging.WARNING, logger="neurotact"):
        suited_window(trains, WindowSpec())
    said = [line for line in caplog.messages if line.startswith("Touches begin at different times")]
    assert len(said) == is_named
    assert all("try `window=nt.Window(align='onset', per_trial=1, onset=nt.Onset(rest_ms=" in line for line in said)


def test_a_given_start_needs_no_note_on_onsets(caplog):
    rng = np.random.default_rng(1)
    with caplog.at_level(logging.WARNING, logger="neurotact"):
        suited_window(pressed(rng, rng.integers(400, 2500, 60), 0), WindowSpec(start_ms=0.0))
    assert not [line for line in caplog.messages if line.startswith("Touches begin")]


def test_trials_longer_than_a_window_are_all_kept():
    assert long_enough(np.array([2100.0, *[9000.0] * 40])).all()
    assert long_enough(np.linspace(800, 1200, 40)).all()  # of similar lengths, too


def test_a_short_recording_hides_no_begin_of_the_touch(tmp_path):
    rng = np.random.default_rng(0)
    signals = [rng.normal(0, 0.1, (400, 2)) for _ in range(40)]
    for signal in signals:
        signal[120:] += rng.normal(0, 5, 2)
    names = pd.DataFrame({"label": ["felt", "silk"] * 20})
    every = nt.Recordings(signals, 200.0, "mV", names)
    brief = nt.Recordings([signals[0][:30], *signals[1:]], 200.0, "mV", names)
    assert common_onset_s(brief) == common_onset_s(every) == 0.6
    nt.save(brief, tmp_path / "touches.h5")
    timing = automatic.look(tmp_path / "touches.h5").timing
    assert timing.classes is not None
    assert timing.classes.tolist() == brief.labels.tolist()
    assert automatic.window(timing)[0] == {"length_ms": 1400.0, "per_trial": 1, "start_ms": 600.0}
