"""Discovery and the session services (OPC 10000-4 5.5 and 5.7)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any, Final

from asyncua import ua
from cryptography import x509

from ua_fleet.endpoint.answers import EncodedResponse
from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.audit_events import AuditEvents, Who
from ua_fleet.endpoint.binary.encoders import EncodedArray, encode_array
from ua_fleet.endpoint.binary.session_responses import activated_response, created_response
from ua_fleet.endpoint.channel import Channel
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.logins import identify
from ua_fleet.endpoint.origin import origin
from ua_fleet.endpoint.places import NoPlace, SessionPlaces, holder_of, standing_of
from ua_fleet.endpoint.sessions import NONCE_BYTES, Session, SessionConnection, Sessions
from ua_fleet.endpoint.signatures import check_signature
from ua_fleet.endpoint.stack import Refusal, StatusCodes
from ua_fleet.endpoint.subscriptions import SubscriptionRegistry
from ua_fleet.endpoint.trust import CertificateRefused
from ua_fleet.endpoint.usage import SessionUsage, shortened
from ua_fleet.endpoint.users import User

__all__ = ["SessionServices"]

_MOST_ENDPOINTS: Final = 64
_LONGEST_URL: Final = 200
"""Characters of an EndpointUrl whose endpoints are kept."""


class SessionServices:
    """What is done before and around a session; also ends sessions."""

    def __init__(
        self, context: EndpointContext, sessions: Sessions, subscriptions: SubscriptionRegistry, events: AuditEvents
    ) -> None:
        self._events = events
        self._context, self._limits = context, context.limits
        self._sessions, self._subscriptions = sessions, subscriptions
        self._places = SessionPlaces(context.limits)
        self._known_endpoints: dict[Any, tuple[list[ua.EndpointDescription], EncodedArray]] = {}
        """Those that were asked for, encoded, with the server's that they were made of."""
        self.activated: Callable[[Session], None] = lambda _session: None
        """Told of a session that is active now."""
        self.ended: Callable[[Session], Awaitable[None]] | None = None
        """Told of a session that has ended."""
        self._without_key = set[str]()
        """Sessions whose session key had ended when it was last looked at."""

    async def get_endpoints(self, params: ua.GetEndpointsParameters, server: tuple[str, int] | None) -> Any:
        """GetEndpoints, on any channel."""
        return EncodedResponse(ua.GetEndpointsResponse, await self._endpoints(params, server))

    async def _endpoints(self, params: ua.GetEndpointsParameters, server: tuple[str, int] | None) -> EncodedArray:
        """The endpoints as a client that has asked for this URL at that address sees them."""
        key = params.EndpointUrl, server, tuple(params.ProfileUris or ())
        endpoints = self._context.iserver.endpoints
        known = self._known_endpoints.get(key)
        if known is not None and known[0] == endpoints:
            return known[1]
        made = await self._context.iserver.get_endpoints(params, sockname=server)
        profiles = set(params.ProfileUris or [])
        data = encode_array([each for each in made if not profiles or each.TransportProfileUri in profiles])
        if len(self._known_endpoints) >= _MOST_ENDPOINTS:
            self._known_endpoints.clear()
        if len(params.EndpointUrl or "") <= _LONGEST_URL and not profiles:
            self._known_endpoints[key] = list(endpoints), data
        return data

    def find_servers(self, params: ua.FindServersParameters, server: tuple[str, int] | None) -> Any:
        """FindServers, on any channel: this server alone, since nobody can register."""
        response = ua.FindServersResponse()
        # asyncua splits each of them; a null one names no server.
        params.ServerUris = [uri or "" for uri in params.ServerUris]  # pyright: ignore[reportAttributeAccessIssue]
        response.Servers = self._context.iserver.find_servers(params, sockname=server)
        return response

    async def create(
        self,
        link: SessionConnection,
        channel: Channel,
        params: ua.CreateSessionParameters,
        server: tuple[str, int] | None,
    ) -> tuple[Session, Any]:
        """CreateSession: a session that nobody may use yet."""
        if not channel.sessions_allowed:
            raise Refusal(StatusCodes.BadSecurityModeInsufficient, "a session without security")
        certificate = channel.client_certificate
        application = params.ClientDescription.ApplicationUri or ""
        if channel.secured:
            given = params.ClientCertificate or b""
            if given[: len(certificate)] != certificate:
                raise Refusal(StatusCodes.BadCertificateInvalid, "another certificate than the channel's")
            if len(params.ClientNonce or b"") < NONCE_BYTES:
                raise Refusal(StatusCodes.BadNonceInvalid)
            self._check_certificate(channel)
            try:
                self._context.trust.check_uri(channel.chain[0], application)
            except CertificateRefused as error:
                raise Refusal(error.ua_status, str(error)) from error
        held = self._sessions.holders() if len(self._sessions) >= self._limits.sessions else ()
        if len(held) >= self._limits.sessions and all(holder.detached_at is None for holder in held):
            # Whose session it will be is not known yet; what is known is that nothing can give way for it.
            self._context.statistics.sessions_refused += 1
            raise Refusal(StatusCodes.BadTooManySessions, f"{len(held)} sessions, server.max_sessions")
        waiting = [session for session in self._sessions.on(link) if not session.active]
        for session in waiting[: max(len(waiting) + 1 - self._limits.inactive_sessions, 0)]:
            await self.end(session, delete_subscriptions=True)
        least, most = self._limits.session_timeout_s
        wish = float(params.RequestedSessionTimeout or most * 1000) / 1000
        timeout_s = min(max(wish, least), most) if wish == wish else least
        usage = SessionUsage(
            name=shortened(params.SessionName),
            product_uri=shortened(params.ClientDescription.ProductUri),
            application_name=shortened(params.ClientDescription.ApplicationName.Text),
            application_type=int(params.ClientDescription.ApplicationType),
            server_uri=shortened(params.ServerUri),
            endpoint_url=shortened(params.EndpointUrl),
            security_mode=int(channel.policy.Mode),
            security_policy=channel.policy.URI,
        )
        most_bytes = int(params.MaxResponseMessageSize or 0)
        session = Session(link, certificate, application, timeout_s, most_bytes, usage=usage)
        self._sessions.add(session)
        self._context.statistics.sessions += 1
        return session, await self._created(session, channel, params, server)

    async def _created(
        self,
        session: Session,
        channel: Channel,
        params: ua.CreateSessionParameters,
        server: tuple[str, int] | None,
    ) -> Any:
        wanted = ua.GetEndpointsParameters()
        wanted.EndpointUrl = params.EndpointUrl
        endpoints = await self._endpoints(wanted, server)
        signed = channel.client_certificate + (params.ClientNonce or b"")
        signature = channel.policy.asymmetric_cryptography.signature(signed)
        return created_response(session, endpoints, channel.policy, signature, self._limits.message_bytes)

    def _check_certificate(self, channel: Channel) -> None:
        try:
            channel.check_certificate()
        except CertificateRefused as error:
            raise Refusal(StatusCodes.BadSecurityChecksFailed, str(error)) from error

    async def activate(
        self, link: SessionConnection, channel: Channel, token: bytes | None, params: ua.ActivateSessionParameters
    ) -> tuple[Session, Any]:
        """ActivateSession: everything is checked first, then the session is bound; a refusal changes nothing."""
        session = self._sessions.find(token)
        if session is None or session.closed:
            raise Refusal(StatusCodes.BadSessionIdInvalid, "no such session")
        if not channel.sessions_allowed:
            raise Refusal(StatusCodes.BadSecurityModeInsufficient, "a session without security")
        before = session.link
        # Only an active session is taken along to a new channel, and only by the certificate that it belongs to.
        # Without security its token is all that tells whose it is; so it stays at the address that has it.
        same = channel.secured and session.client_certificate == channel.client_certificate
        same = same or (
            not channel.secured and not session.client_certificate and origin(session.address) == origin(link.address)
        )
        if before is not link and not session.active:
            raise Refusal(StatusCodes.BadSessionNotActivated, "first activated on another channel than its own")
        if before is not link and not same:
            raise Refusal(StatusCodes.BadSessionIdInvalid, "the session of another channel")
        self._check_certificate(channel)
        if channel.secured:
            code = StatusCodes.BadApplicationSignatureInvalid
            check_signature(channel.policy, params.ClientSignature, session.nonce, code, may_be_unnamed=True)
        nonce = session.nonce
        gateway = self._context.trust.gateways.name_of(channel.chain[0]) if channel.secured else ""
        user = await identify(
            self._context, channel, params, nonce=nonce, address=origin(link.address), gateway=gateway
        )
        # The password was checked in a thread; meanwhile another request may have changed the session.
        if session.closed or session.link is not before or session.nonce is not nonce:
            raise Refusal(StatusCodes.BadSessionIdInvalid, "the session changed during its activation")
        if before is not link and (session.user is None or session.user.name != user.name):
            raise Refusal(StatusCodes.BadIdentityChangeNotSupported, "another user's session")
        same_user = session.user is not None and session.user.name == user.name
        giving_way = [] if same_user else self._room_for(session, user, link.address)
        if before is not link:
            session.refuse_requests(StatusCodes.BadSecureChannelClosed)
            session.unbind()
        session.bind(link)
        session.user, session.gateway = user, gateway
        session.usage.used_by(user.name, by_certificate=bool(user.bridge))
        with self._context.mistakes.guard("diagnostics"):
            self.activated(session)
        session.usage.speaks(params.LocaleIds or [])
        session.usage.security_mode, session.usage.security_policy = int(channel.policy.Mode), channel.policy.URI
        session.last_seen = time.monotonic()
        # Bound before anything is awaited: of two that come at once, the second one finds the place taken.
        for old in giving_way:
            self._context.statistics.session_aborts += 1
            self._context.statistics.sessions_evicted += bool(old.subscriptions)
            self._context.audit.record("logout", old.caller, "BadSessionClosed", reason="made room for a newer session")
            await self.end(old, delete_subscriptions=True)
        self._context.statistics.logins += 1
        by = {"session_key": user.session_key} if user.session_key else {}
        by |= {"gateway": gateway} if gateway else {}
        self._context.audit.record("login", session.caller, "Good", application=session.application[:200], **by)
        return session, activated_response(session.new_nonce())

    def _room_for(self, session: Session, user: User, address: str) -> list[Session]:
        """The detached sessions that have to end for one more of this user; raises Refusal."""
        if self._places.has_room(len(self._sessions)):
            return []
        held = [holder for holder in self._sessions.holders() if holder.key is not session]
        try:
            return self._places.make_room(held, holder_of(user, address), standing_of(user))
        except NoPlace as error:
            self._context.statistics.sessions_refused += 1
            raise Refusal(StatusCodes.BadTooManySessions, f"session of {user.name}: {error}") from error

    async def close(self, session: Session, *, delete_subscriptions: bool) -> Any:
        """CloseSession."""
        self._context.audit.record("logout", session.caller, "Good")
        await self.end(session, delete_subscriptions=delete_subscriptions, cause="CloseSession")
        return EncodedResponse(ua.CloseSessionResponse)

    async def end(self, session: Session, *, delete_subscriptions: bool, cause: str = "Terminated") -> None:
        """End a session. Subscriptions that are left wait for a transfer, as many as one session may have."""
        session.closed = True
        self._events.session_ended(Who(session.caller), session, cause)
        self._sessions.remove(session)
        self._depart(session)
        session.refuse_requests(StatusCodes.BadSessionClosed)
        user = session.user
        for subscription in list(session.subscriptions.values()):
            if session.subscriptions.get(subscription.id) is not subscription:
                continue  # while another one was ended, it has ended too, or another session has taken it over
            kept = user is not None and self._subscriptions.orphans(user) < self._limits.subscriptions_per_session
            if delete_subscriptions or not kept or subscription.owner.anonymous:
                await self._subscriptions.delete(subscription)
            else:
                session.subscriptions.pop(subscription.id)
                subscription.session = None
        session.unbind()
        session.continuations.clear()
        if self.ended is not None:
            with self._context.mistakes.guard("diagnostics"):
                await self.ended(session)

    async def lost(self, link: SessionConnection) -> None:
        """A connection is gone: active sessions wait for their client until their timeout, the others end."""
        for session in self._sessions.on(link):
            if session.active:
                session.unbind()
                self._depart(session)
            else:
                self._context.statistics.session_aborts += 1
                await self.end(session, delete_subscriptions=True)

    def _depart(self, session: Session) -> None:
        for tell in self._context.departed:
            with self._context.mistakes.guard("departures"):
                tell(session.key)

    async def end_overdue(self) -> None:
        """End the sessions whose clients have been silent for too long, and those of removed users."""
        for session in self._sessions.overdue(time.monotonic()):
            self._context.audit.record("logout", session.caller, "BadTimeout")
            self._context.statistics.session_timeouts += 1
            await self.end(session, delete_subscriptions=True, cause="Timeout")

    async def follow_users(self) -> None:
        """The users file has changed: removed users lose their sessions, changed roles hold at once."""
        for session in self._sessions:
            if session.user is None or session.user.anonymous or session.user.bridge:
                continue
            user = self._context.users.get(session.user.name)
            if user is None:
                self._context.audit.record("logout", session.caller, "BadUserAccessDenied", reason="user removed")
                await self.end(session, delete_subscriptions=True)
            else:
                session.user = replace(user, session_key=session.user.session_key)

    async def follow_session_keys(self) -> None:
        """Sessions end with the session key that they were opened with: revoked, too old, or of an old password.

        They do so when found a second time: the first time, the answer to who revokes his own key may be on its way.
        """
        keys, now = self._context.session_keys, time.time()
        without = [one for one in self._sessions if one.user is not None and not keys.holds(one.user, now)]
        found_before, self._without_key = self._without_key, {session.key for session in without}
        for session in without:
            if session.key in found_before and not session.closed:
                reason = f"session key {session.user.session_key if session.user else ''} has ended"
                self._context.audit.record("logout", session.caller, "BadUserAccessDenied", reason=reason)
                await self.end(session, delete_subscriptions=True)
        for key in keys.drain_gone(now):
            self._context.audit.record(
                "session_key", Caller("server", key.user), "Good", what="revoked", key=key.id, name=key.name
            )

    async def follow_bridges(self) -> None:
        """The folder of bridges' certificates has changed: who is not known by his any more loses his sessions."""
        bridges = self._context.bridges
        for session in self._sessions:
            if session.user is None or not session.user.bridge or bridges is None:
                continue
            certificate = x509.load_der_x509_certificate(session.client_certificate)
            if bridges.name_of(certificate) != session.user.bridge:
                self._context.audit.record("logout", session.caller, "BadUserAccessDenied", reason="bridge revoked")
                await self.end(session, delete_subscriptions=True)

    async def follow_gateways(self) -> None:
        """The folder of gateways has changed: the sessions through one that is not trusted any more end."""
        trust = self._context.trust
        for session in self._sessions:
            if not session.gateway:
                continue
            certificate = x509.load_der_x509_certificate(session.client_certificate)
            session.gateway = trust.gateways.name_of(certificate)
            if session.gateway:
                continue
            try:
                trust.check([certificate])
            except CertificateRefused:
                self._context.audit.record("logout", session.caller, "BadUserAccessDenied", reason="gateway revoked")
                await self.end(session, delete_subscriptions=True)
