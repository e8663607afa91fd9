from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from ua_bridges.ros.delivered import Delivered
from ua_bridges.ros2 import session
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.outlet import MOST_HELD, Outlet
from ua_bridges.ros2.qos import Qos
from ua_bridges.ros2.session import Ros2Driver

from tests.unit.bridges.ros2.fakes import fake_type
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.config.schema import FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.metadata import with_max_age
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

TOPIC = Topic(1, 2, 1001)
CONFIG = FleetConfig(
    version=1,
    pubsub=PubSubConfig(security=PubSubSecurity.NONE),
    bridges={"cell": Ros2BridgeConfig(kind="ros2", space=2)},
)


class Driver(Ros2Driver):
    """One whose node is there, and does nothing."""

    def __init__(self, config: FleetConfig) -> None:
        super().__init__(config, "cell")
        self.put_in: list[DriverEvent] = []
        self._inlet = self
        self._watch: Any = SimpleNamespace(attend=id, drop=id, forget=id)
        self._thread._node = SimpleNamespace(executor=SimpleNamespace(create_task=id))  # type: ignore[assignment]
        self._delivered = Delivered(None)

    def put(self, event: DriverEvent) -> None:
        self.put_in.append(event)


def test_a_publisher_goes_on_when_the_maximum_age_of_its_source_is_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "load_type", fake_type)
    made: list[Outlet] = []

    def make(name: str, kind: MessageType, qos: Qos) -> Outlet:
        made.append(Outlet(name, kind, qos))
        return made[-1]

    monkeypatch.setattr(session, "Outlet", make)
    driver = Driver(CONFIG)
    fields = (make_field("data", BuiltinType.DOUBLE),)
    for number, age_s in enumerate((None, 3.0, 5.0, None)):
        metadata = DataSetMetaData("source", with_max_age(fields, age_s), ConfigurationVersion(7, 7 + number))
        part = DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number)
        assert driver.publish(TOPIC, metadata, part)
    assert len(made) == 1
    assert driver.put_in == []


def test_messages_that_no_subscriber_gets_since_more_came_than_are_held_are_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(session, "load_type", fake_type)
    driver = Driver(CONFIG)
    metadata = DataSetMetaData("source", (make_field("data", BuiltinType.DOUBLE),), ConfigurationVersion(7, 7))
    for number in range(MOST_HELD + 3):
        part = DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number)
        assert driver.publish(TOPIC, metadata, part)
    assert [(drop.cause, drop.count) for drop in driver.put_in if isinstance(drop, Dropped)] == [
        (Drop.INLET_FULL, 1)
    ] * 3
