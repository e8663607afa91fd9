from __future__ import annotations

import itertools
from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Reading, Writing, messages, only
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    DataReceived,
    MetaDataReceived,
    ProbeReceived,
    PubSubTiming,
    SourceAppeared,
    SourceReturned,
    SourceSilent,
    SourceUnknown,
    Subscriber,
    SubscriberEvent,
    make_field,
)
from ua_fleet.pubsub.components import reader
from ua_fleet.pubsub.liveness import Liveness
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.topics import LoopVerdict, Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant
from ua_fleet.wire import encode_metadata_announcement, encode_probe
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

DOUBLE, STRING = int(BuiltinType.DOUBLE), int(BuiltinType.STRING)


def kinds(events: list[SubscriberEvent]) -> list[str]:
    return [type(event).__name__ for event in events]


def foreign(part: DataSetMessage, **header: Any) -> bytes:
    """A datagram of a publisher that is not ours, for the same triple."""
    arguments: dict[str, Any] = {"publisher_id": 1, "writer_group_id": 2, **header}
    return CODEC.encode(NetworkMessage(messages=(part,), **arguments))


def foreign_metadata(fields: Any = FIELDS, version: int = 1, **changes: Any) -> bytes:
    metadata = DataSetMetaData("foreign", fields, ConfigurationVersion(version, version))
    announcement = MetaDataAnnouncement(1, PublisherIdType.UINT16, 0, 1001, metadata)
    return encode_metadata_announcement(announcement._replace(**changes))


def frame(level: float = 1.0, **changes: Any) -> DataSetMessage:
    return DataSetMessage(1001, types=(DOUBLE, STRING), values=(level, "a"))._replace(**changes)


def test_metadata_then_data_is_handed_on() -> None:
    writing, reading = Writing(), Reading()
    [met, appeared] = reading.receive(writing.announce(), 100.0)
    assert appeared == SourceAppeared(TOPIC)
    assert isinstance(met, MetaDataReceived)
    assert (met.topic, met.metadata.fields) == (TOPIC, FIELDS)
    [data] = reading.receive(writing.publish(2.0), 100.0)
    assert isinstance(data, DataReceived)
    assert (data.topic, data.message.values, data.metadata) == (TOPIC, (2.0, "a"), met.metadata)
    assert reading.counters.drops == {}
    assert reading.counters.messages_in == 2


def test_what_was_heard_last_is_told_again_to_who_asks() -> None:
    writing, reading = Writing(), Reading()
    assert reading.subscriber.known(TOPIC) == []
    [met, appeared] = reading.receive(writing.announce(), 100.0)
    assert reading.subscriber.known(TOPIC) == [met, appeared]
    [data] = reading.receive(writing.publish(2.0), 100.0)
    assert reading.subscriber.known(TOPIC) == [met, data]
    assert reading.subscriber.hears(TOPIC)
    silent = reading.subscriber.poll(200.0)
    assert reading.subscriber.known(TOPIC) == [met, data, *silent]
    assert not reading.subscriber.hears(TOPIC)
    assert len(silent) == 1


def test_a_repeat_is_counted_and_attests_the_source() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    reading.receive(writing.publish(), 100.0)
    [(time, repeats)] = [sent for sent in writing.run_until(105.0) if messages(sent[1])[0].kind == FrameKind.KEY]
    assert kinds([event for _, event in reading.run_until(104.9)]) == ["SourceSilent"], "keep-alives were not heard"
    assert kinds(reading.receive(repeats, time)) == ["SourceReturned"]
    assert reading.counters.drops == {Drop.REPEATED: 1}


def test_the_loop_rule_comes_first() -> None:
    writing, reading = Writing(), Reading(own_space=1)
    assert reading.receive([*writing.announce(), *writing.publish()], 100.0) == []
    assert reading.counters.drops == {Drop.LOOP: 3}
    assert dict(reading.subscriber.writers) == {}


