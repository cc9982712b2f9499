"""Seconds beside nanoseconds are one time stamp: in folders and tables, by name or as asked for."""

import numpy as np
import pytest
from as_specs import of_folder, of_table
from hypothesis import given
from hypothesis import strategies as st

import neurotact as nt
from neurotact.data.readers.clock import units as split_stamps
from neurotact.data.readers.columns import LayoutSpec, samples_of
from neurotact.data.readers.table.cells import table_of
from neurotact.errors import InputError

PER_SECOND = {"nanosec": 10**9, "nsecs": 10**9, "nanoseconds": 10**9, "tv_usec": 10**6, "msec": 1000, "ms": 1000}


@given(
    begins_s=st.integers(0, 1_800_000_000), steps=st.lists(st.integers(1, 10**9), min_size=2, max_size=30),
    name=st.sampled_from([*PER_SECOND]),
)  # fmt: skip
def test_joined_stamps_are_those_that_were_split(begins_s, steps, name):
    per_second = PER_SECOND[name]
    ticks = begins_s * per_second + np.cumsum([each % per_second + 1 for each in steps])
    seconds, rest = np.divmod(ticks, per_second)
    found = split_stamps.joined(seconds.astype(float), rest.astype(float), name, "a.csv", 2)
    np.testing.assert_allclose(found - found[0], (ticks - ticks[0]) / per_second, atol=1e-6)


NAMES = [
    ("sec", "nanosec"), ("header.stamp.sec", "header.stamp.nanosec"), ("stamp_secs", "stamp_nsecs"),
    ("tv_sec", "tv_usec"), ("Seconds", "Nanoseconds"), ("stampSec", "stampNanosec"),
]  # fmt: skip


