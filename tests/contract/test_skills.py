"""The contract of a `ua_fleet.bridge.Driver` with skills, and of halting and suspending where it can have that done."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.contract.harness import Recorder, SkilledSpace
from tests.waiting import until
from ua_fleet.bridge import (
    Driver,
    Execution,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
)
from ua_fleet.errors import SkillError
from ua_fleet.values import Quality, StatusCode, quality_of

ON_THE_WAY = (ExecutionProgressed, ExecutionSuspended, ExecutionResumed)
FACTS = (ExecutionEnded, ExecutionForgotten, ExecutionNotBegun, *ON_THE_WAY)


class Started:
    """A started driver, and what it has told."""

    def __init__(self, driver: Driver, recorder: Recorder) -> None:
        assert driver.has_skills
        self.driver = driver
        self.recorder = recorder

    def execution(self, *values: Any, execution_id: bytes | None = None) -> Execution:
        """An execution of the skill `work`."""
        skill = next(skill for skill in self.driver.skills() if skill.name == "work")
        return Execution(execution_id or secrets.token_bytes(16), skill.topic, skill.targets[0].id, values, 20.0)

    def begin(self, *values: Any) -> Execution:
        """Begin one."""
        execution = self.execution(*values)
        self.driver.execute(execution)
        return execution

    def facts(self, execution: Execution) -> list[ExecutionFact]:
        """What was told of it."""
        events = list(self.recorder.events)
        return [event for event in events if isinstance(event, FACTS) and event.execution_id == execution.execution_id]

    async def at_it(self, execution: Execution) -> None:
        """Wait until the robot is at it."""
        await until(lambda: self.facts(execution), "the robot's beginning")

    async def says(self, execution: Execution, *facts: ExecutionFact) -> None:
        """Wait until the robot has told these, among its progress."""

        def told() -> list[ExecutionFact]:
            said = [fact for fact in self.facts(execution) if not isinstance(fact, ExecutionProgressed)]
            return [fact._replace(message="") if isinstance(fact, ExecutionSuspended) else fact for fact in said]

        await until(lambda: told() == list(facts), f"{facts}, and not {told()}")

    async def end(self, execution: Execution) -> ExecutionFact:
        """The one fact that is of no way station; it is the last."""

        def ends() -> list[ExecutionFact]:
            return [fact for fact in self.facts(execution) if not isinstance(fact, ON_THE_WAY)]

        await until(ends, "the end")
        await asyncio.sleep(0.2)
        assert len(ends()) == 1
        assert self.facts(execution)[-1] == ends()[0]
        return ends()[0]


@asynccontextmanager
async def started(space: SkilledSpace) -> AsyncGenerator[Started]:
    driver, recorder = space.make_driver(), Recorder()
    await driver.start(recorder)
    try:
        yield Started(driver, recorder)
    finally:
        await driver.stop()


async def test_skill_is_offered_with_its_fields_and_targets(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        skill = next(skill for skill in one.driver.skills() if skill.name == "work")
        assert [field.name for field in skill.request] == ["work", "seconds"]
        assert [field.name for field in skill.response] == ["done", "seconds"]
        (target,) = skill.targets
        assert target.name == "machine"
        assert target.status.space == skill.topic.space
        assert target.status.id != skill.topic.id


async def test_what_is_begun_ends_once_with_its_results(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        execution = one.begin("weld", 0.3)
        assert await one.end(execution) == ExecutionEnded(execution.execution_id, 0, ("weld", 0.3))
        assert isinstance(one.facts(execution)[0], ExecutionProgressed)
    assert skilled_space.told() == ["weld"]


async def test_one_after_the_other(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        for number in range(5):
            execution = one.begin(f"weld {number}", 0.0)
            assert await one.end(execution) == ExecutionEnded(execution.execution_id, 0, (f"weld {number}", 0.0))
    assert skilled_space.told() == [f"weld {number}" for number in range(5)]


async def test_what_fails_says_why(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        ended = await one.end(one.begin("fail", 0.0))
        assert isinstance(ended, ExecutionEnded)
        assert quality_of(ended.status) is Quality.BAD
        assert ended.values == ()
        assert "the machine broke" in ended.message


async def test_what_is_refused_is_not_done(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        execution, said = one.execution("refuse", 0.0), ""
        try:
            one.driver.execute(execution)
        except SkillError as error:
            said = str(error)
        else:
            ended = await one.end(execution)
            assert isinstance(ended, ExecutionEnded)
            assert quality_of(ended.status) is Quality.BAD
            said = ended.message
        assert said == "the machine does not do that"
    assert skilled_space.told() == []


async def test_driver_that_comes_later_finds_out_what_became_of_it(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        ended = one.begin("weld", 0.0)
        await one.end(ended)
        under_way = one.begin("polish", 1.5)
        await one.at_it(under_way)
    async with started(skilled_space) as other:
        for execution in (ended, under_way):
            other.driver.query(execution)
        if not skilled_space.remembers:
            assert [type(await other.end(execution)) for execution in (ended, under_way)] == [ExecutionForgotten] * 2
            return
        assert await other.end(ended) == ExecutionEnded(ended.execution_id, 0, ("weld", 0.0))
        assert await other.end(under_way) == ExecutionEnded(under_way.execution_id, 0, ("polish", 1.5))
    assert skilled_space.told() == ["weld", "polish"]


async def test_what_the_robot_never_heard_of_is_not_done(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        execution = one.execution("weld", 0.0)
        one.driver.query(execution)
        assert isinstance(await one.end(execution), ExecutionForgotten | ExecutionNotBegun)
    assert skilled_space.told() == []


async def test_what_is_halted_ends(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        if not one.driver.can_halt:
            pytest.skip("the driver's robots cannot be stopped")
        execution = one.begin("never ends", 0.0)
        await one.at_it(execution)
        one.driver.halt(execution)
        ended = await one.end(execution)
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT


async def test_what_is_suspended_stands_and_goes_on_and_can_be_halted(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        if not one.driver.can_suspend or not one.driver.can_halt:
            pytest.skip("the driver's robots cannot stand in the middle of what they do")
        execution = one.begin("never ends", 0.0)
        await one.at_it(execution)
        suspended, resumed = ExecutionSuspended(execution.execution_id), ExecutionResumed(execution.execution_id)
        one.driver.suspend(execution)
        await one.says(execution, suspended)
        one.driver.resume(execution)
        await one.says(execution, suspended, resumed)
        one.driver.suspend(execution)
        await one.says(execution, suspended, resumed, suspended)
        one.driver.halt(execution)
        ended = await one.end(execution)
        assert isinstance(ended, ExecutionEnded)
        assert ended.status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT


async def test_driver_that_comes_later_finds_that_the_robot_stands(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        if not one.driver.can_suspend:
            pytest.skip("the driver's robots cannot stand in the middle of what they do")
        execution = one.begin("never ends", 0.0)
        await one.at_it(execution)
        one.driver.suspend(execution)
        await one.says(execution, ExecutionSuspended(execution.execution_id))
    async with started(skilled_space) as other:
        other.driver.query(execution)
        await other.says(execution, ExecutionSuspended(execution.execution_id))
        assert not [fact for fact in other.facts(execution) if isinstance(fact, ExecutionEnded | ExecutionForgotten)]
