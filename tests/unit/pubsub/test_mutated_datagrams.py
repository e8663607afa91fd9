"""Whatever arrives, a subscriber counts it and goes on."""

from __future__ import annotations

from random import Random

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Reading, Writing, only
from ua_fleet.counters import Drop
from ua_fleet.pubsub import DataReceived, SourceUnknown, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import encode_probe
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

MUTATIONS = 20_000


def samples() -> list[bytes]:
    writing = Writing()
    array = make_field("points", BuiltinType.FLOAT, array=True, properties={"RosType": "std_msgs/Float32"})
    datagrams = [*writing.announce(), *writing.publish(), *writing.announce(Topic(1, 2, 7), fields=(array, *FIELDS))]
    values = ((1.0, 2.0, 3.0), 4.0, "text")
    datagrams += writing.publisher.publish(Topic(1, 2, 7), values, timestamp=WALL, now=writing.now)
    datagrams += [datagram for _, sent in writing.run_until(105.0) for datagram in sent]
    datagrams.append(encode_probe(Probe(0, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1, 2, 3))))
    return datagrams


def mutated(random: Random, datagrams: list[bytes]) -> bytes:
    data = bytearray(random.choice(datagrams))
    kind = random.randrange(4)
    if kind == 0:
        for _ in range(random.randint(1, 4)):
            data[random.randrange(len(data))] ^= 1 << random.randrange(8)
    elif kind == 1:
        data[random.randrange(len(data))] = random.choice((0, 1, 0x7F, 0x80, 0xFF))
    elif kind == 2:
        del data[random.randrange(len(data)) :]
    else:
        other = random.choice(datagrams)
        data = data[: random.randrange(len(data))] + other[random.randrange(len(other)) :]
    return bytes(data)


def test_mutated_datagrams_are_counted_and_do_no_harm() -> None:
    random = Random(14)
    datagrams = samples()
    reading = Reading(max_writers=50)
    now = 100.0
    for _ in range(MUTATIONS):
        now += 0.001
        reading.subscriber.receive(mutated(random, datagrams), now)
        due = reading.subscriber.next_deadline()
        if due is not None and due <= now:
            reading.subscriber.poll(now)
    counters = reading.counters
    assert len(reading.subscriber.writers) <= 50
    assert counters.drops[Drop.MALFORMED] == sum(counters.malformed.values()) > MUTATIONS // 10
    said = [one for one in reading.subscriber.complaints(now) if one.cause != Drop.UNKNOWN_SOURCE]
    assert 0 < len(said) <= len(counters.malformed)

    later = now + 1000.0
    reading.subscriber.poll(later)
    writing = Writing(now=later)
    writing.announce()
    assert recovered(writing, reading), "wrong metadata is probed for again, and times from the future are overcome"


def recovered(writing: Writing, reading: Reading) -> bool:
    """Whether a value that never changes arrives in the end, though forged messages came before it."""
    sent = writing.publish(9.0)
    while writing.now < 2000.0:
        for event in only(DataReceived, reading.receive(sent, writing.now)):
            if event.topic == TOPIC and event.message.values == (9.0, "a"):
                return True
        writing.now += 0.05
        sent = writing.publisher.poll(writing.now)
        for unknown in only(SourceUnknown, reading.subscriber.poll(writing.now)):
            probe = CODEC.decode(unknown.datagram) if unknown.datagram else None
            if isinstance(probe, Probe):
                sent += writing.publisher.answer(probe, writing.now)
    return False
