"""What comes and goes: the master, the robots, the bridge. Nobody helps."""

from __future__ import annotations

import asyncio
import signal
import socket
import time

import pytest

from tests import system
from tests.integration.ros1.ros1_graph import WAIT_S, Peer, Ros1Graph
from ua_fleet.pubsub.metadata import MAX_AGE, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, QualifiedName, StatusCode

pytestmark = pytest.mark.needs("ros1")

SOURCE = Topic(1, 2, 7)
OTHER = Topic(1, 2, 8)
OLD = StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE
FOREIGN = Topic(2, 2, 5)
TEXT = (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),)


async def test_master_may_come_after_the_bridge(graph: Ros1Graph, peer: Peer) -> None:
    bridge = graph.bridge()
    await peer.until(lambda: "no ROS master at" in (peer.bridge("Detail") or ""))
    assert peer.bridge("Connected") is False
    await asyncio.to_thread(bridge.wait_for, "not connected to the space")
    graph.master()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: peer.good(SOURCE))
    await peer.until(lambda: peer.bridge("Connected") is True)
    await asyncio.to_thread(bridge.wait_for, "] connected to the space")
    said = [line for line in bridge.lines if "connected to the space" in line]
    assert len(said) == 2  # once each way


async def test_restarted_master_hears_of_everything_again(graph: Ros1Graph, peer: Peer) -> None:
    master = graph.master()
    graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}", "--name", "old")
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "before")
    await peer.until(lambda: peer.good(SOURCE) and "/ua_2_2_5" in graph.state()[0])
    master.end()
    await peer.until(lambda: peer.bridge("Connected") is False)
    before = len(peer.good(SOURCE))
    await peer.until(lambda: len(peer.good(SOURCE)) > before + 5)  # links do not need the master
    assert not peer.silent(SOURCE)
    graph.master()
    await peer.until(lambda: graph.state()[0].get("/ua_2_2_5") == ["/ua_bridge"])
    graph.talker("/ua_1_2_8", "std_msgs/Float64", "{data: COUNT}", "--name", "new")
    await peer.until(lambda: peer.good(OTHER))
    listener = graph.listener("/ua_2_2_5", "std_msgs/String")
    await graph.linked(listener, "/ua_2_2_5")
    peer.publish(FOREIGN, "after")
    await asyncio.to_thread(listener.wait_for, 'data: "after"')
    # A node that is registered with the new master under a topic that the bridge already watches.
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: -1.0}", "--name", "third")
    await peer.until(lambda: (-1.0,) in peer.good(SOURCE))


async def test_bridge_that_comes_after_a_restarted_master_finds_a_program_that_keeps_itself_registered(
    graph: Ros1Graph, peer: Peer
) -> None:
    master = graph.master()
    program = graph.node("registered.py")
    master.end()
    # What has taken the question is gone, and nobody ever says so.
    with socket.create_server(("127.0.0.1", graph.port)) as mute:
        mute.settimeout(WAIT_S)
        silent, _ = await asyncio.to_thread(mute.accept)
    with silent:
        graph.master()
        await peer.until(lambda: graph.services().get("/serve") == ["/registered"])
    graph.bridge()
    await peer.until(lambda: peer.good(SOURCE))
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "after")
    await asyncio.to_thread(program.wait_for, "heard: after")
    assert [line for line in program.lines if line.startswith("heard")] == ["heard: after"], "it has one link"


async def test_robot_of_the_demonstrations_waits_for_its_master(graph: Ros1Graph) -> None:
    program = system.ROOT / "demo" / "ua_demo" / "talkrobots" / "robots" / "ridgeback.py"
    robot = graph.processes.start(system.ROS1_PYTHON, program, env=graph.env)
    robot.wait_for(f"waiting for the ROS master at {graph.uri}", timeout_s=WAIT_S)
    graph.master()
    robot.wait_for("is ready", timeout_s=WAIT_S)
    assert graph.services()["/sawyer/load"] == ["/ridgeback"]


async def test_killed_robot_is_missed_at_once_and_heard_when_it_is_back(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    robot = graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: len(peer.good(SOURCE)) > 3)
    robot.end(signal.SIGKILL)
    assert await peer.takes(lambda: peer.silent(SOURCE)) < 1.5
    assert graph.state()[0]["/ua_1_2_7"] == ["/talker"]  # the master still believes in it
    await peer.stays(lambda: peer.silent(SOURCE), 1.5)
    said = len(peer.good(SOURCE))
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    assert await peer.takes(lambda: len(peer.good(SOURCE)) > said) < 1.5
    assert not peer.silent(SOURCE)


async def test_robot_that_leaves_properly_comes_back_with_another_type(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    robot = graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: peer.good(SOURCE))
    robot.end(signal.SIGINT)
    await peer.until(lambda: peer.silent(SOURCE))
    graph.talker("/ua_1_2_7", "std_msgs/String", "{data: hello}")
    await peer.until(lambda: ("hello",) in peer.good(SOURCE))


