"""Topics `ua_<space>_<ns>_<id>` between real rclpy nodes and PubSub."""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import time

import pytest

from tests.integration.peer import Peer
from tests.integration.ros2.conftest import STATUS_ID, Ros2Space, heard
from tests.waiting import until
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns

pytestmark = pytest.mark.needs("ros2")

OLD = StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE

JOINT_STATE = {
    "header": {"stamp": "STAMP", "frame_id": "base"},
    "name": ["a", "b"],
    "position": [1.5, -2.5],
    "velocity": [0.5],
    "effort": [],
}


def source(ros2: Ros2Space, id: int = 1001) -> Topic:
    return Topic(ros2.domain, 2, id)


async def test_any_message_type_comes_out_as_flat_fields_with_the_robots_time(ros2: Ros2Space) -> None:
    ros2.bridge()
    async with Peer.at(ros2.udp_url) as peer:
        before = ticks_from_unix_ns(time.time_ns())
        ros2.talker(source(ros2).name, "sensor_msgs/JointState", JOINT_STATE)
        await peer.until(lambda: peer.good(source(ros2)))
        message = peer.messages(source(ros2))[0]
        assert message.timestamp is not None
        stamp, values = message.values[:2], message.values[2:]
        assert values == ("base", ("a", "b"), (1.5, -2.5), (0.5,), ())
        assert message.timestamp == ticks_from_unix_ns(stamp[0] * 10**9 + stamp[1])
        assert message.timestamp >= before
        assert peer.properties(source(ros2)) == {"RosType": "sensor_msgs/JointState"}


async def test_other_spaces_message_goes_in_whatever_its_type(ros2: Ros2Space) -> None:
    ros2.bridge()
    topic = Topic(1, 2, 1005)
    listener = ros2.listener(topic.name, "sensor_msgs/JointState")
    async with Peer.at(ros2.udp_url, space=1) as peer:
        names = (
            "header.stamp.sec",
            "header.stamp.nanosec",
            "header.frame_id",
            "name",
            "position",
            "velocity",
            "effort",
        )
        kinds = (BuiltinType.INT32, BuiltinType.UINT32, BuiltinType.STRING, BuiltinType.STRING) + (
            BuiltinType.DOUBLE,
        ) * 3
        properties = {"RosType": "sensor_msgs/JointState"}
        fields = tuple(
            make_field(name, kind, array=index > 2, properties={} if index else properties)
            for index, (name, kind) in enumerate(zip(names, kinds, strict=True))
        )
        peer.announce(topic, fields)
        peer.publish(topic, 5, 7, "base", ("a",), (1.25,), (), ())
        await peer.until(lambda: heard(listener))
        assert "sec=5, nanosec=7" in heard(listener)[0]
        assert "frame_id='base'" in heard(listener)[0]
        assert "position=[1.25]" in heard(listener)[0]


@pytest.mark.parametrize(
    ("builtin", "kind", "value", "text"),
    [
        (BuiltinType.DOUBLE, "std_msgs/Float64", 2.5, "data=2.5"),
        (BuiltinType.BOOLEAN, "std_msgs/Bool", True, "data=True"),
        (BuiltinType.STRING, "std_msgs/String", "go", "data='go'"),
    ],
)
async def test_servers_values_have_std_msgs_types(
    ros2: Ros2Space, builtin: BuiltinType, kind: str, value: object, text: str
) -> None:
    ros2.bridge()
    listener = ros2.listener("ua_0_2_7", kind)
    async with Peer.at(ros2.udp_url) as peer:
        peer.announce(Topic(0, 2, 7), (make_field("Speed", builtin),))
        peer.publish(Topic(0, 2, 7), value)
        await peer.until(lambda: heard(listener))
    assert text in heard(listener)[0]


QOS = list(itertools.product(("--best-effort", ""), ("--transient-local", "")))


@pytest.mark.parametrize(("reliability", "durability"), QOS)
async def test_publisher_of_any_quality_is_heard(ros2: Ros2Space, reliability: str, durability: str) -> None:
    ros2.bridge()
    options = [option for option in (reliability, durability) if option]
    ros2.talker(source(ros2).name, "std_msgs/Int32", {"data": "COUNT"}, *options, "--count", 5, "--wait")
    async with Peer.at(ros2.udp_url) as peer:
        await peer.until(lambda: peer.good(source(ros2))[-1:] == [(4,)])
        assert peer.properties(source(ros2)).get("RosLatched", False) is bool(durability)
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.incompatible_qos"] == 0


