from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Writing, announcements, decoded, messages
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub import PubSubTiming, make_field, version_time
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire.messages import FrameKind, NetworkMessage, Probe, ProbeKind, PublisherIdType

KEY, KEEP_ALIVE = FrameKind.KEY, FrameKind.KEEP_ALIVE


def probe(*writer_ids: int, publisher_id: int = 1, kind: int = ProbeKind.DATA_SET_META_DATA) -> Probe:
    return Probe(publisher_id, PublisherIdType.UINT16, kind, writer_ids)


def test_a_message_carries_the_triple_and_everything_that_a_reader_needs() -> None:
    writing = Writing()
    writing.announce()
    [message] = decoded(writing.publish(2.5, status=StatusCode.UNCERTAIN))
    assert isinstance(message, NetworkMessage)
    assert (message.publisher_id, message.publisher_id_type, message.writer_group_id) == (1, PublisherIdType.UINT16, 2)
    [part] = message.messages
    version = version_time(WALL)
    assert part.data_set_writer_id == 1001
    assert (part.kind, part.values, part.types) == (KEY, (2.5, "a"), (11, 12))
    assert (part.timestamp, part.status) == (WALL, StatusCode.UNCERTAIN)
    assert (part.sequence_number, part.major_version, part.minor_version) == (0, version, version)


def test_version_time_counts_seconds_since_2000() -> None:
    assert version_time(ticks_from_unix_ns(946_684_800_000_000_000 + 5_000_000_000)) == 5
    assert version_time(0) == 1
    assert version_time(1 << 62) == 0xFFFF_FFFF


def test_timestamps_strictly_increase_whatever_the_source_s_clock_does() -> None:
    writing = Writing()
    writing.announce()
    sent = [WALL, WALL, WALL - 50, WALL + 1, WALL + 100]
    stamps = [messages(writing.publish(timestamp=timestamp))[0].timestamp for timestamp in sent]
    assert stamps == [WALL, WALL + 1, WALL + 2, WALL + 3, WALL + 100]


def test_a_repeat_has_the_next_number_and_the_old_timestamp() -> None:
    writing = Writing()
    writing.announce()
    [first] = messages(writing.publish(7.0))
    sent = writing.run_until(writing.now + 5.0)
    [repeat] = messages(sent[-1][1])
    assert sent[-1][0] == 105.0
    assert repeat == first._replace(sequence_number=1)
    [following] = messages(writing.publish(8.0))
    assert following.sequence_number == 2


def test_keep_alives_come_between_repeats_and_carry_the_next_number() -> None:
    writing = Writing()
    writing.announce()
    writing.publish()
    sent = writing.run_until(111.0)
    kinds = [(time, part.kind, part.sequence_number) for time, datagrams in sent for part in messages(datagrams)]
    assert kinds == [
        *[(100.0 + second, KEEP_ALIVE, 1) for second in (1, 2, 3, 4)],
        (105.0, KEY, 1),
        *[(105.0 + second, KEEP_ALIVE, 2) for second in (1, 2, 3, 4)],
        (110.0, KEY, 2),
        (111.0, KEEP_ALIVE, 3),
    ]


def test_a_busy_writer_sends_neither_keep_alives_nor_repeats() -> None:
    writing = Writing()
    writing.announce()
    for step in range(40):
        writing.publish(timestamp=WALL + step)
        assert writing.run_until(writing.now + 0.5) == []


def test_the_keep_alives_of_quiet_writers_go_together_though_they_began_apart() -> None:
    writing = Writing()
    for number in range(8):
        writing.announce(Topic(1, 2, 1001 + number))
        writing.now += 0.11
    sent = writing.run_until(writing.now + 10.0)
    rounds = [(time, messages(datagrams)) for time, datagrams in sent if time > writing.now - 8.0]
    assert len(rounds) <= 2 * 8
    for number in range(8):
        times = [time for time, parts in rounds for part in parts if part.data_set_writer_id == 1001 + number]
        assert all(later - earlier <= 1.0 + 1e-6 for earlier, later in pairwise(times)), "none comes late"
        assert len(times) <= 2 * 8


def test_a_keep_alive_goes_with_a_round_once_half_of_its_period_is_over() -> None:
    writing = Writing()
    writing.announce()
    assert writing.publisher.poll(100.4, is_round=True) == []
    assert writing.publisher.poll(100.6) == []
    [early] = messages(writing.publisher.poll(100.6, is_round=True))
    assert early.kind == KEEP_ALIVE
    assert writing.publisher.next_deadline() == pytest.approx(101.6)


