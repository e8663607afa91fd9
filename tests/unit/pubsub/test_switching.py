"""A component that is disabled sends or takes nothing, and what it missed is there when it is enabled again."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, TOPIC, WALL, Reading, Writing, announcements, decoded, messages, only
from ua_fleet.counters import Drop
from ua_fleet.pubsub import DataReceived, SourceReturned, SourceSilent
from ua_fleet.pubsub.components import (
    CONNECTION,
    Component,
    StateInvalid,
    reader,
    reader_group,
    writer,
    writer_group,
)
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire import encode_probe
from ua_fleet.wire.discovered import (
    ConnectionsAnnouncement,
    PubSubState,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

OTHER = Topic(1, 3, 1002)
LATER = WALL + 10_000_000


def begun() -> Writing:
    """A publisher that has begun, with a writer in each of two groups."""
    writing = Writing()
    writing.publisher.begin(now=writing.now, wall_ticks=WALL)
    writing.announce()
    writing.announce(OTHER)
    writing.publish(1.0)
    writing.publish(2.0, topic=OTHER)
    writing.run_until(writing.now + 1.5)
    return writing


def data_until(writing: Writing, end: float) -> set[int]:
    """The DataSetWriters of whose data or metadata anything is sent until then."""
    sent = [datagram for _, datagrams in writing.run_until(end) for datagram in datagrams]
    parts = {part.data_set_writer_id for part in messages(sent)}
    return parts | {announcement.data_set_writer_id for announcement in announcements(sent)}


@pytest.mark.parametrize(
    ("component", "on"), [(writer(2, 1001), {1002}), (writer_group(2), {1002}), (CONNECTION, set[int]())]
)
def test_what_is_disabled_sends_nothing_whatever_its_source_says(component: Component, on: set[int]) -> None:
    writing = begun()
    switches = writing.publisher.switches
    switches.disable(component, timestamp=LATER, now=writing.now)
    assert writing.publish(3.0, timestamp=LATER + 5) == []
    assert writing.counters.drops == {Drop.DISABLED: 1}
    assert writing.announce() == []
    probe = Probe(1, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1001,))
    assert writing.publisher.answer(probe, writing.now) == []
    assert data_until(writing, writing.now + 200.0) == on
    switches.enable(component, now=writing.now)
    assert data_until(writing, writing.now + 2.0) == {1001, 1002}


@pytest.mark.parametrize("component", [writer(2, 1001), writer_group(2), CONNECTION])
def test_the_last_value_of_the_meantime_is_said_when_it_is_enabled(component: Component) -> None:
    writing, reading = begun(), Reading()
    reading.receive(writing.announce(), writing.now)
    reading.receive(writing.publish(1.0, timestamp=WALL + 1), writing.now)
    gone = writing.publisher.switches.disable(component, timestamp=LATER, now=writing.now)
    told = only(DataReceived, reading.receive(gone, writing.now))
    if component == writer(2, 1001):
        assert [each.message.status for each in told] == [StatusCode.BAD_NO_COMMUNICATION >> 16 << 16]
    else:
        assert told == []
        assert only(SourceSilent, [event for _, event in reading.run_until(writing.now + 4)]) == [SourceSilent(TOPIC)]
    writing.now += 10
    for level in (7.0, 8.0):
        writing.publish(level, timestamp=LATER + 100)
    writing.publisher.switches.enable(component, now=writing.now)
    sent = [datagram for _, datagrams in writing.run_until(writing.now + 1.0) for datagram in datagrams]
    [data] = [each for each in only(DataReceived, reading.receive(sent, writing.now)) if each.topic == TOPIC]
    assert (data.message.values, data.message.status or 0) == ((8.0, "a"), 0)


def test_a_value_that_has_not_changed_is_good_again_after_the_word_that_it_was_gone() -> None:
    writing, reading = begun(), Reading()
    reading.receive(writing.announce(), writing.now)
    reading.receive(writing.publish(1.0, timestamp=WALL + 1), writing.now)
    one = writer(2, 1001)
    reading.receive(writing.publisher.switches.disable(one, timestamp=LATER, now=writing.now), writing.now)
    writing.publisher.switches.enable(one, now=writing.now)
    sent = [datagram for _, datagrams in writing.run_until(writing.now + 1.0) for datagram in datagrams]
    data = only(DataReceived, reading.receive(sent, writing.now))
    assert [(each.message.values, each.message.status or 0) for each in data if each.topic == TOPIC] == [
        ((1.0, "a"), 0)
    ]


def test_a_source_that_was_lost_meanwhile_stays_silent_until_it_is_back() -> None:
    writing = begun()
    one = writer(2, 1001)
    writing.publisher.switches.disable(one, timestamp=LATER, now=writing.now)
    assert writing.publisher.source_lost(TOPIC, timestamp=LATER, now=writing.now) == []
    writing.publisher.switches.enable(one, now=writing.now)
    assert data_until(writing, writing.now + 20.0) == {1002}
    assert messages(writing.publish(4.0, timestamp=LATER + 9))


def test_a_writer_that_comes_while_its_group_is_disabled_is_paused_with_it() -> None:
    writing = begun()
    writing.publisher.switches.disable(writer_group(2), timestamp=LATER, now=writing.now)
    new = Topic(1, 2, 1003)
    assert writing.announce(new) == []
    assert writing.publish(topic=new, timestamp=LATER) == []
    writing.publisher.switches.enable(writer_group(2), now=writing.now)
    assert data_until(writing, writing.now + 2.0) == {1001, 1002, 1003}


def test_the_configuration_says_what_is_disabled() -> None:
    writing = begun()
    sent = writing.publisher.switches.disable(writer(2, 1001), timestamp=LATER, now=writing.now)
    sent += [datagram for _, datagrams in writing.run_until(writing.now + 2.0) for datagram in datagrams]
    [told] = [each for each in decoded(sent) if isinstance(each, WriterConfigurationAnnouncement)]
    assert (told.writer_group.enabled, [each.enabled for each in told.writer_group.data_set_writers]) == (True, [False])
    sent = writing.publisher.switches.disable(CONNECTION, timestamp=LATER, now=writing.now)
    sent += [datagram for _, datagrams in writing.run_until(writing.now + 60.0) for datagram in datagrams]
    states = [each for each in decoded(sent) if isinstance(each, StatusAnnouncement)]
    assert [(each.is_cyclic, each.state) for each in states] == [(False, PubSubState.DISABLED)]
    [connections] = [each for each in decoded(sent) if isinstance(each, ConnectionsAnnouncement)]
    [connection] = connections.connections
    assert not connection.enabled
    assert {group.writer_group_id: group.enabled for group in connection.writer_groups} == {2: True, 3: True}
    sent = writing.publisher.switches.enable(CONNECTION, now=writing.now)
    assert [each.state for each in decoded(sent) if isinstance(each, StatusAnnouncement)] == [PubSubState.OPERATIONAL]


@pytest.mark.parametrize("component", [reader(TOPIC), reader_group(1), CONNECTION])
def test_what_is_read_by_a_disabled_reader_is_silent_and_nothing_of_it_is_taken(component: Component) -> None:
    writing, reading = Writing(), Reading()
    subscriber = reading.subscriber
    reading.receive([*writing.announce(), *writing.publish(1.0)], 100.0)
    reading.receive([*writing.announce(OTHER), *writing.publish(1.0, topic=OTHER)], 100.0)
    assert only(SourceSilent, subscriber.disable(component))[0] == SourceSilent(TOPIC)
    writing.now = 101.0
    taken = reading.receive([*writing.publish(2.0, timestamp=LATER), *writing.publish(3.0, topic=OTHER)], 101.0)
    assert [each.topic for each in only(DataReceived, taken)] == ([OTHER] if component == reader(TOPIC) else [])
    assert reading.counters.drops[Drop.DISABLED] == (1 if component == reader(TOPIC) else 2)
    with pytest.raises(StateInvalid):
        subscriber.disable(component)
    subscriber.enable(component)
    back = reading.receive(writing.publish(4.0, timestamp=LATER + 1), 101.0)
    assert {type(each) for each in back} == {SourceReturned, DataReceived}
    assert subscriber.writers[TOPIC].silences == 1


def test_a_disabled_connection_still_hears_who_asks_for_it() -> None:
    reading = Reading()
    reading.subscriber.disable(CONNECTION)
    probe = encode_probe(Probe(0, PublisherIdType.UINT16, ProbeKind.PUBSUB_CONNECTIONS))
    assert len(reading.receive([probe], 100.0)) == 1


def test_network_messages_and_what_failed_are_counted_where_it_was() -> None:
    writing, reading = begun(), Reading()
    assert writing.publisher.sent_messages[2] > 1
    before = writing.publisher.sent_messages[2]
    sent = writing.publish(5.0, timestamp=LATER)
    assert writing.publisher.sent_messages[2] == before + 1
    reading.receive(sent, writing.now)
    assert reading.subscriber.received_messages == {1: 1}
    assert reading.subscriber.writers[TOPIC].failed == 1  # its metadata is not known
    assert CODEC.decode(sent[0])
