"""The contract of `ua_fleet.bridge.driver.SkillDriver`, for drivers whose space keeps `harness.SkillSpace`."""

from __future__ import annotations

import secrets
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.contract.harness import Recorder, SkillCase, SkillSpace, Space, until
from ua_fleet.bridge import (
    Driver,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    SkillDriver,
)
from ua_fleet.errors import SkillError
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.skill.executions import pack
from ua_fleet.values import Quality, quality_of

FACTS = (ExecutionProgressed, ExecutionEnded, ExecutionForgotten, ExecutionNotBegun)


@pytest.fixture
def skilled(space: Space) -> SkillSpace:
    """The space of a driver with skills."""
    if not isinstance(space, SkillSpace):
        pytest.skip("the robots of this space have no skills")
    return space


class Started:
    """A started driver with what it said of executions."""

    def __init__(self, driver: Driver, recorder: Recorder) -> None:
        assert isinstance(driver, SkillDriver)
        self.driver, self._recorder = driver, recorder

    def said(self, execution: Execution, *kinds: type[Any]) -> list[Any]:
        """What was said of an execution, in order."""
        facts = [event for event in list(self._recorder.events) if isinstance(event, FACTS)]
        return [
            fact for fact in facts if fact.execution_id == execution.execution_id and isinstance(fact, kinds or FACTS)
        ]

    async def end(self, execution: Execution) -> ExecutionEnded:
        """The end of an execution, once it came."""
        await until(lambda: self.said(execution, ExecutionEnded), "ExecutionEnded")
        ended: ExecutionEnded = self.said(execution, ExecutionEnded)[0]
        return ended


@asynccontextmanager
async def started(space: SkillSpace) -> AsyncGenerator[Started]:
    driver, recorder = space.make_driver(), Recorder()
    await driver.start(recorder)
    try:
        yield Started(driver, recorder)
    finally:
        await driver.stop()


def execution(case: SkillCase, values: tuple[Any, ...]) -> Execution:
    return Execution(secrets.token_bytes(16), case.topic, case.target_id, values, 10.0)


async def test_skills_are_complete_and_their_ids_are_unique(skilled: SkillSpace) -> None:
    async with started(skilled) as running:
        skills = running.driver.skills()
        assert skills
        topics = [skill.topic for skill in skills]
        statuses = {target.status for skill in skills for target in skill.targets}
        assert len({topic.id for topic in topics} | {topic.id for topic in statuses}) == len(topics) + len(statuses)
        for skill in skills:
            assert {skill.topic.space, *(target.status.space for target in skill.targets)} == {skilled.number}
            assert skill.targets
            assert len({target.id for target in skill.targets}) == len(skill.targets)
            assert skill.name
        assert list(running.driver.skills()) == list(skills), "what has not changed is equal"


async def test_an_execution_is_begun_once_and_ends_once_with_its_results(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    async with started(skilled) as running:
        [skill] = [skill for skill in running.driver.skills() if skill.topic == case.topic]
        one = execution(case, case.succeeds)
        running.driver.execute(one)
        ended = await running.end(one)
        assert quality_of(ended.status) is Quality.GOOD
        assert pack(type_codes(skill.response), ended.values), "results of the types that were announced"
        assert running.said(one)[-1] == ended, "nothing is said after the end"
        assert skilled.begun(one.execution_id) == 1
        assert len(running.said(one, ExecutionEnded)) == 1


async def test_several_executions_end_each(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    async with started(skilled) as running:
        several = [execution(case, case.succeeds) for _ in range(3)]
        for one in several:
            running.driver.execute(one)
            await running.end(one)
        assert [skilled.begun(one.execution_id) for one in several] == [1, 1, 1]


async def test_a_robot_that_fails_is_told_with_a_reason(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    async with started(skilled) as running:
        one = execution(case, case.fails)
        running.driver.execute(one)
        ended = await running.end(one)
        assert quality_of(ended.status) is Quality.BAD
        assert ended.message
        assert "\n" not in ended.message


async def test_what_is_refused_is_not_begun(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    async with started(skilled) as running:
        one = execution(case, case.refused)
        with pytest.raises(SkillError) as refused:
            running.driver.execute(one)
        assert str(refused.value)
        assert "\n" not in str(refused.value)
        assert skilled.begun(one.execution_id) == 0
        assert running.said(one) == []


async def test_another_driver_finds_out_what_became_of_an_execution(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    one, before = execution(case, case.lasts), execution(case, case.succeeds)
    async with started(skilled) as running:
        running.driver.execute(before)
        await running.end(before)
        running.driver.execute(one)
    async with started(skilled) as running:
        for execution_before in (before, one):
            running.driver.query(execution_before)
            await until(lambda it=execution_before: running.said(it), "an answer")  # type: ignore[misc]  # no type for the default
        if not running.said(before, ExecutionForgotten):
            assert quality_of((await running.end(before)).status) is Quality.GOOD
        if not running.said(one, ExecutionForgotten):
            await running.end(one)
    assert [skilled.begun(before.execution_id), skilled.begun(one.execution_id)] == [1, 1], "asking begins nothing"


async def test_of_what_it_never_heard_a_robot_cannot_tell(skilled: SkillSpace) -> None:
    async with started(skilled) as running:
        one = execution(skilled.skill_case, skilled.skill_case.succeeds)
        running.driver.query(one)
        await until(lambda: running.said(one), "an answer")
        assert not running.said(one, ExecutionEnded, ExecutionProgressed)
    assert skilled.begun(one.execution_id) == 0


async def test_a_stopped_driver_says_nothing_more(skilled: SkillSpace) -> None:
    case = skilled.skill_case
    one = execution(case, case.lasts)
    async with started(skilled) as running:
        running.driver.execute(one)
    said = running.said(one)
    async with started(skilled) as another:
        await until(lambda: skilled.begun(one.execution_id) == 1, "the robot's work")
        two = execution(case, case.succeeds)
        another.driver.execute(two)
        await another.end(two)
    assert running.said(one) == said
