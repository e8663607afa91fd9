"""A subscriber that hears by several connections: a writer is one writer, by whichever of them it is heard."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Writing, announcements, only
from tests.unit.pubsub.security.securing import SIGN, UINT16, envelope, one
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import DataReceived, MetaDataReceived, PubSubTiming, Subscriber, SubscriberEvent, announced
from ua_fleet.pubsub.events import ActionReceived, EventReceived, SetpointReceived, SourceReturned, SourceSilent
from ua_fleet.pubsub.layout import WriterSettings
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security.envelopes import Envelopes
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.pubsub.security.nonces import BLOCK, MemoryNonces
from ua_fleet.values import BuiltinType
from ua_fleet.wire import encode_action, encode_announcement
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ConnectionsAnnouncement, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

GROUP = telemetry_group(TOPIC.space)
WILL = encode_announcement(StatusAnnouncement(TOPIC.space, UINT16, 0, False, PubSubState.ERROR.value))


class TwoWays:
    """A writer, and a reader with two connections that have no keys."""

    def __init__(self, barred: tuple[int, ...] = ()) -> None:
        self.writing = Writing()
        self.counters = Counters()
        self.subscriber = Subscriber(0, PubSubTiming(), self.counters, CODEC)
        assert self.subscriber.add_connection(None, barred=barred) == 1

    def hear(self, datagrams: list[bytes], connection: int = 0) -> list[SubscriberEvent]:
        now = self.writing.now
        return [each for one in datagrams for each in self.subscriber.receive(one, now, connection=connection)]

    def announce(self) -> None:
        self.hear(self.writing.announce())


def test_what_comes_by_both_is_handed_on_once_and_the_double_is_counted() -> None:
    both = TwoWays()
    both.announce()
    sent = both.writing.publish(1.0)
    assert len(only(DataReceived, both.hear(sent, 1))) == 1
    assert both.hear(sent, 0) == []
    assert both.counters.drops == {Drop.DUPLICATE: 1}


def test_the_newest_value_stands_though_the_older_one_comes_after_it() -> None:
    both = TwoWays()
    both.announce()
    old, new = both.writing.publish(1.0), both.writing.publish(2.0, timestamp=WALL + 1)
    [event] = only(DataReceived, both.hear(new, 1))
    assert event.message.values[0] == 2.0
    assert only(DataReceived, both.hear(old, 0)) == []
    assert both.subscriber.writers[TOPIC].handed_on == WALL + 1


def test_a_value_that_another_publisher_of_the_same_source_numbers_anew_falls_by_its_timestamp() -> None:
    both = TwoWays()
    both.announce()
    both.hear(both.writing.publish(1.0))
    message = CODEC.decode(one(both.writing.publisher.poll(both.writing.now + 5.0)))
    assert isinstance(message, NetworkMessage)
    [part] = message.messages
    again = CODEC.encode(message._replace(messages=(part._replace(sequence_number=part.sequence_number or 0),)))
    assert both.hear([again], 1) == []
    assert both.counters.drops == {Drop.REPEATED: 1}


def test_an_event_that_the_faster_connection_lost_is_told_when_the_slower_one_brings_it_and_then_not_again() -> None:
    both = TwoWays()
    both.writing.publisher = Publisher(
        TOPIC.space, PubSubTiming(), Counters(), CODEC, settings={TOPIC: WriterSettings(are_events=True)}
    )
    both.announce()
    first, second, third = (both.writing.publish(float(n), timestamp=WALL + n) for n in range(3))
    told = [
        event.message.values[0]
        for way, sent in ((1, first), (1, third), (0, second))
        for event in only(EventReceived, both.hear(sent, way))
    ]
    assert told == [0.0, 2.0, 1.0]
    assert both.hear([*first, *third], 0) == []
    assert both.hear(second, 1) == []


def test_a_writer_lives_while_it_is_heard_by_either_connection() -> None:
    both = TwoWays()
    both.announce()
    both.hear(both.writing.publish(1.0))
    for second in range(1, 12):
        both.writing.now = 100.0 + second
        sent = both.writing.publisher.poll(both.writing.now)
        both.hear(sent, second % 2)
        assert not only(SourceSilent, both.subscriber.poll(both.writing.now))
    both.writing.now += 3.1
    assert only(SourceSilent, both.subscriber.poll(both.writing.now)) == [SourceSilent(TOPIC)]


def test_a_will_ends_nothing_that_is_heard_by_the_other_connection() -> None:
    both = TwoWays()
    both.announce()
    both.hear(both.writing.publish(1.0), 0)
    assert not only(SourceSilent, both.subscriber.receive(WILL, 100.5, is_fresh=False, connection=1))
    both.writing.now = 101.0
    both.hear(both.writing.publish(2.0, timestamp=WALL + 1), 1)  # by this one alone from now on
    assert only(SourceSilent, both.subscriber.receive(WILL, 103.9, is_fresh=False, connection=1)) == [
        SourceSilent(TOPIC)
    ]
    both.writing.now = 104.0
    assert only(SourceReturned, both.hear(both.writing.publish(3.0, timestamp=WALL + 2), 0))


def test_a_space_is_not_heard_by_a_connection_that_its_bridge_is_not_on() -> None:
    both = TwoWays(barred=(TOPIC.space,))
    announced, sent = both.writing.announce(), both.writing.publish(1.0)
    assert both.hear([*announced, *sent], 1) == []
    assert both.counters.drops == {Drop.NOT_ITS_CONNECTION: len(announced) + 1}
    assert not both.subscriber.writers
    assert only(DataReceived, both.hear([*announced, *sent], 0))


def response() -> bytes:
    return encode_action(ActionMessage(TOPIC.space, 2, 7, 1, 1, ActionState.DONE.value, is_request=False))


def test_actions_and_setpoints_come_only_where_they_are_taken() -> None:
    counters = Counters()
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC)
    subscriber.add_connection(None, takes_actions=False)
    assert only(ActionReceived, subscriber.receive(response(), 0.0, connection=0))
    assert subscriber.receive(response(), 0.0, connection=1) == []
    assert counters.drops == {Drop.NOT_ITS_CONNECTION: 1}
    part = DataSetMessage(9, types=(int(BuiltinType.DOUBLE),), values=(1.0,))
    setpoint = CODEC.encode(NetworkMessage(0, writer_group_id=60, messages=(part,)))
    driven = Subscriber(4, PubSubTiming(), counters, CODEC, setpoint_groups={60: 4})
    driven.add_connection(None, takes_actions=False)
    assert only(SetpointReceived, driven.receive(setpoint, 0.0, connection=0))
    assert driven.receive(setpoint, 0.0, connection=1) == []
    assert counters.drops == {Drop.NOT_ITS_CONNECTION: 2}


def test_what_one_connection_has_brought_is_not_carried_to_another() -> None:
    writing, counters = Writing(), Counters()
    sealer = envelope(TOPIC.space, GROUP, mode=SIGN)
    first, second = Envelopes([envelope(0, GROUP, mode=SIGN), envelope(0, GROUP, mode=SIGN)])
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=first)
    subscriber.add_connection(second)
    sealed = [each for plain in [*writing.announce(), *writing.publish(1.0)] for each in sealer.seal(plain, 0.0)]
    events = [event for each in sealed for event in subscriber.receive(each, 0.0, connection=0)]
    assert len(only(DataReceived, events)) == 1
    for each in sealed:
        assert subscriber.receive(each, 0.0, connection=1) == []
    assert counters.drops == {Drop.REPLAYED: len(sealed)}
    reserved = MemoryNonces()
    reserved.reserve(GROUP, 1, BLOCK)
    other = envelope(TOPIC.space, GROUP, mode=SIGN, nonces=reserved)
    for each in [part for plain in writing.publish(3.0, timestamp=WALL + 5) for part in other.seal(plain, 0.0)]:
        assert only(DataReceived, subscriber.receive(each, 0.0, connection=1)), "what has a nonce of its own comes"
    assert subscriber.receive(writing.publish(2.0, timestamp=WALL + 1)[0], 0.0, connection=1) == []
    assert counters.drops[Drop.NOT_SECURED] == 1


def test_an_unsecured_connection_does_not_change_what_a_secured_one_has_announced() -> None:
    writing, counters = Writing(), Counters()
    sealer = envelope(TOPIC.space, GROUP, mode=SIGN)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=envelope(0, GROUP, mode=SIGN))
    subscriber.add_connection(None)

    def secured(plain: list[bytes]) -> list[SubscriberEvent]:
        return [event for each in plain for part in sealer.seal(each, 0.0) for event in subscriber.receive(part, 0.0)]

    first = writing.announce()[0]
    assert subscriber.receive(first, 0.0, connection=1) == []  # before it is known otherwise, it counts
    secured([first])
    forged = Writing().announce(fields=tuple(each._replace(name="forged") for each in FIELDS))[0]
    assert subscriber.receive(forged, 0.0, connection=1) == []
    responder = encode_announcement(ConnectionsAnnouncement(TOPIC.space, UINT16, 0, ()))
    secured([responder])
    assert subscriber.receive(responder, 0.0, connection=1) == []
    assert counters.drops == {Drop.NOT_SECURED: 2}
    [known] = only(MetaDataReceived, secured(writing.publish(1.0)))
    assert [each.name for each in known.metadata.fields] == ["level", "name"]


def test_how_announcements_were_secured_is_remembered_of_all_where_a_publisher_makes_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(announced, "_MOST_MODES", 4)
    counters = Counters()
    sealer = envelope(TOPIC.space, GROUP, mode=SIGN)
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=envelope(0, GROUP, mode=SIGN))
    subscriber.add_connection(None)
    [said, _] = Writing().announce()
    [made] = announcements([said])
    for number in range(1, 11):
        for part in sealer.seal(encode_announcement(made._replace(data_set_writer_id=number)), 0.0):
            subscriber.receive(part, 0.0)
    for number in range(1, 13):  # two of them nobody has announced
        subscriber.receive(encode_announcement(made._replace(data_set_writer_id=number)), 0.0, connection=1)
    assert counters.drops == {Drop.NOT_SECURED: 12}


def test_no_command_group_is_asked_for_by_hearing_another_ones_actions() -> None:
    subscriber = Subscriber(0, PubSubTiming(), Counters(), CODEC)
    reader = envelope(0, GROUP, mode=SIGN)
    subscriber.add_connection(reader)
    sealed = envelope(TOPIC.space, command_group(TOPIC.space), mode=SIGN).seal(response(), 0.0)
    assert [event for each in sealed for event in subscriber.receive(each, 0.0, connection=1)] == []
    assert command_group(TOPIC.space) not in reader.groups_wanted()
