"""The transport of a fleet's PubSub, from its `fleet.yaml`: UDP, or an MQTT broker."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from ua_fleet.config.schema import FleetConfig
from ua_fleet.transport.base import Transport
from ua_fleet.transport.mqtt.address import is_broker_url, parse_broker_url

__all__ = ["client_id_of", "open_transport"]


def client_id_of(config: FleetConfig, space: int) -> str:
    """The MQTT ClientID of a process: one for each, so that a broker ends its last connection before it has a new one.

    It is the PublisherId with the fleet's name before it (OPC 10000-14 6.2.7.1).
    """
    return f"ua-fleet-{config.fleet.name}-{space}"


def open_transport(
    config: FleetConfig,
    folder: Path,
    *,
    space: int | None,
    hears_itself: bool = True,
    urgent_heads: Collection[bytes] = (),
    url: str | None = None,
    interface: str | None = None,
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

    Raises:
        TransportError: an address that is none, or a file of the broker's that cannot be used.
    """
    pubsub = config.pubsub
    url = url or pubsub.url
    if is_broker_url(url):
        from ua_fleet.transport.mqtt.credentials import Credentials
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
        return MqttTransport(
            url,
            broker.tree(),
            credentials,
            client_id=None if space is None else client_id_of(config, space),
            qos=broker.delivery.qos,
            keep_alive_s=broker.keep_alive_s,
            receive_timeout_s=pubsub.receive_timeout_s,
            most_waiting_bytes=broker.most_waiting_bytes,
            max_message_bytes=pubsub.max_message_bytes,
            hears_itself=hears_itself,
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
