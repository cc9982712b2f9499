"""The page's server: only loopback, a token in the address, only its own origin.

Only two addresses answer, `/TOKEN/` and `/TOKEN/stream` (a websocket). A request that names another host is refused
(against DNS rebinding), and so is one from another origin. Messages are bounded in size and rate; invalid ones are
dropped and counted, and a page that sends too many is disconnected. Idle and slow connections are closed
(`connections.py`).
"""

import asyncio
import base64
import hashlib
import logging
import re
import secrets
import socket
import time
from contextlib import suppress
from importlib import resources
from threading import Thread
from typing import Any

import uvicorn
from neurotact_parts.exporters.live import messages
from neurotact_parts.exporters.live.connections import HttpConnection, PageConnection
from neurotact_parts.exporters.live.frames import Mailbox
from neurotact_parts.exporters.live.session import Session
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from neurotact.errors import InputError

HOST = "127.0.0.1"
MOST_PAGES = 8
MESSAGES_PER_S, BURST = 60.0, 120.0
"""Messages per second that a page may send, and the burst; further ones are dropped."""
MOST_DROPPED = 200
"""Invalid messages of one page; with more, it is disconnected."""
PING_S = 20.0
"""A page without an answer for this long is closed."""
POLICY, TRY_LATER = 1008, 1013
"""Close codes of a websocket."""


def page() -> bytes:
    """The page, with its script and style."""
    return resources.files("neurotact_parts.exporters.live").joinpath("page.html").read_bytes()


def content_policy(html: bytes, authority: str) -> str:
    """A policy that allows the page's own script and style, by their hashes, and connections only to its server.

    >>> content_policy(b"<style>a</style><script>b</script>", "127.0.0.1:1").partition(";")[0]
    "default-src 'none'"
    """

    def hashes(tag: bytes) -> str:
        parts = re.findall(rb"<%b>(.*?)</%b>" % (tag, tag), html, re.DOTALL)
        digests = (base64.b64encode(hashlib.sha256(part).digest()).decode() for part in parts)
        return " ".join(f"'sha256-{digest}'" for digest in digests)

    return (
        f"default-src 'none'; script-src {hashes(b'script')}; style-src {hashes(b'style')}; img-src data:; "
        f"connect-src ws://{authority}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


class Gate:
    """Access control: requests with the token, to this host's own names, from its own origin."""

    def __init__(self, token: str, port: int) -> None:
        self.token = token
        self.authorities = (f"{HOST}:{port}", f"localhost:{port}")

    def opens(self, connection: HTTPConnection, *, needs_origin: bool) -> bool:
        """Whether a request comes from the page itself."""
        headers = connection.headers
        if len(headers.getlist("host")) != 1 or headers["host"] not in self.authorities:
            return False
        origins = headers.getlist("origin")
        if (needs_origin or origins) and origins != [f"http://{headers['host']}"]:
            return False
        return secrets.compare_digest(connection.path_params["token"].encode(), self.token.encode())


class Allowance:
    """A limit of messages per second, with a burst."""

    def __init__(self, per_s: float = MESSAGES_PER_S, burst: float = BURST) -> None:
        self._per_s, self._burst = per_s, burst
        self._left, self._at_s = burst, time.monotonic()

    def spend(self) -> bool:
        """Whether one more message is allowed."""
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + self._per_s * (now_s - self._at_s))
        self._at_s = now_s
        is_allowed = self._left >= 1
        self._left -= is_allowed
        return is_allowed


