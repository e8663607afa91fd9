"""What arrives at a process with keys is mutated, spliced, replayed and flooded: refused, counted, and bounded."""

from __future__ import annotations

import struct
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, TOPIC, WALL, Writing, only
from tests.unit.pubsub.security.securing import ENCRYPT, SIGN, action, announcement, data, envelope, group_keys, probe
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub import DataReceived, PubSubTiming, Subscriber
from ua_fleet.pubsub.events import SourceRefused
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.wire import Cause, SecurityMode
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.security import MessageKey, read_security

MUTATIONS = 40_000
FLOOD = 10_000
PUBLISHER = TOPIC.space
GROUPS = (f"t-{PUBLISHER}", f"c-{PUBLISHER}")
MOST_MESSAGE_BYTES = 256 * 1024


def sender(mode: SecurityMode = ENCRYPT, **more: Any) -> Envelope:
    return envelope(PUBLISHER, *GROUPS, mode=mode, **more)


def samples(mode: SecurityMode) -> list[bytes]:
    """What a publisher sends, in order: data, metadata, chunks, Actions; and probes, plain as they travel."""
    writing = Writing()
    plain = [*writing.announce(), *writing.publish(), announcement(PUBLISHER), action(), data("text")]
    plain += [datagram for _, sent in writing.run_until(105.0) for datagram in sent]
    whole, chunked = sender(mode), sender(mode, max_datagram_bytes=576)
    sealed = [datagram for message in plain for datagram in whole.seal(message, 0.0)]
    large = [data("large" * 300), announcement(PUBLISHER) + bytes(1000)]
    return [*sealed, *[chunk for message in large for chunk in chunked.seal(message, 0.0)], probe(PUBLISHER)]


def mutated(random: Random, datagrams: list[bytes]) -> bytes:
    """Flipped, overwritten, cut short, spliced of two, or as it was: a replay."""
    data_of = bytearray(random.choice(datagrams))
    kind = random.randrange(6)
    if kind == 0:
        for _ in range(random.randint(1, 4)):
            data_of[random.randrange(len(data_of))] ^= 1 << random.randrange(8)
    elif kind == 1:
        data_of[random.randrange(len(data_of))] = random.choice((0, 1, 0x7F, 0x80, 0xFF))
    elif kind == 2:
        del data_of[random.randrange(len(data_of)) :]
    elif kind == 3:
        other = random.choice(datagrams)
        data_of = data_of[: random.randrange(len(data_of))] + other[random.randrange(len(other)) :]
    elif kind == 4:
        other = random.choice(datagrams)
        at = random.randrange(min(len(data_of), len(other)))  # the head of one, the rest of another
        data_of = data_of[:at] + other[at:]
    return bytes(data_of)


@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_only_the_typed_error_comes_out_of_an_envelope(mode: SecurityMode) -> None:
    random, datagrams = Random(15), samples(mode)
    reader = envelope(0, *GROUPS, mode=mode)
    ends: Counter[str] = Counter()
    now = 0.0
    for _ in range(MUTATIONS // 2):
        now += 0.0001
        try:
            datagram = mutated(random, datagrams)
            plain = reader.open(datagram, now)
        except DatagramRefused as refused:
            ends[refused.drop] += 1
        except RemoteWireError as error:
            ends[error.cause] += 1
        else:
            was_secured = read_security(datagram).mode is not SecurityMode.NONE
            ends["let in" if was_secured else "probe"] += 1
            assert plain is None or read_security(plain).mode is SecurityMode.NONE
    assert {Drop.BAD_SIGNATURE, Drop.REPLAYED, Drop.UNKNOWN_TOKEN, Drop.NOT_SECURED} <= set(ends)
    assert set(ends) <= {"let in", "probe", *Drop, *Cause}
    assert 0 < ends["let in"] <= len(datagrams), "each that the sender made once at most, and no other"


@pytest.mark.parametrize("mode", [SIGN, ENCRYPT])
def test_a_subscriber_counts_and_goes_on(mode: SecurityMode) -> None:
    random, datagrams, counters = Random(16), samples(mode), Counters()
    reader = envelope(0, *GROUPS, mode=mode, counters=counters)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=reader, random=Random(1))
    now = 0.0
    for _ in range(MUTATIONS // 4):
        now += 0.0001
        subscriber.receive(mutated(random, datagrams), now)
        due = subscriber.next_deadline()
        if due is not None and due <= now:
            subscriber.poll(now)
    assert counters.drops[Drop.MALFORMED] == sum(counters.malformed.values())
    assert counters.drops[Drop.BAD_SIGNATURE] > MUTATIONS // 16
    assert counters.drops[Drop.SECURED] == 0, "nothing that is secured reaches the codec"
    # What the publisher itself goes on to send is taken as before.
    writing, going_on = Writing(now=now), sender(mode)
    for _ in range(200):  # its numbers go on above those that were heard
        going_on.seal(data("x"), 0.0)
    taken = [
        event
        for plain in (*writing.announce(), *writing.publish(9.0, timestamp=WALL + 1))
        for datagram in going_on.seal(plain, 0.0)
        for event in only(DataReceived, subscriber.receive(datagram, now))
    ]
    assert [event.message.values for event in taken] == [(9.0, "a")]


def test_a_member_of_a_group_that_signs_for_another_is_refused_and_counted() -> None:
    """Space 3 has the keys of t-3; it writes the PublisherId of space 1 into what it signs."""
    counters = Counters()
    reader = envelope(0, "t-1", "t-3", counters=counters)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=reader)
    keys = group_keys(seed="0t-3")
    own_key = MessageKey(keys.policy, keys.keys[0])
    for number, forged in enumerate((data("x"), announcement(1))):
        nonce = struct.pack("<HHI", 3, 0, number + 1)
        offset = read_security(forged).payload_offset
        events = subscriber.receive(own_key.protect(forged, offset, 1, nonce, ENCRYPT), 1.0)
        assert all(isinstance(event, SourceRefused) for event in events)
    assert counters.drops == {Drop.BAD_SIGNATURE: 2}
    assert subscriber.writers == {}


