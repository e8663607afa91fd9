"""What one in the same process is told that begins to listen to a publisher."""

from __future__ import annotations

from tests.unit.pubsub.publishing import TOPIC, WALL, Writing, announcements, messages
from tests.unit.pubsub.test_publisher import probe
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import FrameKind


def test_what_was_said_last_is_there_at_once_and_uses_no_numbers() -> None:
    writing = Writing()
    other = Topic(1, 2, 1002)
    writing.announce()
    writing.announce(other)
    writing.publish(1.0)
    writing.publisher.answer(probe(), writing.now)
    writing.publish(2.0, timestamp=WALL + 5)
    before = {topic: writer.next_number for topic, writer in writing.publisher.writers.items()}
    for _ in range(2):
        datagrams = writing.publisher.said_last()
        assert [one.data_set_writer_id for one in announcements(datagrams)] == [1001, 1002]
        frame, alive = messages(datagrams)
        assert (frame.values[0], frame.timestamp, frame.sequence_number) == (2.0, WALL + 5, before[TOPIC] - 1)
        assert (alive.kind, alive.sequence_number) == (FrameKind.KEEP_ALIVE, before[other])
    assert before == {topic: writer.next_number for topic, writer in writing.publisher.writers.items()}
    writing.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=writing.now)
    writing.publisher.retire(other)
    (frame,) = messages(writing.publisher.said_last())
    assert (frame.status or 0) >> 16 == StatusCode.BAD_NO_COMMUNICATION >> 16
