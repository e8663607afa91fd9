from __future__ import annotations

from typing import Any

import pytest
from ua_bridges.ros.delivered import Delivered
from ua_bridges.ros.outlets import Outlets
from ua_bridges.ros2 import publishing
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.outlet import MOST_HELD, HeldPublisher
from ua_bridges.ros2.publishing import Ros2Outlet, Ros2Publishing
from ua_bridges.ros2.qos import Qos

from tests.unit.bridges.ros2.fakes import fake_type
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.metadata import with_max_age
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

TOPIC = Topic(1, 2, 1001)


class Bench:
    """All that is published, by a node that does nothing."""

    def __init__(self) -> None:
        self.put_in: list[DriverEvent] = []
        self.done: list[str] = []
        no_loop: Any = None  # for rate limits alone
        made = Ros2Publishing(self, lambda step: step())
        self.outlets: Outlets[Ros2Outlet] = Outlets(self, no_loop, Delivered(None), made)

    def attend(self, publisher: HeldPublisher) -> None:
        self.done.append("attend")

    def drop(self, publisher: HeldPublisher) -> None:
        self.done.append("drop")

    def keep(self, name: str, message_class: Any, message: Any) -> None:
        self.done.append("keep")

    def forget(self, name: str) -> None:
        self.done.append("forget")

    def put(self, event: DriverEvent) -> None:
        self.put_in.append(event)


@pytest.fixture(autouse=True)
def types(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing, "load_type", fake_type)


def test_a_publisher_goes_on_when_the_maximum_age_of_its_source_is_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[HeldPublisher] = []

    def make(name: str, kind: MessageType, qos: Qos) -> HeldPublisher:
        made.append(HeldPublisher(name, kind, qos))
        return made[-1]

    monkeypatch.setattr(publishing, "HeldPublisher", make)
    bench = Bench()
    fields = (make_field("data", BuiltinType.DOUBLE),)
    for number, age_s in enumerate((None, 3.0, 5.0, None)):
        metadata = DataSetMetaData("source", with_max_age(fields, age_s), ConfigurationVersion(7, 7 + number))
        part = DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number)
        assert bench.outlets.publish(TOPIC, metadata, part)
    assert len(made) == 1
    assert bench.put_in == []
    assert bench.done == ["attend", "forget"]


def test_a_publisher_of_another_type_takes_its_place() -> None:
    bench = Bench()
    for number, ros_type in enumerate(("std_msgs/Float64", "std_msgs/Int32")):
        builtin = BuiltinType.INT32 if number else BuiltinType.DOUBLE
        fields = (make_field("data", builtin, properties={"RosType": ros_type}),)
        metadata = DataSetMetaData("source", fields, ConfigurationVersion(7, 7 + number))
        assert bench.outlets.publish(TOPIC, metadata, DataSetMessage(TOPIC.id, values=(1,), timestamp=1000 + number))
    assert bench.done == ["attend", "forget", "drop", "attend"]


def test_messages_that_no_subscriber_gets_since_more_came_than_are_held_are_counted() -> None:
    bench = Bench()
    metadata = DataSetMetaData("source", (make_field("data", BuiltinType.DOUBLE),), ConfigurationVersion(7, 7))
    for number in range(MOST_HELD + 3):
        part = DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number)
        assert bench.outlets.publish(TOPIC, metadata, part)
    assert [(drop.cause, drop.count) for drop in bench.put_in if isinstance(drop, Dropped)] == [
        (Drop.INLET_FULL, 1)
    ] * 3
