"""Feed `messages`: the last PubSub messages of the server, for engineers. Keys are rising numbers, and `lost`."""

from __future__ import annotations

import asyncio
import base64
from collections import deque
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient, PubSubMessage, recent_messages
from ua_fleet.console.board import Board
from ua_fleet.console.dissecting import headline
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.shown import harmless_value, shown_time

__all__ = ["MESSAGES"]

_PERIOD_S: Final = 0.5
_AT_ONCE: Final = 3
"""Calls of a period, where there is much."""


class MessageFeedParameters(FeedParameters):
    """Whose messages, and how many are kept."""

    source: str = Field(default="", max_length=256)
    most: int = Field(default=300, ge=1, le=500)


def _entry(one: PubSubMessage) -> dict[str, Any]:
    return {
        "number": one.number,
        "time": shown_time(one.time),
        "sent": one.sent,
        "address": harmless_value(one.address),
        "size": one.size,
        "data": base64.b64encode(one.data).decode("ascii"),
        "open": one.opened,
        "security": one.security,
        "token": one.token_id,
        "chunks": one.in_chunks,
        "dropped": harmless_value(list(one.dropped)),
        **harmless_value(headline(one.data, is_open=one.opened)),
    }


async def _run(client: FleetClient, parameters: MessageFeedParameters, board: Board) -> None:
    shown: deque[str] = deque()
    after = lost = 0
    while True:
        for _ in range(_AT_ONCE):
            heard = await recent_messages(client, parameters.source, after)
            for one in heard.messages:
                after = one.number
                key = f"{one.number:012d}"
                board.put(key, _entry(one))
                shown.append(key)
                if len(shown) > parameters.most:
                    board.gone(shown.popleft())
            lost += heard.lost
            if not heard.has_more:
                break
        board.put("lost", lost)
        board.ready()
        await asyncio.sleep(_PERIOD_S)


MESSAGES: Final = FeedKind("messages", MessageFeedParameters, _run)
