"""The parts of this package put together for one server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.leases import EndedLease
from ua_fleet.operation.skills.executions import SkillKeys
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.teleoperation.methods import TeleoperationMethods
from ua_fleet.server.teleoperation.service import TeleoperationService
from ua_fleet.wire.security import SecurityMode

__all__ = ["add_teleoperation"]


def add_teleoperation(
    model: FleetModel, server: HardenedServer, hub: Hub, projection: Projection, driven: Callable[[str, str], None]
) -> TeleoperationService:
    """Let people drive robots by hand; the server is not started yet.

    Args:
        model: its robots, with their nodes.
        server: gets the Methods.
        hub: carries data.
        projection: writes values to nodes.
        driven: told of who drives a robot, in words; empty: nobody.
    """
    robots = {robot.name: robot for robot in model.robots if robot.teleoperation is not None}
    models = [robot.teleoperation for robot in robots.values() if robot.teleoperation is not None]

    def ended(over: EndedLease, lasted_s: float) -> None:
        lease = over.lease
        server.context.audit.record(
            "teleoperation",
            lease.caller,
            "Good",
            robot=lease.robot,
            lease=lease.number,
            lasted_s=round(lasted_s, 3),
            setpoints=lease.setpoints,
            ended=over.why,
        )

    service = TeleoperationService(
        models,
        send=hub.send,
        want=hub.want_action,
        sooner=hub.check_deadline,
        put=projection.put_ahead,
        busy=lambda name: _busy(hub, robots[name]),
        driven=driven,
        ended=ended,
        must_be_verified=hub.envelope.mode is not SecurityMode.NONE,
        clock=asyncio.get_running_loop().time,
        wall_ticks=wall_ticks,
    )
    TeleoperationMethods(server, service, models)
    server.context.departed.append(service.departed)

    async def look_after() -> None:
        service.look_after()

    server.context.housekeeping.append(look_after)
    hub.add_teleoperation(service)
    return service


def _busy(hub: Hub, robot: RobotModel) -> str:
    """The skills that a robot is at, in words."""
    return ", ".join(
        [skill.name for skill in robot.skills if hub.tracker.under_way(SkillKeys(robot.ns, skill.id).object)]
    )
