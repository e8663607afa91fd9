"""Bounds of connections that uvicorn does not have: so many of an address, and so long until each side does its part.

A connection counts for its address from when it is accepted, before TLS has begun, until its socket is closed. The
WebSocket of a browser that is logged in does not while it is served: it has bounds of its own.
"""

from __future__ import annotations

import asyncio
import socket
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Final

from uvicorn._types import ASGISendEvent
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.origins import TrustedProxies, source_of

__all__ = ["PING_S", "PONG_S", "BoundedListener", "Connections", "bounded_http", "bounded_websocket"]

HEAD_S: Final = 15.0
"""Until the head of a request is there, from the connection's begin or the end of the request before it."""
TAKEN_S: Final = 60.0
"""Until a browser has taken of an answer what no buffer holds."""
PING_S: Final = 10.0
"""Between two pings of a WebSocket, and..."""
PONG_S: Final = 20.0
"""...until it has answered one."""
CLOSED_S: Final = 5.0
"""Until a browser has said that its WebSocket is closed."""

_Peer = tuple[Any, ...]


class _Place:
    """A connection that is open."""

    def __init__(self, source: str) -> None:
        self.source = source


class Connections:
    """The connections that are open, by their addresses; those of trusted proxies are of many, and do not count."""

    def __init__(self, proxies: TrustedProxies, most_of_address: int, counts: ConsoleCounts) -> None:
        self._proxies, self._most, self._counts = proxies, most_of_address, counts
        self._open: dict[_Peer, _Place] = {}
        self._counted: Counter[str] = Counter()

    def accepted(self, peer: _Peer) -> bool:
        """Take a connection, by address and port of the other side; False: its address has too many."""
        address = str(peer[0])
        if self._proxies.is_trusted(address):
            return True
        source = source_of(address)
        if self._counted[source] >= self._most:
            self._counts.drop("too_many_connections")
            return False
        self._open[peer[:2]] = _Place(source)
        self._counted[source] += 1
        return True

    def closed(self, peer: _Peer) -> None:
        """Its socket is closed."""
        place = self._open.pop(peer[:2], None)
        if place is not None and place.source:
            self._leave(place.source)

    @contextmanager
    def logged_in(self, peer: _Peer | None) -> Generator[None]:
        """Do not count a connection meanwhile, since it is that of somebody who is logged in."""
        place = self._open.get(tuple(peer[:2])) if peer else None
        if place is None:
            yield
            return
        source, place.source = place.source, ""
        self._leave(source)
        try:
            yield
        finally:
            place.source = source
            if peer and self._open.get(tuple(peer[:2])) is place:
                self._counted[source] += 1

    def _leave(self, source: str) -> None:
        self._counted[source] -= 1
        if not self._counted[source]:
            del self._counted[source]


class BoundedListener(socket.socket):
    """A socket that listens, and takes no more connections of an address than it may have."""

    connections: Connections

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; ConnectionAbortedError where it was refused: asyncio goes on with the next one."""
        made, peer = super().accept()
        if not self.connections.accepted(peer):
            made.close()
            raise ConnectionAbortedError
        counted = _Accepted(fileno=made.detach())
        counted.connections, counted.peer = self.connections, peer
        return counted, peer


class _Accepted(socket.socket):
    """A connection that says when it is closed, whoever closes it: asyncio or TLS too, of which no protocol hears."""

    connections: Connections
    peer: _Peer

    def close(self) -> None:
        super().close()
        self.connections.closed(self.peer)


def bounded_http(counts: ConsoleCounts) -> type[H11Protocol]:
    """The class of connections for uvicorn; what is cut is counted in `counts`."""

    class BoundedHttp(H11Protocol):
        """One connection."""

        _head: asyncio.TimerHandle | None = None
        _taking: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._expect_head()

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            self._stop_watching()

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._stop_watching()
            super().handle_websocket_upgrade(event)

        def on_response_complete(self) -> None:
            self._expect_head()
            super().on_response_complete()

        def pause_writing(self) -> None:
            """More waits than buffers hold."""
            super().pause_writing()
            self._taking = _later(self._taking, TAKEN_S, self._cut)

        def resume_writing(self) -> None:
            """Enough was taken."""
            super().resume_writing()
            if self._taking is not None:
                self._taking.cancel()

        def _expect_head(self) -> None:
            self._head = _later(self._head, HEAD_S, self._head_late)

        def _head_late(self) -> None:
            cycle: Any = self.cycle
            if cycle is None or cycle.response_complete:
                self._cut()

        def _cut(self) -> None:
            counts.drop("too_slow")
            self.transport.abort()  # where it is closing already, too: what nobody takes would keep it for ever

        def _stop_watching(self) -> None:
            for watch in (self._head, self._taking):
                if watch is not None:
                    watch.cancel()

    return BoundedHttp


def bounded_websocket(counts: ConsoleCounts) -> type[WebSocketsSansIOProtocol]:
    """The class of WebSockets for uvicorn, which waits without end for whoever takes nothing and confirms nothing."""

    class BoundedWebSocket(WebSocketsSansIOProtocol):
        """One WebSocket."""

        _closing: asyncio.TimerHandle | None = None

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            if self._closing is not None:
                self._closing.cancel()

        def keepalive_timeout(self) -> None:
            """No answer to a ping: close it, and do not wait until somebody takes what was sent."""
            super().keepalive_timeout()
            self._cut()

        async def send(self, message: ASGISendEvent) -> None:
            """Send, or close within a time."""
            if message["type"] == "websocket.close":
                self._closing = _later(self._closing, CLOSED_S, self._cut)
            await super().send(message)

        def _cut(self) -> None:
            counts.drop("too_slow")
            self.transport.abort()

    return BoundedWebSocket


def _later(before: asyncio.TimerHandle | None, seconds: float, act: Any) -> asyncio.TimerHandle:
    if before is not None:
        before.cancel()
    return asyncio.get_running_loop().call_later(seconds, act)
