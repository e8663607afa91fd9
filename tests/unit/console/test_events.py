"""Events of the history and of now on one board: each once, the newest ones, and what became of the history."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from ua_fleet.client import EventInfo
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.events import HISTORY_KEY, EventsShown
from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


def event(number: int) -> EventInfo:
    at = BEGIN + timedelta(seconds=number)
    return EventInfo(bytes([number]), "BaseEventType", at, 1, f"event {number}", "", "", False, {})


def told(board: Board) -> list[str]:
    """The messages in the order of their keys, the oldest first."""
    rows = {key: json.loads(text) for key, text in board.items() if key != HISTORY_KEY}
    return [rows[key]["message"].removeprefix("event ") for key in sorted(rows)]


def note(board: Board) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(board.get(HISTORY_KEY) or "{}")
    return found


def test_what_is_in_both_is_there_once_whichever_came_first() -> None:
    board = Board()
    shown = EventsShown(board, 10)
    assert note(board)["state"] == "loading"
    shown.tell(event(3))
    shown.begin_with([event(4), event(3), event(2), event(1)], BEGIN)
    for number in (4, 5):
        shown.tell(event(number))
    assert told(board) == ["1", "2", "4", "3", "5"]
    assert note(board) == {"state": "read", "since": "2026-01-01T00:00:00.000Z", "most": 10, "reason": ""}


def test_the_newest_are_kept_and_those_of_the_history_go_first() -> None:
    board = Board()
    shown = EventsShown(board, 3)
    shown.tell(event(7))
    shown.begin_with([event(number) for number in (6, 5, 4)], BEGIN)
    assert told(board) == ["5", "6", "7"]
    shown.tell(event(8))
    assert told(board) == ["6", "7", "8"]


def test_more_events_than_room_before_the_history_came_leave_none_of_it() -> None:
    board = Board()
    shown = EventsShown(board, 2)
    for number in (7, 8, 9):
        shown.tell(event(number))
    shown.begin_with([event(7), event(6)], BEGIN)
    assert told(board) == ["8", "9"]


@pytest.mark.parametrize(
    ("status", "state"),
    [
        (StatusCode.BAD_HISTORY_OPERATION_UNSUPPORTED, "none"),
        (StatusCode.BAD_USER_ACCESS_DENIED, "refused"),
        (StatusCode.BAD_NOT_READABLE, "refused"),
        (StatusCode.BAD_TIMEOUT, "failed"),
    ],
)
def test_a_history_that_cannot_be_read_is_said_and_what_comes_is_told(status: StatusCode, state: str) -> None:
    board = Board()
    shown = EventsShown(board, 10)
    shown.refused(AccessRefused(status, "why \x1b[31m"))
    shown.tell(event(1))
    assert told(board) == ["1"]
    assert note(board)["state"] == state
    assert note(board)["reason"] == ("" if state == "none" else r"why \x1b[31m")
