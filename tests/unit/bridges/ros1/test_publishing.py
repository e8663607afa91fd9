# pyright: basic, reportMissingImports=false
from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from ua_bridges.ros.delivered import Delivered
from ua_bridges.ros.outlets import Gone, Outlets
from ua_bridges.ros1 import publishing as publishing_module
from ua_bridges.ros1.classes import needed_type
from ua_bridges.ros1.outlet import HOLD_S, LATCH_S, QUEUE_SIZE, Outlet
from ua_bridges.ros1.publishing import Ros1Publishing

from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.metadata import with_max_age
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

TOPIC = Topic(2, 2, 1001)


class Recorded(Outlet):
    """An outlet that no node publishes."""

    def __init__(self, name: str, kind: Any, *_args: Any, **_kwargs: Any) -> None:
        self.name, self.kind = name, kind
        self.sent: list[Any] = []

    def publish(self, values: Any, gone: Gone) -> int:
        self.sent.append(values)
        gone()
        return 0

    def close(self) -> int:
        raise AssertionError("its subscribers would lose what is under way")


class Inlet:
    def __init__(self) -> None:
        self.events: list[DriverEvent] = []

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)


def test_a_publisher_goes_on_when_the_maximum_age_of_its_source_is_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing_module, "Outlet", Recorded)
    loop = asyncio.new_event_loop()
    inlet = Inlet()
    made = Outlets(inlet, loop, Delivered(None), Ros1Publishing(lambda _replaced: None))
    fields = (make_field("data", BuiltinType.DOUBLE),)
    for number, age_s in enumerate((None, 3.0, 5.0, None)):
        metadata = DataSetMetaData("source", with_max_age(fields, age_s), ConfigurationVersion(7, 7 + number))
        part = DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number)
        assert made.publish(TOPIC, metadata, part)
    loop.close()
    (outlet,) = made
    assert isinstance(outlet, Recorded)
    assert outlet.sent == [(0.0,), (1.0,), (2.0,), (3.0,)]
    assert inlet.events == []


def test_messages_that_no_subscriber_gets_since_more_came_than_are_held_are_counted() -> None:
    loop, inlet = asyncio.new_event_loop(), Inlet()
    made = Outlets(inlet, loop, Delivered(None), Ros1Publishing(lambda _replaced: None))
    double, text = (
        DataSetMetaData("source", (make_field("data", builtin),), ConfigurationVersion(7, 7))
        for builtin in (BuiltinType.DOUBLE, BuiltinType.STRING)
    )
    for number in range(QUEUE_SIZE + 3):
        assert made.publish(TOPIC, double, DataSetMessage(TOPIC.id, values=(float(number),), timestamp=1000 + number))
    assert made.publish(TOPIC, text, DataSetMessage(TOPIC.id, values=("x",), timestamp=2000))
    loop.close()
    lost = [(event.cause, event.count) for event in inlet.events if isinstance(event, Dropped)]
    assert lost == [(Drop.INLET_FULL, 1)] * 3 + [(Drop.INLET_FULL, QUEUE_SIZE)]


def test_who_connects_late_has_more_time_where_nothing_else_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    remembering, publishing = (
        Outlet(f"/{name}", needed_type("std_msgs/Int32"), ("data",), latched=True) for name in "ab"
    )
    remembering.remember((2,))
    publishing.remember((2,))
    publishing.publish((3,), lambda: None)
    now += HOLD_S + 0.1
    assert publishing.is_ready(1)
    assert not remembering.is_ready(1)
    assert remembering.is_ready(0)
    now += LATCH_S - HOLD_S
    assert remembering.is_ready(1)
