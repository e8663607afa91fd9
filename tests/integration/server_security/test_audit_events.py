"""AuditEvents: with their standard fields, to engineers, and to nobody else."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncGenerator, Sequence
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import (
    SERVER_URI,
    Client,
    Door,
    Identities,
    bad,
    door,
    send,
    ua,
)
from tests.waiting import until
from ua_fleet.endpoint.audit.allowance import AT_ONCE
from ua_fleet.endpoint.users import Role

pytestmark = pytest.mark.asyncio(loop_scope="module")

TYPES = (
    "AuditOpenSecureChannelEventType",
    "AuditCreateSessionEventType",
    "AuditActivateSessionEventType",
    "AuditSessionEventType",
    "AuditWriteUpdateEventType",
    "AuditUpdateMethodEventType",
    "AuditCertificateUntrustedEventType",
)


class Events:
    """Collects what a subscription tells."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.seen.append(event)

    def of(self, kind: str) -> list[Any]:
        return [event for event in self.seen if event.EventType == ua.NodeId(getattr(ua.ObjectIds, kind))]

    async def first(self, kind: str, count: int = 1) -> Any:
        await until(lambda: len(self.of(kind)) >= count, f"{count} {kind}")
        return self.of(kind)[-1]


async def listen(client: Client, types: Sequence[str] = TYPES, *, where: bool = True) -> Events:
    """Listen to the Server object; without `where` to all events, whatever their type."""
    events = Events()
    subscription = await client.create_subscription(10, events)
    kinds = [getattr(ua.ObjectIds, kind) for kind in types]
    await subscription.subscribe_events(ua.ObjectIds.Server, kinds, where_clause_generation=where)
    return events


@pytest_asyncio.fixture(loop_scope="module")
async def told(hardened: Door) -> AsyncGenerator[Events]:
    """What an engineer is told."""
    async with hardened.connected("eva") as engineer:
        yield await listen(engineer)


def is_engineer(session: Any) -> bool:
    return bool(session.user.role is Role.ENGINEER)


def common(event: Any, source: str, user: str, *, done: bool) -> None:
    """The fields of BaseEventType and AuditEventType (OPC 10000-5 6.4.2 and 6.4.3)."""
    assert (event.SourceName, event.ClientUserId, event.Status) == (source, user, done)
    assert event.ServerId == SERVER_URI
    assert len(event.EventId) == 16
    assert event.ActionTimeStamp is not None
    assert event.Severity == (100 if done else 500)


