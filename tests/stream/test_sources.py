"""Samples out of text and bytes: what is no sample is counted, and what cannot be used at all is refused."""

import os
import sys
import threading
import time
from itertools import takewhile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from levels import examples
from made_chains import make_chain, make_signal, told
from neurotact_parts.streams import sources
from neurotact_parts.streams.sources import Arrived, Faults, Frames, Rows, parser_of
from neurotact_parts.streams.stream import Stream

import neurotact as nt
from neurotact.data import hdf5
from neurotact.data.recordings import Recordings
from neurotact.errors import InputError


def taken(parser, *pieces: bytes) -> list:
    """What a parser makes of bytes: rows as lists, lost samples as numbers."""
    found = []
    for piece in pieces:
        for arrived in parser.take(piece):
            found += [arrived.missing] if arrived.samples is None else arrived.samples.tolist()
    return found


@given(cuts=st.lists(st.integers(0, 400), max_size=5), separator=st.sampled_from([",", ";", "\t", " ", ", "]))
@examples(30)
def test_rows_are_the_same_however_the_bytes_come(cuts, separator):
    signal = make_signal(20)
    text = "a,b\n" + "".join(separator.join(repr(float(v)) for v in row) + "\n" for row in signal)
    data, places = text.encode(), sorted({0, *cuts, len(text)})
    pieces = [data[a:b] for a, b in zip(places, [*places[1:], len(data)], strict=True)]
    assert np.array_equal(np.array(taken(Rows("-", 2, 1000.0, Faults()), *pieces), np.float32), signal)


@given(st.lists(st.floats(-99, 99, width=16), min_size=6, max_size=6), st.sampled_from(";\t "), st.booleans())
def test_rows_with_decimal_commas_are_those_with_points(values, separator, ends_open):
    lines = [separator.join(map(repr, values[at : at + 3])) + separator * ends_open for at in (0, 3)]
    with_points = "t;a;b\n" + "\n".join(lines) + "\n"
    found = [taken(Rows("-", 3, 1.0, Faults()), text.encode()) for text in (with_points, with_points.replace(".", ","))]
    assert found[0] == found[1] == [pytest.approx(values[:3]), pytest.approx(values[3:])]


def test_decimal_commas_are_said_once_and_no_other_commas_are_taken_for_them(capsys):
    assert taken(Rows("-", 2, 1.0, Faults()), b"1;2\n1,5;2\n2,345;0\n1.5;1,234\n") == [
        [1.0, 2.0], [1.5, 2.0], [pytest.approx(2.345), 0.0], [1.5, pytest.approx(1.234)],
    ]  # fmt: skip
    assert capsys.readouterr().err == "neurotact: -: commas in numbers are decimal\n"
    assert taken(Rows("-", 4, 1.0, Faults()), b"1,2;3,4\n") == [[1.0, 2.0, 3.0, 4.0]]
    assert taken(Rows("-", 2, 1.0, Faults()), b"5 ,15\n") == [[5.0, 15.0]]
    assert taken(Rows("-", 2, 1.0, Faults()), b"1;2\n1,234;2,345\n1,5;2.5\n1,2,\n") == [[1.0, 2.0], 1, 1, [1.0, 2.0]]
    assert taken(Rows("-", 3, 1.0, Faults()), b"1;2;3\n1,5;2,5\n7,8;9\n") == [[1.0, 2.0, 3.0], 1, [7.0, 8.0, 9.0]]
    with pytest.raises(InputError, match="has 4 values"):
        taken(Rows("-", 2, 1.0, Faults()), b"1,234;2,345\n")


@pytest.mark.parametrize(
    "above",
    ["", "\ufeff", "\ufeff# a skin\n", "\ufeffleft,right\n", "sep=,\nleft,right\n", "# a skin\nleft,right\n",
     "left,right\nmV,mV\n", "left,right\n[a.u.],[N]\n", "% left right\n// by hand\n"],
)  # fmt: skip
@pytest.mark.parametrize("size", [1, 2, 400])
def test_what_stands_above_the_rows_is_no_sample(above, size):
    faults = Faults()
    data = (above + "1,2\n3,4\n").encode()
    pieces = [data[at : at + size] for at in range(0, len(data), size)]
    assert taken(Rows("-", 2, 1000.0, faults), *pieces) == [[1.0, 2.0], [3.0, 4.0]]
    assert faults == Faults()


def test_what_is_no_sample_is_counted_and_stands_for_a_missing_one():
    faults = Faults()
    rows = Rows("-", 2, 1000.0, faults)
    found = taken(rows, b"# a skin\n1,2\n\n3\n4,five\n6,\n7,8,9\n10,11\r\n12,1")
    assert found[:3] == [[1.0, 2.0], 1, 1]
    assert np.isnan(found[3][1])
    assert found[4:] == [1, [10.0, 11.0]]
    rows.finish()
    assert faults == Faults(bad_rows=3, cut_off=1)
    assert faults.trouble() == "bad rows 3, cut off at the end 1"


