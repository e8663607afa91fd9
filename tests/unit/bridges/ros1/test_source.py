# pyright: basic, reportMissingImports=false, reportCallIssue=false, reportAttributeAccessIssue=false
# (pyright finds the std_msgs of ROS 2)
from __future__ import annotations

import asyncio
import io
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header, String
from ua_bridges.ros.latched import is_latched
from ua_bridges.ros1.feed import MappedFeed, MirrorFeed
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.source import RosSource

from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost
from ua_fleet.config.schema import DataSetConfig, ScalarType, TopicMapping
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

TOPIC = Topic(1, 2, 7)
NAME = "/ua_1_2_7"


class Inlet:
    def __init__(self) -> None:
        self.events: list[DriverEvent] = []

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def take(self) -> list[DriverEvent]:
        events, self.events = self.events, []
        return events


class Socket:
    pass


class Link:
    """What the source sees of rospy's TCPROSTransport."""

    def __init__(self, message_class: Any, callerid: str = "/robot", *, latched: bool = False) -> None:
        self.header = {
            "callerid": callerid,
            "type": message_class._type,
            "md5sum": message_class._md5sum,
            "message_definition": message_class._full_text,
            "latching": "1" if latched else "0",
        }
        self.endpoint_id = "http://robot:1/"
        self.socket = Socket()


class Node:
    name = "/ua_bridge"

    def __init__(self) -> None:
        self.up: list[Link] = []
        self.watched: list[Socket] = []

    def links(self, _topic: str) -> list[Link]:
        return self.up

    def watch_link(self, link: Link) -> None:
        self.watched.append(link.socket)


class Raw:
    def __init__(self, link: Link, message: Any) -> None:
        buffer = io.BytesIO()
        message.serialize(buffer)
        self._buff = buffer.getvalue()
        self._connection_header = link.header


class Bench:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, feed: Any = None, folder: Path | None = None) -> None:
        monkeypatch.setattr("ua_bridges.ros1.source.rospy.Subscriber", lambda *_args, **_named: None)
        self.inlet, self.node, self.memory = Inlet(), Node(), LatchMemory(folder)
        self.source = RosSource(NAME, [feed or MirrorFeed(TOPIC, self.inlet)], self.node, self.inlet, self.memory)  # type: ignore[arg-type]

    def look(self, *links: Link) -> list[DriverEvent]:
        self.node.up = list(links)
        self.source.check(["/robot"], 0.0)
        return self.inlet.take()

    def hear(self, link: Link, message: Any) -> list[DriverEvent]:
        self.source._on_message(Raw(link, message))
        return self.inlet.take()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def kinds(events: list[DriverEvent]) -> list[str]:
    return [type(event).__name__ for event in events]


def test_link_alone_announces_the_source(bench: Bench) -> None:
    (found,) = bench.look(Link(Float64))
    assert isinstance(found, SourceFound)
    assert (found.topic, found.name, [field.name for field in found.fields]) == (TOPIC, "ua_1_2_7", ["data"])
    properties = {key.name: value for key, _, value in found.fields[0].properties}
    assert properties == {"RosType": "std_msgs/Float64", "RosDefinition": "float64 data\n"}


def test_message_before_the_first_look_announces_the_source_first(bench: Bench) -> None:
    link = Link(Float64)
    before = time.time_ns()
    found, sample = bench.hear(link, Float64(1.5))
    assert isinstance(found, SourceFound)
    assert isinstance(sample, SampleRead)
    assert (sample.topic, sample.values, sample.status, sample.own_publication) == (TOPIC, (1.5,), 0, False)
    assert before <= sample.source_time_ns <= time.time_ns()
    assert bench.look(link) == []
    assert kinds(bench.hear(link, Float64(2.5))) == ["SampleRead"]


def test_each_link_is_watched_once_whether_its_message_or_the_look_comes_first(bench: Bench) -> None:
    first, second = Link(Float64), Link(Float64, "/other")
    bench.hear(first, Float64(1.5))
    bench.look(first)
    bench.look(first, second)
    assert bench.node.watched == [first.socket, second.socket]
    first.socket = again = Socket()  # rospy makes a link that was lost anew
    bench.look(first, second)
    assert bench.node.watched[2:] == [again]


