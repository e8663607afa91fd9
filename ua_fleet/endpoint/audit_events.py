"""AuditEvents of the Server object, for engineers alone (OPC 10000-5 6.4.3 to 6.4.27, OPC 10000-4 6.5).

They say live what the audit log keeps: channels, sessions, writes and method calls, done and refused. Other users are
never told, whatever their monitored items ask for. Refusals have the same allowances as in the log, so that a client
that is refused without end does not push other events out of an engineer's queue; the log has the sums. What operators
and engineers change is told in full, and kept in the history within the log's allowance of it.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.common.events import Event

from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.audit.allowance import CHANGES, Allowances
from ua_fleet.endpoint.kept_events import MOST_FIELD_BYTES, MOST_STRANGER_BYTES
from ua_fleet.endpoint.sessions import Session
from ua_fleet.endpoint.stack import ObjectIds, StatusCodes, name_of, ns0, shown
from ua_fleet.endpoint.subscriptions import SubscriptionRegistry
from ua_fleet.endpoint.users import Role, User

__all__ = ["AuditEvents", "ChannelOpened", "Who"]

_SERVER: Final = ns0(ObjectIds.Server)
_DONE: Final = 100
_REFUSED: Final = 500
"""Severities of what was done and of what was refused."""
_MOST_BYTES: Final = 4_096
"""A value that is larger is null in the event: each engineer's queue would keep it."""
_MOST_NODE_ID: Final = 200
_CHANGERS: Final = (Role.OPERATOR.value, Role.ENGINEER.value)

_CERTIFICATE_TYPES: Final[dict[int, int]] = {
    int(StatusCodes.BadCertificateTimeInvalid): ObjectIds.AuditCertificateExpiredEventType,
    int(StatusCodes.BadCertificateIssuerTimeInvalid): ObjectIds.AuditCertificateExpiredEventType,
    int(StatusCodes.BadCertificateUntrusted): ObjectIds.AuditCertificateUntrustedEventType,
    int(StatusCodes.BadCertificateRevoked): ObjectIds.AuditCertificateRevokedEventType,
    int(StatusCodes.BadCertificateUseNotAllowed): ObjectIds.AuditCertificateMismatchEventType,
}
"""OPC 10000-5 6.4.14 to 6.4.18; all others are invalid ones."""

_Field = tuple[str, Any, ua.VariantType]


@dataclass(frozen=True, slots=True)
class Who:
    """Who asked."""

    caller: Caller
    entry: str = ""
    """AuditEntryId of the request."""


@dataclass(frozen=True, slots=True)
class ChannelOpened:
    """What an OpenSecureChannel asked for."""

    channel_id: int
    certificate: bytes
    renewal: bool
    policy_uri: str
    mode: int
    lifetime_ms: float


def _is_engineer(user: User) -> bool:
    return user.role.covers(Role.ENGINEER)


