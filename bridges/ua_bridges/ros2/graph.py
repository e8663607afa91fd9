"""What a look at the ROS 2 graph means for the bridge. Pure: the graph comes in through `GraphView`, facts go out.

There is no event for a change of the graph that rclpy would hand on, so the bridge looks every LOOK_S. A look costs
about 60 us for the names and 4 us for each watched topic, and 20 us more for a topic whose publishers have changed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final, NamedTuple, Protocol

from ua_bridges.ros.names import UaNames
from ua_bridges.ros2.qos import Offer

__all__ = [
    "LOOK_S",
    "QUIET_AFTER_S",
    "QUIET_LOOK_S",
    "GraphChange",
    "GraphView",
    "GraphWatch",
    "Publisher",
    "PublishersChanged",
    "TopicIllegal",
    "TopicRefused",
]

LOOK_S: Final = 0.1
QUIET_AFTER_S: Final = 10.0
QUIET_LOOK_S: Final = 0.5
"""So often is a graph looked at in which nothing has changed for QUIET_AFTER_S."""
_FULL_LOOK_S: Final = 1.0
"""Publishers are counted at each look, and asked who they are when the count changes, or after so long."""

MOST_TOPICS: Final = 2000
"""Topics of the own space that are watched, at some microseconds for each look; anybody may make new ones."""


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


class TopicRefused(NamedTuple):
    """A topic of the own space that is not watched, since there are too many."""

    topic_name: str


GraphChange = PublishersChanged | TopicIllegal | TopicRefused


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
        self._names = UaNames(space)
        self._mapped = frozenset(mapped)
        self._watched = {name: _Watched() for name in self._mapped}
        self._refused: set[str] = set()

    def look(self, view: GraphView, now: float) -> list[GraphChange]:
        """What has changed since the last look."""
        names = dict.fromkeys(view.topic_names())  # in their order, and found at once
        for name in [each for each, seen in self._watched.items() if not seen.count and each not in names]:
            if name not in self._mapped:
                self.forget(name)  # somebody subscribed, and nobody published
        changes = self._new_names(names)
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

    def forget(self, name: str) -> None:
        """A topic is not watched any more; found again where somebody publishes it."""
        self._watched.pop(name, None)
        self._names.forget(name)

    def look_again(self, name: str) -> None:
        """Tell the publishers of a watched topic again."""
        if name in self._watched:
            self._watched[name] = _Watched()

    def _new_names(self, names: Collection[str]) -> list[GraphChange]:
        news = self._names.look(names)
        changes: list[GraphChange] = [TopicIllegal(name, error.reason) for name, error in news.illegal]
        refused: set[str] = set()
        for topic in news.found:
            name = f"/{topic.name}"
            if name in self._watched:
                continue  # a robot's program tells of its executions there
            if len(self._watched) < MOST_TOPICS + len(self._mapped):
                self._watched[name] = _Watched()
                continue
            self._names.forget(name)  # it is found again at the next look, when there may be room
            refused.add(name)
            if name not in self._refused:
                changes.append(TopicRefused(name))
        self._refused = refused
        return changes
