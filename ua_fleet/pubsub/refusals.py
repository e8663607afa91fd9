"""Sources that are refused for their security: each is told of once, until a valid message of it is heard."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import TopicInvalid
from ua_fleet.pubsub.complaints import Complaints
from ua_fleet.pubsub.events import SourceRefused, SubscriberEvent
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.topics import Topic

__all__ = ["Refusals"]

_MOST_REFUSED: Final = 1024
"""Refused sources that we have told of. Anybody can write any PublisherId and DataSetWriterId."""


class Refusals:
    """See the module."""

    def __init__(
        self,
        counters: Counters,
        complaints: Complaints,
        writers: Mapping[Any, RemoteWriter],
        *,
        known: Container[int],
        messages: Counter[int],
    ) -> None:
        """Begin with none.

        Args:
            counters: what is refused is counted here.
            complaints: learns of it.
            writers: those that are heard, by Topic.
            known: the publishers that were heard.
            messages: of each of these, what was refused in its name.
        """
        self._known, self._messages = known, messages
        self._counters, self._complaints, self._writers = counters, complaints, writers
        self._told: dict[tuple[int, int, int], None] = {}
        """The longest known first."""

    def add(self, refused: DatagramRefused) -> list[SubscriberEvent]:
        """Count a message that was refused. Only a source that is not heard is told of: nothing in it is proved."""
        drop, writer_ids = refused.drop, refused.writer_ids
        if drop is Drop.LOOP:
            self._counters.messages_in += len(writer_ids)
            self._counters.drop(drop, len(writer_ids) or 1)
            return []
        self._counters.drop(drop)
        self._complaints.add(refused)
        publisher_id, group_id = refused.publisher_id, refused.writer_group_id
        if type(publisher_id) is int and publisher_id in self._known:
            self._messages[publisher_id] += 1
        if refused.is_action or drop is Drop.UNKNOWN_SOURCE or type(publisher_id) is not int or group_id is None:
            return []
        events: list[SubscriberEvent] = []
        for writer_id in writer_ids:
            key = (publisher_id, group_id, writer_id)
            writer = self._writers.get(key)
            if key in self._told or (writer is not None and not writer.silent):
                continue
            try:
                topic = Topic.checked(*key)
            except TopicInvalid:
                continue
            if len(self._told) >= _MOST_REFUSED:
                del self._told[next(iter(self._told))]
            self._told[topic] = None
            events.append(SourceRefused(topic, drop))
        return events

    def forget(self, topic: Topic) -> None:
        """A valid message of a source is heard."""
        self._told.pop(topic, None)
