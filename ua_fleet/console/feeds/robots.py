"""Feed `robots`: every robot of the fleet, as its card needs it. Keys are names of robots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_fleet.client import FleetClient, Reading
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, NoParameters
from ua_fleet.console.shown import harmless_value, shown_time, shown_value

__all__ = ["ROBOTS", "state_shown"]

_STATES: Final = ("offline", "idle", "busy", "faulted")
"""RobotStateEnumeration of the UaFleet nodeset."""
_PARTS: Final = ("State", "HeldBy", "HeldSince", "HeldReason", "Description", "Origin", "Capacities")


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


def _card(name: str, parts: Mapping[str, Reading]) -> dict[str, Any]:
    values = {part: reading.value for part, reading in parts.items()}
    return {
        "name": name,
        "state": state_shown(parts["State"]),
        "held": held_shown(values.get("HeldBy"), parts.get("HeldSince"), values.get("HeldReason")),
        "description": harmless_value(str(values.get("Description") or "")),
        "origin": str(values.get("Origin") or ""),
        "capacities": harmless_value(list(values.get("Capacities") or ())),
    }


async def _run(client: FleetClient, parameters: NoParameters, board: Board) -> None:
    async def look() -> dict[str, str]:
        return {name: node.to_string() for name, node in sorted((await client.robots()).items())}

    async def show(robots: dict[str, str]) -> None:
        board.keep(set(robots))
        place = {f"{node}.{part}": (name, part) for name, node in robots.items() for part in _PARTS}
        told: dict[str, dict[str, Reading]] = {name: {} for name in robots}
        if not place:
            board.ready()
        async for reading in client.watch(list(place), period_ms=250):
            name, part = place[reading.node_id]
            parts = told[name]
            parts[part] = reading
            if "State" in parts and len(parts) == len(_PARTS):
                board.put(name, _card(name, parts))
                if not board.is_ready and all(len(one) == len(_PARTS) for one in told.values()):
                    board.ready()

    await followed(client, look, show)


ROBOTS: Final = FeedKind("robots", NoParameters, _run)
