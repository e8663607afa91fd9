"""Halting: a target of the skill's own Action, whose request names the execution by its id."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.unit.bridge.test_actions import ACTION, ID, PICK, Bench, FullDisk, Robot
from ua_fleet.bridge import Execution, ExecutionEnded
from ua_fleet.errors import SkillRejected
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.skill import ExecutionState, MemoryJournal, ResponderLimits
from ua_fleet.skill.executions import HALT_TARGETS, halt_id
from ua_fleet.values import StatusCode

S = ExecutionState


class StoppableRobot(Robot):
    """A robot that stops when it is told to."""

    def __init__(self) -> None:
        super().__init__()
        self.halted: list[Execution] = []
        self.halt_error: Exception | None = None

    def halt(self, execution: Execution) -> None:
        self.halted.append(execution)
        if self.halt_error is not None:
            raise self.halt_error


def ask_to_halt(bench: Bench, execution_id: bytes = ID, **rest: Any) -> None:
    options: dict[str, Any] = {
        "action_target_id": 1 | HALT_TARGETS,
        "types": (),
        "correlation_data": halt_id(execution_id),
    }
    bench.ask(2, rest.pop("values", ()), **(options | rest))


def test_the_id_of_a_halt_leads_to_its_execution_and_back() -> None:
    assert halt_id(halt_id(ID)) == ID
    assert halt_id(ID) != ID


def test_a_halt_waits_for_no_interval_and_is_for_those_who_may_see_the_skill() -> None:
    robot = StoppableRobot()
    limits = SkillLimits(least_interval_s=60.0, largest_message_bytes=8, most_requestors=1, visible_to=(0,))
    robot.offered = (replace(PICK, limits=limits),)
    bench = Bench(robot=robot)
    bench.ask()
    ask_to_halt(bench, requestor_id="9.other")
    assert bench.reports()[-1].status == StatusCode.BAD_USER_ACCESS_DENIED
    ask_to_halt(bench, requestor_id="0.other")
    assert [execution.execution_id for execution in robot.halted] == [ID]


def test_a_robot_is_told_once_to_stop_and_its_end_is_told_as_ever() -> None:
    robot = StoppableRobot()
    bench = Bench(robot=robot)
    (announced,) = bench.announced()
    assert [(one.action_target_id, one.name) for one in announced.targets] == [(1, "arm"), (0x8001, "arm, halt")]
    bench.ask()
    for _ in range(2):
        ask_to_halt(bench)
    assert [execution.execution_id for execution in robot.halted] == [ID]
    assert robot.halted[0].topic == ACTION
    assert [report.state for report in bench.reports()] == [S.RUNNING, S.DONE, S.DONE]
    cancelled = int(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)
    bench.tell(ExecutionEnded(ID, cancelled, (), "halted"))
    ids, _, states, *_ = bench.status()
    assert (ids, states) == ((ID,), (S.FAILED,)), "a halt is no execution of the skill"


def test_a_robot_that_goes_on_is_told_again_by_the_next_request() -> None:
    robot = StoppableRobot()
    bench = Bench(robot=robot)
    bench.ask()
    for number in range(3):
        ask_to_halt(bench, request_id=number + 1, correlation_data=halt_id(ID, number))
    assert [execution.execution_id for execution in robot.halted] == [ID] * 3


def test_what_is_not_under_way_cannot_be_halted() -> None:
    robot = StoppableRobot()
    bench = Bench(robot=robot)
    ask_to_halt(bench)
    bench.ask()
    bench.tell(ExecutionEnded(ID, 0, (1.5,)))
    ask_to_halt(bench, ID, request_id=1)
    assert robot.halted == []
    assert [report.state for report in bench.reports() if "not under way" in report.message] == [S.REFUSED] * 2


def test_a_robot_that_cannot_stop_this_goes_on() -> None:
    robot = StoppableRobot()
    bench = Bench(robot=robot)
    bench.ask()
    robot.halt_error = SkillRejected("it holds a load")
    ask_to_halt(bench)
    assert (bench.reports()[-1].state, bench.reports()[-1].message) == (S.REFUSED, "it holds a load")
    assert bench.states()[0] is S.RUNNING


def test_a_driver_that_breaks_while_it_halts_leaves_the_halt_unknown() -> None:
    robot = StoppableRobot()
    bench = Bench(robot=robot)
    bench.ask()
    robot.halt_error = KeyError("x")
    ask_to_halt(bench)
    assert bench.reports()[-1].state is S.UNKNOWN
    assert bench.failures == ["the driver failed while it halted an execution"]
    assert bench.states()[0] is S.RUNNING


def test_a_halt_has_no_arguments() -> None:
    bench = Bench(robot=StoppableRobot())
    bench.ask()
    ask_to_halt(bench, types=(12,), values=("bin",))
    assert bench.reports()[-1].status == StatusCode.BAD_TYPE_MISMATCH


def test_a_driver_without_a_way_to_stop_offers_none() -> None:
    bench = Bench()
    assert [target.action_target_id for target in bench.announced()[0].targets] == [1]
    bench.ask()
    ask_to_halt(bench)
    assert bench.reports()[-1].status == StatusCode.BAD_NOT_SUPPORTED


def test_a_restart_in_the_middle_of_a_halt_leaves_it_unknown() -> None:
    journal, robot = MemoryJournal(), StoppableRobot()
    bench = Bench(robot=robot, journal=journal)
    bench.ask()
    ask_to_halt(bench)
    (halt,) = [execution for execution in journal.executions() if execution.target.action_target_id & HALT_TARGETS]
    again = MemoryJournal()
    again.recorded(halt._replace(report=halt.report._replace(state=S.RUNNING)))
    later = Bench(robot=StoppableRobot(), journal=again)
    assert later.states() == [S.UNKNOWN]
    assert later.robot.asked == []


def test_an_execution_of_another_skill_is_not_halted_here() -> None:
    robot = StoppableRobot()
    robot.offered = (PICK, replace(PICK, topic=ACTION._replace(id=1502), name="place"))
    bench = Bench(robot=robot)
    bench.ask(data_set_writer_id=1502)
    assert len(robot.begun) == 1
    ask_to_halt(bench)
    assert bench.reports()[-1].message == "that execution is not under way"
    assert robot.halted == []


def test_a_bridge_that_does_all_it_can_at_once_halts() -> None:
    robot = StoppableRobot()
    robot.offered = (replace(PICK, limits=SkillLimits(requests_at_once=100)),)
    bench = Bench(robot=robot)
    bench.ask()
    most = ResponderLimits().requests_at_once
    for number in range(2, most + 1):
        bench.ask(number)
    assert len(robot.begun) == most
    ask_to_halt(bench)
    assert [execution.execution_id for execution in robot.halted] == [ID]
    bench.ask(most + 1)
    assert len(robot.begun) == most, "there is no room for another execution"


def test_a_robot_is_halted_though_the_disk_is_full() -> None:
    robot, journal = StoppableRobot(), FullDisk()
    bench = Bench(robot=robot, journal=journal)
    bench.ask()
    journal.is_full = True
    before = len(bench.answers)
    ask_to_halt(bench)
    assert [execution.execution_id for execution in robot.halted] == [ID]
    assert len(bench.answers) == before, "what is not recorded has no answer, so that it is asked again"
    ask_to_halt(bench, bytes([7]) * 16)
    for hint_ms in (0.0, -1.0):
        ask_to_halt(bench, timeout_hint_ms=hint_ms)
    assert len(robot.halted) == 1, "of another execution, or asking alone"
    journal.is_full = False
    ask_to_halt(bench)
    assert bench.reports()[-1].state is ExecutionState.DONE


@pytest.mark.parametrize("requestor", ["77.other", "no name"])
def test_who_may_not_command_halts_nothing_on_a_full_disk(requestor: str) -> None:
    robot, journal = StoppableRobot(), FullDisk()
    robot.offered = (replace(PICK, limits=SkillLimits(visible_to=(0,))),)
    bench = Bench(robot=robot, journal=journal, must_be_verified=True)
    bench.ask(verified=True)
    journal.is_full = True
    ask_to_halt(bench, requestor_id=requestor, verified=True)
    ask_to_halt(bench, requestor_id="9.other", verified=True)
    ask_to_halt(bench)
    assert robot.halted == []
    ask_to_halt(bench, verified=True)
    assert len(robot.halted) == 1
