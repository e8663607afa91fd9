"""Feed `events`: what the server has told since somebody looks, the newest last. Keys are rising numbers.

Audit events are among them for engineers, since the server gives them to nobody else.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import EventInfo, FleetClient
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.shown import harmless_value, shown_time, shown_value

__all__ = ["EVENTS"]


class EventFeedParameters(FeedParameters):
    """How many are kept."""

    most: int = Field(default=500, ge=1, le=2000)


def _event(one: EventInfo) -> dict[str, Any]:
    return {
        "type": harmless_value(one.type_name),
        "time": shown_time(one.time),
        "severity": one.severity,
        "message": harmless_value(one.message),
        "source": harmless_value(one.source),
        "node": one.source_node,
        "audit": one.is_audit,
        "fields": harmless_value(shown_value(dict(one.fields))),
    }


async def _run(client: FleetClient, parameters: EventFeedParameters, board: Board) -> None:
    shown: deque[str] = deque()
    async with client.events() as events:
        board.ready()
        number = 0
        async for one in events:
            number += 1
            key = f"{number:09d}"
            board.put(key, _event(one))
            shown.append(key)
            if len(shown) > parameters.most:
                board.gone(shown.popleft())


EVENTS: Final = FeedKind("events", EventFeedParameters, _run)
