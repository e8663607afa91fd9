"""Robots that come and go, and skills that clients do, put together for one server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.offer_nodes import OfferNodes
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.registry_methods import RobotRegistryMethods
from ua_fleet.nodes.skill_methods import SkillMethods
from ua_fleet.operation.robots.offers import ClientOffers
from ua_fleet.operation.robots.roster import RobotRegistry
from ua_fleet.operation.runs.service import ScenarioService
from ua_fleet.server.attached import Ground
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.robot_admission import RobotAdmission
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import ResponderJournal
from ua_fleet.values import TICKS_PER_SECOND

__all__ = ["connect_roster", "make_offers"]


def make_offers(hub: Callable[[], Hub], journal: ResponderJournal) -> ClientOffers:
    """What clients do; requests for it go through `SkillRouter`. Raises StorageUnavailable."""
    loop = asyncio.get_running_loop()

    def told(execution_id: bytes, outcome: RequestOutcome) -> None:
        loop.call_soon(hub().concluded, execution_id, outcome)

    return ClientOffers(
        journal,
        show=lambda event: hub().hear(event),
        told=told,
        wall_ticks=wall_ticks,
        log=structlog.get_logger("ua_fleet.server"),
        steady_ticks=lambda: round(loop.time() * TICKS_PER_SECOND),
    )


def connect_roster(
    roster: RobotRegistry,
    offers: ClientOffers,
    server: HardenedServer,
    hub: Callable[[], Hub],
    ground: Ground,
    nodes: FleetNodes,
    projection: Projection,
    skills: SkillMethods,
    scenarios: ScenarioService,
) -> None:
    """Let robots come and go; the server is not started yet.

    Args:
        roster: of the robots that are there.
        offers: skills that clients do.
        server: gets the Methods.
        hub: carries data; it is made later.
        ground: what is known of the fleet.
        nodes: that are there.
        projection: makes the others.
        skills: answers the Methods of skills.
        scenarios: runs that may need a robot.
    """
    parts = NodeFactory(server.iserver.aspace, nodes.ns)
    parts.values = nodes.values
    events = ServerEvents(server.iserver)
    roster.connect(
        RobotAdmission(
            hub,
            ground.state,
            ground.tracker,
            skills,
            projection,
            events,
            offers,
            scenarios.users_of,
            scenarios.told_of,
            ground.subscriber.hears,
            wall_ticks,
        )
    )
    RobotRegistryMethods(server, parts, roster).build()
    offer_nodes = OfferNodes(server, parts, projection, roster, offers, wall_ticks)
    offer_nodes.build()
    offers.changed = offer_nodes.show
    server.context.departed.append(offers.departed)
