"""Skills of a real bridge, asked for over real UDP."""

from __future__ import annotations

from typing import Any

import pytest

from tests.contract.skilled import ENDLESS_WORK, FAILING_WORK, REFUSED_WORK, STATUS
from tests.integration.actions.conftest import QUICK_ACTION, SPACE, Cell, work
from tests.waiting import until
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.skill.executions import ExecutionState, OutcomeKind, unpack
from ua_fleet.skill.status import read_result
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode


async def test_a_skill_is_accepted_and_done_once(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        outcome = await work(requestor, "weld", 0.0)
        assert outcome.kind is OutcomeKind.ACCEPTED
        again = [await work(requestor, f"weld {number}", 0.0) for number in range(5)]
    assert [one.kind for one in again] == [OutcomeKind.ACCEPTED] * 5
    assert cell.told() == ["weld", *[f"weld {number}" for number in range(5)]]
    assert requestor.commands.outcomes == {"accepted": 6}


async def test_an_immediate_skill_answers_with_its_result(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        outcome = await work(requestor, "measure", 0.2, action=QUICK_ACTION)
    assert (outcome.kind, outcome.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.DONE)
    assert [result.value for result in unpack(outcome.report.result)] == ["measure", 0.2]


async def test_an_immediate_skill_that_fails_says_why(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        outcome = await work(requestor, FAILING_WORK, 0.1, action=QUICK_ACTION)
    assert (outcome.kind, outcome.report.state) == (OutcomeKind.ACCEPTED, ExecutionState.FAILED)
    assert (outcome.report.status, outcome.report.message) == (StatusCode.BAD_OUT_OF_SERVICE, "the machine broke")


async def test_what_the_robot_refuses_is_refused_and_never_begun(cell: Cell) -> None:
    cell.bridge()
    async with cell.requestor() as requestor:
        outcome = await work(requestor, REFUSED_WORK, 0.0)
        assert outcome.kind is OutcomeKind.REFUSED
        assert outcome.report.message == "the machine does not do that"
        with pytest.raises(SkillRejected, match="work takes 'seconds', which is not given"):
            await work(requestor, "weld")
        with pytest.raises(SkillRejected, match="work"):
            await work(requestor, "weld", "not a number")
    assert cell.told() == []


async def test_a_bridge_that_is_not_there_is_told(cell: Cell) -> None:
    async with cell.requestor() as requestor:
        with pytest.raises(RobotOffline, match="no bridge announces the Action ua_300_2_1900; check that the bridge"):
            await work(requestor, "weld", 0.0, timeout_s=0.3)


async def test_skill_status_says_how_far_each_execution_is_through_a_restart(cell: Cell) -> None:
    bridge = cell.bridge()
    status = Topic(SPACE, 2, STATUS)

    def states() -> list[tuple[str, int, float, dict[str, Any], str]]:
        message = requestor.status.get(status)
        if message is None:
            return []
        _, skills, states, progress, results, messages, _ = message.values
        return list(zip(skills, states, progress, map(read_result, results), messages, strict=True))

    done: tuple[Any, ...] = ("work", ExecutionState.DONE, 1.0, {"done": "weld", "seconds": 0.0}, "")
    failed: tuple[Any, ...] = ("work", ExecutionState.FAILED, 0.0, {}, "the machine broke")
    refused: tuple[Any, ...] = ("work", ExecutionState.REFUSED, 0.0, {}, "the machine does not do that")
    async with cell.requestor() as requestor:
        for one in ("weld", FAILING_WORK, REFUSED_WORK, ENDLESS_WORK):
            await work(requestor, one, 0.0)
        await until(lambda: states() == [done, failed, refused, ("work", ExecutionState.RUNNING, 0.5, {}, "working")])
        bridge.end()
        requestor.status.clear()
        cell.bridge()
        await until(lambda: [state[:2] for state in states()][-1:] == [("work", ExecutionState.RUNNING)])
        assert states()[:3] == [done, failed, refused]
