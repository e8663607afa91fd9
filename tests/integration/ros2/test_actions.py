"""Skills that are ROS 2 actions, with an action server beside the driver, or beside a bridge that is killed."""

from __future__ import annotations

import asyncio
import secrets
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs
from ua_bridges.ros2.skills import action

from tests.integration.actions.requesting import requesting
from tests.integration.ros2.conftest import Ros2Space
from tests.integration.ros2.skilled import skilled_driver
from tests.system import Child
from tests.waiting import until
from ua_fleet.bridge import ExecutionEnded, ExecutionForgotten, ExecutionProgressed
from ua_fleet.config.schema import FleetConfig
from ua_fleet.skill.executions import ExecutionState, OutcomeKind, unpack
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

pytestmark = [
    pytest.mark.needs("ros2", "compiler"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

TURN = 1020
SKILLS: dict[str, Any] = {
    "turn": {
        "id": TURN,
        "arguments": {"angle": {"type": "Double"}, "seconds": {"type": "Double", "default": 0.0}},
        "results": {"reached": {"type": "Double"}},
        "timeout_s": 20.0,
        "immediate": True,
        "via": {"action": {"name": "/turn", "type": "robot_msgs/Turn", "progress": "share", "message": "said"}},
    }
}


@pytest.fixture
def turner(ros2: Ros2Space, robot_msgs: Path, monkeypatch: pytest.MonkeyPatch) -> Child:
    monkeypatch.setattr(sys, "path", [str(robot_msgs), *sys.path])
    ros2.packages.append(str(robot_msgs))
    return ros2.node("turner.py")


def told(robot: Child) -> list[str]:
    return [line.split()[1] for line in robot.lines if line.startswith("told: ")]


async def test_action_tells_its_progress_and_its_result(ros2: Ros2Space, turner: Child) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        execution_id = skilled.begin(TURN, 20.0, 0.5)
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (20.0,))
        progress = [fact.progress for fact in skilled.facts(execution_id) if isinstance(fact, ExecutionProgressed)]
        assert progress == sorted(progress)
        assert len(progress) > 3
    assert turner.wait_for("told:").split() == ["told:", "20.0", execution_id.hex()], "the goal's id is the execution's"


@pytest.mark.parametrize(
    ("angle", "status", "message"),
    [
        (400.0, StatusCode.BAD_REQUEST_NOT_ALLOWED, "the action server refused the goal"),
        (-400.0, StatusCode.BAD_UNEXPECTED_ERROR, "dizzy"),
    ],
)
async def test_goal_that_is_refused_or_aborted(
    ros2: Ros2Space, turner: Child, angle: float, status: int, message: str
) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        execution_id = skilled.begin(TURN, angle, 0.0)
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, status, (), message)


async def test_goal_that_takes_too_long_is_canceled(ros2: Ros2Space, turner: Child) -> None:
    skills = {"turn": {**SKILLS["turn"], "timeout_s": 1.0}}
    async with skilled_driver(ros2.domain, skills) as skilled:
        execution_id = skilled.begin(TURN, 20.0, 30.0)
        ended = ExecutionEnded(execution_id, StatusCode.BAD_TIMEOUT, (), "it took longer than 1 s; it was canceled")
        assert await skilled.end(execution_id) == ended
    turner.wait_for("canceled")


async def test_goal_is_halted(ros2: Ros2Space, turner: Child) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        execution_id = skilled.begin(TURN, 20.0, 30.0)
        await skilled.until_at_it(execution_id)
        skilled.halt(TURN, execution_id)
        status = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT
        assert await skilled.end(execution_id) == ExecutionEnded(execution_id, status, (), "it was halted")
    turner.wait_for("canceled")


async def test_bridge_that_comes_later_asks_the_action_server(ros2: Ros2Space, turner: Child) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        done = skilled.begin(TURN, 1.0, 0.0)
        await skilled.end(done)
        under_way = skilled.begin(TURN, 2.0, 2.0)
        await skilled.until_at_it(under_way)
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        never = bytes(16)
        for execution_id in (done, under_way, never):
            skilled.driver.query(skilled.execution(TURN, 1.0, 2.0, execution_id=execution_id))
        assert await skilled.end(done) == ExecutionEnded(done, 0, (1.0,))
        assert isinstance(await skilled.end(never), ExecutionForgotten)
        assert await skilled.end(under_way) == ExecutionEnded(under_way, 0, (2.0,))
        assert isinstance(skilled.facts(under_way)[0], ExecutionProgressed)
    assert told(turner) == ["1.0", "2.0"]


