"""Stock rospy and rclpy nodes that hear each other through both bridges over UDP, each a process of its own."""

from __future__ import annotations

import asyncio
import re
import signal
from pathlib import Path

import pytest

from tests.integration.peer import Peer
from tests.integration.ros1.ros1_graph import STATUS, Ros1Graph
from tests.integration.ros2.conftest import STATUS_ID, Ros2Space, heard
from tests.system import Child, Processes
from ua_fleet.topics import Topic

pytestmark = pytest.mark.needs("ros1", "ros2")

FROM_ROS1 = "ua_1_2_7"
INT = "std_msgs/Int32"


class Both:
    """A ROS 1 graph and a ROS 2 domain with a bridge each, on one multicast group."""

    def __init__(self, ros1: Ros1Graph, ros2: Ros2Space) -> None:
        self.ros1, self.ros2 = ros1, ros2
        self.from_ros2 = f"ua_{ros2.domain}_2_8"
        ros1.master()
        self.bridges = {1: ros1.bridge(), 2: ros2.bridge()}

    def kill(self, space: int) -> None:
        """Kill a bridge as hard as one can, and start it again."""
        self.bridges[space].end(signal.SIGKILL)
        self.bridges[space] = self.ros1.bridge() if space == 1 else self.ros2.bridge()

    def listener(self, space: int, topic: str, *options: str) -> Child:
        return self.ros1.listener(f"/{topic}", INT) if space == 1 else self.ros2.listener(topic, INT, *options)

    def talker(self, space: int, topic: str, *options: str, latched: bool = False) -> Child:
        if space == 1:
            return self.ros1.talker(f"/{topic}", INT, "{data: COUNT}", *options, *(["--latch"] if latched else []))
        return self.ros2.talker(topic, INT, {"data": "COUNT"}, *options, *(["--transient-local"] if latched else []))


@pytest.fixture
def both(request: pytest.FixtureRequest, udp_url: str, tmp_path: Path, processes: Processes) -> Both:
    domain: int = request.getfixturevalue("ros_domain")
    folders = [tmp_path / "ros1", tmp_path / "ros2"]
    for folder in folders:
        folder.mkdir()
    return Both(Ros1Graph(processes, folders[0], udp_url), Ros2Space(domain, udp_url, folders[1], processes))


def numbers(listener: Child) -> list[int]:
    """The numbers that a listener of either ROS has printed."""
    said = heard(listener) + [line for line in listener.lines if line.startswith("heard latched: ")]
    return [int(re.findall(r"data[=:] ?(-?\d+)", line)[0]) for line in said]


async def until(peer: Peer, listener: Child, last: int) -> None:
    await peer.until(lambda: numbers(listener)[-1:] == [last], 20)


async def looped(both: Both, peer: Peer) -> list[int]:
    """How often each bridge says that it delivered something twice."""
    statuses = [await peer.status(STATUS), await peer.status(Topic(both.ros2.domain, 2, STATUS_ID))]
    return [status["Looped"] for status in statuses]


async def test_nodes_of_both_worlds_hear_each_other_once_and_in_order(both: Both) -> None:
    count = 200
    in_ros2, in_ros1 = both.listener(2, FROM_ROS1), both.listener(1, both.from_ros2)
    async with Peer.at(both.ros2.udp_url) as peer:
        both.talker(1, FROM_ROS1, "--rate", "100", "--count", str(count), "--wait")
        both.talker(2, both.from_ros2, "--rate", "100", "--count", str(count), "--wait")
        await until(peer, in_ros2, count - 1)
        await until(peer, in_ros1, count - 1)
        assert numbers(in_ros2) == list(range(count))
        assert numbers(in_ros1) == list(range(count))
        assert await looped(both, peer) == [0, 0]


@pytest.mark.parametrize("space", [1, 2])
async def test_latched_value_reaches_who_comes_late(both: Both, space: int) -> None:
    topic = FROM_ROS1 if space == 1 else both.from_ros2
    early = both.listener(3 - space, topic)
    async with Peer.at(both.ros2.udp_url) as peer:
        both.talker(space, topic, "--count", "3", latched=True)
        await until(peer, early, 2)  # a bridge that has just come up holds messages for a second
        late = both.listener(3 - space, topic, "--transient-local")
        await until(peer, late, 2)
        await asyncio.sleep(0.5)
        assert numbers(late) == [2]


@pytest.mark.parametrize("killed", [1, 2])
@pytest.mark.parametrize("space", [1, 2])
async def test_killed_bridge_delivers_nothing_twice_when_it_is_back(both: Both, space: int, killed: int) -> None:
    topic = FROM_ROS1 if space == 1 else both.from_ros2
    listener = both.listener(3 - space, topic)
    async with Peer.at(both.ros2.udp_url) as peer:
        both.talker(space, topic, "--rate", "1", "--count", "3", "--wait", latched=True)
        await until(peer, listener, 2)
        assert await looped(both, peer) == [0, 0]  # by now a bridge has noted what its robots have heard
        before = numbers(listener)
        assert before == [0, 1, 2][-len(before) :], "the first ones are over where the listener was slow to come"
        both.kill(killed)
        await asyncio.sleep(6)  # the last value is repeated meanwhile
        assert numbers(listener) == before
        late = both.listener(3 - space, topic, "--transient-local")
        await until(peer, late, 2)
        assert numbers(late) == [2]
        assert numbers(listener) == before
        assert await looped(both, peer) == [0, 0]


async def test_robots_go_on_when_a_bridge_was_killed(both: Both) -> None:
    in_ros2, in_ros1 = both.listener(2, FROM_ROS1), both.listener(1, both.from_ros2)
    async with Peer.at(both.ros2.udp_url) as peer:
        both.talker(1, FROM_ROS1, "--rate", "50", "--wait")
        both.talker(2, both.from_ros2, "--rate", "50", "--wait")
        for killed in (1, 2):
            await peer.until(lambda: numbers(in_ros1) and numbers(in_ros2), 20)
            both.kill(killed)
            before = len(numbers(in_ros1)), len(numbers(in_ros2))
            await peer.until(lambda: len(numbers(in_ros1)) > before[0] + 20 and len(numbers(in_ros2)) > before[1] + 20)  # noqa: B023 - waited for within the turn
        for listener in (in_ros1, in_ros2):
            assert numbers(listener) == sorted(set(numbers(listener)))


@pytest.mark.parametrize("space", [1, 2])
async def test_robot_that_is_restarted_with_its_bridge_gets_the_current_value(both: Both, space: int) -> None:
    topic, here = (FROM_ROS1, 2) if space == 1 else (both.from_ros2, 1)
    listener = both.listener(here, topic, "--transient-local")
    async with Peer.at(both.ros2.udp_url) as peer:
        both.talker(space, topic, "--count", "3", "--wait", latched=True)
        await until(peer, listener, 2)
        both.bridges[here].end()
        listener.end(signal.SIGKILL)
        listener = both.listener(here, topic, "--transient-local")
        both.bridges[here] = both.ros1.bridge() if here == 1 else both.ros2.bridge()
        await until(peer, listener, 2)
        assert numbers(listener) == [2]
