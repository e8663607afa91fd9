"""Feed `counts`: how much waits for a person.

Keys: `alarms` (active, not acknowledged, not put aside), `decisions` (open).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Final

from ua_fleet.client import ConditionInfo, DecisionTold, FleetClient, Reading
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.alarms import follow_conditions
from ua_fleet.console.feeds.decisions import decision_nodes
from ua_fleet.console.feeds.following import followed, show_rows, telling
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters

__all__ = ["COUNTS"]


class _Count:
    """Counts the rows of a board of its own, and shows their number on another."""

    def __init__(self, name: str, shown: Board, counted: Callable[[], None]) -> None:
        self._name, self._shown, self._counted = name, shown, counted
        self.rows = Board()
        self.rows.attach(self)

    def changed(self, key: str, part: str | None) -> None:
        """A row has come or gone."""
        self.replaced()

    def replaced(self) -> None:
        """All rows are there."""
        self._shown.put(self._name, len(self.rows))
        self._counted()

    def failed(self) -> None:
        """Nobody says so here: a feed that fails is begun anew as a whole."""


def _waits(info: ConditionInfo) -> bool | None:
    is_new = info.active and not info.acknowledged and not info.is_put_aside
    return True if is_new and info.kind != "dialog" else None


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    def counted() -> None:
        if len(board) == len(counts):
            board.ready()

    counts = {name: _Count(name, board, counted) for name in ("alarms", "decisions")}

    def is_open(_key: str, readings: Mapping[str, Reading]) -> bool | None:
        return readings["State"].value == "open" or None

    async def look() -> dict[str, str]:
        return await decision_nodes(client)

    async def show(found: dict[str, str]) -> None:
        await show_rows(client, counts["decisions"].rows, found, ("State",), is_open)

    async with asyncio.TaskGroup() as group:
        group.create_task(follow_conditions(client, counts["alarms"].rows, _waits))
        group.create_task(followed(client, look, show, telling(client, (DecisionTold,))))


COUNTS: Final = FeedKind("counts", NoParameters, _run)
