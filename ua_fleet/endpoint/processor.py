"""From the bytes of a frame to a service and back: which service there is, for whom, and what a mistake gets.

What is not in the tables of `Services` does not exist: RegisterServer, AddNodes, DeleteReferences, HistoryUpdate and
all others get Bad_ServiceUnsupported.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Any, NoReturn

import structlog
from asyncua import ua
from asyncua.common.utils import Buffer
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import Certificate

from ua_fleet.endpoint.admission import Progress
from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.audit_events import Who
from ua_fleet.endpoint.binary.session_requests import decode_session_request
from ua_fleet.endpoint.channel import Channel
from ua_fleet.endpoint.charges import REFUSED_LOGIN_S, Charge
from ua_fleet.endpoint.connection import FrameError, TcpConnection
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.decoding import (
    BYTES_BEFORE_SESSION,
    OPERATIONS_BEFORE_SESSION,
    RequestHead,
    decode_parameters,
    decode_request_head,
)
from ua_fleet.endpoint.own_time import own_time
from ua_fleet.endpoint.request import ANSWERED_LATER, ServiceRequest
from ua_fleet.endpoint.secure_connection import Message
from ua_fleet.endpoint.services import Services, encoding
from ua_fleet.endpoint.sessions import Session
from ua_fleet.endpoint.stack import DECODE_ERRORS, ObjectIds, Refusal, StatusCodes, name_of, status, status_of
from ua_fleet.endpoint.trust import CertificateRefused
from ua_fleet.endpoint.turns import LARGE_BYTES, TURN_S, TurnPlace, Turns
from ua_fleet.endpoint.users import User
from ua_fleet.errors import RemoteWireError

__all__ = ["Processor", "Stage", "refuse_stranger"]

_log = structlog.get_logger("ua_fleet.server")


class Stage(IntEnum):
    """How far a connection has come. Each step has its own time."""

    CONNECTED = 0
    OPENED = 1
    SESSION = 2
    AUTHENTICATED = 3


_OPERATION_ADDITIONAL_INFO = 0x80
"""Bit of ReturnDiagnostics (OPC 10000-4 7.33)."""
_INTERNAL = int(StatusCodes.BadInternalError)
_GONE = StatusCodes.BadConnectionClosed
_CREATE = encoding("CreateSession")
_ACTIVATE = encoding("ActivateSession")
_CLOSE = encoding("CloseSession")
_GET_ENDPOINTS = encoding("GetEndpoints")
_FIND_SERVERS = encoding("FindServers")


_BY_SECURITY = frozenset(
    (
        StatusCodes.BadSecurityChecksFailed,
        StatusCodes.BadSecurityModeInsufficient,
        StatusCodes.BadSecureChannelIdInvalid,
        StatusCodes.BadUserAccessDenied,
        StatusCodes.BadUserSignatureInvalid,
        StatusCodes.BadApplicationSignatureInvalid,
        StatusCodes.BadIdentityTokenInvalid,
        StatusCodes.BadIdentityTokenRejected,
        StatusCodes.BadCertificateInvalid,
        StatusCodes.BadCertificateUriInvalid,
        StatusCodes.BadNonceInvalid,
    )
)
"""With what a request is refused because of who asks."""
_TOO_MUCH = "computing time for clients without a user"
_MOST_NAME = 64
"""Of a user name no more is kept."""


def refuse_stranger(context: EndpointContext, peer: str) -> None:
    """Count and record that a client is refused because its address has cost too much."""
    context.statistics.strangers_refused += 1
    context.audit.refuse(Caller(peer), "connection", "BadTcpServerTooBusy", reason=_TOO_MUCH)


class Processor:
    """What stands behind one connection; also the link that its sessions answer through."""

    def __init__(self, connection: TcpConnection, services: Services) -> None:
        self._connection = connection
        self._services = services
        self._context = services.context
        context = self._context
        self._channel = Channel(context.iserver, context.limits, context.policies, context.trust, self._check_shown)
        self.peer, self.address = connection.peer, connection.address
        self.stage = Stage.CONNECTED
        self._early_requests = 0
        self._charge = Charge(context.charges, connection.address)
        self._is_proved = False
        """Whether the client has the key to the certificate that it shows."""
        self._trying = ""
        """The user name whose password is checked."""
        self._behind: list[tuple[bytes, int]] | None = None
        """Responses that wait behind the chunks of a large one, while there is one."""
        self._turns: Turns | None = None
        """Of the request that is worked on."""
        self._place: tuple[User, TurnPlace] | None = None
        """Of the user who has asked last."""
        self._deadline = connection.opened_at + context.limits.handshake_s
        """When the client has to be a step further, as long as the server does not work for it."""
        self._own_work_s = 0.0
        """What the requests of this step took to serve."""
        self._working_since: float | None = None
        """When the server began to serve such a request, while it does."""

    @property
    def writable(self) -> bool:
        """Whether the client keeps up."""
        return self._connection.writable

    @property
    def progress(self) -> Progress:
        """How far a connection without a user has come."""
        if self.stage >= Stage.SESSION:
            return Progress.SESSION
        if self._channel.is_open:
            return Progress.TRUSTED if self._channel.sessions_allowed else Progress.DISCOVERY
        return Progress.HELLO if self._channel.greeted else Progress.CONNECTED

    @property
    def waiting_as(self) -> str:
        """Whom a connection without a user counts for: its address, or who tries to log in through its gateway."""
        if not self._charge.gateway:
            return self.address
        return f"gateway {self._charge.gateway} {self._trying or id(self)}"

    @property
    def gateway(self) -> str:
        """Name of the gateway whose connection this has proved to be; empty for any other."""
        return self._charge.gateway

    @property
    def is_beside_gateway(self) -> bool:
        """Whether this is a gateway's connection, or may become one: it has just come from where one is connected."""
        if self._charge.gateway or self.progress >= Progress.TRUSTED:
            return bool(self._charge.gateway)
        return self._context.charges.has_gateway(self.address)

    def recognise(self) -> bool:
        """Look whether this is a gateway's connection; False where that one has cost too much."""
        name = self._context.trust.gateways.name_of(self._channel.chain[0]) if self._is_proved else ""
        return self._charge.belongs_to(name, time.monotonic())

    def _shown(self) -> bool | None:
        """Whether the client has shown a gateway's certificate; None while it may, or only asks for endpoints."""
        channel = self._channel
        if not channel.is_open or not channel.sessions_allowed:
            return None
        return self._is_a_gateways(channel.chain)

    def _is_a_gateways(self, chain: Sequence[Certificate]) -> bool:
        return bool(chain and self._context.trust.gateways.name_of(chain[0]))

    def _check_shown(self, chain: Sequence[Certificate]) -> None:
        """Refuse who shows no gateway's certificate where others are not served; before our private key is used."""
        charge = self._charge
        if charge.is_on_trial and charge.is_exhausted(time.monotonic(), lambda: self._is_a_gateways(chain)):
            self._refuse_stranger()

    def _refuse_stranger(self) -> NoReturn:
        refuse_stranger(self._context, self.peer)
        raise FrameError(StatusCodes.BadTcpServerTooBusy, _TOO_MUCH) from None

    @property
    def response_bytes(self) -> int:
        """Bytes that the client takes in one response; 0 for any number."""
        return self._channel.response_bytes

    def room(self) -> int:
        """Bytes that the next frame may have."""
        return self._channel.room()

    def overdue(self, now: float) -> str:
        """Why the connection has to be cut off now; empty when it does not."""
        stalled = self._connection.stalled_since
        if self.stage is not Stage.AUTHENTICATED and now > self._deadline + (own_s := self._own_work_until(now)):
            self._context.statistics.handshake_timeouts += 1
            beside = f" and {own_s:.1f} s of the server's work" if own_s > 1 else ""
            return f"no progress beyond {self.stage.name.lower()} in {self._context.limits.handshake_s:g} s{beside}"
        limits, contended = self._context.limits, self._turns is not None and self._turns.contended
        if stalled is not None and now - stalled > (limits.contended_s if contended else limits.stalled_s):
            return "the client does not read its responses"
        if now > self._channel.expires_at:
            return "the secure channel was not renewed"
        return ""

    def _own_work_until(self, now: float) -> float:
        """Seconds of this step that the server took: a busy one may check a password for seconds."""
        working_s = now - self._working_since if self._working_since is not None else 0.0
        return min(self._own_work_s + working_s, self._context.limits.own_work_s)

    def cut_off(self, reason: str, status_name: str = "BadTimeout") -> None:
        """Close the connection at once, with a line in the audit log."""
        self._context.audit.refuse(self._caller(), "connection", status_name, reason=reason)
        self._connection.abort()

    def _caller(self) -> Caller:
        for session in self._services.sessions.on(self):
            return session.caller
        return Caller(self.peer)

    def _advance(self, stage: Stage) -> None:
        """A step is done; the next one has its own time. Doing a step again gives no more time."""
        if stage > self.stage:
            self.stage = stage
            self._begin_step()
            self._channel.authenticated = stage is Stage.AUTHENTICATED

    def _begin_step(self) -> None:
        now = time.monotonic()
        self._deadline, self._own_work_s = now + self._context.limits.handshake_s, 0.0
        if self._working_since is not None:
            self._working_since = now

    def fall_back(self) -> None:
        """Without a session what may be sent is as before authentication, and the time runs again.

        A session is closed, ends after its timeout or with its user, or is taken to another connection; whichever it
        was, a connection that has none must not keep a place that never gives way.
        """
        if self.stage is Stage.AUTHENTICATED and not any(s.active for s in self._services.sessions.on(self)):
            self.stage = Stage.OPENED
            self._begin_step()
            self._channel.authenticated = False

    def process_opening(self, frame: bytes) -> None:
        """Process a Hello or an OpenSecureChannel: neither is a request that somebody serves."""
        message = self._receive(frame)
        assert message is None

    async def process(self, frame: bytes) -> bool:
        """Process one frame; False ends the connection."""
        if (message := self._receive(frame)) is not None:
            await self._serve(message)
        return True

    def _receive(self, frame: bytes) -> Message | None:
        """The request that a frame completes, if any."""
        stranger = self.stage is not Stage.AUTHENTICATED
        if stranger and self._charge.is_exhausted(time.monotonic(), self._shown):
            self._refuse_stranger()
        try:
            if stranger:
                with self._charged():
                    message = self._channel.receive(frame)
            else:
                message = self._channel.receive(frame)
        except CertificateRefused as error:
            self._tell_opened(error.ua_status)
            with self._charged():
                self._reject(error)
            # The client learns no more than that; what is wrong stands in our log (OPC 10000-4 6.1.3).
            raise FrameError(StatusCodes.BadSecurityChecksFailed, "certificate") from error
        except FrameError as error:
            self._tell_opened(error.code)
            raise
        if message is None:
            self._flush()
            self._tell_opened(0)
            if self._channel.is_open:
                self._advance(Stage.OPENED)
        if message is not None and self._channel.secured and not self._is_proved:
            # An OpenSecureChannel can be sent again by anybody; the first message under its keys cannot.
            self._is_proved = True
            if not self.recognise():
                self._refuse_stranger()
        return message

    def _charged(self, stranger: bool = True) -> _Charged:
        """What is computed meanwhile, without waiting, is owed until a user logs in."""
        return _Charged(self._charge if stranger else None)

    def _tell_opened(self, code: int) -> None:
        """Tell engineers of an OpenSecureChannel, if there was one."""
        if (asked := self._channel.take_opened()) is not None and self._services.events.wanted:
            opened = replace(asked, channel_id=self._channel.channel_id)
            self._services.events.channel(Who(self._caller()), opened, code)

    def _reject(self, error: CertificateRefused) -> None:
        self._context.statistics.certificates_rejected += 1
        chain = self._channel.chain
        if chain and error.ua_status == StatusCodes.BadCertificateUntrusted:
            self._context.trust.reject(chain[0], self.address)
        code = name_of(error.ua_status)
        written = self._context.audit.refuse(Caller(self.peer), "certificate", code, reason=str(error))
        certificate = chain[0].public_bytes(Encoding.DER) if chain else b""
        self._services.events.certificate(Who(Caller(self.peer)), certificate, error.ua_status)
        if written:  # a flood fills this log no more than that one
            _log.warning("client certificate rejected", client=self.peer, reason=str(error))

    def refuse(self, error: FrameError) -> None:
        """A frame broke the rules: say so to the client, then it is closed."""
        if not error.code:
            return
        self._context.statistics.frames_refused += 1
        self._flush()
        self._connection.send(Channel.error_message(error.code, name_of(error.code)))
        if not isinstance(error.__cause__, CertificateRefused) and str(error) != _TOO_MUCH:
            self._context.audit.refuse(self._caller(), "message", name_of(error.code), reason=str(error))

    async def closed(self) -> None:
        """The connection is gone."""
        self._charge.end()
        await self._services.session.lost(self)

    def _flush(self) -> None:
        for data in self._channel.output:
            self._connection.send(data)
        self._channel.output.clear()

    async def _serve(self, message: Message) -> None:
        """Serve one request; whatever it is, the client gets an answer."""
        self._context.statistics.requests += 1
        if self.stage is not Stage.AUTHENTICATED:
            self._early_requests += 1
            if self._early_requests > self._context.limits.requests_before_authentication:
                raise FrameError(StatusCodes.BadTcpNotEnoughResources, "too many requests before authentication")
        body = Buffer(message.body)
        try:
            head = decode_request_head(body)
        except (RemoteWireError, Refusal) as error:
            raise FrameError(StatusCodes.BadDecodingError, f"a request header: {error}") from error
        self._working_since = time.monotonic() if self.stage is not Stage.AUTHENTICATED else None
        try:
            await self._answer(head, message.body, body, message.request_id)
        finally:
            if self._working_since is not None:
                self._own_work_s += time.monotonic() - self._working_since
                self._working_since = None
            turns = self._turns
            try:
                if turns is not None and turns.is_large:
                    await self._connection.taken()
            finally:
                self._turns = None
                if turns is not None:
                    turns.leave()

    async def _answer(self, head: RequestHead, data: bytes, body: Buffer, request_id: int) -> None:
        handle, began = head.handle, time.monotonic()
        name = _NAMES.get(head.kind, f"request {head.kind}")
        try:
            response = await self._dispatch(head, data, body, request_id)
        except Exception as error:  # noqa: BLE001 - what is no refusal is logged with its traceback
            code = status_of(error)
            if code is None:
                # A mistake of ours in one service must not end the connection, nor the others'.
                self._context.mistakes.caught("services", error, service=name, client=self.peer)
                code = int(StatusCodes.BadInternalError)
            self._count_refused(head, code)
            self._fault(name, handle, request_id, code, str(error))
            return
        if response is not None:
            await self._send(self._encoded(response, handle), request_id)
            self._context.statistics.answered(name, time.monotonic() - began)

    async def _send(self, data: bytes, request_id: int) -> None:
        """Send a response; others get their turn between the chunks of a large one."""
        if len(data) <= LARGE_BYTES:
            self._put(data, request_id)
            return
        self._behind = []
        try:
            began = time.monotonic()
            for chunk in self._channel.chunks(data, request_id):
                self._connection.send(chunk)
                if time.monotonic() - began > TURN_S:
                    await asyncio.sleep(0)
                    began = time.monotonic()
                if self._connection.over:
                    break
        finally:
            behind, self._behind = self._behind, None
        for waiting in behind:
            self._put(*waiting)

    def _count_refused(self, head: RequestHead, code: int) -> None:
        """Count a refused request for the diagnostics of the server and of its session."""
        statistics, by_security = self._context.statistics, code in _BY_SECURITY
        statistics.requests_refused_by_security += by_security
        if head.kind in (_CREATE, _ACTIVATE):
            statistics.sessions_rejected += 1
            statistics.sessions_rejected_by_security += by_security
        if (session := self._services.sessions.find(head.token)) is not None and session.link is self:
            session.usage.was_refused(head.kind, unauthorized=code == StatusCodes.BadUserAccessDenied)

    def _fault(self, name: str, handle: int, request_id: int, code: int, reason: str) -> None:
        self._context.statistics.requests_refused += 1
        self._context.audit.refuse(self._caller(), name, name_of(code), reason=reason)
        fault = ua.ServiceFault()
        fault.ResponseHeader.ServiceResult = status(code)
        self.respond(fault, handle, request_id)

    def respond(self, response: Any, handle: int, request_id: int) -> None:
        """Send a response, once the large one is out that is being sent."""
        data = self._encoded(response, handle)
        if self._behind is not None:
            self._behind.append((data, request_id))
        else:
            self._put(data, request_id)

    def _put(self, data: bytes, request_id: int) -> None:
        self._channel.respond(data, request_id)
        self._flush()

    def _encoded(self, response: Any, handle: int) -> bytes:
        """The bytes of a response; one that cannot be encoded, or is too long for the client, becomes a fault."""
        try:
            return self._channel.encode(response, handle)
        except DECODE_ERRORS as error:
            fault = ua.ServiceFault()
            long = isinstance(error, OverflowError)
            code = StatusCodes.BadResponseTooLarge if long else StatusCodes.BadEncodingError
            fault.ResponseHeader.ServiceResult = status(code)
            if not long:
                _log.error("response cannot be encoded", response=type(response).__name__, reason=str(error)[:200])
            return self._channel.encode(fault, handle)

    async def _dispatch(self, head: RequestHead, data: bytes, body: Buffer, request_id: int) -> Any:
        """The response to a request, or None when it is answered later; raises errors with a StatusCode."""
        services = self._services.session
        server = self._connection.server_address
        kind = head.kind
        if kind == _GET_ENDPOINTS:
            with self._charged(self.stage is not Stage.AUTHENTICATED):
                return await services.get_endpoints(await _decode_early(ua.GetEndpointsParameters, body), server)
        if kind == _FIND_SERVERS:
            with self._charged(self.stage is not Stage.AUTHENTICATED):
                return services.find_servers(await _decode_early(ua.FindServersParameters, body), server)
        if kind == _CREATE:
            with self._charged(self.stage is not Stage.AUTHENTICATED):
                parameters = await _decode_early(ua.CreateSessionParameters, body)
                return await self._create(head, parameters, server)
        if kind == _ACTIVATE:
            parameters = await _decode_early(ua.ActivateSessionParameters, body)
            return await self._activate(head, parameters)
        service = self._services.table.get(kind)
        if service is None and kind != _CLOSE:
            raise Refusal(StatusCodes.BadServiceUnsupported)
        session = self._session(head.token)
        if service is None:
            delete = bool(_decode_boolean(body))
            response = await services.close(session, delete_subscriptions=delete)
            self.fall_back()
            return response
        if not session.active or session.user is None:
            # OPC 10000-4 5.7.3.1: a session that is used before it is activated is closed.
            await services.end(session, delete_subscriptions=True)
            raise Refusal(StatusCodes.BadSessionNotActivated)
        session.last_seen = time.monotonic()
        session.usage.asked(kind)
        user = session.user

        def refusal() -> Refusal | None:  # who has lost the session, or rights, gets nothing more of this request
            is_gone = self._connection.over
            return Refusal(_GONE, "the client has gone") if is_gone else session.refusal(self, user)

        turns = self._turns = Turns(self._place_of(user), refusal)
        if turns.is_due(len(body)):
            await turns.end(len(body))
        request = ServiceRequest(
            session,
            user,
            session.caller,
            head.handle,
            request_id,
            head.timeout_hint_ms / 1000,
            self._channel.encrypted,
            turns,
            head.audit_entry,
            bool(head.diagnostics & _OPERATION_ADDITIONAL_INFO),
        )
        if service.plan is not None:
            response = await service.plan(request, data, body.cur_pos)
            if response is not None:
                return None if response is ANSWERED_LATER else response
        limits = self._context.limits
        parameters = await decode_parameters(
            service.parameters,
            body,
            most_operations=limits.nodes_per_request,
            most_memory=limits.request_memory_bytes,
            turns=turns,
        )
        return await service.handle(request, parameters)

    def _place_of(self, user: User) -> TurnPlace:
        """The place of the user for large requests."""
        if self._place is None or self._place[0] is not user:
            self._place = user, self._context.places.of(f"at {self.address}" if user.anonymous else user.name)
        return self._place[1]

    async def _create(self, head: RequestHead, parameters: Any, server: tuple[str, int] | None) -> Any:
        channel, tell = self._channel, self._services.events.session_created
        who = Who(self._caller(), head.audit_entry)
        try:
            session, response = await self._services.session.create(self, channel, parameters, server)
        except Exception as error:
            tell(who, channel.channel_id, channel.client_certificate, None, status_of(error) or _INTERNAL)
            raise
        tell(who, channel.channel_id, channel.client_certificate, session)
        self._advance(Stage.SESSION)
        return response

    async def _activate(self, head: RequestHead, parameters: Any) -> Any:
        channel, tell = self._channel, self._services.events.session_activated
        token = parameters.UserIdentityToken
        self._trying = repr(str(getattr(token, "UserName", None) or "")[:_MOST_NAME])
        try:
            session, response = await self._services.session.activate(self, channel, head.token, parameters)
        except Exception as error:
            who, named = Who(Caller(self.peer), head.audit_entry), self._services.sessions.find(head.token)
            tell(who, channel.channel_id, token, named, status_of(error) or _INTERNAL)
            if self.gateway and self.stage is not Stage.AUTHENTICATED:
                self._charge.spend(REFUSED_LOGIN_S, time.monotonic())
            raise
        finally:
            self._trying = ""
        tell(Who(session.caller, head.audit_entry), channel.channel_id, token, session)
        self._charge.repay()
        self._advance(Stage.AUTHENTICATED)
        return response

    def _session(self, token: bytes | None) -> Session:
        """The session of a request; its token is good on its own connection alone."""
        session = self._services.sessions.find(token)
        if session is None:
            raise Refusal(StatusCodes.BadSessionIdInvalid)
        if session.link is not self:
            raise Refusal(StatusCodes.BadSecureChannelIdInvalid, "the session of another channel")
        return session


class _Charged:
    """A context: what is computed in it, without waiting, is spent."""

    __slots__ = ("_began", "_charge")

    def __init__(self, charge: Charge | None) -> None:
        """Spend it of this charge; of none where nobody owes anything."""
        self._charge, self._began = charge, 0.0

    def __enter__(self) -> None:
        self._began = own_time()

    def __exit__(self, *_: object) -> None:
        if self._charge is not None:
            self._charge.spend(own_time() - self._began, time.monotonic())


async def _decode_early(parameters: Any, body: Buffer) -> Any:
    """The parameters of a request that needs no active session."""
    if (plain := decode_session_request(parameters, bytes(body))) is not None:
        return plain
    return await decode_parameters(
        parameters, body, most_operations=OPERATIONS_BEFORE_SESSION, most_memory=BYTES_BEFORE_SESSION
    )


def _decode_boolean(body: Buffer) -> bool:
    if len(body) < 1:
        raise Refusal(StatusCodes.BadDecodingError)
    return body.read(1) != b"\x00"


_NAMES = {
    int(identifier): name.removesuffix("Request_Encoding_DefaultBinary")
    for name, identifier in vars(ObjectIds).items()
    if name.endswith("Request_Encoding_DefaultBinary")
}