def test_header_at_the_top_level_gives_the_time(bench: Bench) -> None:
    now = int(time.time())
    link = Link(JointState)
    message = JointState(header=Header(frame_id="base"))
    message.header.stamp.secs, message.header.stamp.nsecs = now, 7
    _, sample = bench.hear(link, message)
    assert isinstance(sample, SampleRead)
    assert sample.source_time_ns == now * 1_000_000_000 + 7
    message.header.stamp.secs = 12  # time since a simulation began
    (sample,) = bench.hear(link, message)
    assert isinstance(sample, SampleRead)
    assert sample.source_time_ns >= now * 1_000_000_000


def test_source_is_lost_at_the_second_look_without_a_link_and_found_again(bench: Bench) -> None:
    link = Link(Float64)
    bench.look(link)
    assert bench.look() == []
    assert bench.look() == [SourceLost(TOPIC)]
    assert bench.look() == []
    again = Link(Float64)
    assert kinds(bench.look(again)) == ["SourceFound"]
    assert kinds(bench.hear(again, Float64(1.0))) == ["SampleRead"]


def test_second_publisher_keeps_the_source_alive(bench: Bench) -> None:
    first, second = Link(Float64, "/a"), Link(Float64, "/b")
    assert kinds(bench.look(first, second)) == ["SourceFound"]
    for _ in range(3):
        assert bench.look(second) == []


def test_publisher_of_another_type_is_a_conflict_until_the_first_has_gone(bench: Bench) -> None:
    first, second = Link(Float64, "/a"), Link(String, "/b")
    bench.look(first)
    assert bench.look(first, second) == []
    text = "/ua_1_2_7: publishers disagree about the type; std_msgs/String of /b is not read"
    assert bench.hear(second, String("x")) == [Dropped(Drop.CONFLICT, detail=text)]
    assert bench.look(second) == []
    assert bench.look(second) == [SourceLost(TOPIC)]
    assert kinds(bench.look(second)) == ["SourceFound"]
    assert kinds(bench.hear(second, String("x"))) == ["SampleRead"]


def test_robot_that_comes_back_with_another_type_is_announced_again(bench: Bench) -> None:
    bench.look(Link(Float64))
    changed = Link(String)
    (found,) = bench.look(changed)
    assert isinstance(found, SourceFound)
    assert found.fields[0].builtin_type == BuiltinType.STRING


def test_own_publisher_does_not_make_the_source_alive_and_its_messages_are_marked(bench: Bench) -> None:
    own = Link(Float64, "/ua_bridge")
    assert bench.look(own) == []
    (sample,) = bench.hear(own, Float64(1.0))
    assert isinstance(sample, SampleRead)
    assert sample.own_publication


def test_latched_source_says_so(bench: Bench) -> None:
    (found,) = bench.look(Link(Float64, latched=True))
    assert isinstance(found, SourceFound)
    assert is_latched(found.fields)


def test_type_without_a_class_is_counted_for_each_message(bench: Bench) -> None:
    link = Link(Float64)
    link.header |= {"type": "acme_msgs/Evil", "md5sum": "0" * 32, "message_definition": "int8 X;Y=1"}
    assert bench.look(link) == []
    text = "/ua_1_2_7: 'int8 X;Y=1' is neither a field nor a constant"
    assert bench.hear(link, Float64(1.0)) == [Dropped(Drop.TYPE_MISSING, detail=text)]


def test_bytes_that_are_no_message_are_counted_and_told_once(bench: Bench) -> None:
    link = Link(Float64)
    bench.look(link)
    raw = Raw(link, Float64(1.0))
    raw._buff = raw._buff[:3]
    details = []
    for _ in range(2):
        bench.source._on_message(raw)
        (dropped,) = bench.inlet.take()
        assert isinstance(dropped, Dropped)
        assert dropped.cause == Drop.CONVERSION
        details.append(bool(dropped.detail))
    assert details == [True, False]


