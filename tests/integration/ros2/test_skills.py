# pyright: reportPrivateUsage=false
"""Skills on topics, services and robots' own programs, with a real robot beside the driver."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
import time

import pytest
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests.integration.ros2.conftest import Ros2Space
from tests.integration.ros2.skilled import skilled_driver
from tests.system import Child, Processes
from tests.unit.docs.pages import ROOT, blocks
from tests.waiting import until
from ua_fleet.bridge import ExecutionEnded, ExecutionForgotten, ExecutionProgressed, SourceFound
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.values import StatusCode

pytestmark = [
    pytest.mark.needs("ros2"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

DRIVE, MOVE, LOAD = 1010, 1011, 1012
DOUBLE = {"type": "Double"}


@pytest.fixture
def robot(ros2: Ros2Space) -> Child:
    return ros2.node("skilled.py", ros2.domain)


def told(robot: Child) -> list[str]:
    return [line.removeprefix("told: ") for line in robot.lines if line.startswith("told: ")]


async def test_topic_skill_is_done_when_the_robot_says_so(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(MOVE, 1.0)
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (), "arrived")
        assert isinstance(skilled.facts(execution_id)[0], ExecutionProgressed)
    await until(lambda: told(robot) == ["move 1.0 0.5"], "what the robot was told")


@pytest.mark.parametrize(("skill", "arguments"), [(MOVE, (1.0,)), (LOAD, ("home",)), (DRIVE, ("dock", 0.0))])
async def test_skill_ends_while_the_thread_of_the_values_is_behind(
    ros2: Ros2Space, robot: Child, skill: int, arguments: tuple[object, ...]
) -> None:
    """As with an image that takes long, or a thousand messages: here it does nothing else until it is let go."""
    async with skilled_driver(ros2.domain) as skilled:
        await skilled.end(skilled.begin(skill, *arguments))  # its robot is found
        let_go = threading.Event()

        def hold() -> None:
            let_go.wait(60)

        skilled.driver._thread.call(hold)
        try:
            execution_id = skilled.begin(skill, *arguments)
            ended = await skilled.end(execution_id)
        finally:
            let_go.set()
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == 0


async def test_topic_skill_fails_when_the_robot_says_so(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        for _ in range(2):  # the state of the first time is no answer to the second
            execution_id = skilled.begin(MOVE, 2.0)
            assert await skilled.end(execution_id) == ExecutionEnded(
                execution_id, StatusCode.BAD_UNEXPECTED_ERROR, (), "stuck"
            )
    await until(lambda: told(robot) == ["move 2.0 0.5"] * 2, "what the robot was told")


async def test_program_that_answers_twice_or_nonsense_is_counted(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(DRIVE, "dock", 0.0)
        await skilled.end(execution_id)
        done = json.dumps({"execution_id": execution_id.hex(), "state": "done", "results": {"distance": 9.0}})
        other = json.dumps({"execution_id": "00" * 16, "state": "done"})
        for text in (done, other, "done!"):
            ros2.talker(f"ua_{ros2.domain}_2_{DRIVE}", "std_msgs/String", {"data": text}, "--count", 1, "--wait")
        await until(lambda: skilled.recorder.dropped(Drop.UNASKED) >= 2, "both answers")
        await until(lambda: skilled.recorder.dropped(Drop.MALFORMED), "what is no status")
        assert isinstance(skilled.facts(execution_id)[-1], ExecutionEnded)
        assert [fact.values for fact in skilled.facts(execution_id) if isinstance(fact, ExecutionEnded)] == [(2.5,)]


async def test_topic_skill_that_takes_too_long_is_stopped(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(MOVE, 3.0)
        ended = await skilled.end(execution_id)
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == StatusCode.BAD_TIMEOUT
        assert ended.message == "it took longer than 2 s; it was told to stop"
    await until(lambda: told(robot) == ["move 3.0 0.5", "move 0.0 0.0"], "what the robot was told")


async def test_service_skill_ends_with_its_response(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(LOAD, "home")
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (7,))
        execution_id = skilled.begin(LOAD, "missing")
        failed = await skilled.end(execution_id)
        assert isinstance(failed, ExecutionEnded)
        assert failed.status == StatusCode.BAD_UNEXPECTED_ERROR
    await until(lambda: told(robot) == ["map home", "map missing"], "what the robot was told")


async def test_service_that_answers_late_is_counted(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(LOAD, "slow")
        ended = await skilled.end(execution_id)
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == StatusCode.BAD_TIMEOUT
        await until(lambda: skilled.recorder.dropped(Drop.UNASKED), "the late response")
        assert len(skilled.facts(execution_id)) == 2, "at it, and its end"
    await until(lambda: told(robot) == ["map slow"], "what the robot was told")


async def test_program_does_a_skill_once_and_tells_its_progress(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(DRIVE, "dock", 0.5)
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (2.5,))
        progress = [fact.progress for fact in skilled.facts(execution_id) if isinstance(fact, ExecutionProgressed)]
        # What follows fast may be left out for the newest.
        assert progress == sorted(progress)
        assert progress[0] < progress[-1]
        assert not [event for event in skilled.recorder.events if isinstance(event, SourceFound)], "no data source"
    await until(lambda: told(robot) == ["drive dock"], "what the robot was told")


@pytest.mark.parametrize(
    ("to", "status", "message"),
    [
        ("the moon", StatusCode.BAD_REQUEST_NOT_ALLOWED, "no way to the moon"),
        ("the wall", StatusCode.BAD_UNEXPECTED_ERROR, "RuntimeError: bumped"),
    ],
)
async def test_program_refuses_and_fails_in_its_own_words(
    ros2: Ros2Space, robot: Child, to: str, status: int, message: str
) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(DRIVE, to, 0.0)
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, status, (), message)


@pytest.mark.parametrize(("skill", "values", "more"), [(MOVE, (3.0,), ["move 0.0 0.0"]), (DRIVE, ("dock", 30.0), [])])
async def test_what_can_be_stopped_is_halted(
    ros2: Ros2Space, robot: Child, skill: int, values: tuple[float | str, ...], more: list[str]
) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(skill, *values)
        await skilled.until_at_it(execution_id)
        skilled.halt(skill, execution_id)
        ended = await skilled.end(execution_id)
        assert isinstance(ended, ExecutionEnded)
        assert (ended.status, ended.message) == (StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, "it was halted")
        await until(lambda: len(told(robot)) == 1 + len(more), "what the robot was told")
        assert told(robot)[1:] == more
        with pytest.raises(SkillRejected, match="the service /load_map cannot be stopped"):
            skilled.halt(LOAD, execution_id)
        with pytest.raises(SkillRejected, match="a robot stands and goes on only in what its own program offers"):
            skilled.driver.suspend(skilled.execution(LOAD, execution_id=execution_id))
        assert not any(offered.can_suspend for offered in skilled.driver.skills() if offered.topic.id == LOAD)


async def test_what_is_absent_is_named(ros2: Ros2Space) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        early = skilled.begin(LOAD, "home")
        ended = await skilled.end(early)
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == StatusCode.BAD_NO_COMMUNICATION
        assert ended.message == "there is no service /load_map; start the robot's node"
        await asyncio.sleep(2.5)
        for skill, values, text in (
            (LOAD, ("home",), "there is no service /load_map"),
            (MOVE, (1.0,), "/move has no subscriber"),
            (DRIVE, ("dock", 0.0), f"/ua_{ros2.domain}_2_1010 has no publisher"),
        ):
            with pytest.raises(RobotOffline, match=text):
                skilled.begin(skill, *values)


async def test_type_that_is_not_installed_is_named(ros2: Ros2Space) -> None:
    skills = {"cook": {"id": 1, "via": {"action": {"name": "/cook", "type": "kitchen_msgs/Cook"}}}}
    async with skilled_driver(ros2.domain, skills) as skilled:
        with pytest.raises(SkillRejected, match="the action type kitchen_msgs/action/Cook is not installed here"):
            skilled.begin(1)


async def test_bridge_that_comes_later_asks_the_program(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(DRIVE, "dock", 1.5)
        await skilled.until_at_it(execution_id)
    async with skilled_driver(ros2.domain) as skilled:
        for asked in (execution_id, b"never heard of it"[:16]):
            skilled.driver.query(skilled.execution(DRIVE, "dock", 1.5, execution_id=asked))
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (2.5,))
        assert isinstance(await skilled.end(b"never heard of it"[:16]), ExecutionForgotten)
    await until(lambda: told(robot) == ["drive dock"], "what the robot was told")


async def test_service_and_topic_cannot_be_asked_later(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        for skill, value in ((LOAD, "home"), (MOVE, 1.0)):
            execution = skilled.execution(skill, value)
            skilled.driver.query(execution)
            assert isinstance(await skilled.end(execution.execution_id), ExecutionForgotten)
    assert told(robot) == []


async def test_program_that_is_killed_and_comes_back_does_nothing_twice(ros2: Ros2Space, robot: Child) -> None:
    async with skilled_driver(ros2.domain) as skilled:
        execution_id = skilled.begin(DRIVE, "dock", 30.0)
        await skilled.until_at_it(execution_id)
        robot.end(signal.SIGKILL)
        began = time.monotonic()
        again = ros2.node("skilled.py", ros2.domain)
        forgotten = await skilled.end(execution_id)
        assert isinstance(forgotten, ExecutionForgotten)
        assert forgotten.message == "this program remembers nothing of it"
        assert time.monotonic() - began < 10
    assert told(again) == []


async def test_program_of_the_documentation(ros2: Ros2Space, processes: Processes) -> None:
    (program,) = [block.text for block in blocks("python") if block.page == ROOT / "docs" / "skills-json.md"]
    text = program.replace("space=2", f"space={ros2.domain}")
    environment = ros2.environment(**{PROFILES_VARIABLE: str(profile_path("robot"))})
    processes.start(sys.executable, "-c", text, env=environment)
    skills = {"drive": {"id": DRIVE, "arguments": {"to": {"type": "String"}}, "results": {"distance": DOUBLE}}}
    async with skilled_driver(ros2.domain, skills) as skilled:
        async with asyncio.timeout(60):  # refused until the program is there
            while True:
                execution_id = skilled.begin(DRIVE, "dock")
                ended = await skilled.end(execution_id)
                if not isinstance(ended, ExecutionEnded) or ended.status != StatusCode.BAD_NO_COMMUNICATION:
                    break
                await asyncio.sleep(0.05)
        assert ended == ExecutionEnded(execution_id, 0, (3.2,))
        assert skilled.facts(execution_id)[2] == ExecutionProgressed(execution_id, 0.1, "on the way to dock")
