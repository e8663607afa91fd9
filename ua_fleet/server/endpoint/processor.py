"""From the bytes of a frame to a service and back: which service there is, for whom, and what a mistake gets.

What is not in the tables of `Services` does not exist: RegisterServer, AddNodes, DeleteReferences, HistoryUpdate and
all others get Bad_ServiceUnsupported.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import structlog
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary

from ua_fleet.server.audit import Caller
from ua_fleet.server.endpoint.attributes import AttributeServices
from ua_fleet.server.endpoint.channel import Channel
from ua_fleet.server.endpoint.connection import Connection, FrameError
from ua_fleet.server.endpoint.context import Context
from ua_fleet.server.endpoint.methods import MethodServices
from ua_fleet.server.endpoint.request import Request
from ua_fleet.server.endpoint.session_services import SessionServices
from ua_fleet.server.endpoint.sessions import Session, Sessions
from ua_fleet.server.endpoint.stack import DECODE_ERRORS, ObjectIds, Refusal, StatusCodes, name_of, status, status_of
from ua_fleet.server.endpoint.subscription_services import SubscriptionServices
from ua_fleet.server.endpoint.subscriptions import Subscriptions
from ua_fleet.server.endpoint.views import ViewServices
from ua_fleet.server.trust import CertificateRefused

__all__ = ["Processor", "Services", "Stage"]

_log = structlog.get_logger("ua_fleet.server")


class Stage(IntEnum):
    """How far a connection has come. Each step has its own time."""

    CONNECTED = 0
    OPENED = 1
    SESSION = 2
    AUTHENTICATED = 3


@dataclass(frozen=True, slots=True)
class _Service:
    parameters: Any
    """asyncua's class of the request's parameters."""
    handle: Callable[[Request, Any], Awaitable[Any]]
    count_at: int | None = None
    """Where the number of operations stands, for services in which it stands at a fixed place."""


def _encoding(name: str) -> int:
    return int(getattr(ObjectIds, f"{name}Request_Encoding_DefaultBinary"))


class Services:
    """The services of one server, by the identifier of their request's encoding."""

    def __init__(self, context: Context, subscriptions: Subscriptions) -> None:
        self.context = context
        self.sessions = Sessions()
        self.session = SessionServices(context, self.sessions, subscriptions)
        attributes, views, methods = AttributeServices(context), ViewServices(context), MethodServices(context)
        subs = SubscriptionServices(context, subscriptions)
        self.table: dict[int, _Service] = {
            _encoding(name): _Service(parameters, handle, count_at)
            for name, parameters, handle, count_at in (
                ("Read", ua.ReadParameters, attributes.read, 12),
                ("Write", ua.WriteParameters, attributes.write, 0),
                ("HistoryRead", ua.HistoryReadParameters, attributes.history_read, None),
                ("Browse", ua.BrowseParameters, views.browse, None),
                ("BrowseNext", ua.BrowseNextParameters, views.browse_next, 1),
                (
                    "TranslateBrowsePathsToNodeIds",
                    ua.TranslateBrowsePathsToNodeIdsParameters,
                    views.translate_browse_paths,
                    0,
                ),
                ("RegisterNodes", ua.RegisterNodesParameters, views.register_nodes, 0),
                ("UnregisterNodes", ua.UnregisterNodesParameters, views.unregister_nodes, 0),
                ("Call", ua.CallParameters, methods.call, 0),
                ("CreateSubscription", ua.CreateSubscriptionParameters, subs.create_subscription, None),
                ("ModifySubscription", ua.ModifySubscriptionParameters, subs.modify_subscription, None),
                ("DeleteSubscriptions", ua.DeleteSubscriptionsParameters, subs.delete_subscriptions, 0),
                ("SetPublishingMode", ua.SetPublishingModeParameters, subs.set_publishing_mode, 1),
                ("TransferSubscriptions", ua.TransferSubscriptionsParameters, subs.transfer_subscriptions, 0),
                ("Publish", ua.PublishParameters, subs.publish, 0),
                ("Republish", ua.RepublishParameters, subs.republish, None),
                ("CreateMonitoredItems", ua.CreateMonitoredItemsParameters, subs.create_monitored_items, 8),
                ("ModifyMonitoredItems", ua.ModifyMonitoredItemsParameters, subs.modify_monitored_items, 8),
                ("SetMonitoringMode", ua.SetMonitoringModeParameters, subs.set_monitoring_mode, 8),
                ("DeleteMonitoredItems", ua.DeleteMonitoredItemsParameters, subs.delete_monitored_items, 4),
            )
        }


_CREATE = _encoding("CreateSession")
_ACTIVATE = _encoding("ActivateSession")
_CLOSE = _encoding("CloseSession")
_GET_ENDPOINTS = _encoding("GetEndpoints")
_FIND_SERVERS = _encoding("FindServers")


