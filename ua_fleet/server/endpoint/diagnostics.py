"""The server's diagnostics (OPC 10000-5 6.3.3 to 6.3.6): what its sessions and subscriptions do, as Variables.

ServerDiagnostics
  ServerDiagnosticsSummary             counters of all, for everybody
  SubscriptionDiagnosticsArray         for engineers
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

from ua_fleet.server.built import Held
from ua_fleet.server.convert import raw_id
from ua_fleet.server.endpoint.context import Context
from ua_fleet.server.endpoint.data_types import DataTypes
from ua_fleet.server.endpoint.live import Guard, LiveValue
from ua_fleet.server.endpoint.sessions import Session, Sessions
from ua_fleet.server.endpoint.stack import AttributeIds, ObjectIds, StatusCodes, ns0
from ua_fleet.server.endpoint.subscriptions import ClientSubscription, Subscriptions
from ua_fleet.server.nodes import HAS_COMPONENT, NodeBuilder
from ua_fleet.server.users import Role, User
from ua_fleet.values import QualifiedName

__all__ = ["Diagnostics"]

_ROOT: Final = "Server_ServerDiagnostics_"
_SUMMARY: Final = f"{_ROOT}ServerDiagnosticsSummary"
_SESSIONS: Final = f"{_ROOT}SessionsDiagnosticsSummary"
_SERVER_NAMESPACE: Final = 1
"""Of the server's ApplicationUri, in which SessionIds are."""
_CACHED_S: Final = 0.25
"""Arrays of all sessions or subscriptions are made anew after so long, or when there is another one."""
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


class _Array:
    """The values of an array that need not be made anew for each read."""

    def __init__(self, make: Callable[[], list[Any]], version: Callable[[], Any]) -> None:
        self._make, self._version = make, version
        self._kept: tuple[float, Any, list[Any]] = (-1.0, None, [])

    def __call__(self) -> list[Any]:
        made_at, version, values = self._kept
        now, wanted = time.monotonic(), self._version()
        if version != wanted or now - made_at > _CACHED_S:
            values = self._make()
            self._kept = now, wanted, values
        return values


