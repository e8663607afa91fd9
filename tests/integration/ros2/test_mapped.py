"""A robot's own topics, mapped in fleet.yaml, with stock rclpy nodes."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from tests.integration.peer import Peer
from tests.integration.ros2.conftest import STATUS_ID, Ros2Space, heard
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire.messages import DataSetMessage

pytestmark = pytest.mark.needs("ros2")

SPEED = Topic(0, 2, 2002)


def robot(**data: Any) -> dict[str, Any]:
    return {"turtle": {"bridge": "mobile", "data": data}}


def battery(**source: Any) -> dict[str, Any]:
    mapping = {"topic": "/battery_state", "type": "sensor_msgs/msg/BatteryState"} | source
    return robot(
        battery={
            "id": 2001,
            "fields": {
                "Percent": {"type": "Int32", "path": "percentage"},
                "Volt": {"type": "Float", "path": "voltage"},
                "FirstCell": {"type": "Double", "path": "cell_voltage[0]"},
            },
            "source": mapping,
        }
    )


def sink(**mapping: Any) -> dict[str, Any]:
    topic = {"topic": "cmd_vel", "type": "geometry_msgs/Twist"} | mapping
    return robot(speed={"id": 2002, "origin": "server", "type": "Double", "path": "linear.x", "sink": topic})


def announce_speed(peer: Peer) -> None:
    peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))


async def test_fields_are_picked_out_of_a_robots_message(ros2: Ros2Space) -> None:
    ros2.bridge(battery())
    topic = Topic(ros2.domain, 2, 2001)
    async with Peer.at(ros2.udp_url) as peer:
        values = {"percentage": 80.0, "voltage": 12.5, "cell_voltage": [4.0]}
        ros2.talker("/battery_state", "sensor_msgs/BatteryState", values)
        await peer.until(lambda: peer.good(topic))
        assert peer.good(topic)[0] == (80, 12.5, 4.0)


async def test_value_that_does_not_fit_makes_its_field_bad_and_leaves_the_others(ros2: Ros2Space) -> None:
    bridge = ros2.bridge(battery())
    topic = Topic(ros2.domain, 2, 2001)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker("/battery_state", "sensor_msgs/BatteryState", {"percentage": math.nan, "voltage": 12.5})
        await peer.until(lambda: len(peer.good(topic)) >= 3)
        message = peer.messages(topic)[0]
        out_of_range = int(StatusCode.BAD_OUT_OF_RANGE)
        assert message.values == (out_of_range, 12.5, out_of_range)
        assert message.types == (BuiltinType.STATUS_CODE, BuiltinType.FLOAT, BuiltinType.STATUS_CODE)
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.conversion"] >= 6
    await asyncio.to_thread(bridge.wait_for, "field Percent: nan does not fit into Int32")
    assert sum("field Percent: nan does not fit into Int32" in line for line in bridge.lines) == 1


async def test_topic_with_another_type_makes_all_fields_bad(ros2: Ros2Space) -> None:
    bridge = ros2.bridge(battery())
    topic = Topic(ros2.domain, 2, 2001)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker("/battery_state", "std_msgs/Float32", {"data": 80.0})
        await peer.until(lambda: peer.messages(topic))
        assert set(peer.messages(topic)[0].values) == {int(StatusCode.BAD_TYPE_MISMATCH)}
        await asyncio.to_thread(bridge.wait_for, "the topic carries std_msgs/Float32")


def arrivals(peer: Peer, topic: Topic) -> list[DataSetMessage]:
    return [message for message in peer.messages(topic) if not message.status]


async def test_rate_limit_of_a_source_lets_the_latest_win_and_the_last_arrive(ros2: Ros2Space) -> None:
    ros2.bridge(
        robot(
            count={
                "id": 2001,
                "type": "Int32",
                "source": {"topic": "count", "type": "std_msgs/Int32", "max_rate_hz": 5},
            }
        )
    )
    topic = Topic(ros2.domain, 2, 2001)
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker("count", "std_msgs/Int32", {"data": "COUNT"}, "--rate", 100, "--count", 150, "--wait")
        await peer.until(lambda: peer.good(topic)[-1:] == [(149,)])
        numbers = [values[0] for values in peer.good(topic)]
        assert numbers[0] == 0
        assert numbers == sorted(set(numbers))
        assert 6 <= len(numbers) <= 13  # 1.5 s at 5 Hz, more time on a busy machine
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.rate_limited"] == 150 - len(numbers)


async def test_servers_value_is_written_into_a_robots_topic(ros2: Ros2Space) -> None:
    ros2.bridge(sink())
    listener = ros2.listener("/cmd_vel", "geometry_msgs/Twist")
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        for speed in (0.5, 0.0):
            peer.publish(SPEED, speed)
        await peer.until(lambda: len(heard(listener)) == 2)
        assert "linear=geometry_msgs.msg.Vector3(x=0.5, y=0.0, z=0.0)" in heard(listener)[0]
        assert "linear=geometry_msgs.msg.Vector3(x=0.0" in heard(listener)[1]


async def test_rate_limit_of_a_sink_lets_the_latest_win_and_the_last_arrive(ros2: Ros2Space) -> None:
    ros2.bridge(sink(max_rate_hz=5))
    listener = ros2.listener("/cmd_vel", "geometry_msgs/Twist")
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        for number in range(101):
            peer.publish(SPEED, number / 100)
            await asyncio.sleep(0.01)
        await peer.until(lambda: heard(listener) and "x=1.0" in heard(listener)[-1])
        assert 5 <= len(heard(listener)) <= 12
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.rate_limited"] == 101 - len(heard(listener))
        assert status["Drops.type_missing"] == 0


async def test_sinks_quality_of_service_is_that_of_fleet_yaml(ros2: Ros2Space) -> None:
    bridge = ros2.bridge(sink(qos={"durability": "transient_local", "depth": 1}))
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        peer.publish(SPEED, 0.5)
        await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        late = ros2.listener("/cmd_vel", "geometry_msgs/Twist", "--transient-local")
        await peer.until(lambda: heard(late))
    assert not any("incompatible" in line for line in bridge.lines)


async def test_subscriber_that_gets_nothing_is_counted_and_told_once(ros2: Ros2Space) -> None:
    bridge = ros2.bridge(sink())
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        peer.publish(SPEED, 0.5)
        ros2.listener("/cmd_vel", "geometry_msgs/Twist", "--transient-local")
        await peer.until(lambda: any("asks for another durability" in line for line in bridge.lines))
        status = await peer.status(Topic(ros2.domain, 2, STATUS_ID))
        assert status["Drops.incompatible_qos"] == 1


async def test_publisher_that_offers_less_than_fleet_yaml_asks_for_is_told(ros2: Ros2Space) -> None:
    bridge = ros2.bridge(battery(qos={"reliability": "reliable"}))
    async with Peer.at(ros2.udp_url) as peer:
        ros2.talker("/battery_state", "sensor_msgs/BatteryState", {"voltage": 12.5}, "--best-effort")
        await peer.until(lambda: any("offers another reliability" in line for line in bridge.lines))
        assert peer.good(Topic(ros2.domain, 2, 2001)) == []


async def test_topic_that_is_mapped_both_ways_does_not_come_back(ros2: Ros2Space) -> None:
    robots = sink()
    robots["turtle"]["data"]["measured"] = {
        "id": 2003,
        "type": "Double",
        "path": "linear.x",
        "source": {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
    }
    ros2.bridge(robots)
    listener = ros2.listener("/cmd_vel", "geometry_msgs/Twist")
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        peer.publish(SPEED, 0.5)
        await peer.until(lambda: heard(listener))
        ros2.talker("/cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.25}})
        await peer.until(lambda: len(peer.good(Topic(ros2.domain, 2, 2003))) > 3)
        assert set(peer.good(Topic(ros2.domain, 2, 2003))) == {(0.25,)}


async def test_datasets_that_share_a_topic_keep_each_others_fields(ros2: Ros2Space) -> None:
    robots = sink()
    turn = dict(robots["turtle"]["data"]["speed"], id=2004, path="angular.z")
    robots["turtle"]["data"]["turn"] = turn
    ros2.bridge(robots)
    listener = ros2.listener("/cmd_vel", "geometry_msgs/Twist")
    async with Peer.at(ros2.udp_url) as peer:
        announce_speed(peer)
        peer.announce(Topic(0, 2, 2004), (make_field("turn", BuiltinType.DOUBLE),))
        peer.publish(SPEED, 0.5)
        await peer.until(lambda: heard(listener))
        peer.publish(Topic(0, 2, 2004), 2.0)
        await peer.until(lambda: len(heard(listener)) == 2)
    assert "Vector3(x=0.5, y=0.0, z=0.0), angular=geometry_msgs.msg.Vector3(x=0.0, y=0.0, z=2.0)" in heard(listener)[1]
    assert "publishers 2" not in listener.lines
