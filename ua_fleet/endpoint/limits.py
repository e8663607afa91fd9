"""The server's limits in one place: what is enforced is what is advertised."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from asyncua import ua
from asyncua.server.server import Server
from asyncua.ua.object_ids import ObjectIds

from ua_fleet.config.schema import ServerConfig

__all__ = ["CHUNK_BYTES", "EndpointLimits"]

CHUNK_BYTES: Final = 65_536
"""Largest chunk that we take or send, and all that a connection may send before authentication."""
MIN_CHUNK_BYTES: Final = 8_192
"""Smallest buffer that a client may offer (OPC 10000-6 7.1.2.3)."""


@dataclass(frozen=True, slots=True)
class EndpointLimits:
    """What one client, and all of them together, may take."""

    connections: int = 100
    sessions: int = 50
    sessions_per_user: int = 10
    """Active sessions of one user, or of one address where clients have no user."""
    reserved_sessions: int = 10
    """Of `sessions`, those that engineers and bridges alone may take; at most half of them."""
    inactive_sessions: int = 50
    """Sessions of one connection that wait for their activation; the oldest ends for one more."""
    message_bytes: int = 4 * 1024 * 1024
    nodes_per_request: int = 10_000
    subscriptions_per_session: int = 50
    monitored_items_per_subscription: int = 20_000
    calls_per_request: int = 100
    """Methods that one request may call."""
    continuation_points: int = 10
    references_per_node: int = 1_000
    """References in one BrowseResult; the rest waits at a continuation point."""
    browse_path_elements: int = 100
    handshake_s: float = 5.0
    """Time of the client for each step of a connection: Hello and OpenSecureChannel, CreateSession, ActivateSession."""
    own_work_s: float = 30.0
    """Time of the server for a connection that has no user yet: that of the client does not run meanwhile."""
    requests_before_authentication: int = 100
    """Requests of a connection that is not authenticated; discovery and a login take fewer than ten."""
    stalled_s: float = 30.0
    """A client that does not read its responses for so long is cut off."""
    contended_s: float = 10.0
    """As `stalled_s`, where other large requests of the same user wait for the client to read."""
    session_timeout_s: tuple[float, float] = (0.5, 600.0)
    """Between what a session timeout is; a client that asks for 0 gets the longest."""
    channel_lifetime_s: tuple[float, float] = (10.0, 3_600.0)
    method_s: float = 3.0
    """Time for one method call."""
    publishing_interval_ms: tuple[float, float] = (50.0, 60_000.0)
    subscription_lifetime_s: float = 3_600.0
    sampling_interval_s: float = 3_600.0
    """Longest sampling interval of a monitored item."""
    triggering_links: int = 1_000
    """Triggering links of one subscription: each publishing cycle may have to follow all of them."""
    queue_size: int = 100
    """Values that wait for one monitored item."""
    event_queue_size: int = 2_000
    """Likewise events: a thousand robots may fall silent within one publishing interval."""
    queued_bytes_per_user: int = 24 * 1024 * 1024
    """Memory of the values and events that wait for one user in all sessions, or for one address without; then what has
    waited longest gives way."""
    queued_bytes: int = 96 * 1024 * 1024
    """Memory of those of all users; then those of the user for whom most waits."""
    notifications_per_publish: int = 5_000
    notification_bytes: int = 1024 * 1024
    """Bytes after which a notification message is full."""
    retransmissions: int = 50
    """Sent notification messages that a subscription keeps until they are acknowledged."""
    retransmission_bytes: int = 16 * 1024 * 1024
    """Bytes of such messages of one user in all sessions, or of one address without; then the oldest of the greediest
    subscription go."""
    items_per_node_and_user: int = 100
    """Monitored items of one user in all sessions, or of one address where clients have no user, on the same node: each
    write to the node goes to all of them."""
    event_items_per_session: int = 200
    """Monitored items of one session that watch events: each event goes to all of them."""
    filter_elements: int = 200
    """Elements of each clause of an EventFilter: all fields of all events are some 150."""
    filter_steps_per_session: int = 10_000
    """Steps that the filters of a session's event items take for one event, of some microseconds each."""
    tick_s: float = 0.25
    """Period of the check for what is overdue."""

    @property
    def response_bytes(self) -> int:
        """Bytes of the results of one response."""
        return 2 * self.message_bytes

    @property
    def monitored_items_per_user(self) -> int:
        """Monitored items of one user in all sessions, or of one address where clients have no user.

        Each takes 0.8 kB, so that a user takes less than 100 MB with them and with what waits.
        """
        return 3 * self.monitored_items_per_subscription

    @property
    def request_memory_bytes(self) -> int:
        """Memory that a decoded request may take: small values take a multiple of their bytes."""
        return 16 * self.message_bytes

    @classmethod
    def from_config(cls, config: ServerConfig) -> EndpointLimits:
        """The limits that `fleet.yaml` sets."""
        return cls(
            connections=config.max_connections,
            sessions=config.max_sessions,
            sessions_per_user=config.max_sessions_per_user,
            reserved_sessions=config.reserved_sessions,
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
            "OperationLimits_MaxNodesPerMethodCall": (
                min(self.calls_per_request, per_request),
                ua.VariantType.UInt32,
            ),
            "MaxBrowseContinuationPoints": (self.continuation_points, ua.VariantType.UInt16),
            "MaxSessions": (self.sessions, ua.VariantType.UInt32),
            "MaxSubscriptions": (self.sessions * self.subscriptions_per_session, ua.VariantType.UInt32),
            "MaxSubscriptionsPerSession": (self.subscriptions_per_session, ua.VariantType.UInt32),
            "MaxMonitoredItemsPerSubscription": (self.monitored_items_per_subscription, ua.VariantType.UInt32),
            "MaxMonitoredItemsQueueSize": (max(self.queue_size, self.event_queue_size), ua.VariantType.UInt32),
            "MinSupportedSampleRate": (0.0, ua.VariantType.Double),
        }
        for name, (value, variant_type) in values.items():
            identifier = ua.NodeId(getattr(ObjectIds, f"Server_ServerCapabilities_{name}"))
            await server.get_node(identifier).write_value(ua.Variant(value, variant_type))
