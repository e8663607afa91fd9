"""What the WebSockets of pages have in common: how a message is read, and with which codes they are closed."""

from __future__ import annotations

import asyncio
from typing import Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.failures import invalid_parameters
from ua_fleet.console.sessions import BrowserSession

__all__ = [
    "CLOSE_FORBIDDEN",
    "CLOSE_INVALID",
    "CLOSE_LOGGED_OUT",
    "CLOSE_OVER",
    "CLOSE_REFUSED",
    "CLOSE_SILENT",
    "CLOSE_TOO_MANY",
    "Closed",
    "FirstSaid",
    "close",
    "first_said",
    "said_by",
]

CLOSE_INVALID: Final = 4400
CLOSE_LOGGED_OUT: Final = 4401
CLOSE_FORBIDDEN: Final = 4403
CLOSE_SILENT: Final = 4408
CLOSE_REFUSED: Final = 4409
"""A robot is not given out."""
CLOSE_OVER: Final = 4410
"""A lease is over."""
CLOSE_TOO_MANY: Final = 4429
FIRST_S: Final = 10.0
"""A page says its csrf token within so long."""

Said = TypeVar("Said", bound=BaseModel)
First = TypeVar("First", bound="FirstSaid")


class FirstSaid(BaseModel):
    """What the first message of a page has."""

    model_config = ConfigDict(extra="forbid")
    csrf: str | None = Field(default=None, max_length=200)


class Closed(Exception):
    """A page's WebSocket is to be closed."""

    def __init__(self, code: int, reason: str) -> None:
        self.code, self.reason = code, reason


async def said_by(socket: WebSocket, kind: type[Said], counts: ConsoleCounts) -> Said:
    """The next message of a page; raises Closed where it is none of ours, WebSocketDisconnect when it has gone."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    text = message.get("text")
    if text is None:
        counts.drop("invalid")
        raise Closed(CLOSE_INVALID, "a message is JSON text")
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        counts.drop("invalid")
        raise Closed(CLOSE_INVALID, str(invalid_parameters(error, "message"))) from None


async def first_said(
    socket: WebSocket, kind: type[First], session: BrowserSession, counts: ConsoleCounts, timeout_s: float = FIRST_S
) -> First:
    """The first message, which has the token of its session; raises as `said_by`."""
    try:
        async with asyncio.timeout(timeout_s):
            first = await said_by(socket, kind, counts)
    except TimeoutError:
        raise Closed(CLOSE_SILENT, "silent") from None
    if first.csrf is None or not session.is_csrf(first.csrf):
        counts.drop("wrong_csrf")
        raise Closed(CLOSE_FORBIDDEN, "the first message has no csrf token of this session")
    return first


async def close(socket: WebSocket, code: int, reason: str) -> None:
    """Close a page's WebSocket, where it is not closed already."""
    shown = reason.encode()[:120].decode(errors="ignore")  # a Close frame has room for 123 bytes
    try:
        await socket.close(code, shown)
    except (RuntimeError, WebSocketDisconnect):
        return
