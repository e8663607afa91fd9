"""Announcements that are secured, in chunks, or forged; and probes, which never are."""

from __future__ import annotations

from random import Random

import pytest

from tests.unit.pubsub.publishing import CODEC, WALL, only
from tests.unit.pubsub.security.securing import ENCRYPT, NONE, envelope
from tests.unit.pubsub.test_mutated_datagrams import mutated
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    ActionCatalog,
    AnnouncementReceived,
    Application,
    ProbeReceived,
    Publisher,
    PubSubTiming,
    Subscriber,
    SubscriberEvent,
    describe,
    make_field,
)
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import SecurityMode, encode_announcement, encode_probe
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement, ActionTarget, ConnectionsAnnouncement
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

FIELDS = (make_field("x", BuiltinType.DOUBLE),)


def publishing(writers: int) -> Publisher:
    application = Application(describe("urn:cell", "cell"), max_message_bytes=1024 * 1024)
    publisher = Publisher(1, PubSubTiming(), Counters(), CODEC, application)
    for number in range(1, writers + 1):
        publisher.announce(Topic(1, 2, number), f"/cell/robot_{number}", FIELDS, now=0.0, wall_ticks=WALL)
    return publisher


@pytest.mark.parametrize("mode", SecurityMode)
def test_connections_with_many_writers_come_in_chunks(mode: SecurityMode) -> None:
    publisher = publishing(2000)
    groups = () if mode is NONE else ("t-1",)
    sealing = envelope(1, *groups, mode=mode, max_datagram_bytes=1400)
    counters = Counters()
    reading = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=envelope(0, *groups, mode=mode))
    probe = Probe(
        1,
        PublisherIdType.UINT16,
        ProbeKind.PUBSUB_CONNECTIONS,
        include_writer_groups=True,
        include_data_set_writers=True,
    )
    sealed = [part for plain in publisher.answer(probe, 10.0) for part in sealing.seal(plain, 10.0)]
    assert len(sealed) > 100
    assert max(map(len, sealed)) <= 1400
    first, *others = sealed  # a receiver takes nothing older than what it heard first
    Random(1).shuffle(others)
    events: list[SubscriberEvent] = []
    for datagram in (first, *others):
        events += reading.receive(datagram, 10.0)
    [found] = [event.announcement for event in only(AnnouncementReceived, events)]
    assert isinstance(found, ConnectionsAnnouncement)
    assert len(found.connections[0].writer_groups[0].data_set_writers) == 2000
    assert counters.drops == {}


def test_actions_that_are_not_signed_are_not_heard_and_probes_are() -> None:
    publisher = publishing(0)
    target = (ActionTarget(1, "arm"),)
    plain = publisher.announce_action(Topic(1, 2, 7), "move", target, FIELDS, FIELDS, now=0.0, wall_ticks=WALL)
    counters = Counters()
    reading = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=envelope(0, "t-1", mode=ENCRYPT))
    assert only(AnnouncementReceived, reading.receive(plain[0], 0.0)) == []
    assert counters.drops == {Drop.NOT_SECURED: 1}
    [sealed] = envelope(1, "t-1", mode=ENCRYPT).seal(plain[0], 0.0)
    [event] = only(AnnouncementReceived, reading.receive(sealed, 0.0))
    assert isinstance(event.announcement, ActionMetaDataAnnouncement)
    for kind in (ProbeKind.FIND_APPLICATIONS, ProbeKind.ENDPOINTS):
        probe = Probe(0, PublisherIdType.UINT16, kind)
        sent = envelope(1, "t-1", mode=ENCRYPT).seal(encode_probe(probe), 0.0)
        [asked] = reading.receive(sent[0], 0.0)
        assert isinstance(asked, ProbeReceived)


def test_mutated_announcements_do_no_harm() -> None:
    random = Random(16)
    datagrams = [encode_announcement(announcement) for announcement in ANNOUNCEMENTS.values()]
    counters = Counters()
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, random=random)
    catalog = ActionCatalog(most=20, most_bytes=5_000)
    for writer_id in range(50):
        subscriber.want_action(7, writer_id, 0.0)
    heard = 0
    for number in range(10_000):
        now = number * 0.001
        for event in only(AnnouncementReceived, subscriber.receive(mutated(random, datagrams), now)):
            heard += 1
            if isinstance(event.announcement, ActionMetaDataAnnouncement):
                catalog.apply(event.announcement)
        due = subscriber.next_deadline()
        if due is not None and due <= now:
            subscriber.poll(now)
    assert heard > 1000
    assert counters.drops[Drop.MALFORMED] > 1000
    assert len(catalog.actions) <= 20
