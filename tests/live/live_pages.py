"""A session on a made chain, its server in a thread, and a page's end of the websocket."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import numpy as np
from made_chains import make_signal
from neurotact_parts.exporters.live.server import Server
from neurotact_parts.exporters.live.session import Session
from neurotact_parts.streams.chain import Chain
from neurotact_parts.streams.sources import Arrived, Faults
from websockets.sync.client import ClientConnection, connect

from neurotact.encoders.specs import afferent_names

PATIENCE_s = 60.0


class Given:
    """A feed of given pieces, as fast as they are taken; at a None it waits until `go` is set.

    labels: what is touched while each piece is taken.
    """

    kind, name, unit, note = "recordings", "given", "mV", ""

    def __init__(self, pieces: list[np.ndarray | None], labels: list[str] | None = None, rate_Hz: float = 1000.0):
        self._pieces, self._labels = pieces, labels or ["?"] * len(pieces)
        self.sampling_rate_Hz = rate_Hz
        n_taxels = next(piece.shape[1] for piece in pieces if piece is not None)
        self.taxels = tuple(f"taxel{i + 1}" for i in range(n_taxels))
        self.label: str | None = None
        self.go = Event()

    def pieces(self, faults: Faults) -> Iterator[Arrived]:
        for piece, label in zip(self._pieces, self._labels, strict=True):
            while piece is None and not self.go.wait(0.005):
                yield Arrived()
            if piece is not None:
                self.label = label
                yield Arrived(piece)
        yield Arrived(end=True)


def cut(signal: np.ndarray, size: int = 10) -> list[np.ndarray]:
    return [signal[at : at + size] for at in range(0, len(signal), size)]


def session_of(chain: Chain, feed: Any = None, **options) -> Session:
    feed = feed or Given(cut(make_signal(400, chain.n_taxels)))
    return Session(chain, feed, run="made", afferents=afferent_names(feed.taxels), **options)


@contextmanager
def serving(session: Session) -> Iterator[Server]:
    server = Server(session)
    thread = Thread(target=server.run)
    thread.start()
    try:
        end = time.monotonic() + PATIENCE_s
        while not server.is_up:
            assert time.monotonic() < end
            time.sleep(0.01)
        yield server
    finally:
        server.stop()
        thread.join(PATIENCE_s)
        assert not thread.is_alive()


class Page:
    """What a page knows: the newest state, all decisions, and how many frames came."""

    def __init__(self, socket: ClientConnection):
        self.socket = socket
        self.hello: dict[str, Any] = {}
        self.state: dict[str, Any] = {}
        self.rows: list[list[Any]] = []
        self.answers: list[dict[str, Any]] = []
        self.frames: list[bytes] = []

    def ask(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def until(self, is_true) -> "Page":
        """Read until a condition on this page holds."""
        end = time.monotonic() + PATIENCE_s
        while not is_true(self):
            assert time.monotonic() < end, (self.state, len(self.rows), self.answers)
            self.read()
        return self

    def read(self) -> None:
        mail = self.socket.recv(timeout=PATIENCE_s)
        if isinstance(mail, bytes):
            self.frames.append(mail)
            return
        message = json.loads(mail)
        if message["kind"] in ("hello", "state"):
            setattr(self, message["kind"], message)
        elif message["kind"] == "decisions":
            self.rows += message["rows"]
        else:
            self.answers.append(message)

    def pour(self, text: str, times: int) -> None:
        """Send a text over and over, and read until the server ends the page: ConnectionClosed."""
        for _ in range(times):
            self.socket.send(text)
        while True:
            self.read()

    def told(self) -> list[tuple]:
        """The decisions as `made_chains.told` gives them: start, label, steps, input and hidden spikes."""
        return [(r[13], r[3], r[5], r[6], r[7]) for r in sorted(self.rows, key=lambda r: r[1])]


@contextmanager
def page_of(server: Server, **options) -> Iterator[Page]:
    authority = f"127.0.0.1:{server.port}"
    options = {"origin": f"http://{authority}", "max_size": None, "proxy": None, "ping_interval": None, **options}
    with connect(f"ws://{authority}/{server.token}/stream", **options) as socket:
        yield Page(socket)


def has_ended(page: Page) -> bool:
    return bool(page.state.get("ended"))