async def test_source_that_lives_but_says_nothing_stays_alive(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge(keep_alive_s=0.3)
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}", "--count", "1", "--wait").wait_for("published")
    await peer.until(lambda: peer.good(SOURCE))
    await peer.stays(lambda: not peer.silent(SOURCE), 4.0)
    assert len(peer.good(SOURCE)) == 1


async def test_source_that_came_with_a_period_and_lives_but_says_nothing_is_old_after_ten_of_them(
    graph: Ros1Graph, peer: Peer
) -> None:
    graph.master()
    graph.bridge()
    talker = graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}", "--count", "100", "--wait")
    talker.wait_for("published")
    await peer.until(lambda: (99.0,) in peer.good(SOURCE))
    await peer.until(lambda: peer.messages(SOURCE)[-1].status == OLD)
    assert peer.messages(SOURCE)[-1].values == (99.0,)
    assert not peer.silent(SOURCE), "its publisher is there"
    properties = {key: value for key, _, value in peer.data(SOURCE)[-1].metadata.fields[0].properties}
    assert properties[QualifiedName(0, MAX_AGE)] == 3000.0


async def test_source_that_a_restarted_bridge_never_heard_is_not_attested(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}", "--count", "1", "--wait").wait_for("published")
    await peer.until(lambda: peer.good(SOURCE))
    bridge.end(signal.SIGKILL)
    graph.bridge()
    await peer.until(lambda: peer.is_stale(SOURCE))
    await peer.stays(lambda: peer.is_stale(SOURCE), 4.0)
    assert len(peer.good(SOURCE)) == 1


async def test_killed_bridge_starts_again_beside_its_own_ghost(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    listener = graph.listener("/ua_2_2_5", "std_msgs/String")
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "before")
    await asyncio.to_thread(listener.wait_for, "before")
    await peer.until(lambda: peer.good(SOURCE))
    bridge.end(signal.SIGKILL)
    said = len(peer.good(SOURCE))
    graph.bridge()
    await peer.until(lambda: len(peer.good(SOURCE)) > said)
    peer.publish(FOREIGN, "after")
    await asyncio.to_thread(listener.wait_for, "after")


async def test_subscriber_that_has_lost_its_link_gets_another(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge()
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "before")
    await peer.until(lambda: "/ua_2_2_5" in graph.state()[0])
    listener = graph.listener("/ua_2_2_5", "std_msgs/String", "--loses-link")
    await peer.until(lambda: [line for line in listener.lines if "links" in line] == ["links 1", "links 0", "links 1"])
    await graph.linked(listener, "/ua_2_2_5")
    peer.publish(FOREIGN, "after")
    await asyncio.to_thread(listener.wait_for, 'data: "after"')
    await peer.until(lambda: peer.bridge("Drops.unlinked") == 1)
    bridge.wait_for("a subscriber has no link; its topic is registered again")
    await asyncio.to_thread(bridge.wait_for, "a subscriber is linked again")


async def test_subscriber_with_another_type_is_not_asked_to_link_again(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "before")
    await peer.until(lambda: "/ua_2_2_5" in graph.state()[0])
    graph.listener("/ua_2_2_5", "std_msgs/Float64", "--name", "wrong")
    graph.listener("/ua_2_2_5", "std_msgs/String", "--loses-link")
    # Registering for the second one has the master tell both.
    await peer.until(lambda: peer.bridge("Drops.unlinked") == 1)
    await peer.stays(lambda: peer.bridge("Drops.unlinked") == 1, 5.0)


async def test_bridge_leaves_nothing_behind_when_it_stops(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    bridge = graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    peer.announce(FOREIGN, TEXT)
    peer.publish(FOREIGN, "x")
    await peer.until(lambda: peer.good(SOURCE) and "/ua_2_2_5" in graph.state()[0])
    started = time.monotonic()
    assert bridge.end(signal.SIGTERM) == 0
    assert time.monotonic() - started < 2
    assert "stopped" in bridge.lines
    publishers, subscribers = graph.state()
    assert "/ua_2_2_5" not in publishers
    assert "/ua_1_2_7" not in subscribers
    assert not (graph.folder / ".ros").exists()  # rospy writes its logs there by itself


async def test_bridge_whose_name_is_taken_says_so_and_comes_back_when_it_is_free(graph: Ros1Graph, peer: Peer) -> None:
    graph.master()
    graph.bridge()
    graph.talker("/ua_1_2_7", "std_msgs/Float64", "{data: COUNT}")
    await peer.until(lambda: peer.good(SOURCE))
    other = graph.listener("/chatter", "std_msgs/String", "--name", "ua_bridge")
    await peer.until(lambda: "took the name /ua_bridge" in peer.bridge("Detail"))
    assert peer.bridge("Connected") is False
    await peer.until(lambda: peer.silent(SOURCE))
    other.end(signal.SIGKILL)  # the master is told nothing, and keeps its name
    before = len(peer.good(SOURCE))
    await peer.until(lambda: peer.bridge("Connected") and len(peer.good(SOURCE)) > before + 5)
