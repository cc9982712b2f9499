"""The server: who may come in, what may be sent, and that no page can stall the stream."""

import http.client
import json
import socket
import struct
import time
from contextlib import suppress
from threading import Thread

import numpy as np
import pytest
from levels import thinned
from live_pages import Given, cut, has_ended, page_of, serving, session_of
from made_chains import make_chain, make_signal, offline
from neurotact_parts.exporters.live import connections
from neurotact_parts.exporters.live import server as servers
from neurotact_parts.exporters.live import session as sessions
from neurotact_parts.exporters.live.server import Allowance, Server, content_policy, page
from websockets.exceptions import ConnectionClosed, InvalidStatus

from neurotact.errors import InputError


@pytest.fixture
def up():
    with serving(session_of(make_chain({}, patience=5))) as server:
        yield server


@pytest.fixture(scope="module")
def door():
    """A server for visitors who change nothing."""
    with serving(session_of(make_chain({}, patience=5))) as server:
        yield server


def get(server: Server, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    connection.putrequest("GET", path, skip_host=True)
    for key, value in {"Host": f"127.0.0.1:{server.port}", **headers}.items():
        connection.putheader(key, value)
    connection.endheaders()
    answer = connection.getresponse()
    answer.body = answer.read()
    connection.close()
    return answer


# --- who may come in ----------------------------------------------------------------------------------


def test_the_page_is_served_with_a_policy_that_runs_its_own_script_alone(door):
    answer = get(door, f"/{door.token}/")
    assert answer.status == 200
    assert answer.body == page()
    policy = dict(part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"] == f"ws://127.0.0.1:{door.port}"
    assert policy["script-src"].startswith("'sha256-")
    assert "unsafe" not in str(policy)
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["cache-control"] == "no-store"


def test_a_changed_script_has_another_hash():
    html = page()
    assert html.count(b"<script") == html.count(b"<style") == 1
    assert content_policy(html, "a") != content_policy(html.replace(b'"use strict";', b'"use  strict";'), "a")


def test_the_page_asks_nobody_else_for_anything():
    text = page().decode()
    for word in ("http://", "https://", "src=", "@import", "url(", "fetch(", "XMLHttpRequest", "eval(", "innerHTML"):
        assert word not in text


@pytest.mark.parametrize(
    "path", ["/", "/stream", "/{token}", "/{wrong}/", "/{token}/stream", "/{token}/../", "/{token}/x"]
)
def test_nothing_else_is_served(door, path):
    wrong = ("b" if door.token[0] == "a" else "a") + door.token[1:]
    answer = get(door, path.format(token=door.token, wrong=wrong))
    assert answer.status == 404
    assert page() not in answer.body


@pytest.mark.parametrize(
    "headers",
    [{"Host": "evil.example"}, {"Host": "127.0.0.1"}, {"Host": "127.0.0.1:1"}, {"Origin": "http://evil.example"}],
)
def test_another_host_or_origin_gets_nothing(door, headers):
    assert get(door, f"/{door.token}/", **headers).status == 404


def test_localhost_is_this_machine_too(door):
    answer = get(door, f"/{door.token}/", Host=f"localhost:{door.port}")
    assert answer.status == 200
    assert f"connect-src ws://localhost:{door.port};" in answer.headers["content-security-policy"]


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "https://127.0.0.1:{port}", "http://localhost:{port}"]
)
def test_a_websocket_of_another_origin_is_refused(door, origin):
    with (
        pytest.raises(InvalidStatus, match="404"),
        page_of(door, origin=origin and origin.format(port=door.port)) as _,
    ):
        pass
    assert len(door.session.audience) == 0


def test_a_websocket_without_the_token_is_refused(up):
    right, up.token = up.token, "a" * len(up.token)
    with pytest.raises(InvalidStatus, match="404"), page_of(up) as _:
        pass
    up.token = right
    with page_of(up) as me:
        me.until(lambda me: me.hello)


def test_tokens_are_long_and_never_the_same():
    made = [Server(session_of(make_chain({}))) for _ in range(2)]
    assert made[0].token != made[1].token
    assert all(len(each.token) >= 32 for each in made)
    for each in made:
        each._socket.close()


