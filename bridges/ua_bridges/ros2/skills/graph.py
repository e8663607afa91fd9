# pyright: basic, reportMissingImports=false
"""The ROS 2 graph as the ports see it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Final, Literal

from ua_bridges.ros.ports import LoadedType
from ua_bridges.ros.schema import MessageSchema, schema_from_ros2
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros2.classes import TypeMissing, load_type
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.qos import Qos, sink_qos
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.counters import Drop

__all__ = ["Ros2Graph", "find_type", "part_schema"]

SETTLE_S: Final = 0.3
"""A match on our side says nothing of the subscriber's; what is published before it has matched is lost to it."""


def find_type(ros_type: str, folder: Literal["srv", "action"]) -> Any:
    """The class of a service or action type; raises TypeMissing."""
    package, _, name = ros_type.replace(f"/{folder}/", "/").partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except (ImportError, AttributeError):
        raise TypeMissing(ros_type, folder) from None


def part_schema(name: str, cls: Any) -> MessageSchema:
    """The schema of a part of a service or an action, whose class is at hand.

    Raises:
        TypeMissing, SchemaInvalid: a type in it is not installed, or has no flat form.
    """

    def field_types(wanted: str) -> Any:
        return (cls if wanted == name else load_type(wanted).cls).get_fields_and_field_types()

    return schema_from_ros2(name, field_types)


class _Spoken:
    """See `ua_bridges.ros.ports.Spoken`."""

    def __init__(
        self, node: Ros2Node, name: str, message_class: Any, qos: Qos, put: Callable[[DriverEvent], None]
    ) -> None:
        def on_incompatible(policy: str) -> None:
            said = f"{name}: a subscriber asks for another {policy} than the bridge offers and gets nothing; set `qos`"
            put(Dropped(Drop.INCOMPATIBLE_QOS, detail=said))

        self._name = name
        self._publisher = node.create_publisher(message_class, name, qos, on_incompatible)
        self._since: float | None = None

    def look(self, now: float) -> str:
        """See Spoken."""
        if not self._publisher.get_subscription_count():
            self._since = None
            return f"{self._name} has no subscriber; start the robot's node"
        if self._since is None:
            self._since = now
        return "" if now >= self._since + SETTLE_S else f"{self._name} is not ready yet"

    def publish(self, message: Any) -> None:
        """See Spoken. rclpy serialises the message before it returns."""
        self._publisher.publish(message)


class Ros2Graph:
    """See `ua_bridges.ros.ports.SkillGraph`; `node` is for services and actions."""

    def __init__(self, node: Ros2Node, put: Callable[[DriverEvent], None]) -> None:
        self.node, self._put = node, put

    def load(self, ros_type: str) -> LoadedType:
        """See SkillGraph."""
        kind = load_type(ros_type)
        return LoadedType(kind.cls, kind.schema)

    def speak(self, name: str, ros_type: str, qos: QosConfig) -> _Spoken:
        """See SkillGraph."""
        return _Spoken(self.node, name, load_type(ros_type).cls, sink_qos(qos), self._put)
