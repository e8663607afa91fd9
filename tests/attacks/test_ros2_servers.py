"""ROS 2 servers of services and actions that misbehave: the skill ends, an honest neighbour is read all the time."""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.integration.ros2.conftest import Ros2Space, robot_msgs
from tests.integration.ros2.skilled import SKILLS, Skilled, skilled_driver
from tests.integration.ros2.test_actions import SKILLS as ACTIONS
from tests.system import Child, Processes
from tests.waiting import until
from ua_fleet.bridge import ExecutionEnded, ExecutionForgotten
from ua_fleet.errors import SkillError
from ua_fleet.topics import Topic

__all__ = ["robot_msgs"]
pytestmark = [
    pytest.mark.needs("ros2", "compiler"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

PROGRAM = Path(__file__).parent / "ros2_servers.py"
MOVE, LOAD, TURN = 1011, 1012, 1020
OLDEST_S = 4.0


@pytest.fixture
def ros2(ros_domain: int, udp_url: str, tmp_path: Path, processes: Processes) -> Ros2Space:
    return Ros2Space(ros_domain, udp_url, tmp_path, processes)


def hostile(ros2: Ros2Space, processes: Processes, kind: str) -> Child:
    program = processes.start(sys.executable, PROGRAM, kind, str(ros2.domain), env=ros2.environment())
    program.wait_for("ready")
    return program


async def goes_on(skilled: Skilled, topic: Topic, seconds: float) -> None:
    """The honest neighbour is read all the time, and what is told of it is of now."""
    end, last, seen = time.monotonic() + seconds, time.monotonic(), len(skilled.recorder.samples(topic))
    while time.monotonic() < end:
        await asyncio.sleep(0.05)
        samples = skilled.recorder.samples(topic)
        if len(samples) > seen:
            seen, last = len(samples), time.monotonic()
            assert time.time_ns() - samples[-1].source_time_ns < OLDEST_S * 1e9
        assert time.monotonic() - last < OLDEST_S
    assert skilled.driver.status().connected


async def is_over(skilled: Skilled, skill: int, *values: Any) -> bool:
    """Whether a skill comes to an end, or is refused at once."""
    try:
        execution_id = skilled.begin(skill, *values)
    except SkillError:
        return True
    kinds = (ExecutionEnded, ExecutionForgotten)
    await until(lambda: any(isinstance(fact, kinds) for fact in skilled.facts(execution_id)), "the end")
    return True


async def survived(ros2: Ros2Space, skilled: Skilled, skill: int, *values: Any) -> bool:
    """Whether the skill is over, while the values of another source have come all the time."""
    topic = Topic(ros2.domain, 2, 7)
    await asyncio.to_thread(ros2.talker, f"/{topic.name}", "std_msgs/Float64", {"data": "COUNT"})
    await until(lambda: skilled.recorder.samples(topic), "the value")
    over = asyncio.ensure_future(is_over(skilled, skill, *values))
    await goes_on(skilled, topic, 4.0)
    is_ended = await over
    await goes_on(skilled, topic, 0.5)
    return is_ended


@pytest.mark.parametrize("kind", ["other_type", "silent", "dying", "large", "two"])
async def test_a_service_that_misbehaves_costs_its_skill(ros2: Ros2Space, processes: Processes, kind: str) -> None:
    await asyncio.to_thread(hostile, ros2, processes, kind)
    async with skilled_driver(ros2.domain, {"load": SKILLS["load"]}) as skilled:
        assert await survived(ros2, skilled, LOAD, "home")


@pytest.mark.parametrize("kind", ["states", "states_of_another_type"])
async def test_a_robot_that_floods_its_state_costs_itself(ros2: Ros2Space, processes: Processes, kind: str) -> None:
    await asyncio.to_thread(hostile, ros2, processes, kind)
    async with skilled_driver(ros2.domain, {"move": SKILLS["move"]}) as skilled:
        assert await survived(ros2, skilled, MOVE, 1.0)


@pytest.mark.parametrize("kind", ["turn_flood", "turn_vanish", "turn_text"])
async def test_an_action_server_that_misbehaves_costs_its_skill(
    ros2: Ros2Space, processes: Processes, robot_msgs: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(sys, "path", [str(robot_msgs), *sys.path])
    ros2.packages.append(str(robot_msgs))
    await asyncio.to_thread(hostile, ros2, processes, kind)
    async with skilled_driver(ros2.domain, {"turn": {**ACTIONS["turn"], "timeout_s": 3.0}}) as skilled:
        assert await survived(ros2, skilled, TURN, 20.0, 0.0)
