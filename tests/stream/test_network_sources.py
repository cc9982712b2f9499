"""Datagrams and streams of the Lab Streaming Layer: the samples of a pipe, however they come; all else is refused."""

import socket
import sys
from itertools import takewhile
from types import SimpleNamespace

import numpy as np
import pytest
from made_chains import make_signal
from neurotact_parts.streams import sources
from neurotact_parts.streams.sources import Arrived, Faults, kind_of, parser_of

import neurotact as nt
from neurotact import effects
from neurotact.errors import InputError


def samples_of(source) -> list:
    """The samples until the end as rows, and True for a stall."""
    found = []
    for arrived in takewhile(lambda one: not one.end, source):
        found += [True] * arrived.stalled + ([] if arrived.samples is None else arrived.samples.tolist())
    return found


# UDP


def sending(datagrams, faults, **samples):
    """What a port for datagrams makes of them, and of an empty one at the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    given, path = nt.Samples(**samples), f"udp:{port}"
    source = sources.live(path, parser_of(given, path, 2, 1000.0, faults), faults, 5.0, tick_s=0.01)
    assert next(source) == Arrived()  # it is open
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for datagram in [*datagrams, b""]:
            sender.sendto(datagram, ("127.0.0.1", port))
    return samples_of(source)


def test_each_datagram_holds_whole_rows():
    faults = Faults()
    rows = sending([b"left,right", b"1,2", b"3,4\n5,6", b"7,", b"8\n", b"9,10\r\n"], faults)
    assert rows == [[1, 2], [3, 4], [5, 6], [7, pytest.approx(np.nan, nan_ok=True)], [9, 10]]
    assert faults == Faults(bad_rows=1)  # a row is not joined from two datagrams


def test_lost_datagrams_show_in_the_stamps():
    faults, rows = Faults(), [f"{step},{step},1" for step in range(40) if step not in (5, 20, 21)]
    found = sending([row.encode() for row in rows], faults, time_column="ms")
    assert [row[0] for row in found] == [step for step in range(40) if step not in (5, 20, 21)]


@pytest.mark.parametrize("format", ["float32", "int16"])
def test_each_datagram_holds_whole_frames(format):
    faults, signal = Faults(), np.round(make_signal(6)).astype("<f4" if format == "float32" else "<i2")
    datagrams = [signal[:2].tobytes(), signal[2:4].tobytes() + b"\1", b"\2\3", signal[4:].tobytes()]
    assert sending(datagrams, faults, format=format) == signal.tolist()
    assert faults == Faults(bad_rows=2)


def test_an_address_without_a_port_is_refused():
    for path in ("udp:", "udp:x", "udp:65536", "udp:9000:", "udp:-1", "udp:\u0663\u0663"):
        with pytest.raises(InputError, match="is no port for datagrams; give its number, as in udp:9000"):
            next(sources.live(path, parser_of(nt.Samples(), path, 2, 1000.0, Faults()), Faults(), 1.0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        path = f"udp:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match=r"cannot be opened \(.*\); give another port"):
            next(sources.live(path, parser_of(nt.Samples(), path, 2, 1000.0, Faults()), Faults(), 1.0))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has 127.0.0.2")
def test_only_the_address_that_is_given_is_heard():
    for host, heard in (("", []), ("0.0.0.0:", [[5.0, 6.0]])):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind(("127.0.0.1", 0))
            faults, path = Faults(), f"udp:{host}{sender.getsockname()[1] ^ 1}"
            source = sources.live(path, parser_of(nt.Samples(), path, 2, 1000.0, faults), faults, 5.0, tick_s=0.01)
            next(source)
            for address, datagram in (("127.0.0.2", b"5,6"), ("127.0.0.1", b"1,2"), ("127.0.0.1", b"")):
                sender.sendto(datagram, (address, int(path.rpartition(":")[2])))
            assert samples_of(source) == [*heard, [1.0, 2.0]]


# Lab Streaming Layer


class Node:
    """An element of the description of a stream, as pylsl has it."""

    def __init__(self, labels):
        self.labels = labels

    def child(self, name):
        return self

    def child_value(self, name):
        return self.labels[0] if self.labels else ""

    def next_sibling(self):
        return Node(self.labels[1:])


def fake_pylsl(monkeypatch, pieces, *, labels=("left", "right"), n_channels=2, rate_Hz=1000.0, channel_format=1):
    """A module like pylsl with one stream, called Skin, of these pieces; None: nothing arrives. Returns its calls."""
    pieces, calls, rest = [*pieces], [], []

    class Inlet:
        def __init__(self, info, *, recover):
            assert not recover

        def info(self):
            return SimpleNamespace(
                channel_count=lambda: n_channels, nominal_srate=lambda: rate_Hz, desc=lambda: Node(labels),
                channel_format=lambda: channel_format,
            )  # fmt: skip

        def pull_sample(self, timeout):
            assert timeout <= 0.2
            if not pieces:
                raise RuntimeError("the stream is lost")
            piece = pieces.pop(0)
            if piece is None:
                return None, None
            rest[:] = piece[1:]
            return piece[0], 1.5

        def pull_chunk(self, timeout, max_samples):
            assert timeout == 0.0
            return [*rest], [1.5] * len(rest)

        def close_stream(self):
            calls.append("closed")

    module = SimpleNamespace(
        StreamInlet=Inlet, cf_string=3, resolve_byprop=lambda prop, name, timeout: ["it"] * (name == "Skin")
    )
    monkeypatch.setitem(sys.modules, "pylsl", module)
    monkeypatch.setattr("neurotact_parts.streams.lab_streaming.FOUND_S", 0.1)
    return calls


def lsl(path="lsl:Skin", taxels=("left", "right"), stall_s=5.0, faults=None):
    faults = faults or Faults()
    return sources.live(path, parser_of(nt.Samples(), path, 2, 1000.0, faults, taxels), faults, stall_s)


def test_a_stream_of_lsl_is_its_samples_until_its_sender_ends(monkeypatch):
    calls = fake_pylsl(monkeypatch, [[[1, 2]], None, [[3, 4], [5, 6], [7, 1e300]]])
    assert samples_of(lsl()) == [[1, 2], [3, 4], [5, 6], [7, np.inf]]
    assert calls == ["closed"]
    assert kind_of("lsl:Skin") == "LSL stream"


@pytest.mark.parametrize(
    ("labels", "taxels", "expected"),
    [
        (("right", "left"), ("left", "right"), [2, 1]),
        (("right", "left"), None, [1, 2]),
        (("right", ""), ("left", "right"), [1, 2]),
        ((), ("left", "right"), [1, 2]),
    ],
)
def test_channels_of_lsl_are_put_in_order_by_their_labels(monkeypatch, labels, taxels, expected):
    fake_pylsl(monkeypatch, [[[1, 2]]], labels=labels)
    assert samples_of(lsl(taxels=taxels)) == [expected]


def test_a_silent_stream_of_lsl_stalls_once(monkeypatch):
    fake_pylsl(monkeypatch, [[[1, 2]], *[None] * 1000, [[3, 4]]])
    faults = Faults()
    assert samples_of(lsl(stall_s=1e-6, faults=faults)) == [[1, 2], True, [3, 4]]
    assert faults == Faults(stalls=1)


@pytest.mark.parametrize(
    ("stream", "said"),
    [
        ({"n_channels": 3}, "has 3 channels where 2 taxels should be; give these"),
        ({"rate_Hz": 980.0}, r"comes at 980 Hz, but 1000 Hz are expected; give `sampling_rate_Hz=980`"),
        ({"channel_format": 3}, "sends texts, not numbers"),
        ({"labels": ("left", "middle")}, "has the taxel 'middle' where left, right are expected"),
    ],
)
def test_a_stream_of_lsl_of_another_form_is_refused(monkeypatch, stream, said):
    calls = fake_pylsl(monkeypatch, [[[1, 2]]], **stream)
    with pytest.raises(InputError, match=said):
        next(lsl())
    assert calls == ["closed"]


def test_an_irregular_stream_of_lsl_has_no_rate_to_refuse(monkeypatch):
    fake_pylsl(monkeypatch, [[[1, 2]]], rate_Hz=0.0)
    assert samples_of(lsl()) == [[1, 2]]


def test_a_stream_of_lsl_that_is_absent_and_a_missing_package_are_one_sentence(monkeypatch):
    fake_pylsl(monkeypatch, [])
    with pytest.raises(InputError, match=r"lsl:Hand: no such stream is found in 0\.1 s; start it, and check its name"):
        next(lsl("lsl:Hand"))
    with pytest.raises(InputError, match="has no sample"):
        list(lsl())
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(InputError, match=r"lsl:Skin: needs pylsl; pip install 'neurotact\[lsl\]'"):
        next(lsl())


def test_a_stream_of_lsl_is_no_text():
    with pytest.raises(InputError, match="lsl:Skin: sends samples, not rows of text"):
        next(sources.live("lsl:Skin", sources.Rows("lsl:Skin", 2, 1000.0, Faults()), Faults(), 1.0))


def test_pylsl_without_its_library_is_one_sentence(monkeypatch, tmp_path):
    (tmp_path / "pylsl.py").write_text("raise RuntimeError('LSL binary library file was not found. Please ...')")
    monkeypatch.delitem(sys.modules, "pylsl", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"pylsl cannot be used \(LSL binary library file was not found\); install"):
        next(lsl())


def test_options_of_bytes_are_refused_for_a_stream_of_lsl():
    kind = kind_of("lsl:Skin")
    effects.check(source=kind, sampling_rate_Hz=500.0, stall_s=2.0, unit="mV", hold_ms=3.0)
    for option, value in {"format": "csv", "lsb": 2.0, "zero": 1.0, "time_column": "ms", "baud": 9600}.items():
        with pytest.raises(InputError, match=f"`{option}.*no effect"):
            effects.check(source=kind, **{option: value})
