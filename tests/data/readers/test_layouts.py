"""Folders of other makers: conditions in places, names and tables; time stamps; separators, headers, chosen columns."""

import logging
import re
from datetime import datetime, timedelta
from logging.handlers import BufferingHandler
from unittest import mock

import numpy as np
import pytest
import scipy.io
from as_specs import of_folder
from hypothesis import assume, given
from hypothesis import strategies as st
from levels import examples
from neurotact_parts.readers import folder
from neurotact_parts.readers.clock import stamps as clock
from neurotact_parts.readers.folder import conditions_of

import neurotact as nt
from neurotact.data.readers.clock import units
from neurotact.data.readers.specs import NamingSpec
from neurotact.errors import InputError
from neurotact.spec import build


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())


def stamped(n: int = 60, rate_Hz: float = 93.0, jitter_ms: float = 1.2, seed: int = 0):
    """Stamps in ms, ascending, and five taxels that are straight lines of time: interpolation is exact on them."""
    time_ms = np.cumsum(np.random.default_rng(seed).normal(1e3 / rate_Hz, jitter_ms, n))
    return time_ms, 100 + np.outer(time_ms - time_ms[0], np.arange(1, 6))


def test_a_folder_that_was_never_seen_is_read_in_one_call(tmp_path, caplog):
    """5 taxels, 93 Hz with jittered stamps, nested by class and speed, a header, trailing commas, CRLF."""
    for i, place in enumerate(("cork/150", "cork/300", "felt/150", "felt/300/deeper")):
        time_ms, signal = stamped(seed=i)
        rows = [
            ",".join(map(repr, [time, *row])) + "," for time, row in zip(time_ms.tolist(), signal.tolist(), strict=True)
        ]
        write(tmp_path / place / "touch.csv", "\r\n".join(["t_ms,ch1,ch2,ch3,ch4,ch5,", *rows]) + "\r\n")
    with caplog.at_level(logging.WARNING):
        found = nt.read_folder(
            tmp_path,
            unit="count",
            naming=nt.Naming(levels="label,speed"),
            layout=nt.Layout(time_column="t_ms", time_unit="ms"),
        )
    assert found.channels == ("ch1", "ch2", "ch3", "ch4", "ch5")
    assert found.conditions[["label", "speed"]].values.tolist() == [
        ["cork", 150],
        ["cork", 300],
        ["felt", 150],
        ["felt", 300],
    ]
    assert found.sampling_rate_Hz == pytest.approx(93.0, rel=0.02)
    assert "jitter by 1." in caplog.text
    assert "4 of 4 trials are interpolated" in caplog.text
    for signal in found.signals:
        time_ms = 1e3 * np.arange(len(signal)) / found.sampling_rate_Hz
        np.testing.assert_allclose(signal, 100 + np.outer(time_ms, np.arange(1, 6)), rtol=1e-4)


@given(st.floats(5, 5000), st.floats(0, 0.3), st.integers(10, 80), st.integers(0, 2**31))
def test_samples_on_a_clock_are_those_of_a_straight_line(rate_Hz, jitter, n, seed):
    """Wherever the stamps fall, a line through time stays that line, and the clock ends within the recording."""
    gaps = 1 + jitter * np.random.default_rng(seed).uniform(-1, 1, n)
    time = np.concatenate([[0], np.cumsum(gaps)]) / rate_Hz
    stamps = clock.stamps_of(time, "s", "a.csv", 1, None)
    found = clock.on_clock(np.outer(time, [1.0, -2.0]), stamps, rate_Hz)
    ticks = np.arange(len(found)) / rate_Hz
    if not stamps.is_regular:
        np.testing.assert_allclose(found, np.outer(ticks, [1.0, -2.0]), atol=1e-9 + 1e-6 * time[-1])
    assert abs(len(found) - (time[-1] * rate_Hz + 1)) <= 1.5


def test_rounded_stamps_are_regular(caplog):
    """Whole milliseconds of a 93 Hz clock are 10 or 11 apart, which is rounding and no jitter."""
    time = np.round(np.arange(200) * 1e3 / 93)
    stamps = clock.stamps_of(time, "ms", "a.csv", 1, None)
    assert stamps.is_regular
    assert clock.rate_of([stamps]) == pytest.approx(93.0, abs=0.05)
    signal = np.arange(200.0)[:, None]
    assert clock.on_clock(signal, stamps, 93.0) is signal