class Diagnostics:
    """The nodes below ServerDiagnostics, with what they tell."""

    def __init__(self, space: AddressSpace, context: Context, sessions: Sessions, subscriptions: Subscriptions) -> None:
        self._space, self._context = space, context
        self._sessions, self._subscriptions = sessions, subscriptions
        self._builder, self._types = NodeBuilder(space), DataTypes(space)
        self._live: dict[ua.NodeId, dict[ua.NodeId, LiveValue]] = {}
        """The values that are told of changes, by the session that they are of."""

    def build(self) -> None:
        """Give the standard's nodes their values."""
        structure = ua.VariantType.ExtensionObject
        self._set(f"{_ROOT}EnabledFlag", lambda: True, ua.VariantType.Boolean)
        self._set(_SUMMARY, self._summary, structure)
        for name in ua.ServerDiagnosticsSummaryDataType.__dataclass_fields__:
            self._set(f"{_SUMMARY}_{name}", partial(self._of_summary, name), ua.VariantType.UInt32)
        everything, members = _Array(self._all_subscriptions, self._subscription_ids), self._session_ids
        self._set(f"{_ROOT}SubscriptionDiagnosticsArray", everything, structure, _engineers)
        for name, make, guard in (
            ("SessionDiagnosticsArray", _session_diagnostics, _engineers),
            ("SessionSecurityDiagnosticsArray", _encoded_security, _security),
        ):
            self._set(f"{_SESSIONS}_{name}", _Array(partial(self._each, make), members), structure, guard)

    def _set(self, name: str, compute: Callable[[], Any], variant_type: Any, guard: Guard | None = None) -> None:
        node_id = ns0(getattr(ObjectIds, name))
        live = LiveValue(compute, variant_type, guard)
        attributes: Any = self._space[node_id].attributes
        attributes[AttributeIds.Value] = live
        self._live.setdefault(ua.NodeId(), {})[node_id] = live

    async def tell(self) -> None:
        """Tell who watches of changes."""
        for values in list(self._live.values()):
            for live in list(values.values()):
                if live.is_watched:
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
        """Make the nodes of a session that is active now; those that it has are left alone."""
        if session.session_id in self._space:
            return

        def own(user: User, encrypted: bool) -> int:
            is_own = session.user is not None and user.name == session.user.name and not user.anonymous
            return 0 if is_own else _engineers(user, encrypted)

        name = QualifiedName(_SERVER_NAMESPACE, session.usage.name or session.key)
        self._builder.add_object(
            session.session_id, name, ns0(getattr(ObjectIds, _SESSIONS)), ns0(ObjectIds.SessionDiagnosticsObjectType)
        )
        self._live[session.session_id] = {}
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
        own_subscriptions = _Array(
            lambda: [_subscription_diagnostics(each) for each in list(session.subscriptions.values())],
            lambda: tuple(session.subscriptions),
        )
        self._variable(
            session,
            "SubscriptionDiagnosticsArray",
            session.session_id,
            ObjectIds.SubscriptionDiagnosticsArrayType,
            (ns0(ObjectIds.SubscriptionDiagnosticsDataType), 1),
            LiveValue(own_subscriptions, ua.VariantType.ExtensionObject, own),
        )

    async def remove(self, session: Session) -> None:
        """Remove the nodes of a session that has ended."""
        if session.session_id in self._space:
            await self._builder.remove(session.session_id)
        self._live.pop(session.session_id, None)

    def _structure(
        self,
        session: Session,
        name: str,
        type_id: int,
        make: Callable[[Session], Any],
        guard: Guard,
        encoded: Callable[[Any], Any] = lambda made: made,
    ) -> None:
        """A Variable of a structure, also below the array of all; its fields are made when somebody browses it."""
        data_type = self._value_of(ns0(type_id), AttributeIds.DataType)
        live = LiveValue(lambda: encoded(make(session)), ua.VariantType.ExtensionObject, guard)
        node_id = self._variable(session, name, session.session_id, type_id, (data_type, -1), live)
        self._builder.add_reference(ns0(getattr(ObjectIds, f"{_SESSIONS}_{name}Array")), HAS_COMPONENT, node_id)

        def make_fields(owner: ua.NodeId) -> None:
            for reference in list(self._space[ns0(type_id)].references):
                if reference.IsForward and reference.ReferenceTypeId == HAS_COMPONENT:
                    self._add_field(session, name, owner, reference, make, guard)

        self._builder.add_later(node_id, make_fields)  # the last one that is done: a reference to it would be a browse

    def _add_field(
        self,
        session: Session,
        structure: str,
        owner: ua.NodeId,
        declared: ua.ReferenceDescription,
        make: Callable[[Session], Any],
        guard: Guard,
    ) -> None:
        field = str(declared.BrowseName.Name)
        data_type = self._value_of(declared.NodeId, AttributeIds.DataType)
        rank = int(self._value_of(declared.NodeId, AttributeIds.ValueRank))
        builtin = self._types.builtin_types(data_type)
        live = LiveValue(lambda: getattr(make(session), field), ua.VariantType(min(builtin)), guard)
        type_id = ObjectIds.BaseDataVariableType
        self._variable(session, f"{structure}.{field}", owner, type_id, (data_type, rank), live)

    def _variable(
        self,
        session: Session,
        path: str,
        parent: ua.NodeId,
        type_id: int,
        value_type: tuple[ua.NodeId, int],
        live: LiveValue,
    ) -> ua.NodeId:
        node_id = raw_id(f"{session.key}.{path}", _SERVER_NAMESPACE)
        data_type, rank = value_type
        held: Held = live
        self._builder.add_variable(
            node_id,
            QualifiedName(0, path.rpartition(".")[2]),
            parent,
            ns0(type_id),
            data_type=data_type,
            value=held,
            value_rank=rank,
        )
        self._live[session.session_id][node_id] = live
        return node_id

    def _value_of(self, node_id: ua.NodeId, attribute: AttributeIds) -> Any:
        variant = self._space.read_attribute_value(node_id, attribute).Value
        assert variant is not None
        return variant.Value


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