def test_without_the_loop_rule_our_own_data_comes_in() -> None:
    writing = Writing()
    subscriber = Subscriber(1, PubSubTiming(), Counters(), CODEC, rule=lambda _, __, ___, ____: LoopVerdict.TO_SPACE)
    events = [
        event for datagram in [*writing.announce(), *writing.publish()] for event in subscriber.receive(datagram, 1.0)
    ]
    assert kinds(events) == ["MetaDataReceived", "SourceAppeared", "DataReceived"]


def test_duplicates_are_dropped_and_counted() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    first, second = writing.publish(), writing.publish()
    assert len(reading.receive([*first, *first, *second, *second, *first], 100.0)) == 2
    assert reading.counters.drops == {Drop.DUPLICATE: 3}
    assert reading.subscriber.writers[TOPIC].duplicates == 3


def test_what_is_missing_and_what_comes_late_is_counted() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    sent = [writing.publish(float(number)) for number in range(6)]
    events = [event for number in (0, 3, 1, 1, 4, 2, 5) for event in reading.receive(sent[number], 100.0)]
    assert [event.message.values[0] for event in only(DataReceived, events)] == [0.0, 3.0, 4.0, 5.0]
    assert reading.counters.gaps == 2
    assert reading.counters.drops == {Drop.LATE: 2, Drop.DUPLICATE: 1}
    assert (reading.subscriber.writers[TOPIC].gaps, reading.subscriber.writers[TOPIC].late) == (2, 2)


def test_a_keep_alive_shows_what_is_missing() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    reading.receive(writing.publish(), 100.0)
    lost = writing.publish()
    for _, datagrams in writing.run_until(102.0):
        reading.receive(datagrams, 102.0)
    assert reading.counters.gaps == 1
    newer = writing.publish()
    assert only(DataReceived, reading.receive(lost, 102.1)), "only a keep-alive was faster, so it is the latest value"
    assert only(DataReceived, reading.receive(newer, 102.1))
    assert reading.receive(lost, 102.1) == []
    writer = reading.subscriber.writers[TOPIC]
    assert (writer.gaps, writer.late, writer.duplicates, writer.restarts) == (1, 1, 1, 0)


def test_an_old_keep_alive_attests_nothing() -> None:
    writing, reading = Writing(), Reading()
    old = writing.announce()
    reading.receive(old, 100.0)
    reading.receive(writing.publish(), 100.0)
    assert reading.receive(old[1:], 102.0) == []
    assert reading.subscriber.writers[TOPIC].last_heard == 100.0
    assert reading.counters.drops == {Drop.DUPLICATE: 1}


def test_a_restarted_writer_is_known_by_its_version() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    for step in range(5):
        reading.receive(writing.publish(timestamp=WALL + step), 100.0)
    again = Writing()
    events = reading.receive(
        [*again.announce(wall_ticks=WALL + 50_000_000), *again.publish(9.0, timestamp=WALL + 99)], 101.0
    )
    assert kinds(events) == ["MetaDataReceived", "DataReceived"]
    assert (reading.counters.gaps, reading.subscriber.writers[TOPIC].restarts) == (0, 1)


def test_a_restarted_writer_is_known_by_a_later_timestamp() -> None:
    reading = Reading()
    reading.receive([foreign_metadata()], 100.0)
    for number, timestamp in ((500, WALL), (501, WALL + 1), (3, WALL + 2), (4, WALL + 3)):
        events = reading.receive([foreign(frame(sequence_number=number, timestamp=timestamp))], 100.0)
        assert only(DataReceived, events)
    assert (reading.counters.gaps, reading.subscriber.writers[TOPIC].restarts) == (0, 1)


def test_a_writer_that_was_silent_may_begin_anywhere_but_hands_nothing_on_twice() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(sequence_number=500, timestamp=WALL))], 100.0)
    events = reading.receive([foreign(frame(sequence_number=3, timestamp=WALL))], 103.5)
    assert events == []
    assert reading.counters.drops == {Drop.REPEATED: 1}
    assert reading.subscriber.writers[TOPIC].restarts == 1