def test_it_listens_on_loopback_alone(door):
    assert door._socket.getsockname()[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_refused(door):
    with pytest.raises(InputError, match=f"`port={door.port}`: cannot be used"):
        Server(door.session, door.port)


def test_more_pages_than_a_room_holds_are_sent_away(up, monkeypatch):
    monkeypatch.setattr(servers, "MOST_PAGES", 1)
    with page_of(up) as first:
        first.until(lambda me: me.hello)
        with page_of(up) as second, pytest.raises(ConnectionClosed) as closed:
            second.read()
        assert closed.value.rcvd.code == 1013


# --- what may be sent ---------------------------------------------------------------------------------

JUNK = [
    "", "{", "null", "[]", "0", '{"kind": "eval"}', '{"kind": "change"}', '{"kind": "change", "values": {}}',
    '{"kind": "change", "values": {"sa1.gain": NaN}}', '{"kind": "change", "values": {"sa1.gain": 1e300}}',
    '{"kind": "change", "values": {"sa1.gain": "5"}}', '{"kind": "speed", "speed": 1e9}', '{"kind": "speed"}',
    '{"kind": "save", "name": "../../evil"}', '{"kind": "save", "name": "a.toml\\n"}', '{"kind": "clear", "more": 1}',
    "[" * 2000, b"\x00\xff", b"{}", json.dumps({"kind": "label", "label": "x" * 1500}),
]  # fmt: skip


def test_what_is_no_message_is_dropped_and_counted(up):
    with page_of(up) as me:
        me.until(lambda me: me.hello)
        for junk in JUNK:
            me.socket.send(junk)
        me.until(lambda me: me.state.get("refused") == len(JUNK))
        me.ask(kind="compare", windows=7)
        me.until(lambda me: me.state["compared"]["windows"] == 7)
        assert not me.answers


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({"kind": "change", "values": {"sa1.gian": 1.0}}, "did you mean 'sa1.gain'"),
        ({"kind": "change", "values": {"sa1.gain": -1.0}}, "sa1.gain: must be > 0"),
        ({"kind": "change", "values": {"sa1.t_ref_ms": 1e9}}, "t_ref"),
        ({"kind": "change", "values": {"ra1.t_ref_ms": None}}, "ra1.t_ref_ms"),
        ({"kind": "change", "values": {"patience": 1.5}}, "patience: must be a whole number"),
        ({"kind": "change", "values": {"patience": 0}}, "patience: must be a whole number"),
        ({"kind": "change", "values": {"conditioning.baseline": 1.0}}, "cannot be changed"),
        ({"kind": "move", "values": {"force_N": 3.0}}, "has no finger to control"),
        ({"kind": "label", "label": "felt"}, "sets the touched class itself"),
        ({"kind": "save", "name": "mine"}, "saving is off"),
    ],
)
def test_what_cannot_be_done_is_answered_and_changes_nothing(door, message, why):
    with page_of(door) as me:
        me.until(lambda me: me.state)
        before = me.state["settings"]
        me.ask(**message)
        me.until(lambda me: me.answers)
        assert me.answers[0]["kind"] == "refused"
        assert why in me.answers[0]["why"]
        assert door.session._settings() == before


# --- who stays -----------------------------------------------------------------------------------------


def opened(server: Server, *said: bytes) -> list[socket.socket]:
    """Connections that have sent something, and nothing more."""
    found = []
    for text in said:
        found.append(socket.create_connection(("127.0.0.1", server.port), timeout=30))
        found[-1].sendall(text)
    return found


def is_closed(connection: socket.socket) -> bool:
    """Whether the server closes a connection before it says a word."""
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


