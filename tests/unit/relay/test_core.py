"""What a relay forwards, and what it does not, between a writer and a reader that have nothing else in common."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, announcements, messages, only
from tests.unit.pubsub.security.securing import ENCRYPT, NONE, SIGN, UINT16, action, data, envelope, group_keys
from tests.unit.relay.between import GATE, HALL, SETPOINTS, SITE, Between, relay_envelope
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    DataReceived,
    EventReceived,
    MetaDataReceived,
    Publisher,
    PubSubTiming,
    SourceAppeared,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceStale,
    Subscriber,
)
from ua_fleet.pubsub.layout import WriterSettings
from ua_fleet.pubsub.origins import NO_ORIGINS, Direction, Origins
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.relay import RelayCore, RelayedConnection
from ua_fleet.relay.core import ANSWER_INTERVAL_S
from ua_fleet.topics import Topic
from ua_fleet.wire import encode_announcement, encode_probe, read_security
from ua_fleet.wire.discovered import ApplicationAnnouncement, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import (
    DataSetMessage,
    FieldEncoding,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

OTHER = Topic(1, 2, 1002)
STATUS = encode_announcement(StatusAnnouncement(TOPIC.space, UINT16, 0, False, PubSubState.ERROR.value))


def plain(between: Between, connection: int, datagrams: list[bytes]) -> list[bytes]:
    """What the relay sends by a connection for what the writer says, before it is secured."""
    return [plain for to, plain in between.said(datagrams) if to == connection]


@pytest.mark.parametrize("mode", [NONE, SIGN, ENCRYPT])
def test_a_value_arrives_as_it_was_said_with_its_metadata_before_it(mode: Any) -> None:
    between = Between(mode=mode)
    between.carry(between.writing.announce())
    sent = between.writing.publish(1.5, status=0x40_00_00_00)
    [event] = only(DataReceived, between.carry(sent))
    [said] = messages(sent)
    assert event.message == said
    assert between.subscriber.writers[TOPIC].metadata == between.writing.publisher.metadata(TOPIC)
    assert between.read_counters.drops == {}


@pytest.mark.parametrize("mode", [NONE, SIGN, ENCRYPT])
def test_a_bridge_whose_publisher_id_is_a_text_is_forwarded_under_it(mode: Any) -> None:
    ids = PublisherIds({TOPIC.space: (PublisherIdType.STRING.value, "Cell 1")})
    between = Between(mode=mode, ids=ids)
    between.carry(between.writing.announce())
    forwarded = between.said(between.writing.publish(1.5))
    [sealed] = [each for to, plain in forwarded if to == SITE for each in between.sealed(plain)]
    assert read_security(sealed).publisher_id == "Cell 1"
    [event] = only(DataReceived, between.subscriber.receive(sealed, between.now))
    assert (event.topic, event.message.values[0]) == (TOPIC, 1.5)
    assert between.counters.drops == between.read_counters.drops == {}


def test_a_keep_alive_of_the_source_attests_it_and_the_relay_has_none_of_its_own() -> None:
    between = Between()
    between.carry(between.writing.announce())
    between.carry(between.writing.publish())
    for second in range(1, 11):
        between.writing.now = 100.0 + second
        assert not only(SourceSilent, between.carry(between.writing.publisher.poll(between.now)))
        assert not only(SourceSilent, between.subscriber.poll(between.now))
    # The source falls silent; the relay goes on, and says nothing in its place.
    for tenth in range(40):
        between.writing.now = 110.0 + tenth / 10
        between.heard(between.relay.poll(between.now))
        silent = only(SourceSilent, between.subscriber.poll(between.now))
        if silent:
            assert between.now >= 113.0
            return
    raise AssertionError("the source lives on without its publisher")


def test_the_same_value_by_another_road_falls_and_so_does_a_repeat() -> None:
    between = Between(mode=NONE)
    direct = between.subscriber.add_connection(None)
    between.carry(between.writing.announce())
    sent = between.writing.publish(1.0)
    assert len(only(DataReceived, between.carry(sent))) == 1
    assert between.subscriber.receive(sent[0], between.now, connection=direct) == []
    assert between.read_counters.drops == {Drop.DUPLICATE: 1}
    between.writing.now += 5.0
    [repeat] = between.writing.publisher.poll(between.now)
    assert not only(DataReceived, between.subscriber.receive(repeat, between.now, connection=direct))
    assert not only(DataReceived, between.carry([repeat]))
    assert between.read_counters.drops == {Drop.DUPLICATE: 2, Drop.REPEATED: 1}
    # The relay first, then the direct road: the Timestamp alone tells it, where the numbers are others.
    [newer] = between.writing.publish(2.0, timestamp=WALL + 1)
    message = CODEC.decode(newer)
    assert isinstance(message, NetworkMessage)
    [part] = message.messages
    assert only(DataReceived, between.carry([newer]))
    jumped = part._replace(sequence_number=(part.sequence_number or 0) + 1)
    again = CODEC.encode(message._replace(messages=(jumped,)))
    assert not only(DataReceived, between.subscriber.receive(again, between.now, connection=direct))
    assert between.read_counters.drops[Drop.REPEATED] == 2


def test_data_without_metadata_is_not_forwarded_and_the_source_is_asked() -> None:
    between = Between()
    between.writing.announce()
    assert between.said(between.writing.publish(1.0)) == []
    assert between.counters.drops == {Drop.NO_METADATA: 1}
    due = between.relay.next_deadline()
    assert due is not None
    between.writing.now = due
    [(connection, probe)] = between.relay.poll(between.now)
    assert connection == HALL
    asked = CODEC.decode(probe)
    assert isinstance(asked, Probe)
    assert (asked.publisher_id, asked.data_set_writer_ids) == (TOPIC.space, (TOPIC.id,))
    events = between.carry(between.answered(probe))  # metadata, and the last value again
    assert [type(event) for event in events if isinstance(event, MetaDataReceived | DataReceived)] == [
        MetaDataReceived,
        DataReceived,
    ]
    assert between.relay.next_deadline() is None


def test_at_its_start_it_asks_all_origins_and_so_has_their_last_values() -> None:
    between = Between()
    between.carry(between.writing.announce())
    between.carry(between.writing.publish(1.0))
    between.writing.now += 2.0
    between.relay = between.made()  # it was killed, and has no memory
    events = between.heard(between.relay.begin())
    assert between.counters.drops == {}
    assert not only(DataReceived, events)  # the reader has it
    assert between.read_counters.drops[Drop.REPEATED] == 1
    [new] = only(DataReceived, between.carry(between.writing.publish(2.0, timestamp=WALL + 1)))
    assert new.message.values[0] == 2.0


def test_listed_sources_alone_are_asked_for_forwarded_and_taken() -> None:
    between = Between(Origins(sources=[TOPIC]))
    [(_, probe)] = between.relay.begin()
    asked = CODEC.decode(probe)
    assert isinstance(asked, Probe)
    assert asked.data_set_writer_ids == (TOPIC.id,)
    between.carry(between.writing.announce())
    between.carry(between.writing.announce(OTHER, name="other"))
    between.counters.drops.clear()
    assert only(DataReceived, between.carry(between.writing.publish(1.0)))
    assert between.said(between.writing.publish(1.0, topic=OTHER)) == []
    assert between.counters.drops == {Drop.NOT_LISTED: 1}


def test_of_a_message_with_several_those_that_are_listed_go_on_together() -> None:
    between = Between(Origins(sources=[TOPIC, OTHER]))
    third = Topic(1, 2, 1003)
    for topic in (TOPIC, OTHER, third):
        between.carry(between.writing.announce(topic, name=topic.name))
    between.writing.now += 1.5
    [together] = between.writing.publisher.poll(between.now)
    assert len(messages([together])) == 3
    [(_, forwarded)] = between.said([together])
    assert [part.data_set_writer_id for part in messages([forwarded])] == [TOPIC.id, OTHER.id]


def test_a_broker_gets_each_alone() -> None:
    between = Between(takes_one=True)
    for topic in (TOPIC, OTHER):
        between.carry(between.writing.announce(topic, name=topic.name))
    between.writing.now += 1.5
    sent = plain(between, SITE, between.writing.publisher.poll(between.now))
    assert [len(messages([each])) for each in sent] == [1, 1]


def test_an_origin_that_is_not_listed_is_neither_opened_nor_forwarded() -> None:
    between = Between(Origins([2]))
    assert between.said(between.writing.announce()) == []
    assert between.said(between.writing.publish()) == []
    assert between.counters.drops == {Drop.NOT_LISTED: 3}


def test_a_forged_message_of_a_listed_origin_is_refused() -> None:
    between = Between()
    forger = envelope(TOPIC.space, telemetry_group(TOPIC.space), seed="forged")
    between.carry(between.writing.announce())
    for sealed in forger.seal(data(publisher_id=TOPIC.space), between.now):
        assert between.relay.receive(HALL, sealed, between.now) == []
    assert between.relay.receive(HALL, data(publisher_id=TOPIC.space), between.now) == []
    assert between.counters.drops == {Drop.BAD_SIGNATURE: 1, Drop.NOT_SECURED: 1}
    assert {complaint.cause for complaint in between.relay.complaints(between.now)} == {"bad_signature", "not_secured"}


def test_what_was_recorded_and_is_sent_again_is_refused() -> None:
    between = Between()
    between.carry(between.writing.announce())
    [sealed] = between.own.seal(between.writing.publish(1.0)[0], between.now)
    assert len(between.relay.receive(HALL, sealed, between.now)) == 1
    assert between.relay.receive(HALL, sealed, between.now) == []
    assert between.counters.drops == {Drop.REPLAYED: 1}


def test_actions_and_setpoints_are_never_forwarded_though_their_space_is_listed() -> None:
    between = Between(Origins([0, TOPIC.space]))
    commanding = envelope(0, command_group(TOPIC.space), telemetry_group(0), setpoint_groups=SETPOINTS)
    setpoint = data(publisher_id=0, writer_group_id=next(iter(SETPOINTS)))
    for plain in (action(publisher_id=TOPIC.space), setpoint):
        for datagram in (plain, *commanding.seal(plain, between.now)):
            assert between.relay.receive(HALL, datagram, between.now) == []
            assert between.relay.receive(SITE, datagram, between.now) == []
    assert between.counters.drops == {Drop.NOT_RELAYED: 8}


def test_a_setpoint_that_comes_in_a_relays_name_is_not_taken() -> None:
    between = Between(Origins([0, TOPIC.space]), mode=NONE)
    between.subscriber = Subscriber(
        1, PubSubTiming(), between.read_counters, CODEC, relayed=between.origins, setpoint_groups=SETPOINTS
    )
    [group] = SETPOINTS
    assert between.subscriber.receive(data(publisher_id=0, writer_group_id=group), between.now) == []
    assert between.read_counters.drops == {Drop.NOT_ITS_CONNECTION: 1}


def test_what_the_relay_says_comes_back_to_it_and_goes_no_further() -> None:
    between = Between()
    between.carry(between.writing.announce())
    for _, plain in between.said(between.writing.publish()):
        for sealed in between.sealed(plain):
            assert between.relay.receive(SITE, sealed, between.now) == []
    assert between.counters.drops == {Drop.LOOP: 1}


def test_a_reader_takes_of_a_relay_only_what_is_listed_and_of_nobody_else() -> None:
    between = Between(trusted=Origins(sources=[TOPIC]))
    between.carry(between.writing.announce(OTHER, name="other"))
    assert between.carry(between.writing.publish(topic=OTHER)) == []
    assert between.read_counters.drops == {Drop.NOT_ITS_CONNECTION: 3}  # metadata, keep-alive, value
    between.read_counters.drops.clear()
    between.reading.want(telemetry_group(TOPIC.space))
    between.reading.install(telemetry_group(TOPIC.space), group_keys(seed=f"0{telemetry_group(TOPIC.space)}"), 0.0)
    between.writing.announce()
    for sealed in between.own.seal(between.writing.publish()[0], between.now):  # the origin's own keys are not it here
        assert not only(DataReceived, between.subscriber.receive(sealed, between.now))
    assert between.read_counters.drops == {Drop.BAD_SIGNATURE: 1}


def test_the_keys_of_a_relay_speak_for_nobody_who_is_not_listed() -> None:
    between = Between()
    between.reading.want(telemetry_group(2))
    between.reading.install(telemetry_group(2), group_keys(seed="0t-2"), 0.0)
    for sealed in between.sealed(data(publisher_id=2)):
        assert only(SourceRefused, between.subscriber.receive(sealed, between.now))
    assert between.read_counters.drops == {Drop.BAD_SIGNATURE: 1}


def test_a_relay_without_the_key_of_its_group_says_nothing() -> None:
    counters = Counters()
    silent = relay_envelope(telemetry_group(TOPIC.space), counters=counters)
    assert silent.seal(data(publisher_id=TOPIC.space), 0.0) == []
    assert counters.drops == {Drop.NO_KEY: 1}
    assert silent.sending_token(0.0) == 0
    assert relay_envelope(GATE).sending_token(0.0) == 1


def test_states_are_forwarded_and_where_a_publisher_is_found_is_not() -> None:
    between = Between()
    [(to, forwarded)] = between.said([STATUS])
    said = CODEC.decode(forwarded)
    assert isinstance(said, StatusAnnouncement)
    assert (to, said.publisher_id, said.state) == (SITE, TOPIC.space, PubSubState.ERROR)
    begun = between.writing.publisher.begin(now=between.now, wall_ticks=WALL)
    kinds = [type(CODEC.decode(each)) for each in begun]
    assert ApplicationAnnouncement in kinds
    assert [type(CODEC.decode(plain)) for _, plain in between.said(begun)] == [StatusAnnouncement]


def test_a_will_that_the_relay_forwards_makes_the_source_silent() -> None:
    between = Between()
    between.carry(between.writing.announce())
    between.carry(between.writing.publish())
    assert only(SourceSilent, between.carry([STATUS], is_fresh=False)) == [SourceSilent(TOPIC)]


def test_what_a_broker_has_kept_is_no_data_and_its_old_metadata_does_not_replace_a_later_one() -> None:
    between = Between()
    old = between.writing.announce()[0]
    between.said([old], is_fresh=False)
    [new, alive] = between.writing.announce(fields=FIELDS[:1], wall_ticks=WALL + 10_000_000_000)
    between.carry([new, alive])
    [later] = announcements([new])
    assert between.said([old], is_fresh=False) == []
    assert between.said([alive], is_fresh=False) == []
    assert between.counters.drops == {Drop.RETAINED: 2}
    assert between.subscriber.writers[TOPIC].metadata == later.metadata


def test_a_reader_takes_metadata_of_a_relay_as_if_a_broker_had_kept_it() -> None:
    between = Between()
    old = announcements(between.writing.announce())[0]
    between.carry(between.writing.announce(fields=FIELDS[:1], wall_ticks=WALL + 10_000_000_000))
    for sealed in between.sealed(encode_announcement(old)):
        between.subscriber.receive(sealed, between.now)
    assert between.read_counters.drops == {Drop.RETAINED: 1}


def test_who_asks_at_the_target_gets_the_metadata_and_the_last_value_and_that_once_a_second() -> None:
    between = Between()
    between.carry(between.writing.announce())
    between.carry(between.writing.publish())
    between.writing.now += 1.5
    probe = encode_probe(Probe(TOPIC.space, UINT16, ProbeKind.DATA_SET_META_DATA.value, (TOPIC.id,)))
    (to, metadata), (back, asked) = between.relay.receive(SITE, probe, between.now)
    assert (to, back) == (SITE, HALL)
    assert announcements([metadata])[0].metadata == between.writing.publisher.metadata(TOPIC)
    repeated = messages([each for connection, each in between.said(between.answered(asked)) if connection == SITE])
    assert [part.values[0] for part in repeated] == [1.0]
    assert between.relay.receive(SITE, probe, between.now + ANSWER_INTERVAL_S / 2) == []
    assert len(between.relay.receive(SITE, probe, between.now + ANSWER_INTERVAL_S)) == 2
    everything = encode_probe(Probe(TOPIC.space, UINT16, ProbeKind.DATA_SET_META_DATA.value))
    assert len(between.relay.receive(SITE, everything, between.now + 2 * ANSWER_INTERVAL_S)) == 2
    assert between.relay.receive(SITE, everything, between.now + 2.5 * ANSWER_INTERVAL_S) == []


def test_a_probe_in_the_hall_or_for_another_publisher_is_not_answered() -> None:
    between = Between()
    between.carry(between.writing.announce())
    kind = ProbeKind.DATA_SET_META_DATA.value
    assert between.relay.receive(HALL, encode_probe(Probe(TOPIC.space, UINT16, kind)), between.now) == []
    assert between.relay.receive(SITE, encode_probe(Probe(7, UINT16, kind)), between.now) == []
    assert between.relay.receive(SITE, encode_probe(Probe(None, UINT16, 0)), between.now) == []
    assert between.counters.drops == {}


@pytest.mark.parametrize("are_events", [False, True])
def test_delta_frames_raw_fields_and_events_go_as_they_are(are_events: bool) -> None:
    between = Between()
    settings = (
        WriterSettings(are_events=True) if are_events else WriterSettings(FieldEncoding.RAW_DATA, key_frame_count=3)
    )
    between.writing.publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), CODEC, settings={TOPIC: settings})
    between.carry(between.writing.announce())
    wanted: type[Any] = EventReceived if are_events else DataReceived
    told = [
        event.message.values[0]
        for number in range(5)
        for event in only(wanted, between.carry(between.writing.publish(float(number), timestamp=WALL + number)))
    ]
    assert told == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert between.counters.drops == between.read_counters.drops == {}


def test_a_source_that_has_said_nothing_appears_at_the_other_end() -> None:
    between = Between()
    announced, alive = between.writing.announce()
    assert only(SourceAppeared, between.carry([announced])) == []
    assert only(SourceAppeared, between.carry([alive])) == [SourceAppeared(TOPIC)]


def test_a_lost_source_is_lost_at_the_other_end_and_returns_there() -> None:
    between = Between()
    between.carry(between.writing.announce())
    between.carry(between.writing.publish())
    lost = between.writing.publisher.source_lost(TOPIC, timestamp=WALL + 1, now=between.now)
    [event] = only(DataReceived, between.carry(lost))
    assert (event.message.status or 0) >> 16 == 0x8031
    between.writing.now += 4.0
    assert only(SourceSilent, between.subscriber.poll(between.now))
    back = between.writing.announce() + between.writing.publish(3.0, timestamp=WALL + 2)
    events = between.carry(back)
    assert any(isinstance(event, SourceReturned | SourceStale) for event in events)
    assert only(DataReceived, events)[0].message.values[0] == 3.0


def test_the_names_for_the_topics_of_a_broker_are_known_once_there_was_a_message() -> None:
    between = Between()
    announced, alive = between.writing.announce()
    assert between.said([announced]) == []
    assert between.relay.names_of(TOPIC.space, TOPIC.id) is None
    assert [to for to, _ in between.said([alive])] == [SITE, SITE]
    assert between.relay.names_of(TOPIC.space, TOPIC.id) == ("group-2", "arm")
    assert between.relay.names_of(2, TOPIC.id) is None
    assert between.relay.names_of("plc", TOPIC.id) is None


def test_of_more_writers_than_it_may_know_the_longest_silent_one_is_asked_for_again() -> None:
    between = Between(max_writers=2)
    topics = [Topic(1, 2, number) for number in (1, 2, 3)]
    for topic in topics:
        between.carry(between.writing.announce(topic, name=topic.name))
    assert between.said(between.writing.publish(topic=topics[0])) == []
    assert between.counters.drops == {Drop.NO_METADATA: 1}
    assert len(between.said(between.writing.publish(topic=topics[2]))) == 1


def test_sources_whose_fields_are_stated_need_no_metadata() -> None:
    between = Between(mode=NONE, stated=[(TOPIC.space, TOPIC.id)])
    between.writing.announce()
    assert len(between.said(between.writing.publish())) == 1


def test_what_is_malformed_not_valid_or_not_to_be_encoded_is_counted() -> None:
    between = Between(mode=NONE)
    between.carry(between.writing.announce())
    between.counters.drops.clear()
    assert between.relay.receive(HALL, b"", between.now) == []
    assert between.relay.receive(HALL, b"\xf1", between.now) == []
    message = CODEC.decode(between.writing.publish()[0])
    assert isinstance(message, NetworkMessage)
    part = message.messages[0]._replace(valid=False)
    assert between.relay.receive(HALL, CODEC.encode(message._replace(messages=(part,))), between.now) == []
    assert between.relay.receive(HALL, data(publisher_id=1, writer_group_id=2)[:-3], between.now) == []
    assert between.counters.drops == {Drop.MALFORMED: 3, Drop.INVALID: 1}


def test_a_time_in_the_header_of_the_network_message_goes_with_its_message() -> None:
    between = Between(mode=NONE)
    between.carry(between.writing.announce())
    message = CODEC.decode(between.writing.publish()[0])
    assert isinstance(message, NetworkMessage)
    part: DataSetMessage = message.messages[0]._replace(timestamp=None)
    foreign = CODEC.encode(message._replace(messages=(part,), timestamp=WALL + 5, sequence_number=9))
    [(_, forwarded)] = between.said([foreign])
    again = CODEC.decode(forwarded)
    assert isinstance(again, NetworkMessage)
    assert (again.messages[0].timestamp, again.timestamp, again.sequence_number) == (WALL + 5, None, None)


def test_through_two_relays_it_is_the_same_message_and_metadata_counts_by_its_version() -> None:
    between = Between()
    second = "r-second"
    counters = Counters()
    on = [
        RelayedConnection(
            envelope(254, second, GATE, speaks_under=second, relayed={TOPIC.space: GATE}), relayed=between.origins
        ),
        RelayedConnection(envelope(254, second, speaks_under=second)),
    ]
    further = RelayCore(on, [Direction(0, 1, between.origins)], counters, CODEC, receive_timeout_s=3.0)
    sent = between.writing.announce() + between.writing.publish(1.0)
    arrived = [
        plain
        for _, first in between.said(sent)
        for sealed in between.sealed(first)
        for _, plain in further.receive(0, sealed, between.now)
    ]
    assert [type(CODEC.decode(each)) for each in arrived] == [MetaDataAnnouncement, NetworkMessage, NetworkMessage]
    assert messages(arrived)[-1] == messages(sent)[-1]
    old = announcements(between.writing.announce())[0]._replace(sequence_number=7)
    older = old._replace(
        metadata=old.metadata._replace(configuration_version=old.metadata.configuration_version._replace(minor=1))
    )
    for sealed in between.sealed(encode_announcement(older)):
        assert further.receive(0, sealed, between.now) == []
    assert counters.drops == {Drop.RETAINED: 1}


def test_each_direction_of_a_relay_has_its_own_origins() -> None:
    envelopes = [relay_envelope(mode=NONE), relay_envelope(mode=NONE)]
    counters = Counters()
    relay = RelayCore(
        [RelayedConnection(each) for each in envelopes],
        [Direction(HALL, SITE, Origins([1])), Direction(SITE, HALL, Origins([2]))],
        counters,
        CODEC,
        receive_timeout_s=3.0,
        stated=[(1, 1001), (2, 1001)],
    )
    assert [to for to, _ in relay.receive(HALL, data(publisher_id=1), 0.0)] == [SITE]
    assert [to for to, _ in relay.receive(SITE, data(publisher_id=2), 0.0)] == [HALL]
    assert relay.receive(SITE, data(publisher_id=1), 0.0) == []
    assert relay.receive(HALL, data(publisher_id=2), 0.0) == []
    assert counters.drops == {Drop.LOOP: 2}
    assert sorted(to for to, _ in relay.begin()) == [HALL, SITE]
    assert not NO_ORIGINS
