# pyright: basic, reportMissingImports=false
"""The node thread's work: it looks at the graph, listens to its sources, and attends to new publishers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

from ua_bridges.ros.served import Served
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.environment import PROFILES_VARIABLE
from ua_bridges.ros2.feed import Feed, MappedFeed, MirrorFeed
from ua_bridges.ros2.graph import LOOK_S, GraphWatch, PublishersChanged, TopicIllegal
from ua_bridges.ros2.late import LateSubscribers
from ua_bridges.ros2.node import Ros2Node, guarded
from ua_bridges.ros2.outlet import Outlet
from ua_bridges.ros2.source import RosSource
from ua_fleet.bridge.configured import ConfiguredData
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.config.schema import QosConfig, TopicMapping
from ua_fleet.counters import Drop
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.topics import Topic

__all__ = ["Heard", "Watch", "absolute"]

_ATTEND_S: Final = 0.005
"""New publishers are looked at so often until their subscribers have matched."""
_LATE_S: Final = 0.2

Mapped = ConfiguredData[TopicMapping]
"""A DataSet that is read from a robot's own topic."""


class Heard(NamedTuple):
    """A topic that is listened to and is no data source."""

    name: str
    """Full name."""
    type: str
    qos: QosConfig
    feed: Feed


def absolute(topic_name: str) -> str:
    """The full name of a topic."""
    return topic_name if topic_name.startswith("/") else f"/{topic_name}"


class Watch:
    """All methods run in the node's thread."""

    def __init__(
        self,
        config: Ros2BridgeConfig,
        inlet: Inlet,
        mapped: Iterable[Mapped],
        written: set[str],
        served: Served,
        wake_at: Callable[[float], None],
        heard: Iterable[Heard] = (),
    ) -> None:
        """Prepare the watch.

        Args:
            config: the bridge.
            inlet: where everything is told.
            mapped: DataSets that are read from robots' own topics.
            written: full names of the robots' own topics that the bridge publishes to.
            served: whom the bridge before this one had served.
            wake_at: has `turn` called no later.
            heard: topics that are listened to and are no data sources.
        """
        self._config = config
        self._inlet = inlet
        self._mapped: dict[str, list[Mapped]] = {}
        for each in mapped:
            self._mapped.setdefault(absolute(each.side.topic), []).append(each)
        self._written = written
        self._wake_at = wake_at
        self._heard: dict[str, list[Heard]] = {}
        for listened in heard:
            self._heard.setdefault(listened.name, []).append(listened)
        self._graph = GraphWatch(config.space, {**self._mapped, **self._heard})
        self._late = LateSubscribers(config, served)
        self._sources: dict[str, RosSource] = {}
        self._opening: list[Outlet] = []
        self._look_at = self._late_at = 0.0

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
        for name, datasets in self._mapped.items():
            self._sources[name] = self._make_mapped_source(name, datasets)
        for name, heard in self._heard.items():
            if name not in self._sources:
                feeds = [each.feed for each in heard]
                self._sources[name] = RosSource(
                    name, feeds, self._node, self._inlet, self._look_soon, wanted_type=heard[0].type, qos=heard[0].qos
                )

    def _make_mapped_source(self, name: str, datasets: list[Mapped]) -> RosSource:
        feeds: list[Feed] = [
            MappedFeed(data.topic, data.config, data.name, self._inlet, time.monotonic, self._wake_at)
            for data in datasets
        ]
        feeds += [each.feed for each in self._heard.get(name, [])]
        first = datasets[0].side
        return RosSource(name, feeds, self._node, self._inlet, self._look_soon, wanted_type=first.type, qos=first.qos)

    def turn(self, now: float) -> float:
        """Do what is due; when to be called again."""
        if now >= self._look_at:
            self._look_at = now + LOOK_S
            self._look(now)
        due = self._look_at
        for source in self._sources.values():
            when = source.release(now)
            if when is not None:
                due = min(due, when)
        if self._opening:
            self._opening = [outlet for outlet in self._opening if not self._attend(outlet, now)]
            if self._opening:
                due = min(due, now + _ATTEND_S)
        if now >= self._late_at:
            self._late_at = now + _LATE_S
            self._late.look(self._node)
        return due

    def _look_soon(self) -> None:
        self._look_at = 0.0
        self._wake_at(0.0)

    def _look(self, now: float) -> None:
        for change in self._graph.look(self._node, now):
            if isinstance(change, TopicIllegal):
                self._inlet.put(Dropped(Drop.ILLEGAL_TOPIC, detail=f"{change.topic_name}: {change.reason}"))
            else:
                guarded(self._follow)(change)
        for source in self._sources.values():
            source.looked()

    def _follow(self, change: PublishersChanged) -> None:
        source = self._sources.get(change.topic_name)
        if source is None:
            feed = MirrorFeed(Topic.parse(change.topic_name[1:]), self._inlet)
            source = RosSource(change.topic_name, [feed], self._node, self._inlet, self._look_soon)
            self._sources[change.topic_name] = source
        source.follow(change.publishers)

    def attend(self, outlet: Outlet) -> None:
        """Look after a new outlet until it is open."""
        self._opening.append(outlet)
        self._wake_at(0.0)

    def drop(self, outlet: Outlet) -> None:
        """End an outlet."""
        if outlet in self._opening:
            self._opening.remove(outlet)
        self._late.unwatch(outlet.name)
        outlet.close(self._node)

    def keep(self, name: str, message_class: Any, message: Any) -> None:
        """Keep a message that the bridge before this one has published."""
        self._late.keep(name, message_class, message)

    def forget(self, name: str) -> None:
        """There is a newer message than the one that is kept."""
        self._late.forget(name)

    def _attend(self, outlet: Outlet, now: float) -> bool:
        def on_incompatible(policy: str) -> None:
            text = (
                f"{outlet.name}: a subscriber asks for another {policy} than the bridge offers and gets nothing; "
                "set `qos` of the sink in fleet.yaml"
            )
            self._inlet.put(Dropped(Drop.INCOMPATIBLE_QOS, detail=text))

        is_open = outlet.attend(self._node, now, self._opened_at, on_incompatible)
        if is_open and outlet.qos.transient_local:
            self._late.watch(self._node, outlet.name)
        return is_open

    def closing(self) -> None:
        """Leave nothing behind."""
        for source in self._sources.values():
            source.close()
        self._late.close()
