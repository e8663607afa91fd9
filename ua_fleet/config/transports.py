"""The transport of a fleet's PubSub, from its `fleet.yaml`: UDP, or an MQTT broker."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from ua_fleet.config.connections import action_routes, barred_on, connection_numbers, takes_actions
from ua_fleet.config.nodes import data_topics, stated_metadata
from ua_fleet.config.relays import origins_on, relay_connections
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import envelopes_of, publisher_ids
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.counters import Counters
from ua_fleet.pubsub.security.groups import relay_group
from ua_fleet.transport.base import Transport
from ua_fleet.transport.connections import Connection, Connections
from ua_fleet.transport.mqtt.address import is_broker_url, parse_broker_url

__all__ = ["client_id_of", "connections_of", "open_transport", "open_transports", "relay_transports"]


def client_id_of(config: FleetConfig, space: int | str, number: int = 0) -> str:
    """The MQTT ClientID of a process: one for each, so that a broker ends its last connection before it has a new one.

    It is the PublisherId with the fleet's name before it (OPC 10000-14 6.2.7.1); on a connection behind the first one
    with that one's name, since several may be those to one broker. A relay has its SecurityGroup's name in its place.
    """
    behind = f"-{config.connections[number].name}" if number else ""
    return f"ua-fleet-{config.fleet.name}-{space}{behind}"


def open_transports(
    config: FleetConfig,
    folder: Path,
    *,
    space: int,
    hears_itself: bool = True,
    urgent_heads: Collection[bytes] = (),
) -> list[Transport]:
    """`open_transport` for each connection of a process, in their order."""
    return [
        open_transport(config, folder, space=space, hears_itself=hears_itself, urgent_heads=urgent_heads, number=number)
        for number in connection_numbers(config, space)
    ]


def relay_transports(config: FleetConfig, folder: Path, name: str) -> list[Transport]:
    """The transports of a relay, one for each of its connections; raises as `open_transport`."""
    return [
        open_transport(config, folder, space=None, as_client=relay_group(name), hears_itself=False, number=number)
        for number in relay_connections(config, name)
    ]


def connections_of(
    config: FleetConfig, space: int, counters: Counters, state_dir: Path, transports: Transport | Sequence[Transport]
) -> Connections:
    """The connections of a process over these transports, of which there is one for each; a single one stands alone.

    Raises:
        ConfigError: what stands in the folder of the process cannot be used.
    """
    given = list(transports) if isinstance(transports, Sequence) else [transports]
    numbers = connection_numbers(config, space)
    return Connections(
        [
            Connection(
                config.connections[number].name or str(number),
                transport,
                envelope,
                takes_actions(config, space, number),
                barred_on(config, number),
                origins_on(config, number),
            )
            for number, transport, envelope in zip(
                numbers, given, envelopes_of(config, space, counters, state_dir), strict=True
            )
        ],
        action_routes(config, space),
        setpoint_groups(config),
    )


def open_transport(
    config: FleetConfig,
    folder: Path,
    *,
    space: int | None,
    hears_itself: bool = True,
    urgent_heads: Collection[bytes] = (),
    url: str | None = None,
    interface: str | None = None,
    number: int = 0,
    as_client: str | None = None,
) -> Transport:
    """The transport of a process, not started.

    Args:
        config: the fleet.
        folder: of `fleet.yaml`, to which its files are relative.
        space: the PublisherId of the process; None for a tool.
        hears_itself: whether what it sends to a group comes back to it.
        urgent_heads: how datagrams begin that are handed on first.
        url: another address than that of the file.
        interface: another interface than that of the file.
        number: of the connection.
        as_client: ends the MQTT ClientID of a process without a PublisherId; a tool has a random one.

    Raises:
        TransportError: an address that is none, or a file of the broker's that cannot be used.
    """
    pubsub = config.connections[number]
    url = url or pubsub.url
    if is_broker_url(url):
        from ua_fleet.transport.mqtt.credentials import Credentials
        from ua_fleet.transport.mqtt.json import JsonSettings
        from ua_fleet.transport.mqtt.transport import MqttTransport

        broker = pubsub.broker
        credentials = Credentials.read(
            folder,
            user=broker.user,
            password_file=broker.password_file,
            ca_file=broker.ca_file,
            certificate_file=broker.certificate_file,
            key_file=broker.key_file,
            has_tls=parse_broker_url(url).has_tls,
        )
        json = None
        if pubsub.is_json:
            json = JsonSettings(
                form=pubsub.json_form.form,
                has_actions=pubsub.actions,
                described=data_topics(config),
                stated=stated_metadata(config),
            )
        return MqttTransport(
            url,
            broker.tree(
                is_json=pubsub.is_json,
                has_actions=pubsub.actions or not pubsub.is_json,
                publisher_ids=None if pubsub.is_json else publisher_ids(config),
            ),
            credentials,
            more_urls=broker.nodes if url == pubsub.url else (),
            client_id=None if (client := as_client or space) is None else client_id_of(config, client, number),
            qos=broker.delivery.qos,
            keep_alive_s=broker.keep_alive_s,
            answer_timeout_s=broker.answer_timeout_s,
            receive_timeout_s=pubsub.receive_timeout_s,
            most_waiting_s=broker.most_waiting_s,
            most_waiting_bytes=broker.most_waiting_bytes,
            max_message_bytes=pubsub.max_message_bytes,
            hears_itself=hears_itself,
            json=json,
        )
    from ua_fleet.transport.udp import UdpTransport

    return UdpTransport(
        url,
        interface or pubsub.interface,
        ttl=pubsub.ttl,
        receive_buffer_bytes=pubsub.receive_buffer_bytes,
        hears_itself=hears_itself,
        urgent_heads=urgent_heads,
    )
