"""Robots as a whole: hold and release, register and unregister."""

from __future__ import annotations

from typing import Any, Final

from pydantic import Field

from ua_fleet.client import FleetClient, RobotClient
from ua_fleet.console.operations.kinds import OperationKind, OperationParameters

__all__ = ["ROBOT_OPERATIONS"]


class RobotParameters(OperationParameters):
    """A robot."""

    robot: str = Field(min_length=1, max_length=200)


class HoldParameters(RobotParameters):
    """Why it gets no task."""

    reason: str = Field(default="", max_length=500)


class Registered(RobotParameters):
    """What it is, as in `fleet.yaml`."""

    definition: str = Field(default="", max_length=65_536)
    bridge: str = Field(default="", max_length=200)


async def _hold(client: FleetClient, asked: HoldParameters) -> None:
    await RobotClient(client).hold(asked.robot, asked.reason)


async def _release(client: FleetClient, asked: RobotParameters) -> None:
    await RobotClient(client).release(asked.robot)


async def _register(client: FleetClient, asked: Registered) -> dict[str, Any]:
    return {"node": await RobotClient(client).register(asked.robot, asked.definition, bridge=asked.bridge)}


async def _unregister(client: FleetClient, asked: RobotParameters) -> None:
    await RobotClient(client).unregister(asked.robot)


ROBOT_OPERATIONS: Final = (
    OperationKind("robots.hold", HoldParameters, _hold, "Hold of a robot", "operator"),
    OperationKind("robots.release", RobotParameters, _release, "Release of a robot", "operator"),
    OperationKind("robots.register", Registered, _register, "RegisterRobot", "engineer"),
    OperationKind("robots.unregister", RobotParameters, _unregister, "UnregisterRobot", "engineer"),
)
