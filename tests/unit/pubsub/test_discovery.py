"""Publishers and subscribers that ask and answer over a network in memory, which loses, doubles and delays."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from random import Random
from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, WALL, only
from ua_fleet.counters import Counters
from ua_fleet.pubsub import (
    ActionCatalog,
    AnnouncementReceived,
    DataReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    Publisher,
    PubSubTiming,
    SourceUnknown,
    Subscriber,
    SubscriberEvent,
    make_field,
)
from ua_fleet.topics import Topic
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.values import BuiltinType
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionTarget,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

ACTION = Topic(1, 2, 77)
TARGETS = (ActionTarget(1, "arm"), ActionTarget(2, "gripper"))
STEP_S = 0.01


@dataclass
class Member:
    """A process without I/O: what it sends goes on the network, what it learns is kept."""

    endpoint: MemoryEndpoint
    space: int
    seed: int
    publishes: bool = False
    events: list[SubscriberEvent] = field(default_factory=list[SubscriberEvent])
    sent: list[Any] = field(default_factory=list[Any])

    def __post_init__(self) -> None:
        self.now = 0.0
        timing = PubSubTiming()
        self.publisher = Publisher(self.space, timing, Counters(), CODEC)
        self.subscriber = Subscriber(self.space, timing, Counters(), CODEC, random=Random(self.seed))
        self.endpoint.attach(lambda datagram, _: self.handle(self.subscriber.receive(datagram, self.now)))

    def send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            self.sent.append(CODEC.decode(datagram))
            self.endpoint.send(datagram)

    def handle(self, events: list[SubscriberEvent]) -> None:
        self.events += events
        for event in events:
            if isinstance(event, SourceUnknown | ProbeDue) and event.datagram:
                self.send([event.datagram])
            elif isinstance(event, ProbeReceived) and self.publishes:
                self.send(self.publisher.answer(event.probe, self.now))

    def poll(self, now: float) -> None:
        self.now = now
        if self.publishes:
            self.send(self.publisher.poll(now))
        self.handle(self.subscriber.poll(now))

    def announced(self, kind: type) -> list[Any]:
        return [
            event.announcement
            for event in only(AnnouncementReceived, self.events)
            if isinstance(event.announcement, kind)
        ]

    def probes(self) -> list[Probe]:
        return [message for message in self.sent if isinstance(message, Probe)]


class Cell:
    """One publisher (space 1) and subscribers (spaces 2, 3, ...)."""

    def __init__(self, readers: int = 1, **network: Any) -> None:
        self.network = MemoryNetwork(**network)
        self.writer = Member(self.network.endpoint(), 1, 0, publishes=True)
        self.readers = [Member(self.network.endpoint(), 2 + number, number) for number in range(readers)]

    def run_until(self, end: float) -> None:
        while self.network.now < end:
            now = self.network.now + STEP_S
            self.network.advance_to(now)
            for member in (self.writer, *self.readers):
                member.poll(now)

    def announce_action(self, **changes: Any) -> None:
        arguments: dict[str, Any] = {"name": "move", "targets": TARGETS, "request": FIELDS, "response": FIELDS[:1]}
        now = self.network.now
        self.writer.send(self.writer.publisher.announce_action(ACTION, now=now, wall_ticks=WALL, **arguments | changes))


def test_actions_are_asked_for_with_the_delays_of_the_specification() -> None:
    cell = Cell()
    [reader] = cell.readers
    cell.writer.endpoint.reachable = False
    assert reader.subscriber.want_action(1, 77, 0.0)
    times: list[float] = []
    for _ in range(2_000):
        cell.run_until(cell.network.now + STEP_S)
        if len(reader.probes()) > len(times):
            times.append(cell.network.now)
    waits = [later - sooner for sooner, later in pairwise(times)]
    assert 0.1 <= times[0] <= 0.52
    assert waits == pytest.approx([0.5, 1.0, 2.0, 4.0, 8.0], abs=2 * STEP_S)
    assert set(reader.probes()) == {Probe(1, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (77,))}
    cell.writer.endpoint.reachable = True
    cell.announce_action()
    cell.run_until(cell.network.now + 60.0)
    assert len(reader.probes()) == len(times), "what came is not asked for any more"
    assert reader.announced(ActionMetaDataAnnouncement)[0].targets == TARGETS


@pytest.mark.parametrize("seed", range(5))
def test_lost_and_doubled_probes(seed: int) -> None:
    cell = Cell(3, seed=seed, loss=0.4, duplicate=0.4, max_delay_s=0.05)
    cell.announce_action()
    for reader in cell.readers:
        reader.subscriber.want_action(1, 77, cell.network.now)
        for kind in (ProbeKind.ENDPOINTS, ProbeKind.PUBSUB_CONNECTIONS, ProbeKind.DATA_SET_WRITER_CONFIGURATION):
            reader.subscriber.want(1, kind, cell.network.now)
    cell.writer.send(cell.writer.publisher.announce(Topic(1, 2, 5), "arm", FIELDS, now=0.0, wall_ticks=WALL))
    cell.run_until(120.0)
    for reader in cell.readers:
        for announcement in (
            ActionMetaDataAnnouncement,
            EndpointsAnnouncement,
            ConnectionsAnnouncement,
            WriterConfigurationAnnouncement,
        ):
            assert reader.announced(announcement), announcement


def test_many_subscribers_that_ask_at_once_get_a_bounded_number_of_answers() -> None:
    cell = Cell(60)
    cell.announce_action()
    cell.writer.send(cell.writer.publisher.announce(Topic(1, 2, 5), "arm", FIELDS, now=0.0, wall_ticks=WALL))
    cell.run_until(5.0)
    before = len(cell.writer.sent)
    for reader in cell.readers:
        reader.events.clear()
        reader.subscriber.want_action(1, 77, cell.network.now)
        reader.subscriber.want(1, ProbeKind.PUBSUB_CONNECTIONS, cell.network.now)
    cell.run_until(8.0)
    answers = [message for message in cell.writer.sent[before:] if hasattr(message, "sequence_number")]
    actions = [message for message in answers if isinstance(message, ActionMetaDataAnnouncement)]
    connections = [message for message in answers if isinstance(message, ConnectionsAnnouncement)]
    assert 1 <= len(actions) <= 2
    assert 1 <= len(connections) <= 2
    assert sum(len(reader.probes()) for reader in cell.readers) < 20, "one asks, the others hear the answer"
    for reader in cell.readers:
        assert reader.announced(ActionMetaDataAnnouncement)
        assert reader.announced(ConnectionsAnnouncement)


def test_a_changed_action_is_followed_without_a_restart() -> None:
    cell = Cell(seed=3, loss=0.3)
    [reader] = cell.readers
    catalog = ActionCatalog()
    cell.writer.publisher.begin(now=0.0, wall_ticks=WALL)
    cell.announce_action()
    reader.subscriber.want_action(1, 77, 0.0)
    cell.run_until(30.0)
    for action in reader.announced(ActionMetaDataAnnouncement):
        catalog.apply(action)
    first = catalog.find(1, 77)
    assert first is not None
    reader.events.clear()
    cell.announce_action(targets=TARGETS[1:], request=(*FIELDS, make_field("speed", BuiltinType.DOUBLE)))
    cell.run_until(300.0)
    for action in reader.announced(ActionMetaDataAnnouncement):
        catalog.apply(action)
    second = catalog.find(1, 77)
    assert second is not None
    assert second.targets == TARGETS[1:]
    assert len(second.request.fields) == 3
    assert second.request.configuration_version.major > first.request.configuration_version.major


def test_changed_metadata_is_followed_without_a_restart() -> None:
    cell = Cell(2, seed=1, loss=0.2, duplicate=0.2, max_delay_s=0.02)
    topic = Topic(1, 2, 5)
    writer = cell.writer
    layouts = [FIELDS, FIELDS[:1], (*FIELDS, make_field("speed", BuiltinType.DOUBLE))]
    values = [(1.0, "a"), (2.0,), (3.0, "c", 4.0)]
    for number, (fields, value) in enumerate(zip(layouts, values, strict=True)):
        now = cell.network.now
        writer.publisher.announce(topic, "arm", fields, now=now, wall_ticks=WALL)  # and all of it is lost
        for repeat in range(20):
            timestamp = WALL + number * 100 + repeat
            writer.send(writer.publisher.publish(topic, value, timestamp=timestamp, now=cell.network.now))
            cell.run_until(cell.network.now + 0.5)
    for reader in cell.readers:
        versions = [event.metadata for event in only(MetaDataReceived, reader.events)]
        assert [len(metadata.fields) for metadata in versions] == [2, 1, 3]
        majors = [metadata.configuration_version.major for metadata in versions]
        assert majors == sorted(set(majors))
        assert only(DataReceived, reader.events)[-1].message.values == (3.0, "c", 4.0)


def test_what_is_denied_is_asked_for_less_and_less() -> None:
    cell = Cell()
    [reader] = cell.readers
    reader.subscriber.want_action(1, 99, 0.0)
    cell.run_until(30.0)
    assert len(reader.probes()) == 1, "denied"


def test_wishes_are_bounded() -> None:
    subscriber = Subscriber(2, PubSubTiming(), Counters(), CODEC, random=Random(1))
    wanted = sum(subscriber.want_action(1, writer_id, 0.0) for writer_id in range(10_000))
    assert wanted == 4096
    probes = [CODEC.decode(event.datagram) for event in only(ProbeDue, subscriber.poll(0.6))]
    assert sum(len(probe.data_set_writer_ids) for probe in probes if isinstance(probe, Probe)) == 4096
    assert max(len(event.datagram) for event in only(ProbeDue, subscriber.poll(2.0))) <= 1400
    with pytest.raises(ValueError, match="otherwise"):
        subscriber.want(1, ProbeKind.FIND_APPLICATIONS, 0.0)


def test_what_is_not_wanted_any_more_is_not_asked_for_and_gives_its_place_free() -> None:
    subscriber = Subscriber(2, PubSubTiming(), Counters(), CODEC, random=Random(1))
    for writer_id in range(10_000):
        assert subscriber.want_action(1, writer_id, 0.0)
        subscriber.unwant_action(1, writer_id)
    subscriber.unwant_action(1, 5)
    assert only(ProbeDue, subscriber.poll(100.0)) == []


def test_announcements_of_our_own_and_of_no_fleet_are_not_handed_on() -> None:
    counters = Counters()
    subscriber = Subscriber(1, PubSubTiming(), counters, CODEC)
    own = StatusAnnouncement(1, PublisherIdType.UINT16, 0, False, 2)
    foreign = own._replace(publisher_id="1", publisher_id_type=PublisherIdType.STRING)
    heard = own._replace(publisher_id=3)
    events = [
        event for status in (own, foreign, heard) for event in subscriber.receive(encode_announcement(status), 1.0)
    ]
    assert events == [AnnouncementReceived(heard)]
    assert sum(counters.drops.values()) == 2
