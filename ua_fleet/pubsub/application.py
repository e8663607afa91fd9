"""What a process says of itself in discovery, besides its data: who it is, where it listens, how it sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.values import LocalizedText, Variant
from ua_fleet.wire.discovered import NO_SECURITY, ApplicationDescription, ApplicationType, EndpointDescription

__all__ = [
    "MAX_DATAGRAM_BYTES",
    "PRODUCT_URI",
    "UDP_UADP",
    "Application",
    "bridge_application_uri",
    "describe",
    "server_application_uri",
]

MAX_DATAGRAM_BYTES: Final = 65_507
"""The largest UDP payload over IPv4."""
UDP_UADP: Final = "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp"
"""The transport profile of UADP over UDP (OPC 10000-14 7.3.2)."""
PRODUCT_URI: Final = "urn:ua-fleet"


@dataclass(frozen=True, slots=True)
class Application:
    """One process as discovery shows it."""

    description: ApplicationDescription
    capabilities: tuple[str, ...] = ()
    """Capability identifiers of OPC 10000-12 annex D."""
    endpoints: tuple[EndpointDescription, ...] = ()
    """Of its OPC UA Server; a process without a server has none."""
    publisher_id: Variant | None = None
    """Of its messages on the wire, where that is not the UInt16 of its space."""
    url: str = ""
    """Where the messages of its PubSubConnection go."""
    network_interface: str | None = None
    security_mode: int = NO_SECURITY
    """MessageSecurityMode of what it sends."""
    data_group: str | None = None
    """SecurityGroup of its data, where it is secured."""
    command_group: str | None = None
    """SecurityGroup of its Actions, where they are secured."""
    max_message_bytes: int = MAX_DATAGRAM_BYTES
    """The largest message that it sends, put together from chunks where it is larger than a datagram."""


def server_application_uri(fleet_name: str) -> str:
    """The ApplicationUri of a fleet's server; its certificate carries it."""
    return f"{PRODUCT_URI}:{fleet_name}:server"


def bridge_application_uri(fleet_name: str, bridge_name: str) -> str:
    """The ApplicationUri of a bridge; its certificate carries it."""
    return f"{PRODUCT_URI}:{fleet_name}:bridge:{bridge_name}"


def describe(
    application_uri: str, name: str, *, is_server: bool = False, discovery_urls: tuple[str, ...] = ()
) -> ApplicationDescription:
    """The ApplicationDescription of one of our processes. A bridge is a Client: it has no Server."""
    kind = ApplicationType.SERVER if is_server else ApplicationType.CLIENT
    return ApplicationDescription(
        application_uri, PRODUCT_URI, LocalizedText(name), kind.value, discovery_urls=discovery_urls
    )
