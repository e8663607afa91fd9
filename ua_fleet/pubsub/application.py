"""What a process says of itself in discovery, besides its data: who it is, where it listens, how it sends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.values import LocalizedText, Variant
from ua_fleet.wire.discovered import NO_SECURITY, ApplicationDescription, ApplicationType, EndpointDescription
from ua_fleet.wire.json import Form

__all__ = [
    "MAX_DATAGRAM_BYTES",
    "MQTT_JSON",
    "MQTT_UADP",
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
MQTT_UADP: Final = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-uadp"
"""The transport profile of UADP over MQTT (OPC 10000-14 7.3.4)."""
MQTT_JSON: Final = "http://opcfoundation.org/UA-Profile/Transport/pubsub-mqtt-json"
"""The transport profile of JSON over MQTT."""
PRODUCT_URI: Final = "urn:ua-fleet"


@dataclass(frozen=True, slots=True)
class Application:
    """One process as discovery shows it."""

    description: ApplicationDescription
    capabilities: tuple[str, ...] = ()
    """Capability identifiers of OPC 10000-12 annex D."""
    endpoints: tuple[EndpointDescription, ...] = ()
    """Of its OPC UA Server; a process without a server has none."""
    is_brokered: bool = False
    """Whether it speaks over a broker, which keeps announcements and says when the process is gone."""
    is_also_grouped: bool = False
    """Whether it speaks to a multicast group besides, which keeps nothing: it has several connections."""
    json_form: Form | None = None
    """How it writes fields, where it speaks JSON; None where it speaks UADP."""
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
    connection_name: str = ""
    """Of its PubSubConnection, where it has several."""
    takes_actions: bool = True
    """Whether Actions go by this PubSubConnection."""
    further: tuple[Application, ...] = ()
    """The same process as its further PubSubConnections show it. What holds for all of them stands here."""

    @property
    def connections(self) -> tuple[Application, ...]:
        """The process as each of its PubSubConnections shows it."""
        return (self, *self.further)

    @property
    def is_grouped(self) -> bool:
        """Whether it speaks to a multicast group, beside a broker or alone."""
        return self.is_also_grouped or not self.is_brokered

    @property
    def url_is_brokers(self) -> bool:
        """Whether the connection that `url` is about is that to a broker."""
        return self.is_brokered and not self.url.startswith("opc.udp://")

    @property
    def profile(self) -> str:
        """The URI of its transport profile."""
        if self.json_form is not None:
            return MQTT_JSON
        return MQTT_UADP if self.url_is_brokers else UDP_UADP


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
