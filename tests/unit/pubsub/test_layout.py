"""Delta frames, RawData and events of a DataSetWriter that is set to send them."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.pubsub.publishing import CODEC, TOPIC, WALL, Reading, decoded, messages, only
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub import DataReceived, EventReceived, Publisher, PubSubTiming, make_field
from ua_fleet.pubsub.components import writer
from ua_fleet.pubsub.events import ProbeReceived, SourceSilent, SourceUnknown
from ua_fleet.pubsub.layout import FrameMaker, WriterSettings
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.pubsub.packing import HEADER_BYTES
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.discovered import WriterConfigurationAnnouncement
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FrameKind,
    NetworkMessage,
    Probe,
    ProbeKind,
)

FIELDS = (
    make_field("x", BuiltinType.DOUBLE),
    make_field("y", BuiltinType.DOUBLE),
    make_field("name", BuiltinType.STRING),
    make_field("ranges", BuiltinType.FLOAT, array=True),
)
FIRST = (1.0, 2.0, "arm", (0.5, 1.5))
KEY, DELTA = FrameKind.KEY, FrameKind.DELTA
RAW = FieldEncoding.RAW_DATA
DOUBLE, STATUS = int(BuiltinType.DOUBLE), int(BuiltinType.STATUS_CODE)


class Both:
    """A publisher with one set writer, and a subscriber that hears it."""

    def __init__(self, settings: WriterSettings) -> None:
        self.publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), CODEC, settings={TOPIC: settings})
        self.reading = Reading()
        self.now, self.ticks = 100.0, WALL
        announced = self.publisher.announce(TOPIC, "arm", FIELDS, now=self.now, wall_ticks=WALL)
        self.reading.receive(announced, self.now)

    def publish(self, values: tuple[Any, ...], **changes: Any) -> list[bytes]:
        self.ticks += 1
        return self.publisher.publish(TOPIC, values, timestamp=self.ticks, now=self.now, **changes)

    def hear(self, datagrams: list[bytes]) -> list[DataSetMessage]:
        return [event.message for event in only(DataReceived, self.reading.receive(datagrams, self.now))]

    def through(self, values: tuple[Any, ...], **changes: Any) -> tuple[DataSetMessage, DataSetMessage]:
        """What is sent, and what is handed on for it."""
        datagrams = self.publish(values, **changes)
        [sent] = messages(datagrams)
        [heard] = self.hear(datagrams)
        return sent, heard

    @property
    def drops(self) -> dict[str, int]:
        return {cause: count for cause, count in self.reading.counters.drops.items() if count}


@pytest.mark.parametrize("encoding", [FieldEncoding.VARIANT, RAW])
def test_only_what_has_changed_travels_and_all_of_it_arrives(encoding: FieldEncoding) -> None:
    both = Both(WriterSettings(encoding, key_frame_count=4))
    kinds: list[int] = []
    for step in range(9):
        values = (1.0, float(step), "arm", (0.5, 1.5))
        sent, heard = both.through(values)
        kinds.append(sent.kind)
        assert sent.encoding == encoding
        if sent.kind == DELTA and encoding is not RAW:
            assert (sent.indices, sent.types, sent.values) == ((1,), (DOUBLE,), (float(step),))
        assert (heard.kind, heard.values) == (KEY, values)
        assert heard.timestamp == both.ticks
    assert kinds == [KEY, DELTA, DELTA, DELTA, KEY, DELTA, DELTA, DELTA, KEY]
    assert not both.drops


def test_a_delta_frame_is_shorter_and_a_longer_one_is_a_key_frame() -> None:
    both = Both(WriterSettings(key_frame_count=100))
    key = both.publish(FIRST)
    delta = both.publish((1.0, 2.5, "arm", (0.5, 1.5)))
    assert len(delta[0]) == len(key[0]) - len(b"\x0b12345678" + b"\x0c1234arm" + b"\x8a123412341234") + 2
    [all_changed] = messages(both.publish((5.0, 6.0, "leg", (0.25, 1.5))))
    assert all_changed.kind == KEY


def test_a_message_that_equals_the_one_before_is_a_key_frame() -> None:
    """A delta frame without changes shall not be sent (OPC 10000-14 6.2.4.3), and the message is an event."""
    both = Both(WriterSettings(key_frame_count=100))
    both.through(FIRST)
    sent, heard = both.through(FIRST)
    assert (sent.kind, heard.values) == (KEY, FIRST)


def test_what_looks_equal_and_is_not_is_a_change() -> None:
    both = Both(WriterSettings(key_frame_count=100))
    nan = float("nan")
    both.through((0.0, nan, "arm", ()))
    sent, heard = both.through((-0.0, nan, "arm", ()))
    assert (sent.kind, sent.indices) == (DELTA, (0,))
    assert str(heard.values[0]) == "-0.0"


def test_raw_data_has_no_types() -> None:
    both = Both(WriterSettings(RAW))
    sent, heard = both.through(FIRST)
    assert sent.raw == bytes.fromhex("000000000000f03f 0000000000000040 03000000 61726d 02000000 0000003f 0000c03f")
    assert (heard.values, heard.status) == (FIRST, 0)


def test_a_field_without_a_value_goes_as_a_variant() -> None:
    both = Both(WriterSettings(RAW, key_frame_count=10))
    both.through(FIRST)
    types = (DOUBLE, STATUS, int(BuiltinType.STRING), int(BuiltinType.FLOAT) | 0x80)
    bad = (1.0, int(StatusCode.BAD_NO_COMMUNICATION), "arm", (0.5, 1.5))
    sent, heard = both.through(bad, types=types)
    assert (sent.kind, sent.encoding) == (KEY, FieldEncoding.VARIANT)
    assert (heard.types, heard.values) == (types, bad)
    sent, heard = both.through(FIRST)
    assert (sent.kind, sent.encoding, heard.values) == (KEY, RAW, FIRST)


@pytest.mark.parametrize("encoding", [FieldEncoding.VARIANT, RAW])
def test_who_comes_late_gets_a_key_frame_each_repeat_interval_of_a_busy_writer(encoding: FieldEncoding) -> None:
    both = Both(WriterSettings(encoding, key_frame_count=60_000))
    keys: list[tuple[float, Any]] = []
    for step in range(110):
        both.now = 100.0 + step / 10
        values = (1.0, float(step), "arm", (0.5, 1.5))
        sent, _ = both.through(values)
        polled = both.publisher.poll(both.now)
        assert both.hear(polled) == []
        repeats = messages(polled)
        keys += [(both.now, part.timestamp) for part in (sent, *repeats) if part.kind == KEY]
    assert [round(at) for at, _ in keys] == [100, 105, 110]
    late, last = Reading(), (1.0, 109.0, "arm", (0.5, 1.5))
    for datagram in both.publisher.answer(Probe(1, 1, 2, (TOPIC.id,)), both.now):
        events = late.subscriber.receive(datagram, both.now)
        for event in only(DataReceived, events):
            assert event.message.values == last
    assert late.subscriber.writers[TOPIC].has_said


def test_after_a_loss_nothing_wrong_is_told_and_the_reader_asks_for_a_key_frame() -> None:
    both = Both(WriterSettings(key_frame_count=1000))
    both.through(FIRST)
    both.publish((9.0, 2.0, "arm", (0.5, 1.5)))  # lost
    assert both.hear(both.publish((9.0, 3.0, "arm", (0.5, 1.5)))) == []
    assert both.drops == {Drop.NO_KEY_FRAME: 1}
    probes = only(SourceUnknown, both.reading.subscriber.poll(both.now + 0.5))
    datagram = probes[0].datagram
    assert datagram is not None
    asked = Reading(own_space=TOPIC.space).subscriber.receive(datagram, both.now)
    [probe] = [event.probe for event in asked if isinstance(event, ProbeReceived)]
    answer = both.publisher.answer(probe, both.now + 0.5)
    assert [message.values for message in both.hear(answer)] == [(9.0, 3.0, "arm", (0.5, 1.5))]
    sent, heard = both.through((9.0, 4.0, "arm", (0.5, 1.5)))
    assert (sent.kind, heard.values) == (DELTA, (9.0, 4.0, "arm", (0.5, 1.5)))


def test_a_repeat_in_between_does_not_break_the_deltas() -> None:
    both = Both(WriterSettings(RAW, key_frame_count=1000))
    both.through(FIRST)
    both.through((1.0, 7.0, "arm", (0.5, 1.5)))
    both.now += 5.0
    repeats = both.publisher.poll(both.now)
    [repeat] = [part for part in messages(repeats) if part.kind == KEY]
    assert (repeat.encoding, repeat.timestamp) == (RAW, both.ticks)
    assert both.hear(repeats) == []
    sent, heard = both.through((1.0, 8.0, "arm", (0.5, 1.5)))
    assert (sent.kind, heard.values[1]) == (DELTA, 8.0)


@pytest.mark.parametrize("settings", [WriterSettings(RAW, 1000), WriterSettings(key_frame_count=1000)])
def test_after_a_time_off_the_value_of_the_meantime_is_said_and_compared_with_nothing(settings: WriterSettings) -> None:
    both = Both(settings)
    both.through(FIRST)
    switches = both.publisher.switches
    both.now += 1.0
    switches.disable(writer(TOPIC.ns, TOPIC.id), timestamp=both.ticks, now=both.now)
    both.now += 1.0
    assert both.publish((5.0, 5.0, "leg", (0.5, 1.5))) == []
    with pytest.raises(LocalWireError):
        both.publish(("no number", 5.0, "leg", (0.5, 1.5)))
    both.now += 1.0
    switches.enable(writer(TOPIC.ns, TOPIC.id), now=both.now)
    said = [message.values for message in both.hear(both.publisher.poll(both.now))]
    assert said == [(5.0, 5.0, "leg", (0.5, 1.5))]
    sent, heard = both.through((1.0, 5.0, FIRST[2], (0.5, 1.5)))
    assert (sent.kind, heard.values) == (KEY, (1.0, 5.0, FIRST[2], (0.5, 1.5)))


def test_packed_repeats_know_their_size() -> None:
    metadata = DataSetMetaData("arm", FIELDS, ConfigurationVersion(1, 1))
    for settings in (WriterSettings(RAW, 5), WriterSettings(key_frame_count=5)):
        maker = FrameMaker(TOPIC, metadata, settings, CODEC)
        maker.taken(maker.make(0, WALL, 0, type_codes(FIELDS), FIRST))
        values = (1.0, 7.0, "arm", (0.5, 1.5))
        delta = maker.make(1, WALL + 1, 0, type_codes(FIELDS), values)
        maker.taken(delta)
        repeat = maker.repeat(2, WALL + 1, 0, type_codes(FIELDS), values)
        whole = CODEC.encode(NetworkMessage(TOPIC.space, writer_group_id=TOPIC.ns, messages=(repeat,)))
        assert (delta.is_key, delta.size) == (False, len(whole) - HEADER_BYTES)


def test_a_lost_source_is_told_in_its_own_encoding() -> None:
    both = Both(WriterSettings(RAW, key_frame_count=1000))
    both.through(FIRST)
    [heard] = both.hear(both.publisher.source_lost(TOPIC, timestamp=both.ticks + 1, now=both.now))
    assert (heard.values, heard.status) == (FIRST, StatusCode.BAD_NO_COMMUNICATION)


@pytest.mark.parametrize("encoding", [FieldEncoding.VARIANT, RAW])
def test_what_does_not_fit_changes_nothing(encoding: FieldEncoding) -> None:
    both = Both(WriterSettings(encoding, key_frame_count=1000))
    both.through(FIRST)
    for wrong in (("a", 2.0, "arm", ()), (1.0, 2.0, 3, ()), (1.0, 2.0, "arm", 7), (1.0, 2.0, "arm")):
        with pytest.raises(LocalWireError):
            both.publish(wrong)
    sent, heard = both.through((1.0, 5.0, "arm", (0.5, 1.5)))
    assert (sent.kind, sent.sequence_number, heard.values[1]) == (DELTA, 1, 5.0)


VALUES = st.tuples(
    st.sampled_from([0.0, -0.0, 1.5, float("inf")]),
    st.sampled_from([1.0, 2.0]),
    st.sampled_from([None, "", "arm"]),
    st.sampled_from([None, (), (0.5,), (0.5, 1.5)]),
)


@given(
    st.sampled_from([FieldEncoding.VARIANT, RAW]),
    st.integers(1, 6),
    st.lists(st.tuples(VALUES, st.booleans()), min_size=1, max_size=20),
)
def test_whatever_is_lost_what_is_handed_on_was_said(
    encoding: FieldEncoding, count: int, said: list[tuple[tuple[Any, ...], bool]]
) -> None:
    """A reader that misses messages hands on none that was not sent with these values and this time."""
    both = Both(WriterSettings(encoding, count))
    sent: dict[int, str] = {}
    heard: list[DataSetMessage] = []
    for values, is_lost in said:
        datagrams = both.publish(values)
        sent[both.ticks] = repr(values)
        if not is_lost:
            heard += both.hear(datagrams)
    for message in heard:
        assert message.timestamp is not None
        assert repr(message.values) == sent[message.timestamp]
    if count == 1:
        assert len(heard) == sum(1 for _, is_lost in said if not is_lost)


class Events(Both):
    def __init__(self) -> None:
        super().__init__(WriterSettings(are_events=True))

    def told(self, datagrams: list[bytes]) -> list[EventReceived]:
        return only(EventReceived, self.reading.receive(datagrams, self.now))


def test_an_event_is_told_once_and_is_no_state() -> None:
    both = Events()
    datagrams = both.publish(FIRST)
    [sent] = messages(datagrams)
    assert (sent.kind, sent.encoding, sent.values) == (FrameKind.EVENT, FieldEncoding.VARIANT, FIRST)
    [event] = both.told(datagrams)
    assert (event.topic, event.message.values) == (TOPIC, FIRST)
    assert both.told(datagrams) == []
    assert both.drops == {Drop.DUPLICATE: 1}
    answer = both.publisher.answer(Probe(1, 1, 2, (TOPIC.id,)), both.now + 1)
    assert {part.kind for part in messages(answer)} == {FrameKind.KEEP_ALIVE}
    sent_later: list[DataSetMessage] = []
    for second in range(1, 12):
        sent_later += messages(both.publisher.poll(both.now + second))
    assert {part.kind for part in sent_later} == {FrameKind.KEEP_ALIVE}


def test_a_writer_of_events_lives_by_its_keep_alives() -> None:
    both = Events()
    both.told(both.publish(FIRST))
    for _ in range(20):
        both.now += 0.5
        assert not only(SourceSilent, both.reading.receive(both.publisher.poll(both.now), both.now))
        assert not [event for event in both.reading.subscriber.poll(both.now) if isinstance(event, SourceSilent)]
    assert both.publisher.source_lost(TOPIC, timestamp=both.ticks + 1, now=both.now) == []
    assert only(SourceSilent, both.reading.subscriber.poll(both.now + 4.0)) == [SourceSilent(TOPIC)]


def test_a_null_field_of_an_event_and_events_with_one_timestamp() -> None:
    both = Events()
    types = (DOUBLE, int(BuiltinType.NULL), int(BuiltinType.STRING), int(BuiltinType.FLOAT) | 0x80)
    [event] = both.told(both.publish((1.0, None, "arm", ()), types=types))
    assert event.message.values == (1.0, None, "arm", ())
    same = event.message._replace(sequence_number=1)
    datagram = CODEC.encode(NetworkMessage(TOPIC.space, writer_group_id=TOPIC.ns, messages=(same,)))
    assert len(both.told([datagram])) == 1


def test_an_event_of_a_writer_of_values_attests_nothing() -> None:
    both = Both(WriterSettings())
    _, heard = both.through(FIRST)
    event = heard._replace(kind=FrameKind.EVENT.value, sequence_number=1, timestamp=WALL + 50)
    datagram = CODEC.encode(NetworkMessage(TOPIC.space, writer_group_id=TOPIC.ns, messages=(event,)))
    assert both.reading.receive([datagram], both.now) == []
    assert both.drops == {Drop.UNSUPPORTED: 1}


def test_the_configuration_says_how_a_writer_sends() -> None:
    other, third = TOPIC._replace(id=1002), TOPIC._replace(id=1003)
    settings = {TOPIC: WriterSettings(RAW, 10), other: WriterSettings(are_events=True)}
    publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), CODEC, settings=settings)
    publisher.begin(now=0.0, wall_ticks=WALL)
    for topic in (TOPIC, other, third):
        publisher.announce(topic, "arm", FIELDS, now=0.0, wall_ticks=WALL)
    probe = Probe(1, 1, ProbeKind.DATA_SET_WRITER_CONFIGURATION, (TOPIC.id, other.id, third.id))
    answer = decoded(publisher.answer(probe, 10.0))
    [announced] = [one for one in answer if isinstance(one, WriterConfigurationAnnouncement)]
    writers = announced.writer_group.data_set_writers
    assert [(one.data_set_writer_id, one.data_set_field_content_mask, one.key_frame_count) for one in writers] == [
        (1001, 0x20, 10),
        (1002, 0, 0),
        (1003, 0, 1),
    ]