@pytest.mark.parametrize(
    ("times", "gap", "message"),
    [
        (
            [0, 1, 2, 8, 9],
            None,
            r"line 5 comes 6000 ms after the line before it, where 1000 ms is usual; .*`max_gap_ms`",
        ),
        ([0, 1, 2, 5, 6], 2500.0, "line 5 comes 3000 ms"),
        ([0, 1, 3, 2, 4], None, "line 5 is earlier than the line before it"),
        ([4, 4, 4], None, "holds a single time"),
    ],
)
def test_stamps_that_make_no_clock_are_refused(times, gap, message):
    with pytest.raises(InputError, match=message):
        clock.stamps_of(np.array(times, float), "s", "a.csv", 2, gap)
    clock.stamps_of(np.array([0, 1, 2, 8, 9.0]), "s", "a.csv", 2, 6000.0)


def test_conditions_stand_in_names(tmp_path):
    for label, force, speed in (("Linen", 3, -50), ("Denim", 6, 120)):
        for repetition in ("00", "01"):
            write(tmp_path / "flat" / f"{label}_F{force}_V{speed}mmps_{repetition}.csv", "1,2\n3,4\n")
    found = nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(pattern="{label}_F{force}_V{speed}mmps_{repetition}"))
    assert found.conditions.iloc[0].tolist() == ["Denim", 6, 120, "00", "flat/Denim_F6_V120mmps_00.csv"]
    assert found.conditions["speed"].tolist() == [120, 120, -50, -50]
    with pytest.raises(InputError, match=r"Denim_F6_V120mmps_00\.csv: its name does not fit the pattern \{label\}-"):
        nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(pattern="{label}-{force}.csv"))


def test_conditions_stand_in_a_table(tmp_path):
    for name in ("a/1.csv", "a/2.csv", "b/1.csv"):
        write(tmp_path / name, "1,2\n3,4\n")
    table = tmp_path / "conditions.csv"
    table.write_text("file;label;force\na/1.csv;felt;3\n2.csv;silk;6\nb/1.csv;felt;0.5\n")
    found = nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(table=table))
    assert found.conditions["label"].tolist() == ["felt", "silk", "felt"]
    assert found.conditions["force"].tolist() == [3, 6, 0.5]
    for text, message in (
        ("file,label\na/1.csv,felt\n1.csv,felt\n", "line 3: '1.csv' is the name of 2 files"),
        ("file,label\na/1.csv,felt\n", r"has no line for a/2\.csv \(2 in all\)"),
        ("file,label\nc.csv,felt\n", "line 2: 'c.csv' is not a file of recordings in the folder"),
        ("file,label\na/1.csv,x\na/1.csv,y\n", "line 3: 'a/1.csv' already has a line above"),
        ("file,label\na/1.csv,x,3\n", "line 2 has 3 columns where 2 are expected"),
        ("path,label\na/1.csv,x\n", "has no column 'file'"),
        ("file,force\na/1.csv,3\n2.csv,3\nb/1.csv,3\n", "no condition is called label.*name it with `label`, of force"),
    ):
        table.write_text(text)
        with pytest.raises(InputError, match=message):
            nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(table=table))
    table.write_text("file,material\na/1.csv,cork\n2.csv,denim\nb/1.csv,cork\n")
    found = nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(table=table, label="material"))
    assert found.conditions.columns.tolist() == ["label", "file"]
    assert found.conditions["label"].tolist() == ["cork", "denim", "cork"]
    with pytest.raises(InputError, match="no condition is called materials; did you mean 'material'"):
        nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(table=table, label="materials"))


FILES = st.lists(
    st.tuples(st.sampled_from(["felt", "silk", "3"]), st.integers(0, 99), st.integers(-9, 9), st.integers(0, 9)),
    min_size=1, max_size=8, unique=True,
)  # fmt: skip


