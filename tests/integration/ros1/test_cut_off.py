"""A robot whose network goes and comes back. Nobody helps."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Collection, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import system
from tests.integration.actions.requesting import requesting
from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.integration.ros1.skilled import COUNT, DRIVE, HOLD, MOVE, Robot
from tests.network import Cable, cable
from ua_fleet.config.schema import FleetConfig
from ua_fleet.skill.executions import ExecutionState, OutcomeKind

pytestmark = [pytest.mark.needs("ros1"), pytest.mark.needs("netns")]

EACH: dict[int, tuple[Any, ...]] = {MOVE: (1.0,), HOLD: (True,), COUNT: (1,), DRIVE: ("dock", 0.0)}
"""A skill of each kind: by a topic, a service, an action, and the robot's own program."""
HEALED_S = 15.0
"""rospy asks 60 s after the last word whether its link is still there, and then forgets it: that may not be needed."""


@pytest.fixture
def wire() -> Iterator[Cable]:
    with cable() as laid:
        yield laid


@pytest.fixture
async def robot(processes: system.Processes, tmp_path: Path, udp_url: str, wire: Cable) -> AsyncIterator[Robot]:
    """A robot and its master at the far end of a cable, that has done each of its skills."""
    graph = Ros1Graph(processes, tmp_path, udp_url, wire)
    config = FleetConfig.model_validate({"version": 1, "pubsub": {"security": "none", "url": udp_url}})
    graph.master()
    async with requesting(config, tmp_path) as requestor:
        robot = await asyncio.to_thread(Robot, graph, requestor)
        for skill, values in EACH.items():
            assert (await robot.do(skill, *values))[0] is ExecutionState.DONE
        yield robot


async def does_again(robot: Robot, skills: Collection[int]) -> None:
    """Ask for each of these skills until it is taken; it has to be done then."""
    deadline = time.monotonic() + HEALED_S
    for skill in skills:
        while True:
            execution_id = secrets.token_bytes(16)
            outcome = await robot.ask(skill, *EACH[skill], execution_id=execution_id)
            if outcome.kind is OutcomeKind.ACCEPTED:
                break
            assert time.monotonic() < deadline, outcome
            await asyncio.sleep(0.2)
        assert (await robot.end(execution_id))[0] is ExecutionState.DONE


async def test_robot_whose_cable_was_out_does_each_of_its_skills_again(robot: Robot, wire: Cable) -> None:
    wire.unplug()
    await asyncio.sleep(10.0)
    refused = await robot.ask(MOVE, *EACH[MOVE])
    assert refused.kind is OutcomeKind.REFUSED, refused
    assert "no subscriber of /move answers" in refused.report.message
    wire.plug()
    await does_again(robot, EACH)


async def test_command_that_a_network_without_a_word_has_swallowed_is_not_delivered_later(
    robot: Robot, wire: Cable
) -> None:
    told = robot.told().count("move 3.0 0.5")
    wire.drop()
    outcome = await robot.ask(MOVE, 3.0)
    assert outcome.kind is OutcomeKind.ACCEPTED, "nobody knows yet"
    await asyncio.to_thread(robot.bridge.wait_for, "/move: /skilled has not got what was published", 30)
    wire.pass_on()
    await does_again(robot, EACH.keys() - {MOVE})
    assert told == robot.told().count("move 3.0 0.5") == 0
