"""The server's diagnostics (OPC 10000-5 6.3.3 to 6.3.6): what its sessions and subscriptions do, as Variables.

ServerDiagnostics
  ServerDiagnosticsSummary             counters of all, for everybody
  SubscriptionDiagnosticsArray         for engineers
    <subscription>                     for engineers and for its own user
  SessionsDiagnosticsSummary
    SessionDiagnosticsArray            for engineers
    SessionSecurityDiagnosticsArray    for engineers with a name, on an encrypted channel
    <session>                          its own diagnostics, for engineers and for its own user

Values are computed when they are read; who watches one is told of its changes four times a second.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.ua import ua_binary

from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.diagnostic_nodes import SERVER_NAMESPACE, DiagnosticNodes
from ua_fleet.endpoint.live import Guard, LiveValue
from ua_fleet.endpoint.node_builder import HAS_COMPONENT
from ua_fleet.endpoint.sessions import Session, Sessions
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, StatusCodes, ns0
from ua_fleet.endpoint.subscriptions import ClientSubscription, SubscriptionRegistry
from ua_fleet.endpoint.users import Role, User
from ua_fleet.values import QualifiedName

__all__ = ["Diagnostics"]

_ROOT: Final = "Server_ServerDiagnostics_"
_SUMMARY: Final = f"{_ROOT}ServerDiagnosticsSummary"
_SESSIONS: Final = f"{_ROOT}SessionsDiagnosticsSummary"
_SUBSCRIPTIONS: Final = int(getattr(ObjectIds, f"{_ROOT}SubscriptionDiagnosticsArray"))
_OWN: Final = "SubscriptionDiagnostics"
_CACHED_S: Final = 0.25
"""Arrays of all sessions or subscriptions are made anew after so long, or when there is another one; so is what one
subscription tells."""
_ENCODING_DEFAULT_BINARY: Final = "Request_Encoding_DefaultBinary"
_COUNTED: Final = {
    int(getattr(ObjectIds, f"{name.removesuffix('Count')}{_ENCODING_DEFAULT_BINARY}")): name
    for name in ua.SessionDiagnosticsDataType.__dataclass_fields__
    if hasattr(ObjectIds, f"{name.removesuffix('Count')}{_ENCODING_DEFAULT_BINARY}")
}
"""The field that counts a service, by the identifier of its request's encoding."""


def _engineers(user: User, _encrypted: bool) -> int:
    return 0 if user.role.covers(Role.ENGINEER) else int(StatusCodes.BadUserAccessDenied)


def _security(user: User, encrypted: bool) -> int:
    if not encrypted:
        return int(StatusCodes.BadSecurityModeInsufficient)
    return int(StatusCodes.BadUserAccessDenied) if user.anonymous else _engineers(user, encrypted)


class _Kept:
    """What need not be made anew for each read."""

    def __init__(self, make: Callable[[], Any], version: Callable[[], Any]) -> None:
        self._make, self._version = make, version
        self._kept: tuple[float, Any, Any] = (-1.0, None, None)

    def __call__(self) -> Any:
        made_at, version, values = self._kept
        now, wanted = time.monotonic(), self._version()
        if version != wanted or now - made_at > _CACHED_S:
            values = self._make()
            self._kept = now, wanted, values
        return values


