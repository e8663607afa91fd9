"""AuditEvents in the history: what of them is kept, and how many."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import Door, Identities, bad, door, ua
from tests.waiting import until
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