@pytest.mark.parametrize(("reliability", "durability"), QOS)
async def test_subscriber_of_any_quality_hears_the_first_message(
    ros2: Ros2Space, reliability: str, durability: str
) -> None:
    ros2.bridge()
    options = [option for option in (reliability, durability) if option]
    listener = ros2.listener("ua_1_2_9", "std_msgs/Int32", *options)
    async with Peer.at(ros2.udp_url, space=1) as peer:
        peer.announce(
            Topic(1, 2, 9), (make_field("data", BuiltinType.INT32, properties={"RosType": "std_msgs/Int32"}),)
        )
        for number in range(3):
            peer.publish(Topic(1, 2, 9), number)
        await peer.until(lambda: len(heard(listener)) >= 3)
        assert [line[-2] for line in heard(listener)] == ["0", "1", "2"]


async def test_late_subscriber_gets_the_current_value_and_only_that(ros2: Ros2Space) -> None:
    ros2.bridge()
    early = ros2.listener("ua_1_2_9", "std_msgs/Int32")
    async with Peer.at(ros2.udp_url, space=1) as peer:
        peer.announce(
            Topic(1, 2, 9), (make_field("data", BuiltinType.INT32, properties={"RosType": "std_msgs/Int32"}),)
        )
        for number in range(3):
            peer.publish(Topic(1, 2, 9), number)
        await peer.until(lambda: len(heard(early)) == 3)
        late = ros2.listener("ua_1_2_9", "std_msgs/Int32", "--transient-local")
        volatile = ros2.listener("ua_1_2_9", "std_msgs/Int32")
        await peer.until(lambda: heard(late) and "publishers 1" in volatile.lines)
        peer.publish(Topic(1, 2, 9), 3)
        await peer.until(lambda: len(heard(volatile)) == 1 and len(heard(late)) == 2 and len(heard(early)) == 4)
        assert [line[-2] for line in heard(late)] == ["2", "3"]


async def test_value_published_before_the_bridge_came_is_heard_where_it_is_latched(ros2: Ros2Space) -> None:
    talker = ros2.talker(source(ros2).name, "std_msgs/String", {"data": "x"}, "--transient-local", "--count", 1)
    talker.wait_for("published")
    time.sleep(0.2)
    ros2.bridge()
    async with Peer.at(ros2.udp_url) as peer:
        await peer.until(lambda: peer.good(source(ros2)) == [("x",)])


async def test_subscription_follows_a_publisher_that_offers_less(ros2: Ros2Space) -> None:
    ros2.bridge()
    topic = source(ros2)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker(topic.name, "std_msgs/String", {"data": "latched"}, "--transient-local", "--count", 1)
        await peer.until(lambda: peer.good(topic) == [("latched",)])
        ros2.talker(topic.name, "std_msgs/String", {"data": "loose"}, "--best-effort", "--name", "other")
        await peer.until(lambda: ("loose",) in peer.good(topic))
        assert peer.good(topic).count(("latched",)) == 1


async def test_killed_publisher_is_missed_and_comes_back(ros2: Ros2Space) -> None:
    bridge = ros2.bridge()
    topic = source(ros2)
    async with Peer.at(ros2.udp_url) as peer:
        talker = ros2.talker(topic.name, "std_msgs/Int32", {"data": "COUNT"})
        await peer.until(lambda: peer.good(topic))
        killed_at = time.monotonic()
        talker.end(signal.SIGKILL)
        await peer.until(lambda: peer.messages(topic)[-1].status == StatusCode.BAD_NO_COMMUNICATION, 8)
        assert time.monotonic() - killed_at < 6
        await peer.until(lambda: peer.is_silent(topic), 8)
        seen = len(peer.good(topic))
        ros2.talker(topic.name, "std_msgs/Int32", {"data": "COUNT"}, "--wait")
        await peer.until(lambda: len(peer.good(topic)) > seen + 3)
        assert not peer.is_silent(topic)
        assert peer.good(topic)[seen] == (0,)
    assert sum("not connected" in line for line in bridge.lines) == 0


async def test_source_that_came_with_a_period_and_lives_but_says_nothing_is_old_after_ten_of_them(
    ros2: Ros2Space,
) -> None:
    ros2.bridge()
    topic, latched = source(ros2), source(ros2, 1002)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker(topic.name, "std_msgs/Int32", {"data": "COUNT"}, "--wait", "--count", 100)
        ros2.talker(
            latched.name, "std_msgs/Int32", {"data": "COUNT"}, "--count", 60, "--transient-local", "--name", "latched"
        )
        await peer.until(lambda: (99,) in peer.good(topic) and (59,) in peer.good(latched))
        await peer.until(lambda: peer.messages(topic)[-1].status == OLD)
        assert peer.messages(topic)[-1].values == (99,)
        assert not peer.is_silent(topic), "its publisher is there"
        assert not peer.messages(latched)[-1].status, "who is latched says what holds until it says something else"


