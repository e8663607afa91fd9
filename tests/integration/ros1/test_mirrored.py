"""Topics `ua_*` in a real ROS 1 graph, seen from PubSub, and the other way."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest
from ua_bridges.ros.latched import is_latched, mark_latched

from tests.integration.ros1.ros1_graph import Peer, Ros1Graph
from ua_fleet.pubsub.metadata import field_property, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, unix_ns_from_ticks

pytestmark = pytest.mark.needs("ros1")

FLOAT = Topic(1, 2, 7)
JOINTS = Topic(1, 2, 8)
JOINT_YAML = "{header: {frame_id: base, stamp: {secs: 1700000000, nsecs: COUNT}}, name: [a, b], position: [0.5, COUNT]}"


async def test_any_message_type_is_mirrored_without_configuration(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}", "--name", "one")
    graph.talker("/ua_1_2_8", "sensor_msgs/JointState", JOINT_YAML, "--name", "two", "--rate", "50")
    await peer.until(lambda: len(peer.good(FLOAT)) > 5 and len(peer.good(JOINTS)) > 5)
    numbers = [value for (value,) in peer.good(FLOAT)]
    assert numbers == [numbers[0] + step for step in range(len(numbers))]
    first, second = peer.data(JOINTS)[:2]
    fields = {field.name: value for field, value in zip(first.metadata.fields, first.message.values, strict=True)}
    assert fields["name"] == ("a", "b")
    assert fields["position"] == (0.5, float(fields["header.stamp.nanosec"]))
    assert fields["header.frame_id"] == "base"
    assert field_property(first.metadata.fields[0], "RosType") == "sensor_msgs/JointState"
    for data in (first, second):  # the robot's own time
        assert data.message.timestamp is not None
        assert unix_ns_from_ticks(data.message.timestamp) // 1_000_000_000 == 1_700_000_000
    assert peer.bridge("Looped") in (None, 0)


async def test_latched_source_is_delivered_even_when_the_bridge_comes_later(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.talker("/ua_1_2_7", "std_msgs/String", "{data: parked}", "--latch", "--count", "1").wait_for("published")
    graph.bridge()
    await peer.until(lambda: peer.good(FLOAT))
    assert peer.good(FLOAT) == [("parked",)]
    assert is_latched(peer.data(FLOAT)[0].metadata.fields)


async def test_another_spaces_data_is_published_from_its_first_message_on(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    listener = graph.listener("/ua_2_2_5", "sensor_msgs/JointState")
    topic = Topic(2, 2, 5)
    peer.announce(
        topic,
        (
            make_field("header.stamp.sec", BuiltinType.INT32, properties={"RosType": "sensor_msgs/JointState"}),
            make_field("header.stamp.nanosec", BuiltinType.UINT32),
            make_field("header.frame_id", BuiltinType.STRING),
            make_field("name", BuiltinType.STRING, array=True),
            make_field("position", BuiltinType.DOUBLE, array=True),
            make_field("velocity", BuiltinType.DOUBLE, array=True),
            make_field("effort", BuiltinType.DOUBLE, array=True),
        ),
    )
    for number in range(3):
        peer.publish(topic, 17, 4, "base", ("a",), (float(number),), (), ())
    line = await asyncio.to_thread(listener.wait_for, "heard")
    assert "secs: 17 nsecs: 4" in line
    assert 'frame_id: "base" name: - a position: [0.0] velocity: [] effort: []' in line
    await asyncio.to_thread(listener.wait_for, "position: [2.0]")
    await peer.until(lambda: peer.bridge("ToSpace"))
    assert not peer.data(topic)  # nothing of it comes back


async def test_scalar_of_the_server_is_a_std_message_that_a_late_node_gets_too(graph: Ros1Graph, udp_url: str) -> None:
    graph.master()
    graph.bridge()
    topic = Topic(0, 2, 3)
    async with Peer.at(udp_url) as server:
        server.announce(topic, (make_field("Speed", BuiltinType.DOUBLE),))
        server.publish(topic, 1.5)
        await server.until(lambda: "/ua_0_2_3" in graph.state()[0])
        await asyncio.sleep(1.2)
        listener = graph.listener("/ua_0_2_3", "std_msgs/Float64")
        assert "latched: data: 1.5" in await asyncio.to_thread(listener.wait_for, "heard")
        server.publish(topic, 2.5)
        await asyncio.to_thread(listener.wait_for, "data: 2.5")


async def test_event_of_another_space_is_not_told_to_who_comes_later_unless_it_is_latched(
    graph: Ros1Graph, peer: Peer
) -> None:
    graph.master()
    graph.bridge()
    plain, latched = Topic(2, 2, 5), Topic(2, 2, 6)
    fields = (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),)
    peer.announce(plain, fields)
    peer.announce(latched, mark_latched(fields))
    peer.publish(plain, "go")
    peer.publish(latched, "map")
    await peer.until(lambda: peer.bridge("ToSpace") == 2)
    await asyncio.sleep(1.2)  # the first messages are held for subscribers that are about to connect
    late = graph.listener("/ua_2_2_5", "std_msgs/String", "--name", "late")
    other = graph.listener("/ua_2_2_6", "std_msgs/String", "--name", "other")
    await asyncio.to_thread(other.wait_for, 'heard latched: data: "map"')
    await asyncio.to_thread(late.wait_for, "links 1")
    peer.publish(plain, "stop")
    assert await asyncio.to_thread(late.wait_for, "heard") == 'heard: data: "stop"'


async def test_illegal_names_and_missing_types_are_counted(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    for number, name in enumerate(("/ua_1_2", "/ua_1_2_007", "/ua_999999_2_1")):
        graph.talker(name, "std_msgs/Float64", "{data: 1.0}", "--name", f"bad{number}")
    await peer.until(lambda: peer.bridge("Drops.illegal_topic") == 3)
    _, subscribers = graph.state()
    assert not {"/ua_1_2", "/ua_1_2_007", "/ua_999999_2_1"} & set(subscribers)
    topic = Topic(2, 2, 5)
    peer.announce(topic, (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "acme_msgs/Nothing"}),))
    peer.publish(topic, 1.0)
    await peer.until(lambda: peer.bridge("Drops.type_missing") == 1)
    wrong = Topic(2, 2, 6)
    peer.announce(wrong, (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "std_msgs/Int8"}),))
    peer.publish(wrong, float("nan"))
    await peer.until(lambda: peer.bridge("Drops.conversion") == 1)
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: peer.good(FLOAT))  # the rest goes on


async def test_slow_subscriber_holds_up_nobody(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge()
    topic = Topic(2, 2, 5)
    peer.announce(topic, (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),))
    stuck = graph.listener("/ua_2_2_5", "std_msgs/String", "--name", "stuck")
    quick = graph.listener("/ua_2_2_5", "std_msgs/String", "--name", "quick")
    peer.publish(topic, "first")
    await asyncio.to_thread(stuck.wait_for, "first")
    await asyncio.to_thread(quick.wait_for, "first")
    os.kill(stuck.process.pid, signal.SIGSTOP)
    try:
        filler = "x" * 30_000
        for number in range(400):  # more than the kernel buffers for the one that has stopped
            peer.publish(topic, f"{number} {filler}")
            # No faster than it arrives: a datagram that the kernel has no place for is lost, whoever subscribes.
            while number - sum("heard" in line for line in quick.lines) > 20:
                await asyncio.sleep(0.01)
        peer.publish(topic, "the last one")
        await asyncio.to_thread(quick.wait_for, "the last one")
        await peer.until(lambda: peer.bridge("ToSpace") == 402)
        assert bridge.end(timeout_s=10) == 0, "it was not killed: it waits for nobody"
    finally:
        os.kill(stuck.process.pid, signal.SIGCONT)