def test_a_source_whose_clock_was_set_back_is_heard_again_after_the_timeout() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL + 10**12))], 100.0)
    handed_on = [
        100.0 + step
        for step in range(10)
        if only(DataReceived, reading.receive([foreign(frame(timestamp=WALL + step))], 100.0 + step))
    ]
    assert handed_on == [104.0, 105.0, 106.0, 107.0, 108.0, 109.0]
    assert reading.counters.drops == {Drop.REPEATED: 4}


def test_a_value_that_does_not_change_is_heard_again_after_the_clock_was_set_back() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL + 10**12))], 100.0)
    times = [100.0, 101.0, 104.0, 105.0]
    events = [only(DataReceived, reading.receive([foreign(frame(timestamp=WALL))], time)) for time in times]
    assert [len(found) for found in events] == [0, 0, 1, 0]


def test_a_restarted_bridge_that_reads_the_latched_value_again_hands_nothing_on_twice() -> None:
    reading = Reading()
    lost = frame(timestamp=WALL + 50, status=int(StatusCode.BAD_NO_COMMUNICATION))
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL)), foreign(lost)], 100.0)
    for second in range(60):
        assert reading.receive([foreign(frame(timestamp=WALL))], 100.0 + second) == []


def test_wrong_metadata_of_the_right_version_is_probed_for() -> None:
    writing, reading = Writing(), Reading()
    announced = writing.announce()
    version = writing.publisher.metadata(TOPIC)
    assert version is not None
    reading.receive([foreign_metadata(FIELDS[:1], version.configuration_version.major), *announced[1:]], 100.0)
    assert reading.receive(writing.publish(), 100.0) == []
    assert reading.counters.drops == {Drop.LAYOUT: 1}
    [(time, unknown)] = reading.run_until(100.6)
    assert isinstance(unknown, SourceUnknown)
    assert unknown.datagram is not None
    probe = CODEC.decode(unknown.datagram)
    assert isinstance(probe, Probe)
    events = reading.receive(writing.publisher.answer(probe, time), time)
    assert kinds(events) == ["MetaDataReceived", "DataReceived"], "the repeat brings what did not fit before"


def test_old_values_that_are_read_again_once_are_not_a_clock_set_back() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL + 100))], 100.0)
    for now in (101.0, 120.0):
        for step in range(10):  # a restarted bridge reads a depth of ten latched samples
            assert reading.receive([foreign(frame(timestamp=WALL + step))], now) == []
        assert only(DataReceived, reading.receive([foreign(frame(timestamp=WALL + 100 + int(now)))], now))


def test_silence_is_told_once_and_so_is_the_return() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    assert reading.run_until(102.9) == []
    assert reading.run_until(200.0) == [(103.0, SourceSilent(TOPIC))]
    assert reading.subscriber.writers[TOPIC].silent
    assert kinds(reading.receive(writing.publish(), 200.0)) == ["SourceReturned", "DataReceived"]
    assert reading.run_until(300.0) == [(203.0, SourceSilent(TOPIC))]


def test_each_sign_of_life_puts_the_silence_off() -> None:
    writing, reading = Writing(), Reading()
    reading.receive(writing.announce(), 100.0)
    for time, datagrams in writing.run_until(130.0):
        assert reading.run_until(time) == []
        reading.receive(datagrams, time)


def test_a_lost_source_is_data_with_a_bad_status_and_then_silence() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish()], 100.0)
    [data] = reading.receive(writing.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=101.0), 101.0)
    assert isinstance(data, DataReceived)
    assert data.message.status == StatusCode.BAD_NO_COMMUNICATION
    assert reading.run_until(110.0) == [(104.0, SourceSilent(TOPIC))]
    again = writing.publisher.answer(Probe(1, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA), 110.0)
    assert reading.receive(again, 110.0) == [], "repeated for somebody else, it does not say that the source is back"


