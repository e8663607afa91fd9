"""What drivers say of executions means what the words mean, since others begin and stop by it.

`tests/integration/ur` and `tests/unit/bridges/ur/test_tasks.py` have the same questions for a Universal Robots arm.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from tests.contract.harness import FAULT_ID, SkilledSpace
from tests.contract.test_skills import Started, started
from ua_fleet.bridge import Execution, ExecutionEnded, ExecutionForgotten, SampleRead
from ua_fleet.errors import SkillError
from ua_fleet.values import StatusCode

BUSY = (StatusCode.BAD_TOO_MANY_OPERATIONS, StatusCode.BAD_SERVER_TOO_BUSY)
SEEN_S = 0.6
"""A driver that says too much says it at once."""


async def at_work(one: Started) -> Execution:
    execution = one.begin("never ends", 0.0)
    await one.at_it(execution)
    return execution


async def test_a_robot_that_heeds_no_halt_is_never_reported_as_halted(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        if not one.driver.can_halt:
            pytest.skip("the driver's robots cannot be stopped")
        execution = await at_work(one)
        skilled_space.freeze()
        with suppress(SkillError):
            one.driver.halt(execution)
        await asyncio.sleep(SEEN_S)
        assert not [fact for fact in one.facts(execution) if isinstance(fact, ExecutionEnded)]


async def test_a_robot_that_does_one_thing_at_a_time_is_busy(skilled_space: SkilledSpace) -> None:
    async with started(skilled_space) as one:
        await at_work(one)
        second = one.execution("weld", 0.0)
        try:
            one.driver.execute(second)
        except SkillError as error:
            status = error.ua_status
        else:
            ended = await one.end(second)
            status = ended.status if isinstance(ended, ExecutionEnded) else int(StatusCode.UNCERTAIN)
        assert status in (0, *BUSY)


async def test_a_link_that_breaks_is_silence(skilled_space: SkilledSpace) -> None:
    """What was begun is under way, or unknown; and the robot has announced nothing."""
    async with started(skilled_space) as one:
        execution = await at_work(one)
        await asyncio.to_thread(skilled_space.cut)
        await asyncio.sleep(SEEN_S)
        ends = [fact for fact in one.facts(execution) if not isinstance(fact, ExecutionForgotten)]
        assert not [fact for fact in ends if isinstance(fact, ExecutionEnded)]
        samples = [event for event in list(one.recorder.events) if isinstance(event, SampleRead)]
        assert not [sample for sample in samples if sample.topic.id == FAULT_ID and any(sample.values)]
