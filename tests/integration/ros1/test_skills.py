"""Skills in ROS 1 with a real robot, through the bridge as a process and a requestor of commands."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.actions.requesting import requesting
from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.integration.ros1.skilled import COUNT, DRIVE, FAIL, HOLD, MOVE, NO, Robot
from tests.waiting import until
from ua_fleet.config.schema import FleetConfig
from ua_fleet.skill.executions import ExecutionState, OutcomeKind, halt_id
from ua_fleet.values import StatusCode

pytestmark = pytest.mark.needs("ros1")

DONE, FAILED, UNKNOWN = ExecutionState.DONE, ExecutionState.FAILED, ExecutionState.UNKNOWN


@pytest.fixture
async def robot(graph: Ros1Graph, tmp_path: Path) -> AsyncIterator[Robot]:
    config = FleetConfig.model_validate({"version": 1, "pubsub": {"security": "none", "url": graph.pubsub_url}})
    graph.master()
    async with requesting(config, tmp_path) as requestor:
        yield await asyncio.to_thread(Robot, graph, requestor)


async def test_topic_skill_ends_as_the_robot_says(robot: Robot) -> None:
    assert await robot.do(MOVE, 1.0) == (DONE, {}, "arrived")
    for _ in range(2):  # the state of the first time is no answer to the second
        assert await robot.do(MOVE, 2.0) == (FAILED, {}, "stuck")
    assert robot.told() == ["move 1.0 0.5", "move 2.0 0.5", "move 2.0 0.5"]


async def test_topic_skill_that_takes_too_long_is_stopped(robot: Robot) -> None:
    state, _, message = await robot.do(MOVE, 3.0)
    assert (state, message) == (FAILED, "it took longer than 2 s; it was told to stop")
    await until(lambda: robot.told() == ["move 3.0 0.5", "move 0.0 0.0"])


async def test_service_skill_ends_with_its_response(robot: Robot) -> None:
    assert await robot.do(HOLD, True) == (DONE, {}, "held")
    assert await robot.do(NO) == (FAILED, {}, "there is nothing to do")
    state, _, message = await robot.do(FAIL)
    assert state is FAILED
    assert "the gripper is stuck" in message
    state, _, message = await robot.do(HOLD, False)
    assert (state, message) == (FAILED, "it took longer than 1 s; see what the robot does")
    assert robot.told() == ["hold True", "no", "fail", "hold False"]


async def test_action_skill_ends_with_its_result(robot: Robot) -> None:
    assert await robot.do(COUNT, 3) == (DONE, {"counted": 3}, "counted")
    assert await robot.do(COUNT, 98) == (FAILED, {}, "lost count")
    assert await robot.do(COUNT, 99) == (FAILED, {}, "no way")
    assert robot.told() == ["count 3", "count 98", "count 99"]


async def test_program_does_a_skill_once(robot: Robot) -> None:
    assert await robot.do(DRIVE, "dock", 0.5) == (DONE, {"distance": 2.5}, "")
    state, _, message = await robot.do(DRIVE, "the wall", 0.0)
    assert (state, message) == (FAILED, "RuntimeError: bumped")
    assert await robot.do(DRIVE, "the moon", 0.0) == (FAILED, {}, "no way to the moon")
    assert robot.told() == ["drive dock", "drive the wall", "drive the moon"]


@pytest.mark.parametrize(("skill", "values"), [(MOVE, (3.0,)), (COUNT, (50,)), (DRIVE, ("dock", 5.0))])
async def test_robot_is_halted(robot: Robot, skill: int, values: tuple[Any, ...]) -> None:
    execution_id = await robot.begin(skill, *values)
    robot.halt(skill, execution_id)
    state, _, message = await robot.end(execution_id)
    assert (state, message) == (FAILED, "it was halted")


@pytest.mark.parametrize(
    ("skill", "values", "state", "results"),
    [
        (MOVE, (4.0,), UNKNOWN, {}),
        (HOLD, (False,), UNKNOWN, {}),
        (COUNT, (96,), DONE, {"counted": 96}),
        (DRIVE, ("dock", 2.0), DONE, {"distance": 2.5}),
    ],
)
async def test_killed_bridge_finds_out_what_became_of_it(
    robot: Robot, skill: int, values: tuple[Any, ...], state: ExecutionState, results: dict[str, Any]
) -> None:
    execution_id = await robot.begin(skill, *values)
    before = robot.graph.links("/skilled", "/count/result")
    await asyncio.to_thread(robot.restart_bridge)
    # A goal that ends while no bridge listens tells its result to nobody.
    await until(lambda: robot.graph.links("/skilled", "/count/result") - before)
    robot.node.process.send_signal(signal.SIGUSR1)
    ended = await robot.end(execution_id)
    assert ended[:2] == (state, results), ended
    await asyncio.sleep(1.0)
    assert len(robot.told()) == 1, "never twice"


@pytest.mark.parametrize(("skill", "values"), [(COUNT, (400,)), (DRIVE, ("dock", 9.0))])
async def test_halt_that_was_asked_for_while_the_bridge_was_away_is_told(
    robot: Robot, skill: int, values: tuple[Any, ...]
) -> None:
    execution_id = await robot.begin(skill, *values)
    robot.bridge.end(signal.SIGKILL)
    robot.halt(skill, execution_id)
    await asyncio.to_thread(robot.restart_bridge)
    state, _, message = await robot.end(execution_id)
    assert (state, message) == (FAILED, "it was halted")


async def test_robot_that_was_away_when_it_was_halted_is_told_when_it_is_back(robot: Robot) -> None:
    execution_id = await robot.begin(COUNT, 400)
    robot.bridge.end(signal.SIGKILL)
    robot.node.process.send_signal(signal.SIGSTOP)
    try:
        await asyncio.to_thread(robot.restart_bridge)
        robot.halt(COUNT, execution_id)
        halting = await robot.outcome(halt_id(execution_id))
    finally:
        robot.node.process.send_signal(signal.SIGCONT)
    assert (halting.kind, halting.report.state) == (OutcomeKind.ACCEPTED, DONE), "the robot will be told"
    state, _, message = await robot.end(execution_id)
    assert (state, message) == (FAILED, "it was halted")


async def test_goal_that_ended_while_the_bridge_was_away_is_done(robot: Robot) -> None:
    execution_id = await robot.begin(COUNT, 3)
    robot.bridge.end(signal.SIGKILL)
    await asyncio.sleep(0.5)
    await asyncio.to_thread(robot.restart_bridge)
    assert await robot.end(execution_id) == (
        DONE,
        {},
        "it is done; its results came while the bridge was not connected",
    )
    assert len(robot.told()) == 1


async def test_robot_that_is_restarted_knows_nothing(robot: Robot) -> None:
    executions = [await robot.begin(DRIVE, "dock", 30.0), await robot.begin(COUNT, 97)]
    robot.node.end(signal.SIGKILL)
    robot.node = await asyncio.to_thread(robot.graph.node, "skilled.py")
    for execution_id in executions:
        state, _, message = await robot.end(execution_id)
        assert state is UNKNOWN, message
    assert robot.told() == []


async def test_restarted_master_disturbs_no_execution(graph: Ros1Graph, tmp_path: Path) -> None:
    config = FleetConfig.model_validate({"version": 1, "pubsub": {"security": "none", "url": graph.pubsub_url}})
    master = graph.master()
    async with requesting(config, tmp_path) as requestor:
        robot = await asyncio.to_thread(Robot, graph, requestor)
        assert await robot.do(HOLD, True) == (DONE, {}, "held")
        executions = [await robot.begin(DRIVE, "dock", 3.0), await robot.begin(COUNT, 30)]
        master.end()
        assert await robot.do(HOLD, True) == (DONE, {}, "held")  # where it was last
        graph.master()
        for execution_id in executions:
            assert (await robot.end(execution_id))[0] is DONE
        assert await robot.do(MOVE, 1.0) == (DONE, {}, "arrived")  # links do not need the master
    assert len(robot.told()) == 5


async def test_what_is_absent_is_named(graph: Ros1Graph, tmp_path: Path) -> None:
    config = FleetConfig.model_validate({"version": 1, "pubsub": {"security": "none", "url": graph.pubsub_url}})
    graph.master()
    async with requesting(config, tmp_path) as requestor:
        robot = await asyncio.to_thread(Robot, graph, requestor)
        robot.node.end(signal.SIGINT)
        await asyncio.sleep(3.5)
        for skill, values, said in (
            (HOLD, (True,), "there is no service /hold; start the robot's node"),
            (MOVE, (1.0,), "/move has no subscriber; start the robot's node"),
            (COUNT, (1,), "there is no action server /count; start the robot's node"),
            (DRIVE, ("dock", 0.0), "(/ua_1_2_1010 has no publisher)"),
        ):
            refused = await robot.ask(skill, *values)
            assert refused.kind is OutcomeKind.REFUSED
            assert refused.report.status == StatusCode.BAD_NO_COMMUNICATION
            assert said in refused.report.message
