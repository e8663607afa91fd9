"""Feed `alarms`: the conditions that are to be looked at, of all robots or of one: faults, alarms of values, bridges
and certificates, and what people have to decide. Keys are their ConditionIds; `partial` is there while it is not known
whether these are all, since a server with more than it has room for has told the last ones alone.

One is shown while it is active, not acknowledged or not confirmed, and while it is disabled, suppressed or shelved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from ua_fleet.client import ConditionInfo, ConditionsKnown, FleetClient
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.kinds import FeedKind, OfAnyRobot
from ua_fleet.console.shown import harmless_value, shown_time

__all__ = ["ALARMS", "PARTIAL_KEY", "follow_conditions", "robot_of"]

PARTIAL_KEY: Final = "partial"


def robot_of(info: ConditionInfo) -> str:
    """The robot that a condition is about; empty: it is about something else."""
    if info.kind == "fault":
        return info.robot
    is_of_value = info.kind in ("limit", "off_normal") and info.source_name == info.name
    return info.name.partition(".")[0] if is_of_value else ""


def _alarm(info: ConditionInfo) -> dict[str, Any]:
    return {
        "id": harmless_value(info.name),
        "node": info.node_id,
        "event": info.event_id.hex(),
        "kind": info.kind,
        "robot": harmless_value(robot_of(info)),
        "source": harmless_value(info.fault_source or info.source_name),
        "source_node": info.source_node,
        "reason": harmless_value(info.reason),
        "capacities": harmless_value(list(info.capacities)),
        "message": harmless_value(info.message),
        "severity": info.severity,
        "retained": info.retain,
        "active": info.active,
        "acknowledged": info.acknowledged,
        "confirmed": info.confirmed,
        "enabled": info.enabled,
        "suppressed": info.suppressed,
        "shelved": info.shelving,
        "unshelve_at": shown_time(info.unshelve_at),
        "limit": info.limit,
        "quality": info.quality,
        "since": shown_time(info.since),
        "time": shown_time(info.time),
        "comment": harmless_value(info.comment),
        "by": harmless_value(info.comment_by),
    }


async def follow_conditions(
    client: FleetClient, board: Board, row: Callable[[ConditionInfo], Any], *, partial_key: str = ""
) -> None:
    """Keep one value on a board for each condition that is to be looked at; `row` is None for those that are not.

    Args:
        client: of the server.
        board: gets the values, by their ConditionIds.
        row: makes a value.
        partial_key: has the value true while it is not known whether these are all; empty: nothing has.
    """
    async with client.conditions() as told:
        async for one in told:
            if isinstance(one, ConditionsKnown):
                if one.is_whole:
                    board.keep(set(one.node_ids))
                elif partial_key:
                    board.put(partial_key, True)
                board.ready()
            elif (shown := row(one) if one.is_shown else None) is not None:
                board.put(one.node_id, shown)
            else:
                board.gone(one.node_id)


async def _run(client: FleetClient, parameters: OfAnyRobot, board: Board) -> None:
    def row(info: ConditionInfo) -> dict[str, Any] | None:
        return _alarm(info) if parameters.robot in ("", robot_of(info)) else None

    await follow_conditions(client, board, row, partial_key=PARTIAL_KEY)


ALARMS: Final = FeedKind("alarms", OfAnyRobot, _run)
