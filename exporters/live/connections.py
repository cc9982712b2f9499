"""Connections of the page's server that cannot starve it: idle, slow and flooding ones are closed.

Anyone on this machine can open connections, without the token too. A connection must send a request and take its answer
within `ANSWERED_S`; of those without a request under way, the oldest are closed where there are more than `MOST_IDLE`,
so a browser is always let in. A websocket that does not read, or sends a message in endless parts, is closed.
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

ANSWERED_S = 10.0
"""Longest time from the begin of a connection, or from an answer, to the end of the next answer."""
MOST_IDLE = 16
MOST_UNREAD = 1 << 20
"""Bytes that may wait for a websocket when it asks for an answer; a frame for its page has less."""
MOST_PARTS = 64
"""Of a message, whose bytes are limited too."""


class HttpConnection(H11Protocol):
    """A connection before it becomes a websocket."""

    _deadline: asyncio.TimerHandle | None = None
    idle_since_s = 0.0

    @property
    def is_idle(self) -> bool:
        """Whether no request is under way."""
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._begin_to_wait()
        idle = sorted(
            (other for other in self.connections if isinstance(other, HttpConnection) and other.is_idle),
            key=lambda other: other.idle_since_s,
        )
        for other in idle[: max(0, len(idle) - MOST_IDLE)]:
            other.transport.abort()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._begin_to_wait()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._stop_waiting()
        super().handle_websocket_upgrade(event)

    def _begin_to_wait(self) -> None:
        self._stop_waiting()
        self.idle_since_s = self.loop.time()
        self._deadline = self.loop.call_later(ANSWERED_S, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()


class PageConnection(WebSocketsSansIOProtocol):
    """The websocket of a page."""

    _n_parts = 0

    def handle_ping(self) -> None:
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()
        else:
            super().handle_ping()

    def handle_text(self, event: Frame) -> None:
        self._n_parts = 1
        super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        self._n_parts = 1
        super().handle_bytes(event)

    def handle_cont(self, event: Frame) -> None:
        self._n_parts += 1
        if self._n_parts > MOST_PARTS:
            self.transport.abort()
        else:
            super().handle_cont(event)
