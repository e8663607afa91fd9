from __future__ import annotations

import asyncio
from typing import Any

import pytest
from ua_bridges.ros.feed import Mapped, MappedFeed, MirrorFeed
from ua_bridges.ros.topic_mapping import QosConfig, TopicMapping
from ua_bridges.ros2.arrivals import Arrivals
from ua_bridges.ros2.qos import QUEUE_DEPTH, Qos
from ua_bridges.ros2.source import GONE_S, RosSource

from tests.unit.bridges.ros2.fakes import FakeNode, Recorder, fake_type, publisher
from tests.waiting import until
from ua_fleet.bridge.driver import SampleRead, SourceFound
from ua_fleet.config.schema import DataSetConfig, ScalarType
from ua_fleet.errors import UaFleetError
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

TOPIC = Topic(5, 2, 1001)
T0 = 1_700_000_000_000_000_000


class NotInstalled(UaFleetError):
    """Stands for TypeMissing."""


@pytest.fixture(autouse=True)
def types(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(ros_type: str) -> Any:
        try:
            return known[ros_type.replace("/msg/", "/")]
        except KeyError:
            raise NotInstalled(f"{ros_type} is not installed") from None

    known = {name: fake_type(name) for name in ("std_msgs/Int32", "std_msgs/Float64", "my_msgs/Stamped")}
    monkeypatch.setattr("ua_bridges.ros2.source.load_type", load)


class Scene:
    def __init__(self, **options: Any) -> None:
        self.node, self.inlet, self.looks, self.now = FakeNode(), Recorder(), 0, 100.0
        feeds = options.pop("feeds", None)
        self.source = RosSource(
            f"/{TOPIC.name}",
            feeds(self.inlet) if feeds else [MirrorFeed(TOPIC, self.inlet)],
            self.node.as_node(),
            self.inlet,
            self._look,
            clock=lambda: self.now,
            **options,
        )

    def _look(self) -> None:
        self.looks += 1


def test_source_is_found_before_its_samples_and_lost_after_them() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.node.say(1, T0)
    scene.node.say(2, T0 + 1)
    scene.source.follow([])
    assert scene.inlet.said() == ["found", "1", "2", "lost"]
    assert scene.node.subscriptions == [("/ua_5_2_1001", Qos(True, False, QUEUE_DEPTH))]
    found = scene.inlet.events[0]
    assert isinstance(found, SourceFound)
    assert [str(key.name) for key, _, _ in found.fields[0].properties] == ["RosType"]


def test_latched_source_says_so() -> None:
    scene = Scene()
    scene.source.follow([publisher(transient_local=True)])
    found = scene.inlet.events[0]
    assert isinstance(found, SourceFound)
    assert [str(key.name) for key, _, _ in found.fields[0].properties] == ["RosType", "RosLatched"]


def test_history_that_comes_again_is_not_handed_on_again() -> None:
    scene = Scene()
    scene.source.follow([publisher(transient_local=True)])
    scene.node.say(1, T0)
    scene.source.follow([publisher(transient_local=True), publisher(b"b")])
    assert scene.node.destroyed == 1
    scene.node.say(1, T0)
    scene.node.say(2, T0 + 1)
    assert scene.inlet.said() == ["found", "1", "2"]


def test_history_of_a_source_that_was_lost_makes_it_good_again() -> None:
    scene = Scene()
    scene.source.follow([publisher(transient_local=True)])
    scene.node.say(1, T0)
    scene.source.follow([])
    scene.source.follow([publisher(transient_local=True)])
    scene.node.say(1, T0)
    assert scene.inlet.said() == ["found", "1", "lost", "found", "1"]


def test_subscription_is_kept_while_nobody_publishes() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([])
    assert scene.node.destroyed == 0
    scene.source.follow([publisher(b"b")])
    assert len(scene.node.subscriptions) == 1
    assert scene.inlet.said() == ["found", "lost", "found"]


def test_message_of_a_publisher_that_is_not_seen_yet_waits_for_the_look() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([])
    scene.node.say(7, T0)
    assert scene.looks == 1
    assert scene.inlet.said() == ["found", "lost"]
    scene.source.follow([publisher(b"b")])
    scene.source.looked()
    scene.node.say(8, T0 + 1)
    assert scene.inlet.said() == ["found", "lost", "found", "7", "8"]


def test_message_of_a_publisher_that_has_gone_again_is_handed_on() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([])
    scene.node.say(7, T0)
    scene.source.looked()
    assert scene.inlet.said() == ["found", "lost"]
    scene.now += GONE_S
    scene.source.looked()
    assert scene.inlet.said() == ["found", "lost", "found", "7", "lost"]


def test_messages_of_a_publisher_that_no_look_finds_do_not_lose_and_find_the_source_each_time() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([])
    for number in range(100):
        scene.now += 0.01
        scene.node.say(number, T0 + number)
        scene.source.looked()
    assert scene.inlet.said() == ["found", "lost"]
    assert scene.looks == 1
    scene.source.follow([publisher(b"b")])
    scene.source.looked()
    assert scene.inlet.said() == ["found", "lost", "found", *map(str, range(100))]


def test_time_is_the_headers_where_it_is_plausible() -> None:
    scene = Scene()
    scene.source.follow([publisher(kind="my_msgs/msg/Stamped")])
    scene.node.say(0, T0, stamp=(1_699_999_999, 5))
    scene.node.say(0, T0 + 1, stamp=(12, 5))
    times = [event.source_time_ns for event in scene.inlet.events if isinstance(event, SampleRead)]
    assert times == [1_699_999_999_000_000_005, T0 + 1]


def test_type_that_is_not_installed_is_counted_once() -> None:
    scene = Scene()
    for gid in (b"a", b"b"):
        scene.source.follow([publisher(gid, kind="nobody_msgs/msg/Thing")])
    assert scene.inlet.said() == ["type_missing:1"]
    assert scene.node.subscriptions == []


def test_publishers_that_disagree_are_a_conflict_and_the_first_type_stays() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([publisher(b"0", kind="std_msgs/msg/Float64"), publisher()])
    scene.node.say(1, T0)
    assert scene.inlet.said() == ["found", "conflict:1", "1"]


def test_publisher_with_another_type_is_announced_anew() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.source.follow([publisher(b"b", kind="std_msgs/msg/Float64")])
    scene.node.say(1.5, T0)
    assert scene.inlet.said() == ["found", "found", "1.5"]
    assert len(scene.node.subscriptions) == 2


def test_message_that_cannot_be_converted_is_counted_and_ends_nothing() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.node.callback((b"\0\1\0\0\1", {"source_timestamp": T0, "received_timestamp": T0}))
    scene.node.callback((b"\0\1\0\0\1\0\0\0", {}))
    scene.node.say(1, T0 + 1)
    assert scene.inlet.said() == ["found", "conversion:1", "conversion:1", "1"]


def test_incompatible_publisher_makes_a_look_unless_fleet_yaml_asks_for_it() -> None:
    scene = Scene()
    scene.source.follow([publisher()])
    scene.node.tell_incompatible("durability")
    assert (scene.looks, scene.inlet.said()) == (1, ["found"])
    scene.node.tell_incompatible("deadline")
    assert scene.inlet.said() == ["found", "incompatible_qos:1"]
    scene = Scene(qos=QosConfig(reliability="reliable"))
    scene.source.follow([publisher(reliable=False)])
    assert scene.node.subscriptions[0][1] == Qos(True, False, 10)
    scene.node.tell_incompatible("reliability")
    assert scene.inlet.said() == ["found", "incompatible_qos:1"]


def mapped_scene(**options: Any) -> Scene:
    source = TopicMapping(topic="/count", type="std_msgs/Int32", **options)
    data = Mapped("robot", "Count", TOPIC, DataSetConfig(type=ScalarType.BYTE, source=source), source)

    def feeds(inlet: Recorder) -> list[MappedFeed]:
        return [MappedFeed(data, inlet, asyncio.get_running_loop())]

    return Scene(feeds=feeds, wanted_type="std_msgs/Int32", qos=source.qos)


async def test_mapped_field_that_does_not_fit_is_bad() -> None:
    scene = mapped_scene()
    scene.source.follow([publisher()])
    scene.node.say(5, T0)
    scene.node.say(300, T0 + 1)
    bad = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_OUT_OF_RANGE)
    assert scene.inlet.said() == ["found", "5", "conversion:1", str(bad)]


