"""Feed `counts`: how much waits for a person. Keys: `alarms` (active, not acknowledged), `decisions` (open)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Final

from ua_fleet.client import DecisionTold, FaultTold, FleetClient, Reading, Told
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.alarms import fault_nodes
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


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    def counted() -> None:
        if len(board) == len(counts):
            board.ready()

    counts = {name: _Count(name, board, counted) for name in ("alarms", "decisions")}

    async def count(
        name: str,
        nodes: Callable[[FleetClient], Awaitable[dict[str, str]]],
        parts: Sequence[str],
        is_one: Callable[[Mapping[str, Any]], bool],
        told: type[Told],
    ) -> None:
        def row(_key: str, readings: Mapping[str, Reading]) -> bool | None:
            return is_one({part: reading.exact for part, reading in readings.items()}) or None

        async def look() -> dict[str, str]:
            return await nodes(client)

        async def show(found: dict[str, str]) -> None:
            await show_rows(client, counts[name].rows, found, parts, row)

        await followed(client, look, show, telling(client, (told,)))

    async with asyncio.TaskGroup() as group:
        group.create_task(
            count(
                *("alarms", fault_nodes, ("ActiveState.Id", "AckedState.Id")),
                lambda part: part["ActiveState.Id"] is True and part["AckedState.Id"] is not True,
                FaultTold,
            )
        )
        group.create_task(
            count("decisions", decision_nodes, ("State",), lambda part: part["State"] == "open", DecisionTold)
        )


COUNTS: Final = FeedKind("counts", NoParameters, _run)
