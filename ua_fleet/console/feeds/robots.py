"""Feed `robots`: every robot of the fleet, or one, as its card needs it. Keys are names of robots."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from typing import Any, Final

from ua_fleet.client import CardNode, FleetClient, Reading, RobotSummary, SummariesChanged, card_nodes
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, OfAnyRobot
from ua_fleet.console.shown import harmless_value, shown_reading, shown_time, shown_value

__all__ = ["ROBOTS", "held_shown", "state_shown"]

_MOST_MARKED: Final = 500
"""Robots of a fleet whose marked values are watched; of a larger one the cards have none."""
_MARKED_MS: Final = 1000.0
_MARKED_CHARACTERS: Final = 200
"""Of a text on a card."""
_STATES: Final = ("offline", "idle", "busy", "faulted")
"""RobotStateEnumeration of the UaFleet nodeset."""


def state_shown(reading: Reading) -> dict[str, Any]:
    """A robot's State: its name in place of the number."""
    value = reading.value
    name = _STATES[value] if isinstance(value, int) and value in range(len(_STATES)) else None
    return {"v": name, "s": reading.status, "t": shown_time(reading.source_time)}


def held_shown(by: Any, since: Reading | None, reason: Any) -> dict[str, Any] | None:
    """Who holds a robot back from tasks; None: nobody."""
    if not by:
        return None
    return {
        "by": harmless_value(str(by)),
        "since": shown_value(since.exact) if since is not None else None,
        "reason": harmless_value(str(reason or "")),
    }


def _card(robot: RobotSummary) -> dict[str, Any]:
    return {
        "name": robot.name,
        "state": {"v": robot.state, "s": 0, "t": shown_time(robot.state_since)},
        "quality": robot.status,
        "updated": shown_time(robot.last_update),
        "task": harmless_value(robot.task),
        "run": robot.run_id,
        "held": _held(robot) if robot.held else None,
        "faults": robot.faults,
        "fault": harmless_value(robot.fault),
        "bridge": robot.bridge,
        "capacities": harmless_value(list(robot.capacities)),
    }


def _held(robot: RobotSummary) -> dict[str, Any]:
    return {
        "by": harmless_value(robot.held_by),
        "since": shown_time(robot.held_since),
        "reason": harmless_value(robot.held_reason),
    }


def _marked(node: CardNode, reading: Reading) -> dict[str, Any]:
    shown = {"name": harmless_value(node.name), **shown_reading(reading, node.unit)}
    if isinstance(reading.exact, str) and len(reading.exact) > _MARKED_CHARACTERS:
        shown["v"] = f"{shown_value(reading.exact[:_MARKED_CHARACTERS])}…"
    if node.names:
        shown["names"] = {str(number): harmless_value(name) for number, name in node.names.items()}
    return shown


class _Cards:
    """Puts cards together of what is heard of robots as a whole, and of the values that they show beside it."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._cards: dict[str, dict[str, Any]] = {}
        self._marked: dict[str, list[dict[str, Any]]] = {}

    def stands(self, change: SummariesChanged) -> None:
        for robot in change.changed:
            self._cards[robot.name] = _card(robot)
            self._show(robot.name)
        for name in change.gone:
            self._cards.pop(name, None)
            self._board.gone(name)
        if change.is_whole:
            self._board.ready()

    def marks(self, robot: str, marked: list[dict[str, Any]]) -> None:
        self._marked[robot] = marked
        if robot in self._cards:
            self._show(robot)

    def unmark(self, robots: set[str]) -> None:
        """These alone have such values from now on."""
        for robot in self._marked.keys() - robots:
            self.marks(robot, [])

    def _show(self, robot: str) -> None:
        self._board.put(robot, {**self._cards[robot], "marked": self._marked.get(robot, [])})


async def _run(client: FleetClient, parameters: OfAnyRobot, board: Board) -> None:
    cards = _Cards(board)
    if parameters.robot:  # its page has all its values anyway
        async with aclosing(client.watch_summaries(robot=parameters.robot)) as changes:
            async for change in changes:
                cards.stands(change)

    async def look() -> list[CardNode]:
        return await card_nodes(client, _MOST_MARKED)

    async def show(marked: list[CardNode]) -> None:
        place = {one.node_id: one for one in marked}
        told: dict[str, dict[str, Any]] = {}
        order: dict[str, list[str]] = {}
        for one in marked:
            order.setdefault(one.robot, []).append(one.node_id)
        cards.unmark(set(order))
        if not place:
            await asyncio.Event().wait()
        async with aclosing(client.watch(list(place), period_ms=_MARKED_MS, newest_only=True)) as changes:
            async for reading in changes:
                one = place[reading.node_id]
                told[one.node_id] = _marked(one, reading)
                cards.marks(one.robot, [told[node] for node in order[one.robot] if node in told])

    async with asyncio.TaskGroup() as group:
        group.create_task(followed(client, look, show))
        async with aclosing(client.watch_summaries()) as changes:
            async for change in changes:
                cards.stands(change)


ROBOTS: Final = FeedKind("robots", OfAnyRobot, _run)
