# pyright: basic, reportMissingImports=false
"""The node thread's work: it looks at the graph, listens to its sources, and attends to new publishers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Protocol

from ua_bridges.ros.feed import Feed, Mapped, MappedFeed, MirrorFeed
from ua_bridges.ros.served import Served
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.environment import PROFILES_VARIABLE
from ua_bridges.ros2.graph import (
    LOOK_S,
    MOST_TOPICS,
    QUIET_AFTER_S,
    QUIET_LOOK_S,
    GraphWatch,
    Publisher,
    PublishersChanged,
    TopicIllegal,
    TopicRefused,
)
from ua_bridges.ros2.late import LateSubscribers
from ua_bridges.ros2.node import Ros2Node, guarded
from ua_bridges.ros2.outlet import HeldPublisher
from ua_bridges.ros2.source import RosSource
from ua_bridges.ros2.sources import Sources
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.topics import Topic

__all__ = ["Listener", "Watch"]

_ATTEND_S: Final = 0.005
"""New publishers are looked at so often until their subscribers have matched."""
_LATE_S: Final = 0.2


class Listener(Protocol):
    """Who listens to a topic in a thread of its own, and is told of its publishers."""

    name: str
    """Full name of the topic."""

    def follow(self, publishers: Sequence[Publisher]) -> None:
        """Take note of the publishers that are there now, our own left out."""
        ...

    def looked(self) -> None:
        """The graph was looked at."""
        ...


class Watch:
    """All methods run in the node's thread."""

    def __init__(
        self,
        config: Ros2BridgeConfig,
        inlet: Inlet,
        mapped: Iterable[Mapped],
        written: set[str],
        served: Served,
        loop: asyncio.AbstractEventLoop,
        wake_at: Callable[[float], None],
        offenders: Offenders,
        listeners: Iterable[Listener] = (),
    ) -> None:
        """Prepare the watch.

        Args:
            config: the bridge.
            inlet: where everything is told.
            mapped: DataSets that are read from robots' own topics.
            written: full names of the robots' own topics that the bridge publishes to.
            served: whom the bridge before this one had served.
            loop: has the timers of rate limits.
            wake_at: has `turn` called no later.
            offenders: the topics that are put aside.
            listeners: who listens to topics that are no data sources by being listened to.
        """
        self._config = config
        self._inlet = inlet
        self._mapped: dict[str, list[Mapped]] = {}
        for each in mapped:
            self._mapped.setdefault(each.side.own_topic, []).append(each)
        self._written = written
        self._loop, self._wake_at = loop, wake_at
        self._listeners = {listener.name: listener for listener in listeners}
        self._offenders = offenders
        self._graph = GraphWatch(config.space, {*self._mapped, *self._listeners})
        self._sources = Sources(list(self._mapped), self._make_source, self._graph, inlet, offenders)
        self._late = LateSubscribers(config, served)
        self._opening: list[HeldPublisher] = []
        self._look_at = self._late_at = self._changed_at = 0.0

    def opened(self, node: Ros2Node) -> None:
        """The node is there.

        Raises:
            BridgeUnavailable: a topic is mapped both ways, and the node would hear itself on it.
        """
        self._node = node
        self._opened_at = time.monotonic()
        both_ways = sorted(self._written & set(self._mapped))
        if both_ways and node.hears_itself():
            raise BridgeUnavailable(
                f"{both_ways[0]} is mapped in both directions, and the Fast DDS profile in use lets the bridge hear "
                f"itself; set its property fastdds.ignore_local_endpoints to true, or unset {PROFILES_VARIABLE}"
            )
        self._sources.open()

    def _make_source(self, name: str) -> RosSource:
        if name in self._mapped:
            return self._make_mapped_source(name, self._mapped[name])
        feed = MirrorFeed(Topic.parse(name[1:]), self._inlet)
        return RosSource(name, [feed], self._node, self._inlet, self.look_soon)

    def _make_mapped_source(self, name: str, datasets: list[Mapped]) -> RosSource:
        feeds: list[Feed] = [MappedFeed(data, self._inlet, self._loop) for data in datasets]
        first = datasets[0].side
        return RosSource(name, feeds, self._node, self._inlet, self.look_soon, wanted_type=first.type, qos=first.qos)

    def turn(self, now: float) -> float:
        """Do what is due; when to be called again."""
        if now >= self._look_at:
            self._look_at = float("inf")
            if self._look(now):
                self._changed_at = now
            pause_s = LOOK_S if now < self._changed_at + QUIET_AFTER_S else QUIET_LOOK_S
            self._look_at = min(self._look_at, now + pause_s)
        due = self._look_at
        if self._opening:
            self._opening = [each for each in self._opening if not self._attend(each, now)]
            if self._opening:
                due = min(due, now + _ATTEND_S)
        if now >= self._late_at:
            self._late_at = now + _LATE_S
            self._late.look(self._node)
        return due

    def look_soon(self) -> None:
        """Look at the graph as soon as possible."""
        self._look_at = 0.0
        self._wake_at(0.0)

    def _look(self, now: float) -> bool:
        """Look at the graph; whether anything has changed."""
        changes = self._graph.look(self._node, now)
        for change in changes:
            if isinstance(change, TopicIllegal):
                self._inlet.put(Dropped(Drop.ILLEGAL_TOPIC, detail=f"{change.topic_name}: {change.reason}"))
            elif isinstance(change, TopicRefused):
                self._inlet.put(Dropped(Drop.UNKNOWN_SOURCE, detail=f"more than {MOST_TOPICS} topics of this space"))
            else:
                self._follow(change)
        self._sources.look()
        for listener in self._listeners.values():
            guarded(listener.looked)()
        return bool(changes)

    def _follow(self, change: PublishersChanged) -> None:
        listener = self._listeners.get(change.topic_name)
        if listener is not None:
            guarded(listener.follow)(change.publishers)
        if listener is None or change.topic_name in self._mapped:
            self._sources.changed(change)

    def attend(self, publisher: HeldPublisher) -> None:
        """Look after a new publisher until it is open."""
        self._opening.append(publisher)
        self._wake_at(0.0)

    def drop(self, publisher: HeldPublisher) -> None:
        """End an publisher."""
        if publisher in self._opening:
            self._opening.remove(publisher)
        self._late.unwatch(publisher.name)
        lost = publisher.close(self._node)
        if lost:
            self._inlet.put(
                Dropped(Drop.INLET_FULL, lost, f"{publisher.name}: more messages than are held at its start")
            )

    def keep(self, name: str, message_class: Any, message: Any) -> None:
        """Keep a message that the bridge before this one has published."""
        self._late.keep(name, message_class, message)

    def forget(self, name: str) -> None:
        """There is a newer message than the one that is kept."""
        self._late.forget(name)

    def _attend(self, publisher: HeldPublisher, now: float) -> bool:
        def on_incompatible(policy: str) -> None:
            text = (
                f"{publisher.name}: a subscriber asks for another {policy} than the bridge offers and gets nothing; "
                "set `qos` of the sink in fleet.yaml"
            )
            self._inlet.put(Dropped(Drop.INCOMPATIBLE_QOS, detail=text))

        if self._offenders.is_aside(publisher.name, now):
            return False
        try:
            is_open = publisher.attend(self._node, now, self._opened_at, on_incompatible)
        except Exception as error:  # noqa: BLE001 - rclpy raises what it likes; one topic, one mistake
            said = " ".join(str(error).split())
            self._offenders.put_aside(publisher.name, f"the bridge cannot publish it: {said}", now)
            return False
        if is_open and publisher.qos.transient_local:
            self._late.watch(self._node, publisher.name)
        return is_open

    def closing(self) -> None:
        """Leave nothing behind."""
        self._sources.close()
        self._late.close()
