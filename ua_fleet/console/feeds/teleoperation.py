"""Feed `teleoperation`: how a robot is driven by hand, and who drives it now.

Who drives it himself hears more of it by `api/drive`. Keys are `info` (null: nobody drives it by hand) and `status`.
"""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from typing import Any, Final

from pydantic import Field

from ua_fleet.client import (
    FleetClient,
    NodeNotFound,
    TeleoperationInfo,
    TeleoperationStatus,
    teleoperation_info,
    watch_teleoperation,
)
from ua_fleet.console.board import Board
from ua_fleet.console.feeds.following import followed
from ua_fleet.console.feeds.kinds import FeedKind, FeedParameters
from ua_fleet.console.shown import shown_time
from ua_fleet.printing import harmless

__all__ = ["TELEOPERATION", "teleoperation_shown"]

_PERIOD_MS: Final = 100.0


class TeleoperationParameters(FeedParameters):
    """Which robot."""

    robot: str = Field(min_length=1, max_length=1000)


def teleoperation_shown(info: TeleoperationInfo) -> dict[str, Any]:
    """How a robot is driven, for the page."""
    return {
        "axes": [
            {
                "name": harmless(axis.name),
                "unit": harmless(axis.unit or ""),
                "speed": axis.speed,
                "acceleration": axis.acceleration,
                "deceleration": axis.deceleration,
                "jerk": axis.jerk,
            }
            for axis in info.axes
        ],
        "deadman_ms": round(info.deadman_s * 1000),
        "lease_ms": round(info.lease_s * 1000),
        "robot_timeout_ms": round(info.robot_timeout_s * 1000),
        "period_ms": round(info.period_s * 1000),
        "stop_ms": round(info.stop_s * 1000),
    }


def _status(status: TeleoperationStatus) -> dict[str, Any]:
    return {
        "s": status.status,
        "state": status.state,
        "holder": harmless(status.holder),
        "since": shown_time(status.held_since),
        "last_end": harmless(status.last_end),
        "output": list(status.output),
    }


async def _run(client: FleetClient, parameters: TeleoperationParameters, board: Board) -> None:
    async def look() -> TeleoperationInfo | None:
        try:
            return await teleoperation_info(client, parameters.robot)
        except NodeNotFound:
            return None

    async def show(info: TeleoperationInfo | None) -> None:
        board.put("info", None if info is None else teleoperation_shown(info))
        if info is None:
            board.gone("status")
            board.ready()
            await asyncio.Event().wait()
            return
        async with aclosing(watch_teleoperation(client, info, period_ms=_PERIOD_MS)) as statuses:
            async for status in statuses:
                board.put("status", _status(status))
                if status.state:
                    board.ready()

    await followed(client, look, show)


TELEOPERATION: Final = FeedKind("teleoperation", TeleoperationParameters, _run)