@given(FILES)
def test_what_names_say_is_read_back(tmp_path_factory, trials):
    files = [f"{label}/{speed}mm/F{force}_{repetition}.csv" for label, speed, force, repetition in trials]
    naming = NamingSpec(levels="label,{speed}mm", pattern="F{force}_{repetition}.csv")
    found = conditions_of(files, naming, tmp_path_factory.getbasetemp())
    assert found[["label", "speed", "force", "repetition"]].values.tolist() == [list(trial) for trial in trials]
    assert found["file"].tolist() == files


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("1;2;3\n4;5;6\n", {}),
        ("1\t2\t3\n4\t5\t6\n", {}),
        ("1;2;3;\n4;5;6;\n", {}),
        ("# made by a rig\n# on a day\na,b,c\n1,2,3\n4,5,6\n", {}),
        ("rig 7\n\na,b,c\n1,2,3\n4,5,6\n", {"header_lines": 3}),
        ("rig 7\n1,2,3\n4,5,6\n", {"header_lines": 1}),
        ("n,state,a,b,c,\n0,on,1,2,3,\n1,off,4,5,6,\n", {"columns": "3-5"}),
        ("n,state,a,b,c\n0,on,1,2,3\n1,,4,5,6\n", {"columns": ["a", "b", "c"]}),
        ("c,b,a\n3,2,1\n6,5,4\n", {"columns": "a,b,c"}),
        ("1,0;2,0;3,0\n4,0;5,0;6,0\n", {"decimal": ","}),
        ("a;b;c\n1,0;2,0;3,0\n4,0;5,0;6,0\n", {"decimal": ","}),
        ("1,2,0,3\n4,5,1,6\n", {"columns": "1,2,4", "time_column": "3", "sampling_rate_Hz": 1.0}),
    ],
)
def test_one_table_in_many_forms(tmp_path, text, options):
    write(tmp_path / "felt" / "a.csv", text)
    found = nt.read_folder(tmp_path, **of_folder({"sampling_rate_Hz": 100, "unit": "mV", **options}))
    np.testing.assert_array_equal(found.signals[0], [[1, 2, 3], [4, 5, 6]])


def test_columns_are_a_range_of_names_too(tmp_path):
    write(tmp_path / "felt" / "a.csv", "t,p-1,p-2,p-3\n0,1,2,3\n1,4,5,7\n")
    found = nt.read_folder(tmp_path, 100, "mV", layout=nt.Layout(columns="p-1-p-3"))
    assert found.channels == ("p-1", "p-2", "p-3")
    assert nt.read_folder(tmp_path, 100, "mV", layout=nt.Layout(columns="p-3-p-2,t")).channels == ("p-2", "p-3", "t")


def test_a_column_that_never_changes_is_named(tmp_path, caplog):
    """In all files: one that rests in a single trial is silent there, and no mistake."""
    write(tmp_path / "felt" / "a.csv", "p,board_C,q\n1,31.2,3\n2,31.2,3\n")
    write(tmp_path / "silk" / "b.csv", "p,board_C,q\n1,31.2,4\n2,31.2,4\n")
    nt.read_folder(tmp_path, 100, "mV")
    assert "every sample has the same value in board_C; select the taxels with `columns`" in caplog.text
    caplog.clear()
    nt.read_folder(tmp_path, 100, "mV", layout=nt.Layout(columns="p,q"))
    assert "same value" not in caplog.text


def counted(n_samples: int, last: int) -> str:
    """A table without names: a counter that ends in `last`, and two taxels, one that falls once."""
    rows = [f"{row},{row % 7},{row if row else 5}" for row in range(n_samples - 1)]
    return "\n".join([*rows, f"{last},0,99"]) + "\n"


def test_a_column_that_rises_throughout_every_trial_is_named(tmp_path, caplog):
    """A column of time stamps without a name is no taxel; one of two that falls, or short ones, show a signal."""
    write(tmp_path / "felt" / "a.csv", counted(20, 19))
    write(tmp_path / "silk" / "b.csv", counted(30, 29))
    nt.read_folder(tmp_path, 100, "mV")
    expected = "taxel1 rises throughout every trial, as time stamps or a counter do; give `time_column`"
    assert expected in caplog.text
    for texts in ((counted(20, 19), counted(30, 27)), (counted(19, 18), counted(18, 17))):
        for name, text in zip(("felt/a.csv", "silk/b.csv"), texts, strict=True):
            write(tmp_path / name, text)
        caplog.clear()
        nt.read_folder(tmp_path, 100, "mV")
        assert "rises" not in caplog.text
    write(tmp_path / "silk" / "b.csv", counted(30, 29))
    write(tmp_path / "felt" / "a.csv", counted(20, 19))
    caplog.clear()
    for taxels in ("2-3", "1"):  # a counter is no only taxel
        nt.read_folder(tmp_path, 100, "mV", layout=nt.Layout(columns=taxels))
        assert "rises" not in caplog.text


