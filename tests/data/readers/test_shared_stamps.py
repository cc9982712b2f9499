"""Rows that share a time stamp: batches keep their rows, true repeats are dropped and counted, the rest is refused."""

import numpy as np
import pytest
from as_specs import of_folder
from hypothesis import given
from hypothesis import strategies as st
from neurotact_parts.readers.clock import shared as shared_stamps
from neurotact_parts.readers.clock import stamps as clock
from neurotact_parts.readers.clock.shared import Uneven

import neurotact as nt
from neurotact.data.readers.clock import units
from neurotact.errors import InputError


def values(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 2)).astype(np.float32)


def stamps_of(time, unit="s", signal=None, **known) -> clock.Stamps:
    time = np.asarray(time, float)
    return clock.stamps_of(
        time, unit, "a.csv", 2, None, signal=values(len(time)) if signal is None else signal, **known
    )


# --- batches and coarse clocks ----------------------------------------------------------------------


@given(
    per_tick=st.floats(1.15, 100.0), tick=st.sampled_from([1.0, 1e-3]), begin=st.floats(0.0, 1.0),
    n_ticks=st.floats(12.0, 80.0), rounded=st.sampled_from([np.floor, np.ceil, np.round]),
)  # fmt: skip
def test_samples_of_a_regular_clock_with_coarse_stamps_are_all_kept_as_they_are(
    per_tick, tick, begin, n_ticks, rounded
):
    """Wherever the recording begins and ends within a tick: the first and the last batch are cut."""
    rate_Hz = per_tick / tick
    true_s = begin * tick + np.arange(int(n_ticks * tick * rate_Hz)) / rate_Hz
    found = stamps_of(rounded(true_s / tick + 1e-7), "s" if tick == 1.0 else "ms")
    assert found.keep.all()
    assert found.n_shared > 0
    assert found.n_dropped == 0
    assert 1 / found.interval_s == pytest.approx(rate_Hz, rel=2 / (n_ticks - 2) / (tick * rate_Hz))
    signal = values(len(true_s))
    assert clock.on_clock(signal, found, clock.rate_of([found])) is signal


