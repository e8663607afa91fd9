"""What comes of runs: what robots are asked, and what people are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.operation.runs.world import ACCEPTED, CONFIG, IMMEDIATE, ONE, World
from ua_fleet.config.skill_schema import SkillLimitsConfig
from ua_fleet.errors import NoCandidate, RobotOffline, ScenarioError, ScenarioInvalid, StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotState
from ua_fleet.operation.runs.robot_news import COALESCE_S
from ua_fleet.operation.runs.task_calls import START_WITHIN_S
from ua_fleet.orchestrator import DecisionChanged, Fault, OperatorAsked, RunChanged
from ua_fleet.resilience import DecisionMode
from ua_fleet.scenario.consequences import HALT_S, SETTLE_S
from ua_fleet.scenario.facts import TaskOutcome, TaskOver
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.values import BuiltinType, NodeId, StatusCode


def test_a_task_is_asked_for_once_and_its_end_ends_the_run(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((robot, values, execution_id),) = world.robots.asked
    assert (robot, values) == ("left", (5.0,))
    world.service.concluded(execution_id, ACCEPTED)
    world.service.concluded(execution_id, IMMEDIATE)
    assert world.ended() == ["done"]
    world.service.concluded(execution_id, IMMEDIATE)
    assert world.ended() == ["done"]
    assert len(world.robots.asked) == 1


@pytest.mark.parametrize(("kind", "value"), [(BuiltinType.BYTE_STRING, b"3 kg"), (BuiltinType.STRING, None)])
def test_a_result_that_is_no_value_of_a_condition_is_left_out(tmp_path: Path, kind: BuiltinType, value: object) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    report = ExecutionReport(ExecutionState.DONE, result=pack((kind,), (value,)))
    world.service.concluded(execution_id, RequestOutcome(OutcomeKind.ACCEPTED, report))
    assert (world.ended(), world.service.problem) == (["done"], "")


def test_a_number_that_no_double_holds_is_no_result(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(f"{ONE}  - if: a.weight > 1\n    timeout_s: 1\n    then: {{task: b, skill: grab, robot: left}}\n")
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    told = ExecutionStatus(execution_id, "grab", ExecutionState.DONE, result=f'{{"weight": {10**400}}}')
    world.hear(1200, told)
    world.pass_time(3.0)
    assert len(world.robots.asked) == 1
    assert "a.weight" in world.ended()[0]


@pytest.mark.parametrize("status", [StatusCode.BAD_TOO_MANY_OPERATIONS, StatusCode.BAD_SERVER_TOO_BUSY])
def test_a_robot_that_is_at_something_else_is_asked_again_a_little_later(tmp_path: Path, status: StatusCode) -> None:
    """It may still be stopping what took too long, or do what an operator has asked for."""
    world = World(tmp_path)
    world.start()
    for number in range(1, 4):
        assert [robot for robot, _, _ in world.robots.asked] == ["left"] * number
        if number < 3:
            report = ExecutionReport(ExecutionState.REFUSED, status, "1 such executions are under way")
            world.service.concluded(world.robots.asked[-1][2], RequestOutcome(OutcomeKind.REFUSED, report))
        else:  # its bridge has taken it, and the robot's program has not
            report = ExecutionReport(ExecutionState.FAILED, status, "the device is busy with something else")
            world.service.concluded(world.robots.asked[-1][2], RequestOutcome(OutcomeKind.ACCEPTED, report))
        world.pass_time(0.4)
        assert len(world.robots.asked) == number, "not at once"
        world.pass_time(0.2)
    world.service.concluded(world.robots.asked[-1][2], IMMEDIATE)
    assert (world.ended(), world.faults()) == (["done"], [])
    assert len({execution_id for _, _, execution_id in world.robots.asked}) == 4


def test_nobody_begins_beside_a_robot_that_does_not_stop_what_took_too_long(tmp_path: Path) -> None:
    """Automatic or not: a person is asked, and at the limit the task fails."""
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 1, retries: 1"))
    world.service.concluded(world.robots.asked[-1][2], ACCEPTED)
    world.pass_time(1.0)
    assert world.robots.halted == ["left"]
    world.pass_time(HALT_S + 59)
    (asked,) = [output for output in world.said if isinstance(output, OperatorAsked)]
    assert "not done in 1 s; left did not confirm that it has stopped; left may still be at it" in asked.question
    assert world.service.open_decisions == 1
    world.pass_time(1.5)
    assert [robot for robot, _, _ in world.robots.asked] == ["left"]
    assert [line.endswith("nobody consented in time to a second robot beside the first") for line in world.ended()] == [
        True
    ]


def test_a_halt_that_no_robot_has_confirmed_outlives_run_and_server(tmp_path: Path) -> None:
    world = World(tmp_path)
    run_id = world.start()
    execution_id = world.robots.asked[-1][2]
    world.service.concluded(execution_id, ACCEPTED)
    world.robots.known[execution_id] = ACCEPTED
    world.service.runs.abort(run_id, "enough", "anna")
    world.pass_time(HALT_S)
    assert (world.ended()[0].split(maxsplit=1)[0], world.faults()) == ("aborted", ["left.not_halted RAISED"])
    world.journal.close()
    world.robots.halted.clear()
    again = World(tmp_path, world.robots)
    assert again.service.must_not_begin() == [execution_id]
    assert again.robots.halted == ["left"], "it is told again"
    again.start()
    assert again.robots.asked[-1][0] == "right"
    again.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.FAILED))
    assert again.faults()[-1] == "left.not_halted CLEARED"
    assert again.journal.halts() == []
    again.start()
    assert again.robots.asked[-1][0] == "left"


def test_a_person_consents_to_a_second_robot(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 1"))
    world.service.concluded(world.robots.asked[-1][2], ACCEPTED)
    world.pass_time(1.0 + HALT_S)
    (run_id,) = world.service.run_ids
    with pytest.raises(NoCandidate, match="left cannot take over: may still be at it"):
        world.service.decisions.confirm(f"{run_id}.0", "left", "anna")
    world.service.decisions.confirm(f"{run_id}.0", "right", "anna")
    assert [robot for robot, _, _ in world.robots.asked] == ["left", "right"]


def test_a_task_whose_robot_stands_waits_and_nobody_is_asked_in_its_place(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.SUSPENDED))
    world.pass_time(3.0)
    assert (world.ended(), world.faults()) == ([], [])
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.ended(), len(world.robots.asked)) == (["done"], 1)


def test_after_a_restart_a_known_request_is_not_made_again(tmp_path: Path) -> None:
    world = World(tmp_path)
    run_id = world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.journal.close()
    again = World(tmp_path, world.robots)
    assert [record.run_id for record in again.records] == [run_id]
    assert len(again.robots.asked) == 1
    again.service.concluded(execution_id, IMMEDIATE)
    assert again.ended() == ["done"]


def test_a_robot_tells_of_its_own_executions_alone(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    for status_id, ended in ((1201, []), (1200, ["done"])):
        world.hear(status_id, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
        assert world.ended() == ended


def test_why_an_execution_failed_is_told_with_its_status_code(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    for status_id, status, outcome, said in (
        (1200, StatusCode.BAD_OUT_OF_SERVICE, TaskOutcome.STOPPED, "stuck (BadOutOfService)"),
        (1201, StatusCode.BAD_UNEXPECTED_ERROR, TaskOutcome.FAILED, "stuck (BadUnexpectedError)"),
    ):
        *_, execution_id = world.robots.asked[-1]
        world.service.concluded(execution_id, ACCEPTED)
        world.hear(
            status_id, ExecutionStatus(execution_id, "grab", ExecutionState.FAILED, 0.5, "", "stuck", int(status))
        )
        over = [out.fact for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)][-1]
        assert (over.outcome, over.message) == (outcome, said)
    assert [fault.reason for fault in world.service.faults] == ["grab failed: stuck (BadOutOfService)"]


@pytest.mark.parametrize(
    ("status", "outcome"),
    [
        (StatusCode.BAD_DEVICE_FAILURE, TaskOutcome.STOPPED),
        (StatusCode.BAD_NO_COMMUNICATION, TaskOutcome.UNREACHED),
        (StatusCode.BAD_TIMEOUT, TaskOutcome.UNKNOWN),
    ],
)
def test_what_a_driver_says_of_the_robot_by_the_status_of_an_end(
    tmp_path: Path, status: StatusCode, outcome: TaskOutcome
) -> None:
    world = World(tmp_path)
    world.start()
    *_, execution_id = world.robots.asked[-1]
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.FAILED, status=int(status)))
    (over,) = [out.fact for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)]
    assert over.outcome is outcome


def test_an_action_that_nobody_announces_is_looked_for_until_another_robot_is_asked(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.robots.refusal = RobotOffline("nobody announces it")
    world.start()
    world.pass_time(START_WITHIN_S - 1)
    assert not [output for output in world.said if isinstance(output, RunChanged) and isinstance(output.fact, TaskOver)]
    world.pass_time(2)
    (over, *_) = [o.fact for o in world.said if isinstance(o, RunChanged) and isinstance(o.fact, TaskOver)]
    assert (over.outcome, over.message) == (TaskOutcome.UNREACHED, "nobody announces it")
    world.pass_time(CONFIG.resilience.silence_s)
    assert any(isinstance(output, DecisionChanged) for output in world.said)


BOTH = """version: 1
name: both
steps:
  - parallel:
      - {task: a, skill: grab, robot: left, arguments: {angle: 5}}
      - {task: b, skill: grab, robot: right, arguments: {angle: 5}}
