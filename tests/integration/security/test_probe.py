"""What `ua-fleet pubsub probe` does asks secured bridges: with the keys of the fleet, and without any."""

from __future__ import annotations

import asyncio

from tests.integration.security.conftest import COUNTER_ONE, ONE, STATUS_ONE, TWO, Site
from ua_fleet.cli.kind import HealthKind
from ua_fleet.cli.opening import Opener, tool_envelope, tool_keys
from ua_fleet.cli.probe_tables import table
from ua_fleet.cli.prober import Prober
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import AnnouncementReceived
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement, WriterConfigurationAnnouncement


async def probe(site: Site, kind: HealthKind, publisher_id: int | None = None) -> Prober:
    counters = Counters()
    envelope = tool_envelope(site.config, counters)
    prober = Prober(kind, publisher_id, Opener(counters, envelope))
    async with tool_keys(site.config, envelope, site.folder, None) as keys:
        await prober.ask(UdpTransport(site.url, "lo"), keys, 10.0)
    assert not counters.drops
    return prober


async def test_secured_bridges_answer_who_has_the_keys(secured: Site) -> None:
    await asyncio.to_thread(secured.bridge, "one")
    await asyncio.to_thread(secured.bridge, "two")
    found = table(HealthKind.APPLICATIONS, (await probe(secured, HealthKind.APPLICATIONS)).answers)
    assert [row[:4] for row in found[1:]] == [
        [str(ONE), "bridge one", "client", "operational"],
        [str(TWO), "bridge two", "client", "operational"],
    ]
    writers = (await probe(secured, HealthKind.WRITERS, ONE)).answers
    groups = [found for found in writers if isinstance(found, WriterConfigurationAnnouncement)]
    assert {writer_id for group in groups for writer_id in group.data_set_writer_ids} == {COUNTER_ONE.id, STATUS_ONE.id}
    assert {group.writer_group.security_group_id for group in groups} == {f"t-{ONE}"}
    [_, row] = table(HealthKind.ENDPOINTS, (await probe(secured, HealthKind.ENDPOINTS, ONE)).answers)
    assert row[1] == "BadNotSupported", "a bridge has no server, and says so"
    both = await probe(secured, HealthKind.METADATA)
    assert both.answered == {ONE, TWO}, "who is found is asked"


async def test_without_keys_nobody_is_heard(secured: Site) -> None:
    await asyncio.to_thread(secured.bridge, "one")
    counters = Counters()
    prober = Prober(HealthKind.APPLICATIONS, None, Opener(counters, tool_envelope(None, counters)))
    await prober.ask(UdpTransport(secured.url, "lo"), None, 1.0)
    assert prober.answers == []
    assert set(counters.drops) == {Drop.SECURED}


async def test_a_bridge_says_that_it_begins_and_ends(secured: Site) -> None:
    async with secured.peer() as peer:

        def states() -> list[int]:
            heard = [event.announcement for event in peer.events if isinstance(event, AnnouncementReceived)]
            return [status.state for status in heard if isinstance(status, StatusAnnouncement)]

        bridge = await asyncio.to_thread(secured.bridge, "one")
        await peer.until(lambda: states() == [PubSubState.OPERATIONAL])
        await asyncio.to_thread(bridge.end)
        await peer.until(lambda: states() == [PubSubState.OPERATIONAL, PubSubState.DISABLED])
