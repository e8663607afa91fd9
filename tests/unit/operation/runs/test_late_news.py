"""What is known late, or cannot be written down yet, has no robot begin what it must not, and no run wait in vain."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.world import ACCEPTED, CONFIG, ONE, STATUS, World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline
from ua_fleet.fleet.model import RobotState
from ua_fleet.orchestrator import OperatorAsked, RunChanged
from ua_fleet.scenario.consequences import HALT_S, LEAST_SILENCE_S, SETTLE_S
from ua_fleet.scenario.facts import TaskOutcome, TaskOver
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import BuiltinType, StatusCode

LONG = ONE.replace("angle: 5}", "angle: 5}, timeout_s: 500, on_unknown: replace")
"""Its author consents to a second robot as soon as nobody knows what the first one is at."""
NO_ANSWER = RequestOutcome(
    OutcomeKind.UNKNOWN, ExecutionReport(ExecutionState.UNKNOWN, StatusCode.BAD_NO_COMMUNICATION, "no answer came")
)


def test_a_task_that_waits_is_not_begun_while_its_end_waits_for_the_disk(tmp_path: Path) -> None:
    """The Action is announced after the fault, and before the journal can be written again."""
    world = World(tmp_path)
    world.robots.refusal = RobotOffline("nobody announces the Action")
    world.start()
    world.journal.fails = True
    world.value(1300, "stuck", BuiltinType.STRING)
    world.robots.refusal = None
    world.pass_time(3)
    assert world.robots.asked == []
    world.journal.fails = False
    world.pass_time(3)
    assert [robot for robot, _, _ in world.robots.asked] == ["right"]


def test_a_robot_that_goes_on_though_it_was_halted_does_not_withdraw_the_question(tmp_path: Path) -> None:
    """It would be halted and asked about for ever, and nobody could answer in time."""
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 1"))
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.pass_time(1 + HALT_S)
    assert world.service.open_decisions == 1
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING, 0.5))
    assert world.service.open_decisions == 1
    world.pass_time(61)
    assert len([output for output in world.said if isinstance(output, OperatorAsked)]) == 1
    (ended,) = world.ended()
    assert ended.endswith("nobody consented in time to a second robot beside the first")


def test_a_robot_that_ends_after_all_though_it_was_halted_answers_the_question(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 1"))
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.pass_time(1 + HALT_S)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.ended(), world.service.open_decisions) == (["done"], 0)


@pytest.mark.parametrize("is_late", [False, True])
def test_what_was_done_though_its_robot_has_a_fault_is_not_done_again(tmp_path: Path, *, is_late: bool) -> None:
    """The robot announces its fault, and then that it had done the task: somebody is still choosing, or has chosen."""
    said = CONFIG.model_dump(mode="json", exclude_unset=True)
    said["resilience"]["mode"] = "operator"
    world = World(tmp_path, config=FleetConfig.model_validate(said))
    run_id = world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.value(1300, "stuck", BuiltinType.STRING)
    world.pass_time(SETTLE_S)
    assert world.service.open_decisions == 1
    if is_late:
        world.service.decisions.confirm(f"{run_id}.0", "right", "anna")
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.service.open_decisions, world.ended()) == (0, ["done"])
    *_, over = [out.fact for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)]
    if is_late:  # the second one was asked, and had not begun: it is told not to
        assert [robot for robot, _, _ in world.robots.asked] == ["left", "right"]
        assert world.robots.halted[-1] == "right"
        assert over.message == "it was done before right began: done"
    else:
        assert [robot for robot, _, _ in world.robots.asked] == ["left"]
        assert over.message == "left reported late: done; the question is closed"


def test_a_fault_and_the_end_that_comes_right_behind_it_choose_nobody(tmp_path: Path) -> None:
    """A robot that announces a fault has its last word, also where nobody has to be asked who takes over."""
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.value(1300, "stuck", BuiltinType.STRING)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    world.pass_time(60)
    assert ([robot for robot, _, _ in world.robots.asked], world.ended()) == (["left"], ["done"])


@pytest.mark.parametrize("is_done", [True, False])
def test_after_a_restart_nobody_takes_over_before_the_robot_may_have_said_that_it_was_done(
    tmp_path: Path, *, is_done: bool
) -> None:
    """The server was killed while nobody was there to take over; its robots are heard again one after the other."""
    world = World(tmp_path, heard=["left"])
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.robots.known[execution_id] = ACCEPTED
    world.value(1300, "stuck", BuiltinType.STRING)
    world.pass_time(SETTLE_S)
    assert world.service.open_decisions == 1
    world.journal.close()
    again = World(tmp_path, world.robots, heard=["right"])
    again.pass_time(1.0)
    assert [robot for robot, _, _ in again.robots.asked] == ["left"]
    if is_done:
        again.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
        assert again.ended() == ["done"]
    again.pass_time(LEAST_SILENCE_S)
    assert [robot for robot, _, _ in again.robots.asked] == (["left"] if is_done else ["left", "right"])


def test_what_a_robot_never_answered_is_asked_also_after_a_restart(tmp_path: Path) -> None:
    """The request was lost, its robot is waited for (`on_unknown: retry`), and then the server is restarted."""
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, on_unknown: retry"))
    ((_, _, execution_id),) = world.robots.asked
    world.state("left", RobotState.OFFLINE)
    world.service.concluded(execution_id, NO_ANSWER)
    world.robots.known[execution_id] = NO_ANSWER
    world.pass_time(31)
    world.journal.close()
    again = World(tmp_path, world.robots, heard=["right"])
    assert again.robots.inquired == []
    again.state("left", RobotState.IDLE)
    assert again.robots.inquired == [execution_id]
    never = ExecutionReport(ExecutionState.TIMED_OUT, StatusCode.BAD_TIMEOUT, "it came too late")
    again.service.concluded(execution_id, RequestOutcome(OutcomeKind.TIMED_OUT, never))
    again.pass_time(3)
    assert [robot for robot, _, _ in again.robots.asked] == ["left", "left"]


def test_a_request_of_a_run_that_was_aborted_does_not_begin_after_a_restart(tmp_path: Path) -> None:
    """The server was killed after the abort was written down, and before the request was withdrawn."""
    world = World(tmp_path)
    run_id = world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.runs.abort(run_id, "enough", "anna")
    world.journal.close()
    again = World(tmp_path, world.robots)
    assert again.service.must_not_begin() == [execution_id]


def begun_without_values(world: World) -> bytes:
    """Its robot has begun a task, and then its values are lost; the execution."""
    world.start(LONG)
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.state("left", RobotState.OFFLINE)
    return execution_id


def ends(world: World) -> list[TaskOutcome]:
    """How attempts have ended."""
    return [out.fact.outcome for out in world.said if isinstance(out, RunChanged) and isinstance(out.fact, TaskOver)]


def asked(world: World) -> list[str]:
    return [robot for robot, _, _ in world.robots.asked]


def test_a_robot_that_says_it_is_at_its_task_is_not_silent_for_it_though_its_values_are_lost(tmp_path: Path) -> None:
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.pass_time(100)
    assert (ends(world), asked(world)) == ([], ["left"])
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert (world.ended(), asked(world)) == (["done"], ["left"])


def test_it_is_silent_from_then_on_when_its_status_is_lost_too(tmp_path: Path) -> None:
    world = World(tmp_path)
    begun_without_values(world)
    world.pass_time(100)
    world.service.source_lost(STATUS["left"])
    world.pass_time(29)
    assert (ends(world), asked(world)) == ([], ["left"])
    world.pass_time(2)
    assert (ends(world), asked(world)) == ([TaskOutcome.UNKNOWN], ["left", "right"])


def test_it_is_silent_from_then_on_when_it_says_so_no_more(tmp_path: Path) -> None:
    """Its bridge was started anew, and asks the robot."""
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.pass_time(100)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.ASKING))
    world.pass_time(29)
    assert ends(world) == []
    world.pass_time(2)
    assert ends(world) == [TaskOutcome.UNKNOWN]


def test_a_status_that_is_back_says_again_what_it_said(tmp_path: Path) -> None:
    """Messages were lost for a while, and the robot has said nothing new meanwhile."""
    world = World(tmp_path)
    begun_without_values(world)
    world.service.source_lost(STATUS["left"])
    world.pass_time(20)
    world.service.source_returned(STATUS["left"])
    world.pass_time(100)
    assert (ends(world), asked(world)) == ([], ["left"])


def test_a_bridge_that_has_lost_its_robot_does_not_speak_for_it(tmp_path: Path) -> None:
    """The robot's program was killed: its bridge goes on, and knows no end of what was under way."""
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.pass_time(100)
    world.value("900.Connected", False, BuiltinType.BOOLEAN)
    world.pass_time(20)
    world.value("900.Connected", True, BuiltinType.BOOLEAN)
    world.pass_time(100)
    assert ends(world) == []
    world.value("900.Connected", False, BuiltinType.BOOLEAN)
    world.service.source_returned(STATUS["left"])
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.pass_time(29)
    assert (ends(world), asked(world)) == ([], ["left"])
    world.pass_time(2)
    assert (ends(world), asked(world)) == ([TaskOutcome.UNKNOWN], ["left", "right"])


