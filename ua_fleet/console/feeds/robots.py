"""Feed `robots`: every robot of the fleet, as its card needs it. Keys are names of robots."""

from __future__ import annotations

from contextlib import aclosing
from typing import Any, Final

from ua_fleet.client import FleetClient, Reading, RobotSummary
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters
from ua_fleet.console.shown import harmless_value, shown_time, shown_value

__all__ = ["ROBOTS", "held_shown", "state_shown"]

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


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    async with aclosing(client.watch_summaries()) as changes:
        async for change in changes:
            for robot in change.changed:
                board.put(robot.name, _card(robot))
            for name in change.gone:
                board.gone(name)
            if change.is_whole:
                board.ready()


ROBOTS: Final = FeedKind("robots", NoParameters, _run)