async def test_mapped_topic_with_another_type_is_bad_once_until_the_right_one_comes() -> None:
    scene = mapped_scene()
    wrong = publisher(b"b", kind="std_msgs/msg/Float64")
    scene.source.follow([wrong])
    scene.source.follow([wrong, publisher(b"c", kind="std_msgs/msg/Float64")])
    bad = str(Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH))
    assert scene.inlet.said() == ["found", "conversion:1", bad]
    scene.source.follow([publisher(), wrong])
    scene.node.say(5, T0)
    assert scene.inlet.said()[-2:] == ["found", "5"]


async def test_rate_limit_hands_on_the_latest_when_its_turn_comes() -> None:
    scene = mapped_scene(max_rate_hz=10)
    scene.source.follow([publisher()])
    for number in range(3):
        scene.node.say(number, T0 + number)
    assert scene.inlet.said() == ["found", "0", "rate_limited:1"]
    await until(lambda: scene.inlet.said()[-1] == "2", "the turn of the latest")


async def test_rate_limit_hands_on_what_waits_when_the_source_goes() -> None:
    scene = mapped_scene(max_rate_hz=0.01)
    scene.source.follow([publisher()])
    for number in range(3):
        scene.node.say(number, T0 + number)
    scene.source.follow([])
    assert scene.inlet.said() == ["found", "0", "rate_limited:1", "2", "lost"]