def test_the_first_message_is_repeated_in_time_where_keep_alives_are_rarer() -> None:
    writing = Writing(timing=PubSubTiming(keep_alive_s=60.0, receive_timeout_s=200.0, repeat_interval_s=5.0))
    writing.announce()
    writing.publish()
    assert [time for time, _ in writing.run_until(112.0)] == [105.0, 110.0]


def test_a_lost_source_is_said_once_and_then_there_is_silence() -> None:
    writing = Writing()
    writing.announce()
    writing.publish(3.0)
    [lost] = messages(writing.publisher.source_lost(TOPIC, timestamp=WALL - 9, now=writing.now))
    assert (lost.status, lost.values, lost.timestamp) == (StatusCode.BAD_NO_COMMUNICATION, (3.0, "a"), WALL + 1)
    assert writing.run_until(200.0) == []
    assert writing.publisher.next_deadline() is None
    assert writing.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=200.0) == []


def test_a_source_that_was_lost_before_its_first_message_has_a_reason_in_place_of_each_value() -> None:
    writing = Writing()
    writing.announce()
    [lost] = messages(writing.publisher.source_lost(TOPIC, timestamp=WALL, now=writing.now))
    assert lost.types == (BuiltinType.STATUS_CODE,) * 2
    assert lost.values == (StatusCode.BAD_NO_COMMUNICATION,) * 2


@pytest.mark.parametrize("by", ["announce", "publish"])
def test_a_lost_source_comes_back(by: str) -> None:
    writing = Writing()
    writing.announce()
    writing.publish()
    writing.publisher.source_lost(TOPIC, timestamp=WALL + 5, now=writing.now)
    writing.run_until(150.0)
    back = messages(writing.announce() if by == "announce" else writing.publish())
    assert back[0].kind == (KEEP_ALIVE if by == "announce" else KEY)
    sent = [part for _, datagrams in writing.run_until(155.0) for part in messages(datagrams)]
    assert [part.kind for part in sent] == [KEEP_ALIVE] * 4 + [KEY]
    expected = StatusCode.BAD_NO_COMMUNICATION if by == "announce" else StatusCode.GOOD
    assert sent[-1].status == expected, "until there is a new value, the last thing known is that it was lost"


def test_an_announcement_is_followed_by_a_keep_alive_that_tells_the_writer_group() -> None:
    writing = Writing()
    announcement, message = decoded(writing.announce())
    assert (announcement.publisher_id, announcement.data_set_writer_id) == (1, 1001)
    assert announcement.metadata.name == "arm"
    assert announcement.metadata.fields == FIELDS
    [keep_alive] = message.messages
    assert (message.writer_group_id, keep_alive.kind, keep_alive.sequence_number) == (2, KEEP_ALIVE, 0)


def test_the_version_changes_with_the_fields_and_only_forward() -> None:
    writing = Writing()

    def version(**changes: Any) -> tuple[int, int]:
        [announcement] = announcements(writing.announce(**changes))
        return announcement.metadata.configuration_version

    first = version()
    assert first == (version_time(WALL),) * 2
    assert version() == first, "nothing changed"
    assert version(name="other") == (first[0], first[1] + 1), "a name is no incompatible change"
    wider = (*FIELDS, make_field("on", BuiltinType.BOOLEAN))
    assert version(name="other", fields=wider) == (first[0] + 1, first[0] + 1)
    assert version(fields=FIELDS, wall_ticks=0) == (first[0] + 2, first[0] + 2), "a clock set back changes nothing"


def test_two_writers_with_the_same_id_never_share_a_version() -> None:
    """An announcement names no WriterGroup, so its version has to tell."""
    writing = Writing()
    [one] = announcements(writing.announce())
    [other] = announcements(writing.announce(Topic(1, 3, 1001)))
    assert one.metadata.configuration_version != other.metadata.configuration_version


def test_what_was_sent_with_other_fields_is_not_repeated() -> None:
    writing = Writing()
    writing.announce()
    writing.publish()
    writing.announce(fields=FIELDS[:1])
    sent = [part for _, datagrams in writing.run_until(110.0) for part in messages(datagrams)]
    assert {part.kind for part in sent} == {KEEP_ALIVE}


def test_announcements_come_again_and_are_numbered() -> None:
    writing = Writing()
    numbers = [announcement.sequence_number for announcement in announcements(writing.announce())]
    for _, datagrams in writing.run_until(230.0):
        numbers += [announcement.sequence_number for announcement in announcements(datagrams)]
    assert numbers == [0, 1, 2]


