"""A node of no ROS at all."""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from ua_bridges.ros.codec import CDR_LITTLE_ENDIAN
from ua_bridges.ros.schema import schema_from_ros2
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.graph import Publisher
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.qos import Offer, Qos

from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound

HEADER = {"stamp": "builtin_interfaces/Time", "frame_id": "string"}
TYPES: dict[str, dict[str, str]] = {
    "std_msgs/Int32": {"data": "int32"},
    "std_msgs/Float64": {"data": "double"},
    "std_msgs/Header": HEADER,
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
    "my_msgs/Stamped": {"header": "std_msgs/Header", "value": "double"},
}


class Message(SimpleNamespace):
    """A message whose fields can be set."""


def fake_type(ros_type: str) -> MessageType:
    name = ros_type.replace("/msg/", "/")
    return MessageType(name, Message, schema_from_ros2(name, TYPES.__getitem__), "header" in TYPES[name])


class FakePublisher:
    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.matched = 0
        self.acknowledged = True

    def publish(self, message: Any) -> None:
        self.sent.append(message.data)

    def get_subscription_count(self) -> int:
        return self.matched

    def wait_for_all_acked(self, _timeout: Any) -> bool:
        return self.acknowledged


def _nothing(*_args: Any) -> None:
    """For what nobody has asked for yet."""


class FakeNode:
    """What sources and outlets ask of a node."""

    no_time = None

    def __init__(self) -> None:
        self.subscriptions: list[tuple[str, Qos]] = []
        self.destroyed = 0
        self.callback: Callable[..., None] = _nothing
        self.tell_incompatible: Callable[[str], None] = _nothing
        self.publisher = FakePublisher()
        self.there: list[Publisher] = []
        self.node = self

    def create_subscription(
        self,
        _cls: Any,
        name: str,
        qos: Qos,
        callback: Callable[..., None],
        on_incompatible: Callable[[str], None],
        *,
        raw: bool,
    ) -> object:
        assert raw
        self.subscriptions.append((name, qos))
        self.callback, self.tell_incompatible = callback, on_incompatible
        return object()

    def destroy_subscription(self, _subscription: object) -> None:
        self.destroyed += 1

    def create_publisher(self, *_args: Any) -> FakePublisher:
        return self.publisher

    def destroy_publisher(self, _publisher: object) -> None:
        self.destroyed += 1

    def subscribers(self, _name: str) -> list[Publisher]:
        return self.there

    def as_node(self) -> Ros2Node:
        return cast("Ros2Node", self)

    def say(
        self,
        data: float,
        sent_ns: int,
        received_ns: int = 2_000_000_000_000_000_000,
        stamp: tuple[int, int] | None = None,
    ) -> None:
        """A message comes in CDR: an Int32, a Float64, or with a stamp a Stamped."""
        content = struct.pack("<i" if isinstance(data, int) else "<d", data)
        if stamp is not None:
            content = struct.pack("<iIIxxxxd", *stamp, 1, data)
        info = {"source_timestamp": sent_ns, "received_timestamp": received_ns}
        self.callback((CDR_LITTLE_ENDIAN + content, info))


def publisher(
    gid: bytes = b"a", kind: str = "std_msgs/msg/Int32", *, reliable: bool = True, transient_local: bool = False
) -> Publisher:
    return Publisher(kind, Offer(gid, reliable, transient_local), False)


class Recorder:
    """An inlet that keeps what it gets."""

    def __init__(self) -> None:
        self.events: list[DriverEvent] = []

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def said(self) -> list[str]:
        """The events in short."""
        return [_short(event) for event in self.events]


def _short(event: DriverEvent) -> str:
    if isinstance(event, SampleRead):
        return " ".join(str(value) for value in event.values)
    if isinstance(event, Dropped):
        return f"{event.cause.value}:{event.count}"
    return "found" if isinstance(event, SourceFound) else "lost"