@given(
    n_rows=st.integers(2, 40), late=st.floats(0.0, 0.35), cut=st.integers(0, 39), n=st.integers(8, 60),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_batches_of_equal_size_are_on_one_line_however_late_their_stamps_come(n_rows, late, cut, n, seed):
    arrives_s = np.arange(n) + late * np.random.default_rng(seed).uniform(0, 1, n)
    time_s = np.repeat(arrives_s, n_rows)[min(cut, n_rows - 1) :]
    found = stamps_of(time_s)
    assert found.keep.all()
    assert found.is_regular
    assert 1 / found.interval_s == pytest.approx(n_rows, rel=2.5 * late / n + 1e-9)


@given(seed=st.integers(0, 99), n_rows=st.integers(3, 30), slower=st.floats(1.2, 1.35))
def test_rows_of_a_clock_whose_rate_drifts_stay_between_their_stamp_and_the_next_one(seed, n_rows, slower):
    true_s = np.cumsum(np.linspace(1, slower, 60 * n_rows)) / n_rows
    time_s = np.floor(true_s)
    found = stamps_of(time_s)
    assert found.keep.all()
    assert not found.is_regular
    between_s = found.time_s - found.time_s[0] + time_s[np.argmax(time_s > time_s[0])]
    between_s -= found.time_s[np.argmax(time_s > time_s[0])]
    inner = slice(int(np.argmax(time_s > time_s[0])), len(time_s))
    assert (between_s[inner] >= time_s[inner] - 1e-9).all()
    assert (between_s[inner] < time_s[inner] + 1 + 1e-9).all()
    assert (np.diff(found.time_s) > 0).all()


@pytest.mark.parametrize(
    ("lost", "line"), [([101, 102, 103], 102), (range(100, 110), 92)], ids=["three rows", "a whole second"]
)
def test_lost_rows_of_a_batch_are_named(lost, line):
    time_s = np.delete(np.arange(300) // 10, lost)
    with pytest.raises(
        InputError, match=rf"too unevenly to be spread: \d+ within [12] s from line {line} on, where [12]0"
    ):
        stamps_of(time_s)


def test_a_lost_batch_is_named_and_not_hidden_in_the_rate():
    arrives_s = np.delete(np.arange(100.0), 50) + np.random.default_rng(0).uniform(0, 0.2, 99)
    assert isinstance(shared_stamps.spread(np.repeat(arrives_s, 8) - arrives_s[0], 1e-9), Uneven)
    with pytest.raises(
        InputError, match=r"where 1\d\.?\d* are usual; give `sampling_rate_Hz` if the samples are regular"
    ):
        stamps_of(np.repeat(arrives_s, 8))


BURSTS = np.repeat(np.arange(6.0), [10, 7, 30, 2, 18, 4])


def test_uneven_bursts_are_samples_of_the_given_rate_if_they_last_as_long():
    found = stamps_of(BURSTS, given_Hz=12.0)
    assert found.keep.all()
    assert found.interval_s == pytest.approx(1 / 12)
    with pytest.raises(InputError, match=r"do not last as long as at 100 Hz; correct or leave out `sampling_rate_Hz`"):
        stamps_of(BURSTS, given_Hz=100.0)
    assert stamps_of(BURSTS, drop_repeats=True).n_dropped == len(BURSTS) - 6


def test_a_given_rate_that_fits_coarse_stamps_is_exact():
    signal, time_ms = values(1000), np.floor(np.arange(1000) / 3.001)
    found = stamps_of(time_ms, "ms", signal, given_Hz=3000.0)
    assert clock.on_clock(signal, found, 3000.0) is signal


def test_stamps_that_their_type_rounds_are_of_a_regular_clock():
    """float32 holds 40,000 s to 4 ms, in which a skin of 1 kHz has four samples, and 5,000 s to half a millisecond."""
    for begins_s, is_shared in ((40_000, True), (5_000, False)):
        time_s = (begins_s + np.arange(5000) / 1000).astype(np.float32).astype(float)
        found = stamps_of(time_s)
        assert found.keep.all()
        assert (found.n_shared > 0) == is_shared
        assert found.is_regular
        assert clock.rate_of([found]) == pytest.approx(1000.0, abs=0.3)


# --- true repeats -----------------------------------------------------------------------------------


@given(
    at=st.lists(st.integers(1, 299), min_size=1, max_size=12, unique=True), seed=st.integers(0, 99),
    jitter=st.floats(0.0, 3.0),
)  # fmt: skip
def test_rows_that_were_written_twice_are_dropped(at, seed, jitter):
    time_ms = np.arange(300) * 10.0 + np.random.default_rng(seed).uniform(0, jitter, 300)
    signal = values(300, seed)
    twice = np.sort(np.r_[np.arange(300), at])
    found = stamps_of(time_ms[twice], "ms", signal[twice])
    assert found.n_dropped == len(at)
    np.testing.assert_array_equal(signal[twice][found.keep], signal)


def test_a_resting_skin_repeats_its_values_by_chance():
    """A quantised sensor at rest: rows of a batch are equal and yet samples; a held reading is one sample."""
    time_s = np.arange(300) // 10
    for resting in (np.ones((300, 1)), np.round(np.random.default_rng(0).normal(0, 0.3, (300, 1)))):
        assert stamps_of(time_s, signal=resting).n_dropped == 0
    assert stamps_of(time_s, signal=np.repeat(values(30), 10, axis=0)).n_dropped == 270


def folder_of(place, time: np.ndarray, signal: np.ndarray, n_files: int = 2, column: str = "t_ms"):
    for label in ("felt", "silk"):
        (place / label).mkdir(parents=True, exist_ok=True)
        for number in range(n_files):
            rows = (f"{t:.10g},{a:.5g},{b:.5g}\n" for t, (a, b) in zip(time, signal, strict=True))
            (place / label / f"{number}.csv").write_text(f"{column},left,right\n" + "".join(rows))
    return place


def test_no_import_drops_more_than_a_twentieth_of_the_rows_unasked(tmp_path, caplog):
    twice = np.sort(np.r_[np.arange(200), np.arange(0, 200, 25)])
    few = folder_of(tmp_path / "few", (np.arange(200) * 10.0)[twice], values(200)[twice])
    assert nt.read_folder(few, unit="mV").lengths.tolist() == [200] * 4
    (said,) = [each for each in caplog.messages if "rows" in each]
    assert said.endswith(
        "few: 32 of 832 rows repeat the time stamp of the row before them and are dropped (in 4 of 4 trials; the first "
        "is felt/0.csv)"
    )
    twice = np.repeat(np.arange(200), 2)
    many = folder_of(tmp_path / "many", (np.arange(200) * 10.0)[twice], values(200)[twice])
    with pytest.raises(
        InputError, match=r"many: 800 of 1,600 rows repeat the row before them .* with `drop_repeats=True`"
    ):
        nt.read_folder(many, unit="mV")
    assert nt.read_folder(many, unit="mV", layout=nt.Layout(drop_repeats=True)).lengths.tolist() == [200] * 4
    assert nt.read_folder(many, 200, "mV").lengths.tolist() == [400] * 4, "each row is a sample of its own"


def test_spread_rows_are_counted_once(tmp_path, caplog):
    seconds = folder_of(tmp_path / "seconds", np.arange(7, 293) // 10, values(286), column="time_s")
    touches = nt.read_folder(seconds, unit="mV")
    assert touches.lengths.tolist() == [286] * 4
    assert touches.sampling_rate_Hz == 10
    (said,) = caplog.messages
    assert "seconds: 1,024 of 1,144 rows have the time stamp of the row before them (in 4 of 4 trials); all are" in said
    assert "at 10 Hz; if that is wrong, give `sampling_rate_Hz` or `drop_repeats=True`" in said


def test_single_precision_stamps_of_an_array_keep_their_samples(tmp_path, caplog):
    (tmp_path / "felt").mkdir()
    time_s = (40_000 + np.arange(2000) / 1000).astype(np.float32)
    np.savez(tmp_path / "felt" / "0.npz", pressure=values(2000), time_s=time_s)
    touches = nt.read_folder(tmp_path, unit="mV")
    np.testing.assert_array_equal(touches.signals[0], values(2000))
    assert touches.sampling_rate_Hz == pytest.approx(1000, abs=0.5)
    assert "rows have the time stamp of the row before them (in 1 of 1 trials); all are kept" in caplog.text


def test_short_trials_take_the_rate_of_longer_ones(tmp_path):
    place = folder_of(tmp_path, np.arange(60) // 10, values(60), column="time_s")
    (place / "felt" / "short.csv").write_text(
        "time_s,left,right\n" + "".join(f"{k // 10},{k},1\n" for k in range(6, 14))
    )
    assert sorted(nt.read_folder(place, unit="mV").lengths.tolist()) == [8, 60, 60, 60, 60]
    for path in place.glob("*/[0-9].csv"):
        path.unlink()
    (place / "silk").rmdir()
    with pytest.raises(
        InputError, match=r"short\.csv: 6 of 8 rows have .*, and two time stamps do not tell the sampling"
    ):
        nt.read_folder(place, unit="mV")
    assert nt.read_folder(place, 10, "mV").lengths.tolist() == [8]


def test_one_stamp_for_all_rows_needs_the_rate(tmp_path):
    place = folder_of(tmp_path, np.full(50, 1.7e9), values(50), column="time_s")
    with pytest.raises(
        InputError, match="holds a single time in 50 rows, and a sampling rate needs two; give `sampling_rate_Hz`"
    ):
        nt.read_folder(place, unit="mV")
    assert nt.read_folder(place, 100, "mV").lengths.tolist() == [50] * 4


@pytest.mark.parametrize(("option", "value"), [("drop_repeats", True), ("max_gap_ms", 50.0)])
def test_an_option_of_stamps_without_stamps_is_refused(tmp_path, option, value):
    place = folder_of(tmp_path, values(50)[:, 0], values(50), column="shear")
    option_in_words = f"`{option}`"
    with pytest.raises(InputError, match=f"{option_in_words}: the samples have no time stamps"):
        nt.read_folder(place, 100, "mV", **of_folder({option: value}))


def test_drop_repeats_without_repeats_is_refused(tmp_path):
    place = folder_of(tmp_path, np.arange(50) * 10.0, values(50))
    with pytest.raises(
        InputError, match="`drop_repeats`: no row has the time stamp of the row before it; leave it out"
    ):
        nt.read_folder(place, unit="mV", layout=nt.Layout(drop_repeats=True))


def test_a_table_of_whole_seconds_keeps_its_rows(tmp_path, caplog):
    rows = [
        f"{trial},{'ab'[trial % 2]},{k // 10},{a:.4f}\n" for trial in range(4) for k, a in enumerate(values(60)[:, 0])
    ]
    path = tmp_path / "all.csv"
    path.write_text("trial,label,time_s,left\n" + "".join(rows))
    touches = nt.read_table(path, unit="mV")
    assert touches.lengths.tolist() == [60] * 4
    assert touches.sampling_rate_Hz == 10
    assert len([each for each in caplog.messages if "have the time stamp of the row before them" in each]) == 1
    assert nt.read_table(path, unit="mV", layout=nt.Layout(drop_repeats=True)).lengths.tolist() == [6] * 4


def test_whole_seconds_without_a_unit_are_seconds(tmp_path):
    place = folder_of(tmp_path, np.arange(300) // 10, values(300), column="time")
    assert nt.read_folder(place, unit="mV").sampling_rate_Hz == 10


# --- clocks that are set ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("jump_s", "message"),
    [
        (
            -3600.0,
            r"line 52 is earlier than the line before it, by 3600 s \(a clock that was set, as for daylight-saving",
        ),
        (3600.0, r"line 52 comes 3\.6e\+06 ms after the line before it, where 10 ms is usual \(a clock that was set"),
        (
            -0.5,
            r"line 52 is earlier than the line before it, by 0\.49 s; sort the rows, cut the file there, or drop it",
        ),
    ],
)
def test_a_clock_that_was_set_is_named(jump_s, message):
    with pytest.raises(InputError, match=message):
        stamps_of(np.arange(100) * 0.01 + np.where(np.arange(100) < 50, 0.0, jump_s))


@pytest.mark.parametrize(
    "cells",
    [
        ["23:59:59.0", "23:59:59.5", "00:00:00.0", "00:00:00.5"],
        ["2024-10-27 02:59:59.0+02:00", "2024-10-27 02:59:59.5+02:00", "2024-10-27 02:00:00+01:00",
         "2024-10-27 02:00:00.5 +0100"],
        ["2024-03-31T00:59:59.0Z", "2024-03-31T00:59:59.5Z", "2024-03-31T03:00:00+02:00",
         "2024-03-31T03:00:00.5+02:00"],
        ["2024-12-31 23:59:59-05:30", "2024-12-31 23:59:59.5-05:30", "2025-01-01 00:00:00-05:30",
         "2025-01-01 00:00:00.5-05:30"],
    ],
)  # fmt: skip
def test_times_of_day_go_on_over_midnight_and_changes_of_the_zone(cells):
    assert np.diff(units.seconds_of(cells, "a.csv", "time", 2, None)).tolist() == [0.5] * 3


def test_files_in_different_units_are_refused(tmp_path):
    folder_of(tmp_path, np.arange(300) * 0.01, values(300), column="time")
    folder_of(tmp_path, np.arange(300) * 10.0, values(300), n_files=1, column="time")
    with pytest.raises(
        InputError, match=r"give 1e\+05 Hz in \w+/1\.csv and 100 Hz in \w+/0\.csv; if their units differ, write"
    ):
        nt.read_folder(tmp_path, unit="mV")


@given(st.integers(2, 80), st.integers(2, 9))
def test_a_slower_file_keeps_its_length(n, times):
    found = clock.stamps_of(np.arange(n) / 10.0, "s", "a.csv", 2, None)
    signal = np.arange(n)[:, None].astype(np.float32)
    again = clock.on_clock(signal, found, 10.0 * times)
    assert len(again) == times * n
    np.testing.assert_array_equal(again[::times], signal)
    np.testing.assert_array_equal(again[-times:], np.repeat(signal[-1:], times, axis=0))