class AuditEvents:
    """Tells engineers who have subscribed to the Server object's events."""

    def __init__(
        self,
        subscriptions: SubscriptionRegistry,
        server_id: Callable[[], str],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make it.

        Args:
            subscriptions: all that there are.
            server_id: says the ServerId, the server's ApplicationUri.
            clock: for the allowances.
        """
        self._subscriptions, self._server_id, self._clock = subscriptions, server_id, clock
        self._allowances, self._kept_changes = Allowances(), Allowances(CHANGES)

    @property
    def wanted(self) -> bool:
        """Whether an engineer listens, or they are kept; otherwise nothing needs to be made."""
        return self._is_kept or bool(self._subscriptions.audience(_SERVER, _is_engineer))

    @property
    def _is_kept(self) -> bool:
        keeper = self._subscriptions.keeper
        return keeper is not None and keeper.audit

    def channel(self, who: Who, opened: ChannelOpened, code: int = 0) -> None:
        """OpenSecureChannel (6.4.6)."""
        if not self.wanted:
            return
        thumbprint = hashlib.sha1(opened.certificate).hexdigest() if opened.certificate else ""  # noqa: S324 - its name
        request_type = ua.SecurityTokenRequestType.Renew if opened.renewal else ua.SecurityTokenRequestType.Issue
        self._emit(
            ObjectIds.AuditOpenSecureChannelEventType,
            "SecureChannel/OpenSecureChannel",
            who,
            code,
            user="System/OpenSecureChannel",
            fields=[
                ("SecureChannelId", str(opened.channel_id), ua.VariantType.String),
                ("ClientCertificate", opened.certificate, ua.VariantType.ByteString),
                ("ClientCertificateThumbprint", thumbprint, ua.VariantType.String),
                ("RequestType", int(request_type), ua.VariantType.Int32),
                ("SecurityPolicyUri", opened.policy_uri, ua.VariantType.String),
                ("SecurityMode", opened.mode, ua.VariantType.Int32),
                ("RequestedLifetime", opened.lifetime_ms, ua.VariantType.Double),
            ],
        )

    def certificate(self, who: Who, certificate: bytes, code: int) -> None:
        """A client's certificate was refused (6.4.12)."""
        kind = _CERTIFICATE_TYPES.get(code, ObjectIds.AuditCertificateInvalidEventType)
        field: _Field = ("Certificate", certificate, ua.VariantType.ByteString)
        self._emit(kind, "Security/Certificate", who, code, user="System/OpenSecureChannel", fields=[field])

    def session_created(
        self, who: Who, channel_id: int, certificate: bytes, session: Session | None, code: int = 0
    ) -> None:
        """CreateSession (6.4.8); without a session it was refused."""
        if not self.wanted:
            return
        thumbprint = hashlib.sha1(certificate).hexdigest() if certificate else ""  # noqa: S324 - its name
        self._emit(
            ObjectIds.AuditCreateSessionEventType,
            "Session/CreateSession",
            who,
            code,
            user="System/CreateSession",
            fields=[
                _session_id(session),
                ("SecureChannelId", str(channel_id), ua.VariantType.String),
                ("ClientCertificate", certificate, ua.VariantType.ByteString),
                ("ClientCertificateThumbprint", thumbprint, ua.VariantType.String),
                ("RevisedSessionTimeout", session.timeout_s * 1000 if session else 0.0, ua.VariantType.Double),
            ],
        )

    def session_activated(self, who: Who, channel_id: int, token: Any, session: Session | None, code: int = 0) -> None:
        """ActivateSession (6.4.10). The password is left out."""
        if not self.wanted:
            return
        shown_token, user = _without_secret(token)
        self._emit(
            ObjectIds.AuditActivateSessionEventType,
            "Session/ActivateSession",
            who,
            code,
            user=who.caller.user or user,
            fields=[
                _session_id(session),
                ("SecureChannelId", str(channel_id), ua.VariantType.String),
                ("UserIdentityToken", shown_token, ua.VariantType.ExtensionObject),
                ("ClientSoftwareCertificates", [], ua.VariantType.ExtensionObject),
            ],
        )

    def session_ended(self, who: Who, session: Session, cause: str) -> None:
        """A session is over (6.4.7): `CloseSession`, `Timeout` or `Terminated`."""
        if not self.wanted:
            return
        self._emit(ObjectIds.AuditSessionEventType, f"Session/{cause}", who, 0, fields=[_session_id(session)])

    def written(self, who: Who, wanted: ua.WriteValue, old: ua.Variant | None, code: int) -> None:
        """A value was written, or not (6.4.26)."""
        given = wanted.Value.Value if wanted.Value is not None else None
        self._emit(
            ObjectIds.AuditWriteUpdateEventType,
            "Attribute/Write",
            who,
            code,
            source=wanted.NodeId,
            changes=True,
            fields=[
                ("AttributeId", int(wanted.AttributeId), ua.VariantType.UInt32),
                ("IndexRange", (wanted.IndexRange or "")[:_MOST_NODE_ID], ua.VariantType.String),
                _value("OldValue", old),
                _value("NewValue", given),
            ],
        )

    def called(self, who: Who, wanted: ua.CallMethodRequest, outputs: Sequence[Any], code: int) -> None:
        """A method was called, or not (6.4.27)."""
        arguments = ua.VariantType.Variant
        self._emit(
            ObjectIds.AuditUpdateMethodEventType,
            "Attribute/Call",
            who,
            code,
            source=wanted.ObjectId,
            changes=True,
            fields=[
                ("MethodId", _short(wanted.MethodId), ua.VariantType.NodeId),
                ("StatusCodeId", ua.StatusCode(ua.UInt32(code)), ua.VariantType.StatusCode),
                ("InputArguments", _small_ones(wanted.InputArguments or []), arguments),
                ("OutputArguments", _small_ones(outputs), arguments),
            ],
        )

    def _emit(
        self,
        event_type: int,
        source_name: str,
        who: Who,
        code: int,
        *,
        fields: Sequence[_Field],
        source: ua.NodeId = _SERVER,
        user: str = "",
        changes: bool = False,
    ) -> None:
        audience = self._subscriptions.audience(_SERVER, _is_engineer)
        keeper = self._subscriptions.keeper if self._is_kept else None
        caller, is_good = who.caller, code == 0
        if not (audience or keeper):
            return
        if not (changes and is_good and caller.role in _CHANGERS):
            if not self._allowances.take(caller, source_name, self._clock()):
                return
        elif keeper is not None and not self._kept_changes.take(caller, source_name, self._clock()):
            keeper.left_out += 1
            keeper = None
            if not audience:
                return
        now = datetime.now(UTC)
        by = user or caller.user or caller.client
        what = f"{source_name} of {shown(source)}" if source is not _SERVER else source_name
        event = Event(_SERVER)
        common: Sequence[_Field] = (
            ("EventId", secrets.token_bytes(16), ua.VariantType.ByteString),
            ("EventType", ns0(event_type), ua.VariantType.NodeId),
            ("SourceNode", _short(source), ua.VariantType.NodeId),
            ("SourceName", source_name, ua.VariantType.String),
            ("Time", now, ua.VariantType.DateTime),
            ("ReceiveTime", now, ua.VariantType.DateTime),
            (
                "Message",
                ua.LocalizedText(f"{what} by {by} from {caller.client}: {name_of(code)}"),
                ua.VariantType.LocalizedText,
            ),
            ("Severity", _DONE if is_good else _REFUSED, ua.VariantType.UInt16),
            ("ActionTimeStamp", now, ua.VariantType.DateTime),
            ("Status", is_good, ua.VariantType.Boolean),
            ("ServerId", self._server_id(), ua.VariantType.String),
            ("ClientAuditEntryId", who.entry, ua.VariantType.String),
            ("ClientUserId", user or caller.user, ua.VariantType.String),
        )
        for name, value, kind in (*common, *fields):
            event.add_property(name, value, kind)
        if keeper is not None:
            most_bytes = MOST_STRANGER_BYTES if caller.is_stranger else MOST_FIELD_BYTES
            keeper.keep(event, is_audit=True, most_bytes=most_bytes)
        for subscription in audience:
            subscription.items.tell(event)


def _session_id(session: Session | None) -> _Field:
    return "SessionId", session.session_id if session is not None else ua.NodeId(), ua.VariantType.NodeId


def _without_secret(token: Any) -> tuple[Any, str]:
    """A UserIdentityToken without what proves it, and the name that it states."""
    if isinstance(token, ua.UserNameIdentityToken):
        name = (token.UserName or "")[:_MOST_NODE_ID]
        return ua.UserNameIdentityToken(PolicyId=token.PolicyId, UserName=name), name  # pyright: ignore[reportArgumentType]
    if isinstance(token, ua.X509IdentityToken):
        kept = (token.CertificateData or b"")[:_MOST_BYTES]
        return ua.X509IdentityToken(PolicyId=token.PolicyId, CertificateData=kept), ""  # pyright: ignore[reportArgumentType]
    return ua.AnonymousIdentityToken(), ""


def _short(node_id: ua.NodeId) -> ua.NodeId:
    """A NodeId, or the null one for what a client has made too long to be kept."""
    identifier = node_id.Identifier
    return ua.NodeId() if isinstance(identifier, str | bytes) and len(identifier) > _MOST_NODE_ID else node_id


def _size(value: Any) -> int:
    """Roughly the bytes of a value; it stops counting when it is enough."""
    if isinstance(value, str | bytes):
        return len(value)
    if isinstance(value, list | tuple):
        total = 0
        for each in value:
            total += _size(each)
            if total > _MOST_BYTES:
                break
        return total
    if isinstance(value, int | float | bool | None | datetime):
        return 8
    # A structure: what it has, but not how deep.
    return sum(_size(each) for each in vars(value).values()) if hasattr(value, "__dict__") else 16


def _small(variant: Any) -> ua.Variant:
    """A value as it is, or null where it is too large for an event."""
    if not isinstance(variant, ua.Variant) or variant.Value is None or _size(variant.Value) > _MOST_BYTES:
        return ua.Variant()
    return variant


def _value(name: str, variant: ua.Variant | None) -> _Field:
    kept = _small(variant)
    return name, kept.Value, kept.VariantType


def _small_ones(values: Sequence[Any]) -> list[ua.Variant]:
    """Arguments; all of them together are as bounded as one value."""
    left, kept = _MOST_BYTES, list[ua.Variant]()
    for value in values:
        small = _small(value)
        left -= _size(small.Value)
        kept.append(small if left >= 0 else ua.Variant())
    return kept
