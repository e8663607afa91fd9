"""Suspending: targets of the skill's own Action, whose requests name the execution by their argument."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.unit.bridge.test_actions import ACTION, ID, PICK, Bench, Robot
from ua_fleet.bridge import (
    Execution,
    ExecutionEnded,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
)
from ua_fleet.errors import SkillRejected
from ua_fleet.skill import ExecutionState, MemoryJournal
from ua_fleet.skill.executions import RESUME_TARGETS, SUSPEND_TARGETS
from ua_fleet.values import BuiltinType, StatusCode

S = ExecutionState
SUSPEND, RESUME = 1 | SUSPEND_TARGETS, 1 | RESUME_TARGETS


class PatientRobot(Robot):
    """A robot that stands and goes on when it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[str, Execution]] = []
        self.suspend_error: Exception | None = None

    def suspend(self, execution: Execution) -> None:
        self.told.append(("suspend", execution))
        if self.suspend_error is not None:
            raise self.suspend_error

    def resume(self, execution: Execution) -> None:
        self.told.append(("resume", execution))


def request(bench: Bench, target: int, number: int, execution_id: bytes | None = ID) -> None:
    bench.ask(number, (execution_id,), action_target_id=target, types=(int(BuiltinType.BYTE_STRING),))


def at_work() -> tuple[Bench, PatientRobot]:
    robot = PatientRobot()
    bench = Bench(robot=robot)
    bench.ask()
    return bench, robot


def state(bench: Bench) -> ExecutionState:
    """What SkillStatus shows of the execution."""
    return ExecutionState(bench.status()[2][0])


def test_it_is_announced_only_for_skills_in_which_a_robot_can_stand() -> None:
    robot = PatientRobot()
    targets = [(one.action_target_id, one.name) for one in Bench(robot=robot).announced()[0].targets]
    assert targets == [(1, "arm"), (0xC001, "arm, suspend"), (0xA001, "arm, resume")]
    robot.offered = (replace(PICK, can_suspend=False),)
    bench = Bench(robot=robot)
    assert [target.action_target_id for target in bench.announced()[0].targets] == [1]
    bench.ask()
    request(bench, SUSPEND, 3)
    assert bench.reports()[-1].status == StatusCode.BAD_NOT_SUPPORTED
    assert robot.told == []


def test_a_robot_stands_goes_on_and_stands_again() -> None:
    bench, robot = at_work()
    for _ in range(2):
        request(bench, SUSPEND, 3)  # a copy is not told again
    assert [(what, one.execution_id, one.topic) for what, one in robot.told] == [("suspend", ID, ACTION)]
    assert state(bench) is S.RUNNING, "that it stands is the robot's word"
    bench.tell(ExecutionSuspended(ID, "it stands"))
    assert (state(bench), bench.status()[5]) == (S.SUSPENDED, ("it stands",))
    bench.tell(ExecutionProgressed(ID, 0.5))
    assert (state(bench), bench.status()[3]) == (S.SUSPENDED, (0.5,))
    request(bench, RESUME, 4)
    bench.tell(ExecutionResumed(ID))
    assert state(bench) is S.RUNNING
    request(bench, SUSPEND, 5)
    assert [what for what, _ in robot.told] == ["suspend", "resume", "suspend"]
    assert [report.state for report in bench.reports()] == [S.RUNNING, *[S.DONE] * 4]


def test_who_asks_again_for_the_execution_hears_that_it_was_accepted() -> None:
    bench, _ = at_work()
    bench.tell(ExecutionSuspended(ID))
    bench.ask()
    assert [report.state for report in bench.reports()] == [S.RUNNING, S.RUNNING]


def test_what_stands_already_is_not_told_again_and_what_does_not_stand_cannot_go_on() -> None:
    bench, robot = at_work()
    request(bench, RESUME, 3)
    assert bench.reports()[-1].message == "that execution is not suspended"
    bench.tell(ExecutionSuspended(ID))
    request(bench, SUSPEND, 4)
    assert (bench.reports()[-1].state, robot.told) == (S.DONE, [])
    bench.tell(ExecutionEnded(ID, 0, (1.5,)))
    assert state(bench) is S.DONE
    for number, target in enumerate((SUSPEND, RESUME), start=5):
        request(bench, target, number)
        assert bench.reports()[-1].message == "that execution is not under way"


@pytest.mark.parametrize("named", [None, b"", b"short", bytes(16)])
def test_what_names_no_execution_is_refused(named: bytes | None) -> None:
    bench, robot = at_work()
    request(bench, SUSPEND, 3, named)
    assert bench.reports()[-1].state is S.REFUSED
    assert robot.told == []


def test_an_execution_of_another_skill_is_not_suspended_here() -> None:
    robot = PatientRobot()
    robot.offered = (PICK, replace(PICK, topic=ACTION._replace(id=1502), name="place"))
    bench = Bench(robot=robot)
    bench.ask(data_set_writer_id=1502)
    assert len(robot.begun) == 1
    request(bench, SUSPEND, 3)
    assert bench.reports()[-1].message == "that execution is not under way"
    assert robot.told == []


def test_a_robot_that_cannot_stand_now_goes_on() -> None:
    bench, robot = at_work()
    robot.suspend_error = SkillRejected("it holds a load")
    request(bench, SUSPEND, 3)
    assert (bench.reports()[-1].state, bench.reports()[-1].message) == (S.REFUSED, "it holds a load")
    robot.suspend_error = KeyError("x")
    request(bench, SUSPEND, 4)
    assert bench.reports()[-1].state is S.UNKNOWN
    assert bench.failures == ["the driver failed while it suspended an execution"]
    assert state(bench) is S.RUNNING


def test_a_bridge_that_was_started_anew_asks_and_hears_that_the_robot_stands() -> None:
    journal = MemoryJournal()
    bench = Bench(robot=PatientRobot(), journal=journal)
    bench.ask()
    bench.tell(ExecutionSuspended(ID))
    later = Bench(robot=PatientRobot(), journal=journal)
    assert (state(later), len(later.robot.asked)) == (S.ASKING, 1)
    later.tell(ExecutionSuspended(ID))
    assert state(later) is S.SUSPENDED
    later.tell(ExecutionNotBegun(ID))
    assert (state(later), later.robot.begun) == (S.SUSPENDED, []), "what stands was begun"


def test_the_answer_of_an_immediate_skill_waits_while_its_robot_stands() -> None:
    robot = PatientRobot()
    robot.offered = (replace(PICK, is_immediate=True),)
    bench = Bench(robot=robot)
    bench.ask()
    bench.tell(ExecutionSuspended(ID))
    bench.ask()
    assert bench.reports() == []
    bench.tell(ExecutionEnded(ID, 0, (1.5,)))
    assert [report.state for report in bench.reports()] == [S.DONE]
