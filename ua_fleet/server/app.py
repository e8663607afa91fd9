"""The server as one coroutine: `run_server`."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import structlog

from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.config.security import file_keys_of
from ua_fleet.endpoint.announced import announced_endpoints
from ua_fleet.endpoint.expiry import CertificateWatch
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.standard_nodes import forget_makers
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.change_events import tell_capacities
from ua_fleet.nodes.client_writes import ClientWrites
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.nodeset import load_types
from ua_fleet.nodes.projection import Projection
from ua_fleet.nodes.recent_message_methods import RecentMessageMethods
from ua_fleet.nodes.session_key_methods import SessionKeyMethods
from ua_fleet.nodes.skill_events import tell_transition
from ua_fleet.nodes.skill_methods import SkillMethods
from ua_fleet.nodes.wanted_data import WantedData
from ua_fleet.operation.robots.roster import RobotRegistry
from ua_fleet.operation.runs.activity import RobotActivities
from ua_fleet.operation.skills.router import SkillRouter
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.pubsub.application import bridge_application_uri, server_application_uri
from ua_fleet.pubsub.subscriber import LoopRule
from ua_fleet.server.figures import ServerFigures
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.key_service.local import LocalKeySource
from ua_fleet.server.key_service.nodes import KeyServiceNodes
from ua_fleet.server.key_service.service import KeyService
from ua_fleet.server.robot_setup import add_roster, make_offers
from ua_fleet.server.run_log import RunLog
from ua_fleet.server.scenario_setup import add_scenarios
from ua_fleet.server.skill_ends import SkillEnds
from ua_fleet.server.teleoperation.setup import add_teleoperation
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.topics import SERVER_SPACE, loop_verdict
from ua_fleet.transport.base import Transport
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire.security import SecurityMode

__all__ = ["application_uri", "run_server"]


def application_uri(config: FleetConfig) -> str:
    """The ApplicationUri of a fleet's server; its certificate carries it."""
    return server_application_uri(config.fleet.name)


