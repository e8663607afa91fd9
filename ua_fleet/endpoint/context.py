"""What all connections of one server share."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyFactory
from asyncua.server.internal_server import InternalServer

from ua_fleet.endpoint.audit import AuditLog
from ua_fleet.endpoint.bridge_trust import BridgeTrust
from ua_fleet.endpoint.charges import Charges
from ua_fleet.endpoint.gateway_logins import GatewayLogins
from ua_fleet.endpoint.history_source import HistorySource
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.session_keys import SessionKeys
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.endpoint.throttle import LoginThrottle
from ua_fleet.endpoint.trust import TrustList
from ua_fleet.endpoint.turns import Places
from ua_fleet.endpoint.users import Role, User, UserStore
from ua_fleet.monitoring.mistakes import Mistakes

__all__ = ["EndpointContext", "NodeGate", "Statistics"]


class NodeGate(Protocol):
    """The model behind the nodes, which has the last word on what clients write."""

    def check_write(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> int:
        """StatusCode of a write before it happens; 0 lets it go on."""
        ...

    def written(self, node_id: ua.NodeId, value: ua.DataValue, user: User) -> None:
        """A client's write has been done; the node has this value."""
        ...

    def request_done(self) -> None:
        """All writes of a request have been done, of which there may have been none."""
        ...


@dataclass(slots=True)
class Statistics:
    """Counters of the endpoint since its start."""

    connections: int = 0
    connections_refused: int = 0
    connections_evicted: int = 0
    """Unauthenticated connections closed to make room for newer ones."""
    strangers_refused: int = 0
    """Connections without a user that were closed because their address had cost too much computing time."""
    handshake_timeouts: int = 0
    frames_refused: int = 0
    certificates_rejected: int = 0
    sessions: int = 0
    sessions_refused: int = 0
    """Sessions for which there was no place."""
    sessions_rejected: int = 0
    """CreateSession and ActivateSession requests that were refused, for whatever reason."""
    sessions_rejected_by_security: int = 0
    """Those of them that did not prove who asks."""
    session_timeouts: int = 0
    session_aborts: int = 0
    """Sessions that ended since their connection was lost: at once, or to make room for newer ones."""
    sessions_evicted: int = 0
    """Detached sessions with subscriptions that ended to make room for newer ones."""
    logins: int = 0
    requests: int = 0
    requests_refused: int = 0
    requests_refused_by_security: int = 0
    """Those of them that were refused to who asked."""
    subscriptions: int = 0
    writes: int = 0
    calls: int = 0
    answered: Callable[[str, float], None] = lambda service, seconds: None
    """Told of each request that was answered at once: the service, and how long it took."""


@dataclass
class EndpointContext:
    """What all connections of one server share."""

    iserver: InternalServer
    limits: EndpointLimits
    trust: TrustList
    users: UserStore
    session_keys: SessionKeys
    audit: AuditLog
    private_key: Any
    allow_none_security: bool
    allow_anonymous: bool
    policies: Sequence[SecurityPolicyFactory] = ()
    server_id: str = ""
    """The server's ApplicationUri."""
    gate: NodeGate | None = None
    history: HistorySource | None = None
    """Without it no node has a history."""
    throttle: LoginThrottle = field(default_factory=LoginThrottle)
    gateway_logins: GatewayLogins = field(default_factory=GatewayLogins)
    charges: Charges = field(default_factory=Charges)
    statistics: Statistics = field(default_factory=Statistics)
    bridges: BridgeTrust | None = None
    """Without it nobody logs in by a certificate."""
    places: Places = field(default_factory=Places)
    """Of the large requests of each user."""
    method_rules: dict[ua.NodeId, Callable[[User], bool]] = field(
        default_factory=dict[ua.NodeId, Callable[[User], bool]]
    )
    """Who may call a method, where that is not an operator."""
    departed: list[Callable[[str], None]] = field(default_factory=list[Callable[[str], None]])
    """Called with the key of a session when it ends, and when its connection is lost."""
    mistakes: Mistakes = field(default_factory=Mistakes)
    """What has cost a request, an item or a subscription."""
    housekeeping: list[Callable[[], Awaitable[None]]] = field(default_factory=list[Callable[[], Awaitable[None]]])
    """Called four times a second."""
    encrypted_methods: set[ua.NodeId] = field(default_factory=set[ua.NodeId])
    """Methods that may be called over an encrypted channel alone."""
    waiting_methods: set[ua.NodeId] = field(default_factory=set[ua.NodeId])
    """Methods that wait for others; what their session asks for meanwhile is served."""
    frequent_methods: set[ua.NodeId] = field(default_factory=set[ua.NodeId])
    """Methods that are called so often that neither log nor event tells of each call; but of who may not."""
    secret_methods: set[ua.NodeId] = field(default_factory=set[ua.NodeId])
    """Methods whose outputs no audit event shows."""
    secret_inputs: frozenset[ua.NodeId] = frozenset(
        (ns0(ObjectIds.PublishSubscribe_SetSecurityKeys), ns0(ObjectIds.PublishSubscribeType_SetSecurityKeys))
    )
    """Methods whose arguments are neither logged nor shown in an audit event, also where this server has none of them:
    a client that takes it for another server shows keys all the same."""

    def may_call(self, user: User, method_id: ua.NodeId) -> bool:
        """Whether a user may call a method at all."""
        rule = self.method_rules.get(method_id)
        return user.role.covers(Role.OPERATOR) if rule is None else rule(user)

    def misfit(self, what: str, error: Exception) -> None:
        """Something of this server cannot be encoded; clients get Bad_EncodingError for it."""
        self.mistakes.caught("encoding", error, node=what)
