"""DataSetWriters that somebody disables and enables, alone or with the WriterGroup or PubSubConnection they are in.

A disabled writer sends nothing: no data, no keep-alive, no metadata. What its source says meanwhile is kept, so that
its last value is sent when it is enabled again. Discovery and Actions go on: by these it can be enabled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ua_fleet.pubsub.announcer import Announcer
from ua_fleet.pubsub.components import Component, Components, writer
from ua_fleet.pubsub.writer import Writer
from ua_fleet.topics import Topic

__all__ = ["WriterSwitches"]

_GROUP: int = 2
"""Length of the name of a WriterGroup; that of a DataSetWriter is longer."""


class WriterSwitches:
    """The switches of one Publisher. Every method that sends returns datagrams, in order."""

    def __init__(
        self,
        components: Components,
        writers: Mapping[Any, Writer],
        announcer: Announcer,
        lost: Callable[..., list[bytes]],
        queue: Callable[[Writer], None],
    ) -> None:
        """Connect them.

        Args:
            components: what is disabled.
            writers: all DataSetWriters, by Topic.
            announcer: tells of the configuration.
            lost: `Publisher.source_lost`.
            queue: enters a writer for its next deadline.
        """
        self.components, self._writers, self._announcer = components, writers, announcer
        self._lost, self._queue = lost, queue

    def is_off(self, topic: Topic) -> bool:
        """Whether a DataSetWriter is disabled, or what it is part of."""
        return not self.components.is_whole and not self.components.is_operational(writer(topic.ns, topic.id))

    def disable(self, component: Component, *, timestamp: int, now: float) -> list[bytes]:
        """Send nothing of a component and of what is below it from now on; raises StateInvalid.

        A single DataSetWriter says once, as of `timestamp`, that its source is gone; a PubSubConnection says that it is
        Disabled. The end of a WriterGroup shows by silence: a message for each of thousands would overrun receivers.
        """
        self.components.disable(component)
        datagrams: list[bytes] = []
        for topic, each in self._below(component):
            if each.is_off:
                continue
            if len(component) > _GROUP:
                kept = each.types, each.sent_types, each.values, each.status, each.alive
                datagrams += self._lost(topic, timestamp=timestamp, now=now)
                _, each.sent_types, each.values, each.status, each.alive = kept
                each.timestamp += 1  # what it says next is news to who has heard that it is gone
            each.turn_off()
        return datagrams + self._announcer.switched(component, now)

    def enable(self, component: Component, *, now: float) -> list[bytes]:
        """Send again what is Operational now; raises StateInvalid. `Publisher.poll` says what the last values are."""
        self.components.enable(component)
        for topic, each in self._below(component):
            if each.is_off and not self.is_off(topic) and each.turn_on(now):
                self._queue(each)
        return self._announcer.switched(component, now)

    def _below(self, component: Component) -> list[tuple[Topic, Writer]]:
        """The writers that a component is, or has below it."""
        return [
            (each.topic, each)
            for each in self._writers.values()
            if writer(each.topic.ns, each.topic.id)[: len(component)] == component
        ]
