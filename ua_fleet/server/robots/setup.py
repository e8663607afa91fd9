"""The parts of this package put together for one server."""

from __future__ import annotations

from ua_fleet.server.address_space import FleetNodes
from ua_fleet.server.events import ServerEvents
from ua_fleet.server.hardened import HardenedServer
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.parts import NodeParts
from ua_fleet.server.projection import Projection
from ua_fleet.server.robots.methods import RosterMethods
from ua_fleet.server.robots.roster import Roster
from ua_fleet.server.robots.taking import ServerParts
from ua_fleet.server.scenarios.service import ScenarioService
from ua_fleet.server.skills.methods import SkillMethods

__all__ = ["add_roster"]


def add_roster(
    roster: Roster,
    server: HardenedServer,
    hub: Hub,
    nodes: FleetNodes,
    projection: Projection,
    skills: SkillMethods,
    scenarios: ScenarioService,
) -> None:
    """Let robots come and go; the server is not started yet.

    Args:
        roster: of the robots that are there.
        server: gets the Methods.
        hub: carries data.
        nodes: that are there.
        projection: makes the others.
        skills: answers the Methods of skills.
        scenarios: runs that may need a robot.
    """
    parts = NodeParts(server.iserver.aspace, nodes.ns)
    events = ServerEvents(server.iserver)
    roster.connect(ServerParts(hub, skills, projection, events, scenarios.users_of, wall_ticks))
    RosterMethods(server, parts, roster, projection.settled).build()
    hub.add_roster(roster)