def test_data_before_its_metadata_is_probed_for_and_not_lost() -> None:
    writing, reading = Writing(), Reading()
    writing.announce()
    assert reading.receive(writing.publish(5.0), 100.0) == []
    assert reading.counters.drops == {Drop.NO_METADATA: 1}
    [(time, unknown)] = reading.run_until(100.6)
    assert isinstance(unknown, SourceUnknown)
    assert unknown.datagram is not None
    assert 100.1 <= time <= 100.5
    probe = CODEC.decode(unknown.datagram)
    assert probe == Probe(1, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1001,))
    assert isinstance(probe, Probe)
    events = reading.receive(writing.publisher.answer(probe, time), time)
    assert kinds(events) == ["MetaDataReceived", "DataReceived"]
    assert reading.run_until(102.0) == []


def test_probes_wait_and_then_wait_twice_as_long() -> None:
    writing, reading = Writing(), Reading(timing=PubSubTiming(receive_timeout_s=1000.0))
    writing.announce()
    reading.receive(writing.publish(), 100.0)
    times = [time for time, _ in reading.run_until(200.0)]
    waits = [round(later - earlier, 6) for earlier, later in itertools.pairwise(times)]
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]


def test_no_probe_is_sent_when_the_metadata_comes_by_itself() -> None:
    writing, reading = Writing(), Reading()
    announcement, keep_alive = writing.announce()
    reading.receive([keep_alive], 100.0)
    reading.receive([announcement], 100.05)
    assert reading.run_until(102.0) == []


def test_a_probe_of_somebody_else_delays_ours() -> None:
    writing, reading = Writing(), Reading()
    writing.announce()
    reading.receive(writing.publish(), 100.0)
    for ids in ((1001,), ()):
        probe = Probe(1, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, ids)
        assert reading.receive([encode_probe(probe)], 100.05) == []
    assert [time for time, _ in reading.run_until(100.6)] == [100.55]


def test_one_probe_asks_for_many_sources() -> None:
    writing = Writing()
    reading = Reading()
    topics = {Topic(1, 2, number) for number in range(1, 801)}
    for topic in topics:
        writing.announce(topic)
        reading.receive(writing.publish(topic=topic), 100.0)
    assert reading.subscriber.poll(100.09) == []
    events = only(SourceUnknown, reading.subscriber.poll(100.5))
    assert {event.topic for event in events} == topics
    probes = [CODEC.decode(event.datagram) for event in events if event.datagram]
    assert all(isinstance(probe, Probe) for probe in probes)
    assert sorted(len(probe.data_set_writer_ids) for probe in probes if isinstance(probe, Probe)) == [32, 256, 256, 256]


def test_a_source_that_never_says_what_it_sends_is_forgotten() -> None:
    writing, reading = Writing(), Reading()
    writing.announce()
    reading.receive(writing.publish(), 100.0)
    events = [event for _, event in reading.run_until(200.0)]
    assert set(kinds(events)) == {"SourceUnknown"}, "nobody was told of it, so nobody is told that it is silent"
    assert dict(reading.subscriber.writers) == {}
    assert reading.subscriber.next_deadline() is None


def test_another_version_needs_its_metadata() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish()], 100.0)
    announced = writing.announce(fields=FIELDS[:1])
    data = writing.publisher.publish(TOPIC, (3.0,), timestamp=WALL + 5, now=101.0)
    assert reading.receive(data, 101.0) == []
    assert reading.counters.drops == {Drop.NO_METADATA: 1}
    assert reading.receive(announced[:1], 101.1) == []
    assert kinds(reading.receive(writing.publisher.publish(TOPIC, (4.0,), timestamp=WALL + 6, now=102.0), 102.0)) == [
        "MetaDataReceived",
        "DataReceived",
    ]
    assert reading.counters.gaps == 0


