"""Bounds of HTTP connections that uvicorn does not have: so many of an address, and so long for a request's head."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.origins import TrustedProxies

__all__ = ["bounded_http"]

HEAD_S: Final = 15.0
"""Until the head of a request is there, from the connection's begin or the end of the request before it."""


def bounded_http(proxies: TrustedProxies, most_of_address: int, counts: ConsoleCounts) -> type[H11Protocol]:
    """The class of connections for uvicorn.

    Args:
        proxies: their connections are those of many, and are not counted.
        most_of_address: connections of one address that are not WebSockets.
        counts: what is refused is counted here.
    """
    there: Counter[str] = Counter()

    class BoundedHttp(H11Protocol):
        """One connection."""

        _address = ""
        _watch: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            address = self.client[0] if self.client else ""
            if address and not proxies.is_trusted(address):
                if there[address] >= most_of_address:
                    counts.drop("too_many_connections")
                    transport.abort()
                    return
                self._address = address
                there[address] += 1
            self._expect_head()

        def connection_lost(self, exc: Exception | None) -> None:
            super().connection_lost(exc)
            self._leave()

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._leave()
            super().handle_websocket_upgrade(event)

        def on_response_complete(self) -> None:
            self._expect_head()
            super().on_response_complete()

        def _expect_head(self) -> None:
            if self._watch is not None:
                self._watch.cancel()
            self._watch = self.loop.call_later(HEAD_S, self._head_late)

        def _head_late(self) -> None:
            cycle: Any = self.cycle
            if (cycle is None or cycle.response_complete) and not self.transport.is_closing():
                counts.drop("too_slow")
                self.transport.abort()

        def _leave(self) -> None:
            if self._watch is not None:
                self._watch.cancel()
                self._watch = None
            if self._address:
                there[self._address] -= 1
                if not there[self._address]:
                    del there[self._address]
                self._address = ""

    return BoundedHttp
