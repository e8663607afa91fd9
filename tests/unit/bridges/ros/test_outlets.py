"""What a bridge publishes, without any ROS: the library is a list."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ua_bridges.ros import outlets as outlets_module
from ua_bridges.ros.delivered import Delivered
from ua_bridges.ros.errors import ConversionError, SchemaInvalid
from ua_bridges.ros.feed import Mapped
from ua_bridges.ros.form import Form
from ua_bridges.ros.latched import mark_latched
from ua_bridges.ros.outlets import Gone, Outlets, Publishing, Values
from ua_bridges.ros.topic_mapping import TopicMapping

from tests.waiting import until
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.config.schema import DataSetConfig, FieldConfig, ScalarType
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FrameKind

FOREIGN, SPEED = Topic(1, 2, 1001), Topic(0, 2, 2001)
NUMBER = (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "std_msgs/Float64"}),)


class FakeOutlet:
    def __init__(self, name: str, latched: bool = False) -> None:
        self.name, self.latched = name, latched
        self.sent: list[Any] = []
        self.held: list[Gone] = []
        self.listeners, self.is_open, self.lost = 1, True, 0

    def publish(self, values: Values, gone: Gone) -> int:
        if values == ("unfit",):
            raise ConversionError("data", "it is no number")
        self.sent.append(values)
        self.held.append(gone)
        if self.is_open:
            self.open()
        return self.lost

    def open(self) -> None:
        held, self.held = self.held, []
        for gone in held:
            gone()

    def write(self, values: Values) -> bool:
        if self.is_open:
            self.publish(values, lambda: None)
        return self.is_open

    def remember(self, values: Values) -> None:
        self.sent.append(("kept", *values))

    def supersede(self) -> None:
        self.sent.append("newer")


class FakePublishing(Publishing[FakeOutlet]):
    failures = (ConversionError, KeyError)

    def __init__(self) -> None:
        self.told: list[tuple[str | None, str | None]] = []
        self.held = 0

    def mirror(self, name: str, form: Form, *, latched: bool, are_events: bool) -> tuple[FakeOutlet, Form]:
        assert not (latched and are_events)
        if form.ros_type == "nobody_msgs/Thing":
            raise SchemaInvalid(form.ros_type, "it is not installed")
        return FakeOutlet(name, latched), form

    def sink(self, data: Mapped, *, takes_setpoints: bool) -> FakeOutlet:
        if data.side.type == "nobody_msgs/Thing":
            raise SchemaInvalid(data.side.type, "it is not installed")
        return FakeOutlet(data.side.own_topic)

    def retire(self, outlet: FakeOutlet) -> int:
        return self.held

    def changed(self, made: FakeOutlet | None, replaced: FakeOutlet | None) -> None:
        self.told.append((made.name if made else None, replaced.name if replaced else None))


class Bench:
    def __init__(self, loop: asyncio.AbstractEventLoop, delivered: Delivered | None = None) -> None:
        self.events: list[DriverEvent] = []
        self.publishing = FakePublishing()
        self.outlets = Outlets(self, loop, delivered or Delivered(None), self.publishing)
        self.timestamp = 1000

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def add_sink(self, **options: Any) -> None:
        side = TopicMapping.model_validate({"topic": "cmd", "type": "geometry_msgs/Twist", **options})
        fields = {"v": FieldConfig(type=ScalarType.DOUBLE), "w": FieldConfig(type=ScalarType.DOUBLE)}
        config = DataSetConfig(id=SPEED.id, origin="server", fields=fields, sink=side)
        self.outlets.add_sink(Mapped("rover", "speed", SPEED, config, side))

    def publish(
        self, *values: Any, topic: Topic = FOREIGN, fields: Any = NUMBER, kind: FrameKind = FrameKind.KEY
    ) -> bool:
        self.timestamp += 1
        metadata = DataSetMetaData("source", fields, ConfigurationVersion(7, 7))
        message = DataSetMessage(topic.id, kind, values=values, timestamp=self.timestamp)
        return self.outlets.publish(topic, metadata, message)

    def drops(self) -> list[tuple[Drop, int, str]]:
        return [(event.cause, event.count, event.detail) for event in self.events if isinstance(event, Dropped)]

    def sent(self) -> dict[str, list[Any]]:
        return {outlet.name: outlet.sent for outlet in self.outlets}


TWIST = tuple(make_field(name, BuiltinType.DOUBLE) for name in "vw")
SWAPPED = tuple(make_field(name, BuiltinType.DOUBLE) for name in "wv")


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    made = asyncio.new_event_loop()
    yield made
    made.close()


@pytest.fixture
def bench(loop: asyncio.AbstractEventLoop) -> Bench:
    return Bench(loop)


def test_a_message_of_another_space_goes_to_the_topic_of_its_name(bench: Bench) -> None:
    assert bench.publish(1.0)
    assert bench.publish(2.0)
    assert bench.sent() == {"/ua_1_2_1001": ["newer", (1.0,), (2.0,)]}
    assert bench.publishing.told == [("/ua_1_2_1001", None)]


def test_states_are_latched_and_events_are_not(bench: Bench) -> None:
    bench.publish(1.0)
    bench.publish(1.0, topic=Topic(0, 2, 5))
    bench.publish(1.0, topic=Topic(1, 2, 6), fields=mark_latched(NUMBER))
    bench.publish(1.0, topic=Topic(0, 2, 7), kind=FrameKind.EVENT)
    assert [outlet.latched for outlet in bench.outlets] == [False, True, True, False]


def test_a_type_that_is_not_here_is_told_for_each_message(bench: Bench) -> None:
    fields = (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "nobody_msgs/Thing"}),)
    assert not bench.publish(1.0, fields=fields)
    assert not bench.publish(2.0, fields=fields)
    assert [(cause, count) for cause, count, _ in bench.drops()] == [(Drop.TYPE_MISSING, 1)] * 2
    assert "ua_1_2_1001 cannot be published here" in bench.drops()[0][2]
    assert bench.publishing.told == [(None, None)]


def test_another_type_takes_the_place_of_the_first_and_what_it_held_is_counted(bench: Bench) -> None:
    bench.publish(1.0)
    bench.publishing.held = 3
    text = (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),)
    assert bench.publish("x", fields=text)
    assert bench.publishing.told == [("/ua_1_2_1001", None), ("/ua_1_2_1001", "/ua_1_2_1001")]
    assert bench.drops() == [(Drop.INLET_FULL, 3, "/ua_1_2_1001: more messages than are held at its start")]
    assert bench.sent() == {"/ua_1_2_1001": [("x",)]}


def test_what_does_not_fit_or_fails_is_counted(bench: Bench) -> None:
    assert not bench.publish("unfit")
    assert bench.drops() == [(Drop.CONVERSION, 1, "/ua_1_2_1001: field data: it is no number")]


def test_there_are_only_so_many_topics_of_others(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlets_module, "MAX_MIRRORED", 1)
    assert bench.publish(1.0)
    bench.add_sink()
    assert not bench.publish(1.0, topic=Topic(1, 2, 9))
    assert bench.drops() == [(Drop.UNKNOWN_SOURCE, 1, "more than 1 topics of other spaces")]
    assert bench.publish(1.0, 2.0, topic=SPEED, fields=TWIST)  # its sink is not one of them


def test_a_sink_gets_the_fields_in_its_own_order_however_they_come(bench: Bench) -> None:
    bench.add_sink()
    assert bench.publish(1.0, 2.0, topic=SPEED, fields=SWAPPED)
    assert bench.sent()["/cmd"] == ["newer", (2.0, 1.0)]
    bench.publish(1.0, topic=SPEED, fields=TWIST[:1])
    assert bench.sent()["/cmd"] == ["newer", (2.0, 1.0)]
    assert bench.drops()[-1][0] is Drop.CONVERSION


def test_a_sink_whose_type_is_not_here_is_told_at_once_and_for_each_message(bench: Bench) -> None:
    bench.add_sink(type="nobody_msgs/Thing")
    assert [(cause, count) for cause, count, _ in bench.drops()] == [(Drop.TYPE_MISSING, 0)]
    assert "speed cannot be written to cmd" in bench.outlets.setpoint_problem(SPEED)
    assert not bench.publish(1.0, 2.0, topic=SPEED, fields=TWIST)
    bench.outlets.write_setpoint(SPEED, (1.0, 2.0))
    assert [(cause, count) for cause, count, _ in bench.drops()[1:]] == [(Drop.TYPE_MISSING, 1)] * 2


async def test_a_sink_with_a_rate_gets_the_latest() -> None:
    bench = Bench(asyncio.get_running_loop())
    bench.add_sink(max_rate_hz=20)
    for number in range(3):
        assert bench.publish(float(number), 0.0, topic=SPEED, fields=TWIST)
    assert bench.sent()["/cmd"] == ["newer", (0.0, 0.0)]
    await until(lambda: bench.sent()["/cmd"][-1] == (2.0, 0.0), "the turn of the latest")
    assert bench.drops() == [(Drop.RATE_LIMITED, 1, "")]


def test_setpoints_are_written_now_or_not_at_all(bench: Bench) -> None:
    bench.add_sink()
    (sink,) = bench.outlets
    assert bench.outlets.setpoint_problem(SPEED) == ""
    bench.outlets.write_setpoint(SPEED, (0.5, 0.0))
    sink.listeners, sink.is_open = 0, False
    assert bench.outlets.setpoint_problem(SPEED) == "/cmd has no subscriber in ROS"
    bench.outlets.write_setpoint(SPEED, (0.7, 0.0))
    assert sink.sent == [(0.5, 0.0)]
    assert bench.drops() == [(Drop.NOT_CONNECTED, 1, "")]


def test_what_the_bridge_before_has_published_is_kept_and_not_published_again(
    tmp_path: Path, loop: asyncio.AbstractEventLoop
) -> None:
    before = Delivered(tmp_path, "bridge")
    first = Bench(loop, before)
    first.publish(1.0)
    before.close()
    after = Delivered(tmp_path, "bridge")
    second = Bench(loop, after)
    assert not second.publish(1.0)
    assert second.drops() == [(Drop.REPEATED, 1, "")]
    assert second.sent() == {"/ua_1_2_1001": [("kept", 1.0)]}
    assert second.publish(2.0)
    assert second.sent() == {"/ua_1_2_1001": [("kept", 1.0), "newer", (2.0,)]}
    after.close()


class Noted(Delivered):
    def __init__(self) -> None:
        super().__init__(None)
        self.noted: list[int | None] = []

    def note(self, topic: Topic, timestamp: int | None) -> None:
        self.noted.append(timestamp)


def test_what_is_held_is_noted_as_delivered_when_it_is_published(loop: asyncio.AbstractEventLoop) -> None:
    delivered = Noted()
    bench = Bench(loop, delivered)
    bench.publish(1.0)
    (outlet,) = bench.outlets
    outlet.is_open = False
    bench.publish(2.0)
    assert delivered.noted == [1001]
    outlet.open()
    assert delivered.noted == [1001, 1002]
    bench.publish("unfit")
    assert delivered.noted == [1001, 1002], "nor is what cannot be published"


async def test_what_waits_for_its_turn_is_noted_as_delivered_when_that_comes() -> None:
    delivered = Noted()
    bench = Bench(asyncio.get_running_loop(), delivered)
    bench.add_sink(max_rate_hz=20)
    for number in range(3):
        bench.publish(float(number), 0.0, topic=SPEED, fields=TWIST)
    assert delivered.noted == [1001]
    await until(lambda: bench.sent()["/cmd"][-1] == (2.0, 0.0), "the turn of the latest")
    assert delivered.noted == [1001, 1003], "what a newer one has pushed out is not"
    for number in range(2):
        bench.publish(float(number), 0.0, topic=SPEED, fields=TWIST)
    bench.outlets.close()
    assert bench.timestamp not in delivered.noted, "the bridge after this one publishes it"


def test_what_fails_on_one_of_its_ways_is_delivered_by_the_others(loop: asyncio.AbstractEventLoop) -> None:
    delivered = Noted()
    bench = Bench(loop, delivered)
    bench.add_sink(type="nobody_msgs/Thing")
    bench.add_sink()
    bench.publish(1.0, 2.0, topic=SPEED, fields=TWIST)
    assert delivered.noted == [1001]