def test_metadata_that_only_has_another_name_is_told_again() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish()], 100.0)
    [met] = reading.receive(writing.announce(name="other"), 101.0)
    assert isinstance(met, MetaDataReceived)
    assert met.metadata.name == "other"
    assert reading.receive(writing.announce(name="other"), 102.0) == [], "nothing new"


def test_two_groups_with_the_same_writer_id_are_kept_apart() -> None:
    writing, reading = Writing(), Reading()
    other = Topic(1, 3, 1001)
    announced = [*writing.announce(), *writing.announce(other, fields=FIELDS[1:])]
    met = only(MetaDataReceived, reading.receive(announced, 100.0))
    assert {(event.topic, len(event.metadata.fields)) for event in met} == {(TOPIC, 2), (other, 1)}
    data = [*writing.publish(), *writing.publisher.publish(other, ("x",), timestamp=WALL, now=100.0)]
    assert [event.message.values for event in only(DataReceived, reading.receive(data, 100.0))] == [(1.0, "a"), ("x",)]


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"types": (DOUBLE,), "values": (1.0,)}, Drop.LAYOUT),
        ({"types": (STRING, DOUBLE), "values": ("a", 1.0)}, Drop.LAYOUT),
        ({"types": (DOUBLE | 0x80, STRING), "values": ((1.0,), "a")}, Drop.LAYOUT),
        ({"kind": int(FrameKind.EVENT), "types": (DOUBLE,), "values": (1.0,)}, Drop.LAYOUT),
        ({"kind": int(FrameKind.DELTA), "indices": (0, 1)}, Drop.NO_KEY_FRAME),
        ({"valid": False}, Drop.INVALID),
    ],
)
def test_what_does_not_fit_is_dropped_by_its_cause(changes: dict[str, Any], cause: Drop) -> None:
    reading = Reading()
    events = reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL)._replace(**changes))], 1.0)
    assert only(DataReceived, events) == []
    assert reading.counters.drops == {cause: 1}


@pytest.mark.parametrize(
    ("types", "values"),
    [
        ((int(BuiltinType.STATUS_CODE), STRING), (int(StatusCode.BAD_SENSOR_FAILURE), "a")),
        ((0, STRING), (None, "a")),
    ],
)
def test_a_reason_or_nothing_may_stand_in_place_of_a_value(types: tuple[int, ...], values: tuple[Any, ...]) -> None:
    reading = Reading()
    events = reading.receive([foreign_metadata(), foreign(frame(types=types, values=values, timestamp=WALL))], 1.0)
    assert only(DataReceived, events)[0].message.values == values


def test_a_field_of_any_type_takes_any_type() -> None:
    reading = Reading()
    fields = (make_field("any", BuiltinType.VARIANT), make_field("name", BuiltinType.STRING))
    events = reading.receive([foreign_metadata(fields), foreign(frame(timestamp=WALL))], 1.0)
    assert kinds(events) == ["MetaDataReceived", "DataReceived"]


def test_values_with_a_status_of_their_own_are_handed_on() -> None:
    reading = Reading()
    part = frame(encoding=int(FieldEncoding.DATA_VALUE), field_status=(int(StatusCode.UNCERTAIN), 0), timestamp=WALL)
    events = only(DataReceived, reading.receive([foreign_metadata(), foreign(part)], 1.0))
    assert events[0].message.field_status == (StatusCode.UNCERTAIN, 0)


def test_raw_data_is_decoded_with_its_metadata() -> None:
    reading = Reading()
    fields = (make_field("x", BuiltinType.INT32), make_field("y", BuiltinType.INT32))
    raw = DataSetMessage(1001, encoding=int(FieldEncoding.RAW_DATA), raw=b"\1\0\0\0\2\0\0\0", timestamp=WALL)
    events = only(DataReceived, reading.receive([foreign_metadata(fields), foreign(raw)], 1.0))
    assert events[0].message.values == (1, 2)
    assert reading.receive([foreign(raw._replace(raw=b"\1", timestamp=WALL + 1))], 1.0) == []
    assert reading.counters.drops == {Drop.MALFORMED: 1}