def stamps(column: str, times, taxel: str = "p") -> str:
    return "\n".join([f"{column},{taxel}", *(f"{time!r},{n % 7}" for n, time in enumerate(times))]) + "\n"


def test_a_column_with_the_name_of_time_stamps_is_the_time(tmp_path, caplog):
    """FabricSlide is read in one try: `timestamp` counts ms of a long day, and its rate is found."""
    for label in ("felt", "silk"):
        write(tmp_path / label / "a.csv", stamps("timestamp", range(4_277_465, 4_283_065, 28)))
    found = nt.read_folder(tmp_path, unit="count")
    assert found.channels == ("p",)
    assert found.sampling_rate_Hz == pytest.approx(1e3 / 28, 1e-3)
    assert "the time stamps are taken as ms (trials of 5.57 s at 35.71 Hz); if that is wrong, give" in caplog.text
    caplog.clear()
    assert (
        nt.read_folder(tmp_path, unit="count", layout=nt.Layout(columns="p")).sampling_rate_Hz == found.sampling_rate_Hz
    )
    assert nt.read_folder(tmp_path, 35.6, "count").sampling_rate_Hz == 35.6
    assert nt.read_folder(tmp_path, 1000, "count", layout=nt.Layout(columns="p")).sampling_rate_Hz == 1000, (
        "the stamps are not read"
    )


def day_times(form: str, n: int = 50, begin: str = "2024-01-31T23:59:59.7") -> list[str]:
    """Stamps of 100 Hz around midnight."""
    times = np.datetime64(begin) + 10 * np.arange(n) * np.timedelta64(1, "ms")
    return [f"{time.astype(datetime):{form}}" for time in times]


@pytest.mark.parametrize(
    ("form", "separator", "options"),
    [
        ("%Y-%m-%d %H:%M:%S.%f", ",", {}),
        ("%Y-%m-%dT%H:%M:%S.%f+01:00", ";", {}),
        ("%d.%m.%Y %H:%M:%S,%f", ";", {"decimal": ","}),
        ('"%m/%d/%Y %H:%M:%S.%f"', "\t", {"columns": "left", "time_column": "1"}),
    ],
)
@pytest.mark.parametrize("name", ["logged", "Time"])
def test_times_of_day_are_the_time(tmp_path, form, separator, options, name, caplog):
    rows = [separator.join([time, f"{n % 7}{options.get('decimal', '.')}5"]) for n, time in enumerate(day_times(form))]
    write(tmp_path / "felt" / "a.csv", "\n".join([f"{name}{separator}left", *rows]) + "\n")
    found = nt.read_folder(tmp_path, unit="count", **of_folder(options))
    assert (found.sampling_rate_Hz, found.channels) == (100.0, ("left",))
    assert found.signals[0][:, 0].tolist() == [n % 7 + 0.5 for n in range(50)]
    assert caplog.text == ""


def test_times_of_day_need_no_header(tmp_path):
    write(tmp_path / "felt" / "a.csv", "".join(f"{n},12:00:0{n}.25Z\n" for n in range(9)))
    assert nt.read_folder(tmp_path, unit="V").sampling_rate_Hz == 1


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("time,p\n12:00:01,1\n12:00,2\n", {}, "line 3, column 1 is '12:00', not a time as in 12:00:00.25; repair it"),
        ("time,p\n12:00:01,1\n", {"time_unit": "ms"}, "column 1 holds times of day, which are in seconds; leave"),
        ("time,p\n12:00:01,1\n11:59:59,2\n", {}, "line 3 is earlier than the line before it"),
        ("p,time\n1,12:00:01\n2\n", {}, "line 3 has 1 column where 2 are expected"),
        ("p,at\n1,12:00:01,9\n2,12:00:02\n", {}, "line 2 has 3 columns where 2 are expected"),
    ],
)  # fmt: skip
def test_wrong_times_of_day_are_refused(tmp_path, text, options, message):
    write(tmp_path / "felt" / "a.csv", text)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, unit="V", **of_folder(options))


