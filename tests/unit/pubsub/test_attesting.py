"""What says that a value is of now: only what was taken, and what repeats it."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.unit.fleet.fleet_of import SPEED, Fleet, values
from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Reading, Writing, messages, only
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    DataReceived,
    ProbeReceived,
    PubSubTiming,
    SourceAppeared,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    Subscriber,
    SubscriberEvent,
    make_field,
)
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import encode_metadata_announcement
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    PublisherIdType,
)

DOUBLE, STRING = int(BuiltinType.DOUBLE), int(BuiltinType.STRING)


def sent_by(part: DataSetMessage) -> bytes:
    return CODEC.encode(NetworkMessage(TOPIC.space, writer_group_id=TOPIC.ns, messages=(part,)))


def announced(major: int, fields: Any = FIELDS) -> bytes:
    metadata = DataSetMetaData("source", fields, ConfigurationVersion(major, major))
    return encode_metadata_announcement(MetaDataAnnouncement(1, PublisherIdType.UINT16, 0, TOPIC.id, metadata))


def frame(number: int | None = None, **changes: Any) -> DataSetMessage:
    made = DataSetMessage(TOPIC.id, types=(DOUBLE, STRING), values=(12.0, "a"), sequence_number=number, major_version=7)
    return made._replace(**changes)


DROPPED: dict[str, tuple[dict[str, Any], Drop]] = {
    "an unknown version": ({"major_version": 8}, Drop.NO_METADATA),
    "other types": ({"types": (STRING, DOUBLE), "values": ("a", 1.0)}, Drop.LAYOUT),
    "too few fields": ({"types": (DOUBLE,), "values": (1.0,)}, Drop.LAYOUT),
    "an event": ({"kind": int(FrameKind.EVENT)}, Drop.UNSUPPORTED),
    "bytes that do not decode": (
        {"encoding": int(FieldEncoding.RAW_DATA), "raw": b"\1", "types": (), "values": ()},
        Drop.MALFORMED,
    ),
    "not valid": ({"valid": False}, Drop.INVALID),
    "an old timestamp": ({"timestamp": WALL - 5}, Drop.REPEATED),
}


@pytest.mark.parametrize("name", DROPPED)
def test_a_message_that_is_dropped_attests_nothing(name: str) -> None:
    changes, cause = DROPPED[name]
    reading = Reading()
    reading.receive([announced(7), sent_by(frame(0, timestamp=WALL))], 100.0)
    said: list[SubscriberEvent] = []
    for number in range(1, 9):  # a fresh Timestamp each time, but for the old one, which decreases
        stamp = changes.get("timestamp", WALL + 2 * number) - number
        part = frame(number)._replace(**{**changes, "timestamp": stamp})
        said += reading.receive([sent_by(part)], 100.0 + number / 2)
        said += [event for _, event in reading.run_until(100.0 + number / 2)]
    assert reading.counters.drops[cause] == 8
    assert not only(DataReceived, said)
    assert only(SourceSilent, said) == [SourceSilent(TOPIC)]
    assert not only(SourceReturned, said)
    assert not only(SourceReturned, reading.receive([sent_by(frame(9)._replace(**changes))], 105.0))
    assert only(SourceReturned, reading.receive([sent_by(frame(10, timestamp=WALL + 90))], 105.1)), "it is taken again"


@pytest.mark.parametrize("name", DROPPED)
def test_a_keep_alive_after_a_message_that_was_dropped_does_not_attest_the_one_before(name: str) -> None:
    for numbered in (True, False):
        reading = Reading()
        reading.receive([announced(7), sent_by(frame(0 if numbered else None, timestamp=WALL))], 100.0)
        part = frame(1 if numbered else None, timestamp=WALL + 2)._replace(**DROPPED[name][0])
        reading.receive([sent_by(part)], 100.5)
        alive = DataSetMessage(
            TOPIC.id, kind=int(FrameKind.KEEP_ALIVE), sequence_number=2 if numbered else None, major_version=7
        )
        said: list[SubscriberEvent] = []
        for second in range(101, 110):
            said += reading.receive([sent_by(alive)], float(second))
            said += [event for _, event in reading.run_until(float(second))]
        assert [event for event in said if not isinstance(event, SourceUnknown)] == [SourceStale(TOPIC)]
        back = reading.receive([sent_by(frame(2 if numbered else None, timestamp=WALL + 9))], 110.0)
        assert [type(event) for event in back] == [SourceReturned, DataReceived]


def test_messages_refused_for_their_security_or_malformed_attest_nothing() -> None:
    reading = Reading()
    good = sent_by(frame(0, timestamp=WALL))
    reading.receive([announced(7), good], 100.0)
    secured = bytes([good[0], good[1] | 0x10]) + good[2:]
    said: list[SubscriberEvent] = []
    for step in range(1, 12):
        said += reading.receive([secured, good[:-3]], 100.0 + step / 2)
        said += [event for _, event in reading.run_until(100.0 + step / 2)]
    assert said == [SourceSilent(TOPIC)]
    assert reading.counters.drops[Drop.SECURED] == reading.counters.drops[Drop.MALFORMED] == 11


def test_a_publisher_that_was_restarted_without_an_announcement_is_never_good_with_its_old_value() -> None:
    """open62541 makes a new ConfigurationVersion at each start, and announces no metadata."""
    fleet, counters = Fleet(), Counters()
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC)
    field = make_field("data", BuiltinType.DOUBLE)
    shown: dict[float, Any] = {}

    def take(datagrams: list[bytes], now: float) -> None:
        events = [event for datagram in datagrams for event in subscriber.receive(datagram, now)]
        for event in [*events, *subscriber.poll(now)]:
            found = values(fleet.state.apply(event, fleet.now))
            if SPEED.id in found:
                shown[now] = found[SPEED.id]

    def value(level: float, major: int) -> bytes:
        part = DataSetMessage(SPEED.id, types=(DOUBLE,), values=(level,), major_version=major, minor_version=major)
        return CODEC.encode(NetworkMessage(SPEED.space, writer_group_id=SPEED.ns, messages=(part,)))

    metadata = DataSetMetaData("temp", (field,), ConfigurationVersion(7, 7))
    announcement = MetaDataAnnouncement(SPEED.space, PublisherIdType.UINT16, 0, SPEED.id, metadata)
    take([encode_metadata_announcement(announcement)], 0.0)
    for step in range(10):
        take([value((step + 3) / 10, 7)], step / 10)
    assert shown[0.9][:2] == (1.2, 0)
    for step in range(200):
        take([value(2.0, 9)], 5.0 + step / 10)
    assert counters.drops[Drop.NO_METADATA] == 200
    last = shown[max(shown)]
    assert last[:2] == (1.2, StatusCode.BAD_NO_COMMUNICATION)
    assert all(status for time, (_, status, _) in shown.items() if time > 4.0)


def test_a_new_life_that_has_said_nothing_leaves_the_value_of_the_old_one_stale() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish(5.0)], 100.0)
    again = Writing(now=101.0)
    said = reading.receive(again.announce(wall_ticks=WALL + 10_000_000), 101.0)
    for time, datagrams in again.run_until(200.0):
        said += [event for _, event in reading.run_until(time)]
        said += reading.receive(datagrams, time)
    assert only(SourceStale, said) == [SourceStale(TOPIC)]
    assert not only(SourceReturned, said)
    assert not only(SourceSilent, said), "it lives, and says so"
    assert reading.subscriber.known(TOPIC)[-1] == SourceStale(TOPIC)
    fresh = reading.receive(again.publish(6.0, timestamp=WALL + 20_000_000), 200.0)
    assert [type(event) for event in fresh] == [SourceReturned, DataReceived]


def test_a_source_that_came_back_after_its_loss_is_stale_until_it_speaks() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish(5.0)], 100.0)
    reading.receive(writing.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=101.0), 101.0)
    reading.run_until(110.0)
    writing.now = 110.0
    said = reading.receive(writing.announce(), 110.0)
    for time, datagrams in writing.run_until(130.0):
        said += [event for _, event in reading.run_until(time)]
        said += reading.receive(datagrams, time)
    assert said == [SourceStale(TOPIC)]


def test_a_value_that_was_lost_on_its_way_is_asked_for_at_the_next_keep_alive() -> None:
    writing, reading = Writing(timing=PubSubTiming(repeat_interval_s=1000.0)), Reading()
    reading.receive([*writing.announce(), *writing.publish(5.0)], 100.0)
    writing.publish(6.0, timestamp=WALL + 1)  # nobody hears it
    got: list[Any] = []
    for step in range(1, 60):
        now = 100.0 + step / 10
        for _, datagrams in writing.run_until(now):
            got += reading.receive(datagrams, now)
        for event in reading.subscriber.poll(now):
            if isinstance(event, SourceUnknown) and event.datagram is not None:
                probe = CODEC.decode(event.datagram)
                assert isinstance(probe, Probe)
                got += reading.receive(writing.publisher.answer(probe, now), now)
            got.append(event)
    assert [event.message.values[0] for event in only(DataReceived, got)] == [6.0]
    assert len(only(SourceUnknown, got)) == 1
    assert not only(SourceSilent, got)
    assert not only(SourceStale, got)
    assert not only(ProbeReceived, got)


def test_a_value_that_stays_lost_is_stale() -> None:
    writing, reading = Writing(timing=PubSubTiming(repeat_interval_s=1000.0)), Reading()
    reading.receive([*writing.announce(), *writing.publish(5.0)], 100.0)
    writing.publish(6.0, timestamp=WALL + 1)
    said: list[SubscriberEvent] = []
    for time, datagrams in writing.run_until(110.0):
        said += [event for _, event in reading.run_until(time)]
        said += reading.receive(datagrams, time)
    assert [event for event in said if not isinstance(event, SourceUnknown)] == [SourceStale(TOPIC)]


STEPS = st.lists(
    st.tuples(st.sampled_from(("publish", "keep-alive", "repeat", "unknown", "restart")), st.booleans()), max_size=40
)


@given(steps=STEPS)
@example([("publish", True), ("restart", False), ("publish", False), ("keep-alive", True)])
def test_what_is_said_to_be_of_now_is_what_the_publisher_has(steps: list[tuple[str, bool]]) -> None:
    """Whatever is lost or dropped: a value that returns is the one that the publisher said last, in its life of now."""
    reading, now, life, level, number = Reading(timing=PubSubTiming()), 100.0, 7, 0, 0
    reading.receive([announced(life)], now)
    has: float | None = None
    """What the publisher has said last in this life."""
    held: float | None = None
    stamp = WALL

    def send(part: DataSetMessage, arrives: bool) -> None:
        nonlocal held
        if not arrives:
            return
        for event in reading.receive([sent_by(part)], now):
            if isinstance(event, DataReceived):
                held = event.message.values[0]

    for name, arrives in steps:
        now += 2.0
        if name == "restart":
            life, number, has = life + 1, 0, None
            reading.receive([announced(life)], now)
        elif name in ("publish", "unknown"):
            level, stamp = level + 1, stamp + 10
            has = float(level)
            major = life if name == "publish" else life + 1000
            send(frame(number, values=(has, "a"), timestamp=stamp, major_version=major), arrives)
            number += 1
        elif name == "repeat" and has is not None:
            send(frame(number, values=(has, "a"), timestamp=stamp, major_version=life), arrives)
            number += 1
        elif name == "keep-alive":
            alive = DataSetMessage(
                TOPIC.id, kind=int(FrameKind.KEEP_ALIVE), sequence_number=number & 0xFFFF, major_version=life
            )
            send(alive, arrives)
        reading.run_until(now)
        writer = reading.subscriber.writers.get(TOPIC)
        if writer is not None and writer.attested_at == now and held is not None:
            assert held == has


def test_the_repeats_of_a_publisher_attest_its_value_for_ever() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish()], 100.0)
    for time, datagrams in writing.run_until(400.0):
        assert not reading.run_until(time)
        assert not reading.receive(datagrams, time)
    assert {part.kind for part in messages(writing.publish())} == {int(FrameKind.KEY)}


def test_a_source_that_has_said_nothing_appears_by_its_keep_alives_alone() -> None:
    writing, reading = Writing(), Reading()
    announced_only, alive = writing.announce()
    assert not only(SourceAppeared, reading.receive([announced_only], 100.0)), "anybody may keep metadata"
    assert reading.receive([alive], 100.0)[-1] == SourceAppeared(TOPIC)
    said = [event for time, datagrams in writing.run_until(120.0) for event in reading.receive(datagrams, time)]
    assert said == []
    # Dead, it is silent; there again, nobody has a value of it that could be of now, until it says one.
    assert [event for _, event in reading.run_until(130.0)] == [SourceSilent(TOPIC)]
    writing.now = 130.0
    assert reading.receive(writing.announce(), 130.0) == [SourceStale(TOPIC)]
    assert [event for time, sent in writing.run_until(140.0) for event in reading.receive(sent, time)] == []
    assert [type(event) for event in reading.receive(writing.publish(), 140.0)] == [SourceReturned, DataReceived]


def test_a_keep_alive_after_a_first_message_that_was_dropped_tells_that_its_source_is_there() -> None:
    reading = Reading()
    reading.receive([announced(7), sent_by(frame(0, types=(DOUBLE,), values=(1.0,)))], 100.0)
    alive = DataSetMessage(TOPIC.id, kind=int(FrameKind.KEEP_ALIVE), sequence_number=1, major_version=7)
    assert reading.receive([sent_by(alive)], 100.5) == [SourceAppeared(TOPIC)]


def test_a_source_that_was_lost_before_it_said_anything_does_not_appear() -> None:
    writing, reading = Writing(), Reading()
    announced_only, _ = writing.announce()  # nobody hears its keep-alive
    lost = writing.publisher.source_lost(TOPIC, timestamp=WALL, now=100.5)
    said = reading.receive([announced_only, *lost], 100.5)
    said += [event for time, sent in writing.run_until(200.0) for event in reading.receive(sent, time)]
    assert not only(SourceAppeared, said)
    said += [event for _, event in reading.run_until(200.0)]
    assert said[-1] == SourceSilent(TOPIC)
    assert reading.subscriber.known(TOPIC)[-1] == SourceSilent(TOPIC)