def test_delta_frames_change_the_key_frame_before_them() -> None:
    reading = Reading()
    delta = DataSetMessage(1001, int(FrameKind.DELTA), (DOUBLE,), (2.0,), 1, WALL + 1, indices=(0,))
    sent = [
        foreign_metadata(),
        foreign(frame(sequence_number=0, timestamp=WALL)),
        foreign(delta),
        foreign(delta._replace(values=("b",), types=(STRING,), indices=(1,), sequence_number=2, timestamp=WALL + 2)),
    ]
    events = only(DataReceived, reading.receive(sent, 1.0))
    assert [event.message.values for event in events] == [(1.0, "a"), (2.0, "a"), (2.0, "b")]
    assert all(event.message.kind == FrameKind.KEY and event.message.indices is None for event in events)
    later = delta._replace(sequence_number=4, timestamp=WALL + 4)
    assert reading.receive([foreign(later), foreign(later._replace(sequence_number=5, timestamp=WALL + 5))], 1.0) == []
    assert reading.counters.drops == {Drop.NO_KEY_FRAME: 2}, "after a gap only a key frame helps"
    assert len(reading.receive([foreign(frame(sequence_number=6, timestamp=WALL + 6))], 1.0)) == 1
    outside = delta._replace(indices=(7,), sequence_number=7, timestamp=WALL + 7)
    assert reading.receive([foreign(outside)], 1.0) == []
    assert reading.counters.drops[Drop.LAYOUT] == 1


def test_a_delta_frame_may_bring_a_status_for_its_field() -> None:
    reading = Reading()
    delta = DataSetMessage(
        1001,
        int(FrameKind.DELTA),
        (DOUBLE,),
        (2.0,),
        timestamp=WALL + 1,
        indices=(0,),
        encoding=int(FieldEncoding.DATA_VALUE),
        field_status=(int(StatusCode.UNCERTAIN),),
    )
    sent = [foreign_metadata(), foreign(frame(timestamp=WALL)), foreign(delta)]
    message = only(DataReceived, reading.receive(sent, 1.0))[-1].message
    assert (message.values, message.field_status) == ((2.0, "a"), (StatusCode.UNCERTAIN, 0))


def test_without_numbers_a_delta_frame_after_one_that_could_not_be_read_waits_for_a_key_frame() -> None:
    reading = Reading()
    delta = DataSetMessage(1001, int(FrameKind.DELTA), (DOUBLE,), (2.0,), timestamp=WALL + 2, indices=(0,))
    outside = delta._replace(indices=(7,), timestamp=WALL + 1)
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL)), foreign(outside)], 1.0)
    assert reading.receive([foreign(delta)], 1.0) == []
    assert reading.counters.drops == {Drop.LAYOUT: 1, Drop.NO_KEY_FRAME: 1}
    assert len(reading.receive([foreign(frame(timestamp=WALL + 3))], 1.0)) == 1


def test_what_came_while_a_reader_was_off_is_missed_without_numbers_too() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(timestamp=WALL))], 1.0)
    topic = next(iter(reading.subscriber.writers))
    reading.subscriber.disable(reader(topic))
    reading.receive([foreign(frame(timestamp=WALL + 1))], 1.1)
    reading.subscriber.enable(reader(topic))
    heartbeat = DataSetMessage(1001, timestamp=WALL + 2)
    assert only(SourceReturned, reading.receive([foreign(heartbeat)], 1.2)) == []
    assert len(only(DataReceived, reading.receive([foreign(frame(timestamp=WALL + 3))], 1.3))) == 1


