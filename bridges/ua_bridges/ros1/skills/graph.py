# pyright: basic, reportMissingImports=false
"""The ROS 1 graph as the ports see it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import rospy

from ua_bridges.ros.ports import LoadedType
from ua_bridges.ros.schema import ros1_type_name
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros1.classes import TypeUnavailable, needed_type
from ua_bridges.ros1.master import SystemState
from ua_bridges.ros1.outlet import QUEUE_SIZE
from ua_bridges.ros1.subscribers import SubscriberLink, links_of
from ua_bridges.ros1.tcpros import SILENT_S
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.counters import Drop
from ua_fleet.printing import harmless

__all__ = ["Ros1Graph", "ros1_name"]

SETTLE_S: Final = 1.0
"""Subscribers that the master knows have so long to link themselves after the first one has."""
UNDELIVERED_S: Final = 20.0
"""What was published and has not arrived for so long is not delivered any more: somebody may have asked anew."""


def ros1_name(ros_type: str) -> str:
    """The name of a type in ROS 1, for what `fleet.yaml` may say in either way."""
    for folder in ("/msg/", "/srv/", "/action/"):
        ros_type = ros_type.replace(folder, "/")
    return ros1_type_name(ros_type)


class _Spoken:
    """See `ua_bridges.ros.ports.Spoken`. rospy sends in threads of its own."""

    def __init__(
        self, name: str, publisher: Any, subscribers: Callable[[], int], put: Callable[[DriverEvent], None]
    ) -> None:
        self._name, self._publisher, self._subscribers, self._put = name, publisher, subscribers, put
        self._since: float | None = None

    def look(self, now: float) -> str:
        """See Spoken."""
        links = links_of(self._name)
        if not links:
            self._since = None
            return f"{self._name} has no subscriber; start the robot's node"
        unanswered = [link for link in links if link.unanswered_s > SILENT_S]
        if unanswered:
            self._withdraw(unanswered)
        if len(unanswered) == len(links):
            self._since = None
            return f"no subscriber of {self._name} answers; look at the network of the robot's node"
        if self._since is None:
            self._since = now
        if len(links) < self._subscribers() and now < self._since + SETTLE_S:
            return f"{self._name} is not linked to all its subscribers yet"
        return ""

    def _withdraw(self, unanswered: Iterable[SubscriberLink]) -> None:
        """End the links on which something is on its way for too long: the robot gets it soon, or never."""
        for link in unanswered:
            if link.unanswered_s > UNDELIVERED_S and link.has_undelivered:
                link.cut()
                said = f"{self._name}: {link.subscriber} has not got what was published for {UNDELIVERED_S:g} s"
                self._put(Dropped(Drop.UNLINKED, detail=harmless(f"{said}; it will not get it later")))

    def publish(self, message: Any) -> None:
        """See Spoken."""
        self._publisher.publish(message)


class Ros1Graph:
    """See `ua_bridges.ros.ports.SkillGraph`; and what services need."""

    def __init__(
        self,
        node_name: str,
        master_uri: str,
        state: Callable[[], SystemState],
        call: Callable[[Callable[[], None]], None],
        put: Callable[[DriverEvent], None],
    ) -> None:
        """Begin with nothing published.

        Args:
            node_name: of this process.
            master_uri: of the master.
            state: what it said last.
            call: has a step done in the skills' thread.
            put: where is told what was not delivered.
        """
        self._put = put
        self.node_name, self.master_uri, self.state, self.call = node_name, master_uri, state, call
        self.spoken: dict[str, str] = {}
        """Type of each topic that is published; the watch registers them."""

    def load(self, ros_type: str) -> LoadedType:
        """See SkillGraph."""
        kind = needed_type(ros1_name(ros_type))
        return LoadedType(kind.cls, kind.schema)

    def speak(self, name: str, ros_type: str, qos: QosConfig) -> _Spoken:
        """See SkillGraph. ROS 1 has no quality of service."""
        kind = needed_type(ros1_name(ros_type))
        try:
            publisher = rospy.Publisher(name, kind.cls, queue_size=QUEUE_SIZE, tcp_nodelay=True)
        except rospy.ROSException as error:
            raise TypeUnavailable(f"{name} is published with another type already: {error}") from error
        self.spoken[name] = kind.name
        return _Spoken(name, publisher, lambda: self._subscribers(name), self._put)

    def _subscribers(self, name: str) -> int:
        return sum(other != self.node_name for other in self.state().subscribers.get(name, ()))