@pytest.mark.parametrize("seed", ["another service", "0t-3"])
def test_wrong_and_swapped_keys_are_refused_and_counted(seed: str) -> None:
    counters = Counters()
    reader = envelope(0, counters=counters)
    reader.install("t-1", group_keys(seed=seed), 0.0)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=reader)
    for datagram in sender().seal(data("x"), 0.0):
        subscriber.receive(datagram, 1.0)
    assert counters.drops == {Drop.BAD_SIGNATURE: 1}


@pytest.fixture
def _traced() -> Iterator[None]:
    tracemalloc.start()
    yield
    tracemalloc.stop()


def held() -> int:
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.usefixtures("_traced")
def test_memory_while_anybody_claims_to_be_everybody() -> None:
    """Forged messages of all PublisherIds, with all tokens: each is refused, and little is remembered of them."""
    counters = Counters()
    reader = envelope(0, *GROUPS, counters=counters)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=reader)
    secured = bytearray(sender().seal(data("x"), 0.0)[0])
    before = held()
    for number in range(FLOOD):
        struct.pack_into("<H", secured, 2, number * 3 % 0xFFFF + 1)
        struct.pack_into("<I", secured, 11, number)
        subscriber.receive(bytes(secured), number / 1000)
    assert sum(counters.drops.values()) == FLOOD
    assert held() - before < 8 * 1024 * 1024
    assert len(reader.groups_wanted()) < 10_000


def chunk(number: int, offset: int, total: int, size: int, *, writer_id: int = 1001) -> bytes:
    """An unsecured chunk."""
    head = struct.pack("<BBBHBHH", 0xF1, PublisherIdType.UINT16 | 0x80, 1, 1, 1, 2, writer_id)
    return head + struct.pack("<HIIi", number & 0xFFFF, offset, total, size) + bytes(size)


FLOODS: dict[str, Callable[[int], bytes]] = {
    "never end": lambda at: chunk(at, 0, MOST_MESSAGE_BYTES, 1200, writer_id=at % 60_000),
    "announce 4 GB": lambda at: chunk(at, 0, 0xFFFF_FFFF, 1200),
    "overlap": lambda at: chunk(at // 3, at % 3 * 100, MOST_MESSAGE_BYTES, 1200),
    "one byte each": lambda at: chunk(at // 1000, at % 1000 * 2, MOST_MESSAGE_BYTES, 1),
    "last byte first": lambda at: chunk(at, MOST_MESSAGE_BYTES - 1, MOST_MESSAGE_BYTES, 1),
    "contradict each other": lambda at: chunk(at // 4, at % 4 * 1200, MOST_MESSAGE_BYTES - at % 4, 1200),
}


@pytest.mark.usefixtures("_traced")
@pytest.mark.parametrize("kind", FLOODS)
def test_memory_under_chunks(kind: str) -> None:
    """Without security anybody may send chunks: what they hold is bounded by pubsub.max_message_bytes."""
    counters = Counters()
    reader = envelope(0, mode=SecurityMode.NONE, counters=counters, max_message_bytes=MOST_MESSAGE_BYTES)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=reader)
    most, make = MOST_MESSAGE_BYTES, FLOODS[kind]
    before, peak = held(), 0
    for number in range(FLOOD // 2):
        subscriber.receive(make(number), number / 100_000)
        peak = max(peak, held() - before)
    assert peak < 3 * most + 512 * 1024
    assert sum(counters.drops.values()) > 0
    subscriber.poll(1000.0)
    assert held() - before < 512 * 1024, "given up after a while"
