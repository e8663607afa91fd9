"""Feed `alarms`: faults that are active, or that nobody has acknowledged, of all robots or of one. Keys are their ids,
e.g. `rover.silent`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ua_fleet.client import FaultTold, FleetClient, Reading
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed, show_rows, telling
from ua_fleet.console.feeds.kinds import FeedKind, OfAnyRobot
from ua_fleet.console.shown import harmless_value, shown_value

__all__ = ["ALARMS", "fault_nodes"]

_FOLDER: Final = "ns=2;s=Fleet.Faults"
_PARTS: Final = (
    *("Robot", "FaultSource", "Reason", "Capacities", "Message", "Severity", "Time", "Retain"),
    *("ActiveState.Id", "ActiveState.TransitionTime", "AckedState.Id", "Comment", "ClientUserId"),
)


def _alarm(fault: str, parts: Mapping[str, Reading]) -> dict[str, Any] | None:
    told = {name: reading.exact for name, reading in parts.items()}
    if not told["Retain"]:
        return None
    return {
        "id": fault,
        "robot": harmless_value(str(told["Robot"] or "")),
        "source": harmless_value(str(told["FaultSource"] or "")),
        "reason": harmless_value(str(told["Reason"] or "")),
        "capacities": harmless_value(list(told["Capacities"] or ())),
        "message": harmless_value(str(told["Message"] or "")),
        "severity": told["Severity"],
        "active": told["ActiveState.Id"] is True,
        "acknowledged": told["AckedState.Id"] is True,
        "since": shown_value(told["ActiveState.TransitionTime"]),
        "time": shown_value(told["Time"]),
        "comment": harmless_value(str(told["Comment"] or "")),
        "by": harmless_value(str(told["ClientUserId"] or "")),
    }


async def fault_nodes(client: FleetClient, robot: str = "") -> dict[str, str]:
    """NodeIds of faults by their ids, of all robots or of one."""
    nodes = await client.browse(_FOLDER)
    beginning = f"{robot}." if robot else ""
    return {
        node.browse_name: node.node_id
        for node in nodes
        if node.node_class == "Object" and node.browse_name.startswith(beginning)
    }


async def _run(client: FleetClient, parameters: OfAnyRobot, board: Board) -> None:
    async def look() -> dict[str, str]:
        return await fault_nodes(client, parameters.robot)

    async def show(faults: dict[str, str]) -> None:
        await show_rows(client, board, faults, _PARTS, _alarm)

    await followed(client, look, show, telling(client, (FaultTold,)))


ALARMS: Final = FeedKind("alarms", OfAnyRobot, _run)