"""


def test_two_robots_that_cannot_be_reached_end_the_run_and_not_the_server(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.robots.refusal = RobotOffline("nobody announces it")
    world.start(BOTH)
    world.service.decisions.set_settings(replace(world.service.settings, mode=DecisionMode.ABORT), "anna")
    world.pass_time(START_WITHIN_S + CONFIG.resilience.silence_s + 1)
    assert len(world.ended()) == 1
    assert world.service.run_ids == []
    assert world.mistakes.count == 0


def test_a_mistake_with_one_task_costs_that_task_alone(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.robots.refusal = KeyError("no such thing")
    run_id = world.start(BOTH)
    assert world.mistakes.counts["outputs of runs"] == 2
    overs = [o.fact for o in world.said if isinstance(o, RunChanged) and isinstance(o.fact, TaskOver)]
    assert {over.outcome for over in overs} == {TaskOutcome.UNKNOWN}
    assert "KeyError" in overs[0].message
    world.robots.refusal = None
    if run_id in world.service.run_ids:
        world.service.runs.abort(run_id, "enough", "anna")
    world.pass_time(HALT_S)
    world.start()
    assert world.robots.asked == [], "nobody knows what it was told"
    world.service.fault_reports.clear_fault("left")
    world.start()
    assert [robot for robot, *_ in world.robots.asked] == ["left"]


TWICE = ONE + "  - {task: b, after: [a], skill: grab, robot: left, arguments: {angle: 6}}\n"


@pytest.mark.parametrize("is_status_first", [False, True])
def test_a_skill_is_asked_for_again_after_its_interval(tmp_path: Path, *, is_status_first: bool) -> None:
    skill = CONFIG.robots["left"].skills["grab"]
    limited = skill.model_copy(update={"limits": SkillLimitsConfig(least_interval_s=2.0)})
    left = CONFIG.robots["left"].model_copy(update={"skills": {"grab": limited}})
    world = World(tmp_path, config=CONFIG.model_copy(update={"robots": {**CONFIG.robots, "left": left}}))
    world.start(TWICE)
    world.pass_time(0.5)  # the request is on its way
    ((_, _, first),) = world.robots.asked
    if not is_status_first:
        world.service.concluded(first, ACCEPTED)
        world.pass_time(0.5)
    world.hear(1200, ExecutionStatus(first, "grab", ExecutionState.DONE))
    waits_s = 2.0 if is_status_first else 1.5
    world.pass_time(waits_s - 0.01)
    assert len(world.robots.asked) == 1
    world.pass_time(0.01)
    assert [values for _, values, _ in world.robots.asked] == [(5.0,), (6.0,)]


def test_a_silent_robot_has_an_alarm_and_its_task_goes_on(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 60"))
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.state("left", RobotState.OFFLINE)
    assert world.faults() == ["left.silent RAISED"]
    world.pass_time(29)
    assert ([robot for robot, _, _ in world.robots.asked], world.robots.halted) == (["left"], [])
    world.state("left", RobotState.IDLE)
    assert world.faults() == ["left.silent RAISED", "left.silent CLEARED"]
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.ended(), len(world.robots.asked)) == (["done"], 1)


def test_a_robot_that_is_found_at_its_task_goes_on_and_nobody_need_answer(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 500"))
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.silence("left")
    world.pass_time(35)
    assert world.service.open_decisions == 1, "what it said before is not of now"
    world.state("left", RobotState.IDLE)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.ASKING))
    assert world.service.open_decisions == 1, "its bridge asks it itself"
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    assert world.service.open_decisions == 0
    world.pass_time(100)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.ended(), len(world.robots.asked)) == (["done"], 1)


def test_a_silent_robot_that_never_answered_is_asked_when_it_is_heard(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.state("left", RobotState.OFFLINE)
    no_answer = ExecutionReport(ExecutionState.UNKNOWN, StatusCode.BAD_NO_COMMUNICATION, "no answer came")
    world.service.concluded(execution_id, RequestOutcome(OutcomeKind.UNKNOWN, no_answer))
    world.pass_time(4)
    assert ([o for o in world.said if isinstance(o, OperatorAsked)], world.robots.inquired) == ([], [])
    world.state("left", RobotState.IDLE)
    assert world.robots.inquired == [execution_id]
    never = ExecutionReport(ExecutionState.TIMED_OUT, StatusCode.BAD_TIMEOUT, "it came too late")
    world.service.concluded(execution_id, RequestOutcome(OutcomeKind.TIMED_OUT, never))
    world.pass_time(3)
    assert [robot for robot, _, _ in world.robots.asked] == ["left", "left"], "it is known that it was never begun"


def test_a_request_that_came_too_late_is_made_again_until_its_robot_was_waited_for(tmp_path: Path) -> None:
    """Its bridge was away for longer than a request may take, and for less than a silent robot is waited for."""
    world = World(tmp_path)
    world.start()
    never = ExecutionReport(ExecutionState.TIMED_OUT, StatusCode.BAD_TIMEOUT, "it came 16.4 s after it was issued")
    while [robot for robot, _, _ in world.robots.asked].count("left") < 3:
        world.pass_time(8)
        world.service.concluded(world.robots.asked[-1][2], RequestOutcome(OutcomeKind.TIMED_OUT, never))
        world.pass_time(2)
        assert {robot for robot, _, _ in world.robots.asked} == {"left"}
    world.pass_time(11)
    world.service.concluded(world.robots.asked[-1][2], RequestOutcome(OutcomeKind.TIMED_OUT, never))
    assert [robot for robot, _, _ in world.robots.asked] == ["left", "left", "left", "right"]


def test_a_robot_that_is_wanted_is_waited_for_from_the_start_of_the_server(tmp_path: Path) -> None:
    world = World(tmp_path, heard=["right"])
    world.start()
    world.pass_time(29)
    assert world.robots.asked == []
    world.state("left", RobotState.IDLE)
    assert [robot for robot, _, _ in world.robots.asked] == ["left"]


def test_a_robot_that_stays_silent_is_replaced_where_it_had_begun_nothing(tmp_path: Path) -> None:
    world = World(tmp_path, heard=["right"])
    world.start()
    world.pass_time(30)
    assert [robot for robot, _, _ in world.robots.asked] == ["right"]


def test_what_becomes_known_together_is_known_before_anything_follows(tmp_path: Path) -> None:
    """Both robots announce a fault in one message: the second one is not asked to stand in for the first."""
    world = World(tmp_path)
    world.start()
    for key in (1300, 1301):
        change = ValueChanged(NodeId(2, key), int(BuiltinType.STRING), "stuck", 0, 1, False)
        world.service.value_changed(change)
    world.service.take_news()
    assert [robot for robot, _, _ in world.robots.asked] == ["left"]


def test_a_value_that_is_a_fault_is_known_before_a_run_begins(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(1000, 15.0)
    world.start()
    assert [robot for robot, _, _ in world.robots.asked] == ["right"]


def test_a_task_that_waited_for_the_disk_is_not_begun_on_a_robot_that_has_a_fault_by_then(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start("version: 1\nname: s\nsteps:\n  - {wait: , event: go}\n" + ONE.partition("steps:\n")[2])
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        world.service.runs.tell_event("go")
    world.value(1300, "stuck", BuiltinType.STRING)
    world.journal.fails = False
    world.pass_time(5)
    assert [robot for robot, _, _ in world.robots.asked] == ["right"]


def test_a_request_of_a_run_before_does_not_begin_on_a_robot_with_a_fault(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.fault_reports.raise_fault("left", "stuck")
    world.journal.close()
    again = World(tmp_path, world.robots)
    assert again.service.must_not_begin() == [execution_id]
    assert [robot for robot, _, _ in again.robots.asked] == ["left"]


def test_a_task_that_was_not_asked_for_before_a_restart_is_not_on_a_robot_with_a_fault(tmp_path: Path) -> None:
    """The server was killed between writing the task down and asking; meanwhile somebody has found a fault."""
    world = World(tmp_path)
    world.start()
    world.journal.write([], [Fault("left.robot", "left", "robot", "stuck", True, False, 100.0)])
    world.journal.close()
    again = World(tmp_path)  # nobody was ever asked
    assert [robot for robot, _, _ in again.robots.asked] == ["right"]


def test_a_robot_that_is_never_heard_is_silent_after_a_while(tmp_path: Path) -> None:
    world = World(tmp_path, heard=["right"])
    world.pass_time(1)
    assert world.faults() == []
    world.pass_time(60)
    assert world.faults() == ["left.silent RAISED"]
    world.state("left", RobotState.IDLE)
    assert world.faults() == ["left.silent RAISED", "left.silent CLEARED"]


def test_conditions_are_looked_at_soon_and_not_for_each_value(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(1000, 15.0)
    assert world.service.next_deadline() == world.now + COALESCE_S
    world.value(1000, 10.0)
    world.pass_time(1)
    assert world.faults() == ["left.battery_low RAISED"]
    world.value(1010, True, BuiltinType.BOOLEAN)
    assert world.service.next_deadline() == world.now
    world.value(1000, 50.0)
    world.pass_time(1)
    assert world.faults() == ["left.battery_low RAISED", "left.battery_low CLEARED"]


def test_faults_are_there_again_after_a_restart(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.fault_reports.raise_fault("left", "gripper stuck")
    world.service.fault_reports.acknowledge("left.robot", "anna")
    world.journal.close()
    again = World(tmp_path)
    ((fault),) = again.service.faults
    assert (fault.id, fault.reason, fault.acknowledged_by) == ("left.robot", "gripper stuck", "anna")
    again.service.fault_reports.clear_fault("left")
    assert again.service.faults == []


def test_a_run_that_no_longer_fits_the_fleet_is_ended(tmp_path: Path) -> None:
    world = World(tmp_path)
    run_id = world.start()
    world.journal.close()
    (tmp_path / "runs.db").touch()
    with RunJournal(tmp_path / "runs.db") as journal:
        (created, *others) = journal.facts(run_id)
        text = ONE.replace("robot: left", "robot: gone")
        journal.write([("other", type(created)(1.0, "other", text))])  # type: ignore[call-arg, arg-type]  # it is RunCreated
        assert others
    again = World(tmp_path)
    (ended,) = [record for record in again.records if record.run_id == "other"]
    assert ended.shown_state == "failed"
    assert "there is no robot 'gone'" in ended.state.reason
    assert again.service.run_ids == [run_id]


def test_a_robot_announces_its_fault_and_its_repair(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    world.value(1300, " motor\n overheated", BuiltinType.STRING)
    world.value(1300, "motor overheated", BuiltinType.STRING)
    world.value(1300, "motor burnt", BuiltinType.STRING)
    assert world.faults() == ["left.announced RAISED", "left.announced REASON_CHANGED"]
    assert world.service.faults[0].reason == "motor burnt"
    world.pass_time(SETTLE_S)
    assert [robot for robot, *_ in world.robots.asked] == ["left", "right"], "another robot does the task"
    with pytest.raises(ScenarioError, match=r"cause is still there: announced \(motor burnt\)"):
        world.service.fault_reports.clear_fault("left")
    world.value(1300, "", BuiltinType.STRING)
    assert world.faults()[-1] == "left.announced CLEARED"


def test_an_announced_fault_lasts_while_the_robot_is_silent_and_over_a_restart(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(1300, "motor overheated", BuiltinType.STRING)
    world.value(1300, "motor overheated", BuiltinType.STRING, StatusCode.BAD_NO_COMMUNICATION)
    assert world.faults() == ["left.announced RAISED"]
    world.journal.close()
    again = World(tmp_path)
    assert [(fault.id, fault.reason, fault.active) for fault in again.service.faults] == [
        ("left.announced", "motor overheated", True)
    ]
    again.service.fault_reports.clear_fault("left")  # nobody says any more that it is there
    assert again.faults()[-1] == "left.announced CLEARED"
    again.value(1300, "motor overheated", BuiltinType.STRING)
    assert again.faults()[-1] == "left.announced RAISED"


def test_what_is_no_text_is_no_fault(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(1300, 7, BuiltinType.INT32)
    world.value(1300, "x" * 1000, BuiltinType.STRING)
    (fault,) = world.service.faults
    assert len(fault.reason) == 200


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_robot_that_can_tell_later_answers_what_operators_were_asked(tmp_path: Path, *, is_restarted: bool) -> None:
    world = World(tmp_path)
    world.start()
    *_, execution_id = world.robots.asked[0]
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.UNKNOWN))
    (asked,) = [output for output in world.said if isinstance(output, OperatorAsked)]
    assert (asked.robot, asked.skill, asked.execution_id) == ("left", "grab", execution_id.hex())
    if is_restarted:
        world.journal.close()
        world = World(tmp_path, world.robots)
    world.hear(1201, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert not world.ended(), "another robot cannot know"
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert world.ended() == ["done"]
    over = [out.fact for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)][-1]
    assert over.message == "left reported late: done; the question is closed"
    assert len(world.robots.asked) == 1


@pytest.mark.parametrize(
    ("angle", "said"), [("91", "angle is 91; legal is -90 to 90"), ("left", "angle is 'left'; it has to be a number")]
)
def test_what_a_scenario_computes_is_held_against_the_skill_before_a_robot_hears_of_it(
    tmp_path: Path, angle: str, said: str
) -> None:
    world = World(tmp_path)
    text = ONE.replace("angle: 5", 'angle: "=angle"').replace("steps:", "parameters: {angle: {}}\nsteps:")
    with pytest.raises(ScenarioInvalid, match="the parameter 'angle' is inf, and no number"):
        world.start(text, ["angle"], ["1e999"])
    world.start(text, ["angle"], [angle])
    over = [out.fact for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)]
    assert {(fact.outcome, fact.message) for fact in over} == {(TaskOutcome.REFUSED, said)}
    assert not world.robots.asked
    assert [fault.robot for fault in world.service.faults] == [], "no robot is to blame"
