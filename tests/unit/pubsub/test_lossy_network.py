"""A publisher and two subscribers over a network that loses, delays, duplicates and reorders."""

from __future__ import annotations

from collections import defaultdict

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.pubsub.publishing import CODEC, TOPIC, WALL, Reading, Writing, messages
from ua_fleet.counters import Drop
from ua_fleet.pubsub import DataReceived, MetaDataReceived, ProbeReceived, SourceUnknown, Subscriber, SubscriberEvent
from ua_fleet.topics import Topic
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire.messages import NetworkMessage

TOPICS = tuple(Topic(1, 2, number) for number in (1, 2, 3))


class _Member:
    """A process on the network: the clock of the network is its clock."""

    def __init__(self, network: MemoryNetwork, subscriber: Subscriber, publisher: Writing | None = None) -> None:
        self.network, self.subscriber, self.writing = network, subscriber, publisher
        self.endpoint: MemoryEndpoint = network.endpoint()
        self.endpoint.attach(lambda datagram, _: self.take(subscriber.receive(datagram, network.now)))
        self.handed_on: dict[Topic, list[tuple[int, float]]] = defaultdict(list)
        self.metadata: dict[Topic, object] = {}

    def take(self, events: list[SubscriberEvent]) -> None:
        for event in events:
            if isinstance(event, DataReceived):
                assert event.metadata == self.metadata[event.topic], "metadata is told before the data of its version"
                assert event.message.timestamp is not None
                self.handed_on[event.topic].append((event.message.timestamp, event.message.values[0]))
            elif isinstance(event, MetaDataReceived):
                self.metadata[event.topic] = event.metadata
            elif isinstance(event, SourceUnknown) and event.datagram:
                self.endpoint.send(event.datagram)
            elif isinstance(event, ProbeReceived) and self.writing is not None:
                self.send(self.writing.publisher.answer(event.probe, self.network.now))

    def send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            self.endpoint.send(datagram)

    def poll(self) -> None:
        self.take(self.subscriber.poll(self.network.now))
        if self.writing is not None:
            self.send(self.writing.publisher.poll(self.network.now))

    def deadline(self) -> float:
        known = [self.subscriber.next_deadline()]
        if self.writing is not None:
            known.append(self.writing.publisher.next_deadline())
        return min((time for time in known if time is not None), default=float("inf"))


def run_until(network: MemoryNetwork, members: list[_Member], end: float) -> None:
    while True:
        due = min([end, network.next_delivery() or end, *[member.deadline() for member in members]])
        network.advance_to(max(due, network.now))
        for member in members:
            if member.deadline() <= network.now:
                member.poll()
        if network.now >= end:
            return


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.1, 0.5]),
    duplicate=st.sampled_from([0.0, 0.3]),
    max_delay_s=st.sampled_from([0.0, 0.01, 0.4]),
    sent=st.lists(st.tuples(st.sampled_from(TOPICS), st.floats(0.0, 2.0), st.integers(-5, 5)), max_size=30),
)
def test_nothing_is_handed_on_twice_and_the_last_value_always_arrives(
    seed: int, loss: float, duplicate: float, max_delay_s: float, sent: list[tuple[Topic, float, int]]
) -> None:
    network = MemoryNetwork(seed, loss=loss, duplicate=duplicate, max_delay_s=max_delay_s, now=100.0)
    writing = Writing()
    sender = _Member(network, Reading(own_space=1).subscriber, writing)
    first, second = Reading(), Reading(own_space=2)
    receivers = [_Member(network, first.subscriber), _Member(network, second.subscriber)]
    members = [sender, *receivers]
    for topic in TOPICS:
        writing.now = network.now
        sender.send(writing.announce(topic))
    last: dict[Topic, float] = {}
    for number, (topic, pause, clock) in enumerate(sent):
        run_until(network, members, network.now + pause)
        writing.now = network.now
        last[topic] = float(number)
        sender.send(writing.publish(float(number), topic=topic, timestamp=WALL + number + clock * TICKS_PER_SECOND))
    network.loss = 0.0
    run_until(network, members, network.now + 70.0)

    for receiver in receivers:
        for handed_on in receiver.handed_on.values():
            stamps = [timestamp for timestamp, _ in handed_on]
            assert stamps == sorted(set(stamps)), "Timestamps strictly increase, so nothing comes twice"
        arrived = {topic: handed_on[-1][1] for topic, handed_on in receiver.handed_on.items()}
        assert arrived == last
        assert set(receiver.metadata) == set(TOPICS)
        assert not any(writer.silent for writer in receiver.subscriber.writers.values())
        assert not any(writer.restarts for writer in receiver.subscriber.writers.values())
    assert sender.handed_on == {}, "the sender hears itself, and the loop rule drops it"


@settings(max_examples=100)
@given(
    order=st.lists(st.integers(0, 60), min_size=1, max_size=120),
    start=st.sampled_from([0, 65_500, 40_000]),
)
def test_every_message_is_accounted_for(order: list[int], start: int) -> None:
    """Whatever is lost, doubled or out of order: what was missing when it was passed is lost or late."""
    writing, reading = Writing(), Reading()
    [message] = messages([*writing.announce()[:1], *writing.publish()])
    datagrams = [
        CODEC.encode(
            NetworkMessage(
                TOPIC.space,
                writer_group_id=TOPIC.ns,
                messages=(message._replace(sequence_number=(start + number) & 0xFFFF, timestamp=WALL + number),),
            )
        )
        for number in range(61)
    ]
    reading.receive([*writing.announce()[:1], datagrams[0]], 100.0)
    arrived = {0}
    for number in order:
        reading.subscriber.receive(datagrams[number], 100.0)
        arrived.add(number)
    never = set(range(max(arrived))) - arrived
    writer = reading.subscriber.writers[TOPIC]
    assert reading.counters.gaps == writer.gaps == len(never) + writer.late
    assert reading.counters.drops[Drop.LATE] == writer.late
    assert writer.duplicates == reading.counters.drops[Drop.DUPLICATE] == len(order) + 1 - len(arrived)
    assert writer.restarts == 0