def test_a_probe_gets_the_metadata_and_the_last_message() -> None:
    writing = Writing()
    writing.announce()
    writing.publish(4.0)
    announcement, data = decoded(writing.publisher.answer(probe(1001), writing.now))
    assert announcement.data_set_writer_id == 1001
    assert (data.messages[0].values, data.messages[0].timestamp) == ((4.0, "a"), WALL)


def test_a_probe_for_all_writers_is_answered_for_all() -> None:
    writing = Writing()
    topics = [Topic(1, 2, number) for number in (5, 6, 7)]
    for topic in topics:
        writing.announce(topic)
        writing.publish(topic=topic)
    answer = writing.publisher.answer(probe(), writing.now)
    assert [announcement.data_set_writer_id for announcement in announcements(answer)] == [5, 6, 7]
    assert len(answer) == 4, "the repeats share a NetworkMessage"


@pytest.mark.parametrize(
    "other",
    [
        probe(1001, publisher_id=2),
        probe(1001, publisher_id=2, kind=ProbeKind.DATA_SET_WRITER_CONFIGURATION),
        Probe("1", PublisherIdType.STRING, ProbeKind.DATA_SET_META_DATA),
    ],
)
def test_other_probes_are_not_answered(other: Probe) -> None:
    writing = Writing()
    writing.announce()
    assert writing.publisher.answer(other, writing.now) == []


def test_answers_for_one_writer_keep_half_a_second_apart() -> None:
    writing = Writing()
    writing.announce()
    writing.publish()
    assert len(writing.publisher.answer(probe(1001), 100.0)) == 2
    assert writing.publisher.answer(probe(1001), 100.1) == []
    assert writing.publisher.answer(probe(1001), 100.2) == [], "a duplicate is discarded"
    assert writing.publisher.next_deadline() == 100.5
    sent = [(time, len(announcements(datagrams))) for time, datagrams in writing.run_until(100.9)]
    assert sent == [(100.5, 1)]


def test_a_lost_source_still_answers_with_the_frame_that_says_so() -> None:
    writing = Writing()
    writing.announce()
    writing.publish()
    writing.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=writing.now)
    [data] = messages(writing.publisher.answer(probe(1001), 150.0))
    assert data.status == StatusCode.BAD_NO_COMMUNICATION
    assert writing.run_until(200.0) == []


def test_answers_of_many_writers_are_paced_and_all_come() -> None:
    writing = Writing()
    for number in range(1, 2001):
        writing.announce(Topic(1, 2, number))
    writing.now = 101.0
    at_once = writing.publisher.answer(probe(), writing.now)
    assert sum(len(datagram) + 512 for datagram in at_once) < 128 * 1024, "no more than a small receive buffer holds"
    answered = {announcement.data_set_writer_id for announcement in announcements(at_once)}
    while writing.publisher.next_deadline() is not None and len(answered) < 2000:
        due = writing.publisher.next_deadline()
        assert due is not None
        assert due < 105.0
        writing.now = max(writing.now, due)
        answered |= {
            announcement.data_set_writer_id for announcement in announcements(writing.publisher.poll(writing.now))
        }
    assert len(answered) == 2000


def test_due_messages_of_one_group_share_network_messages_that_fit_a_frame() -> None:
    writing = Writing()
    topics = [Topic(1, 2 + number % 2, 1 + number) for number in range(200)]
    for topic in topics:
        writing.announce(topic)
        writing.publish(topic=topic)
    writing.now = 101.0
    datagrams = writing.publisher.poll(writing.now)
    assert len(datagrams) <= 4
    assert all(len(datagram) <= 1400 for datagram in datagrams)
    assert max(len(datagram) for datagram in datagrams) > 1300
    parts = {
        (message.writer_group_id, part.data_set_writer_id)
        for message in decoded(datagrams)
        for part in message.messages
    }
    assert parts == {(topic.ns, topic.id) for topic in topics}
    writing.now = 105.0
    repeats = writing.publisher.poll(writing.now)
    assert all(len(datagram) <= 1400 for datagram in repeats)
    assert max(len(datagram) for datagram in repeats) > 1300
    assert {part.kind for part in messages(repeats)} == {KEY}


def test_one_poll_does_not_hold_the_event_loop_up() -> None:
    writing = Writing()
    for number in range(1, 1001):
        writing.announce(Topic(1, 2, number))
    writing.now = 101.0
    counts: list[int] = []
    while (due := writing.publisher.next_deadline()) is not None and due <= 101.0:
        counts.append(len(messages(writing.publisher.poll(writing.now))))
    assert sum(counts) == 1000
    assert max(counts) == 256