async def run_server(
    config: FleetConfig,
    config_dir: Path,
    *,
    transport: Transport | None = None,
    ready: Callable[[str], None] | None = None,
    rule: LoopRule = loop_verdict,
    sent: Callable[[bytes, int], None] | None = None,
    monitor: Monitor | None = None,
    once: bool = False,
) -> None:
    """Serve a fleet until cancelled.

    Args:
        config: the checked `fleet.yaml`.
        config_dir: its folder; `server.state_dir` is relative to it.
        transport: in place of the UDP transport that the configuration describes.
        ready: called with the endpoint URL once clients can connect and data is received.
        rule: the loop rule.
        sent: told of each PubSub message that is sent, with its bytes on the wire.
        monitor: tells of the server.
        once: this process makes no other server, so what is needed to make one need not stay in memory.

    Raises:
        ConfigError: a data source has no id, or the key files cannot be used.
        ServerStartError: the port is in use, or something that the server needs is missing.
        StorageUnavailable: a file in which the server records something cannot be used.
        TransportError: PubSub has no route, no permission or no such interface.
    """
    configured = fleet_model(config)
    monitor = monitor or Monitor(ProcessKind.SERVER)
    mistakes = monitor.mistakes
    state_dir = config_dir / config.server.state_dir
    has_key_service = _has_key_service(config.pubsub)
    server = await create_server(
        config.server,
        state_dir,
        application_uri=application_uri(config),
        files_dir=config_dir,
        bridges={bridge_application_uri(config.fleet.name, name): name for name in config.bridges}
        if has_key_service
        else None,
    )
    if once:
        forget_makers()
    stack = ExitStack()
    loop = asyncio.get_running_loop()
    handler_before = loop.get_exception_handler()
    loop.set_exception_handler(mistakes.in_loop)
    try:
        records = stack.enter_context(ServerRecords(state_dir))
        roster = RobotRegistry(config, configured, records.robots, time.time, structlog.get_logger("ua_fleet.server"))
        model = roster.restore()
        await load_types(server, config.fleet.namespace_uri, config.fleet.namespace_index, config.fleet.namespaces)
        nodes = FleetNodes(server.iserver.aspace, model)
        nodes.build()
        SessionKeyMethods(server, NodeFactory(server.iserver.aspace, nodes.ns)).build()
        keys: KeySource | None = None
        if has_key_service:
            service = KeyService(config, state_dir)
            await KeyServiceNodes(server, service, model.ns).build()
            keys = LocalKeySource(service)
        elif config.pubsub.security is not PubSubSecurity.NONE:
            keys = file_keys_of(config, SERVER_SPACE, config_dir)
        events = ServerEvents(server.iserver)
        ends, run_log = SkillEnds(monitor), RunLog()

        async def tell_skill(change: SkillTransitioned) -> None:
            ends.moved(change)
            await tell_transition(events, change)

        projection = Projection(
            nodes,
            tell=tell_skill,
            tell_capacities=lambda change, gained, lost: tell_capacities(events, change, gained, lost, wall_ticks()),
            mistakes=mistakes,
        )
        hub = Hub(
            config,
            model,
            transport or _udp(config.pubsub),
            projection,
            state_dir=state_dir,
            journal=records.requests,
            keys=keys,
            rule=rule,
            sent=sent,
            mistakes=mistakes,
        )
        RecentMessageMethods(
            server,
            NodeFactory(server.iserver.aspace, nodes.ns),
            hub.recent,
            is_encrypted=hub.envelope.mode is SecurityMode.SIGN_AND_ENCRYPT,
        ).build()
        offers = make_offers(hub, records.executions)
        requests = SkillRouter(hub.skills, offers)

        def driven(robot: str, told: str) -> None:
            hub.set_driven(robot, told)
            scenarios.driven(robot, told and f"is {told}")

        teleoperation = add_teleoperation(model, server, hub, projection, driven)
        methods = SkillMethods(
            server,
            requests,
            hub.tracker,
            put=hub.show_skills,
            clock=asyncio.get_running_loop().time,
            wall_ticks=wall_ticks,
            driven_by=teleoperation.driven_by,
        )
        for robot in model.robots:
            methods.add(robot)
        folder = config_dir / config.scenarios.folder
        activities = RobotActivities()
        scenarios = add_scenarios(
            config, model, server, hub, nodes, records.runs, projection, folder, requests, run_log, activities
        )
        add_roster(roster, offers, server, hub, nodes, projection, methods, scenarios, activities)
        wanted = WantedData(
            model.bridges,
            lambda: hub.robots,
            nodes.values,
            scenarios.needed_values,
            publish=hub.publish,
            clock=asyncio.get_running_loop().time,
            wall_ticks=wall_ticks,
        )
        hub.add_wanted(wanted)
        hub.add_clock(CertificateWatch(state_dir, asyncio.get_running_loop().time))
        hub.add_clock(nodes.show_mistakes(mistakes, projection.put, asyncio.get_running_loop().time, wall_ticks))
        server.context.mistakes = mistakes
        server.gate = ClientWrites(hub.commands, nodes, hub.publish, hub.flush_soon, wall_ticks)
        try:
            await hub.start()
            await server.start()
            hub.describe(await announced_endpoints(server))
            ServerFigures(hub, server, scenarios, run_log, ends).tell(monitor)
            if ready is not None:
                ready(server.endpoint.geturl())
            await hub.run()
        finally:
            server.context.departed.clear()  # that clients are gone now says nothing of them
            with mistakes.guard("teleoperation"):
                teleoperation.close()
            await hub.close()
    finally:
        stack.close()
        await server.stop()
        loop.set_exception_handler(handler_before)


def _has_key_service(config: PubSubConfig) -> bool:
    """Whether this server gives keys of message security to the bridges."""
    return config.security is not PubSubSecurity.NONE and config.keys.source == "service"


def _udp(config: PubSubConfig) -> Transport:
    return UdpTransport(config.url, config.interface, ttl=config.ttl, receive_buffer_bytes=config.receive_buffer_bytes)
