"""Sessions: made on one SecureChannel, used on that one alone, and moved to another only by their owner.

    created --activate (certificate, signature and user right)--> active --close, timeout--> closed

A refused ActivateSession changes nothing: the request is checked in full before anything is bound. An active session
outlives its connection until its timeout, or until its place is needed (see places.py): it may be activated again from
a new channel, when the client's certificate, its signature and the user are those that the session has. Without
security there is no such proof; there the user and the address must be the same.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import secrets
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

from asyncua import ua

from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.notifications import publish_response
from ua_fleet.endpoint.places import Holder, holder_of, standing_of
from ua_fleet.endpoint.stack import Refusal, StatusCodes, guid_id, opaque_id, status
from ua_fleet.endpoint.usage import SessionUsage
from ua_fleet.endpoint.users import User

if TYPE_CHECKING:
    from ua_fleet.endpoint.subscriptions import ClientSubscription

__all__ = ["PublishRequest", "Session", "SessionConnection", "Sessions", "current_session"]

current_session: ContextVar[Session | None] = ContextVar("current_session", default=None)
"""The caller's session, while the implementation of a method runs."""

TOKEN_BYTES: Final = 32
NONCE_BYTES: Final = 32
"""OPC 10000-4 5.6.2.2: at least 32."""


_AROUND_BYTES: Final = 2_048
"""Of a PublishResponse besides its notifications: header, sequence numbers, and results of acknowledgements."""


_MOST_FAREWELLS: Final = 50


class SessionConnection(Protocol):
    """The connection that a session is bound to."""

    peer: str
    address: str

    @property
    def writable(self) -> bool:
        """Whether the client keeps up."""
        ...

    @property
    def response_bytes(self) -> int:
        """Bytes that the client takes in one response; 0 for any number."""
        ...

    def respond(self, response: Any, handle: int, request_id: int) -> None:
        """Send a response; one of more bytes than the client takes as a fault."""
        ...


@dataclass(slots=True)
class PublishRequest:
    """A Publish request that waits for something to send."""

    handle: int
    request_id: int
    expires_at: float
    results: bytes
    """Of its acknowledgements, encoded."""