def test_a_heartbeat_is_a_sign_of_life_without_a_value() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(), foreign(frame(sequence_number=0, timestamp=WALL))], 100.0)
    heartbeat = DataSetMessage(1001, sequence_number=1, timestamp=WALL + 1)
    assert reading.receive([foreign(heartbeat)], 102.0) == []
    assert reading.counters.drops == {}
    assert reading.run_until(104.0) == []


def test_a_source_without_timestamps_takes_that_of_the_network_message() -> None:
    reading = Reading()
    sent = [foreign_metadata(), foreign(frame(), timestamp=WALL), foreign(frame(), timestamp=WALL)]
    events = only(DataReceived, reading.receive(sent, 1.0))
    assert [event.message.timestamp for event in events] == [WALL]


def test_a_source_without_any_timestamp_is_heard_by_its_sequence_alone() -> None:
    reading = Reading()
    sent = [foreign_metadata(), *[foreign(frame(sequence_number=number), timestamp=0) for number in (0, 1, 1, 2)]]
    assert len(only(DataReceived, reading.receive(sent, 1.0))) == 3


@pytest.mark.parametrize(
    "header",
    [
        {"publisher_id": 1, "publisher_id_type": PublisherIdType.BYTE},
        {"publisher_id": 1, "publisher_id_type": PublisherIdType.UINT32},
        {"publisher_id": "1", "publisher_id_type": PublisherIdType.STRING},
        {"publisher_id": 240},
        {"writer_group_id": None},
        {"writer_group_id": 0},
        {"payload_header": False},
    ],
)
def test_sources_that_are_no_spaces_are_counted(header: dict[str, Any]) -> None:
    reading = Reading()
    assert reading.receive([foreign(frame(timestamp=WALL), **header)], 1.0) == []
    assert reading.counters.drops == {Drop.UNKNOWN_SOURCE: 1}


def test_metadata_of_a_publisher_that_is_no_space_is_counted() -> None:
    reading = Reading()
    announcement = foreign_metadata(publisher_id="x", publisher_id_type=PublisherIdType.STRING)
    assert reading.receive([announcement], 1.0) == []
    assert reading.counters.drops == {Drop.UNKNOWN_SOURCE: 1}


def test_a_bad_announcement_is_no_metadata() -> None:
    reading = Reading()
    reading.receive([foreign_metadata(status=int(StatusCode.BAD_NODE_ID_UNKNOWN)), foreign(frame(timestamp=WALL))], 1.0)
    assert reading.counters.drops == {Drop.NO_METADATA: 1}


def test_no_more_writers_than_allowed_are_known() -> None:
    writing, reading = Writing(), Reading(max_writers=3)
    for number in range(1, 6):
        topic = Topic(1, 2, number)
        reading.receive([*writing.announce(topic), *writing.publish(topic=topic)], 100.0)
    assert len(reading.subscriber.writers) == 3
    assert reading.counters.drops[Drop.UNKNOWN_SOURCE] == 4


def test_the_longest_silent_writer_makes_room_for_a_new_one() -> None:
    writing, reading = Writing(), Reading(max_writers=2)
    topics = [Topic(1, 2, number) for number in (1, 2, 3)]
    for second, topic in enumerate(topics[:2]):
        reading.receive(writing.announce(topic), 100.0 + second)
    reading.run_until(110.0)
    assert kinds(reading.receive(writing.announce(topics[2]), 110.0)) == ["MetaDataReceived", "SourceAppeared"]
    assert set(reading.subscriber.writers) == set(topics[1:])
    assert kinds(reading.receive(writing.announce(topics[1]), 111.0)) == ["SourceStale"]


def test_announcements_that_nobody_sends_data_for_do_not_fill_the_memory() -> None:
    reading = Reading(max_writers=3)
    for number in range(1, 100):
        reading.receive([foreign_metadata(data_set_writer_id=number)], 100.0)
    part = frame(timestamp=WALL)
    events = reading.receive([foreign(part._replace(data_set_writer_id=number)) for number in (1, 98, 99)], 100.0)
    assert [event.topic.id for event in only(DataReceived, events)] == [98, 99]