@pytest.mark.parametrize(("unit_s", "scale"), [(1.0, 1e-3), (1e-3, 1.0)])
def test_a_time_column_finds_lost_and_doubled_rows(unit_s, scale):
    faults = Faults()
    rows = Rows("-", 1, 1000.0, faults, time_unit_s=unit_s)
    times = [5.0, 6.1, 6.9, 10.0, 10.0, 9.0, 11.0]
    text = "".join(f"{t * scale!r},{i}\n" for i, t in enumerate(times))
    assert taken(rows, text.encode()) == [[0.0], [1.0], [2.0], 2, [3.0], [6.0]]
    assert faults.bad_rows == 2


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"1,2,3\n", "line 1 has 3 values, '1,2,3', where 2 numbers"),
        (b"left,right\nup,down\n", "line 2 has 2 values"),
        (b"a,b\n\xff\xfe\x01\n\n\x01\x10\n", "line 2"),
        (b"\x00\xff\xfe\x01\n\n\x00\x10\n", "begins with zeros or UTF-16 text, not with rows of UTF-8 text"),
        ("a,b\n1,2\n".encode("utf-16"), "begins with zeros or UTF-16 text"),
        (b"\x93NUMPY\x01\x00v\x00{", r"is not rows of text, but a NumPy array; import it \(neurotact import\), and"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a Git LFS pointer, not the file itself; fetch the file"),
        (b"x" * (sources.LONGEST_ROW + 1), "does not end within"),
    ],
)
def test_text_that_is_no_table_is_refused(data, message):
    with pytest.raises(InputError, match=message):
        list(Rows("-", 2, 1000.0, Faults()).take(data))


@pytest.mark.parametrize("parser", [Rows("-", 2, 1000.0, Faults()), Frames("-", 2, "int16", Faults())])
def test_a_source_without_a_sample_is_refused(parser):
    with pytest.raises(InputError, match="has no sample"):
        parser.finish()


@given(cuts=st.lists(st.integers(0, 60), max_size=4), kind=st.sampled_from(["float32", "int16"]))
@examples(20)
def test_frames_are_the_same_however_the_bytes_come(cuts, kind):
    signal = np.arange(-12, 12).reshape(-1, 2)
    data, faults = signal.astype({"float32": "<f4", "int16": "<i2"}[kind]).tobytes() + b"\x01", Faults()
    places = sorted({0, *(c for c in cuts if c < len(data))})
    frames = Frames("-", 2, kind, faults, lsb=0.5, zero=1.0)
    found = taken(frames, *(data[a:b] for a, b in zip(places, [*places[1:], len(data)], strict=True)))
    assert found == (signal if kind == "float32" else 1.0 + 0.5 * signal).tolist()
    frames.finish()
    assert faults.cut_off == 1


def test_text_given_for_frames_is_refused():
    with pytest.raises(InputError, match="pass `format='csv'`"):
        list(Frames("-", 2, "float32", Faults()).take(b"1.25,3.5\n1.5,2.5\n"))


def test_a_pipe_that_stalls_is_a_gap(tmp_path):
    chain, faults = make_chain({}), Faults()
    signal = make_signal(150)
    path = tmp_path / "pipe"
    os.mkfifo(path)

    def write() -> None:
        with path.open("wb", buffering=0) as pipe:
            pipe.write(signal[:60].tobytes())
            for _ in range(600):
                if faults.stalls:
                    break
                time.sleep(0.1)
            pipe.write(signal[60:].tobytes())

    writer = threading.Thread(target=write)
    writer.start()
    stream = Stream(chain)
    source = sources.live(str(path), Frames("-", 2, "float32", faults), faults, stall_s=0.2)
    found = list(sources.decide(stream, source))
    writer.join()
    assert faults.stalls == 1
    assert stream.tally.gaps == 1
    assert stream.tally.dropped == 1
    alone = Stream(chain)
    expected = told(Stream(chain).push(signal[:60])) + told(alone.push(signal[60:]))
    assert told(found) == expected


def test_recordings_are_streamed_trial_by_trial(tmp_path):
    chain = make_chain({"baseline": "start"})
    signals = [make_signal(90, seed=1), make_signal(130, seed=2)]
    skin = Recordings(signals, 1000.0, "mV", pd.DataFrame({"label": ["a", "b"]}))
    hdf5.save_recordings(skin, tmp_path / "skin.h5")
    found = list(sources.decide(Stream(chain), sources.recorded(tmp_path / "skin.h5", 2, 7)))
    assert told(found) == [row for signal in signals for row in told(Stream(chain).push(signal))]
    with pytest.raises(InputError, match="has 2 taxels but the chain receives 3"):
        next(sources.recorded(tmp_path / "skin.h5", 3, 7))