def application(session: Session, gate: Gate) -> Starlette:
    """The server's application."""
    html = page()

    async def show(request: Request) -> Response:
        if not gate.opens(request, needs_origin=False):
            return PlainTextResponse("not found", 404)
        headers = {
            "content-security-policy": content_policy(html, request.headers["host"]),
            "cache-control": "no-store", "referrer-policy": "no-referrer", "x-content-type-options": "nosniff",
            "x-frame-options": "DENY", "cross-origin-opener-policy": "same-origin",
            "cross-origin-resource-policy": "same-origin",
        }  # fmt: skip
        return Response(html, media_type="text/html; charset=utf-8", headers=headers)

    async def stream(websocket: WebSocket) -> None:
        if not gate.opens(websocket, needs_origin=True):
            await websocket.send_denial_response(PlainTextResponse("not found", 404))
        elif len(session.audience) >= MOST_PAGES:
            await websocket.accept()
            await websocket.close(TRY_LATER, f"{MOST_PAGES} pages are connected already")
        else:
            await websocket.accept()
            await _attend(session, websocket)

    app = Starlette(routes=[Route("/{token}/", show), WebSocketRoute("/{token}/stream", stream)])
    app.router.redirect_slashes = False
    return app


async def _attend(session: Session, websocket: WebSocket) -> None:
    """Send a page its messages and receive its requests, until either ends."""
    loop, bell = asyncio.get_running_loop(), asyncio.Event()

    def ring() -> None:
        with suppress(RuntimeError):  # the server ends
            loop.call_soon_threadsafe(bell.set)

    box = Mailbox(ring)
    session.audience.join(box)
    tasks = [asyncio.create_task(_send(box, bell, websocket)), asyncio.create_task(_receive(session, box, websocket))]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    except (WebSocketDisconnect, RuntimeError, OSError):
        pass  # it has closed
    finally:
        session.audience.leave(box)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send(box: Mailbox, bell: asyncio.Event, websocket: WebSocket) -> None:
    """Sending waits for a slow page; meanwhile new frames replace old ones in its mailbox."""
    while True:
        await bell.wait()
        bell.clear()
        for mail in box.take():
            if isinstance(mail, str):
                await websocket.send_text(mail)
            else:
                await websocket.send_bytes(mail)


async def _receive(session: Session, box: Mailbox, websocket: WebSocket) -> None:
    allowance, dropped = Allowance(), 0
    while dropped <= MOST_DROPPED:
        received = await websocket.receive()
        if received["type"] == "websocket.disconnect":
            return
        text = received.get("text")
        message = messages.read(text) if text is not None and allowance.spend() else None
        if message is None or not session.ask(box, message):
            dropped += 1
            session.refuse()
    await websocket.close(POLICY, "too many invalid messages")


class Server:
    """A session's server on loopback; a browser opens `address`.

    port: 0 for any free port.
    """

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self._socket = _bound(port)
        self.port: int = self._socket.getsockname()[1]
        self.token = secrets.token_urlsafe(24)
        self.address = f"http://{HOST}:{self.port}/{self.token}/"
        app: Any = application(session, Gate(self.token, self.port))
        self._uvicorn = uvicorn.Server(uvicorn.Config(
            app, log_config=None, log_level=logging.CRITICAL, access_log=False, lifespan="off",
            http=HttpConnection, ws=PageConnection,
            ws_max_size=messages.LONGEST, ws_per_message_deflate=False, ws_ping_interval=PING_S, ws_ping_timeout=PING_S,
            h11_max_incomplete_event_size=16_384, limit_concurrency=4 * MOST_PAGES, timeout_keep_alive=5,
            timeout_graceful_shutdown=1, server_header=False, proxy_headers=False,
        ))  # fmt: skip

    def run(self) -> None:
        """Serve, and run the session, until Ctrl-C or `stop`; an error of the session's thread is raised here."""
        thread = Thread(target=self.session.run, name="neurotact live", daemon=True)
        thread.start()
        try:
            self._uvicorn.run(sockets=[self._socket])
        finally:
            self.session.stop()
            thread.join(5.0)
            self._socket.close()
        if self.session.fault is not None:
            raise self.session.fault

    def stop(self) -> None:
        """End `run` soon; callable from any thread."""
        self._uvicorn.should_exit = True

    @property
    def is_up(self) -> bool:
        """Whether the server answers."""
        return self._uvicorn.started


def _bound(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
        listening.listen()  # an early request waits until it is answered
    except OSError as error:
        listening.close()
        raise InputError(
            f"`port={port}`: cannot be used ({error.strerror}); choose another, or leave `port` out for any"
        ) from error
    return listening
