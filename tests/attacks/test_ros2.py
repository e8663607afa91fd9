"""A hostile or broken ROS 2 node costs itself; an honest neighbour publishes all the time."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from ua_bridges.ros2.sources import MOST_GONE

from tests.attacks.bridges import OLDEST_S, Course, cpu_share, goes_on, goes_on_a_while, limit_memory
from tests.integration.peer import Peer
from tests.integration.ros2.conftest import STATUS_ID, Ros2Space
from tests.system import Child, Processes
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import FieldMetaData

pytestmark = pytest.mark.needs("ros2")

PROGRAM = Path(__file__).parent / "ros2_program.py"
MOST_MORE_CPU = 0.2
"""Of a processor, for an honest topic when thousands were there before: it was 0.7 once, and is 0.01."""
FOREIGN, OTHER = Topic(1, 2, 5), Topic(1, 2, 6)


def field(ros_type: str, builtin: BuiltinType) -> tuple[FieldMetaData, ...]:
    return (make_field("data", builtin, properties={"RosType": ros_type}),)


NUMBER, TEXT = field("std_msgs/Float64", BuiltinType.DOUBLE), field("std_msgs/String", BuiltinType.STRING)


@pytest.fixture
def ros2(ros_domain: int, udp_url: str, tmp_path: Path, processes: Processes) -> Ros2Space:
    return Ros2Space(ros_domain, udp_url, tmp_path, processes)


@pytest.fixture
async def peer(udp_url: str) -> AsyncIterator[Peer]:
    async with Peer.at(udp_url, space=1) as started:
        yield started


class Honest:
    """A bridge with an honest neighbour."""

    def __init__(self, ros2: Ros2Space, peer: Peer, processes: Processes) -> None:
        self._ros2, self._peer, self._processes = ros2, peer, processes
        self.topic = Topic(ros2.domain, 2, 7)
        self.attacked = Topic(ros2.domain, 2, 66)
        self.status = Topic(ros2.domain, 2, STATUS_ID)

    async def start(self) -> None:
        self.bridge = await asyncio.to_thread(self._ros2.bridge)
        limit_memory(self.bridge)
        await asyncio.to_thread(self._ros2.talker, f"/{self.topic.name}", "std_msgs/Float64", {"data": "COUNT"})
        await self._peer.until(lambda: self._peer.good(self.topic))

    async def attack(self, kind: str, number: int) -> Child:
        environment = self._ros2.environment()
        program = self._processes.start(
            sys.executable, PROGRAM, kind, str(self._ros2.domain), str(number), env=environment
        )
        await asyncio.to_thread(program.wait_for, "ready")
        return program

    async def goes_on_until_done(self, program: Child, timeout_s: float = 120) -> Course:
        """See `goes_on`: until a program has done what it does, and a second more."""
        worst = Course()
        async with asyncio.timeout(timeout_s):
            while "done" not in program.lines:
                worst = worst.or_worse(await goes_on_a_while(self._peer, self.topic, self.bridge, 0.5))
        return worst.or_worse(await goes_on(self._peer, self.topic, self.bridge, 1.0))


@pytest.fixture
async def honest(ros2: Ros2Space, peer: Peer, processes: Processes) -> Honest:
    started = Honest(ros2, peer, processes)
    await started.start()
    return started


async def test_a_source_of_another_space_that_changes_its_type_ends_no_bridge(
    honest: Honest, ros2: Ros2Space, peer: Peer
) -> None:
    peer.announce(OTHER, NUMBER)
    listener = await asyncio.to_thread(ros2.listener, f"/{OTHER.name}", "std_msgs/Float64")
    worst = Course()
    for turn in range(8):
        peer.announce(FOREIGN, (NUMBER, TEXT)[turn % 2])
        peer.publish(FOREIGN, (1.0, "text")[turn % 2])
        if not turn:
            await asyncio.to_thread(ros2.listener, f"/{FOREIGN.name}", "std_msgs/Float64")
        worst = worst.or_worse(await goes_on_a_while(peer, honest.topic, honest.bridge, 0.5))
    assert worst.oldest_s < OLDEST_S
    texts = await asyncio.to_thread(ros2.listener, f"/{FOREIGN.name}", "std_msgs/String")
    peer.publish(OTHER, 5.0)
    peer.publish(FOREIGN, "the last")
    await asyncio.to_thread(listener.wait_for, "5.0")
    await asyncio.to_thread(texts.wait_for, "the last")
    assert honest.bridge.process.poll() is None


async def test_many_topics_at_once_make_nobody_wait(honest: Honest, peer: Peer) -> None:
    course = await honest.goes_on_until_done(await honest.attack("crowd", 500))
    assert course.oldest_s < OLDEST_S


async def test_topics_that_come_and_go_leave_nothing_behind(honest: Honest, peer: Peer) -> None:
    before = await cpu_share(honest.bridge, 2.0)
    await honest.goes_on_until_done(await honest.attack("short_lived", 300))
    assert await cpu_share(honest.bridge, 3.0) < before + MOST_MORE_CPU
    counting = await honest.attack("counting", 0)

    def listens_to() -> int:
        said = [line for line in counting.lines if line.startswith("listens to ")]
        return int(said[-1].split()[-1]) if said else 0

    await peer.until(lambda: 0 < listens_to() <= MOST_GONE + 10)


@pytest.mark.parametrize(("kind", "number"), [("changing", 40), ("rubbish", 40), ("flooding", 6)])
async def test_a_topic_that_is_misused_costs_itself(honest: Honest, kind: str, number: int) -> None:
    course = await honest.goes_on_until_done(await honest.attack(kind, number))
    assert course.oldest_s < OLDEST_S