@dataclass(slots=True, eq=False)
class Session:
    """One client's session."""

    link: SessionConnection | None
    client_certificate: bytes
    application: str
    timeout_s: float
    most_response_bytes: int = 0
    """MaxResponseMessageSize of the client; 0 for any size. Notification messages are no larger.

    Other responses may be: node-opcua always says 800,000 and takes 64 MiB. What Hello says is what it really takes.
    """
    token: bytes = field(default_factory=lambda: secrets.token_bytes(TOKEN_BYTES))
    session_id: ua.NodeId = field(default_factory=lambda: guid_id(uuid.uuid4(), 1))
    nonce: bytes = field(default_factory=lambda: secrets.token_bytes(NONCE_BYTES))
    user: User | None = None
    """Set while the session is active."""
    gateway: str = ""
    """Name of the gateway through which its user has come; empty for an ordinary client."""
    closed: bool = False
    last_seen: float = field(default_factory=time.monotonic)
    last_peer: str = ""
    last_address: str = ""
    detached_at: float | None = None
    """When its connection was lost; None while it has one."""
    subscriptions: dict[int, ClientSubscription] = field(default_factory=dict)
    late: OrderedDict[int, None] = field(default_factory=OrderedDict)
    """Ids of subscriptions that have something to send and no request to send it with."""
    requests: deque[PublishRequest] = field(default_factory=deque)
    farewells: deque[tuple[int, bytes]] = field(
        default_factory=lambda: deque[tuple[int, bytes]](maxlen=_MOST_FAREWELLS)
    )
    """Last messages of subscriptions that it has no more, with their ids; each goes with the next Publish request."""
    continuations: OrderedDict[bytes, list[Any]] = field(default_factory=OrderedDict)
    calls_aside: int = 0
    """Its calls that are answered later."""
    usage: SessionUsage = field(default_factory=SessionUsage)
    """What its diagnostics tell."""
    _caller: tuple[Caller, SessionConnection | None, User | None] | None = None
    """What `caller` has said last, and of which connection and user."""

    @property
    def active(self) -> bool:
        """Whether services other than activation may be used."""
        return self.user is not None and not self.closed

    @property
    def auth_token(self) -> ua.NodeId:
        """The AuthenticationToken, known to this client alone."""
        return opaque_id(self.token)

    @property
    def key(self) -> str:
        """The session for other parts of the server; nobody can use it with this."""
        return str(self.session_id.Identifier)

    @property
    def label(self) -> str:
        """Short name of the session for logs; its token is never shown."""
        return str(self.session_id.Identifier)[:8]

    @property
    def caller(self) -> Caller:
        """The session for a line of the audit log."""
        known, link, user = self._caller, self.link, self.user
        if known is not None and known[1] is link and known[2] is user:
            return known[0]
        peer = link.peer if link is not None else self.last_peer
        who = ("", "") if user is None else (user.name, user.shown_role)
        caller = Caller(peer, *who, session=self.label)
        self._caller = caller, link, user
        return caller

    @property
    def address(self) -> str:
        """Address of the client, the last one while there is none."""
        return self.link.address if self.link is not None else self.last_address

    def refusal(self, link: SessionConnection, user: User) -> Refusal | None:
        """Why a request of this user on that connection is not to go on; None while it is."""
        if self.closed:
            return Refusal(StatusCodes.BadSessionClosed, "the session has ended")
        if self.link is not link:
            return Refusal(StatusCodes.BadSecureChannelClosed, "the session has moved to another channel")
        # Equal, not the same: each change of the users file gives all sessions their users anew.
        if self.user != user:
            return Refusal(StatusCodes.BadUserAccessDenied, "the user's rights have changed")
        return None

    def room(self, wish: int) -> int:
        """Bytes of `wish` after which a notification message is full for this client; its last part may have more."""
        limits = (self.most_response_bytes, self.link.response_bytes if self.link is not None else 0)
        return _within(wish, limits)

    def room_for_one(self, wish: int) -> int:
        """Bytes of `wish` that one notification may have for this client."""
        return _within(wish, (self.link.response_bytes if self.link is not None else 0,))

    def bind(self, link: SessionConnection) -> None:
        """The client has come, or come back, on this connection."""
        self.link = link
        self.detached_at = None

    def new_nonce(self) -> bytes:
        """A fresh nonce for the next activation."""
        self.nonce = secrets.token_bytes(NONCE_BYTES)
        return self.nonce

    def unbind(self) -> None:
        """The connection is gone; its requests with it."""
        if self.link is not None:
            self.last_peer, self.last_address = self.link.peer, self.link.address
            self.detached_at = time.monotonic()
        self.link = self._caller = None
        self.requests.clear()

    @property
    def has_request(self) -> bool:
        """Whether a Publish request waits that can be answered now."""
        if self.link is None or not self.link.writable:
            return False
        self.drop_expired_requests()
        return bool(self.requests)

    def take_request(self, subscription_id: int) -> PublishRequest | None:
        """A Publish request to answer; without one the subscription is remembered as late."""
        if self.has_request:
            self.late.pop(subscription_id, None)
            return self.requests.popleft()
        self.late[subscription_id] = None
        return None

    def say_farewell(self, subscription_id: int, message: bytes) -> None:
        """Send the last message of a subscription, encoded: now if a Publish request waits."""
        if not self.has_request:
            self.farewells.append((subscription_id, message))
            return
        request = self.requests.popleft()
        self.answer_with_farewell(request, subscription_id, message)

    def answer_with_farewell(self, request: PublishRequest, subscription_id: int, message: bytes) -> None:
        """Answer a Publish request with the last message of a subscription."""
        if self.link is not None:
            response = publish_response(subscription_id, message, request.results)
            self.link.respond(response, request.handle, request.request_id)

    def refuse_requests(self, code: int) -> None:
        """Answer all Publish requests that wait with a fault."""
        while self.requests:
            self.refuse_request(self.requests.popleft(), code)

    def drop_expired_requests(self) -> None:
        """Answer the Publish requests whose time is over with Bad_Timeout."""
        now = time.monotonic()
        while self.requests and self.requests[0].expires_at < now:
            self.refuse_request(self.requests.popleft(), StatusCodes.BadTimeout)

    def refuse_request(self, request: PublishRequest, code: int) -> None:
        """Answer a Publish request with a fault."""
        if self.link is not None:
            fault = ua.ServiceFault()
            fault.ResponseHeader.ServiceResult = status(code)
            self.link.respond(fault, request.handle, request.request_id)


def _within(wish: int, limits: tuple[int, ...]) -> int:
    return min([wish, *(max((limit - _AROUND_BYTES) // 2, 1) for limit in limits if limit)])


class Sessions:
    """All sessions of the server, by token."""

    def __init__(self) -> None:
        self._by_token: dict[bytes, Session] = {}

    def __iter__(self) -> Iterator[Session]:
        return iter(list(self._by_token.values()))

    def __len__(self) -> int:
        return len(self._by_token)

    @property
    def active(self) -> int:
        """Number of active sessions."""
        return sum(session.active for session in self._by_token.values())

    def add(self, session: Session) -> None:
        """Keep a new session."""
        self._by_token[session.token] = session

    def remove(self, session: Session) -> None:
        """Forget a closed session."""
        self._by_token.pop(session.token, None)

    def find(self, token: bytes | None) -> Session | None:
        """The session with this AuthenticationToken. Tokens have 256 random bits, so a lookup tells nothing."""
        return self._by_token.get(token) if token is not None else None

    def on(self, link: SessionConnection) -> list[Session]:
        """The sessions that are bound to a connection."""
        return [session for session in self._by_token.values() if session.link is link]

    def holders(self) -> list[Holder[Session]]:
        """The active sessions, as holders of places."""
        return [
            Holder(
                session,
                holder_of(session.user, session.address),
                standing_of(session.user),
                session.detached_at,
                bool(session.subscriptions),
            )
            for session in self._by_token.values()
            if session.user is not None and not session.closed
        ]

    def overdue(self, now: float) -> list[Session]:
        """Sessions whose client has been silent for longer than their timeout."""
        return [session for session in self._by_token.values() if now - session.last_seen > session.timeout_s]