async def test_source_that_a_restarted_bridge_never_heard_is_not_attested(ros2: Ros2Space) -> None:
    bridge = ros2.bridge()
    topic = source(ros2)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker(topic.name, "std_msgs/Int32", {"data": 5}, "--wait", "--count", 1)
        await peer.until(lambda: peer.good(topic))
        bridge.end(signal.SIGKILL)
        ros2.bridge()
        await peer.until(lambda: peer.is_stale(topic))
        seen = len(peer.events)
        await asyncio.sleep(4.0)  # keep-alives come, and attest nothing
        assert len(peer.events) > seen
        assert peer.is_stale(topic)
        assert peer.good(topic) == [(5,)]


async def test_publisher_that_leaves_properly_is_missed_at_once(ros2: Ros2Space) -> None:
    ros2.bridge()
    topic = source(ros2)
    async with Peer.at(ros2.udp_url) as peer:
        talker = ros2.talker(topic.name, "std_msgs/Int32", {"data": "COUNT"})
        await peer.until(lambda: peer.good(topic))
        talker.end(signal.SIGINT)
        await peer.until(lambda: peer.messages(topic)[-1].status == StatusCode.BAD_NO_COMMUNICATION, 2)


async def test_type_that_is_not_installed_is_counted_and_told_once(ros2: Ros2Space) -> None:
    bridge = ros2.bridge()
    async with Peer.at(ros2.udp_url, space=1) as peer:
        topic = Topic(1, 2, 9)
        peer.announce(topic, (make_field("data", BuiltinType.INT32, properties={"RosType": "nobody_msgs/Thing"}),))
        peer.publish(topic, 1)
        peer.publish(topic, 2)
        await peer.until(lambda: any("nobody_msgs/msg/Thing is not installed" in line for line in bridge.lines))
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.type_missing"] == 2
        assert status["ToSpace"] == 0
    assert sum("nobody_msgs" in line for line in bridge.lines) == 1


async def test_illegal_names_are_counted_and_told_once(ros2: Ros2Space) -> None:
    bridge = ros2.bridge()
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker("ua_7_02_1", "std_msgs/Int32", {"data": 1})
        ros2.talker("ua_arm", "std_msgs/Int32", {"data": 1}, "--name", "other")
        await peer.until(lambda: sum("illegal_topic" in line for line in bridge.lines) == 2)
        ros2.talker(source(ros2).name, "std_msgs/Int32", {"data": 1}, "--name", "legal")
        await peer.until(lambda: peer.good(source(ros2)))
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.illegal_topic"] == 2


async def test_stock_node_without_any_profile_takes_part(ros2: Ros2Space) -> None:
    ros2.bridge()
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker(source(ros2).name, "std_msgs/Int32", {"data": "COUNT"}, quick=False)
        await peer.until(lambda: peer.good(source(ros2)))


async def test_slow_subscriber_holds_up_nobody(ros2: Ros2Space) -> None:
    bridge = ros2.bridge()
    topic, count = Topic(1, 2, 9), 400
    stuck = ros2.listener(topic.name, "std_msgs/String", "--name", "stuck")
    quick = ros2.listener(topic.name, "std_msgs/String", "--name", "quick")
    async with Peer.at(ros2.udp_url, space=1) as peer:
        peer.announce(topic, (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),))
        peer.publish(topic, "first")
        await peer.until(lambda: heard(stuck) and heard(quick))
        os.killpg(stuck.process.pid, signal.SIGSTOP)
        try:
            for number in range(count):
                peer.publish(topic, f"{number} " + "x" * 10_000)
                # A mirrored topic has a depth of 1: what a busy machine does not take in time is not sent again.
                await until(lambda: len(heard(quick)) > number - 5, f"message {number - 5}")  # noqa: B023 - awaited
            await until(lambda: len(heard(quick)) == count + 1, "the last message")
            async with asyncio.timeout(60):  # what it has counted is told at intervals
                while (await peer.status(Topic(ros2.domain, 2, STATUS_ID)))["ToSpace"] != count + 1:
                    pass
            started = time.monotonic()
            assert bridge.end() == 0
            assert time.monotonic() - started < 2
        finally:
            os.killpg(stuck.process.pid, signal.SIGCONT)
