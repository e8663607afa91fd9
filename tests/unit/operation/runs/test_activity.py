"""What each robot is at, from what the service says."""

from __future__ import annotations

from typing import Final

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.operation.runs.activity import RobotActivities, RobotActivity
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import Fault, FaultChange, FaultChanged, Hold, HoldChanged, RunChanged
from ua_fleet.scenario.facts import (
    Fact,
    Replaced,
    ReplacementWanted,
    RunCreated,
    RunEnded,
    RunOutcome,
    TaskAccepted,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.state import RunState

NOTHING: Final = RobotActivity()
TEXT: Final = "version: 1\nname: s\nsteps:\n  - {task: fetch, robot: rover, skill: go}\n"


class Told:
    """Activities that are told facts of runs, as the view tells them."""

    def __init__(self) -> None:
        self.activities = RobotActivities()
        self.runs: dict[str, RunState] = {}

    def tell(self, run_id: str, *facts: Fact) -> None:
        for fact in facts:
            run = self.runs.setdefault(run_id, RunState())
            run.apply(fact)
            self.activities.take(RunChanged(run_id, fact), run)

    def of(self, robot: str) -> RobotActivity:
        return self.activities.of(robot)


def assigned(step: str, task: str, robot: str, attempt: int = 1) -> TaskAssigned:
    return TaskAssigned(1.0, step, task, attempt, robot, f"{step}{attempt}", "go")


def over(step: str, then: Then = Then.DONE) -> TaskOver:
    return TaskOver(2.0, step, 1, TaskOutcome.DONE if then is Then.DONE else TaskOutcome.FAILED, then, "said")


def fault(source: str, reason: str, *capacities: str, active: bool = True) -> FaultChanged:
    told = Fault(f"rover.{source}", "rover", source, reason, active, False, 1.0, capacities=capacities)
    return FaultChanged(told, FaultChange.RAISED if active else FaultChange.CLEARED)


def test_a_robot_is_at_its_task_from_the_request_to_the_end() -> None:
    told = Told()
    assert told.of("rover") == NOTHING
    told.tell("r1", assigned("1", "fetch", "rover"))
    assert told.activities.moved.take(9) == ["rover"]
    assert (told.of("rover").tasks, told.of("rover").run_id) == (("fetch",), "r1")
    told.tell("r1", TaskAccepted(1.5, "1", 1))
    assert told.activities.moved.take(9) == []
    told.tell("r1", over("1"))
    assert told.activities.moved.take(9) == ["rover"]
    assert told.of("rover") == NOTHING


def test_a_task_goes_to_the_robot_that_takes_it_over() -> None:
    told = Told()
    told.tell("r1", assigned("1", "fetch", "rover"), over("1", Then.REPLACE))
    assert told.of("rover") == NOTHING
    told.tell("r1", ReplacementWanted(2.0, "1", "rover", "broken"), Replaced(3.0, "1", "rover", "lift", "anna"))
    assert told.of("lift") == NOTHING  # it waits for its turn
    told.activities.moved.take(9)
    told.tell("r1", assigned("1", "fetch", "lift", 2))
    assert told.of("lift").tasks == ("fetch",)
    assert told.activities.moved.take(9) == ["lift"]


def test_two_tasks_are_told_with_the_run_of_the_first() -> None:
    told = Told()
    told.tell("r1", assigned("1", "fetch", "rover"))
    told.tell("r2", assigned("7", "look", "rover"))
    assert (told.of("rover").tasks, told.of("rover").run_id) == (("fetch", "look"), "r1")
    told.tell("r1", over("1"))
    assert (told.of("rover").tasks, told.of("rover").run_id) == (("look",), "r2")


def test_the_end_of_a_run_is_the_end_of_its_tasks() -> None:
    told = Told()
    told.tell("r1", assigned("1", "fetch", "rover"), assigned("2", "look", "lift"))
    told.activities.moved.take(9)
    told.tell("r1", RunEnded(3.0, RunOutcome.ABORTED, "enough"))
    assert (told.of("rover"), told.of("lift")) == (NOTHING, NOTHING)
    assert sorted(told.activities.moved.take(9)) == ["lift", "rover"]


def test_the_first_fault_is_told_and_silence_only_where_there_is_no_other() -> None:
    told = Told().activities
    told.take(fault("silent", "nothing is heard"), None)
    assert told.of("rover") == NOTHING._replace(faults=1, fault="nothing is heard")
    told.take(fault("announced", "the drive is hot", "mobile"), None)
    told.take(fault("robot", "out of order"), None)
    assert told.of("rover") == NOTHING._replace(faults=3, fault="lacks mobile: the drive is hot")
    told.take(fault("announced", "", active=False), None)
    assert told.of("rover") == NOTHING._replace(faults=2, fault="out of order")
    told.moved.take(9)
    for source in ("robot", "silent", "silent"):
        told.take(fault(source, "", active=False), None)
    assert told.of("rover") == NOTHING
    assert told.moved.take(9) == ["rover"]


def test_who_holds_a_robot_is_told_until_it_is_released() -> None:
    told, hold = RobotActivities(), Hold("rover", "anna", 1.0, "")
    told.take(HoldChanged(hold, is_held=True, by="anna"), None)
    assert told.of("rover").hold == hold
    told.take(HoldChanged(hold, is_held=False, by="otto"), None)
    assert told.of("rover") == NOTHING


def test_after_a_restart_the_journal_says_it() -> None:
    going_on = RunRecord.of("r1", [RunCreated(0.0, "r1", TEXT), assigned("1", "fetch", "rover")])
    ended = RunRecord.of(
        "r0", [RunCreated(0.0, "r0", TEXT), assigned("1", "old", "lift"), RunEnded(3.0, RunOutcome.DONE)]
    )
    told = RobotActivities()
    told.restored([ended, going_on], [Hold("arm", "anna", 1.0, "")])
    assert (told.of("rover").tasks, told.of("rover").run_id) == (("fetch",), "r1")
    assert told.of("lift") == NOTHING
    assert told.of("arm").hold == Hold("arm", "anna", 1.0, "")
    told.take(RunChanged("r1", over("1")), _applied(going_on, over("1")))
    assert told.of("rover") == NOTHING


def _applied(record: RunRecord, fact: Fact) -> RunState:
    record.apply(fact)
    return record.state


RUNS: Final = st.sampled_from(("r1", "r2"))
STEPS: Final = st.sampled_from("123")
FACTS: Final = st.one_of(
    st.builds(assigned, STEPS, st.sampled_from(("fetch", "look")), st.sampled_from(("rover", "lift"))),
    st.builds(over, STEPS, st.sampled_from(Then)),
    st.just(RunEnded(9.0, RunOutcome.FAILED)),
)


@given(st.lists(st.tuples(RUNS, FACTS), max_size=40))
def test_nothing_is_left_of_runs_that_have_ended(facts: list[tuple[str, Fact]]) -> None:
    told = Told()
    for run_id, fact in facts:
        if told.runs.get(run_id, RunState()).outcome is None:
            told.tell(run_id, fact)
        told.activities.of("rover")
    for run_id in list(told.runs):
        told.tell(run_id, RunEnded(10.0, RunOutcome.ABORTED))
    assert (told.of("rover"), told.of("lift")) == (NOTHING, NOTHING)
