"""Feed `events`: what the server tells, beginning with the events of the last hour that it has kept.

Keys rise with time: `0` and a number for events of the history, `1` and a number for those that came since somebody
looks. An event that is in both is there once, by its EventId. The key `history` says what became of the history.

Audit events are among them for engineers, since the server gives them to nobody else.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import EventInfo, FleetClient
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.shown import harmless_value, shown_time, shown_value
from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode

__all__ = ["EVENTS", "HISTORY_KEY", "EventsShown"]

HISTORY_KEY: Final = "history"
_SPAN: Final = timedelta(hours=1)
_AHEAD: Final = timedelta(minutes=1)
"""Events may have happened since the server has told its time."""
_CURRENT_TIME: Final = "i=2258"
_REFUSED: Final = (StatusCode.BAD_USER_ACCESS_DENIED, StatusCode.BAD_NOT_READABLE)


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


class EventsShown:
    """Keeps the newest events on a board, each once."""

    def __init__(self, board: Board, most: int) -> None:
        """Begin with none; the history is being read."""
        self._board, self._most = board, most
        self._keys: deque[str] = deque()
        self._number = 0
        self._live: set[bytes] = set()
        """EventIds of those that came before the history did."""
        self._past: set[bytes] = set()
        """EventIds of the history."""
        self._is_read = False
        self._note("loading")

    def tell(self, one: EventInfo) -> None:
        """An event has come."""
        if one.event_id in self._past:
            return
        if not self._is_read:
            self._live.add(one.event_id)
        self._number += 1
        key = f"1{self._number:09d}"
        self._board.put(key, _event(one))
        self._keys.append(key)
        if len(self._keys) > self._most:
            self._board.gone(self._keys.popleft())

    def begin_with(self, past: Sequence[EventInfo], since: datetime) -> None:
        """The events of the history, the newest first; `since` is the time from which it was read."""
        new = [one for one in past if one.event_id not in self._live][: self._most - len(self._keys)]
        for at, one in enumerate(new):
            key = f"0{self._most - at:09d}"
            self._board.put(key, _event(one))
            self._keys.appendleft(key)
        self._past = {one.event_id for one in past}
        self._end("read", since=since)

    def refused(self, error: AccessRefused) -> None:
        """The history cannot be read."""
        if error.ua_status == StatusCode.BAD_HISTORY_OPERATION_UNSUPPORTED:
            self._end("none")
        else:
            self._end("refused" if error.ua_status in _REFUSED else "failed", reason=str(error))

    def _end(self, state: str, *, since: datetime | None = None, reason: str = "") -> None:
        self._is_read, self._live = True, set()
        self._note(state, since=since, reason=reason)

    def _note(self, state: str, *, since: datetime | None = None, reason: str = "") -> None:
        note = {"state": state, "since": shown_time(since), "most": self._most, "reason": harmless_value(reason)}
        self._board.put(HISTORY_KEY, note)


async def _read(client: FleetClient, shown: EventsShown, most: int) -> None:
    """Begin with what the server has kept."""
    try:
        told = (await client.read(_CURRENT_TIME)).exact
        now = told.replace(tzinfo=UTC) if isinstance(told, datetime) else datetime.now(UTC)
        past = await client.past_events(now - _SPAN, now + _AHEAD, most)
    except AccessRefused as error:
        shown.refused(error)
    else:
        shown.begin_with(past, now - _SPAN)


async def _run(client: FleetClient, parameters: EventFeedParameters, board: Board) -> None:
    shown = EventsShown(board, parameters.most)
    # Subscribed before the history is read: what happens meanwhile is in one of them at least.
    async with client.events() as events, asyncio.TaskGroup() as group:
        board.ready()
        group.create_task(_read(client, shown, parameters.most))
        async for one in events:
            shown.tell(one)


EVENTS: Final = FeedKind("events", EventFeedParameters, _run)
