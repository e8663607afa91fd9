"""What is known of executions, and what is shown and told of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from tests.unit.nodes.skilled import BLINK, STATUS, TURN, model, said
from ua_fleet.fleet import ValueChanged
from ua_fleet.operation.skills.program import ProgramState, Transition, path
from ua_fleet.operation.skills.tracker import SkillChange, SkillTracker, SkillTransitioned
from ua_fleet.pubsub.events import SourceReturned, SourceSilent
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack
from ua_fleet.skill.status import ExecutionStatus, result_text
from ua_fleet.values import BuiltinType, StatusCode

FIRST, SECOND = bytes(15) + b"\1", bytes(15) + b"\2"
S = ExecutionState
NO_COMMUNICATION = int(StatusCode.BAD_NO_COMMUNICATION)
UNATTESTED = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)
T = Transition


def status(execution_id: bytes, state: ExecutionState, skill: str = "turn", **more: Any) -> ExecutionStatus:
    return ExecutionStatus(execution_id, skill, state, **more)


def shown(changes: Sequence[SkillChange]) -> dict[str, tuple[Any, int]]:
    """Value and status of each member of `turn` that changed."""
    return {
        str(change.key.identifier).removeprefix("1500."): (getattr(change.value, "text", change.value), change.status)
        for change in changes
        if isinstance(change, ValueChanged) and str(change.key.identifier).startswith("1500.")
    }


def told(changes: Sequence[SkillChange]) -> list[tuple[Transition, bytes, bool]]:
    return [
        (change.transition, change.execution.id, change.execution.is_over)
        for change in changes
        if isinstance(change, SkillTransitioned)
    ]


def heard() -> SkillTracker:
    """A tracker whose robot has said that nothing was asked of it."""
    tracker = SkillTracker(model())
    tracker.apply(said(), 5)
    return tracker


def test_a_request_runs_is_accepted_goes_on_and_ends_with_its_results() -> None:
    tracker = heard()
    began = tracker.requested(TURN, FIRST, 10)
    assert told(began) == [(T.READY_TO_RUNNING, FIRST, False)]
    assert shown(began)["CurrentState"] == ("Running", 0)
    assert shown(began)["ExecutionId"] == (FIRST.hex(), 0)
    accepted = RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(S.RUNNING))
    assert tracker.concluded(FIRST, accepted, 11) == []
    half = tracker.apply(said(status(FIRST, S.RUNNING, progress=0.5, message="half")), 12)
    assert shown(half) == {"Progress": (0.5, 0), "Message": ("half", 0)}
    assert told(half) == []
    result = result_text({"reached": 20, "count": 3})
    ended = tracker.apply(said(status(FIRST, S.DONE, result=result), timestamp=60), 13)
    values = shown(ended)
    assert values["CurrentState"] == ("Ready", 0)
    assert (values["LastTransition"], values["LastTransition.Number"]) == (("RunningToReady", 0), (4, 0))
    assert (values["Progress"], values["LastStatus"]) == ((1.0, 0), (0, 0))
    assert (values["Result.reached"], values["Result.count"]) == ((20.0, 0), (3, 0))
    assert values["LastResult.ExecutionId"] == (FIRST.hex(), 0)
    assert values["LastResult.EndTime"] == (60, 0)
    assert told(ended) == [(T.RUNNING_TO_READY, FIRST, True)]
    (event,) = [change for change in ended if isinstance(change, SkillTransitioned)]
    assert event.execution.results == {"reached": 20.0, "count": 3}
    assert tracker.apply(said(status(FIRST, S.DONE, result=result), timestamp=70), 14) == []
    assert tracker.apply(said(status(FIRST, S.RUNNING), timestamp=20), 15) == []


def test_what_was_asked_of_a_robot_that_was_never_heard_is_shown_and_not_good() -> None:
    tracker = SkillTracker(model())
    assert shown(tracker.requested(TURN, FIRST, 10))["CurrentState"] == ("Running", UNATTESTED)
    assert tracker.concluded(FIRST, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(S.RUNNING)), 11) == []
    assert shown(tracker.apply(said(status(FIRST, S.RUNNING)), 12))["CurrentState"] == ("Running", 0)


def test_a_request_that_is_made_again_after_a_restart_changes_nothing() -> None:
    tracker = SkillTracker(model())
    tracker.apply(said(status(FIRST, S.DONE)), 10)
    assert tracker.requested(TURN, FIRST, 11) == []
    assert tracker.state(TURN) is ProgramState.READY


def test_an_immediate_skill_brings_its_results_in_the_answer() -> None:
    tracker = heard()
    tracker.requested(TURN, FIRST, 10)
    packed = pack((int(BuiltinType.UINT16), int(BuiltinType.DOUBLE)), (2, 1.5))
    names = ("count", "reached")  # the bridge has them in another order than the server's fleet.yaml
    ended = tracker.concluded(
        FIRST, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(S.DONE, result=packed), names), 11
    )
    assert (shown(ended)["Result.reached"], shown(ended)["Result.count"]) == ((1.5, 0), (2, 0))
    assert told(ended) == [(T.RUNNING_TO_READY, FIRST, True)]
    repeated = tracker.apply(said(status(FIRST, S.DONE)), 12)
    assert (shown(repeated), told(repeated)) == ({}, [])


@pytest.mark.parametrize(
    ("kind", "report", "move", "state"),
    [
        (
            OutcomeKind.REFUSED,
            ExecutionReport(S.REFUSED, int(StatusCode.BAD_OUT_OF_RANGE), "no"),
            T.RUNNING_TO_READY,
            "Ready",
        ),
        (OutcomeKind.TIMED_OUT, ExecutionReport(S.TIMED_OUT), T.RUNNING_TO_READY, "Ready"),
        (
            OutcomeKind.ACCEPTED,
            ExecutionReport(S.FAILED, int(StatusCode.BAD_OUT_OF_SERVICE)),
            T.RUNNING_TO_HALTED,
            "Halted",
        ),
        (OutcomeKind.UNKNOWN, ExecutionReport(S.UNKNOWN, NO_COMMUNICATION, "no answer"), T.RUNNING_TO_HALTED, "Halted"),
    ],
)
def test_other_outcomes_end_an_execution(
    kind: OutcomeKind, report: ExecutionReport, move: Transition, state: str
) -> None:
    tracker = heard()
    tracker.requested(TURN, FIRST, 10)
    ended = tracker.concluded(FIRST, RequestOutcome(kind, report), 11)
    assert told(ended) == [(move, FIRST, True)]
    expected = report.status or int(StatusCode.BAD_TIMEOUT)
    assert shown(ended)["LastStatus"] == (expected, 0)
    assert shown(ended)["CurrentState"] == (state, 0)


@pytest.mark.parametrize(
    ("state", "told_status", "expected"),
    [
        (S.FAILED, StatusCode.BAD_TIMEOUT, StatusCode.BAD_TIMEOUT),
        (S.FAILED, StatusCode.GOOD, StatusCode.BAD_UNEXPECTED_ERROR),
        (S.FAILED, StatusCode.UNCERTAIN, StatusCode.BAD_UNEXPECTED_ERROR),
        (S.REFUSED, StatusCode.BAD_OUT_OF_RANGE, StatusCode.BAD_OUT_OF_RANGE),
        (S.UNKNOWN, StatusCode.BAD_TIMEOUT, StatusCode.UNCERTAIN),
        (S.DONE, StatusCode.UNCERTAIN, StatusCode.UNCERTAIN),
        (S.DONE, StatusCode.BAD_TIMEOUT, StatusCode.GOOD),
    ],
)
def test_the_status_of_an_end_is_what_the_bridge_says_where_that_fits_its_state(
    state: ExecutionState, told_status: StatusCode, expected: StatusCode
) -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    ended = tracker.apply(said(status(FIRST, state, status=int(told_status))), 11)
    assert shown(ended)["LastStatus"] == (int(expected), 0)


def test_a_failed_skill_is_halted_until_it_is_reset_or_begins_again() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    tracker.apply(said(status(FIRST, S.FAILED, message="stuck")), 11)
    assert tracker.state(TURN) is ProgramState.HALTED
    again = tracker.requested(TURN, SECOND, 12)
    assert [move for move, _, _ in told(again)] == [T.HALTED_TO_READY, T.READY_TO_RUNNING]
    tracker.apply(said(status(SECOND, S.FAILED), timestamp=60), 13)
    reset = tracker.reset(TURN, 14)
    assert told(reset) == [(T.HALTED_TO_READY, SECOND, True)]
    assert shown(reset)["CurrentState"] == ("Ready", 0)
    assert tracker.reset(TURN, 15) == []
    assert tracker.apply(said(status(SECOND, S.FAILED), timestamp=70), 16) == []
    assert tracker.state(TURN) is ProgramState.READY


def test_a_robot_that_stands_and_goes_on_is_shown_and_told() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    stands = tracker.apply(said(status(FIRST, S.SUSPENDED, progress=0.5, message="it stands")), 11)
    assert told(stands) == [(T.RUNNING_TO_SUSPENDED, FIRST, False)]
    assert (shown(stands)["CurrentState"], shown(stands)["CurrentState.Number"]) == (("Suspended", 0), (14, 0))
    assert (tracker.suspended_executions(TURN), tracker.under_way(TURN)) == ([FIRST], 1)
    asked = tracker.apply(said(status(FIRST, S.ASKING, progress=0.5), timestamp=51), 12)
    assert (told(asked), tracker.state(TURN)) == ([], ProgramState.SUSPENDED), "a bridge that asks knows no better"
    goes_on = tracker.apply(said(status(FIRST, S.RUNNING, progress=0.5), timestamp=52), 13)
    assert told(goes_on) == [(T.SUSPENDED_TO_RUNNING, FIRST, False)]
    tracker.apply(said(status(FIRST, S.SUSPENDED), timestamp=53), 14)
    halted = tracker.apply(said(status(FIRST, S.FAILED, message="halted"), timestamp=54), 15)
    assert told(halted) == [(T.SUSPENDED_TO_HALTED, FIRST, True)]


def test_a_skill_is_suspended_where_its_robot_stands_in_all_that_is_under_way() -> None:
    tracker = SkillTracker(model())
    for execution_id in (FIRST, SECOND):
        tracker.requested(TURN, execution_id, 10)
    tracker.apply(said(status(FIRST, S.SUSPENDED), status(SECOND, S.RUNNING)), 11)
    assert tracker.state(TURN) is ProgramState.RUNNING
    assert tracker.running_executions(TURN) == [SECOND]
    tracker.apply(said(status(FIRST, S.SUSPENDED), status(SECOND, S.SUSPENDED), timestamp=51), 12)
    assert tracker.state(TURN) is ProgramState.SUSPENDED


def test_a_server_that_was_started_anew_shows_that_a_robot_stands() -> None:
    tracker = SkillTracker(model())
    first = tracker.apply(said(status(FIRST, S.SUSPENDED)), 10)
    assert (told(first), shown(first)["CurrentState"]) == ([], ("Suspended", 0))
    assert path(ProgramState.HALTED, ProgramState.SUSPENDED) == (
        T.HALTED_TO_READY,
        T.READY_TO_RUNNING,
        T.RUNNING_TO_SUSPENDED,
    )


def test_an_unknown_end_that_is_known_after_all_is_shown() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    tracker.concluded(FIRST, RequestOutcome(OutcomeKind.UNKNOWN, ExecutionReport(S.UNKNOWN, NO_COMMUNICATION)), 11)
    goes_on = tracker.apply(said(status(FIRST, S.RUNNING)), 12)
    assert [move for move, _, _ in told(goes_on)] == [T.HALTED_TO_READY, T.READY_TO_RUNNING]
    ended = tracker.apply(said(status(FIRST, S.DONE), timestamp=60), 13)
    assert told(ended) == [(T.RUNNING_TO_READY, FIRST, True)]


def test_the_first_status_after_a_start_shows_the_truth_and_tells_no_old_events() -> None:
    tracker = SkillTracker(model())
    first = tracker.apply(said(status(FIRST, S.DONE, result='{"reached":7}'), status(SECOND, S.RUNNING)), 10)
    assert told(first) == []
    assert shown(first)["CurrentState"] == ("Running", 0)
    assert shown(first)["ExecutionId"] == (SECOND.hex(), 0)
    assert shown(first)["Result.reached"] == (7.0, 0)
    assert told(tracker.apply(said(status(SECOND, S.DONE), timestamp=60), 11)) == [(T.RUNNING_TO_READY, SECOND, True)]


def test_an_execution_that_somebody_else_asked_for_is_told_whole() -> None:
    tracker = SkillTracker(model())
    tracker.apply(said(), 10)
    both = tracker.apply(said(status(FIRST, S.DONE), timestamp=60), 11)
    assert [move for move, _, _ in told(both)] == [T.READY_TO_RUNNING, T.RUNNING_TO_READY]


def test_what_drives_the_nodes_falls_silent_and_comes_back() -> None:
    tracker = SkillTracker(model())
    assert not tracker.is_silent(TURN)
    tracker.apply(said(status(FIRST, S.RUNNING, progress=0.25)), 10)
    silent = shown(tracker.apply(SourceSilent(STATUS), 11))
    assert silent["CurrentState"] == ("Running", NO_COMMUNICATION)
    assert silent["Progress"] == (0.25, NO_COMMUNICATION)
    assert tracker.is_silent(TURN)
    back = tracker.apply(SourceReturned(STATUS), 12)
    assert shown(back)["Progress"] == (0.25, 0)
    assert not tracker.is_silent(TURN)
    lost = tracker.apply(said(status=NO_COMMUNICATION, timestamp=60), 13)
    assert shown(lost)["CurrentState"] == ("Running", NO_COMMUNICATION)


def test_skills_that_did_nothing_are_ready_once_their_robot_is_heard() -> None:
    tracker = SkillTracker(model())
    idle = tracker.apply(said(), 10)
    assert shown(idle)["CurrentState"] == ("Ready", 0)
    assert tracker.state(BLINK) is ProgramState.READY


def test_two_executions_at_once_keep_a_skill_running_until_both_are_over() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    tracker.requested(TURN, SECOND, 11)
    assert (tracker.under_way(TURN), tracker.open_executions(TURN)) == (2, [FIRST, SECOND])
    one = tracker.apply(said(status(FIRST, S.DONE), status(SECOND, S.RUNNING)), 12)
    assert told(one) == [(T.RUNNING_TO_READY, FIRST, True)]
    assert tracker.state(TURN) is ProgramState.RUNNING
    assert tracker.take_busy_changes() == [(STATUS, ("turn",))]
    tracker.apply(said(status(SECOND, S.FAILED), timestamp=60), 13)
    assert tracker.state(TURN) is ProgramState.HALTED
    assert tracker.take_busy_changes() == [(STATUS, ())]
    assert tracker.take_busy_changes() == []


def test_an_execution_whose_end_was_lost_is_given_up_long_after_its_time() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    tracker.requested(TURN, SECOND, 10)
    tracker.apply(said(status(SECOND, S.RUNNING)), 11)
    assert tracker.expire(TURN, 10 + 40 * 10**7) == []
    given_up = tracker.expire(TURN, 11 + 40 * 10**7)
    assert told(given_up) == [(T.RUNNING_TO_HALTED, FIRST, True)]
    assert shown(given_up)["LastStatus"] == (int(StatusCode.UNCERTAIN), 0)
    assert tracker.open_executions(TURN) == [SECOND], "the robot tells of it"
    late = tracker.apply(said(status(FIRST, S.DONE), status(SECOND, S.RUNNING), timestamp=60), 12)
    assert told(late) == [(T.HALTED_TO_READY, FIRST, True)]


def test_results_that_do_not_fit_and_states_nobody_knows_are_left_out() -> None:
    tracker = SkillTracker(model())
    tracker.requested(TURN, FIRST, 10)
    changes = tracker.apply(said(status(FIRST, S.DONE, result='{"reached":"far","count":-1,"other":1}')), 11)
    assert shown(changes)["Result.reached"] == (None, 0)
    (event,) = [change for change in changes if isinstance(change, SkillTransitioned)]
    assert event.execution.results == {}
    odd = said(status(SECOND, S.RUNNING), timestamp=70)
    values = list(odd.message.values)
    values[2] = (99,)
    assert tracker.apply(odd._replace(message=odd.message._replace(values=tuple(values))), 12) == []


def test_ended_executions_are_forgotten_in_time() -> None:
    tracker = SkillTracker(model())
    for number in range(200):
        execution_id = number.to_bytes(16, "big")
        tracker.requested(TURN, execution_id, number)
        tracker.concluded(execution_id, RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(S.DONE)), number)
    assert tracker.execution(TURN, bytes(16)) is None
    assert tracker.execution(TURN, (199).to_bytes(16, "big")) is not None


def test_paths_between_states_are_those_of_the_standard() -> None:
    assert path(ProgramState.HALTED, ProgramState.RUNNING) == (T.HALTED_TO_READY, T.READY_TO_RUNNING)
    assert path(ProgramState.READY, ProgramState.READY) == ()
    for transition in Transition:
        assert path(*transition.ends) == (transition,)
        assert transition.text == f"{transition.ends[0].text}To{transition.ends[1].text}"


def test_the_outcome_for_a_robot_that_is_gone_changes_nothing() -> None:
    tracker = heard()
    tracker.requested(TURN, FIRST, 10)
    (robot,) = model().robots
    tracker.remove(robot)
    accepted = RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(S.RUNNING))
    assert tracker.concluded(FIRST, accepted, 11) == []