async def test_mapped_topic_with_a_bad_field(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    dataset = DataSetConfig(id=9, type=ScalarType.INT32, source=TopicMapping(topic="/charge", type="std_msgs/Float64"))
    feed = MappedFeed(Topic(1, 2, 9), dataset, "Charge", bench.inlet, asyncio.get_running_loop())
    bench.source._feeds = [feed]
    link = Link(Float64)
    (found,) = bench.look(link)
    assert isinstance(found, SourceFound)
    assert (found.name, [(field.name, field.builtin_type) for field in found.fields]) == (
        "/charge",
        [("Charge", BuiltinType.INT32)],
    )
    (sample,) = bench.hear(link, Float64(41.6))
    assert isinstance(sample, SampleRead)
    assert sample.values == (42,)
    dropped, sample = bench.hear(link, Float64(float("nan")))
    assert isinstance(sample, SampleRead)
    assert sample.values == (Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_OUT_OF_RANGE),)
    assert dropped == Dropped(Drop.CONVERSION, 1, "/charge field Charge: nan does not fit into Int32")


async def test_rate_limit_of_a_mapped_topic_delivers_the_last_before_the_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    mapping = TopicMapping(topic="/charge", type="std_msgs/Float64", max_rate_hz=0.01)
    dataset = DataSetConfig(id=9, type=ScalarType.DOUBLE, source=mapping)
    bench.source._feeds = [MappedFeed(Topic(1, 2, 9), dataset, "Charge", bench.inlet, asyncio.get_running_loop())]
    link = Link(Float64)
    for number in range(4):
        bench.hear(link, Float64(number))
    bench.look(link)
    bench.look()
    bench.look()
    await asyncio.sleep(0)
    events = bench.inlet.take()
    assert kinds(events) == ["SourceFound", "SampleRead", "Dropped", "Dropped", "SampleRead", "SourceLost"]
    samples = [event.values for event in events if isinstance(event, SampleRead)]
    assert samples == [(0.0,), (3.0,)]


def restarted(bench: Bench, monkeypatch: pytest.MonkeyPatch, folder: Path) -> Bench:
    bench.memory.close()
    return Bench(monkeypatch, folder=folder)


def time_of(events: list[DriverEvent]) -> int:
    sample = events[-1]
    assert isinstance(sample, SampleRead)
    return sample.source_time_ns


def test_latched_message_that_the_bridge_before_had_heard_keeps_its_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first = Bench(monkeypatch, folder=tmp_path)
    link = Link(Float64, latched=True)
    first.hear(link, Float64(1.0))
    heard_ns = time_of(first.hear(link, Float64(2.0)))
    second = restarted(first, monkeypatch, tmp_path)
    assert time_of(second.hear(Link(Float64, latched=True), Float64(2.0))) == heard_ns
    assert time_of(second.hear(link, Float64(2.0))) > heard_ns
    third = restarted(second, monkeypatch, tmp_path)
    assert time_of(third.hear(Link(Float64, latched=True), Float64(3.0))) > heard_ns
    third.memory.close()


def test_latched_message_of_a_robot_that_was_restarted_too_is_news(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first = Bench(monkeypatch, folder=tmp_path)
    link = Link(Float64, latched=True)
    first.look(link)
    heard_ns = time_of(first.hear(link, Float64(2.0)))
    second = restarted(first, monkeypatch, tmp_path)
    again = Link(Float64, latched=True)
    again.endpoint_id = "http://robot:2/"
    second.look(again)
    assert time_of(second.hear(again, Float64(2.0))) > heard_ns
    second.memory.close()


def test_latched_message_of_a_source_that_was_lost_is_news(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first = Bench(monkeypatch, folder=tmp_path)
    heard_ns = time_of(first.hear(Link(Float64, latched=True), Float64(2.0)))
    for _ in range(2):
        first.look()
    second = restarted(first, monkeypatch, tmp_path)
    assert time_of(second.hear(Link(Float64, latched=True), Float64(2.0))) > heard_ns
    second.memory.close()


def test_message_that_is_not_latched_is_always_news(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first = Bench(monkeypatch, folder=tmp_path)
    heard_ns = time_of(first.hear(Link(Float64), Float64(2.0)))
    second = restarted(first, monkeypatch, tmp_path)
    assert time_of(second.hear(Link(Float64), Float64(2.0))) > heard_ns
    second.memory.close()