class Diagnostics:
    """The nodes below ServerDiagnostics, with what they tell."""

    def __init__(
        self, space: AddressSpace, context: EndpointContext, sessions: Sessions, subscriptions: SubscriptionRegistry
    ) -> None:
        self._space, self._context = space, context
        self._sessions, self._subscriptions = sessions, subscriptions
        self._nodes = DiagnosticNodes(space)
        self._waiting: dict[str, Session] = {}
        """Sessions whose nodes nobody has wanted yet: most end before that."""
        self._made = set[str]()
        self._is_making = False
        """Whether nodes of a session are being made, which asks for the references of what is above them."""

    def build(self) -> None:
        """Give the standard's nodes their values."""
        structure = ua.VariantType.ExtensionObject
        self._set(f"{_ROOT}EnabledFlag", lambda: True, ua.VariantType.Boolean)
        self._set(_SUMMARY, self._summary, structure)
        for name in ua.ServerDiagnosticsSummaryDataType.__dataclass_fields__:
            self._set(f"{_SUMMARY}_{name}", partial(self._of_summary, name), ua.VariantType.UInt32)
        everything, members = _Kept(self._all_subscriptions, self._subscription_ids), self._session_ids
        self._set(f"{_ROOT}SubscriptionDiagnosticsArray", everything, structure, _engineers)
        for name, make, guard in (
            ("SessionDiagnosticsArray", _session_diagnostics, _engineers),
            ("SessionSecurityDiagnosticsArray", _encoded_security, _security),
        ):
            self._set(f"{_SESSIONS}_{name}", _Kept(partial(self._each, make), members), structure, guard)
        above = [_SESSIONS, f"{_SESSIONS}_SessionDiagnosticsArray", f"{_SESSIONS}_SessionSecurityDiagnosticsArray"]
        parents = [ns0(getattr(ObjectIds, name)) for name in above]
        self._nodes.builder.make_when_wanted(parents, self._make_all, self._make_one)

    def _set(self, name: str, compute: Callable[[], Any], variant_type: Any, guard: Guard | None = None) -> None:
        node_id = ns0(getattr(ObjectIds, name))
        live = LiveValue(compute, variant_type, guard)
        attributes: Any = self._space[node_id].attributes
        attributes[AttributeIds.Value] = live
        self._nodes.hold("", live)

    async def tell(self) -> None:
        """Tell who watches of changes."""
        for live in self._nodes.watched():
            await live.tell()

    def _summary(self) -> Any:
        statistics = self._context.statistics
        subscriptions = self._current()
        return ua.ServerDiagnosticsSummaryDataType(  # pyright: ignore[reportCallIssue]
            ServerViewCount=0,
            CurrentSessionCount=len(self._sessions),
            CumulatedSessionCount=statistics.sessions,
            SecurityRejectedSessionCount=statistics.sessions_rejected_by_security,
            RejectedSessionCount=statistics.sessions_rejected,
            SessionTimeoutCount=statistics.session_timeouts,
            SessionAbortCount=statistics.session_aborts,
            CurrentSubscriptionCount=len(subscriptions),
            CumulatedSubscriptionCount=statistics.subscriptions,
            PublishingIntervalCount=len({subscription.interval_s for subscription in subscriptions}),
            SecurityRejectedRequestsCount=statistics.requests_refused_by_security,
            RejectedRequestsCount=statistics.requests_refused,
        )

    def _of_summary(self, name: str) -> int:
        return int(getattr(self._summary(), name))

    def _current(self) -> list[ClientSubscription]:
        everything: list[Any] = list(self._subscriptions.subscriptions.values())
        return [each for each in everything if isinstance(each, ClientSubscription)]

    def _subscription_ids(self) -> Any:
        return tuple(self._subscriptions.subscriptions)

    def _session_ids(self) -> Any:
        return tuple(session.key for session in self._sessions if session.active)

    def _all_subscriptions(self) -> list[Any]:
        return [_subscription_diagnostics(subscription) for subscription in self._current()]

    def _each(self, make: Callable[[Session], Any]) -> list[Any]:
        return [make(session) for session in self._sessions if session.active]

    def add(self, session: Session) -> None:
        """A session is active now: its nodes are made when somebody wants them. Those that it has are left alone."""
        if session.key not in self._made:
            self._waiting[session.key] = session

    def _make_all(self) -> None:
        """Make the nodes of all sessions that wait for that; who is making one makes the next one when it is done."""
        while self._waiting and not self._is_making:
            self._make(self._waiting.popitem()[1])

    def _make_one(self, node_id: ua.NodeId) -> None:
        """Make the nodes of the session that one of them is of."""
        if node_id.NamespaceIndex == SERVER_NAMESPACE and self._waiting:
            session = self._waiting.pop(str(node_id.Identifier).partition(".")[0], None)
            if session is not None:
                self._make(session)

    def _make(self, session: Session) -> None:
        self._made.add(session.key)
        was_making, self._is_making = self._is_making, True
        try:
            with self._context.mistakes.guard("diagnostics"):
                self._build_session(session)
        finally:
            self._is_making = was_making

    def _build_session(self, session: Session) -> None:
        def own(user: User, encrypted: bool) -> int:
            is_own = session.user is not None and user.name == session.user.name and not user.anonymous
            return 0 if is_own else _engineers(user, encrypted)

        name = QualifiedName(SERVER_NAMESPACE, session.usage.name or session.key)
        self._nodes.builder.add_object(
            session.session_id, name, ns0(getattr(ObjectIds, _SESSIONS)), ns0(ObjectIds.SessionDiagnosticsObjectType)
        )
        self._structure(
            session, "SessionDiagnostics", ObjectIds.SessionDiagnosticsVariableType, _session_diagnostics, own
        )
        self._structure(
            session,
            "SessionSecurityDiagnostics",
            ObjectIds.SessionSecurityDiagnosticsType,
            _security_diagnostics,
            _security,
            _encoded,
        )
        # Its disabled items are counted, of which a user may have many thousands.
        own_subscriptions = _Kept(
            lambda: [_subscription_diagnostics(each) for each in list(session.subscriptions.values())],
            lambda: tuple(session.subscriptions),
        )
        array = "SubscriptionDiagnosticsArray"
        self._nodes.add_variable(
            session.key,
            array,
            QualifiedName(0, array),
            session.session_id,
            ObjectIds.SubscriptionDiagnosticsArrayType,
            (ns0(ObjectIds.SubscriptionDiagnosticsDataType), 1),
            LiveValue(own_subscriptions, ua.VariantType.ExtensionObject, own),
        )

    async def remove(self, session: Session) -> None:
        """Remove the nodes of a session that has ended, as far as they are made."""
        self._waiting.pop(session.key, None)
        if session.key in self._made:
            self._made.remove(session.key)
            self._nodes.remove(session.key, session.session_id)

    def _structure(
        self,
        session: Session,
        name: str,
        type_id: int,
        make: Callable[[Session], Any],
        guard: Guard,
        encoded: Callable[[Any], Any] = lambda made: made,
    ) -> None:
        """A Variable of a structure, also below the array of all."""
        made, browse_name = partial(make, session), QualifiedName(0, name)
        node_id = self._nodes.add_structure(
            session.key, name, browse_name, session.session_id, type_id, made, guard, encoded
        )
        array = ns0(getattr(ObjectIds, f"{_SESSIONS}_{name}Array"))
        self._nodes.builder.add_reference(array, HAS_COMPONENT, node_id)
        self._nodes.add_fields(session.key, name, node_id, type_id, made, guard)

    def add_subscription(self, subscription: ClientSubscription) -> None:
        """Make the node of a new subscription, below the array of all."""

        def own(user: User, encrypted: bool) -> int:
            is_own = user.name == subscription.owner.name and not user.anonymous
            return 0 if is_own else _engineers(user, encrypted)

        key, name = _key_of(subscription), QualifiedName(SERVER_NAMESPACE, str(subscription.id))
        # Its disabled items are counted, and each of its 31 fields may be read ten thousand times in a request.
        make = _Kept(lambda: _subscription_diagnostics(subscription), lambda: subscription.usage.modified)
        type_id = ObjectIds.SubscriptionDiagnosticsType
        node_id = self._nodes.add_structure(key, _OWN, name, ns0(_SUBSCRIPTIONS), type_id, make, own)
        self._nodes.add_fields(key, _OWN, node_id, type_id, make, own)

    async def remove_subscription(self, subscription: ClientSubscription) -> None:
        """Remove the node of a subscription that has ended."""
        key = _key_of(subscription)
        self._nodes.remove(key, raw_id(f"{key}.{_OWN}", SERVER_NAMESPACE))


