"""Robots that are driven by hand, put together for one server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.leases import EndedLease
from ua_fleet.operation.skills.executions import SkillKeys
from ua_fleet.operation.skills.tracker import SkillTracker
from ua_fleet.server.attached import Ground
from ua_fleet.server.hub import wall_ticks
from ua_fleet.server.teleoperation.methods import TeleoperationMethods
from ua_fleet.server.teleoperation.service import TeleoperationService
from ua_fleet.server.timer import Timer

__all__ = ["make_teleoperation"]


def make_teleoperation(
    model: FleetModel,
    server: HardenedServer,
    ground: Ground,
    timer: Timer,
    projection: Projection,
    driven: Callable[[str, str], None],
    *,
    must_be_verified: bool,
) -> TeleoperationService:
    """Let people drive robots by hand; the server is not started yet.

    Args:
        model: its robots, with their nodes.
        server: gets the Methods.
        ground: what is known of the fleet, and how to send.
        timer: is to call what is due.
        projection: writes values to nodes.
        driven: told of who drives a robot, in words; empty: nobody.
        must_be_verified: only signed responses are taken.
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
        send=ground.send,
        want=ground.subscriber.want_action,
        sooner=timer.sooner,
        put=projection.write_ahead,
        busy=lambda name: _busy(ground.tracker, robots[name]),
        driven=driven,
        ended=ended,
        must_be_verified=must_be_verified,
        clock=asyncio.get_running_loop().time,
        wall_ticks=wall_ticks,
    )
    TeleoperationMethods(server, service, models)
    server.context.departed.append(service.departed)

    async def look_after() -> None:
        service.look_after()

    server.context.housekeeping.append(look_after)
    return service


def _busy(tracker: SkillTracker, robot: RobotModel) -> str:
    """The skills that a robot is at, in words."""
    return ", ".join([skill.name for skill in robot.skills if tracker.under_way(SkillKeys(robot.ns, skill.id).object)])
