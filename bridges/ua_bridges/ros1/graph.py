"""What a look at the ROS 1 graph means for the bridge. Pure: two states of the master in, what to do out.

rospy registers once and trusts the master to remember. A master that is restarted knows nothing, and a publisher
that was killed stays registered for ever, so the bridge compares what the master says with what it wants at each
look, and says again what is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

__all__ = ["LinkRetry", "unregistered"]


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