def _key_of(subscription: ClientSubscription) -> str:
    return f"Subscription{subscription.id}"


def _session_diagnostics(session: Session) -> Any:
    usage, subscriptions = session.usage, list(session.subscriptions.values())
    client: Any = ua.ApplicationDescription()
    client.ApplicationUri, client.ProductUri = session.application, usage.product_uri
    client.ApplicationName = ua.LocalizedText(usage.application_name)
    client.ApplicationType = ua.ApplicationType(usage.application_type)
    told: Any = ua.SessionDiagnosticsDataType()
    told.SessionId, told.SessionName, told.ClientDescription = session.session_id, usage.name, client
    told.ServerUri, told.EndpointUrl, told.LocaleIds = usage.server_uri, usage.endpoint_url, list(usage.locales)
    told.ActualSessionTimeout = session.timeout_s * 1000
    told.MaxResponseMessageSize = session.most_response_bytes
    told.ClientConnectionTime, told.ClientLastContactTime = usage.connected_at, usage.last_contact
    told.CurrentSubscriptionsCount = len(subscriptions)
    told.CurrentMonitoredItemsCount = sum(len(subscription.items) for subscription in subscriptions)
    told.CurrentPublishRequestsInQueue = len(session.requests)
    told.TotalRequestCount = ua.ServiceCounterDataType(usage.requests, usage.refused)  # pyright: ignore[reportArgumentType]
    told.UnauthorizedRequestCount = usage.unauthorized
    for kind, (total, errors) in usage.services.items():
        if (name := _COUNTED.get(kind)) is not None:
            setattr(told, name, ua.ServiceCounterDataType(total, errors))  # pyright: ignore[reportArgumentType]
    return told


