"""The information model of PubSub, put together for one server."""

from __future__ import annotations

import asyncio
import ipaddress
from collections.abc import Callable, Sequence
from typing import Any
from urllib.parse import urlsplit

from ua_fleet.config.connections import connection_numbers
from ua_fleet.config.nodes import writer_settings
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.endpoint.hardened_server import HardenedServer
from ua_fleet.operation.pubsub.connections import ServerFacts
from ua_fleet.operation.pubsub.description import Shown
from ua_fleet.pubsub.events import SubscriberEvent
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.server.attached import Ground
from ua_fleet.server.bridge_switches import BridgeSwitchRequests
from ua_fleet.server.ground import PubSubEnds
from ua_fleet.server.hub import Hub, wall_ticks
from ua_fleet.server.pubsub_model import PubSubModel
from ua_fleet.server.timer import Timer
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant
from ua_fleet.wire.security import SecurityMode

__all__ = ["make_pubsub_model"]


def make_pubsub_model(
    config: FleetConfig,
    server: HardenedServer,
    ns: int,
    ground: Ground,
    ends: PubSubEnds,
    timer: Timer,
    hub: Callable[[], Hub],
) -> PubSubModel:
    """Show PubSub; the server is not started yet.

    Args:
        config: of the fleet.
        server: gets the nodes and the Methods.
        ns: the fleet's namespace.
        ground: what is shown.
        ends: how messages are secured and sent.
        timer: is to call what is due.
        hub: of the server, once it is made.
    """
    connections, ids = ends.connections, publisher_ids(config)
    mode = min(connection.envelope.mode for connection in connections.all)
    bridges = {name: bridge.space for name, bridge in config.bridges.items()}
    clock = asyncio.get_running_loop().time

    def publisher_id(space: int) -> Variant:
        return Variant(int(BuiltinType.UINT16), space) if ids is None else ids.variant(space)

    def address(space: int, number: int) -> Any:
        return _resolved(config.connections[connection_numbers(config, space)[number]].url)

    facts = ServerFacts(
        publisher=ground.publisher,
        subscriber=ground.subscriber,
        sources=lambda: ground.state.all_sources,
        source=ground.state.source,
        publishers={space: name for name, space in bridges.items()},
        publisher_id=publisher_id,
        settings=writer_settings(config),
        receive_timeout_s=config.pubsub.timing().receive_timeout_s,
        security_mode=mode.value,
        security_group=lambda space: None if mode is SecurityMode.NONE else telemetry_group(space),
        failed=ends.sender.failed,
        not_secured=ends.sender.not_secured,
        problems=lambda: connections.problems,
        address=address,
    )
    requests = BridgeSwitchRequests(
        bridges,
        ns,
        send=ground.send,
        want=ground.subscriber.want_action,
        sooner=timer.sooner,
        must_be_verified=connections.must_be_verified,
        clock=clock,
        wall_ticks=wall_ticks,
    )

    def hear(events: Sequence[SubscriberEvent]) -> None:
        hub().hear_all(events)

    return PubSubModel(
        server,
        ns,
        facts,
        bridges,
        further={
            name: [config.connections[number].name or "" for number in connection_numbers(config, space)[1:]]
            for name, space in {"": SERVER_SPACE, **bridges}.items()
        },
        status_topics={
            name: Topic(bridge.space, config.fleet.namespace_index, bridge.status_id)
            for name, bridge in config.bridges.items()
            if bridge.status_id is not None
        },
        requests=requests,
        is_heard=lambda name: ground.state.bridges_heard.get(name, False),
        hear=hear,
        send=ground.send,
        clock=clock,
        wall_ticks=wall_ticks,
    )


def _resolved(url: str) -> Any:
    """The IP address of a URL; a name is resolved by the transport, which does not say to what."""
    host = urlsplit(url).hostname or ""
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return Shown(None, int(StatusCode.BAD_NOT_SUPPORTED))