def test_a_replay_keeps_its_rate():
    faults = Faults()
    source = iter([sources.Arrived(make_signal(200)), sources.Arrived(missing=100), sources.Arrived(end=True)])
    began = time.monotonic()
    parts = list(sources.at_its_rate(source, 1000.0, faults, 20))
    assert 0.299 < time.monotonic() - began < 1.5
    assert [len(p.samples) for p in parts if p.samples is not None] == [20] * 10


def test_a_slow_taker_is_noted():
    faults = Faults()
    source = iter([sources.Arrived(make_signal(60))])
    for _ in sources.at_its_rate(source, 1000.0, faults, 10):
        time.sleep(0.05)
    assert faults.late_blocks >= 3
    assert "late blocks" in faults.trouble()


def test_a_replay_may_be_faster_or_slower():
    faults, speeds = Faults(), iter([2.0] * 5 + [0.5] * 5)
    source = iter([Arrived(make_signal(100))])
    began = time.monotonic()
    parts = list(sources.at_its_rate(source, 1000.0, faults, 10, speed=lambda: next(speeds)))
    assert 0.124 < time.monotonic() - began < 1.5
    assert len(parts) == 10


def test_whoever_waits_is_told_that_nothing_came(tmp_path):
    parts = list(sources.at_its_rate(iter([Arrived(make_signal(100))]), 1000.0, Faults(), 100, tick_s=0.01))
    assert 2 <= len(parts) - 1 <= 10
    assert all(part == Arrived() for part in parts[:-1])
    path = tmp_path / "pipe"
    os.mkfifo(path)
    faults = Faults()
    descriptor = os.open(path, os.O_RDWR)  # a pipe that nobody closes
    source = sources.live(str(path), Frames("-", 2, "float32", faults), faults, 0.3, tick_s=0.01)
    before = [*takewhile(lambda arrived: not arrived.stalled, source)]
    assert 1 <= len(before) <= 30
    assert {*before, *(next(source) for _ in range(3))} == {Arrived()}
    assert faults.stalls == 1
    os.write(descriptor, make_signal(3).tobytes())
    assert len(next(source).samples) == 3
    os.close(descriptor)


def test_a_source_that_was_under_way_begins_with_a_whole_row():
    rows = Rows("-", 2, 1000.0, Faults(), joins=True)
    assert taken(rows, b"3.5", b",7\n1,", b"2\n3,4\n") == [[1.0, 2.0], [3.0, 4.0]]
    cut_off = parser_of(nt.Samples(), "serial:/dev/x", 2, 1000.0, Faults())
    assert taken(cut_off, b"9\n1,2\n") == [[1.0, 2.0]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"format": "wav"}, "format: must be 'csv', 'float32' or 'int16'; got 'wav'"),
        ({"time_column": "h"}, "time_column: must be 's', 'ms', 'us' or 'ns'; got 'h'"),
        ({"format": "int16", "lsb": 1e38}, "is beyond float32"),
    ],
)
def test_samples_of_an_unknown_form_are_refused(given, message):
    with pytest.raises(InputError, match=message):
        parser_of(nt.Samples(**given), "-", 2, 1000.0, Faults())


def test_a_serial_port_is_read_as_its_samples_come():
    pytest.importorskip("serial", reason="no pyserial; pip install 'neurotact[serial]'")
    master, slave = os.openpty()
    path, faults = f"serial:{os.ttyname(slave)}", Faults()
    source = sources.live(path, parser_of(nt.Samples(), path, 2, 1000.0, faults), faults, 5.0, tick_s=0.01)
    assert next(source) == Arrived()  # it is open; what came before is dropped
    os.write(master, b"5,6\n1,2\r\n3,4\n")
    rows: list = []
    while len(rows) < 2:
        arrived = next(source)
        rows += [] if arrived.samples is None else arrived.samples.tolist()
    assert rows == [[1.0, 2.0], [3.0, 4.0]]
    os.close(master)  # the plug is pulled
    assert [each for each in source if each != Arrived()] == [Arrived(end=True)]
    os.close(slave)


def test_a_serial_port_that_is_not_there_is_refused(monkeypatch):
    path = "serial:/dev/no-such-port"
    pytest.importorskip("serial", reason="no pyserial; pip install 'neurotact[serial]'")
    with pytest.raises(InputError, match="/dev/no-such-port: cannot be read"):
        next(sources.live(path, Rows(path, 2, 1000.0, Faults()), Faults(), 1.0))
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(InputError, match=r"needs pyserial; pip install 'neurotact\[serial\]'"):
        next(sources.live(path, Rows(path, 2, 1000.0, Faults()), Faults(), 1.0))
