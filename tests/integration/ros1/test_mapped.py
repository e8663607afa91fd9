"""Robots' own topics that `fleet.yaml` maps, in both directions."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from tests.integration.ros1.ros1_graph import Peer, Ros1Graph
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode

pytestmark = pytest.mark.needs("ros1")

BATTERY = Topic(1, 2, 11)
CHARGE = Topic(1, 2, 12)
COMMAND = Topic(0, 2, 21)


def robot(**data: Any) -> dict[str, Any]:
    return {"arm": {"bridge": "ros1", "data": data}}


async def test_fields_of_a_robots_own_topic_reach_their_datasets(graph: Ros1Graph, peer: Peer) -> None:
    topic = {"topic": "/joint_states", "type": "sensor_msgs/JointState"}
    graph.master()
    graph.bridge(
        robot(
            Joints={
                "id": 11,
                "fields": {
                    "First": {"type": "Double", "path": "position[0]"},
                    "Third": {"type": "Double", "path": "position[2]"},
                    "Rounded": {"type": "Int32", "path": "position[1]"},
                    "Frame": {"type": "String", "path": "header.frame_id"},
                },
                "source": topic,
            },
            Speeds={"id": 12, "type": "Double", "array": True, "path": "velocity", "source": topic},
        )
    )
    yaml = "{header: {frame_id: base}, position: [0.5, .nan], velocity: [1.0, 2.0]}"
    graph.talker("/joint_states", "sensor_msgs/JointState", yaml)
    await peer.until(lambda: peer.data(BATTERY) and peer.data(CHARGE))
    data = peer.data(BATTERY)[0]
    assert [field.name for field in data.metadata.fields] == ["First", "Third", "Rounded", "Frame"]
    assert data.message.values == (0.5, StatusCode.BAD_OUT_OF_RANGE, StatusCode.BAD_OUT_OF_RANGE, "base")
    assert data.message.types == (
        BuiltinType.DOUBLE,
        BuiltinType.STATUS_CODE,
        BuiltinType.STATUS_CODE,
        BuiltinType.STRING,
    )
    assert peer.good(CHARGE)[0] == ((1.0, 2.0),)
    await peer.until(lambda: (peer.bridge("Drops.conversion") or 0) > 1)


async def test_topic_of_another_type_than_configured_is_bad_and_the_rest_goes_on(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge(
        robot(
            Charge={"id": 12, "type": "Double", "source": {"topic": "/charge", "type": "std_msgs/Float64"}},
            Battery={"id": 11, "type": "Double", "source": {"topic": "/battery", "type": "std_msgs/Float64"}},
        )
    )
    graph.talker("/charge", "std_msgs/String", "{data: full}", "--name", "one")
    graph.talker("/battery", "std_msgs/Float64", "{data: 80.0}", "--name", "two")
    await peer.until(lambda: peer.data(BATTERY) and peer.data(CHARGE))
    assert peer.data(CHARGE)[0].message.values == (StatusCode.BAD_TYPE_MISMATCH,)
    assert peer.good(BATTERY)[0] == (80.0,)
    reason = "the topic carries std_msgs/String, fleet.yaml says std_msgs/Float64"
    await asyncio.to_thread(bridge.wait_for, reason)
    await peer.until(lambda: len(peer.data(CHARGE)) > 3)
    assert len([line for line in bridge.lines if reason in line]) == 1


async def test_latched_topic_of_a_robot_is_read_by_a_bridge_that_comes_later(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.talker("/charge", "std_msgs/Float64", "{data: 55.0}", "--latch", "--count", "1").wait_for("published")
    source = {"topic": "charge", "type": "std_msgs/Float64"}
    graph.bridge(robot(Charge={"id": 12, "type": "Double", "source": source}))
    await peer.until(lambda: peer.good(CHARGE) == [(55.0,)])


async def test_rate_limit_lets_the_last_value_through(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    source = {"topic": "/charge", "type": "std_msgs/Float64", "max_rate_hz": 5.0}
    graph.bridge(robot(Charge={"id": 12, "type": "Double", "source": source}))
    graph.talker("/charge", "std_msgs/Float64", "{data: COUNT}", "--rate", "200", "--count", "300", "--wait")
    await peer.until(lambda: (299.0,) in peer.good(CHARGE))
    values = [value for (value,) in peer.good(CHARGE)]
    assert values == sorted(set(values))
    # However long it took, on a busy machine: 5 in a second, beside the first and the last.
    assert 3 <= len(values) <= 5.0 * span_s(peer, CHARGE) + 2
    await peer.until(lambda: peer.bridge("Drops.rate_limited") == 300 - len(values))


def span_s(peer: Peer, topic: Topic) -> float:
    """From the first to the last value of a source, by their times."""
    times = [message.timestamp for message in peer.messages(topic) if message.timestamp is not None]
    ticks: int = times[-1] - times[0]
    return ticks / 1e7


async def test_what_clients_write_reaches_the_robots_own_topic(graph: Ros1Graph, udp_url: str) -> None:
    graph.master()
    sink = {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    graph.bridge(
        robot(
            Drive={
                "id": 21,
                "origin": "server",
                "fields": {
                    "Speed": {"type": "Double", "path": "linear.x"},
                    "Turn": {"type": "Double", "path": "angular.z"},
                },
                "sink": sink,
            }
        )
    )
    listener = graph.listener("/cmd_vel", "geometry_msgs/Twist")
    async with Peer.at(udp_url) as server:
        await graph.linked(listener, "/cmd_vel")
        server.announce(COMMAND, (make_field("Speed", BuiltinType.DOUBLE), make_field("Turn", BuiltinType.DOUBLE)))
        server.publish(COMMAND, 0.25, -1.0)
        line = await asyncio.to_thread(listener.wait_for, "heard")
        assert line == "heard: linear: x: 0.25 y: 0.0 z: 0.0 angular: x: 0.0 y: 0.0 z: -1.0"
        await server.until(lambda: server.bridge("ToSpace") == 1)
        assert server.bridge("Drops.type_missing") == 0


async def test_sink_is_rate_limited_and_latched(graph: Ros1Graph, udp_url: str) -> None:
    graph.master()
    sink = {"topic": "/limit", "type": "std_msgs/Float64", "max_rate_hz": 5.0, "latched": True}
    graph.bridge(robot(Limit={"id": 21, "origin": "server", "type": "Double", "sink": sink}))
    early = graph.listener("/limit", "std_msgs/Float64", "--name", "early")
    async with Peer.at(udp_url) as server:
        await graph.linked(early, "/limit")
        server.announce(COMMAND, (make_field("Limit", BuiltinType.DOUBLE),))
        begun = time.monotonic()
        for number in range(100):
            server.publish(COMMAND, float(number))
            await asyncio.sleep(0.005)
        await asyncio.to_thread(early.wait_for, "data: 99.0")
        most = 5.0 * (time.monotonic() - begun) + 2
        assert len([line for line in early.lines if "heard" in line]) <= most
        late = graph.listener("/limit", "std_msgs/Float64", "--name", "late")
        assert await asyncio.to_thread(late.wait_for, "heard") == "heard latched: data: 99.0"


async def test_topic_that_is_mapped_in_both_directions_does_not_feed_itself(graph: Ros1Graph, udp_url: str) -> None:
    graph.master()
    mapping = {"topic": "/target", "type": "std_msgs/Float64"}
    graph.bridge(
        robot(
            Target={"id": 12, "type": "Double", "source": mapping},
            Wanted={"id": 21, "origin": "server", "type": "Double", "sink": mapping},
        )
    )
    listener = graph.listener("/target", "std_msgs/Float64")
    async with Peer.at(udp_url) as server:
        await graph.linked(listener, "/target")
        server.announce(COMMAND, (make_field("Wanted", BuiltinType.DOUBLE),))
        server.publish(COMMAND, 7.0)
        await asyncio.to_thread(listener.wait_for, "data: 7.0")
        await server.until(lambda: server.bridge("Drops.own_publication") == 1)
        assert server.good(CHARGE) == []
        graph.talker("/target", "std_msgs/Float64", "{data: 8.0}")
        await server.until(lambda: (8.0,) in server.good(CHARGE))
        assert (7.0,) not in server.good(CHARGE)


async def test_datasets_that_share_a_topic_keep_each_others_fields(graph: Ros1Graph, udp_url: str) -> None:
    graph.master()
    sink = {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    speed = {"id": 21, "origin": "server", "type": "Double", "path": "linear.x", "sink": sink}
    graph.bridge(robot(Speed=speed, Turn=speed | {"id": 22, "path": "angular.z"}))
    listener = graph.listener("/cmd_vel", "geometry_msgs/Twist")
    turn = Topic(0, 2, 22)
    async with Peer.at(udp_url) as server:
        await graph.linked(listener, "/cmd_vel")
        server.announce(COMMAND, (make_field("Speed", BuiltinType.DOUBLE),))
        server.announce(turn, (make_field("Turn", BuiltinType.DOUBLE),))
        server.publish(COMMAND, 0.5)
        await asyncio.to_thread(listener.wait_for, "heard: linear: x: 0.5 y: 0.0 z: 0.0 angular: x: 0.0 y: 0.0 z: 0.0")
        server.publish(turn, 2.0)
        await asyncio.to_thread(listener.wait_for, "heard: linear: x: 0.5 y: 0.0 z: 0.0 angular: x: 0.0 y: 0.0 z: 2.0")