@given(st.lists(st.integers(0, 86_399_999_999), min_size=2, max_size=20), st.booleans())
def test_seconds_since_the_first_day_are_those_of_the_calendar(steps_us, is_dated):
    """Stamps less than a day apart; without a date, all of one day."""
    since = np.cumsum(steps_us) if is_dated else np.sort(steps_us)
    times = [datetime(2024, 2, 28) + timedelta(microseconds=int(us)) for us in since]
    cells = [f"{time:%Y-%m-%d %H:%M:%S.%f}" if is_dated else f"{time:%H:%M:%S.%f}" for time in times]
    found = units.seconds_of(cells, "a.csv", "time", 2, None)
    np.testing.assert_allclose(np.diff(found), np.diff(since) / 1e6, atol=1e-8)


def test_without_a_rate_or_time_stamps_the_rate_is_asked_for(tmp_path):
    write(tmp_path / "felt" / "a.csv", "q,p\n0.00,1\n0.01,2\n")
    with pytest.raises(InputError, match="the sampling rate is not known; give `sampling_rate_Hz`, or `time_column`"):
        nt.read_folder(tmp_path, unit="mV")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("T,p\n21.0,1\n20.9,2\n", "column 'T' is named like time stamps, but its values fall; choose the taxels with"),
        ("t,time,p\n0.0,0,1\n0.1,1,2\n", r"column 2 \('time'\) looks like time stamps but is not the time column"),
        ("at,t_s,p\n12:00:00,0,1\n12:00:01,1,2\n", r"column 1 \('at'\) looks like time stamps but is not"),
    ],
)
def test_a_column_that_is_only_named_like_time_stamps_is_named(tmp_path, text, message):
    write(tmp_path / "felt" / "a.csv", text)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, unit="mV")
    assert nt.read_folder(tmp_path, 10, "mV", layout=nt.Layout(columns="p")).channels == ("p",)


@given(st.sampled_from(list(units.UNIT_S)), st.floats(10.1, 9.9e4), st.integers(20, 4000), st.floats(0, 1e6))
def test_the_unit_of_stamps_of_touch_is_found_or_asked_for(unit, rate_Hz, n_samples, first):
    """Whatever the unit, it is among those that can be touch; given the rate, it is the only one."""
    trial_s = (n_samples - 1) / rate_Hz
    assume(0.0201 < trial_s < 599)
    time = first + np.arange(n_samples) / rate_Hz / units.UNIT_S[unit]
    found = {each.unit: each for each in units.timings([time, time + 7])}
    assert found[unit].rate_Hz == pytest.approx(rate_Hz, 1e-3)
    assert found[unit].trial_s == pytest.approx(trial_s, 1e-3)
    assert [each.unit for each in units.timings([time], rate_Hz * 1.5)] == [unit]


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("1;2,5\n", {"decimal": "."}, "line 1 has decimal commas; pass `decimal=','`"),
        ("1.5;2,5\n", {}, "line 1 has decimal commas; pass `decimal=','`"),
        ("1,2\n", {"decimal": ","}, "has commas between its columns"),
        ("1,5;2.5\n", {"decimal": ","}, "line 1 holds a point, but commas are decimal"),
        (
            "a,b\n1,2\n",
            {"columns": "3"},
            "`columns`: 3 is not there, since this file has 2 columns, numbered from 1; name columns that it has",
        ),
        ("a,b\n1,2\n", {"columns": "left"}, r"`columns`: there is no column 'left'; known: a, b"),
        ("a,b\n1,2\n", {"columns": "a-c"}, "`columns`: there is no column 'a-c'"),
        ("a,b\n1,2\n", {"time_column": "a-b"}, "`time_column`: there is no column 'a-b'"),
        ("a,b\n1,2\n", {"columns": "1,a"}, "`columns` and `time_column` name a column twice"),
        ("a\n1\n2\n", {"time_column": "a"}, "has no column besides the time"),
        ("t,a\n0,x\n1,2\n", {"time_column": "t"}, r"line 2, column 2 \(a\) is 'x', not a number"),
        ("a,b,\n1,2,\n1,,\n", {}, r"line 3, column 2 \(b\) is empty"),
        ("a,b\n", {"header_lines": 1}, "holds no row of numbers"),
    ],
)
def test_a_layout_that_does_not_fit_is_named(tmp_path, text, options, message):
    write(tmp_path / "felt" / "a.csv", text)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, 100, "mV", **of_folder(options))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"pattern": "touch.csv"}, "pattern must hold a name in braces"),
        ({"pattern": "{label}_{label}.csv"}, "'label' is named twice"),
        ({"levels": "label,my speed"}, "a condition is a word"),
        ({"levels": "label,file"}, "'file' is named twice"),
        ({"pattern": "{}.csv"}, "a condition is a word"),
    ],
)
def test_a_naming_that_cannot_be_is_refused(table, message):
    with pytest.raises(InputError, match=message):
        build(NamingSpec, table, "import folder")