def test_probes_for_us_are_handed_on() -> None:
    reading = Reading(own_space=5)
    for_us = Probe(5, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1,))
    for_others = for_us._replace(publisher_id=6)
    unknown = for_us._replace(publisher_id="5", publisher_id_type=PublisherIdType.STRING)
    sent = [encode_probe(probe) for probe in (for_us, for_others, unknown)]
    assert reading.receive(sent, 1.0) == [ProbeReceived(for_us)]


def test_malformed_datagrams_are_counted_and_said_once_a_minute() -> None:
    reading = Reading()
    for _ in range(3):
        reading.receive([b"", b"\xff"], 1.0)
    assert reading.counters.drops == {Drop.MALFORMED: 6}
    causes = reading.counters.malformed
    assert sum(causes.values()) == 6
    assert {(said.cause, said.count) for said in reading.subscriber.complaints(1.0)} == set(causes.items())
    assert reading.subscriber.complaints(1.0) == []
    reading.receive([b""], 2.0)
    reading.receive([b""], 3.0)
    assert reading.subscriber.complaints(60.0) == []
    assert [said.count for said in reading.subscriber.complaints(61.0)] == [2]


def test_a_secured_message_is_counted_and_never_read() -> None:
    reading = Reading()
    plain = foreign(frame(timestamp=WALL))
    secured = bytes([plain[0], plain[1] | 0x10]) + plain[2:]
    assert reading.receive([secured], 1.0) == []
    assert reading.counters.drops == {Drop.SECURED: 1}


def test_a_variant_in_place_of_a_value_is_not_of_the_field_s_type() -> None:
    reading = Reading()
    types, values = (0x80 | int(BuiltinType.VARIANT), STRING), ((Variant(DOUBLE, 1.0),), "a")
    reading.receive([foreign_metadata(), foreign(frame(types=types, values=values, timestamp=WALL))], 1.0)
    assert reading.counters.drops == {Drop.LAYOUT: 1}


def test_returned_sources_are_told_before_their_data() -> None:
    writing, reading = Writing(), Reading()
    reading.receive([*writing.announce(), *writing.publish()], 100.0)
    reading.run_until(110.0)
    again = Writing()
    events = reading.receive([*again.announce(wall_ticks=WALL * 2), *again.publish(timestamp=WALL + 1)], 110.0)
    # The keep-alive that comes with the announcement is of a new life, in which nothing has been said yet.
    assert kinds(events) == ["MetaDataReceived", "SourceStale", "SourceReturned", "DataReceived"]
    assert only(SourceReturned, events) == [SourceReturned(TOPIC, is_followed=True)]


def test_a_mistake_about_one_writer_costs_the_others_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The silences that had been found before it were lost, and those behind it never came."""
    writing, reading, other = Writing(), Reading(), Topic(TOPIC.space, TOPIC.ns, TOPIC.id + 1)
    caught: list[str] = []
    reading.subscriber.caught = lambda loop, error: caught.append(f"{loop}: {error}")
    for topic in (TOPIC, other):
        reading.receive([*writing.announce(topic), *writing.publish(topic=topic)], 100.0)
    deadline: Any = getattr(Liveness, "_deadline")  # noqa: B009 - what breaks is inside

    def mistaken(self: Liveness, writer: RemoteWriter) -> Any:
        if writer.topic == TOPIC:
            raise KeyError("broken")
        return deadline(self, writer)

    monkeypatch.setattr(Liveness, "_deadline", mistaken)
    assert reading.subscriber.poll(103.5) == [SourceSilent(other)]
    assert caught == ["silences: 'broken'"]
    monkeypatch.undo()
    assert reading.subscriber.poll(107.0) == [SourceSilent(TOPIC)], "it is looked at again later"