class Processor:
    """What stands behind one connection; also the link that its sessions answer through."""

    def __init__(self, connection: Connection, services: Services) -> None:
        self._connection = connection
        self._services = services
        self._context = services.context
        context = self._context
        self._channel = Channel(context.iserver, context.limits, context.policies, context.trust)
        self.peer, self.address = connection.peer, connection.address
        self.stage = Stage.CONNECTED
        self._early_requests = 0
        self._deadline = connection.opened_at + context.limits.handshake_s

    @property
    def writable(self) -> bool:
        """Whether the client keeps up."""
        return self._connection.writable

    def room(self) -> int:
        """Bytes that the next frame may have."""
        return self._channel.room()

    def overdue(self, now: float) -> str:
        """Why the connection has to be cut off now; empty when it does not."""
        stalled = self._connection.stalled_since
        if self.stage is not Stage.AUTHENTICATED and now > self._deadline:
            self._context.statistics.handshake_timeouts += 1
            return f"no progress beyond {self.stage.name.lower()} in {self._context.limits.handshake_s:g} s"
        if stalled is not None and now - stalled > self._context.limits.stalled_s:
            return "the client does not read its responses"
        if now > self._channel.expires_at:
            return "the secure channel was not renewed"
        return ""

    def cut_off(self, reason: str) -> None:
        """Close the connection at once, with a line in the audit log."""
        self._context.audit.refuse(self._caller(), "connection", "BadTimeout", reason=reason)
        self._connection.abort()

    def _caller(self) -> Caller:
        for session in self._services.sessions.on(self):
            return session.caller
        return Caller(self.peer)

    def _advance(self, stage: Stage) -> None:
        """A step is done; the next one has its own time. Doing a step again gives no more time."""
        if stage > self.stage:
            self.stage = stage
            self._deadline = time.monotonic() + self._context.limits.handshake_s
            self._channel.authenticated = stage is Stage.AUTHENTICATED

    def _fall_back(self) -> None:
        """The last session is closed: what may be sent is as before authentication, and the time runs again."""
        if self.stage is Stage.AUTHENTICATED and not any(s.active for s in self._services.sessions.on(self)):
            self.stage = Stage.OPENED
            self._deadline = time.monotonic() + self._context.limits.handshake_s
            self._channel.authenticated = False

    async def process(self, frame: bytes) -> bool:
        """Process one frame; False ends the connection."""
        try:
            message = self._channel.receive(frame)
        except CertificateRefused as error:
            self._reject(error)
            # The client learns no more than that; what is wrong stands in our log (OPC 10000-4 6.1.3).
            raise FrameError(StatusCodes.BadSecurityChecksFailed, "certificate") from error
        self._flush()
        if self._channel.is_open:
            self._advance(Stage.OPENED)
        if message is not None:
            await self._serve(message)
        return True

    def _reject(self, error: CertificateRefused) -> None:
        self._context.statistics.certificates_rejected += 1
        chain = self._channel.chain
        if chain and error.ua_status == StatusCodes.BadCertificateUntrusted:
            self._context.trust.reject(chain[0])
        self._context.audit.refuse(Caller(self.peer), "certificate", name_of(error.ua_status), reason=str(error))
        _log.warning("client certificate rejected", client=self.peer, reason=str(error))

    def refuse(self, error: FrameError) -> None:
        """A frame broke the rules: say so to the client, then it is closed."""
        if not error.code:
            return
        self._context.statistics.frames_refused += 1
        self._flush()
        self._connection.send(Channel.error_message(error.code, name_of(error.code)))
        if not isinstance(error.__cause__, CertificateRefused):
            self._context.audit.refuse(self._caller(), "message", name_of(error.code), reason=str(error))

    async def closed(self) -> None:
        """The connection is gone."""
        await self._services.session.lost(self)

    def _flush(self) -> None:
        for data in self._channel.output:
            self._connection.send(data)
        self._channel.output.clear()

    async def _serve(self, message: Any) -> None:
        """Serve one request; whatever it is, the client gets an answer."""
        self._context.statistics.requests += 1
        if self.stage is not Stage.AUTHENTICATED:
            self._early_requests += 1
            if self._early_requests > self._context.limits.requests_before_authentication:
                raise FrameError(StatusCodes.BadTcpNotEnoughResources, "too many requests before authentication")
        body: Buffer = message.body()
        request_id = int(message.SequenceHeader().RequestId)
        try:
            type_id = nodeid_from_binary(body)
            header = struct_from_binary(ua.RequestHeader, body)
            handle = int(header.RequestHandle)
        except DECODE_ERRORS as error:
            raise FrameError(StatusCodes.BadDecodingError, f"a request header: {type(error).__name__}") from error
        kind = type_id.Identifier if type_id.NamespaceIndex == 0 and isinstance(type_id.Identifier, int) else -1
        name = _NAMES.get(kind, f"request {kind}")
        try:
            response = await self._dispatch(kind, header, body, request_id)
        except Exception as error:  # noqa: BLE001 - what is no refusal is logged with its traceback
            code = status_of(error)
            if code is None:
                # A mistake of ours in one service must not end the connection, nor the others'.
                _log.exception("service failed", service=name, client=self.peer)
                code = int(StatusCodes.BadInternalError)
            self._fault(name, handle, request_id, code, str(error))
            return
        if response is not None:
            self.respond(response, handle, request_id)

    def _fault(self, name: str, handle: int, request_id: int, code: int, reason: str) -> None:
        self._context.statistics.requests_refused += 1
        self._context.audit.refuse(self._caller(), name, name_of(code), reason=reason)
        fault = ua.ServiceFault()
        fault.ResponseHeader.ServiceResult = status(code)
        self.respond(fault, handle, request_id)

    def respond(self, response: Any, handle: int, request_id: int) -> None:
        """Send a response; one that cannot be encoded, or is too long for the client, becomes a fault."""
        try:
            data = self._channel.encode(response, handle)
        except DECODE_ERRORS as error:
            fault = ua.ServiceFault()
            long = isinstance(error, OverflowError)
            code = StatusCodes.BadResponseTooLarge if long else StatusCodes.BadEncodingError
            fault.ResponseHeader.ServiceResult = status(code)
            if not long:
                _log.error("response cannot be encoded", response=type(response).__name__, reason=str(error)[:200])
            data = self._channel.encode(fault, handle)
        self._channel.respond(data, request_id)
        self._flush()

    async def _dispatch(self, kind: int, header: Any, body: Buffer, request_id: int) -> Any:
        """The response to a request, or None when it is answered later; raises errors with a StatusCode."""
        services = self._services.session
        server = self._connection.server_address
        if kind == _GET_ENDPOINTS:
            return await services.get_endpoints(_decode(ua.GetEndpointsParameters, body), server)
        if kind == _FIND_SERVERS:
            return services.find_servers(_decode(ua.FindServersParameters, body), server)
        if kind == _CREATE:
            parameters = _decode(ua.CreateSessionParameters, body)
            _, response = await services.create(self, self._channel, parameters, server)
            self._advance(Stage.SESSION)
            return response
        if kind == _ACTIVATE:
            parameters = _decode(ua.ActivateSessionParameters, body)
            _, response = await services.activate(self, self._channel, header.AuthenticationToken, parameters)
            self._advance(Stage.AUTHENTICATED)
            return response
        service = self._services.table.get(kind)
        if service is None and kind != _CLOSE:
            raise Refusal(StatusCodes.BadServiceUnsupported)
        session = self._session(header.AuthenticationToken)
        if service is None:
            delete = bool(_decode_boolean(body))
            response = await services.close(session, delete_subscriptions=delete)
            self._fall_back()
            return response
        if not session.active or session.user is None:
            raise Refusal(StatusCodes.BadSessionNotActivated)
        session.last_seen = time.monotonic()
        request = Request(
            session,
            session.user,
            session.caller,
            int(header.RequestHandle),
            request_id,
            header.TimeoutHint / 1000,
            self._channel.encrypted,
        )
        if service.count_at is not None:
            self._check_count(body, service.count_at)
        return await service.handle(request, _decode(service.parameters, body))

    def _session(self, token: ua.NodeId | None) -> Session:
        """The session of a request; its token is good on its own connection alone."""
        session = self._services.sessions.find(token)
        if session is None:
            raise Refusal(StatusCodes.BadSessionIdInvalid)
        if session.link is not self:
            raise Refusal(StatusCodes.BadSecureChannelIdInvalid, "the session of another channel")
        return session

    def _check_count(self, body: Buffer, at: int) -> None:
        """Refuse a request with too many operations before they are decoded."""
        peek = body.copy()
        if len(peek) < at + 4:
            raise Refusal(StatusCodes.BadDecodingError)
        peek.skip(at)
        count = int.from_bytes(peek.read(4), "little", signed=True)
        if count > self._context.limits.nodes_per_request:
            raise Refusal(StatusCodes.BadTooManyOperations, f"{count} operations")


def _decode(parameters: Any, body: Buffer) -> Any:
    try:
        return struct_from_binary(parameters, body)
    except DECODE_ERRORS as error:
        raise Refusal(StatusCodes.BadDecodingError, f"{parameters.__name__}: {type(error).__name__}") from error


def _decode_boolean(body: Buffer) -> bool:
    if len(body) < 1:
        raise Refusal(StatusCodes.BadDecodingError)
    return body.read(1) != b"\x00"


_NAMES = {
    int(identifier): name.removesuffix("Request_Encoding_DefaultBinary")
    for name, identifier in vars(ObjectIds).items()
    if name.endswith("Request_Encoding_DefaultBinary")
}