def test_a_status_that_says_that_its_source_is_gone_says_nothing_of_executions(tmp_path: Path) -> None:
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.hear(
        1200,
        ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING),
        status=int(StatusCode.BAD_NO_COMMUNICATION),
    )
    world.pass_time(31)
    assert ends(world) == [TaskOutcome.UNKNOWN]


def test_another_robot_cannot_say_what_a_robot_is_at(tmp_path: Path) -> None:
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.service.source_lost(STATUS["left"])
    world.hear(1201, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.pass_time(31)
    assert ends(world) == [TaskOutcome.UNKNOWN]


def test_after_a_restart_a_robot_without_values_is_followed_by_what_it_says(tmp_path: Path) -> None:
    world = World(tmp_path)
    execution_id = begun_without_values(world)
    world.robots.known[execution_id] = ACCEPTED
    world.journal.close()
    again = World(tmp_path, world.robots, heard=["right"])
    again.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    again.pass_time(100)
    assert (ends(again), asked(again)) == ([], ["left"])


def test_a_robot_without_values_that_does_not_stop_is_asked_about_once(tmp_path: Path) -> None:
    """It was told to, since its time is over, and goes on saying that it is at it."""
    world = World(tmp_path)
    world.start(ONE.replace("angle: 5}", "angle: 5}, timeout_s: 20, on_unknown: retry"))
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.RUNNING))
    world.state("left", RobotState.OFFLINE)
    world.pass_time(20 + HALT_S)
    assert (ends(world), world.service.open_decisions, asked(world)) == ([TaskOutcome.UNKNOWN], 1, ["left"])
