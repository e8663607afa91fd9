"""Robots as a whole: held back from tasks, and let go."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from ua_fleet.client import FleetClient, RobotClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters

__all__ = ["ROBOT_OPERATIONS"]


class OfRobot(OperationParameters):
    """A robot."""

    robot: str = Field(min_length=1, max_length=200)


class Hold(OfRobot):
    """Why it is held back, which others read."""

    reason: str = Field(default="", max_length=200)


async def _hold(client: FleetClient, asked: Hold) -> None:
    await RobotClient(client).hold(asked.robot, asked.reason)


async def _release(client: FleetClient, asked: OfRobot) -> None:
    await RobotClient(client).release(asked.robot)


ROBOT_OPERATIONS: Final = (
    OperationKind("robots.hold", Hold, _hold, "Hold of a robot", "operator"),
    OperationKind("robots.release", OfRobot, _release, "Release of a robot", "operator"),
)