@dataclass(frozen=True, slots=True)
class _Security:
    """A SessionSecurityDiagnosticsDataType; asyncua's class takes its field Encoding for something of the codec's."""

    SessionId: ua.NodeId
    ClientUserIdOfSession: str
    ClientUserIdHistory: list[str]
    AuthenticationMechanism: str
    Encoding: str
    TransportProtocol: str
    SecurityMode: int
    SecurityPolicyUri: str
    ClientCertificate: bytes


def _security_diagnostics(session: Session) -> _Security:
    usage, user = session.usage, session.user
    name = user.name if user is not None and not user.anonymous else ""
    named = "Certificate" if usage.by_certificate else "UserName"
    return _Security(
        session.session_id,
        name,
        list(usage.users),
        named if name else "Anonymous",
        "UA Binary",
        "opc.tcp",
        usage.security_mode,
        usage.security_policy,
        session.client_certificate,
    )


def _encoded_security(session: Session) -> Any:
    return _encoded(_security_diagnostics(session))


def _encoded(told: _Security) -> Any:
    text = ua_binary.Primitives.String.pack
    history = [len(told.ClientUserIdHistory).to_bytes(4, "little"), *map(text, told.ClientUserIdHistory)]
    texts = (told.AuthenticationMechanism, told.Encoding, told.TransportProtocol)
    body = (
        ua_binary.nodeid_to_binary(told.SessionId),
        text(told.ClientUserIdOfSession),
        *history,
        *map(text, texts),
        told.SecurityMode.to_bytes(4, "little"),
        text(told.SecurityPolicyUri),
        ua_binary.Primitives.ByteString.pack(told.ClientCertificate),
    )
    type_id = ns0(ObjectIds.SessionSecurityDiagnosticsDataType_Encoding_DefaultBinary)
    return ua.ExtensionObject(type_id, ua.ByteString(b"".join(body)))


def _subscription_diagnostics(subscription: ClientSubscription) -> Any:
    usage = subscription.usage
    told: Any = ua.SubscriptionDiagnosticsDataType()
    told.SessionId = subscription.session_id or ua.NodeId()
    told.SubscriptionId, told.Priority = subscription.id, subscription.priority
    told.PublishingInterval = subscription.interval_s * 1000
    told.MaxKeepAliveCount, told.MaxLifetimeCount = subscription.keep_alive_count, subscription.lifetime_count
    told.MaxNotificationsPerPublish = subscription.max_notifications
    told.PublishingEnabled = subscription.enabled
    told.ModifyCount, told.EnableCount, told.DisableCount = usage.modified, usage.enabled, usage.disabled
    told.RepublishRequestCount = told.RepublishMessageRequestCount = usage.republish_requests
    told.RepublishMessageCount = usage.republished
    told.TransferRequestCount = usage.transfer_requests
    told.TransferredToAltClientCount = usage.transferred_to_other
    told.TransferredToSameClientCount = usage.transferred_to_same
    told.PublishRequestCount = usage.publish_requests
    told.DataChangeNotificationsCount, told.EventNotificationsCount = usage.data_changes, usage.events
    told.NotificationsCount = usage.data_changes + usage.events
    told.LatePublishRequestCount = usage.late
    told.CurrentKeepAliveCount = subscription.quiet_cycles
    told.CurrentLifetimeCount = subscription.cycles_without_request
    told.UnacknowledgedMessageCount = len(subscription.unacknowledged)
    told.DiscardedMessageCount = usage.discarded
    told.MonitoredItemCount = len(subscription.items)
    told.DisabledMonitoredItemCount = sum(item.mode is ua.MonitoringMode.Disabled for item in subscription.items)
    told.MonitoringQueueOverflowCount, told.EventQueueOverflowCount = usage.overflows, usage.event_overflows
    told.NextSequenceNumber = subscription.next_sequence
    return told
