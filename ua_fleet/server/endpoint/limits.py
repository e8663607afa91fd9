"""The server's limits in one place: what is enforced is what is advertised."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from asyncua import ua
from asyncua.server.server import Server
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.config.schema import ServerConfig

__all__ = ["CHUNK_BYTES", "Limits"]

CHUNK_BYTES: Final = 65_536
"""Largest chunk that we take or send, and all that a connection may send before authentication."""
MIN_CHUNK_BYTES: Final = 8_192
"""Smallest buffer that a client may offer (OPC 10000-6 7.1.2.3)."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What one client, and all of them together, may take."""

    connections: int = 100
    sessions: int = 50
    message_bytes: int = 4 * 1024 * 1024
    nodes_per_request: int = 10_000
    subscriptions_per_session: int = 50
    monitored_items_per_subscription: int = 20_000
    continuation_points: int = 10
    references_per_node: int = 1_000
    """References in one BrowseResult; the rest waits at a continuation point."""
    browse_path_elements: int = 100
    handshake_s: float = 5.0
    """Time for each step of a connection: Hello and OpenSecureChannel, CreateSession, ActivateSession."""
    requests_before_authentication: int = 100
    """Requests of a connection that is not authenticated; discovery and a login take fewer than ten."""
    stalled_s: float = 30.0
    """A client that does not read its responses for so long is cut off."""
    session_timeout_s: tuple[float, float] = (5.0, 600.0)
    channel_lifetime_s: tuple[float, float] = (10.0, 3_600.0)
    method_s: float = 3.0
    """Time for one method call."""
    publishing_interval_ms: tuple[float, float] = (50.0, 60_000.0)
    subscription_lifetime_s: float = 3_600.0
    queue_size: int = 100
    """Values or events that wait for one monitored item."""
    queued_notifications: int = 100_000
    """Values and events that wait in one subscription; then each item keeps its newest alone."""
    notifications_per_publish: int = 5_000
    retransmissions: int = 50
    """Sent notification messages that a subscription keeps until they are acknowledged."""
    filter_elements: int = 100
    tick_s: float = 0.25
    """Period of the check for what is overdue."""

    @classmethod
    def from_config(cls, config: ServerConfig) -> Limits:
        """The limits that `fleet.yaml` sets."""
        return cls(
            connections=config.max_connections,
            sessions=config.max_sessions,
            message_bytes=config.max_message_bytes,
            nodes_per_request=config.max_nodes_per_request,
            subscriptions_per_session=config.max_subscriptions_per_session,
            monitored_items_per_subscription=config.max_monitored_items_per_subscription,
        )

    async def advertise(self, server: Server) -> None:
        """Write the limits to ServerCapabilities, so that clients see what is enforced."""
        per_request = self.nodes_per_request
        values: dict[str, tuple[int | float, ua.VariantType]] = {
            f"OperationLimits_{name}": (per_request, ua.VariantType.UInt32)
            for name in (
                "MaxNodesPerRead",
                "MaxNodesPerWrite",
                "MaxNodesPerMethodCall",
                "MaxNodesPerBrowse",
                "MaxNodesPerRegisterNodes",
                "MaxNodesPerTranslateBrowsePathsToNodeIds",
                "MaxMonitoredItemsPerCall",
                "MaxNodesPerHistoryReadData",
                "MaxNodesPerHistoryReadEvents",
                # These services are refused whatever the number.
                "MaxNodesPerHistoryUpdateData",
                "MaxNodesPerHistoryUpdateEvents",
                "MaxNodesPerNodeManagement",
            )
        }
        values |= {
            "MaxBrowseContinuationPoints": (self.continuation_points, ua.VariantType.UInt16),
            "MaxSessions": (self.sessions, ua.VariantType.UInt32),
            "MaxSubscriptions": (self.sessions * self.subscriptions_per_session, ua.VariantType.UInt32),
            "MaxSubscriptionsPerSession": (self.subscriptions_per_session, ua.VariantType.UInt32),
            "MaxMonitoredItemsPerSubscription": (self.monitored_items_per_subscription, ua.VariantType.UInt32),
            "MaxMonitoredItemsQueueSize": (self.queue_size, ua.VariantType.UInt32),
            "MinSupportedSampleRate": (0.0, ua.VariantType.Double),
        }
        for name, (value, variant_type) in values.items():
            identifier = ua.NodeId(getattr(ObjectIds, f"Server_ServerCapabilities_{name}"))
            await server.get_node(identifier).write_value(ua.Variant(value, variant_type))
