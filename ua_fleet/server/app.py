"""The server as one coroutine: `run_server`."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from pathlib import Path

import structlog

from ua_fleet.config.connections import needs_keys
from ua_fleet.config.history import HistoryRules
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import file_keys_of
from ua_fleet.config.transports import open_transports
from ua_fleet.endpoint.announced import announced_endpoints
from ua_fleet.endpoint.hardened_server import HardenedServer, create_server
from ua_fleet.endpoint.kept_events import EventKeeper
from ua_fleet.endpoint.standard_nodes import forget_makers
from ua_fleet.fleet.model import FleetModel
from ua_fleet.keys.source import KeySource
from ua_fleet.monitoring import Mistakes, Monitor, ProcessKind
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.node_factory import NodeFactory
from ua_fleet.nodes.nodeset import load_types
from ua_fleet.nodes.session_key_methods import SessionKeyMethods
from ua_fleet.operation.robots.roster import RobotRegistry
from ua_fleet.pubsub.application import bridge_application_uri, server_application_uri
from ua_fleet.pubsub.subscriber import LoopRule
from ua_fleet.server.assembly import Assembly, Given
from ua_fleet.server.history import HistoryService, open_history
from ua_fleet.server.key_service.local import LocalKeySource
from ua_fleet.server.key_service.nodes import KeyServiceNodes
from ua_fleet.server.key_service.service import KeyService
from ua_fleet.storage.control import state_control
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.topics import SERVER_SPACE, loop_verdict
from ua_fleet.transport.base import Transport

__all__ = ["application_uri", "run_server"]


def application_uri(config: FleetConfig) -> str:
    """The ApplicationUri of a fleet's server; its certificate carries it."""
    return server_application_uri(config.fleet.name)


async def run_server(
    config: FleetConfig,
    config_dir: Path,
    *,
    transport: Transport | Sequence[Transport] | None = None,
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
        transport: in place of those that the configuration describes, of several connections one for each.
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
    configured = fleet_model(config)  # before anything is made: it may be wrong
    monitor = monitor or Monitor(ProcessKind.SERVER)
    mistakes = monitor.mistakes
    state_dir = config_dir / config.server.state_dir
    server = await create_server(
        config.server,
        state_dir,
        application_uri=application_uri(config),
        files_dir=config_dir,
        bridges={bridge_application_uri(config.fleet.name, name): name for name in (*config.bridges, *config.relays)}
        if _has_key_service(config)
        else None,
        pushed_keys=_has_key_service(config) and config.pubsub.keys.pushed_by is not None,
    )
    if once:
        forget_makers()
    loop = asyncio.get_running_loop()
    handler_before = loop.get_exception_handler()
    loop.set_exception_handler(mistakes.in_loop)
    try:
        with ServerRecords(state_dir) as records:
            async with _history(config, config_dir, mistakes) as history:
                given = await _given(config, configured, config_dir, server, monitor, records, history)
                transport = transport or open_transports(config, config_dir, space=SERVER_SPACE)
                assembly = Assembly(given, transport, rule, sent)
                threads = [] if history is None else [history.in_thread]
                async with state_control(state_dir, "server", threads):
                    await _serve(server, assembly, mistakes, ready)
    finally:
        await server.stop()
        loop.set_exception_handler(handler_before)


@contextlib.asynccontextmanager
async def _history(config: FleetConfig, config_dir: Path, mistakes: Mistakes) -> AsyncGenerator[HistoryService | None]:
    """The history of the fleet's values, where one is kept; raises StorageUnavailable."""
    if config.history is None:
        yield None
        return
    history = await open_history(
        config.history, HistoryRules(config), config_dir, config_dir / config.server.state_dir, mistakes
    )
    try:
        yield history
    finally:
        await history.close()


async def _given(
    config: FleetConfig,
    configured: FleetModel,
    config_dir: Path,
    server: HardenedServer,
    monitor: Monitor,
    records: ServerRecords,
    history: HistoryService | None,
) -> Given:
    """Make the nodes of the fleet, with the robots that are recorded; raises as `run_server` does."""
    roster = RobotRegistry(config, configured, records.robots, time.time, structlog.get_logger("ua_fleet.server"))
    model = roster.restore()
    await load_types(server, config.fleet.namespace_uri, config.fleet.namespace_index, config.fleet.namespaces)
    server.context.history = history
    if history is not None and (events := history.rules.events) is not None:
        server.keep_events(EventKeeper(history.record_event, server.context.misfit, audit=events.audit))
    nodes = FleetNodes(server.iserver.aspace, model, None if history is None else history.rules)
    nodes.build()
    SessionKeyMethods(server, NodeFactory(server.iserver.aspace, nodes.ns)).build()
    keys: KeySource | None = None
    if _has_key_service(config):
        service = KeyService(config, config_dir / config.server.state_dir)
        await KeyServiceNodes(server, service, model.ns).build()
        keys = LocalKeySource(service)
    elif needs_keys(config, SERVER_SPACE):
        keys = file_keys_of(config, SERVER_SPACE, config_dir)
    return Given(config, config_dir, model, server, nodes, roster, records, monitor, keys, history)


async def _serve(
    server: HardenedServer, assembly: Assembly, mistakes: Mistakes, ready: Callable[[str], None] | None
) -> None:
    """Serve until cancelled."""
    hub = assembly.hub
    try:
        await hub.start()
        if assembly.namespace is not None:
            await assembly.namespace.start()
        await server.start()
        hub.describe(await announced_endpoints(server))
        assembly.tell_monitor()
        if ready is not None:
            ready(server.endpoint.geturl())
        await hub.run()
    finally:
        server.context.departed.clear()  # that clients are gone now says nothing of them
        with mistakes.guard("teleoperation"):
            assembly.teleoperation.close()
        with mistakes.guard("Unified Namespace"):
            if assembly.namespace is not None:
                await assembly.namespace.close()
        await hub.close()


def _has_key_service(config: FleetConfig) -> bool:
    """Whether this server gives keys of message security to the bridges."""
    return config.is_secured and config.pubsub.keys.from_server