async def test_the_server_says_that_it_audits(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        assert await client.get_node(ua.ObjectIds.Server_Auditing).read_value() is True


async def test_channel_and_session(hardened: Door, told: Events, identities: Identities) -> None:
    client = await hardened.client("oscar")
    await client.connect()
    await client.disconnect()
    der = identities.client.certificate.read_bytes()
    thumbprint = hashlib.sha1(der).hexdigest()
    channel = await told.first("AuditOpenSecureChannelEventType")
    common(channel, "SecureChannel/OpenSecureChannel", "System/OpenSecureChannel", done=True)
    assert (channel.ClientCertificate, channel.ClientCertificateThumbprint) == (der, thumbprint)
    assert (channel.RequestType, channel.SecurityMode) == (0, 3)
    assert channel.SecurityPolicyUri.endswith("#Basic256Sha256")
    created = await told.first("AuditCreateSessionEventType")
    common(created, "Session/CreateSession", "System/CreateSession", done=True)
    assert (created.SecureChannelId, created.RevisedSessionTimeout) == (channel.SecureChannelId, 60_000)
    assert created.ClientCertificateThumbprint == thumbprint
    activated = await told.first("AuditActivateSessionEventType")
    common(activated, "Session/ActivateSession", "oscar", done=True)
    assert (activated.SessionId, activated.SecureChannelId) == (created.SessionId, channel.SecureChannelId)
    assert activated.UserIdentityToken.UserName == "oscar"
    assert not activated.UserIdentityToken.Password
    closed = await told.first("AuditSessionEventType")
    common(closed, "Session/CloseSession", "oscar", done=True)
    assert closed.SessionId == created.SessionId


async def test_a_refused_login(hardened: Door, told: Events) -> None:
    stranger = await hardened.client("oscar", password="wrong guess")
    assert await bad(stranger.connect()) == "BadUserAccessDenied"
    event = await told.first("AuditActivateSessionEventType")
    common(event, "Session/ActivateSession", "oscar", done=False)
    assert not event.UserIdentityToken.Password
    assert "BadUserAccessDenied" in event.Message.Text


async def test_a_refused_certificate(hardened: Door, told: Events, identities: Identities) -> None:
    unknown = identities.get("unknown-to-all")
    stranger = await hardened.client("oscar", files=unknown)
    assert await bad(stranger.connect()) != "Good"
    event = await told.first("AuditCertificateUntrustedEventType")
    common(event, "Security/Certificate", "System/OpenSecureChannel", done=False)
    assert event.Certificate == unknown.certificate.read_bytes()
    channel = await told.first("AuditOpenSecureChannelEventType")
    common(channel, "SecureChannel/OpenSecureChannel", "System/OpenSecureChannel", done=False)


async def test_a_channel_for_another_certificate(hardened: Door, told: Events, identities: Identities) -> None:
    client = await hardened.client()
    policy: Any = client.security_policy
    policy.peer_certificate = b"another certificate"
    assert await bad(client.connect_sessionless()) in ("BadCertificateInvalid", "closed")
    event = await told.first("AuditOpenSecureChannelEventType")
    common(event, "SecureChannel/OpenSecureChannel", "System/OpenSecureChannel", done=False)
    assert event.ClientCertificate == identities.client.certificate.read_bytes()
    assert "BadCertificateInvalid" in event.Message.Text


async def test_writes(hardened: Door, told: Events) -> None:
    async with hardened.connected("oscar") as client:
        node = client.get_node(hardened.nodes.value)
        before = await node.read_value()
        request = ua.WriteRequest()
        request.RequestHeader.AuditEntryId = "order 4711"
        value = ua.DataValue(ua.Variant(21.5, ua.VariantType.Double))
        request.Parameters.NodesToWrite = [ua.WriteValue(node.nodeid, ua.AttributeIds.Value, None, value)]
        (result,) = (await send(client, request, ua.WriteResponse)).Results  # asyncua leaves AuditEntryId as it is
        assert result.is_good()
        event = await told.first("AuditWriteUpdateEventType")
        common(event, "Attribute/Write", "oscar", done=True)
        assert event.ClientAuditEntryId == "order 4711"
        assert (event.SourceNode, event.AttributeId) == (node.nodeid, 13)
        assert (event.OldValue, event.NewValue) == (before, 21.5)
        assert await bad(client.get_node(hardened.nodes.plain).write_value(1.0)) == "BadNotWritable"
        event = await told.first("AuditWriteUpdateEventType", 2)
        common(event, "Attribute/Write", "oscar", done=False)
        assert (event.SourceNode, event.OldValue, event.NewValue) == (hardened.nodes.plain, None, 1.0)
        assert await bad(client.get_node(hardened.nodes.text).write_value("x" * 100_000)) == "BadNotWritable"
        assert (await told.first("AuditWriteUpdateEventType", 3)).NewValue is None, (
            "an event does not carry what is large"
        )


async def test_method_calls(hardened: Door, told: Events) -> None:
    async with hardened.connected("oscar") as client:
        method = client.get_node(hardened.nodes.methods["add"])
        one, two = ua.Variant(1, ua.VariantType.Int64), ua.Variant(2, ua.VariantType.Int64)
        assert await client.nodes.objects.call_method(method, one, two) == 3
        event = await told.first("AuditUpdateMethodEventType")
        common(event, "Attribute/Call", "oscar", done=True)
        assert (event.SourceNode, event.MethodId) == (ua.NodeId(ua.ObjectIds.ObjectsFolder), method.nodeid)
        assert [argument.Value for argument in event.InputArguments] == [1, 2]
    async with hardened.connected("olga") as observer:
        assert await bad(observer.nodes.objects.call_method(method, one, two)) == "BadUserAccessDenied"
    event = await told.first("AuditUpdateMethodEventType", 2)
    common(event, "Attribute/Call", "olga", done=False)


async def test_nobody_else_is_told(hardened: Door, told: Events) -> None:
    async with hardened.connected("olga") as observer, hardened.connected("oscar") as operator:
        others = [await listen(observer), await listen(observer, where=False), await listen(operator)]
        for number in range(3):
            await operator.get_node(hardened.nodes.value).write_value(float(number))
        await told.first("AuditWriteUpdateEventType", 3)
        await asyncio.sleep(0.1)  # several publishing intervals
        assert [event for events in others for event in events.seen] == []


async def test_a_role_that_is_taken_away_holds_at_once(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as own, own.connected("eva") as engineer, own.connected("oscar") as operator:
        told = await listen(engineer)
        await operator.get_node(own.nodes.value).write_value(1.0)
        await told.first("AuditWriteUpdateEventType")
        own.users.add("eva", "engineer-1", Role.OPERATOR, replace_existing=True)
        sessions: Any = own.server
        await until(
            lambda: all(
                session.user.role is Role.OPERATOR
                for session in sessions._services.sessions
                if session.user is not None
            )
        )
        await operator.get_node(own.nodes.value).write_value(2.0)
        await asyncio.sleep(0.1)
        assert len(told.of("AuditWriteUpdateEventType")) == 1


async def test_refusals_do_not_flood_an_engineer(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as own, own.connected("eva") as engineer, own.connected("olga") as observer:
        told = await listen(engineer)
        request = ua.WriteRequest()
        value = ua.DataValue(ua.Variant(0.5, ua.VariantType.Double))
        request.Parameters.NodesToWrite = [ua.WriteValue(own.nodes.value, ua.AttributeIds.Value, None, value)] * 1_000
        await send(observer, request, ua.WriteResponse)
        async with own.connected("oscar") as operator:
            await operator.get_node(own.nodes.value).write_value(3.5)
        await until(lambda: any(event.ClientUserId == "oscar" for event in told.of("AuditWriteUpdateEventType")))
        assert len(told.of("AuditWriteUpdateEventType")) <= AT_ONCE + 2