def test_folders_less_deep_than_the_levels_are_named(tmp_path):
    write(tmp_path / "felt" / "a.csv", "1,2\n")
    with pytest.raises(InputError, match=r"a\.csv: is 1 sub-folders deep, but `levels` names 2 \(label, speed\)"):
        nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(levels="label,speed"))


def test_time_stamps_in_another_unit_than_said_are_named(tmp_path, caplog):
    for name in ("felt", "silk"):
        write(tmp_path / name / "a.csv", stamps("timestamp", range(4_277_465, 4_278_025, 28)))
    with pytest.raises(InputError, match=r"stamps give 0\.0357 Hz and `sampling_rate_Hz` says 35\.6 Hz; give the unit"):
        nt.read_folder(tmp_path, 35.6, "count", layout=nt.Layout(time_unit="s"))
    assert nt.read_folder(tmp_path, 35.6, "count", layout=nt.Layout(time_unit="ms")).sampling_rate_Hz == 35.6
    assert "--time-unit" not in caplog.text
    assert nt.read_folder(tmp_path, unit="count", layout=nt.Layout(time_unit="s")).sampling_rate_Hz == pytest.approx(
        1 / 28, 1e-3
    )
    assert "0.03571 Hz is slow for touch; if the unit of the time stamps is another, give it with" in caplog.text
    caplog.clear()
    found = nt.read_folder(tmp_path, unit="count", layout=nt.Layout(time_unit="us"))
    assert found.sampling_rate_Hz == pytest.approx(1e6 / 28, 1e-3)
    assert "the median trial lasts 0.00056 s at 35714.3 Hz, which is short for touch; if the unit" in caplog.text
    caplog.clear()
    assert nt.read_folder(tmp_path, 35.6, "count").sampling_rate_Hz == 35.6
    assert "the time stamps are taken as ms (trials of 0.532 s at 35.71 Hz)" in caplog.text


def test_stamps_that_may_be_in_two_units_are_refused(tmp_path):
    write(tmp_path / "felt" / "a.csv", stamps("time", range(0, 200_000, 100)))
    message = r"may be in ms \(trials of 200 s at 10 Hz\) or us \(trials of 0.2 s at 10,000 Hz\); give their unit with"
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, unit="mV")
    assert nt.read_folder(tmp_path, 10_000, "mV").sampling_rate_Hz == 10_000
    assert nt.read_folder(tmp_path, unit="mV", layout=nt.Layout(time_unit="us")).sampling_rate_Hz == 10_000


@pytest.mark.parametrize(("name", "rate_Hz"), [("t_ms", 500), ("Time [us]", 5e5), ("time (s)", 0.5), ("T_S", 0.5)])
def test_the_name_of_the_time_column_says_its_unit(tmp_path, name, rate_Hz):
    for label in ("felt", "silk"):
        write(tmp_path / label / "a.csv", "\n".join([f"{name},a", *(f"{2 * n},{n % 7}" for n in range(50))]) + "\n")
    assert nt.read_folder(tmp_path, unit="count", layout=nt.Layout(time_column=name)).sampling_rate_Hz == pytest.approx(
        rate_Hz
    )
    assert nt.read_folder(tmp_path, unit="count", layout=nt.Layout(time_column="1")).sampling_rate_Hz == pytest.approx(
        rate_Hz
    )
    assert (
        nt.read_folder(tmp_path, unit="count", layout=nt.Layout(time_column=name, time_unit="ms")).sampling_rate_Hz
        == 500
    )