def test_a_message_that_is_almost_due_travels_with_one_that_is() -> None:
    writing = Writing()
    writing.announce()
    writing.now = 100.03
    writing.announce(Topic(1, 2, 1002))
    assert [(time, len(messages(datagrams))) for time, datagrams in writing.run_until(101.5)] == [(101.0, 2)]


def test_a_retired_source_says_nothing_and_goes_on_with_its_numbers() -> None:
    writing = Writing()
    [first] = announcements(writing.announce())
    writing.publish(timestamp=WALL)
    writing.publisher.retire(TOPIC)
    assert writing.run_until(120.0) == []
    assert writing.publisher.answer(probe(), writing.now) == []
    with pytest.raises(LocalWireError, match="before it is announced"):
        writing.publish()
    assert writing.publisher.metadata(TOPIC) is None
    [again] = announcements(writing.announce())
    assert again.metadata == first.metadata
    [message] = messages(writing.publish(timestamp=WALL))
    assert (message.timestamp, message.sequence_number) == (WALL + 1, 1)


def test_what_does_not_fit_changes_nothing() -> None:
    writing = Writing()
    writing.announce()
    with pytest.raises(LocalWireError):
        writing.publisher.publish(TOPIC, ("no number", "a"), timestamp=WALL, now=1.0)
    with pytest.raises(LocalWireError):
        writing.publisher.publish(TOPIC, (1.0,), timestamp=WALL, now=1.0)
    with pytest.raises(LocalWireError, match="types for 2 fields"):
        writing.publisher.publish(TOPIC, (1.0,), timestamp=WALL, now=1.0, types=(11,))
    with pytest.raises(LocalWireError, match="the largest message may have 65507"):
        writing.publisher.publish(TOPIC, (1.0, "a" * 70_000), timestamp=WALL, now=1.0)
    [message] = messages(writing.publish(timestamp=WALL))
    assert (message.sequence_number, message.timestamp) == (0, WALL)
    assert writing.counters.messages_out == 2, "the keep-alive of the announcement and this"


def test_foreign_sources_and_unannounced_ones_are_refused() -> None:
    writing = Writing()
    with pytest.raises(LocalWireError, match="does not originate in space 1"):
        writing.announce(Topic(2, 2, 1001))
    with pytest.raises(LocalWireError, match="before it is announced"):
        writing.publish()


def test_metadata_that_does_not_fit_a_datagram_is_refused() -> None:
    writing = Writing()
    field = make_field("definition", BuiltinType.STRING, properties={"RosDefinition": "x" * 66_000})
    with pytest.raises(LocalWireError, match="the largest message may have 65507"):
        writing.announce(fields=(field,))
    with pytest.raises(LocalWireError, match="before it is announced"):
        writing.publish()


def test_a_field_may_carry_the_reason_why_it_has_no_value() -> None:
    writing = Writing()
    writing.announce()
    types = (int(BuiltinType.STATUS_CODE), int(BuiltinType.STRING))
    values = (int(StatusCode.BAD_SENSOR_FAILURE), "a")
    [message] = messages(writing.publisher.publish(TOPIC, values, timestamp=WALL, now=100.0, types=types))
    assert (message.types, message.values) == (types, values)
    [repeat] = messages(writing.run_until(105.0)[-1][1])
    assert repeat.types == types


def test_sequence_numbers_wrap() -> None:
    writing = Writing()
    writing.announce()
    numbers = [messages(writing.publish(timestamp=WALL + step))[0].sequence_number for step in range(65_537)][-2:]
    assert numbers == [65_535, 0]


def test_the_codec_decodes_what_is_packed_to_the_same_messages() -> None:
    """Sizes of DataSetMessages are computed here and not in the codec."""
    writing = Writing()
    writing.announce()
    [datagram] = writing.publish()
    [keep_alive] = writing.announce()[1:]
    from ua_fleet.pubsub.packing import HEADER_BYTES, KEEP_ALIVE_BYTES

    assert len(keep_alive) == HEADER_BYTES + KEEP_ALIVE_BYTES
    message = CODEC.decode(datagram)
    assert isinstance(message, NetworkMessage)
    twice = CODEC.encode(message._replace(messages=message.messages * 2))
    assert len(twice) == HEADER_BYTES + 2 + 4 + 2 * (len(datagram) - HEADER_BYTES)