def rows_of(begins_s: int = 1_700_000_000, n: int = 150, rate_Hz: int = 100, rest: str = "nanosec"):
    ticks = np.arange(n) * (10**9 // rate_Hz) + 730_000_000
    per_rest = 1000 if "usec" in rest.lower() else 1
    values = np.random.default_rng(0).normal(size=n)
    return [
        (int(tick // 10**9) + begins_s, int(tick % 10**9) // per_rest, f"{value:.4f}")
        for tick, value in zip(ticks, values, strict=True)
    ]


def folder_of(place, header: str, rows):
    for label in ("felt", "silk"):
        (place / label).mkdir()
        (place / label / "0.csv").write_text(header + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return place


@pytest.mark.parametrize(("seconds", "rest"), NAMES)
def test_columns_that_are_named_as_seconds_and_their_rest_are_joined(tmp_path, caplog, seconds, rest):
    place = folder_of(tmp_path, f"{seconds},{rest},left\n", rows_of(rest=rest))
    touches = nt.read_folder(place, unit="mV")
    assert touches.channels == ("left",)
    assert touches.lengths.tolist() == [150, 150]
    assert touches.sampling_rate_Hz == 100
    assert not caplog.messages


def test_the_columns_may_be_asked_for_by_name_or_number(tmp_path):
    rows = [(row[2], *row[:2]) for row in rows_of()]
    (tmp_path / "named").mkdir()
    named = folder_of(tmp_path / "named", "left,a,b\n", rows)
    for asked in ("a,b", "2,3", " a , b "):
        touches = nt.read_folder(named, unit="mV", layout=nt.Layout(time_column=asked))
        assert (touches.channels, touches.sampling_rate_Hz) == (("left",), 100)
    (tmp_path / "numbered").mkdir()
    assert (
        nt.read_folder(
            folder_of(tmp_path / "numbered", "", rows), unit="mV", layout=nt.Layout(time_column="2,3")
        ).n_channels
        == 1
    )


def test_times_of_day_have_their_rest_in_another_column(tmp_path):
    rows = [(f"12:00:{20 + k // 50:02d}", 20 * (k % 50), k % 7) for k in range(200)]
    touches = nt.read_folder(
        folder_of(tmp_path, "time,ms,left\n", rows), unit="mV", layout=nt.Layout(time_column="time,ms")
    )
    assert (touches.channels, touches.sampling_rate_Hz, touches.lengths.tolist()) == (("left",), 50, [200, 200])


def test_a_table_joins_them_too(tmp_path):
    lines = [f"{t},{'ab'[t % 2]},{','.join(map(str, row))}\n" for t in range(4) for row in rows_of(n=60)]
    (tmp_path / "all.csv").write_text("trial,label,sec,nanosec,left\n" + "".join(lines))
    for options in ({}, {"time_column": "sec,nanosec"}):
        touches = nt.read_table(tmp_path / "all.csv", unit="mV", **of_table(options))
        assert (touches.channels, touches.sampling_rate_Hz, touches.lengths.tolist()) == (("left",), 100, [60] * 4)
        assert list(touches.conditions) == ["label", "trial"]


@pytest.mark.parametrize(("names", "asked"), [(("sec", "nanosec"), None), (("begin", "beyond"), "begin,beyond")])
def test_arrays_of_seconds_and_their_rest_are_joined(tmp_path, names, asked):
    seconds, rest, left = np.array(rows_of(), float).T
    for label in ("felt", "silk"):
        (tmp_path / label).mkdir()
        stamps = {names[0]: seconds.astype(np.int64), names[1]: rest.astype(np.uint32)}
        np.savez(tmp_path / label / "0.npz", pressure=np.stack([left, -left], axis=1), **stamps)
    touches = nt.read_folder(tmp_path, unit="mV", layout=nt.Layout(time_column=asked))
    assert (touches.n_channels, touches.sampling_rate_Hz, touches.lengths.tolist()) == (2, 100, [150, 150])


def test_channels_of_a_group_are_joined():
    seconds, rest, left = np.array(rows_of(), float).T
    table = samples_of(table_of("felt.tdms", {"sec": seconds, "nanosec": rest, "left": left}), LayoutSpec())
    assert (table.names, table.time_unit) == (("left",), "s")
    assert table.time is not None
    np.testing.assert_allclose(np.diff(table.time), 0.01, atol=1e-6)


@pytest.mark.parametrize(
    ("header", "row", "options", "message"),
    [
        ("sec,nanosec,p\n", "7,1000000000,1\n8,0,2\n", {}, "line 2: nanosec is 1000000000 ns, not the rest of a"),
        ("sec,nanosec,p\n", "7,-1,1\n8,0,2\n", {}, "line 2: nanosec is -1 ns, not the rest of a second; name the time"),
        ("sec,msec,p\n", "0.5,500,1\n0.7,700,2\n", {}, r"line 2: the seconds are 0\.5, not whole, so that msec"),
        ("sec,nanosec,p\n", "7,0,1\n8,0,2\n", {"time_unit": "ms"}, "`time_unit`: seconds and nanosec together are in"),
        ("sec,nanosec,p\n", "7,0,1\n8,0,2\n", {"time_column": "sec,nanos"}, "there is no column 'nanos'; did you mean"),
        ("sec,nanosec,p\n", "7,0,1\n8,0,2\n", {"time_column": "sec,sec"}, "name a column twice; name each once"),
        ("time,sec,nanosec,p\n", "0,7,0,1\n1,8,0,2\n", {}, r"column 2 \('sec'\) looks like time stamps but is not the"),
        ("sec,nanosec,p\n", "8,0,1\n7,0,2\n", {}, "column 'sec' is named like time stamps, but its values fall"),
    ],
)  # fmt: skip
def test_what_is_no_pair_is_named(tmp_path, header, row, options, message):
    (tmp_path / "felt").mkdir()
    (tmp_path / "felt" / "0.csv").write_text(header + row)
    with pytest.raises(InputError, match=message):
        nt.read_folder(tmp_path, unit="mV", **of_folder(options))