class LateScene(Scene):
    """A source whose messages have waited in the subscription; the clock is the test's."""

    def __init__(self, max_ages: dict[Topic, float] | None = None) -> None:
        super().__init__()
        self.now_ns = T0
        arrivals = Arrivals(self.inlet, 2.0, lambda: self.now_ns, max_ages)
        self.source = RosSource(
            f"/{TOPIC.name}", [MirrorFeed(TOPIC, arrivals)], self.node.as_node(), arrivals, self._look
        )
        self.source.follow([publisher()])

    def say(self, value: int, received_s: float) -> None:
        self.node.say(value, T0 + value, int(T0 + received_s * 1e9))


def test_sample_tells_how_long_it_has_waited_in_the_subscription() -> None:
    scene = LateScene()
    scene.now_ns += 1_500_000_000
    scene.say(1, 0.0)
    scene.say(2, 1.4999)
    waited = [event.waited_s for event in scene.inlet.events if isinstance(event, SampleRead)]
    assert waited == [1.5, 0.0]


def test_message_that_has_waited_too_long_goes_where_a_newer_one_comes() -> None:
    scene = LateScene()
    scene.now_ns += 10_000_000_000
    for value in range(5):
        scene.say(value, 1.0 + value / 10)
    scene.say(5, 9.9)
    assert scene.inlet.said() == ["found", *["too_old:1"] * 5, "5"]
    scene.source.looked()
    assert scene.inlet.said()[-1] == "5"


def test_the_last_message_comes_through_however_old_it_is() -> None:
    scene = LateScene()
    scene.now_ns += 10_000_000_000
    scene.say(1, 0.0)
    scene.say(2, 0.0)
    assert scene.inlet.said() == ["found", "too_old:1"]
    assert scene.source.is_waiting
    scene.source.looked()
    assert scene.inlet.said() == ["found", "too_old:1", "2"]
    assert not scene.source.is_waiting


def test_a_source_s_own_maximum_age_counts_where_it_is_shorter() -> None:
    scene = LateScene({TOPIC: 0.5})
    scene.now_ns += 1_000_000_000
    scene.say(1, 0.4)
    scene.say(2, 0.6)
    assert scene.inlet.said() == ["found", "too_old:1", "2"]
    longer = LateScene({TOPIC: 60.0})
    longer.now_ns += 3_000_000_000
    longer.say(1, 0.9)
    longer.say(2, 1.1)
    assert longer.inlet.said() == ["found", "too_old:1", "2"]