async def test_server_that_was_restarted_remembers_no_goal(
    ros2: Ros2Space, turner: Child, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(action, "ASK_AGAIN_S", 0.5)
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        execution_id = skilled.begin(TURN, 20.0, 30.0)
        await skilled.until_at_it(execution_id)
        turner.end(signal.SIGKILL)
        again = ros2.node("turner.py")
        forgotten = await skilled.end(execution_id)
        assert forgotten == ExecutionForgotten(execution_id, "the server of /turn remembers no such goal")
    assert told(again) == []


async def test_killed_bridge_learns_the_truth_when_it_is_back(ros2: Ros2Space, turner: Child) -> None:
    robots = {"carrier": {"bridge": "mobile", "skill_status_id": 1000, "skills": SKILLS}}
    bridge = ros2.bridge(robots)
    config = FleetConfig.model_validate({"version": 1, "pubsub": ros2.fleet()["pubsub"]})
    async with requesting(config, ros2.folder) as requestor:
        target = Topic(ros2.domain, 2, TURN)
        asking = asyncio.ensure_future(requestor.invoke(target, (20.0, 3.0), 15.0))
        await until(lambda: told(turner), "the robot's beginning")
        bridge.end(signal.SIGKILL)
        ros2.bridge(robots)
        outcome = await asking
        assert (outcome.kind, outcome.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.DONE)
        assert [result.value for result in unpack(outcome.report.result)] == [20.0]
    assert told(turner) == ["20.0"], "once"


async def test_halt_that_was_asked_for_while_the_bridge_was_away_is_told(ros2: Ros2Space, turner: Child) -> None:
    robots = {"carrier": {"bridge": "mobile", "skill_status_id": 1000, "skills": SKILLS}}
    bridge = ros2.bridge(robots)
    config = FleetConfig.model_validate({"version": 1, "pubsub": ros2.fleet()["pubsub"]})
    async with requesting(config, ros2.folder) as requestor:
        target, execution_id = Topic(ros2.domain, 2, TURN), secrets.token_bytes(16)
        asking = asyncio.ensure_future(requestor.invoke(target, (20.0, 18.0), 20.0, execution_id))
        await until(lambda: told(turner), "the robot's beginning")
        bridge.end(signal.SIGKILL)
        requestor.commands.halt(target, "carrier", execution_id)
        ros2.bridge(robots)
        outcome = await asking
        assert (outcome.report.state, outcome.report.message) == (ExecutionState.FAILED, "it was halted")
    turner.wait_for("canceled")


async def test_robot_that_was_away_when_it_was_halted_is_told_when_it_is_back(ros2: Ros2Space, turner: Child) -> None:
    skills = {"turn": {**SKILLS["turn"], "timeout_s": 120.0}}
    async with skilled_driver(ros2.domain, skills) as skilled:
        under_way = skilled.begin(TURN, 20.0, 100.0)
        await skilled.until_at_it(under_way)
        turner.process.send_signal(signal.SIGSTOP)
        try:
            (port,) = skilled.driver._skills  # pyright: ignore[reportPrivateUsage]
            await until(lambda: port.absent, "the bridge's notice")
            skilled.halt(TURN, under_way)
        finally:
            turner.process.send_signal(signal.SIGCONT)
        end = await skilled.end(under_way)
        assert isinstance(end, ExecutionEnded)
        assert end.message == "it was halted"
    turner.wait_for("canceled")


@pytest.mark.parametrize("after_s", [0.0, 0.05])
async def test_halt_in_the_first_moments_of_a_bridge_is_told(ros2: Ros2Space, turner: Child, after_s: float) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        under_way = skilled.begin(TURN, 20.0, 18.0)
        await skilled.until_at_it(under_way)
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        skilled.driver.query(skilled.execution(TURN, 20.0, 18.0, execution_id=under_way))
        await asyncio.sleep(after_s)
        skilled.halt(TURN, under_way)
        end = await skilled.end(under_way)
        assert isinstance(end, ExecutionEnded)
        assert end.message == "it was halted"


async def test_halt_before_the_server_has_taken_the_goal_is_told_again(ros2: Ros2Space, turner: Child) -> None:
    async with skilled_driver(ros2.domain, SKILLS) as skilled:
        execution_id = skilled.begin(TURN, 360.0, 18.0)
        await asyncio.to_thread(turner.wait_for, "decides")
        skilled.halt(TURN, execution_id)
        end = await skilled.end(execution_id)
        assert isinstance(end, ExecutionEnded)
        assert end.message == "it was halted"
    turner.wait_for("canceled")


async def test_server_that_does_not_cancel_is_logged_once_and_told_again(ros2: Ros2Space, turner: Child) -> None:
    with capture_logs() as logs:
        async with skilled_driver(ros2.domain, SKILLS) as skilled:
            execution_id = skilled.begin(TURN, 359.0, 4.0)
            await skilled.until_at_it(execution_id)
            skilled.halt(TURN, execution_id)
            assert await skilled.end(execution_id) == ExecutionEnded(execution_id, 0, (359.0,))
    said = [entry for entry in logs if "does not cancel" in entry["event"]]
    # The last word may come to it when it has just done its goal: another answer, which is logged as well.
    assert [one["reason"] for one in said if one["reason"] != "the goal has ended"] == ["refused"]
    assert {(one["action"], one["skill"]) for one in said} == {("/turn", "carrier.turn")}
    assert turner.lines.count("is to cancel") > 1


async def test_goal_that_is_slow_to_stop_is_no_goal_that_is_not_canceled(ros2: Ros2Space, turner: Child) -> None:
    with capture_logs() as logs:
        async with skilled_driver(ros2.domain, SKILLS) as skilled:
            execution_id = skilled.begin(TURN, 358.0, 30.0)
            await skilled.until_at_it(execution_id)
            skilled.halt(TURN, execution_id)
            end = await skilled.end(execution_id)
            assert isinstance(end, ExecutionEnded)
            assert end.message == "it was halted"
    assert [entry for entry in logs if "does not cancel" in entry["event"]] == []
