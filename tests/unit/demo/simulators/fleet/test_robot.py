"""The virtual robot is a driver with skills."""

from __future__ import annotations

import pytest
from ua_demo.simulators.fleet.robot import VirtualRobot

from ua_fleet.bridge.driver import Execution, ExecutionEnded, ExecutionForgotten, Skill
from ua_fleet.errors import SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.values import Quality, quality_of

SKILL = Skill(Topic(256, 2, 3), "work", ())


def execution(number: int) -> Execution:
    return Execution(number.to_bytes(16), SKILL.topic, 1, (1.5,))


def test_it_does_everything_in_three_seconds() -> None:
    now = [10.0]
    robot = VirtualRobot(SKILL, lambda: now[0], fails=False)
    assert robot.has_skills
    assert list(robot.skills()) == [SKILL]
    assert robot.next_deadline() is None
    robot.execute(execution(1))
    now[0] = 11.0
    robot.execute(execution(2))
    assert robot.next_deadline() == 13.0
    assert robot.poll(12.9) == []
    assert robot.poll(13.0) == [ExecutionEnded(execution(1).execution_id)]
    robot.query(execution(2))
    robot.query(execution(1))
    (forgotten,) = robot.poll(13.1)
    assert isinstance(forgotten, ExecutionForgotten)
    assert forgotten.execution_id == execution(1).execution_id


def test_one_that_fails_does_so_halfway_and_stays_broken() -> None:
    robot = VirtualRobot(SKILL, lambda: 0.0, fails=True)
    robot.execute(execution(1))
    (ended,) = robot.poll(1.5)
    assert isinstance(ended, ExecutionEnded)
    assert quality_of(ended.status) is Quality.BAD
    with pytest.raises(SkillRejected, match="its drive has failed"):
        robot.execute(execution(2))
