"""AuditEvents in the history: what of them is kept, and how many."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import Door, Identities, bad, door, send, ua
from tests.integration.server_security.test_audit_events import listen
from tests.waiting import until
from ua_fleet.endpoint.audit.allowance import CHANGES
from ua_fleet.endpoint.kept_events import EventKeeper, PastEvent
from ua_fleet.history.events import KeptEvent

pytestmark = pytest.mark.asyncio(loop_scope="module")


class Kept:
    """The AuditEvents that go to the store."""

    def __init__(self, own: Door) -> None:
        self.sizes: list[int] = []
        self.events: list[PastEvent] = []
        self.keeper = EventKeeper(self._record, own.server.context.misfit, audit=True)
        own.server.keep_events(self.keeper)

    def _record(self, time: int, data: bytes, *, is_audit: bool) -> None:
        assert is_audit
        self.sizes.append(len(data))
        self.events.append(PastEvent(KeptEvent(data)))

    def of(self, kind: str) -> list[PastEvent]:
        wanted = ua.NodeId(getattr(ua.ObjectIds, kind))
        return [event for event in self.events if event.variant("EventType").Value == wanted]


@pytest_asyncio.fixture(loop_scope="module")
async def own(tmp_path: Path, identities: Identities) -> AsyncGenerator[Door]:
    async with door(tmp_path, identities) as made:
        yield made


async def test_a_stranger_makes_small_events(own: Door, identities: Identities) -> None:
    kept = Kept(own)
    unknown = identities.get("unknown-to-all")
    assert len(unknown.certificate.read_bytes()) > 512
    stranger = await own.client("oscar", files=unknown)
    assert await bad(stranger.connect()) != "Good"
    await until(lambda: bool(kept.of("AuditCertificateUntrustedEventType")))
    await until(lambda: bool(kept.of("AuditOpenSecureChannelEventType")))
    assert max(kept.sizes) < 1_500
    [refused] = kept.of("AuditCertificateUntrustedEventType")
    assert refused.variant("Certificate").Value is None
    [channel] = kept.of("AuditOpenSecureChannelEventType")
    assert channel.variant("ClientCertificate").Value is None
    assert len(channel.variant("ClientCertificateThumbprint").Value) == 40


async def test_what_a_user_does_is_kept_whole(own: Door) -> None:
    kept = Kept(own)
    async with own.connected("oscar") as client:
        assert await bad(client.get_node(own.nodes.text).write_value("x" * 3_000)) == "BadNotWritable"
    [written] = kept.of("AuditWriteUpdateEventType")
    found: Any = written.variant("NewValue").Value
    assert found == "x" * 3_000


async def test_a_loop_of_writes_is_told_and_not_kept_without_end(own: Door) -> None:
    kept = Kept(own)
    async with own.connected("oscar") as client, own.connected("eva") as engineer:
        request = ua.WriteRequest()
        value = ua.DataValue(ua.Variant(0.5, ua.VariantType.Double))
        one = ua.WriteValue(own.nodes.value, ua.AttributeIds.Value, None, value)
        for _ in range(5):
            request.Parameters.NodesToWrite = [one] * 1_000
            await send(client, request, ua.WriteResponse)
        written = kept.of("AuditWriteUpdateEventType")
        assert CHANGES.at_once <= len(written) < CHANGES.at_once + 600
        assert len(written) + own.server.events_left_out == 5_000
        # Who listens is told all the same, and another user has an allowance of their own.
        told = await listen(engineer)
        await client.get_node(own.nodes.value).write_value(7.5)
        assert (await told.first("AuditWriteUpdateEventType")).NewValue == 7.5
        await engineer.get_node(own.nodes.value).write_value(8.5)
        assert kept.of("AuditWriteUpdateEventType")[-1].variant("NewValue").Value == 8.5
