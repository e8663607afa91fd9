"""A robot that was told to stop, or of which nobody knows what it is at, is nobody's until that is known: it is told
again, and a person is asked, but nothing waits for ever.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import pytest

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator import (
    Fault,
    FaultChanged,
    Halt,
    HaltChanged,
    OperatorAsked,
    Orchestrator,
    Output,
    ResilienceSettings,
    RunChanged,
    TaskCancelled,
    TasksAhead,
    TaskStarted,
)
from ua_fleet.resilience import Criterion, CriterionKind, DecisionMode
from ua_fleet.scenario import FleetView, RobotView, Value, scenario_of
from ua_fleet.scenario.consequences import HALT_S, NOT_HALTED, SETTLE_S, SILENT
from ua_fleet.scenario.facts import Fact, RunEnded, RunOutcome, TaskHalting, TaskOutcome

GO = SkillModel(1, "go", ("mobile",))
FLEET = FleetView({name: RobotView(name, frozenset({"mobile"}), {"go": GO}) for name in ("ned", "ted")})
Kind = TypeVar("Kind", bound=Output)
CRITERIA = ((Criterion("availability", CriterionKind.BENEFIT, (0, 100)), TasksAhead()),)
SETTINGS = ResilienceSettings(CRITERIA, {}, mode=DecisionMode.AUTOMATIC, limit_s=60.0, silence_s=30.0, return_s=100.0)


class World:
    """An orchestrator and its time; `seen` is all that it said."""

    def __init__(self, halts: Iterable[Halt] = (), faults: Iterable[Fault] = ()) -> None:
        self.now = 0.0
        self.seen: list[Output] = []
        self.facts: list[Fact] = []
        self.values: dict[str, Value] = {}
        self.make = Orchestrator(SETTINGS, FLEET, self.values.__getitem__, lambda _, fact: self.facts.append(fact))
        for fault in faults:
            self.take(self.make.fault_raised(fault.robot, fault.source, fault.reason, fault.since))
        self.take(self.make.restore_all([], self.now, halts))

    def take(self, outputs: list[Output]) -> None:
        self.seen += outputs

    def run(self, run_id: str, task: str) -> str:
        """Start a run of one task on ned; its execution id, where a robot was asked."""
        text = f"version: 1\nname: s\nsteps:\n  - {{task: t, robot: ned, skill: go{task}}}\n"
        self.take(self.make.start(run_id, scenario_of(text), {}, by="anna", now=self.now))
        return next((begun.execution_id for begun in self.of(TaskStarted) if begun.run_id == run_id), "")

    def accept(self, execution_id: str) -> None:
        self.take(self.make.accepted(execution_id, self.now))

    def end(self, execution_id: str, outcome: TaskOutcome) -> None:
        self.take(self.make.ended(execution_id, outcome, self.now))

    def silent(self, robot: str) -> None:
        self.take(self.make.fault_raised(robot, SILENT, "it is silent", self.now))

    def heard(self, robot: str) -> None:
        self.take(self.make.fault_cleared(robot, SILENT, self.now))

    def go(self, seconds: float) -> None:
        end, polls = self.now + seconds, 0
        while (due := self.make.next_deadline()) is not None and due <= end:
            self.now, polls = max(self.now, due), polls + 1
            self.take(self.make.poll(self.now))
            assert polls < 1000, "it is called for nothing"
        self.now = end
        self.take(self.make.poll(self.now))

    def of(self, kind: type[Kind]) -> list[Kind]:
        return [output for output in self.seen if isinstance(output, kind)]

    def asked(self) -> list[tuple[str, str]]:
        return [(begun.run_id, begun.robot) for begun in self.of(TaskStarted)]

    def ends(self) -> dict[str, RunOutcome]:
        changed = self.of(RunChanged)
        return {one.run_id: one.fact.outcome for one in changed if isinstance(one.fact, RunEnded)}

    def is_out(self) -> bool:
        """Whether people are told that ned did not stop."""
        return any(fault.source == NOT_HALTED for fault in self.make.faults.active("ned"))


def test_what_its_driver_gave_up_is_not_asked_of_the_same_robot_unasked() -> None:
    world = World()
    execution_id = world.run("a", ", on_unknown: retry, retries: 5")
    world.accept(execution_id)
    world.end(execution_id, TaskOutcome.UNKNOWN)
    assert len(world.of(OperatorAsked)) == 1
    world.go(59)
    assert (world.asked(), world.ends()) == ([("a", "ned")], {})
    world.go(2)
    assert (world.asked(), world.ends()) == ([("a", "ned")], {"a": RunOutcome.FAILED})


@pytest.mark.parametrize("outcome", [TaskOutcome.FAILED, TaskOutcome.DONE])
def test_it_is_asked_again_once_it_is_known_not_to_be_at_it(outcome: TaskOutcome) -> None:
    world = World()
    execution_id = world.run("a", ", on_unknown: retry")
    world.accept(execution_id)
    world.end(execution_id, TaskOutcome.UNKNOWN)
    world.end(execution_id, outcome)
    is_done = outcome is TaskOutcome.DONE
    assert world.asked() == [("a", "ned")] * (1 if is_done else 2)
    assert world.make.decisions == {}
    assert bool(world.ends()) is is_done


def test_a_robot_that_never_returns_is_waited_for_so_long_then_a_decision_asks() -> None:
    world = World()
    world.accept(world.run("a", ", on_unknown: retry"))
    world.silent("ned")
    world.go(SETTINGS.silence_s + SETTINGS.return_s - 1)
    assert (world.of(OperatorAsked), world.ends()) == ([], {})
    world.go(1)
    assert len(world.of(OperatorAsked)) == 1
    world.go(SETTINGS.limit_s)
    assert (world.asked(), world.ends()) == ([("a", "ned")], {"a": RunOutcome.FAILED})


def test_a_robot_that_is_heard_again_and_tells_nothing_is_asked_about() -> None:
    world = World()
    world.accept(world.run("a", ", on_unknown: retry"))
    world.silent("ned")
    world.go(40)
    world.heard("ned")
    world.go(11)
    assert len(world.of(OperatorAsked)) == 1
    assert world.asked() == [("a", "ned")]


@pytest.mark.parametrize("policy", ["retry", "ask"])
def test_a_robot_that_goes_on_whatever_it_is_told_is_asked_about_once(policy: str) -> None:
    world = World()
    execution_id = world.run("a", f", on_unknown: {policy}, retries: 3, timeout_s: 5")
    world.accept(execution_id)
    for _ in range(80):
        world.go(1)
        world.accept(execution_id)  # its SkillStatus says that it is running
    assert len(world.of(OperatorAsked)) == 1
    assert len([fact for fact in world.facts if isinstance(fact, TaskHalting)]) == 1
    assert world.ends() == {"a": RunOutcome.FAILED}
    assert len(world.of(TaskCancelled)) > 3, "it is told again"
    assert world.is_out()


@pytest.mark.parametrize("policy", ["ask", "retry"])
def test_a_run_that_is_aborted_leaves_no_robot_moving_to_the_next(policy: str) -> None:
    world = World()
    execution_id = world.run("a", f", on_unknown: {policy}")
    world.accept(execution_id)
    world.silent("ned")
    world.go(31)  # nobody knows what it is at: asked, or waited for
    world.take(world.make.abort("a", "enough", "anna", world.now))
    world.heard("ned")
    world.run("b", "")
    assert (world.ends(), world.asked()) == ({"a": RunOutcome.ABORTED}, [("a", "ned")])
    assert world.of(TaskCancelled)[-1] == TaskCancelled(execution_id, "ned", "go")
    world.end(execution_id, TaskOutcome.FAILED)
    assert world.asked() == [("a", "ned"), ("b", "ned")], "it has stopped"
    assert [changed.is_owed for changed in world.of(HaltChanged)] == [True, False]


def test_a_run_that_breaks_while_a_person_is_asked_has_its_robot_stopped() -> None:
    world = World()
    world.values["bad"] = 0.0
    text = "version: 1\nname: s\nsteps:\n  - parallel:\n"
    text += "      - {task: t, robot: ned, skill: go}\n      - {wait: , until: bad > 1}\n"
    world.take(world.make.start("a", scenario_of(text), {}, by="anna", now=0.0))
    (begun,) = world.of(TaskStarted)
    world.accept(begun.execution_id)
    world.end(begun.execution_id, TaskOutcome.UNKNOWN)
    assert len(world.of(OperatorAsked)) == 1
    del world.values["bad"]
    world.go(1)
    assert world.ends() == {"a": RunOutcome.FAILED}
    assert world.of(TaskCancelled) == [TaskCancelled(begun.execution_id, "ned", "go")]
    world.run("b", "")
    assert world.asked() == [("a", "ned")]
    world.end(begun.execution_id, TaskOutcome.FAILED)
    assert world.asked() == [("a", "ned"), ("b", "ned")]


@pytest.mark.parametrize("by", ["robot", "person"])
def test_a_robot_that_does_not_stop_is_out_until_it_has_or_somebody_says_so(by: str) -> None:
    world = World()
    execution_id = world.run("a", "")
    world.accept(execution_id)
    world.take(world.make.abort("a", "enough", "anna", world.now))
    world.go(HALT_S)
    assert world.ends() == {"a": RunOutcome.ABORTED}
    assert world.is_out()
    world.run("b", "")
    assert world.asked()[-1] == ("b", "ted"), "another one does it"
    if by == "robot":
        world.end(execution_id, TaskOutcome.FAILED)
    else:
        world.take(world.make.fault_cleared("ned", NOT_HALTED, world.now))
    assert not world.is_out()
    world.run("c", "")
    assert world.asked()[-1] == ("c", "ned")
    told = len(world.of(TaskCancelled))
    world.go(100)
    assert len(world.of(TaskCancelled)) == told, "nobody is told any more"


@pytest.mark.parametrize("is_fault_known", [False, True])
def test_a_halt_outlives_the_server(*, is_fault_known: bool) -> None:
    halt = Halt("00" * 16, "ned", "go", -1.0)
    faults = [Fault(f"ned.{NOT_HALTED}", "ned", NOT_HALTED, "look", True, False, 0.0)] if is_fault_known else []
    world = World([halt], faults)
    assert world.make.must_not_begin() == [halt.execution_id]
    assert world.of(TaskCancelled) == [TaskCancelled(halt.execution_id, "ned", "go")]
    world.run("a", "")
    assert world.asked() == ([("a", "ted")] if is_fault_known else [])
    world.go(400)
    assert 5 < len(world.of(TaskCancelled)) < 15, "in growing pauses"
    assert world.is_out()
    world.end(halt.execution_id, TaskOutcome.FAILED)
    world.run("b", "")
    assert (world.asked()[-1], world.is_out()) == (("b", "ned"), False)


def test_a_robot_that_announces_a_fault_stands_and_owes_nothing() -> None:
    world = World()
    world.accept(world.run("a", ""))
    world.take(world.make.abort("a", "enough", "anna", world.now))
    world.take(world.make.fault_raised("ned", "announced", "the drive is hot", world.now))
    world.go(HALT_S)
    world.take(world.make.fault_cleared("ned", "announced", world.now))
    world.run("b", "")
    assert world.asked()[-1] == ("b", "ned")
    assert not any(changed.fault.source == NOT_HALTED for changed in world.of(FaultChanged))


@pytest.mark.parametrize("policy", ["fail", "replace"])
def test_nobody_else_gets_a_robot_that_may_be_at_what_was_given_up(policy: str) -> None:
    world = World()
    execution_id = world.run("a", f", on_unknown: {policy}")
    world.accept(execution_id)
    world.end(execution_id, TaskOutcome.UNKNOWN)
    world.run("b", "")
    assert ("b", "ned") not in world.asked()
    world.end(execution_id, TaskOutcome.FAILED)
    assert world.asked()[-1] == ("b", "ned")


def test_what_was_done_before_the_second_robot_was_free_is_not_done_again() -> None:
    world = World()
    text = "version: 1\nname: s\nsteps:\n  - {task: t, robot: ted, skill: go}\n"
    world.take(world.make.start("busy", scenario_of(text), {}, by="anna", now=0.0))
    execution_id = world.run("a", "")
    world.accept(execution_id)
    world.take(world.make.fault_raised("ned", "announced", "the drive is hot", world.now))
    world.go(SETTLE_S)
    assert world.make.decisions == {}, "ted was chosen, and is at something else"
    world.end(execution_id, TaskOutcome.DONE)
    assert world.ends() == {"a": RunOutcome.DONE}
    assert world.asked() == [("busy", "ted"), ("a", "ned")]


@pytest.mark.parametrize("is_asked", [False, True])
def test_a_halt_of_the_run_itself_is_no_halt_of_a_client(is_asked: bool) -> None:
    world = World()
    execution_id = world.run("a", ", on_unknown: ask")
    world.accept(execution_id)
    if is_asked:
        world.end(execution_id, TaskOutcome.UNKNOWN)  # what follows takes it back, without a wait for its end
    world.take(world.make.fault_raised("ned", "robot", "hot", world.now))
    world.end(execution_id, TaskOutcome.HALTED)
    assert world.asked() == [("a", "ned"), ("a", "ted")]


@pytest.mark.parametrize("outcome", [TaskOutcome.UNREACHED, TaskOutcome.BUSY, TaskOutcome.REFUSED])
@pytest.mark.parametrize("is_asked", [False, True])
def test_what_never_reached_its_robot_is_no_fault_of_it(outcome: TaskOutcome, is_asked: bool) -> None:
    """A PLC that stands is accepted for by its bridge, which says in the end that nothing was given to it."""
    world = World()
    execution_id = world.run("a", ", timeout_s: 35")
    world.accept(execution_id)
    world.go(35)
    if is_asked:
        world.go(HALT_S)
    world.end(execution_id, outcome)
    assert world.asked() == [("a", "ned"), ("a", "ted")], "longer than silence_s nobody asks an unreached robot again"
    world.end(world.of(TaskStarted)[-1].execution_id, TaskOutcome.DONE)
    assert world.ends() == {"a": RunOutcome.DONE}
    assert list(world.make.faults) == []


def test_what_never_reached_its_robot_is_asked_of_it_again_as_if_it_had_not_been() -> None:
    world = World()
    execution_id = world.run("a", ", timeout_s: 20")
    world.accept(execution_id)
    world.go(20)
    world.end(execution_id, TaskOutcome.UNREACHED)
    assert world.asked() == [("a", "ned"), ("a", "ned")]
