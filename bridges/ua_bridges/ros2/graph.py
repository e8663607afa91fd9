"""What a look at the ROS 2 graph means for the bridge. Pure: the graph comes in through `GraphView`, facts go out.

There is no event for a change of the graph that rclpy would hand on, so the bridge looks every LOOK_S. A look costs
about 60 us for the names and 4 us for each watched topic, and 20 us more for a topic whose publishers have changed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple, Protocol

from ua_bridges.ros2.qos import Offer
from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import Topic

__all__ = ["LOOK_S", "GraphChange", "GraphView", "GraphWatch", "Publisher", "PublishersChanged", "TopicIllegal"]

LOOK_S: Final = 0.1
_FULL_LOOK_S: Final = 1.0
"""Publishers are counted at each look, and asked who they are when the count changes, or after so long."""

_PREFIX: Final = "/ua_"


class Publisher(NamedTuple):
    """One publisher of a topic in the graph."""

    type: str
    """`pkg/msg/Name`."""
    offer: Offer
    own: bool
    """Whether the bridge itself is it."""


class GraphView(Protocol):
    """The graph as the node sees it now."""

    def topic_names(self) -> Iterable[str]:
        """All topics that anybody publishes or subscribes to."""
        ...

    def count_publishers(self, topic_name: str) -> int:
        """How many publishers a topic has, the bridge's own included."""
        ...

    def publishers(self, topic_name: str) -> Iterable[Publisher]:
        """The publishers of a topic."""
        ...


class PublishersChanged(NamedTuple):
    """A watched topic has other foreign publishers than before; none: its source is gone."""

    topic_name: str
    publishers: tuple[Publisher, ...]


class TopicIllegal(NamedTuple):
    """A name has appeared that begins like a UA topic and is none."""

    topic_name: str
    reason: str


GraphChange = PublishersChanged | TopicIllegal


class _Watched:
    __slots__ = ("count", "full_look_at", "publishers")

    def __init__(self) -> None:
        self.count = 0
        self.full_look_at = 0.0
        self.publishers: tuple[Publisher, ...] = ()


class GraphWatch:
    """Watches all UA topics of one space, and the topics that `fleet.yaml` maps."""

    def __init__(self, space: int, mapped: Iterable[str] = ()) -> None:
        """`mapped` are full names such as `/battery_state`."""
        self._space = space
        self._watched = {name: _Watched() for name in mapped}
        self._others: set[str] = set()
        self._illegal: set[str] = set()

    def look(self, view: GraphView, now: float) -> list[GraphChange]:
        """What has changed since the last look."""
        changes = self._new_names(view.topic_names())
        for name, watched in self._watched.items():
            count = view.count_publishers(name)
            if count == watched.count and (not count or now < watched.full_look_at):
                continue
            watched.count, watched.full_look_at = count, now + _FULL_LOOK_S
            publishers = tuple(sorted(p for p in view.publishers(name) if not p.own)) if count else ()
            if publishers != watched.publishers:
                watched.publishers = publishers
                changes.append(PublishersChanged(name, publishers))
        return changes

    def _new_names(self, names: Iterable[str]) -> list[GraphChange]:
        changes: list[GraphChange] = []
        still_illegal: set[str] = set()
        for name in names:
            if not name.startswith(_PREFIX) or name in self._watched or name in self._others:
                continue
            if name in self._illegal:
                still_illegal.add(name)
                continue
            try:
                topic = Topic.parse(name[1:])
            except TopicInvalid as error:
                still_illegal.add(name)
                changes.append(TopicIllegal(name, error.reason))
                continue
            if topic.space == self._space:
                self._watched[name] = _Watched()
            else:
                self._others.add(name)
        self._illegal = still_illegal  # a name that goes and comes back is counted again
        return changes
