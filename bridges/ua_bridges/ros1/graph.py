"""What a look at the ROS 1 graph means for the bridge. Pure: two states of the master in, what to do out.

rospy registers once and trusts the master to remember. A master that is restarted knows nothing, and a publisher
that was killed stays registered for ever, so the bridge compares what the master says with what it wants at each
look, and says again what is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import Topic

__all__ = ["GraphNews", "GraphWatch", "LinkRetry"]

_PREFIX: Final = "/ua_"


class GraphNews(NamedTuple):
    """What is new in the graph."""

    found: list[Topic]
    """Topics of the own space that somebody publishes and that are not watched yet."""
    illegal: list[TopicInvalid]
    """Names that have just appeared, begin like a UA topic and are none."""


class GraphWatch:
    """Finds the UA topics of one space among the names that nodes publish."""

    def __init__(self, space: int) -> None:
        self._space = space
        self._legal: set[str] = set()
        self._illegal: set[str] = set()

    def forget(self, topic: Topic) -> None:
        """A topic is not watched any more: it is found again where somebody publishes it."""
        self._legal.discard(f"/{topic.name}")

    def look(self, published: Iterable[str]) -> GraphNews:
        """The news in the names of all topics that have a publisher now."""
        found: list[Topic] = []
        illegal: list[TopicInvalid] = []
        still_illegal: set[str] = set()
        for name in published:
            if not name.startswith(_PREFIX) or name in self._legal:
                continue
            if name in self._illegal:
                still_illegal.add(name)
                continue
            try:
                topic = Topic.parse(name[1:])
            except TopicInvalid as error:
                illegal.append(error)
                still_illegal.add(name)
                continue
            if topic.space == self._space:
                self._legal.add(name)
                found.append(topic)
        self._illegal = still_illegal  # a name that goes and comes back is counted again
        return GraphNews(found, illegal)


def unregistered(wanted: Collection[str], registered: Mapping[str, list[str]], node_name: str) -> list[str]:
    """The topics of `wanted` under which the master does not know the node (any more)."""
    return [topic for topic in wanted if node_name not in registered.get(topic, ())]


@dataclass(slots=True)
class LinkRetry:
    """When to ask again for the publishers of a topic that has fewer links than registered publishers.

    The master tells of a new publisher only once. Where the link broke while the publisher lived on, nobody would
    ever connect again. For a publisher that was killed this goes on for ever, ever more seldom.
    """

    first_s: float = 1.0
    longest_s: float = 30.0
    _wait_s: float = field(default=0.0, init=False)
    _next: float | None = field(default=None, init=False)
    _publishers: frozenset[str] = field(default=frozenset(), init=False)

    def due(self, publishers: Iterable[str], links: int, now: float) -> bool:
        """Whether to try now; to be asked at each look."""
        names = frozenset(publishers)
        if links >= len(names):
            self._next = None
            return False
        if self._next is None or names != self._publishers:
            self._publishers, self._wait_s, self._next = names, self.first_s, now + self.first_s
            return False
        if now < self._next:
            return False
        self._wait_s = min(2 * self._wait_s, self.longest_s)
        self._next = now + self._wait_s
        return True