@pytest.mark.parametrize("name", ["Zeit [ms]", "zeit_ms", "Zeitstempel (ms)", "Temps [ms]", "tempo_ms", "Tiempo (ms)"])
def test_a_time_column_is_found_in_other_languages_with_and_without_a_given_rate(tmp_path, name):
    for label in ("felt", "silk"):
        write(tmp_path / label / "a.csv", "\n".join([f"{name},a", *(f"{20 * n},{n % 7}" for n in range(50))]) + "\n")
    found = nt.read_folder(tmp_path, unit="count"), nt.read_folder(tmp_path, 50, "count")
    assert [(one.sampling_rate_Hz, one.channels) for one in found] == [(50, ("a",))] * 2


def test_text_files_are_recordings_where_there_is_nothing_else(tmp_path, caplog):
    for name in ("gel_1.txt", "gel_2.TXT", "foam_1.tsv"):
        write(tmp_path / name, "left\tright\n1\t2\n3\t4\n")
    found = nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(pattern="{label}_{n}"))
    assert found.conditions[["label", "n"]].values.tolist() == [["foam", 1], ["gel", 1], ["gel", 2]]
    assert found.channels == ("left", "right")
    assert not caplog.messages
    write(tmp_path / "felt_1.csv", "left,right\n1,2\n")
    with caplog.at_level(logging.WARNING):
        assert nt.read_folder(tmp_path, 100, "mV", naming=nt.Naming(pattern="{label}_{n}.csv")).classes == ("felt",)
    assert "ignores 3 files (hidden, or not recordings): foam_1.tsv, gel_1.txt, gel_2.TXT" in caplog.text


def arrays_of(folder, suffix: str, **arrays) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if suffix == ".mat":
        scipy.io.savemat(folder / "a.mat", arrays)
    else:
        np.savez(folder / "a.npz", **arrays)


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize(("name", "options"), [("t", {}), ("time_ms", {}), ("clock", {"time_column": "clock"})])
def test_an_array_of_stamps_gives_the_rate(tmp_path, suffix, transpose, name, options):
    stamps_s = np.arange(80) * 0.004 + 3.0
    touch = np.arange(240).reshape(80, 3) % 11
    stamps = stamps_s * (1e3 if name.endswith("ms") else 1)
    arrays_of(tmp_path / "felt", suffix, touch=touch.T if transpose else touch, **{name: stamps})
    found = nt.read_folder(tmp_path, unit="V", **of_folder(options | {"transpose": transpose}))
    assert (len(found), found.sampling_rate_Hz) == (1, 250.0)
    assert (found.signals[0] == touch).all()
    assert nt.read_folder(tmp_path, 125, "V", **of_folder(options | {"transpose": transpose})).lengths.tolist() == [40]


def test_an_array_of_another_length_is_no_stamps(tmp_path):
    arrays_of(tmp_path / "felt", ".npz", touch=np.ones((80, 3)), t=np.ones((79, 3)))
    assert len(nt.read_folder(tmp_path, 100, "V")) == 2


@pytest.mark.parametrize(
    ("arrays", "options", "message"),
    [
        ({"touch": np.ones((9, 3)), "clock": np.arange(8.0)}, {}, "'touch' has 9 samples and 'clock' 8 time stamps"),
        ({"touch": np.ones((3, 9)), "clock": np.arange(9.0)}, {}, "give each sample one, or use `transpose=True`"),
        ({"touch": np.ones((9, 3))}, {}, "holds no array 'clock'; known: touch"),
        ({"clock": np.arange(9.0)}, {}, "holds no array but the time stamps; save the samples too"),
        ({"touch": np.ones((9, 3)), "clock": np.ones((9, 3))}, {}, "must hold one number per sample as time stamps"),
        ({"touch": np.ones((9, 3)), "clock": np.full(9, np.nan)}, {}, "time stamp 0 is not finite"),
        ({"touch": np.ones((3, 3)), "clock": [0.0, 0.2, 0.1]}, {}, "sample 2 is earlier than the sample before it"),
        ({"touch": np.ones((9, 3))}, {"time_column": None}, "the sampling rate is not known"),
        ({"touch": np.ones((9, 3))}, {"columns": "1"}, "`columns` is for CSV files"),
    ],
)
def test_wrong_arrays_of_stamps_are_refused(tmp_path, arrays, options, message):
    arrays_of(tmp_path / "felt", ".npz", **arrays)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, unit="V", **of_folder({"time_column": "clock"} | options))