@pytest.mark.parametrize("said", [b"", b"GET /", b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n"])
def test_a_browser_comes_in_whatever_a_hundred_others_hold_open(up, said):
    idle = opened(up, *[said] * 100)
    assert get(up, f"/{up.token}/").status == 200
    with page_of(up) as me:
        me.until(has_ended)
        more = opened(up, *[said] * 60)  # the page stays
        me.ask(kind="compare", windows=7)
        me.until(lambda me: me.state["compared"]["windows"] == 7)
    assert len(up._uvicorn.server_state.connections) <= connections.MOST_IDLE + 2
    assert all(map(is_closed, idle))
    for each in (*idle, *more):
        each.close()


@thinned("said", [b"", b"GET /a HTTP/1.1\r\nHost: a\r\n", b"GET /a/ HTTP/1.1\r\nHost: a\r\n\r\nGET /a"])
def test_a_connection_that_never_ends_its_request_is_closed(monkeypatch, said):
    monkeypatch.setattr(connections, "ANSWERED_S", 0.5)
    with serving(session_of(make_chain({}, patience=5))) as up:
        (slow,) = opened(up, said)
        began = time.monotonic()
        slow.settimeout(0.1)
        is_over = False
        while not is_over:  # byte by byte
            assert time.monotonic() - began < 30
            try:
                slow.sendall(b"a")
                is_over = slow.recv(4096) == b""
            except TimeoutError:
                pass
            except ConnectionError:
                is_over = True
        slow.close()
        with page_of(up) as me:  # a page is no such connection
            time.sleep(0.7)
            me.until(has_ended)
            me.ask(kind="compare", windows=7)
            me.until(lambda me: me.state["compared"]["windows"] == 7)


def frame_of(opcode: int, size: int, *, is_last: bool = True, content: bytes = b"") -> bytes:
    """A frame of a client, whose header may declare more than it has; the mask is zero."""
    length = bytes([0x80 | size]) if size < 126 else bytes([0x80 | 127]) + size.to_bytes(8, "big")
    return bytes([opcode | (0x80 if is_last else 0)]) + length + bytes(4) + content


FLOODS = {
    "a frame of an exabyte": frame_of(1, 2**60),
    "a message of endless empty parts": frame_of(1, 0, is_last=False) + frame_of(0, 0, is_last=False) * 10_000,
    "pings whose answers are not read": frame_of(9, 125, content=bytes(125)) * 100_000,
}


@pytest.mark.parametrize("flood", FLOODS)
def test_a_websocket_that_floods_is_closed_and_no_other(up, monkeypatch, flood):
    monkeypatch.setattr(connections, "MOST_UNREAD", 1 << 16)
    with page_of(up) as other:
        other.until(has_ended)
        (raw,) = opened(up, handshake_of(up))
        with suppress(ConnectionError, TimeoutError):
            for _ in range(20):
                raw.sendall(FLOODS[flood])
        other.until(lambda me: me.state["pages"] == 1)
        other.ask(kind="compare", windows=7)
        other.until(lambda me: me.state["compared"]["windows"] == 7)
        raw.close()


def handshake_of(server: Server) -> bytes:
    return (
        f"GET /{server.token}/stream HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {'a' * 22}==\r\nSec-WebSocket-Version: 13\r\n"
        f"Origin: http://127.0.0.1:{server.port}\r\n\r\n"
    ).encode()


def test_a_message_that_is_too_long_ends_the_page_and_nothing_else(up):
    with page_of(up) as other, page_of(up) as me:
        me.until(lambda me: me.hello)
        with pytest.raises(ConnectionClosed) as closed:
            me.pour("x" * 5000, 1)
        assert closed.value.rcvd.code == 1009
        other.until(has_ended)


def test_a_page_that_goes_on_sending_junk_is_cut_off(up, monkeypatch):
    monkeypatch.setattr(servers, "MOST_DROPPED", 20)
    with page_of(up) as other:
        with page_of(up) as me, pytest.raises(ConnectionClosed) as closed:
            me.pour("junk", 10_000)
        other.until(lambda other: other.state.get("refused") == 21)
    assert closed.value.rcvd.code == 1008


def test_an_allowance_is_a_burst_and_then_a_rate():
    allowance = Allowance(per_s=0.001, burst=5)
    assert [allowance.spend() for _ in range(7)] == [True] * 5 + [False] * 2
    refilled = Allowance(per_s=1000.0, burst=1)
    assert refilled.spend()
    time.sleep(0.01)
    assert refilled.spend()


# --- messages ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("patience", [None, 5])
def test_decisions_over_the_socket_are_those_of_the_whole_trial(patience):
    chain, signal = make_chain({}, patience=patience), make_signal(400)
    _, expected = offline(chain, signal)
    with serving(session_of(chain, Given(cut(signal, 7)))) as server, page_of(server) as me, page_of(server) as second:
        me.until(has_ended)
        second.until(has_ended)
        assert me.told() == second.told() == expected
        assert len(expected) == 10
        with page_of(server) as late:
            assert late.until(lambda me: me.rows).told() == expected


@pytest.mark.thorough
def test_a_page_that_reads_nothing_stalls_nobody(monkeypatch):
    """Megabytes of frames, more than the system's buffers hold: they are dropped, the decisions are not."""
    monkeypatch.setattr(sessions, "FRAME_S", 0.0)
    monkeypatch.setattr(servers, "PING_S", 600.0)  # a machine may be too busy to answer one in time
    chain, signal = make_chain({}, n_taxels=8, windows={"length_ms": 400}), make_signal(240_000, 8)
    with serving(session_of(chain, Given(cut(signal, 400)))) as server:
        narrow = socket.socket()
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        narrow.connect(("127.0.0.1", server.port))
        with page_of(server, sock=narrow, max_queue=1) as slow, page_of(server) as me:
            me.until(has_ended)
            assert me.state["pages"] == 2
            boxes = server.session.audience.each()
            assert max(box.dropped for box in boxes) > 0
            slow.until(has_ended)
            assert slow.told() == me.told()  # what was decided is not lost to it
            assert len(slow.rows) == 600
            assert len(slow.frames) < 600


def test_a_page_that_vanishes_is_forgotten():
    chain, signal = make_chain({}), make_signal(4000)
    feed = Given([*cut(signal[:2000]), None, *cut(signal[2000:])])
    with serving(session_of(chain, feed)) as server, page_of(server) as me:
        raw = socket.create_connection(("127.0.0.1", server.port))
        raw.sendall(handshake_of(server))
        assert b"101" in raw.recv(64)
        me.until(lambda me: me.state.get("pages") == 2)
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        raw.close()  # a reset, no goodbye
        feed.go.set()
        me.until(has_ended)
        me.ask(kind="compare", windows=9)
        me.until(lambda me: me.state["pages"] == 1)
        assert me.told() == offline(chain, signal)[1]


def test_a_fault_of_the_session_is_raised_by_the_server():
    class Broken(Given):
        def pieces(self, faults):
            yield from ()
            raise ZeroDivisionError

    session = session_of(make_chain({}), Broken([make_signal(10)]))
    server = Server(session)
    session.on_end = server.stop
    session.waits = False
    with pytest.raises(ZeroDivisionError):
        server.run()


def test_an_encoder_is_saved_whole_and_never_over_another(tmp_path):
    with serving(session_of(make_chain({}), save_to=tmp_path / "new")) as server, page_of(server) as me:
        me.until(lambda me: me.hello)
        me.ask(kind="change", values={"sa1.t_ref_ms": 5})
        me.ask(kind="save", name="mine")
        me.until(lambda me: me.answers)
        assert me.answers[0] == {"kind": "saved", "path": str(tmp_path / "new" / "mine.toml")}
        before = (tmp_path / "new" / "mine.toml").read_bytes()
        me.ask(kind="save", name="mine")
        me.until(lambda me: len(me.answers) == 2)
        assert "mine.toml: already exists; choose another name" in me.answers[1]["why"]
        assert (tmp_path / "new" / "mine.toml").read_bytes() == before
        assert [path.name for path in (tmp_path / "new").iterdir()] == ["mine.toml"]


def test_many_threads_may_ask_at_once(up):
    with page_of(up) as me:
        me.until(has_ended)
        asks = [Thread(target=me.ask, kwargs={"kind": "compare", "windows": n}) for n in range(1, 31)]
        for each in asks:
            each.start()
        for each in asks:
            each.join()
        me.ask(kind="compare", windows=99)
        me.until(lambda me: me.state["compared"]["windows"] == 99)
        assert me.state["refused"] == 0
        assert np.isfinite(me.state["compared"]["after"]["nJ"])