@given(st.lists(st.sampled_from([20.0, 50.0, 99.0, 100.0, 125.0]), min_size=1, max_size=8))
@examples(8)
def test_the_common_rate_is_that_of_a_file_and_resampled_trials_are_counted(tmp_path_factory, rates_Hz):
    """Of two rates in the middle it is the faster one; the others are counted."""
    folder = tmp_path_factory.mktemp("rates")
    for trial, rate_Hz in enumerate(rates_Hz):
        write(folder / "felt" / f"{trial}.csv", stamps("time_s", np.round(np.arange(60) / rate_Hz, 6).tolist()))
    handler = BufferingHandler(1000)
    with mock.patch.object(logging.getLogger("neurotact"), "handlers", [handler]):
        found = nt.read_folder(folder, unit="mV")
    messages = [record.getMessage() for record in handler.buffer]
    common_Hz = sorted(rates_Hz)[len(rates_Hz) // 2]
    assert found.sampling_rate_Hz == pytest.approx(common_Hz, rel=1e-3)
    n_others = sum(rate_Hz != common_Hz for rate_Hz in rates_Hz)
    counted_now = [int(match[1]) for line in messages if (match := re.search(r": (\d+) of \d+ trials", line))]
    assert sum(counted_now) == n_others


@given(begin_s=st.integers(0, 86_000) | st.sampled_from([3599, 43_199, 46_799]), ticks=st.integers(6, 40))
@examples(30)
def test_a_time_of_day_is_read_in_each_of_its_forms(tmp_path_factory, begin_s, ticks):
    """12-hour and 24-hour clocks, months by name, minutes and seconds alone: the same recording."""
    times = [datetime(2024, 1, 31) + timedelta(seconds=begin_s + 0.25 * tick) for tick in range(ticks)]
    folder_of = {}
    for name, form in {
        "day": "%H:%M:%S.%f", "half": "%I:%M:%S.%f %p", "month": "%d-%b-%Y %H:%M:%S.%f",
        "dated": "%d-%b-%Y %I:%M:%S.%f%p",
        "minutes": "%M:%S.%f",
    }.items():  # fmt: skip
        folder_of[name] = tmp_path_factory.mktemp(name)
        (folder_of[name] / "felt").mkdir()
        rows = [f"{time.strftime(form)},{tick}.5" for tick, time in enumerate(times)]
        (folder_of[name] / "felt" / "a.csv").write_text("\n".join(["time,left", *rows]) + "\n")
    read = [folder.read(place, None, "mV") for place in folder_of.values()]
    assert {touch.sampling_rate_Hz for touch in read} == {4.0}
    assert all(touch.signals[0].tolist() == [[tick + 0.5] for tick in range(ticks)] for touch in read)


@pytest.mark.parametrize("cells", [("12:00:00 AM", "13:00:01 PM"), ("02:03.5", "00:02:04.5"), ("12:00:00", "00:00 PM")])
def test_a_time_in_another_form_than_the_first_is_refused(cells):
    with pytest.raises(InputError, match=r"line 3, column time is .*, not a time as in"):
        units.seconds_of(cells, "a.csv", "time", 2, None)


@pytest.mark.parametrize("cell", ["02:03", "13:02:03 PM", "00:00:01 AM", "1:2:03:04"])
def test_a_time_that_could_be_two_or_none_is_refused_with_the_forms_that_are_read(tmp_path, cell):
    write(tmp_path / "felt" / "a.csv", f"time,left\n{cell},1\n{cell},2\n")
    with pytest.raises(InputError, match=r"not a time that is read; write it as 12:00:00.25, .* PM or, .* 59:59.25"):
        folder.read(tmp_path, 10, "mV")
